"""`noctule bench`: measurements as rows {name, value, unit, reference, must, aim}.

Each bench is a function that yields rows; BENCHES names them. must and aim are limits as text: '<= 0.08' or '>= 0.95'.
What has been flown is kept under runs/bench and is not flown again, so that a long bench can be stopped and resumed;
a run is flown again when its settings or the built programs have changed.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from noctule.processes import build_folder
from noctule.settings import FlightSettings, InputError

FOLDER = Path("runs") / "bench"
SEEDS = (1, 2, 3, 4, 5)
QUICK_SEEDS = (1, 2)
OFFICE_PLAN = Path("plans_json") / "OFFICE_chewlane.json"


def row(name: str, value, unit: str, reference=None, must: str | None = None, aim: str | None = None) -> dict:
    """One metric. value is a number or None where nothing could be measured."""
    return {"name": name, "value": value, "unit": unit, "reference": reference, "must": must, "aim": aim}


def kept(path: Path, key: str, fresh: bool, measure: Callable[[], dict]) -> dict:
    """What was measured under this key before, from its file, else measured now and kept with the key; a cut write leaves the old file."""
    if path.is_file() and not fresh and (found := json.loads(path.read_text(encoding="utf-8")))["key"] == key:
        return found
    found = {"key": key, **measure()}
    path.parent.mkdir(parents=True, exist_ok=True)
    half = path.with_suffix(".part")
    half.write_text(json.dumps(found) + "\n", encoding="utf-8")
    half.replace(path)
    return found


def meets(value, limit: str | None) -> bool | None:
    """Whether a value keeps a limit; None where there is no limit. A missing value keeps none.

    >>> meets(0.05, '<= 0.08'), meets(None, '>= 1'), meets(3, None)
    (True, False, None)
    """
    if limit is None:
        return None
    match = re.fullmatch(r"(<=|>=|==)\s*(-?[\d.]+(?:e-?\d+)?)", limit)
    if match is None:
        raise ValueError(f"limit '{limit}' is not like '<= 0.08'")
    if value is None:
        return False
    bound = float(match[2])
    return {"<=": value <= bound, ">=": value >= bound, "==": value == bound}[match[1]]


def judged(rows: list[dict]) -> list[dict]:
    """Rows with `ok` (keeps its must) added."""
    return [{**r, "ok": meets(r["value"], r["must"])} for r in rows]


def table(rows: list[dict]) -> str:
    """The rows as text for a terminal; a broken must is marked."""
    cells = [("name", "value", "unit", "reference", "must", "aim", "")]
    for r in judged(rows):
        value = "-" if r["value"] is None else (f"{r['value']:.4g}" if isinstance(r["value"], float) else str(r["value"]))
        cells.append((r["name"], value, r["unit"], str(r["reference"] or "-"), r["must"] or "-", r["aim"] or "-",
                      "" if r["ok"] is not False else "MISSED"))
    widths = [max(len(c[i]) for c in cells) for i in range(7)]
    return "\n".join("  ".join(c[i].rjust(widths[i]) if i == 1 else c[i].ljust(widths[i]) for i in range(7)).rstrip()
                     for c in cells)


def data_folder() -> Path | None:
    """Shared data for measuring: $NOCTULE_DATA or ../shared/data beside the repository, or None."""
    named = os.environ.get("NOCTULE_DATA")
    path = Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data"
    return path if path.is_dir() else None


def _programs() -> str:
    """A fingerprint of all that a flight is made by: built programs and simulator."""
    digest = hashlib.sha256()
    import noctule_sim

    sources = sorted(Path(noctule_sim.__file__).parent.rglob("*.py"))
    for path in [build_folder() / "bin" / n for n in ("noctule-bridge", "noctule-nav", "noctule-vision")] + sources:
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def flown(settings: FlightSettings, label: str, fresh: bool) -> dict:
    """The report of that flight: a kept one if nothing has changed since, else it is flown now."""
    from noctule import flight, record

    folder = FOLDER / label
    key = {"programs": _programs(), "world": settings.world, "seed": settings.seed, "camera": settings.camera,
           "parameters": settings.parameters, "preset": settings.preset, "profile": settings.profile,
           "faults": settings.faults, "max_time_s": settings.max_time_s, "autopilot": settings.autopilot}
    kept = record.read_json(folder / "report.json")
    if kept and not fresh and record.read_json(folder / "bench.json") == key and kept["outcome"] != "interrupted":
        print(f"{label}: kept", flush=True)
        return kept
    if folder.exists():
        shutil.rmtree(folder)
    settings.out = folder
    result = flight.fly(settings, quiet=True)
    if result["outcome"] == "interrupted":
        raise KeyboardInterrupt
    (folder / "bench.json").write_text(json.dumps(key) + "\n", encoding="utf-8")
    print(f"{label}: {result['outcome']}, explored {result['floors'][0]['explored_fraction']:.3f}, "
          f"collisions {result['collisions']}, pose {result['pose_error_m']['mean']} m, "
          f"{result['realtime_factor']} times real time", flush=True)
    return result


def _worst(values, pick):
    values = list(values)
    return None if not values or any(v is None for v in values) else pick(values)


def flight_rows(label: str, reports: list[dict], camera: bool) -> list[dict]:
    """The rows of a world's flights: the worst of all its seeds."""
    floors = [r["floors"][0] for r in reports]
    completed = sum(r["outcome"] == "completed" for r in reports)
    return [
        row(f"{label}: completed", completed, f"of {len(reports)} flights", None, f"== {len(reports)}"),
        row(f"{label}: collisions", sum(r["collisions"] for r in reports), "-", None, "== 0"),
        row(f"{label}: explored_fraction, least", _worst((f["explored_fraction"] for f in floors), min), "-", None, ">= 0.95", ">= 0.99"),
        row(f"{label}: home error, greatest", _worst((r["home_error_m"] for r in reports), max), "m", None, "<= 0.5"),
        row(f"{label}: pose error mean, greatest", _worst((r["pose_error_m"]["mean"] for r in reports), max), "m", "paper 0.08", "<= 0.03", "<= 0.01"),
        row(f"{label}: altitude error mean, greatest", _worst((r["altitude_error_m"]["mean"] for r in reports), max), "m", "paper 0.023", "<= 0.023", "<= 0.01"),
        row(f"{label}: least clearance", _worst((r["min_clearance_m"] for r in reports), min), "m", None, ">= 0"),
        row(f"{label}: time to 95 %, mean", mean_time(reports, "time_to_95_s"), "s"),
        row(f"{label}: never reached 95 %", sum(f["time_to_95_s"] is None for f in floors), "flights", None, "== 0"),
        row(f"{label}: path, mean", _worst((r["path_length_m"] for r in reports), lambda v: sum(v) / len(v)), "m"),
        row(f"{label}: real-time factor, least", _worst((r["realtime_factor"] for r in reports), min), "-", None,
            ">= 3" if camera else ">= 5", ">= 5" if camera else ">= 10"),
        row(f"{label}: step p99, greatest", _worst((r["step_ms"]["p99"] for r in reports), max), "ms", None, "<= 20"),
        row(f"{label}: heap allocations after start", _worst((r["memory"]["heap_allocations_after_start"] for r in reports), max), "-", None, "== 0"),
        row(f"{label}: lockstep broken", sum(r["lockstep_broken"] for r in reports), "flights", None, "== 0"),
    ]


def mean_time(reports: list[dict], name: str) -> float | None:
    """Mean of a time over flights; a flight that never got there counts as its --max-time."""
    times = [r["floors"][0][name] if r["floors"][0][name] is not None else r["max_time_s"] for r in reports]
    return None if not times or any(t is None for t in times) else sum(times) / len(times)


def bench_flight(quick: bool, fresh: bool) -> list[dict]:
    """Whole flights through all processes: maze_a, maze_b and the plan of a real office."""
    seeds = QUICK_SEEDS if quick else SEEDS
    worlds = [("maze_a", "maze_a", False), ("maze_b", "maze_b", False)]
    data = data_folder()
    if data is not None and (data / OFFICE_PLAN).is_file():
        worlds.append(("office plan", str(data / OFFICE_PLAN), False))
    else:
        print("office plan: skipped: no data", flush=True)
    rows = []
    for label, world, camera in worlds:
        reports = [flown(FlightSettings(world=world, seed=seed, camera=camera), f"flight-{label.replace(' ', '-')}-{seed}", fresh)
                   for seed in (seeds[:1] if quick and label == "office plan" else seeds)]
        rows += flight_rows(label, reports, camera)
    reports = [flown(FlightSettings(world="maze_a", seed=1, camera=True), "flight-maze_a-camera-1", fresh)]
    if reports[0]["camera"]:
        rows.append(row("maze_a with camera: real-time factor", reports[0]["realtime_factor"], "-", None, ">= 3", ">= 5"))
    else:
        print("maze_a with camera: skipped: the camera cannot run here", flush=True)
    return rows


BENCHES: dict[str, Callable[[bool, bool], list[dict]]] = {"flight": bench_flight}
BENCHES["altitude"] = lambda quick, fresh: importlib.import_module("noctule.bench_altitude").bench_altitude(quick, fresh)
BENCHES["localisation"] = lambda quick, fresh: importlib.import_module("noctule.bench_localisation").bench_localisation(quick, fresh)
BENCHES["motion"] = lambda quick, fresh: importlib.import_module("noctule.bench_motion").bench_motion(quick, fresh)
BENCHES["unseen"] = lambda quick, fresh: importlib.import_module("noctule.bench_unseen").bench_unseen(quick, fresh)
BENCHES["exploration"] = lambda quick, fresh: importlib.import_module("noctule.bench_exploration").bench_exploration(quick, fresh)
BENCHES["instructions"] = lambda quick, fresh: importlib.import_module("noctule.bench_instructions").bench_instructions(quick, fresh)
BENCHES["floors"] = lambda quick, fresh: importlib.import_module("noctule.bench_floors").bench_floors(quick, fresh)
BENCHES["vision"] = lambda quick, fresh: importlib.import_module("noctule.bench_vision").bench_vision(quick, fresh)
BENCHES["link"] = lambda quick, fresh: importlib.import_module("noctule.bench_link").bench_link(quick, fresh)


def run(name: str, quick: bool = False, fresh: bool = False) -> list[dict]:
    """The rows of a bench.

    Raises:
        InputError: there is no bench of that name.
    """
    if name not in BENCHES:
        raise InputError(f"no bench '{name}'; there are: {', '.join(sorted(BENCHES))}")
    return BENCHES[name](quick, fresh)
