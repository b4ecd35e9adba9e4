"""Writes docs/memory.md and a row of docs/memory.csv from the built programs: `make memory`.

Objects and section sizes come from the programs, capacities and what happens when one is full from core/capacity.hpp,
greatest use from a recorded flight, the stack from the linked machine code (stack_report.py).
"""

from __future__ import annotations

import argparse
import ast
import csv
import json
import operator
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from noctule import stack_report
from noctule.processes import build_folder, need_program

ROOT = Path(__file__).resolve().parents[2]
PAGE, HISTORY = ROOT / "docs" / "memory.md", ROOT / "docs" / "memory.csv"
MUST_BYTES, AIM_BYTES = 32 * 2**20, 16 * 2**20
MUST_MICRO_BYTES = 2**20
MUST_STACK, AIM_STACK = 64 * 1024, 16 * 1024
# Program -> where its pointers go (nav: the bus, the stopwatch, the policies; bridge: its lines and buses), and the roots of its flight's loop.
POINTERS = {"noctule-nav": {r"7NavNode": r"12_GLOBAL__N_1.*(7publish|12monotonic_ns)",
                            r"^_ZN7noctule(8Explorer|7Mission)": r"^_ZN7noctule\d+\w*Policy(5begin|4step)E"},
            "noctule-bridge": {r"^_ZN7noctule": r"_GLOBAL__N_19Endpoints\d+(to_autopilot|to_ground|publish|store)",
                               r"_GLOBAL__N_19Endpoints": r"^_ZN7noctule\d+(Udp|Serial)Endpoint4send"}}
ROOTS = {"noctule-nav": {"Navigator::step": r"9Navigator4stepE", "NavNode::step, with publishing": r"7NavNode4stepE", "NavNode::receive, a message": r"7NavNode7receiveE"},
         "noctule-bridge": {f"Bridge::{name}": rf"6Bridge{len(name)}{name}E" for name in ("from_autopilot", "from_ground", "on_nav", "on_odom", "on_scan", "on_objects", "on_wall")}}
_CONSTANT = re.compile(r"inline constexpr \S+ (k\w+) = ([^;]+);\s*///< (.*)")
PROFILES = ("full", "small", "micro")
_OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.FloorDiv: operator.floordiv, ast.Div: operator.floordiv}


def evaluate(text: str, known: dict[str, int], profile: str = "full") -> int:
    """A sum or product of whole numbers and constants named before, or a choice by capacity profile.

    >>> evaluate("kA + 8 * 2", {"kA": 4})
    20
    >>> evaluate("by_profile(768, 256, 12)", {}, "micro")
    12
    """
    def value(node):
        if isinstance(node, ast.Constant):
            return int(node.value)
        if isinstance(node, ast.Name):
            return known[node.id]
        if isinstance(node, ast.Call):   # by_profile(full, small, micro)
            return value(node.args[PROFILES.index(profile)])
        if isinstance(node, ast.BinOp):
            return _OPERATORS[type(node.op)](value(node.left), value(node.right))
        raise ValueError(text)

    return value(ast.parse(re.sub(r"\b(\d+)[uUlL]+\b", r"\1", text), mode="eval").body)


def capacities(text: str, profile: str = "full") -> list[tuple[str, int, str, str]]:
    """(constant, value, what it holds, what happens when full) of core/capacity.hpp, whose comments are 'what; when full'."""
    rows, known = [], {}
    for name, expression, comment in _CONSTANT.findall(text):
        try:
            known[name] = evaluate(expression.strip(), known, profile)
        except (KeyError, ValueError, SyntaxError):
            continue
        what, _, full = comment.partition("; ")
        rows.append((name, known[name], what, full or "-"))
    return rows


def peaks(log: Path) -> dict[str, int]:
    """Greatest use of the pools in a flight: what its messages tell, and what the firmware says when it runs again."""
    from noctule.record import message_type
    from noctule.replay import read_flight_log

    most: dict[str, int] = {}
    fields = {"imu_used": "kMaxImuPerStep", "attitude_used": "kMaxAttitudePerStep", "range_up_used": "kMaxRangePerStep",
              "range_down_used": "kMaxRangePerStep", "baro_used": "kMaxBaroPerStep", "vehicle_used": "kMaxVehiclePerStep", "command_used": "kMaxCommandPerStep"}
    for channel, data in read_flight_log(log).events:
        if channel == "NAV":
            message = message_type("nav_t").decode(data)
            for name, constant in fields.items():
                most[constant] = max(most.get(constant, 0), getattr(message, name))
        elif channel == "SCAN":
            most["kMaxBeams"] = max(most.get("kMaxBeams", 0), message_type("scan_t").decode(data).count)
        elif channel == "WALLS":
            most["kMaxWalls"] = max(most.get("kMaxWalls", 0), message_type("walls_t").decode(data).count)
        elif channel == "LEVELS":
            most["kMaxSurfaces"] = max(most.get("kMaxSurfaces", 0), message_type("levels_t").decode(data).count)
        most["kMaxLcmBytes"] = max(most.get("kMaxLcmBytes", 0), len(data))
    parameters = log.parent / "parameters.toml"
    command = [str(need_program("noctule-profile")), str(log), "--pools", *(["--parameters", str(parameters)] if parameters.exists() else [])]
    return most | json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def sections(program: Path) -> dict[str, int]:
    """text, data and bss of a program [bytes]."""
    names, values = subprocess.run(["size", str(program)], capture_output=True, text=True, check=True).stdout.splitlines()[:2]
    return {n: int(v) for n, v in zip(names.split()[:3], values.split()[:3])}


def stacks(name: str) -> dict[str, stack_report.Depth]:
    """Deepest path under each root of a program's loop in flight."""
    functions = stack_report.disassemble(need_program(name))
    found = {}
    for label, pattern in ROOTS[name].items():
        roots = [function for function in functions if re.search(pattern, function) and not function.endswith(".cold")]
        if len(roots) != 1:
            raise ValueError(f"{label}: {len(roots)} functions are called so")
        found[label] = stack_report.deepest(functions, roots[0], POINTERS[name])
    return found


def navigator_bytes() -> dict[str, int]:
    """Size of the Navigator by capacity profile, as the compiler of this machine lays it out."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        source, program = Path(folder) / "size.cpp", Path(folder) / "size"
        source.write_text('#include <cstdio>\n#include "navigator.hpp"\nint main() { std::printf("%zu", sizeof(noctule::Navigator)); }\n', encoding="ascii")
        for profile in PROFILES:
            subprocess.run(["c++", "-std=c++20", f"-DNOCTULE_CAPACITY_{profile.upper()}", f"-I{ROOT / 'firmware'}", f"-I{build_folder() / 'generated'}",
                            str(source), "-o", str(program)], check=True)
            found[profile] = int(subprocess.run([program], capture_output=True, text=True, check=True).stdout)
    return found


def thousands(value: int) -> str:
    """1234567 as '1 234 567'."""
    return f"{value:,}".replace(",", " ")


def page(sizes: dict[str, int], profiles: dict[str, int], parts: dict[str, dict[str, int]], pools, most: dict[str, int], depths: dict[str, stack_report.Depth], log: str) -> str:
    """The text of docs/memory.md."""
    nav = parts["noctule-nav"]
    static = nav["data"] + nav["bss"]
    lines = ["# Memory", "",
             "Made by `make memory` from the built programs (x86-64, gcc 12, release); each run adds a row to [memory.csv](memory.csv).", "",
             "noctule-nav and noctule-bridge allocate nothing after their first step: the allocator is interposed in every simulated flight, and",
             "report.json carries the count (`memory.heap_allocations_after_start`). No allocator, exception or unwinder symbol is in the archive of",
             "core to command (tests/house). All storage of the autonomy is one static object.", "",
             f"noctule-nav, static: **{static / 2**20:.2f} MiB** (must 32, aim 16). Worst stack of the flight's loop: "
             f"**{max(d.bytes for d in depths.values()) / 1024:.1f} KiB** (must 64, aim 16).", "",
             "Capacity profiles (`-DNOCTULE_CAPACITY=`, [capacity.hpp](../firmware/core/capacity.hpp)), size of the Navigator: "
             + ", ".join(f"{name} {value / 2**20:.2f} MiB" for name, value in profiles.items()) + ". Micro is what a bare Cortex-M7 runs, with its stack in",
             "1 MiB of RAM (`make test-boards PARTS=cortex-m7`; the linker refuses more).", "",
             "| program | code, bytes | data | bss |", "|---|---|---|---|"]
    lines += [f"| {name} | {thousands(s['text'])} | {thousands(s['data'])} | {thousands(s['bss'])} |" for name, s in parts.items()]
    lines += ["", "| object | bytes |", "|---|---|"]
    lines += [f"| {name} | {thousands(value)} |" for name, value in sizes.items() if not name.startswith("k")]
    lines += ["", "## Stack", "",
              "Read from the linked program's machine code: frames of all functions, deepest path through the call graph, no recursion, no frame of",
              f"variable size, no call through a pointer that is not resolved. A function of a shared library (libm, memcpy, lcm_publish) is taken to need {stack_report.LIBRARY_BYTES} bytes. Above these stand main",
              "and LCM's dispatcher. Start-up (command line, TOML) goes deeper and is over before the first message; its stack is the 8 MiB of the process.", "",
              "| from | bytes | deepest path (frame) | not proved |", "|---|---|---|---|"]
    for label, depth in depths.items():
        names = stack_report.demangle(depth.path)
        lines.append(f"| {label} | {depth.bytes} | {', '.join(names)} | {', '.join(stack_report.demangle([p.split(': ')[1] for p in depth.problems])) or '-'} |")
    lines += ["", "## Pools", "", f"Greatest use: in {log}; `-` where no message tells of it.", "",
              "| capacity | full | small | micro | bytes, full | greatest use | what | when full |", "|---|---|---|---|---|---|---|---|"]
    for (name, value, what, full), (_, small, *_), (_, micro, *_) in zip(*pools):
        use = str(most[name]) if name in most else "-"
        lines.append(f"| {name} | {thousands(value)} | {thousands(small)} | {thousands(micro)} | {thousands(sizes[name]) if name in sizes else '-'} | {use} | {what} | {full} |")
    lines += ["", "Bytes are those of the object that a capacity sizes (with what else is in it); where none is given it is a part of one of the objects above.",
              "A waiting scan is replaced by a newer one and counted (`scans_replaced` of `--stats`). noctule-vision is separate and may allocate (OpenCV).", ""]
    return "\n".join(lines)


def main(arguments=None) -> int:
    """Writes both files; 1 where a must is missed."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("log", type=Path, help="a recorded flight.lcm, for the greatest use")
    options.add_argument("--log-name", default="one flight through maze_a, seed 1", help="how the page calls it")
    chosen = options.parse_args(arguments)
    sizes = json.loads(subprocess.run([need_program("noctule-profile"), "--sizes"], capture_output=True, text=True, check=True).stdout)
    parts = {name: sections(need_program(name)) for name in ("noctule-nav", "noctule-bridge")}
    depths = {**stacks("noctule-nav"), **stacks("noctule-bridge")}
    header = (ROOT / "firmware" / "core" / "capacity.hpp").read_text(encoding="utf-8")
    pools = [capacities(header, profile) for profile in PROFILES]
    profiles = navigator_bytes()
    PAGE.write_text(page(sizes, profiles, parts, pools, peaks(chosen.log), depths, chosen.log_name), encoding="utf-8")
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    worst = max(d.bytes for d in depths.values())
    row = {"commit": commit, "nav_static_bytes": parts["noctule-nav"]["data"] + parts["noctule-nav"]["bss"], "nav_code_bytes": parts["noctule-nav"]["text"],
           "bridge_static_bytes": parts["noctule-bridge"]["data"] + parts["noctule-bridge"]["bss"], "bridge_code_bytes": parts["noctule-bridge"]["text"],
           "navigator_bytes": sizes["Navigator"], "stack_bytes": worst, "navigator_small_bytes": profiles["small"], "navigator_micro_bytes": profiles["micro"]}
    rows = list(csv.DictReader(HISTORY.open(encoding="utf-8"))) if HISTORY.exists() else []
    rows = [r for r in rows if r["commit"] != commit] + [row]
    with HISTORY.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(row), restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    proved = not any(d.problems for d in depths.values())
    print(f"static {row['nav_static_bytes'] / 2**20:.2f} MiB, stack {worst} bytes{'' if proved else ' (not proved)'}: {PAGE.relative_to(ROOT)}")
    return 0 if row["nav_static_bytes"] <= MUST_BYTES and profiles["micro"] <= MUST_MICRO_BYTES and worst <= MUST_STACK and proved else 1


if __name__ == "__main__":
    sys.exit(main())
