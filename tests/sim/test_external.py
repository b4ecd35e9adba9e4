"""Real autopilots' physics interfaces against small peers that read and write them as the real programs do."""

import math
import re
import signal
import socket
import stat
import struct
import sys
import textwrap
import threading
import time

import pytest
from pymavlink.dialects.v20 import common as mav

from noctule_sim import sitl
from noctule_sim.autopilot import Landed
from noctule_sim.external import MOTOR_OF_ROTOR, Ardupilot, AutopilotGone, Px4, json_state
from noctule_sim.passage import AutopilotState, Passage, frames
from noctule_sim.simulation import Simulation
from noctule_sim.vehicle import Airframe

from fixture import hall

HOVER = Airframe().hover_share


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def ardupilot_reads(line):
    """One line as ArduPilot's parser takes it: search for the key, skip the quote and the colon, then scanf without leading blanks."""
    text = line.decode()
    out = {}
    for section, key, count in (("", "timestamp", 1), ("imu", "gyro", 3), ("imu", "accel_body", 3), ("", "position", 3), ("", "quaternion", 4),
                                ("", "velocity", 3), ("", "no_time_sync", 1)):
        p = text.index(section) + len(section) + 1 if section else 1
        p = text.index(key, p) + len(key) + 2
        if count == 1:
            out[key] = float(re.match(r"-?[0-9.e+-]+", text[p:])[0])
        else:
            assert text[p] == "[", f"{key}: its scanf wants the bracket at once"
            out[key] = [float(v) for v in text[p + 1:text.index("]", p)].split(",")]
            assert len(out[key]) == count
    return out


@pytest.mark.parametrize("yaw_deg, north, east", [(0, 1, 0), (90, 0, -1), (180, -1, 0), (-90, 0, 1)])
def test_json_state_turns_world_to_north_east_down(yaw_deg, north, east):
    # World is x forward, y left, z up; a vehicle that flies nose first at 2 m/s and climbs at 0.5.
    half = math.radians(yaw_deg) / 2
    speed = (2.0 * math.cos(2 * half), 2.0 * math.sin(2 * half), 0.5)
    line = json_state(2_500, (0.1, 0.2, 9.81), (0.01, 0.02, 0.03), (11.0, 22.0, 3.5), (math.cos(half), 0, 0, math.sin(half)), speed, (10.0, 20.0, 0.5))
    assert line.startswith(b"\n{") and line.endswith(b"}\n") and b": " not in line
    got = ardupilot_reads(line)
    assert got["timestamp"] == 0.0025 and got["no_time_sync"] == 1
    assert got["gyro"] == pytest.approx([0.01, -0.02, -0.03]) and got["accel_body"] == pytest.approx([0.1, -0.2, -9.81])
    assert got["position"] == pytest.approx([1.0, -2.0, -3.0])
    assert got["velocity"] == pytest.approx([2.0 * north, 2.0 * east, -0.5], abs=1e-6)
    w, x, y, z = got["quaternion"]
    nose = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z))
    assert nose == pytest.approx((north, east), abs=1e-6)


def test_motor_order_and_curve():
    # Theirs: front right, rear left, front left, rear right. Ours: front left, front right, rear right, rear left.
    a = Airframe()
    place = {0: (1, -1), 1: (-1, 1), 2: (1, 1), 3: (-1, -1)}
    assert [place[m] for m in MOTOR_OF_ROTOR] == list(zip(a.rotor_x, a.rotor_y))
    # Their spin: the first two counter-clockwise from above, so the body is turned clockwise: negative about z up.
    turned = {0: -1, 1: -1, 2: 1, 3: 1}
    assert [turned[m] for m in MOTOR_OF_ROTOR] == list(a.rotor_torque)
    external = Ardupilot(free_port())
    try:
        assert external.thrusts([1000] * 16) == [0.0] * 4 and external.thrusts([2000] * 16) == [1.0] * 4
        assert external.thrusts([900, 2300, 1500, 1000] + [0] * 12) == pytest.approx([0.35 * 0.5 + 0.65 * 0.25, 0.0, 0.0, 1.0])
    finally:
        external.close()


class FakeArduCopter(threading.Thread):
    """Sends servo outputs, waits for the state, as JSON::update does; hovers by the vertical velocity it is told."""

    def __init__(self, port, steps):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(60.0)
        self.to, self.steps, self.seen, self.repeat = ("127.0.0.1", port), steps, [], False

    def run(self):
        pwm = [1000] * 16
        for count in range(self.steps):
            packet = struct.pack("<HHI16H", 18458, 800, count, *pwm)
            self.socket.sendto(packet, self.to)
            if self.repeat and count == 5:
                self.socket.sendto(packet, self.to)     # asks again, as it does after a second of silence
            if count == self.steps - 1:
                break
            self.seen.append(ardupilot_reads(self.socket.recv(65000).split(b"\n")[1] + b"\n"))
            climb, height = -self.seen[-1]["velocity"][2], -self.seen[-1]["position"][2]
            thrust = HOVER * (1.0 + 0.8 * (1.0 - height) - 0.8 * climb)
            u = (-0.35 + math.sqrt(0.35 ** 2 + 4 * 0.65 * max(0.0, thrust))) / 1.3
            pwm = [int(1000 + 1000 * min(1.0, u))] * 16
        self.socket.close()


def test_ardupilot_flies_our_physics_in_lockstep():
    port = free_port()
    external = Ardupilot(port)
    simulation = Simulation(hall(), profile="ideal", external=external)
    external.attach(simulation)
    peer = FakeArduCopter(port, 40 * 16 + 1)
    peer.repeat = True
    peer.start()
    external.connect(lambda: None)
    ticks = [simulation.tick() for _ in range(16)]
    external.close()
    assert ticks[-1].t_us == 800_000
    assert [round(s["timestamp"] * 1e6) for s in peer.seen[:3]] == [1250, 2500, 3750]
    assert external.answers == 40 * 16 + 1 and external.repeats == 1
    assert 0.1 < ticks[-1].truth.z_m - ticks[0].truth.z_m < 1.2
    assert -peer.seen[-1]["position"][2] == pytest.approx(ticks[-1].truth.z_m - 0.12, abs=0.02)
    assert ticks[-1].scan_m is not None and len(ticks[-1].imu) == 0


def test_ardupilot_that_never_comes_or_goes_away():
    external = Ardupilot(free_port())
    with pytest.raises(AutopilotGone, match="ended with exit code 3"):
        external.connect(lambda: "arducopter ended with exit code 3")
    external.close()


class FakePx4(threading.Thread):
    """Connects, takes HIL_SENSOR, answers each but the first hundred with HIL_ACTUATOR_CONTROLS."""

    def __init__(self, port, armed=True):
        super().__init__(daemon=True)
        self.port, self.armed, self.sensors, self.distances, self.skip = port, armed, [], [], ()

    def run(self):
        out = mav.MAVLink(None, srcSystem=1)
        with socket.create_connection(("127.0.0.1", self.port)) as stream:
            reader = mav.MAVLink(None)
            while True:
                try:
                    data = stream.recv(4096)
                except OSError:
                    return
                if not data:
                    return
                for m in reader.parse_buffer(data) or []:
                    if m.get_type() == "DISTANCE_SENSOR":
                        self.distances.append(m)
                    if m.get_type() != "HIL_SENSOR":
                        continue
                    self.sensors.append(m)
                    if len(self.sensors) < 20 or len(self.sensors) in self.skip:
                        continue
                    lift = HOVER * 1.1
                    controls = [lift] * 4 + [math.nan] * 12
                    mode = mav.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
                    stream.sendall(mav.MAVLink_hil_actuator_controls_message(m.time_usec, controls, mode, 1).pack(out))


@pytest.mark.parametrize("armed", [True, False])
def test_px4_flies_our_physics(armed):
    port = free_port(socket.SOCK_STREAM)
    external = Px4(port)
    simulation = Simulation(hall(), profile="ideal", external=external)
    external.attach(simulation)
    peer = FakePx4(port, armed)
    peer.skip = (50,)                                     # one answer is left out: the flight goes on
    peer.start()
    external.connect(lambda: None)
    for _ in range(40):
        tick = simulation.tick()
        external.ranges(tick, None)
    external.close()
    peer.join(5.0)
    assert external.left_out == 1 and external.answers == 400 - 19 - 1
    first, last = peer.sensors[0], peer.sensors[-1]
    assert first.time_usec == 5000 and last.time_usec == 2_000_000
    assert first.zacc == pytest.approx(-9.81, abs=0.3) and first.fields_updated == 0x1A3F and peer.sensors[1].fields_updated == 0x3F
    baro = [m for m in peer.sensors if m.fields_updated & 0x200]
    assert len(baro) == 40 and 900.0 < baro[0].abs_pressure < 1100.0
    assert tick.truth.z_m - 0.12 > 0.3 if armed else abs(tick.truth.z_m - 0.12) < 0.02
    if armed:
        assert baro[-1].abs_pressure < baro[0].abs_pressure
    assert {d.orientation for d in peer.distances} == {24, 25} and len(peer.distances) == 80
    up, down = ([d for d in peer.distances if d.orientation == o][-1] for o in (24, 25))
    assert up.current_distance == pytest.approx(100 * tick.range_up_m, abs=1) and up.signal_quality == 100
    low = math.isnan(tick.range_down_m)                   # on its legs it is nearer than the least range
    assert down.current_distance == (0 if low else pytest.approx(100 * tick.range_down_m, abs=1)) and (down.signal_quality == 1) == low


def test_px4_that_ends_is_told():
    port = free_port(socket.SOCK_STREAM)
    external = Px4(port)
    simulation = Simulation(hall(), external=external)
    external.attach(simulation)
    with socket.create_connection(("127.0.0.1", port)):
        external.connect(lambda: None)
    with pytest.raises(AutopilotGone, match="PX4 has ended"):
        for _ in range(5):
            simulation.tick()
    external.close()


# ---------------------------------------------------------------- the MAVLink between the two


class Ends:
    """A passage with an autopilot's and a companion's socket."""

    def __init__(self, faults=(), flavour="px4"):
        self.companion = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.companion.bind(("127.0.0.1", 0))
        self.companion.settimeout(2.0)
        self.autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.autopilot.bind(("127.0.0.1", 0))
        self.autopilot.settimeout(2.0)
        port = free_port()
        self.state = AutopilotState(flavour)
        self.passage = Passage(self.state, ("udpin", "127.0.0.1", port), self.companion.getsockname()[1], lambda name: name in faults)
        self.peer = ("127.0.0.1", port)
        self.mav = mav.MAVLink(None, srcSystem=1, srcComponent=1)

    def say(self, *messages):
        self.autopilot.sendto(b"".join(m.pack(self.mav) for m in messages), self.peer)
        self.passage.receive(0.2, None)

    def close(self):
        self.companion.close()
        self.autopilot.close()
        self.passage.close()


def ids(data):
    return [f.message for f in frames(data)]


def odometry(t_us):
    return mav.MAVLink_odometry_message(t_us, 20, 12, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21, 0, 6, 90)


def test_passage_passes_both_ways_and_holds_an_answer_back():
    e = Ends()
    try:
        heartbeat = mav.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3)
        e.say(heartbeat, mav.MAVLink_extended_sys_state_message(0, 2), mav.MAVLink_local_position_ned_message(5, 1, 2, -3, 0.1, 0.2, -0.3),
              mav.MAVLink_attitude_message(5, 0, 0, 0.5, 0, 0, 0), mav.MAVLink_statustext_message(4, b"hello"), mav.MAVLink_highres_imu_message(5, *[0] * 13, 0))
        data, at = e.companion.recvfrom(65536)
        assert ids(data) == [0, 245, 32, 30, 253, 105]
        s = e.state
        assert s.armed and s.name() == "OFFBOARD" and s.landed is Landed.in_air and e.passage.imu_heard
        assert (s.estimator.x, s.estimator.y, s.estimator.z) == pytest.approx((1, -2, 3)) and s.estimator.yaw_rad == pytest.approx(-0.5)
        assert s.messages == [(4, "hello")]
        answers = mav.MAVLink(None, srcSystem=1, srcComponent=191)
        e.passage.hold_until(80_000)
        e.companion.sendto(odometry(40_000).pack(answers), at)
        assert not e.passage.receive(0.05, 50_000)          # another stamp does not answer the sweep
        e.companion.sendto(odometry(50_000).pack(answers), at)
        assert e.passage.receive(1.0, 50_000)
        e.passage.pump(79_000)
        e.autopilot.settimeout(0.05)
        with pytest.raises(TimeoutError):
            e.autopilot.recv(65536)
        e.passage.pump(80_000)
        e.autopilot.settimeout(2.0)
        assert ids(e.autopilot.recv(65536)) == [331] and ids(e.autopilot.recv(65536)) == [331]
        assert e.passage.odometry_passed == 2
    finally:
        e.close()


def test_faults_cut_streams():
    e = Ends(faults=("odometry-cut", "imu-50hz"))
    try:
        e.say(*[mav.MAVLink_highres_imu_message(5 + i, *[0] * 13, 0) for i in range(10)])
        data, at = e.companion.recvfrom(65536)
        assert ids(data) == [105, 105]
        answers = mav.MAVLink(None, srcSystem=1, srcComponent=191)
        setpoint = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x9C0, *[0.0] * 11)
        e.companion.sendto(odometry(50_000).pack(answers) + setpoint.pack(answers), at)
        assert e.passage.receive(1.0, 50_000)               # the companion has answered, the autopilot never hears it
        e.passage.pump(1_000_000)
        assert ids(e.autopilot.recv(65536)) == [84]
        assert e.passage.odometry_passed == 0 and e.passage.setpoints_passed == 1
    finally:
        e.close()


def test_frames_survive_noise_and_signatures():
    link = mav.MAVLink(None, srcSystem=7, srcComponent=9)
    link.signing.secret_key, link.signing.sign_outgoing = b"k" * 32, True
    signed = mav.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(link)
    plain = mav.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(mav.MAVLink(None, srcSystem=1))
    data = b"\x00\x11" + signed + plain + signed[:9]
    found = list(frames(data))
    assert [(f.message, f.system, f.component) for f in found] == [(0, 7, 9), (0, 1, 0)] and found[-1].end == len(data) - 9
    assert found[0].end - found[0].begin == len(signed)


# ---------------------------------------------------------------- the programs


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_shipped_parameters_each_have_a_reason(kind):
    path = sitl.parameter_file(kind)
    values = sitl.read_parameters(path)
    assert len(values) > 20
    for line in path.read_text().splitlines():
        assert not line.strip() or line.startswith("#") or re.fullmatch(r"[A-Z0-9_]+ +-?[0-9.]+ +# .+", line), line
    wanted = {"ardupilot": {"EK3_SRC1_POSXY": 6, "EK3_SRC1_YAW": 6, "VISO_TYPE": 1, "WP_YAW_BEHAVIOR": 0, "COMPASS_ENABLE": 0},
              "px4": {"EKF2_EV_CTRL": 15, "EKF2_HGT_REF": 3, "EKF2_MAG_TYPE": 5, "COM_OF_LOSS_T": 1, "COM_OBL_RC_ACT": 4}}[kind]
    assert {name: values[name] for name in wanted} == wanted


def test_bad_parameter_lines_are_named(tmp_path):
    for text in ("EKF2_EV_CTRL = 3", "EKF2_EV_CTRL", "lower 3", "ONE 1\nONE 2"):
        path = tmp_path / "x.parm"
        path.write_text(text)
        with pytest.raises(ValueError, match=r"x\.parm, line"):
            sitl.read_parameters(path)


def script(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!{sys.executable}\n" + textwrap.dedent(text))
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_a_program_that_ignores_sigterm_is_killed(tmp_path):
    binary = script(tmp_path / "arducopter", """
        import signal, sys, time
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        print(" ".join(sys.argv[1:]), flush=True)
        time.sleep(60)
        """)
    program = sitl.Program("ardupilot", binary, tmp_path / "run")
    program.start()
    deadline = time.monotonic() + 10
    while "--model" not in program.log.read_text() and time.monotonic() < deadline:
        time.sleep(0.02)
    process = program._process
    arguments = program.log.read_text()
    assert "--model JSON" in arguments and "--rate 800" in arguments and program.problem() is None
    assert "EK3_SRC1_POSXY 6\n" in (tmp_path / "run" / "defaults.parm").read_text()
    program.end()
    assert process.poll() == -signal.SIGKILL
    program.end()


def test_a_program_that_ends_is_told(tmp_path):
    binary = script(tmp_path / "build" / "bin" / "px4", "import sys; print('no such airframe'); sys.exit(3)")
    with pytest.raises(ValueError, match="name the program inside its build folder"):
        sitl.Program("px4", binary, tmp_path / "run")
    (tmp_path / "build" / "etc" / "init.d-posix").mkdir(parents=True)
    (tmp_path / "build" / "etc" / "init.d-posix" / "rcS").touch()
    program = sitl.Program("px4", binary, tmp_path / "run")
    program.start()
    deadline = time.monotonic() + 10
    while program.problem() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    assert program.problem() == "px4 ended with exit code 3: no such airframe"
    program.end()


def test_two_instances_have_their_own_ports():
    a, b = sitl.Instance("px4"), sitl.Instance("px4")
    try:
        assert a.number != b.number and not set(sitl.ports("px4", a.number)) & set(sitl.ports("px4", b.number))
    finally:
        a.release()
        b.release()


@pytest.mark.parametrize("kind, name", [("ardupilot", "arducopter"), ("px4", "px4")])
def test_without_the_program_a_flight_is_skipped(kind, name, monkeypatch, tmp_path, capsys):
    from noctule import cli
    from noctule_sim import __main__ as simulator

    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv(sitl.VARIABLE[kind], raising=False)
    assert cli.main(["fly", "maze_a", "--autopilot", kind]) == 77
    assert simulator.main(["maze_a", "--autopilot", kind]) == 77
    said = capsys.readouterr()
    assert f"skipped: no {name} found" in said.out and f"skipped: no {name} found" in said.err


def test_bad_places_are_refused():
    for text in ("udpout:1.2.3.4:5", "tcp:host", "udpin:127.0.0.1:99999"):
        with pytest.raises(ValueError, match="is wanted"):
            sitl.parse_connect(text)
