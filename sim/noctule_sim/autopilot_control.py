"""The simulated autopilot's cascade: position, velocity, attitude, rate, rotors.

The same structure as PX4's multicopter controllers: a proportional position loop with the setpoint's velocity fed
forward, a velocity loop with an integrator, a thrust vector that sets tilt and collective, a quaternion attitude loop
and a rate loop on normalised torques. Scalars, run at each inertial sample. Gains and their reasons:
docs/maths/vehicle.md, section 5. Frame Map (forward-left-up) and Body (forward-left-up), SI.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .autopilot_estimator import Estimator
from .vehicle import GRAVITY_M_S2, Airframe


class Gains(NamedTuple):
    """Of the horizontal loops: position [1/s], velocity [1/s], its integral [1/s^2], share of the setpoints' acceleration fed forward."""

    position: float
    velocity: float
    integral: float
    feed: float


BRISK = Gains(1.7, 4.0, 1.2, 1.0)
SLUGGISH = Gains(0.95, 1.8, 0.4, 0.0)   # PX4's defaults: a setpoint that brakes is flown past

HEIGHT_P = 1.6              # 1/s
CLIMB_P = 5.0               # 1/s
CLIMB_I = 2.0               # 1/s^2
ATTITUDE_P = 7.5            # 1/s
YAW_P = 3.0                 # 1/s
RATE_P = (20.0, 20.0, 9.0)  # 1/s, on angular acceleration
RATE_I = (12.0, 12.0, 4.0)  # 1/s^2
SPEED_MAX_M_S = 2.5
CLIMB_MAX_M_S = 1.5
SINK_MAX_M_S = 1.0
ACCEL_MAX_M_S2 = 4.0
RATE_MAX_RAD_S = 3.5
YAW_RATE_MAX_RAD_S = 1.8
CARRY_S = 0.10              # PX4 keeps a setpoint as it is; this bridges the time between two
FEED_ACCEL_MAX_M_S2 = 2.0
BLIND_ACCEL_MAX_M_S2 = 1.5
IDLE_SHARE = 0.01           # rotor thrust share when armed on the ground


class Setpoint:
    """Where to be: position [m], velocity feed-forward [m/s], yaw [rad], frame Map; and since when [us]."""

    __slots__ = ("t_us", "x", "y", "z", "vx", "vy", "vz", "yaw", "ax", "ay", "az")

    def __init__(self, t_us, x, y, z, vx, vy, vz, yaw):
        self.t_us, self.x, self.y, self.z, self.yaw = t_us, x, y, z, yaw
        self.vx, self.vy, self.vz = vx, vy, vz
        self.ax = self.ay = self.az = 0.0

    def follow(self, before: "Setpoint | None") -> None:
        """Take the acceleration to feed forward from the change of velocity since the setpoint before, smoothed."""
        if before is None:
            return
        dt = (self.t_us - before.t_us) * 1e-6
        if not 0.005 <= dt <= 0.3:
            return
        top = FEED_ACCEL_MAX_M_S2
        self.ax = 0.5 * before.ax + 0.5 * max(-top, min(top, (self.vx - before.vx) / dt))
        self.ay = 0.5 * before.ay + 0.5 * max(-top, min(top, (self.vy - before.vy) / dt))
        self.az = 0.5 * before.az + 0.5 * max(-top, min(top, (self.vz - before.vz) / dt))


class Controller:
    """Turns a setpoint and the estimate into rotor demands. `lift` is the collective thrust asked for, 1 is hover.

    Args:
        airframe: constants of the vehicle.
        carry_s: a position setpoint is carried on with its velocity for at most this long (ArduPilot: until its time-out).
    """

    def __init__(self, airframe: Airframe, carry_s: float = CARRY_S):
        self.airframe = airframe
        self.carry_s = carry_s
        self.gains = BRISK
        self.rotors = [0.0, 0.0, 0.0, 0.0]
        self.lift = 0.0
        self.climb_wanted_m_s = 0.0
        self.relax()

    def relax(self) -> None:
        """Forget all integrators."""
        self._ix = self._iy = self._iz = 0.0
        self._rx = self._ry = self._rz = 0.0

    def stop(self) -> None:
        self.rotors = [0.0, 0.0, 0.0, 0.0]
        self.lift = 0.0
        self.relax()

    def idle(self) -> None:
        self.rotors = [IDLE_SHARE] * 4
        self.lift = 0.0
        self.relax()

    def step(self, e: Estimator, sp: Setpoint, dt_s: float, blind: bool, lift_max: float) -> list[float]:
        """Rotor demands (4,) for the next dt_s as shares of the greatest thrust.

        Args:
            blind: the position is not known: brake softly, follow only sp.vz.
            lift_max: greatest collective thrust, hover is 1 (the ground spool-up and the touch-down limit it).

        Source: docs/maths/vehicle.md, equations (20) to (26).
        """
        g = self.gains
        if blind:  # brake on the inertial velocity, which is good for some seconds
            ax = max(-BLIND_ACCEL_MAX_M_S2, min(BLIND_ACCEL_MAX_M_S2, -0.5 * g.velocity * e.vx))
            ay = max(-BLIND_ACCEL_MAX_M_S2, min(BLIND_ACCEL_MAX_M_S2, -0.5 * g.velocity * e.vy))
            climb = sp.vz
        else:
            carry = min(self.carry_s, max(0.0, (e.t_us - sp.t_us) * 1e-6))
            vx = sp.vx + g.position * (sp.x + carry * sp.vx - e.x)
            vy = sp.vy + g.position * (sp.y + carry * sp.vy - e.y)
            speed = math.sqrt(vx * vx + vy * vy)
            if speed > SPEED_MAX_M_S:
                vx, vy = vx * SPEED_MAX_M_S / speed, vy * SPEED_MAX_M_S / speed
            climb = sp.vz + HEIGHT_P * (sp.z + carry * sp.vz - e.z)
            ex, ey = vx - e.vx, vy - e.vy
            ax, ay = g.feed * sp.ax + g.velocity * ex + self._ix, g.feed * sp.ay + g.velocity * ey + self._iy
            size = math.sqrt(ax * ax + ay * ay)
            if size > ACCEL_MAX_M_S2:
                ax, ay = ax * ACCEL_MAX_M_S2 / size, ay * ACCEL_MAX_M_S2 / size
            else:
                self._ix = max(-2.0, min(2.0, self._ix + dt_s * g.integral * ex))
                self._iy = max(-2.0, min(2.0, self._iy + dt_s * g.integral * ey))
        climb = max(-SINK_MAX_M_S, min(CLIMB_MAX_M_S, climb))
        self.climb_wanted_m_s = climb
        ez = climb - e.vz
        az = (0.0 if blind else sp.az) + CLIMB_P * ez + self._iz
        up = az + GRAVITY_M_S2
        top = lift_max * GRAVITY_M_S2
        if up < 0.15 * GRAVITY_M_S2 and lift_max >= 1.0:
            up = 0.15 * GRAVITY_M_S2
        elif up > top:
            up = top
        else:
            self._iz = max(-4.0, min(4.0, self._iz + dt_s * CLIMB_I * ez))
        up = max(up, 0.05 * GRAVITY_M_S2)
        # Thrust vector: its direction is the wanted Body z, its length along the present Body z the collective.
        length = math.sqrt(ax * ax + ay * ay + max(up, 3.0) ** 2)
        zx, zy, zz = ax / length, ay / length, max(up, 3.0) / length
        w, x, y, z = e.qw, e.qx, e.qy, e.qz
        cos_tilt = 1.0 - 2.0 * (x * x + y * y)
        self.lift = min(lift_max, up / GRAVITY_M_S2 / max(cos_tilt, 0.5))
        # Attitude wanted: yaw, then the shortest turn that brings z up to (zx, zy, zz).
        cy, sy = math.cos(sp.yaw / 2), math.sin(sp.yaw / 2)
        tw = math.sqrt(0.5 * (1.0 + zz))
        tx, ty = -zy / (2.0 * tw), zx / (2.0 * tw)
        dw, dx, dy, dz = tw * cy, tx * cy + ty * sy, ty * cy - tx * sy, tw * sy
        # Error in Body: inverse(q) * wanted.
        ew = w * dw + x * dx + y * dy + z * dz
        sx = w * dx - x * dw - y * dz + z * dy
        sy_ = w * dy + x * dz - y * dw - z * dx
        sz = w * dz - x * dy + y * dx - z * dw
        if ew < 0.0:
            sx, sy_, sz = -sx, -sy_, -sz
        top = RATE_MAX_RAD_S
        px = max(-top, min(top, 2.0 * ATTITUDE_P * sx))
        py = max(-top, min(top, 2.0 * ATTITUDE_P * sy_))
        pz = max(-YAW_RATE_MAX_RAD_S, min(YAW_RATE_MAX_RAD_S, 2.0 * YAW_P * sz))
        ox, oy, oz = px - e.wx, py - e.wy, pz - e.wz
        alpha_x, alpha_y, alpha_z = RATE_P[0] * ox + self._rx, RATE_P[1] * oy + self._ry, RATE_P[2] * oz + self._rz
        if self.lift > 0.4:
            self._rx = max(-20.0, min(20.0, self._rx + dt_s * RATE_I[0] * ox))
            self._ry = max(-20.0, min(20.0, self._ry + dt_s * RATE_I[1] * oy))
            self._rz = max(-5.0, min(5.0, self._rz + dt_s * RATE_I[2] * oz))
        return self._mix(alpha_x, alpha_y, alpha_z)

    def _mix(self, alpha_x, alpha_y, alpha_z) -> list[float]:
        """Angular accelerations and lift to rotors; yaw gives way first when a rotor would leave its range."""
        a = self.airframe
        base = self.lift * a.hover_share
        unit = 1.0 / (4.0 * a.rotor_thrust_max_n)
        roll = alpha_x * a.inertia_kg_m2[0] / a.rotor_offset_m * unit
        pitch = alpha_y * a.inertia_kg_m2[1] / a.rotor_offset_m * unit
        yaw = alpha_z * a.inertia_kg_m2[2] / a.rotor_torque_per_thrust_m * unit
        room = max(0.0, min(base, 1.0 - base) - abs(roll) - abs(pitch))
        yaw = max(-room, min(room, yaw))
        self.rotors = [
            max(0.002, min(1.0, base + roll * a.rotor_y[i] - pitch * a.rotor_x[i] + yaw * a.rotor_torque[i])) for i in range(4)
        ]
        return self.rotors
