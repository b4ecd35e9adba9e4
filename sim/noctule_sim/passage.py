"""The MAVLink between a real autopilot and the companion, passed on byte for byte, watched, and held back where the model says so.

The simulator stands in the middle for three reasons: it knows then when the companion has answered a sweep (lockstep), an
answer reaches the autopilot one latency after the sweep's stamp whatever the wall clock did, and faults can cut a stream.
Nothing is changed on the way.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from typing import Callable, Iterator, NamedTuple

from pymavlink.dialects.v20 import common as mav

from .autopilot import Landed

DATAGRAM_BYTES = 65536
LAND_STATES = {state.value: state for state in Landed}
CUT = {"odometry-cut": (mav.MAVLINK_MSG_ID_ODOMETRY, mav.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE),
       "setpoint-cut": (mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,)}
IMU_SLOW = 5              # with the fault imu-50hz one HIGHRES_IMU in this many passes
WATCHED = frozenset((mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
                     mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, mav.MAVLINK_MSG_ID_STATUSTEXT,
                     mav.MAVLINK_MSG_ID_SYS_STATUS))
ARDUPILOT_MODES = {0: "STABILIZE", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 9: "LAND", 16: "POSHOLD", 17: "BRAKE"}
PX4_MAIN = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED"}
PX4_AUTO = {2: "AUTO.TAKEOFF", 3: "AUTO.LOITER", 4: "AUTO.MISSION", 5: "AUTO.RTL", 6: "AUTO.LAND"}


class Frame(NamedTuple):
    """One MAVLink frame: where it lies in its buffer, and who says what."""

    begin: int
    end: int
    message: int
    system: int
    component: int


def frames(data: bytes) -> Iterator[Frame]:
    """The MAVLink 1 and 2 frames in a buffer, by their lengths alone; what is not a frame is passed over.

    >>> [f.message for f in frames(bytes([0x00, 0xFE, 1, 0, 1, 1, 0, 9, 9, 9]))]
    [0]
    """
    at, size = 0, len(data)
    while at + 8 <= size:
        if data[at] == 0xFD:
            if at + 12 > size:
                return
            end = at + 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
            message, system, component = int.from_bytes(data[at + 7:at + 10], "little"), data[at + 5], data[at + 6]
        elif data[at] == 0xFE:
            end = at + 8 + data[at + 1]
            message, system, component = data[at + 5], data[at + 3], data[at + 4]
        else:
            at += 1
            continue
        if end > size:
            return
        yield Frame(at, end, message, system, component)
        at = end


def payload(data: bytes, frame: Frame) -> bytes:
    """The payload of a frame; MAVLink 2 leaves off zeros at its end."""
    head = 10 if data[frame.begin] == 0xFD else 6
    return data[frame.begin + head:frame.begin + head + data[frame.begin + 1]]


class Believed:
    """What the autopilot says of itself, frame Map (its LOCAL_NED turned to forward-left-up)."""

    def __init__(self) -> None:
        self.t_us = 0
        self.x = self.y = self.z = self.vx = self.vy = self.vz = self.yaw_rad = 0.0


class AutopilotState:
    """The autopilot's state as its messages tell it: armed, landed, mode, battery, position."""

    def __init__(self, flavour: str):
        self.flavour = flavour
        self.armed = False
        self.custom_mode = 0
        self.landed = Landed.on_ground
        self.land_state_known = False
        self.battery = 1.0
        self.estimator = Believed()
        self.messages: list[tuple[int, str]] = []
        self.heard = False
        self._decoder = mav.MAVLink(None)
        self._decoder.robust_parsing = True

    def name(self) -> str:
        """The present mode's name."""
        if self.flavour == "ardupilot":
            return ARDUPILOT_MODES.get(self.custom_mode, f"MODE{self.custom_mode}")
        main, sub = self.custom_mode >> 16 & 255, self.custom_mode >> 24 & 255
        return PX4_AUTO.get(sub, "AUTO") if main == 4 else PX4_MAIN.get(main, f"MODE{main}.{sub}")

    def take(self, frame: bytes) -> None:
        """One frame of the autopilot component; damaged ones are passed over."""
        try:
            m = self._decoder.decode(bytearray(frame))
        except mav.MAVError:
            return
        kind, e = m.get_type(), self.estimator
        if kind == "HEARTBEAT":
            self.heard = True
            self.armed = bool(m.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
            self.custom_mode = m.custom_mode
            if not self.land_state_known:
                self.landed = Landed.in_air if self.armed else Landed.on_ground
        elif kind == "EXTENDED_SYS_STATE":
            self.land_state_known = m.landed_state in LAND_STATES
            self.landed = LAND_STATES.get(m.landed_state, self.landed)
        elif kind == "LOCAL_POSITION_NED":
            e.x, e.y, e.z, e.vx, e.vy, e.vz = m.x, -m.y, -m.z, m.vx, -m.vy, -m.vz
        elif kind == "ATTITUDE":
            e.yaw_rad = -m.yaw
        elif kind == "ATTITUDE_QUATERNION":
            from .vehicle import quaternion_to_euler

            e.yaw_rad = quaternion_to_euler(m.q1, m.q2, -m.q3, -m.q4)[2]
        elif kind == "STATUSTEXT":
            self.messages.append((m.severity, m.text.rstrip("\0")))
        elif kind == "SYS_STATUS" and m.battery_remaining >= 0:
            self.battery = m.battery_remaining / 100.0


class Passage:
    """Autopilot on one side, companion on the other.

    Args:
        state: is kept up to date from what the autopilot says.
        autopilot: where the autopilot's MAVLink comes: ("udpin", host, port) or ("tcp", host, port).
        companion_port: of the companion on 127.0.0.1.
        fault: fault(name) says whether a fault acts now.

    Raises:
        OSError: a port is taken, or nobody listens there (tcp).
    """

    def __init__(self, state: AutopilotState, autopilot: tuple[str, str, int], companion_port: int, fault: Callable[[str], bool]):
        kind, host, port = autopilot
        self.state = state
        self._fault = fault
        self._stream = kind == "tcp"
        if self._stream:
            self._autopilot = socket.create_connection((host, port), timeout=10.0)
        else:
            self._autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._autopilot.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
            self._autopilot.bind((host, port))
        self._autopilot_peer = None
        self._companion_peer = ("127.0.0.1", companion_port)
        self._companion = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._companion.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self._companion.bind(("127.0.0.1", 0))
        self._poll = select.poll()
        for s in (self._autopilot, self._companion):
            s.setblocking(False)
            self._poll.register(s, select.POLLIN)
        self._rest = b""
        self._held: list[bytes] = []
        self._release_us = 0
        self._mav = mav.MAVLink(None, srcSystem=1, srcComponent=mav.MAV_COMP_ID_PERIPHERAL)
        self._imu_count = 0
        self.companion_heard = False
        self.imu_heard = False
        self.odometry_passed = self.setpoints_passed = 0

    def close(self) -> None:
        self._autopilot.close()
        self._companion.close()

    def send_heartbeat(self) -> None:
        """Nothing to send: the autopilot has its own."""

    # ------------------------------------------------------------ both ways

    def pump(self, t_us: int) -> None:
        """Pass on what has come; what was held back is released when its time has come. t_us: autopilot clock."""
        self._take_autopilot()
        if self._held and t_us >= self._release_us:
            held, self._held = self._held, []
            for data in held:
                self._to_autopilot(data)
        self._take_companion(None)

    def hold_until(self, t_us: int) -> None:
        """What `receive` takes in from now on reaches the autopilot at t_us."""
        self._release_us = t_us

    def receive(self, wait_s: float, until_us: int | None) -> bool:
        """Take what comes for at most wait_s of wall time. True: the companion's ODOMETRY of time until_us is in."""
        end = time.monotonic() + wait_s
        while True:
            left = end - time.monotonic()
            if not self._poll.poll(max(0.0, left) * 1000.0):
                return False
            self._take_autopilot()
            if self._take_companion(until_us):
                return True
            if left <= 0.0:
                return False

    def _take_autopilot(self) -> None:
        for _ in range(10000):
            try:
                if self._stream:
                    data = self._autopilot.recv(DATAGRAM_BYTES)
                    if not data:
                        return
                else:
                    data, self._autopilot_peer = self._autopilot.recvfrom(DATAGRAM_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return
            self._from_autopilot(data)

    def _from_autopilot(self, data: bytes) -> None:
        if self._stream:
            data = self._rest + data
        out = bytearray()
        end = 0
        slow = self._fault("imu-50hz")
        for frame in frames(data):
            end = frame.end
            if frame.component == mav.MAV_COMP_ID_AUTOPILOT1:
                if frame.message in WATCHED:
                    self.state.take(data[frame.begin:frame.end])
                elif frame.message in (mav.MAVLINK_MSG_ID_HIGHRES_IMU, mav.MAVLINK_MSG_ID_SCALED_IMU, mav.MAVLINK_MSG_ID_RAW_IMU):
                    self.imu_heard = True
                    self._imu_count += 1
                    if slow and self._imu_count % IMU_SLOW:
                        continue
            out += data[frame.begin:frame.end]
            if len(out) > 1200:
                self._to_companion(bytes(out))
                out = bytearray()
        if self._stream:
            self._rest = data[end:][-1000:]
        if out:
            self._to_companion(bytes(out))

    def _to_companion(self, data: bytes) -> None:
        try:
            self._companion.sendto(data, self._companion_peer)
        except (ConnectionRefusedError, BlockingIOError):
            pass  # nobody listens yet: UDP may lose, the lockstep notices

    def _take_companion(self, until_us: int | None) -> bool:
        """until_us None: passed on at once. Else: kept until the time of `hold_until`; True once the ODOMETRY of that time is there."""
        for _ in range(10000):
            try:
                data, _ = self._companion.recvfrom(DATAGRAM_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return False
            self.companion_heard = True
            out, answered = bytearray(), False
            for frame in frames(data):
                if any(frame.message in messages and self._fault(name) for name, messages in CUT.items()):
                    passes = False
                else:
                    passes = True
                if frame.message == mav.MAVLINK_MSG_ID_ODOMETRY:
                    self.odometry_passed += passes
                    stamp = payload(data, frame)[:8].ljust(8, b"\0")
                    answered = answered or struct.unpack("<Q", stamp)[0] == until_us
                elif frame.message == mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                    self.setpoints_passed += passes
                if passes:
                    out += data[frame.begin:frame.end]
            if out:
                if until_us is None:
                    self._to_autopilot(bytes(out))
                else:
                    self._held.append(bytes(out))
            if answered:
                return True
        return False

    def tell_autopilot(self, message) -> None:
        """A message of the simulator's own, as a peripheral of the vehicle (a range finder on its MAVLink)."""
        self._to_autopilot(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) & 255

    def _to_autopilot(self, data: bytes) -> None:
        try:
            if self._stream:
                self._autopilot.sendall(data)
            elif self._autopilot_peer is not None:
                self._autopilot.sendto(data, self._autopilot_peer)
        except (ConnectionRefusedError, BlockingIOError):
            pass
