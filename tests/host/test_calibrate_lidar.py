"""`noctule calibrate lidar`: turns in place in a known room, with the laser mounted askew, noise, dropouts and a gyro that drifts."""

import math

import numpy as np
import pytest

from noctule import calibrate_lidar
from noctule.settings import InputError

BEAMS, RATE_HZ, SWEEP_S = 541, 20.0, 0.0375
BEARINGS_RAD = np.radians(np.linspace(-135.0, 135.0, BEAMS))
# A room that is no rectangle, with a box in it; metres, the vehicle's axis at the origin, the nose towards the wall at x = 2.5.
ROOM_M = [[(2.5, -2.0), (2.5, 1.6), (0.8, 3.1), (-2.8, 3.1), (-2.8, -1.2), (-1.1, -2.0)], [(-1.6, 1.0), (-1.6, 1.9), (-0.5, 1.9), (-0.5, 1.0)]]
SEGMENTS_M = np.array([(*ring[k], *ring[(k + 1) % len(ring)]) for ring in ROOM_M for k in range(len(ring))])


def cast(x, y, direction_rad):
    """Distance along each direction from each place to the nearest wall."""
    ux, uy = np.cos(direction_rad)[..., None], np.sin(direction_rad)[..., None]
    ax, ay, bx, by = SEGMENTS_M.T
    ex, ey = bx - ax, by - ay
    det = ux * -ey + uy * ex
    rx, ry = ax - x[..., None], ay - y[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):   # beams along a wall
        along = (rx * -ey + ry * ex) / det
        part = (ux * ry - uy * rx) / det
    return np.where((part >= 0.0) & (part <= 1.0) & (along > 0.0), along, np.inf).min(axis=-1)


def turn(seed, yaw_rad, x_m, y_m, tilt_rad=0.0, tilt_towards_rad=0.0, degrees=380.0, rate_rad_s=0.5, bias_rad_s=0.0005, noise_m=0.01):
    """A recorded turn. The laser looks along yaw, stands at x, y, and is tilted towards a direction of its own."""
    random = np.random.default_rng(seed)
    count = int(math.radians(degrees) / rate_rad_s * RATE_HZ)
    stamps = np.arange(count)[:, None] / RATE_HZ + (np.arange(BEAMS)[None, :] - (BEAMS - 1)) * SWEEP_S / (BEAMS - 1)
    stamps -= stamps[0, -1]
    heading = np.clip(stamps, 0.0, None) * rate_rad_s
    # A tilted plane: what lies across the direction of the tilt keeps its length, what lies along it is cast shorter on the floor.
    along, across = np.cos(BEARINGS_RAD - tilt_towards_rad) * math.cos(tilt_rad), np.sin(BEARINGS_RAD - tilt_towards_rad)
    flat = np.hypot(along, across)
    direction = heading + yaw_rad + tilt_towards_rad + np.arctan2(across, along)
    c, s = np.cos(heading), np.sin(heading)
    ranges = cast(c * x_m - s * y_m, s * x_m + c * y_m, direction) / flat
    ranges = np.round((ranges + noise_m * random.standard_normal(ranges.shape)) * 1000.0) / 1000.0
    ranges[random.random(ranges.shape) < 0.002] = np.nan
    return calibrate_lidar.Turn(BEARINGS_RAD, ranges, heading + bias_rad_s * stamps, stamps)


@pytest.mark.parametrize("seed, yaw_deg, x_m, y_m", [(1, 0.0, 0.0, 0.0), (2, 3.0, 0.12, -0.05), (3, -178.0, -0.2, 0.15), (4, 12.0, 0.05, 0.02)])
def test_finds_yaw_and_place(seed, yaw_deg, x_m, y_m):
    found = calibrate_lidar.calibrate(turn(seed, math.radians(yaw_deg), x_m, y_m), math.radians(round(yaw_deg / 30.0) * 30.0))
    assert abs(math.degrees(math.remainder(found.yaw_rad - math.radians(yaw_deg), 2.0 * math.pi))) < 0.15
    assert math.hypot(found.x_m - x_m, found.y_m - y_m) < 0.003
    assert found.tilt_rad < math.radians(1.2)


@pytest.mark.parametrize("seed, tilt_deg, towards_deg", [(1, 2.5, 0.0), (2, 4.0, 70.0), (3, 3.0, -40.0)])
def test_finds_a_tilt_up_to_its_sign(seed, tilt_deg, towards_deg):
    found = calibrate_lidar.calibrate(turn(seed, 0.0, 0.1, 0.0, math.radians(tilt_deg), math.radians(towards_deg)))
    assert found.tilt_rad > found.tilt_least_rad
    assert abs(math.degrees(found.tilt_rad) - tilt_deg) < 0.5
    assert abs(math.degrees(math.remainder(found.tilt_axis_rad - math.radians(towards_deg + 90.0), math.pi))) < 12.0
    assert math.hypot(found.x_m - 0.1, found.y_m) < 0.003
    assert "shim" in calibrate_lidar.text(found)


def test_ten_turns_stay_within_what_it_claims():
    errors = []
    for seed in range(10):
        found = calibrate_lidar.calibrate(turn(100 + seed, 0.05, 0.1, 0.03))
        errors.append([(found.yaw_rad - 0.05) / found.yaw_sigma_rad, (found.x_m - 0.1) / found.offset_sigma_m, (found.y_m - 0.03) / found.offset_sigma_m])
    assert 0.2 < np.mean(np.square(errors)) < 4.0


def test_says_what_is_missing():
    with pytest.raises(InputError, match="whole turn"):
        calibrate_lidar.calibrate(turn(1, 0.0, 0.0, 0.0, degrees=200.0))
    with pytest.raises(InputError, match="nose square"):
        calibrate_lidar.calibrate(turn(1, math.radians(35.0), 0.0, 0.0), math.radians(65.0))
