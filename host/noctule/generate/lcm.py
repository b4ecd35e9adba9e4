"""Reads interface/lcm/*.lcm, checks them against the rules for messages, and generates C++ and Python from them.

The rules (facts of lcm-gen 1.3.1 and of flight without a heap): constant lengths only, no strings, no nested or
unsigned types, `[unit]` first in every field's comment and equal to the name's suffix, one line above the struct that
says what it is, who publishes and who reads it, and every long array length repeats a constant of its struct.
"""

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from noctule.generate import INTERFACE, InterfaceError, write_if_changed
from noctule.generate.units import name_matches_unit

SOURCE = INTERFACE / "lcm"
PYTHON_PACKAGE = "noctule_lcm"  # in Python the package `noctule` is the host's own
PRIMITIVES = ("int8_t", "int16_t", "int32_t", "int64_t", "float", "double", "boolean", "byte")
MAX_BARE_LENGTH = 16  # arrays up to this long (a covariance, a vector) need no constant

_CONST = re.compile(r"const\s+(\w+)\s+(\w+)\s*=\s*(-?\d+)\s*;")
_FIELD = re.compile(r"(\w+)\s+(\w+)((?:\s*\[\s*\w+\s*\])*)\s*;\s*(?://\s*(.*))?$")
_UNIT = re.compile(r"\[([^\]]+)\]\s*(.*)")


@dataclass(frozen=True)
class Field:
    type: str
    name: str
    lengths: tuple
    unit: str
    doc: str


@dataclass(frozen=True)
class Message:
    name: str
    doc: str
    constants: tuple  # of (name, value)
    fields: tuple


def _field(match, where):
    kind, name, brackets, comment = match.groups()
    if kind == "string":
        raise InterfaceError(f"{where}: {name} is a string; strings allocate")
    if kind not in PRIMITIVES:
        raise InterfaceError(f"{where}: {name} has type {kind}; allowed are {', '.join(PRIMITIVES)}")
    lengths = []
    for length in re.findall(r"\[\s*(\w+)\s*\]", brackets):
        if not length.isdigit():
            raise InterfaceError(f"{where}: {name} has length [{length}]; only literal lengths are constant in lcm-gen 1.3.1")
        lengths.append(int(length))
    unit = _UNIT.match(comment or "")
    if not unit or not unit.group(2).strip():
        raise InterfaceError(f"{where}: {name} needs a comment that starts with its [unit] and says what it is")
    try:
        matches = name_matches_unit(name, unit.group(1))
    except ValueError as error:
        raise InterfaceError(f"{where}: {name}: {error}") from None
    if not matches:
        raise InterfaceError(f"{where}: {name} does not end in its unit [{unit.group(1)}]")
    return Field(kind, name, tuple(lengths), unit.group(1), unit.group(2).strip())


def literal_matches(length, constants):
    """Name of the constant that an array length repeats: equal to it or to its square; None where there is none.

    >>> literal_matches(64, (("TILE", 8),)), literal_matches(8, (("TILE", 8),)), literal_matches(9, (("TILE", 8),))
    ('TILE * TILE', 'TILE', None)
    """
    for name, value in constants:
        if length == value:
            return name
    for name, value in constants:
        if length == value * value:
            return f"{name} * {name}"
    return None


def parse(path):
    """One message type of an .lcm file, checked.

    Args:
        path: file that holds one struct of package noctule.

    Returns:
        Message.

    Raises:
        InterfaceError: a rule of the module's docstring is broken; names file, line and rule.
    """
    path = Path(path)
    name, doc, comment, constants, fields = None, "", "", [], []
    if not re.search(r"^package noctule;$", path.read_text(encoding="utf-8"), re.MULTILINE):
        raise InterfaceError(f"{path.name}: is not in package noctule")
    for number, raw in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        line, where = raw.strip(), f"{path.name}:{number}"
        if not line or line in ("{", "}") or line.startswith("package "):
            continue
        if line.startswith("//"):
            comment = line.lstrip("/ ").strip()
        elif line.startswith("struct"):
            if name is not None:
                raise InterfaceError(f"{where}: a second struct; one a file")
            name, doc = line.split()[1].rstrip("{"), comment
            if "Published by" not in doc or "Read by" not in doc:
                raise InterfaceError(f"{where}: the line above the struct must say 'Published by ...' and 'Read by ...'")
        elif match := _CONST.match(line):
            if match.group(1) not in ("int32_t", "int64_t"):
                raise InterfaceError(f"{where}: constant {match.group(2)} must be int32_t or int64_t for usable C++")
            constants.append((match.group(2), int(match.group(3))))
        elif match := _FIELD.match(line):
            fields.append(_field(match, where))
        else:
            raise InterfaceError(f"{where}: not understood: {line}")
    if name is None or name != path.stem:
        raise InterfaceError(f"{path.name}: must hold struct {path.stem}")
    used = set()
    for field in fields:
        for length in field.lengths:
            constant = literal_matches(length, constants)
            if constant is None and length > MAX_BARE_LENGTH:
                raise InterfaceError(f"{path.name}: {field.name}[{length}] repeats no constant of {name}")
            used.add(constant)
    for constant, _ in constants:
        if constant.startswith("MAX_") and constant not in used:
            raise InterfaceError(f"{path.name}: no array has the length of {constant}")
    return Message(name, doc, tuple(constants), tuple(fields))


def load(folder=SOURCE):
    """All messages by name, in order of name. Raises InterfaceError as `parse` does."""
    return {path.stem: parse(path) for path in sorted(Path(folder).glob("*.lcm"))}


def cpp_all(messages):
    """Text of lcmtypes.gen.hpp, which includes every type."""
    out = ["/// Every message type. Generated from firmware/interface/lcm by `python -m noctule.generate`.", "#pragma once", ""]
    out += [f'#include "lcmtypes/noctule/{name}.hpp"  // IWYU pragma: export' for name in messages]
    return "\n".join([*out, ""])


def cpp_checks(messages):
    """Text of a C++ file whose static_asserts tie every array length to its constant."""
    out = ["// Generated from firmware/interface/lcm by `python -m noctule.generate`."]
    out += ['#include "lcmtypes.gen.hpp"', "", "#include <type_traits>", "", "// Trivially copyable: a message of constant length is plain memory, nothing of it is on the heap."]
    for message in messages.values():
        out.append("")
        out.append(f"static_assert(std::is_trivially_copyable_v<noctule::{message.name}>);")
        for field in message.fields:
            for dimension, length in enumerate(field.lengths):
                constant = literal_matches(length, message.constants)
                if constant is not None:
                    value = " * ".join(f"noctule::{message.name}::{c}" for c in constant.split(" * "))
                    out.append(f"static_assert(std::extent_v<decltype(noctule::{message.name}::{field.name}), {dimension}> == {value},\n"
                               f'              "{message.name}.{field.name} and {constant} differ");')
    out.append("")
    return "\n".join(out)


def _run(command):
    tool = shutil.which(command[0])
    if tool is None:
        raise InterfaceError(f"{command[0]} was not found; it is in Debian's liblcm-bin")
    done = subprocess.run([tool, *command[1:]], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InterfaceError(f"lcm-gen: {(done.stderr or done.stdout).strip()}")


def generate_cpp(out):
    """Writes lcmtypes/noctule/*.hpp, lcmtypes.gen.hpp and lcm_checks.gen.cpp under out."""
    messages = load()
    out = Path(out)
    with tempfile.TemporaryDirectory() as scratch:
        _run(["lcm-gen", "--cpp", "--cpp-hpath", f"{scratch}/lcmtypes", *map(str, sorted(SOURCE.glob("*.lcm")))])
        for header in sorted(Path(scratch).rglob("*.hpp")):
            write_if_changed(out / header.relative_to(scratch), header.read_text(encoding="utf-8"))
    write_if_changed(out / "lcmtypes.gen.hpp", cpp_all(messages))
    write_if_changed(out / "lcm_checks.gen.cpp", cpp_checks(messages))


def generate_python(out):
    """Writes the package noctule_lcm under out. A type's fingerprint does not depend on the package's name."""
    load()
    with tempfile.TemporaryDirectory() as scratch:
        renamed = Path(scratch) / "lcm"
        renamed.mkdir()
        for path in sorted(SOURCE.glob("*.lcm")):
            text = path.read_text(encoding="utf-8").replace("package noctule;", f"package {PYTHON_PACKAGE};")
            (renamed / path.name).write_text(text, encoding="utf-8")
        _run(["lcm-gen", "--python", "--ppath", scratch, *map(str, sorted(renamed.glob("*.lcm")))])
        for module in sorted((Path(scratch) / PYTHON_PACKAGE).glob("*.py")):
            write_if_changed(Path(out) / PYTHON_PACKAGE / module.name, module.read_text(encoding="utf-8"))
