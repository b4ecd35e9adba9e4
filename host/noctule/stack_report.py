"""Greatest stack of a linked program, proved from its machine code (x86-64, as gcc and GNU objdump write it).

Every function's frame is read from its instructions: return address, pushes, and what is taken off %rsp. Calls and jumps
to other functions make the call graph; its deepest path is the bound. What cannot be bounded is named, not guessed:
calls through pointers, recursion, frames of variable size. Functions of shared libraries (libm, libc) count LIBRARY_BYTES.
Because it is the linked program, inlining and the clones that the optimiser made are what really runs.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

LIBRARY_BYTES = 2048         # for a leaf of libm or memcpy: glibc's own need some hundreds
_FUNCTION = re.compile(r"^([0-9a-f]+) <(.+)>:$")
_CALL = re.compile(r"^(call|jmp|j[a-z]+)\s+([0-9a-f]+) <([^+>]+(?:\+0x[0-9a-f]+)?.*)>$")
_SUB = re.compile(r"^sub\s+\$0x([0-9a-f]+),%rsp$")
_ADD = re.compile(r"^add\s+\$0x([0-9a-f]+),%rsp$")
# std::sort goes down at most 2 log2(n) times: twice 17 for the greatest capacity of the firmware, 131072.
_SORT, SORT_DEPTH = re.compile(r"^_ZSt16__introsort_loop"), 34


def _signed(text: str) -> int:
    value = int(text, 16)
    return value - (1 << 64) if value >= 1 << 63 else value


@dataclass
class Function:
    """Bytes of one function with its return address, and whom it may call: names, or '*' for a pointer."""

    name: str
    frame: int = 8
    calls: set[str] = field(default_factory=set)
    variable: bool = False


def read_functions(lines) -> dict[str, Function]:
    """Functions of `objdump -d --no-show-raw-insn` without demangling.

    Within a function the stack only grows where it pushes or subtracts; all of these are added up, though two branches may
    exclude each other: a bound, never too small.
    """
    functions: dict[str, Function] = {}
    current = None
    for line in lines:
        if match := _FUNCTION.match(line):
            current = functions.setdefault(match[2], Function(match[2]))
            continue
        if current is None or "\t" not in line:
            continue
        code = line.split("\t", 1)[1].split("#")[0].strip()
        code = code.removeprefix("bnd ").removeprefix("notrack ")
        if code.startswith("push"):
            current.frame += 8
        elif match := _SUB.match(code):
            current.frame += max(0, _signed(match[1]))       # `sub $-128` gives back
        elif match := _ADD.match(code):
            current.frame += max(0, -_signed(match[1]))      # `add $-128` takes
        elif code.startswith("sub ") and code.endswith(",%rsp"):
            current.variable = True
        elif match := _CALL.match(code):
            target = re.sub(r"\+0x[0-9a-f]+$", "", match[3])
            if target != current.name or match[1] == "call":
                current.calls.add(target)    # a jump within itself is a loop
        elif re.match(r"call\s+\*", code):
            current.calls.add("*")
        elif re.match(r"jmp\s+\*%", code):
            current.calls.add("*jump")
    return functions


@dataclass
class Depth:
    """Deepest path from a function. problems: what keeps it from being a proof."""

    bytes: int
    path: list[str]
    problems: list[str]


def _pointed_at(functions: dict[str, Function], name: str, pointers: dict[str, str]) -> list[str]:
    """Whom a call through a pointer in that function may reach: lambdas written inside it, and what `pointers` says."""
    inside = [n for n in functions if name.startswith("_ZN") and n.startswith("_ZZ" + name[2:name.index("E", 3) if "E" in name[3:] else None])]
    said = [n for caller, callees in pointers.items() if re.search(caller, name) for n in functions if re.search(callees, n)]
    return inside + said


def deepest(functions: dict[str, Function], root: str, pointers: dict[str, str] | None = None) -> Depth:
    """The deepest path under root.

    pointers: for calls through a pointer, caller -> callees, regular expressions of mangled names. A jump through a pointer
    inside a function is a switch, not a call, and needs no stack.
    """
    known: dict[str, tuple[int, list[str]]] = {}
    problems: set[str] = set()

    def walk(name: str, above: tuple[str, ...]) -> tuple[int, list[str]]:
        if name in known:
            return known[name]
        if name in above:
            problems.add(f"recursion: {name}")
            return 0, []
        function = functions.get(name)
        if function is None or "@plt" in name:
            return LIBRARY_BYTES, [name]
        if function.variable:
            problems.add(f"frame of variable size: {name}")
        best: tuple[int, list[str]] = (0, [])
        callees = set(function.calls) - {"*", "*jump"}
        if "*" in function.calls:
            reached = _pointed_at(functions, name, pointers or {})
            callees.update(reached)
            if not reached:
                problems.add(f"call through a pointer: {name}")
        times = SORT_DEPTH if _SORT.match(name) else 1
        if times > 1:
            callees.discard(name)
        for callee in sorted(callees):
            best = max(best, walk(callee, (*above, name)), key=lambda entry: entry[0])
        known[name] = times * function.frame + best[0], [name, *best[1]]
        return known[name]

    if root not in functions:
        raise KeyError(root)
    total, path = walk(root, ())
    return Depth(total, path, sorted(problems))


def disassemble(program: Path) -> dict[str, Function]:
    """Functions of a program or archive member."""
    text = subprocess.run(["objdump", "-d", "--no-show-raw-insn", str(program)], capture_output=True, text=True, check=True).stdout
    return read_functions(text.splitlines())


def demangle(names: list[str]) -> list[str]:
    """Readable names."""
    done = subprocess.run(["c++filt", *names], capture_output=True, text=True, check=True).stdout.splitlines()
    return [re.sub(r"\(.*", "", name.replace("(anonymous namespace)::", "").replace("noctule::", "")) for name in done]
