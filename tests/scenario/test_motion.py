"""Flights in the process: a narrow door, a fence before an open front door, a battery that runs down."""

import pytest

from noctule import bench_motion, inprocess, motion_worlds


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    try:
        inprocess.library_path()
    except inprocess.LibraryMissing as missing:
        pytest.fail(str(missing))
    monkeypatch.chdir(tmp_path)      # what the bench keeps goes there


@pytest.mark.flight
def test_a_door_of_0_80_m_at_17_degrees_is_passed_without_contact():
    result = bench_motion.fly(bench_motion.door_jobs(0.80, (17,), (0.4,))[0])
    assert bench_motion.passed(result), result["reason"]
    assert result["min_clearance_m"] >= 0.05
    floor = result["floors"][0]
    assert floor["walls_found_fraction"] >= 0.98 and floor["walls_true_fraction"] >= 0.97
    assert bench_motion.fly(bench_motion.door_jobs(0.80, (17,), (0.4,))[0]) == result      # kept, not flown again


@pytest.mark.flight
def test_a_vehicle_that_flies_past_its_setpoints_touches_nothing():
    job = bench_motion.door_jobs(0.80, (45,), (-0.8,))[0]       # before the guard looked at the vehicle's own motion: two contacts
    result = bench_motion.fly(bench_motion.Job("sluggish", job.world, faults=["sluggish@0"], axis_deg=job.axis_deg))
    assert bench_motion.passed(result), result["reason"]
    assert result["min_clearance_m"] >= 0.05
    assert result["parts"]["tracking_error_m"] > 0.03           # it is sluggish: else the flight shows nothing


@pytest.mark.flight
def test_an_open_front_door_ends_nothing():
    fence = motion_worlds.front_door_fence()
    inside = bench_motion.fly(bench_motion.Job("fence", motion_worlds.open_front_door(), parameters=fence, axis_deg=11.0))
    assert inside["outcome"] == "completed", inside["reason"]
    assert inside["far_x_m"] < 4.0            # the door is at 4.0 m; without the fence the yard beyond is explored


@pytest.mark.flight
def test_it_is_home_before_the_battery_is_empty():
    result = bench_motion.fly(bench_motion.Job("battery", "maze_a", faults=["battery-drain@0"]))
    assert result["outcome"] == "not_completed" and "battery" in result["reason"]
    assert result["landed"] and result["home_error_m"] < 0.5 and result["battery_end"] > 0.1
    assert result["floors"][0]["explored_fraction"] > 0.3     # it did not turn round at once
