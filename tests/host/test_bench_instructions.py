"""Instruction counts: callgrind's format is read rightly, and a real count is repeatable."""

import shutil

import pytest

from noctule import bench_instructions as bench
from noctule.processes import find_program
from noctule.settings import FlightSettings, InputError

DUMPS = """\
# callgrind format
part: 1
positions: line
events: Ir
summary: 161

fn=(1) noctule::Navigator::step(noctule::SensorFrame const&)
12 10
+1 5
cfn=(2) noctule::Mission::step(noctule::Estimate const&)
calls=1 40
+2 100
cfn=(3) noctule::Navigator::update_estimate(noctule::SensorFrame const&)
calls=1 40
* 46

fn=(3)
30 6
cfn=(4) noctule::Localiser::update(noctule::SensorFrame const&)
calls=1 40
+2 40

fn=(2)
40 60
cfn=(5) noctule::Bounded<float, 4ul>::push(float const&)
calls=3 9
+2 40

fn=(4)
50 40

fn=(5)
60 40
totals: 161

part: 2
fn=(1)
12 7
cfn=(2)
calls=1 40
+2 13
fn=(2)
40 13
part: 3
fn=(9) memcpy
1 3
"""


def test_own_and_inclusive_costs_are_told_apart():
    steps = bench.read_dumps(DUMPS.splitlines(keepends=True))
    assert [s.total for s in steps] == [161, 20]                 # the third has no step in it
    assert steps[0].stages == {"Mission::step": 100, "Localiser::update": 40}
    assert steps[0].own == {"Navigator::step": 15, "Navigator::update_estimate": 6, "Mission::step": 60, "Localiser::update": 40, "Bounded::push": 40}
    assert steps[1].stages == {"Mission::step": 13}
    assert bench.hot(steps, 1) == [("Mission::step", 36.5, pytest.approx(73 / 181))]


def test_rows_judge_median_and_99_percent():
    steps = [bench.StepCount(n * 1_000_000, {"Mission::step": n * 1_000_000}) for n in range(1, 101)]
    rows = bench.rows_of("w", steps)
    assert rows[0]["value"] == pytest.approx(50.5) and rows[0]["must"] == "<= 15"
    assert rows[1]["value"] == pytest.approx(99.01) and rows[1]["must"] == "<= 40"


def test_names_lose_arguments_and_namespace():
    assert bench.plain("noctule::Guard::decide(noctule::Estimate const&, bool)") == "Guard::decide"
    assert bench.plain("noctule::(anonymous namespace)::up_to(int)") == "up_to"
    assert bench.plain("void noctule::take<noctule::Bounded<int, 3ul> >(int&)") == "take"
    assert bench.plain("__expf_fma") == "__expf_fma"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None or find_program("noctule-profile") is None, reason="no valgrind, or not built")
def test_a_count_is_the_same_twice(tmp_path):
    from noctule import inprocess_flight
    from noctule_sim.world import load_world

    settings = FlightSettings(world="maze_a", seed=5, camera=False, max_time_s=1.0, out=tmp_path)
    inprocess_flight.fly(settings, load_world("maze_a"), tmp_path)
    first, second = (bench.count(tmp_path / "flight.lcm", tmp_path / "parameters.toml", every=10, length=3) for _ in range(2))
    assert len(first) == 6
    assert [s.total for s in first] == pytest.approx([s.total for s in second], rel=1e-3)
    for step in first:
        assert step.total > 100_000
        assert {"Localiser::update", "OccupancyGrid::integrate"} <= set(step.stages)
        assert 0.8 * step.total < sum(step.stages.values()) <= step.total


def test_a_log_that_is_none_is_named(tmp_path):
    if shutil.which("valgrind") is None or find_program("noctule-profile") is None:
        pytest.skip("no valgrind, or not built")
    with pytest.raises(InputError, match="missing.lcm"):
        bench.count(tmp_path / "missing.lcm", None)
