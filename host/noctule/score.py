"""How good a flight was: explored share, pose errors, path. Pure functions of truth and record, no files.

Meanings: docs/report.md. The estimated map is placed in World by the true start pose alone, nothing is fitted.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from noctule import truth as truth_module
from noctule.truth import CELL_M, FloorTruth

TILE_CELLS = 64
TOUCHDOWN_RISE_M = 0.05      # higher than this above the resting height counts as flying
LEVEL_MATCH_M = 0.5          # an estimated level is compared with a true one within this distance

_truths: OrderedDict[str, FloorTruth] = OrderedDict()


@dataclass(frozen=True)
class StartPose:
    """World * Map: the true pose at the start; z_m is the elevation of the floor under it, frame World."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float

    def to_world(self, x_m, y_m):
        """Points of Map in World; arrays or numbers."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + c * x_m - s * y_m, self.y_m + s * x_m + c * y_m

    def to_map(self, x_m, y_m):
        """Points of World in Map; arrays or numbers."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        return c * dx + s * dy, c * dy - s * dx


def cached_floor_truth(primitives, floor_elevation_m: float, seed_x_m: float, seed_y_m: float,
                       range_m: float = truth_module.LASER_RANGE_M) -> FloorTruth:
    """As truth.floor_truth; the last few results are kept by the world's fingerprint."""
    key = truth_module.fingerprint(primitives, floor_elevation_m, seed_x_m, seed_y_m, range_m)
    if key not in _truths:
        _truths[key] = truth_module.floor_truth(primitives, floor_elevation_m, seed_x_m, seed_y_m, range_m)
        while len(_truths) > 8:
            _truths.popitem(last=False)
    _truths.move_to_end(key)
    return _truths[key]


def wrap_angle(angle_rad):
    """The same angle in (-pi, pi]; arrays or numbers.

    >>> round(float(wrap_angle(3.0 * math.pi)), 6)
    3.141593
    """
    return math.pi - np.mod(math.pi - np.asarray(angle_rad), 2.0 * math.pi)


class ExploredScore:
    """explored_fraction of one floor while its map grows tile by tile.

    A cell of S is right if it is known and its class occurs in truth within one cell.

    Args:
        floor: the truth of the floor.
        start: the true start pose.
        thresholds: shares of |S| whose first time is kept.
    """

    def __init__(self, floor: FloorTruth, start: StartPose, thresholds=(0.95, 0.99)):
        self.floor = floor
        self.start = start
        self.total = int(np.count_nonzero(floor.seeable))
        self.right = 0
        self.time_to_s: dict[float, float | None] = {t: None for t in thresholds}
        neighbours = np.ones((3, 3), bool)
        rows, columns = np.nonzero(floor.seeable)
        self._free_near = ndimage.binary_dilation(~floor.occupied, neighbours)[rows, columns]
        self._occupied_near = ndimage.binary_dilation(floor.occupied, neighbours)[rows, columns]
        self._map_x_m, self._map_y_m = start.to_map(floor.x0_m + (columns + 0.5) * CELL_M,
                                                    floor.y0_m + (rows + 0.5) * CELL_M)
        self._cell_right = np.zeros(self.total, bool)
        self._cell_m = 0.0
        self._tiles: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}

    def _index(self, cell_m: float) -> None:
        # Which cells of S fall into which tile, and where in it. Done again only if the map's cell size changes.
        i = np.floor(self._map_x_m / cell_m + 1e-9).astype(np.int64)
        j = np.floor(self._map_y_m / cell_m + 1e-9).astype(np.int64)
        tile_x, tile_y = i // TILE_CELLS, j // TILE_CELLS
        inside = (j % TILE_CELLS) * TILE_CELLS + i % TILE_CELLS
        self._tiles = {}
        if self.total:
            order = np.lexsort((tile_y, tile_x))
            change = np.nonzero(np.diff(tile_x[order]) | np.diff(tile_y[order]))[0] + 1
            for group in np.split(order, change):
                self._tiles[int(tile_x[group[0]]), int(tile_y[group[0]])] = (group, inside[group])
        self._cell_m = cell_m
        self._cell_right[:] = False
        self.right = 0

    def update(self, t_s: float, tile_x: int, tile_y: int, cell_m: float, log_odds: np.ndarray) -> None:
        """Take a tile of the map: log_odds (4096,) int, 0 unknown, positive occupied, negative free, row-major."""
        if not cell_m > 0.0:
            return
        if abs(cell_m - self._cell_m) > 1e-6:
            self._index(float(round(cell_m, 6)))
        entry = self._tiles.get((tile_x, tile_y))
        if entry is None:
            return
        cells, inside = entry
        value = np.asarray(log_odds).ravel()[inside]
        now = ((value < 0) & self._free_near[cells]) | ((value > 0) & self._occupied_near[cells])
        self.right += int(np.count_nonzero(now)) - int(np.count_nonzero(self._cell_right[cells]))
        self._cell_right[cells] = now
        for share, first in self.time_to_s.items():
            if first is None and self.total and self.right >= share * self.total:
                self.time_to_s[share] = t_s

    @property
    def explored_fraction(self) -> float:
        """right / |S|; 0 for a floor without a seeable cell."""
        return self.right / self.total if self.total else 0.0


@dataclass
class Spread:
    """Mean, 95th percentile and greatest of a set of errors; None where there is no sample."""

    mean: float | None = None
    p95: float | None = None
    max: float | None = None

    @classmethod
    def of(cls, values) -> "Spread":
        """Of (N,) values; non-finite ones make the whole spread None: an estimate of NaN has no error figure."""
        values = np.asarray(values, float)
        if values.size == 0 or not np.all(np.isfinite(values)):
            return cls()
        return cls(float(np.mean(values)), float(np.percentile(values, 95)), float(np.max(values)))

    def as_dict(self) -> dict:
        """{mean, p95, max}."""
        return {"mean": self.mean, "p95": self.p95, "max": self.max}


@dataclass
class PoseErrors:
    """Errors at each scan stamp from arming to touchdown, and the series behind them (all (N,) float)."""

    position_m: Spread = field(default_factory=Spread)
    yaw_rad: Spread = field(default_factory=Spread)
    altitude_m: Spread = field(default_factory=Spread)
    t_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    position_series_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    yaw_series_rad: np.ndarray = field(default_factory=lambda: np.zeros(0))
    altitude_series_m: np.ndarray = field(default_factory=lambda: np.zeros(0))


def flight_interval(t_s, z_m, armed) -> tuple[float, float] | None:
    """Times of arming and of touchdown [s], or None if the vehicle never armed.

    Touchdown is the end of the last time above the resting height; without a take-off, the end of being armed.

    Args:
        t_s, z_m: (N,) float, time and true height; the first row is at rest.
        armed: (N,) bool.
    """
    rows = np.nonzero(np.asarray(armed, bool))[0]
    if rows.size == 0:
        return None
    first, last = int(rows[0]), int(rows[-1])
    # Being disarmed in the air (a failsafe's end) does not end the flight: the fall belongs to it.
    flying = np.nonzero(np.asarray(z_m)[first:] > z_m[0] + TOUCHDOWN_RISE_M)[0]
    if flying.size:
        last = min(first + int(flying[-1]) + 1, len(t_s) - 1)
    return float(t_s[first]), float(t_s[last])


def pose_errors(nav: dict, truth: dict, start: StartPose) -> PoseErrors:
    """Errors of the estimate at each scan stamp from arming to touchdown; nothing is fitted.

    Args:
        nav: t_us (N,) int, x_m, y_m, z_m, yaw_rad (N,) float, frame Map.
        truth: t_s, x_m, y_m, z_m, yaw_rad (M,) float, frame World, and armed (M,); rows at the scan stamps.
        start: World * Map.
    """
    interval = flight_interval(truth["t_s"], truth["z_m"], truth["armed"])
    if interval is None or len(nav["t_us"]) == 0:
        return PoseErrors()
    stamps = np.round(np.asarray(truth["t_s"]) * 1e6).astype(np.int64)
    t_us = np.asarray(nav["t_us"])
    row = np.clip(np.searchsorted(stamps, t_us - 500), 0, len(stamps) - 1)
    keep = (np.abs(stamps[row] - t_us) <= 500) & (t_us >= interval[0] * 1e6 - 500) & (t_us <= interval[1] * 1e6 + 500)
    row = row[keep]
    x, y = start.to_world(np.asarray(nav["x_m"], float)[keep], np.asarray(nav["y_m"], float)[keep])
    position = np.hypot(x - truth["x_m"][row], y - truth["y_m"][row])
    yaw = np.abs(wrap_angle(np.asarray(nav["yaw_rad"], float)[keep] + start.yaw_rad - truth["yaw_rad"][row]))
    altitude = np.abs(np.asarray(nav["z_m"], float)[keep] + start.z_m - truth["z_m"][row])
    return PoseErrors(Spread.of(position), Spread.of(yaw), Spread.of(altitude), t_us[keep] * 1e-6,
                      position, yaw, altitude)


def path_length_m(truth: dict) -> float:
    """Length of the true path while armed [m], in three dimensions. 0 if never armed."""
    rows = np.nonzero(np.asarray(truth["armed"], bool))[0]
    if rows.size < 2:
        return 0.0
    part = slice(int(rows[0]), int(rows[-1]) + 1)
    points = np.stack([truth["x_m"][part], truth["y_m"][part], truth["z_m"][part]], axis=1)
    return float(np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def home_error_m(truth: dict) -> float | None:
    """Horizontal distance from the true start to where the vehicle is at the end [m]; None without truth."""
    if len(truth["t_s"]) == 0:
        return None
    return float(math.hypot(truth["x_m"][-1] - truth["x_m"][0], truth["y_m"][-1] - truth["y_m"][0]))


def true_levels_m(primitives, floors, start_z_m: float) -> list[float]:
    """Elevations in Map of every horizontal face: floors, slab undersides, tops and undersides of boxes [m], sorted."""
    faces = {round(float(f.elevation_m) - start_z_m, 4) for f in floors}
    for p in primitives:
        if p.kind == "box" and getattr(p, "tag", "") not in ("wall",):
            faces.add(round(float(p.centre_m[2] + p.half_extent_m[2]) - start_z_m, 4))
            faces.add(round(float(p.centre_m[2] - p.half_extent_m[2]) - start_z_m, 4))
    return sorted(faces)


def match_levels(estimated_m, true_m) -> list[dict]:
    """Each estimated level with the nearest true one within LEVEL_MATCH_M, else None.

    >>> match_levels([0.01, 9.0], [0.0, 2.41])
    [{'elevation_m': 0.01, 'true_elevation_m': 0.0}, {'elevation_m': 9.0, 'true_elevation_m': None}]
    """
    rows = []
    for z in sorted(float(v) for v in estimated_m):
        near = min(true_m, key=lambda v: abs(v - z), default=None)
        rows.append({"elevation_m": z,
                     "true_elevation_m": near if near is not None and abs(near - z) <= LEVEL_MATCH_M else None})
    return rows
