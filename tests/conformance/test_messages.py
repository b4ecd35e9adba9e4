"""The bytes of every message between bridge and nav, as agreed: Python writes and reads them as the file says.

tests/unit/link/conformance_test.cpp does the same in C++ on the same file. A changed message type changes its bytes: then both sides,
and every recorded log, are of another version, and the file is to be written anew on purpose.
"""

import json
import math
from pathlib import Path

import noctule_lcm
import pytest

MESSAGES = json.loads((Path(__file__).parent / "messages.json").read_text())


def number(value):
    return math.nan if value == "nan" else value


@pytest.mark.parametrize("name", MESSAGES)
def test_python_writes_the_agreed_bytes(name):
    message = getattr(noctule_lcm, name)()
    fields = MESSAGES[name]["fields"]
    assert sorted(fields) == sorted(message.__slots__)       # every field has an agreed value
    for field, value in fields.items():
        setattr(message, field, number(value))
    assert message.encode().hex() == MESSAGES[name]["bytes"]


@pytest.mark.parametrize("name", MESSAGES)
def test_python_reads_the_agreed_bytes(name):
    message = getattr(noctule_lcm, name).decode(bytes.fromhex(MESSAGES[name]["bytes"]))
    for field, value in MESSAGES[name]["fields"].items():
        got = getattr(message, field)
        if value == "nan":
            assert math.isnan(got)
        else:
            assert (list(got) if isinstance(value, list) else got) == value
