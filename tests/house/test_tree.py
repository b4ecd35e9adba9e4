"""What keeps the tree readable: short files, nothing left unfinished, no room for odds and ends."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("firmware", "host", "sim")
MAX_LINES = 600


def sources():
    """Every hand-written C++ and Python file of the product, as (path relative to the root, text)."""
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".cpp", ".hpp", ".py") and not path.stem.endswith("_gen") and "egg-info" not in str(path):
                yield path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")


def test_no_file_is_a_room_with_too_much_in_it():
    long = {path: text.count("\n") for path, text in sources() if text.count("\n") > MAX_LINES}
    assert long == {}


def test_nothing_is_left_unfinished():
    mark = re.compile(r"\b(TODO|FIXME|XXX|HACK)\b|NotImplementedError|not implemented", re.IGNORECASE)
    found = [f"{path}: {line.strip()}" for path, text in sources() for line in text.splitlines() if mark.search(line)]
    assert found == []


def test_there_is_no_folder_for_odds_and_ends():
    odd = [path for path, _ in sources() if re.search(r"/(utils?|common|misc|helpers?)(/|\.[ch]pp$|\.py$)", path)]
    assert odd == []


def test_firmware_headers_are_guarded_and_open_no_namespace():
    wrong = []
    for path, text in sources():
        if path.endswith(".hpp"):
            if "#pragma once" not in text:
                wrong.append(f"{path}: no #pragma once")
            if re.search(r"^\s*using namespace", text, re.MULTILINE):
                wrong.append(f"{path}: using namespace in a header")
    assert wrong == []
