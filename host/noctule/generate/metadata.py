"""Component metadata for ground stations (https://mavlink.io/en/services/component_metadata.html), served by the bridge over MAVLink FTP."""

import json
import lzma
import zlib

FOLDER = "noctule"
GENERAL, PARAMETERS = f"{FOLDER}/general.json", f"{FOLDER}/parameters.json.xz"
TYPE_PARAMETER = 1       # COMP_METADATA_TYPE_PARAMETER
UNITS = {"-": "", "hz": "Hz", "us": "us", "px": "px"}


def crc32(data):
    """CRC-32 as MAVLink FTP counts it: begun at zero and not inverted at the end."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def parameter_json(rows):
    """Parameter metadata, schema version 1.

    Args:
        rows: the table, of generate.parameters.load().

    Returns:
        bytes, JSON.
    """
    entries = []
    for row in rows:
        short = row.doc.split(". ")[0].rstrip(".")
        entry = {
            "name": row.param, "type": "Int32" if row.type == "int" else "Float",
            "shortDesc": short, "longDesc": f"{row.doc} ({row.name}; {row.source})",
            "units": UNITS.get(row.unit, row.unit), "default": row.default, "min": row.min, "max": row.max,
            "group": row.section or "other", "category": "Standard",
        }
        if row.type == "float":
            entry["decimalPlaces"] = 4
        if row.reboot:
            entry["rebootRequired"] = True
        if not entry["units"]:
            del entry["units"]
        entries.append(entry)
    return json.dumps({"version": 1, "parameters": entries}, separators=(",", ":")).encode()


def files(rows):
    """What is served: path -> bytes, the general file first."""
    packed = lzma.compress(parameter_json(rows), format=lzma.FORMAT_XZ, check=lzma.CHECK_CRC32, preset=9)
    general = {"version": 1, "metadataTypes": [
        {"type": TYPE_PARAMETER, "uri": f"mftp:///{PARAMETERS}", "fileCrc": crc32(packed)}]}
    return {GENERAL: json.dumps(general, separators=(",", ":")).encode(), PARAMETERS: packed}


def cpp(rows):
    """Text of metadata.gen.hpp."""
    out = ["/// Generated from firmware/interface/parameters.toml by `python -m noctule.generate`; edit that file.", "#pragma once", "",
           "#include <array>", "#include <cstdint>", "", '#include "link/ftp_server.hpp"', "", "namespace noctule {", ""]
    entries = []
    for i, (path, data) in enumerate(files(rows).items()):
        out.append(f"inline constexpr std::array<std::uint8_t, {len(data)}> kMetadata{i}{{")
        out += ["    " + ", ".join(f"0x{byte:02X}" for byte in data[at:at + 24]) + "," for at in range(0, len(data), 24)]
        out += ["};", ""]
        entries.append(f'    {{"{path}", kMetadata{i}, 0x{crc32(data):08X}U}},')
    out += [f"inline constexpr std::array<ServedFile, {len(entries)}> kMetadataFiles{{{{", *entries, "}};", "", "}  // namespace noctule", ""]
    return "\n".join(out)
