import json
import math
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from fixture import hall
from noctule_sim.__main__ import main, parse_faults
from noctule_sim.autopilot import Mode
from noctule_sim.mavlink import MavlinkLink, custom_mode, mode_of, odometry_from
from noctule_sim.run import Runner, ScanEncoder
from noctule_sim.simulation import Simulation


class Companion(threading.Thread):
    """Answers each tick with an ODOMETRY of its time, as if standing at the start; keeps all it heard, tick by tick."""

    def __init__(self, silent_after_s=math.inf):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.2)
        self.port = self.socket.getsockname()[1]
        self.link = mav.MAVLink(None, srcSystem=1, srcComponent=191)
        self.ticks, self.current, self.acks = [], [], []
        self.silent_after_s, self.done = silent_after_s, False
        self.orders = {}      # tick number -> messages to send before the answer

    def say(self, message):
        self.socket.sendto(message.pack(self.link), self.peer)
        self.link.seq = (self.link.seq + 1) & 255

    def run(self):
        while not self.done:
            try:
                data, self.peer = self.socket.recvfrom(65536)
            except TimeoutError:
                continue
            for m in self.link.parse_buffer(data) or []:
                self.current.append(m)
                if m.get_type() == "HEARTBEAT" and not self.ticks:
                    self.say(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
                if m.get_type() == "HIGHRES_IMU" and m.time_usec % 50_000 == 0:
                    self.ticks.append(self.current)
                    self.current = []
                    for order in self.orders.get(len(self.ticks), []):
                        self.say(order)
                    if m.time_usec * 1e-6 <= self.silent_after_s:
                        self.say(mav.MAVLink_odometry_message(m.time_usec, mav.MAV_FRAME_LOCAL_FRD, mav.MAV_FRAME_BODY_FRD, 0, 0, -0.12, [1, 0, 0, 0],
                                                              0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21, 0, mav.MAV_ESTIMATOR_TYPE_VISION, 90))


def fly(companion, seconds, folder=None, **settings):
    companion.start()
    runner = Runner(Simulation(hall(), max_time_s=seconds, **settings), companion.port, "memq://", folder=folder)
    runner.run()
    companion.done = True
    companion.join()
    return runner


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    companion = Companion()
    arm = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    mode = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, 6, 0, 0, 0, 0, 0)
    strange = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_NAV_SPLINE_WAYPOINT, 0, 1, 0, 0, 0, 0, 0, 0)
    companion.orders = {10: [arm], 40: [mode], 60: [strange], 70: [mav.MAVLink_timesync_message(0, 1234)]}
    target = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, mav.MAV_FRAME_LOCAL_NED, 0x09C0, 0, 0, -1.0, 0, 0, 0, 0, 0, 0, 0, 0)
    for k in range(41, 140):
        companion.orders.setdefault(k, []).append(target)
    companion.orders[90] = [mode, arm]
    return companion, fly(companion, 7.0, folder), folder


def test_a_tick_ends_with_the_inertial_sample_of_its_time_and_is_in_order(flown):
    companion, runner, _ = flown
    assert not runner.lockstep_broken
    assert len(companion.ticks) == 140
    for number, tick in enumerate(companion.ticks, 1):
        assert tick[-1].get_type() == "HIGHRES_IMU" and tick[-1].time_usec == number * 50_000
        assert tick[-2].get_type() == "ATTITUDE_QUATERNION" and tick[-2].time_boot_ms == number * 50
        kinds = [m.get_type() for m in tick]
        assert kinds.count("DISTANCE_SENSOR") == 2 and kinds.count("LOCAL_POSITION_NED") == 1
        times = [m.time_usec for m in tick if m.get_type() == "HIGHRES_IMU"]
        assert [m.time_usec for m in tick if m.get_type() == "HIGHRES_IMU" and m.fields_updated & 0x0800] == times[-1:]  # the pressure
        assert times == sorted(times) and 12 <= len(times) <= 13


def test_frames_on_the_wire_are_forward_right_down(flown):
    companion, _, _ = flown
    imu = companion.ticks[5][-1]
    assert imu.zacc == pytest.approx(-9.81, abs=0.2)
    down = [m for m in companion.ticks[139] if m.get_type() == "DISTANCE_SENSOR" and m.orientation == 25][0]
    assert (down.min_distance, down.max_distance) == (10, 1200)
    local = next(m for m in companion.ticks[8] if m.get_type() == "LOCAL_POSITION_NED")
    assert local.z == pytest.approx(-0.12, abs=0.03)


def test_commands_are_answered(flown):
    companion, _, _ = flown
    acks = [(m.command, m.result) for tick in companion.ticks for m in tick if m.get_type() == "COMMAND_ACK"]
    assert acks[0] == (mav.MAV_CMD_COMPONENT_ARM_DISARM, mav.MAV_RESULT_TEMPORARILY_REJECTED)      # not steady yet
    assert acks[1] == (mav.MAV_CMD_DO_SET_MODE, mav.MAV_RESULT_TEMPORARILY_REJECTED)               # no setpoints yet
    assert acks[2] == (mav.MAV_CMD_NAV_SPLINE_WAYPOINT, mav.MAV_RESULT_UNSUPPORTED)
    assert acks[3:] == [(mav.MAV_CMD_DO_SET_MODE, 0), (mav.MAV_CMD_COMPONENT_ARM_DISARM, 0)]
    texts = [m.text for tick in companion.ticks for m in tick if m.get_type() == "STATUSTEXT"]
    assert any("Arming denied" in t for t in texts)
    assert any(m.ts1 == 1234 and m.tc1 > 0 for tick in companion.ticks for m in tick if m.get_type() == "TIMESYNC")
    beats = [m for tick in companion.ticks for m in tick if m.get_type() == "HEARTBEAT"]
    assert beats[-1].base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED and beats[-1].custom_mode == 6 << 16


def test_truth_and_summary_are_written(flown):
    _, runner, folder = flown
    rows = (folder / "truth.csv").read_text().splitlines()
    assert rows[0].startswith("t_s,x_m,y_m,z_m,yaw_rad") and len(rows) == 141
    assert all(row.count(",") == rows[0].count(",") for row in rows)
    summary = json.loads((folder / "sim.json").read_text())
    assert summary["outcome"] == "max_time" and summary["lockstep_broken"] is False and summary["odometry_used"] > 130


def test_a_companion_that_falls_silent_breaks_the_lockstep_and_the_flight_goes_on():
    runner = fly(Companion(silent_after_s=0.5), 1.0)
    assert runner.lockstep_broken and runner.simulation.t_us == 1_000_000


def test_odometry_is_turned_into_map():
    half = math.radians(90) / 2
    message = mav.MAVLink_odometry_message(5, mav.MAV_FRAME_LOCAL_FRD, mav.MAV_FRAME_BODY_FRD, 1, -2, -3, [math.cos(half), 0, 0, -math.sin(half)],
                                           0.5, 0, 0, 0, 0, 0, [0] * 21, [0] * 21, 3, 6, 70)
    o = odometry_from(message)
    assert (o.x_m, o.y_m, o.z_m, o.yaw_rad) == pytest.approx((1, 2, 3, math.radians(90)))
    assert (o.vx_m_s, o.vy_m_s, o.vz_m_s) == pytest.approx((0, 0.5, 0), abs=1e-9)
    assert (o.quality, o.reset_counter, o.t_us) == (70, 3, 5)
    message.frame_id = mav.MAV_FRAME_BODY_FRD
    assert odometry_from(message) is None


def test_ardupilot_takes_odometry_in_one_pair_of_frames_only():
    for frame, child, px4, ardupilot in ((20, 12, True, True), (1, 12, True, False), (20, 8, True, False), (20, 20, True, False), (12, 12, False, False)):
        message = mav.MAVLink_odometry_message(5, frame, child, 1, -2, -3, [1, 0, 0, 0], 0.5, 0, 0, 0, 0, 0, [0] * 21, [0] * 21, 3, 6, 70)
        assert (odometry_from(message, "px4") is not None, odometry_from(message, "ardupilot") is not None) == (px4, ardupilot), (frame, child)


def test_px4_takes_no_odometry_of_a_lidar():
    for flavour, estimator, taken in (("px4", 7, 0), ("px4", 2, 1), ("px4", 0, 1), ("ardupilot", 7, 1)):
        simulation = Simulation(hall(), flavour=flavour)
        link = MavlinkLink(simulation, 9)
        message = mav.MAVLink_odometry_message(5, 20, 12, 1, -2, -3, [1, 0, 0, 0], 0.5, 0, 0, 0, 0, 0, [0] * 21, [0] * 21, 3, estimator, 70)
        assert link._handle(message, 5)                     # the tick ends all the same
        assert simulation.odometry_received == taken and bool(link._outbox) != bool(taken)
        link.close()


@pytest.mark.parametrize("flavour, frame, wanted", [
    # At (1, 2, 3) with the nose to the left: what a target of 0.5 m north, 0.2 m/s north, becomes. None: not taken.
    ("px4", 1, (0.5, 0, 0, 0.2, 0)), ("px4", 8, (1, 2, 3, 0, 0.2)), ("px4", 7, None), ("px4", 20, None),
    ("ardupilot", 1, (0.5, 0, 0, 0.2, 0)), ("ardupilot", 7, (1.5, 2, 3, 0.2, 0)), ("ardupilot", 8, (1, 2.5, 3, 0, 0.2)), ("ardupilot", 9, (1, 2.5, 3, 0, 0.2)),
    ("ardupilot", 20, "stops"), ("ardupilot", 12, "stops"),
])
def test_setpoint_frames_are_taken_as_the_real_ones_take_them(flavour, frame, wanted):
    simulation = Simulation(hall(), flavour=flavour)
    link = MavlinkLink(simulation, 9)
    autopilot = simulation.autopilot
    e = autopilot.estimator
    e.x, e.y, e.z, e.qw, e.qz = 1.0, 2.0, 3.0, math.sqrt(0.5), math.sqrt(0.5)
    autopilot.mode = Mode.offboard
    link._handle(mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, 0x0DC0, 0.5, 0, 0, 0.2, 0, 0, 0, 0, 0, 0, 0), None)
    for _, action in simulation._pending:
        action()
    link.close()
    got = autopilot._setpoint
    if wanted is None:
        assert got is None
    elif wanted == "stops":
        assert (got.x, got.y, got.z, got.vx) == (1.0, 2.0, 3.0, 0.0)
    else:
        assert (got.x, got.y, got.z, got.vx, got.vy) == pytest.approx(wanted)


def test_modes_have_the_flavours_numbers():
    assert custom_mode("px4", Mode.offboard) == 6 << 16 and custom_mode("px4", Mode.land) == 4 << 16 | 6 << 24
    assert custom_mode("ardupilot", Mode.offboard) == 4 and custom_mode("ardupilot", Mode.land) == 9
    assert mode_of("px4", 4, 6) is Mode.land and mode_of("px4", 6, 0) is Mode.offboard and mode_of("px4", 7, 0) is None
    assert mode_of("ardupilot", 4, 0) is Mode.offboard


def test_garbage_on_the_wire_harms_nothing():
    simulation = Simulation(hall())
    link = MavlinkLink(simulation, 9)
    port = link.socket.getsockname()[1]
    rng = np.random.default_rng(2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(50):
            out.sendto(b"\xfd" + rng.bytes(60), ("127.0.0.1", port))
        sender = mav.MAVLink(None, srcSystem=1, srcComponent=191)
        nan = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x09C0, math.nan, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        out.sendto(nan.pack(sender), ("127.0.0.1", port))
    link.receive(0.1, None)
    simulation.tick()
    assert math.isfinite(simulation.autopilot.estimator.x)
    link.close()


def test_scan_bytes_are_what_the_generated_type_reads():
    from noctule_lcm import scan_t

    simulation = Simulation(hall())
    scan = simulation.tick().scan_m
    message = getattr(scan_t, "scan_t", scan_t).decode(ScanEncoder(simulation).encode(50_000, 3, scan))
    assert (message.t_us, message.seq, message.count) == (50_000, 3, 1080)
    assert np.array_equal(np.array(message.range_m[:1080], np.float32), scan, equal_nan=True)
    assert math.isnan(message.range_m[1080])
    first_us = message.t_us - (message.count - 1) * message.time_increment_us
    assert first_us == pytest.approx(50_000 - 37_500, abs=50)


@pytest.mark.parametrize("arguments, part", [
    (["atlantis"], "no world"), (["maze_a", "--fault", "gremlins@3"], "--fault"), (["maze_a", "--fault", "odometry-cut"], "--fault"),
    (["maze_a", "--param", "HULL_RADIUS"], "--param"), (["maze_a", "--param", "NO_SUCH=1"], "no parameter"), (["maze_a", "--seed", "-1"], "--seed"),
    (["maze_a", "--max-time", "0"], "--max-time"),
])
def test_bad_input_is_one_line_and_exit_2(arguments, part, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert part in said and said.count("\n") == 1


def test_faults_are_read():
    assert parse_faults(["odometry-cut@30", "imu-50hz@0"]) == {"odometry-cut": 30.0, "imu-50hz": 0.0}


def test_it_runs_alone_in_real_time():
    done = subprocess.run([sys.executable, "-m", "noctule_sim", "maze_a", "--realtime", "--max-time", "0.5", "--lcm-url", "memq://"],
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "0.5 s" in done.stdout
