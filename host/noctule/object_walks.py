"""Walks for the objects' bench: random buildings with objects, and a camera carried through them, without a navigator.

One building a seed: walls in tints, floors of several kinds, furniture that is no object, and objects with pictures and plain ones, large and
small, alike in several places, close to walls and to each other, partly hidden, on one floor or two. The camera goes from place to place
as a flight does, with tilt, rates, light and noise of the simulator; what noctule-vision is told (pose, attitude, sweep) carries the errors of
a flight. A walk is written in the form of a run directory, so that the same frames can be looked at again and again.
"""

from __future__ import annotations

import colorsys
import heapq
import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

STEP_S = 0.05                   # of the laser
FRAME_EVERY = 4                 # sweeps
CRUISE_M = 1.0                  # of the body over the floor
SPEED_M_S = 0.7
TURN_RAD_S = 0.9
CELL_M = 0.1
REACH_M = 0.42                  # of the body's axis from anything solid
SPACING_M = 1.7                 # of the places that the tour goes to
POSE_SIGMA_M, YAW_SIGMA_RAD, TILT_SIGMA_RAD = 0.006, 0.0015, 0.004
SHOWN_M, SHOWN_FRAMES = 5.0, 10  # an object counts if so many frames had it in free view within so far
TEXTURED, PLAIN = 8, 4          # objects, of these two plain ones and sometimes two with pictures are alike


# ---------------------------------------------------------------- buildings


def _rgba(hue: float, saturation: float, value: float) -> list[float]:
    return [round(c, 3) for c in colorsys.hsv_to_rgb(hue % 1.0, saturation, value)]


class _Building:
    """Draws a building piece by piece; what would stand in something else is drawn anew."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng((seed, 4711))
        self.taken: list[tuple[int, float, float, float]] = []     # floor, x, y, radius

    def free(self, floor: int, x: float, y: float, radius: float, gap: float) -> bool:
        return all(f != floor or math.hypot(x - a, y - b) > radius + r + gap for f, a, b, r in self.taken)

    def spot(self, floor: int, size, radius: float, gap: float = 0.85, margin: float = 0.35):
        """A place at least `gap` from what stands there already and from the walls; None after many attempts."""
        for _ in range(300):
            x = self.rng.uniform(margin + radius, size[0] - margin - radius)
            y = self.rng.uniform(margin + radius, size[1] - margin - radius)
            if self.free(floor, x, y, radius, gap) and all(_beside(w, x, y) > radius + margin for w in self.walls if w[4] == floor):
                self.taken.append((floor, x, y, radius))
                return round(x, 2), round(y, 2)
        return None


def _beside(wall, x: float, y: float) -> float:
    x0, y0, x1, y1, _ = wall
    length2 = (x1 - x0) ** 2 + (y1 - y0) ** 2
    t = min(1.0, max(0.0, ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length2))
    return math.hypot(x - x0 - t * (x1 - x0), y - y0 - t * (y1 - y0))


def building(seed: int) -> dict:
    """The description (docs/worlds.md) of the building of that seed: every third has two floors."""
    b = _Building(seed)
    rng = b.rng
    storeys = 2 if seed % 3 == 0 else 1
    size = round(rng.uniform(9.0, 13.0), 1), round(rng.uniform(8.0, 11.0), 1)
    wall_hue = rng.uniform()
    wall_tint = rng.choice([0.0, 0.08, 0.16, 0.22])
    materials = {
        "paint": {"rgba": _rgba(wall_hue, wall_tint, rng.uniform(0.6, 0.92))},
        "ground": {"rgba": _rgba(rng.choice([0.08, 0.6, 0.3]), rng.choice([0.0, 0.05, 0.25]), rng.uniform(0.3, 0.75)),
                   "texture": str(rng.choice(["none", "speckle", "gradient", "none"]))},
        "grey": {"rgba": _rgba(0.0, 0.0, rng.uniform(0.15, 0.5))},
    }
    height = 2.4
    opening = None
    b.walls = []
    if storeys == 2:
        opening = [round(size[0] / 2 - 1.2, 2), round(size[1] / 2 - 1.2, 2), round(size[0] / 2 + 1.2, 2), round(size[1] / 2 + 1.2, 2)]
    x1, y1 = size
    for f in range(storeys):
        b.walls += [(0, 0, x1, 0, f), (x1, 0, x1, y1, f), (x1, y1, 0, y1, f), (0, y1, 0, 0, f)]
        if opening:
            b.taken.append((f, x1 / 2, y1 / 2, 1.9))
        for side in rng.permutation(4)[: rng.integers(2, 4)]:          # short walls into the room from its sides
            along, depth = rng.uniform(0.3, 0.7), rng.uniform(0.28, 0.42)
            if side < 2:
                x = round(along * x1, 2)
                b.walls.append((x, 0, x, round(depth * y1, 2), f) if side == 0 else (x, y1, x, round((1 - depth) * y1, 2), f))
            else:
                y = round(along * y1, 2)
                b.walls.append((0, y, round(depth * x1, 2), y, f) if side == 2 else (x1, y, round((1 - depth) * x1, 2), y, f))
    start = b.spot(0, size, 0.5)
    boxes = []
    for f in range(storeys):
        for _ in range(rng.integers(1, 4)):                            # furniture: wood and grey, no objects
            w, d, h = rng.uniform(0.4, 1.1), rng.uniform(0.4, 0.8), rng.uniform(0.5, 1.7)
            at = b.spot(f, size, math.hypot(w, d) / 2)
            if at:
                boxes.append({"at": list(at), "size": [round(float(v), 2) for v in (w, d, h)], "yaw_deg": float(rng.integers(0, 90)), "floor": f,
                              "material": str(rng.choice(["wood", "grey"]))})
    world = {
        "name": f"walk {seed}", "start": {"x": start[0], "y": start[1], "z": 0.0, "yaw_deg": float(rng.integers(-180, 180))},
        "materials": materials,
        "floors": [{"elevation": round(f * (height + 0.2), 2), "height": height, "slab": 0.2, "extent": [-0.05, -0.05, x1 + 0.05, y1 + 0.05],
                    "material": "ground", **({"openings": [opening]} if f == 1 else {})} for f in range(storeys)],
        "walls": [{"from": [w[0], w[1]], "to": [w[2], w[3]], "floor": w[4], "material": "paint"} for w in b.walls],
        "boxes": boxes, "objects": [],
        "lights": [{"at": [round(float(x1 * rng.uniform(0.15, 0.85)), 2), round(float(y1 * rng.uniform(0.15, 0.85)), 2), round(2.2 + f * (height + 0.2), 2)]}
                   for f in range(storeys) for _ in range(4 // storeys)],
    }
    _fill(b, world, seed, size, storeys, wall_hue if wall_tint > 0 else 0.09)
    return json.loads(json.dumps(world, default=float))     # numbers of NumPy become plain ones


def _fill(b: _Building, world: dict, seed: int, size, storeys: int, near_hue: float) -> None:
    """The objects: a third of those with pictures hang on walls; the last two plain ones are alike; one plain one is near the walls' hue."""
    rng = b.rng
    hues = (rng.uniform() + np.arange(TEXTURED + PLAIN - 1) / (TEXTURED + PLAIN - 1)) % 1.0
    rng.shuffle(hues)
    alike = rng.uniform() < 0.4                                        # two with the same picture
    for i in range(TEXTURED + PLAIN):
        plain = i >= TEXTURED
        twin = i == TEXTURED + PLAIN - 1 or (alike and i == 1)
        if twin:
            shape, material = shapes[-1], world["objects"][-1]["material"]
        else:
            material = f"{'plain' if plain else 'picture'} {seed} {i}"
            hue = near_hue if plain and i == TEXTURED else hues[i]
            world["materials"][material] = {"rgba": _rgba(hue, rng.uniform(0.7 if plain else 0.6, 0.97), rng.uniform(0.55, 0.95)),
                                            **({} if plain else {"texture": "picture"})}
            shape = _shape(rng, plain, i)
            shapes = [shape]
        floor = int(rng.integers(storeys))
        item = _hang(b, shape, floor) if shape["kind"] == "poster" else _stand(b, shape, floor, size)
        if item is None:
            continue
        world["objects"].append({"name": f"{'plain' if plain else 'picture'} {i}{' twin' if twin else ''}", "floor": floor, "material": material, **item})


def _shape(rng, plain: bool, i: int) -> dict:
    if not plain and i % 3 == 2:
        return {"kind": "poster", "width": rng.uniform(0.5, 1.2), "height": rng.uniform(0.5, 1.0)}
    if rng.uniform() < 0.4:
        return {"kind": "cylinder", "radius": rng.uniform(0.15, 0.35), "height": rng.uniform(0.7, 1.5)}
    return {"kind": "box", "size": (rng.uniform(0.3, 0.7), rng.uniform(0.3, 0.7), rng.uniform(0.5, 1.5))}


def _stand(b: _Building, shape: dict, floor: int, size):
    rng = b.rng
    radius = shape["radius"] if shape["kind"] == "cylinder" else math.hypot(*shape["size"][:2]) / 2
    # Some stand close to a wall, some close to another one.
    at = b.spot(floor, size, radius, gap=rng.choice([0.3, 0.8, 1.2]), margin=rng.choice([0.1, 0.3, 0.6]))
    if at is None:
        return None
    if shape["kind"] == "cylinder":
        return {"shape": "cylinder", "at": list(at), "radius": round(shape["radius"], 2), "height": round(shape["height"], 2)}
    return {"at": list(at), "size": [round(float(v), 2) for v in shape["size"]], "yaw_deg": float(rng.integers(0, 90))}


def _hang(b: _Building, shape: dict, floor: int):
    """On a side of a wall of that floor, away from its ends and from what stands before it."""
    rng = b.rng
    walls = [w for w in b.walls if w[4] == floor]
    for _ in range(200):
        x0, y0, x1, y1, _ = walls[rng.integers(len(walls))]
        length = math.hypot(x1 - x0, y1 - y0)
        if length < shape["width"] + 0.6:
            continue
        s = rng.uniform(0.3 + shape["width"] / 2, length - 0.3 - shape["width"] / 2)
        ux, uy = (x1 - x0) / length, (y1 - y0) / length
        x, y = x0 + s * ux - 0.065 * uy, y0 + s * uy + 0.065 * ux      # 15 mm thick board on the left side of the wall
        if b.free(floor, x, y, shape["width"] / 2, 0.3) and all(w[:4] == (x0, y0, x1, y1) or _beside(w, x, y) > shape["width"] / 2 + 0.2 for w in walls):
            b.taken.append((floor, x, y, shape["width"] / 2))
            return {"at": [round(x, 3), round(y, 3)], "base": round(float(rng.uniform(0.5, 0.9)), 2),
                    "size": [round(shape["width"], 2), 0.03, round(shape["height"], 2)], "yaw_deg": round(math.degrees(math.atan2(uy, ux)), 2)}
    return None


# ---------------------------------------------------------------- the way through it


@dataclass(frozen=True)
class _Moment:
    """True pose of Body, frame World, and the floor's index."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    floor: int


def _lattice(geometry, world, floor: int) -> tuple[np.ndarray, float, float]:
    x0, y0, x1, y1 = world.floors[floor].extent_m
    z = world.floors[floor].elevation_m + CRUISE_M
    columns, rows = int((x1 - x0) / CELL_M), int((y1 - y0) / CELL_M)
    free = np.zeros((rows, columns), bool)
    holes = [o for f in world.floors for o in f.openings]
    for r in range(rows):
        for c in range(columns):
            x, y = x0 + (c + 0.5) * CELL_M, y0 + (r + 0.5) * CELL_M
            over = any(a - 0.3 < x < d + 0.3 and e - 0.3 < y < g + 0.3 for a, e, d, g in holes) and floor > 0
            free[r, c] = not over and geometry.clearance(x, y, z, 0.0, 0.1)[0] >= REACH_M
    return free, x0, y0


def _way(free: np.ndarray, start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]]:
    """Cells from start to goal, 8-connected; empty: no way."""
    best, queue, parent = {start: 0.0}, [(0.0, start)], {}
    while queue:
        cost, cell = heapq.heappop(queue)
        if cell == goal:
            way = [cell]
            while cell in parent:
                cell = parent[cell]
                way.append(cell)
            return way[::-1]
        if cost > best[cell] + 1e-9:
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                n = cell[0] + dr, cell[1] + dc
                if (dr or dc) and 0 <= n[0] < free.shape[0] and 0 <= n[1] < free.shape[1] and free[n]:
                    c = cost + math.hypot(dr, dc)
                    if c < best.get(n, math.inf) - 1e-9:
                        best[n], parent[n] = c, cell
                        heapq.heappush(queue, (c, n))
    return []


def tour(geometry, world, rng) -> list[_Moment]:
    """Poses every STEP_S: to all places of a coarse grid, nearest first, looking ahead; round about at every other place."""
    moments: list[_Moment] = []
    for floor in range(len(world.floors)):
        free, x0, y0 = _lattice(geometry, world, floor)
        z = world.floors[floor].elevation_m + CRUISE_M
        cell = (int((world.start.y_m - y0) / CELL_M), int((world.start.x_m - x0) / CELL_M))
        if not free[cell]:
            rows, columns = np.nonzero(free)
            k = np.argmin((rows - cell[0]) ** 2 + (columns - cell[1]) ** 2)
            cell = (int(rows[k]), int(columns[k]))
        step = int(SPACING_M / CELL_M)
        places = [(r, c) for r in range(step // 2, free.shape[0], step) for c in range(step // 2, free.shape[1], step) if free[r, c]]
        yaw, visited = world.start.yaw_rad, 0
        x, y = x0 + (cell[1] + 0.5) * CELL_M, y0 + (cell[0] + 0.5) * CELL_M

        def turn(to: float) -> None:
            nonlocal yaw
            while abs(d := math.remainder(to - yaw, 2 * math.pi)) > 1e-6:
                yaw += math.copysign(min(abs(d), TURN_RAD_S * STEP_S), d)
                moments.append(_Moment(x, y, z, yaw, floor))

        while places:
            places.sort(key=lambda p: (p[0] - cell[0]) ** 2 + (p[1] - cell[1]) ** 2 + rng.uniform(0, 60))
            way = _way(free, cell, places.pop(0))
            for r, c in way[3::3] + way[-1:]:
                tx, ty = x0 + (c + 0.5) * CELL_M, y0 + (r + 0.5) * CELL_M
                length = math.hypot(tx - x, ty - y)
                if length < 1e-6:
                    continue
                turn(math.atan2(ty - y, tx - x))
                for s in np.arange(SPEED_M_S * STEP_S, length, SPEED_M_S * STEP_S):
                    moments.append(_Moment(x + (tx - x) * s / length, y + (ty - y) * s / length, z, yaw, floor))
                x, y = tx, ty
            if way:
                cell = way[-1]
                visited += 1
                if visited % 2 == 1:
                    for part in (2.0, 4.0, 6.28):
                        turn(yaw + part - (0.0 if part == 2.0 else part - 2.2))
    return moments


# ---------------------------------------------------------------- what is seen on it


def walk(seed: int, folder: Path, description: dict | None = None) -> int:
    """Walks through the building of that seed (or through the one described); frames taken. Leaves flight.lcm, camera.lcm, world.yaml, camera.yaml and shown.json.

    Raises:
        CameraUnavailable: no renderer.
    """
    import lcm
    import mujoco

    from noctule import record
    from noctule.settings import FlightSettings, parameter_values
    from noctule_sim.camera import Camera, Optics, write_calibration
    from noctule_sim.geometry import Geometry
    from noctule_sim.sensors import PROFILES, Laser
    from noctule_sim.vehicle import Airframe, Vehicle
    from noctule_sim.world import build_world, dump_world

    world = build_world(description or building(seed))
    folder.mkdir(parents=True, exist_ok=True)
    dump_world(world, folder / "world.yaml")
    write_calibration(folder / "camera.yaml")
    values = parameter_values(FlightSettings(world="maze_a", seed=1))
    mount = np.array([values[n] for n in ("lidar_x_m", "lidar_y_m", "lidar_z_m", "lidar_yaw_rad")])
    rng = np.random.default_rng((seed, 815))
    geometry, laser = Geometry(world), Laser(PROFILES["default"], rng)
    vehicle = Vehicle(world, Airframe())
    camera, optics = Camera(vehicle.model), Optics(rng)
    moments = tour(geometry, world, rng)
    encode = _Encoder(record, laser)
    frames = 0
    shown = dict.fromkeys((o.name for o in world.objects), 0)
    flight, pictures = (lcm.EventLog(str(folder / n), "w", overwrite=True) for n in ("flight.lcm", "camera.lcm"))
    try:
        drift = rng.normal(0.0, 1.0, 6)
        tilt = np.zeros(2)
        poses = np.zeros((2, 8))
        truth_before = None
        for k, m in enumerate(moments):
            t_us = int(round((k + 1) * STEP_S * 1e6))
            # Errors that change slowly, in x, y, yaw, roll, pitch, z; tilt that a vehicle flies with.
            drift = 0.98 * drift + 0.2 * rng.normal(0.0, 1.0, 6)
            tilt = 0.97 * tilt + 0.006 * rng.normal(0.0, 1.0, 2)
            truth = (m.x_m, m.y_m, m.z_m, float(tilt[0]), float(tilt[1]), m.yaw_rad)
            before = truth if truth_before is None or math.hypot(truth[0] - truth_before[0], truth[1] - truth_before[1]) > 0.2 else truth_before
            poses[0], poses[1] = _row(t_us * 1e-6 - STEP_S, before), _row(t_us * 1e-6, truth)
            out = np.zeros(laser.bearings_rad.shape[0])
            out[0] = t_us * 1e-6 - laser.sweep_s
            geometry.sweep(poses, mount, laser.bearings_rad, 10.0, out)
            flight.write_event(t_us, "SCAN", encode.scan(t_us, laser.measure(out)))
            floor = world.floors[m.floor]
            start = world.floors[0].elevation_m
            flight.write_event(t_us, "NAV", encode.nav(t_us, world, truth, drift, m.floor, floor.elevation_m - start, floor.elevation_m + floor.height_m - start))
            if k % FRAME_EVERY == 0:
                vehicle.data.qpos[:] = poses[1][1:]
                mujoco.mj_kinematics(vehicle.model, vehicle.data)
                mujoco.mj_camlight(vehicle.model, vehicle.data)
                yaw_rate = math.remainder(truth[5] - before[5], 2 * math.pi) / STEP_S
                bgr = optics.apply(camera.capture(vehicle.data), t_us * 1e-6, yaw_rate, float(truth[4] - before[4]) / STEP_S)
                pictures.write_event(t_us, "IMAGE", struct.pack(">8sqiii", encode.image, t_us, frames, bgr.shape[1], bgr.shape[0]) + bgr.tobytes())
                frames += 1
                for o in world.objects:
                    shown[o.name] += _in_view(geometry, o.primitive, m)
            truth_before = truth
    finally:
        camera.close()
        flight.close()
        pictures.close()
    (folder / "shown.json").write_text(json.dumps(shown) + "\n", encoding="utf-8")
    return frames


def _in_view(geometry, primitive, m: _Moment) -> bool:
    """Whether the camera has the middle of an object, and points to its sides, in free line of sight within SHOWN_M."""
    cx, cy, cz = primitive.centre_m
    ahead = math.atan2(cy - m.y_m, cx - m.x_m)
    half = min(primitive.half_extent_m[:2]) if primitive.kind == "cylinder" else max(primitive.half_extent_m[:2])
    for side in (-0.7, 0.0, 0.7):
        x, y = cx - side * half * math.sin(ahead), cy + side * half * math.cos(ahead)
        off = math.remainder(math.atan2(y - m.y_m, x - m.x_m) - m.yaw_rad, 2 * math.pi)
        far = math.sqrt((x - m.x_m) ** 2 + (y - m.y_m) ** 2 + (cz - m.z_m) ** 2)
        if abs(off) > 0.5 or far > SHOWN_M or abs(cz - m.z_m) > 0.4 * far:
            return False
        ray = ((x - m.x_m) / far, (y - m.y_m) / far, (cz - m.z_m) / far)
        if geometry.cast((m.x_m, m.y_m, m.z_m), ray, far) < far - half - 0.15:
            return False
    return True


def _row(t_s: float, truth) -> tuple:
    x, y, z, roll, pitch, yaw = truth
    cr, sr, cp, sp, cy, sy = (f(a / 2) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return (t_s, x, y, z, cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy)


class _Encoder:
    """NAV and SCAN as noctule-nav and the laser's driver send them."""

    def __init__(self, record, laser):
        self._nav, self._scan = record.message_type("nav_t")(), record.message_type("scan_t")()
        self.image = record.message_type("image_t")._get_packed_fingerprint()
        self._scan.count = len(laser.bearings_rad)
        self._scan.bearing_first_rad = float(laser.bearings_rad[0])
        self._scan.bearing_increment_rad = float(laser.bearings_rad[1] - laser.bearings_rad[0])
        self._scan.time_increment_us = laser.sweep_s * 1e6 / (len(laser.bearings_rad) - 1)
        self._scan.range_min_m, self._scan.range_max_m = laser.profile.laser_min_m, laser.profile.laser_max_m
        self._pad = [0.0] * (len(self._scan.range_m) - self._scan.count)

    def scan(self, t_us: int, range_m: np.ndarray) -> bytes:
        self._scan.t_us, self._scan.range_m = t_us, range_m.tolist() + self._pad
        return self._scan.encode()

    def nav(self, t_us: int, world, truth, drift, floor: int, ground_z_m: float, ceiling_z_m: float) -> bytes:
        n, s = self._nav, world.start
        dx, dy = truth[0] - s.x_m, truth[1] - s.y_m
        c, q = math.cos(s.yaw_rad), math.sin(s.yaw_rad)
        n.t_us = t_us
        n.x_m, n.y_m = c * dx + q * dy + POSE_SIGMA_M * drift[0], c * dy - q * dx + POSE_SIGMA_M * drift[1]
        n.z_m = truth[2] - s.z_m + 0.005 * drift[5]
        n.roll_rad, n.pitch_rad = truth[3] + TILT_SIGMA_RAD * drift[3], truth[4] + TILT_SIGMA_RAD * drift[4]
        n.yaw_rad = math.remainder(truth[5] - s.yaw_rad + YAW_SIGMA_RAD * drift[2], 2 * math.pi)
        n.covariance_xyyaw = [POSE_SIGMA_M**2, 0.0, 0.0, POSE_SIGMA_M**2, 0.0, YAW_SIGMA_RAD**2]
        n.ground_z_m, n.ceiling_z_m, n.floor, n.quality = ground_z_m, ceiling_z_m, floor, 100
        return n.encode()


# ---------------------------------------------------------------- looking


def look(folder: Path, database=None, parameters=None):
    """Runs the recognition over a walk (or over a flight with logged images): the grade, without what was never shown, and the times a frame [ms]."""
    import time

    from noctule import objects, record
    from noctule.bench_objects import recorded
    from noctule.score import StartPose
    from noctule.vision_abi import Vision
    from noctule_sim.world import load_world

    world = load_world(folder / "world.yaml")
    path = Path(database or folder / "objects.db")
    for end in ("", "-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)
    times = []
    with Vision(path, folder / "camera.yaml", parameters=parameters) as vision:
        for channel, data in recorded(folder):
            vision.receive(channel, data)
            if channel == "IMAGE":
                begin = time.perf_counter()
                vision.look()
                times.append(1e3 * (time.perf_counter() - begin))
    s = world.start
    graded = objects.grade(objects.read(path), world, StartPose(s.x_m, s.y_m, s.z_m, s.yaw_rad))
    shown = record.read_json(folder / "shown.json")
    if shown:
        graded.missed = [name for name in graded.missed if shown[name] >= SHOWN_FRAMES]
    return graded, times
