"""Flights over a profile of floors, tables, stairs and ceilings, for measuring the altitude filter alone.

The vehicle moves in the x-z plane of Map along legs; its thrust points where the motion needs it, so accelerometer,
attitude and tilt of the ranges belong together. Sensors are those of noctule_sim (noise, bias, rounding, dropouts,
limits, scale error); a range is the nearest return within a cone, so that a table's edge is caught early.
Truth and samples are made here alone; the filter is the firmware's, loaded from libnoctule_sim_abi.so.
Frames Map and Body (forward-left-up), SI.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass

import numpy as np

from noctule_sim.sensors import PROFILES, STANDARD_GRAVITY_M_S2, Barometer, Imu, Profile, RangeSensor

REST_S = 3.0                 # on the ground before the first leg
CLEARANCE_M = 0.12           # Body origin over the floor on the landing gear
MOUNT_UP_M, MOUNT_DOWN_M = 0.05, -0.05
TICK_S = 0.05
IMU_SPAN_US = 4000           # an inertial sample is the mean over this long
BEAM_HALF_RAD = math.radians(1.0)
BEAM_RAYS = 3
ATTITUDE_OFFSET_RAD = 0.003  # of the autopilot's roll and pitch: a constant a flight and a slow wave
ATTITUDE_NOISE_RAD = 0.001
PLACE_OFFSET_M = 0.03        # of the planar estimate


@dataclass(frozen=True)
class Solid:
    """A box in the x-z plane [m], endless in y."""

    x0: float
    x1: float
    z0: float
    z1: float


@dataclass(frozen=True)
class Flight:
    """Solids, and legs (duration [s], x [m], z [m]) from (0, CLEARANCE_M) on.

    `grounds` and `ceilings` are the elevations to be found, `floors` those that are floors of the building.
    """

    name: str
    solids: tuple[Solid, ...]
    legs: tuple[tuple[float, float, float], ...]
    floors: tuple[float, ...] = (0.0,)
    grounds: tuple[float, ...] = (0.0,)
    ceilings: tuple[float, ...] = ()

    @property
    def duration_s(self) -> float:
        return REST_S + sum(leg[0] for leg in self.legs)


@dataclass(frozen=True)
class Trouble:
    """What is made worse than the profile says."""

    outliers: float = 0.0                             # share of ranges that are anything between the sensor's limits
    silent_s: tuple[tuple[float, float], ...] = ()    # both ranges say nothing between these times
    roll_rad: float = 0.0                             # amplitude of a roll with a period of 4 s


@dataclass
class Samples:
    """What the filter gets, and the truth at the scans."""

    imu_t_us: np.ndarray
    accel_m_s2: np.ndarray        # (N, 3)
    attitude_t_us: np.ndarray
    roll_pitch_rad: np.ndarray    # (M, 2)
    range_t_us: np.ndarray        # (K,) also the scans'
    down_m: np.ndarray
    up_m: np.ndarray
    planar: np.ndarray            # (K, 5)
    landed: np.ndarray
    limits_m: tuple[float, float]
    true_z_m: np.ndarray
    true_x_m: np.ndarray
    baro_m: np.ndarray            # (K,) with the ranges


def motion(flight: Flight, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place, velocity and acceleration at the times: (N, 2) each, columns x and z. A leg's speed is a raised cosine."""
    place = np.empty((len(t_s), 2))
    place[:] = (0.0, CLEARANCE_M)
    speed, accel = np.zeros_like(place), np.zeros_like(place)
    begin, at = REST_S, np.array([0.0, CLEARANCE_M])
    for duration, x, z in flight.legs:
        step = np.array([x, z]) - at
        u = np.clip((t_s - begin) / duration, 0.0, 1.0)[:, None]
        place += step * (u - np.sin(2 * math.pi * u) / (2 * math.pi))
        inside = ((t_s > begin) & (t_s <= begin + duration))[:, None]
        speed += np.where(inside, step * (1 - np.cos(2 * math.pi * u)) / duration, 0.0)
        accel += np.where(inside, step * (2 * math.pi * np.sin(2 * math.pi * u)) / duration**2, 0.0)
        begin, at = begin + duration, at + step
    return place, speed, accel


def attitude(accel: np.ndarray, t_s: np.ndarray, trouble: Trouble) -> tuple[np.ndarray, np.ndarray]:
    """True roll and pitch [rad] of a vehicle whose thrust makes that acceleration (N, 2)."""
    flying = 1.0 - np.exp(-np.maximum(t_s - REST_S, 0.0))
    roll = trouble.roll_rad * np.sin(2 * math.pi * t_s / 4.0) * flying
    return roll, np.arctan2(accel[:, 0], accel[:, 1] + STANDARD_GRAVITY_M_S2)


def cast(solids: tuple[Solid, ...], place: np.ndarray, roll: np.ndarray, pitch: np.ndarray, up: bool) -> np.ndarray:
    """Range along +z or -z of Body to the nearest solid within the cone, (N,) [m]; infinity: none."""
    mount, sign = (MOUNT_UP_M, 1.0) if up else (MOUNT_DOWN_M, -1.0)
    axis = np.stack([np.sin(pitch) * np.cos(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    origin = place + mount * axis
    best = np.full(len(place), math.inf)
    for lean in np.linspace(-BEAM_HALF_RAD, BEAM_HALF_RAD, BEAM_RAYS):
        ray = sign * np.stack([np.sin(pitch + lean) * np.cos(roll), np.cos(pitch + lean) * np.cos(roll)], axis=1)
        ray = np.where(np.abs(ray) < 1e-12, 1e-12, ray)
        for solid in solids:
            a = (np.array([solid.x0, solid.z0]) - origin) / ray
            b = (np.array([solid.x1, solid.z1]) - origin) / ray
            enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            best = np.where((enter <= leave) & (enter > 0.0), np.minimum(best, enter), best)
    return best


def samples(flight: Flight, seed: int, profile: Profile | str = "default", trouble: Trouble = Trouble()) -> Samples:
    """The samples of one flight. One generator a sensor, children of the seed."""
    p = PROFILES[profile] if isinstance(profile, str) else profile
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(7)]
    imu_step_us = 1_000_000 // p.imu_stream_hz
    imu_t_us = np.arange(imu_step_us, int(flight.duration_s * 1e6) + 1, imu_step_us, dtype=np.int64)
    middle_s = (imu_t_us - IMU_SPAN_US / 2) * 1e-6  # a slower stream leaves samples out, it does not average
    _, _, a = motion(flight, middle_s)
    roll, pitch = attitude(a, middle_s, trouble)
    lift = a[:, 1] + STANDARD_GRAVITY_M_S2
    forward, along = np.cos(pitch) * a[:, 0] - np.sin(pitch) * lift, np.sin(pitch) * a[:, 0] + np.cos(pitch) * lift
    force = np.stack([forward, np.sin(roll) * along, np.cos(roll) * along], axis=1)
    errors = np.array(Imu(p, rngs[0]).errors(np.full(len(imu_t_us), IMU_SPAN_US * 1e-6)))

    attitude_t_us = np.arange(20_000, int(flight.duration_s * 1e6) + 1, 20_000, dtype=np.int64)
    t_s = attitude_t_us * 1e-6
    _, _, a = motion(flight, t_s)
    offset = ATTITUDE_OFFSET_RAD * rngs[1].standard_normal(2)
    wave = ATTITUDE_OFFSET_RAD * np.sin(2 * math.pi * t_s[:, None] / 13.0 + rngs[1].uniform(0, 2 * math.pi, 2))
    noise = ATTITUDE_NOISE_RAD * rngs[1].standard_normal((len(t_s), 2))
    told = np.stack(attitude(a, t_s, trouble), axis=1) + (offset + wave + noise if p.gyro_density else 0.0)

    count = int(round(flight.duration_s / TICK_S))
    t_us = np.arange(1, count + 1, dtype=np.int64) * int(TICK_S * 1e6)
    t_s = t_us * 1e-6
    place, speed, a = motion(flight, t_s)
    roll, pitch = attitude(a, t_s, trouble)
    read = []
    for up, rng, echo in ((False, rngs[2], rngs[4]), (True, rngs[3], rngs[5])):
        sensor = RangeSensor(p, rng)
        r = np.array([sensor.measure(float(v)) for v in cast(flight.solids, place, roll, pitch, up)])
        wrong = echo.random(count) < trouble.outliers
        r = np.where(wrong, np.round(echo.uniform(p.range_min_m, p.range_max_m, count), 2), r)
        for begin, end in trouble.silent_s:
            r[(t_s >= begin) & (t_s < end)] = math.nan
        read.append(r)
    planar = np.zeros((count, 5))
    planar[:, 0] = place[:, 0] + PLACE_OFFSET_M * rngs[1].standard_normal()
    planar[:, 3] = speed[:, 0]
    barometer = Barometer(p, rngs[6])
    baro = np.array([barometer.measure(t, z) for t, z in zip(t_s.tolist(), place[:, 1].tolist())])
    landed = np.where(t_s <= REST_S, 1, 2).astype(np.int8)
    return Samples(imu_t_us, force + errors[:, :3], attitude_t_us, told, t_us, read[0], read[1], planar, landed,
                   (p.range_min_m, p.range_max_m), place[:, 1], place[:, 0], baro)


class _Input(ctypes.Structure):
    _fields_ = [("imu_count", ctypes.c_size_t), ("imu_t_us", ctypes.c_void_p), ("accel_m_s2", ctypes.c_void_p),
                ("attitude_count", ctypes.c_size_t), ("attitude_t_us", ctypes.c_void_p), ("roll_pitch_rad", ctypes.c_void_p),
                ("range_count", ctypes.c_size_t), ("range_t_us", ctypes.c_void_p), ("range_down_m", ctypes.c_void_p),
                ("range_up_m", ctypes.c_void_p), ("range_min_m", ctypes.c_float), ("range_max_m", ctypes.c_float),
                ("scan_count", ctypes.c_size_t), ("scan_t_us", ctypes.c_void_p), ("planar", ctypes.c_void_p),
                ("landed", ctypes.c_void_p), ("baro_m", ctypes.c_void_p)]


class Level(ctypes.Structure):
    """A level as the filter knows it."""

    _fields_ = [("z_m", ctypes.c_float), ("z_var_m2", ctypes.c_float), ("x_min_m", ctypes.c_float), ("y_min_m", ctypes.c_float),
                ("x_max_m", ctypes.c_float), ("y_max_m", ctypes.c_float), ("facing", ctypes.c_int32), ("floor", ctypes.c_int32),
                ("seen", ctypes.c_int32)]


@dataclass
class Answer:
    """What the filter said, one row a scan, and what it knows at the end."""

    z_m: np.ndarray
    z_var_m2: np.ndarray
    ground_m: np.ndarray
    ceiling_m: np.ndarray
    floor_m: np.ndarray
    valid: np.ndarray
    step_ns: np.ndarray
    levels: list[Level]
    surfaces: list[Level]
    counters: dict[str, int]


COUNTERS = ("matched", "founded", "unmatched", "refused_empty", "refused_input", "refused_range", "refused_tilt", "refused_time",
            "inertial_refused", "frames_refused", "levels_confirmed", "levels_forgotten", "levels_merged", "levels_evicted",
            "shifts", "drifts", "baro_used", "baro_refused", "baro_restarts")

_library = None


def library():
    """The firmware's shared library.

    Raises:
        LibraryMissing: it was not built.
    """
    global _library
    if _library is None:
        from noctule.inprocess import library_path

        loaded = ctypes.CDLL(str(library_path()))
        loaded.noctule_altitude_create.restype = ctypes.c_void_p
        loaded.noctule_altitude_destroy.argtypes = [ctypes.c_void_p]
        loaded.noctule_altitude_set_parameter.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_double]
        loaded.noctule_altitude_run.argtypes = [ctypes.c_void_p, ctypes.POINTER(_Input), ctypes.c_void_p, ctypes.c_void_p]
        for name in ("noctule_altitude_levels", "noctule_altitude_surfaces"):
            getattr(loaded, name).argtypes = [ctypes.c_void_p, ctypes.POINTER(Level), ctypes.c_size_t]
            getattr(loaded, name).restype = ctypes.c_size_t
        loaded.noctule_altitude_counters.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
        loaded.noctule_altitude_counters.restype = ctypes.c_size_t
        _library = loaded
    return _library


def estimate(s: Samples, parameters: dict[str, float] | None = None) -> Answer:
    """Runs the firmware's filter over the samples.

    Raises:
        ValueError: no such parameter, or a value out of its range.
    """
    lib = library()
    kept = []

    def pointer(values, kind):
        kept.append(np.ascontiguousarray(values, dtype=kind))
        return kept[-1].ctypes.data

    count = len(s.range_t_us)
    out, step_ns = np.zeros((count, 8), np.float32), np.zeros(count, np.int64)
    times = pointer(s.range_t_us, np.int64)
    data = _Input(len(s.imu_t_us), pointer(s.imu_t_us, np.int64), pointer(s.accel_m_s2, np.float32),
                  len(s.attitude_t_us), pointer(s.attitude_t_us, np.int64), pointer(s.roll_pitch_rad, np.float32),
                  count, times, pointer(s.down_m, np.float32), pointer(s.up_m, np.float32), *s.limits_m,
                  count, times, pointer(s.planar, np.float32), pointer(s.landed, np.int8),
                  pointer(s.baro_m, np.float32))
    handle = lib.noctule_altitude_create()
    try:
        for name, value in (parameters or {}).items():
            if lib.noctule_altitude_set_parameter(handle, name.encode(), float(value)) != 0:
                raise ValueError(f"parameter {name} = {value}")
        lib.noctule_altitude_run(handle, ctypes.byref(data), out.ctypes.data, step_ns.ctypes.data)
        found = []
        for ask in (lib.noctule_altitude_levels, lib.noctule_altitude_surfaces):
            table = (Level * 64)()
            found.append(list(table)[:ask(handle, table, 64)])
        counts = np.zeros(len(COUNTERS), np.uint32)
        lib.noctule_altitude_counters(handle, counts.ctypes.data, len(COUNTERS))
    finally:
        lib.noctule_altitude_destroy(handle)
    o = out.astype(float)
    return Answer(o[:, 0], o[:, 2], o[:, 4], o[:, 5], o[:, 6], o[:, 7] > 0.5, step_ns, found[0], found[1],
                  dict(zip(COUNTERS, counts.tolist())))


# ---- the flights

FLOOR = Solid(-500.0, 500.0, -0.3, 0.0)


def paper_flight() -> Flight:
    """The paper's: floor 0, a table of 0.55 m, an upper floor at 2.41 m, a ceiling at 4.66 m over all."""
    solids = (FLOOR, Solid(3.0, 5.4, 0.0, 0.55), Solid(8.6, 16.0, 2.21, 2.41), Solid(-500.0, 500.0, 4.66, 5.0))
    legs = ((3.0, 0.0, 1.0), (2.0, 0.0, 1.0), (12.0, 7.5, 1.0), (5.0, 7.5, 3.4), (8.0, 12.5, 3.4), (2.0, 12.5, 3.4), (8.0, 7.5, 3.4),
            (5.0, 7.5, 1.0), (12.0, 0.5, 1.0), (2.0, 0.5, 1.0))
    return Flight("paper", solids, legs, (0.0, 2.41), (0.0, 0.55, 2.41), (4.66,))


def flat_flight(length_m: float = 100.0) -> Flight:
    """Along a flat floor under a ceiling of 2.5 m."""
    hops, legs, x = int(length_m / 10.0), [(3.0, 0.0, 1.0)], 0.0
    for _ in range(hops):
        x += length_m / hops
        legs.append((length_m / hops / 0.6, x, 1.0))
    return Flight("flat", (FLOOR, Solid(-500.0, 500.0, 2.5, 2.8)), tuple(legs), (0.0,), (0.0,), (2.5,))


def hover_flight() -> Flight:
    """Up to 1.2 m under a ceiling of 2.5 m, then for 60 s slowly up and down by 0.4 m, to and fro over the same 2 m."""
    legs = ((3.0, 0.0, 1.2), (12.0, 2.0, 1.6), (12.0, 0.0, 1.2), (12.0, 2.0, 1.6), (12.0, 0.0, 1.2), (12.0, 2.0, 1.6))
    return Flight("hover", (FLOOR, Solid(-500.0, 500.0, 2.5, 2.8)), legs, (0.0,), (0.0,), (2.5,))


def table_flight(crossings: int = 20) -> Flight:
    """To and fro over a table of 0.72 m, 1.4 m long."""
    legs, x = [(3.0, 0.0, 1.3)], 0.0
    for _ in range(crossings):
        x = 3.4 - x
        legs.append((6.5, x, 1.3))
    return Flight("tables", (FLOOR, Solid(1.0, 2.4, 0.0, 0.72), Solid(-500.0, 500.0, 2.6, 2.9)), tuple(legs), (0.0,), (0.0, 0.72), (2.6,))


def stair_flight() -> Flight:
    """Up and down a staircase of 14 treads to a floor at 2.5 m, 1.0 m over the floor or 0.5 m over the tread, whichever is higher."""
    rise, run, steps, foot = 2.5, 3.7, 14, 2.0
    treads = tuple(Solid(foot + run / steps * k, foot + run, rise / steps * k, rise / steps * (k + 1)) for k in range(steps))
    solids = (FLOOR, *treads, Solid(foot + run, 30.0, 2.2, 2.5), Solid(-500.0, 500.0, 5.0, 5.3))
    way = [(0.0, 1.0), (foot, 1.0), (foot + 0.7, 1.0), (foot + run, 3.05), (foot + run + 1.5, 3.5), (foot + run + 4.0, 3.5)]
    legs = [(3.0, 0.0, 1.0)] + [(max(2.5 * math.hypot(b[0] - a[0], b[1] - a[1]), 1.0), *b) for a, b in zip(way, way[1:])]
    legs += [(max(2.5 * math.hypot(b[0] - a[0], b[1] - a[1]), 1.0), *b) for a, b in zip(way[::-1], way[-2::-1])]
    return Flight("stairs", solids, tuple(legs), (0.0, 2.5), (0.0, 2.5), (5.0,))


def many_levels_flight(treads: int = 70) -> Flight:
    """Along more surfaces than the filter holds, 0.15 m from one to the next, and 15 s of hovering at their end."""
    solids = (FLOOR, *(Solid(1.0 + 0.5 * k, 1.5 + 0.5 * k, 0.0, 0.15 * (k + 1)) for k in range(treads)))
    end, top = 1.0 + 0.5 * treads - 0.25, 0.15 * treads + 1.0
    return Flight("many levels", solids, ((3.0, 0.0, 1.0), (2.0 * end, end, top), (15.0, end, top)))
