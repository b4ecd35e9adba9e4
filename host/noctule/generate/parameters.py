"""Reads interface/parameters.toml, checks every row, and writes the C++ table, the Python table and docs/parameters.md."""

import json
import math
import tomllib
import zlib
from dataclasses import dataclass
from pathlib import Path

from noctule.generate import INTERFACE, InterfaceError
from noctule.generate.units import name_matches_unit

SOURCE = INTERFACE / "parameters.toml"
REQUIRED = ("param", "type", "unit", "default", "min", "max", "doc", "source")
OPTIONAL = ("paper", "reboot")
PRESETS = ("paper",)
MAX_ID_LENGTH = 16  # MAVLink PARAM_VALUE.param_id


@dataclass(frozen=True)
class Row:
    """One tunable. `value` fields are float or int as `type` says; `presets` holds only the values that differ."""

    name: str
    param: str
    type: str
    unit: str
    default: float | int
    min: float | int
    max: float | int
    doc: str
    source: str
    reboot: bool
    presets: tuple
    section: str


def _number(value, kind):
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError("is not a number")
    if kind == "int":
        if not isinstance(value, int):
            raise ValueError("is not a whole number")
        if abs(value) > 2**24:
            raise ValueError("does not survive a MAVLink PARAM_VALUE, whose value is a float")
        return value
    if not math.isfinite(value):
        raise ValueError("is not finite")
    return float(value)


def _row(name, entry, section, where):
    def fail(text):
        raise InterfaceError(f"{where}: [{name}] {text}")

    if not isinstance(entry, dict):
        fail("is not a table")
    for field in REQUIRED:
        if field not in entry:
            fail(f"has no field '{field}'")
    for field in entry:
        if field not in REQUIRED + OPTIONAL:
            fail(f"has an unknown field '{field}'")
    if not name.isidentifier() or name != name.lower():
        fail("is not a snake_case name")
    if entry["type"] not in ("float", "int"):
        fail(f"has type '{entry['type']}', which is neither float nor int")
    param = entry["param"]
    if not param or len(param) > MAX_ID_LENGTH:
        fail(f"has param '{param}', which is empty or over {MAX_ID_LENGTH} characters")
    if not all(c.isascii() and (c.isupper() or c.isdigit() or c == "_") for c in param):
        fail(f"has param '{param}', which holds more than A-Z, 0-9 and _")
    try:
        if not name_matches_unit(name, entry["unit"]):
            fail(f"does not end in its unit '{entry['unit']}'")
    except ValueError as error:
        if isinstance(error, InterfaceError):
            raise
        fail(f"has {error}")
    numbers = {}
    for field in ("default", "min", "max") + PRESETS:
        if field in entry:
            try:
                numbers[field] = _number(entry[field], entry["type"])
            except ValueError as error:
                fail(f"field '{field}' {error}")
    if numbers["min"] > numbers["max"]:
        fail("has min over max")
    for field in ("default",) + PRESETS:
        if field in numbers and not numbers["min"] <= numbers[field] <= numbers["max"]:
            fail(f"has {field} {numbers[field]} outside {numbers['min']} to {numbers['max']}")
    if not str(entry["doc"]).strip() or not str(entry["source"]).strip():
        fail("has an empty doc or source")
    if not isinstance(entry.get("reboot", False), bool):
        fail("field 'reboot' is neither true nor false")
    presets = tuple((p, numbers[p]) for p in PRESETS if p in numbers)
    return Row(name, param, entry["type"], entry["unit"], numbers["default"], numbers["min"], numbers["max"],
               entry["doc"].strip(), entry["source"].strip(), entry.get("reboot", False), presets, section)


def _sections(text):
    """Row name -> title of the section comment (`# ---- title`) above it."""
    sections, title = {}, ""
    for line in text.splitlines():
        line = line.strip()
        if line.startswith("# ---"):
            title = line.lstrip("#- ").strip()
        elif line.startswith("[") and line.endswith("]"):
            sections[line[1:-1].strip()] = title
    return sections


def load(path=SOURCE):
    """The table, in the order of the file.

    Args:
        path: a TOML file with one table a parameter.

    Returns:
        tuple of Row.

    Raises:
        InterfaceError: a missing or unknown field, a value out of range, an id over 16 characters or used twice,
            a name that does not end in its unit, or a file that is not TOML.
    """
    path = Path(path)
    text = path.read_text(encoding="utf-8")
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InterfaceError(f"{path.name}: {error}") from None
    sections = _sections(text)
    rows = tuple(_row(name, entry, sections.get(name, ""), path.name) for name, entry in tables.items())
    seen = {}
    for row in rows:
        if row.param in seen:
            raise InterfaceError(f"{path.name}: [{row.name}] uses param '{row.param}', which [{seen[row.param]}] has already")
        seen[row.param] = row.name
    if not rows:
        raise InterfaceError(f"{path.name}: holds no parameter")
    return rows


def crc(rows):
    """CRC-32 of what the table means (names, ids, types, values), so that a new comment leaves it as it is."""
    meaning = [[r.name, r.param, r.type, r.unit, r.default, r.min, r.max, r.reboot, r.presets] for r in rows]
    return zlib.crc32(json.dumps(meaning).encode())


def _cpp_float(value):
    text = repr(float(value))
    return f"{text}F"


def _cpp_value(row, value):
    return str(value) if row.type == "int" else _cpp_float(value)


def cpp(rows):
    """Text of params.gen.hpp."""
    out = [
        "/// Generated from firmware/interface/parameters.toml by `python -m noctule.generate`; edit that file.",
        "#pragma once",
        "",
        "#include <array>",
        "#include <cmath>",
        "#include <cstdint>",
        "#include <string_view>",
        "",
        "namespace noctule {",
        "",
        "/// Every tunable with its default. Units are the ends of the names; docs/parameters.md has the meanings.",
        "struct Parameters {",
    ]
    for row in rows:
        kind = "std::int32_t" if row.type == "int" else "float"
        out.append(f"    {kind} {row.name} = {_cpp_value(row, row.default)};")
    out += [
        "};",
        "",
        "/// One row of the table. Exactly one of the two members is not null.",
        "struct ParameterRow {",
        "    std::string_view name;  ///< as in parameters.toml and in Parameters",
        "    std::string_view id;    ///< MAVLink PARAM id, at most 16 characters",
        "    float Parameters::*as_float;",
        "    std::int32_t Parameters::*as_int;",
        "    float min;",
        "    float max;",
        "    bool reboot;  ///< takes effect at the next start only",
        "};",
        "",
        f"inline constexpr std::array<ParameterRow, {len(rows)}> kParameterTable{{{{",
    ]
    for row in rows:
        member = f"&Parameters::{row.name}"
        pointers = f"nullptr, {member}" if row.type == "int" else f"{member}, nullptr"
        reboot = "true" if row.reboot else "false"
        out.append(f'    {{"{row.name}", "{row.param}", {pointers}, {_cpp_float(row.min)}, {_cpp_float(row.max)}, {reboot}}},')
    out += [
        "}};",
        "",
        "/// CRC-32 of names, ids, types, limits and defaults. Two programs with the same value have the same table.",
        f"inline constexpr std::uint32_t kParametersCrc = 0x{crc(rows):08X}U;",
        "",
        "/// One value of a preset that differs from the default; `row` indexes kParameterTable.",
        "struct ParameterOverride {",
        "    std::size_t row;",
        "    float value;",
        "};",
        "",
    ]
    for preset in PRESETS:
        chosen = [(i, dict(r.presets)[preset]) for i, r in enumerate(rows) if preset in dict(r.presets)]
        out.append(f"inline constexpr std::array<ParameterOverride, {len(chosen)}> kPreset{preset.title()}{{{{")
        out += [f"    {{{i}, {_cpp_float(v)}}},  // {rows[i].name}" for i, v in chosen]
        out += ["}};", ""]
    out += [
        "/// The row with this name or MAVLink id; null when there is none.",
        "[[nodiscard]] constexpr const ParameterRow* find_parameter(const std::string_view name_or_id) {",
        "    for (const ParameterRow& row : kParameterTable) {",
        "        if (row.name == name_or_id || row.id == name_or_id) { return &row; }",
        "    }",
        "    return nullptr;",
        "}",
        "",
        "[[nodiscard]] constexpr float parameter_value(const Parameters& parameters, const ParameterRow& row) {",
        "    return row.as_float != nullptr ? parameters.*row.as_float : static_cast<float>(parameters.*row.as_int);",
        "}",
        "",
        "enum class ParameterSet : std::uint8_t { stored, rejected_range, rejected_not_whole };",
        "",
        "/// Stores a value. Rejected: not finite or out of the row's range, or a fraction for a whole number; nothing changes then.",
        "[[nodiscard]] inline ParameterSet set_parameter(Parameters& parameters, const ParameterRow& row, const float value) {",
        "    if (!(value >= row.min && value <= row.max)) { return ParameterSet::rejected_range; }",
        "    if (row.as_float != nullptr) {",
        "        parameters.*row.as_float = value;",
        "        return ParameterSet::stored;",
        "    }",
        "    if (value != std::floor(value)) { return ParameterSet::rejected_not_whole; }",
        "    parameters.*row.as_int = static_cast<std::int32_t>(value);",
        "    return ParameterSet::stored;",
        "}",
        "",
        "}  // namespace noctule",
        "",
    ]
    return "\n".join(out)


def python(rows):
    """Text of noctule/params_gen.py."""
    out = [
        '"""Every tunable. Generated from firmware/interface/parameters.toml by `python -m noctule.generate`; edit that file."""',
        "",
        "from typing import NamedTuple",
        "",
        "",
        "class Row(NamedTuple):",
        '    """One tunable; `type` is "float" or "int", `presets` holds the values that differ from the default."""',
        "",
        "    name: str",
        "    param: str",
        "    type: str",
        "    unit: str",
        "    default: float",
        "    min: float",
        "    max: float",
        "    reboot: bool",
        "    presets: dict",
        "    doc: str",
        "",
        "",
        f"CRC = 0x{crc(rows):08X}",
        "",
        "TABLE = (",
    ]
    for r in rows:
        fields = (r.name, r.param, r.type, r.unit, r.default, r.min, r.max, r.reboot, dict(r.presets), r.doc)
        out.append("    Row(" + ", ".join(repr(f) for f in fields) + "),")
    out += [
        ")",
        "",
        "BY_NAME = {row.name: row for row in TABLE}",
        "BY_PARAM = {row.param: row for row in TABLE}",
        "DEFAULTS = {row.name: row.default for row in TABLE}",
        f"PRESET_NAMES = {('default', *PRESETS)!r}",
        "PRESETS = {preset: {row.name: row.presets.get(preset, row.default) for row in TABLE} for preset in PRESET_NAMES}",
        "",
    ]
    return "\n".join(out)


def _plain(value):
    return f"{value:g}" if isinstance(value, float) else str(value)


def docs(rows):
    """Text of docs/parameters.md."""
    out = [
        "# Parameters",
        "",
        "Generated from `firmware/interface/parameters.toml` by `python -m noctule.generate docs`. Set one for a flight with "
        "`noctule fly WORLD --param NAME=VALUE`, where NAME is the name or the MAVLink id. "
        "`paper` is the value of `--preset paper` where it differs. `(start)` marks those that take effect at the next start only.",
        "",
    ]
    section = None
    for r in rows:
        if r.section != section:
            section = r.section
            if out[-1]:
                out.append("")
            out += [f"## {section[:1].upper() + section[1:]}", "",
                    "| name | MAVLink id | unit | default | min | max | paper | meaning | source |",
                    "|---|---|---|---|---|---|---|---|---|"]
        meaning = r.doc.replace("|", "\\|").replace("\n", " ") + (" (start)" if r.reboot else "")
        paper = _plain(dict(r.presets)["paper"]) if r.presets else ""
        cells = [f"`{r.name}`", f"`{r.param}`", r.unit, _plain(r.default), _plain(r.min), _plain(r.max), paper, meaning, r.source]
        out.append("| " + " | ".join(cells) + " |")
    out.append("")
    return "\n".join(out)
