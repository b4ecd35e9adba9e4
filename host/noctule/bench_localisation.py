"""`noctule bench localisation`: the firmware's localisation on scripted flights and on logs of real buildings.

Scripted flights (planar_profile.py) and logs (carmen.py) drive the very Localiser that flies. Errors are those of the pose at
each sweep, the first pose on truth, nothing fitted. Shared data is looked for beside the repository; where it is absent
the row is left out and 'skipped: no data' is printed. Times are processor time of the thread.

The whole is made of parts (one log, one scene), as many at a time as there are cores, each kept under runs/bench/localisation: a
bench that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from noctule import carmen, planar_profile, planar_scenes
from noctule.bench import FOLDER, data_folder, kept, row
from noctule.localise import compose, memory_bytes
from noctule.planar_profile import Errors, Motion
from noctule.planar_scenes import Plan

SEEDS, QUICK_SEEDS = 20, 5
NEES_SEEDS, QUICK_NEES_SEEDS = 50, 10
PAPER_STEPS = 676
PAPER_S = PAPER_STEPS * 0.05
SPIN_RAD_S = 1.0
LONG = ("loop_500m", "freiburg-079", "paper")   # parts that take longest
FAR_M = 0.10                 # off by more than this, a pose should not be called good
CM = 100.0

# (log, relations, name of the reference, must and aim for mean translation [m], must for mean rotation [deg])
REAL_LOGS = (("intel-2725", "intel.relations", "iris_lama 0.052 / 1.2, Cartographer 0.023 / 0.45", "<= 0.055", "<= 0.045", "<= 1.5"),
             ("intel", "intel.relations", "corrected poses 0.067 / 2.3", "<= 0.08", "<= 0.055", "<= 2.5"),
             ("freiburg-079", "fr079.relations", "hector 0.039 / 0.85, Cartographer 0.045 / 0.54", "<= 0.042", "<= 0.036", "<= 1.0"))


def paper_preset() -> dict[str, float]:
    """The `paper` preset's parameters."""
    from noctule.params_gen import PRESETS

    return {k: v for k, v in PRESETS["paper"].items() if v != PRESETS["default"][k]}


def fly(plan: Plan, motion: Motion, seeds: range, sensors: planar_profile.Profile, *settings: dict[str, float]) -> list[list[Errors]]:
    """Flies the seeds; for each of the settings (none: the defaults) one list of flights, over the same samples."""
    out: list[list[Errors]] = [[] for _ in settings or ({},)]
    for seed in seeds:
        flown = planar_profile.samples(plan, motion, seed, sensors)
        for flights, parameters in zip(out, settings or ({},)):
            flights.append(planar_profile.localise(flown, parameters))
    return out


def seeds_to(count: int, first: int = 1) -> range:
    """Seeds first to count."""
    return range(first, count + 1)


def position_rows(label: str, flights: list[Errors], reference=None, must=None, worst=None, aim=None) -> list[dict]:
    """Position and yaw over the seeds, and how often the pose was lost."""
    means = np.array([CM * e.position_m.mean() for e in flights])
    return [row(f"{label}: position error, mean", float(means.mean()), "cm", reference, must, aim),
            row(f"{label}: the same, worst seed", float(means.max()), "cm", None, worst),
            row(f"{label}: yaw error, mean", float(np.degrees(np.mean([e.yaw_rad.mean() for e in flights]))), "deg"),
            row(f"{label}: steps that said lost", sum(e.lost for e in flights), "-")]


def synth_rows(folder: Path) -> list[dict]:
    """The shared simulated log with drifting odometry; the first pose on truth."""
    log = carmen.read(folder / "synth10r.clf.gz")
    truth = np.loadtxt(folder / "synth10r.gt")
    track = carmen.track(log)
    poses = np.array([compose(truth[0, 1:], p) for p in track.poses])
    error_m = np.hypot(*(poses[:, :2] - truth[:, 1:3]).T)
    yaw = np.degrees(np.abs(np.remainder(poses[:, 2] - truth[:, 3] + math.pi, 2.0 * math.pi) - math.pi))
    us = track.localise_us
    return [row("synth10r: position error, mean", float(CM * error_m.mean()), "cm", "karto 0.9, hector 1.8", "<= 1.0", "<= 0.4"),
            row("synth10r: position error, greatest", float(CM * error_m.max()), "cm"),
            row("synth10r: yaw error, mean", float(yaw.mean()), "deg", "0.12", "<= 0.12", "<= 0.04"),
            row("synth10r: one step, median", float(np.median(us)) * 1e-3, "ms", "hector 0.23", "<= 1.0", "<= 0.25"),
            row("synth10r: one step, 99 %", float(np.percentile(us, 99)) * 1e-3, "ms", "hector 0.57", "<= 3.0", "<= 0.8"),
            row("synth10r: entering the map, median", float(np.median(track.map_us)) * 1e-3, "ms")]


def real_rows(folder: Path, name: str, relations: str, reference: str, must: str, aim: str, must_deg: str) -> list[dict]:
    """The log of a real building against its relations, with the flight's defaults. The trajectory judged is that of each moment.

    Judged on every second relation, told as the others tell (carmen.calibrate): relations have a clock and a point of the robot of
    their own. Beside it all of them as they stand, and without the scan match.
    """
    rows = []
    log, truth = carmen.read(folder / f"{name}.clf.gz"), carmen.read_relations(folder / relations)
    for label, parameters in ((name, {}), (f"{name}, without the scan match", {"scan_match": 0})):
        track = carmen.track(log, parameters)
        us = track.localise_us
        if label == name:
            convention = carmen.calibrate(log, track.t_s, track.poses, truth[::2])
        errors = carmen.relation_errors(log, track.t_s, track.poses, truth[1::2], convention)
        limits = (must, aim, must_deg) if label == name else (None, None, None)
        rows += [*error_rows(f"{label}: relations", errors, reference, *limits),
                 *error_rows(f"{label}: relations as they stand", carmen.relation_errors(log, track.t_s, track.poses, truth), reference),
                 row(f"{label}: steps that said lost", sum(s.quality < 0 for s in track.steps), f"of {len(track.steps)}"),
                 row(f"{label}: one step, median", float(np.median(us)) * 1e-3, "ms"),
                 row(f"{label}: one step, 99 %", float(np.percentile(us, 99)) * 1e-3, "ms")]
        if label == name:
            rows += [row(f"{name}: the relations' clock: log less relations", convention.clock_s, "s"),
                     row(f"{name}: the relations tell poses of sweeps", int(convention.same_sweep_s > 0.0), "1: yes"),
                     row(f"{name}: the relations' point before that of the log", convention.x_m, "m"),
                     row(f"{name}: the relations' point left of that of the log", convention.y_m, "m")]
    return rows


def error_rows(label: str, errors: carmen.RelationErrors, reference, must=None, aim=None, must_deg=None) -> list[dict]:
    """Mean and median of translation and rotation."""
    t, r = errors.translation_m, np.degrees(errors.rotation_rad)
    return [row(f"{label}, translation, mean", float(t.mean()), "m", reference, must, aim),
            row(f"{label}, translation, median", float(np.median(t)), "m"),
            row(f"{label}, rotation, mean", float(r.mean()), "deg", None, must_deg),
            row(f"{label}, rotation, median", float(np.median(r)), "deg")]


def paper_rows(seeds: int, nees_seeds: int) -> list[dict]:
    """The paper's set-up: 676 sweeps at 20 Hz of 1080 beams in 15 x 15 m, inertial prediction."""
    plan = planar_scenes.rooms()
    motion = Motion(plan, PAPER_S)
    usual, preset = fly(plan, motion, seeds_to(seeds), planar_profile.profile(), {}, paper_preset())
    rows = position_rows("paper's set-up, 1 cm, 250 Hz", usual, "paper 8", "<= 1.0", "<= 2.0", "<= 0.4")
    rows += position_rows("paper's set-up, paper preset", preset, "paper 8", "<= 8", None, "<= 3")
    us = np.concatenate([e.localise_us for e in usual])
    rows += [row("one step, 1080 beams, 100 particles: median", float(np.median(us)) * 1e-3, "ms", "hector 0.23, gmapping 1167", "<= 1.0", "<= 0.25"),
             row("one step, 1080 beams, 100 particles: 99 %", float(np.percentile(us, 99)) * 1e-3, "ms", "hector 0.57", "<= 3.0", "<= 0.8")]
    (more,) = fly(plan, motion, seeds_to(nees_seeds, seeds + 1), planar_profile.profile())
    return rows + nees_rows([*usual, *more])


def slow_rows(seeds: int) -> list[dict]:
    """The paper's set-up with inertial data at 50 Hz."""
    plan = planar_scenes.rooms()
    (flights,) = fly(plan, Motion(plan, PAPER_S), seeds_to(seeds), planar_profile.profile(0.01, 50))
    return position_rows("paper's set-up, 1 cm, 50 Hz", flights, "paper 8", "<= 1.0", "<= 2.0", "<= 0.4")


def noise_rows(seeds: int, hz: int) -> list[dict]:
    """The paper's set-up at 3 cm noise, not told and told."""
    plan = planar_scenes.rooms()
    untold, told = fly(plan, Motion(plan, PAPER_S), seeds_to(seeds), planar_profile.profile(0.03, hz), {}, {"laser_range_noise_m": 0.03})
    return [*position_rows(f"paper's set-up, 3 cm, {hz} Hz", untold, None, "<= 2.5", None, "<= 1.0"),
            *position_rows(f"the same with LASER_NOISE = 0.03, {hz} Hz", told, None, "<= 2.5", None, "<= 1.0")]


def skew_rows(seeds: int) -> list[dict]:
    """Turning at 1 rad/s along the way, with the sweep de-skewed and as it came."""
    plan = planar_scenes.rooms()
    both = fly(plan, Motion(plan, PAPER_S, SPIN_RAD_S), seeds_to(seeds), planar_profile.profile(), {"deskew": 1}, {"deskew": 0})
    return [r for label, flights in zip(("de-skewed", "not de-skewed"), both) for r in position_rows(f"turning at 1 rad/s, {label}", flights)]


def nees_rows(flights: list[Errors]) -> list[dict]:
    """Normalised error squared of the pose at the end of each flight: mean over the seeds in its 95 % band."""
    from scipy.stats import chi2

    seeds = len(flights)
    mean = float(np.mean([e.nees[-1] for e in flights]))
    low, high = (float(chi2.ppf(q, 3 * seeds) / seeds) for q in (0.025, 0.975))
    return [row(f"normalised error squared, {seeds} seeds", mean, "-", f"band to {high:.2f}", f"<= {high:.4f}"),
            row("normalised error squared, not too small", mean, "-", f"band from {low:.2f}", f">= {low:.4f}")]


# Where walls alone do not help, and where drift shows: plan, duration of the flight [s], limits of the closure [cm].
HARDER = ((planar_scenes.round_hall, PAPER_S, None, None), (planar_scenes.cluttered_hall, 70.0, None, None),
          (planar_scenes.corridor_40m, 122.0, None, None), (planar_scenes.courtyard, 190.0, None, None),
          (planar_scenes.loop_100m, 130.0, None, None), (planar_scenes.loop_500m, 570.0, "<= 15", "<= 5"))


def untold(e: Errors) -> np.ndarray:
    """(K,) bool: off by more than FAR_M while the quality is good and the published covariance does not cover it (99.9 %)."""
    from scipy.stats import chi2

    return (e.position_m > FAR_M) & ~e.lost_at & (e.nees > chi2.ppf(0.999, 3))


def harder_rows(seeds: int, make: Callable[[], Plan], seconds: float, closure: str | None, closure_aim: str | None) -> list[dict]:
    """A scene where walls alone do not help, or where drift shows. Lost is no fault there; being off and not saying so is."""
    plan = make()
    (flights,) = fly(plan, Motion(plan, seconds), seeds_to(seeds), planar_profile.profile())
    return [*position_rows(plan.name, flights, None, None, None, "<= 5"),
            row(f"{plan.name}: position error, greatest", float(CM * max(e.position_m.max() for e in flights)), "cm"),
            row(f"{plan.name}: over 0.1 m off with good quality", float(np.mean([((e.position_m > FAR_M) & ~e.lost_at).mean() for e in flights])), "of steps"),
            row(f"{plan.name}: and not covered by the covariance either", sum(bool(untold(e).any()) for e in flights), f"of {len(flights)} flights", None, "== 0"),
            row(f"{plan.name}: pose jumps said", sum(e.resets for e in flights), "-"),
            row(f"{plan.name}: position error at the end, greatest", float(CM * max(e.position_m[-1] for e in flights)), "cm", None, closure, closure_aim)]


CARRIED_AT_S, CARRIED_BACK_S = 30.0, 20.0


def carried_rows(seeds: int) -> list[dict]:
    """Carried, unseen, to a place of 20 s ago: said at once, and found again in the stored map."""
    plan = planar_scenes.rooms()
    motion = Motion(plan, PAPER_S)
    flights = [planar_profile.localise(planar_profile.carried_back(planar_profile.samples(plan, motion, s, planar_profile.profile()), CARRIED_AT_S, CARRIED_BACK_S))
               for s in seeds_to(seeds)]
    return [row("carried to another place: not covered by the covariance and not said", sum(bool(untold(e).any()) for e in flights), f"of {seeds} flights", None, "== 0"),
            row("carried to another place: found again", sum(bool(not e.lost_at[-1] and e.position_m[-1] < FAR_M) for e in flights), f"of {seeds} flights", None, f"== {seeds}"),
            row("carried to another place: lost for, longest", max(e.lost for e in flights) * planar_profile.TICK_US * 1e-6, "s"),
            row("carried to another place: position error at the end, greatest", float(CM * max(e.position_m[-1] for e in flights)), "cm")]


def parts(quick: bool) -> dict[str, Callable[[], list[dict]]]:
    """Name -> what measures it, in the order of the table; a log that is not there is left out."""
    seeds, few = (QUICK_SEEDS, 2) if quick else (SEEDS, QUICK_SEEDS)
    data = data_folder()
    folder = data / "slam_bench" if data is not None else None
    found: dict[str, Callable[[], list[dict]]] = {"synth10r": lambda: synth_rows(folder)}
    found |= {log[0]: lambda log=log: real_rows(folder, *log) for log in REAL_LOGS}
    found = {name: f for name, f in found.items() if folder is not None and (folder / f"{name}.clf.gz").is_file()}
    found["turning"] = lambda: skew_rows(QUICK_SEEDS)
    found |= {make.__name__: lambda scene=(make, *rest): harder_rows(few, *scene) for make, *rest in HARDER}
    found["carried"] = lambda: carried_rows(few)
    found["paper"] = lambda: paper_rows(seeds, QUICK_NEES_SEEDS if quick else NEES_SEEDS)
    found["paper, 50 Hz"] = lambda: slow_rows(seeds)
    found |= {f"paper, 3 cm, {hz} Hz": lambda hz=hz: noise_rows(seeds, hz) for hz in (250, 50)}
    return found


def _fingerprint() -> str:
    """Of all that a part is made by: the firmware, what flies and judges it, and the logs."""
    import noctule_sim
    from noctule.inprocess import library_path

    digest = hashlib.sha256(library_path().read_bytes())
    here = Path(__file__).parent
    for path in [here / f"{n}.py" for n in ("bench_localisation", "planar_profile", "planar_scenes", "altitude_profile", "localise", "carmen")]:
        digest.update(path.read_bytes())
    for path in sorted(Path(noctule_sim.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    data = data_folder()
    for path in sorted((data / "slam_bench").glob("*")) if data is not None else ():
        digest.update(f"{path.name} {path.stat().st_size} ".encode())
    return digest.hexdigest()[:16]


def measured(name: str, quick: bool, fresh: bool, key: str) -> list[dict]:
    """The rows of one part, kept or measured now."""
    path = FOLDER / "localisation" / f"{name}{', quick' if quick else ''}.json"
    return kept(path, key, fresh, lambda: {"rows": parts(quick)[name]()})["rows"]


def bench_localisation(quick: bool, fresh: bool) -> list[dict]:
    """Every row that can be measured without flying; closed-loop flights are `noctule bench flight`. A part's rows are printed as it ends."""
    names, key = list(parts(quick)), _fingerprint()
    for log in ("synth10r", *(log[0] for log in REAL_LOGS)):
        if log not in names:
            print(f"{log}: skipped: no data", flush=True)
    done: dict[str, list[dict]] = {}
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        # The longest first, so that no core ends long before the others.
        jobs = {pool.submit(measured, name, quick, fresh, key): name for name in sorted(names, key=lambda n: n not in LONG)}
        try:
            for job in as_completed(jobs):
                done[jobs[job]] = job.result()
                for r in done[jobs[job]]:
                    print(f"{r['name']}: {r['value']:.4g} {r['unit']}", flush=True)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    localiser, grid = memory_bytes()
    return [*(r for name in names for r in done[name]),
            row("memory of the filter, static", localiser / 2**20, "MiB", "iris_lama 6, gmapping 141", "<= 4", "<= 2"),
            row("memory of the map, static", grid / 2**20, "MiB")]
