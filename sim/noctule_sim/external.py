"""Real autopilots in the place of the simulated one: our physics, sensors and walls; their estimator and their controllers.

Each inertial sample goes to the autopilot's own simulator interface, and its motors' demand comes back before the physics goes
on: lockstep on the simulator's clock, which is the autopilot's clock, too. Truth goes to that interface only (it stands for the
sensors on the vehicle's board); position and yaw the autopilot has from the companion's ODOMETRY.

Frames on both interfaces: north-east-down with north along World's x, body forward-right-down.
"""

from __future__ import annotations

import abc
import math
import socket
import struct
import time
from typing import Callable

from pymavlink.dialects.v20 import common as mav

from .autopilot import Landed
from .passage import AutopilotState, Passage, frames, payload
from .vehicle import GRAVITY_M_S2

START_PATIENCE_S = 60.0       # wall time for a program to come up
ANSWER_PATIENCE_S = 20.0      # wall time for one answer in flight
# Rotor order of ours: front left, front right, rear right, rear left. Theirs: front right, rear left, front left, rear right.
MOTOR_OF_ROTOR = (2, 0, 3, 1)
STANDARD_PRESSURE_HPA, STANDARD_TEMPERATURE_C = 1013.25, 25.0


class AutopilotGone(RuntimeError):
    """The autopilot's program does not answer any more; one line."""


def ned(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Forward-left-up to forward-right-down, and back."""
    return x, -y, -z


def pressure_hpa(height_m: float) -> float:
    """Standard atmosphere's pressure at a height over sea level.

    >>> round(pressure_hpa(0.0), 2)
    1013.25
    """
    return STANDARD_PRESSURE_HPA * (1.0 - 2.25577e-5 * height_m) ** 5.25588


class External(abc.ABC):
    """What Simulation needs of an autopilot, from a real one.

    Subclasses give `physics_step_s`, `split` (physics steps of each inertial sample of a tick, for even and odd ticks), `flavour`,
    `connect()`, `exchange()`, `ranges()`.

    Attributes as those of autopilot.Autopilot: armed, landed, battery, messages, estimator, rotors, name().
    """

    physics_step_s = 0.00125
    split: tuple[tuple[int, ...], ...] = ((1,) * 40,) * 2
    flavour = ""

    def __init__(self) -> None:
        self.state = AutopilotState(self.flavour)
        self.rotors = [0.0, 0.0, 0.0, 0.0]
        self.stop: Callable[[], bool] = lambda: False
        self.on_time: Callable[[int], None] = lambda t_us: None
        self.simulation = None

    armed = property(lambda self: self.state.armed)
    landed = property(lambda self: self.state.landed)
    battery = property(lambda self: self.state.battery)
    messages = property(lambda self: self.state.messages)
    estimator = property(lambda self: self.state.estimator)

    def name(self) -> str:
        """The present mode's name."""
        return self.state.name()

    def attach(self, simulation) -> None:
        """Take the simulation whose vehicle is flown; before the first tick."""
        self.simulation = simulation
        x, y, z = simulation.vehicle.position_m
        self._home = (x, y, z)

    def imu(self, t_us: int, dt_s: float, ax, ay, az, gx, gy, gz) -> list[float]:
        """One inertial sample to the autopilot, its rotor demands (4,) back. Then all that is due at t_us."""
        self.estimator.t_us = t_us
        self.rotors = self.exchange(t_us, (ax, ay, az), (gx, gy, gz))
        self.on_time(t_us)
        return self.rotors

    @abc.abstractmethod
    def connect(self, alive: Callable[[], str | None]) -> None:
        """Wait for the autopilot's program. alive() says in a line what has gone wrong with it, or None.

        Raises:
            AutopilotGone: it does not come.
        """

    @abc.abstractmethod
    def exchange(self, t_us: int, force_m_s2, rate_rad_s) -> list[float]:
        """The autopilot's answer to one inertial sample, frame Body: shares of the greatest thrust (4,)."""

    @abc.abstractmethod
    def ranges(self, tick, link: Passage) -> None:
        """Hand over what the range finders measured in a tick."""

    def close(self) -> None:
        """Give the ports back."""


def both_ranges(tick, profile) -> list:
    """DISTANCE_SENSOR of the lower and the upper range finder. No reading: 0 cm, less than the least range, quality 1 (invalid); a
    sensor that fell silent on the ground would forbid arming."""
    low, high = int(round(profile.range_min_m * 100)), int(round(profile.range_max_m * 100))
    out = []
    for number, orientation, r in ((0, mav.MAV_SENSOR_ROTATION_PITCH_270, tick.range_down_m), (1, mav.MAV_SENSOR_ROTATION_PITCH_90, tick.range_up_m)):
        known = not math.isnan(r)
        out.append(mav.MAVLink_distance_sensor_message(
            tick.t_us // 1000, low, high, int(math.floor(r * 100 + 0.5)) if known else 0, mav.MAV_DISTANCE_SENSOR_LASER, number, orientation, 255,
            0.0, 0.0, [0.0] * 4, 100 if known else 1))
    return out


# ---------------------------------------------------------------- ArduPilot


def json_state(t_us: int, force_m_s2, rate_rad_s, position_m, attitude, velocity_m_s, home_m) -> bytes:
    """One line of ArduPilot's JSON physics interface. Its parser wants no space after a colon, and a line end on both sides.

    Args:
        t_us: simulator's clock.
        force_m_s2, rate_rad_s: (3,) specific force and angular rate, frame Body.
        position_m, velocity_m_s: (3,) frame World.
        attitude: (4,) quaternion, Body to World.
        home_m: (3,) where the vehicle stood at first, frame World.

    >>> json_state(1250, (0, 0, 9.81), (0, 0, 0), (1, 2, 3), (1, 0, 0, 0), (0, 0, 0), (0, 0, 3))[:46]
    b'\\n{"timestamp":0.00125,"imu":{"gyro":[0, 0, 0],'
    """
    def row(values) -> str:
        return "[" + ", ".join(f"{v:.9g}" for v in values) + "]"

    w, i, j, k = attitude
    place = ned(*(p - h for p, h in zip(position_m, home_m)))
    return (f'\n{{"timestamp":{t_us * 1e-6:.9g},"imu":{{"gyro":{row(_plus(ned(*rate_rad_s)))},"accel_body":{row(_plus(ned(*force_m_s2)))}}},'
            f'"position":{row(_plus(place))},"quaternion":{row(_plus((w, i, -j, -k)))},"velocity":{row(_plus(ned(*velocity_m_s)))},'
            f'"no_time_sync":1}}\n').encode()


def _plus(values) -> tuple:
    """Without negative zeros, which the reader would print back."""
    return tuple(v + 0.0 if v else 0 for v in values)


class Ardupilot(External):
    """ArduCopter through its JSON interface: it sends its servo outputs by UDP and waits for the state of the physics.

    Args:
        port: where it sends them (its --sim-port-out).
        pwm_range_us: pulse widths of no thrust and of the greatest thrust.
        thrust_expo: share of the square in the thrust over the pulse (MOT_THST_EXPO of the shipped parameters).
    """

    physics_step_s = 0.00125                  # 800 Hz: its loop of 400 Hz wants at least 1.8 times that
    split = ((1,) * 40,) * 2
    flavour = "ardupilot"
    MAGIC_16, MAGIC_32 = 18458, 29569

    def __init__(self, port: int = 9002, pwm_range_us=(1000.0, 2000.0), thrust_expo: float = 0.65):
        super().__init__()
        self.port = port
        self._low, self._high = pwm_range_us
        self._expo = thrust_expo
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._peer = None
        self._count = -1
        self._sent = b""
        self.answers = self.repeats = 0

    def close(self) -> None:
        self._socket.close()

    def connect(self, alive: Callable[[], str | None]) -> None:
        self._receive(START_PATIENCE_S, alive, f"nothing on UDP port {self.port}")

    def exchange(self, t_us: int, force_m_s2, rate_rad_s) -> list[float]:
        v = self.simulation.vehicle
        self._sent = json_state(t_us, force_m_s2, rate_rad_s, v.position_m, v.attitude, v.velocity_m_s, self._home)
        self._socket.sendto(self._sent, self._peer)
        return self._receive(ANSWER_PATIENCE_S, lambda: None, "ArduCopter does not answer any more")

    def _receive(self, patience_s: float, alive, complaint: str) -> list[float]:
        end = time.monotonic() + patience_s
        while not self.stop():
            self._socket.settimeout(0.5)
            try:
                data, peer = self._socket.recvfrom(4096)
            except TimeoutError:
                problem = alive()
                if problem or time.monotonic() > end:
                    raise AutopilotGone(problem or complaint) from None
                continue
            except ConnectionRefusedError:
                raise AutopilotGone("ArduCopter has ended") from None
            if len(data) < 40 or struct.unpack_from("<H", data)[0] not in (self.MAGIC_16, self.MAGIC_32):
                continue
            count = struct.unpack_from("<I", data, 4)[0]
            if self._peer is not None and count <= self._count:
                # It asks again for what it missed, after a second of silence; what crossed on the way is old.
                self.repeats += 1
                continue
            self._peer, self._count = peer, count
            self.answers += 1
            return self.thrusts(struct.unpack_from("<16H", data, 8))
        raise AutopilotGone("stopped")

    def thrusts(self, pwm_us) -> list[float]:
        """Thrust shares (4,) in our rotor order of its servo outputs [us]; what a motor with a curved thrust makes of them."""
        out = []
        for motor in MOTOR_OF_ROTOR:
            u = min(1.0, max(0.0, (pwm_us[motor] - self._low) / (self._high - self._low)))
            out.append((1.0 - self._expo) * u + self._expo * u * u)
        return out

    def ranges(self, tick, link: Passage) -> None:
        for message in both_ranges(tick, self.simulation.profile):
            link.tell_autopilot(message)


# ---------------------------------------------------------------- PX4


class Px4(External):
    """PX4 through its simulator_mavlink module: it connects by TCP, takes HIL_SENSOR and answers with HIL_ACTUATOR_CONTROLS.

    Args:
        port: where it connects to (4560 plus its instance).
    """

    physics_step_s = 0.0025
    split = ((2,) * 10,) * 2                  # HIL_SENSOR at 200 Hz
    flavour = "px4"
    IMU, BARO = 0x003F, 0x1A00                # of HIL_SENSOR.fields_updated
    SHORT_WAIT_S = 0.2                        # for one answer; PX4 leaves one out now and then
    BOOT_STEP_S = 0.004                       # wall time of a step while it boots, when it answers none

    def __init__(self, port: int = 4560):
        super().__init__()
        self.port = port
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.bind(("127.0.0.1", port))
        self._server.listen(1)
        self._stream = None
        self._rest = b""
        self._mav = mav.MAVLink(None, srcSystem=1, srcComponent=51)
        self._answered_us = -1
        self._next_baro_us = self._next_beat_us = 0
        self.answers = self.left_out = 0

    def close(self) -> None:
        self._server.close()
        if self._stream is not None:
            self._stream.close()

    def connect(self, alive: Callable[[], str | None]) -> None:
        end = time.monotonic() + START_PATIENCE_S
        self._server.settimeout(0.5)
        while not self.stop():
            try:
                self._stream, _ = self._server.accept()
                self._stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return
            except TimeoutError:
                problem = alive()
                if problem or time.monotonic() > end:
                    raise AutopilotGone(problem or f"PX4 does not connect to TCP port {self.port}") from None
        raise AutopilotGone("stopped")

    def exchange(self, t_us: int, force_m_s2, rate_rad_s) -> list[float]:
        acc, gyro = ned(*force_m_s2), ned(*rate_rad_s)
        fields, pressure, height = self.IMU, 0.0, 0.0
        if t_us >= self._next_baro_us:
            self._next_baro_us = t_us + 50_000
            height = self.simulation.barometer.measure(t_us * 1e-6, self.simulation.vehicle.position_m[2])
            pressure = pressure_hpa(height)
            fields |= self.BARO
        self._send(mav.MAVLink_hil_sensor_message(t_us, *acc, *gyro, 0.0, 0.0, 0.0, pressure, 0.0, height, STANDARD_TEMPERATURE_C, fields, 0))
        if t_us >= self._next_beat_us:
            self._next_beat_us = t_us + 1_000_000
            self._send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3))
        booted = self._answered_us >= 0
        end = time.monotonic() + (self.SHORT_WAIT_S if booted else self.BOOT_STEP_S)
        while not self.stop():
            left = end - time.monotonic()
            if left <= 0.0:
                self.left_out += booted
                if booted and t_us - self._answered_us > 1_000_000 and self._silent_for(ANSWER_PATIENCE_S):
                    raise AutopilotGone("PX4 does not answer any more")
                break
            self._stream.settimeout(left)
            try:
                data = self._stream.recv(65536)
            except TimeoutError:
                continue
            except OSError:
                data = b""
            if not data:
                raise AutopilotGone("PX4 has ended")
            if self._take(data, t_us):
                break
        return self.rotors

    def _silent_for(self, seconds: float) -> bool:
        return time.monotonic() - self._answered_wall > seconds

    def _take(self, data: bytes, t_us: int) -> bool:
        data = self._rest + data
        end, done = 0, False
        for frame in frames(data):
            end = frame.end
            if frame.message != mav.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
                continue
            body = payload(data, frame).ljust(81, b"\0")
            stamp = struct.unpack_from("<Q", body)[0]
            controls = struct.unpack_from("<16f", body, 16)
            armed = body[80] & mav.MAV_MODE_FLAG_SAFETY_ARMED
            self.rotors = [min(1.0, max(0.0, controls[m])) if armed and math.isfinite(controls[m]) else 0.0 for m in MOTOR_OF_ROTOR]
            self._answered_us, self._answered_wall = t_us, time.monotonic()
            self.answers += 1
            done = done or stamp >= t_us
        self._rest = data[end:]
        return done

    def _send(self, message) -> None:
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) & 255
        try:
            self._stream.sendall(data)
        except OSError:
            raise AutopilotGone("PX4 has ended") from None

    def ranges(self, tick, link: Passage) -> None:
        for message in both_ranges(tick, self.simulation.profile):
            self._send(message)


REAL = {"ardupilot": Ardupilot, "px4": Px4}
