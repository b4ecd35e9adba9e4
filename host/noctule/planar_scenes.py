"""Plans for measuring the localisation alone (planar_profile.py flies them). Frame plan (World); metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Plan:
    """Walls (x0, y0, x1, y1), pillars (x, y, radius) and the way (x, y) through them [m]; the way begins along +x."""

    name: str
    walls: tuple[tuple[float, float, float, float], ...]
    pillars: tuple[tuple[float, float, float], ...]
    way: tuple[tuple[float, float], ...]


def _outline(x0: float, y0: float, x1: float, y1: float):
    return ((x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0))


def rooms() -> Plan:
    """15 x 15 m: four rooms, doors of 1 m, two pillars, and a way through all of them and back."""
    walls = (*_outline(0.0, 0.0, 15.0, 15.0), (7.0, 0.0, 7.0, 2.6), (7.0, 3.8, 7.0, 11.0), (7.0, 12.2, 7.0, 15.0),
             (0.0, 8.0, 2.9, 8.0), (4.1, 8.0, 7.0, 8.0), (7.0, 6.5, 10.4, 6.5), (11.6, 6.5, 15.0, 6.5), (13.0, 9.0, 15.0, 9.0))
    way = ((2.0, 3.2), (4.5, 3.2), (7.0, 3.2), (9.5, 3.2), (11.0, 4.6), (11.0, 6.5), (10.8, 9.0), (9.5, 11.3), (7.0, 11.6),
           (4.6, 11.3), (3.5, 10.0), (3.5, 8.0), (3.4, 6.0), (2.6, 4.4))
    return Plan("rooms", walls, ((13.0, 2.0, 0.3), (5.5, 13.5, 0.25)), way)


def round_hall() -> Plan:
    """A round hall of 6 m radius in 90 short chords, with three pillars: no wall that deserves the name."""
    turn = np.linspace(0.0, 2.0 * math.pi, 91)
    corners = [(6.0 * math.cos(a), 6.0 * math.sin(a)) for a in turn]
    walls = tuple((*a, *b) for a, b in zip(corners, corners[1:]))
    way = ((-2.5, -2.5), (0.0, -3.2), (2.8, -2.0), (3.2, 1.0), (1.0, 3.2), (-2.0, 2.8), (-3.2, 0.0), (-1.5, -1.2))
    return Plan("round hall", walls, ((0.0, 0.0, 0.3), (4.6, -0.8, 0.3), (-1.5, 4.4, 0.25)), way)


def loop_100m() -> Plan:
    """A corridor 2 m wide round a block, 100 m once round, with shallow niches (0.3 m) every few metres."""
    walls = [*_outline(0.0, 0.0, 32.0, 22.0), *_outline(2.0, 2.0, 30.0, 20.0)]
    for x in (5.0, 11.0, 16.5, 23.0, 27.5):
        walls += [(x, 0.0, x, 0.3), (x + 1.2, 20.0, x + 1.2, 20.3)]
    for y in (5.5, 9.0, 14.5):
        walls += [(0.0, y, 0.3, y), (31.7, y + 2.0, 32.0, y + 2.0)]
    way = ((1.0, 1.0), (8.0, 1.0), (16.0, 1.0), (24.0, 1.0), (29.0, 1.0), (30.6, 1.4), (31.0, 3.0), (31.0, 8.0), (31.0, 12.0),
           (31.0, 17.0), (31.0, 19.0), (30.6, 20.6), (29.0, 21.0), (25.0, 21.0), (16.0, 21.0), (8.0, 21.0), (3.0, 21.0),
           (1.4, 20.6), (1.0, 19.0), (1.0, 15.0), (1.0, 8.0), (1.0, 3.0), (1.4, 1.4), (3.0, 1.0), (4.5, 1.0))
    return Plan("loop of 100 m", tuple(walls), (), way)


def corridor_40m() -> Plan:
    """A corridor of 40 x 2.4 m without a single feature, flown to the room at its far end and back: for half of the way
    no end is within the laser's range, and nothing but inertia tells how far along the vehicle is."""
    walls = ((0.0, 2.4, 0.0, 0.0), (0.0, 0.0, 40.0, 0.0), (0.0, 2.4, 40.0, 2.4),
             (40.0, 0.0, 40.0, -2.0), (40.0, -2.0, 47.0, -2.0), (47.0, -2.0, 47.0, 4.4), (47.0, 4.4, 40.0, 4.4), (40.0, 4.4, 40.0, 2.4))
    way = ((2.5, 1.2), (10.0, 1.2), (20.0, 1.2), (30.0, 1.2), (38.0, 1.1), (41.0, 0.6), (43.5, -0.2), (45.4, 1.2), (43.5, 2.6), (41.0, 1.8), (38.0, 1.3),
           (30.0, 1.2), (20.0, 1.2), (10.0, 1.2), (4.0, 1.2))
    return Plan("corridor of 40 m", walls, (), way)


def cluttered_hall() -> Plan:
    """A hall of 16 x 12 m full of crates and poles at all angles, which hide most of its walls."""
    way = ((2.0, 2.0), (5.0, 2.2), (8.5, 2.0), (12.0, 2.4), (13.8, 4.5), (13.5, 8.0), (11.0, 9.8), (8.0, 8.6), (6.2, 6.2), (4.0, 8.4), (2.4, 6.5), (2.2, 4.0))
    corners = np.array(way)
    along = np.concatenate([np.linspace(a, b, 20) for a, b in zip(corners, corners[1:])])
    random = np.random.default_rng(40)
    walls, pillars, taken = [*_outline(0.0, 0.0, 16.0, 12.0)], [], []
    while len(taken) < 64:
        x, y, turn = random.uniform(0.6, 15.4), random.uniform(0.6, 11.4), random.uniform(0.0, math.pi)
        half_x, half_y = random.uniform(0.10, 0.45), random.uniform(0.10, 0.30)
        reach = math.hypot(half_x, half_y)
        if np.hypot(*(along - (x, y)).T).min() < reach + 0.65 or any(math.hypot(x - u, y - v) < reach + w for u, v, w in taken):
            continue
        taken.append((x, y, reach))
        if random.random() < 0.3:
            pillars.append((x, y, half_y))
            continue
        c, s = math.cos(turn), math.sin(turn)
        crate = [(x + c * i * half_x - s * j * half_y, y + s * i * half_x + c * j * half_y) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        walls += [(*crate[n], *crate[(n + 1) % 4]) for n in range(4)]
    return Plan("cluttered hall", tuple(walls), tuple(pillars), way)


def courtyard() -> Plan:
    """A court of 56 x 32 m with buildings' fronts round it. The way follows the fronts and crosses the middle, where for
    about 30 % of the time no wall is within the laser's 10 m."""
    walls = [*_outline(0.0, 0.0, 56.0, 32.0)]
    for x in (6.0, 13.0, 21.5, 29.0, 37.0, 46.0):
        walls += [(x, 0.0, x, 0.6), (x, 0.6, x + 1.5, 0.6), (x + 1.5, 0.6, x + 1.5, 0.0), (x + 2.0, 32.0, x + 2.0, 31.2)]
    for y in (7.0, 15.5, 22.0):
        walls += [(0.0, y, 0.8, y), (56.0, y + 1.5, 55.3, y + 1.5), (55.3, y + 1.5, 55.3, y + 3.0), (55.3, y + 3.0, 56.0, y + 3.0)]
    way = ((4.0, 4.0), (10.0, 3.6), (20.0, 4.0), (30.0, 3.6), (40.0, 4.0), (50.0, 4.2), (52.4, 7.0), (51.5, 12.0), (47.0, 15.4), (40.0, 16.0), (28.0, 16.0),
           (18.0, 16.0), (8.0, 16.2), (4.5, 18.5), (4.0, 23.5), (6.0, 27.5), (12.0, 28.0), (22.0, 27.6), (29.0, 24.0), (30.0, 15.0), (24.0, 7.5), (14.0, 4.4), (8.0, 4.0))
    return Plan("courtyard", tuple(walls), (), way)


def loop_500m() -> Plan:
    """A corridor 2.4 m wide round a block, 500 m once round, with shallow niches at irregular places; it ends where it began."""
    width, depth, gauge = 148.0, 106.0, 2.4
    walls = [*_outline(0.0, 0.0, width, depth), *_outline(gauge, gauge, width - gauge, depth - gauge)]
    random = np.random.default_rng(500)
    for side, length in ((0, width), (1, depth), (2, width), (3, depth)):
        at = 4.0
        while at < length - 4.0:
            out = random.uniform(0.15, 0.40)
            walls.append({0: (at, 0.0, at, out), 1: (width, at, width - out, at), 2: (at, depth, at, depth - out), 3: (0.0, at, out, at)}[side])
            at += random.uniform(3.0, 9.0)
    near, right, top = 1.2, width - 1.2, depth - 1.2
    way = [(6.0, near), *((x, near) for x in np.linspace(16.0, right - 3.0, 10)), (right - 0.4, near + 0.4)]
    way += [(right, y) for y in np.linspace(4.2, top - 3.0, 8)] + [(right - 0.4, top - 0.4)]
    way += [(x, top) for x in np.linspace(right - 3.0, 4.2, 10)] + [(near + 0.4, top - 0.4)]
    way += [(near, y) for y in np.linspace(top - 3.0, 4.2, 8)] + [(near + 0.4, near + 0.4), (4.2, near), (9.0, near)]
    return Plan("loop of 500 m", tuple(walls), (), tuple((float(x), float(y)) for x, y in way))
