import json
import math

import pytest

from fixture import HALL
from noctule_sim.geometry import Geometry
from noctule_sim.world import WorldError, build_world, dump_world, horizontal_distance_m, load_world, shipped_worlds


def plan(tmp_path, **fields):
    content = {"walls": [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]], "start": [2, 2], "ignored": 1} | fields
    path = tmp_path / "plan.json"
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))
    return path


def test_the_promised_worlds_are_shipped():
    assert shipped_worlds() == ["atrium", "gallery", "levels", "maze_a", "maze_b", "office", "three_floor", "trap_opening", "two_floor", "two_stairs"]


@pytest.mark.parametrize("name", ["atrium", "gallery", "levels", "maze_a", "maze_b", "office", "three_floor", "trap_opening", "two_floor", "two_stairs"])
def test_walls_lie_off_the_grid_in_map(name):
    world = load_world(name)
    turned = math.degrees(world.start.yaw_rad) % 90.0
    assert 5.0 < turned < 85.0


def test_two_floor_is_what_the_paper_describes():
    world = load_world("two_floor")
    low, high = world.floors
    assert high.elevation_m + high.height_m == pytest.approx(4.8)
    x0, y0, x1, y1 = high.openings[0]
    assert x1 - x0 >= 3.4 and y1 - y0 >= 3.4
    pillars = [p for p in world.solids if p.tag == "pillar"]
    assert [sum(p.centre_m[2] < 2.5 for p in pillars), sum(p.centre_m[2] > 2.5 for p in pillars)] == [5, 3]
    stairs = [p for p in world.solids if p.tag == "stairs"]
    assert max(p.centre_m[2] + p.half_extent_m[2] for p in stairs) == pytest.approx(2.5)
    for p in stairs:
        assert x0 <= p.centre_m[0] <= x1 and y0 <= p.centre_m[1] - p.half_extent_m[1] and p.centre_m[1] + p.half_extent_m[1] <= y1


def test_levels_has_the_papers_surfaces():
    geometry = Geometry(load_world("levels"))
    assert geometry.cast((2.0, 2.0, 1.0), (0, 0, -1), 12.0) == pytest.approx(1.0)
    assert geometry.cast((5.1, 3.6, 1.0), (0, 0, -1), 12.0) == pytest.approx(1.0 - 0.55)
    assert geometry.cast((10.0, 4.0, 3.4), (0, 0, -1), 12.0) == pytest.approx(3.4 - 2.41)
    assert geometry.cast((2.0, 2.0, 1.0), (0, 0, 1), 12.0) == pytest.approx(4.66 - 1.0)


def test_a_plan_becomes_walls_of_10_cm_centred_on_their_lines(tmp_path):
    world = load_world(plan(tmp_path))
    geometry = Geometry(world)
    assert world.start.yaw_rad == 0.0
    assert geometry.cast((2.0, 2.0, 1.0), (1, 0, 0), 20.0) == pytest.approx(6.0 - 0.05 - 2.0)
    assert geometry.cast((2.0, 2.0, 1.0), (0, 0, 1), 20.0) == pytest.approx(1.5)
    assert Geometry(load_world(plan(tmp_path, height=3.1))).cast((2.0, 2.0, 1.0), (0, 0, 1), 20.0) == pytest.approx(2.1)


def test_a_door_leaves_its_width_and_a_lintel():
    description = json.loads(json.dumps(HALL))
    description["walls"].append({"from": [15, 0], "to": [15, 20], "doors": [{"at": 9.7, "width": 0.9, "height": 2.0}]})
    geometry = Geometry(build_world(description))
    for y, z, blocked in ((9.7, 1.0, False), (9.26, 1.0, False), (10.14, 1.0, False), (9.24, 1.0, True), (10.16, 1.0, True), (9.7, 2.1, True)):
        assert (geometry.cast((10.3, y, z), (1, 0, 0), 30.0) < 5.0) == blocked


def test_an_opening_is_open_and_the_slab_around_it_is_not():
    geometry = Geometry(load_world("two_floor"))
    assert geometry.cast((10.0, 10.0, 1.0), (0, 0, 1), 12.0) == pytest.approx(3.8)
    assert geometry.cast((8.5, 10.0, 1.0), (0, 0, 1), 12.0) == pytest.approx(1.3)


def test_a_dumped_world_is_the_same_world(tmp_path):
    for source in ("office", plan(tmp_path)):
        world = load_world(source)
        dump_world(world, tmp_path / "again.yaml")
        assert load_world(tmp_path / "again.yaml").primitives() == world.primitives()


@pytest.mark.parametrize("fields, part", [
    ({"walls": None}, "walls"), ({"walls": []}, "walls"), ({"walls": [[0, 0, 1]]}, "walls[0]"), ({"walls": [[1, 1, 1, 1]]}, "no length"),
    ({"start": None}, "start"), ({"start": [1, "a"]}, "start"), ({"start": [1, float("nan")]}, "start"), ({"height": -1}, "height"),
    ({"start": [0.3, 2.0]}, "the hull needs 0.30"), ({"start": [0.0, 2.0]}, "inside walls"), ({"start": [90, 2]}, "not on a floor"),
])
def test_a_bad_plan_gives_one_clear_line(tmp_path, fields, part):
    with pytest.raises(WorldError) as error:
        load_world(plan(tmp_path, **fields))
    assert part in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("text, part", [
    ("name: [", "line"), ("3", "mapping"), ("name: a", "floors"), ("floors: [{extent: [0, 0, 9, 9]}]", "start is missing"),
    ("floors: [{extent: [0, 0, 9, 9], hight: 2}]\nstart: {x: 1, y: 1}", "unknown key 'hight'"),
    ("floors: [{extent: [9, 0, 0, 9]}]\nstart: {x: 1, y: 1}", "extent"),
    ("floors: [{extent: [0, 0, 9, 9]}, {extent: [0, 0, 9, 9], elevation: 4}]\nstart: {x: 1, y: 1}", "floors[1]"),
    ("floors: [{extent: [0, 0, 9, 9]}]\nstart: {x: 1, y: 1}\nboxes: [{at: [4, 4], size: [1, 1, 1], material: ice}]", "boxes[0].material"),
    ("floors: [{extent: [0, 0, 9, 9]}]\nstart: {x: 1, y: 1}\nwalls: [{from: [0, 0], to: [9, 0], doors: [{at: 8.9, width: 1}]}]", "walls[0].doors"),
    ("floors: [{extent: [0, 0, 9, 9]}]\nstart: {x: 1, y: 1}\npillars: [{at: [1.2, 1], radius: 0.2}]", "pillars[0]"),
    ("floors: [{extent: [0, 0, 9, 9]}]\nstart: {x: .nan, y: 1}", "start.x"),
])
def test_a_bad_yaml_gives_one_clear_line(tmp_path, text, part):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(WorldError) as error:
        load_world(path)
    assert part in str(error.value) and "\n" not in str(error.value)


def test_an_unknown_name_lists_the_shipped_worlds():
    with pytest.raises(WorldError, match="maze_a"):
        load_world("atlantis")


def test_distance_to_a_turned_box():
    box = next(p for p in load_world("maze_b").solids if p.tag == "box" and p.yaw_rad != 0.0)
    c, s = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
    reach = box.half_extent_m[0] + 0.7
    assert horizontal_distance_m(box, box.centre_m[0] + c * reach, box.centre_m[1] + s * reach) == pytest.approx(0.7)
