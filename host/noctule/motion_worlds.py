"""Buildings for the bench of motion: doors at any angle, an open front door. Pure functions, form of docs/worlds.md."""

from __future__ import annotations

import math
import random


def turned(x_m: float, y_m: float, angle_rad: float) -> list[float]:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return [round(c * x_m - s * y_m, 5), round(s * x_m + c * y_m, 5)]


def described(name: str, walls, start, yaw_rad: float, angle_rad: float, doors=None) -> dict:
    # The plan turned about the origin. walls: (x0, y0, x1, y1); doors: index of a wall -> list of doors.
    rows = [{"from": turned(*w[:2], angle_rad), "to": turned(*w[2:], angle_rad), **({"doors": doors[i]} if i in (doors or {}) else {})}
            for i, w in enumerate(walls)]
    points = [p for row in rows for p in (row["from"], row["to"])]
    extent = [min(p[0] for p in points) - 4.0, min(p[1] for p in points) - 4.0, max(p[0] for p in points) + 4.0, max(p[1] for p in points) + 4.0]
    x_m, y_m = turned(*start, angle_rad)
    return {"name": name, "start": {"x": x_m, "y": y_m, "yaw_deg": round(math.degrees(yaw_rad + angle_rad), 4)},
            "floors": [{"elevation": 0.0, "height": 2.5, "extent": extent}], "walls": rows}


def door(width_m: float, angle_deg: float, offset_m: float) -> dict:
    """Two rooms of 4 x 4 m with one door between them, full height; the second has a corner that only a visit shows.

    The wall with the door lies on x = 0 before the turn, 0.10 m thick, the door's middle on y = 0; the start is at (-2, offset_m),
    heading along +x. All is turned by angle_deg about the door's middle.
    """
    walls = [(-4, -2, -4, 2), (4, -2, 4, 2), (-4, -2, 4, -2), (-4, 2, 4, 2), (0, -2, 0, 2), (2.2, -2, 2.2, 0.4), (1.0, 0.6, 1.0, 2)]
    return described(f"door_{width_m * 100:.0f}_{angle_deg:.0f}_{offset_m:+.2f}", walls, (-2.0, offset_m), 0.0, math.radians(angle_deg),
                      {4: [{"at": 2.0, "width": width_m, "height": 2.5}]})


def open_front_door(angle_deg: float = 11.0) -> dict:
    """Two rooms, and a front door of 1.2 m that stands open to a yard of 14 x 14 m (a far wall bounds the world, not the flight)."""
    walls = [(-4, -3, 4, -3), (4, -3, 4, 3), (4, 3, -4, 3), (-4, 3, -4, -3), (0, -3, 0, 3),
             (4, -7, 18, -7), (18, -7, 18, 7), (18, 7, 4, 7), (4, 7, 4, 3), (4, -3, 4, -7)]
    return described("open_front_door", walls, (-2.5, -1.0), 0.3, math.radians(angle_deg),
                      {1: [{"at": 3.0, "width": 1.2, "height": 2.1}], 4: [{"at": 1.5, "width": 0.9, "height": 2.1}]})


def front_door_fence() -> dict[str, float]:
    """The parameters of a fence along the outer walls of open_front_door, frame Map of its start; the same for any angle."""
    x0, y0, yaw = -2.5, -1.0, 0.3
    c, s = math.cos(yaw), math.sin(yaw)
    fence: dict[str, float] = {"fence_corners": 4}
    for k, (x, y) in enumerate(((-4.2, -3.2), (4.0, -3.2), (4.0, 3.2), (-4.2, 3.2)), start=1):
        fence[f"fence_{k}_x_m"], fence[f"fence_{k}_y_m"] = c * (x - x0) + s * (y - y0), c * (y - y0) - s * (x - x0)
    return fence


def clutter(seed: int) -> dict:
    """Five rooms of 12 x 8 m in all, turned by any angle: doors of 0.74 to 1.0 m, table legs, thin and thick pillars, cupboards askew."""
    draw = random.Random(seed)
    angle_rad = math.radians(draw.uniform(0, 90))
    walls = [(0, 0, 12, 0), (12, 0, 12, 8), (12, 8, 0, 8), (0, 8, 0, 0), (4, 0, 4, 8), (8, 0, 8, 8), (4, 4, 8, 4), (8, 3.6, 12, 3.6)]
    spans = {4: ((1.2, 2.4), (5.4, 6.6)), 5: ((1.2, 6.6),), 6: ((1.2, 2.8),), 7: ((1.2, 2.8),)}
    doors = {wall: [{"at": draw.uniform(*span), "width": draw.choice((0.74, 0.78, 0.80, 0.85, 0.90, 1.00)), "height": 2.1} for span in of]
             for wall, of in spans.items()}
    start = (1.2, 1.2)
    plan = described(f"clutter_{seed}", walls, start, draw.uniform(-3.1, 3.1) - angle_rad, angle_rad, doors)

    def place(border_m: float) -> tuple[float, float]:
        while True:
            x, y = draw.uniform(border_m, 12 - border_m), draw.uniform(border_m, 8 - border_m)
            if math.hypot(x - start[0], y - start[1]) > 1.2:
                return x, y

    legs, cupboards, pillars = [], [], []
    for _ in range(3):
        (x, y), turn = place(0.8), draw.uniform(0, 3)
        legs += [(x + dx * math.cos(turn) - dy * math.sin(turn), y + dx * math.sin(turn) + dy * math.cos(turn)) for dx in (-0.4, 0.4) for dy in (-0.3, 0.3)]
    for _ in range(5):
        cupboards.append({"at": turned(*place(0.6), angle_rad), "size": [draw.uniform(0.3, 0.7), draw.uniform(0.3, 0.7), draw.uniform(1.3, 2.0)],
                          "yaw_deg": draw.uniform(0, 180)})
    for radius in (0.02, 0.04, 0.15):
        pillars.append({"at": turned(*place(0.6), angle_rad), "radius": radius, "height": 2.5})
    pillars += [{"at": turned(*leg, angle_rad), "radius": 0.025, "height": 2.2} for leg in legs]
    return plan | {"boxes": cupboards, "pillars": pillars}
