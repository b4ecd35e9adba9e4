"""`noctule export`: what a run recorded, in the forms that other tools read.

tum   estimate.tum and truth.tum (t x y z qx qy qz qw), frame World, one line a step from arming to touchdown: the very poses
      that report.json's pose_error_m is of. `evo_ape tum truth.tum estimate.tum --project_to_plane xy` gives that figure.
ros   map_<floor>.pgm and .yaml, as map_server reads them, frame Map.
png   the same maps as pictures.
csv   steps.csv: a row a step, what noctule-nav said (frame Map) and the truth at that time (frame World).
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from noctule import record, report, score
from noctule.settings import InputError

FORMATS = ("tum", "ros", "png", "csv")
STAMP_SLACK_US = 500         # a row of truth.csv belongs to a step if their stamps are this close


def truth_rows(t_us: np.ndarray, truth: dict) -> tuple[np.ndarray, np.ndarray]:
    """Which steps have a true pose at their stamp, (N,) bool, and its row for each, (N,) int."""
    stamps = np.round(np.asarray(truth["t_s"]) * 1e6).astype(np.int64)
    row = np.clip(np.searchsorted(stamps, t_us - STAMP_SLACK_US), 0, max(len(stamps) - 1, 0))
    return (np.abs(stamps[row] - t_us) <= STAMP_SLACK_US if len(stamps) else np.zeros(len(t_us), bool)), row


def _tum(run: report.Run, out: Path) -> list[Path]:
    nav, truth = run.flight.nav, run.truth
    interval = score.flight_interval(truth["t_s"], truth["z_m"], truth["armed"]) if len(truth["t_s"]) else None
    if interval is None:
        raise InputError(f"{run.folder}: the vehicle never armed: there is no trajectory to export")
    t_us = nav["t_us"]
    keep, row = truth_rows(t_us, truth)
    keep &= (t_us >= interval[0] * 1e6 - STAMP_SLACK_US) & (t_us <= interval[1] * 1e6 + STAMP_SLACK_US)
    row = row[keep]
    x, y = run.start.to_world(nav["x_m"][keep], nav["y_m"][keep])
    t_s = t_us[keep] * 1e-6
    zero = np.zeros(len(truth["t_s"]))
    roll, pitch = (np.asarray(truth.get(name, zero))[row] for name in ("roll_rad", "pitch_rad"))
    files = {"estimate.tum": report.tum_lines(t_s, x, y, nav["z_m"][keep] + run.start.z_m, nav["roll_rad"][keep], nav["pitch_rad"][keep],
                                              nav["yaw_rad"][keep] + run.start.yaw_rad),
             "truth.tum": report.tum_lines(t_s, truth["x_m"][row], truth["y_m"][row], truth["z_m"][row], roll, pitch, truth["yaw_rad"][row])}
    for name, lines in files.items():
        (out / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [out / name for name in files]


def _maps(run: report.Run, out: Path, suffixes: tuple[str, ...]) -> list[Path]:
    from noctule import carmen
    from noctule.replay import read_parameters

    values = read_parameters(run.folder / "parameters.toml") if (run.folder / "parameters.toml").is_file() else None
    written = []
    for floor in sorted({tile.floor for tile in run.flight.tiles}):
        carmen.write_map(out, record.map_of(run.flight.tiles, floor), values, f"map_{floor}", suffixes)
        written += [out / f"map_{floor}{suffix}" for suffix in suffixes]
    if not written:
        raise InputError(f"{run.folder}: no map was recorded")
    return written


def _csv(run: report.Run, out: Path) -> list[Path]:
    nav, truth = run.flight.nav, run.truth
    found, row = truth_rows(nav["t_us"], truth)
    names = [name for name in nav if name != "t_us"]
    true_names = [name for name in truth if name not in record.TEXT_COLUMNS]
    with (out / "steps.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["t_us", *names, *(f"true_{name}" for name in true_names)])
        for k, t_us in enumerate(nav["t_us"]):
            true = [f"{float(truth[name][row[k]]):.9g}" for name in true_names] if found[k] else [""] * len(true_names)
            writer.writerow([int(t_us), *(f"{nav[name][k]:.9g}" for name in names), *true])
    return [out / "steps.csv"]


def export(folder: Path, kind: str, out: Path | None = None) -> list[Path]:
    """Writes a run's record in another form.

    Args:
        folder: run directory.
        kind: one of FORMATS.
        out: where to; None: `export` in the run directory.

    Returns:
        the files written.

    Raises:
        RecordError, InputError: no such run, nothing recorded that could be exported, or the folder cannot be made.
    """
    run = report.open_run(folder)
    out = out or Path(folder) / "export"
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made ({error.strerror})") from None
    if kind == "tum":
        return _tum(run, out)
    if kind == "csv":
        return _csv(run, out)
    return _maps(run, out, (".pgm", ".yaml") if kind == "ros" else (".png",))
