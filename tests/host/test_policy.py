"""Policies in Python: what they see, what they may answer, and that a bad one harms only itself."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from noctule import cli, inprocess_flight, record, replay
from noctule.policies.widest import Widest
from noctule.policy import FINISHED, Goal, MapView, Pose
from noctule.policy_host import Host, load
from noctule.settings import EXTERNAL_POLICY, FlightSettings, InputError, parameter_values
from test_replay import built

sys.path.insert(0, str(Path(__file__).parent))

needs_library = pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")
PARAMETERS = parameter_values(FlightSettings("maze_a"))
FREE, WALL = -20, 40


def room(view):
    """Free from (0, 0) to (6, 6) m, a wall at x = 3 with a gap of 1.2 m at y = 5, unknown beyond y = 6."""
    grid = np.zeros((64, 64), np.int8)
    grid[:60, :60] = FREE
    grid[0, :60] = grid[:60, 0] = grid[:60, 59] = WALL
    grid[:44, 30] = grid[56:, 30] = WALL
    view.put(0, 0, 0, grid.ravel())
    return view


def test_the_view_is_the_published_map():
    view = room(MapView(PARAMETERS))
    tile = np.zeros(4096, np.int8)
    tile[5 * 64 + 7] = WALL
    view.put(0, -1, 2, tile)
    assert view.log_odds.shape == (192, 128) and (view.x0_m, view.y0_m) == (pytest.approx(-6.4), 0.0)
    row, column = view.cell(-6.4 + 0.75, 12.8 + 0.55)
    assert view.occupied[row, column] and view.place(row, column) == (pytest.approx(-5.65), pytest.approx(13.35))
    assert view.free[view.cell(1.0, 1.0)] and view.unknown[view.cell(1.0, 6.2)]
    view.put(1, 0, 0, np.full(4096, FREE, np.int8))
    view.enter(1)
    assert view.free.all() and view.log_odds.shape == (64, 64)


def test_ways_lead_round_walls_and_keep_the_hull_clear():
    view = room(MapView(PARAMETERS))
    view.moved(Pose(1.5, 1.5))
    assert view.way_m[view.cell(1.5, 4.5)] == pytest.approx(3.0, abs=0.15)
    through = math.hypot(1.4, 3.3) + math.hypot(1.6, 3.3)
    assert through < view.way_m[view.cell(4.5, 1.5)] < 1.15 * through
    assert not view.passable[view.cell(0.25, 3.0)] and not np.isfinite(view.way_m[view.cell(2.95, 1.0)])
    view.moved(Pose(4.5, 1.5))
    assert view.way_m[view.cell(4.55, 1.55)] < 0.15


def test_frontiers_are_the_edge_of_the_unknown_nearest_first():
    view = room(MapView(PARAMETERS))
    view.moved(Pose(1.5, 1.5))
    fronts = view.frontiers()
    assert [f.cells for f in fronts] == [29, 28] or [f.cells for f in fronts] == [57]
    assert all(abs(f.y_m - 5.95) < 0.01 and f.view_y_m < 5.7 for f in fronts)
    assert fronts == sorted(fronts, key=lambda f: f.way_m)


def asked(host, number=1, **more):
    ask = record.message_type("policy_ask_t")()
    ask.seq, ask.exploration, ask.x_m, ask.y_m, ask.budget_cells = number, 1, 1.5, 1.5, 16000
    ask.from_x_m, ask.from_y_m = 1.5, 1.5
    for name, value in more.items():
        setattr(ask, name, value)
    return record.message_type("policy_goal_t").decode(host.receive("POLICY_ASK", ask.encode()))


class Says:
    """A policy that need not derive from Policy."""

    def __init__(self, what):
        self.what = what

    def step(self, view, pose, budget_cells):
        return self.what() if callable(self.what) else self.what


@pytest.mark.parametrize("what, kind", [(None, 0), (Goal(2.0, 3.0), 1), (FINISHED, 2), ("left", 3), (7.0, 3), (Goal("a", "b"), 3),
                                        (lambda: 1 / 0, 3), (sys.exit, 3)])
def test_every_answer_has_its_kind(what, kind, capsys):
    told = asked(Host(lambda: Says(what), PARAMETERS), 5)
    assert (told.kind, told.ask, told.seq) == (kind, 5, 0)


def test_a_goal_carries_the_way_it_looks():
    told = asked(Host(lambda: Says(Goal(2.0, 3.0, look=(2.5, 9.0))), PARAMETERS))
    assert (told.x_m, told.y_m, told.look_x_m, told.look_y_m) == (2.0, 3.0, 2.5, 9.0)
    told = asked(Host(lambda: Says(Goal(2.0, 3.0, yaw_rad=math.pi / 2)), PARAMETERS))
    assert math.atan2(told.look_y_m - 3.0, told.look_x_m - 2.0) == pytest.approx(math.pi / 2)


def test_the_example_takes_the_widest_front_for_its_distance_and_ends():
    policy, view = Widest(), room(MapView(PARAMETERS))
    view.moved(Pose(1.5, 1.5))
    policy.begin(Pose(0.0, 0.0))
    goal = policy.step(view, Pose(1.5, 1.5), 16000)
    assert goal.look[1] == pytest.approx(5.95) and view.passable[view.cell(goal.x_m, goal.y_m)]
    assert policy.step(view, Pose(1.5, 1.5), 0) is goal
    grid = view.log_odds.copy()
    grid[59, :60] = WALL                                    # seen: it was a wall
    view.put(0, 0, 0, grid.ravel())
    for t_s in (1.0, 1.6, 3.0):
        view.t_s = t_s
        last = policy.step(view, Pose(1.5, 4.0), 16000)
    assert last is FINISHED


def test_the_example_is_as_short_as_the_manual_says():
    source = Path(sys.modules[Widest.__module__].__file__).read_text(encoding="utf-8")
    assert len(source.splitlines()) <= 40


@pytest.mark.parametrize("name, word", [("greedy", "no policy 'greedy'"), ("nowhere.at_all:P", "nowhere"), ("bad_policies:Nobody", "no class Nobody"),
                                        ("noctule.policies.widest:LOOK_S", "method step"), (":", "package.module:Class")])
def test_a_policy_that_is_not_there_is_refused_in_one_line(name, word, capsys):
    assert cli.main(["fly", "maze_a", "--policy", name]) == 2
    said = capsys.readouterr().err
    assert word in said and said.count("\n") == 1


def fly(folder, policy, max_time_s, **parameters):
    from noctule_sim.world import load_world

    settings = FlightSettings(world="levels", seed=1, camera=False, max_time_s=max_time_s, policy_class=policy,
                              parameters={"policy": EXTERNAL_POLICY, **parameters})
    return inprocess_flight.fly(settings, load_world("levels"), folder)


@needs_library
def test_the_example_flies_and_its_log_replays(tmp_path):
    result = fly(tmp_path / "run", "noctule.policies.widest:Widest", 45.0, floors_max=1)
    assert result["policy"] == {"name": "noctule.policies.widest:Widest", "refused": 0, "timeouts": 0, "given_up_s": None}
    assert result["explorer"]["goals"] >= 2 and result["collisions"] == 0
    assert result["floors"][0]["explored_fraction"] > 0.9
    again = replay.replay_flight(tmp_path / "run" / "flight.lcm")
    assert again.equal and again.compared["POLICY_ASK"] > 200, again.difference


@needs_library
@pytest.mark.parametrize("name, counted", [("Throws", "refused"), ("ThrowsAtBirth", "refused"), ("NoNumber", "refused"), ("Outside", "refused"),
                                           ("InWall", "refused"), ("WrongType", "refused"), ("Stalls", "timeouts"), ("Dies", "timeouts"),
                                           ("Idle", "timeouts")])
def test_a_bad_policy_does_not_end_the_flight(tmp_path, monkeypatch, name, counted):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    assert load(f"bad_policies:{name}")
    result = fly(tmp_path / "run", f"bad_policies:{name}", 30.0, policy_patience=3, policy_timeout_s=0.5)
    told = result["policy"]
    assert told[counted] == 3 and told["refused"] + told["timeouts"] == 3
    assert 5.0 < told["given_up_s"] < 20.0
    assert result["explorer"]["goals"] >= 1 and result["outcome"] == "max_time"      # the tour flies on
    assert result["floors"][0]["explored_fraction"] > 0.8
