"""Buildings drawn at random: the same every time, all of their rooms within reach, no two pieces of furniture in each other."""

import json
import math

import numpy as np
import pytest

from noctule.bench_unseen import rows_of
from noctule.random_buildings import APART_M, KINDS, building
from noctule.score import cached_floor_truth
from noctule_sim.world import build_world


@pytest.mark.parametrize("kind", KINDS)
def test_a_number_is_a_building(kind):
    assert json.dumps(building(kind, 3)) == json.dumps(building(kind, 3))
    assert building(kind, 3) != building(kind, 4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", (1000, 1001))
def test_every_room_can_be_reached_or_looked_into(kind, number):
    description = building(kind, number)
    world = build_world(description, description["name"])
    truth = cached_floor_truth(world.primitives(), 0.0, world.start.x_m, world.start.y_m)
    corners = np.array([p for w in description["walls"] for p in (w["from"], w["to"])])
    # Inside: within the turned rectangle of all walls, told by the first wall's direction.
    along = np.subtract(description["walls"][0]["to"], description["walls"][0]["from"])
    along = along / np.hypot(*along)
    turn = np.array([along, [-along[1], along[0]]])
    low, high = (corners @ turn.T).min(axis=0), (corners @ turn.T).max(axis=0)
    jj, ii = np.nonzero(~truth.occupied.astype(bool))
    places = np.column_stack([truth.x0_m + 0.1 * (ii + 0.5), truth.y0_m + 0.1 * (jj + 0.5)]) @ turn.T
    inside = np.all((places > low + 0.2) & (places < high - 0.2), axis=1)
    assert np.mean(truth.seeable[jj[inside], ii[inside]]) > 0.9


@pytest.mark.parametrize("kind", ("office", "flat", "hall"))
def test_furniture_leaves_room_to_pass(kind):
    found = 0
    for number in range(1000, 1010):
        boxes = building(kind, number)["boxes"]
        found += len(boxes)
        for k, a in enumerate(boxes):
            for b in boxes[:k]:
                assert math.dist(a["at"], b["at"]) > 0.5 * (min(a["size"][:2]) + min(b["size"][:2])) + APART_M
    assert found > 20


def test_the_table_tells_each_kind():
    def flown(world, policy, time_s):
        return {"world": world, "seed": 1, "policy": policy, "completed": True, "explored_fraction": 0.995, "time_to_99_s": time_s, "path_to_99_m": time_s / 2,
                "least_clearance_m": 0.1, "back_and_forth": 0, "switches": 0, "stuck": 0, "plan_ms": (1.0, 2.0, 3.0), "walls": (0.99, 1.0)}

    results = [flown(w, p, t) for w, p, t in (("office_0", "tour", 80.0), ("office_0", "frontier", 100.0), ("maze_0", "tour", 60.0), ("maze_0", "frontier", 50.0))]
    rows = {r["name"].strip(): r for r in rows_of(results)}
    assert rows["time to 99 %, against nearest frontier, mean over buildings"]["value"] == pytest.approx(1.0)
    assert rows["path to 99 %, office"]["value"] == pytest.approx(0.8)
    assert rows["path to 99 %, maze"]["value"] == pytest.approx(1.2)
    assert not any("hall" in name for name in rows)
