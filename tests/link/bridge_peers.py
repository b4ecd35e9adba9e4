"""Everything around a real noctule-bridge: a fake autopilot, a fake nav on LCM, a fake ground station, on loopback."""

from __future__ import annotations

import math
import os
import random
import select
import signal
import socket
import struct
import subprocess
import time
from pathlib import Path

import lcm
import noctule_lcm

os.environ.setdefault("MAVLINK20", "1")
from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

from noctule import params_gen  # noqa: E402
from noctule.processes import PortLock, lcm_url  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("NOCTULE_BUILD", ROOT / "build" / "release")).resolve()
SYSTEM, COMPANION = 7, 191
OFFBOARD, POSITION, LAND = 6 << 16, 3 << 16, 4 << 16 | 6 << 24
TICK_US = 50_000
VISION_TIME = {"ODOMETRY": "time_usec", "VISION_POSITION_ESTIMATE": "usec"}


AUTOPILOT_PARAMETERS = {"EKF2_EV_CTRL": 15, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0, "EKF2_MAG_TYPE": 5, "COM_OF_LOSS_T": 1.0}


def values_crc(values: dict[str, float]) -> int:
    """NAV.values_crc of a table of values by name: FNV-1a over the floats of the rows that need no restart, as a signed number."""
    code = 2166136261
    for row in params_gen.TABLE:
        if not row.reboot:
            for byte in struct.pack("<f", values[row.name]):
                code = (code ^ byte) * 16777619 % (1 << 32)
    return code - (1 << 32) if code >= 1 << 31 else code


class Lossy:
    """A datagram socket that loses a share of what passes, both ways, and now and then speaks garbage."""

    def __init__(self, loss: float, garbage: float, seed: int, bind_port: int = 0):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.bind(("127.0.0.1", bind_port))
        self.socket.setblocking(False)
        self.loss, self.garbage, self.random = loss, garbage, random.Random(seed)
        self.peer = None

    def send(self, data: bytes) -> None:
        if self.peer is None:
            return
        if self.random.random() < self.garbage:
            self.socket.sendto(self.random.randbytes(self.random.randrange(1, 300)) + b"\xfd", self.peer)
        if self.random.random() >= self.loss:
            self.socket.sendto(data, self.peer)

    def receive(self) -> list[bytes]:
        out = []
        while True:
            try:
                data, self.peer = self.socket.recvfrom(65536)
            except (BlockingIOError, ConnectionRefusedError):
                return out
            if self.random.random() >= self.loss:
                out.append(data)


class Peers:
    """Runs a bridge and plays its surroundings, tick by tick of 50 ms of the autopilot's time.

    Args:
        folder: where the bridge's stderr and stats go.
        loss: share of datagrams lost on each MAVLink link and in each direction.
        garbage: share of sends that are preceded by a datagram of garbage.
        options: further options of the bridge.
        second_ground: a second ground station listens at an endpoint of its own.
    """

    def __init__(self, folder: Path, loss: float = 0.0, garbage: float = 0.0, parameters: str = "", options: tuple[str, ...] = (), second_ground: bool = False):
        self.locks = [PortLock.take_any() for _ in range(4)]
        autopilot_port, ground_port, lcm_port, second_port = (lock.port for lock in self.locks)
        self.lcm = lcm.LCM(lcm_url(lcm_port))
        self.autopilot = Lossy(loss, garbage, 1)
        self.autopilot.peer = ("127.0.0.1", autopilot_port)
        self.ground = Lossy(loss, garbage, 2, ground_port)
        self.second = Lossy(loss, garbage, 3, second_port) if second_ground else None
        self.stats = folder / "stats.json"
        self.log = folder / "bridge.txt"
        (folder / "parameters.toml").write_text(parameters)
        environment = dict(os.environ)
        counter = BUILD / "lib" / "libnoctule_heap_count.so"
        if counter.exists():
            environment["LD_PRELOAD"] = str(counter)
        self.process = subprocess.Popen(
            [str(BUILD / "bin" / "noctule-bridge"), "--parameters", str(folder / "parameters.toml"), "--autopilot", f"udpin:127.0.0.1:{autopilot_port}",
             "--ground", f"udpout:127.0.0.1:{ground_port}", "--lcm-url", lcm_url(lcm_port), "--stats", str(self.stats), *options,
             *(("--ground", f"udpout:127.0.0.1:{second_port}") if second_ground else ())],
            stderr=open(self.log, "w"), env=environment)
        self.autopilot_mav = mavlink.MAVLink(None, SYSTEM, 1)
        self.ground_mav = mavlink.MAVLink(None, 255, 190)
        self.autopilot_mav.robust_parsing = self.ground_mav.robust_parsing = True
        self.mode, self.armed, self.landed = POSITION, False, 1
        self.t_us = 1_000_000
        self.at_autopilot: list = []    # messages that arrived there, from the bridge
        self.at_ground: list = []
        self.at_second: list = []
        self.second_mav = mavlink.MAVLink(None, 254, 190)
        self.second_mav.robust_parsing = True
        self.tables: list = []
        self.values = {row.name: row.default for row in params_gen.TABLE}   # what the fake nav flies
        self.imu: list = []
        self.vehicle: list = []
        self.orders: list[int] = []
        self.nav = noctule_lcm.nav_t()
        self.nav.parameters_crc = params_gen.CRC - (1 << 32) if params_gen.CRC >= 1 << 31 else params_gen.CRC
        self.nav.ready, self.nav.quality, self.nav.z_m = 1, 90, 0.1
        self.odom = noctule_lcm.odom_t()
        self.odom.quality, self.odom.z_m, self.odom.at_scan = 90, 0.1, 1
        self.nav_runs = True
        self.unanswered = 0
        for channel, kind, store in (("IMU", noctule_lcm.imu_t, self.imu), ("VEHICLE", noctule_lcm.vehicle_t, self.vehicle)):
            self.lcm.subscribe(channel, lambda _, data, kind=kind, store=store: store.append(kind.decode(data)))
        self.lcm.subscribe("COMMAND", lambda _, data: self.orders.append(noctule_lcm.command_t.decode(data).command))
        self.lcm.subscribe("PARAMETERS", self._take_table)
        self._wait_until_up()

    def _take_table(self, _, data: bytes) -> None:
        table = noctule_lcm.parameters_t.decode(data)
        self.tables.append(table)
        for row, value in zip(params_gen.TABLE, table.value):
            if not row.reboot:
                self.values[row.name] = value

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        for end in (self.autopilot, self.ground, self.second):
            if end is not None:
                end.socket.close()
        for lock in self.locks:
            lock.release()

    def _wait_until_up(self) -> None:
        """The bridge is up when its first heartbeat reaches the ground station."""
        deadline = time.monotonic() + 10.0
        while not self.of(self.at_ground, "HEARTBEAT") and time.monotonic() < deadline:
            select.select([self.ground.socket], [], [], 0.1)
            self._receive()
        assert self.of(self.at_ground, "HEARTBEAT"), self.log.read_text()

    @staticmethod
    def of(messages: list, kind: str) -> list:
        """Those of one type."""
        return [m for m in messages if m.get_type() == kind]

    def _receive(self) -> None:
        for end, parser, store in ((self.autopilot, self.autopilot_mav, self.at_autopilot), (self.ground, self.ground_mav, self.at_ground),
                                   (self.second, self.second_mav, self.at_second)):
            for data in (end.receive() if end is not None else ()):
                store += parser.parse_buffer(data) or []
        while self.lcm.handle_timeout(0) > 0:
            pass

    def _autopilot_says(self, *messages) -> None:
        for message in messages:
            self.autopilot.send(message.pack(self.autopilot_mav))
            self.autopilot_mav.seq = (self.autopilot_mav.seq + 1) % 256

    def _obey(self, begin: int) -> None:
        for message in self.at_autopilot[begin:]:
            if message.get_type() == "PARAM_REQUEST_READ" and message.param_id in AUTOPILOT_PARAMETERS:
                value = AUTOPILOT_PARAMETERS[message.param_id]
                kind = mavlink.MAV_PARAM_TYPE_INT32 if isinstance(value, int) else mavlink.MAV_PARAM_TYPE_REAL32
                wire = struct.unpack("<f", struct.pack("<i", value))[0] if isinstance(value, int) else value
                self._autopilot_says(mavlink.MAVLink_param_value_message(message.param_id.encode(), wire, kind, len(AUTOPILOT_PARAMETERS), 0))
            if message.get_type() != "COMMAND_LONG" or message.target_component != 1:
                continue
            if message.command == mavlink.MAV_CMD_DO_SET_MODE:
                self.mode = int(message.param2) << 16 | int(message.param3) << 24
            elif message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = message.param1 > 0.5
            self._autopilot_says(mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, message.get_srcSystem(), message.get_srcComponent()))

    def tick(self) -> None:
        """One tick: autopilot's messages, nav's answer, what comes back. Waits for the ODOMETRY of the tick, for 50 ms at most."""
        self.t_us += TICK_US
        ms = self.t_us // 1000
        looked_at = len(self.at_autopilot)
        if ms % 500 == 0:
            flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
            self._autopilot_says(mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, flags, self.mode, 4, 3))
        if ms % 200 == 0:
            self._autopilot_says(mavlink.MAVLink_extended_sys_state_message(0, self.landed))
        self._autopilot_says(
            mavlink.MAVLink_attitude_quaternion_message(ms, math.cos(0.5 * self.odom.yaw_rad), 0.0, 0.0, -math.sin(0.5 * self.odom.yaw_rad), 0.0, 0.0, 0.0),
            mavlink.MAVLink_local_position_ned_message(ms, self.odom.x_m, -self.odom.y_m, -self.odom.z_m, 0.0, 0.0, 0.0),
            mavlink.MAVLink_distance_sensor_message(ms, 10, 1200, 100, 0, 1, 25, 255),
            *(mavlink.MAVLink_highres_imu_message(self.t_us - TICK_US + 4000 * (i + 1) if i < 11 else self.t_us, 0.0, 0.0, -9.81, 0.0, 0.0, 0.0,
                                                  0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0x3F) for i in range(12)))
        self._wait(lambda: self.imu and self.imu[-1].t_us >= self.t_us)
        if not self.nav_runs:
            self._obey(looked_at)
            return
        self.nav.t_us = self.odom.t_us = self.t_us
        self.nav.values_crc = values_crc(self.values)
        self.nav.seq += 1
        self.odom.seq += 1
        self.nav.x_m, self.nav.y_m, self.nav.z_m = self.odom.x_m, self.odom.y_m, self.odom.z_m
        self.lcm.publish("NAV", self.nav.encode())
        self.lcm.publish("ODOM", self.odom.encode())
        if not self._wait(lambda: any(self.t_us == getattr(m, VISION_TIME.get(m.get_type(), ""), None) for m in self.at_autopilot[looked_at:])):
            self.unanswered += 1
        self._obey(looked_at)

    def _wait(self, done) -> bool:
        deadline = time.monotonic() + 0.25
        while not done():
            left = deadline - time.monotonic()
            if left <= 0.0:
                return False
            select.select([self.autopilot.socket, self.ground.socket, self.lcm.fileno()], [], [], left)
            self._receive()
        return True

    def run(self, seconds: float, until=lambda: False) -> bool:
        """Ticks for some seconds of the autopilot's time. True: `until` came true."""
        for _ in range(round(seconds * 20)):
            self.tick()
            if until():
                return True
        return until()

    def say(self, message, second: bool = False) -> None:
        """A ground station (the second one) sends a message."""
        end, mav = (self.second, self.second_mav) if second else (self.ground, self.ground_mav)
        end.send(message.pack(mav))
        mav.seq = (mav.seq + 1) % 256

    def ask(self, command: int, param1: float = 0.0, param3: float = 0.0) -> None:
        """The ground station orders the companion."""
        message = mavlink.MAVLink_command_long_message(SYSTEM, COMPANION, command, 0, param1, 0.0, param3, 0.0, 0.0, 0.0, 0.0)
        self.ground.send(message.pack(self.ground_mav))
        self.ground_mav.seq = (self.ground_mav.seq + 1) % 256

    def result(self, command: int):
        """Newest COMMAND_ACK result of the companion; None: unanswered."""
        acks = [m for m in self.of(self.at_ground, "COMMAND_ACK") if m.command == command and m.get_srcComponent() == COMPANION]
        return acks[-1].result if acks else None

    def stand(self) -> None:
        """Nav's setpoint: where the vehicle is."""
        self.nav.setpoint_valid = 1
        self.nav.setpoint_x_m, self.nav.setpoint_y_m, self.nav.setpoint_z_m = self.odom.x_m, self.odom.y_m, self.odom.z_m

    def start(self) -> bool:
        """Start by the ground station, asking again each second until answered; nav then takes off. True: armed in OFFBOARD."""
        self.run(3.0)
        for _ in range(10):
            self.ask(mavlink.MAV_CMD_MISSION_START)
            if self.run(1.0, lambda: self.result(mavlink.MAV_CMD_MISSION_START) == mavlink.MAV_RESULT_ACCEPTED):
                break
        self.stand()
        self.nav.state, self.nav.ready = 1, 0
        if not self.run(15.0, lambda: self.armed and self.mode == OFFBOARD):
            return False
        self.run(1.5)
        self.landed, self.odom.z_m, self.nav.state = 2, 1.0, 3
        self.stand()
        self.run(1.0)
        return True

    def said(self, words: str) -> bool:
        """A STATUSTEXT of the companion has these words."""
        return any(words in m.text for m in self.of(self.at_ground, "STATUSTEXT") if m.get_srcComponent() == COMPANION)

    def stop(self) -> int:
        """SIGINT; the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=10)
