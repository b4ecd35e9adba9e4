"""Random buildings of the objects' bench: the same for the same seed, sound, and walked through without touching anything."""

import math

import numpy as np
import pytest
from noctule_sim.geometry import Geometry
from noctule_sim.world import build_world, horizontal_distance_m

from noctule import object_walks


@pytest.mark.parametrize("seed", [1, 3])
def test_building_is_sound_and_follows_from_its_seed(seed):
    description = object_walks.building(seed)
    assert description == object_walks.building(seed) != object_walks.building(seed + 1)
    world = build_world(description)
    assert len(world.floors) == (2 if seed % 3 == 0 else 1)
    assert len(world.objects) >= 8
    # Two plain ones are alike and stand apart; no object stands in another one.
    twins = [o.primitive for o in world.objects if o.primitive.material == world.objects[-1].primitive.material]
    assert len(twins) == 2
    for i, a in enumerate(world.objects):
        for b in world.objects[i + 1:]:
            if abs(a.primitive.centre_m[2] - b.primitive.centre_m[2]) < 1.2:
                assert horizontal_distance_m(a.primitive, *b.primitive.centre_m[:2]) > 0.1, (a.name, b.name)


def test_tour_is_steady_and_free_of_contact():
    world = build_world(object_walks.building(2))
    geometry = Geometry(world)
    moments = object_walks.tour(geometry, world, np.random.default_rng(0))
    assert len(moments) > 1000
    for a, b in zip(moments, moments[1:]):
        assert math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) <= object_walks.SPEED_M_S * object_walks.STEP_S + 0.06
        assert abs(math.remainder(b.yaw_rad - a.yaw_rad, 2 * math.pi)) <= object_walks.TURN_RAD_S * object_walks.STEP_S + 1e-9
    for m in moments[::20]:
        assert geometry.clearance(m.x_m, m.y_m, m.z_m, 0.0, 0.1)[0] > 0.3
