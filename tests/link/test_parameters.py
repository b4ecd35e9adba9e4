"""The parameter table over the real noctule-bridge: lost packets, two ground stations, bad values, a restart."""

import struct
import subprocess

import pytest
from bridge_peers import BUILD, COMPANION, SYSTEM, Peers, mavlink

from noctule import params_gen

CHANGED = 0.625


def companion_values(messages):
    return [m for m in Peers.of(messages, "PARAM_VALUE") if m.get_srcComponent() == COMPANION]


def number(m):
    """The value of a PARAM_VALUE in PX4's encoding."""
    return m.param_value if m.param_type == mavlink.MAV_PARAM_TYPE_REAL32 else struct.unpack("<i", struct.pack("<f", m.param_value))[0]


def read_all(peers, store, second):
    """As ground stations do it: ask for the list, then for what is missing."""
    peers.say(mavlink.MAVLink_param_request_list_message(SYSTEM, COMPANION), second)
    have = {}
    for _ in range(30):
        peers.run(1.0)
        have = {m.param_index: m for m in companion_values(store)}
        missing = [i for i in range(len(params_gen.TABLE)) if i not in have]
        if not missing:
            return have
        for index in missing[:40]:
            peers.say(mavlink.MAVLink_param_request_read_message(SYSTEM, COMPANION, b"", index), second)
    return have


def write(peers, name, value, kind=mavlink.MAV_PARAM_TYPE_REAL32):
    message = mavlink.MAVLink_param_set_message(SYSTEM, COMPANION, name.encode(), value, kind)
    peers.say(message)
    return message


def newest(peers, name):
    found = [m for m in companion_values(peers.at_ground) if m.param_id == name]
    return number(found[-1]) if found else None


def seen_by_second(peers, value):
    return any(m.param_id == "SPEED_MAX" and m.param_value == value for m in companion_values(peers.at_second))


def test_two_ground_stations_read_the_whole_table_over_lossy_links(tmp_path):
    with Peers(tmp_path, loss=0.05, second_ground=True) as peers:
        peers.run(1.0)
        peers.say(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), second=True)
        for store, second in ((peers.at_ground, False), (peers.at_second, True)):
            have = read_all(peers, store, second)
            assert sorted(have) == list(range(len(params_gen.TABLE)))
            for index, row in enumerate(params_gen.TABLE):
                m = have[index]
                assert m.param_id == row.param and m.param_count == len(params_gen.TABLE)
                assert m.param_type == (mavlink.MAV_PARAM_TYPE_INT32 if row.type == "int" else mavlink.MAV_PARAM_TYPE_REAL32)
                assert number(m) == pytest.approx(row.default, rel=1e-6)
        # A write by one is seen by both, and by nav.
        for _ in range(20):
            write(peers, "SPEED_MAX", CHANGED)
            if peers.run(0.5, lambda: newest(peers, "SPEED_MAX") == CHANGED and seen_by_second(peers, CHANGED)):
                break
        assert newest(peers, "SPEED_MAX") == CHANGED and seen_by_second(peers, CHANGED)
        peers.run(1.0)
        assert peers.values["speed_max_m_s"] == CHANGED


def test_a_bad_value_is_refused_in_words(tmp_path):
    with Peers(tmp_path) as peers:
        peers.run(1.0)
        write(peers, "SPEED_MAX", 99.0)
        assert peers.run(1.0, lambda: bool(Peers.of(peers.at_ground, "PARAM_ERROR")))
        assert Peers.of(peers.at_ground, "PARAM_ERROR")[0].error == 2                      # VALUE_OUT_OF_RANGE
        assert peers.said("SPEED_MAX refused:")
        assert newest(peers, "SPEED_MAX") == params_gen.BY_NAME["speed_max_m_s"].default
        assert peers.tables == []


def test_what_was_written_outlives_the_bridge_and_a_damaged_file_is_named(tmp_path):
    store = tmp_path / "stored.toml"
    with Peers(tmp_path, options=("--store", str(store))) as peers:
        peers.run(1.0)
        write(peers, "SPEED_MAX", CHANGED)
        assert peers.run(2.0, lambda: peers.values["speed_max_m_s"] == CHANGED)
        write(peers, "HULL_RADIUS", 0.25)
        assert peers.run(2.0, lambda: peers.said("HULL_RADIUS takes effect at the next start"))
        assert peers.values["hull_radius_m"] == params_gen.BY_NAME["hull_radius_m"].default
        assert peers.stop() == 0
    assert "speed_max_m_s = 0.625" in store.read_text() and "hull_radius_m = 0.25" in store.read_text()
    assert not store.with_name("stored.toml.new").exists()
    with Peers(tmp_path, options=("--store", str(store))) as peers:
        peers.run(1.0)
        peers.say(mavlink.MAVLink_param_request_read_message(SYSTEM, COMPANION, b"HULL_RADIUS", -1))
        assert peers.run(1.0, lambda: newest(peers, "HULL_RADIUS") == 0.25)
        # nav started without the file: it is told the value, and flies it.
        assert peers.run(3.0, lambda: peers.values["speed_max_m_s"] == CHANGED)
        # Back to the start value: the row leaves the file.
        write(peers, "SPEED_MAX", params_gen.BY_NAME["speed_max_m_s"].default)
        assert peers.run(2.0, lambda: "speed_max" not in store.read_text())
        assert peers.stop() == 0
    store.write_text("hull_radius_m = 0.25\nspeed_max_m_s = 99\n")
    done = subprocess.run([str(BUILD / "bin" / "noctule-bridge"), "--store", str(store)], capture_output=True, text=True, timeout=10)
    assert done.returncode == 2 and "stored.toml:2:" in done.stderr
