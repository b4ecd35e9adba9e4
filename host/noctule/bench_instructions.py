"""`noctule bench instructions`: machine instructions per Navigator::step, counted with callgrind over recorded flights.

Counts do not depend on how fast or how busy a machine is, so they hold everywhere for one binary and log. A flight is
flown once (kept like every bench flight), then noctule-profile runs it again under callgrind, which counts inside
Navigator::step only, in blocks of steps spread over the flight with a fixed seed.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from noctule.bench import flown, row
from noctule.processes import need_program
from noctule.settings import FlightSettings, InputError

WORLDS = ("maze_a", "office")
STEP = "noctule::Navigator::step"
MUST_MEDIAN, MUST_P99 = 15e6, 40e6
AIM_MEDIAN, AIM_P99 = 4e6, 10e6
HOT = 12                     # functions named in the table of what is hot
EVERY, LENGTH = 100, 15      # of each stretch of 100 steps one block of 15 is counted
_NAME = re.compile(r"\((\d+)\)(?: (.*))?")


@dataclass
class StepCount:
    """One step: all its instructions, those of each stage (called by step itself, with all below), those of each function alone."""

    total: int = 0
    stages: dict[str, int] = field(default_factory=dict)
    own: dict[str, int] = field(default_factory=dict)


def plain(name: str) -> str:
    """A demangled function without arguments, namespace and template arguments."""
    depth, text = 0, ""
    for letter in name.replace("(anonymous namespace)::", "").replace("noctule::", ""):
        if letter == "(" and depth == 0:
            break
        depth += (letter == "<") - (letter == ">")
        if depth == 0 and letter != ">":
            text += letter
    return text.split(" ")[-1] if " " in text and "operator" not in text else text


def read_dumps(lines) -> list[StepCount]:
    """The parts of a callgrind file of combined dumps, one a step. Names are compressed over the whole file.

    Format: valgrind's manual, "Callgrind Format Specification": a cost line is a position and a number; after a line
    `calls=` the next cost line is inclusive and of the call.
    """
    names: dict[str, str] = {}
    steps: list[StepCount] = []
    step, function, callee, call_next = StepCount(), "", "", False

    def name_of(text: str) -> str:
        match = _NAME.match(text)
        if match is None:
            return plain(text)
        if match[2]:
            names[match[1]] = plain(match[2])
        return names[match[1]]

    for line in lines:
        if line.startswith("part:"):
            step = StepCount()
            steps.append(step)
        elif line.startswith("fn="):
            function = name_of(line[3:].rstrip("\n"))
        elif line.startswith("cfn="):
            callee = name_of(line[4:].rstrip("\n"))
        elif line.startswith("calls="):
            call_next = True
        elif line[:1] in "+-*" or line[:1].isdigit():
            words = line.split()
            if len(words) < 2:
                continue
            cost = int(words[1])
            if call_next:
                call_next = False
                if function in ("Navigator::step", "Navigator::update_estimate") and callee != "Navigator::update_estimate":
                    step.stages[callee] = step.stages.get(callee, 0) + cost
            else:
                step.own[function] = step.own.get(function, 0) + cost
                step.total += cost
    return [s for s in steps if s.total > 0 and s.stages]


def count(log: Path, parameters: Path | None, every: int = EVERY, length: int = LENGTH) -> list[StepCount]:
    """Counts the steps of a recorded flight.

    Raises:
        InputError: no valgrind here, or the log cannot be run.
    """
    if shutil.which("valgrind") is None:
        raise InputError("valgrind is not installed; run: apt-get install valgrind, then build again")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "callgrind.out"
        command = ["valgrind", "--tool=callgrind", "--instr-atstart=no", "--collect-atstart=no", f"--toggle-collect={STEP}*",
                   "--combine-dumps=yes", f"--callgrind-out-file={out}", str(need_program("noctule-profile")), str(log),
                   "--every", str(every), "--length", str(length)]
        if parameters is not None:
            command += ["--parameters", str(parameters)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0 or not out.is_file():
            raise InputError(f"{log}: {(done.stderr.strip().splitlines() or ['callgrind failed'])[-1]}")
        with out.open(encoding="utf-8", errors="replace") as lines:
            steps = read_dumps(lines)
    if not steps:
        raise InputError(f"{log}: nothing was counted: was noctule-profile built where valgrind/callgrind.h is installed?")
    return steps


def hot(steps: list[StepCount], pick: int = HOT) -> list[tuple[str, float, float]]:
    """(function, instructions per step in itself, share), greatest first, mean over the steps."""
    sums: dict[str, int] = {}
    for step in steps:
        for name, cost in step.own.items():
            sums[name] = sums.get(name, 0) + cost
    all_of_it = sum(sums.values())
    return [(name, cost / len(steps), cost / all_of_it) for name, cost in sorted(sums.items(), key=lambda item: -item[1])[:pick]]


def rows_of(label: str, steps: list[StepCount]) -> list[dict]:
    """Median and 99 % of the whole step, then of each stage."""
    totals = np.array([s.total for s in steps]) / 1e6
    rows = [row(f"{label}: instructions per step, median", float(np.median(totals)), "million", None, f"<= {MUST_MEDIAN / 1e6:g}", f"<= {AIM_MEDIAN / 1e6:g}"),
            row(f"{label}: the same, 99 %", float(np.percentile(totals, 99)), "million", None, f"<= {MUST_P99 / 1e6:g}", f"<= {AIM_P99 / 1e6:g}"),
            row(f"{label}: steps counted", len(steps), "-")]
    stages = sorted({name for s in steps for name in s.stages}, key=lambda name: -sum(s.stages.get(name, 0) for s in steps))
    for name in stages[:7]:
        costs = np.array([s.stages.get(name, 0) for s in steps]) / 1e6
        rows.append(row(f"{label}: {name}, median / 99 %: {np.median(costs):.2f} / {np.percentile(costs, 99):.2f}; mean", float(np.mean(costs)), "million"))
    return rows


def bench_instructions(quick: bool, fresh: bool) -> list[dict]:
    """Instructions per step, whole and per stage, of a flight through each world (seed 1)."""
    rows = []
    for world in WORLDS[:1] if quick else WORLDS:
        label = f"instructions-{world}"
        flown(FlightSettings(world=world, seed=1, camera=False), label, fresh)
        folder = Path("runs") / "bench" / label
        steps = count(folder / "flight.lcm", folder / "parameters.toml", EVERY * 3 if quick else EVERY, LENGTH)
        rows += rows_of(world, steps)
        print(f"{world}: hot functions, mean instructions per step in themselves:", flush=True)
        for name, mean, share in hot(steps):
            print(f"  {mean / 1e6:7.3f} million  {share:5.1%}  {name}", flush=True)
    return rows
