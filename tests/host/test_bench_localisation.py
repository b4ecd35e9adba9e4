"""What `noctule bench localisation` measures with: motion, samples and figures of the scripted flights."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from noctule import bench, bench_localisation, planar_profile, planar_scenes
from noctule.planar_profile import Errors, Motion
from noctule_sim.sensors import PROFILES, STANDARD_GRAVITY_M_S2
from test_replay import built

needs_library = pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")
DURATION_S = {planar_scenes.rooms: 33.8, **{make: seconds for make, seconds, *_ in bench_localisation.HARDER}}


@pytest.mark.parametrize("make", DURATION_S, ids=lambda m: m.__name__)
def test_the_way_keeps_clear_and_its_derivatives_agree(make):
    from types import SimpleNamespace

    from noctule_sim.geometry import Geometry
    from noctule_sim.world import Material

    plan = make()
    motion = Motion(plan, DURATION_S[make])
    t = np.arange(0.0, motion.duration_s, 0.002)
    s = motion.at(t)
    speed = np.gradient(s["place"], 0.002, axis=0)
    inside = (t > planar_profile.REST_S + 0.1) & (t < motion.duration_s - 0.1)
    assert np.abs(np.gradient(speed, 0.002, axis=0) - s["accel"])[inside].max() < 0.02
    assert np.abs(np.gradient(s["yaw"], 0.002) - s["yaw_rate"])[inside].max() < 0.01
    assert np.hypot(*speed.T).max() < 1.1 and np.hypot(*s["accel"].T).max() < 1.0
    geometry = Geometry(SimpleNamespace(primitives=lambda: planar_profile.primitives(plan), materials={"wall": Material("wall")}))
    clear = [geometry.clearance(x, y, planar_profile.HEIGHT_M, 0.0, 0.1)[0] for x, y in s["place"][::50]]
    assert min(clear) > 0.3


def test_walls_stand_across_the_axes_of_map():
    motion = Motion(planar_scenes.rooms(), 10.0)
    assert math.degrees(float(motion.at(np.zeros(1))["yaw"][0])) == pytest.approx(-17.0)


def test_turning_is_at_the_rate_asked_for():
    s = Motion(planar_scenes.rooms(), 33.8, 1.0).at(np.arange(5.0, 33.0, 0.1))
    assert np.abs(s["yaw_rate"] - 1.0).max() < 0.05


def test_inertial_samples_belong_to_the_motion():
    """Without errors: what gyro and accelerometer measure, integrated in the plain, leads where the truth leads."""
    quiet = replace(PROFILES["ideal"], imu_stream_hz=250)
    motion = Motion(planar_scenes.rooms(), 12.0)
    flown = planar_profile.samples(planar_scenes.rooms(), motion, 1, quiet)
    s = motion.at(flown.imu_t_us * 1e-6 - 0.002)
    turn = planar_profile._rotations(s["roll"], s["pitch"], s["yaw"])
    accel = turn.apply(flown.imu[:, :3]) - (0.0, 0.0, STANDARD_GRAVITY_M_S2)
    np.testing.assert_allclose(accel[:, 2], 0.0, atol=0.08)            # the height is held
    place = np.cumsum(np.cumsum(accel[:, :2], axis=0) * 0.004, axis=0) * 0.004
    end = motion.at(np.array([12.0]))["place"][0] - motion.at(np.array([0.0]))["place"][0]
    assert place[-1] == pytest.approx(end, abs=0.03)
    yaw_rate = (np.sin(s["roll"]) * flown.imu[:, 4] + np.cos(s["roll"]) * flown.imu[:, 5]) / np.cos(s["pitch"])
    np.testing.assert_allclose(yaw_rate, s["yaw_rate"], atol=0.02)


def test_a_quiet_sweep_hits_the_walls_of_the_plan():
    plan, quiet = planar_scenes.rooms(), PROFILES["ideal"]
    motion = Motion(plan, 2.0)
    flown = planar_profile.samples(plan, motion, 1, quiet)
    yaw = motion.at(np.zeros(1))["yaw"][0]
    x, y = motion.at(np.zeros(1))["place"][0]
    bearings = flown.layout.bearing_first_rad + flown.layout.bearing_increment_rad * np.arange(flown.scans.shape[1])
    r = flown.scans[0]
    hit = np.isfinite(r)
    px, py = x + r[hit] * np.cos(yaw + bearings[hit]), y + r[hit] * np.sin(yaw + bearings[hit])
    gap = np.full(len(px), np.inf)
    for x0, y0, x1, y1 in plan.walls:
        a, b = np.array([x0, y0]) + planar_profile.SHIFT_M, np.array([x1, y1]) + planar_profile.SHIFT_M
        u = np.clip(((px - a[0]) * (b - a)[0] + (py - a[1]) * (b - a)[1]) / ((b - a) @ (b - a)), 0, 1)
        gap = np.minimum(gap, np.hypot(px - a[0] - u * (b - a)[0], py - a[1] - u * (b - a)[1]))
    for cx, cy, radius in plan.pillars:
        gap = np.minimum(gap, np.abs(np.hypot(px - cx - planar_profile.SHIFT_M[0], py - cy - planar_profile.SHIFT_M[1]) - radius))
    assert gap.max() < 0.08 and hit.mean() > 0.9


def test_seeds_differ_and_repeat():
    plan = planar_scenes.rooms()
    motion = Motion(plan, 2.0)
    a, b, c = (planar_profile.samples(plan, motion, seed, planar_profile.profile()) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.scans, b.scans)
    np.testing.assert_array_equal(a.imu, b.imu)
    assert not np.array_equal(a.scans, c.scans, equal_nan=True)
    slow = planar_profile.samples(plan, motion, 1, planar_profile.profile(0.01, 50))
    assert len(slow.imu_t_us) * 5 == len(a.imu_t_us)


def errors(position_m, lost=0):
    position_m = np.array(position_m)
    return Errors(position_m, position_m * 0.0 + math.radians(0.5), position_m * 0.0 + 3.0, position_m * 0.0, np.arange(len(position_m)) < lost, 0, {})


def test_rows_take_the_mean_and_the_worst_seed_and_judge():
    flights = [errors([0.005, 0.015]), errors([0.02, 0.04], lost=2)]
    rows = bench.judged(bench_localisation.position_rows("x", flights, None, "<= 2.1", "<= 2.9"))
    assert [r["value"] for r in rows] == pytest.approx([2.0, 3.0, 0.5, 2])
    assert [r["ok"] for r in rows] == [True, False, None, None]


def test_the_band_is_chi_squares():
    rows = bench.judged(bench_localisation.nees_rows([errors([0.01])] * 50))
    assert rows[0]["value"] == 3.0 and [r["ok"] for r in rows] == [True, True]
    assert [float(r["must"].split()[1]) for r in rows] == pytest.approx([3.716, 2.360], abs=2e-3)


@needs_library
def test_the_firmware_flies_at_the_vehicles_speed():
    plan = planar_scenes.rooms()
    motion = Motion(plan, bench_localisation.PAPER_S)
    (flights,) = bench_localisation.fly(plan, motion, range(1, 3), planar_profile.profile())
    for e in flights:
        assert 1e-5 < e.position_m.mean() < 0.01 and e.lost == 0 and e.counters["refused_samples"] == 0
        assert e.position_m[0] == 0.0 and 0.0 < e.nees.mean() < 10.0


@needs_library
def test_skew_is_measured():
    plan = planar_scenes.rooms()
    motion = Motion(plan, 12.0, 1.0)
    (plain,), (skewed,) = bench_localisation.fly(plan, motion, range(1, 2), planar_profile.profile(), {"deskew": 1}, {"deskew": 0})
    assert skewed.yaw_rad[100:].mean() > 3.0 * plain.yaw_rad[100:].mean()


@needs_library
def test_without_data_the_rows_are_left_out_and_a_part_is_measured_once(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NOCTULE_DATA", str(tmp_path / "none"))

    def carried(seeds):
        with (tmp_path / "measured").open("a") as f:
            f.write("x")
        return [bench.row("carried", float(seeds), "-")]

    for name in ("paper_rows", "slow_rows", "noise_rows", "skew_rows", "harder_rows"):
        monkeypatch.setattr(bench_localisation, name, lambda *_: [])
    monkeypatch.setattr(bench_localisation, "carried_rows", carried)
    rows = bench.run("localisation", quick=True)
    assert [r["name"] for r in rows] == ["carried", "memory of the filter, static", "memory of the map, static"]
    assert "synth10r: skipped: no data" in capsys.readouterr().out
    assert bench.run("localisation", quick=True) == rows and (tmp_path / "measured").read_text() == "x"
    bench.run("localisation", quick=True, fresh=True)
    assert (tmp_path / "measured").read_text() == "xx"
    monkeypatch.setattr(bench_localisation, "_fingerprint", lambda: "another build")
    bench.run("localisation", quick=True)
    assert (tmp_path / "measured").read_text() == "xxx"


def test_off_and_silent_is_told_from_off_and_said():
    e = errors([0.05, 0.2, 0.2, 0.2])
    e.nees[:] = (30.0, 30.0, 10.0, 30.0)
    e.lost_at[3] = True
    assert bench_localisation.untold(e).tolist() == [False, True, False, False]


def test_carried_back_the_way_is_flown_twice_and_the_clock_goes_on():
    plan = planar_scenes.rooms()
    flown = planar_profile.samples(plan, Motion(plan, 6.0), 1, PROFILES["ideal"])
    twice = planar_profile.carried_back(flown, 4.0, 2.5)
    for t_us in (twice.scan_t_us, twice.imu_t_us, twice.attitude_t_us):
        assert (np.diff(t_us) > 0).all()
    assert twice.scan_t_us[-1] == flown.scan_t_us[-1] + 2_500_000 and len(twice.scans) == len(twice.truth) == len(flown.scans) + 50
    k = int(np.searchsorted(twice.scan_t_us, 4_050_000))
    np.testing.assert_array_equal(twice.scans[k], flown.scans[int(np.searchsorted(flown.scan_t_us, 1_550_000))])
    assert np.hypot(*(twice.truth[k] - twice.truth[k - 1])[:2]) > 0.5


@needs_library
def test_a_part_can_be_kept():
    rows = bench_localisation.carried_rows(1)
    assert json.loads(json.dumps(rows)) == rows and [r["value"] for r in rows[:2]] == [0, 1]
