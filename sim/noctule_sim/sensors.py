"""What each sensor makes of the truth: noise, bias, rounding, dropouts, blind zones. Profiles ideal, default and harsh.

One numpy Generator per sensor, children of the seed, so that switching one sensor off changes no other. Truth comes in,
measurements go out. Models: docs/maths/vehicle.md, section 6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

STANDARD_GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Profile:
    """Sensor figures of one quality. Fields are explained in docs/maths/vehicle.md; design.md fixes the values."""

    beams: int = 1080
    field_rad: float = math.radians(270.0)
    laser_min_m: float = 0.06
    laser_max_m: float = 10.0
    laser_sigma_m: float = 0.01
    laser_step_m: float = 0.001
    sweep_s: float = 0.0375
    laser_dropouts: float = 0.002
    range_min_m: float = 0.10
    range_max_m: float = 12.0
    range_sigma_m: float = 0.02
    range_step_m: float = 0.01
    range_dropouts: float = 0.01
    range_scale: float = 0.0              # greatest scale error of the up and down sensors, drawn per seed
    baro_sigma_m: float = 0.10
    baro_drift_m: float = 0.10            # amplitude of each of two slow waves: the ventilation of the building
    gyro_density: float = math.radians(0.007)                     # rad/s/sqrt(Hz)
    gyro_bias_rad_s: float = math.radians(0.1)
    accel_density: float = 150e-6 * STANDARD_GRAVITY_M_S2         # m/s^2/sqrt(Hz)
    accel_bias_m_s2: float = 0.05
    magnet_sigma_gauss: float = 0.002
    magnet_distortion_gauss: float = 0.08
    imu_stream_hz: int = 250              # what the autopilot sends on; it flies on 250 Hz itself
    answer_latency_s: float = 0.030       # 25 ms of the laser and 5 ms of the companion
    camera_latency_s: float = 0.040


PROFILES = {
    "default": Profile(),
    "ideal": Profile(
        laser_sigma_m=0.0, laser_step_m=0.0, sweep_s=0.0, laser_dropouts=0.0, range_sigma_m=0.0, range_step_m=0.0, range_dropouts=0.0,
        baro_sigma_m=0.0, baro_drift_m=0.0,
        gyro_density=0.0, gyro_bias_rad_s=0.0, accel_density=0.0, accel_bias_m_s2=0.0, magnet_sigma_gauss=0.0, magnet_distortion_gauss=0.0,
    ),
}
PROFILES["harsh"] = replace(
    PROFILES["default"], laser_sigma_m=0.03, laser_dropouts=0.01, range_dropouts=0.05, range_scale=0.01,
    gyro_bias_rad_s=math.radians(0.2), accel_bias_m_s2=0.10, imu_stream_hz=50,
)


class Laser:
    """The planar scanner. `bearings_rad` (B,), frame Lidar, in the order of time."""

    def __init__(self, profile: Profile, rng: np.random.Generator):
        self.profile = profile
        self._rng = rng
        self.increment_rad = profile.field_rad / profile.beams
        self.first_rad = -0.5 * self.increment_rad * (profile.beams - 1)
        self.bearings_rad = self.first_rad + self.increment_rad * np.arange(profile.beams)
        self.time_increment_s = profile.sweep_s / profile.beams

    @property
    def sweep_s(self) -> float:
        """Time from the first beam to the last [s]."""
        return self.time_increment_s * (self.profile.beams - 1)

    def measure(self, true_m: np.ndarray) -> np.ndarray:
        """(B,) float32 measured ranges [m]: infinity for no return within the greatest range, NaN for a dropout or a
        return from nearer than the least range. Overwrites true_m."""
        p = self.profile
        r = true_m
        near = r < p.laser_min_m
        if p.laser_sigma_m:
            r += p.laser_sigma_m * self._rng.standard_normal(r.shape[0])
        if p.laser_step_m:
            r /= p.laser_step_m
            np.rint(r, out=r)
            r *= p.laser_step_m
        r[r > p.laser_max_m] = math.inf
        np.maximum(r, p.laser_min_m, out=r)
        r[near] = math.nan
        if p.laser_dropouts:
            r[self._rng.random(r.shape[0]) < p.laser_dropouts] = math.nan
        return r.astype(np.float32)


class RangeSensor:
    """One beam along +z or -z of Body."""

    def __init__(self, profile: Profile, rng: np.random.Generator):
        self.profile = profile
        self._rng = rng
        self.scale = 1.0 + float(rng.uniform(-profile.range_scale, profile.range_scale))

    def measure(self, true_m: float) -> float:
        """Measured range [m], rounded to whole steps; NaN: dropout, or nothing within the sensor's limits."""
        p = self.profile
        noise, lot = float(self._rng.standard_normal()), float(self._rng.random())
        if lot < p.range_dropouts or not p.range_min_m <= true_m <= p.range_max_m:
            return math.nan
        r = true_m * self.scale + p.range_sigma_m * noise
        if p.range_step_m:
            r = math.floor(r / p.range_step_m + 0.5) * p.range_step_m
        return r if p.range_min_m - 1e-9 <= r <= p.range_max_m + 1e-9 else math.nan


class Barometer:
    """Height by air pressure: white noise, an origin of the day, and two slow waves whose period and phase are drawn per seed."""

    ORIGIN_M = 300.0                      # greatest distance of the origin from World's
    PERIOD_S = (40.0, 160.0)

    def __init__(self, profile: Profile, rng: np.random.Generator):
        self.profile = profile
        self._rng = rng
        self._origin_m = float(rng.uniform(-self.ORIGIN_M, self.ORIGIN_M))
        self._rate_rad_s = (2.0 * math.pi / rng.uniform(*self.PERIOD_S, 2)).tolist()
        self._phase_rad = rng.uniform(0.0, 2.0 * math.pi, 2).tolist()

    def measure(self, t_s: float, true_z_m: float) -> float:
        """Measured height [m] over the origin of the day."""
        p = self.profile
        drift = p.baro_drift_m * sum(math.sin(w * t_s + a) for w, a in zip(self._rate_rad_s, self._phase_rad))
        return true_z_m + self._origin_m + drift + p.baro_sigma_m * float(self._rng.standard_normal())


class Imu:
    """Accelerometer and gyroscope: white noise of a given density and on each axis a constant bias, its sign drawn per seed."""

    def __init__(self, profile: Profile, rng: np.random.Generator):
        self.profile = profile
        self._rng = rng
        sign = rng.choice((-1.0, 1.0), 6)
        self.bias = [float(b) for b in sign * ([profile.accel_bias_m_s2] * 3 + [profile.gyro_bias_rad_s] * 3)]
        self._density = np.array([profile.accel_density] * 3 + [profile.gyro_density] * 3)

    def errors(self, spans_s: np.ndarray) -> list[list[float]]:
        """(N, 6) errors of N samples, each the mean over its span: ax ay az [m/s^2] gx gy gz [rad/s], frame Body."""
        noise = self._rng.standard_normal((len(spans_s), 6)) * self._density / np.sqrt(spans_s)[:, None]
        return (noise + self.bias).tolist()


class Magnetometer:
    """The Earth's field bent by the building: two smooth waves in space whose place is drawn per seed."""

    FIELD_GAUSS = (0.21, 0.02, -0.43)

    def __init__(self, profile: Profile, rng: np.random.Generator):
        self.profile = profile
        self._rng = rng
        self._waves = rng.uniform(-1.5, 1.5, (2, 3)).tolist()
        self._phases = rng.uniform(0.0, 2.0 * math.pi, (2, 3)).tolist()

    def measure(self, position_m, q) -> tuple[float, float, float]:
        """Field [gauss], frame Body, at a position (3,) and attitude (4,) w x y z in World."""
        p = self.profile
        x, y, z = position_m
        field = list(self.FIELD_GAUSS)
        for wave, phases in zip(self._waves, self._phases):
            arm = wave[0] * x + wave[1] * y + wave[2] * z
            for k in range(3):
                field[k] += 0.5 * p.magnet_distortion_gauss * math.sin(arm + phases[k])
        w, i, j, k = q
        fx, fy, fz = field
        noise = self._rng.standard_normal(3).tolist()
        s = p.magnet_sigma_gauss
        return (
            (1 - 2 * (j * j + k * k)) * fx + 2 * (i * j + w * k) * fy + 2 * (i * k - w * j) * fz + s * noise[0],
            2 * (i * j - w * k) * fx + (1 - 2 * (i * i + k * k)) * fy + 2 * (j * k + w * i) * fz + s * noise[1],
            2 * (i * k + w * j) * fx + 2 * (j * k - w * i) * fy + (1 - 2 * (i * i + j * j)) * fz + s * noise[2],
        )
