"""CARMEN logs (.clf, .clf.gz) through the firmware's localisation and mapping; trajectories and maps as files; relations.

Lines read: ODOM, FLASER, ROBOTLASER1. Poses in a log are wheel odometry; only their increments are used. Format:
docs/replay.md. Relations: Kuemmerle et al., On measuring the accuracy of SLAM algorithms, Autonomous Robots 2009.
"""

from __future__ import annotations

import bisect
import math
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from noctule.localise import Layout, Step, Tracker, between, compose
from noctule.record import RecordError

READ = ("ODOM", "FLASER", "ROBOTLASER1")
NO_RETURN_SHARE = 0.95       # of the greatest range in a FLASER log: from there on nothing was hit
MAX_LASER_M = 100.0
START_US = 1_000_000         # stamp of the first sweep; a log's own epoch does not fit the filter's clock


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviation of an increment: floors, and shares of path and turn since the sweep before.

    Wide, as old robots slip: the logs' own odometry turns 0.1 rad in a metre off where a wheel catches.
    """

    floor_m: float = 0.005
    floor_rad: float = 0.003
    share_path: float = 0.30       # m for each m
    turn_per_path: float = 0.20    # rad for each m
    share_turn: float = 0.30       # rad for each rad
    path_per_turn: float = 0.10    # m for each rad

    def covariance(self, path_m: float, turn_rad: float) -> tuple[float, ...]:
        """Upper triangle (6,) of the covariance of (dx, dy, dyaw)."""
        along = self.floor_m + self.share_path * path_m + self.path_per_turn * turn_rad
        yaw = self.floor_rad + self.turn_per_path * path_m + self.share_turn * turn_rad
        return along * along, 0.0, 0.0, along * along, 0.0, yaw * yaw


@dataclass
class Log:
    """A log in order of time. Poses are odometry, (x [m], y [m], yaw [rad])."""

    scan_t_s: list[float] = field(default_factory=list)
    scan_pose: list[tuple] = field(default_factory=list)
    ranges: list[np.ndarray] = field(default_factory=list)
    layouts: list[Layout] = field(default_factory=list)
    odometry_t_s: list[float] = field(default_factory=list)    # ODOM lines and sweeps
    odometry_pose: list[tuple] = field(default_factory=list)
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)     # laser in the robot's frame
    bad_lines: int = 0
    other_lines: int = 0
    cut: bool = False              # the file ends in the middle of a line or of a compressed block
    late: int = 0                  # sweeps whose time did not rise; left out


def _chunks(path: Path, log: Log):
    """The file's text in pieces, decompressed where needed; all that a cut file still holds."""
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
            file.seek(0)
            unpack = zlib.decompressobj(wbits=31) if packed else None
            while chunk := file.read(1 << 20):
                if unpack is None:
                    yield chunk
                    continue
                while chunk:
                    if unpack.eof:                   # another member follows
                        unpack = zlib.decompressobj(wbits=31)
                    yield unpack.decompress(chunk)
                    chunk = unpack.unused_data
            log.cut = unpack is not None and not unpack.eof
    except zlib.error:
        log.cut = True
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from None


def _lines(path: Path, log: Log):
    """Lines of a log; sets log.cut."""
    tail = b""
    for chunk in _chunks(path, log):
        *whole, tail = (tail + chunk).split(b"\n")
        yield from whole
    if tail.strip():
        log.cut = True
        yield tail


def _flaser_bearings(count: int) -> tuple[float, float]:
    """First bearing and increment [rad] of a FLASER line: half a circle; 180 and 360 beams leave out the last one."""
    steps = count if count in (180, 360) else max(count - 1, 1)
    return -0.5 * math.pi, math.pi / steps


def _stamp(fields: list[bytes]) -> float:
    """Time of a line [s]: `ipc_timestamp ipc_hostname logger_timestamp` end it, the first counts."""
    t = float(fields[0])
    if len(fields) != 3 or not math.isfinite(t):
        raise ValueError("no time")
    return t


def _parse(words: list[bytes], log: Log, laser_poses: list) -> None:
    """One line into the log.

    Raises:
        ValueError, IndexError: the line is not as its name says.
    """
    name = words[0]
    if name == b"ODOM":
        if len(words) != 10:
            raise ValueError("length")
        values = [float(v) for v in words[1:7]]
        t = _stamp(words[7:])
        if not all(map(math.isfinite, values)):
            raise ValueError("not finite")
        log.odometry_t_s.append(t)
        log.odometry_pose.append(tuple(values[:3]))
        return
    if name == b"FLASER":
        count = int(words[1])
        if count < 2 or len(words) != count + 11:
            raise ValueError("length")
        ranges, rest = words[2:2 + count], words[2 + count:]
        poses, stamp = rest[:6], rest[6:]
        first, increment = _flaser_bearings(count)
        layout = Layout(first, increment, 0.05, MAX_LASER_M)
    else:
        first, increment, range_max = float(words[2]), float(words[4]), float(words[5])
        count = int(words[8])
        extra = int(words[9 + count])                # remissions
        rest = words[10 + count + extra:]
        if count < 2 or extra < 0 or len(rest) != 14 or not 0.1 < range_max < 1000.0:
            raise ValueError("length")
        ranges, poses, stamp = words[9:9 + count], rest[:6], rest[11:]
        layout = Layout(first, increment, 0.01, range_max)
    ranges = np.array(ranges, dtype=np.float64)
    values = [float(v) for v in poses]
    t = _stamp(stamp)
    if not all(map(math.isfinite, values)) or not math.isfinite(first + increment):
        raise ValueError("not finite")
    if log.scan_t_s and t <= log.scan_t_s[-1]:
        log.late += 1
        return
    log.scan_t_s.append(t)
    log.scan_pose.append(tuple(values[3:]))
    log.ranges.append(ranges)
    log.layouts.append(layout)
    laser_poses.append(tuple(values[:3]))
    log.odometry_t_s.append(t)
    log.odometry_pose.append(tuple(values[3:]))


def read(path, range_max_m: float | None = None) -> Log:
    """Reads a log. Bad lines are counted and left out; a cut file gives what it holds.

    Args:
        path: .clf or .clf.gz.
        range_max_m: ranges from here on are no returns; None: as the log says or shows.

    Raises:
        RecordError: no such file, or not a single sweep in it.
    """
    path = Path(path)
    if not path.is_file():
        raise RecordError(f"{path}: no such file")
    log, laser_poses = Log(), []
    names = {n.encode() for n in READ}
    for line in _lines(path, log):
        words = line.split()
        if not words or words[0].startswith(b"#"):
            continue
        if words[0] not in names:
            log.other_lines += 1
            continue
        try:
            _parse(words, log, laser_poses)
        except (ValueError, IndexError):
            log.bad_lines += 1
    if not log.ranges:
        raise RecordError(f"{path}: no FLASER and no ROBOTLASER1 line in it; is it a CARMEN log?")
    order = np.argsort(np.array(log.odometry_t_s), kind="stable")
    log.odometry_t_s = [log.odometry_t_s[i] for i in order]
    log.odometry_pose = [log.odometry_pose[i] for i in order]
    offsets = np.array([between(o, p) for o, p in zip(log.scan_pose, laser_poses)])
    middle = np.median(offsets, axis=0)
    if np.abs(offsets - middle).max() < 2e-3 and np.hypot(*middle[:2]) < 2.0:
        log.mounting = tuple(float(v) for v in np.round(middle, 4))
    _clean(log, range_max_m)
    return log


def _clean(log: Log, range_max_m: float | None) -> None:
    """Turns ranges that say nothing into NaN, and no returns within a known reach into infinity."""
    greatest = max(float(np.max(r, initial=0.0, where=np.isfinite(r))) for r in log.ranges)
    for k, (ranges, layout) in enumerate(zip(log.ranges, log.layouts)):
        if layout.range_max_m == MAX_LASER_M:        # FLASER: its reach is not in the log, a missing return may be anything
            limit = range_max_m or min(NO_RETURN_SHARE * greatest, MAX_LASER_M)
            ranges[~(ranges < limit)] = math.nan
            log.layouts[k] = Layout(layout.bearing_first_rad, layout.bearing_increment_rad, layout.range_min_m, max(limit, 0.1))
        else:
            limit = range_max_m or layout.range_max_m
            ranges[ranges >= limit * 0.999] = math.inf
            if range_max_m:
                log.layouts[k] = Layout(layout.bearing_first_rad, layout.bearing_increment_rad, layout.range_min_m, limit)


@dataclass
class Track:
    """What the localisation said of a log, one entry a sweep; poses in Map."""

    t_s: np.ndarray
    poses: np.ndarray              # (N, 3)
    steps: list[Step]
    counters: dict[str, int]
    grid: tuple | None             # Tracker.grid

    @property
    def localise_us(self) -> np.ndarray:
        """Processor time of each step [us]."""
        return np.array([s.localise_ns for s in self.steps]) * 1e-3

    @property
    def map_us(self) -> np.ndarray:
        """Processor time of entering each sweep into the grid [us]."""
        return np.array([s.map_ns for s in self.steps]) * 1e-3


def increments(log: Log, noise: OdometryNoise):
    """For each sweep: (dx, dy, dyaw, dt) since the one before, and its covariance. The first one is zero.

    Path and turn are summed over the ODOM lines between, so that a step to and fro counts as twice its length.
    """
    out = [((0.0, 0.0, 0.0, 0.0), (0.0,) * 6)]
    for k in range(1, len(log.scan_t_s)):
        i = bisect.bisect_right(log.odometry_t_s, log.scan_t_s[k - 1])
        j = bisect.bisect_left(log.odometry_t_s, log.scan_t_s[k])
        chain = [log.scan_pose[k - 1], *log.odometry_pose[i:j], log.scan_pose[k]]
        parts = [between(a, b) for a, b in zip(chain, chain[1:])]
        path, turn = sum(math.hypot(p[0], p[1]) for p in parts), sum(abs(p[2]) for p in parts)
        step = between(log.scan_pose[k - 1], log.scan_pose[k])
        out.append(((*step, log.scan_t_s[k] - log.scan_t_s[k - 1]), noise.covariance(path, turn)))
    return out


def track(log: Log, parameters: dict[str, float] | None = None, noise: OdometryNoise = OdometryNoise(), mapping: bool = True) -> Track:
    """Runs the firmware over a log.

    Raises:
        LibraryMissing: the shared library was not built.
        ValueError: no such parameter, or a value out of its range.
    """
    mounted = dict(zip(("lidar_x_m", "lidar_y_m", "lidar_yaw_rad"), log.mounting))
    steps = []
    with Tracker({**mounted, **(parameters or {})}, mapping) as tracker:
        for t_s, ranges, layout, motion in zip(log.scan_t_s, log.ranges, log.layouts, increments(log, noise)):
            t_us = START_US + round((t_s - log.scan_t_s[0]) * 1e6)
            steps.append(tracker.step(t_us, ranges, layout, motion))
        counters, grid = tracker.counters(), tracker.grid() if mapping else None
    return Track(np.array(log.scan_t_s), np.array([s.pose for s in steps]), steps, counters, grid)


# ---- relations

def read_relations(path) -> np.ndarray:
    """(N, 5): t1 [s], t2 [s], dx [m], dy [m], dyaw [rad]: the pose at t2 as seen from the pose at t1.

    Raises:
        RecordError: missing, empty, or a line is not `t1 t2 dx dy dz roll pitch yaw`.
    """
    path = Path(path)
    if not path.is_file():
        raise RecordError(f"{path}: no such file")
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            v = [float(w) for w in words]
        except ValueError:
            v = []
        if len(v) != 8 or not all(map(math.isfinite, v)):
            raise RecordError(f"{path}: line {number} is not `t1 t2 dx dy dz roll pitch yaw`")
        rows.append((v[0], v[1], v[2], v[3], v[7]))
    if not rows:
        raise RecordError(f"{path}: no relation in it")
    return np.array(rows)


def _odometry_at(log: Log, t_s: float) -> tuple:
    """Odometry at a time, linear between its lines."""
    times = log.odometry_t_s
    j = min(max(bisect.bisect_right(times, t_s), 1), len(times) - 1)
    i = j - 1
    if times[j] <= times[i]:
        return log.odometry_pose[j]
    share = min(max((t_s - times[i]) / (times[j] - times[i]), 0.0), 1.0)
    step = between(log.odometry_pose[i], log.odometry_pose[j])
    return compose(log.odometry_pose[i], tuple(share * v for v in step))


def pose_at(log: Log, t_s: np.ndarray, poses: np.ndarray, at_s: float) -> tuple | None:
    """Pose at a time between two sweeps: odometry from the one before, its error spread evenly up to the one after.

    None: before the first or after the last sweep by more than a second.
    """
    k = bisect.bisect_right(t_s, at_s) - 1
    if at_s < t_s[0] - 1.0 or at_s > t_s[-1] + 1.0:
        return None
    k = min(max(k, 0), len(t_s) - 1)
    here = _odometry_at(log, at_s)
    forward = compose(poses[k], between(log.scan_pose[k], here))
    if k + 1 == len(t_s) or at_s <= t_s[k]:
        return forward
    backward = compose(poses[k + 1], between(log.scan_pose[k + 1], here))
    share = (at_s - t_s[k]) / (t_s[k + 1] - t_s[k])
    gap = between(forward, backward)
    return compose(forward, tuple(share * v for v in gap))


@dataclass(frozen=True)
class RelationErrors:
    """Errors of a trajectory against relations: one entry a relation used."""

    translation_m: np.ndarray
    rotation_rad: np.ndarray
    unused: int                    # relations outside the log

    def text(self) -> str:
        """Two lines for a terminal."""
        if not len(self.translation_m):
            return f"relations: none of {self.unused} lies within the log"
        t, r = self.translation_m, np.degrees(self.rotation_rad)
        return (f"relations: {len(t)} used, {self.unused} outside the log\n"
                f"  translation mean {t.mean():.4f} m, median {np.median(t):.4f} m; rotation mean {r.mean():.3f} deg, "
                f"median {np.median(r):.3f} deg")


SAME_SWEEP_S = 0.10          # a relation's time within this of a sweep's means that sweep
CLOCK_MOST_S, CLOCK_STEP_S = 0.20, 0.01
CLOCK_TRIED_WITH = 600       # relations
POINT_SCATTER_M = 0.03       # of a relation; those far beyond say nothing of the point
POINT_USUAL_M = 0.3


@dataclass(frozen=True)
class Convention:
    """How a file of relations tells poses: on which clock, of sweeps or of times between, of which point of the robot."""

    clock_s: float = 0.0          # the log's clock less that of the relations
    same_sweep_s: float = 0.0     # a time within this of a sweep's means that sweep, not a place between sweeps
    x_m: float = 0.0              # the point, in Body
    y_m: float = 0.0

    def text(self) -> str:
        """For a terminal."""
        return (f"clock {self.clock_s:+.2f} s, {'poses of sweeps' if self.same_sweep_s else 'poses of any time'}, "
                f"{1e3 * self.x_m:.0f} mm before and {1e3 * self.y_m:.0f} mm left of the robot's point")


def calibrate(log: Log, t_s: np.ndarray, poses: np.ndarray, relations: np.ndarray) -> Convention:
    """The convention that brings a trajectory nearest to relations: clock and kind from the rotations, point from the translations.

    As with any two instruments, what was measured by one in its own frame and on its own clock has to be brought to the other's.
    Judge by relations that were not given to this.
    """
    some = relations[:: max(1, len(relations) // CLOCK_TRIED_WITH)]
    steps = round(CLOCK_MOST_S / CLOCK_STEP_S)
    clocks = sorted((round(k * CLOCK_STEP_S, 3) for k in range(-steps, steps + 1)), key=abs)
    tried = [Convention(clock_s, same_s) for same_s in (0.0, SAME_SWEEP_S) for clock_s in clocks]

    def turned_off(convention: Convention) -> float:
        rotation_rad = relation_errors(log, t_s, poses, some, convention).rotation_rad
        return float(rotation_rad.mean()) if len(rotation_rad) else math.inf

    best = min(tried, key=turned_off)
    # (R(turn) - I) point = told - seen, with a robust weight.
    rows, values = [], []
    for t1, t2, *told in relations:
        a, b = _told_at(log, t_s, poses, t1, best), _told_at(log, t_s, poses, t2, best)
        if a is None or b is None:
            continue
        seen = between(a, b)
        c, s = math.cos(seen[2]) - 1.0, math.sin(seen[2])
        rows += [(c, -s), (s, c)]
        values += [told[0] - seen[0], told[1] - seen[1]]
    prior = POINT_SCATTER_M / POINT_USUAL_M
    matrix, value = np.array([*rows, (prior, 0.0), (0.0, prior)]), np.array([*values, 0.0, 0.0])
    point = np.zeros(2)
    for _ in range(10):
        root = 1.0 / np.sqrt(1.0 + ((value - matrix @ point) / POINT_SCATTER_M) ** 2)
        point = np.linalg.lstsq(matrix * root[:, None], value * root, rcond=None)[0]
    return replace(best, x_m=float(point[0]), y_m=float(point[1]))


def _told_at(log: Log, t_s: np.ndarray, poses: np.ndarray, time_s: float, convention: Convention) -> tuple | None:
    """Pose at a relation's time; None: outside the log."""
    time_s += convention.clock_s
    k = int(np.argmin(np.abs(t_s - time_s)))
    pose = tuple(poses[k]) if abs(t_s[k] - time_s) <= convention.same_sweep_s else pose_at(log, t_s, poses, time_s)
    return None if pose is None else compose(pose, (convention.x_m, convention.y_m, 0.0))


def calibrated_errors(log: Log, t_s: np.ndarray, poses: np.ndarray, relations: np.ndarray) -> tuple[Convention, RelationErrors]:
    """The convention found on every second relation, and the errors at the others."""
    convention = calibrate(log, t_s, poses, relations[::2])
    return convention, relation_errors(log, t_s, poses, relations[1::2], convention)


def relation_errors(log: Log, t_s: np.ndarray, poses: np.ndarray, relations: np.ndarray, convention: Convention = Convention()) -> RelationErrors:
    """Kuemmerle's errors: how far the relative pose of each pair lies from the relation, translation and rotation apart.

    Args:
        t_s, poses: (N,) and (N, 3), the trajectory at the log's sweeps.
        relations: (M, 5) of read_relations.
        convention: how the relations tell poses.
    """
    translation, rotation, unused = [], [], 0
    for t1, t2, *truth in relations:
        a, b = _told_at(log, t_s, poses, t1, convention), _told_at(log, t_s, poses, t2, convention)
        if a is None or b is None:
            unused += 1
            continue
        error = between(truth, between(a, b))
        translation.append(math.hypot(error[0], error[1]))
        rotation.append(abs(error[2]))
    return RelationErrors(np.array(translation), np.array(rotation), unused)


# ---- files

def write_trajectory(folder: Path, t_s: np.ndarray, poses: np.ndarray) -> None:
    """trajectory.txt (`t x y theta`) and trajectory.tum (`t x y z qx qy qz qw`), times as in the log, frame Map."""
    with (folder / "trajectory.txt").open("w", encoding="utf-8") as text, (folder / "trajectory.tum").open("w", encoding="utf-8") as tum:
        for t, (x, y, yaw) in zip(t_s, poses):
            text.write(f"{t:.6f} {x:.6f} {y:.6f} {yaw:.6f}\n")
            tum.write(f"{t:.6f} {x:.6f} {y:.6f} 0 0 0 {math.sin(0.5 * yaw):.9f} {math.cos(0.5 * yaw):.9f}\n")


def grid_image(grid: np.ndarray, occupied: int, free: int) -> np.ndarray:
    """Grey values (rows, columns) as ROS map_server reads them: 0 occupied, 254 free, 205 unknown; the first row is the top (+y)."""
    image = np.full(grid.shape, 205, np.uint8)
    image[grid >= occupied] = 0
    image[grid <= free] = 254
    return image[::-1]


def write_map(folder: Path, grid, parameters: dict[str, float] | None = None, name: str = "map",
              suffixes: tuple[str, ...] = (".png", ".pgm", ".yaml")) -> bool:
    """<name>.png, <name>.pgm and <name>.yaml (ROS map_server), or those of them named. False: there is no map, nothing was written.

    Args:
        grid: Tracker.grid.
        parameters: thresholds of the grid, where they are not the defaults.
        name: of the files.
        suffixes: which of them.
    """
    from PIL import Image

    from noctule.params_gen import DEFAULTS

    if grid is None:
        return False
    cells, x_m, y_m, cell_m = grid
    values = {**DEFAULTS, **(parameters or {})}
    seen = np.argwhere(cells != 0)
    if seen.size:
        (i0, j0), (i1, j1) = np.maximum(seen.min(axis=0) - 2, 0), seen.max(axis=0) + 3
        cells, x_m, y_m = cells[i0:i1, j0:j1], x_m + j0 * cell_m, y_m + i0 * cell_m
    image = grid_image(cells, round(16 * values["grid_occupied_log_odds"]), round(16 * values["grid_free_log_odds"]))
    if ".png" in suffixes:
        Image.fromarray(image).save(folder / f"{name}.png")
    if ".pgm" in suffixes:
        with (folder / f"{name}.pgm").open("wb") as file:
            file.write(b"P5\n%d %d\n255\n" % (image.shape[1], image.shape[0]) + image.tobytes())
    if ".yaml" in suffixes:
        (folder / f"{name}.yaml").write_text(
            f"image: {name}.pgm\nresolution: {cell_m:.6g}\norigin: [{x_m:.4f}, {y_m:.4f}, 0.0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n", encoding="utf-8")
    return True
