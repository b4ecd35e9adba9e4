"""The firmware's Localiser and OccupancyGrid in this process: sweeps in, poses and a map out.

Motion between two sweeps is wheel odometry (an increment with its covariance) or inertial samples. Loaded from
libnoctule_sim_abi.so (firmware/app/replay_abi.cpp). Frames Map, Body, Lidar; SI.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass

import numpy as np

COUNTERS = ("refused_samples", "refused_beams", "coasted", "blind_scans", "lost", "landmarks_evicted", "cells_evicted",
            "scans_not_mapped", "tiles_refused", "carried", "recognised")
TILE_CELLS = 64


class _Sweep(ctypes.Structure):
    _fields_ = [("t_us", ctypes.c_int64), ("count", ctypes.c_int32), ("time_increment_us", ctypes.c_float),
                ("bearing_first_rad", ctypes.c_float), ("bearing_increment_rad", ctypes.c_float),
                ("range_min_m", ctypes.c_float), ("range_max_m", ctypes.c_float), ("range_m", ctypes.c_void_p),
                ("has_motion", ctypes.c_int32), ("motion", ctypes.c_float * 4), ("motion_covariance", ctypes.c_float * 6),
                ("imu_count", ctypes.c_size_t), ("imu_t_us", ctypes.c_void_p), ("imu", ctypes.c_void_p),
                ("attitude_count", ctypes.c_size_t), ("attitude_t_us", ctypes.c_void_p), ("roll_pitch_rad", ctypes.c_void_p)]


class _Pose(ctypes.Structure):
    _fields_ = [("x_m", ctypes.c_double), ("y_m", ctypes.c_double), ("yaw_rad", ctypes.c_double),
                ("covariance", ctypes.c_float * 6), ("quality", ctypes.c_int32), ("reset_counter", ctypes.c_int32),
                ("walls_seen", ctypes.c_int32), ("walls_matched", ctypes.c_int32), ("landmarks", ctypes.c_int32),
                ("effective_particles", ctypes.c_float), ("localise_ns", ctypes.c_int64), ("map_ns", ctypes.c_int64)]


class _Tile(ctypes.Structure):
    _fields_ = [("tile_x", ctypes.c_int32), ("tile_y", ctypes.c_int32), ("log_odds", ctypes.c_int8 * TILE_CELLS**2)]


@dataclass(frozen=True)
class Layout:
    """What is the same for every sweep of one laser."""

    bearing_first_rad: float
    bearing_increment_rad: float
    range_min_m: float
    range_max_m: float
    time_increment_us: float = 0.0


@dataclass(frozen=True)
class Step:
    """What one step said. pose: x [m], y [m], yaw [rad] in Map; covariance: upper triangle (6,); times of this thread [ns]."""

    pose: tuple[float, float, float]
    covariance: tuple[float, ...]
    quality: int
    reset_counter: int
    walls_seen: int
    walls_matched: int
    landmarks: int
    localise_ns: int
    map_ns: int


_library = None


def library():
    """The firmware's shared library.

    Raises:
        LibraryMissing: it was not built, or is older than this code.
    """
    global _library
    if _library is None:
        from noctule.inprocess import LibraryMissing, library_path

        loaded = ctypes.CDLL(str(library_path()))
        if not hasattr(loaded, "noctule_replay_create"):
            raise LibraryMissing(f"{library_path()} is older than this program: run `make build`")
        handle = ctypes.c_void_p
        loaded.noctule_replay_create.restype = handle
        loaded.noctule_replay_destroy.argtypes = [handle]
        loaded.noctule_replay_set_parameter.argtypes = [handle, ctypes.c_char_p, ctypes.c_double]
        loaded.noctule_replay_set_mapping.argtypes = [handle, ctypes.c_int]
        loaded.noctule_replay_step.argtypes = [handle, ctypes.POINTER(_Sweep), ctypes.POINTER(_Pose)]
        loaded.noctule_replay_tile_count.argtypes = [handle]
        loaded.noctule_replay_read_tile.argtypes = [handle, ctypes.c_int32, ctypes.POINTER(_Tile)]
        loaded.noctule_replay_grid_format.argtypes = [handle, ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_int32)]
        loaded.noctule_replay_counters.argtypes = [handle, ctypes.c_void_p, ctypes.c_size_t]
        for name in ("counters", "localiser_bytes", "grid_bytes"):
            getattr(loaded, f"noctule_replay_{name}").restype = ctypes.c_size_t
        _library = loaded
    return _library


class Tracker:
    """One Localiser and one OccupancyGrid. Not thread-safe; trackers share nothing.

    Args:
        parameters: name or MAVLink id -> value; what is not named keeps its default.
        mapping: False: the grid stays empty.

    Raises:
        LibraryMissing: the shared library was not built.
        ValueError: no such parameter, or a value out of its range.
    """

    def __init__(self, parameters: dict[str, float] | None = None, mapping: bool = True):
        self._lib = library()
        self._handle = self._lib.noctule_replay_create()
        self._lib.noctule_replay_set_mapping(self._handle, int(mapping))
        self._pose = _Pose()
        for name, value in (parameters or {}).items():
            result = self._lib.noctule_replay_set_parameter(self._handle, name.encode(), float(value))
            if result != 0:
                self.close()
                raise ValueError(f"parameter {name} = {value}: " + {1: "no such name", 2: "out of range or not whole"}[result])

    def close(self) -> None:
        """Frees the tracker. A closed one must not be used."""
        if self._handle:
            self._lib.noctule_replay_destroy(self._handle)
            self._handle = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def step(self, t_us: int, range_m: np.ndarray, layout: Layout, motion=None, imu=None, attitude=None) -> Step:
        """One sweep.

        Args:
            t_us: stamp, time of the last beam.
            range_m: (B,) [m]; infinity: nothing hit, NaN: nothing known.
            layout: the laser's.
            motion: (dx, dy, dyaw, dt) in Body at the sweep before and the upper triangle (6,) of its covariance, or None.
            imu: times (N,) int64 [us] and (N, 6) specific force [m/s^2] and rates [rad/s], oldest first, or None.
            attitude: times (M,) int64 [us] and (M, 2) roll and pitch [rad], or None.
        """
        ranges = np.ascontiguousarray(range_m, np.float32)
        sweep = _Sweep(t_us=t_us, count=len(ranges), time_increment_us=layout.time_increment_us,
                       bearing_first_rad=layout.bearing_first_rad, bearing_increment_rad=layout.bearing_increment_rad,
                       range_min_m=layout.range_min_m, range_max_m=layout.range_max_m, range_m=ranges.ctypes.data)
        kept = []

        def pointer(values, kind):
            kept.append(np.ascontiguousarray(values, kind))
            return kept[-1].ctypes.data

        if motion is not None:
            sweep.has_motion = 1
            sweep.motion[:], sweep.motion_covariance[:] = motion[0], motion[1]
        if imu is not None:
            sweep.imu_count, sweep.imu_t_us, sweep.imu = len(imu[0]), pointer(imu[0], np.int64), pointer(imu[1], np.float32)
        if attitude is not None:
            sweep.attitude_count, sweep.attitude_t_us = len(attitude[0]), pointer(attitude[0], np.int64)
            sweep.roll_pitch_rad = pointer(attitude[1], np.float32)
        self._lib.noctule_replay_step(self._handle, ctypes.byref(sweep), ctypes.byref(self._pose))
        p = self._pose
        return Step((p.x_m, p.y_m, p.yaw_rad), tuple(p.covariance), p.quality, p.reset_counter, p.walls_seen, p.walls_matched,
                    p.landmarks, p.localise_ns, p.map_ns)

    def counters(self) -> dict[str, int]:
        """What was refused and lost so far; names in COUNTERS."""
        values = np.zeros(len(COUNTERS), np.uint32)
        self._lib.noctule_replay_counters(self._handle, values.ctypes.data, len(COUNTERS))
        return dict(zip(COUNTERS, values.tolist()))

    def grid(self) -> tuple[np.ndarray, float, float, float] | None:
        """Log-odds (rows, columns) int8 in 1/16 nat, row along y; x and y of its corner [m] in Map; cell edge [m]. None: empty."""
        from noctule import record

        cell_m, cells = ctypes.c_float(), ctypes.c_int32()
        self._lib.noctule_replay_grid_format(self._handle, ctypes.byref(cell_m), ctypes.byref(cells))
        tile, tiles = _Tile(), []
        for slot in range(self._lib.noctule_replay_tile_count(self._handle)):
            self._lib.noctule_replay_read_tile(self._handle, slot, ctypes.byref(tile))
            tiles.append(record.Tile(0, 0, tile.tile_x, tile.tile_y, cell_m.value, np.frombuffer(bytes(tile.log_odds), np.int8)))
        return record.map_of(tiles, 0)


def memory_bytes() -> tuple[int, int]:
    """Static memory of the Localiser and of the OccupancyGrid [bytes]."""
    return library().noctule_replay_localiser_bytes(), library().noctule_replay_grid_bytes()


def compose(a, b) -> tuple[float, float, float]:
    """Pose a * b: b, told in a's frame, in the frame that a is told in. (x, y, yaw) each, yaw wrapped.

    >>> [round(v, 3) for v in compose((1.0, 2.0, math.pi / 2), (1.0, 0.0, 0.0))]
    [1.0, 3.0, 1.571]
    """
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], math.remainder(a[2] + b[2], 2.0 * math.pi)


def between(a, b) -> tuple[float, float, float]:
    """Pose of b as seen from a: compose(a, between(a, b)) is b.

    >>> [round(v, 3) for v in between((1.0, 2.0, math.pi / 2), (1.0, 3.0, math.pi / 2))]
    [1.0, 0.0, 0.0]
    """
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return c * dx + s * dy, c * dy - s * dx, math.remainder(b[2] - a[2], 2.0 * math.pi)
