"""The simulated autopilot's MAVLink: UDP to the companion, forward-right-down, milliseconds, centimetres.

The only module of the simulator that knows the wire. What comes in is posted to the simulation and acts one latency
later; what goes out of a tick is packed into few datagrams, in the order of time, the last inertial sample last.
"""

from __future__ import annotations

import math
import select
import socket
import struct
from typing import Callable

from pymavlink.dialects.v20 import common as mav

from .autopilot import Landed, Mode
from .simulation import AttitudeOut, Inertial, OdometryIn, SetpointIn, Simulation, TickData

SYSTEM, COMPONENT = 1, 1
DATAGRAM_BYTES = 1400
STATUS_EVERY, STATE_EVERY = 20, 4          # ticks: 1 Hz and 5 Hz
PRESSURE_ALT = 0x0800                      # of fields_updated
IMU_FIELDS = 0x01FF                        # accelerometer, gyroscope, magnetometer
CAPACITY_CELLS = 4

_PX4_MAIN = {Mode.manual: 1, Mode.hold: 4, Mode.takeoff: 4, Mode.offboard: 6, Mode.land: 4}
_PX4_SUB = {Mode.hold: 3, Mode.takeoff: 2, Mode.land: 6}
_ARDUPILOT = {Mode.manual: 0, Mode.hold: 5, Mode.takeoff: 3, Mode.offboard: 4, Mode.land: 9}
# What the companion's preflight check reads; the values say what this simulator does.
_PX4_PARAMETERS = {"COM_OF_LOSS_T": 1.0, "COM_DISARM_LAND": 2.0, "EKF2_EV_CTRL": 15, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0, "EKF2_MAG_TYPE": 5}
_ARDUPILOT_PARAMETERS = {"GUID_TIMEOUT": 3.0, "DISARM_DELAY": 2.0, "VISO_TYPE": 1, "EK3_SRC1_POSXY": 6, "EK3_SRC1_VELXY": 6, "EK3_SRC1_POSZ": 6,
                         "EK3_SRC1_VELZ": 6, "EK3_SRC1_YAW": 6, "COMPASS_ENABLE": 0, "WP_YAW_BEHAVIOR": 0}
_PX4_ESTIMATORS = (mav.MAV_ESTIMATOR_TYPE_UNKNOWN, mav.MAV_ESTIMATOR_TYPE_NAIVE, mav.MAV_ESTIMATOR_TYPE_VISION, mav.MAV_ESTIMATOR_TYPE_VIO)
_BODY_FRAMES = (mav.MAV_FRAME_BODY_NED, mav.MAV_FRAME_BODY_OFFSET_NED)
_SETPOINT_FRAMES = {"px4": (mav.MAV_FRAME_LOCAL_NED, mav.MAV_FRAME_BODY_NED),
                    "ardupilot": (mav.MAV_FRAME_LOCAL_NED, mav.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY_FRAMES)}
_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_YAW = 0x0007, 0x0038, 0x0400


def custom_mode(flavour: str, mode: Mode) -> int:
    """HEARTBEAT.custom_mode of a mode."""
    if flavour == "ardupilot":
        return _ARDUPILOT[mode]
    return _PX4_MAIN[mode] << 16 | _PX4_SUB.get(mode, 0) << 24


def mode_of(flavour: str, main: int, sub: int) -> Mode | None:
    """The mode that (main, sub) of MAV_CMD_DO_SET_MODE stands for; ArduPilot: main alone. None: not flown here."""
    if flavour == "ardupilot":
        found = [m for m, number in _ARDUPILOT.items() if number == main]
    else:
        found = [m for m, number in _PX4_MAIN.items() if number == main and (main != 4 or _PX4_SUB.get(m) == sub)]
    return found[0] if found else None


def odometry_from(message, flavour: str = "px4") -> OdometryIn | None:
    """ODOMETRY in local FRD or NED with velocity in Body FRD (or in the local frame); ArduPilot takes LOCAL_FRD with BODY_FRD only. None:
    other frames, a broken quaternion."""
    if message.frame_id not in (mav.MAV_FRAME_LOCAL_FRD, mav.MAV_FRAME_LOCAL_NED):
        return None
    if flavour == "ardupilot" and (message.frame_id, message.child_frame_id) != (mav.MAV_FRAME_LOCAL_FRD, mav.MAV_FRAME_BODY_FRD):
        return None
    w, x, y, z = message.q[0], message.q[1], -message.q[2], -message.q[3]   # to forward-left-up
    n = w * w + x * x + y * y + z * z
    if not 0.8 < n < 1.2:
        return None
    n = 1.0 / math.sqrt(n)
    w, x, y, z = w * n, x * n, y * n, z * n
    vx, vy, vz = message.vx, -message.vy, -message.vz
    if message.child_frame_id in (mav.MAV_FRAME_BODY_FRD, mav.MAV_FRAME_BODY_NED):
        vx, vy, vz = (
            (1 - 2 * (y * y + z * z)) * vx + 2 * (x * y - w * z) * vy + 2 * (x * z + w * y) * vz,
            2 * (x * y + w * z) * vx + (1 - 2 * (x * x + z * z)) * vy + 2 * (y * z - w * x) * vz,
            2 * (x * z - w * y) * vx + 2 * (y * z + w * x) * vy + (1 - 2 * (x * x + y * y)) * vz,
        )
    elif message.child_frame_id != message.frame_id:
        return None
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return OdometryIn(message.time_usec, message.x, -message.y, -message.z, vx, vy, vz, yaw, message.quality, message.reset_counter)


class MavlinkLink:
    """The autopilot's side of one UDP link.

    Args:
        simulation: whose autopilot speaks.
        port: of the companion, on 127.0.0.1; we send from a free port of our own and take what comes back to it.
    """

    def __init__(self, simulation: Simulation, port: int):
        self.simulation = simulation
        self.flavour = simulation.autopilot.flavour
        self.peer = ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self.socket, select.POLLIN)
        self._mav = mav.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self._mav.robust_parsing = True
        self._outbox: list = []
        self._said: set[str] = set()
        self._state = None
        self._parameters = dict(_PX4_PARAMETERS if self.flavour == "px4" else _ARDUPILOT_PARAMETERS)
        self._asked = self.flavour == "px4"     # ArduPilot sends its heartbeat alone until messages are asked for
        self.companion_heard = False
        self.bad_bytes = 0

    def close(self) -> None:
        self.socket.close()

    # ------------------------------------------------------------ out

    def send_heartbeat(self) -> None:
        """A heartbeat alone, to be heard before the first tick."""
        self._send([self._heartbeat()])

    def send(self, tick: TickData) -> None:
        """Everything of one tick; the HIGHRES_IMU of its end is last."""
        self._send([message for group in self._groups(tick) for message in group])

    def play(self, tick: TickData, until: Callable[[float], object]) -> None:
        """The same one inertial sample after the other; until(share) waits until that share of the time for it is over."""
        groups = self._groups(tick)
        for i, group in enumerate(groups):
            until(i / len(groups))
            self._send(group)

    def _groups(self, tick: TickData) -> list[list]:
        """The messages of a tick in the order of time, those up to and with one inertial sample together."""
        if not self._asked:
            return [self._states(tick)]
        magnet = tick.magnet_gauss
        attitudes = {a.t_us: a for a in tick.attitude}
        groups = []
        for sample in tick.imu[:-1]:
            attitude = [_attitude(attitudes[sample.t_us])] if sample.t_us in attitudes else []
            groups.append([*attitude, _imu(sample, magnet)])
        end_ms = tick.t_us // 1000
        x, y, z, vx, vy, vz, _ = tick.local
        groups.append([
            *self._states(tick),
            _range(end_ms, tick.range_up_m, mav.MAV_SENSOR_ROTATION_PITCH_90, 0, self.simulation.profile),
            _range(end_ms, tick.range_down_m, mav.MAV_SENSOR_ROTATION_PITCH_270, 1, self.simulation.profile),
            mav.MAVLink_local_position_ned_message(end_ms, x, -y, -z, vx, -vy, -vz),
            _attitude(tick.attitude[-1]),
            _imu(tick.imu[-1], magnet, tick.baro_m),
        ])
        return groups

    def _states(self, tick: TickData) -> list:
        autopilot, count = self.simulation.autopilot, self.simulation.ticks
        out = [mav.MAVLink_statustext_message(severity, text.encode()[:50]) for severity, text in tick.messages]
        out += self._outbox
        self._outbox = []
        state = (autopilot.armed, autopilot.mode, autopilot.landed)
        changed, self._state = state != self._state, state
        if changed or count % STATUS_EVERY == 1:
            out.append(self._heartbeat())
        if changed or count % STATE_EVERY == 1:
            out.append(mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_UNDEFINED, int(autopilot.landed)))
        if count % STATUS_EVERY == 1:
            percent = int(round(100.0 * autopilot.battery))
            volt = CAPACITY_CELLS * (3.5 + 0.7 * autopilot.battery)
            healthy = mav.MAV_SYS_STATUS_SENSOR_3D_GYRO | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL | mav.MAV_SYS_STATUS_SENSOR_BATTERY
            out.append(mav.MAVLink_sys_status_message(healthy, healthy, healthy, 150, int(volt * 1000), -1, percent, 0, 0, 0, 0, 0, 0))
            cells = [int(volt / CAPACITY_CELLS * 1000)] * CAPACITY_CELLS + [0xFFFF] * (10 - CAPACITY_CELLS)
            if self.flavour == "px4":
                out.append(self._estimator_status(tick))
            out.append(mav.MAVLink_battery_status_message(0, mav.MAV_BATTERY_FUNCTION_ALL, mav.MAV_BATTERY_TYPE_LIPO, 0x7FFF, cells, -1, -1, -1, percent))
        return out

    def _estimator_status(self, tick: TickData):
        """As PX4 1.17 says it: the constant position mode is on at rest, with a position and without."""
        autopilot = self.simulation.autopilot
        flags = mav.ESTIMATOR_ATTITUDE | mav.ESTIMATOR_VELOCITY_VERT | mav.ESTIMATOR_POS_VERT_ABS
        if autopilot.estimator.aided:
            flags |= mav.ESTIMATOR_VELOCITY_HORIZ | mav.ESTIMATOR_POS_HORIZ_REL | mav.ESTIMATOR_PRED_POS_HORIZ_REL
        if autopilot.landed is Landed.on_ground:
            flags |= mav.ESTIMATOR_CONST_POS_MODE
        return mav.MAVLink_estimator_status_message(tick.t_us, flags, *[math.nan] * 6, 0.02, 0.02)

    def _heartbeat(self):
        autopilot = self.simulation.autopilot
        base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_STABILIZE_ENABLED
        if autopilot.armed:
            base |= mav.MAV_MODE_FLAG_SAFETY_ARMED
        if autopilot.mode is not Mode.manual:
            base |= mav.MAV_MODE_FLAG_GUIDED_ENABLED
        kind = mav.MAV_AUTOPILOT_PX4 if self.flavour == "px4" else mav.MAV_AUTOPILOT_ARDUPILOTMEGA
        state = mav.MAV_STATE_ACTIVE if autopilot.landed is not Landed.on_ground else mav.MAV_STATE_STANDBY
        return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, kind, base, custom_mode(self.flavour, autopilot.mode), state, 3)

    def _send(self, messages: list) -> None:
        if not messages:
            return
        buffer = bytearray()
        link = self._mav
        for message in messages:
            packet = message.pack(link)
            link.seq = (link.seq + 1) & 255
            if len(buffer) + len(packet) > DATAGRAM_BYTES:
                self._sendto(buffer)
                buffer = bytearray()
            buffer += packet
        self._sendto(buffer)

    def _sendto(self, buffer: bytearray) -> None:
        try:
            self.socket.sendto(buffer, self.peer)
        except (ConnectionRefusedError, BlockingIOError):
            pass  # nobody listens yet, or the queue is full: UDP may lose, the lockstep notices

    # ------------------------------------------------------------ in

    def receive(self, wait_s: float, until_us: int | None) -> bool:
        """Take what comes for at most wait_s of wall time. True: the ODOMETRY of time until_us came (the rest waits its turn)."""
        if not self._poll.poll(max(0.0, wait_s) * 1000.0):
            return False
        answered = False
        while not answered:
            try:
                data, _ = self.socket.recvfrom(65536)
            except (BlockingIOError, ConnectionRefusedError):
                break
            try:
                messages = self._mav.parse_buffer(data) or []
            except mav.MAVError:
                messages = []
            for message in messages:
                answered = self._handle(message, until_us) or answered
        return answered

    def _handle(self, message, until_us: int | None) -> bool:
        kind = message.get_type()
        simulation = self.simulation
        if kind == "ODOMETRY":
            odometry = odometry_from(message, self.flavour)
            if self.flavour == "px4" and message.estimator_type not in _PX4_ESTIMATORS:
                self._once(f"ODOMETRY: estimator_type {message.estimator_type} unsupported")
            elif odometry is not None:   # another frame is dropped in silence, as both real ones do
                simulation.post_odometry(odometry)
            return message.time_usec == until_us
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._setpoint(message)
        elif kind == "HEARTBEAT":
            if message.get_srcComponent() != COMPONENT or message.get_srcSystem() != SYSTEM:
                self.companion_heard = self.companion_heard or self._asked
        elif kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._asked = self._asked or message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL
            if message.target_system in (0, SYSTEM) and message.target_component in (0, COMPONENT):
                parameters = [getattr(message, f"param{i}") for i in range(1, 5)]
                height = message.param7 if kind == "COMMAND_LONG" else message.z
                sender = (message.get_srcSystem(), message.get_srcComponent())
                simulation.post(lambda: self._command(message.command, parameters, height, sender))
        elif kind == "SET_GPS_GLOBAL_ORIGIN":
            simulation.autopilot.origin_given = True
        elif kind == "SET_MODE":
            number = message.custom_mode
            main, sub = (number, 0) if self.flavour == "ardupilot" else (number >> 16 & 255, number >> 24 & 255)
            simulation.post(lambda: self._set_mode(main, sub))
        elif kind == "TIMESYNC":
            if message.tc1 == 0:
                self._outbox.append(mav.MAVLink_timesync_message(simulation.t_us * 1000, message.ts1))
        elif kind == "PARAM_REQUEST_LIST":
            for i, (name, value) in enumerate(self._parameters.items()):
                self._outbox.append(self._parameter(name, value, i))
        elif kind == "PARAM_REQUEST_READ":
            for i, (name, value) in enumerate(self._parameters.items()):
                if message.param_id.rstrip("\0") == name or message.param_index == i:
                    self._outbox.append(self._parameter(name, value, i))
                    break
        elif kind == "BAD_DATA":
            self.bad_bytes += len(message.data)
        return False

    def _parameter(self, name: str, value: float, index: int):
        if isinstance(value, int):      # PX4 copies the bytes of a whole number, ArduPilot casts it
            value = float(value) if self.flavour == "ardupilot" else struct.unpack("<f", struct.pack("<i", value))[0]
            return mav.MAVLink_param_value_message(name.encode(), value, mav.MAV_PARAM_TYPE_INT32, len(self._parameters), index)
        return mav.MAVLink_param_value_message(name.encode(), value, mav.MAV_PARAM_TYPE_REAL32, len(self._parameters), index)

    def _setpoint(self, m) -> None:
        mask, frame = m.type_mask, m.coordinate_frame
        position, velocity = mask & _IGNORE_POSITION == 0, mask & _IGNORE_VELOCITY == 0
        simulation = self.simulation
        if frame not in _SETPOINT_FRAMES[self.flavour]:
            if self.flavour == "ardupilot":
                simulation.post(simulation.autopilot.stop_here)
            return
        if frame == mav.MAV_FRAME_BODY_NED and self.flavour == "px4":
            position = False               # it is dropped in silence
        if not (position or velocity):
            return

        def act() -> None:
            e = simulation.autopilot.estimator
            c, s = (math.cos(e.yaw_rad), math.sin(e.yaw_rad)) if frame in _BODY_FRAMES else (1.0, 0.0)
            yaw = e.yaw_rad if mask & _IGNORE_YAW else math.remainder(-m.yaw + (e.yaw_rad if frame in _BODY_FRAMES else 0.0), 2.0 * math.pi)
            x, y, z = (m.x, -m.y, -m.z) if position else (0.0, 0.0, 0.0)
            vx, vy, vz = (m.vx, -m.vy, -m.vz) if velocity else (0.0, 0.0, 0.0)
            x, y, vx, vy = c * x - s * y, s * x + c * y, c * vx - s * vy, s * vx + c * vy
            if not position or frame != mav.MAV_FRAME_LOCAL_NED:   # an offset from where the vehicle is
                x, y, z = e.x + x, e.y + y, e.z + z
            simulation._take_setpoint(SetpointIn(x, y, z, vx, vy, vz, yaw))

        simulation.setpoints_received += 1
        simulation.post(act)

    def _set_mode(self, main: int, sub: int) -> str | None:
        mode = mode_of(self.flavour, main, sub)
        if mode is None:
            return "mode not flown here"
        return self.simulation.autopilot.set_mode(mode)

    def _command(self, command: int, p: list[float], height_m: float, sender: tuple[int, int]) -> None:
        autopilot = self.simulation.autopilot
        refusal: str | None = None
        known = True
        if command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            refusal = autopilot.arm() if p[0] >= 0.5 else autopilot.disarm(force=abs(p[1] - 21196.0) < 0.5)
        elif command == mav.MAV_CMD_DO_SET_MODE:
            refusal = self._set_mode(int(p[1]), int(p[2]))
        elif command == mav.MAV_CMD_NAV_LAND:
            refusal = autopilot.set_mode(Mode.land)
        elif command == mav.MAV_CMD_NAV_TAKEOFF:
            refusal = autopilot.takeoff(height_m if math.isfinite(height_m) and height_m > 0.1 else 1.0)
        elif command == mav.MAV_CMD_REQUEST_MESSAGE and int(p[0]) == mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            capabilities = mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            self._outbox.append(mav.MAVLink_autopilot_version_message(capabilities, 0, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 1))
        elif command not in (mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAV_CMD_DO_SET_HOME):  # 611, DO_SET_GLOBAL_ORIGIN, is known to neither
            known = False
        result = mav.MAV_RESULT_UNSUPPORTED if not known else mav.MAV_RESULT_TEMPORARILY_REJECTED if refusal else mav.MAV_RESULT_ACCEPTED
        self._outbox.append(mav.MAVLink_command_ack_message(command, result, 0, 0, *sender))

    def _once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self._outbox.append(mav.MAVLink_statustext_message(mav.MAV_SEVERITY_WARNING, text.encode()[:50]))


def _imu(s: Inertial, magnet, baro_m: float | None = None):
    height = (0.0, IMU_FIELDS) if baro_m is None else (baro_m, IMU_FIELDS | PRESSURE_ALT)
    return mav.MAVLink_highres_imu_message(
        s.t_us, s.ax, -s.ay, -s.az, s.gx, -s.gy, -s.gz, magnet[0], -magnet[1], -magnet[2], 0.0, 0.0, height[0], 0.0, height[1])


def _attitude(a: AttitudeOut):
    return mav.MAVLink_attitude_quaternion_message(a.t_us // 1000, a.qw, a.qx, -a.qy, -a.qz, a.wx, -a.wy, -a.wz)


def _range(t_ms: int, range_m: float, orientation: int, number: int, profile):
    known = not math.isnan(range_m)
    low, high = int(round(profile.range_min_m * 100)), int(round(profile.range_max_m * 100))
    current = int(math.floor(range_m * 100 + 0.5)) if known else high
    return mav.MAVLink_distance_sensor_message(
        t_ms, low, high, current, mav.MAV_DISTANCE_SENSOR_LASER, number, orientation, 255, 0.0, 0.0, [0.0] * 4, 100 if known else 1)
