"""A recorded flight made by hand: known truth, known errors, a perfect map."""

import json
import math

import lcm
import numpy as np
import pytest

from noctule import record, score

WORLD = """\
name: hall
start: {x: 2.03, y: 1.52, z: 0.0, yaw_deg: 90.0}
floors:
  - {elevation: 0.0, height: 2.5, slab: 0.2, extent: [-0.1, -0.1, 6.1, 4.1]}
walls:
  - {from: [-0.05, -0.05], to: [6.05, -0.05]}
  - {from: [6.05, -0.05], to: [6.05, 4.05]}
  - {from: [6.05, 4.05], to: [-0.05, 4.05]}
  - {from: [-0.05, 4.05], to: [-0.05, -0.05]}
"""
TICKS = 400
ERROR_X_M, ERROR_Y_M, ERROR_Z_M, ERROR_YAW_RAD = 0.03, 0.04, 0.02, 0.01


def truth_rows():
    """Rests 2 s, arms, climbs to 1 m, flies 2 m along +x of World and back, lands, disarms at 18 s."""
    t = np.arange(1, TICKS + 1) * 0.05
    height = np.interp(t, [0, 3, 5, 14, 17, 20], [0.1, 0.1, 1.0, 1.0, 0.1, 0.1])
    x = np.interp(t, [0, 6, 9, 13, 20], [2.03, 2.03, 4.03, 2.03, 2.03])
    armed = (t >= 2.0) & (t < 18.0)
    return t, x, np.full(TICKS, 1.52), height, np.full(TICKS, math.pi / 2), armed


def write_run(folder, mistakes=0.0, states=None, run=None, sim=None):
    """Fills a run directory; mistakes: share of the map's cells that are recorded as free at random places."""
    from noctule_sim.world import load_world

    (folder / "log").mkdir(parents=True)
    (folder / "world.yaml").write_text(WORLD)
    world = load_world(folder / "world.yaml")
    t, x, y, z, yaw, armed = truth_rows()
    lines = ["t_s,x_m,y_m,z_m,yaw_rad,roll_rad,pitch_rad,vx_m_s,vy_m_s,vz_m_s,clearance_m,contacts_total,armed,mode"]
    for row in zip(t, x, y, z, yaw, armed):
        lines.append("%.6f,%.6f,%.6f,%.6f,%.9f,0,0,0,0,0,1.2,0,%d,OFFBOARD" % row)
    (folder / "truth.csv").write_text("\n".join(lines) + "\n")
    (folder / "run.json").write_text(json.dumps({"world": "hall", "seed": 7, "profile": "default", "preset": "default",
                                                 "autopilot": "px4", "parameters": {}, "faults": [], "camera": False,
                                                 "max_time_s": 600.0, "wall_time_s": 4.0, "date": "2026-01-01",
                                                 "interrupted": False, "died": None, "last_text": None, **(run or {})}))
    (folder / "sim.json").write_text(json.dumps({"outcome": "landed", "collisions": 0, "min_clearance_m": 1.2,
                                                 "sim_time_s": 20.0, "lockstep_broken": False, "reasons": [], **(sim or {})}))
    (folder / "log" / "nav-stats.json").write_text(json.dumps({
        "step_us": {"p50": 900.0, "p99": 2000.0, "max": 2500.0}, "navigator_bytes": 1000000, "rss_kib": 9000,
        "heap_allocations_after_start": 0}))

    start = score.StartPose(2.03, 1.52, 0.0, math.pi / 2)
    log = lcm.EventLog(str(folder / "flight.lcm"), "w", overwrite=True)
    mx, my = start.to_map(x, y)
    if states is None:
        states = np.select([t < 2.5, t < 5, t < 6, t < 9, t < 13, t < 17], [0, 1, 2, 3, 4, 5], 6)
    reasons = np.select([states == 1, states == 2, states == 3, states == 4, states == 5, states == 6],
                        [1, 2, 3, 4, 10, 11], 0)
    grid_t, nav_t, levels_t = (record.message_type(n) for n in ("grid_tile_t", "nav_t", "levels_t"))
    floor = score.cached_floor_truth(world.primitives(), 0.0, 2.03, 1.52)
    noise = np.random.default_rng(3)
    tiles = {}
    for i, j in np.argwhere(np.ones_like(floor.occupied)):
        px, py = start.to_map(floor.x0_m + (j + 0.5) * 0.1, floor.y0_m + (i + 0.5) * 0.1)
        a, b = math.floor(px / 0.1 + 1e-9), math.floor(py / 0.1 + 1e-9)
        tile = tiles.setdefault((a // 64, b // 64), np.zeros(4096, np.int8))
        wrong = noise.random() < mistakes
        tile[(b % 64) * 64 + a % 64] = 0 if wrong else (20 if floor.occupied[i, j] else -20)
    for n in range(TICKS):
        t_us = round(t[n] * 1e6)
        if n == 150:
            for (a, b), tile in tiles.items():
                message = grid_t()
                message.t_us, message.tile_x, message.tile_y, message.cell_m = t_us, a, b, 0.1
                message.log_odds = tile.tolist()
                log.write_event(t_us, "GRID_TILE", message.encode())
        message = nav_t()
        message.t_us, message.seq, message.state, message.reason = t_us, n, int(states[n]), int(reasons[n])
        message.x_m, message.y_m, message.z_m = mx[n] + ERROR_X_M, my[n] + ERROR_Y_M, z[n] + ERROR_Z_M
        message.yaw_rad, message.ready, message.quality = ERROR_YAW_RAD, 1, 100
        message.guard_interventions = n // 200
        log.write_event(t_us, "NAV", message.encode())
    message = levels_t()
    message.count = 2
    message.z_m[0], message.z_m[1] = 2.49, 0.004
    message.facing[0], message.facing[1] = -1, 1
    message.z_var_m2[1], message.x_min_m[1], message.y_max_m[1] = 1e-6, -2.0, 3.0
    log.write_event(1, "LEVELS", message.encode())
    log.close()
    return folder


@pytest.fixture
def make_run(tmp_path):
    """Makes run directories: make_run('a', mistakes=0.1)."""
    return lambda name, **how: write_run(tmp_path / name, **how)
