"""`noctule paper`: the published test set-ups with the `paper` preset, each figure drawn and set beside its published figure.

Pepe, Satler, Tripicchio, "Autonomous exploration of indoor environments with a micro-aerial vehicle". The sensors' data is
made by the profiles of the benches, by the kinematic loop and by flights in the process; what computes is the firmware.
Drawing is in paper_figures.py, the page in paper_page.py. Frames World and Map, SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from noctule.settings import POLICIES, FlightSettings

PAPER_S = 676 * 0.05                    # 676 poses at 20 Hz
START = (6.0, 6.0, 0.0)                 # of the maze
MULTI_FLOOR = {"potential_window_m": 3.0, "floor_mode_step_m": 1.5, "floor_safety_m": 1.5, "paper_unknown_share": 0.10}
MULTI_FLOOR_S = 900.0
WINDOW_M = 2.0
LEVELS_M = ((0.0, "ground"), (0.55, "table"), (2.41, "upper floor"), (4.66, "ceiling"))
PUBLISHED_LEVELS_M = {0.0: "-0.0185 / 0.008", 0.55: "0.521 / 0.489", 2.41: "2.31 / 2.33", 4.66: "4.65 / 4.67"}


@dataclass
class Row:
    """One published number beside ours. published and ours are texts with their unit; default: the same with Noctule's defaults."""

    what: str
    published: str
    ours: str
    default: str = "-"


@dataclass
class Figure:
    """One figure of the paper. pictures: file name -> PNG bytes."""

    number: str
    title: str
    setup: str
    rows: list[Row]
    remarks: str
    pictures: dict[str, bytes] = field(default_factory=dict)


def preset(**more) -> dict[str, float]:
    """What the `paper` preset changes, and what a set-up of the paper changes beside it."""
    from noctule.bench_localisation import paper_preset

    return {**paper_preset(), **more}


# ---- figures 3 and 4: pose

def odometry(flown) -> np.ndarray:
    """Dead reckoning from the inertial data alone, (K, 3) x, y, yaw in Map at the sweeps: section B with a start at rest."""
    at = np.searchsorted(flown.attitude_t_us, flown.imu_t_us, side="right") - 1
    roll, pitch = flown.roll_pitch[np.clip(at, 0, None)].T
    dt = np.diff(np.concatenate([[0], flown.imu_t_us])) * 1e-6
    yaw = np.cumsum(flown.imu[:, 5] * dt)
    fx, fy, fz = flown.imu[:, :3].T
    forward = np.cos(pitch) * fx + np.sin(roll) * np.sin(pitch) * fy + np.cos(roll) * np.sin(pitch) * fz
    left = np.cos(roll) * fy - np.sin(roll) * fz
    ax, ay = np.cos(yaw) * forward - np.sin(yaw) * left, np.sin(yaw) * forward + np.cos(yaw) * left
    vx, vy = np.cumsum(ax * dt), np.cumsum(ay * dt)
    track = np.column_stack([np.cumsum(vx * dt), np.cumsum(vy * dt), yaw])
    track = track[np.clip(np.searchsorted(flown.imu_t_us, flown.scan_t_us, side="right") - 1, 0, None)]
    return track - track[0]


def wrapped(angle):
    """In [-pi, pi)."""
    return np.remainder(np.asarray(angle) + math.pi, 2.0 * math.pi) - math.pi


def poses(seeds: int) -> list[Figure]:
    """The planar localisation: 676 poses at 20 Hz in a building of walls, 100 particles, 12 landmarks, p0 0.1."""
    from noctule import paper_figures, planar_profile, planar_scenes

    plan = planar_scenes.rooms()
    motion = planar_profile.Motion(plan, PAPER_S)
    errors = {"paper": [], "default": []}
    first = None
    for seed in range(1, seeds + 1):
        flown = planar_profile.samples(plan, motion, seed, planar_profile.profile())
        for name, parameters in (("paper", preset()), ("default", {})):
            told = planar_profile.localise(flown, parameters)
            off = told.poses - flown.truth
            errors[name].append((*np.abs(off[:, :2]).mean(axis=0), told.position_m.mean(), np.degrees(np.abs(wrapped(off[:, 2]))).mean()))
            if first is None:
                first = flown, told.poses, odometry(flown)
    flown, track, dead = first
    mean = {name: np.mean(values, axis=0) for name, values in errors.items()}
    drift = float(np.hypot(*(dead[-1, :2] - flown.truth[-1, :2])))
    cm = lambda name, k: f"{100 * mean[name][k]:.2f} cm"
    setup = (f"{len(flown.truth)} poses at 20 Hz along {motion.path_m:.0f} m of way through four rooms (15 x 15 m), 1080 beams, laser noise 1 cm, inertial "
             f"data at 250 Hz; {seeds} seeds, seed 1 drawn.")
    return [
        Figure("3", "Trajectory", setup,
               [Row("mean error in x", "about 8 cm", cm("paper", 0), cm("default", 0)), Row("mean error in y", "about 8 cm", cm("paper", 1), cm("default", 1)),
                Row("mean distance", "-", cm("paper", 2), cm("default", 2)),
                Row("odometry alone, at the end", "drawn, no number", f"{drift:.1f} m", "-")],
               "The building, the way and the sensor noise of the publication are not given; ours are a set of rooms of the same size. What brings the error under a "
               "centimetre is not the filter alone: sweeps are de-skewed, the velocity is estimated, and the covariance of a wall is "
               "propagated from its points (docs/maths/localisation.md).",
               {"figure-3.png": paper_figures.trajectory(plan, flown.truth, track, dead)}),
        Figure("4", "Orientation", setup,
               [Row("mean error of the yaw", "drawn, no number", f"{mean['paper'][3]:.3f} deg", f"{mean['default'][3]:.3f} deg")],
               "The yaw comes from gyro and laser; no compass is used.",
               {"figure-4.png": paper_figures.yaw(flown.scan_t_us * 1e-6, flown.truth[:, 2], track[:, 2])}),
    ]


# ---- figures 6 and 7, and the level table: altitude

def nearest_level(levels, z_m: float, facing: int) -> float:
    """Elevation of the level of that facing which lies nearest to z; NaN if there is none."""
    return min((float(v.z_m) for v in levels if v.facing == facing), key=lambda v: abs(v - z_m), default=math.nan)


def altitude(seeds: int) -> list[Figure]:
    """The multilevel filter over floor, table and upper floor under one ceiling."""
    from noctule import altitude_profile as profile
    from noctule import paper_figures

    flight = profile.paper_flight()
    means = {"paper": [], "default": []}
    found = {"paper": [], "default": []}
    first = None
    for seed in range(1, seeds + 1):
        samples = profile.samples(flight, seed)
        for name, parameters in (("paper", preset()), ("default", {})):
            told = profile.estimate(samples, parameters)
            off = samples.range_t_us > profile.REST_S * 1e6
            means[name].append(float(np.abs(told.z_m - samples.true_z_m)[off].mean()))
            found[name].append([nearest_level(told.levels, z, -1 if z in flight.ceilings else 1) for z, _ in LEVELS_M])
            if first is None:
                first = samples, told
    samples, told = first
    cm = lambda name: " / ".join(f"{100 * v:.1f}" for v in means[name][:2]) + f" cm (mean of {seeds}: {100 * np.mean(means[name]):.2f})"
    table = [Row(f"level {z:g} m ({what})", PUBLISHED_LEVELS_M[z] + " m", " / ".join(f"{v[k]:.3f}" for v in found["paper"][:2]) + " m",
                 " / ".join(f"{v[k]:.3f}" for v in found["default"][:2]) + " m") for k, (z, what) in enumerate(LEVELS_M)]
    setup = ("Ranges at 20 Hz; levels at the start: ground 0.0 m, ceiling 15.0 m; s_m 0.10 m, R 1 m, delta1 0.20 m, delta2 0.05 m. Over the floor, a table of 0.55 m, up to a floor "
             f"at 2.41 m and back, under a ceiling at 4.66 m. Tests 1 and 2 are seeds 1 and 2.")
    return [
        Figure("6", "Altitude", setup, [Row("mean error, test 1 / test 2", "2.3 / 1.8 cm", cm("paper"), cm("default"))],
               "The preset takes height and levels as independent, as published; over long flat floors its error grows past what it claims "
               "(docs/results.md). The default estimates them jointly.",
               {"figure-6.png": paper_figures.height(samples.range_t_us * 1e-6, samples.true_z_m, told.z_m, LEVELS_M)}),
        Figure("7", "Levels", setup, table, "The publication's worst level is 10 cm off (2.31 m of 2.41 m). A level here is the stored one nearest to the true elevation.",
               {"figure-7.png": paper_figures.levels(flight, samples, told)}),
    ]


# ---- figure 9: one floor by the windowed potential

def maze(quick: bool) -> Figure:
    """The two mazes, 15 x 15 m at 0.10 m, window 2 m, start (6, 6, 0)."""
    from noctule import kinematic, paper_figures
    from noctule_sim.world import Start, load_world

    max_time_s = 300.0 if quick else 900.0
    flown, rows = {}, []
    for name in ("maze_a", "maze_b"):
        world = replace(load_world(name), start=Start(START[0], START[1], 0.0, START[2]))
        runs = {"paper": kinematic.explore(world, 1, preset(potential_window_m=WINDOW_M), max_time_s),
                "default": kinematic.explore(world, 1, {"policy": POLICIES.index("tour"), "floors_max": 1}, max_time_s)}
        flown[name] = world, runs
        paper, usual = runs["paper"], runs["default"]
        rows += [Row(f"{name}: cells never in the window, at the end", "under 5 %", f"{100 * paper.unknown_share:.0f} % of the known free ones", "-"),
                 Row(f"{name}: explored, as the report counts it", "-", f"{100 * paper.explored_fraction:.0f} %", f"{100 * usual.explored_fraction:.0f} %"),
                 Row(f"{name}: way, time until it turned home", "drawn, no number", f"{paper.exploring_path_m:.0f} m, {paper.exploring_s:.0f} s",
                     f"{usual.exploring_path_m:.0f} m, {usual.exploring_s:.0f} s"),
                 Row(f"{name}: nearest to a wall (hull)", "-", f"{100 * paper.least_clearance_m:.0f} cm", f"{100 * usual.least_clearance_m:.0f} cm")]
    return Figure("9", "Exploration of one floor", "Kinematic loop (pose given with 5 mm noise), seed 1, cells 0.10 m, window 2 m, start (6, 6, 0), relative error 1e-4; it ends when under 5 % of "
                  "the known free cells were never in the window, or when the gradient leads to nothing new for 60 s.",
                  rows,
                  "The published mazes are drawn only; these two are of the same size. An earlier build ended with 30 % (maze_a) and 8 % (maze_b) never in the window. Found by going back to it: in maze_b the relaxation was "
                  "cut off after ten sweeps of the window a step (the planner's budget); relaxed to the relative error, which takes 6 sweeps mostly, 244 in one step of a hundred and 362 at the most, that very build ends with 4.4 %. In maze_a the vehicle went to and fro "
                  "in the door at (10, 1.5), and that took two mendings: the cell that the vehicle leaves takes the mean of its neighbours, not a fixed value (a dip that draws it back: 48 % with the fixed value on today's way through doors), and the way through "
                  "gaps itself (30 % and more without today's planner and guard). The publication names the method's fault, it oscillates among near obstacles: this is where it does. "
                  "The share that the report calls explored counts all that the laser could have seen; the method ends by the cells that it knows of, and leaves what lies behind a corner that it never came to. "
                  "A rule that the publication does not have: cells where the hull does not fit count as obstacles; without it the path touches.",
                  {"figure-9.png": paper_figures.mazes(flown)})


# ---- figures 8, 10, 11, 12: two floors

@dataclass
class Overhead:
    """What the upward range saw over the first floor: places (N, 2) in World, elevation over the floor (N,), cluster centres, who is far (N,) bool."""

    places: np.ndarray
    elevation_m: np.ndarray
    near_m: float
    far_m: float
    far: np.ndarray


def two_means(values: np.ndarray) -> tuple[float, float, np.ndarray]:
    """k-means with k = 2 in one dimension, from the two ends: both centres and who belongs to the upper one.

    >>> two_means(np.array([2.0, 2.2, 4.0, 4.2]))[:2]
    (2.1, 4.1)
    """
    low, high = float(values.min()), float(values.max())
    for _ in range(100):
        far = np.abs(values - high) < np.abs(values - low)
        if not far.any() or far.all():
            break
        low, high, before = float(values[~far].mean()), float(values[far].mean()), (low, high)
        if (low, high) == before:
            break
    return low, high, far


def overhead(run, cell_m: float = 0.10) -> Overhead | None:
    """The upward readings of the first floor, one a cell (the median): elevation is the estimate's height and the range."""
    from noctule import record

    nav, kind = run.flight.nav, record.message_type("range_t")
    on_floor = (nav["floor"] == 0) & np.isin(nav["state"], (2, 3, 9))
    t_us, at = [], []
    for channel, _, data in record.events(run.folder / "flight.lcm"):
        if channel == "RANGE_UP":
            m = kind.decode(data)
            t_us.append(m.t_us)
            at.append(m.range_m)
    row = np.searchsorted(nav["t_us"], t_us)
    row = np.minimum(row, len(nav["t_us"]) - 1)
    range_m = np.array(at)
    good = on_floor[row] & np.isfinite(range_m) & (nav["t_us"][row] == np.array(t_us)) & (nav["z_m"][row] < 1.6)
    if not good.any():
        return None
    row, range_m = row[good], range_m[good]
    x, y = run.start.to_world(nav["x_m"][row], nav["y_m"][row])
    tilt = np.cos(nav["roll_rad"][row]) * np.cos(nav["pitch_rad"][row])
    z = nav["z_m"][row] + 0.05 + range_m * tilt
    cells: dict[tuple, list] = {}
    for key, value in zip(zip(np.floor(x / cell_m).astype(int), np.floor(y / cell_m).astype(int)), z):
        cells.setdefault(key, []).append(value)
    places = (np.array(list(cells)) + 0.5) * cell_m
    elevation = np.array([float(np.median(v)) for v in cells.values()])
    low, high, far = two_means(elevation)
    return Overhead(places, elevation, low, high, far)


def transitions(seen: Overhead) -> np.ndarray:
    """Distance of each far place to the nearest place with the near ceiling [m], (F,)."""
    from scipy.spatial import cKDTree

    if not seen.far.any() or seen.far.all():
        return np.zeros(0)
    return cKDTree(seen.places[~seen.far]).query(seen.places[seen.far])[0]


def two_floors(folder: Path, quick: bool) -> list[Figure]:
    """The building of 16 x 16 x 4.8 m: one flight as published, one that maps with the published grid and finds its way by the defaults."""
    from noctule import inprocess_flight, paper_figures, report
    from noctule.params_gen import TABLE
    from noctule_sim.world import load_world

    world = load_world("two_floor")
    max_time_s = 400.0 if quick else MULTI_FLOOR_S
    paper = inprocess_flight.fly(FlightSettings(world=world.name, seed=1, camera=False, max_time_s=max_time_s, preset="paper", parameters=MULTI_FLOOR), world, folder / "paper")
    grid = {row.name: preset()[row.name] for row in TABLE if row.param.startswith("GRID_") and row.name in preset()}
    mapped = inprocess_flight.fly(FlightSettings(world=world.name, seed=1, camera=False, max_time_s=max_time_s, parameters=grid), world, folder / "grid")
    usual = inprocess_flight.fly(FlightSettings(world=world.name, seed=1, camera=False, max_time_s=max_time_s), world, folder / "default")
    runs = {name: report.open_run(folder / name) for name in ("paper", "grid", "default")}
    seen = {name: overhead(runs[name]) for name in ("paper", "default")}
    floors = lambda r: f"{sum(f['explored_fraction'] > 0.5 for f in r['floors'])} of 2"
    explored = lambda r: " and ".join(f"{100 * f['explored_fraction']:.0f} %" for f in r["floors"])
    share = lambda r, key: " and ".join("-" if f.get(key) is None else f"{100 * f[key]:.0f} %" for f in r["floors"])
    modes = lambda o: "-" if o is None else f"{o.near_m:.2f} and {o.far_m:.2f} m, {o.far_m - o.near_m:.2f} m apart"

    # Figure 11 needs a flight that came under the opening.
    rule = next(((name, o) for name, o in seen.items() if o is not None and o.far_m - o.near_m > MULTI_FLOOR["floor_mode_step_m"]), ("default", seen["default"]))

    def candidates(o, safety_m):
        if o is None:
            return "-"
        r = transitions(o)
        return f"{np.count_nonzero(r > safety_m)} of {len(r)} places, greatest distance {r.max():.2f} m" if len(r) else "none"

    setup = "two_floor: 16 x 16 x 4.8 m, floors at 0 and 2.5 m, five pillars below and three above, a staircase in an opening of 3.8 x 3.8 m; whole flight in the process with physics, estimators and seed 1."
    values = "window 3 m, at most 10 % of the known free cells never in it, least step of the ceilings 1.5 m, safety distance 1.5 m, 1 m over the floor."
    return [
        Figure("8", "Grid maps of both floors", f"{setup} Cells 0.10 m, prior 0.5, obstacle thickness 0.5 m, without the defaults' rule for beams that return nothing; the way is found by the defaults.",
               [Row("floors mapped", "2 of 2", floors(mapped), floors(usual)), Row("explored, lower and upper", "\"fairly enough represents\"", explored(mapped), explored(usual)),
                Row("true walls that are marked", "-", share(mapped, "walls_found_fraction"), share(usual, "walls_found_fraction")),
                Row("marked cells that are true", "-", share(mapped, "walls_true_fraction"), share(usual, "walls_true_fraction"))],
               "0.5 m of obstacle thickness draws every wall four cells deeper than it is seen, from both sides; doors of 0.90 m close. The default is one cell.",
               {"figure-8.png": paper_figures.grids(runs["grid"], runs["default"])}),
        Figure("10", "Levels over the first floor and their modes", f"{setup} {values}",
               [Row("modes of the upward range", "2, drawn", modes(seen["paper"]), modes(seen["default"])),
                Row("true elevations", "-", "2.30 and 4.80 m", "2.30 and 4.80 m")],
               "One vote a cell (0.10 m), not a reading: hovering must not weigh. Stairs and their opening's edge lie between the modes.",
               {"figure-10.png": paper_figures.modes(seen["paper"], seen["default"])}),
        Figure("11", "Transition points", f"{setup} {values}",
               [Row("far places whose nearest near place is farther than 1.5 m", "drawn, R1 and R2", candidates(seen["paper"], 1.5), candidates(seen["default"], 1.5)),
                Row("the same, farther than 0.60 m (2 x our radius)", "-", candidates(seen["paper"], 0.6), candidates(seen["default"], 0.6))],
               "A range finder sees one spot at a time: a line of flight across an opening says nothing of its width beside the line. The default therefore looks round inside an opening before it goes through (docs/maths/floors.md).",
               {"figure-11.png": paper_figures.transition_points(world, *rule)}),
        Figure("12", "Flight over two floors", f"{setup} {values}",
               [Row("floors explored", "2 of 2, at most 10 % unknown each", floors(paper), floors(usual)), Row("explored, lower and upper", "-", explored(paper), explored(usual)),
                Row("time", "660 s (11 minutes)", f"{paper['sim_time_s']:.0f} s: {paper['outcome'].replace('_', ' ')}", f"{usual['sim_time_s']:.0f} s: {usual['outcome'].replace('_', ' ')}"),
                Row("way", "drawn, no number", f"{paper['path_length_m']:.0f} m", f"{usual['path_length_m']:.0f} m"),
                Row("one plan to the transition point", "about 1 minute", f"{paper['step_ms']['max']:.0f} ms, the longest whole step", f"{usual['step_ms']['max']:.0f} ms, the longest whole step"),
                Row("collisions, nearest to a wall", "-", f"{paper['collisions']}, {100 * (paper['min_clearance_m'] or 0):.0f} cm", f"{usual['collisions']}, {100 * (usual['min_clearance_m'] or 0):.0f} cm")],
               "The way to the opening, the climb and the way home are Noctule's own in both columns (the publication flies to the transition with the potential of the whole grid); only the exploration of a floor is the published one in the column `paper`.",
               {"figure-12.png": paper_figures.flight_3d(world, runs["paper"], runs["default"])}),
    ]


# ---- figure 13: objects

def objects(folder: Path, quick: bool) -> Figure:
    """The gallery seen with the published segmentation: a threshold on each colour channel."""
    from noctule import inprocess_flight, paper_figures
    from noctule_sim.world import load_world

    world = load_world("gallery")
    max_time_s = 60.0 if quick else 150.0
    told = {}
    for name, parameters in (("paper", {"seg_contrast": 0, "seg_intensity": 200}), ("default", {})):
        if name == "default" and quick:
            continue
        settings = FlightSettings(world=world.name, seed=1, camera=True, log_images=True, max_time_s=max_time_s, parameters=parameters)
        told[name] = inprocess_flight.fly(settings, world, folder / f"objects-{name}")
    count = lambda r, key: "-" if r is None or r[key] is None else str(r[key])
    paper, usual = told["paper"], told.get("default")
    total = len(world.objects)
    found = lambda r: "-" if r is None or r["objects_missed"] is None else f"{total - r['objects_missed']} of {total}"
    return Figure("13", "Segmentation and detection", f"gallery, {max_time_s:.0f} s of a flight with the default policy, camera 320 x 240 at 5 Hz; I0 = 200, regions described with SURF.",
                  [Row("objects found", "shown on one picture", found(paper), found(usual)), Row("found twice", "-", count(paper, "objects_duplicated"), count(usual, "objects_duplicated")),
                   Row("false", "-", count(paper, "objects_false"), count(usual, "objects_false"))],
                  "One threshold for all channels takes whatever is bright for an object: lit walls as well. The default separates by colour ratio and texture, whatever the light (docs/maths/vision.md). "
                  "The publication's fault, texture-less objects are not recognised, holds for SURF alone in both.",
                  {"figure-13.png": paper_figures.segmentation(folder / "objects-paper", 200)})
