"""Rays and distances against a world's primitives: the one ray caster of all range sensors, and the clearance.

The primitives are copied into flat arrays once, and sorted into the squares of a horizontal grid. A ray walks that grid
square by square, so its cost depends on what stands along it, not on the size of the building. Compiled by numba,
without fast-math: the same input gives the same bits. Model: docs/maths/vehicle.md, sections 6 and 7. Frame World.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from .world import World

SQUARE_M = 0.5
NO_RETURN = math.inf
_SOAKING = 1  # material class of surfaces that give no return


class Geometry:
    """A world, prepared for rays and distances.

    Args:
        world: the building.
    """

    def __init__(self, world: World):
        primitives = world.primitives()
        n = len(primitives)
        self.primitives = primitives
        # columns: cx cy cz hx hy hz cos sin
        self.shape = np.zeros((n, 8))
        self.cylinder = np.zeros(n, np.int8)
        self.soaking = np.zeros(n, np.int8)
        self.slab = np.zeros(n, np.int8)
        reach = np.zeros((n, 2))
        for i, p in enumerate(primitives):
            c, s = math.cos(p.yaw_rad), math.sin(p.yaw_rad)
            self.shape[i] = (*p.centre_m, *p.half_extent_m, c, s)
            self.cylinder[i] = p.kind == "cylinder"
            self.soaking[i] = _SOAKING if world.materials[p.material].laser != "diffuse" else 0
            self.slab[i] = p.tag == "slab"
            hx, hy, _ = p.half_extent_m
            reach[i] = (hx, hy) if self.cylinder[i] else (abs(c) * hx + abs(s) * hy, abs(s) * hx + abs(c) * hy)
        low, high = self.shape[:, :2] - reach, self.shape[:, :2] + reach
        self.x0_m, self.y0_m = (low.min(axis=0) - SQUARE_M).tolist()
        far = high.max(axis=0) + SQUARE_M
        self.columns = int(math.ceil((far[0] - self.x0_m) / SQUARE_M))
        self.rows = int(math.ceil((far[1] - self.y0_m) / SQUARE_M))
        squares: list[list[int]] = [[] for _ in range(self.columns * self.rows)]
        pad = 1e-6
        for i in range(n):
            j0, j1 = (int((v - self.x0_m) / SQUARE_M) for v in (low[i, 0] - pad, high[i, 0] + pad))
            i0, i1 = (int((v - self.y0_m) / SQUARE_M) for v in (low[i, 1] - pad, high[i, 1] + pad))
            for row in range(i0, i1 + 1):
                for column in range(j0, j1 + 1):
                    squares[row * self.columns + column].append(i)
        self.first = np.zeros(len(squares) + 1, np.int32)
        self.first[1:] = np.cumsum([len(s) for s in squares])
        self.member = np.array([i for s in squares for i in s], np.int32)
        self._grid = (self.x0_m, self.y0_m, self.columns, self.rows, self.first, self.member)
        self._solid = (self.shape, self.cylinder, self.soaking)

    def cast(self, origin_m, direction, max_range_m: float) -> float:
        """Distance [m] along one ray to the first surface; infinity: nothing within max_range_m, or no return.

        Args:
            origin_m: (3,) frame World.
            direction: (3,) unit vector, frame World.
        """
        ox, oy, oz = origin_m
        dx, dy, dz = direction
        return _cast(ox, oy, oz, dx, dy, dz, max_range_m, *self._grid, *self._solid)

    def sweep(self, poses: np.ndarray, mount: np.ndarray, bearings_rad: np.ndarray, max_range_m: float, out: np.ndarray) -> None:
        """Ranges [m] of a planar laser that moves while it turns, written to out; infinity as in cast.

        Args:
            poses: (P, 8) t, x, y, z, qw, qx, qy, qz of Body in World, evenly spaced in t from the first beam (or
                earlier) to the last; poses between are interpolated for each beam's own time.
            mount: (4,) x, y, z [m] and yaw [rad] of Lidar in Body.
            bearings_rad: (B,) frame Lidar, in the order of time: beam i is cast at
                t_first + (t_last - t_first) * i / (B - 1), where t_last is the last pose's time.
            out: (B,) float64. out[0] on entry is t_first.
        """
        _sweep(poses, mount, bearings_rad, max_range_m, out, *self._grid, *self._solid)

    def clearance(self, x: float, y: float, z: float, radius_m: float, half_height_m: float) -> tuple[float, float, float]:
        """Distances [m] from an upright cylinder centred at (x, y, z), frame World: to the nearest solid but slabs, to the
        nearest slab below, to the nearest slab above. Each is cut at 3 m, 0 where they touch."""
        return _clearance(x, y, z, radius_m, half_height_m, self.shape, self.cylinder, self.slab)


@njit(cache=True, inline="always")
def _hit(shape, cylinder, i, ox, oy, oz, dx, dy, dz, best):
    """Entry distance of the ray into primitive i if it is nearer than best and ahead, else best. From inside: 0."""
    cx, cy, cz, hx, hy, hz, c, s = shape[i, 0], shape[i, 1], shape[i, 2], shape[i, 3], shape[i, 4], shape[i, 5], shape[i, 6], shape[i, 7]
    px, py, pz = ox - cx, oy - cy, oz - cz
    near, far = 0.0, best
    if dz != 0.0:  # slab test in z, common to both kinds
        a, b = (-hz - pz) / dz, (hz - pz) / dz
        if a > b:
            a, b = b, a
        near, far = max(near, a), min(far, b)
        if near > far:
            return best
    elif abs(pz) > hz:
        return best
    if cylinder[i]:
        a = dx * dx + dy * dy
        b = px * dx + py * dy
        k = px * px + py * py - hx * hx
        if a > 1e-18:
            root = b * b - a * k
            if root < 0.0:
                return best
            root = math.sqrt(root)
            near, far = max(near, (-b - root) / a), min(far, (-b + root) / a)
        elif k > 0.0:
            return best
    else:
        u, v = c * px + s * py, c * py - s * px
        du, dv = c * dx + s * dy, c * dy - s * dx
        if du != 0.0:
            a, b = (-hx - u) / du, (hx - u) / du
            if a > b:
                a, b = b, a
            near, far = max(near, a), min(far, b)
        elif abs(u) > hx:
            return best
        if dv != 0.0:
            a, b = (-hy - v) / dv, (hy - v) / dv
            if a > b:
                a, b = b, a
            near, far = max(near, a), min(far, b)
        elif abs(v) > hy:
            return best
    if near > far or near >= best:
        return best
    return near


@njit(cache=True)
def _cast(ox, oy, oz, dx, dy, dz, max_range, x0, y0, columns, rows, first, member, shape, cylinder, soaking):
    """Walk the grid's squares along the ray (Amanatides and Woo 1987) and keep the nearest entry."""
    best, hit = max_range, -1
    column, row = int(math.floor((ox - x0) / SQUARE_M)), int(math.floor((oy - y0) / SQUARE_M))
    if column < 0 or column >= columns or row < 0 or row >= rows:
        return NO_RETURN  # outside of the building's bounds: nothing is there
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    next_x = ((x0 + (column + (dx > 0)) * SQUARE_M) - ox) / dx if dx != 0.0 else math.inf
    next_y = ((y0 + (row + (dy > 0)) * SQUARE_M) - oy) / dy if dy != 0.0 else math.inf
    span_x = SQUARE_M / abs(dx) if dx != 0.0 else math.inf
    span_y = SQUARE_M / abs(dy) if dy != 0.0 else math.inf
    while True:
        square = row * columns + column
        for k in range(first[square], first[square + 1]):
            i = member[k]
            distance = _hit(shape, cylinder, i, ox, oy, oz, dx, dy, dz, best)
            if distance < best:
                best, hit = distance, i
        leaves = min(next_x, next_y)
        if best <= leaves:
            break
        if next_x < next_y:
            column += step_x
            next_x += span_x
            if column < 0 or column >= columns:
                break
        else:
            row += step_y
            next_y += span_y
            if row < 0 or row >= rows:
                break
    if hit < 0 or soaking[hit]:
        return NO_RETURN
    return best


@njit(cache=True)
def _sweep(poses, mount, bearings, max_range, out, x0, y0, columns, rows, first, member, shape, cylinder, soaking):
    count, last = bearings.shape[0], poses.shape[0] - 1
    t_first, t_last = out[0], poses[last, 0]
    t_begin = poses[0, 0]
    spacing = (t_last - t_begin) / last
    mc, ms = math.cos(mount[3]), math.sin(mount[3])
    for beam in range(count):
        at = (t_first + (t_last - t_first) * beam / (count - 1) - t_begin) / spacing
        k = min(max(int(math.floor(at)), 0), last - 1)
        f = at - k
        g = 1.0 - f
        x, y, z = (g * poses[k, 1] + f * poses[k + 1, 1], g * poses[k, 2] + f * poses[k + 1, 2], g * poses[k, 3] + f * poses[k + 1, 3])
        # Neighbours are 2 ms apart: the normalised mean of two quaternions of one sign is the rotation between them.
        turn = 0.0
        for m in range(4, 8):
            turn += poses[k, m] * poses[k + 1, m]
        f = f if turn >= 0.0 else -f
        w, i, j, l = (g * poses[k, 4] + f * poses[k + 1, 4], g * poses[k, 5] + f * poses[k + 1, 5],
                      g * poses[k, 6] + f * poses[k + 1, 6], g * poses[k, 7] + f * poses[k + 1, 7])
        n = 1.0 / math.sqrt(w * w + i * i + j * j + l * l)
        w, i, j, l = w * n, i * n, j * n, l * n
        r00, r01, r02 = 1 - 2 * (j * j + l * l), 2 * (i * j - w * l), 2 * (i * l + w * j)
        r10, r11, r12 = 2 * (i * j + w * l), 1 - 2 * (i * i + l * l), 2 * (j * l - w * i)
        r20, r21, r22 = 2 * (i * l - w * j), 2 * (j * l + w * i), 1 - 2 * (i * i + j * j)
        ox = x + r00 * mount[0] + r01 * mount[1] + r02 * mount[2]
        oy = y + r10 * mount[0] + r11 * mount[1] + r12 * mount[2]
        oz = z + r20 * mount[0] + r21 * mount[1] + r22 * mount[2]
        bc, bs = math.cos(bearings[beam]), math.sin(bearings[beam])
        bx, by = mc * bc - ms * bs, ms * bc + mc * bs
        out[beam] = _cast(ox, oy, oz, r00 * bx + r01 * by, r10 * bx + r11 * by, r20 * bx + r21 * by, max_range,
                          x0, y0, columns, rows, first, member, shape, cylinder, soaking)


@njit(cache=True)
def _clearance(x, y, z, radius, half_height, shape, cylinder, slab):
    solid, below, above = 3.0, 3.0, 3.0
    for i in range(shape.shape[0]):
        dx, dy, dz = x - shape[i, 0], y - shape[i, 1], z - shape[i, 2]
        vertical = abs(dz) - shape[i, 5] - half_height
        if vertical > 3.0:
            continue
        if cylinder[i]:
            gap = math.sqrt(dx * dx + dy * dy) - shape[i, 3] - radius
        else:
            c, s = shape[i, 6], shape[i, 7]
            u, v = max(abs(c * dx + s * dy) - shape[i, 3], 0.0), max(abs(c * dy - s * dx) - shape[i, 4], 0.0)
            gap = math.sqrt(u * u + v * v) - radius
        gap, vertical = max(gap, 0.0), max(vertical, 0.0)
        distance = math.sqrt(gap * gap + vertical * vertical)
        if not slab[i]:
            solid = min(solid, distance)
        elif dz > 0.0:
            below = min(below, distance)
        else:
            above = min(above, distance)
    return solid, below, above
