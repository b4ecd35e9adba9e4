"""Reads what a flight recorded: the LCM log, truth.csv, sim.json and the statistics of noctule-nav.

LCM messages come in as the generated types (package `noctule_lcm`), except grid tiles, which are many and are read
straight into numpy.
"""

from __future__ import annotations

import csv
import json
import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Iterator

import numpy as np

NAV_FLOATS = ("x_m", "y_m", "z_m", "yaw_rad", "vx_m_s", "vy_m_s", "vz_m_s", "ground_z_m", "ceiling_z_m",
              "known_area_m2", "clearance_m", "step_us", "roll_rad", "pitch_rad", "setpoint_x_m", "setpoint_y_m", "setpoint_z_m")
NAV_INTEGERS = ("t_us", "state", "reason", "floor", "quality", "reset_counter", "guard_interventions", "guard_rule",
                "landmarks", "refused_samples", "setpoint_valid", "policy", "policy_refused", "policy_timeouts")
TEXT_COLUMNS = ("mode",)
TRUTH_REQUIRED = ("t_s", "x_m", "y_m", "z_m", "yaw_rad", "armed")


class RecordError(ValueError):
    """A recorded file is missing or cannot be read; the text is one clear line."""


@dataclass(frozen=True)
class Tile:
    """One GRID_TILE: log_odds (4096,) int8, row-major, 0 unknown, positive occupied, negative free; frame Map."""

    t_us: int
    floor: int
    tile_x: int
    tile_y: int
    cell_m: float
    log_odds: np.ndarray


_TILE_HEAD = struct.Struct(">8sqiiiif")


@lru_cache(maxsize=None)
def message_type(name: str):
    """The generated LCM class, for instance message_type('nav_t')."""
    import noctule_lcm

    found = getattr(noctule_lcm, name)
    return getattr(found, name, found)      # a generated package may hand out the module


@lru_cache(maxsize=None)
def _tile_fingerprint() -> bytes:
    return message_type("grid_tile_t")._get_packed_fingerprint()


def decode_tile(data: bytes) -> Tile:
    """A GRID_TILE message.

    Raises:
        RecordError: the bytes are of another type or cut short.
    """
    if len(data) != _TILE_HEAD.size + 4096 or data[:8] != _tile_fingerprint():
        raise RecordError("GRID_TILE message of another type or length")
    _, t_us, _, floor, tile_x, tile_y, cell_m = _TILE_HEAD.unpack_from(data)
    return Tile(t_us, floor, tile_x, tile_y, cell_m, np.frombuffer(data, np.int8, 4096, _TILE_HEAD.size))


def events(path) -> Iterator[tuple[str, int, bytes]]:
    """Channel, time of logging [us] and bytes of each event of an LCM log, in order; a torn last event ends it."""
    import lcm

    path = Path(path)
    if not path.is_file():
        raise RecordError(f"{path}: no such log")
    if path.stat().st_size == 0:
        return
    log = lcm.EventLog(str(path), "r")
    try:
        for event in log:
            yield event.channel, event.timestamp, event.data
    finally:
        log.close()


@dataclass
class Flight:
    """What the score needs of a log. nav: one (N,) array a field; walls and levels: the last message or None."""

    nav: dict[str, np.ndarray]
    tiles: list[Tile]
    walls: object | None
    levels: object | None
    counts: dict[str, int]


def empty_nav() -> dict[str, np.ndarray]:
    """The nav arrays of a flight without a single step."""
    return {name: np.zeros(0) for name in NAV_FLOATS} | {name: np.zeros(0, np.int64) for name in NAV_INTEGERS}


def read_flight(path) -> Flight:
    """The flight in an LCM log."""
    nav_t, walls_t, levels_t = message_type("nav_t"), message_type("walls_t"), message_type("levels_t")
    names = NAV_FLOATS + NAV_INTEGERS
    rows, tiles, counts = [], [], {}
    walls = levels = None
    for channel, _, data in events(path):
        counts[channel] = counts.get(channel, 0) + 1
        if channel == "NAV":
            message = nav_t.decode(data)
            rows.append([getattr(message, name) for name in names])
        elif channel == "GRID_TILE":
            tiles.append(decode_tile(data))
        elif channel == "WALLS":
            walls = data
        elif channel == "LEVELS":
            levels = data
    nav = empty_nav()
    if rows:
        columns = list(zip(*rows))
        nav = {name: np.array(columns[i], np.int64 if name in NAV_INTEGERS else float) for i, name in enumerate(names)}
    return Flight(nav, tiles, walls_t.decode(walls) if walls else None, levels_t.decode(levels) if levels else None,
                  counts)


def read_truth(path) -> dict[str, np.ndarray]:
    """truth.csv as one (N,) array a column, frame World; text columns as lists of str arrays. A torn last row is left out.

    Raises:
        RecordError: the file is missing or lacks a column.
    """
    path = Path(path)
    if not path.is_file():
        raise RecordError(f"{path}: no such file; did the simulator start?")
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file)
        head = [name.strip() for name in next(reader, [])]
        rows = [row for row in reader if len(row) == len(head)]
    missing = [name for name in TRUTH_REQUIRED if name not in head]
    if missing:
        raise RecordError(f"{path}: no column {', '.join(missing)}")
    columns = list(zip(*rows)) if rows else [()] * len(head)
    result = {}
    for name, values in zip(head, columns):
        if name in TEXT_COLUMNS:
            result[name] = np.array(values, dtype=str)
        else:
            result[name] = np.array([float(v) if v.strip() else np.nan for v in values], float)
    return result


def read_json(path) -> dict:
    """A JSON object, or {} if the file is missing or torn."""
    try:
        value = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def map_of(tiles: list[Tile], floor: int) -> tuple[np.ndarray, float, float, float] | None:
    """The last state of a floor's map: log odds (rows, columns) int8, x and y of its corner [m] in Map, cell edge [m]."""
    last = {(t.tile_x, t.tile_y): t for t in tiles if t.floor == floor}
    if not last:
        return None
    x = [k[0] for k in last]
    y = [k[1] for k in last]
    grid = np.zeros(((max(y) - min(y) + 1) * 64, (max(x) - min(x) + 1) * 64), np.int8)
    for (tx, ty), tile in last.items():
        i, j = (ty - min(y)) * 64, (tx - min(x)) * 64
        grid[i:i + 64, j:j + 64] = tile.log_odds.reshape(64, 64)
    cell_m = next(iter(last.values())).cell_m
    return grid, min(x) * 64 * cell_m, min(y) * 64 * cell_m, cell_m
