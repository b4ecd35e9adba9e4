"""`noctule bench exploration`: how fast each policy sees a building, world by world, against the nearest frontier.

Every exploration is flown in the kinematic loop (kinematic.py: the firmware's map, mission, reference and guard, the simulator's ray
caster, the pose given), two at a time, and kept under runs/bench/exploration, one file each: a bench that was stopped goes on. A
sample is confirmed by whole in-process flights (`confirm`). Times are counted from the start of the climb.
"""

from __future__ import annotations

import hashlib
import json
import math
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from noctule.bench import FOLDER, SEEDS, data_folder, row
from noctule.settings import POLICIES

SHIPPED = ("maze_a", "maze_b", "office", "levels", "two_floor")
QUICK_WORLDS = ("maze_a", "maze_b", "SCHOOL_Borchen4", "HOUSEEXPO_house_expo_room_0000", "SCHOOL_Franch1")
QUICK_SEEDS = (1,)
TUNED_ON = ("maze_a", "maze_b", "SCHOOL_Borchen4", "OFFICE_chewlane")   # all others and seeds 4, 5 were held back
MAX_TIME_S = 1800.0
WORKERS = 2
COMPARED = ("tour", "frontier")
CRUISE_M_S = 0.7          # of the clairvoyant tour: mean speed between looks that the flights of both policies reach
LOOK_EVERY_M = 1.0        # lattice of its viewpoints
PAPER_TIME_S = 600.0


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
    from noctule.kinematic import explore

    path = FOLDER / "exploration" / f"{name}-{seed}-{policy}.json"
    key = _fingerprint()
    if path.is_file() and not fresh:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["key"] == key:
            return kept
    world, truth = _truth(source)
    parameters, max_time_s = {"policy": POLICIES.index(policy)}, MAX_TIME_S
    if policy == "paper":
        from noctule.params_gen import PRESETS

        parameters = {k: v for k, v in PRESETS["paper"].items() if v != PRESETS["default"][k]}
        max_time_s = PAPER_TIME_S
    r = explore(world, seed, parameters, max_time_s, truth)
    kept = {"key": key, "world": name, "seed": seed, "policy": policy, "completed": r.completed, "explored_fraction": r.explored_fraction,
            "time_to_95_s": r.time_to_s[0.95], "time_to_99_s": r.time_to_s[0.99], "path_to_99_m": r.path_to_m[0.99],
            "exploring_s": r.exploring_s, "exploring_path_m": r.exploring_path_m, "time_s": r.time_s, "path_m": r.path_m,
            "least_clearance_m": r.least_clearance_m, "goals": r.goals, "switches": r.switches, "back_and_forth": r.back_and_forth,
            "stuck": r.stuck, "in_vain": r.in_vain, "plan_ms": r.plan_ms, "whole_plan_ms": r.whole_plan_ms, "whole_plan_cells": r.whole_plan_cells, "reason": r.reason, "unknown_share": r.unknown_share,
            "track": np.round(r.track, 2).tolist()}
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(kept) + "\n", encoding="utf-8")
    part.replace(path)
    return kept


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


def clairvoyant_s(source: str) -> float:
    """Time of a tour that knows the building: places on a lattice of reachable cells, chosen greedily until they see 99 % of S (line of
    sight, 10 m, all round), joined by shortest paths in an open tour (nearest insertion, 2-opt), flown at CRUISE_M_S without a stop.

    A plain model: not the least possible, and it turns and brakes for nothing.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import dijkstra

    world, truth = _truth(source)
    rows, columns = np.nonzero(truth.reachable)
    number = -np.ones(truth.reachable.shape, int)
    number[rows, columns] = np.arange(len(rows))
    heads, tails, costs = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        y, x = rows + dy, columns + dx
        inside = (y >= 0) & (y < number.shape[0]) & (x >= 0) & (x < number.shape[1])
        to = np.full(len(rows), -1)
        to[inside] = number[y[inside], x[inside]]
        ok = to >= 0
        heads.append(np.nonzero(ok)[0])
        tails.append(to[ok])
        costs.append(np.full(int(ok.sum()), 0.1 * math.hypot(dx, dy)))
    graph = sparse.csr_matrix((np.concatenate(costs), (np.concatenate(heads), np.concatenate(tails))), (len(rows), len(rows)))
    step = max(1, int(round(LOOK_EVERY_M / 0.1)))
    places = np.nonzero((rows % step == 0) & (columns % step == 0))[0]
    start_column = int((world.start.x_m - truth.x0_m) / 0.1)
    start_row = int((world.start.y_m - truth.y0_m) / 0.1)
    home = int(np.argmin((rows - start_row) ** 2 + (columns - start_column) ** 2))
    places = np.concatenate([[home], places])
    sees = [_visible(truth, int(rows[p]), int(columns[p])) for p in places]
    total = int(truth.seeable.sum())
    seen, chosen = sees[0].copy(), [0]
    while seen.sum() < 0.99 * total:
        gains = [int((s & ~seen).sum()) for s in sees]
        best = int(np.argmax(gains))
        if gains[best] == 0:
            break
        chosen.append(best)
        seen |= sees[best]
    nodes = places[chosen]
    distance = dijkstra(graph, directed=False, indices=nodes)[:, nodes]
    order = [0]
    left = set(range(1, len(nodes)))
    while left:
        best = min(((distance[order[i], s] + (distance[s, order[i + 1]] - distance[order[i], order[i + 1]] if i + 1 < len(order) else 0.0), i, s)
                    for s in left for i in range(len(order))))
        order.insert(best[1] + 1, best[2])
        left.remove(best[2])
    better = True
    while better:
        better = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                gain = distance[order[i - 1], order[i]] - distance[order[i - 1], order[j]]
                if j + 1 < len(order):
                    gain += distance[order[j], order[j + 1]] - distance[order[i], order[j + 1]]
                if gain > 1e-6:
                    order[i:j + 1] = order[i:j + 1][::-1]
                    better = True
    return float(sum(distance[a, b] for a, b in zip(order, order[1:]))) / CRUISE_M_S


def _visible(truth, row0: int, column0: int) -> np.ndarray:
    """(rows, columns) bool: cells of S in line of sight of a cell within 10 m, by 1440 rays of 0.05 m."""
    angles = np.linspace(0.0, 2.0 * math.pi, 1440, endpoint=False)
    r = np.arange(0.0, 100.0, 0.5)
    y = (row0 + 0.5 + np.outer(np.sin(angles), r)).astype(int).clip(0, truth.occupied.shape[0] - 1)
    x = (column0 + 0.5 + np.outer(np.cos(angles), r)).astype(int).clip(0, truth.occupied.shape[1] - 1)
    hit = truth.occupied[y, x]
    before = np.cumsum(hit, axis=1) - hit == 0      # up to the first hit and with it
    out = np.zeros_like(truth.seeable)
    out[y[before], x[before]] = True
    return out & truth.seeable


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


def rows_of(results: list[dict], clairvoyant: dict[str, float]) -> list[dict]:
    """The table: the default against the nearest frontier, worlds weighing the same."""
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
    for label, value, must, aim in (("time to 99 %", time_to_99, "<= 0.85", "<= 0.75"), ("path to 99 %", path_to_99, "<= 0.90", "<= 0.80"),
                                    ("time until nothing is left", lambda r: r["exploring_s"], None, None)):
        by_world = ratios(results, value)
        if not by_world:
            continue
        low, high = bootstrap(list(by_world.values()))
        rows.append(row(f"{label}, against nearest frontier, mean over worlds", float(np.mean(list(by_world.values()))), f"interval {low:.2f} to {high:.2f}", "1.0", must, aim))
        held = [v for k, v in by_world.items() if k not in TUNED_ON]
        if held:
            rows.append(row(f"{label}, the same, worlds not tuned on", float(np.mean(held)), f"{len(held)} worlds", "1.0"))
        if label == "time to 99 %":
            rows += [row(f"  {name}", ratio, "of nearest frontier's") for name, ratio in by_world.items()]
    base = {n: float(np.mean([time_to_99(r) for r in results if r["world"] == n and r["policy"] == "frontier"])) for n in clairvoyant}
    if clairvoyant:
        rows.append(row("a tour that knows the building, at 0.7 m/s, against nearest frontier", float(np.mean([clairvoyant[n] / base[n] for n in clairvoyant])),
                        f"{len(clairvoyant)} worlds", "0.4 to 0.7"))
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
    clairvoyant = {n: clairvoyant_s(sources[n]) for n in names}
    picture = FOLDER / "exploration" / "paths.png"
    draw_paths(results, picture, seeds[0])
    print(f"paths: {picture}", flush=True)
    return rows_of(results, clairvoyant) + plan_rows(results) + paper_rows(paper)
