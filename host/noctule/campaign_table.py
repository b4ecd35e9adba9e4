"""What a campaign showed: a row a variant (policy and parameters) with intervals, paired differences, paths, CSV, JSON."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from noctule import record

BOOTSTRAP = 4000
CONFIDENCE = 0.95

# Column of the table: how to get it from a report; a flight that has no such figure gives None.
FIGURES = {
    "completed": lambda r: float(r["outcome"] == "completed"),
    "collisions": lambda r: r.get("collisions"),
    "explored_fraction": lambda r: _floors(r, "explored_fraction", min),
    "time_to_95_s": lambda r: _time(r, "time_to_95_s"),
    "time_to_99_s": lambda r: _time(r, "time_to_99_s"),
    "path_length_m": lambda r: r.get("path_length_m"),
    "flight_s": lambda r: r["touchdown_s"] - r["armed_s"] if r.get("touchdown_s") is not None and r.get("armed_s") is not None else None,
    "min_clearance_m": lambda r: r.get("min_clearance_m"),
    "pose_error_mean_m": lambda r: (r.get("pose_error_m") or {}).get("mean"),
    "home_error_m": lambda r: r.get("home_error_m"),
}


def _floors(report: dict, name: str, pick):
    values = [floor.get(name) for floor in report.get("floors") or []]
    return None if not values or any(v is None for v in values) else pick(values)


def _time(report: dict, name: str):
    """Time to a share of the first floor; one that never got there counts as --max-time, as in every bench."""
    floors = report.get("floors") or []
    if not floors:
        return None
    return floors[0].get(name) if floors[0].get(name) is not None else report.get("max_time_s")


def interval(values: np.ndarray, seed: int = 1) -> tuple[float, float]:
    """Bootstrap interval (percentile, CONFIDENCE) of the mean of (N,) values; one value has no width."""
    if len(values) < 2:
        return float(values[0]), float(values[0])
    draws = np.random.default_rng(seed).integers(0, len(values), (BOOTSTRAP, len(values)))
    low, high = np.percentile(values[draws].mean(axis=1), [50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)])
    return float(low), float(high)


def _values(reports: dict, variant: str, figure: str) -> dict[tuple[str, int], float]:
    out = {}
    for trial, report in reports.items():
        if trial.variant == variant:
            value = FIGURES[figure](report)
            if value is not None:
                out[trial.world, trial.seed] = float(value)
    return out


def summary(reports: dict) -> list[dict]:
    """A row a variant and figure: mean and interval; against the first variant the paired difference and its interval.

    Pairs are flights of the same world and seed; a broken flight leaves its pair out, and `flights` and `pairs` say how many
    there were.
    """
    variants = list(dict.fromkeys(trial.variant for trial in reports))
    rows = []
    for figure in FIGURES:
        first = _values(reports, variants[0], figure)
        for variant in variants:
            values = _values(reports, variant, figure)
            asked = sum(trial.variant == variant for trial in reports)
            row = {"variant": variant, "figure": figure, "flights": len(values), "of": asked, "mean": None, "low": None, "high": None,
                   "pairs": 0, "difference": None, "difference_low": None, "difference_high": None}
            if values:
                array = np.array(list(values.values()))
                row["mean"], (row["low"], row["high"]) = float(array.mean()), interval(array)
            shared = [key for key in values if key in first]
            if variant != variants[0] and shared:
                change = np.array([values[key] - first[key] for key in shared])
                row["pairs"], row["difference"] = len(shared), float(change.mean())
                row["difference_low"], row["difference_high"] = interval(change)
            rows.append(row)
    return rows


def text(rows: list[dict]) -> str:
    """The summary for a terminal."""
    def number(value) -> str:
        return "-" if value is None else f"{value:.4g}"

    lines = [("figure", "variant", "flights", "mean", "95 % interval", "against the first, paired", "95 % interval")]
    for r in rows:
        difference = "-" if r["difference"] is None else f"{r['difference']:+.4g}"
        lines.append((r["figure"], r["variant"], f"{r['flights']}/{r['of']}", number(r["mean"]), f"{number(r['low'])} to {number(r['high'])}",
                      difference, "-" if r["difference"] is None else f"{r['difference_low']:+.4g} to {r['difference_high']:+.4g}"))
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip() for line in lines)


def paths_png(folder: Path, reports: dict, world: str, out: Path) -> bool:
    """One picture a world: its plan, and the true path of each variant's first seed. False: no path was recorded."""
    from noctule import draw

    paths, plan = {}, None
    for trial, _ in sorted(reports.items(), key=lambda item: item[0].seed):
        here = folder / trial.label
        if trial.world != world or trial.variant in paths or not (here / "truth.csv").is_file():
            continue
        try:
            truth = record.read_truth(here / "truth.csv")
        except record.RecordError:
            continue
        flown = np.asarray(truth["armed"], bool)
        if flown.any():
            paths[trial.variant] = (np.asarray(truth["x_m"])[flown], np.asarray(truth["y_m"])[flown])
            plan = plan or here / "world.yaml"
    if plan is None:
        return False
    from noctule_sim.world import load_world

    built = load_world(str(plan))
    out.write_bytes(draw.paths_png(built.primitives(), built.start.z_m, paths, f"{Path(world).stem}: true path of the first seed"))
    return True


def write(folder: Path, reports: dict) -> list[dict]:
    """flights.csv (a row a flight), summary.json, summary.txt and paths-<world>.png; the summary's rows."""
    with (folder / "flights.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["world", "seed", "variant", "outcome", *FIGURES, "run"])
        for trial, report in reports.items():
            values = [FIGURES[name](report) for name in FIGURES]
            writer.writerow([Path(trial.world).stem, trial.seed, trial.variant, report["outcome"], *("" if v is None else f"{v:.9g}" for v in values), trial.label])
    rows = summary(reports)
    (folder / "summary.json").write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    (folder / "summary.txt").write_text(text(rows) + "\n", encoding="utf-8")
    for world in dict.fromkeys(trial.world for trial in reports):
        paths_png(folder, reports, world, folder / f"paths-{Path(world).stem}.png")
    return rows
