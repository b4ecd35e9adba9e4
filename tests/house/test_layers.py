"""The rooms of the firmware stand in the order in which data flows: no file includes a later room."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"

# A room may include itself and whatever stands before it. navigator.hpp counts as a room of its own.
ORDER = ("core", "sense", "estimate", "map", "plan", "command", "navigator", "link", "drivers", "app")
# recognise is a branch: it reads the estimate, and only app may include it.
RECOGNISE_MAY = ("core", "sense", "estimate", "recognise")

INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


def room_of(path):
    """Room of an include path or of a file's path relative to firmware/; None for generated and system headers.

    >>> room_of("core/angle.hpp"), room_of("navigator.hpp"), room_of("params.gen.hpp")
    ('core', 'navigator', None)
    """
    head = path.split("/")[0] if "/" in path else path.split(".")[0]
    return head if head in ORDER or head == "recognise" else None


def forbidden(room, target):
    """Why a file of `room` may not include `target`; None if it may.

    >>> forbidden("sense", "estimate"), forbidden("plan", "map"), forbidden("app", "recognise")
    ('sense comes before estimate', None, None)
    """
    if room == "recognise":
        return None if target in RECOGNISE_MAY else f"recognise may not include {target}"
    if target == "recognise":
        return None if room == "app" else f"only app may include recognise, not {room}"
    if ORDER.index(target) > ORDER.index(room):
        return f"{room} comes before {target}"
    return None


def violations(folder):
    """One line for each include against the order, for the C++ files under a firmware folder."""
    found = []
    for path in sorted(folder.rglob("*.[ch]pp")):
        relative = path.relative_to(folder).as_posix()
        room = room_of(relative)
        if room is None:
            found.append(f"{relative}: is in no room")
            continue
        for target in INCLUDE.findall(path.read_text(encoding="utf-8")):
            if target.startswith("lcmtypes") and room not in ("link", "drivers", "app"):
                found.append(f"{relative}: only link, drivers and app know a wire format, it includes {target}")
            elif room_of(target) and (why := forbidden(room, room_of(target))):
                found.append(f"{relative}: {why}, it includes {target}")
    return found


def test_no_room_includes_a_later_one():
    assert violations(FIRMWARE) == []


def test_every_include_names_its_room():
    """A bare or relative include would hide which room it is from."""
    bare = []
    for path in sorted(FIRMWARE.rglob("*.[ch]pp")):
        for target in INCLUDE.findall(path.read_text(encoding="utf-8")):
            if not (FIRMWARE / target).exists() and not re.fullmatch(r"(params|streams|metadata|lcmtypes)\.gen\.hpp|lcmtypes/noctule/\w+\.hpp", target):
                bare.append(f"{path.relative_to(FIRMWARE)}: {target}")
    assert bare == []


@pytest.mark.parametrize(
    "relative, text, expected",
    [
        ("sense/a.hpp", '#include "estimate/estimate.hpp"', "sense comes before estimate"),
        ("map/a.cpp", '  #  include "plan/mission.hpp"', "map comes before plan"),
        ("command/guard.hpp", '#include "navigator.hpp"', "command comes before navigator"),
        ("recognise/a.hpp", '#include "map/grid.hpp"', "recognise may not include map"),
        ("link/a.hpp", '#include "recognise/surf.hpp"', "only app may include recognise"),
        ("plan/a.hpp", '#include "lcmtypes/noctule/nav_t.hpp"', "know a wire format"),
        ("utils/a.hpp", "", "is in no room"),
    ],
)
def test_the_check_sees_a_violation(tmp_path, relative, text, expected):
    (tmp_path / relative).parent.mkdir()
    (tmp_path / relative).write_text(text + "\n", encoding="utf-8")
    found = violations(tmp_path)
    assert len(found) == 1 and expected in found[0]


def test_the_check_lets_the_allowed_direction_pass(tmp_path):
    (tmp_path / "app").mkdir()
    (tmp_path / "app" / "a.cpp").write_text('#include "navigator.hpp"\n#include "recognise/surf.hpp"\n', encoding="utf-8")
    assert violations(tmp_path) == []
