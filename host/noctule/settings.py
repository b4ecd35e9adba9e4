"""What a flight is asked to be: parameters, profile, faults; checked before anything starts."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

PROFILES = ("ideal", "default", "harsh")
PRESETS = ("default", "paper")
POLICIES = ("tour", "frontier", "paper")       # in the order of the parameter's values
EXTERNAL_POLICY = 3                            # the parameter's value for a policy in a process of its own
AUTOPILOTS = ("px4", "ardupilot")              # flavours of the built-in one
REAL_AUTOPILOTS = ("ardupilot", "px4")
EXIT_SKIPPED = 77                              # the real autopilot's program is not there: nothing was flown
DEFAULT_MAX_TIME_S = 1800.0


class InputError(ValueError):
    """Bad input of the user; the text is one clear line, the command ends with 2."""


class SkippedFlight(Exception):
    """Nothing was flown because a program of the user's is not there; the text is one line, the command ends with EXIT_SKIPPED."""


@dataclass
class FlightSettings:
    """One flight. world is a shipped name or a path; parameters holds what --param changed."""

    world: str
    seed: int = 0
    out: Path | None = None
    realtime: bool = False
    camera: bool = True
    max_time_s: float = DEFAULT_MAX_TIME_S
    parameters: dict[str, float] = field(default_factory=dict)
    policy_class: str | None = None     # package.module:Class: a policy in Python, in a process of its own
    preset: str = "default"
    profile: str = "default"
    faults: list[str] = field(default_factory=list)
    log_images: bool = False
    video: str | None = None            # ground station that the front camera is streamed to
    autopilot: str = "px4"              # flavour of the built-in autopilot
    real: str | None = None             # one of REAL_AUTOPILOTS: flown by that instead
    autopilot_binary: Path | None = None
    connect: str | None = None          # the real one runs already: where its MAVLink is


def policy_choice(name: str) -> tuple[int, str | None]:
    """Value of the parameter `policy` and class in Python of tour, frontier, paper or package.module:Class.

    Raises:
        InputError: neither; one line.
    """
    if name in POLICIES:
        return POLICIES.index(name), None
    if ":" not in name:
        raise InputError(f"no policy '{name}'; there are {', '.join(POLICIES)}, or package.module:Class for one in Python (docs/extending.md)")
    from noctule.policy_host import load

    load(name)
    return EXTERNAL_POLICY, name


def parameter_row(name: str):
    """The row of a tunable by its name or its MAVLink id.

    Raises:
        InputError: there is none of that name.
    """
    from difflib import get_close_matches

    from noctule import params_gen

    for row in params_gen.TABLE:
        if name in (row.name, row.param):
            return row
    near = get_close_matches(name, [r.name for r in params_gen.TABLE], 1)
    raise InputError(f"--param {name}: no such parameter" + (f"; did you mean {near[0]}?" if near else "")
                     + " (docs/parameters.md lists them)")


def parse_parameter(text: str) -> tuple[str, float]:
    """Name and value of NAME=VALUE, checked against the table.

    Raises:
        InputError: not of that form, unknown, not a number, out of range, or not whole where it must be.
    """
    name, equals, value_text = text.partition("=")
    if not equals or not name.strip():
        raise InputError(f"--param {text}: write it as NAME=VALUE")
    row = parameter_row(name.strip())
    try:
        value = float(value_text)
    except ValueError:
        raise InputError(f"--param {row.name}: '{value_text}' is not a number") from None
    if not row.min <= value <= row.max:
        raise InputError(f"--param {row.name}: {value:g} is outside {row.min:g} to {row.max:g}"
                         + ("" if row.unit == "-" else f" {row.unit}"))
    if row.type == "int":
        if value != int(value):
            raise InputError(f"--param {row.name}: {value:g} is not a whole number")
        value = int(value)
    return row.name, value


def parse_fault(text: str) -> str:
    """A fault NAME@T, T in simulated seconds; given back as it is.

    Raises:
        InputError: not of that form.
    """
    if not re.fullmatch(r"[a-z][a-z0-9-]*@\d+(\.\d+)?", text):
        raise InputError(f"--fault {text}: write it as NAME@SECONDS, for instance odometry-cut@40")
    from noctule_sim.simulation import FAULTS

    if text.partition("@")[0] not in FAULTS:
        raise InputError(f"--fault {text}: no such fault; there are {', '.join(sorted(FAULTS))}")
    return text


def parameter_values(settings: FlightSettings) -> dict[str, float]:
    """Every tunable's value: defaults, then the preset, then --param."""
    from noctule import params_gen

    values = dict(params_gen.DEFAULTS)
    values.update(params_gen.PRESETS.get(settings.preset, {}) if settings.preset != "default" else {})
    values.update(settings.parameters)
    return values


def parameters_toml(values: dict[str, float]) -> str:
    """The parameter file of a run: `name = value` a line, floats with a point so that their type is kept."""
    lines = [f"{name} = {value if isinstance(value, int) else repr(float(value))}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def run_folder(settings: FlightSettings, world_name: str) -> Path:
    """The folder of the run, made: --out, or runs/<world>-<seed>[-n], the first that is free.

    Raises:
        InputError: --out holds a run already or cannot be made.
    """
    if settings.out is not None:
        folder = settings.out
        if (folder / "run.json").exists():
            raise InputError(f"--out {folder}: holds a run already")
        try:
            (folder / "log").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--out {folder}: cannot be made ({error.strerror})") from None
        return folder
    base = Path("runs")
    for n in range(1, 100000):
        folder = base / (f"{world_name}-{settings.seed}" + ("" if n == 1 else f"-{n}"))
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
        (folder / "log").mkdir()
        return folder
    raise InputError(f"{base}: too many runs of {world_name}")
