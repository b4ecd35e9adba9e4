"""Buildings drawn at random, for judging an exploration by what it was not tuned on. Pure functions, form of docs/worlds.md.

A kind and a number give one building, the same on every machine. All are one floor of 2.5 m, turned by any angle. Doors are 0.85 m or wider, and nothing stands before them.
"""

from __future__ import annotations

import math
import random

from noctule.motion_worlds import described, turned

KINDS = ("office", "flat", "maze", "hall")
DOOR_CLEAR_M = 0.9        # in front of a door nothing stands
APART_M = 0.8             # pieces of furniture leave this much between them, or stand at a wall
CORNER_M = 0.15           # between a door and the next wall


class _Plan:
    """Walls as (x0, y0, x1, y1) along an axis [m], their doors as (at [m along it], width [m]), boxes as (x, y, along x, along y, turn [rad])."""

    def __init__(self) -> None:
        self.walls: list[tuple[float, float, float, float]] = []
        self.doors: dict[int, list[tuple[float, float]]] = {}
        self.boxes: list[tuple[float, float, float, float, float]] = []

    def add(self, x0: float, y0: float, x1: float, y1: float) -> int:
        self.walls.append((x0, y0, x1, y1))
        return len(self.walls) - 1

    def enclose(self, x0: float, y0: float, x1: float, y1: float) -> None:
        for wall in ((x0, y0, x1, y0), (x0, y1, x1, y1), (x0, y0, x0, y1), (x1, y0, x1, y1)):
            self.add(*wall)

    def door(self, draw: random.Random, wall: int, low_m: float, high_m: float, width_m: float) -> bool:
        """A door between two places along a wall, clear of the walls that meet it and of other doors; False: there is no room."""
        x0, y0, x1, y1 = self.walls[wall]
        upright = x0 == x1
        met = [(v[1] if upright else v[0]) - (y0 if upright else x0) for k, w in enumerate(self.walls) if k != wall for v in (w[:2], w[2:])
               if abs((v[0] - x0) if upright else (v[1] - y0)) < 1e-6]
        taken = [(m, 0.0) for m in met] + self.doors.get(wall, [])
        for _ in range(40):
            if high_m - low_m < width_m + 2 * CORNER_M:
                return False
            at_m = draw.uniform(low_m + width_m / 2 + CORNER_M, high_m - width_m / 2 - CORNER_M)
            if all(abs(at_m - m) > (width_m + w) / 2 + CORNER_M for m, w in taken):
                self.doors.setdefault(wall, []).append((at_m, width_m))
                return True
        return False

    def furnish(self, draw: random.Random, x0: float, y0: float, x1: float, y1: float, per_m2: float, start: tuple[float, float]) -> None:
        """Tables and cupboards in a room, some along its walls, some askew; none before a door."""
        entries = [(w[0] + (0 if w[0] == w[2] else at), w[1] + (at if w[0] == w[2] else 0)) for k, w in enumerate(self.walls) for at, _ in self.doors.get(k, [])]
        for _ in range(int(6 * per_m2 * (x1 - x0) * (y1 - y0))):
            a, b = draw.choice(((1.4, 0.7), (0.6, 0.6), (0.9, 0.45), (1.8, 0.8), (0.45, 0.9), (0.7, 1.4)))
            if x1 - x0 < a + 2 * APART_M or y1 - y0 < b + 2 * APART_M:
                continue
            reach, turn = math.hypot(a, b) / 2, draw.choice((0.0, 0.0, draw.uniform(0, 3)))
            if draw.random() < 0.6:
                turn, reach = 0.0, max(a, b) / 2
                x, y = draw.choice(((x0 + a / 2 + 0.05, draw.uniform(y0 + b / 2 + APART_M, y1 - b / 2 - APART_M)), (draw.uniform(x0 + a / 2 + APART_M, x1 - a / 2 - APART_M), y1 - b / 2 - 0.05)))
            else:
                margin = reach + APART_M
                if x1 - x0 < 2 * margin or y1 - y0 < 2 * margin:
                    continue
                x, y = draw.uniform(x0 + margin, x1 - margin), draw.uniform(y0 + margin, y1 - margin)
            far = all(math.hypot(x - ex, y - ey) > reach + DOOR_CLEAR_M for ex, ey in [*entries, start])
            if far and all(math.hypot(x - o[0], y - o[1]) > reach + math.hypot(o[2], o[3]) / 2 + APART_M for o in self.boxes):
                self.boxes.append((x, y, a, b, turn))


def _office(draw: random.Random, plan: _Plan) -> tuple[float, float]:
    # A corridor with rooms on both sides.
    length, width = draw.uniform(14, 26), draw.uniform(1.5, 2.4)
    start, rooms = (draw.uniform(1, length - 1), width / 2), []
    for y, away in ((width, 1.0), (0.0, -1.0)):
        depth, x = away * draw.uniform(3.0, 5.5), 0.0
        side = plan.add(0.0, y, length, y)
        plan.add(0.0, y + depth, length, y + depth)
        while length - x > 0.1:
            wide = draw.uniform(2.2, 5.5)
            wide = length - x if length - x - wide < 2.2 else wide
            plan.add(x, min(y, y + depth), x, max(y, y + depth))
            rooms.append((side, x, wide, min(y, y + depth), max(y, y + depth)))
            x += wide
        plan.add(length, min(y, y + depth), length, max(y, y + depth))
    for x in (0.0, length):
        plan.add(x, 0.0, x, width)
    for side, x, wide, _, _ in rooms:
        plan.door(draw, side, x, x + wide, draw.uniform(0.85, 1.15))
    density = draw.choice((0.0, 0.06, 0.15))
    for _, x, wide, y0, y1 in rooms:
        plan.furnish(draw, x, y0, x + wide, y1, density, start)
    return start


def _flat(draw: random.Random, plan: _Plan) -> tuple[float, float]:
    # A rectangle divided again and again; a door in every dividing wall, a second one in some.
    least, rooms, dividing = 2.2, [], []

    def divide(x0: float, y0: float, x1: float, y1: float) -> None:
        w, h = x1 - x0, y1 - y0
        if max(w, h) < 2 * least or (w * h < draw.uniform(10, 30) and max(w, h) < 3 * least):
            rooms.append((x0, y0, x1, y1))
        elif w > h:
            c = draw.uniform(x0 + least, x1 - least)
            dividing.append(plan.add(c, y0, c, y1))
            divide(x0, y0, c, y1)
            divide(c, y0, x1, y1)
        else:
            c = draw.uniform(y0 + least, y1 - least)
            dividing.append(plan.add(x0, c, x1, c))
            divide(x0, y0, x1, c)
            divide(x0, c, x1, y1)

    width, height = draw.uniform(10, 19), draw.uniform(8, 14)
    plan.enclose(0.0, 0.0, width, height)
    divide(0.0, 0.0, width, height)
    loops = draw.choice((0.05, 0.2, 0.4))
    for wall in dividing:
        x0, y0, x1, y1 = plan.walls[wall]
        for _ in range(1 + (draw.random() < loops)):
            wide = draw.uniform(0.85, 1.3)
            if not plan.door(draw, wall, 0.0, x1 - x0 + y1 - y0, wide):
                plan.door(draw, wall, 0.0, x1 - x0 + y1 - y0, 0.85)
    room = max(rooms, key=lambda r: (r[2] - r[0]) * (r[3] - r[1]))
    start = ((room[0] + room[2]) / 2, (room[1] + room[3]) / 2)
    density = draw.choice((0.0, 0.05, 0.12, 0.2))
    for r in rooms:
        plan.furnish(draw, *r, density, start)
    return start


def _maze(draw: random.Random, plan: _Plan) -> tuple[float, float]:
    # Square cells, a random spanning tree of passages, one wall in eight left out as well.
    cell, columns, rows = draw.uniform(1.3, 2.3), draw.randint(5, 8), draw.randint(4, 7)
    open_between, seen, trail = set(), {(0, 0)}, [(0, 0)]
    while trail:
        x, y = trail[-1]
        fresh = [(x + a, y + b) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1)) if 0 <= x + a < columns and 0 <= y + b < rows and (x + a, y + b) not in seen]
        if not fresh:
            trail.pop()
            continue
        trail.append(draw.choice(fresh))
        seen.add(trail[-1])
        open_between.add(frozenset(((x, y), trail[-1])))
    plan.enclose(0.0, 0.0, columns * cell, rows * cell)
    for x in range(columns):
        for y in range(rows):
            for a, b in ((1, 0), (0, 1)):
                if x + a < columns and y + b < rows and frozenset(((x, y), (x + a, y + b))) not in open_between and draw.random() > 0.12:
                    plan.add((x + a) * cell, (y + b) * cell, (x + 1) * cell, (y + 1) * cell)
    return (draw.randrange(columns) + 0.5) * cell, (draw.randrange(rows) + 0.5) * cell


def _hall(draw: random.Random, plan: _Plan) -> tuple[float, float]:
    # One room of 80 to 250 m2, full of things, with screens that stand free.
    width, height = draw.uniform(10, 18), draw.uniform(8, 14)
    plan.enclose(0.0, 0.0, width, height)
    start = (draw.uniform(1, width - 1), draw.uniform(1, height - 1))
    for _ in range(draw.randint(3, 7)):
        long, turn = draw.uniform(1.5, 5.0), draw.choice((0.0, math.pi / 2, draw.uniform(0, 3)))
        x, y, reach = draw.uniform(2, width - 2), draw.uniform(2, height - 2), long / 2
        inside = reach + APART_M < min(x, width - x, y, height - y)
        if inside and math.hypot(x - start[0], y - start[1]) > reach + DOOR_CLEAR_M and all(math.hypot(x - o[0], y - o[1]) > reach + o[2] / 2 + APART_M for o in plan.boxes):
            plan.boxes.append((x, y, long, 0.12, turn))
    plan.furnish(draw, 0.0, 0.0, width, height, draw.choice((0.05, 0.1, 0.2)), start)
    return start


def building(kind: str, number: int) -> dict:
    """A world of that kind.

    Args:
        kind: one of KINDS.
        number: of the building.
    """
    draw, plan = random.Random(f"{kind} {number}"), _Plan()
    start = {"office": _office, "flat": _flat, "maze": _maze, "hall": _hall}[kind](draw, plan)
    angle_rad = draw.choice((0.0, 0.3, 0.79, draw.uniform(0, 3)))
    doors = {k: [{"at": at, "width": wide, "height": 2.1} for at, wide in of] for k, of in plan.doors.items()}
    world = described(f"{kind}_{number}", plan.walls, start, draw.uniform(-3.1, 3.1) - angle_rad, angle_rad, doors)
    boxes = [{"at": turned(x, y, angle_rad), "size": [a, b, 2.2], "yaw_deg": round(math.degrees(turn + angle_rad), 4)} for x, y, a, b, turn in plan.boxes]
    return world | {"boxes": boxes}
