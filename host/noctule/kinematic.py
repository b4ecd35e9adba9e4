"""Exploring without dynamics and estimators: the firmware's map, mission, reference and guard round a vehicle that follows with a lag.

The world is ray-cast by the simulator's own Geometry (1080 beams, 270 degrees, noise by seed), the pose is handed over as it is.
A building takes seconds instead of minutes. What it leaves out - physics, IMU, localisation, height, drop-outs - is confirmed by
in-process and three-process flights (docs/results.md). Frames World and Map, SI units.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from noctule.inprocess import library
from noctule.map_score import wall_shares
from noctule.score import ExploredScore, StartPose, cached_floor_truth
from noctule_sim.geometry import Geometry

STEP_S = 0.05
LASER_SIGMA_M = 0.01
SCORE_EVERY = 10            # steps between two looks at the map
LASER_OVER_BODY_M = 0.0
EXPLORING, LANDED, ABORTED = 3, 6, 7
START_ORDER = 1
POSE_SIGMA_M = 0.005


class _In(ctypes.Structure):
    _fields_ = [("t_us", ctypes.c_int64)] + [(n, ctypes.c_double) for n in ("x_m", "y_m", "z_m", "yaw_rad", "vx_m_s", "vy_m_s", "ceiling_z_m")] + [
        ("range_m", ctypes.c_void_p), ("count", ctypes.c_int32), ("bearing_first_rad", ctypes.c_float), ("bearing_increment_rad", ctypes.c_float),
        ("range_max_m", ctypes.c_float), ("armed", ctypes.c_int32), ("on_ground", ctypes.c_int32), ("order", ctypes.c_int32)]


class _Out(ctypes.Structure):
    _fields_ = [(n, ctypes.c_double) for n in ("x_m", "y_m", "z_m", "yaw_rad", "vx_m_s", "vy_m_s", "vz_m_s", "goal_x_m", "goal_y_m")] + [
        ("map_ns", ctypes.c_int64), ("plan_ns", ctypes.c_int64)] + [(n, ctypes.c_int32) for n in (
            "setpoint_valid", "state", "reason", "ready", "goal_valid", "guard_rule")] + [("known_area_m2", ctypes.c_float), ("unknown_share", ctypes.c_float)] + [
        (n, ctypes.c_int32) for n in ("goals", "switches", "stuck", "in_vain", "back_and_forth", "stops", "path_points")]


class _Tile(ctypes.Structure):
    _fields_ = [("tile_x", ctypes.c_int32), ("tile_y", ctypes.c_int32), ("log_odds", ctypes.c_int8 * 4096)]


@njit(cache=True)
def _follow(state, setpoint, armed, lag_s):
    """One step of the vehicle. state (8,): x y z yaw vx vy vz length, frame Map, changed in place."""
    if armed:
        dt = STEP_S / 5
        for _ in range(5):
            for axis in range(3):
                want = setpoint[4 + axis] + 1.2 * (setpoint[axis] - state[axis])
                state[4 + axis] += (want - state[4 + axis]) * dt / lag_s
                state[axis] += state[4 + axis] * dt
            state[2] = max(0.0, state[2])
            turn = setpoint[3] - state[3]
            state[3] += 3.0 * math.atan2(math.sin(turn), math.cos(turn)) * dt
            state[7] += math.hypot(state[4], state[5]) * dt


@dataclass
class Exploration:
    """What one exploration came to."""

    completed: bool = False
    explored_fraction: float = 0.0
    time_to_s: dict = field(default_factory=dict)      # share -> s after take-off's start, or None
    path_to_m: dict = field(default_factory=dict)
    time_s: float = 0.0                                # until landed
    exploring_s: float = 0.0                           # until the way home began
    path_m: float = 0.0
    exploring_path_m: float = 0.0
    least_clearance_m: float = math.inf                # hull to solid
    goals: int = 0
    switches: int = 0
    stuck: int = 0
    in_vain: int = 0
    back_and_forth: int = 0
    unknown_share: float = 1.0                         # the paper's policy: known free cells that were never in its window
    reason: int = 0
    plan_ms: tuple = ()                                # p50, p99, greatest, processor time
    whole_plan_ms: float = -1.0                        # one plan over the whole map at the end, processor time
    whole_plan_cells: int = 0                          # settled by it
    walls: tuple = (None, None)                        # map_score.wall_shares of the map at the end
    track: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (N, 3) t, x, y, frame World, every half second
    goal_track: list = field(default_factory=list)
    speed_m_s: np.ndarray = field(default_factory=lambda: np.zeros(0))


def _load():
    abi = library()
    abi.noctule_explore_create.restype = ctypes.c_void_p
    abi.noctule_explore_destroy.argtypes = [ctypes.c_void_p]
    abi.noctule_explore_set_parameter.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_double]
    abi.noctule_explore_step.argtypes = [ctypes.c_void_p, ctypes.POINTER(_In), ctypes.POINTER(_Out)]
    abi.noctule_explore_plan_ms.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_int32)]
    abi.noctule_explore_plan_ms.restype = ctypes.c_double
    abi.noctule_explore_tile_count.argtypes = [ctypes.c_void_p]
    abi.noctule_explore_tile_at.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(_Tile)]
    return abi


def _map(abi, handle) -> tuple[np.ndarray, float, float]:
    """The whole grid: log odds (rows, columns) int8 and its corner [m], frame Map."""
    tiles, tile = {}, _Tile()
    for slot in range(abi.noctule_explore_tile_count(handle)):
        abi.noctule_explore_tile_at(handle, slot, ctypes.byref(tile))
        tiles[tile.tile_y, tile.tile_x] = np.frombuffer(tile.log_odds, np.int8).reshape(64, 64).copy()
    low, high = np.min(list(tiles), axis=0), np.max(list(tiles), axis=0) + 1
    grid = np.zeros((high - low) * 64, np.int8)
    for at, values in tiles.items():
        row, column = (np.array(at) - low) * 64
        grid[row:row + 64, column:column + 64] = values
    return grid, float(low[1]) * 6.4, float(low[0]) * 6.4


def explore(world, seed: int, parameters: dict[str, float], max_time_s: float = 1800.0, floor_truth=None, watch=None, lag_s: float = 0.15) -> Exploration:
    """Explores one floor of a world from its start.

    Args:
        world: the building; its floor under the start is explored.
        seed: of laser and pose noise.
        parameters: tunables by name; the rest keep their defaults.
        floor_truth: of that floor, if it is at hand.
        watch: called as watch(t_s, state, out) in every step.
        lag_s: in which the vehicle's velocity follows what its position loop wants.
    """
    abi = _load()
    rng = np.random.default_rng(seed)
    geometry = Geometry(world)
    start = StartPose(world.start.x_m, world.start.y_m, world.start.z_m, world.start.yaw_rad)
    storey = min(world.floors, key=lambda f: abs(f.elevation_m - world.start.z_m))
    truth = floor_truth or cached_floor_truth(world.primitives(), float(storey.elevation_m), world.start.x_m, world.start.y_m)
    score = ExploredScore(truth, start)
    handle = abi.noctule_explore_create()
    for name, value in parameters.items():
        if abi.noctule_explore_set_parameter(handle, name.encode(), float(value)) != 0:
            raise ValueError(f"parameter {name} = {value}")
    beams = 1080
    increment = math.radians(270.0) / beams
    bearings = -0.5 * increment * (beams - 1) + increment * np.arange(beams)
    state, setpoint, ranges = np.zeros(8), np.zeros(8), np.zeros(beams)
    poses, mount = np.zeros((2, 8)), np.zeros(4)
    poses[1, 0] = 1.0
    data, out, tile = _In(), _Out(), _Tile()
    data.range_m, data.count = ranges.ctypes.data, beams
    data.bearing_first_rad, data.bearing_increment_rad, data.range_max_m = bearings[0], increment, 10.0
    data.ceiling_z_m = storey.height_m
    result = Exploration(time_to_s={0.95: None, 0.99: None}, path_to_m={0.95: None, 0.99: None})
    c, s = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
    armed, ordered, step, began_s, t_s = False, False, 0, 0.0, 0.0
    plan_ns, track, speeds, last_goal = [], [], [], None
    delayed = setpoint.copy()
    while t_s < max_time_s:
        step += 1
        t_s = step * STEP_S
        wx, wy, yaw = start.x_m + c * state[0] - s * state[1], start.y_m + s * state[0] + c * state[1], start.yaw_rad + state[3]
        poses[:, 1], poses[:, 2], poses[:, 3] = wx, wy, start.z_m + max(state[2], 0.12)
        poses[:, 4], poses[:, 7] = math.cos(yaw / 2), math.sin(yaw / 2)
        ranges[0] = 0.0
        geometry.sweep(poses, mount, bearings, 10.0, ranges)
        ranges += LASER_SIGMA_M * rng.standard_normal(beams)
        np.maximum(ranges, 0.06, out=ranges)
        data.t_us = int(round(t_s * 1e6)) + 1_000_000
        jitter = POSE_SIGMA_M * rng.standard_normal(2)
        data.x_m, data.y_m, data.z_m, data.yaw_rad = state[0] + jitter[0], state[1] + jitter[1], state[2], state[3]
        data.vx_m_s, data.vy_m_s = state[4], state[5]
        data.armed, data.on_ground = int(armed), int(state[2] < 0.02)
        data.order = START_ORDER if not ordered and out.ready else 0
        ordered = ordered or bool(out.ready)
        abi.noctule_explore_step(handle, ctypes.byref(data), ctypes.byref(out))
        plan_ns.append(out.plan_ns)
        if out.state == 1 and not armed:
            armed, began_s = True, t_s
        _follow(state, delayed, armed and bool(out.setpoint_valid), lag_s)
        delayed[:4] = out.x_m, out.y_m, out.z_m, out.yaw_rad
        delayed[4:7] = out.vx_m_s, out.vy_m_s, out.vz_m_s
        if step % SCORE_EVERY == 0:
            before = dict(score.time_to_s)
            for slot in range(abi.noctule_explore_tile_count(handle)):
                abi.noctule_explore_tile_at(handle, slot, ctypes.byref(tile))
                score.update(t_s - began_s, tile.tile_x, tile.tile_y, 0.1, np.frombuffer(tile.log_odds, np.int8))
            for share in before:
                if before[share] is None and score.time_to_s[share] is not None:
                    result.path_to_m[share] = float(state[7])
            track.append((t_s - began_s, wx, wy))
        if out.goal_valid and (out.goal_x_m, out.goal_y_m) != last_goal:
            last_goal = (out.goal_x_m, out.goal_y_m)
            result.goal_track.append((t_s - began_s, *last_goal))
        if state[2] > 0.3:
            result.least_clearance_m = min(result.least_clearance_m, geometry.clearance(wx, wy, start.z_m + state[2], 0.30, 0.10)[0])
        if out.state == EXPLORING:
            result.exploring_s, result.exploring_path_m = t_s - began_s, float(state[7])
            speeds.append(math.hypot(state[4], state[5]))
        if watch is not None:
            watch(t_s - began_s, state, out)
        if out.state in (LANDED, ABORTED):
            break
    result.walls = wall_shares(truth, start, *_map(abi, handle), 0.1)
    cells = ctypes.c_int32()
    result.whole_plan_ms = abi.noctule_explore_plan_ms(handle, ctypes.byref(cells))
    result.whole_plan_cells = cells.value
    abi.noctule_explore_destroy(handle)
    result.completed = out.state == LANDED and out.reason == 11
    result.reason = out.reason
    result.explored_fraction = score.explored_fraction
    result.time_to_s = dict(score.time_to_s)
    result.time_s, result.path_m = t_s - began_s, float(state[7])
    result.goals, result.switches, result.stuck, result.in_vain = out.goals, out.switches, out.stuck, out.in_vain
    result.back_and_forth, result.unknown_share = out.back_and_forth, out.unknown_share
    result.plan_ms = tuple(float(v) * 1e-6 for v in (np.percentile(plan_ns, 50), np.percentile(plan_ns, 99), max(plan_ns)))
    result.track, result.speed_m_s = np.array(track), np.array(speeds)
    return result
