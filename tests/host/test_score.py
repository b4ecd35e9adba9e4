"""The score on hand-made worlds whose answer can be worked out on paper."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from noctule import score, truth
from noctule.score import ExploredScore, StartPose


@dataclass
class Box:
    """A primitive as the worlds hand them out."""

    centre_m: tuple
    half_extent_m: tuple
    yaw_rad: float = 0.0
    kind: str = "box"
    tag: str = "box"


def wall(x0, y0, x1, y1, thickness=0.1, z_low=0.0, z_high=2.5):
    length = math.hypot(x1 - x0, y1 - y0)
    return Box(((x0 + x1) / 2, (y0 + y1) / 2, (z_low + z_high) / 2),
               (length / 2, thickness / 2, (z_high - z_low) / 2), math.atan2(y1 - y0, x1 - x0))


def room(x0, y0, x1, y1):
    """Walls whose inner faces are the given lines (thickness 0.1 outside)."""
    o = 0.05
    return [wall(x0 - 2 * o, y0 - o, x1 + 2 * o, y0 - o), wall(x0 - 2 * o, y1 + o, x1 + 2 * o, y1 + o),
            wall(x0 - o, y0, x0 - o, y1), wall(x1 + o, y0, x1 + o, y1)]


def cell(floor, x, y):
    return int(math.floor((y - floor.y0_m) / 0.1)), int(math.floor((x - floor.x0_m) / 0.1))


def test_an_empty_room_counts_its_floor_and_one_ring_of_wall_cells():
    # GIVEN a room of 4.0 x 3.0 m on the lattice lines, walls outside of it
    floor = truth.floor_truth(room(0.0, 0.0, 4.0, 3.0), 0.0, 2.0, 1.5)
    # THEN S is 40 x 30 free cells and the wall cells that a ray meets first: 2 x 40 + 2 x 30, no corner
    free = floor.seeable & ~floor.occupied
    assert np.count_nonzero(free) == 1200
    assert np.count_nonzero(floor.seeable & floor.occupied) == 140
    assert floor.explorable_area_m2 == pytest.approx(13.40)


def test_reachable_cells_hold_a_point_at_least_0_36_m_from_the_wall():
    floor = truth.floor_truth(room(0.0, 0.0, 4.0, 3.0), 0.0, 2.0, 1.5)
    # 0.36 m lies in the cell 0.3 to 0.4 m, so 34 x 24 cells hold such a point.
    assert np.count_nonzero(floor.reachable) == 34 * 24
    assert floor.reachable[cell(floor, 0.35, 1.5)]
    assert not floor.reachable[cell(floor, 0.25, 1.5)]


def two_rooms(door_m):
    middle = 1.5
    return room(0.0, 0.0, 6.0, 3.0) + [wall(3.0, -0.1, 3.0, middle - door_m / 2), wall(3.0, middle + door_m / 2, 3.0, 3.1)]


def test_a_room_behind_a_door_of_0_74_m_is_reachable_and_behind_0_68_m_it_is_not():
    wide = truth.floor_truth(two_rooms(0.74), 0.0, 1.5, 1.5)
    narrow = truth.floor_truth(two_rooms(0.68), 0.0, 1.5, 1.5)
    assert wide.reachable[cell(wide, 5.0, 2.5)]
    assert not narrow.reachable[cell(narrow, 5.0, 2.5)]
    assert wide.explorable_area_m2 > narrow.explorable_area_m2 + 0.4


def test_behind_a_too_narrow_door_only_what_is_in_sight_counts():
    floor = truth.floor_truth(two_rooms(0.5), 0.0, 1.5, 1.5)
    assert floor.seeable[cell(floor, 5.5, 1.55)]          # straight through the door
    assert not floor.seeable[cell(floor, 3.15, 0.15)]     # in the corner beside the door, out of every line of sight
    assert not floor.reachable[cell(floor, 5.5, 1.55)]


def test_the_inside_of_a_box_is_out_and_its_faces_are_in():
    box = Box((2.0, 2.0, 0.6), (0.5, 0.5, 0.6))
    floor = truth.floor_truth(room(0.0, 0.0, 4.0, 4.0) + [box], 0.0, 0.6, 0.6)
    assert floor.occupied[cell(floor, 2.05, 2.05)] and not floor.seeable[cell(floor, 2.05, 2.05)]
    assert floor.seeable[cell(floor, 1.55, 2.05)] and floor.seeable[cell(floor, 2.45, 2.05)]
    inside_or_face = floor.occupied & floor.seeable
    i, j = cell(floor, 1.55, 1.55)
    assert np.count_nonzero(inside_or_face[i:i + 10, j:j + 10]) == 36      # the ring of a 10 x 10 block


def test_a_table_under_the_plane_is_not_in_the_score():
    table = Box((2.0, 1.5, 0.4), (0.5, 0.5, 0.4))
    with_table = truth.floor_truth(room(0.0, 0.0, 4.0, 3.0) + [table], 0.0, 0.6, 0.6)
    assert not with_table.occupied[cell(with_table, 2.0, 1.5)]


def test_a_free_wall_end_beyond_the_laser_range_is_not_seeable():
    # GIVEN a vehicle locked in a cage of posts too dense to leave, in a hall longer than the laser reaches
    posts = [wall(1.2, y, 1.3, y, 0.1) for y in np.arange(0.0, 2.01, 0.4)]
    floor = truth.floor_truth(room(0.0, 0.0, 16.0, 2.0) + posts, 0.0, 0.6, 1.0)
    assert floor.seeable[cell(floor, 8.0, 1.0)]
    assert not floor.seeable[cell(floor, 14.0, 1.0)]


def test_seeable_agrees_with_brute_force_on_a_turned_world():
    # An independent route: march from every reachable cell in steps of 5 mm to every cell, straight from the shapes.
    turned = [Box((1.5, 1.4, 1.2), (0.3, 0.12, 1.2), 0.3), Box((2.4, 0.8, 1.2), (0.2, 0.2, 1.2), 0.0, "cylinder")]
    solids = room(0.0, 0.0, 3.4, 2.2) + turned
    floor = truth.floor_truth(solids, 0.0, 0.6, 0.6)
    shapes = truth.slice_primitives(solids, 1.0)
    reach = [(floor.x0_m + (j + 0.5) * 0.1, floor.y0_m + (i + 0.5) * 0.1) for i, j in np.argwhere(floor.reachable)]
    wrong = free = 0
    for x in np.arange(0.05, 3.4, 0.3):
        for y in np.arange(0.05, 2.2, 0.2):
            index = cell(floor, x, y)
            if floor.occupied[index]:
                continue
            free += 1
            seen = False
            for rx, ry in reach:
                n = int(math.hypot(rx - x, ry - y) / 0.005) + 2
                px, py = np.linspace(x, rx, n), np.linspace(y, ry, n)
                if all(np.all(truth.distance_to_shape(s, px, py) > 0.0) for s in shapes):
                    seen = True
                    break
            wrong += seen != floor.seeable[index]
    assert free > 80
    assert wrong <= 1      # a cell on the very edge of a shadow may fall either way


def perfect_tiles(floor, start, cell_m=0.1):
    """The map that a perfect mapper would record, frame Map, as (tile_x, tile_y) -> (4096,) log odds."""
    tiles = {}
    for i, j in np.argwhere(np.ones_like(floor.occupied)):
        x, y = start.to_map(floor.x0_m + (j + 0.5) * 0.1, floor.y0_m + (i + 0.5) * 0.1)
        a, b = int(math.floor(x / cell_m + 1e-9)), int(math.floor(y / cell_m + 1e-9))
        tile = tiles.setdefault((a // 64, b // 64), np.zeros(4096, np.int8))
        tile[(b % 64) * 64 + a % 64] = 20 if floor.occupied[i, j] else -20
    return tiles


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2])
def test_a_perfect_map_scores_one_and_times_are_first_times(yaw):
    floor = truth.floor_truth(room(0.0, 0.0, 4.0, 3.0), 0.0, 2.0, 1.5)
    start = StartPose(2.0, 1.5, 0.0, yaw)
    grade = ExploredScore(floor, start)
    for n, (key, tile) in enumerate(perfect_tiles(floor, start).items()):
        grade.update(10.0 + n, *key, 0.1, tile)
    assert grade.explored_fraction == 1.0
    last = 10.0 + n
    assert 10.0 <= grade.time_to_s[0.95] <= grade.time_to_s[0.99] <= last
    for key, tile in perfect_tiles(floor, start).items():         # later mistakes do not move the first time
        grade.update(99.0, *key, 0.1, 0 * tile)
    assert grade.explored_fraction == 0.0 and grade.time_to_s[0.99] <= last
    for key, tile in perfect_tiles(floor, start).items():
        grade.update(200.0, *key, 0.1, tile)
    assert grade.explored_fraction == 1.0 and grade.time_to_s[0.99] <= last


def test_a_map_shifted_by_one_cell_is_forgiven_and_by_three_is_not():
    floor = truth.floor_truth(room(0.0, 0.0, 4.0, 3.0), 0.0, 2.0, 1.5)
    true_start = StartPose(2.0, 1.5, 0.0, 0.0)
    shares = {}
    for shift in (1, 3):
        grade = ExploredScore(floor, true_start)
        for key, tile in perfect_tiles(floor, StartPose(2.0 + 0.1 * shift, 1.5, 0.0, 0.0)).items():
            grade.update(0.0, *key, 0.1, tile)
        shares[shift] = grade.explored_fraction
    assert shares[1] == 1.0
    assert shares[3] < 0.985        # most of the free floor still is free; the walls are wrong


def test_a_blank_claim_of_free_space_does_not_score_walls():
    floor = truth.floor_truth(room(0.0, 0.0, 4.0, 3.0), 0.0, 2.0, 1.5)
    # GIVEN a thick box, so that its face cells have a free neighbour but a claim of "occupied everywhere" must fail
    grade = ExploredScore(floor, StartPose(2.0, 1.5, 0.0, 0.0))
    for key in [(a, b) for a in (-1, 0) for b in (-1, 0)]:
        grade.update(0.0, *key, 0.1, np.full(4096, 20, np.int8))
    # Occupied everywhere is right in the wall ring and in the free ring beside it only.
    assert grade.right == 140 + (40 + 30 + 38 + 28)


def test_pose_errors_take_world_from_the_start_pose_and_only_the_flight():
    start = StartPose(3.0, 4.0, 0.5, math.pi / 2)
    t = np.arange(1, 101) * 0.05
    z = np.where((t > 1.0) & (t < 4.0), 1.6, 0.6)
    true = {"t_s": t, "x_m": np.full(100, 3.0), "y_m": 4.0 + t, "z_m": z, "yaw_rad": np.full(100, math.pi / 2),
            "armed": (t >= 0.5) & (t <= 4.5)}
    nav = {"t_us": np.round(t * 1e6).astype(np.int64), "x_m": t + 0.03, "y_m": np.full(100, 0.04),
           "z_m": z - 0.5 + 0.02, "yaw_rad": np.full(100, -0.01)}
    nav["x_m"][:5] += 9.0                                    # before arming: must not count
    errors = score.pose_errors(nav, true, start)
    assert errors.position_m.mean == pytest.approx(0.05) and errors.position_m.max == pytest.approx(0.05)
    assert errors.yaw_rad.mean == pytest.approx(0.01)
    assert errors.altitude_m.p95 == pytest.approx(0.02)
    assert errors.t_s[0] == pytest.approx(0.5) and errors.t_s[-1] == pytest.approx(4.0)


def test_a_flight_that_never_armed_has_no_errors_and_no_path():
    true = {"t_s": np.arange(3) * 0.05, "x_m": np.zeros(3), "y_m": np.zeros(3), "z_m": np.zeros(3),
            "yaw_rad": np.zeros(3), "armed": np.zeros(3, bool)}
    errors = score.pose_errors({"t_us": np.array([0]), "x_m": [0.0], "y_m": [0.0], "z_m": [0.0], "yaw_rad": [0.0]},
                               true, StartPose(0, 0, 0, 0))
    assert errors.position_m.as_dict() == {"mean": None, "p95": None, "max": None}
    assert score.path_length_m(true) == 0.0


def test_path_length_counts_armed_time_only():
    true = {"t_s": np.arange(5.0), "x_m": np.array([0.0, 3.0, 3.0, 6.0, 100.0]), "y_m": np.array([0.0, 4.0, 4.0, 8.0, 0.0]),
            "z_m": np.zeros(5), "armed": np.array([1, 1, 1, 1, 0])}
    assert score.path_length_m(true) == pytest.approx(10.0)
