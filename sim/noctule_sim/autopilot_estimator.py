"""What the simulated autopilot believes of itself, from its IMU and the companion's ODOMETRY alone.

A fixed-gain observer: the IMU carries attitude, velocity and position; each ODOMETRY is compared with what was believed
at its own time (it comes late), and the difference corrects position, velocity, tilt, yaw and the biases. Without
ODOMETRY the tilt leans on gravity and the position drifts with the IMU. Scalars, not arrays: it runs 250 times a second
of simulated time. Model and gains: docs/maths/vehicle.md, section 4.

Frame Map of the companion (forward-left-up at its start), because position and yaw come from there; Body
forward-left-up. SI.
"""

from __future__ import annotations

import math
from collections import deque

from .vehicle import GRAVITY_M_S2

# Observer gains on a position difference: 1/s, 1/s^2, 1/s^3, and on a velocity difference: 1/s, 1/s^2.
POSITION_GAIN, VELOCITY_GAIN, ACCEL_GAIN = 5.0, 6.0, 2.0
VELOCITY_GAIN_V, ACCEL_GAIN_V = 2.0, 1.0
YAW_GAIN = 4.0                # 1/s
BIAS_SHARE = 0.10             # of a turn correction that is laid to the gyro's bias, 1/s
GRAVITY_GAIN_REST = 1.0       # 1/s, lean on gravity while standing
GRAVITY_GAIN_BLIND = 0.05     # 1/s, in flight without ODOMETRY
REST_BIAS_GAIN = 0.5          # 1/s
FRESH_S = 0.5                 # ODOMETRY younger than this counts as aid
HISTORY = 96                  # inertial states kept, 0.38 s at 250 Hz
STEP_MAX_S = 0.1              # longest interval that one ODOMETRY stands for


class Estimator:
    """Attitude, velocity and position of the vehicle as the autopilot knows them.

    Attributes: qw, qx, qy, qz (Body to Map); x, y, z [m]; vx, vy, vz [m/s]; yaw_rad; wx, wy, wz [rad/s], rate less bias,
    frame Body. aided: ODOMETRY is fresh. refused: ODOMETRY messages not used.
    """

    def __init__(self):
        self.qw, self.qx, self.qy, self.qz = 1.0, 0.0, 0.0, 0.0
        self.x = self.y = self.z = 0.0
        self.vx = self.vy = self.vz = 0.0
        self.wx = self.wy = self.wz = 0.0
        self.force_z = GRAVITY_M_S2
        self.bias_x = self.bias_y = self.bias_z = 0.0   # gyro [rad/s]
        self.bias_up = 0.0                              # accelerometer, vertical [m/s^2]
        self.t_us = 0
        self.last_odometry_us = None                    # time of measurement
        self.last_heard_us = None                       # time of arrival
        self.first_heard_us = None                      # start of the present unbroken stream
        self.reset_counter = None
        self.refused = 0
        self.tilt_known = False
        self._history = deque(maxlen=HISTORY)

    @property
    def yaw_rad(self) -> float:
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def odometry_age_s(self) -> float:
        """Time since the last ODOMETRY that was used [s]; infinity: none yet."""
        return math.inf if self.last_heard_us is None else (self.t_us - self.last_heard_us) * 1e-6

    @property
    def aided(self) -> bool:
        return self.odometry_age_s() < FRESH_S

    def steady_s(self) -> float:
        """How long ODOMETRY has been coming without a break [s]."""
        return (self.t_us - self.first_heard_us) * 1e-6 if self.first_heard_us is not None and self.aided else 0.0

    def predict(self, t_us: int, dt_s: float, ax, ay, az, gx, gy, gz, at_rest: bool) -> None:
        """Carry the state over dt_s with one inertial sample (means over that time, frame Body).

        Source: docs/maths/vehicle.md, equations (10) to (12).
        """
        self.t_us = t_us
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        if not self.tilt_known:  # level with gravity at the first sample
            roll, pitch = math.atan2(ay, az), math.atan2(-ax, math.hypot(ay, az))
            cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
            w, x, y, z = cr * cp, sr * cp, cr * sp, -sr * sp
            self.tilt_known = True
        wx, wy, wz = gx - self.bias_x, gy - self.bias_y, gz - self.bias_z
        self.wx, self.wy, self.wz = wx, wy, wz
        self.force_z = az
        # Lean on gravity: the turn that would bring the measured up to Body's idea of up, only where nothing better is there.
        ux, uy, uz = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        norm = math.sqrt(ax * ax + ay * ay + az * az)
        lean = GRAVITY_GAIN_REST if at_rest else (0.0 if self.aided else GRAVITY_GAIN_BLIND)
        cx = cy = cz = 0.0
        if lean > 0.0 and abs(norm - GRAVITY_M_S2) < 1.0:
            k = lean / norm
            cx, cy, cz = k * (ay * uz - az * uy), k * (az * ux - ax * uz), k * (ax * uy - ay * ux)
        hx, hy, hz = 0.5 * dt_s * (wx + cx), 0.5 * dt_s * (wy + cy), 0.5 * dt_s * (wz + cz)
        nw = w - x * hx - y * hy - z * hz
        nx = x + w * hx + y * hz - z * hy
        ny = y + w * hy + z * hx - x * hz
        nz = z + w * hz + x * hy - y * hx
        n = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
        # The force was averaged over the step: turn it by the attitude half way.
        mw, mx, my, mz = w + nw * n, x + nx * n, y + ny * n, z + nz * n
        m = 1.0 / math.sqrt(mw * mw + mx * mx + my * my + mz * mz)
        mw, mx, my, mz = mw * m, mx * m, my * m, mz * m
        self.qw, self.qx, self.qy, self.qz = nw * n, nx * n, ny * n, nz * n
        fx = (1 - 2 * (my * my + mz * mz)) * ax + 2 * (mx * my - mw * mz) * ay + 2 * (mx * mz + mw * my) * az
        fy = 2 * (mx * my + mw * mz) * ax + (1 - 2 * (mx * mx + mz * mz)) * ay + 2 * (my * mz - mw * mx) * az
        fz = 2 * (mx * mz - mw * my) * ax + 2 * (my * mz + mw * mx) * ay + (1 - 2 * (mx * mx + my * my)) * az - GRAVITY_M_S2 - self.bias_up
        if at_rest:  # standing: the velocity is known, the gyro shows its bias, the force its own
            self.vx = self.vy = self.vz = 0.0
            g = REST_BIAS_GAIN * dt_s
            self.bias_x += g * wx
            self.bias_y += g * wy
            self.bias_z += g * wz
            self.bias_up += g * fz
        else:
            self.x += dt_s * (self.vx + 0.5 * dt_s * fx)
            self.y += dt_s * (self.vy + 0.5 * dt_s * fy)
            self.z += dt_s * (self.vz + 0.5 * dt_s * fz)
            self.vx += dt_s * fx
            self.vy += dt_s * fy
            self.vz += dt_s * fz
        self._history.append((t_us, self.x, self.y, self.z, self.vx, self.vy, self.vz, self.yaw_rad))

    def odometry(self, t_us: int, x, y, z, vx, vy, vz, yaw_rad, quality: int, reset_counter: int) -> bool:
        """Take one ODOMETRY, measured at t_us (frame Map). False: it was not used (lost, malformed, too old, or of the future).

        Source: docs/maths/vehicle.md, equations (13) to (16).
        """
        if quality < 0 or not math.isfinite(x + y + z + vx + vy + vz + yaw_rad) or not self._history:
            self.refused += 1
            return False
        then = None
        for entry in reversed(self._history):
            if entry[0] <= t_us:
                then = entry
                break
        if then is None or t_us > self.t_us + 1000 or (self.last_odometry_us is not None and t_us <= self.last_odometry_us):
            self.refused += 1
            return False
        late = (t_us - then[0]) * 1e-6
        ex, ey, ez = x - then[1] - late * then[4], y - then[2] - late * then[5], z - then[3] - late * then[6]
        ux, uy, uz = vx - then[4], vy - then[5], vz - then[6]
        turn = _wrap(yaw_rad - then[7])
        fresh_start = not self.aided or reset_counter != self.reset_counter
        if not self.aided:
            self.first_heard_us = self.t_us
        dt = STEP_MAX_S if self.last_odometry_us is None else min(STEP_MAX_S, (t_us - self.last_odometry_us) * 1e-6)
        self.last_odometry_us, self.last_heard_us, self.reset_counter = t_us, self.t_us, reset_counter
        if fresh_start:  # a jump, announced by the counter or after silence: follow it at once
            self._jump(ex, ey, ez, ux, uy, uz, turn)
            return True
        kp, kv, ka, qv, qa = POSITION_GAIN * dt, VELOCITY_GAIN * dt, ACCEL_GAIN * dt, VELOCITY_GAIN_V * dt, ACCEL_GAIN_V * dt
        self.x += kp * ex
        self.y += kp * ey
        self.z += kp * ez
        self.vx += kv * ex + qv * ux
        self.vy += kv * ey + qv * uy
        self.vz += kv * ez + qv * uz
        self.bias_up -= ka * ez + qa * uz
        # A horizontal acceleration that was missing is a tilt that was wrong: turn d (Map) with d x (0, 0, g) = e.
        dx, dy, dz = -(ka * ey + qa * uy) / GRAVITY_M_S2, (ka * ex + qa * ux) / GRAVITY_M_S2, YAW_GAIN * dt * turn
        self._turn(dx, dy, dz)
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        self.bias_x -= BIAS_SHARE * ((1 - 2 * (y * y + z * z)) * dx + 2 * (x * y + w * z) * dy + 2 * (x * z - w * y) * dz)
        self.bias_y -= BIAS_SHARE * (2 * (x * y - w * z) * dx + (1 - 2 * (x * x + z * z)) * dy + 2 * (y * z + w * x) * dz)
        self.bias_z -= BIAS_SHARE * (2 * (x * z + w * y) * dx + 2 * (y * z - w * x) * dy + (1 - 2 * (x * x + y * y)) * dz)
        return True

    def _turn(self, dx, dy, dz) -> None:
        """Turn the attitude by a small rotation vector, frame Map."""
        hx, hy, hz = 0.5 * dx, 0.5 * dy, 0.5 * dz
        hw = math.sqrt(max(0.0, 1.0 - hx * hx - hy * hy - hz * hz))
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        nw, nx, ny, nz = (hw * w - hx * x - hy * y - hz * z, hw * x + hx * w + hy * z - hz * y,
                          hw * y + hy * w + hz * x - hx * z, hw * z + hz * w + hx * y - hy * x)
        n = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
        self.qw, self.qx, self.qy, self.qz = nw * n, nx * n, ny * n, nz * n

    def _jump(self, ex, ey, ez, ux, uy, uz, turn) -> None:
        self.x += ex
        self.y += ey
        self.z += ez
        self.vx += ux
        self.vy += uy
        self.vz += uz
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        c, s = math.cos(turn / 2), math.sin(turn / 2)
        self.qw, self.qx, self.qy, self.qz = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
        self._history = deque(
            ((t, a + ex, b + ey, c_ + ez, d + ux, e + uy, f + uz, _wrap(g + turn)) for t, a, b, c_, d, e, f, g in self._history),
            maxlen=HISTORY,
        )


def _wrap(angle_rad: float) -> float:
    """The angle in (-pi, pi]."""
    wrapped = math.fmod(angle_rad, 2.0 * math.pi)
    if wrapped <= -math.pi:
        return wrapped + 2.0 * math.pi
    return wrapped - 2.0 * math.pi if wrapped > math.pi else wrapped
