"""Makes report.json, report.html, map.png and the trajectory files of a run directory from what was recorded."""

from __future__ import annotations

import base64
import html
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from noctule import atlas, draw, map_score, objects, record, score
from noctule.score import ExploredScore, StartPose
from noctule.settings import EXTERNAL_POLICY, POLICIES

EXPLORER_COUNTERS = ("goals", "switches", "back_and_forth", "in_vain", "stuck", "passes")   # of noctule-nav's statistics

STATES = ("waiting", "taking off", "looking around", "exploring", "returning home", "landing", "landed", "aborted",
          "paused", "changing floor")
RETURNING, LANDING, LANDED, ABORTED = 4, 5, 6, 7
REASONS = {5: "return was ordered", 6: "landing was ordered", 7: "abort was ordered", 8: "pause was ordered",
           12: "the pilot or a failsafe took over", 13: "localisation was lost", 14: "height was lost",
           15: "take-off took too long", 16: "the battery was low", 17: "the autopilot's position and ours disagreed",
           18: "no way home was known", 19: "a start was refused", 21: "nothing new was found for long"}   # values of plan/mission.hpp
NOTHING_LEFT = 4
STEP_S = 0.05
GROUND_HEIGHT_M = 0.10       # nearer than this to the resting height counts as on the ground
OVER_FLOOR_M = 2.0           # ground farther below than this lies beyond an opening


def schema() -> dict:
    """The JSON schema of report.json (docs/report.schema.json).

    Raises:
        RecordError: the schema is not where the sources keep it.
    """
    path = Path(__file__).resolve().parents[2] / "docs" / "report.schema.json"
    if not path.is_file():
        raise record.RecordError(f"{path}: no such file; run from a checkout of the repository")
    return json.loads(path.read_text(encoding="utf-8"))


def validate(report: dict) -> list[str]:
    """What is wrong with a report by its schema, one line each; empty if nothing is."""
    import jsonschema

    validator = jsonschema.Draft202012Validator(schema())
    return [f"{'.'.join(str(p) for p in e.absolute_path) or 'report'}: {e.message}" for e in validator.iter_errors(report)]


@dataclass
class Run:
    """All that a run directory holds, read. `settings` is run.json, `sim` is sim.json, `stats` is noctule-nav's."""

    folder: Path
    world: object
    settings: dict
    sim: dict
    stats: dict
    flight: record.Flight
    truth: dict
    start: StartPose


def start_pose(world, truth: dict) -> StartPose:
    """World * Map: the first true pose, on the point of the floor that the world starts from."""
    start = world.start
    if len(truth["t_s"]) == 0:
        return StartPose(start.x_m, start.y_m, start.z_m, start.yaw_rad)
    return StartPose(float(truth["x_m"][0]), float(truth["y_m"][0]), start.z_m, float(truth["yaw_rad"][0]))


def open_run(folder) -> Run:
    """Reads a run directory.

    Raises:
        RecordError: it is none, or a file of it cannot be read.
    """
    from noctule_sim.world import WorldError, load_world

    folder = Path(folder)
    settings = record.read_json(folder / "run.json")
    if not settings:
        raise record.RecordError(f"{folder}: not a run directory (no run.json in it)")
    try:
        world = load_world(str(folder / "world.yaml"))
    except WorldError as error:
        raise record.RecordError(str(error)) from None
    try:
        truth = record.read_truth(folder / "truth.csv")
    except record.RecordError:
        # The simulator never ticked; the report still says so, with nothing measured.
        truth = {name: np.zeros(0) for name in record.TRUTH_REQUIRED}
    try:
        flight = record.read_flight(folder / "flight.lcm")
    except record.RecordError:
        flight = record.Flight(record.empty_nav(), [], None, None, {})
    return Run(folder, world, settings, record.read_json(folder / "sim.json"),
               record.read_json(folder / "log" / "nav-stats.json"), flight, truth, start_pose(world, truth))


def _heap(nav: dict, bridge: dict) -> int | None:
    """Calls of the allocator in both flight processes; None: one of them did not count."""
    counts = [stats.get("heap_allocations_after_start") for stats in (nav, bridge) if stats]
    return sum(counts) if counts and None not in counts else None


def _state_name(state: int) -> str:
    return STATES[state] if 0 <= state < len(STATES) else f"in state {state}"


def judge(settings: dict, sim: dict, states, reasons, landed: bool, sim_time_s: float) -> tuple[str, str]:
    """Outcome and one sentence of why.

    Completed means: went home because nothing reachable was left unknown, and landed there for no other reason.

    Args:
        settings: run.json (interrupted, died, max_time_s, last_text).
        sim: sim.json (outcome, reasons).
        states, reasons: (N,) int, mission state and why it was entered, as recorded.
        landed: the vehicle is on the ground, disarmed.
        sim_time_s: simulated time at the end.
    """
    if settings.get("interrupted"):
        return "interrupted", "Stopped by the operator (SIGINT)."
    if settings.get("died"):
        return "failed", f"{settings['died']}."
    if sim.get("outcome") == "crashed":
        text = "; ".join([str(sim.get("text") or "the vehicle crashed")] + [str(r) for r in sim.get("reasons") or []])
        return "crashed", f"Crashed: {text.rstrip('.')}."
    why = settings.get("last_text") or "; ".join(str(r) for r in sim.get("reasons", []) or [])
    ended = f" Last word: {why.rstrip('.')}." if why else ""
    states, reasons = np.asarray(states), np.asarray(reasons)
    if states.size == 0:
        return "failed", f"noctule-nav published no step.{ended}"
    last = int(states[-1])
    cause = next((REASONS[int(r)] for r in reasons[::-1] if int(r) in REASONS), None)
    if np.any(states == ABORTED):
        return "aborted", f"Aborted: {cause or 'no cause given'}.{ended}"
    finished = np.any((states == RETURNING) & (reasons == NOTHING_LEFT))
    if last == LANDED and landed and finished and cause is None:
        return "completed", "Explored all that was reachable, returned and landed."
    limit = settings.get("max_time_s")
    if limit and sim_time_s >= float(limit) - STEP_S:
        return "max_time", f"Still {_state_name(last)} at --max-time {float(limit):g} s."
    if last == LANDED and landed:
        return "not_completed", f"Landed early: {cause or 'exploration was not finished'}.{ended}"
    return "not_completed", f"Ended while {_state_name(last)}{': ' + cause if cause else ''}.{ended}"


def _number(value, digits=6):
    """A finite number rounded, else None: NaN and infinity are not JSON."""
    if value is None or not math.isfinite(float(value)):
        return None
    return round(float(value), digits) + 0.0     # + 0.0: no minus before a zero


def _spread(spread: score.Spread) -> dict:
    return {name: _number(value) for name, value in spread.as_dict().items()}


def explored(run: Run) -> tuple[list[dict], list[tuple[float, float]]]:
    """One entry a floor of report.json's `floors`, and the share of the start's floor over time."""
    nav, tiles, rows, series = run.flight.nav, run.flight.tiles, [], []
    primitives = run.world.primitives()
    for index in sorted({t.floor for t in tiles} | {0}):
        on_floor = nav["floor"] == index
        height = nav["z_m"][on_floor] - nav["ground_z_m"][on_floor]
        ground = nav["ground_z_m"][on_floor][np.isfinite(height) & (height < OVER_FLOOR_M)]   # not what is seen through the opening
        estimate = 0.0 if index == 0 else (float(np.median(ground)) if ground.size else None)
        seed = (run.start.x_m, run.start.y_m)
        if index != 0 and on_floor.any() and len(run.truth["t_s"]):
            row = int(np.searchsorted(run.truth["t_s"], nav["t_us"][on_floor][0] * 1e-6 - 1e-3))
            row = min(row, len(run.truth["t_s"]) - 1)
            seed = (float(run.truth["x_m"][row]), float(run.truth["y_m"][row]))
        wanted = run.start.z_m + (estimate or 0.0)
        true_floor = min(run.world.floors, key=lambda f: abs(float(f.elevation_m) - wanted))
        grade = ExploredScore(score.cached_floor_truth(primitives, float(true_floor.elevation_m), *seed), run.start)
        for tile in tiles:
            if tile.floor == index:
                grade.update(tile.t_us * 1e-6, tile.tile_x, tile.tile_y, tile.cell_m, tile.log_odds)
                if index == 0:
                    series.append((tile.t_us * 1e-6, grade.explored_fraction))
        estimate = floor_elevation_m(run.flight.levels, estimate)
        recorded = record.map_of(tiles, index)
        found, true = map_score.wall_shares(grade.floor, run.start, *recorded) if recorded is not None else (None, None)
        camera = map_score.camera_seen_fraction(grade.floor, run.truth, float(true_floor.elevation_m)) if len(run.truth["t_s"]) else None
        rows.append({
            "elevation_m": _number(estimate, 4),
            "true_elevation_m": _number(float(true_floor.elevation_m) - run.start.z_m, 4),
            "explored_fraction": _number(grade.explored_fraction),
            "explorable_area_m2": _number(grade.floor.explorable_area_m2, 4),
            "time_to_95_s": _number(grade.time_to_s[0.95], 3),
            "time_to_99_s": _number(grade.time_to_s[0.99], 3),
            "walls_found_fraction": _number(found),
            "walls_true_fraction": _number(true),
            "camera_seen_fraction": _number(camera),
        })
    return rows, series


def floor_elevation_m(levels, near_m: float | None) -> float | None:
    """Elevation of the floor about there, as the map has it: of the nearest level of the last levels_t that faces up. Without one within 0.3 m: near_m itself,
    or None for the floor of the start."""
    if near_m is None:
        return None
    found = [z for z, facing in zip(levels.z_m[:levels.count], levels.facing) if facing > 0 and abs(z - near_m) < 0.3] if levels is not None else []
    if found:
        return min(found, key=lambda z: abs(z - near_m))
    return near_m or None


def levels_found(levels, true_levels_m: list[float]) -> list[dict]:
    """report.json's `levels` of the last levels_t (or None), lowest first: elevation with sigma, facing, and the box where it was seen."""
    order = sorted(range(levels.count), key=lambda i: levels.z_m[i]) if levels is not None else []
    matches = score.match_levels([levels.z_m[i] for i in order], true_levels_m)
    return [{"elevation_m": _number(m["elevation_m"], 4), "true_elevation_m": _number(m["true_elevation_m"], 4),
             "sigma_m": _number(math.sqrt(max(levels.z_var_m2[i], 0.0)), 4), "facing": int(levels.facing[i]),
             "extent_m": [_number(v[i], 3) for v in (levels.x_min_m, levels.y_min_m, levels.x_max_m, levels.y_max_m)]}
            for i, m in zip(order, matches)]


def policy_told(settings: dict, nav) -> dict | None:
    """Who decided where to look, and how a policy in a process of its own did; None before the first step of exploring."""
    asked = np.flatnonzero(nav["policy"] == EXTERNAL_POLICY)
    if not nav["t_us"].size:
        return None
    after = np.flatnonzero(nav["policy"] != EXTERNAL_POLICY)
    after = after[after > asked[-1]] if asked.size else after[:0]
    name = settings.get("policy_class") or ("another process" if asked.size else POLICIES[int(nav["policy"][-1])])
    return {"name": name, "refused": int(nav["policy_refused"][-1]), "timeouts": int(nav["policy_timeouts"][-1]),
            "given_up_s": _number(nav["t_us"][after[0]] * 1e-6, 3) if after.size else None}


def build(run: Run) -> tuple[dict, score.PoseErrors, list[tuple[float, float]]]:
    """report.json's content, the error series and the explored share over time."""
    settings, sim, stats, nav, truth = run.settings, run.sim, run.stats, run.flight.nav, run.truth
    rows = len(truth["t_s"])
    sim_time_s = float(sim.get("sim_time_s") or (truth["t_s"][-1] if rows else 0.0))
    wall_time_s = float(sim.get("wall_time_s") or settings.get("wall_time_s") or 0.0)
    landed = bool(rows and not truth["armed"][-1] and truth["z_m"][-1] - truth["z_m"][0] < GROUND_HEIGHT_M
                  and np.any(truth["armed"]))
    errors = score.pose_errors(nav, truth, run.start)
    interval = score.flight_interval(truth["t_s"], truth["z_m"], truth["armed"]) if rows else None
    floors, series = explored(run)
    levels = run.flight.levels
    true_levels = score.true_levels_m(run.world.primitives(), run.world.floors, run.start.z_m)
    step_us = stats.get("step_us") or {}
    if not step_us and nav["step_us"].size:
        p50, p99 = np.percentile(nav["step_us"], (50, 99))
        step_us = {"p50": p50, "p99": p99, "max": nav["step_us"].max()}
    outcome, reason = judge(settings, sim, nav["state"], nav["reason"], landed, sim_time_s)
    clearance = sim.get("min_clearance_m")
    whole = lambda value: None if value is None else int(value)
    report = {
        "schema": 1,
        "world": settings.get("world") or run.world.name,
        "seed": int(settings.get("seed", 0)),
        "outcome": outcome,
        "reason": reason,
        "lockstep_broken": bool(sim.get("lockstep_broken", True)),
        "sim_time_s": _number(sim_time_s, 3),
        "wall_time_s": _number(wall_time_s, 2),
        "realtime_factor": _number(sim_time_s / wall_time_s, 2) if wall_time_s > 0.0 else None,
        "path_length_m": _number(score.path_length_m(truth), 3),
        "collisions": int(sim["collisions"] if sim.get("collisions") is not None
                          else (truth["contacts_total"][-1] if rows and "contacts_total" in truth else 0)),
        "min_clearance_m": _number(clearance, 4),
        "pose_error_m": _spread(errors.position_m),
        "yaw_error_rad": _spread(errors.yaw_rad),
        "altitude_error_m": _spread(errors.altitude_m),
        "floors": floors,
        "levels": levels_found(levels, true_levels),
        **objects.report_fields(run.folder, run.world, run.start),
        "landed": landed,
        "home_error_m": _number(score.home_error_m(truth), 4),
        "step_ms": {k: _number(step_us[k] * 1e-3, 4) if step_us.get(k) is not None else None for k in ("p50", "p99", "max")},
        "memory": {"navigator_bytes": whole(stats.get("navigator_bytes")), "rss_kib": whole(stats.get("rss_kib")),
                   "heap_allocations_after_start": _heap(stats, record.read_json(run.folder / "log" / "bridge-stats.json"))},
        "explorer": ({k: whole(stats["explorer"].get(k)) for k in EXPLORER_COUNTERS} if stats.get("explorer") else None),
        "policy": policy_told(settings, nav),
        "guard_interventions": int(nav["guard_interventions"][-1]) if nav["t_us"].size else 0,
        "camera": bool(settings.get("camera", False)),
        "profile": settings.get("profile", "default"),
        "preset": settings.get("preset", "default"),
        "autopilot": settings.get("autopilot", "px4"),
        "parameters": settings.get("parameters", {}),
        "faults": settings.get("faults", []),
        "max_time_s": settings.get("max_time_s"),
        "armed_s": _number(interval[0], 3) if interval else None,
        "touchdown_s": _number(interval[1], 3) if interval else None,
        "steps": int(nav["t_us"].size),
        "refused_samples": int(nav["refused_samples"][-1]) if nav["t_us"].size else 0,
        "start": {"x_m": _number(run.start.x_m), "y_m": _number(run.start.y_m), "z_m": _number(run.start.z_m),
                  "yaw_rad": _number(run.start.yaw_rad)},
        "date": settings.get("date", ""),
        "run": str(run.folder),
    }
    return report, errors, series


def tum_lines(t_s, x_m, y_m, z_m, roll_rad, pitch_rad, yaw_rad) -> list[str]:
    """Poses as lines `t x y z qx qy qz qw` (TUM format); all (N,) float, Z-Y-X angles, one frame."""
    cr, sr = np.cos(roll_rad / 2), np.sin(roll_rad / 2)
    cp, sp = np.cos(pitch_rad / 2), np.sin(pitch_rad / 2)
    cy, sy = np.cos(yaw_rad / 2), np.sin(yaw_rad / 2)
    table = np.stack([t_s, x_m, y_m, z_m, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
                      cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy], axis=1)
    return [" ".join(f"{v:.6f}" for v in row) for row in table]


def write_trajectories(run: Run) -> None:
    """trajectory_estimate.tum and trajectory_truth.tum, both frame World, the estimate placed by the start pose alone."""
    nav, truth = run.flight.nav, run.truth
    x, y = run.start.to_world(nav["x_m"], nav["y_m"])
    lines = tum_lines(nav["t_us"] * 1e-6, x, y, nav["z_m"] + run.start.z_m, nav["roll_rad"], nav["pitch_rad"],
                      nav["yaw_rad"] + run.start.yaw_rad)
    (run.folder / "trajectory_estimate.tum").write_text("\n".join(lines) + "\n", encoding="utf-8")
    zero = np.zeros(len(truth["t_s"]))
    lines = tum_lines(truth["t_s"], truth["x_m"], truth["y_m"], truth["z_m"], truth.get("roll_rad", zero),
                      truth.get("pitch_rad", zero), truth["yaw_rad"])
    (run.folder / "trajectory_truth.tum").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _rows(value, name="") -> list[tuple[str, str]]:
    if isinstance(value, dict):
        return [row for k, v in value.items() for row in _rows(v, f"{name}.{k}" if name else k)]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [row for i, v in enumerate(value) for row in _rows(v, f"{name}[{i}]")]
    text = "-" if value is None or value == [] or value == {} else (f"{value:.4g}" if isinstance(value, float) else str(value))
    return [(name, text)]


def html_page(report: dict, map_png: bytes, series_svg: str) -> str:
    """The report as one page that needs no other file."""
    first = report["floors"][0]["explored_fraction"] if report["floors"] else 0.0
    figures = [("explored", f"{100.0 * first:.1f} %"), ("collisions", str(report["collisions"])),
               ("simulated time", f"{report['sim_time_s']:.1f} s"), ("path", f"{report['path_length_m']:.1f} m")]
    for label, field, unit, scale in (("pose error, mean", "pose_error_m", "cm", 100.0),
                                      ("altitude error, mean", "altitude_error_m", "cm", 100.0)):
        mean = report[field]["mean"]
        figures.append((label, "-" if mean is None else f"{scale * mean:.1f} {unit}"))
    cards = "".join(f"<div><b>{html.escape(v)}</b><span>{html.escape(k)}</span></div>" for k, v in figures)
    table = "".join(f"<tr><td>{html.escape(k)}</td><td>{html.escape(v)}</td></tr>" for k, v in _rows(report))
    title = html.escape(f"{report['world']}, seed {report['seed']}: {report['outcome'].replace('_', ' ')}")
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Noctule: {title}</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 70rem; margin: 1.5rem auto; padding: 0 1rem; }}
h1 {{ font-size: 1.4rem; margin-bottom: .2rem; }}
.cards {{ display: flex; flex-wrap: wrap; gap: .7rem; margin: 1rem 0; }}
.cards div {{ border: 1px solid #ddd; border-radius: .4rem; padding: .5rem .9rem; }}
.cards b {{ display: block; font-size: 1.2rem; }} .cards span {{ color: #666; font-size: .85rem; }}
img, svg {{ max-width: 100%; height: auto; }}
table {{ border-collapse: collapse; font-size: .9rem; }} td {{ border-bottom: 1px solid #eee; padding: .15rem 1.2rem .15rem 0; }}
td:last-child {{ font-variant-numeric: tabular-nums; }}
</style></head><body>
<h1>{title}</h1><p>{html.escape(report['reason'])}</p>
<div class="cards">{cards}</div>
<h2>Map</h2><p>White: recorded as free. Black: recorded as occupied. Brown: the true solids, cut 1 m above the floor.</p>
<img alt="map with true and estimated path" src="data:image/png;base64,{base64.b64encode(map_png).decode()}">
<h2>Over time</h2>{series_svg}
<h2>All figures</h2><p>Their meanings: docs/report.md.</p><table>{table}</table>
</body></html>
"""


def write(folder) -> dict:
    """Scores the run in a folder and writes report.json, report.html, map.png and the trajectories; returns the report.

    Raises:
        RecordError: it is not a run directory, or the report breaks its own schema.
    """
    run = open_run(folder)
    report, errors, series = build(run)
    broken = validate(report)
    if broken:
        raise record.RecordError(f"{folder}: report breaks its schema: {broken[0]}")
    (run.folder / "report.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    write_trajectories(run)
    title = f"{report['world']}, seed {report['seed']}: {report['outcome'].replace('_', ' ')}, " \
            f"{100.0 * report['floors'][0]['explored_fraction']:.1f} % explored"
    picture = draw.map_png(run.world.primitives(), run.start.z_m + report["floors"][0]["true_elevation_m"], run.start,
                           record.map_of(run.flight.tiles, 0), run.flight.nav, run.truth, run.flight.walls, title)
    (run.folder / "map.png").write_bytes(picture)
    thin = series[::max(1, len(series) // 1500)] + series[-1:]
    levels = [row["elevation_m"] for row in report["levels"]]
    page = html_page(report, picture, draw.series_svg(errors, run.flight.nav, run.truth, run.start, levels, thin))
    if len(report["floors"]) > 1:
        nav = run.flight.nav
        building = atlas.picture(atlas.of_record(run.flight.tiles, [f["elevation_m"] or 0.0 for f in report["floors"]], nav),
                                 np.stack([nav["x_m"], nav["y_m"], nav["z_m"], nav["floor"].astype(float)], axis=1)[::4])
        (run.folder / "building.png").write_bytes(building)
        shown = base64.b64encode(building).decode()
        page = page.replace("</body>", f'<h2>The building</h2>\n<img alt="floor plans and the building" src="data:image/png;base64,{shown}">\n</body>', 1)
    page = page.replace("</body>", f"{objects.section(run.folder, report, run.world, run.start)}\n</body>", 1)
    (run.folder / "report.html").write_text(page, encoding="utf-8")
    return report
