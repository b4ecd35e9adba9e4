"""What a world's floor really offers: the lattice that `explored_fraction` is measured on. Pure functions.

The plane of the score lies `PLANE_HEIGHT_M` above the floor. Solids are the world's primitives cut by that plane:
turned rectangles and discs, whose distance is known exactly. The fine lattice has `FINE_M`, the cell of the score
`CELL_M`; both are on World axes, cell (row, column) covers
[x0_m + column * CELL_M, x0_m + (column + 1) * CELL_M) x [y0_m + row * CELL_M, ...).
Definition: docs/design.md, "explored_fraction".
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

CELL_M = 0.10
FINE_M = 0.02
RATIO = 5                    # fine lattice points per cell and axis
PLANE_HEIGHT_M = 1.0
REACH_CLEARANCE_M = 0.36     # a point of the lattice is reachable at this distance from anything solid
LASER_RANGE_M = 10.0
RAYS = 720                   # directions tried from a point before it is called unseeable
NEAR_M = 0.60                # exact distances are kept up to here
START_SEARCH_M = 0.5         # the start may stand a little closer to a wall than REACH_CLEARANCE_M


@dataclass(frozen=True)
class Shape:
    """A solid cut by the plane of the score, frame World: a turned rectangle or (disc=True) a circle of radius half_x_m."""

    x_m: float
    y_m: float
    half_x_m: float
    half_y_m: float
    yaw_rad: float
    disc: bool = False


@dataclass(frozen=True)
class FloorTruth:
    """The truth of one floor. All arrays (rows, columns), row along World y, column along World x."""

    x0_m: float               # left edge of column 0, frame World
    y0_m: float               # lower edge of row 0, frame World
    occupied: np.ndarray      # bool: something solid lies in the cell
    reachable: np.ndarray     # bool: the vehicle's centre may be somewhere in the cell
    seeable: np.ndarray       # bool: the set S of the score

    @property
    def explorable_area_m2(self) -> float:
        """Area of S [m^2]."""
        return float(np.count_nonzero(self.seeable)) * CELL_M * CELL_M


def slice_primitives(primitives, z_m: float) -> list[Shape]:
    """Shapes of the primitives that the horizontal plane at z_m (frame World) cuts.

    Args:
        primitives: objects with kind 'box' or 'cylinder', centre_m (3,), half_extent_m (3,), yaw_rad, frame World.
        z_m: elevation of the plane [m].
    """
    shapes = []
    for p in primitives:
        if abs(z_m - float(p.centre_m[2])) > float(p.half_extent_m[2]):
            continue
        shapes.append(Shape(float(p.centre_m[0]), float(p.centre_m[1]), float(p.half_extent_m[0]),
                            float(p.half_extent_m[1]), float(p.yaw_rad), p.kind == "cylinder"))
    return shapes


def distance_to_shape(shape: Shape, x_m, y_m):
    """Distance from points to a shape [m], negative inside; x_m and y_m broadcast against each other, frame World."""
    dx, dy = x_m - shape.x_m, y_m - shape.y_m
    if shape.disc:
        return np.hypot(dx, dy) - shape.half_x_m
    c, s = math.cos(shape.yaw_rad), math.sin(shape.yaw_rad)
    ax = np.abs(c * dx + s * dy) - shape.half_x_m
    ay = np.abs(c * dy - s * dx) - shape.half_y_m
    return np.hypot(np.maximum(ax, 0.0), np.maximum(ay, 0.0)) + np.minimum(np.maximum(ax, ay), 0.0)


def distance_field(shapes: list[Shape], x0_m: float, y0_m: float, rows: int, columns: int) -> np.ndarray:
    """Distance to the nearest solid on the fine lattice, exact up to NEAR_M and cut there. (rows, columns) float32 [m].

    Point (i, j) lies at (x0_m + (j + 0.5) FINE_M, y0_m + (i + 0.5) FINE_M), frame World.
    """
    field = np.full((rows, columns), NEAR_M, np.float32)
    xs = x0_m + (np.arange(columns) + 0.5) * FINE_M
    ys = y0_m + (np.arange(rows) + 0.5) * FINE_M
    for shape in shapes:
        c, s = abs(math.cos(shape.yaw_rad)), abs(math.sin(shape.yaw_rad))
        reach_x = (shape.half_x_m if shape.disc else c * shape.half_x_m + s * shape.half_y_m) + NEAR_M
        reach_y = (shape.half_x_m if shape.disc else s * shape.half_x_m + c * shape.half_y_m) + NEAR_M
        j0, j1 = np.searchsorted(xs, (shape.x_m - reach_x, shape.x_m + reach_x))
        i0, i1 = np.searchsorted(ys, (shape.y_m - reach_y, shape.y_m + reach_y))
        if i0 >= i1 or j0 >= j1:
            continue
        window = field[i0:i1, j0:j1]
        np.minimum(window, distance_to_shape(shape, xs[None, j0:j1], ys[i0:i1, None]), out=window, casting="same_kind")
    return field


def _reachable_points(field: np.ndarray, start_row: float, start_column: float) -> np.ndarray:
    """Points of the fine lattice that keep REACH_CLEARANCE_M and are 8-connected to the start. (rows, columns) bool."""
    labels, _ = ndimage.label(field >= REACH_CLEARANCE_M - 1e-6, structure=np.ones((3, 3), int))
    radius = int(START_SEARCH_M / FINE_M)
    i, j = int(math.floor(start_row)), int(math.floor(start_column))
    i0, j0 = max(i - radius, 0), max(j - radius, 0)
    window = labels[i0:i + radius + 1, j0:j + radius + 1]
    candidates = np.argwhere(window > 0)
    if candidates.size == 0:
        return np.zeros(field.shape, bool)
    d2 = np.sum((candidates + (i0 + 0.5 - start_row, j0 + 0.5 - start_column)) ** 2, axis=1)
    best = candidates[int(np.argmin(d2))]
    return labels == window[best[0], best[1]]


def _sees_reachable(points: np.ndarray, step_solid: np.ndarray, to_reach: np.ndarray, range_m: float) -> np.ndarray:
    """Which fine lattice points see a reachable point within range_m, along any of RAYS directions. (N,) bool.

    Sphere tracing: a ray may advance by the smaller of the distances to the nearest solid and to the nearest reachable
    point; it ends when it meets either.

    Args:
        points: (N, 2) int, row and column of free points.
        step_solid: (rows, columns) float32, lower bound of the distance to anything solid [fine cells].
        to_reach: (rows, columns) float32, distance to the nearest reachable point [fine cells].
        range_m: laser range [m].
    """
    seen = np.zeros(len(points), bool)
    rows, columns = step_solid.shape
    range_cells = range_m / FINE_M
    combined = np.minimum(step_solid, to_reach).astype(np.float32)
    angles = np.arange(RAYS) * (2.0 * math.pi / RAYS)
    order = np.argsort(np.arange(RAYS) % 45, kind="stable")      # spread the first tries over the circle
    groups = np.split(order, [16, 80, 240])
    for group in groups:
        for begin in range(0, len(points), max(1, 4_000_000 // len(group))):
            part = np.arange(begin, min(len(points), begin + max(1, 4_000_000 // len(group))))
            part = part[~seen[part]]
            if part.size == 0:
                continue
            ray_point = np.repeat(part, len(group))
            ray_angle = np.tile(angles[group], part.size)
            si = (points[ray_point, 0] + 0.5).astype(np.float32)
            sj = (points[ray_point, 1] + 0.5).astype(np.float32)
            ui, uj = np.sin(ray_angle).astype(np.float32), np.cos(ray_angle).astype(np.float32)
            travelled = np.ones(len(ray_point), np.float32)      # leave the point itself, which touches its own wall
            while ray_point.size:
                i = (si + ui * travelled).astype(np.int32)
                j = (sj + uj * travelled).astype(np.int32)
                inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns) & (travelled <= range_cells)
                np.clip(i, 0, rows - 1, out=i)
                np.clip(j, 0, columns - 1, out=j)
                reached = inside & (to_reach[i, j] < 1.0)
                seen[ray_point[reached]] = True
                alive = inside & ~reached & (step_solid[i, j] > 0.0) & ~seen[ray_point]
                step = np.maximum(combined[i, j], 0.5)
                ray_point, si, sj, ui, uj = ray_point[alive], si[alive], sj[alive], ui[alive], uj[alive]
                travelled = (travelled + step)[alive]
    return seen


def floor_truth(primitives, floor_elevation_m: float, seed_x_m: float, seed_y_m: float,
                range_m: float = LASER_RANGE_M) -> FloorTruth:
    """Truth of a floor: occupied, reachable and seeable cells, as docs/design.md defines them.

    Args:
        primitives: the world's solids, see slice_primitives.
        floor_elevation_m: elevation of the floor, frame World.
        seed_x_m, seed_y_m: a point of the floor that the vehicle has been at (the start), frame World.
        range_m: laser range [m].
    """
    shapes = slice_primitives(primitives, floor_elevation_m + PLANE_HEIGHT_M)
    reach = [math.hypot(s.half_x_m, 0.0 if s.disc else s.half_y_m) for s in shapes]
    x_low = min([seed_x_m - range_m] + [s.x_m - r for s, r in zip(shapes, reach)])
    x_high = max([seed_x_m + range_m] + [s.x_m + r for s, r in zip(shapes, reach)])
    y_low = min([seed_y_m - range_m] + [s.y_m - r for s, r in zip(shapes, reach)])
    y_high = max([seed_y_m + range_m] + [s.y_m + r for s, r in zip(shapes, reach)])
    # A lattice on World axes: the corner is a whole number of cells, so every floor of a world shares the cells.
    c0, r0 = math.floor(x_low / CELL_M) - 2, math.floor(y_low / CELL_M) - 2
    columns = math.ceil(x_high / CELL_M) + 2 - c0
    rows = math.ceil(y_high / CELL_M) + 2 - r0
    x0, y0 = c0 * CELL_M, r0 * CELL_M
    field = distance_field(shapes, x0, y0, rows * RATIO, columns * RATIO)
    return _classify(field, x0, y0, (seed_y_m - y0) / FINE_M, (seed_x_m - x0) / FINE_M, range_m)


def _cells_any(fine: np.ndarray) -> np.ndarray:
    rows, columns = fine.shape[0] // RATIO, fine.shape[1] // RATIO
    return fine.reshape(rows, RATIO, columns, RATIO).any(axis=(1, 3))


def _classify(field, x0_m, y0_m, start_row, start_column, range_m) -> FloorTruth:
    solid = field <= 0.0
    occupied = _cells_any(solid)
    reach_fine = _reachable_points(field, start_row, start_column)
    reachable = _cells_any(reach_fine)
    seeable = reachable & ~occupied
    if not reach_fine.any():
        return FloorTruth(x0_m, y0_m, occupied, reachable, seeable)

    # Lower bound of the distance to solids, in fine cells: exact near, from the lattice (less its own error) far away.
    far = ndimage.distance_transform_edt(~solid).astype(np.float32) - 1.5
    step_solid = np.where(field < NEAR_M, field / FINE_M, np.maximum(far, NEAR_M / FINE_M)).astype(np.float32)
    to_reach = ndimage.distance_transform_edt(~reach_fine).astype(np.float32)

    # Sight runs through free space, so only what touches the free space round the start can be seen at all.
    free_labels, _ = ndimage.label(~solid, structure=np.ones((3, 3), int))
    free = free_labels == free_labels[tuple(np.argwhere(reach_fine)[0])]
    touches = ndimage.binary_dilation(solid) & free        # free points that lie against a solid one

    # A free cell is asked at its centre, and at its corners where the centre is not seen.
    undecided = ~occupied & ~reachable & (_cells_any(free))
    for di, dj in ((2, 2), (0, 0), (0, 4), (4, 0), (4, 4)):
        cells = np.argwhere(undecided & ~seeable)
        if cells.size:
            seen = _sees_reachable(cells * RATIO + (di, dj), step_solid, to_reach, range_m)
            seeable[tuple(cells[seen].T)] = True

    # An occupied cell is a first hit if a free point against one of its solid points is in sight.
    fine_i, fine_j = np.nonzero(touches)
    points = np.stack([fine_i, fine_j], axis=1)
    pairs = []
    for di, dj in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        i, j = fine_i + di, fine_j + dj
        inside = (i >= 0) & (i < field.shape[0]) & (j >= 0) & (j < field.shape[1])
        index = np.nonzero(inside)[0]
        index = index[solid[i[index], j[index]]]
        pairs.append(np.stack([index, (i[index] // RATIO) * occupied.shape[1] + j[index] // RATIO], axis=1))
    pairs = np.concatenate(pairs)
    pairs = np.unique(pairs, axis=0)
    hit = np.zeros(occupied.size, bool)
    # The middle of a cell's face first: it settles nearly every cell, the rest is asked in full.
    by_cell = pairs[np.argsort(pairs[:, 1], kind="stable")]
    _, first, count = np.unique(by_cell[:, 1], return_index=True, return_counts=True)
    for chosen in (first + count // 2, np.arange(len(by_cell))):
        ask = by_cell[chosen]
        ask = ask[~hit[ask[:, 1]]]
        if ask.size:
            seen = _sees_reachable(points[ask[:, 0]], step_solid, to_reach, range_m)
            hit[ask[seen, 1]] = True
    seeable |= hit.reshape(occupied.shape) & occupied
    return FloorTruth(x0_m, y0_m, occupied, reachable, seeable)


def fingerprint(primitives, floor_elevation_m: float, seed_x_m: float, seed_y_m: float, range_m: float) -> str:
    """A name for a floor's truth that changes with anything the truth depends on (cache key)."""
    digest = hashlib.sha256(f"2 {floor_elevation_m!r} {seed_x_m!r} {seed_y_m!r} {range_m!r}".encode())
    for p in primitives:
        digest.update(f"{p.kind} {[float(v) for v in p.centre_m]} {[float(v) for v in p.half_extent_m]} "
                      f"{float(p.yaw_rad)!r}".encode())
    return digest.hexdigest()[:24]
