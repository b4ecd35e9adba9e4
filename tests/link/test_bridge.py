"""The real noctule-bridge between a fake autopilot, a fake nav and a fake ground station."""

import json
import subprocess
import time

import pytest
from bridge_peers import BUILD, COMPANION, LAND, OFFBOARD, POSITION, SYSTEM, Peers, mavlink

BRIDGE = BUILD / "bin" / "noctule-bridge"


def setpoints(peers):
    return Peers.of(peers.at_autopilot, "SET_POSITION_TARGET_LOCAL_NED")


def test_a_ground_station_starts_follows_and_ends_a_mission(tmp_path):
    with Peers(tmp_path) as peers:
        assert peers.start()
        beats = [m for m in Peers.of(peers.at_ground, "HEARTBEAT") if m.get_srcComponent() == COMPANION]
        assert beats[-1].get_srcSystem() == SYSTEM and beats[-1].autopilot == mavlink.MAV_AUTOPILOT_INVALID
        assert peers.orders == [1]
        assert peers.vehicle[-1].armed == 1 and peers.vehicle[-1].offboard == 1 and peers.vehicle[-1].landed == 2
        # A step to the left and up in Map is a step to negative y and z in NED; one setpoint a tick.
        before = len(setpoints(peers))
        peers.nav.setpoint_y_m, peers.nav.setpoint_z_m, peers.nav.setpoint_yaw_rad = 0.5, 1.25, 1.0
        peers.run(2.0)
        sent = setpoints(peers)
        assert abs(len(sent) - before - 40) <= 1
        assert (sent[-1].type_mask, sent[-1].coordinate_frame, sent[-1].target_system) == (0x0800, mavlink.MAV_FRAME_LOCAL_NED, SYSTEM)
        assert (sent[-1].y, sent[-1].z, round(sent[-1].yaw, 5)) == (-0.5, -1.25, -1.0)
        odometry = Peers.of(peers.at_autopilot, "ODOMETRY")[-1]
        assert (odometry.frame_id, odometry.child_frame_id) == (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD)
        assert odometry.time_usec == peers.t_us and odometry.quality == 90
        # The autopilot's traffic reaches the ground station; its commands reach the autopilot.
        assert len(Peers.of(peers.at_ground, "LOCAL_POSITION_NED")) > 100
        assert {m.name for m in Peers.of(peers.at_ground, "NAMED_VALUE_FLOAT")} >= {"area_m2", "quality"}
        home = mavlink.MAVLink_command_long_message(SYSTEM, 1, mavlink.MAV_CMD_DO_SET_HOME, 0, 1, 0, 0, 0, 0, 0, 0)
        peers.ground.send(home.pack(peers.ground_mav))
        assert peers.run(1.0, lambda: any(m.command == mavlink.MAV_CMD_DO_SET_HOME for m in Peers.of(peers.at_autopilot, "COMMAND_LONG")))
        peers.nav.state, peers.nav.reason, peers.nav.setpoint_valid, peers.nav.want_disarm = 6, 11, 0, 1
        peers.landed = 1
        assert peers.run(5.0, lambda: not peers.armed)
        peers.run(1.0)
        assert peers.said("landed: on the ground")
        assert peers.unanswered == 0
        # Every inertial sample arrived, once and in order.
        assert [m.seq for m in peers.imu] == list(range(1, len(peers.imu) + 1))
        assert peers.stop() == 0
        stats = json.loads(peers.stats.read_text())
        assert stats["imu"] == len(peers.imu) and stats["undecodable"] == 0 and stats["publish_failed"] == 0
        if stats["heap_allocations_after_start"] is not None:
            assert stats["heap_allocations_after_start"] == 0


def test_garbage_and_five_percent_loss_do_not_stop_a_mission(tmp_path):
    with Peers(tmp_path, loss=0.05, garbage=0.05) as peers:
        assert peers.start()
        peers.run(10.0)
        assert peers.mode == OFFBOARD and peers.armed                     # neither held nor yielded
        assert len(setpoints(peers)) > 250
        assert peers.vehicle[-1].mission_lost == 0
        stamps = [m.t_us for m in peers.imu]
        assert stamps == sorted(set(stamps))
        assert peers.stop() == 0
        stats = json.loads(peers.stats.read_text())
        assert stats["skipped_bytes"] > 1000


def test_when_nav_dies_the_bridge_lands_and_says_why(tmp_path):
    with Peers(tmp_path) as peers:
        assert peers.start()
        peers.nav_runs = False
        assert peers.run(6.0, lambda: peers.mode == LAND)
        peers.run(1.0)
        assert peers.said("holding position: nav silent") and peers.said("landing: nav silent")
        assert peers.vehicle[-1].mission_lost == 1


def test_the_pilot_takes_over(tmp_path):
    with Peers(tmp_path) as peers:
        assert peers.start()
        peers.mode = POSITION
        peers.run(1.5)
        before = len(setpoints(peers))
        peers.run(5.0)
        assert len(setpoints(peers)) == before and peers.mode == POSITION
        assert peers.vehicle[-1].mission_lost == 1
        assert peers.said("yielded, mode is POSITION")


def test_a_peer_that_is_missing_is_named_in_one_line(tmp_path):
    with Peers(tmp_path) as peers:
        deadline = time.monotonic() + 8.0
        while time.monotonic() < deadline and peers.log.read_text().count("\n") < 2:
            time.sleep(0.1)
        lines = peers.log.read_text().splitlines()
        assert len(lines) == 2
        assert "no autopilot on udpin" in lines[0] and "noctule-nav" in lines[1]
        assert peers.stop() == 0


@pytest.mark.parametrize("arguments, words", [
    (["--autopilot", "tcp:127.0.0.1:5760"], "is no endpoint"),
    (["--autopilot", "udpin:127.0.0.1:0"], "is no endpoint"),
    (["--ground", "udpout:somewhere:14550"], "is no endpoint"),
    (["--parameters", "absent.toml"], "absent.toml"),
])
def test_bad_options_give_one_line_and_exit_2(arguments, words, tmp_path):
    done = subprocess.run([str(BRIDGE), *arguments], capture_output=True, text=True, timeout=10, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.parametrize("line, words", [
    ("speed_max_m_s = 99.0", "out of range"),
    ("speed_max_m_s = 'fast'", "must be a number"),
    ("no_such_parameter = 1", "is no parameter"),
    ("speed_max_m_s = ", ":2:"),
])
def test_a_bad_parameter_file_gives_one_line_with_its_line_number(line, words, tmp_path):
    (tmp_path / "p.toml").write_text("# comment\n" + line + "\n")
    done = subprocess.run([str(BRIDGE), "--parameters", "p.toml"], capture_output=True, text=True, timeout=10, cwd=tmp_path)
    assert done.returncode == 2
    assert "p.toml:2:" in done.stderr and words in done.stderr and done.stderr.count("\n") == 1
