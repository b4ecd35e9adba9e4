"""`noctule replay`: the firmware over a recorded log, in this process.

A flight's LCM log drives the very NavNode of noctule-nav: every step gets the samples that NAV says it consumed, and
what is published is compared with the log bit for bit. A CARMEN log drives Localiser and OccupancyGrid (carmen.py).
Page: docs/replay.md.
"""

from __future__ import annotations

import struct
import time
import tomllib
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from noctule.record import RecordError, message_type

INPUTS = ("SCAN", "IMU", "ATTITUDE", "RANGE_UP", "RANGE_DOWN", "VEHICLE", "COMMAND", "BARO", "PARAMETERS", "POLICY_GOAL")
OUTPUTS = {"NAV": "nav_t", "ODOM": "odom_t", "GRID_TILE": "grid_tile_t", "WALLS": "walls_t", "LEVELS": "levels_t", "POLICY_ASK": "policy_ask_t"}
USED = ("imu_used", "attitude_used", "range_up_used", "range_down_used", "vehicle_used", "command_used", "baro_used", "parameters_used", "policy_used")
MAGIC = b"\xed\xa1\xda\x01"
STEP_US_BYTES = 4            # NAV ends with step_us, the only field that equal runs may differ in
PATIENCE = 3                 # steps: samples that are not in the log by then are lost

_EVENT = struct.Struct(">4sqqii")
_STAMP = struct.Struct(">8xqi")      # fingerprint, t_us, seq: how every stream begins


@dataclass
class FlightLog:
    """Events of an LCM log in order: (channel, bytes)."""

    events: list[tuple[str, bytes]]
    cut: bool = False            # ends in the middle of an event
    damaged_bytes: int = 0       # skipped to find the next event


def read_flight_log(path: Path) -> FlightLog:
    """Reads an LCM log; a torn end is noted, damage in the middle is stepped over and counted.

    Raises:
        RecordError: no such file, or not an LCM log.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not data.startswith(MAGIC):
        raise RecordError(f"{path}: not an LCM log")
    log, at = FlightLog([]), 0
    while at < len(data):
        if len(data) - at < _EVENT.size:
            log.cut = True
            break
        magic, _, _, name_size, size = _EVENT.unpack_from(data, at)
        end = at + _EVENT.size + name_size + size
        if magic != MAGIC or not 0 < name_size < 64 or size < 0:
            following = data.find(MAGIC, at + 1)
            if following < 0:
                log.cut = True
                break
            log.damaged_bytes += following - at
            at = following
            continue
        if end > len(data):
            log.cut = True
            break
        middle = at + _EVENT.size + name_size
        log.events.append((data[at + _EVENT.size:middle].decode("ascii", "replace"), data[middle:end]))
        at = end
    return log


def read_parameters(path: Path) -> dict[str, float]:
    """A run's parameters.toml.

    Raises:
        RecordError: it cannot be read, or names a parameter that this build does not have.
    """
    from noctule.params_gen import DEFAULTS

    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: {error}") from None
    unknown = sorted(set(values) - set(DEFAULTS))
    if unknown:
        raise RecordError(f"{path}: this build has no parameter {unknown[0]}; replay with the version that flew")
    return values


@dataclass
class Difference:
    """The first message that is not as logged."""

    channel: str
    t_us: int
    seq: int
    what: str

    def text(self) -> str:
        """One line."""
        return f"first difference: {self.channel} {self.seq} at {self.t_us * 1e-6:.6f} s: {self.what}"


@dataclass
class FlightReplay:
    """Outcome of a flight's replay. compared: messages of each channel that were compared."""

    steps: int
    compared: dict[str, int]
    difference: Difference | None
    notes: list[str] = field(default_factory=list)
    wall_s: float = 0.0

    @property
    def equal(self) -> bool:
        return self.difference is None and self.compared.get("NAV", 0) > 0


def gaps(log: FlightLog) -> list[str]:
    """One line for each input stream whose sequence numbers have gaps or repeats."""
    lines, last = [], {}
    missing: dict[str, list] = {}
    for channel, data in log.events:
        if channel not in (*INPUTS, "NAV", "ODOM") or len(data) < _STAMP.size:
            continue
        t_us, seq = _STAMP.unpack_from(data)
        if channel in last and seq != last[channel] + 1:
            entry = missing.setdefault(channel, [0, 0, t_us])
            entry[0] += 1
            entry[1] += max(seq - last[channel] - 1, 0)
        last[channel] = seq
    for channel, (count, lost, t_us) in missing.items():
        lines.append(f"{channel}: {count} gap{'s' if count > 1 else ''} in its sequence numbers, {lost} messages missing, "
                     f"first at {t_us * 1e-6:.3f} s")
    return lines


class _Step:
    """One NAV of the log: the scan it used, what it consumed, and how far the inertial data had got before it."""

    def __init__(self, message, position: int, imu_before_us: int):
        self.scan = (message.scan_seq, message.t_us)
        # In the order of nav_t, which is that of Node.step_with.
        self.used = tuple(getattr(message, name) for name in message.__slots__ if name.endswith("_used"))
        self.position = position
        self.imu_before_us = imu_before_us
        self.seq, self.t_us = message.seq, message.t_us


def _steps(log: FlightLog) -> deque[_Step]:
    """Steps in order. Between scans nav publishes ODOM when inertial data arrives: its newest one before a NAV says how
    much of that data nav had seen when it stepped, whatever the order in which the recorder heard of it."""
    nav_type, odom_type = message_type("nav_t"), message_type("odom_t")
    steps, imu_before_us = deque(), -1
    for position, (channel, data) in enumerate(log.events):
        try:
            if channel == "NAV":
                steps.append(_Step(nav_type.decode(data), position, imu_before_us))
                imu_before_us = -1
            elif channel == "ODOM":
                message = odom_type.decode(data)
                if not message.at_scan:
                    imu_before_us = message.t_us
        except ValueError:
            raise RecordError(f"{channel} in the log is of another version; replay with the version that flew") from None
    return steps


def _drive(log: FlightLog, steps: deque[_Step], node, notes: list[str]) -> tuple[list[tuple[str, bytes]], int, _Step | None]:
    """Feeds the node; what it published, how many steps it made, and the step that lacked samples, if any."""
    published: list[tuple[str, bytes]] = []
    scans: dict[tuple, bytes] = {}
    done, imu_us, scan_fed = 0, -1, False
    for position, (channel, data) in enumerate(log.events):
        if channel == "SCAN":
            t_us, seq = _STAMP.unpack_from(data)
            scans.setdefault((seq, t_us), data)
        elif channel in INPUTS:
            node.hold(channel, data)
            published += node.outputs()
            if channel == "IMU":
                imu_us = _STAMP.unpack_from(data)[0]
        elif channel != "NAV":
            continue
        while steps and steps[0].scan in scans and imu_us >= steps[0].imu_before_us:
            if not scan_fed:
                node.hold("SCAN", scans[steps[0].scan])
                published += node.outputs()
                scan_fed = True
            if not node.step_with(*steps[0].used):
                break
            published += node.outputs()
            scans.pop(steps.popleft().scan)
            done, scan_fed = done + 1, False
        if len(steps) > PATIENCE and position > steps[PATIENCE].position:
            return published, done, steps[0]
    if steps:
        notes.append(f"the log ends before the samples of its last {len(steps)} step{'s' if len(steps) > 1 else ''}")
    return published, done, None


def _fields(type_name: str, logged: bytes, again: bytes) -> str:
    """Which field differs first, in words."""
    kind = message_type(type_name)
    try:
        a, b = kind.decode(logged), kind.decode(again)
    except ValueError:
        return "not decodable"
    for name in kind.__slots__:
        x, y = getattr(a, name), getattr(b, name)
        if isinstance(x, (bytes, bytearray)):
            x, y = list(x), list(y)
        if isinstance(x, (list, tuple)):
            for i, (u, v) in enumerate(zip(x, y)):
                if u != v and not (u != u and v != v):
                    return f"{name}[{i}] is {v!r}, logged {u!r}"
        elif x != y and not (x != x and y != y) and name != "step_us":
            return f"{name} is {y!r}, logged {x!r}"
    return "the bytes differ"


def compare(logged: list[tuple[str, bytes]], again: list[tuple[str, bytes]], complete: bool) -> tuple[dict[str, int], Difference | None]:
    """Messages compared of each channel, and the first difference in time.

    Args:
        logged, again: (channel, bytes) in order.
        complete: every step of the log was made again; then nothing that was logged may be missing.
    """
    compared, first = {}, None
    for channel, type_name in OUTPUTS.items():
        old, new = ([d for c, d in side if c == channel] for side in (logged, again))
        cut = -STEP_US_BYTES if channel == "NAV" else None
        found = None
        for a, b in zip(old, new):
            if a[:cut] != b[:cut]:
                found = Difference(channel, *_STAMP.unpack_from(a), _fields(type_name, a, b))
                break
        if found is None and complete and len(old) > len(new):
            found = Difference(channel, *_STAMP.unpack_from(old[len(new)]), "not published again")
        compared[channel] = min(len(old), len(new))
        if found is not None and (first is None or found.t_us < first.t_us):
            first = found
    return compared, first


def replay_flight(path: Path, changed: dict[str, float] | None = None, base: dict[str, float] | None = None) -> FlightReplay:
    """Flies a log again and compares.

    Args:
        path: flight.lcm. parameters.toml beside it counts unless base is given.
        changed: parameters that differ from the flight's.
        base: parameters of the flight.

    Raises:
        RecordError: the log or the parameters cannot be used.
        LibraryMissing: the firmware's shared library was not built.
    """
    from noctule.inprocess import Node

    notes = []
    log = read_flight_log(path)
    if log.cut:
        notes.append("the log is cut short in the middle of an event; what it holds is compared")
    if log.damaged_bytes:
        notes.append(f"{log.damaged_bytes} bytes of the log are damaged and were stepped over")
    notes += gaps(log)
    if base is None:
        beside = path.parent / "parameters.toml"
        base = read_parameters(beside) if beside.is_file() else {}
        if not base:
            notes.append("no parameters.toml beside the log: defaults")
    steps = _steps(log)
    if not steps:
        raise RecordError(f"{path}: no NAV in it, nothing to compare with")
    begin = time.monotonic()
    with Node({**base, **(changed or {})}) as node:
        published, done, lacking = _drive(log, steps, node, notes)
    # What follows a step that could not be repeated is without meaning.
    logged = [e for e in log.events[:None if lacking is None else lacking.position] if e[0] in OUTPUTS]
    compared, difference = compare(logged, published, complete=not steps and not log.cut)
    if lacking is not None and difference is None:
        difference = Difference("NAV", lacking.t_us, lacking.seq, "the log lacks samples that this step consumed")
    return FlightReplay(done, compared, difference, notes, time.monotonic() - begin)


def is_flight(path: Path) -> bool:
    """Whether a file is an LCM log."""
    try:
        with path.open("rb") as file:
            return file.read(4) == MAGIC
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror or error})") from None


def run_flight(path: Path, changed: dict[str, float], base: dict[str, float] | None) -> int:
    """Replays a flight and prints the outcome; 0: equal, 1: not."""
    result = replay_flight(path, changed, base)
    for note in result.notes:
        print(f"note: {note}")
    counts = ", ".join(f"{n} {channel}" for channel, n in result.compared.items())
    print(f"{result.steps} steps in {result.wall_s:.1f} s; compared {counts}")
    print("equal" if result.equal else result.difference.text())
    return 0 if result.equal else 1


def run_carmen(path: Path, out: Path, changed: dict[str, float], relations: Path | None, range_max_m: float | None, mapping: bool) -> int:
    """Runs localisation and mapping over a CARMEN log, writes trajectory and map, prints timing and relations; 0."""
    from noctule import carmen

    truth = carmen.read_relations(relations) if relations is not None else None
    log = carmen.read(path, range_max_m)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"--out {out}: cannot be made ({error.strerror})") from None
    begin = time.monotonic()
    track = carmen.track(log, changed, mapping=mapping)
    wall_s = time.monotonic() - begin
    carmen.write_trajectory(out, track.t_s, track.poses)
    has_map = carmen.write_map(out, track.grid, changed)
    beams = sorted({len(r) for r in log.ranges})
    span_s = log.scan_t_s[-1] - log.scan_t_s[0]
    print(f"{len(log.ranges)} sweeps of {beams[0]}{f' to {beams[-1]}' if len(beams) > 1 else ''} beams in {span_s:.1f} s, "
          f"{len(log.odometry_t_s) - len(log.ranges)} ODOM lines; bad lines {log.bad_lines}, other lines {log.other_lines}, "
          f"sweeps with a time that does not rise {log.late}" + ("; the file is cut short" if log.cut else ""))
    for name, values in (("localisation", track.localise_us), ("map", track.map_us)):
        if mapping or name == "localisation":
            print(f"{name}: {np.median(values):.0f} us median, {np.percentile(values, 99):.0f} us 99 %, {values.max():.0f} us most")
    lost = sum(s.quality < 0 for s in track.steps)
    print(f"{wall_s:.1f} s in all; steps that said lost: {lost}; counters: "
          + ", ".join(f"{name} {value}" for name, value in track.counters.items() if value) )
    if truth is not None:
        print("as they stand, " + carmen.relation_errors(log, track.t_s, track.poses, truth).text())
        if len(truth) > 1:
            convention, errors = carmen.calibrated_errors(log, track.t_s, track.poses, truth)
            print(f"{convention.text()} (found on every second one), the others: {errors.text()}")
    print(f"{out / 'trajectory.txt'}, {out / 'trajectory.tum'}" + (f", {out / 'map.png'}, {out / 'map.pgm'}, {out / 'map.yaml'}" if has_map else ""))
    return 0


def run(path: Path, out: Path | None, changed: dict[str, float], preset: str, relations: Path | None, range_max_m: float | None,
        mapping: bool) -> int:
    """Replays a log of either kind and prints the outcome; the exit code.

    Raises:
        RecordError: bad input, in one line.
    """
    from noctule.inprocess import LibraryMissing
    from noctule.params_gen import PRESETS

    if path.is_dir():
        path = path / "flight.lcm"
    if not path.is_file():
        raise RecordError(f"{path}: no such file")
    base = None if preset == "default" else dict(PRESETS[preset])
    try:
        if is_flight(path):
            if relations is not None:
                raise RecordError("--relations goes with a CARMEN log")
            return run_flight(path, changed, base)
        name = path.name.removesuffix(".gz").removesuffix(".clf").removesuffix(".log") or "log"
        return run_carmen(path, out or Path("runs") / f"replay-{name}", {**(base or {}), **changed}, relations, range_max_m,
                          mapping)
    except LibraryMissing as error:
        raise RecordError(str(error)) from None
