"""The pure parts of the exploration bench: ratios in pairs, intervals, what never reached 99 % counts."""

import math

import numpy as np
import pytest

from noctule import bench_exploration as bench
from noctule.settings import EXTERNAL_POLICY, POLICIES


def result(world, seed, policy, t99, **more):
    return {"world": world, "seed": seed, "policy": policy, "time_to_99_s": t99, "path_to_99_m": None if t99 is None else t99 / 2, "path_m": 300.0,
            "exploring_s": 100.0, "completed": True, "explored_fraction": 0.99, "least_clearance_m": 0.07, "back_and_forth": 0, "switches": 1,
            "stuck": 0, "plan_ms": (0.5, 2.0, 3.0), "walls": (0.99, 0.98), **more}


def test_ratios_pair_the_seeds_that_both_policies_flew():
    results = [result("a", 1, "tour", 50.0), result("a", 1, "frontier", 100.0), result("a", 2, "frontier", 400.0),
               result("b", 1, "tour", 80.0), result("c", 1, "frontier", 10.0)]
    assert bench.ratios(results, bench.time_to_99) == {"a": 0.5}


def test_never_reaching_99_percent_counts_as_the_greatest_time_for_either_policy():
    for policy in bench.COMPARED:
        assert bench.time_to_99(result("a", 1, policy, None)) == bench.MAX_TIME_S
        assert bench.path_to_99(result("a", 1, policy, None)) == 300.0


def test_the_interval_holds_the_mean_and_narrows_with_worlds():
    rng = np.random.default_rng(1)
    few, many = rng.normal(0.8, 0.1, 5), rng.normal(0.8, 0.1, 200)
    low, high = bench.bootstrap(few)
    assert low < few.mean() < high
    tight = bench.bootstrap(many)
    assert tight[1] - tight[0] < high - low


def test_rows_say_missed_for_a_flight_that_did_not_complete():
    results = [result("a", 1, "tour", 50.0, completed=False), result("a", 1, "frontier", 100.0)]
    rows = {r["name"]: r for r in bench.rows_of(results, {"a": 40.0})}
    completed = rows["default: completed, explored_fraction at least 0.97"]
    assert (completed["value"], completed["must"]) == (0, "== 1")
    assert rows["time to 99 %, against nearest frontier, mean over worlds"]["value"] == pytest.approx(0.5)
    assert rows["a tour that knows the building: path, against nearest frontier"]["value"] == pytest.approx(40.0 / 50.0)
    assert rows["a tour that knows the building, at 0.7 m/s: time, against nearest frontier"]["value"] == pytest.approx(40.0 / 0.7 / 100.0)
    assert rows["default: visible wall cells marked within one cell, mean"]["value"] == pytest.approx(0.99)


def test_a_world_that_nobody_sees_whole_is_told_and_left_out_of_the_means():
    results = [result("a", 1, "tour", 50.0), result("a", 1, "frontier", 100.0)]
    results += [result("b", 1, policy, None, explored_fraction=share) for policy, share in (("tour", 0.98), ("frontier", 0.96))]
    results += [result("c", 1, "tour", None), result("c", 1, "frontier", 900.0)]      # one of the two saw it: the other's counts
    rows = {r["name"]: r for r in bench.rows_of(results, {})}
    assert rows["b: 99 % seen by nobody, left out of the two means; explored_fraction"]["value"] == pytest.approx(0.98)
    assert rows["time to 99 %, against nearest frontier, mean over worlds"]["value"] == pytest.approx((0.5 + bench.MAX_TIME_S / 900.0) / 2)
    assert rows["path to 99 %, against nearest frontier, mean over worlds"]["value"] == pytest.approx((0.5 + 300.0 / 450.0) / 2)
    assert rows["default: never reached 99 %"]["value"] == 2


def test_a_whole_flight_with_a_contact_confirms_nothing():
    whole = [{"world": "a", "seed": 1, "completed": True, "explored_fraction": 0.99, "time_to_99_s": 60.0, "collisions": n} for n in (0, 1)]
    rows = bench.confirmed_rows(whole, [result("a", 1, "tour", 50.0), result("a", 1, "frontier", 10.0)])
    assert (rows[0]["value"], rows[0]["must"]) == (1, "== 2")
    assert rows[1]["value"] == pytest.approx(1.2)


def test_a_tour_that_knows_the_building_looks_into_each_room_and_no_farther():
    from noctule.clairvoyant import clairvoyant_m
    from noctule.score import cached_floor_truth
    from noctule_sim.world import build_world

    def way(*walls):
        plan = {"name": "rooms", "start": {"x": 1.0, "y": 1.0, "yaw_deg": 0.0}, "floors": [{"elevation": 0.0, "height": 2.5, "extent": [-1, -1, 9, 5]}],
                "walls": [{"from": list(w[:2]), "to": list(w[2:])} for w in walls]}
        world = build_world(plan)
        return clairvoyant_m(cached_floor_truth(world.primitives(), 0.0, 1.0, 1.0), 1.0, 1.0)

    box = ((0, 0, 8, 0), (8, 0, 8, 4), (8, 4, 0, 4), (0, 4, 0, 0))
    assert way(*box) == pytest.approx(0.0, abs=0.5)                      # all of it is seen from the start
    behind = way(*box, (5, 0, 5, 2.9))                                    # a room behind a wall, its door at the far side
    assert 2.0 < behind < 9.0                                              # through the door and a look round, not every corner

def test_policies_are_named_in_the_order_of_the_parameter():
    from noctule.params_gen import TABLE

    row = next(r for r in TABLE if r.name == "policy")
    assert (row.min, row.max) == (0, EXTERNAL_POLICY) and EXTERNAL_POLICY == len(POLICIES)
    assert POLICIES.index("tour") == 0 and math.isclose(row.default, 0.0)


def test_an_unknown_policy_is_refused_with_one_line(capsys):
    from noctule import cli

    assert cli.main(["fly", "maze_a", "--policy", "greedy"]) == 2
    assert "greedy" in capsys.readouterr().err
