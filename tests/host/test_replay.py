"""`noctule replay`: a flight's log gives the same messages again; whatever is wrong with a log is said and ends nothing."""

import shutil
import struct

import pytest

from noctule import cli, record, replay
from noctule.settings import FlightSettings

FLIGHT_S = 6.0


def built() -> bool:
    try:
        from noctule.localise import library

        library()
    except Exception:
        return False
    return True


pytestmark = pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A short flight through the in-process loop, with a parameter that is not the default's."""
    from noctule_sim.world import load_world

    from noctule import inprocess_flight

    folder = tmp_path_factory.mktemp("runs") / "maze"
    settings = FlightSettings(world="maze_a", seed=5, camera=False, max_time_s=FLIGHT_S, parameters={"particles": 60}, out=folder)
    inprocess_flight.fly(settings, load_world("maze_a"), folder)
    return folder


@pytest.fixture
def flight(run_folder, tmp_path):
    """A copy of it that a test may damage."""
    return shutil.copytree(run_folder, tmp_path / "flight")


def rewrite(folder, change):
    """Writes the log anew; change(channel, bytes) gives bytes, or None to leave the event out."""
    events = replay.read_flight_log(folder / "flight.lcm").events
    out = bytearray()
    for n, (channel, data) in enumerate(events):
        data = change(channel, data)
        if data is not None:
            name = channel.encode()
            out += replay.MAGIC + struct.pack(">qqii", n, n, len(name), len(data)) + name + data
    (folder / "flight.lcm").write_bytes(out)


def nth(channel_wanted, n, action):
    """A change that acts on the n-th message of a channel only."""
    count = -1

    def change(channel, data):
        nonlocal count
        count += channel == channel_wanted
        return action(data) if channel == channel_wanted and count == n else data

    return change


def test_a_flight_is_repeated_bit_for_bit(run_folder, capsys):
    assert cli.main(["replay", str(run_folder)]) == 0
    out = capsys.readouterr().out
    steps = round(FLIGHT_S / 0.05)
    assert out.splitlines()[-1] == "equal"
    assert f"{steps} steps" in out and f"{steps} NAV" in out and "note:" not in out
    result = replay.replay_flight(run_folder / "flight.lcm")
    assert result.compared["ODOM"] > 2 * steps and result.compared["GRID_TILE"] > 0


def test_the_log_reader_agrees_with_lcms_own(run_folder):
    own = replay.read_flight_log(run_folder / "flight.lcm")
    assert own.events == [(c, d) for c, _, d in record.events(run_folder / "flight.lcm")]
    assert not own.cut and own.damaged_bytes == 0


def test_another_parameter_gives_a_difference_that_is_named(run_folder, capsys):
    assert cli.main(["replay", str(run_folder), "--param", "particles=20"]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("first difference: NAV ") and "logged" in last


def test_the_parameters_beside_the_log_count(flight):
    assert replay.replay_flight(flight / "flight.lcm").equal
    (flight / "parameters.toml").unlink()
    result = replay.replay_flight(flight / "flight.lcm")
    assert not result.equal and any("no parameters.toml" in note for note in result.notes)


def test_one_flipped_bit_of_a_pose_is_found(flight):
    def flip(data):
        changed = bytearray(data)
        changed[8 + 8 + 4 + 4 + 4 + 3] ^= 1          # last bit of x_m: fingerprint, t_us, seq, scan_seq, parameters_crc
        return bytes(changed)

    rewrite(flight, nth("NAV", 40, flip))
    result = replay.replay_flight(flight / "flight.lcm")
    assert not result.equal
    assert result.difference.channel == "NAV" and result.difference.seq == 40 and result.difference.what.startswith("x_m is")


def test_step_time_may_differ(flight):
    rewrite(flight, nth("NAV", 40, lambda data: data[:-4] + struct.pack(">f", 123.0)))
    assert replay.replay_flight(flight / "flight.lcm").equal


def test_odometry_between_scans_is_compared(flight):
    rewrite(flight, nth("ODOM", 100, lambda data: data[:-1] + bytes([data[-1] ^ 1])))      # reset_counter
    difference = replay.replay_flight(flight / "flight.lcm").difference
    assert difference.channel == "ODOM" and "reset_counter" in difference.what


def test_a_cut_log_is_repeated_as_far_as_it_goes(flight, capsys):
    log = flight / "flight.lcm"
    log.write_bytes(log.read_bytes()[:-1500])
    assert cli.main(["replay", str(log)]) == 0
    out = capsys.readouterr().out
    assert "cut short" in out and out.splitlines()[-1] == "equal"


def test_missing_inputs_are_noted_as_a_gap_and_not_called_equal(flight):
    rewrite(flight, nth("IMU", 700, lambda _: None))
    result = replay.replay_flight(flight / "flight.lcm")
    assert not result.equal
    assert any(note.startswith("IMU: 1 gap in its sequence numbers, 1 messages missing") for note in result.notes)


def test_a_missing_scan_ends_the_comparison_with_a_reason(flight):
    rewrite(flight, nth("SCAN", 50, lambda _: None))
    result = replay.replay_flight(flight / "flight.lcm")
    assert not result.equal and result.difference.seq == 50 and "lacks" in result.difference.what
    assert result.compared["NAV"] == 50


def test_damage_in_the_middle_is_stepped_over_and_counted(flight):
    log = flight / "flight.lcm"
    data = log.read_bytes()
    at = data.index(replay.MAGIC, len(data) // 2)
    log.write_bytes(data[:at] + b"\0" * 37 + data[at:])
    result = replay.replay_flight(log)
    assert result.equal and any("37 bytes" in note for note in result.notes)


def test_the_order_of_the_recorder_does_not_matter(flight):
    """Bus and recorder may hear nav before the laser: a NAV logged ahead of its scan is still repeated."""
    events = replay.read_flight_log(flight / "flight.lcm").events
    scan = max(i for i, (c, _) in enumerate(events[:3000]) if c == "SCAN")
    nav = next(i for i in range(scan, len(events)) if events[i][0] == "NAV")
    order = list(range(len(events)))
    order.insert(nav + 2, order.pop(scan))
    out = bytearray()
    for i in order:
        channel, data = events[i]
        out += replay.MAGIC + struct.pack(">qqii", i, i, len(channel), len(data)) + channel.encode() + data
    (flight / "flight.lcm").write_bytes(out)
    assert replay.replay_flight(flight / "flight.lcm").equal


BAD = [("missing.lcm", None, "no such file"), ("empty.lcm", b"", "no FLASER"), ("other.lcm", replay.MAGIC, "no NAV in it")]


@pytest.mark.parametrize("name, content, expected", BAD)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, monkeypatch, capsys, name, content, expected):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert cli.main(["replay", name]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and expected in err
    assert not (tmp_path / "runs").exists()


def test_an_unknown_parameter_beside_the_log_is_refused(flight, capsys):
    (flight / "parameters.toml").write_text("no_such = 1.0\n")
    assert cli.main(["replay", str(flight)]) == 2
    assert "no parameter no_such" in capsys.readouterr().err


def test_relations_do_not_go_with_a_flight(run_folder, capsys):
    assert cli.main(["replay", str(run_folder), "--relations", "x"]) == 2
    assert "CARMEN" in capsys.readouterr().err
