"""How true the map is, and how much floor the camera has seen. Pure functions of truth and record."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from noctule.score import StartPose
from noctule.truth import CELL_M, FloorTruth

CAMERA_RANGE_M = 4.0
CAMERA_FOV_RAD = 1.2
RAYS = 64
POSE_STEP_S = 0.2            # the camera's frame time


def wall_shares(floor: FloorTruth, start: StartPose, log_odds: np.ndarray, x0_m: float, y0_m: float, cell_m: float) -> tuple[float | None, float | None]:
    """(share of true visible wall cells marked within one cell, share of marked cells that are true within one cell).

    Visible wall cells are the occupied cells of S (first hits, docs/report.md). A marked cell is true if its centre, placed in World
    by the start pose alone, lies in an occupied cell or beside one. None where there is nothing to divide by.

    Args:
        log_odds: (rows, columns) int, positive: occupied; its corner is (x0_m, y0_m) in Map.
    """
    near = np.ones((3, 3), bool)
    marked = np.asarray(log_odds) > 0
    found = true = None
    rows, columns = np.nonzero(floor.occupied & floor.seeable)
    if rows.size:
        x, y = start.to_map(floor.x0_m + (columns + 0.5) * CELL_M, floor.y0_m + (rows + 0.5) * CELL_M)
        hit = _lookup(ndimage.binary_dilation(marked, near), (y - y0_m) / cell_m, (x - x0_m) / cell_m)
        found = float(np.mean(hit))
    rows, columns = np.nonzero(marked)
    if rows.size:
        x, y = start.to_world(x0_m + (columns + 0.5) * cell_m, y0_m + (rows + 0.5) * cell_m)
        hit = _lookup(ndimage.binary_dilation(floor.occupied, near), (y - floor.y0_m) / CELL_M, (x - floor.x0_m) / CELL_M)
        true = float(np.mean(hit))
    return found, true


def _lookup(table: np.ndarray, row, column) -> np.ndarray:
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    inside = (i >= 0) & (i < table.shape[0]) & (j >= 0) & (j < table.shape[1])
    return inside & table[np.clip(i, 0, table.shape[0] - 1), np.clip(j, 0, table.shape[1] - 1)]


def camera_seen_fraction(floor: FloorTruth, truth: dict, z_floor_m: float, range_m: float = CAMERA_RANGE_M, fov_rad: float = CAMERA_FOV_RAD) -> float | None:
    """Share of the free cells of S that were in the front camera's view: within its range and horizontal field, in line of sight.

    True poses of every 0.2 s while armed and within 2 m over z_floor_m (frame World); 64 rays a pose in steps of half a cell, a ray ends
    at an occupied cell. Angles and steps are as fine as a cell at the greatest range. None without free cells.
    """
    wanted = floor.seeable & ~floor.occupied
    total = int(np.count_nonzero(wanted))
    if total == 0:
        return None
    t, armed, z = truth["t_s"], np.asarray(truth["armed"], bool), truth["z_m"]
    rows = np.nonzero(armed & (z > z_floor_m + 0.3) & (z < z_floor_m + 2.0))[0]
    rows = rows[np.unique(np.floor(t[rows] / POSE_STEP_S), return_index=True)[1]] if rows.size else rows
    seen = np.zeros(floor.occupied.shape, bool)
    distance = np.arange(0.0, range_m, 0.5 * CELL_M)
    bearing = np.linspace(-fov_rad / 2, fov_rad / 2, RAYS)
    for k in rows:
        angle = bearing + truth["yaw_rad"][k]
        i = np.floor((truth["y_m"][k] + np.outer(np.sin(angle), distance) - floor.y0_m) / CELL_M).astype(int)
        j = np.floor((truth["x_m"][k] + np.outer(np.cos(angle), distance) - floor.x0_m) / CELL_M).astype(int)
        inside = (i >= 0) & (i < seen.shape[0]) & (j >= 0) & (j < seen.shape[1])
        i, j = np.where(inside, i, 0), np.where(inside, j, 0)
        open_way = np.logical_and.accumulate(inside & ~floor.occupied[i, j], axis=1)
        seen[i[open_way], j[open_way]] = True
    return float(np.count_nonzero(seen & wanted)) / total
