import math

import mujoco
import numpy as np
import pytest

from fixture import hall
from noctule_sim.geometry import Geometry
from noctule_sim.vehicle import Airframe, Vehicle
from noctule_sim.world import build_world, load_world

EXTENT = {"floors": [{"elevation": 0.0, "height": 3.0, "extent": [0, 0, 20, 20]}], "start": {"x": 2, "y": 2}}


def test_a_tilted_ray_meets_a_wall_where_trigonometry_says():
    geometry = Geometry(hall())
    tilt = math.radians(7.0)
    distance = geometry.cast((10.0, 10.0, 1.0), (math.cos(tilt), 0.0, math.sin(tilt)), 30.0)
    assert distance == pytest.approx((20.0 - 0.05 - 10.0) / math.cos(tilt), abs=1e-12)
    down = geometry.cast((10.0, 10.0, 1.0), (math.cos(tilt), 0.0, -math.sin(tilt)), 30.0)
    assert down == pytest.approx(1.0 / math.sin(tilt), abs=1e-12)


def test_a_ray_meets_a_pillar_on_its_circle():
    geometry = Geometry(build_world(EXTENT | {"pillars": [{"at": [10, 10], "radius": 0.5}]}))
    offset = 0.3
    assert geometry.cast((5.0, 10.0 + offset, 1.0), (1, 0, 0), 30.0) == pytest.approx(5.0 - math.sqrt(0.25 - offset**2))
    assert geometry.cast((5.0, 10.51, 1.0), (1, 0, 0), 10.0) == math.inf


def test_nothing_within_range_and_soaking_surfaces_give_no_return():
    geometry = Geometry(build_world(EXTENT | {"boxes": [
        {"at": [6, 10], "size": [0.2, 2, 2], "material": "dark"}, {"at": [10, 14], "size": [2, 0.2, 2], "material": "glass"}, {"at": [10, 6], "size": [2, 0.2, 2]}]}))
    assert geometry.cast((10, 10, 1), (-1, 0, 0), 30.0) == math.inf
    assert geometry.cast((10, 10, 1), (0, 1, 0), 30.0) == math.inf
    assert geometry.cast((10, 10, 1), (0, -1, 0), 30.0) == pytest.approx(3.9)
    assert geometry.cast((10, 10, 1), (0, -1, 0), 3.8) == math.inf


@pytest.mark.parametrize("name", ["maze_b", "two_floor"])
def test_rays_agree_with_mujoco(name):
    """The independent route: MuJoCo's own ray caster on the same primitives."""
    world = load_world(name)
    geometry, vehicle = Geometry(world), Vehicle(world, Airframe())
    rng = np.random.default_rng(3)
    group = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    x0, y0, x1, y1 = world.bounds_m()
    geom = np.zeros(1, np.int32)
    compared = 0
    for _ in range(3000):
        origin = np.array([rng.uniform(x0 + 0.2, x1 - 0.2), rng.uniform(y0 + 0.2, y1 - 0.2), rng.uniform(0.05, 2.2)])
        if geometry.clearance(*origin, 0.01, 0.01)[0] < 0.01:
            continue  # inside a solid: the two differ by design
        direction = rng.standard_normal(3) * (1.0, 1.0, 0.3)
        direction /= np.linalg.norm(direction)
        theirs = mujoco.mj_ray(vehicle.model, vehicle.data, origin, direction, group, 1, -1, geom)
        ours = geometry.cast(tuple(origin), tuple(direction), 40.0)
        if theirs < 0.0:
            assert ours == math.inf
        else:
            assert ours == pytest.approx(theirs, abs=1e-6)
            compared += 1
    assert compared > 2000


def test_a_level_sweep_at_rest_sees_the_hall():
    geometry = Geometry(hall())
    poses = np.zeros((11, 8))
    poses[:, 0] = np.linspace(0.0, 0.04, 11)
    poses[:, 1:5] = (10.0, 10.0, 1.0, 1.0)
    bearings = np.radians(np.linspace(-135, 135, 1080))
    out = np.empty(1080)
    out[0] = 0.0025
    geometry.sweep(poses, np.zeros(4), bearings, 30.0, out)
    expected = 9.95 / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings)))
    assert out == pytest.approx(expected, abs=1e-9)


def test_each_beam_is_cast_from_the_pose_at_its_own_time():
    """Moving at 1 m/s and turning at 1 rad/s, each beam is compared with a single ray from the exact pose at its time."""
    geometry = Geometry(hall())
    speed, rate, t_first, t_last = 1.0, 1.0, 0.0125, 0.05
    times = np.linspace(0.01, t_last, 11)
    poses = np.zeros((11, 8))
    poses[:, 0] = times
    poses[:, 1], poses[:, 2], poses[:, 3] = 10.0 + speed * times, 10.0, 1.0
    poses[:, 4], poses[:, 7] = np.cos(rate * times / 2), np.sin(rate * times / 2)
    bearings = np.radians(np.linspace(-135, 135, 1080))
    mount = np.array([0.10, -0.05, 0.08, 0.3])
    out = np.empty(1080)
    out[0] = t_first
    geometry.sweep(poses, mount, bearings, 30.0, out)
    skewed = 0.0
    for beam in range(0, 1080, 7):
        t = t_first + (t_last - t_first) * beam / 1079
        def ray(at):
            yaw = rate * at
            x = 10.0 + speed * at + math.cos(yaw) * mount[0] - math.sin(yaw) * mount[1]
            y = 10.0 + math.sin(yaw) * mount[0] + math.cos(yaw) * mount[1]
            angle = yaw + mount[3] + bearings[beam]
            return geometry.cast((x, y, 1.08), (math.cos(angle), math.sin(angle), 0.0), 30.0)
        assert out[beam] == pytest.approx(ray(t), abs=1e-5)
        skewed = max(skewed, abs(out[beam] - ray(t_last)))
    assert skewed > 0.05


def test_clearance_of_the_hull():
    geometry = Geometry(build_world(EXTENT | {"boxes": [{"at": [10, 10], "size": [2, 2, 1.0], "yaw_deg": 45}]}))
    corner = math.sqrt(2.0)
    solid, below, above = geometry.clearance(10.0 - corner - 0.8, 10.0, 0.5, 0.3, 0.1)
    assert (solid, below, above) == pytest.approx((0.5, 0.4, 2.4))
    solid, _, _ = geometry.clearance(10.0, 10.0, 1.5, 0.3, 0.1)       # over the box
    assert solid == pytest.approx(0.4)
    solid, _, _ = geometry.clearance(10.0 - corner - 0.6, 10.0, 1.5, 0.3, 0.1)   # beside and over
    assert solid == pytest.approx(math.hypot(0.3, 0.4))
    assert geometry.clearance(10.0, 10.0, 1.05, 0.3, 0.1)[0] == 0.0
