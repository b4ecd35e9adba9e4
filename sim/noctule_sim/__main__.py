"""`python -m noctule_sim WORLD`: the simulated building, vehicle and autopilot, for any MAVLink client."""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import tempfile
from pathlib import Path

EXIT_SKIPPED = 77         # no program of the real autopilot was found: nothing was flown, nothing has failed


def _parser() -> argparse.ArgumentParser:
    from .autopilot import MODE_NAMES
    from .sensors import PROFILES
    from .simulation import FAULTS
    from .world import shipped_worlds

    parser = argparse.ArgumentParser(
        prog="noctule-sim",
        description="A building, a quadrotor with its sensors, and an autopilot that speaks MAVLink over UDP. The laser's sweeps go out on LCM. "
                    "The autopilot knows its position only from the ODOMETRY it is sent.",
        epilog=f"Shipped worlds: {', '.join(shipped_worlds())}. Without a companion that answers each sweep it runs at the pace of the clock.",
    )
    parser.add_argument("world", metavar="WORLD", help="shipped name, world .yaml or plan .json")
    parser.add_argument("--seed", type=int, default=1, help="of all noise and biases (default 1)")
    parser.add_argument("--profile", choices=sorted(PROFILES), default="default", help="sensor quality")
    parser.add_argument("--out", type=Path, help="folder for truth.csv and sim.json (default: none are written)")
    parser.add_argument("--autopilot-port", type=int, default=14540, help="UDP port on 127.0.0.1 where the companion listens (default 14540)")
    parser.add_argument("--lcm-url", default="udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2097152", help="bus of the sweeps")
    parser.add_argument("--camera-lcm-url", help="bus of the images (default: none, no camera)")
    parser.add_argument("--no-camera", action="store_true", help="render nothing")
    parser.add_argument("--realtime", action="store_true", help="at the pace of the clock, waiting for nobody")
    parser.add_argument("--max-time", type=float, default=math.inf, help="ends after this many simulated seconds")
    parser.add_argument("--fault", action="append", default=[], metavar="NAME@T", help=f"from T seconds on: {', '.join(FAULTS)}")
    parser.add_argument("--autopilot-flavour", choices=sorted(MODE_NAMES), default="px4", help="whose behaviour")
    parser.add_argument("--autopilot", choices=("builtin", "ardupilot", "px4"), default="builtin",
                        help="who flies: the simulator's own autopilot, or the user's real one in software in the loop (docs/px4.md, docs/ardupilot.md)")
    parser.add_argument("--autopilot-binary", type=Path, metavar="PATH", help="its program (default: NOCTULE_ARDUCOPTER or NOCTULE_PX4, then PATH)")
    parser.add_argument("--connect", metavar="URL", help="it runs already: its MAVLink is at udpin:HOST:PORT or tcp:HOST:PORT")
    parser.add_argument("--physics-port", type=int, metavar="PORT",
                        help="with --connect, where its physics interface comes to (default 9002 for ArduPilot, 4560 for PX4)")
    parser.add_argument("--param", action="append", default=[], metavar="NAME=VALUE", help="row of the parameter table (hull, sensor places)")
    return parser


def parse_faults(texts) -> dict[str, float]:
    """NAME@T texts as name -> seconds.

    Raises:
        ValueError: one line that says which text is wrong.

    >>> parse_faults(["odometry-cut@30"])
    {'odometry-cut': 30.0}
    """
    from .simulation import FAULTS

    out = {}
    for text in texts:
        name, _, at = text.partition("@")
        try:
            seconds = float(at)
        except ValueError:
            seconds = math.nan
        if name not in FAULTS or not seconds >= 0.0:
            raise ValueError(f"--fault {text}: NAME@T is wanted, NAME one of {', '.join(FAULTS)}, T seconds")
        out[name] = seconds
    return out


def parse_parameters(texts) -> dict[str, float]:
    """NAME=VALUE texts as name -> value.

    Raises:
        ValueError: one line that says which text is wrong.
    """
    out = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise ValueError(f"--param {text}: NAME=VALUE is wanted") from None
    return out


def external_autopilot(options):
    """The real autopilot that the options name: External, its MAVLink's place, and Program (None: the user runs it).

    Raises:
        ValueError, OSError: one line. FileNotFoundError: no program; its text is the line of a skipped flight.
    """
    from . import sitl
    from .external import REAL

    kind = options.autopilot
    if options.connect:
        place = sitl.parse_connect(options.connect)
        default = 4560 if kind == "px4" else 9002
        return REAL[kind](options.physics_port or default), place, None
    binary = sitl.find(kind, options.autopilot_binary)
    if binary is None:
        raise FileNotFoundError(sitl.skipped_line(kind))
    folder = (options.out or Path(tempfile.mkdtemp(prefix="noctule-"))) / "autopilot"
    program = sitl.Program(kind, binary, folder)
    (_, physics), (_, mavlink) = sitl.ports(kind, program.instance.number)
    return REAL[kind](physics), ("udpin", "127.0.0.1", mavlink), program


def main(arguments=None) -> int:
    """Runs one simulation. 0: it ended by itself; 1: the real autopilot was lost; 2: bad input; 77: no real autopilot found; 130: interrupted."""
    # With this set, MuJoCo loads EGL at import and cannot be imported at all where there is none; the camera asks for EGL itself.
    os.environ.pop("MUJOCO_GL", None)
    options = _parser().parse_args(arguments)
    from .camera import CameraUnavailable
    from .external_run import ExternalRunner
    from .passage import Passage
    from .run import Runner
    from .simulation import Simulation, vehicle_parameters
    from .world import WorldError, load_world

    try:
        faults, parameters = parse_faults(options.fault), parse_parameters(options.param)
        if not 0 <= options.seed < 2**63:
            raise ValueError("--seed: a whole number from 0 on is wanted")
        if not options.max_time > 0.0:
            raise ValueError("--max-time: more than 0 seconds are wanted")
        if not 0 < options.autopilot_port < 65536:
            raise ValueError("--autopilot-port: 1 to 65535 is wanted")
        world = load_world(options.world, vehicle_parameters(parameters)["hull_radius_m"])
        folder = options.out
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        make = dict(world=world, seed=options.seed, profile=options.profile, parameters=parameters, flavour=options.autopilot_flavour,
                    faults=faults, max_time_s=options.max_time)
        external = link = program = None
        if options.autopilot != "builtin":
            external, place, program = external_autopilot(options)
            make["external"] = external
            simulation_box: list = []
            link = Passage(external.state, place, options.autopilot_port, lambda name: bool(simulation_box) and simulation_box[0].fault(name))
        try:
            simulation = Simulation(camera=bool(options.camera_lcm_url) and not options.no_camera, **make)
        except CameraUnavailable as error:
            print(f"noctule-sim: {error}; going on without it", file=sys.stderr, flush=True)
            simulation = Simulation(camera=False, **make)
        if external is None:
            runner = Runner(simulation, options.autopilot_port, options.lcm_url, options.camera_lcm_url, folder, options.realtime)
        else:
            simulation_box.append(simulation)
            runner = ExternalRunner(simulation, link, options.lcm_url, options.camera_lcm_url, folder, options.realtime, program)
            if program is not None:
                program.start()
    except FileNotFoundError as error:
        print(f"noctule-sim: {error}", file=sys.stderr)
        return EXIT_SKIPPED
    except (WorldError, ValueError, OSError, RuntimeError) as error:
        print(f"noctule-sim: {' '.join(str(error).split())}", file=sys.stderr)
        return 2

    def end(_signal, _frame) -> None:
        runner.stop = True

    signal.signal(signal.SIGINT, end)
    signal.signal(signal.SIGTERM, end)
    outcome = runner.run()
    print(f"noctule-sim: {outcome.text} after {simulation.t_us * 1e-6:.1f} s", flush=True)
    return {"interrupted": 130, "autopilot_lost": 1}.get(outcome.name, 0)


if __name__ == "__main__":
    sys.exit(main())
