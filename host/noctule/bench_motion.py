"""`noctule bench motion`: doors, closest approach, truth of the map, fence, battery, in-process flights (docs/results.md).

Kept under runs/bench/motion and not flown again while settings and built library are the same.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from noctule import clearance, inprocess, motion_worlds, record, report
from noctule.bench import FOLDER, data_folder, row
from noctule.settings import FlightSettings

DOOR_M = 0.80
ANGLES_DEG = (0, 17, 45)
OFFSETS_M = (-0.8, -0.4, 0.0, 0.4, 0.8)
WORLDS = ("maze_a", "maze_b", "office")
PLANS = ("OFFICE_chewlane", "OFFICE_130604_Floor_Plan_with_Furniture_small", "SCHOOL_Borchen4")
SEEDS, QUICK_SEEDS = (1, 2, 3), (1,)
CLUTTER, QUICK_CLUTTER = tuple(range(10, 20)), (10, 11)      # seeds of motion_worlds.clutter
LAGS_S = (0.15, 0.3, 0.5)
MAX_TIME_S = 1800.0


@dataclass
class Job:
    """One flight: world is a description (docs/worlds.md), a shipped name or a path."""

    label: str
    world: object
    seed: int = 1
    parameters: dict[str, float] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    profile: str = "default"
    axis_deg: float = 0.0      # the farthest x of the true path along this direction is told


def fly(job: Job) -> dict:
    """Flies a job, or takes what is kept of it: the report, with `parts` (clearance.parts), `far_x_m` and `battery_end`."""
    from noctule import inprocess_flight
    from noctule_sim.world import build_world, load_world

    folder = FOLDER / "motion" / job.label
    library = hashlib.sha256(inprocess.library_path().read_bytes()).hexdigest()[:16]
    key = {"library": library, "world": job.world if isinstance(job.world, str) else json.dumps(job.world, sort_keys=True), "seed": job.seed,
           "parameters": job.parameters, "faults": job.faults, "profile": job.profile}
    if record.read_json(folder / "bench.json") == key and (kept := record.read_json(folder / "motion.json")):
        return kept
    shutil.rmtree(folder, ignore_errors=True)
    world = build_world(job.world) if isinstance(job.world, dict) else load_world(job.world)
    settings = FlightSettings(world=world.name, seed=job.seed, camera=False, max_time_s=MAX_TIME_S, parameters=job.parameters, faults=job.faults,
                              profile=job.profile)
    result = inprocess_flight.fly(settings, world, folder)
    run = report.open_run(folder)
    c, s = math.cos(math.radians(job.axis_deg)), math.sin(math.radians(job.axis_deg))
    vehicle = [message.battery_remaining for message in (record.message_type("vehicle_t").decode(data)
                                                         for name, _, data in record.events(folder / "flight.lcm") if name == "VEHICLE")]
    result |= {"parts": clearance.parts(run), "far_x_m": float((c * run.truth["x_m"] + s * run.truth["y_m"]).max()), "battery_end": vehicle[-1]}
    (folder / "motion.json").write_text(json.dumps(result) + "\n", encoding="utf-8")
    (folder / "bench.json").write_text(json.dumps(key) + "\n", encoding="utf-8")
    p = result["parts"]
    print(f"{job.label}: {result['outcome']}, explored {result['floors'][0]['explored_fraction']:.3f}, collisions {result['collisions']}, nearest {result['min_clearance_m']:.3f} m "
          f"(setpoint {p['setpoint_m']:.3f}, estimate {p['estimate_m']:.3f}), {p['mean_speed_m_s']:.2f} m/s", flush=True)
    return result


def door_jobs(width_m: float = DOOR_M, angles=ANGLES_DEG, offsets=OFFSETS_M) -> list[Job]:
    """A flight for each angle of the door and each offset of the start."""
    return [Job(f"door{width_m * 100:.0f}-{a}-{o:+.1f}", motion_worlds.door(width_m, a, o), axis_deg=a) for a in angles for o in offsets]


def lag_flight(lag_s: float) -> float:
    """Closest approach of a vehicle whose velocity follows with a lag, kinematic loop, in rooms full of things [m]."""
    from noctule import kinematic
    from noctule_sim.world import build_world

    return kinematic.explore(build_world(motion_worlds.clutter(CLUTTER[0])), 1, {}, lag_s=lag_s).least_clearance_m


def passed(result: dict) -> bool:
    """Through the door and back, everything explored, landed."""
    return result["outcome"] == "completed" and result["far_x_m"] > 0.5 and result["collisions"] == 0


def rows_of(doors: list[dict], wide: list[dict], worlds: list[dict], clutter: list[dict], sluggish: list[dict], harsh: list[dict], lags: list[float],
            fence: dict, battery: dict, beams_per_s: float) -> list[dict]:
    """The table."""
    floors = [r["floors"][0] for r in worlds]
    least = lambda results: min(r["min_clearance_m"] for r in results)
    mean = lambda values: sum(values) / len(values)
    return [
        row(f"door 0.80 m at {', '.join(map(str, ANGLES_DEG))} degrees: passed", sum(passed(r) for r in doors), f"of {len(doors)}", None, f"== {len(doors)}"),
        row("door 0.80 m: contacts", sum(r["collisions"] for r in doors), "-", None, "== 0"),
        row("door 0.80 m (room for 0.10 m each side): closest approach", least(doors), "m", None, ">= 0.05"),
        row("door 0.90 m (0.15 m each side): closest approach", least(wide), "m", None, ">= 0.05"),
        row("worlds: flights completed", sum(r["outcome"] == "completed" for r in worlds), f"of {len(worlds)}", None, f"== {len(worlds)}"),
        row("worlds: contacts", sum(r["collisions"] for r in worlds), "-", None, "== 0"),
        row("worlds: closest approach, least", least(worlds), "m", None, ">= 0.05"),
        row("worlds: closest approach of the setpoint, least", min(r["parts"]["setpoint_m"] for r in worlds), "m"),
        row("worlds: true place off the line of setpoints near obstacles, greatest", max(r["parts"]["tracking_error_m"] for r in worlds), "m"),
        row("worlds: estimate off near obstacles, greatest", max(r["parts"]["estimate_error_m"] for r in worlds), "m"),
        row("worlds: visible wall cells marked, least", min(f["walls_found_fraction"] for f in floors), "-", None, ">= 0.98"),
        row("worlds: visible wall cells marked, mean", mean([f["walls_found_fraction"] for f in floors]), "-", None, ">= 0.98"),
        row("worlds: marked cells that are true, least", min(f["walls_true_fraction"] for f in floors), "-", None, ">= 0.97"),
        row("worlds: floor seen by the camera, mean", mean([f["camera_seen_fraction"] for f in floors]), "-"),
        row("worlds: mean speed while exploring", mean([r["parts"]["mean_speed_m_s"] for r in worlds]), "m/s"),
        row("rooms full of things: flights completed", sum(r["outcome"] == "completed" for r in clutter), f"of {len(clutter)}", None, f"== {len(clutter)}"),
        row("rooms full of things: contacts", sum(r["collisions"] for r in clutter), "-", None, "== 0"),
        row("rooms full of things: closest approach, least", least(clutter), "m", None, ">= 0.05"),
        row("sluggish autopilot (PX4's default gains), doors and rooms full of things: contacts", sum(r["collisions"] for r in sluggish), f"in {len(sluggish)} flights", None, "== 0"),
        row("sluggish autopilot: closest approach, least", least(sluggish), "m", None, ">= 0.05"),
        row("profile harsh, maze_a: contacts", sum(r["collisions"] for r in harsh), f"in {len(harsh)} flights", None, "== 0"),
        row("profile harsh, maze_a: closest approach, least", least(harsh), "m", None, ">= 0.05"),
        row(f"lag of {', '.join(map(str, LAGS_S))} s, kinematic loop, rooms full of things: closest approach, least", min(lags), "m", None, ">= 0.05"),
        row("open front door, fence at the walls: farthest out (walls at 4.0 m)", fence["far_x_m"], "m", None, "<= 4.0"),
        row("open front door: completed", int(fence["outcome"] == "completed"), "-", None, "== 1"),
        row("battery that drains in 150 s: landed at home", battery["home_error_m"] if battery["landed"] else None, "m", None, "<= 0.5"),
        row("battery that drains in 150 s: left at the end", battery["battery_end"], "-", None, ">= 0.1"),
        row("grid, one thread", beams_per_s, "beams/s", None, ">= 43200"),
    ]


def bench_motion(quick: bool, fresh: bool) -> list[dict]:
    """Doors at three angles, shipped worlds and plans, fence and battery."""
    if fresh:
        shutil.rmtree(FOLDER / "motion", ignore_errors=True)
    seeds = QUICK_SEEDS if quick else SEEDS
    names: list[tuple[str, str]] = [(w, w) for w in WORLDS]
    data = data_folder()
    for plan in PLANS[:1] if quick else PLANS:
        path = data / "plans_json" / f"{plan}.json" if data is not None else None
        if path is not None and path.is_file():
            names.append((plan, str(path)))
        else:
            print(f"{plan}: skipped: no data", flush=True)
    doors = door_jobs()
    wide = door_jobs(0.90, (17,), OFFSETS_M[::2])
    worlds = [Job(f"{label}-{seed}", world, seed) for label, world in names for seed in seeds]
    clutter = [Job(f"clutter-{k}", motion_worlds.clutter(k), k) for k in (QUICK_CLUTTER if quick else CLUTTER)]
    slow = [Job(f"sluggish-{job.label}", job.world, job.seed, faults=["sluggish@0"], axis_deg=job.axis_deg) for job in doors[::2] + clutter[: len(clutter) // 2]]
    harsh = [Job(f"harsh-{seed}", "maze_a", seed, profile="harsh") for seed in (3, 4)]
    ends = [Job("fence", motion_worlds.open_front_door(), parameters=motion_worlds.front_door_fence(), axis_deg=11.0),
            Job("battery", "maze_a", faults=["battery-drain@0"])]
    parts = (doors, wide, worlds, clutter, slow, harsh, ends)
    with ProcessPoolExecutor(os.cpu_count() or 1) as pool:
        results = iter(list(pool.map(fly, [job for part in parts for job in part])))
        lags = list(pool.map(lag_flight, LAGS_S))
    flown = [[next(results) for _ in part] for part in parts]
    return rows_of(*flown[:-1], lags, *flown[-1], inprocess.grid_beams_per_s())
