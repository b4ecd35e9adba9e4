"""The `noctule` command."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

from noctule.settings import (AUTOPILOTS, DEFAULT_MAX_TIME_S, EXIT_SKIPPED, PRESETS, PROFILES, REAL_AUTOPILOTS,
                              FlightSettings, InputError, SkippedFlight, parse_fault, parse_parameter, policy_choice)

ABOUT = """\
Noctule flies a micro-aerial vehicle through a building it has never seen, maps it, and comes home.

  noctule fly maze_a                  fly a shipped world in the simulator; a report is left in runs/
  noctule fly my_plan.json --seed 3   fly your own building: {"walls": [[x1,y1,x2,y2], ...], "start": [x,y]} in metres
  noctule replay runs/maze_a-1        the recorded flight again, compared bit for bit
  noctule worlds                      the shipped worlds
"""

FLY = """\
Starts the simulator, noctule-bridge, noctule-nav and noctule-vision, starts the mission as a ground station would,
and shows how it goes. A flight runs as fast as the machine allows; the same seed gives the same flight.

WORLD is a shipped name (noctule worlds), a world .yaml (docs/worlds.md), or a plan .json:
  {"walls": [[x1,y1,x2,y2], ...], "start": [x,y], "height": 2.5}     metres; height may be left out

The run directory holds report.html (look at this first), report.json, map.png, flight.lcm (everything that the
processes said), flight.tlog (for ground stations), truth.csv, the trajectories and log/*.txt.
A ground station (QGroundControl, MAVProxy) can watch on UDP port 14550.

examples:
  noctule fly maze_a --no-camera
  noctule fly office --seed 2 --param speed_max_m_s=0.7 --profile harsh
  noctule fly maze_a --fault odometry-cut@40      what happens when the autopilot loses our position
  noctule fly maze_a --policy noctule.policies.widest:Widest      a policy in Python; docs/extending.md: how to write one

  noctule fly maze_a --autopilot px4 --autopilot-binary ~/PX4-Autopilot/build/px4_sitl_default/bin/px4

exit code: 0 completed, 1 not completed or a collision, 2 bad input, 77 skipped (the real autopilot that was asked for is not
installed), 130 interrupted (the report is still written)
"""

REPLAY = """\
Runs the firmware over a recorded log, in this process.

A flight (run directory or its flight.lcm): every step gets the very samples that it consumed in flight, and all that
noctule-nav published is compared bit for bit (NAV without step_us). Parameters come from parameters.toml beside the log.
Prints 'equal' or the first difference.

A CARMEN log (.clf, .clf.gz with FLASER or ROBOTLASER1 and ODOM lines): wheel odometry and laser go through localisation
and mapping. --out gets trajectory.txt (t x y theta), trajectory.tum, map.png, map.pgm and map.yaml (ROS map_server).
--relations FILE (t1 t2 dx dy dz roll pitch yaw a line) prints mean and median errors as Kuemmerle et al. define them.

examples:
  noctule replay runs/maze_a-1
  noctule replay intel.clf.gz --relations intel.relations --out runs/intel
  noctule replay corridor.clf --param particles=50 --range-max 8

exit code: 0 equal or done, 1 a difference, 2 bad input
"""


EXPORT = """\
Writes what a run recorded in the forms that other tools read.

  tum   estimate.tum and truth.tum, frame World, from arming to touchdown; evo (PyPI) evaluates them:
        evo_ape tum truth.tum estimate.tum --project_to_plane xy      gives report.json's pose_error_m
  ros   map_<floor>.pgm and .yaml for map_server, frame Map
  png   the maps as pictures
  csv   steps.csv: a row a step, what noctule-nav said and the truth beside it
"""

OBJECTS = """\
What the camera found in a run: objects with their place, size, pictures and sightings (docs/objects.md).

examples:
  noctule objects runs/gallery-1                         a table
  noctule objects runs/gallery-1 show 3                  one object in full
  noctule objects runs/gallery-1 export --to html        a gallery with the plan, runs/gallery-1/objects.html
  noctule objects runs/gallery-1 export --to csv --out objects.csv
"""


class _Parser(argparse.ArgumentParser):
    """As argparse, but an error is one line and ends with 2."""

    def error(self, message):
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e7:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number of seconds")
    return value


def _positive_range(text: str) -> float:
    value = float(text)
    if not 0.1 < value < 1000.0:
        raise argparse.ArgumentTypeError(f"{text} is not in 0.1 to 1000 m")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value < 2**31:
        raise argparse.ArgumentTypeError(f"{text} is not in 0 to 2^31 - 1")
    return value


def _workers(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 1024:
        raise argparse.ArgumentTypeError(f"{text} is not in 1 to 1024")
    return value


class _Plain(argparse.Action):
    """Collects checked values; the message of a bad one is the checker's own, without 'argument ...:' before it."""

    def __init__(self, *args, check, **kwargs):
        super().__init__(*args, **kwargs)
        self.check = check

    def __call__(self, parser, namespace, text, option_string=None):
        try:
            value = self.check(text)
        except InputError as error:
            parser.exit(2, f"{parser.prog}: {error}\n")
        setattr(namespace, self.dest, [*getattr(namespace, self.dest), value])


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = _Parser(prog="noctule", description=ABOUT, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)

    fly = commands.add_parser("fly", help="fly a simulated flight", description=FLY,
                              formatter_class=argparse.RawDescriptionHelpFormatter)
    fly.add_argument("world", metavar="WORLD", help="shipped name, world .yaml or plan .json")
    fly.add_argument("--seed", type=_seed, default=1, metavar="N", help="of all noise (default 1)")
    fly.add_argument("--out", type=Path, metavar="DIR", help="run directory (default runs/<world>-<seed>)")
    fly.add_argument("--realtime", action="store_true", help="no faster than real time")
    fly.add_argument("--no-camera", dest="camera", action="store_false", help="no camera, no vision process")
    fly.add_argument("--max-time", type=_positive, default=DEFAULT_MAX_TIME_S, metavar="S",
                     help=f"end after so many simulated seconds (default {DEFAULT_MAX_TIME_S:g})")
    fly.add_argument("--param", action=_Plain, check=parse_parameter, default=[], metavar="NAME=VALUE",
                     help="set a tunable, by name or MAVLink id (docs/parameters.md); may be repeated")
    fly.add_argument("--preset", choices=PRESETS, default="default", help="set of tunables to begin with; paper: as published")
    fly.add_argument("--profile", choices=PROFILES, default="default", help="how good the sensors are")
    fly.add_argument("--policy", metavar="NAME", help="who decides where to look next: tour, frontier, paper, or package.module:Class, "
                                                      "one in Python (docs/extending.md; default: the preset's, tour unless --preset paper)")
    fly.add_argument("--fault", action=_Plain, check=parse_fault, default=[], metavar="NAME@T",
                     help="inject a fault at T simulated seconds (for instance odometry-cut@40); may be repeated")
    fly.add_argument("--video", metavar="HOST", help="stream the front camera to this host's UDP port 5600 (wants GStreamer's programs)")
    fly.add_argument("--log-images", action="store_true", help="record the camera's images (46 MB a minute and more)")
    fly.add_argument("--autopilot-flavour", dest="autopilot", choices=AUTOPILOTS, default="px4",
                     help="which autopilot the simulated one behaves like")
    fly.add_argument("--autopilot", dest="real", choices=("builtin", *REAL_AUTOPILOTS), default="builtin",
                     help="who flies: the simulator's own autopilot, or your real ArduCopter or PX4 in software in the loop "
                          "(docs/ardupilot.md, docs/px4.md)")
    fly.add_argument("--autopilot-binary", type=Path, metavar="PATH",
                     help="the real autopilot's program (default: NOCTULE_ARDUCOPTER or NOCTULE_PX4, then PATH)")
    fly.add_argument("--connect", metavar="URL", help="the real autopilot runs already; its MAVLink is at udpin:HOST:PORT or tcp:HOST:PORT")
    fly.add_argument("--quiet", action="store_true", help="no progress")

    commands.add_parser("worlds", help="list the shipped worlds", description="The worlds that come with the simulator.")

    bench = commands.add_parser("bench", help="measure and print a table",
                                description="Measures and prints one row a metric: value, unit, reference, must, aim. "
                                            "What has been measured is kept under runs/bench and not measured again.")
    bench.add_argument("name", metavar="NAME", help="which bench: flight, altitude, localisation, exploration, unseen, instructions, motion, floors, vision, link")
    bench.add_argument("--json", type=Path, metavar="FILE", help="write the rows to this file, too")
    bench.add_argument("--quick", action="store_true", help="fewer seeds; ends in 15 minutes")
    bench.add_argument("--fresh", action="store_true", help="measure everything again")

    replay = commands.add_parser("replay", help="run the firmware over a recorded log", description=REPLAY,
                                 formatter_class=argparse.RawDescriptionHelpFormatter)
    replay.add_argument("log", type=Path, metavar="LOG", help="run directory, flight.lcm, .clf or .clf.gz")
    replay.add_argument("--out", type=Path, metavar="DIR", help="where a CARMEN log's files go (default runs/replay-<name>)")
    replay.add_argument("--relations", type=Path, metavar="FILE", help="judge a CARMEN log's trajectory by these relations")
    replay.add_argument("--param", action=_Plain, check=parse_parameter, default=[], metavar="NAME=VALUE",
                        help="set a tunable, by name or MAVLink id; may be repeated. A flight then differs from its log")
    replay.add_argument("--preset", choices=PRESETS, default="default", help="set of tunables to begin with; paper: as published")
    replay.add_argument("--range-max", type=_positive_range, metavar="M", help="laser ranges from here on are no returns (CARMEN)")
    replay.add_argument("--no-map", dest="mapping", action="store_false", help="trajectory only (CARMEN)")

    again = commands.add_parser("report", help="make the report of a run again",
                                description="Scores a recorded run again and rewrites its report and pictures.")
    again.add_argument("run", type=Path, metavar="RUN", help="run directory")

    many = commands.add_parser("campaign", help="fly worlds x seeds x policies x parameters, and compare",
                               description="Flies every combination that FILE (TOML, docs/campaign.md) names, in-process, on all "
                                           "cores, and prints means, intervals and paired differences. Stopped, it goes on where it "
                                           "was. Exit code 0: every flight was flown to its end, 1: some broke.")
    many.add_argument("file", type=Path, metavar="FILE", help="campaign file (docs/campaign.md)")
    many.add_argument("--out", type=Path, metavar="DIR", help="folder of its runs (default runs/campaign/<name>)")
    many.add_argument("--workers", type=_workers, metavar="N", help="flights at a time (default: one a core)")
    many.add_argument("--scheduler", metavar="ADDRESS", help="fly on a cluster: address of a Dask scheduler, for instance tcp://host:8786")

    paper = commands.add_parser("paper", help="the published test set-ups, figure by figure",
                                description="Runs every test set-up of the paper with the preset `paper`, draws its figures again and sets each published "
                                            "number beside ours: DIR/paper.md and DIR/pictures/paper/. Half an hour on two cores; docs/paper.md is such a page.")
    paper.add_argument("--out", type=Path, default=Path("runs") / "paper", metavar="DIR", help="where to (default runs/paper)")
    paper.add_argument("--quick", action="store_true", help="fewer seeds and shorter flights; ends in 5 minutes")

    export = commands.add_parser("export", help="write a run in the forms that other tools read", description=EXPORT,
                                 formatter_class=argparse.RawDescriptionHelpFormatter)
    export.add_argument("run", type=Path, metavar="RUN", help="run directory")
    export.add_argument("--to", required=True, choices=("tum", "ros", "png", "csv"), help="the form")
    export.add_argument("--out", type=Path, metavar="DIR", help="where to (default RUN/export)")

    objects = commands.add_parser("objects", help="the objects that a run found", description=OBJECTS,
                                  formatter_class=argparse.RawDescriptionHelpFormatter)
    objects.add_argument("run", type=Path, metavar="RUN", help="run directory, or an object database")
    objects.add_argument("what", nargs="?", choices=("list", "show", "export"), default="list", help="default: list")
    objects.add_argument("id", nargs="?", type=int, metavar="ID", help="of the object to show")
    objects.add_argument("--to", choices=("csv", "json", "html"), default="csv", help="form of the export (default csv)")
    objects.add_argument("--out", type=Path, metavar="FILE", help="file of the export (default: printed; html: RUN/objects.html)")

    compare = commands.add_parser("compare", help="say whether two runs are equal",
                                  description="Compares two reports; what depends on the machine (wall time, step time, "
                                              "process memory, dates, paths) is left out. Exit code 0: equal, 1: not.")
    compare.add_argument("first", type=Path, metavar="RUN_A")
    compare.add_argument("second", type=Path, metavar="RUN_B")

    atlas = commands.add_parser("atlas", help="what is in an atlas", description="Prints what an atlas holds (docs/atlas.md): floors, walls, levels, "
                                                                              "passages, refused openings, objects.")
    atlas.add_argument("file", type=Path, metavar="FILE")
    atlas.add_argument("--picture", type=Path, metavar="PNG", help="draw the floor plans and the building")

    calibrate = commands.add_parser("calibrate", help="how a sensor is mounted", description="Mounting yaw, place and tilt of the laser from a recorded turn in place that "
                                    "began with the nose square to a flat wall (docs/hardware.md). Prints lines for parameters.toml.")
    calibrate.add_argument("sensor", choices=("lidar",))
    calibrate.add_argument("log", type=Path, metavar="LOG", help="recorded flight.lcm with SCAN and IMU")
    calibrate.add_argument("--yaw-near", type=float, default=0.0, metavar="DEG", help="mounting yaw within 25 degrees, for a laser that does not look ahead (default 0)")
    return top


def _fly(options) -> int:
    from noctule import flight

    parameters = dict(options.param)
    policy_class = None
    if options.policy is not None:
        parameters["policy"], policy_class = policy_choice(options.policy)
    settings = FlightSettings(world=options.world, seed=options.seed, out=options.out, realtime=options.realtime,
                              camera=options.camera, max_time_s=options.max_time, parameters=parameters,
                              preset=options.preset, policy_class=policy_class, profile=options.profile, faults=options.fault,
                              log_images=options.log_images, video=options.video, autopilot=options.autopilot,
                              real=None if options.real == "builtin" else options.real,
                              autopilot_binary=options.autopilot_binary, connect=options.connect)
    result = flight.fly(settings, options.quiet)
    print(flight.summary(result))
    print(f"report: {Path(result['run']) / 'report.html'}")
    return flight.exit_code(result)


def _worlds(_) -> int:
    from noctule_sim.world import load_world, shipped_worlds

    for name in shipped_worlds():
        world = load_world(name)
        x0, y0, x1, y1 = world.bounds_m()
        floors = ", ".join(f"{f.elevation_m:g}" for f in world.floors)
        print(f"{name:12s} {x1 - x0:5.1f} x {y1 - y0:4.1f} m   floors at {floors} m   {len(world.objects)} objects")
    return 0


def _bench(options) -> int:
    from noctule import bench

    rows = bench.run(options.name, options.quick, options.fresh)
    print(bench.table(rows))
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return 0 if all(row["ok"] is not False for row in bench.judged(rows)) else 1


def _replay(options) -> int:
    from noctule import replay

    return replay.run(options.log, options.out, dict(options.param), options.preset, options.relations, options.range_max, options.mapping)


def _report(options) -> int:
    from noctule import flight, report

    result = report.write(options.run)
    print(flight.summary(result))
    print(f"report: {options.run / 'report.html'}")
    return 0


def _campaign(options) -> int:
    from noctule import campaign

    _, reports, folder = campaign.run(options.file, options.out, options.workers, options.scheduler)
    print((folder / "summary.txt").read_text(encoding="utf-8"), end="")
    print(f"{folder}: flights.csv, summary.json, summary.txt, paths-*.png")
    return 1 if any(report["outcome"] == "broken" for report in reports.values()) else 0


def _paper(options) -> int:
    from noctule import paper_page

    print(paper_page.make(options.out, options.quick))
    return 0


def _export(options) -> int:
    from noctule import export

    for path in export.export(options.run, options.to, options.out):
        print(path)
    return 0


def _objects(options) -> int:
    from noctule import objects

    path = options.run if options.run.is_file() else options.run / "objects.db"
    if options.what == "show":
        if options.id is None:
            raise InputError("objects RUN show ID: the id of an object is wanted")
        print(objects.show(options.run, options.id))
        return 0
    if options.what == "list":
        print(objects.text(objects.read(path)))
        return 0
    text = objects.export(options.run, options.to)
    out = options.out or (options.run / "objects.html" if options.to == "html" and options.run.is_dir() else None)
    if out is None:
        print(text, end="")
    else:
        out.write_text(text, encoding="utf-8")
        print(out)
    return 0


def _compare(options) -> int:
    from noctule import compare, record

    reports = []
    for folder in (options.first, options.second):
        reports.append(record.read_json(folder / "report.json"))
        if not reports[-1]:
            raise InputError(f"{folder}: no report.json in it")
    lines = compare.differences(*reports)
    print("\n".join(lines) if lines else "equal")
    return 1 if lines else 0


def _atlas(options) -> int:
    from noctule import atlas

    try:
        building = atlas.read(options.file)
    except atlas.AtlasError as error:
        raise InputError(str(error)) from None
    print(atlas.summary(building))
    if options.picture is not None:
        options.picture.write_bytes(atlas.picture(building))
    return 0


def _calibrate(options) -> int:
    from noctule import calibrate_lidar

    print(calibrate_lidar.text(calibrate_lidar.calibrate(calibrate_lidar.read_turn(options.log), math.radians(options.yaw_near))))
    return 0


def main(arguments=None) -> int:
    """Runs the command; returns its exit code."""
    options = parser().parse_args(arguments)
    action = {"fly": _fly, "worlds": _worlds, "bench": _bench, "replay": _replay, "report": _report, "export": _export, "paper": _paper, "campaign": _campaign,
              "compare": _compare, "objects": _objects, "atlas": _atlas, "calibrate": _calibrate}[options.command]
    try:
        return action(options)
    except InputError as error:
        print(f"noctule: {error}", file=sys.stderr)
        return 2
    except SkippedFlight as error:
        print(error)
        return EXIT_SKIPPED
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 1
    except ValueError as error:
        from noctule.record import RecordError

        if not isinstance(error, RecordError):
            raise
        print(f"noctule: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
