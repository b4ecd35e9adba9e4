"""`noctule calibrate lidar`: how the laser is mounted, from one turn in place. docs/hardware.md, "calibrating the laser".

The vehicle stands with its nose square to a flat wall, then turns once about its own vertical axis, in a room with flat walls.
Unknown are the laser's place against the axis, its tilt, the gyro's bias and the walls; every point on a wall is one equation
(Gauss-Newton on the distance from point to wall). A turn alone cannot tell where forward is: the wall ahead at the start does.
The tilt shows in second order only, as a stretch of the room along one direction of the laser: its sign stays open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from noctule.settings import InputError

MOST_SWEEPS = 60             # spread evenly over the turn
LEAST_TURN_RAD = math.radians(300.0)
STILL_RAD_S = 0.03           # slower: not turning yet
FIRST_TURN_RAD = math.radians(60.0)   # solved first: the walls have not moved far in the laser's view by then
GATES_M = (0.30, 0.15, 0.08, 0.05, 0.04, 0.04)   # distance from point to wall, round by round
WALL_M, WALL_POINTS = 0.7, 25   # least length and points of a piece of wall
SPLIT_M = 0.05               # a piece that bends by more is two
END_M = 0.1                  # of a wall that is left out
AHEAD_RAD = math.radians(25.0)


@dataclass(frozen=True)
class Turn:
    """What was recorded. Angles of the beams count from the laser's zero bearing, anticlockwise; headings from the first sweep."""

    bearings_rad: np.ndarray     # (B,)
    ranges_m: np.ndarray         # (N, B), not finite where nothing was hit
    headings_rad: np.ndarray     # (N, B) turned since the first sweep when the beam was cast, by the gyro, its bias before the turn taken out
    seconds: np.ndarray          # (N, B) since the first sweep


@dataclass(frozen=True)
class Mounting:
    """What `calibrate` found, with standard deviations. Frame Body."""

    yaw_rad: float
    yaw_sigma_rad: float
    x_m: float
    y_m: float
    offset_sigma_m: float
    tilt_rad: float
    tilt_least_rad: float        # a smaller tilt would not have shown
    tilt_axis_rad: float         # the laser is tilted about this direction of Body, one way or the other
    residual_m: float            # points to walls, root mean square
    walls: int
    turned_rad: float


def pieces(x: np.ndarray, y: np.ndarray, split_m: float = SPLIT_M) -> list[tuple[int, int]]:
    """First and last index of the straight pieces of a row of points (split at the point farthest from the chord).

    >>> pieces(np.array([0.0, 1.0, 2.0, 2.0, 2.0]), np.array([0.0, 0.0, 0.0, 1.0, 2.0]))
    [(0, 2), (2, 4)]
    """
    done, open_ = [], [(0, len(x) - 1)]
    while open_:
        a, b = open_.pop()
        length = math.hypot(x[b] - x[a], y[b] - y[a])
        away = np.abs((x[b] - x[a]) * (y[a:b + 1] - y[a]) - (y[b] - y[a]) * (x[a:b + 1] - x[a])) / max(length, 1e-6)
        k = int(np.argmax(away))
        if away[k] > split_m and 0 < k < b - a:
            open_ += [(a + k, b), (a, a + k)]
        else:
            done.append((a, b))
    return sorted(done)


def walls_of(points: np.ndarray, order: np.ndarray) -> list[list[float]]:
    """Walls [alpha, rho, from, to] of one sweep: points (n, 2) and the number of each one's beam; jumps and gaps end a piece."""
    found = []
    step = np.hypot(*np.diff(points, axis=0).T)
    apart = np.nonzero((step > 0.3) | (np.diff(order) > 8))[0] + 1
    for run in np.split(np.arange(len(points)), apart):
        if len(run) < WALL_POINTS:
            continue
        for a, b in pieces(points[run, 0], points[run, 1]):
            part = points[run[a + 2:b - 1]]
            if len(part) < WALL_POINTS or math.dist(part[0], part[-1]) < WALL_M:
                continue
            middle = part.mean(axis=0)
            along = np.linalg.svd(part - middle, full_matrices=False)[2][0]
            alpha = math.atan2(along[0], -along[1])
            rho = middle[0] * math.cos(alpha) + middle[1] * math.sin(alpha)
            if rho < 0.0:
                alpha, rho = alpha + math.pi, -rho
            s = part @ np.array([-math.sin(alpha), math.cos(alpha)])
            found.append([alpha, rho, float(s.min()), float(s.max())])
    return found


def placed(turn: Turn, sweeps: np.ndarray, unknown: np.ndarray):
    """Points of sweeps in the laser's frame at the start, and what they move by for a small change of each unknown.

    Unknown: place of the laser (2), gyro bias, anisotropic stretch (2). Returns points (n, 2), their derivatives (n, 2, 5), beam and sweep numbers.
    """
    use = np.isfinite(turn.ranges_m[sweeps])
    row, beam = np.nonzero(use)
    r = turn.ranges_m[sweeps][use]
    p = np.stack([r * np.cos(turn.bearings_rad[beam]), r * np.sin(turn.bearings_rad[beam])], axis=1)
    t = turn.seconds[sweeps][use]
    heading = turn.headings_rad[sweeps][use] - unknown[2] * t
    c, s = np.cos(heading), np.sin(heading)
    e1, e2 = unknown[3:5]
    local = unknown[:2] + p - np.stack([e1 * p[:, 0] + e2 * p[:, 1], e2 * p[:, 0] - e1 * p[:, 1]], axis=1)
    turned = lambda v: np.stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]], axis=1)  # noqa: E731
    world = turned(local)
    slope = np.empty((len(r), 2, 5))
    slope[:, :, 0], slope[:, :, 1] = np.stack([c, s], axis=1), np.stack([-s, c], axis=1)
    slope[:, :, 2] = np.stack([world[:, 1] * t, -world[:, 0] * t], axis=1)
    slope[:, :, 3] = turned(np.stack([-p[:, 0], p[:, 1]], axis=1))
    slope[:, :, 4] = turned(np.stack([-p[:, 1], -p[:, 0]], axis=1))
    return world, slope, beam, sweeps[row]


def assign(world: np.ndarray, walls: np.ndarray, gate_m: float) -> np.ndarray:
    """Wall of each point, -1 where none is within the gate or more than one is."""
    normal = np.stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])])
    away = np.abs(world @ normal - walls[:, 1])
    along = world @ np.stack([-np.sin(walls[:, 0]), np.cos(walls[:, 0])])
    away[(along < walls[:, 2] + END_M) | (along > walls[:, 3] - END_M)] = np.inf   # corners: whose point is it?
    nearest = np.argmin(away, axis=1)
    others = np.partition(away, 1, axis=1)[:, 1] if len(walls) > 1 else np.full(len(world), np.inf)
    good = (away[np.arange(len(world)), nearest] < gate_m) & (others > 2.0 * gate_m)
    return np.where(good, nearest, -1)


def solve(turn: Turn, sweeps: np.ndarray, unknown: np.ndarray, walls: np.ndarray, gate_m: float):
    """One round of Gauss-Newton; the new unknowns and walls, the covariance of both and the residual."""
    world, slope, _, _ = placed(turn, sweeps, unknown)
    of = assign(world, walls, gate_m)
    keep = of >= 0
    world, slope, of = world[keep], slope[keep], of[keep]
    alpha = walls[of, 0]
    normal = np.stack([np.cos(alpha), np.sin(alpha)], axis=1)
    along = np.stack([-np.sin(alpha), np.cos(alpha)], axis=1)
    residual = (world * normal).sum(axis=1) - walls[of, 1]
    n = len(walls)
    left = np.einsum("ij,ijk->ik", normal, slope)
    turned = (world * along).sum(axis=1)
    # Normal equations: the five unknowns, then alpha and rho of each wall. The weak priors stand for what nothing else ties.
    size = 5 + 2 * n
    matrix = np.diag(np.concatenate([[1e-2, 1e-2, 1e2, 1e4, 1e4], np.full(2 * n, 1e-3)]))
    right = -matrix[:, :] @ np.concatenate([unknown, np.zeros(2 * n)])
    matrix[:5, :5] += left.T @ left
    right[:5] -= left.T @ residual
    for k in range(n):
        mine = of == k
        rows = np.stack([turned[mine], -np.ones(mine.sum())], axis=1)
        at = slice(5 + 2 * k, 7 + 2 * k)
        matrix[at, at] += rows.T @ rows
        matrix[:5, at] += left[mine].T @ rows
        matrix[at, :5] = matrix[:5, at].T
        right[at] -= rows.T @ residual[mine]
    step = np.linalg.solve(matrix, right)
    new_walls = walls.copy()
    new_walls[:, 0] += step[5::2]
    new_walls[:, 1] += step[6::2]
    rms = float(np.sqrt(np.mean(residual ** 2)))
    return unknown + step[:5], new_walls, np.linalg.inv(matrix) * rms ** 2, rms, np.bincount(of, minlength=n), size


def add_walls(turn: Turn, sweeps: np.ndarray, unknown: np.ndarray, walls: np.ndarray, gate_m: float) -> np.ndarray:
    """The walls, and those of points that belong to none yet."""
    for sweep in sweeps:
        world, _, beam, _ = placed(turn, np.array([sweep]), unknown)
        alone = assign(world, walls, gate_m) < 0 if len(walls) else np.ones(len(world), dtype=bool)
        new = [w for w in walls_of(world[alone], beam[alone]) if not any(same_wall(w, old) for old in walls)]
        if new:
            walls = np.vstack([walls, new])
    return walls


def same_wall(one, two) -> bool:
    """True: two pieces of one line, near each other."""
    off = abs(math.remainder(one[0] - two[0], 2.0 * math.pi))
    return off < 0.1 and abs(one[1] - two[1]) < 0.3 and one[2] < two[3] + 0.5 and two[2] < one[3] + 0.5


def calibrate(turn: Turn, yaw_near_rad: float = 0.0) -> Mounting:
    """How the laser is mounted.

    Args:
        turn: the recording; the nose square to a flat wall in its first sweep.
        yaw_near_rad: mounting yaw known roughly, within 25 degrees; tells which wall is ahead.

    Raises:
        InputError: the turn is too short, there are too few walls, or none is ahead at the start.
    """
    turned = float(np.max(turn.headings_rad) - np.min(turn.headings_rad))
    if turned < LEAST_TURN_RAD:
        raise InputError(f"the vehicle turned by {math.degrees(turned):.0f} degrees only; a whole turn is needed")
    middle = turn.headings_rad[:, turn.headings_rad.shape[1] // 2]
    wanted = np.linspace(middle.min(), middle.max(), MOST_SWEEPS)
    chosen = np.unique([0, *(int(np.argmin(np.abs(middle - w))) for w in wanted)])
    early = chosen[np.abs(middle[chosen]) < FIRST_TURN_RAD]
    unknown = np.zeros(5)
    walls = add_walls(turn, early[:1], unknown, np.empty((0, 4)), GATES_M[0])
    if len(walls) < 2:
        raise InputError("no flat walls in the first sweep")
    for gate_m in GATES_M[:3]:
        unknown, walls, *_ = solve(turn, early, unknown, walls, gate_m)
    walls = add_walls(turn, chosen, unknown, walls, GATES_M[1])
    for gate_m in GATES_M:
        unknown, walls, covariance, rms, counts, _ = solve(turn, chosen, unknown, walls, gate_m)
    seen = counts >= WALL_POINTS
    directions = np.abs(np.sin(walls[seen][:, None, 0] - walls[seen][None, :, 0]))
    if seen.sum() < 3 or directions.max() < 0.5:
        raise InputError("too few flat walls: use a room with walls in two directions at least")
    # The wall ahead: its foot as the laser sees it at the start.
    feet = np.where(seen, np.abs([math.remainder(a + yaw_near_rad, 2.0 * math.pi) for a in walls[:, 0]]), np.inf)
    ahead = int(np.argmin(feet))
    if feet[ahead] > AHEAD_RAD:
        raise InputError("no wall ahead at the start: begin with the nose square to a flat wall (and give --yaw-near for a laser that does not look ahead)")
    yaw = math.remainder(-walls[ahead, 0], 2.0 * math.pi)
    c, s = math.cos(yaw), math.sin(yaw)
    stretch = math.hypot(unknown[3], unknown[4])
    stretch_sigma = math.sqrt(max(covariance[3, 3], covariance[4, 4]))
    down = 0.5 * math.atan2(unknown[4], unknown[3])
    return Mounting(
        yaw_rad=yaw, yaw_sigma_rad=math.sqrt(covariance[5 + 2 * ahead, 5 + 2 * ahead]),
        x_m=c * unknown[0] - s * unknown[1], y_m=s * unknown[0] + c * unknown[1], offset_sigma_m=math.sqrt(max(covariance[0, 0], covariance[1, 1])),
        tilt_rad=2.0 * math.sqrt(stretch), tilt_least_rad=2.0 * math.sqrt(4.0 * stretch_sigma), tilt_axis_rad=math.remainder(down + yaw + 0.5 * math.pi, math.pi),
        residual_m=rms, walls=int(seen.sum()), turned_rad=turned)


def read_turn(log: Path) -> Turn:
    """SCAN and IMU of a recorded log (flight.lcm, or noctule-log's).

    Raises:
        InputError: no sweeps or no inertial samples in it, or it does not begin at rest.
    """
    from noctule.record import message_type
    from noctule.replay import read_flight_log

    scan_type, imu_type = message_type("scan_t"), message_type("imu_t")
    scans, imu = [], []
    for channel, data in read_flight_log(log).events:
        if channel == "SCAN":
            scans.append(scan_type.decode(data))
        elif channel == "IMU":
            m = imu_type.decode(data)
            imu.append((m.t_us, m.gyro_rad_s[2]))
    if len(scans) < 20 or len(imu) < 100:
        raise InputError(f"{log}: {len(scans)} sweeps and {len(imu)} inertial samples; record a whole turn")
    t, rate = np.array(imu, dtype=float).T
    moving = np.nonzero(np.abs(np.convolve(rate, np.ones(25) / 25.0, "same")) > STILL_RAD_S)[0]
    still = rate[:moving[0]] if len(moving) else rate
    if len(still) < 50:
        raise InputError(f"{log}: does not begin at rest: let the vehicle stand for a second before it turns")
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t) * 1e-6)]) - still.mean() * (t - t[0]) * 1e-6
    first = scans[0]
    index = np.arange(first.count)
    scans = [s for s in scans if s.count == first.count and t[0] <= s.t_us - first.count * s.time_increment_us and s.t_us <= t[-1]]
    stamps = np.array([s.t_us - (first.count - 1 - index) * s.time_increment_us for s in scans], dtype=float)
    ranges = np.array([np.asarray(s.range_m[:first.count], dtype=float) for s in scans])
    ranges[(ranges < first.range_min_m) | (ranges > first.range_max_m)] = np.nan
    headings = np.interp(stamps, t, heading)
    return Turn(first.bearing_first_rad + index * first.bearing_increment_rad, ranges, headings - headings[0, -1], (stamps - stamps[0, -1]) * 1e-6)


def text(m: Mounting) -> str:
    """What the command prints: lines for parameters.toml, and what no parameter can mend."""
    lines = [f"# turned {math.degrees(m.turned_rad):.0f} degrees, {m.walls} walls, points {1000 * m.residual_m:.1f} mm off them",
             f"lidar_yaw_rad = {m.yaw_rad:.4f}   # +- {m.yaw_sigma_rad:.4f} ({math.degrees(m.yaw_rad):.2f} degrees), as square as the nose stood to the wall",
             f"lidar_x_m = {m.x_m:.3f}   # +- {m.offset_sigma_m:.3f}, from the axis of the turn",
             f"lidar_y_m = {m.y_m:.3f}   # +- {m.offset_sigma_m:.3f}"]
    if m.tilt_rad > m.tilt_least_rad:
        lines.append(f"# tilted by {math.degrees(m.tilt_rad):.1f} degrees about the direction {math.degrees(m.tilt_axis_rad):.0f} degrees of Body, one way or the other: "
                     "shim the laser until this is gone")
    else:
        lines.append(f"# level within {math.degrees(m.tilt_least_rad):.1f} degrees")
    return "\n".join(lines)
