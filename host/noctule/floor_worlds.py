"""Buildings of several floors for the bench: one opening of a given size, and whole buildings drawn from a number. Pure functions, form of docs/worlds.md."""

from __future__ import annotations

import math
import random

EDGE_M = 0.05          # slabs reach so far beyond the middle of the outer walls
APART_M = 1.3          # between an opening and what stands on either of its floors


def opening_world(side_m: float, turn: int) -> dict:
    """A building of two floors whose opening is a square of that side; `turn` moves start and opening."""
    x, y = 5.6 + 0.23 * turn, 3.1 + 0.17 * turn
    walls = [{"from": a, "to": b, "height": 4.8} for a, b in _outline(9.0, 7.0)]
    extent = [-EDGE_M, -EDGE_M, 9.0 + EDGE_M, 7.0 + EDGE_M]
    return {
        "name": f"opening_{side_m:g}",
        "start": {"x": 1.9 + 0.1 * turn, "y": 2.2, "z": 0.0, "yaw_deg": 17.0 + 11.0 * turn},
        "floors": [{"elevation": 0.0, "height": 2.3, "slab": 0.2, "extent": extent},
                   {"elevation": 2.5, "height": 2.3, "slab": 0.2, "extent": extent,
                    "openings": [[x - side_m / 2, y - side_m / 2, x + side_m / 2, y + side_m / 2]]}],
        "walls": [*walls, {"from": [4, 7], "to": [4, 5.2]}, {"from": [9, 5.6], "to": [7.2, 5.6], "floor": 1}],
    }


def _outline(width_m: float, depth_m: float) -> list[tuple[list[float], list[float]]]:
    corners = [[0.0, 0.0], [width_m, 0.0], [width_m, depth_m], [0.0, depth_m]]
    return [(a, b) for a, b in zip(corners, corners[1:] + corners[:1])]


def _clear(x: float, y: float, radius_m: float, rectangles, segments=()) -> bool:
    # True: a disc keeps APART_M from all openings and does not touch the walls.
    for x0, y0, x1, y1 in rectangles:
        if math.hypot(max(x0 - x, 0.0, x - x1), max(y0 - y, 0.0, y - y1)) < radius_m + APART_M:
            return False
    for (ax, ay), (bx, by) in segments:
        along = min(1.0, max(0.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)))
        if math.hypot(x - ax - along * (bx - ax), y - ay - along * (by - ay)) < radius_m + 0.05:
            return False
    return True


def building(number: int) -> dict:
    """Two or three floors, drawn from the number: outline, storeys, openings of 1.6 to 3 m, walls, furniture, and on which floor it starts.

    An opening of 2.4 m or more has stairs in half of the buildings. Nothing stands within APART_M of an opening.

    >>> len(building(1)["floors"]) in (2, 3), building(1) == building(1), building(1) == building(2)
    (True, True, False)
    """
    draw = random.Random(7000 + number)
    count = draw.choice((2, 2, 3))
    width_m, depth_m = round(draw.uniform(8.0, 13.0), 2), round(draw.uniform(7.5, 10.5), 2)
    slab_m = draw.choice((0.2, 0.25, 0.3))
    heights_m = [round(draw.uniform(2.3, 2.8), 2) for _ in range(count)]
    extent = [-EDGE_M, -EDGE_M, width_m + EDGE_M, depth_m + EDGE_M]
    floors, openings = [], []
    elevation_m = 0.0
    for n in range(count):
        floor = {"elevation": round(elevation_m, 3), "height": heights_m[n], "slab": slab_m, "extent": extent}
        if n > 0:
            while True:
                a, b = round(draw.uniform(1.6, 3.0), 2), round(draw.uniform(1.6, 3.0), 2)
                x, y = draw.uniform(0.9, width_m - 0.9 - a), draw.uniform(0.9, depth_m - 0.9 - b)
                box = [round(x, 2), round(y, 2), round(x + a, 2), round(y + b, 2)]
                if all(box[0] > o[2] + 0.8 or box[2] < o[0] - 0.8 or box[1] > o[3] + 0.8 or box[3] < o[1] - 0.8 for o in openings):
                    break
            openings.append(box)
            floor["openings"] = [box]
        floors.append(floor)
        elevation_m += heights_m[n] + slab_m
    walls, boxes, pillars, stairs = [], [], [], []
    free = []   # per floor: what must be kept clear, and its walls
    for n in range(count):
        near = openings[max(n - 1, 0):n + 1]
        lines = list(_outline(width_m, depth_m))
        walls += [{"from": a, "to": b, "floor": n} for a, b in lines]
        for _ in range(draw.choice((1, 2))):
            for _ in range(50):
                at, length = draw.uniform(2.2, width_m - 2.2), draw.uniform(0.3, 0.55) * depth_m
                up = draw.random() < 0.5
                wall = ([round(at, 2), 0.0], [round(at, 2), round(length, 2)]) if up else ([round(at, 2), depth_m], [round(at, 2), round(depth_m - length, 2)])
                steps = [(wall[0][0], wall[0][1] + (wall[1][1] - wall[0][1]) * k / 20) for k in range(21)]
                if all(_clear(x, y, 0.0, near) for x, y in steps) and all(abs(wall[0][0] - o[0][0]) > 2.0 for o in lines[4:]):
                    lines.append(wall)
                    walls.append({"from": wall[0], "to": wall[1], "floor": n})
                    break
        free.append((near, lines))
        for _ in range(draw.choice((1, 2, 3))):
            for _ in range(50):
                x, y, r = draw.uniform(0.7, width_m - 0.7), draw.uniform(0.7, depth_m - 0.7), draw.uniform(0.35, 0.7)
                if _clear(x, y, r, near, lines):
                    if draw.random() < 0.4:
                        pillars.append({"at": [round(x, 2), round(y, 2)], "radius": round(0.4 * r, 2), "floor": n})
                    else:
                        boxes.append({"at": [round(x, 2), round(y, 2)], "size": [round(1.2 * r, 2), round(1.5 * r, 2), draw.choice((0.6, 1.4, 1.7))],
                                      "yaw_deg": round(draw.uniform(-45.0, 45.0), 1), "floor": n})
                    break
    for n, (x0, y0, x1, y1) in enumerate(openings):
        if min(x1 - x0, y1 - y0) >= 2.4 and draw.random() < 0.5:
            stairs.append({"at": [x0 + 0.05, y1 - 0.5], "yaw_deg": 0, "width": 0.9, "rise": round(heights_m[n] + slab_m, 3), "run": round(x1 - x0 - 0.1, 2),
                           "steps": 15, "floor": n})
    on = draw.randrange(count)
    while True:
        x, y = draw.uniform(0.8, width_m - 0.8), draw.uniform(0.8, depth_m - 0.8)
        things = [(b["at"], max(b["size"][:2])) for b in boxes if b["floor"] == on] + [(p["at"], p["radius"]) for p in pillars if p["floor"] == on]
        if _clear(x, y, 0.6, free[on][0], free[on][1]) and all(math.hypot(x - at[0], y - at[1]) > r + 0.7 for at, r in things):
            break
    return {
        "name": f"building_{number}",
        "start": {"x": round(x, 2), "y": round(y, 2), "z": floors[on]["elevation"], "yaw_deg": round(draw.uniform(-180.0, 180.0), 1)},
        "floors": floors, "walls": walls, "boxes": boxes, "pillars": pillars, "stairs": stairs,
    }
