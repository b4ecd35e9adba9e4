"""`noctule bench floors`: buildings of several floors, flown in this process (design.md, "Speed of benchmarks").

Rows are the issue's; the worst of all seeds where they do not say otherwise. Flights are kept under runs/bench and not flown again
while library and simulator stay the same.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from noctule.bench import FOLDER, row
from noctule.floor_worlds import building, opening_world
from noctule.settings import FlightSettings

SEEDS = tuple(range(1, 11))
OTHER_SEEDS = (1, 2, 3, 4, 5)
QUICK_SEEDS = (1,)
WORLDS = ("levels", "three_floor", "two_stairs", "atrium", "trap_opening")
OPENINGS_M = (1.4, 1.8, 2.2, 2.6, 3.0)
BUILDINGS = (1, 2, 3, 4, 5, 6)   # floor_worlds.building: not looked at while the firmware was developed
MAX_TIME_S = 500.0
SAME_FLOOR_M = 0.5


def judge_floors(found_m: list[float], true_m: list[float]) -> tuple[int, int]:
    """How many found floors are none (or one twice), and how many true ones were missed.

    >>> judge_floors([0.01, 2.49], [0.0, 2.5]), judge_floors([0.0, 3.6], [0.0])
    ((0, 0), (1, 0))
    """
    left = list(true_m)
    false = 0
    for z in found_m:
        near = min(left, key=lambda v: abs(v - z), default=None)
        if near is None or abs(near - z) > SAME_FLOOR_M:
            false += 1
        else:
            left.remove(near)
    return false, len(left)


def _key(settings: FlightSettings, description) -> str:
    import noctule_sim
    from noctule.inprocess import library_path

    digest = hashlib.sha256(Path(library_path()).read_bytes())
    for path in sorted(Path(noctule_sim.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    digest.update(json.dumps([description, settings.seed, settings.preset, settings.profile, settings.parameters, settings.max_time_s]).encode())
    return digest.hexdigest()[:24]


def flown(world, label: str, settings: FlightSettings, fresh: bool) -> tuple[dict, Path]:
    """Report and run directory of that flight; a kept one if nothing has changed."""
    from noctule import inprocess_flight, record

    folder = FOLDER / label
    key = _key(settings, world.description)
    kept = record.read_json(folder / "report.json")
    if not kept or fresh or record.read_json(folder / "bench.json").get("key") != key:
        kept = inprocess_flight.fly(settings, world, folder)
        (folder / "bench.json").write_text(json.dumps({"key": key}) + "\n", encoding="utf-8")
    print(f"{label}: {kept['outcome']}, {kept['sim_time_s']} s, floors "
          + ", ".join(f"{f['elevation_m']} m {f['explored_fraction']:.3f}" for f in kept["floors"]) + f", collisions {kept['collisions']}", flush=True)
    return kept, folder


def _measured(world, report: dict) -> dict:
    true = [float(f.elevation_m) - world.start.z_m for f in world.floors]
    found = [f["elevation_m"] for f in report["floors"] if f["elevation_m"] is not None]
    false, missed = judge_floors(found, true)
    errors = [min(abs(z - t) for t in true) for z in found]
    return {"false": false, "missed": missed, "elevation": max(errors, default=None),
            "explored": min(f["explored_fraction"] for f in report["floors"]) if not missed else 0.0}


def _end_error_m(folder: Path, report: dict) -> float | None:
    # Distance of estimate and truth in the last second before touchdown.
    from noctule import record, score
    from noctule.report import open_run

    run = open_run(folder)
    errors = score.pose_errors(run.flight.nav, run.truth, run.start)
    return float(np.mean(errors.position_series_m[-20:])) if errors.position_series_m.size else None


def bench_floors(quick: bool, fresh: bool) -> list[dict]:
    """The rows of several floors."""
    from noctule_sim.world import build_world, load_world

    seeds = QUICK_SEEDS if quick else SEEDS
    others = QUICK_SEEDS if quick else OTHER_SEEDS
    rows = []

    def settings(name, seed, **more):
        return FlightSettings(world=name, seed=seed, camera=False, max_time_s=more.pop("max_time_s", MAX_TIME_S), **more)

    two = load_world("two_floor")
    reports = [flown(two, f"floors-two_floor-{s}", settings("two_floor", s), fresh)[0] for s in seeds]
    measured = [_measured(two, r) for r in reports]
    good = sum(r["outcome"] == "completed" and m["explored"] >= 0.97 and r["collisions"] == 0 for r, m in zip(reports, measured))
    rows += [
        row("two_floor: both floors 97 %, home, landed", good, f"of {len(seeds)} flights", None, f"== {len(seeds)}"),
        row("two_floor: time of flight, longest", max(r["sim_time_s"] for r in reports), "s", "paper 660", "<= 300", "<= 180"),
        row("two_floor: time of flight, mean", float(np.mean([r["sim_time_s"] for r in reports])), "s", "paper 660"),
        row("two_floor: explored, least", min(m["explored"] for m in measured), "-", "paper 0.90", ">= 0.97"),
        row("two_floor: step p99, greatest", max(r["step_ms"]["p99"] for r in reports), "ms", "paper: one plan 60000", "<= 10", "<= 2"),
    ]
    paper, _ = flown(two, "floors-two_floor-paper", settings("two_floor", 1, preset="paper", parameters={"potential_window_m": 3.0, "paper_unknown_share": 0.10}, max_time_s=900.0), fresh)
    rows.append(row("two_floor, preset paper: completed", int(paper["outcome"] == "completed"), "of 1 flight", None, "== 1"))
    rows.append(row("two_floor, preset paper: time of flight", paper["sim_time_s"], "s", "paper 660"))

    all_worlds = [(two, r, m) for r, m in zip(reports, measured)]
    for name in WORLDS:
        world = load_world(name)
        for seed in others:
            report, folder = flown(world, f"floors-{name}-{seed}", settings(name, seed), fresh)
            all_worlds.append((world, report, _measured(world, report)))
            if name == "three_floor":
                rows.append(row(f"three_floor, seed {seed}: position error at the end", _end_error_m(folder, report), "m", None, "<= 0.06", "<= 0.03"))
    rows += [
        row("all worlds: flights completed", sum(r["outcome"] == "completed" for _, r, _ in all_worlds), f"of {len(all_worlds)} flights", None, f"== {len(all_worlds)}"),
        row("all worlds: floors missed", sum(m["missed"] for _, _, m in all_worlds), "-", None, "== 0"),
        row("all worlds: false floors", sum(m["false"] for _, _, m in all_worlds), "-", None, "== 0"),
        row("all worlds: collisions", sum(r["collisions"] for _, r, _ in all_worlds), "-", None, "== 0"),
        row("all worlds: elevation error, greatest", max(m["elevation"] for _, _, m in all_worlds), "m", "paper 0.10", "<= 0.02", "<= 0.01"),
    ]
    taken = 0
    for n, side_m in enumerate(OPENINGS_M):
        world = build_world(opening_world(side_m, n))
        report, _ = flown(world, f"floors-opening-{side_m:g}", settings(world.name, 1), fresh)
        taken += int(_measured(world, report)["missed"] == 0 and report["collisions"] == 0)
    rows.append(row("openings of 1.4 to 3 m taken", taken, f"of {len(OPENINGS_M)}", None, f"== {len(OPENINGS_M)}"))
    drawn = []
    for number in BUILDINGS[:1] if quick else BUILDINGS:
        world = build_world(building(number))
        report, _ = flown(world, f"floors-{world.name}", settings(world.name, number), fresh)
        drawn.append((report, _measured(world, report)))
    rows += [
        row("drawn buildings: flights completed", sum(r["outcome"] == "completed" for r, _ in drawn), f"of {len(drawn)} flights", None, f"== {len(drawn)}"),
        row("drawn buildings: floors missed", sum(m["missed"] for _, m in drawn), "-", None, "== 0"),
        row("drawn buildings: false floors", sum(m["false"] for _, m in drawn), "-", None, "== 0"),
        row("drawn buildings: collisions", sum(r["collisions"] for r, _ in drawn), "-", None, "== 0"),
        row("drawn buildings: elevation error, greatest", max(m["elevation"] for _, m in drawn), "m", None, "<= 0.02", "<= 0.01"),
    ]
    return rows
