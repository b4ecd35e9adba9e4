"""What only the tests may do: fly the autopilot on the truth, made a little worse, in place of a companion."""

import math

import numpy as np

from noctule_sim.autopilot import Mode
from noctule_sim.simulation import OdometryIn, SetpointIn, Simulation
from noctule_sim.world import build_world

HALL = {
    "name": "hall",
    "start": {"x": 10.3, "y": 9.7, "yaw_deg": 17},
    "floors": [{"elevation": 0.0, "height": 6.0, "extent": [0, 0, 20, 20]}],
    "walls": [
        {"from": [0, 0], "to": [20, 0]}, {"from": [20, 0], "to": [20, 20]},
        {"from": [20, 20], "to": [0, 20]}, {"from": [0, 20], "to": [0, 0]},
    ],
}


def hall():
    """An empty hall of 20 x 20 x 6 m."""
    return build_world(HALL)


def hold(_t_s):
    """One metre over the start."""
    return SetpointIn(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)


class Flight:
    """Runs a simulation in a closed loop of its own and keeps what happened, frame Map.

    Attributes after run(): t_s (N,), true (N, 4) x y z yaw, believed (N, 4), velocity (N, 3), tilt_error_rad (N,), said (time, text).
    """

    def __init__(self, seed=1, profile="default", noise_m=0.01, setpoints=hold, arm_at_s=2.0, mute=None, **options):
        self.simulation = Simulation(hall(), seed, profile, **options)
        self.simulation.autopilot.arm_settle_s = 0.0
        self._setpoints, self._arm_at_s, self._noise_m, self._mute = setpoints, arm_at_s, noise_m, mute or (lambda t: False)
        self._rng = np.random.default_rng(99)
        self.said, self.ticks, self._rows = [], [], []
        self._asked = False

    def run(self, until_s):
        s = self.simulation
        start = s.world.start
        c, n = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
        while s.t_us * 1e-6 < until_s - 1e-9 and s.outcome is None:
            d = s.tick()
            t, t_s = d.truth, d.t_us * 1e-6
            dx, dy = t.x_m - start.x_m, t.y_m - start.y_m
            yaw = math.remainder(t.yaw_rad - start.yaw_rad, 2 * math.pi)
            true = (c * dx + n * dy, c * dy - n * dx, t.z_m, yaw)
            velocity = (c * t.vx_m_s + n * t.vy_m_s, c * t.vy_m_s - n * t.vx_m_s, t.vz_m_s)
            e = self._rng.standard_normal(7) * self._noise_m
            answer = [] if self._mute(t_s) else [OdometryIn(
                d.t_us, true[0] + e[0], true[1] + e[1], true[2] + e[2], velocity[0] + e[3], velocity[1] + e[4], velocity[2] + e[5],
                yaw + 0.2 * e[6], 90, 0)]
            s.apply(self._setpoints(t_s) if self._setpoints else None, answer)
            if not self._asked and t_s >= self._arm_at_s:
                self._asked = True
                s.post(lambda: s.autopilot.set_mode(Mode.offboard))
                s.post(s.autopilot.arm)
            roll, pitch, _ = d.attitude[-1].euler_rad
            self.said += [(t_s, text) for _, text in d.messages]
            self.ticks.append(d)
            self._rows.append((t_s, *true, *d.local[:3], d.local[6], *velocity, math.hypot(roll - t.roll_rad, pitch - t.pitch_rad)))
        table = np.array(self._rows)
        self.t_s, self.true, self.believed = table[:, 0], table[:, 1:5], table[:, 5:9]
        self.velocity, self.tilt_error_rad = table[:, 9:12], table[:, 12]
        return self

    def heard(self, part):
        """Time of the first message that holds this text; None: never."""
        return next((t for t, text in self.said if part in text), None)
