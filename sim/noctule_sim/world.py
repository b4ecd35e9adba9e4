"""Worlds: what is solid, where the vehicle starts, and what the light shines on.

A world comes from a YAML file (docs/worlds.md) or from a plan JSON, and expands into primitives: boxes and
cylinders that stand upright, turned only about the vertical. Physics, ray casting, the camera, the clearance and
the score all use these same primitives. Frame World: z up, metres, chosen by the author of the file; the vehicle's
Map frame is joined to it by the true start pose alone.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import yaml

PLAN_WALL_THICKNESS_M = 0.10
PLAN_HEIGHT_M = 2.5
HULL_RADIUS_M = 0.30  # default of the parameter hull_radius_m; callers that know better pass their own
LASER_KINDS = ("diffuse", "dark", "glass")
TEXTURES = ("none", "checker", "speckle", "gradient", "picture")
WORLDS_FOLDER = Path(__file__).parent / "worlds"


class WorldError(ValueError):
    """The world cannot be used; the text is one line that says what is wrong and where."""


@dataclass(frozen=True)
class Start:
    """True pose at the start, frame World: the point of the floor under the vehicle, and its heading."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


@dataclass(frozen=True)
class Material:
    """How a surface answers the laser (diffuse; dark and glass give no return) and how it looks."""

    name: str
    laser: str = "diffuse"
    rgba: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    texture: str = "none"


@dataclass(frozen=True)
class Primitive:
    """One upright solid, frame World.

    kind: 'box' or 'cylinder'. centre_m: (3,) of the solid. half_extent_m: (3,) along its own axes; of a cylinder
    (radius, radius, half height). yaw_rad turns a box about the vertical. tag: 'wall', 'slab', 'stairs', 'box',
    'pillar' or 'object'. label: which item of the world's description it came from.
    """

    kind: str
    centre_m: tuple[float, float, float]
    half_extent_m: tuple[float, float, float]
    yaw_rad: float
    material: str
    tag: str
    label: str = ""


@dataclass(frozen=True)
class Floor:
    """One storey: the top of its slab, the free height over it, its extent and the openings in its slab (x0, y0, x1, y1)."""

    elevation_m: float
    height_m: float
    slab_m: float
    extent_m: tuple[float, float, float, float]
    openings: tuple[tuple[float, float, float, float], ...] = ()
    material: str = "floor"


@dataclass(frozen=True)
class SceneObject:
    """Something to be found by the camera, frame World."""

    name: str
    primitive: Primitive


@dataclass(frozen=True)
class World:
    """A building, frame World. `description` is the document it was built from, in the form of docs/worlds.md."""

    name: str
    start: Start
    floors: tuple[Floor, ...]
    solids: tuple[Primitive, ...]
    objects: tuple[SceneObject, ...]
    lights: tuple[tuple[float, float, float], ...]
    materials: dict[str, Material]
    description: dict = field(repr=False)

    def primitives(self) -> list[Primitive]:
        """Everything solid, slabs and objects included."""
        return [*self.solids, *(o.primitive for o in self.objects)]

    def bounds_m(self) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) of all floors."""
        return (
            min(f.extent_m[0] for f in self.floors), min(f.extent_m[1] for f in self.floors),
            max(f.extent_m[2] for f in self.floors), max(f.extent_m[3] for f in self.floors),
        )


def shipped_worlds() -> list[str]:
    """Names of the worlds that come with the simulator."""
    return sorted(p.stem for p in WORLDS_FOLDER.glob("*.yaml"))


def load_world(name_or_path, hull_radius_m: float = HULL_RADIUS_M) -> World:
    """The world of that shipped name, YAML file or plan JSON.

    Raises:
        WorldError: no such world, not readable, not understood, or the vehicle does not fit at the start.
    """
    path = _find(str(name_or_path))
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise WorldError(f"{path}: cannot be read: {_one_line(error)}") from None
    try:
        if path.suffix.lower() == ".json":
            description = plan_description(_parse_json(text), path.stem)
        else:
            description = _parse_yaml(text)
        world = build_world(description, path.stem)
        check_start(world, hull_radius_m)
    except WorldError as error:
        raise WorldError(f"{path}: {error}") from None
    return world


def dump_world(world: World, path) -> None:
    """Write the world as YAML that load_world reads back as the same world."""
    text = yaml.safe_dump(world.description, sort_keys=False, default_flow_style=None, width=160)
    Path(path).write_text(text, encoding="utf-8")


# ---------------------------------------------------------------- files


def _find(name: str) -> Path:
    path = Path(name)
    if path.suffix.lower() in (".yaml", ".yml", ".json"):
        if not path.is_file():
            raise WorldError(f"{name}: no such file")
        return path
    shipped = WORLDS_FOLDER / f"{name}.yaml"
    if shipped.is_file():
        return shipped
    if path.is_file():
        raise WorldError(f"{name}: a world file ends in .yaml, .yml or .json")
    raise WorldError(f"no world '{name}'; shipped are {', '.join(shipped_worlds())}, or give a .yaml or a plan .json")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _parse_json(text: str):
    try:
        return json.loads(text)
    except ValueError as error:
        raise WorldError(f"is not JSON: {_one_line(error)}") from None


def _parse_yaml(text: str):
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        raise WorldError(f"is not YAML: {getattr(error, 'problem', None) or _one_line(error)}{where}") from None


def plan_description(plan, name: str = "plan") -> dict:
    """The world description of a plan: {"walls": [[x1, y1, x2, y2], ...], "start": [x, y], "height": 2.5} in metres.

    Walls are 0.10 m thick, centred on the line; one slab and one ceiling cover them all; the start faces +x.

    Raises:
        WorldError: a field is missing or is not what it should be.
    """
    if not isinstance(plan, dict):
        raise WorldError("a plan must be an object with walls and start")
    walls = plan.get("walls")
    if not isinstance(walls, list) or not walls:
        raise WorldError("walls: a list of [x1, y1, x2, y2] is missing")
    segments = []
    for i, wall in enumerate(walls):
        x1, y1, x2, y2 = _numbers(wall, 4, f"walls[{i}]")
        if math.hypot(x2 - x1, y2 - y1) < 1e-6:
            raise WorldError(f"walls[{i}]: has no length")
        segments.append((x1, y1, x2, y2))
    if "start" not in plan:
        raise WorldError("start: [x, y] is missing")
    x, y = _numbers(plan["start"], 2, "start")
    height = PLAN_HEIGHT_M if plan.get("height") is None else _number(plan["height"], "height")
    if not 0.5 <= height <= 100.0:
        raise WorldError(f"height: {height:g} is outside 0.5 to 100 m")
    xs = [v for s in segments for v in (s[0], s[2])]
    ys = [v for s in segments for v in (s[1], s[3])]
    extent = [min(xs) - 0.5, min(ys) - 0.5, max(xs) + 0.5, max(ys) + 0.5]
    half = PLAN_WALL_THICKNESS_M / 2
    for i, (x1, y1, x2, y2) in enumerate(segments):
        if _distance_to_segment(x, y, x1, y1, x2, y2) < half:
            raise WorldError(f"start: ({x:g}, {y:g}) is inside walls[{i}]")
    return {
        "name": str(plan.get("name") or name),
        "start": {"x": x, "y": y, "z": 0.0, "yaw_deg": 0.0},
        "floors": [{"elevation": 0.0, "height": height, "slab": 0.2, "extent": extent}],
        "walls": [
            {"from": [x1, y1], "to": [x2, y2], "thickness": PLAN_WALL_THICKNESS_M} for x1, y1, x2, y2 in segments
        ],
    }


def _distance_to_segment(x, y, x1, y1, x2, y2) -> float:
    dx, dy = x2 - x1, y2 - y1
    s = max(0.0, min(1.0, ((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy)))
    return math.hypot(x - x1 - s * dx, y - y1 - s * dy)


# ---------------------------------------------------------------- reading a description


def _number(value, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise WorldError(f"{where}: a number is wanted, not {_shown(value)}")
    return float(value)


def _numbers(value, count: int, where: str) -> tuple[float, ...]:
    if not isinstance(value, (list, tuple)) or len(value) != count:
        raise WorldError(f"{where}: {count} numbers are wanted, not {_shown(value)}")
    return tuple(_number(v, where) for v in value)


def _shown(value) -> str:
    text = _one_line(repr(value))
    return text if len(text) <= 60 else text[:57] + "..."


_WANTED = object()  # default of a key that must be given


class _Item:
    """One mapping of the description; every key must be asked for, and an unknown one is an error."""

    def __init__(self, data, where: str, keys: tuple[str, ...]):
        if not isinstance(data, dict):
            raise WorldError(f"{where}: a mapping is wanted, not {_shown(data)}")
        for key in data:
            if key not in keys:
                raise WorldError(f"{where}: unknown key '{key}', known are {', '.join(keys)}")
        self.data = data
        self.where = where

    def _get(self, key: str, default):
        if key in self.data and self.data[key] is not None:
            return self.data[key]
        if default is _WANTED:
            raise WorldError(f"{self.where}: {key} is missing")
        return default

    def number(self, key: str, default, least=-1e6, most=1e6) -> float:
        value = _number(self._get(key, default), f"{self.where}.{key}")
        if not least <= value <= most:
            raise WorldError(f"{self.where}.{key}: {value:g} is outside {least:g} to {most:g}")
        return value

    def numbers(self, key: str, count: int, default) -> tuple[float, ...]:
        return _numbers(self._get(key, default), count, f"{self.where}.{key}")

    def text(self, key: str, default, choices=None) -> str:
        value = self._get(key, default)
        if not isinstance(value, str) or (choices and value not in choices):
            raise WorldError(f"{self.where}.{key}: {_shown(value)} is not " + (f"one of {', '.join(choices)}" if choices else "a text"))
        return value

    def items(self, key: str, keys: tuple[str, ...]) -> list["_Item"]:
        value = self._get(key, [])
        if not isinstance(value, list):
            raise WorldError(f"{self.where}.{key}: a list is wanted, not {_shown(value)}")
        prefix = f"{self.where}.{key}" if self.where != "world" else key
        return [_Item(v, f"{prefix}[{i}]", keys) for i, v in enumerate(value)]


_DEFAULT_MATERIALS = {
    "wall": Material("wall", "diffuse", (0.86, 0.84, 0.78, 1.0), "speckle"),
    "floor": Material("floor", "diffuse", (0.55, 0.52, 0.48, 1.0), "checker"),
    "ceiling": Material("ceiling", "diffuse", (0.92, 0.92, 0.92, 1.0), "none"),
    "wood": Material("wood", "diffuse", (0.62, 0.43, 0.25, 1.0), "gradient"),
    "stone": Material("stone", "diffuse", (0.60, 0.60, 0.62, 1.0), "speckle"),
    "dark": Material("dark", "dark", (0.05, 0.05, 0.05, 1.0), "none"),
    "glass": Material("glass", "glass", (0.6, 0.8, 0.9, 0.25), "none"),
}


def build_world(description, name: str = "world") -> World:
    """The world that a description (a parsed YAML of docs/worlds.md) stands for.

    Raises:
        WorldError: one line naming the place in the description and what is wrong there.
    """
    top = _Item(description, "world", ("name", "start", "materials", "floors", "walls", "boxes", "pillars", "stairs", "objects", "lights"))
    materials = _read_materials(top)
    floors = _read_floors(top, materials)
    solids = [p for i, f in enumerate(floors) for p in _slab(f, i, floors)]
    solids += _read_walls(top, floors, materials)
    solids += _read_boxes(top, floors, materials)
    solids += _read_pillars(top, floors, materials)
    solids += _read_stairs(top, floors, materials)
    start = _Item(top._get("start", _WANTED), "start", ("x", "y", "z", "yaw_deg"))
    return World(
        name=top.text("name", name),
        start=Start(start.number("x", _WANTED), start.number("y", _WANTED), start.number("z", 0.0),
                    math.radians(start.number("yaw_deg", 0.0, -360.0, 360.0))),
        floors=tuple(floors),
        solids=tuple(solids),
        objects=tuple(_read_objects(top, floors, materials)),
        lights=tuple(item.numbers("at", 3, _WANTED) for item in top.items("lights", ("at",))),
        materials=materials,
        description=description,
    )


def _read_materials(top: _Item) -> dict[str, Material]:
    materials = dict(_DEFAULT_MATERIALS)
    given = top._get("materials", {})
    if not isinstance(given, dict):
        raise WorldError("materials: a mapping of names is wanted")
    for name, data in given.items():
        item = _Item(data, f"materials.{name}", ("laser", "rgba", "texture"))
        rgba = item._get("rgba", [0.8, 0.8, 0.8])
        rgba = _numbers(rgba, 4 if isinstance(rgba, list) and len(rgba) == 4 else 3, f"materials.{name}.rgba")
        if any(not 0.0 <= c <= 1.0 for c in rgba):
            raise WorldError(f"materials.{name}.rgba: each value lies in 0 to 1")
        materials[str(name)] = Material(
            str(name), item.text("laser", "diffuse", LASER_KINDS), (*rgba, 1.0)[:4], item.text("texture", "none", TEXTURES)
        )
    return materials


def _material(item: _Item, default: str, materials: dict[str, Material]) -> str:
    return item.text("material", default, tuple(materials))


def _read_floors(top: _Item, materials) -> list[Floor]:
    floors = []
    for item in top.items("floors", ("elevation", "height", "slab", "extent", "openings", "material")):
        extent = item.numbers("extent", 4, _WANTED)
        if extent[0] >= extent[2] or extent[1] >= extent[3]:
            raise WorldError(f"{item.where}.extent: x0, y0, x1, y1 with x0 < x1 and y0 < y1 is wanted")
        given = item._get("openings", [])
        if not isinstance(given, list):
            raise WorldError(f"{item.where}.openings: a list of [x0, y0, x1, y1] is wanted")
        openings = []
        for i, value in enumerate(given):
            x0, y0, x1, y1 = _numbers(value, 4, f"{item.where}.openings[{i}]")
            if not (extent[0] <= x0 < x1 <= extent[2] and extent[1] <= y0 < y1 <= extent[3]):
                raise WorldError(f"{item.where}.openings[{i}]: does not lie in the floor's extent")
            openings.append((x0, y0, x1, y1))
        floors.append(Floor(
            item.number("elevation", 0.0), item.number("height", 2.5, 0.5, 100.0), item.number("slab", 0.2, 0.01, 5.0),
            extent, tuple(openings), _material(item, "floor", materials),
        ))
    if not floors:
        raise WorldError("floors: at least one floor is wanted")
    for i, (low, high) in enumerate(zip(floors, floors[1:]), 1):
        if abs(low.elevation_m + low.height_m + high.slab_m - high.elevation_m) > 0.01:
            raise WorldError(
                f"floors[{i}]: elevation {high.elevation_m:g} is not floors[{i - 1}]'s elevation + height + the slab"
                f" ({low.elevation_m + low.height_m + high.slab_m:g})"
            )
    return floors


def _slab(floor: Floor, index: int, floors: list[Floor]) -> list[Primitive]:
    """The floor's slab, cut into boxes round its openings; over the last floor a ceiling without openings."""
    bottom = floor.elevation_m - floor.slab_m
    out = [
        _box_between(r, bottom, floor.elevation_m, floor.material, "slab", f"floors[{index}]")
        for r in _without_openings(floor.extent_m, floor.openings)
    ]
    if index == len(floors) - 1:
        top = floor.elevation_m + floor.height_m
        out.append(_box_between(floor.extent_m, top, top + floor.slab_m, "ceiling", "slab", "ceiling"))
    return out


def _without_openings(extent, openings):
    """Rectangles that cover the extent but not the openings: cut on the openings' lines, runs of cells in a row joined."""
    xs = sorted({extent[0], extent[2], *(v for o in openings for v in (o[0], o[2]))})
    ys = sorted({extent[1], extent[3], *(v for o in openings for v in (o[1], o[3]))})
    out = []
    for y0, y1 in zip(ys, ys[1:]):
        run = None
        for x0, x1 in zip(xs, xs[1:]):
            xc, yc = (x0 + x1) / 2, (y0 + y1) / 2
            if any(o[0] < xc < o[2] and o[1] < yc < o[3] for o in openings):
                if run is not None:
                    out.append((run, y0, x0, y1))
                run = None
            elif run is None:
                run = x0
        if run is not None:
            out.append((run, y0, extent[2], y1))
    return out


def _box_between(rectangle, z0, z1, material, tag, label) -> Primitive:
    x0, y0, x1, y1 = rectangle
    return Primitive("box", ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2), ((x1 - x0) / 2, (y1 - y0) / 2, (z1 - z0) / 2), 0.0, material, tag, label)


def _floor_of(item: _Item, floors: list[Floor]) -> Floor:
    index = item.number("floor", 0, 0, len(floors) - 1)
    if index != int(index):
        raise WorldError(f"{item.where}.floor: a whole number is wanted")
    return floors[int(index)]


def _read_walls(top: _Item, floors, materials) -> list[Primitive]:
    out = []
    for item in top.items("walls", ("from", "to", "thickness", "floor", "base", "height", "material", "doors")):
        floor = _floor_of(item, floors)
        x0, y0 = item.numbers("from", 2, _WANTED)
        x1, y1 = item.numbers("to", 2, _WANTED)
        length = math.hypot(x1 - x0, y1 - y0)
        if length < 1e-6:
            raise WorldError(f"{item.where}: from and to are the same point")
        thickness = item.number("thickness", 0.1, 0.01, 5.0)
        base = item.number("base", 0.0, 0.0, floor.height_m)
        height = item.number("height", floor.height_m - base, 0.01, 100.0)
        material = _material(item, "wall", materials)
        doors = sorted(
            (d.number("at", _WANTED, 0.0, length), d.number("width", _WANTED, 0.01, length), d.number("height", 2.0, 0.01, 100.0))
            for d in item.items("doors", ("at", "width", "height"))
        )
        pieces, begin = [], 0.0  # (s0, s1, z0, z1) along the wall and up from the floor
        for at, width, door_height in doors:
            if at - width / 2 < begin - 1e-9 or at + width / 2 > length + 1e-9:
                raise WorldError(f"{item.where}.doors: the door at {at:g} does not fit in the wall or overlaps another")
            pieces.append((begin, at - width / 2, base, base + height))
            pieces.append((at - width / 2, at + width / 2, max(base, door_height), base + height))
            begin = at + width / 2
        pieces.append((begin, length, base, base + height))
        yaw = math.atan2(y1 - y0, x1 - x0)
        for s0, s1, low, high in pieces:
            if s1 - s0 > 1e-6 and high - low > 1e-6:
                s = (s0 + s1) / 2 / length
                centre = (x0 + s * (x1 - x0), y0 + s * (y1 - y0), floor.elevation_m + (low + high) / 2)
                out.append(Primitive("box", centre, ((s1 - s0) / 2, thickness / 2, (high - low) / 2), yaw, material, "wall", item.where))
    return out


def _box(item: _Item, floor: Floor, material: str, tag: str) -> Primitive:
    x, y = item.numbers("at", 2, _WANTED)
    sx, sy, sz = item.numbers("size", 3, _WANTED)
    if min(sx, sy, sz) <= 0.0:
        raise WorldError(f"{item.where}.size: each edge must be positive")
    base = floor.elevation_m + item.number("base", 0.0)
    return Primitive("box", (x, y, base + sz / 2), (sx / 2, sy / 2, sz / 2), math.radians(item.number("yaw_deg", 0.0, -360.0, 360.0)),
                     material, tag, item.where)


def _cylinder(item: _Item, floor: Floor, material: str, tag: str) -> Primitive:
    x, y = item.numbers("at", 2, _WANTED)
    radius = item.number("radius", _WANTED, 0.005, 50.0)
    base = item.number("base", 0.0)
    height = item.number("height", floor.height_m - base, 0.01, 100.0)
    return Primitive("cylinder", (x, y, floor.elevation_m + base + height / 2), (radius, radius, height / 2), 0.0, material, tag, item.where)


def _read_boxes(top: _Item, floors, materials) -> list[Primitive]:
    keys = ("at", "size", "base", "yaw_deg", "floor", "material")
    return [_box(i, _floor_of(i, floors), _material(i, "wood", materials), "box") for i in top.items("boxes", keys)]


def _read_pillars(top: _Item, floors, materials) -> list[Primitive]:
    keys = ("at", "radius", "base", "height", "floor", "material")
    return [_cylinder(i, _floor_of(i, floors), _material(i, "stone", materials), "pillar") for i in top.items("pillars", keys)]


def _read_stairs(top: _Item, floors, materials) -> list[Primitive]:
    """Steps as boxes that reach down to the floor, from the foot `at` (middle of the first riser) upwards along yaw."""
    out = []
    for item in top.items("stairs", ("at", "yaw_deg", "width", "rise", "run", "steps", "floor", "material")):
        floor = _floor_of(item, floors)
        x, y = item.numbers("at", 2, _WANTED)
        yaw = math.radians(item.number("yaw_deg", 0.0, -360.0, 360.0))
        width = item.number("width", 1.0, 0.1, 50.0)
        rise = item.number("rise", _WANTED, 0.05, 100.0)
        run = item.number("run", _WANTED, 0.05, 100.0)
        steps = int(item.number("steps", 12, 1, 200))
        material = _material(item, "stone", materials)
        for i in range(steps):
            forward = (i + 0.5) * run / steps
            top_m = (i + 1) * rise / steps
            centre = (x + forward * math.cos(yaw), y + forward * math.sin(yaw), floor.elevation_m + top_m / 2)
            out.append(Primitive("box", centre, (run / steps / 2, width / 2, top_m / 2), yaw, material, "stairs", item.where))
    return out


def _read_objects(top: _Item, floors, materials) -> list[SceneObject]:
    out = []
    keys = ("name", "shape", "at", "base", "size", "radius", "height", "yaw_deg", "floor", "material")
    for item in top.items("objects", keys):
        floor = _floor_of(item, floors)
        shape = item.text("shape", "box", ("box", "cylinder"))
        build = _box if shape == "box" else _cylinder
        out.append(SceneObject(item.text("name", _WANTED), build(item, floor, _material(item, "wood", materials), "object")))
    return out


# ---------------------------------------------------------------- the start


def check_start(world: World, hull_radius_m: float, height_m: float = 0.40) -> None:
    """Refuse a start that is not on a floor, or where the hull up to height_m over it touches something.

    Raises:
        WorldError: says which item is too close and how close.
    """
    s = world.start
    floor = [f for f in world.floors if abs(f.elevation_m - s.z_m) < 0.01 and f.extent_m[0] <= s.x_m <= f.extent_m[2]
             and f.extent_m[1] <= s.y_m <= f.extent_m[3] and not any(o[0] < s.x_m < o[2] and o[1] < s.y_m < o[3] for o in f.openings)]
    if not floor:
        raise WorldError(f"start: ({s.x_m:g}, {s.y_m:g}, {s.z_m:g}) is not on a floor")
    nearest, label = math.inf, ""
    for p in world.primitives():
        if p.tag == "slab" or p.centre_m[2] - p.half_extent_m[2] > s.z_m + height_m or p.centre_m[2] + p.half_extent_m[2] < s.z_m + 0.005:
            continue
        gap = horizontal_distance_m(p, s.x_m, s.y_m)
        if gap < nearest:
            nearest, label = gap, p.label
    if nearest < hull_radius_m:
        raise WorldError(f"start: ({s.x_m:g}, {s.y_m:g}) is {nearest:.2f} m from {label}, the hull needs {hull_radius_m:.2f} m")


def horizontal_distance_m(p: Primitive, x_m: float, y_m: float) -> float:
    """Horizontal distance [m] from a point to the primitive's footprint, 0 inside. Frame World."""
    dx, dy = x_m - p.centre_m[0], y_m - p.centre_m[1]
    if p.kind == "cylinder":
        return max(0.0, math.hypot(dx, dy) - p.half_extent_m[0])
    c, s = math.cos(p.yaw_rad), math.sin(p.yaw_rad)
    u = abs(c * dx + s * dy) - p.half_extent_m[0]
    v = abs(-s * dx + c * dy) - p.half_extent_m[1]
    return math.hypot(max(u, 0.0), max(v, 0.0))
