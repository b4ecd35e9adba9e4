"""Reads an atlas (docs/atlas.md) and draws it: floor plans side by side, and stacked in three dimensions."""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

MAGIC = b"NOCTATLS"
VERSION = 1
TILE_CELLS = 64
_HEADER = struct.Struct("<8sIIQqQII")
_SECTION = struct.Struct("<IiII")
FLOOR, WALLS, LEVELS, TILES, PASSAGES, REFUSED, OBJECTS = range(1, 8)
REFUSALS = ("", "too small", "not seen all round", "no way there", "no room beyond", "clearance gone", "no floor behind it", "too many floors")


class AtlasError(ValueError):
    """The file is no atlas, or is damaged; the text is one line."""


@dataclass
class AtlasFloor:
    """One floor, frame Map. walls: (N, 10) r, alpha, x0, y0, x1, y1, var r, var alpha, v, seen. tiles: (tile_x, tile_y) -> (64, 64) int8."""

    elevation_m: float
    walls: np.ndarray = field(default_factory=lambda: np.zeros((0, 10)))
    cell_m: float = 0.1
    tiles: dict = field(default_factory=dict)

    def area_m2(self) -> float:
        """What is known of it, free or occupied."""
        return sum(int(np.count_nonzero(t)) for t in self.tiles.values()) * self.cell_m**2

    def image(self) -> tuple[np.ndarray, tuple[float, float, float, float]]:
        """(rows, columns) int8 log odds and its extent x0, x1, y0, y1 [m]; one empty cell where nothing is known."""
        if not self.tiles:
            return np.zeros((1, 1), np.int8), (0.0, self.cell_m, 0.0, self.cell_m)
        xs, ys = [k[0] for k in self.tiles], [k[1] for k in self.tiles]
        x0, y0 = min(xs), min(ys)
        out = np.zeros(((max(ys) - y0 + 1) * TILE_CELLS, (max(xs) - x0 + 1) * TILE_CELLS), np.int8)
        for (x, y), tile in self.tiles.items():
            out[(y - y0) * TILE_CELLS:(y - y0 + 1) * TILE_CELLS, (x - x0) * TILE_CELLS:(x - x0 + 1) * TILE_CELLS] = tile
        edge = TILE_CELLS * self.cell_m
        return out, (x0 * edge, (max(xs) + 1) * edge, y0 * edge, (max(ys) + 1) * edge)


@dataclass
class Atlas:
    """A building, frame Map. levels: (N, 8) z, var, x0, y0, x1, y1, facing, seen. passages: (low, high, x, y); refused: (floor, why, x, y);
    objects: (id, floor, x, y, z)."""

    sequence: int
    t_us: int
    floors: dict[int, AtlasFloor]
    levels: np.ndarray
    passages: list[tuple]
    refused: list[tuple]
    objects: list[tuple]


def parse(data: bytes) -> Atlas:
    """The atlas in these bytes.

    Raises:
        AtlasError: no atlas, another version, cut short, or a wrong checksum.
    """
    if len(data) < _HEADER.size or data[:8] != MAGIC:
        raise AtlasError("is not an atlas")
    _, version, sections, sequence, t_us, size, crc, head_crc = _HEADER.unpack_from(data)
    if zlib.crc32(data[:_HEADER.size - 4]) != head_crc:
        raise AtlasError("its header is damaged")
    if version != VERSION:
        raise AtlasError(f"is of version {version}, this program reads {VERSION}")
    body = data[_HEADER.size:_HEADER.size + size]
    if len(body) != size or zlib.crc32(body) != crc:
        raise AtlasError("is cut short or damaged")
    atlas = Atlas(sequence, t_us, {}, np.zeros((0, 8)), [], [], [])
    at = 0
    try:
        for _ in range(sections):
            kind, floor, count, length = _SECTION.unpack_from(body, at)
            at += _SECTION.size
            _section(atlas, kind, floor, count, body[at:at + length])
            at += length
    except (struct.error, ValueError, KeyError) as error:
        raise AtlasError(f"a section is not what it should be: {error}") from None
    return atlas


def _section(atlas: Atlas, kind: int, floor: int, count: int, body: bytes) -> None:
    if kind == FLOOR:
        atlas.floors[floor] = AtlasFloor(*struct.unpack("<f", body))
    elif kind == WALLS:
        rows = [struct.unpack_from("<8f2i", body, 40 * i) for i in range(count)]
        atlas.floors[floor].walls = np.array(rows, float).reshape(-1, 10)
    elif kind == TILES:
        (atlas.floors[floor].cell_m,) = struct.unpack_from("<f", body)
        stride = 8 + TILE_CELLS**2
        for i in range(count):
            x, y = struct.unpack_from("<ii", body, 4 + stride * i)
            cells = np.frombuffer(body, np.int8, TILE_CELLS**2, 12 + stride * i)
            atlas.floors[floor].tiles[x, y] = cells.reshape(TILE_CELLS, TILE_CELLS)
    elif kind == LEVELS:
        atlas.levels = np.array([struct.unpack_from("<6f2i", body, 32 * i) for i in range(count)], float).reshape(-1, 8)
    elif kind == PASSAGES:
        atlas.passages = [struct.unpack_from("<iiff", body, 16 * i) for i in range(count)]
    elif kind == REFUSED:
        atlas.refused = [struct.unpack_from("<iiff", body, 16 * i) for i in range(count)]
    elif kind == OBJECTS:
        atlas.objects = [struct.unpack_from("<iifff", body, 20 * i) for i in range(count)]
    # Others come from a later minor change: passed over.


def of_record(tiles, elevations_m: list[float], nav=None) -> Atlas:
    """An atlas of what a flight log holds: its tiles (record.Tile, the last of a place counts), the elevation of each floor, and from `nav` (arrays
    of a record.Flight) the places where the vehicle came to a floor for the first time."""
    building = Atlas(0, 0, {n: AtlasFloor(z) for n, z in enumerate(elevations_m)}, np.zeros((0, 8)), [], [], [])
    for tile in tiles:
        if tile.floor in building.floors:
            building.floors[tile.floor].cell_m = tile.cell_m
            building.floors[tile.floor].tiles[tile.tile_x, tile.tile_y] = np.asarray(tile.log_odds, np.int8).reshape(TILE_CELLS, TILE_CELLS)
    if nav is not None:
        floors, known = nav["floor"], {int(nav["floor"][0])} if len(nav["floor"]) else set()
        for i in np.nonzero(np.diff(floors))[0]:
            low, high = sorted((int(floors[i]), int(floors[i + 1])), key=lambda n: elevations_m[n] if 0 <= n < len(elevations_m) else 0.0)
            if int(floors[i + 1]) not in known and low in building.floors and high in building.floors:
                building.passages.append((low, high, float(nav["x_m"][i + 1]), float(nav["y_m"][i + 1])))
            known.add(int(floors[i + 1]))
    return building


def read(path) -> Atlas:
    """The atlas of a file.

    Raises:
        AtlasError: it cannot be read or is no atlas.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise AtlasError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return parse(data)
    except AtlasError as error:
        raise AtlasError(f"{path}: {error}") from None


def summary(atlas: Atlas) -> str:
    """What is in it, for a terminal."""
    lines = [f"atlas of version {VERSION}, number {atlas.sequence}, at {atlas.t_us * 1e-6:.2f} s"]
    for name, floor in sorted(atlas.floors.items()):
        lines.append(f"floor {name}: elevation {floor.elevation_m:.3f} m, {floor.area_m2():.1f} m2 known, {len(floor.walls)} walls, {len(floor.tiles)} tiles")
    lines.append(f"{len(atlas.levels)} levels, {len(atlas.objects)} objects")
    lines += [f"passage between floors {low} and {high} at ({x:.2f}, {y:.2f})" for low, high, x, y in atlas.passages]
    lines += [f"opening from floor {floor} at ({x:.2f}, {y:.2f}) refused: {REFUSALS[why] if 0 <= why < len(REFUSALS) else why}"
              for floor, why, x, y in atlas.refused]
    return "\n".join(lines)


def _known(floor: AtlasFloor) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    # The part of the floor's image that holds something, and a cell of margin round it.
    image, (x0, _, y0, _) = floor.image()
    rows, columns = np.nonzero(image)
    if len(rows) == 0:
        return image, (x0, x0 + floor.cell_m, y0, y0 + floor.cell_m)
    r0, r1, c0, c1 = max(rows.min() - 5, 0), rows.max() + 6, max(columns.min() - 5, 0), columns.max() + 6
    cut = image[r0:r1, c0:c1]
    return cut, (x0 + c0 * floor.cell_m, x0 + (c0 + cut.shape[1]) * floor.cell_m, y0 + r0 * floor.cell_m, y0 + (r0 + cut.shape[0]) * floor.cell_m)


def picture(atlas: Atlas, track=None) -> bytes:
    """PNG: the floor plans side by side, and the building stacked in three dimensions.

    Args:
        track: (N, 4) x, y, z [m], frame Map, and floor of the way flown, or None.
    """
    from matplotlib.figure import Figure

    floors = sorted(atlas.floors.items())
    figure = Figure(figsize=(4.2 * (len(floors) + 1), 4.6), layout="constrained")
    for n, (name, floor) in enumerate(floors):
        axes = figure.add_subplot(1, len(floors) + 1, n + 1)
        image, extent = _known(floor)
        shade = np.where(image > 0, 0.0, np.where(image < 0, 1.0, 0.75))
        axes.imshow(shade, extent=extent, origin="lower", cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
        for wall in floor.walls:
            axes.plot(wall[[2, 4]], wall[[3, 5]], color="tab:blue", linewidth=0.8)
        for low, high, x, y in atlas.passages:
            if name in (low, high):
                axes.plot(x, y, "^" if name == low else "v", color="tab:red")
        for on, _, x, y in atlas.refused:
            if on == name:
                axes.plot(x, y, "x", color="tab:orange")
        for _, on, x, y, _ in atlas.objects:
            if on == name:
                axes.plot(x, y, "*", color="tab:green")
        if track is not None:
            here = np.where((track[:, 3] == name)[:, None], track[:, :2], np.nan)
            axes.plot(here[:, 0], here[:, 1], color="tab:blue", linewidth=0.5)
        axes.set_title(f"floor {name}, {floor.elevation_m + 0.0:.2f} m, {floor.area_m2():.0f} m2".replace("-0.00", "0.00"), fontsize=9)
        axes.set_aspect("equal")
    axes = figure.add_subplot(1, len(floors) + 1, len(floors) + 1, projection="3d")
    for name, floor in floors:
        image, extent = _known(floor)
        rows, columns = np.nonzero(image > 0)
        axes.scatter(extent[0] + (columns + 0.5) * floor.cell_m, extent[2] + (rows + 0.5) * floor.cell_m, floor.elevation_m, s=0.5)
    heights = {name: floor.elevation_m for name, floor in floors}
    for low, high, x, y in atlas.passages:
        if low in heights and high in heights:
            axes.plot([x, x], [y, y], [heights[low], heights[high]], color="tab:red")
    if track is not None:
        axes.plot(track[:, 0], track[:, 1], track[:, 2], color="0.4", linewidth=0.5)
    axes.set_box_aspect((1.0, 1.0, 0.8))
    axes.set_zlabel("z [m]")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    return buffer.getvalue()
