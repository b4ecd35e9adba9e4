"""Reads interface/streams.toml and writes channel names for C++ and Python, and docs/messages.md."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from noctule.generate import INTERFACE, InterfaceError

SOURCE = INTERFACE / "streams.toml"
FIELDS = {"type": str, "rate_hz": (int, float), "from": str, "to": list, "bus": str, "log": bool}
BUSES = ("flight", "camera")
MAX_CHANNEL_LENGTH = 15  # a longer name makes liblcm allocate on every receive


@dataclass(frozen=True)
class Stream:
    channel: str
    type: str
    rate_hz: float
    source: str
    readers: tuple
    bus: str
    log: bool


def load(path=SOURCE, messages=None):
    """The streams, in the order of the file.

    Args:
        path: a TOML file with one table a channel.
        messages: names of the message types that exist; None leaves the types unchecked.

    Returns:
        tuple of Stream.

    Raises:
        InterfaceError: a field is missing, unknown or of the wrong type, or the channel's name is too long.
    """
    path = Path(path)
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise InterfaceError(f"{path.name}: {error}") from None
    streams = []
    for channel, entry in tables.items():
        where = f"{path.name}: [{channel}]"
        if len(channel) > MAX_CHANNEL_LENGTH or not channel.isidentifier() or channel != channel.upper():
            raise InterfaceError(f"{where} must be an upper-case name of at most {MAX_CHANNEL_LENGTH} characters")
        for field, kind in FIELDS.items():
            if field not in entry:
                raise InterfaceError(f"{where} has no field '{field}'")
            if not isinstance(entry[field], kind):
                raise InterfaceError(f"{where} field '{field}' has the wrong type")
        for field in entry:
            if field not in FIELDS:
                raise InterfaceError(f"{where} has an unknown field '{field}'")
        if entry["bus"] not in BUSES:
            raise InterfaceError(f"{where} is on bus '{entry['bus']}'; there are {' and '.join(BUSES)}")
        if messages is not None and entry["type"] not in messages:
            raise InterfaceError(f"{where} has type '{entry['type']}', which no .lcm file defines")
        streams.append(Stream(channel, entry["type"], entry["rate_hz"], entry["from"], tuple(entry["to"]), entry["bus"], entry["log"]))
    return tuple(streams)


def cpp(streams):
    """Text of streams.gen.hpp: one constant a channel, `kChannelRangeUp` for RANGE_UP, and kAllChannels."""
    out = ["/// Generated from firmware/interface/streams.toml by `python -m noctule.generate`; edit that file.", "#pragma once", "",
           "#include <array>", "", "namespace noctule {", ""]
    names = []
    for s in streams:
        name = "".join(part.title() for part in s.channel.split("_"))
        rate = f"{s.rate_hz:g} Hz" if s.rate_hz else "on event"
        names.append(f"kChannel{name}")
        out.append(f'inline constexpr const char* kChannel{name} = "{s.channel}";  ///< {s.type}, {rate}, {s.bus} bus, from {s.source}')
    out += ["", f"inline constexpr std::array<const char*, {len(names)}> kAllChannels{{{', '.join(names)}}};", "", "}  // namespace noctule", ""]
    return "\n".join(out)


def python(streams):
    """Text of noctule/streams_gen.py."""
    out = ['"""Channels. Generated from firmware/interface/streams.toml by `python -m noctule.generate`; edit that file."""', "",
           "from typing import NamedTuple", "", "",
           "class Stream(NamedTuple):", '    """One channel; rate_hz 0 means on event, `log` whether the flight recorder keeps it."""', "",
           "    channel: str", "    type: str", "    rate_hz: float", "    source: str", "    readers: tuple", "    bus: str", "    log: bool", "", ""]
    out += [f'{s.channel} = "{s.channel}"' for s in streams]
    out += ["", "STREAMS = {"]
    for s in streams:
        fields = (s.channel, s.type, s.rate_hz, s.source, s.readers, s.bus, s.log)
        out.append(f'    "{s.channel}": Stream(' + ", ".join(repr(f) for f in fields) + "),")
    out += ["}", ""]
    return "\n".join(out)


def docs(streams, messages):
    """Text of docs/messages.md: the table of streams, then every message with its fields."""
    out = ["# Streams and messages", "",
           "Generated from `firmware/interface/streams.toml` and `firmware/interface/lcm/*.lcm` by `python -m noctule.generate docs`. "
           "All run over LCM; the camera bus has a port of its own. MAVLink messages are in `firmware/link/`.", "",
           "| channel | type | rate | from | to | bus | logged |", "|---|---|---|---|---|---|---|"]
    for s in streams:
        rate = f"{s.rate_hz:g} Hz" if s.rate_hz else "on event"
        out.append(f"| {s.channel} | [`{s.type}`](#{s.type}) | {rate} | {s.source} | {', '.join(s.readers)} | {s.bus} | {'yes' if s.log else 'no'} |")
    for message in messages.values():
        out += ["", f"## {message.name}", "", message.doc, ""]
        if message.constants:
            out += [", ".join(f"`{name} = {value}`" for name, value in message.constants), ""]
        out += ["| field | type | unit | meaning |", "|---|---|---|---|"]
        for f in message.fields:
            kind = f.type + "".join(f"[{n}]" for n in f.lengths)
            out.append(f"| `{f.name}` | {kind} | {f.unit} | {f.doc.replace('|', chr(92) + '|')} |")
    out.append("")
    return "\n".join(out)
