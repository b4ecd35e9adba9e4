"""`noctule bench unseen`: each policy in buildings drawn at random, which nothing was tuned on.

Offices, flats, mazes and halls of random_buildings.py, explored as in `noctule bench exploration` and kept beside its results. Numbers 0 to 9 of each
kind are for judging; whoever tunes takes numbers from 1000 on.
"""

from __future__ import annotations

import json

import numpy as np

from noctule.bench import FOLDER, row
from noctule.bench_exploration import COMPARED, all_explored, bootstrap, path_to_99, policy_rows, ratios, time_to_99, undecided, wall_rows
from noctule.random_buildings import KINDS, building

NUMBERS, QUICK_NUMBERS = tuple(range(10)), (0, 1)
SEEDS, QUICK_SEEDS = (1, 2), (1,)
COMPARISONS = (("time to 99 %", time_to_99, "<= 0.85", "<= 0.75"), ("path to 99 %", path_to_99, "<= 0.90", "<= 0.80"))


def sources(numbers: tuple[int, ...]) -> dict[str, str]:
    """Name -> file of every building, written anew."""
    folder = FOLDER / "exploration" / "buildings"
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for kind in KINDS:
        for number in numbers:
            world = building(kind, number)
            path = folder / f"{world['name']}.yaml"
            path.write_text(json.dumps(world), encoding="utf-8")   # JSON is YAML
            found[world["name"]] = str(path)
    return found


def rows_of(results: list[dict]) -> list[dict]:
    """The default against the nearest frontier: all buildings, and each kind."""
    rows, never = policy_rows(results), undecided(results)
    rows += [row(f"{name}: 99 % seen by nobody, left out", 0, "-") for name in never]
    for label, value, must, aim in COMPARISONS:
        by_world = ratios([r for r in results if r["world"] not in never], value)
        low, high = bootstrap(list(by_world.values()))
        rows.append(row(f"{label}, against nearest frontier, mean over buildings", float(np.mean(list(by_world.values()))), f"interval {low:.2f} to {high:.2f}", "1.0", must, aim))
        for kind in KINDS:
            mine = [v for name, v in by_world.items() if name.startswith(kind)]
            if mine:
                rows.append(row(f"  {label}, {kind}", float(np.mean(mine)), f"{len(mine)} buildings", "1.0"))
    return rows + wall_rows(results)


def bench_unseen(quick: bool, fresh: bool) -> list[dict]:
    """All kinds x numbers x seeds x policies."""
    buildings = sources(QUICK_NUMBERS if quick else NUMBERS)
    seeds = QUICK_SEEDS if quick else SEEDS
    return rows_of(all_explored([(name, source, seed, policy) for seed in seeds for name, source in buildings.items() for policy in COMPARED], fresh))
