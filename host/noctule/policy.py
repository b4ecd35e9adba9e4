"""A policy of one's own: what decides where to look next, in Python, without touching the firmware.

The counterpart of firmware/plan/policy.hpp: a class with begin() and step() that gets a view of the map, the pose and a
budget, and answers with a goal and where to look from there. It moves nothing: the explorer finds the way and flies it,
the guard has the last word. Fly it with `noctule fly WORLD --policy package.module:Class`; page: docs/extending.md.
Frame Map, SI units.
"""

from __future__ import annotations

import heapq
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numba import njit

ARRIVED_M = 0.2
UNDER_WAY, UNREACHABLE, STUCK, REFUSED = "under way", "unreachable", "stuck", "refused"
FATES = (UNDER_WAY, UNREACHABLE, STUCK, REFUSED)       # in the order of policy_ask_t.fate
TILE = 64


@dataclass(frozen=True)
class Pose:
    """x, y [m], yaw [rad], frame Map."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True)
class Goal:
    """Where to fly, and which way to look there: at a point, or by a yaw; neither: along the way that led there."""

    x_m: float
    y_m: float
    look: tuple[float, float] | None = None
    yaw_rad: float | None = None

    def look_at(self, pose: Pose) -> tuple[float, float]:
        """The point to look at from the goal [m]."""
        if self.look is not None:
            return float(self.look[0]), float(self.look[1])
        yaw = self.yaw_rad if self.yaw_rad is not None else math.atan2(self.y_m - pose.y_m, self.x_m - pose.x_m)
        return self.x_m + 10.0 * math.cos(yaw), self.y_m + 10.0 * math.sin(yaw)


FINISHED = object()        # an answer of step(): nothing reachable and worth it is left


class Policy(ABC):
    """To be derived from, or to be imitated: only begin() and step() are called."""

    def begin(self, home: Pose) -> None:
        """A new exploration: after take-off, and on every further floor."""

    @abstractmethod
    def step(self, view: MapView, pose: Pose, budget_cells: int):
        """One step of 50 ms.

        Args:
            view: the map and what became of the goal before. Holds until the call returns.
            pose: the vehicle's.
            budget_cells: about so many cells may be looked at; 0: only what is cheap. In simulation the flight waits for the
                answer (up to 1.5 s), on a vehicle it does not.

        Returns:
            a Goal (the same one again changes nothing), None to fly on as before, or FINISHED.
        """


@njit(cache=True)
def _costs(passable, row, column, cell_m):
    """Shortest way over the eight neighbours from one cell, (H, W) float32 [m], inf where none leads; ways through passable cells."""
    height, width = passable.shape
    costs = np.full((height, width), np.inf, np.float32)
    costs[row, column] = 0.0
    heap = [(np.float32(0.0), np.int64(row * width + column))]
    while len(heap) > 0:
        cost, at = heapq.heappop(heap)
        y, x = at // width, at % width
        if cost > costs[y, x]:
            continue
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                ny, nx = y + dy, x + dx
                if (dx == 0 and dy == 0) or ny < 0 or nx < 0 or ny >= height or nx >= width or not passable[ny, nx]:
                    continue
                there = np.float32(cost + cell_m * (1.41421356 if dx != 0 and dy != 0 else 1.0))
                if there < costs[ny, nx]:
                    costs[ny, nx] = there
                    heapq.heappush(heap, (there, np.int64(ny * width + nx)))
    return costs


@dataclass(frozen=True)
class Frontier:
    """A connected piece of the edge of the unknown. x, y: the middle of it; cells: how long it is."""

    x_m: float
    y_m: float
    cells: int
    view_x_m: float      # the cheapest passable place near it, where to look at it from
    view_y_m: float
    way_m: float         # from the vehicle to that place


class MapView:
    """What a policy may look at: the grid of the floor that is explored, as noctule-nav published it.

    Arrays are (H, W), row by row along y; cell (row, column) covers x from x0_m + column * cell_m. Derived ones are
    computed when first asked for and kept until the map changes.

    Args:
        parameters: of the flight, by name.
    """

    def __init__(self, parameters: dict[str, float]):
        self.parameters = parameters
        self.cell_m = float(parameters["grid_cell_m"])
        self.t_s = 0.0
        self.floor = 0
        self.home = Pose(0.0, 0.0)
        self.start = Pose(0.0, 0.0)             # where ways begin: the last setpoint
        self.fate = UNDER_WAY                   # of the goal answered last
        self.goal: tuple[float, float] | None = None    # under way
        self.at_goal_s = 0.0                    # for so long the vehicle has been at it
        self.known_area_m2 = 0.0
        self._tiles: dict[int, dict[tuple[int, int], np.ndarray]] = {}
        self._kept: dict[str, object] = {}
        self._grid = np.zeros((TILE, TILE), np.int8)
        self._corner = (0, 0)                   # tile_x, tile_y of the grid's first tile

    def put(self, floor: int, tile_x: int, tile_y: int, log_odds: np.ndarray) -> None:
        """A GRID_TILE came: (4096,) int8."""
        self._tiles.setdefault(floor, {})[tile_x, tile_y] = log_odds.reshape(TILE, TILE)
        if floor == self.floor:
            self._kept.clear()

    def enter(self, floor: int) -> None:
        """The floor that is explored from now on."""
        if floor != self.floor:
            self.floor = floor
            self._kept.clear()

    def moved(self, start: Pose) -> None:
        """Ways begin there from now on."""
        if start != self.start:
            self.start = start
            self._kept.pop("way", None)

    def _once(self, name: str, make):
        if name not in self._kept:
            self._kept[name] = make()
        return self._kept[name]

    def _lay(self) -> np.ndarray:
        tiles = self._tiles.get(self.floor) or {(0, 0): np.zeros((TILE, TILE), np.int8)}
        xs, ys = [x for x, _ in tiles], [y for _, y in tiles]
        self._corner = min(xs), min(ys)
        grid = np.zeros(((max(ys) - min(ys) + 1) * TILE, (max(xs) - min(xs) + 1) * TILE), np.int8)
        for (x, y), values in tiles.items():
            row, column = (y - self._corner[1]) * TILE, (x - self._corner[0]) * TILE
            grid[row:row + TILE, column:column + TILE] = values
        return grid

    @property
    def log_odds(self) -> np.ndarray:
        """int8 [1/16 nat]: 0 unknown, positive occupied, negative free."""
        return self._once("log_odds", self._lay)

    @property
    def x0_m(self) -> float:
        """x of the lower edge of column 0."""
        return self.log_odds is not None and self._corner[0] * TILE * self.cell_m

    @property
    def y0_m(self) -> float:
        """y of the lower edge of row 0."""
        return self.log_odds is not None and self._corner[1] * TILE * self.cell_m

    @property
    def occupied(self) -> np.ndarray:
        """bool: a wall or a thing."""
        return self._once("occupied", lambda: self.log_odds >= max(1, round(16 * self.parameters["grid_occupied_log_odds"])))

    @property
    def free(self) -> np.ndarray:
        """bool: seen to be empty."""
        return self._once("free", lambda: self.log_odds <= min(-1, round(16 * self.parameters["grid_free_log_odds"])))

    @property
    def unknown(self) -> np.ndarray:
        """bool: neither."""
        return self._once("unknown", lambda: ~(self.occupied | self.free))

    @property
    def clearance_m(self) -> np.ndarray:
        """Distance of each cell's centre to that of the nearest occupied or unknown one [m]."""
        from scipy.ndimage import distance_transform_edt

        return self._once("clearance", lambda: distance_transform_edt(self.free) * self.cell_m)

    @property
    def passable(self) -> np.ndarray:
        """bool: the hull fits. Judged by cells; the firmware judges by hit points and moves a goal by up to half a metre."""
        room_m = self.parameters["hull_radius_m"] + self.parameters["plan_margin_m"]
        return self._once("passable", lambda: self.clearance_m >= room_m)

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Row and column of a point; may lie outside the array."""
        return math.floor((y_m - self.y0_m) / self.cell_m), math.floor((x_m - self.x0_m) / self.cell_m)

    def place(self, row, column):
        """x, y of a cell's centre [m]; arrays give arrays."""
        return self.x0_m + (column + 0.5) * self.cell_m, self.y0_m + (row + 0.5) * self.cell_m

    @property
    def way_m(self) -> np.ndarray:
        """Length of the shortest way from the vehicle over passable cells [m], inf where there is none."""

        def make():
            near = np.hypot(*(a - b for a, b in zip(self.place(*np.indices(self.free.shape)), (self.start.x_m, self.start.y_m))))
            passable = self.passable | (self.free & (near < 0.5))     # where the vehicle is it may leave
            row, column = np.unravel_index(int(np.argmin(np.where(passable, near, np.inf))), near.shape)
            return _costs(passable, int(row), int(column), np.float32(self.cell_m))

        return self._once("way", make)

    def frontiers(self, min_cells: int = 4, view_m: float = 1.5) -> list[Frontier]:
        """Pieces of the edge of the unknown that can be looked at from a reachable place within view_m, nearest first."""
        from scipy import ndimage

        edge = self.free & ndimage.binary_dilation(self.unknown)
        labels, count = ndimage.label(edge, np.ones((3, 3)))
        reach = int(view_m / self.cell_m)
        found = []
        for number, box in enumerate(ndimage.find_objects(labels), 1):
            rows, columns = np.nonzero(labels[box] == number)
            if len(rows) < min_cells:
                continue
            middle = np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2)
            row, column = int(rows[middle] + box[0].start), int(columns[middle] + box[1].start)
            r0, c0 = max(row - reach, 0), max(column - reach, 0)
            around = self.way_m[r0:row + reach + 1, c0:column + reach + 1]
            at = np.unravel_index(int(np.argmin(around)), around.shape)
            if np.isfinite(around[at]):
                found.append(Frontier(*map(float, self.place(row, column)), len(rows), *map(float, self.place(r0 + at[0], c0 + at[1])), float(around[at])))
        return sorted(found, key=lambda f: f.way_m)
