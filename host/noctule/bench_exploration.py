"""`noctule bench exploration`: how fast each policy sees a building, world by world, against the nearest frontier.

Every exploration is flown in the kinematic loop (kinematic.py: the firmware's map, mission, reference and guard, the simulator's ray
caster, the pose given), two at a time, and kept under runs/bench/exploration, one file each: a bench that was stopped goes on. A
sample is confirmed by whole in-process flights (`confirmed`). Times are counted from the start of the climb. One floor is explored and
none looked for (floors_max 1): the search for openings comes after an exploration and is `noctule bench floors`'s.
"""

from __future__ import annotations

import hashlib
import math
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from noctule.bench import FOLDER, SEEDS, data_folder, kept, row
from noctule.settings import POLICIES

SHIPPED = ("maze_a", "maze_b", "office", "levels", "two_floor")
QUICK_WORLDS = ("maze_a", "maze_b", "SCHOOL_Borchen4", "HOUSEEXPO_house_expo_room_0000", "SCHOOL_Franch1")
QUICK_SEEDS = (1,)
TUNED_ON = ("maze_a", "maze_b", "office", "levels", "HOUSEEXPO_house_expo_room_0000", "OFFICE_chewlane", "SCHOOL_Borchen4", "SCHOOL_Lamuniere1")
MAX_TIME_S = 1800.0
CRUISE_M_S = 0.7          # at which the tour that knows the building is flown: between the mean speeds of both policies and what is allowed
WORKERS = 2
COMPARED = ("tour", "frontier")
PAPER_TIME_S = 600.0
CONFIRMED = (("maze_a", 1), ("office", 1), ("SCHOOL_Borchen4", 1))   # flown again whole, in the process: physics, IMU, localisation, drop-outs


def worlds() -> dict[str, str]:
    """Name -> what load_world takes: shipped worlds, then the plans of the shared data if it is there."""
    found = {name: name for name in SHIPPED}
    data = data_folder()
    if data is not None:
        found |= {p.stem: str(p) for p in sorted((data / "plans_json").glob("*.json"))}
    return found


def _fingerprint() -> str:
    from noctule.inprocess import library_path

    digest = hashlib.sha256(library_path().read_bytes())
    digest.update(Path(__file__).with_name("kinematic.py").read_bytes())
    return digest.hexdigest()[:16]


def _truth(source: str):
    """The floor's truth, kept beside the results: it takes longer than a small flight."""
    import pickle

    from noctule.score import cached_floor_truth
    from noctule.truth import fingerprint, LASER_RANGE_M
    from noctule_sim.world import load_world

    world = load_world(source)
    storey = min(world.floors, key=lambda f: abs(f.elevation_m - world.start.z_m))
    key = fingerprint(world.primitives(), float(storey.elevation_m), world.start.x_m, world.start.y_m, LASER_RANGE_M)
    path = FOLDER / "exploration" / f"truth-{hashlib.sha256(str(key).encode()).hexdigest()[:20]}.pickle"
    if path.is_file():
        return world, pickle.loads(path.read_bytes())
    truth = cached_floor_truth(world.primitives(), float(storey.elevation_m), world.start.x_m, world.start.y_m)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(truth))
    return world, truth


def explored(name: str, source: str, seed: int, policy: str, fresh: bool = False) -> dict:
    """The figures of one exploration, kept or flown now."""
    path = FOLDER / "exploration" / f"{name}-{seed}-{policy}.json"
    return kept(path, _fingerprint(), fresh, lambda: _explored_now(name, source, seed, policy))


def _explored_now(name: str, source: str, seed: int, policy: str) -> dict:
    from noctule.kinematic import explore

    world, truth = _truth(source)
    parameters, max_time_s = {"policy": POLICIES.index(policy), "floors_max": 1}, MAX_TIME_S
    if policy == "paper":
        from noctule.params_gen import PRESETS

        parameters = {k: v for k, v in PRESETS["paper"].items() if v != PRESETS["default"][k]}
        max_time_s = PAPER_TIME_S
    r = explore(world, seed, parameters, max_time_s, truth)
    return {"world": name, "seed": seed, "policy": policy, "completed": r.completed, "explored_fraction": r.explored_fraction,
            "time_to_95_s": r.time_to_s[0.95], "time_to_99_s": r.time_to_s[0.99], "path_to_99_m": r.path_to_m[0.99],
            "exploring_s": r.exploring_s, "exploring_path_m": r.exploring_path_m, "time_s": r.time_s, "path_m": r.path_m,
            "least_clearance_m": r.least_clearance_m, "goals": r.goals, "switches": r.switches, "back_and_forth": r.back_and_forth,
            "stuck": r.stuck, "in_vain": r.in_vain, "plan_ms": r.plan_ms, "whole_plan_ms": r.whole_plan_ms, "whole_plan_cells": r.whole_plan_cells,
            "reason": r.reason, "unknown_share": r.unknown_share, "walls": r.walls, "track": np.round(r.track, 2).tolist()}


def confirmed(name: str, source: str, seed: int, fresh: bool = False) -> dict:
    """The default's exploration as a whole flight in the process, kept or flown now."""
    from noctule.inprocess import library_path

    path = FOLDER / "exploration" / f"whole-{name}-{seed}" / "bench.json"
    return kept(path, hashlib.sha256(library_path().read_bytes()).hexdigest()[:16], fresh, lambda: _confirmed_now(name, source, seed, path.parent))


def _confirmed_now(name: str, source: str, seed: int, folder: Path) -> dict:
    import shutil

    from noctule import inprocess_flight
    from noctule.settings import FlightSettings
    from noctule_sim.world import load_world

    shutil.rmtree(folder, ignore_errors=True)
    settings = FlightSettings(world=source, seed=seed, camera=False, max_time_s=MAX_TIME_S, parameters={"floors_max": 1.0})
    report = inprocess_flight.fly(settings, load_world(source), folder)
    floor = report["floors"][0]
    return {"world": name, "seed": seed, "completed": report["outcome"] == "completed", "explored_fraction": floor["explored_fraction"],
            "time_to_99_s": floor["time_to_99_s"], "collisions": report["collisions"], "least_clearance_m": report["min_clearance_m"]}


def confirmed_rows(whole: list[dict], results: list[dict]) -> list[dict]:
    """Whole flights beside the kinematic ones of the same world and seed."""
    rows = [row("whole flights: completed without contact, explored_fraction at least 0.97", sum(w["completed"] and w["collisions"] == 0 and w["explored_fraction"] >= 0.97 for w in whole),
                f"of {len(whole)}", None, f"== {len(whole)}")]
    for w in whole:
        alike = next((r for r in results if (r["world"], r["seed"], r["policy"]) == (w["world"], w["seed"], "tour")), None)
        if alike is not None:
            rows.append(row(f"  {w['world']}, seed {w['seed']}: time to 99 %, against the kinematic loop's", time_to_99(w) / time_to_99(alike), f"{time_to_99(w):.0f} s", "1.0"))
    return rows


def all_explored(wanted: list[tuple[str, str, int, str]], fresh: bool) -> list[dict]:
    """Every (world, source, seed, policy), two at a time, in the order asked for."""
    done: dict[tuple, dict] = {}
    with ProcessPoolExecutor(WORKERS) as pool:
        jobs = {pool.submit(explored, *w, fresh): w for w in wanted}
        try:
            for job in as_completed(jobs):
                r = done[jobs[job]] = job.result()
                t99 = "never" if r["time_to_99_s"] is None else f"{r['time_to_99_s']:.0f} s"
                print(f"{r['world']}, seed {r['seed']}, {r['policy']}: {'completed' if r['completed'] else 'not completed'}, explored "
                      f"{r['explored_fraction']:.4f}, 99 % after {t99}, path {r['path_m']:.0f} m, switches A-B-A {r['back_and_forth']}", flush=True)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
    return [done[w] for w in wanted]


def time_to_99(r: dict) -> float:
    """Never reached counts as the greatest time allowed, for every policy alike."""
    return MAX_TIME_S if r["time_to_99_s"] is None else r["time_to_99_s"]


def path_to_99(r: dict) -> float:
    """Path when 99 % were seen; the whole path where that never was."""
    return r["path_m"] if r["path_to_99_m"] is None else r["path_to_99_m"]


def undecided(results: list[dict]) -> list[str]:
    """Worlds in which no flight of any policy saw 99 %: times and paths to it say nothing there."""
    return sorted({r["world"] for r in results} - {r["world"] for r in results if r["time_to_99_s"] is not None})


def ratios(results: list[dict], value, first: str = "tour", second: str = "frontier") -> dict[str, float]:
    """World -> mean of value over the seeds with the first policy over the same with the second; worlds where both were flown."""
    names = sorted({r["world"] for r in results})
    out = {}
    for name in names:
        means = []
        for policy in (first, second):
            seeds = {r["seed"] for r in results if r["world"] == name and r["policy"] == first} & {
                r["seed"] for r in results if r["world"] == name and r["policy"] == second}
            values = [value(r) for r in results if r["world"] == name and r["policy"] == policy and r["seed"] in seeds]
            means.append(float(np.mean(values)) if values else math.nan)
        if all(math.isfinite(m) for m in means):
            out[name] = means[0] / means[1]
    return out


def bootstrap(values, rounds: int = 4000, seed: int = 0) -> tuple[float, float]:
    """95 % interval of the mean, worlds drawn with replacement (the pairs stay together)."""
    values = np.asarray(values, float)
    draws = np.random.default_rng(seed).integers(0, len(values), (rounds, len(values)))
    low, high = np.percentile(values[draws].mean(axis=1), (2.5, 97.5))
    return float(low), float(high)


def clairvoyant_of(name: str, source: str) -> float:
    """Length of the tour that knows the building (clairvoyant.py), kept beside the results [m]."""
    from noctule import clairvoyant

    path = FOLDER / "exploration" / f"clairvoyant-{name}.json"
    world, truth = _truth(source)
    key = hashlib.sha256(Path(clairvoyant.__file__).read_bytes() + truth.seeable.tobytes() + truth.reachable.tobytes()).hexdigest()[:16]
    tour_m = kept(path, key, False, lambda: {"tour_m": clairvoyant.clairvoyant_m(truth, world.start.x_m, world.start.y_m)})["tour_m"]
    print(f"{name}: a tour that knows the building, {tour_m:.0f} m", flush=True)
    return tour_m


def draw_paths(results: list[dict], path: Path, seed: int) -> None:
    """The paths of that seed over the true walls, one panel a world, one colour a policy."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    sources = worlds()
    names = sorted({r["world"] for r in results})
    columns = min(4, len(names))
    figure, axes = plt.subplots(math.ceil(len(names) / columns), columns, figsize=(4 * columns, 3.6 * math.ceil(len(names) / columns)), squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, name in zip(axes.flat, names):
        _, truth = _truth(sources[name])
        h, w = truth.occupied.shape
        axis.imshow(truth.occupied, origin="lower", cmap="Greys", vmax=2, extent=[truth.x0_m, truth.x0_m + 0.1 * w, truth.y0_m, truth.y0_m + 0.1 * h])
        for policy, colour in (("frontier", "tab:orange"), ("tour", "tab:blue")):
            for r in results:
                if r["world"] == name and r["policy"] == policy and r["seed"] == seed and r["track"]:
                    track = np.array(r["track"])
                    axis.plot(track[:, 1], track[:, 2], color=colour, lw=0.8, label=f"{policy}: {time_to_99(r):.0f} s")
        axis.legend(fontsize=6, loc="lower right")
        axis.set_title(name, fontsize=7)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def policy_rows(results: list[dict]) -> list[dict]:
    """What each policy did, the default with what it must."""
    rows = []
    for policy in COMPARED:
        mine = [r for r in results if r["policy"] == policy]
        must = policy == "tour"
        label = {"tour": "default", "frontier": "nearest frontier"}[policy]
        rows += [
            row(f"{label}: completed, explored_fraction at least 0.97", sum(r["completed"] and r["explored_fraction"] >= 0.97 for r in mine),
                f"of {len(mine)} flights", None, f"== {len(mine)}" if must else None),
            row(f"{label}: explored_fraction, least", min(r["explored_fraction"] for r in mine), "-"),
            row(f"{label}: closest approach, hull to anything", min(r["least_clearance_m"] for r in mine), "m", None, ">= 0.05" if must else None),
            row(f"{label}: never reached 99 %", sum(r["time_to_99_s"] is None for r in mine), "flights"),
            row(f"{label}: target switches A-B-A without new information", sum(r["back_and_forth"] for r in mine), "-", None, "== 0" if must else None),
            row(f"{label}: targets left for a better one, mean", float(np.mean([r["switches"] for r in mine])), "-"),
            row(f"{label}: targets given up, mean", float(np.mean([r["stuck"] for r in mine])), "-"),
            row(f"{label}: planning each step, p99, greatest", max(r["plan_ms"][1] for r in mine), "ms", None, "<= 5" if must else None, "<= 1" if must else None),
        ]
    return rows


def rows_of(results: list[dict], clairvoyant: dict[str, float]) -> list[dict]:
    """The table: the default against the nearest frontier, worlds weighing the same."""
    rows = policy_rows(results)
    never = undecided(results)
    for name in never:
        seen = {policy: float(np.mean([r["explored_fraction"] for r in results if (r["world"], r["policy"]) == (name, policy)])) for policy in COMPARED}
        rows.append(row(f"{name}: 99 % seen by nobody, left out of the two means; explored_fraction", seen["tour"], f"nearest frontier's {seen['frontier']:.4f}"))
    for label, value, must, aim in (("time to 99 %", time_to_99, "<= 0.85", "<= 0.75"), ("path to 99 %", path_to_99, "<= 0.90", "<= 0.80"),
                                    ("time until nothing is left", lambda r: r["exploring_s"], None, None)):
        by_world = ratios([r for r in results if must is None or r["world"] not in never], value)
        if not by_world:
            continue
        low, high = bootstrap(list(by_world.values()))
        rows.append(row(f"{label}, against nearest frontier, mean over worlds", float(np.mean(list(by_world.values()))), f"interval {low:.2f} to {high:.2f}", "1.0", must, aim))
        held = [v for k, v in by_world.items() if k not in TUNED_ON]
        if held:
            rows.append(row(f"{label}, the same, worlds not tuned on", float(np.mean(held)), f"{len(held)} worlds", "1.0"))
        if must is not None:
            rows += [row(f"  {label}, {name}", ratio, "of nearest frontier's") for name, ratio in by_world.items()]
    rows += wall_rows(results) + clairvoyant_rows(results, clairvoyant)
    return rows


def wall_rows(results: list[dict]) -> list[dict]:
    """Truth of the maps of the default's flights."""
    mine = [r for r in results if r["policy"] == "tour"]
    found, true = ([r["walls"][k] for r in mine] for k in (0, 1))
    return [row("default: visible wall cells marked within one cell, mean", float(np.mean(found)), f"least {min(found):.3f}", None, ">= 0.98"),
            row("default: marked cells that are true, mean", float(np.mean(true)), f"least {min(true):.3f}", None, ">= 0.97")]


def clairvoyant_rows(results: list[dict], tour_m: dict[str, float]) -> list[dict]:
    """A tour that knows the building against both policies, on the worlds that it is known of: its length, and its time at CRUISE_M_S."""
    rows = []
    for policy, label in (("frontier", "nearest frontier"), ("tour", "default")):
        mine = {n: [r for r in results if r["world"] == n and r["policy"] == policy] for n in tour_m}
        paths = [tour_m[n] / float(np.mean([path_to_99(r) for r in flown])) for n, flown in mine.items() if flown]
        times = [tour_m[n] / CRUISE_M_S / float(np.mean([time_to_99(r) for r in flown])) for n, flown in mine.items() if flown]
        if paths:
            rows += [row(f"a tour that knows the building: path, against {label}", float(np.mean(paths)), f"{len(paths)} worlds", "0.4 to 0.7" if policy == "frontier" else None),
                     row(f"a tour that knows the building, at {CRUISE_M_S} m/s: time, against {label}", float(np.mean(times)), f"{len(times)} worlds")]
    return rows


def plan_rows(results: list[dict]) -> list[dict]:
    """One whole plan over an explored map, from the place that is dearest to reach: maze_a (15 x 15 m) and the slowest world."""
    rows = []
    for label, mine in (("maze_a, 150 x 150 cells", [r for r in results if r["world"] == "maze_a"]), ("the slowest world", results)):
        if mine:
            slowest = max(mine, key=lambda r: r["whole_plan_ms"])
            rows.append(row(f"one whole plan, {label}", slowest["whole_plan_ms"], f"ms, {slowest['world']}, {slowest['whole_plan_cells']} cells reached", "60 s", "<= 10", "<= 2"))
    return rows


def paper_rows(result: dict) -> list[dict]:
    """maze_a with the paper's policy and preset."""
    label = "maze_a, paper's policy and preset"
    return [row(f"{label}: completed", int(result["completed"]), f"reason {result['reason']}, {result['time_s']:.0f} s"),
            row(f"{label}: known free cells never in the window", result["unknown_share"], "share", "ends under 0.05"),
            row(f"{label}: explored_fraction", result["explored_fraction"], "-")]


def bench_exploration(quick: bool, fresh: bool) -> list[dict]:
    """All shipped worlds and plans, seeds x policies; the paper's policy on maze_a; a picture of the paths."""
    sources = worlds()
    seeds = QUICK_SEEDS if quick else SEEDS
    names = [n for n in sources if not quick or n in QUICK_WORLDS]
    # Seed by seed, so that a bench that is stopped has seen every world.
    wanted = [(n, sources[n], seed, policy) for seed in seeds for n in names for policy in COMPARED]
    results = all_explored(wanted, fresh)
    paper = explored("maze_a", "maze_a", 1, "paper", fresh)
    whole = [confirmed(n, sources[n], seed, fresh) for n, seed in CONFIRMED if n in names and seed in seeds]
    clairvoyant = {n: clairvoyant_of(n, sources[n]) for n in names}
    picture = FOLDER / "exploration" / "paths.png"
    draw_paths(results, picture, seeds[0])
    print(f"paths: {picture}", flush=True)
    return rows_of(results, clairvoyant) + plan_rows(results) + confirmed_rows(whole, results) + paper_rows(paper)
