"""The tour of somebody who knows the building: what an exploration is compared with for orientation.

Places on a lattice of reachable cells, chosen greedily until they see 99 % of S (line of sight, 10 m, all round), joined by shortest
paths in an open tour (nearest insertion, then 2-opt). A plain model, not the least possible, and it turns and brakes for nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from noctule.truth import CELL_M, FloorTruth, LASER_RANGE_M

LOOK_EVERY_M = 1.0        # lattice of the viewpoints
RAYS = 1440


@njit(cache=True)
def _visible(occupied, number, row, column, rays, reach_cells, out):
    """out (S,) bool, set where a cell of S (number: its index or -1) is in line of sight of a cell: up to the first hit and with it."""
    rows, columns = occupied.shape
    for k in range(rays):
        angle = 2.0 * math.pi * k / rays
        dy, dx = math.sin(angle), math.cos(angle)
        r = 0.0
        while r < reach_cells:
            i, j = int(row + 0.5 + r * dy), int(column + 0.5 + r * dx)
            if i < 0 or j < 0 or i >= rows or j >= columns:
                break
            if number[i, j] >= 0:
                out[number[i, j]] = True
            if occupied[i, j]:
                break
            r += 0.5


def _graph(reachable: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray, np.ndarray]:
    """Reachable cells joined to their eight neighbours [m]; their rows and columns."""
    rows, columns = np.nonzero(reachable)
    number = np.full(np.array(reachable.shape) + 2, -1)
    number[rows + 1, columns + 1] = np.arange(len(rows))
    heads, tails, costs = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        to = number[rows + 1 + dy, columns + 1 + dx]
        heads.append(np.nonzero(to >= 0)[0])
        tails.append(to[to >= 0])
        costs.append(np.full(len(tails[-1]), CELL_M * math.hypot(dx, dy)))
    return sparse.csr_matrix((np.concatenate(costs), (np.concatenate(heads), np.concatenate(tails))), (len(rows), len(rows))), rows, columns


def viewpoints(floor: FloorTruth, rows: np.ndarray, columns: np.ndarray, home: int, share: float = 0.99) -> list[int]:
    """Cells (indices into rows and columns), the home first, each the one that shows most of what those before it do not."""
    number = np.full(floor.seeable.shape, -1)
    number[floor.seeable] = np.arange(int(floor.seeable.sum()))
    step = max(1, round(LOOK_EVERY_M / CELL_M))
    places = np.concatenate([[home], np.nonzero((rows % step == 0) & (columns % step == 0))[0]])
    sees = np.zeros((len(places), int(floor.seeable.sum())), bool)
    for k, p in enumerate(places):
        _visible(floor.occupied, number, int(rows[p]), int(columns[p]), RAYS, LASER_RANGE_M / CELL_M, sees[k])
    gains, unseen, chosen = sees.sum(axis=1), np.ones(sees.shape[1], bool), []
    best = 0
    while unseen.sum() > (1.0 - share) * len(unseen) and gains[best] > 0:
        chosen.append(int(places[best]))
        new = sees[best] & unseen
        gains = gains - sees[:, new].sum(axis=1)
        unseen &= ~new
        best = int(np.argmax(gains))
    return chosen


def open_tour_m(distance: np.ndarray) -> float:
    """Length of an open tour over all nodes from node 0: nearest insertion, then 2-opt.

    >>> x = np.array([0.0, 3.0, 1.0, 2.0])
    >>> open_tour_m(abs(x[:, None] - x[None, :]))
    3.0
    """
    order, left = [0], set(range(1, len(distance)))
    while left:
        _, i, s = min((distance[order[i], s] + (distance[s, order[i + 1]] - distance[order[i], order[i + 1]] if i + 1 < len(order) else 0.0), i, s)
                      for s in left for i in range(len(order)))
        order.insert(i + 1, s)
        left.remove(s)
    better = True
    while better:
        better = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                gain = distance[order[i - 1], order[i]] - distance[order[i - 1], order[j]]
                if j + 1 < len(order):
                    gain += distance[order[j], order[j + 1]] - distance[order[i], order[j + 1]]
                if gain > 1e-6:
                    order[i:j + 1] = order[i:j + 1][::-1]
                    better = True
    return float(sum(distance[a, b] for a, b in zip(order, order[1:])))


def clairvoyant_m(floor: FloorTruth, start_x_m: float, start_y_m: float) -> float:
    """Length of that tour from the start, frame World [m]."""
    graph, rows, columns = _graph(floor.reachable)
    home = int(np.argmin((rows - (start_y_m - floor.y0_m) / CELL_M) ** 2 + (columns - (start_x_m - floor.x0_m) / CELL_M) ** 2))
    nodes = viewpoints(floor, rows, columns, home)
    return open_tour_m(dijkstra(graph, directed=False, indices=nodes)[:, nodes])
