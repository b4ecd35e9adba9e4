import math
from dataclasses import replace

import numpy as np
import pytest

from noctule_sim.sensors import PROFILES, Barometer, Imu, Laser, Magnetometer, RangeSensor

DEFAULT = PROFILES["default"]


def rng():
    return np.random.default_rng(11)


def test_laser_noise_steps_and_dropouts_have_the_profiles_size():
    laser = Laser(DEFAULT, rng())
    errors, lost = [], 0
    for _ in range(200):
        r = laser.measure(np.full(DEFAULT.beams, 4.0)).astype(float)
        lost += np.isnan(r).sum()
        errors.append(r[~np.isnan(r)] - 4.0)
    errors = np.concatenate(errors)
    assert errors.std() == pytest.approx(0.01, rel=0.02)
    assert abs(errors.mean()) < 2e-4
    assert lost / (200 * DEFAULT.beams) == pytest.approx(0.002, rel=0.15)
    assert np.abs(np.rint(errors * 1000) - errors * 1000).max() < 1e-3  # whole millimetres, up to float32


def test_laser_tells_no_return_from_a_dropout():
    laser = Laser(replace(DEFAULT, laser_dropouts=0.0), rng())
    true = np.full(DEFAULT.beams, np.inf)
    true[:10], true[10:20], true[20:30] = 0.03, 9.5, 10.5
    r = laser.measure(true)
    assert np.isnan(r[:10]).all() and np.isfinite(r[10:20]).all() and np.isinf(r[20:]).all()


def test_laser_geometry_is_the_profiles():
    laser = Laser(DEFAULT, rng())
    assert len(laser.bearings_rad) == 1080
    assert laser.bearings_rad[0] == pytest.approx(-laser.bearings_rad[-1])
    assert laser.increment_rad == pytest.approx(math.radians(0.25))
    assert laser.sweep_s == pytest.approx(0.0375, rel=2e-3)


def test_range_sensor_rounds_and_does_not_truncate():
    sensor = RangeSensor(replace(DEFAULT, range_sigma_m=0.0, range_dropouts=0.0), rng())
    assert sensor.measure(1.2349) == pytest.approx(1.23)
    assert sensor.measure(1.2351) == pytest.approx(1.24)
    assert math.isnan(sensor.measure(0.09)) and math.isnan(sensor.measure(12.5)) and math.isnan(sensor.measure(math.inf))


def test_range_noise_has_no_offset():
    sensor = RangeSensor(DEFAULT, rng())
    readings = np.array([sensor.measure(2.0037) for _ in range(20000)])
    good = readings[~np.isnan(readings)]
    assert good.std() == pytest.approx(math.hypot(0.02, 0.01 / math.sqrt(12)), rel=0.03)
    assert abs(good.mean() - 2.0037) < 6e-4
    assert 1 - len(good) / len(readings) == pytest.approx(0.01, rel=0.25)


def test_harsh_ranges_have_a_scale_error_of_the_seed():
    scales = [RangeSensor(PROFILES["harsh"], np.random.default_rng(s)).scale for s in range(50)]
    assert max(scales) <= 1.01 and min(scales) >= 0.99 and np.std(scales) > 0.003


def test_imu_noise_density_does_not_depend_on_the_interval():
    for span in (0.002, 0.004):
        imu = Imu(DEFAULT, rng())
        e = np.array(imu.errors(np.full(20000, span)))
        white = e.std(axis=0) * math.sqrt(span)
        assert white[:3] == pytest.approx([150e-6 * 9.80665] * 3, rel=0.03)
        assert white[3:] == pytest.approx([math.radians(0.007)] * 3, rel=0.03)
        assert np.abs(e.mean(axis=0)[:3]) == pytest.approx([0.05] * 3, rel=0.05)
        assert np.abs(e.mean(axis=0)[3:]) == pytest.approx([math.radians(0.1)] * 3, rel=0.05)


def test_ideal_is_exact():
    p = PROFILES["ideal"]
    assert np.abs(np.array(Imu(p, rng()).errors(np.full(5, 0.004)))).max() == 0.0
    assert RangeSensor(p, rng()).measure(1.23456) == 1.23456
    assert Laser(p, rng()).measure(np.full(p.beams, 1.23456)) == pytest.approx(np.float32(1.23456))


def test_the_magnetic_field_is_bent_indoors():
    sensor = Magnetometer(DEFAULT, rng())
    level = (1.0, 0.0, 0.0, 0.0)
    heading = [math.atan2(*sensor.measure((x, 0.5 * x, 1.0), level)[1::-1]) for x in np.linspace(0, 10, 60)]
    assert max(heading) - min(heading) > math.radians(5)


def test_the_barometer_is_white_noise_on_a_slow_drift_from_an_origin_of_the_seed():
    ends = []
    for seed in range(20):
        sensor = Barometer(DEFAULT, np.random.default_rng(seed))
        t = np.arange(0.0, 120.0, 0.05)
        h = np.array([sensor.measure(v, 1.0) for v in t])
        slow = h.reshape(-1, 20).mean(axis=1)
        assert np.std(np.diff(h)) == pytest.approx(math.sqrt(2) * 0.10, rel=0.06)
        assert 0.1 < np.ptp(slow) < 0.55
        assert np.abs(np.diff(slow)).max() < 0.15         # a second of drift, and the noise of 20 samples
        ends.append(h[0])
    assert np.std(ends) > 50.0
    still = Barometer(PROFILES["ideal"], rng())
    assert still.measure(50.0, 3.0) - still.measure(0.0, 1.0) == pytest.approx(2.0)
