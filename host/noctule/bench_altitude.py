"""`noctule bench altitude`: the altitude filter over profiles of floors, tables and stairs, and the height kept in whole flights.

The profiles (altitude_profile.py) drive the firmware's AltitudeFilter alone; the closed loop (height_loop.py) flies
noctule_sim with the firmware's NavNode. Errors count from take-off to the end of the legs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from noctule import altitude_profile as profile
from noctule.altitude_profile import Flight, Trouble
from noctule.bench import row

SEEDS, QUICK_SEEDS = 20, 5
FLAT_SEEDS, QUICK_FLAT_SEEDS = 40, 10
FALSE_FLOOR_M = 0.10     # a floor farther than this from every true one is false
CM = 100.0


@dataclass
class Batch:
    """One flight over several seeds: a number a seed, lengths in metres."""

    mean_m: np.ndarray          # mean of |error|
    greatest_m: np.ndarray
    end_m: np.ndarray           # |error| at the end
    nees: np.ndarray            # error squared over the published variance, at the end
    nees_mean: np.ndarray       # the same, mean over the flight
    over_m: np.ndarray          # greatest |error| less 1 % of the range under the vehicle
    covered: np.ndarray         # share of the flight within two published sigmas
    lost: int                   # steps that were not valid
    false_floors: int           # flights with a floor that is none, or with one missing
    levels_m: dict[float, np.ndarray]   # |error| of each level, key: elevation
    level_nees: np.ndarray      # of the building's surfaces, all seeds
    step_ns: np.ndarray
    known: int                  # levels at the end, the most over the seeds


def fly(flight: Flight, seeds: int, sensors: str = "default", trouble: Trouble = Trouble(),
        parameters: dict[str, float] | None = None) -> Batch:
    """Flies the seeds 1 to `seeds`."""
    per_seed: list[tuple] = []
    levels: dict[float, list[float]] = {z: [] for z in (*flight.grounds, *flight.ceilings)}
    lost = false_floors = known = 0
    level_nees, step_ns = [], []
    for seed in range(1, seeds + 1):
        s = profile.samples(flight, seed, sensors, trouble)
        a = profile.estimate(s, parameters)
        off = s.range_t_us > profile.REST_S * 1e6
        error, variance = (a.z_m - s.true_z_m)[off], a.z_var_m2[off]
        drop = np.nan_to_num(s.true_z_m[off] - a.ground_m[off])
        squared = error**2 / variance
        per_seed.append((np.abs(error).mean(), np.abs(error).max(), abs(error[-1]), squared[-1], squared.mean(),
                         (np.abs(error) - 0.01 * drop).max(), (squared < 4.0).mean()))
        lost += int((~a.valid).sum())
        false_floors += int(not floors_right(flight, a))
        known = max(known, len(a.levels))
        step_ns.append(a.step_ns)
        for z in levels:
            facing = -1 if z in flight.ceilings else 1
            levels[z].append(min((abs(v.z_m - z) for v in a.levels if v.facing == facing), default=9.0))
        for surface in a.surfaces:
            z = min(flight.floors if surface.facing > 0 else flight.ceilings, key=lambda v: abs(v - surface.z_m))
            if z != 0.0:  # the start's floor defines zero
                level_nees.append((surface.z_m - z) ** 2 / surface.z_var_m2)
    columns = np.array(per_seed).T
    return Batch(*columns, lost, false_floors, {z: np.array(v) for z, v in levels.items()}, np.array(level_nees),
                 np.concatenate(step_ns), known)


def floors_right(flight: Flight, answer) -> bool:
    """Whether the floors found are the flight's: each once, none else.

    The paper's form has no floors; it is right when it claims none.
    """
    found = [s.z_m for s in answer.surfaces if s.facing > 0]
    claimed = [v.z_m for v in answer.levels if v.floor]
    false = any(min(abs(z - t) for t in flight.floors) > FALSE_FLOOR_M for z in found + claimed)
    return not false and (not found or len(found) == len(flight.floors))


def band(seeds: int, upper_only: bool = False) -> tuple[float, float]:
    """95 % band of the mean of `seeds` normalised squared errors (chi-square over its degrees of freedom)."""
    from scipy.stats import chi2

    if upper_only:
        return 0.0, float(chi2.ppf(0.95, seeds) / seeds)
    return float(chi2.ppf(0.025, seeds) / seeds), float(chi2.ppf(0.975, seeds) / seeds)


def nees_rows(label: str, values: np.ndarray, both_sides: bool = True) -> list[dict]:
    """Normalised squared error with its band; the lower limit is a row of its own where it is wanted."""
    low, high = band(len(values), not both_sides)
    rows = [row(f"{label}: normalised error squared", float(values.mean()), "-", f"paper 36, band to {high:.2f}", f"<= {high:.4f}")]
    if both_sides:
        rows.append(row(f"{label}: the same, not too small", float(values.mean()), "-", f"band from {low:.2f}", f">= {low:.4f}"))
    return rows


def _cm(values) -> float:
    return float(CM * np.mean(values))


def _worst_cm(values) -> float:
    return float(CM * np.max(values))


def paper_rows(batch: Batch) -> list[dict]:
    """The paper's flight with the default filter."""
    rows = [row("paper's flight: altitude error, mean", _cm(batch.mean_m), "cm", "paper 2.3 / 1.8", "<= 1.0", "<= 0.6"),
            row("paper's flight: the same, worst seed", _worst_cm(batch.mean_m), "cm", None, "<= 2.0"),
            row("paper's flight: greatest error of any moment", _worst_cm(batch.greatest_m), "cm")]
    for z, errors in sorted(batch.levels_m.items()):
        rows.append(row(f"level {z:g} m: error, mean of the seeds", _cm(errors), "cm", "paper 0.8 to 10", "<= 1.5", "<= 0.7"))
        rows.append(row(f"level {z:g} m: error, worst seed", _worst_cm(errors), "cm", None, "<= 1.5"))
    rows += nees_rows("surfaces of the building", batch.level_nees, both_sides=False)
    rows.append(row("paper's flight: flights with a false or missing floor", batch.false_floors, "-", None, "== 0"))
    return rows


def harder_rows(label: str, batch: Batch) -> list[dict]:
    """A harder flight, `default` sensors."""
    return [row(f"{label}: altitude error, mean", _cm(batch.mean_m), "cm", None, "<= 2.5"),
            row(f"{label}: the same, worst seed", _worst_cm(batch.mean_m), "cm"),
            row(f"{label}: flights with a false or missing floor", batch.false_floors, "-", None, "== 0"),
            row(f"{label}: steps without a valid height", batch.lost, "-", None, "== 0")]


def harsh_rows(label: str, batch: Batch, climbs: bool = False) -> list[dict]:
    """A flight with `harsh` sensors. Where it climbs from surface to surface the scale error is one of the whole height, not of one range."""
    return [row(f"harsh, {label}: altitude error, mean", _cm(batch.mean_m), "cm", None, "<= 2.5"),
            row(f"harsh, {label}: greatest error beyond 1 % of range", _worst_cm(batch.over_m), "cm", None, None if climbs else "<= 2.5"),
            *nees_rows(f"harsh, {label}", batch.nees, both_sides=False),
            row(f"harsh, {label}: within two sigmas, share of the flight", float(batch.covered.mean()), "-"),
            row(f"harsh, {label}: flights with a false or missing floor", batch.false_floors, "-", None, "== 0")]


def paper_preset() -> dict[str, float]:
    """The altitude parameters of the `paper` preset."""
    from noctule.params_gen import PRESETS

    return {k: v for k, v in PRESETS["paper"].items()
            if v != PRESETS["default"][k] and k.startswith(("alt_", "range_", "floor_", "ground_"))}


LONG_SILENCE = Trouble(silent_s=((20.0, 50.0),))
BAROMETER = {"alt_baro_sigma_m": 0.12}   # of one sample; the profile's is 0.10


def silence_rows(seeds: int) -> list[dict]:
    """30 s without a range, with the barometer off (the default) and on. The greatest error is that of the silence."""
    rows = []
    for sensors in ("default", "harsh"):
        for label, parameters in (("no barometer", None), ("barometer", BAROMETER)):
            batch = fly(profile.hover_flight(), seeds, sensors, LONG_SILENCE, parameters)
            name, on = f"30 s of silence, {sensors}, {label}", parameters is not None
            rows += [row(f"{name}: greatest error, mean of the seeds", _cm(batch.greatest_m), "cm"),
                     row(f"{name}: the same, worst seed", _worst_cm(batch.greatest_m), "cm", None, "<= 50" if on else None),
                     row(f"{name}: within two sigmas, share of the flight", float(batch.covered.mean()), "-"),
                     row(f"{name}: steps without a valid height", batch.lost, "-", None, "== 0" if on else None)]
    return rows


HARDER = {
    "5 % echoes": Trouble(outliers=0.05),
    "2 s of silence, twice": Trouble(silent_s=((12.0, 14.0), (27.0, 29.0))),
    "15 degrees of roll": Trouble(roll_rad=0.2618),
}


def bench_altitude(quick: bool, fresh: bool) -> list[dict]:
    """Every row of the altitude filter, then the height kept in closed loop."""
    from noctule import height_loop

    seeds, flat_seeds = (QUICK_SEEDS, QUICK_FLAT_SEEDS) if quick else (SEEDS, FLAT_SEEDS)
    paper = fly(profile.paper_flight(), seeds)
    rows = paper_rows(paper)
    preset = fly(profile.paper_flight(), seeds, parameters=paper_preset())
    rows.append(row("paper's flight, paper preset: altitude error, mean", _cm(preset.mean_m), "cm", "paper 2.3", "<= 2.3"))
    flat = fly(profile.flat_flight(), flat_seeds)
    rows.append(row("100 m of floor: error at the end, mean", _cm(flat.end_m), "cm", "paper's form 4", "<= 1.0"))
    rows += nees_rows("100 m of floor", flat.nees)
    rows.append(row("100 m of floor: levels known at the end, most", flat.known, "-"))
    flat_paper = fly(profile.flat_flight(), seeds, parameters=paper_preset())
    rows.append(row("100 m of floor, paper preset: error at the end, mean", _cm(flat_paper.end_m), "cm"))
    rows.append(row("100 m of floor, paper preset: normalised error squared", float(flat_paper.nees.mean()), "-"))
    tables = fly(profile.table_flight(), seeds)
    rows.append(row("20 table crossings: error at the end, mean", _cm(tables.end_m), "cm", None, "<= 1.0", "<= 0.5"))
    rows.append(row("20 table crossings: the same, worst seed", _worst_cm(tables.end_m), "cm"))
    rows += harder_rows("20 table crossings", tables)
    rows += harder_rows("stairs", fly(profile.stair_flight(), seeds))
    for label, trouble in HARDER.items():
        rows += harder_rows(label, fly(profile.paper_flight(), seeds, trouble=trouble))
    rows += silence_rows(seeds)
    for flight in (profile.paper_flight(), profile.flat_flight(), profile.stair_flight()):
        rows += harsh_rows(flight.name, fly(flight, seeds, "harsh"), climbs=flight.name == "stairs")
    steps_us = np.concatenate([paper.step_ns, tables.step_ns]) * 1e-3
    rows.append(row("one step: median", float(np.median(steps_us)), "us", None, "<= 20", "<= 5"))
    rows.append(row("one step: 99 %", float(np.percentile(steps_us, 99)), "us", None, "<= 20"))
    full = fly(profile.many_levels_flight(), 1)
    rows.append(row(f"one step with {full.known} levels known: median", float(np.median(full.step_ns[-200:])) * 1e-3, "us", None, "<= 20"))
    return rows + height_loop.rows(quick, fresh)
