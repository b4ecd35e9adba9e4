"""What `noctule bench altitude` measures with: the profile's samples, its figures, and the height loop's judgement."""

import math
from dataclasses import replace

import numpy as np
import pytest

from noctule import altitude_profile as profile
from noctule import bench, bench_altitude, height_loop
from noctule.altitude_profile import FLOOR, Flight, Level, Solid, Trouble
from noctule_sim.sensors import PROFILES, STANDARD_GRAVITY_M_S2


def built() -> bool:
    try:
        profile.library()
    except Exception:
        return False
    return True


needs_library = pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")


def test_motion_is_consistent_and_ends_where_the_legs_end():
    flight = profile.paper_flight()
    t = np.arange(0.0, flight.duration_s, 0.001)
    place, speed, accel = profile.motion(flight, t)
    assert np.abs(np.gradient(place, 0.001, axis=0) - speed)[5:-5].max() < 1e-3
    assert np.abs(np.gradient(speed, 0.001, axis=0) - accel)[5:-5].max() < 6e-3
    assert place[0] == pytest.approx([0.0, 0.12]) and place[-1] == pytest.approx([0.5, 1.0], abs=1e-6)


def test_a_level_vehicle_measures_heights_and_a_leaning_one_slants():
    solids = (FLOOR, Solid(-9.0, 9.0, 3.0, 3.2))
    place, flat = np.array([[0.0, 1.0]]), np.zeros(1)
    assert profile.cast(solids, place, flat, flat, False) == pytest.approx([0.95], abs=1e-3)
    assert profile.cast(solids, place, flat, flat, True) == pytest.approx([1.95], abs=1e-3)
    roll = np.array([0.3])
    # The mount leans with the vehicle: from 1 - 0.05 cos(0.3) down along the slant.
    assert profile.cast(solids, place, roll, flat, False) == pytest.approx([1.0 / math.cos(0.3) - 0.05], abs=1e-3)


def test_the_cone_catches_an_edge_before_the_axis_does():
    solids = (FLOOR, Solid(1.0, 2.0, 0.0, 0.5))
    x = np.linspace(0.9, 1.1, 201)
    r = profile.cast(solids, np.stack([x, np.full_like(x, 1.0)], axis=1), np.zeros_like(x), np.zeros_like(x), False)
    edge = x[np.argmax(r < 0.7)]
    assert 1.0 - 0.95 * math.tan(profile.BEAM_HALF_RAD) - 0.002 <= edge < 1.0


def test_inertial_samples_are_the_specific_force_of_the_motion():
    quiet = replace(PROFILES["ideal"], imu_stream_hz=250)
    flight = Flight("hop", (FLOOR,), ((4.0, 2.0, 1.5),))
    s = profile.samples(flight, 1, quiet, Trouble(roll_rad=0.2))
    roll, pitch = s.roll_pitch_rad[:, 0], s.roll_pitch_rad[:, 1]
    t = s.imu_t_us * 1e-6
    roll, pitch = np.interp(t, s.attitude_t_us * 1e-6, roll), np.interp(t, s.attitude_t_us * 1e-6, pitch)
    up = (-np.sin(pitch) * s.accel_m_s2[:, 0] + np.sin(roll) * np.cos(pitch) * s.accel_m_s2[:, 1]
          + np.cos(roll) * np.cos(pitch) * s.accel_m_s2[:, 2]) - STANDARD_GRAVITY_M_S2
    climb = np.cumsum(up) * 0.004
    assert np.cumsum(climb)[-1] * 0.004 == pytest.approx(1.5 - profile.CLEARANCE_M, abs=0.01)


def test_troubles_do_what_they_say_and_leave_the_rest_alone():
    flight = profile.flat_flight(20.0)
    plain = profile.samples(flight, 4)
    silent = profile.samples(flight, 4, trouble=Trouble(silent_s=((8.0, 10.0),)))
    off = (silent.range_t_us >= 8_000_000) & (silent.range_t_us < 10_000_000)
    assert np.isnan(silent.down_m[off]).all() and np.isnan(silent.up_m[off]).all()
    np.testing.assert_array_equal(plain.down_m[~off], silent.down_m[~off])
    echoes = profile.samples(flight, 4, trouble=Trouble(outliers=0.05))
    changed = (echoes.down_m != plain.down_m) & ~np.isnan(plain.down_m)
    assert 0.02 < changed.mean() < 0.09
    np.testing.assert_array_equal(plain.accel_m_s2, echoes.accel_m_s2)


def test_ranges_have_the_profiles_noise_steps_and_dropouts():
    s = profile.samples(profile.flat_flight(60.0), 5)
    air = s.range_t_us > 8_000_000
    error = s.down_m[air] - (s.true_z_m[air] + profile.MOUNT_DOWN_M)
    good = ~np.isnan(error)
    assert np.nanstd(error) == pytest.approx(math.hypot(0.02, 0.01 / math.sqrt(12)), rel=0.1)
    assert 1.0 - good.mean() == pytest.approx(0.01, abs=0.008)
    assert np.allclose(s.down_m[air][good] * 100, np.round(s.down_m[air][good] * 100), atol=1e-6)


def test_band_is_chi_squares():
    low, high = bench_altitude.band(40)
    assert (low, high) == pytest.approx((0.611, 1.484), abs=2e-3)
    rows = bench.judged(bench_altitude.nees_rows("x", np.full(40, 0.5)))
    assert [r["ok"] for r in rows] == [True, False]
    assert [r["ok"] for r in bench.judged(bench_altitude.nees_rows("x", np.full(40, 2.0)))] == [False, True]


def test_a_false_a_missing_and_a_doubled_floor_are_wrong():
    def answer(surfaces, levels=()):
        make = lambda z, floor: Level(z_m=z, facing=1, floor=floor)
        return type("A", (), {"surfaces": [make(z, 1) for z in surfaces], "levels": [make(z, f) for z, f in levels]})()

    flight = profile.paper_flight()
    assert bench_altitude.floors_right(flight, answer([0.0, 2.42]))
    assert bench_altitude.floors_right(flight, answer([], [(0.0, 1), (0.55, 0)]))     # the paper's form
    assert not bench_altitude.floors_right(flight, answer([0.0, 0.55]))
    assert not bench_altitude.floors_right(flight, answer([0.0]))
    assert not bench_altitude.floors_right(flight, answer([0.0, 2.41, 2.43]))
    assert not bench_altitude.floors_right(flight, answer([0.0, 2.41], [(0.55, 1)]))


@needs_library
def test_the_firmwares_filter_flies_the_papers_flight():
    batch = bench_altitude.fly(profile.paper_flight(), 2)
    assert 1e-4 < batch.mean_m.mean() < 0.01 and batch.false_floors == 0 and batch.lost == 0
    assert set(batch.levels_m) == {0.0, 0.55, 2.41, 4.66}
    assert all(errors.max() < 0.02 for errors in batch.levels_m.values())
    worse = bench_altitude.fly(profile.paper_flight(), 2, parameters={"alt_joint": 0})
    assert worse.mean_m.mean() > 1.5 * batch.mean_m.mean()


@needs_library
def test_unknown_parameters_are_refused():
    s = profile.samples(profile.flat_flight(10.0), 1)
    with pytest.raises(ValueError, match="no_such"):
        profile.estimate(s, {"no_such": 1.0})


@needs_library
def test_equal_samples_give_equal_answers():
    s = profile.samples(profile.table_flight(2), 3)
    a, b = profile.estimate(s), profile.estimate(s)
    np.testing.assert_array_equal(a.z_m, b.z_m)
    assert a.counters == b.counters and a.counters["matched"] > 300


def log_of(z, below, dt=0.05):
    n = len(z)
    zero = np.zeros(n)
    return height_loop.Log(np.arange(n) * dt, zero, zero, np.array(z), np.array(z), zero + 1, zero, np.array(below), True, 0, 0)


def test_height_over_stairs_is_the_higher_of_the_two_rules():
    below = np.array([0.0, 0.36, 0.54, 2.0])
    np.testing.assert_allclose(height_loop.wanted_m(below, below > 0.05), [1.0, 1.0, 1.04, 2.5])
    np.testing.assert_allclose(height_loop.wanted_m(below, below > 9.0), 1.0)


def test_a_step_at_an_edge_is_seen_and_a_tread_is_judged_at_its_end():
    edge = log_of([1.0] * 60 + [1.1] * 60, [0.0] * 60 + [0.55] * 60)
    assert height_loop.edge_steps_m(edge) == pytest.approx([0.1])
    # One tread of 0.6 m: the vehicle comes to 1.12 m, 2 cm too high, after a slow climb that is not judged.
    tread = log_of([1.0] * 40 + list(np.linspace(1.0, 1.12, 40)) + [1.12] * 40 + [1.2] * 20, [0.0] * 40 + [0.6] * 80 + [0.78] * 20)
    assert height_loop.tread_errors_m(tread) == pytest.approx([0.02])


def test_walker_passes_its_waypoints_and_stands_at_the_last():
    walker = height_loop._Walker(0.0, 0.0, ((2.0, 0.0, 0.5), (2.0, 1.0, 0.3)))
    path = []
    while not walker.done:
        path.append(walker.step(0.05))
        assert len(path) < 400
    path = np.array(path)
    assert np.hypot(path[:, 2], path[:, 3]).max() <= 0.5 + 1e-9
    assert np.hypot(path[:, 0] - 2.0, path[:, 1]).min() < 1e-6
    assert walker.step(0.05) == (2.0, 1.0, 0.0, 0.0)


def test_surface_below_is_the_highest_under_the_point():
    from noctule_sim.world import load_world

    primitives = load_world("levels").primitives()
    assert height_loop.surface_below(primitives, 5.1, 3.6, 1.0) == pytest.approx(0.55)
    assert height_loop.surface_below(primitives, 3.0, 1.0, 1.0) == pytest.approx(0.0)
    assert height_loop.surface_below(primitives, 10.0, 4.0, 3.4) == pytest.approx(2.41)
    assert height_loop.surface_below(primitives, 10.0, 4.0, 1.0) == pytest.approx(0.0)


def test_the_barometer_follows_the_height_and_leaves_the_other_samples_alone():
    s = profile.samples(profile.hover_flight(), 3)
    offset = s.baro_m - s.true_z_m
    assert 0.09 < np.std(np.diff(offset)) / math.sqrt(2) < 0.11
    assert np.ptp(offset.reshape(-1, 20).mean(axis=1)) < 0.55
    quiet = profile.samples(profile.hover_flight(), 3, replace(PROFILES["default"], baro_sigma_m=0.0))
    np.testing.assert_array_equal(s.down_m, quiet.down_m)
    np.testing.assert_array_equal(s.accel_m_s2, quiet.accel_m_s2)


@needs_library
def test_without_its_parameter_the_barometer_is_not_there_and_with_it_silence_is_survived():
    s = profile.samples(profile.hover_flight(), 3, "harsh", bench_altitude.LONG_SILENCE)
    off = profile.estimate(s)
    np.testing.assert_array_equal(off.z_m, profile.estimate(replace(s, baro_m=s.baro_m + 50.0)).z_m)
    assert off.counters["baro_used"] == 0 and not off.valid.all()
    on = profile.estimate(s, bench_altitude.BAROMETER)
    assert on.counters["baro_used"] > 1200 and on.valid.all()
    assert np.abs(on.z_m - s.true_z_m).max() < 0.5


def test_the_bench_compares_silence_with_and_without_it(monkeypatch):
    asked = []
    batch = bench_altitude.Batch(*np.full((7, 2), 0.1), 0, 0, {}, np.zeros(1), np.zeros(1), 1)
    monkeypatch.setattr(bench_altitude, "fly", lambda *a: asked.append(a[2:]) or batch)
    rows = bench_altitude.silence_rows(2)
    assert [a[2] for a in asked] == [None, bench_altitude.BAROMETER] * 2 and [a[0] for a in asked] == ["default"] * 2 + ["harsh"] * 2
    assert len(rows) == 16 and all(a[1].silent_s == ((20.0, 50.0),) for a in asked)
