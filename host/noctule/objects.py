"""The objects of a run: read from objects.db (docs/objects.md), graded against the world, exported.

Positions in the database are in Map; the true start pose places them in World, for the grade alone.
"""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import math
import sqlite3
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from noctule.record import RecordError

SCHEMA = 2
APPLICATION = 0x4E4F4354
FOUND_M = 0.75          # an object is found if it is listed within this distance of its true place
SOURCES = ("none", "laser", "floor", "wall")


@dataclass
class View:
    """One picture: BMP bytes, direction from the object to the camera [rad, Map], distance [m]."""

    t_us: int
    direction_rad: float
    distance_m: float
    features: int
    picture: bytes


@dataclass
class StoredObject:
    """One row of the table `object`, with its pictures."""

    id: int
    confirmed: bool
    floor: int
    position_m: tuple[float, float, float]      # centre of the footprint and middle of the height, Map
    covariance_m2: tuple[float, float, float]   # xx, xy, yy
    width_m: float
    height_m: float
    first_seen_s: float
    last_seen_s: float
    sightings: int
    textured: bool
    colour: list[float]
    views: list[View] = field(default_factory=list)

    @property
    def sigma_m(self) -> float:
        """Greatest standard deviation of the position."""
        xx, xy, yy = self.covariance_m2
        return math.sqrt(max(np.linalg.eigvalsh([[xx, xy], [xy, yy]])))

    @property
    def kind(self) -> str:
        """'textured' or 'plain'."""
        return "textured" if self.textured else "plain"


def read(path, candidates: bool = False) -> list[StoredObject]:
    """The objects in a database, by id; candidates: also those that were not yet sure.

    Raises:
        RecordError: no such file, another program's, or a schema that is not known.
    """
    path = Path(path)
    if not path.is_file():
        raise RecordError(f"{path}: no such file; was the camera on?")
    try:
        with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as base:
            version = base.execute("PRAGMA user_version").fetchone()[0]
            application = base.execute("PRAGMA application_id").fetchone()[0]
            if application != APPLICATION or not 1 <= version <= SCHEMA:
                raise RecordError(f"{path}: not an object database of schema 1 to {SCHEMA} (application {application:#x}, schema {version})")
            extra = "textured, colour" if version >= 2 else "0, x''"
            rows = base.execute("SELECT id, confirmed, floor, x_m, y_m, z_m, xx_m2, xy_m2, yy_m2, width_m, height_m, first_seen_us, last_seen_us, "
                                f"sightings, {extra} FROM object ORDER BY id").fetchall()
            views = base.execute("SELECT object, t_us, direction_rad, distance_m, length(features), picture FROM view ORDER BY object, slot").fetchall()
    except sqlite3.DatabaseError as error:
        raise RecordError(f"{path}: {error}") from None
    found = {}
    for r in rows:
        if r[1] or candidates:
            found[r[0]] = StoredObject(r[0], bool(r[1]), r[2], (r[3], r[4], r[5]), (r[6], r[7], r[8]), r[9], r[10], r[11] * 1e-6, r[12] * 1e-6,
                                       r[13], bool(r[14]), np.frombuffer(r[15], "<f4").tolist())
    for o, t_us, direction, distance, size, picture in views:
        if o in found:
            found[o].views.append(View(t_us, direction, distance, size // 276, picture))
    return list(found.values())


@dataclass
class Grade:
    """Objects against the truth. rows: one a stored object, in order: (object, true name or None, error [m] or None, duplicate)."""

    rows: list[tuple[StoredObject, str | None, float | None, bool]]
    missed: list[str]

    @property
    def found(self) -> int:
        """True objects that are listed."""
        return sum(name is not None and not again for _, name, _, again in self.rows)

    @property
    def duplicated(self) -> int:
        """Listed once more than they exist."""
        return sum(again for _, _, _, again in self.rows)

    @property
    def false(self) -> int:
        """Listed where there is none."""
        return sum(name is None for _, name, _, _ in self.rows)

    @property
    def errors_m(self) -> list[float]:
        """Position errors of the found ones."""
        return [e for _, name, e, again in self.rows if name is not None and not again]


def grade(objects: list[StoredObject], world, start) -> Grade:
    """Each stored object with the nearest true one within FOUND_M on its floor; nearest pairs first, each true one once.

    Args:
        world: the building; the truth is the centre of an object's footprint.
        start: noctule.score.StartPose, World * Map.
    """
    truth = [(o.name, o.primitive.centre_m) for o in world.objects]
    pairs = []
    for i, o in enumerate(objects):
        x, y = start.to_world(o.position_m[0], o.position_m[1])
        for j, (_, centre) in enumerate(truth):
            d = math.hypot(x - centre[0], y - centre[1])
            if d <= FOUND_M and abs(o.position_m[2] + start.z_m - centre[2]) < 1.2:
                pairs.append((d, i, j))
    owner, taken = {}, set()
    for d, i, j in sorted(pairs):
        if i not in owner and j not in taken:
            owner[i] = (j, d, False)
            taken.add(j)
    for d, i, j in sorted(pairs):
        if i not in owner:
            owner[i] = (j, d, True)
    rows = []
    for i, o in enumerate(objects):
        j, d, again = owner.get(i, (None, None, False))
        rows.append((o, None if j is None else truth[j][0], d, again))
    return Grade(rows, [name for j, (name, _) in enumerate(truth) if j not in taken])


def report_fields(folder: Path, world, start) -> dict:
    """objects, objects_missed, objects_duplicated and objects_false of report.json; without a database an empty list and nulls."""
    path = Path(folder) / "objects.db"
    if not path.is_file():
        return {"objects": [], "objects_missed": None, "objects_duplicated": None, "objects_false": None}
    graded = grade(read(path), world, start)
    rows = [{"id": o.id, "true_id": name, "floor": o.floor, "position_m": [round(v, 4) + 0.0 for v in o.position_m],
             "error_m": None if error is None else round(error, 4), "sightings": o.sightings, "sigma_m": round(o.sigma_m, 4),
             "kind": o.kind, "width_m": round(o.width_m, 3), "height_m": round(o.height_m, 3)}
            for o, name, error, _ in graded.rows]
    return {"objects": rows, "objects_missed": len(graded.missed), "objects_duplicated": graded.duplicated, "objects_false": graded.false}


def section(folder: Path, report: dict, world, start) -> str:
    """The objects in report.html: plan of each floor, then a line an object with its best picture; empty without a database."""
    path = Path(folder) / "objects.db"
    if not path.is_file():
        return ""
    found = {o.id: o for o in read(path)}
    lines = []
    for row in report["objects"]:
        o = found[row["id"]]
        shown = [v for v in o.views if v.picture]
        best = max(shown, key=lambda v: (v.features, -v.distance_m)) if shown else None
        picture = f'<img src="{picture_uri(best.picture)}" alt="object {o.id}" style="height:64px">' if best else ""
        error = "-" if row["error_m"] is None else f'{100.0 * row["error_m"]:.1f} cm'
        cells = (o.id, html.escape(row["true_id"] or "none"), o.kind, o.floor, f"{o.position_m[0]:.2f}, {o.position_m[1]:.2f}", error, f"{100.0 * o.sigma_m:.1f} cm",
                 f"{o.width_m:.2f} x {o.height_m:.2f} m", o.sightings)
        lines.append(f'<tr id="object{o.id}"><td>{picture}</td>' + "".join(f"<td>{c}</td>" for c in cells) + "</tr>")
    heads = "".join(f"<th>{c}</th>" for c in ("", "id", "true name", "kind", "floor", "x, y in Map", "error", "sigma", "size", "sightings"))
    plans = "".join(f"<h3>Floor {floor}</h3>{svg}" for floor, svg in plans_of(Path(folder), list(found.values()), world, start).items())
    return (f"<h2>Objects</h2><p>{len(lines)} listed; missed {report['objects_missed']}, duplicated {report['objects_duplicated']}, false {report['objects_false']}. "
            f"Red: with texture, blue: plain; the disc is two standard deviations. Green rings: true places.</p>{plans}<table><tr>{heads}</tr>{''.join(lines)}</table>")


# ---------------------------------------------------------------- exports


COLUMNS = ("id", "kind", "floor", "x_m", "y_m", "z_m", "sigma_m", "width_m", "height_m", "sightings", "pictures", "first_seen_s", "last_seen_s")


def table(objects: list[StoredObject]) -> list[dict]:
    """One dict a object with the keys of COLUMNS."""
    return [{"id": o.id, "kind": o.kind, "floor": o.floor, "x_m": round(o.position_m[0], 3), "y_m": round(o.position_m[1], 3),
             "z_m": round(o.position_m[2], 3), "sigma_m": round(o.sigma_m, 3), "width_m": round(o.width_m, 3), "height_m": round(o.height_m, 3),
             "sightings": o.sightings, "pictures": len(o.views), "first_seen_s": round(o.first_seen_s, 2), "last_seen_s": round(o.last_seen_s, 2)}
            for o in objects]


def text(objects: list[StoredObject]) -> str:
    """For a terminal."""
    cells = [COLUMNS] + [tuple(str(v) for v in row.values()) for row in table(objects)]
    widths = [max(len(c[i]) for c in cells) for i in range(len(COLUMNS))]
    return "\n".join("  ".join(c[i].rjust(widths[i]) for i in range(len(COLUMNS))) for c in cells)


def as_csv(objects: list[StoredObject]) -> str:
    """CSV with a head line."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(table(objects))
    return out.getvalue()


def as_json(objects: list[StoredObject]) -> str:
    """JSON: {"objects": [...]} with the covariance and the directions of the pictures as well."""
    rows = table(objects)
    for row, o in zip(rows, objects):
        row["covariance_m2"] = list(o.covariance_m2)
        row["views"] = [{"t_us": v.t_us, "direction_rad": v.direction_rad, "distance_m": v.distance_m, "features": v.features} for v in o.views]
    return json.dumps({"frame": "Map", "objects": rows}, indent=2) + "\n"


def picture_uri(picture: bytes) -> str:
    """A stored picture as a PNG data URI."""
    from PIL import Image

    out = io.BytesIO()
    Image.open(io.BytesIO(picture)).save(out, "PNG")
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode()


def plan_svg(objects: list[StoredObject], floor: int, grid=None, start=None, world=None) -> str:
    """The plan of a floor with the objects on it as SVG, frame Map, x to the right, y up.

    Args:
        grid: as record.map_of: log odds (rows, columns), x and y of the corner [m], cell edge [m]; or None.
        start, world: with both, true places are marked as well.
    """
    here = [o for o in objects if o.floor == floor]
    xs, ys = [o.position_m[0] for o in here] or [0.0], [o.position_m[1] for o in here] or [0.0]
    box = [min(xs) - 1.0, min(ys) - 1.0, max(xs) + 1.0, max(ys) + 1.0]
    cells = ""
    if grid is not None:
        odds, x0, y0, cell = grid
        rows, columns = np.nonzero(odds)
        if len(rows):
            box = [min(box[0], x0 + columns.min() * cell), min(box[1], y0 + rows.min() * cell),
                   max(box[2], x0 + (columns.max() + 1) * cell), max(box[3], y0 + (rows.max() + 1) * cell)]
        from PIL import Image

        shade = np.full((*odds.shape, 4), 0, np.uint8)
        shade[odds < 0] = (244, 243, 238, 255)
        shade[odds > 0] = (60, 60, 66, 255)
        out = io.BytesIO()
        Image.fromarray(shade[::-1]).save(out, "PNG")
        height, width = odds.shape
        cells = (f'<image x="{x0:.3f}" y="{-(y0 + height * cell):.3f}" width="{width * cell:.3f}" height="{height * cell:.3f}" '
                 f'style="image-rendering:pixelated" href="data:image/png;base64,{base64.b64encode(out.getvalue()).decode()}"/>')
    marks = []
    if start is not None and world is not None:
        for true in world.objects:
            c, s = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
            dx, dy = true.primitive.centre_m[0] - start.x_m, true.primitive.centre_m[1] - start.y_m
            low = sum(f.elevation_m <= true.primitive.centre_m[2] for f in world.floors) - 1
            if low == floor:
                marks.append(f'<circle cx="{c * dx + s * dy:.3f}" cy="{-(-s * dx + c * dy):.3f}" r="0.12" fill="none" stroke="#2a9d3a" stroke-width="0.05"/>')
    for o in here:
        x, y, _ = o.position_m
        colour = "#c8102e" if o.textured else "#1f4fbf"
        marks.append(f'<a href="#object{o.id}"><circle cx="{x:.3f}" cy="{-y:.3f}" r="{max(0.08, 2 * o.sigma_m):.3f}" fill="{colour}" fill-opacity="0.5"/>'
                     f'<text x="{x + 0.15:.3f}" y="{-y - 0.1:.3f}" font-size="0.45" fill="{colour}">{o.id}</text></a>')
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box[0]:.2f} {-box[3]:.2f} {box[2] - box[0]:.2f} {box[3] - box[1]:.2f}" '
            f'style="max-width:760px;width:100%;background:#fff;border:1px solid #bbb">{cells}{"".join(marks)}</svg>')


def gallery(objects: list[StoredObject], title: str, plans: dict[int, str], names: dict[int, str] | None = None) -> str:
    """An HTML page: the plan of each floor with the objects on it, then each object with its pictures. Needs no other file."""
    cards = []
    for o in objects:
        pictures = "".join(f'<figure><img src="{picture_uri(v.picture)}" alt="object {o.id}"><figcaption>from {math.degrees(v.direction_rad):.0f}&deg;, '
                           f'{v.distance_m:.1f} m, {v.features} features</figcaption></figure>' for v in o.views if v.picture)
        name = f' <small>{html.escape(names[o.id])}</small>' if names and o.id in names else ""
        cards.append(f'<section id="object{o.id}"><h2>Object {o.id}{name}</h2><p>{o.kind}, floor {o.floor}, at ({o.position_m[0]:.2f}, {o.position_m[1]:.2f}) m '
                     f'&plusmn; {o.sigma_m:.2f} m, {o.width_m:.2f} m wide, {o.height_m:.2f} m high; {o.sightings} sightings, '
                     f'{o.first_seen_s:.1f} to {o.last_seen_s:.1f} s</p><div class="row">{pictures}</div></section>')
    shown = "".join(f"<h2>Floor {floor}</h2>{svg}" for floor, svg in sorted(plans.items()))
    return (f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title><style>'
            'body{font:15px/1.45 sans-serif;margin:2em auto;max-width:1000px;padding:0 1em;color:#222}section{border-top:1px solid #ddd}'
            '.row{display:flex;flex-wrap:wrap;gap:10px}figure{margin:0}img{height:130px;border:1px solid #ccc}figcaption{font-size:12px;color:#666}'
            f'small{{color:#777}}</style></head><body><h1>{html.escape(title)}</h1><p>{len(objects)} objects. Positions in Map: x ahead at the start, y left. '
            f'Red: with texture, blue: plain; the disc is two standard deviations. Green rings: true places, where they are known.</p>{shown}{"".join(cards)}</body></html>')


def plans_of(folder: Path, objects: list[StoredObject], world=None, start=None) -> dict[int, str]:
    """plan_svg of each floor that has an object, on the map that the run recorded."""
    from noctule import record

    try:
        tiles = record.read_flight(folder / "flight.lcm").tiles
    except RecordError:
        tiles = []
    return {floor: plan_svg(objects, floor, record.map_of(tiles, floor), start, world) for floor in sorted({o.floor for o in objects} | {0})}


def export(folder: Path, form: str) -> str:
    """The objects of a run directory (or of a database file) as 'csv', 'json' or 'html'.

    Raises:
        RecordError: there is no database.
    """
    folder = Path(folder)
    path = folder if folder.is_file() else folder / "objects.db"
    objects = read(path)
    if form == "csv":
        return as_csv(objects)
    if form == "json":
        return as_json(objects)
    world = start = names = None
    if folder.is_dir():
        from noctule import report

        try:
            run = report.open_run(folder)
            world, start = run.world, run.start
            names = {o.id: name for o, name, _, _ in grade(objects, world, start).rows if name}
        except RecordError:
            pass
    plans = plans_of(folder, objects, world, start) if folder.is_dir() else {}
    return gallery(objects, f"Objects of {path.parent.name if folder.is_dir() else path.name}", plans, names)


def show(folder: Path, number: int) -> str:
    """One object in full: its row, its pictures, its last sightings.

    Raises:
        RecordError: there is no such object.
    """
    folder = Path(folder)
    path = folder if folder.is_file() else folder / "objects.db"
    found = [o for o in read(path, candidates=True) if o.id == number]
    if not found:
        raise RecordError(f"{path}: no object {number}")
    o = found[0]
    lines = [f"{k}: {v}" for k, v in table(found)[0].items()] + [f"covariance_m2: {o.covariance_m2}"]
    lines += [f"picture from {math.degrees(v.direction_rad):.0f} deg at {v.distance_m:.2f} m, {v.features} features, t {v.t_us * 1e-6:.2f} s" for v in o.views]
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as base:
        rows = base.execute("SELECT t_us, x_m, y_m, along_sigma_m, across_sigma_m, range_source, whole, features FROM sighting WHERE object=? "
                            "ORDER BY id DESC LIMIT 10", (number,)).fetchall()
    lines += [f"seen at {t * 1e-6:.2f} s at ({x:.2f}, {y:.2f}) +- {a:.2f} / {c:.2f} m by {SOURCES[s]}{'' if whole else ', in part'}, {n} features"
              for t, x, y, a, c, s, whole, n in rows]
    return "\n".join(lines)
