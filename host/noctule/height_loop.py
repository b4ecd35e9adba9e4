"""The height kept in whole flights: over tables and up a staircase, in the simulator, with the firmware in the loop.

The mission takes off and is then paused; where it is to fly comes from a list of waypoints (frame World), how high it is to fly
comes from the mission alone. So the height command, the estimate and the vehicle are what is measured, whatever the
explorer would have chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

PAUSED = 8
LOOKING_AROUND = 2
KEPT_M, STAIR_M = 1.0, 0.5      # over the floor; over the tread
SETTLED_S = 0.5                 # the end of the time over one tread, where the height is judged
EDGE_S = 1.0                    # before and after an edge


@dataclass(frozen=True)
class Script:
    """Waypoints (x [m], y [m], speed to it [m/s]), frame World, and where it flies."""

    world: str
    way: tuple[tuple[float, float, float], ...]


TABLES = Script("levels", ((2.9, 3.3, 0.5), (7.3, 3.7, 0.5), (2.9, 3.6, 0.5), (5.1, 3.6, 0.5), (5.1, 1.6, 0.5)))
STAIRS = Script("two_floor", ((6.0, 5.2, 0.5), (6.3, 8.5, 0.5), (7.2, 11.0, 0.5), (7.7, 12.15, 0.4), (8.5, 12.15, 0.3),
                              (12.3, 12.15, 0.10), (13.6, 12.15, 0.3)))


@dataclass
class Log:
    """One row a tick of the scripted part. z over the start's floor [m]."""

    t_s: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    z_m: np.ndarray
    estimate_m: np.ndarray
    variance_m2: np.ndarray
    command_m: np.ndarray
    below_m: np.ndarray        # true elevation of what lies under the vehicle
    finished: bool             # the script came to its end
    collisions: int
    lost: int                  # steps without a pose


class _Walker:
    """Where the vehicle is to be: along the waypoints at their speeds, slower at the corners."""

    def __init__(self, x_m: float, y_m: float, way):
        self._points = [(x_m, y_m, 0.0), *way]
        self._leg, self._gone, self._speed = 0, 0.0, 0.0

    @property
    def done(self) -> bool:
        return self._leg >= len(self._points) - 1

    def step(self, dt_s: float) -> tuple[float, float, float, float]:
        """Place and velocity, frame World."""
        if self.done:
            return self._points[-1][0], self._points[-1][1], 0.0, 0.0
        (x0, y0, _), (x1, y1, most) = self._points[self._leg:self._leg + 2]
        length = max(math.hypot(x1 - x0, y1 - y0), 1e-9)
        left = length - self._gone
        self._speed = min(self._speed + 0.4 * dt_s, most, math.sqrt(2 * 0.3 * max(left, 0.0)) + 0.02)
        self._gone += self._speed * dt_s
        if self._gone >= length:
            self._leg, self._gone = self._leg + 1, 0.0
            return x1, y1, 0.0, 0.0
        ux, uy = (x1 - x0) / length, (y1 - y0) / length
        return x0 + ux * self._gone, y0 + uy * self._gone, ux * self._speed, uy * self._speed


def surface_below(primitives, x_m: float, y_m: float, z_m: float) -> float:
    """Elevation of the highest top under the point, frame World."""
    best = -math.inf
    for p in primitives:
        top = p.centre_m[2] + p.half_extent_m[2]
        if top > z_m or top <= best:
            continue
        dx, dy = x_m - p.centre_m[0], y_m - p.centre_m[1]
        if p.kind == "cylinder":
            inside = math.hypot(dx, dy) <= p.half_extent_m[0]
        else:
            c, s = math.cos(p.yaw_rad), math.sin(p.yaw_rad)
            inside = abs(c * dx + s * dy) <= p.half_extent_m[0] and abs(c * dy - s * dx) <= p.half_extent_m[1]
        if inside:
            best = top
    return best


def fly(script: Script, seed: int, profile: str = "default", max_time_s: float = 240.0) -> Log:
    """Flies the script once.

    Raises:
        LibraryMissing: the firmware's shared library was not built.
    """
    from noctule import record
    from noctule.inprocess import Node
    from noctule.inprocess_flight import VEHICLE_US, _Encoder, _Starter
    from noctule.settings import FlightSettings, parameter_values
    from noctule_sim.simulation import OdometryIn, SetpointIn, Simulation
    from noctule_sim.world import load_world

    world = load_world(script.world)
    simulation = Simulation(world, seed, profile, parameter_values(FlightSettings(world=script.world)), max_time_s=max_time_s)
    encoder, starter, primitives = _Encoder(simulation), _Starter(), world.primitives()
    nav_type, odom_type = record.message_type("nav_t"), record.message_type("odom_t")
    start = world.start
    c, s = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
    nav, walker, shown, next_vehicle_us, rows, lost = None, None, None, 0, [], 0
    try:
        with Node() as node:
            while simulation.outcome is None and not (walker is not None and walker.done):
                data = simulation.tick()
                autopilot = simulation.autopilot
                state = (autopilot.armed, autopilot.mode, autopilot.landed, starter.lost)
                if state != shown or data.t_us >= next_vehicle_us:
                    shown, next_vehicle_us = state, data.t_us + VEHICLE_US
                    node.receive("VEHICLE", encoder.vehicle(data, autopilot, starter.lost))
                if nav is not None and nav.ready and starter.started_us is None:
                    starter.started_us = data.t_us
                    node.receive("COMMAND", encoder.start(data.t_us))
                if nav is not None and nav.state == LOOKING_AROUND:
                    node.receive("COMMAND", _pause(encoder, data.t_us))
                for a in data.attitude:
                    node.receive("ATTITUDE", encoder.attitude(a))
                node.receive("RANGE_UP", encoder.range(data.t_us, data.range_up_m, True))
                node.receive("RANGE_DOWN", encoder.range(data.t_us, data.range_down_m, False))
                node.receive("BARO", encoder.baro(data.t_us, data.baro_m))
                for sample in data.imu:
                    node.receive("IMU", encoder.imu(sample))
                if data.scan_m is not None:
                    node.receive("SCAN", encoder.scan(data.t_us, data.scan_m))
                setpoint, odometries = None, []
                for channel, message in node.outputs():
                    if channel == "NAV":
                        nav = nav_type.decode(message)
                        if nav.setpoint_valid and not starter.lost:
                            setpoint = SetpointIn(nav.setpoint_x_m, nav.setpoint_y_m, nav.setpoint_z_m, nav.setpoint_vx_m_s,
                                                  nav.setpoint_vy_m_s, nav.setpoint_vz_m_s, nav.setpoint_yaw_rad)
                    elif channel == "ODOM":
                        o = odom_type.decode(message)
                        odometries.append(OdometryIn(o.t_us, o.x_m, o.y_m, o.z_m, o.vx_m_s, o.vy_m_s, o.vz_m_s, o.yaw_rad, o.quality,
                                                     o.reset_counter & 0xFF))
                if nav is not None and nav.state == PAUSED and setpoint is not None:
                    if walker is None:
                        walker = _Walker(data.truth.x_m, data.truth.y_m, script.way)
                    x, y, vx, vy = walker.step(0.05)
                    dx, dy = x - start.x_m, y - start.y_m
                    setpoint = setpoint._replace(x_m=c * dx + s * dy, y_m=c * dy - s * dx, vx_m_s=c * vx + s * vy, vy_m_s=c * vy - s * vx)
                    t = data.truth
                    lost += int(nav.quality < 0)
                    rows.append((t.t_s, t.x_m, t.y_m, t.z_m - start.z_m, nav.z_m, nav.z_var_m2, setpoint.z_m,
                                 surface_below(primitives, t.x_m, t.y_m, t.z_m) - start.z_m))
                simulation.apply(setpoint, odometries)
                if nav is not None:
                    starter.act(simulation, nav)
            collisions = simulation.collisions
    finally:
        simulation.close()
    columns = np.array(rows).T if rows else np.zeros((8, 0))
    return Log(*columns, finished=walker is not None and walker.done, collisions=collisions, lost=lost)


def _pause(encoder, t_us: int) -> bytes:
    from noctule import record

    m = record.message_type("command_t")()
    m.t_us, m.seq, m.command = t_us, encoder._next("command"), m.PAUSE
    return m.encode()


def wanted_m(below_m: np.ndarray, stairs: np.ndarray) -> np.ndarray:
    """The height over the start's floor that issue 4 asks for: KEPT_M, but STAIR_M over a tread where that is higher."""
    return np.where(stairs, np.maximum(KEPT_M, below_m + STAIR_M), KEPT_M)


def edge_steps_m(log: Log, rise_m: float = 0.3) -> np.ndarray:
    """How much the mean height changes from EDGE_S before to EDGE_S after each edge higher than rise_m."""
    steps = []
    for k in np.flatnonzero(np.abs(np.diff(log.below_m)) > rise_m):
        t = log.t_s[k]
        before = (log.t_s > t - EDGE_S) & (log.t_s <= t)
        after = (log.t_s > t) & (log.t_s <= t + EDGE_S)
        steps.append(log.z_m[after].mean() - log.z_m[before].mean())
    return np.array(steps)


def tread_errors_m(log: Log) -> np.ndarray:
    """Signed error at the end of the time over each tread: true height less the one asked for.

    A riser that is met before the vehicle could climb it is not an error of the height kept; what is judged is where it comes to.
    """
    errors = []
    changes = np.flatnonzero(np.abs(np.diff(log.below_m)) > 0.05)
    want = wanted_m(log.below_m, log.below_m > 0.05)
    for k in changes:
        if log.below_m[k] > 0.05:
            last = (log.t_s <= log.t_s[k]) & (log.t_s > log.t_s[k] - SETTLED_S) & (np.abs(log.below_m - log.below_m[k]) < 0.01)
            errors.append((log.z_m[last] - want[last]).mean())
    return np.array(errors)


def rows(quick: bool, fresh: bool) -> list[dict]:
    """The closed-loop rows of the bench."""
    from noctule.bench import row

    seeds = (1,) if quick else (1, 2, 3)
    tables = [fly(TABLES, seed) for seed in seeds]
    stairs = [fly(STAIRS, seed) for seed in seeds]
    harsh = [fly(STAIRS, seed, "harsh") for seed in seeds]
    cm = 100.0
    floor = [np.abs(v.z_m - KEPT_M).max(initial=0.0) for v in tables]
    before = [np.abs((v.z_m - KEPT_M)[np.cumsum(v.below_m > 0.05) == 0]).max(initial=0.0) for v in stairs]
    edges = [np.abs(edge_steps_m(v)).max(initial=0.0) for v in tables]
    treads = [np.abs(tread_errors_m(v)).max(initial=9.0 if not v.finished else 0.0) for v in stairs]
    nearest = [(v.z_m - v.below_m).min(initial=9.0) for v in stairs]
    squared = np.concatenate([(v.estimate_m - v.z_m) ** 2 / v.variance_m2 for v in tables])
    return [
        row("closed loop, levels: scripts flown to the end", sum(v.finished for v in tables), "-", None, f"== {len(seeds)}"),
        row("closed loop, levels: greatest error from 1.0 m over the floor", float(cm * max(floor)), "cm", None, "<= 5"),
        row("closed loop, levels: step at a table's edge, greatest", float(cm * max(edges)), "cm", None, "<= 2"),
        row("closed loop, levels: altitude error, mean", float(cm * np.mean([np.abs(v.estimate_m - v.z_m).mean() for v in tables])), "cm", None, "<= 1.0"),
        row("closed loop, levels: normalised error squared, mean of the flights", float(squared.mean()), "-"),
        row("closed loop, stairs: scripts flown to the end", sum(v.finished for v in stairs), "-", None, f"== {len(seeds)}"),
        row("closed loop, stairs: greatest error from 1.0 m over the lower floor", float(cm * max(before)), "cm", None, "<= 5"),
        row("closed loop, stairs: error over a tread, settled, greatest", float(cm * max(treads)), "cm", None, "<= 5"),
        row("closed loop, stairs: least height over a tread at any moment", float(cm * min(nearest)), "cm"),
        row("closed loop, stairs: altitude error, mean", float(cm * np.mean([np.abs(v.estimate_m - v.z_m).mean() for v in stairs])), "cm", None, "<= 1.0"),
        row("closed loop, stairs, harsh: scripts flown to the end", sum(v.finished for v in harsh), "-", None, f"== {len(seeds)}"),
        row("closed loop, stairs, harsh: altitude error, mean", float(cm * np.mean([np.abs(v.estimate_m - v.z_m).mean() for v in harsh])), "cm"),
        row("closed loop: collisions", sum(v.collisions for v in tables + stairs + harsh), "-", None, "== 0"),
        row("closed loop: steps without a pose", sum(v.lost for v in tables + stairs + harsh), "-"),
    ]
