"""The files of firmware/interface keep their rules, the checks see what breaks them, and the generated documents are fresh."""

import subprocess
import sys

import pytest

from noctule.generate import InterfaceError, lcm, parameters, streams
from noctule.generate.__main__ import products
from noctule.generate.units import name_matches_unit

GOOD_ROW = """
[gate_sigma]
param = "GATE"
type = "float"
unit = "sigma"
default = 4.0
min = 2.0
max = 10.0
doc = "Gate."
source = "docs/maths/altitude.md"
"""


def load_parameters(tmp_path, text):
    path = tmp_path / "parameters.toml"
    path.write_text(text, encoding="utf-8")
    return parameters.load(path)


def test_every_parameter_of_the_project_is_valid():
    rows = parameters.load()
    assert len({row.param for row in rows}) == len(rows)
    assert all(row.min <= row.default <= row.max for row in rows)


def test_a_good_row_is_read_as_it_stands(tmp_path):
    (row,) = load_parameters(tmp_path, GOOD_ROW + "paper = 3.0\nreboot = true\n")
    assert (row.name, row.param, row.default, row.min, row.max) == ("gate_sigma", "GATE", 4.0, 2.0, 10.0)
    assert row.presets == (("paper", 3.0),) and row.reboot


@pytest.mark.parametrize(
    "old, new, expected",
    [
        ('doc = "Gate."\n', "", "no field 'doc'"),
        ("default = 4.0", "default = 11.0", "outside"),
        ("default = 4.0", "default = nan", "not finite"),
        ("default = 4.0", 'default = "4"', "not a number"),
        ('"GATE"', '"GATE_OF_SEVENTEEN"', "over 16"),
        ('"GATE"', '"gate"', "A-Z"),
        ('unit = "sigma"', 'unit = "m"', "does not end in its unit"),
        ('unit = "sigma"', 'unit = "deg"', "unknown unit"),
        ('type = "float"', 'type = "int"', "not a whole number"),
        ('type = "float"', 'type = "bool"', "neither float nor int"),
        ("min = 2.0", "min = 12.0", "min over max"),
        ("max = 10.0", "max = 10.0\npaper = 1.0", "paper 1.0 outside"),
        ("max = 10.0", "max = 10.0\nmaximum = 1.0", "unknown field 'maximum'"),
        ("[gate_sigma]", "[gate_sigma", "parameters.toml"),
    ],
)
def test_a_broken_row_is_refused_with_its_reason(tmp_path, old, new, expected):
    assert old in GOOD_ROW
    with pytest.raises(InterfaceError, match=expected) as caught:
        load_parameters(tmp_path, GOOD_ROW.replace(old, new))
    assert "\n" not in str(caught.value)


def test_an_id_may_be_used_once(tmp_path):
    with pytest.raises(InterfaceError, match=r"\[other_sigma\] uses param 'GATE', which \[gate_sigma\] has already"):
        load_parameters(tmp_path, GOOD_ROW + GOOD_ROW.replace("gate_sigma", "other_sigma"))


def test_the_crc_follows_meaning_not_comments(tmp_path):
    base = parameters.crc(load_parameters(tmp_path, GOOD_ROW))
    assert parameters.crc(load_parameters(tmp_path, "# remark\n" + GOOD_ROW.replace("Gate.", "The gate."))) == base
    assert parameters.crc(load_parameters(tmp_path, GOOD_ROW.replace("4.0", "4.5"))) != base


def test_a_noise_strength_may_be_named_before_its_unit():
    assert name_matches_unit("gyro_sigma_rad_s", "rad/s")
    assert not name_matches_unit("gyro_sigma_rad_s", "rad")
    assert not name_matches_unit("gyro_sigma_rad", "rad/s")


def test_generated_python_holds_the_table():
    namespace = {}
    rows = parameters.load()
    exec(parameters.python(rows), namespace)  # the text itself is under test
    assert namespace["CRC"] == parameters.crc(rows)
    assert namespace["DEFAULTS"] == {row.name: row.default for row in rows}
    for row in rows:
        assert namespace["PRESETS"]["paper"][row.name] == dict(row.presets).get("paper", row.default)


GOOD_MESSAGE = """package noctule;

// Walls, frame Map. Published by nav on WALLS. Read by host.
struct walls_t
{
    const int32_t MAX_WALLS = 32;

    int64_t t_us;             // [us] stamp
    float   r_m[32];          // [m] distance
    int32_t count;            // [-] valid entries
}
"""


def parse_message(tmp_path, text):
    path = tmp_path / "walls_t.lcm"
    path.write_text(text, encoding="utf-8")
    return lcm.parse(path)


def test_every_message_and_stream_of_the_project_is_valid():
    messages = lcm.load()
    assert {stream.type for stream in streams.load(messages=messages)} == set(messages), "a type without a stream"


def test_a_good_message_is_read_as_it_stands(tmp_path):
    message = parse_message(tmp_path, GOOD_MESSAGE)
    assert message.constants == (("MAX_WALLS", 32),)
    assert [(f.name, f.lengths, f.unit) for f in message.fields] == [("t_us", (), "us"), ("r_m", (32,), "m"), ("count", (), "-")]
    assert "extent_v<decltype(noctule::walls_t::r_m), 0> == noctule::walls_t::MAX_WALLS" in lcm.cpp_checks({"walls_t": message})


@pytest.mark.parametrize(
    "old, new, expected",
    [
        ("// [m] distance", "", r"starts with its \[unit\]"),
        ("// [m] distance", "// distance", r"starts with its \[unit\]"),
        ("// [m] distance", "// [m]", "says what it is"),
        ("// [m] distance", "// [rad] direction", "does not end in its unit"),
        ("float   r_m[32]; ", "string  r_m; ", "strings allocate"),
        ("float   r_m[32]; ", "float   r_m[count]; ", "literal lengths"),
        ("float   r_m[32]; ", "float   r_m[33]; ", "repeats no constant"),
        ("float   r_m[32]; ", "float   r_m; ", "no array has the length of MAX_WALLS"),
        ("int32_t count; ", "uint32_t count; ", "allowed are"),
        ("const int32_t", "const double", "must be int32_t"),
        ("Read by host.", "", "Read by"),
        ("struct walls_t", "struct wall_t", "must hold struct walls_t"),
        ("package noctule;", "package other;", "package noctule"),
    ],
)
def test_a_broken_message_is_refused_with_its_reason(tmp_path, old, new, expected):
    assert old in GOOD_MESSAGE
    with pytest.raises(InterfaceError, match=expected):
        parse_message(tmp_path, GOOD_MESSAGE.replace(old, new))


@pytest.mark.parametrize(
    "old, new, expected",
    [
        ("[WALLS]", "[WALLS_OF_THE_MAP]", "at most 15"),
        ("[WALLS]", "[walls]", "upper-case"),
        ('type = "walls_t"', 'type = "wall_t"', "no .lcm file defines"),
        ("rate_hz = 2\n", "", "no field 'rate_hz'"),
        ('bus = "flight"', 'bus = "can"', "there are flight and camera"),
        ("log = true", "log = true\nrate = 2", "unknown field"),
    ],
)
def test_a_broken_stream_is_refused_with_its_reason(tmp_path, old, new, expected):
    good = '[WALLS]\ntype = "walls_t"\nrate_hz = 2\nfrom = "nav"\nto = ["host"]\nbus = "flight"\nlog = true\n'
    path = tmp_path / "streams.toml"
    path.write_text(good, encoding="utf-8")
    assert streams.load(path, messages=("walls_t",))[0].channel == "WALLS"
    assert old in good
    path.write_text(good.replace(old, new), encoding="utf-8")
    with pytest.raises(InterfaceError, match=expected):
        streams.load(path, messages=("walls_t",))


def test_python_types_travel(tmp_path):
    """Generated Python packs and unpacks, and its fingerprint is that of the type, whatever the package is called."""
    lcm.generate_python(tmp_path)
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from noctule_lcm import range_t\n"
        "m = range_t(); m.t_us = 2**40; m.seq = 7\n"
        "back = range_t.decode(m.encode())\n"
        "assert (back.t_us, back.seq) == (2**40, 7)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize("path, text", products().items(), ids=lambda v: getattr(v, "name", ""))
def test_generated_documents_are_fresh(path, text):
    assert path.read_text(encoding="utf-8") == text, f"{path.name} is stale: .venv/bin/python -m noctule.generate docs"
