"""Scripted flights through a plan, for measuring the localisation alone: no flight dynamics, no sockets.

The vehicle follows a smooth path at constant height; its thrust points where the motion needs it, so accelerometer, attitude
and tilt of the sweep belong together. Sensors are those of noctule_sim, each beam cast from the pose at its own time. The
plan's walls stand at 17 degrees to the map's axes and off its lattice. Truth and samples are made here alone; the
estimate is the firmware's (localise.py). Frames: plan (World), Map, Body; SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np

from noctule.altitude_profile import ATTITUDE_NOISE_RAD, ATTITUDE_OFFSET_RAD
from noctule.localise import Layout, Step, Tracker, between
from noctule.planar_scenes import Plan
from noctule_sim.geometry import Geometry
from noctule_sim.sensors import PROFILES, STANDARD_GRAVITY_M_S2, Imu, Laser, Profile
from noctule_sim.world import Material, Primitive

TURN_RAD = math.radians(17.0)      # walls against the axes of Map
SHIFT_M = (0.037, 0.061)           # of the plan against its own lattice
TICK_US = 50_000
IMU_SPAN_US = 4000                 # an inertial sample is the mean over this long
HEIGHT_M = 1.0
WALL_M = 0.10                      # thickness
MOUNT_Z_M = 0.08                   # of the laser, as the parameter lidar_z_m
REST_S = 1.0                       # at the start, before the path


def primitives(plan: Plan) -> list[Primitive]:
    """The plan's solids, frame World. No floor and no ceiling: the laser's own plane is measured."""
    solids = []
    for x0, y0, x1, y1 in plan.walls:
        length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
        centre = (0.5 * (x0 + x1) + SHIFT_M[0], 0.5 * (y0 + y1) + SHIFT_M[1], HEIGHT_M)
        solids.append(Primitive("box", centre, (0.5 * (length + WALL_M), 0.5 * WALL_M, 6.0), yaw, "wall", "wall"))
    for x, y, radius in plan.pillars:
        solids.append(Primitive("cylinder", (x + SHIFT_M[0], y + SHIFT_M[1], HEIGHT_M), (radius, radius, 6.0), 0.0, "wall", "pillar"))
    return solids


class Motion:
    """Truth: place, heading and their derivatives at any time.

    Args:
        plan: where to fly.
        duration_s: REST_S and the path, at a speed that follows from it.
        turn_rad_s: yaw rate on top of the path's heading, after the rest; None: the nose follows the path.
    """

    def __init__(self, plan: Plan, duration_s: float, turn_rad_s: float | None = None):
        from scipy.interpolate import CubicSpline, PchipInterpolator

        points = np.array(plan.way) + SHIFT_M
        self.duration_s = duration_s
        self._span_s = duration_s - REST_S
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        self._way = CubicSpline(lengths, points)
        fine = np.linspace(0.0, lengths[-1], max(400, int(2.0 * lengths[-1])))
        slope = self._way(fine, 1)
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self._way(fine), axis=0).T))])
        self.path_m = float(arc[-1])
        self._parameter = PchipInterpolator(arc, fine)
        heading = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
        # Splined over time with few knots, so that its rate is smooth.
        knots = np.linspace(0.0, self._span_s, 4 * len(points))
        course = np.interp(self._arc(knots), arc, heading)
        yaw = course if turn_rad_s is None else course[0] + turn_rad_s * np.maximum(knots - 1.0, 0.0)
        self._yaw = CubicSpline(knots, yaw - yaw[0] - TURN_RAD, bc_type="clamped" if turn_rad_s is None else "natural")
        # Place over time as a spline, too: acceleration is then continuous and is the true one of what is cast.
        dense = np.linspace(0.0, self._span_s, max(int(self._span_s / 0.4), 8))
        self._place = CubicSpline(dense, self._way(self._parameter(self._arc(dense))), bc_type="clamped")

    def _arc(self, t_s):
        """Path length at a time [m]: speeds up and slows down over 2 s (raised cosine), even speed between."""
        ramp = min(2.0, 0.25 * self._span_s)
        speed = self.path_m / (self._span_s - ramp)

        def begun(t):
            t = np.clip(t, 0.0, ramp)
            return 0.5 * speed * (t - ramp / math.pi * np.sin(math.pi * t / ramp))

        rest = np.asarray(self._span_s - t_s)
        middle = speed * np.clip(np.asarray(t_s) - ramp, 0.0, self._span_s - 2 * ramp)
        return np.clip(begun(t_s) + middle + begun(ramp) - begun(rest), 0.0, self.path_m)

    def at(self, t_s: np.ndarray) -> dict[str, np.ndarray]:
        """place (N, 2), accel (N, 2) in World; yaw, yaw_rate, roll, pitch (N,)."""
        u = np.clip(np.asarray(t_s) - REST_S, 0.0, self._span_s)
        moves = (np.asarray(t_s) > REST_S) & (np.asarray(t_s) < self.duration_s)
        accel = np.where(moves[:, None], self._place(u, 2), 0.0)
        yaw, rate = self._yaw(u), np.where(moves, self._yaw(u, 1), 0.0)
        c, s = np.cos(yaw), np.sin(yaw)
        forward, left = c * accel[:, 0] + s * accel[:, 1], c * accel[:, 1] - s * accel[:, 0]
        # Thrust along Body z makes the acceleration and holds the height (Z-Y-X, forward-left-up).
        pitch = np.arctan2(forward, STANDARD_GRAVITY_M_S2)
        roll = np.arctan2(-left, np.hypot(forward, STANDARD_GRAVITY_M_S2))
        return {"place": self._place(u), "accel": accel, "yaw": yaw, "yaw_rate": rate, "roll": roll, "pitch": pitch}


def _rotations(roll, pitch, yaw) -> np.ndarray:
    """(N, 3, 3), Body to World, Z-Y-X."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))


@dataclass
class Flown:
    """Truth and sweeps of one flight over one seed. Times [us], rising."""

    scan_t_us: np.ndarray
    scans: np.ndarray             # (K, B) float32
    layout: Layout
    imu_t_us: np.ndarray
    imu: np.ndarray               # (N, 6)
    attitude_t_us: np.ndarray
    roll_pitch: np.ndarray        # (M, 2)
    truth: np.ndarray             # (K, 3): x, y, yaw in Map


def profile(laser_sigma_m: float = 0.01, imu_hz: int = 250) -> Profile:
    """The default sensors with that laser noise and inertial rate."""
    return replace(PROFILES["default"], laser_sigma_m=laser_sigma_m, imu_stream_hz=imu_hz)


def samples(plan: Plan, motion: Motion, seed: int, sensors: Profile) -> Flown:
    """The samples of one flight. One generator a sensor, children of the seed."""
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    geometry = Geometry(SimpleNamespace(primitives=lambda: primitives(plan), materials={"wall": Material("wall")}))
    laser = Laser(sensors, rngs[0])
    end_us = int(round(motion.duration_s * 1e6)) // TICK_US * TICK_US
    offset = ATTITUDE_OFFSET_RAD * rngs[2].standard_normal(2)
    phase = rngs[2].uniform(0.0, 2.0 * math.pi, 2)

    # Truth every 2 ms, for the sweeps.
    fine_s = np.arange(-0.05, end_us * 1e-6 + 1e-9, 0.002)
    state = motion.at(fine_s)
    quaternion = _rotations(state["roll"], state["pitch"], state["yaw"]).as_quat()[:, [3, 0, 1, 2]]
    rows = np.column_stack([fine_s, state["place"], np.full(len(fine_s), HEIGHT_M), quaternion])
    scan_t_us = np.arange(TICK_US, end_us + 1, TICK_US, dtype=np.int64)
    scans = np.empty((len(scan_t_us), sensors.beams), np.float32)
    mount, out = np.array([0.0, 0.0, MOUNT_Z_M, 0.0]), np.empty(sensors.beams)
    for k, t_us in enumerate(scan_t_us):
        last = int(round((t_us * 1e-6 + 0.05) / 0.002))
        out[0] = rows[last, 0] - laser.sweep_s
        geometry.sweep(rows[last - 20:last + 1], mount, laser.bearings_rad, sensors.laser_max_m, out)
        scans[k] = laser.measure(out)

    imu_step_us = 1_000_000 // sensors.imu_stream_hz
    imu_t_us = np.arange(imu_step_us, end_us + 1, imu_step_us, dtype=np.int64)
    s = motion.at((imu_t_us - IMU_SPAN_US / 2) * 1e-6)
    half = 1e-3
    before, after = (motion.at((imu_t_us - IMU_SPAN_US / 2) * 1e-6 + d) for d in (-half, half))
    turn = _rotations(before["roll"], before["pitch"], before["yaw"]).inv() * _rotations(after["roll"], after["pitch"], after["yaw"])
    force_world = np.column_stack([s["accel"], np.full(len(imu_t_us), STANDARD_GRAVITY_M_S2)])
    force = _rotations(s["roll"], s["pitch"], s["yaw"]).inv().apply(force_world)
    errors = np.array(Imu(sensors, rngs[1]).errors(np.full(len(imu_t_us), IMU_SPAN_US * 1e-6)))
    imu = np.column_stack([force, turn.as_rotvec() / (2.0 * half)]) + errors

    attitude_t_us = np.arange(20_000, end_us + 1, 20_000, dtype=np.int64)
    t_s = attitude_t_us * 1e-6
    s = motion.at(t_s)
    wave = ATTITUDE_OFFSET_RAD * np.sin(2.0 * math.pi * t_s[:, None] / 13.0 + phase)
    told = np.column_stack([s["roll"], s["pitch"]]) + offset + wave + ATTITUDE_NOISE_RAD * rngs[2].standard_normal((len(t_s), 2))

    s = motion.at(scan_t_us * 1e-6)
    poses = np.column_stack([s["place"], s["yaw"]])
    truth = np.array([between(poses[0], p) for p in poses])
    layout = Layout(float(laser.first_rad), float(laser.increment_rad), sensors.laser_min_m, sensors.laser_max_m,
                    laser.time_increment_s * 1e6)
    return Flown(scan_t_us, scans, layout, imu_t_us, imu, attitude_t_us, told, truth)


def carried_back(flown: Flown, at_s: float, back_s: float) -> Flown:
    """The flight up to at_s, and then once more from back_s before: as if the vehicle had been carried there in no time, unseen.

    Sample times go on; at_s and back_s are whole sweeps.
    """
    at_us, back_us = int(round(at_s * 1e6)), int(round(back_s * 1e6))

    def glue(t_us, *values):
        before, after = t_us <= at_us, t_us > at_us - back_us
        return [np.concatenate([t_us[before], t_us[after] + back_us]), *(np.concatenate([v[before], v[after]]) for v in values)]

    scan_t_us, scans, truth = glue(flown.scan_t_us, flown.scans, flown.truth)
    imu_t_us, imu = glue(flown.imu_t_us, flown.imu)
    attitude_t_us, roll_pitch = glue(flown.attitude_t_us, flown.roll_pitch)
    return Flown(scan_t_us, scans, flown.layout, imu_t_us, imu, attitude_t_us, roll_pitch, truth)


@dataclass
class Errors:
    """One flight's errors at every sweep."""

    position_m: np.ndarray
    yaw_rad: np.ndarray
    nees: np.ndarray              # error squared over the published covariance, 3 degrees of freedom
    localise_us: np.ndarray
    lost_at: np.ndarray           # (K,) bool: quality -1
    resets: int
    counters: dict[str, int]
    poses: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))   # (K, 3): x, y, yaw in Map, as estimated

    @property
    def lost(self) -> int:
        """Steps with quality -1."""
        return int(self.lost_at.sum())


def localise(flown: Flown, parameters: dict[str, float] | None = None) -> Errors:
    """Runs the firmware over a flight and compares with the truth in Map; nothing is fitted.

    Raises:
        LibraryMissing: the firmware's shared library was not built.
    """
    imu_end = np.searchsorted(flown.imu_t_us, flown.scan_t_us, side="right")
    attitude_end = np.searchsorted(flown.attitude_t_us, flown.scan_t_us, side="right")
    steps: list[Step] = []
    with Tracker(parameters, mapping=False) as tracker:
        i = j = 0
        for k, t_us in enumerate(flown.scan_t_us):
            i1, j1 = int(imu_end[k]), int(attitude_end[k])
            steps.append(tracker.step(int(t_us), flown.scans[k], flown.layout, imu=(flown.imu_t_us[i:i1], flown.imu[i:i1]),
                                      attitude=(flown.attitude_t_us[j:j1], flown.roll_pitch[j:j1])))
            i, j = i1, j1
        counters = tracker.counters()
    poses = np.array([s.pose for s in steps])
    error = poses - flown.truth
    error[:, 2] = np.remainder(error[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    upper = np.array([s.covariance for s in steps], float)
    p = np.empty((len(steps), 3, 3))
    for n, (a, b) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        p[:, a, b] = p[:, b, a] = upper[:, n]
    nees = np.einsum("ki,ki->k", error, np.linalg.solve(p, error[:, :, None])[:, :, 0])
    return Errors(np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]), nees, np.array([s.localise_ns for s in steps]) * 1e-3,
                  np.array([s.quality < 0 for s in steps]), steps[-1].reset_counter, counters, poses)
