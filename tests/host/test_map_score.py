"""Map quality and the camera's share on a hand-made room whose answers can be worked out on paper."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from noctule import map_score, truth
from noctule.score import StartPose


@dataclass
class Box:
    """A primitive as the worlds hand them out."""

    centre_m: tuple
    half_extent_m: tuple
    yaw_rad: float = 0.0
    kind: str = "box"


def room():
    """4.0 x 3.0 m inside, walls 0.1 m thick outside of it, on the lattice lines."""
    sides = ((2.0, -0.05, 2.1, 0.05), (2.0, 3.05, 2.1, 0.05), (-0.05, 1.5, 0.05, 1.5), (4.05, 1.5, 0.05, 1.5))
    return truth.floor_truth([Box((x, y, 1.25), (hx, hy, 1.25)) for x, y, hx, hy in sides], 0.0, 2.0, 1.5)


def perfect(floor, start, shift_m=0.0):
    """A map of 0.1 m cells with every wall cell marked where it is, its corner far out; shifted along World x."""
    grid = np.zeros((200, 200), np.int8)
    i, j = np.nonzero(floor.occupied)
    x, y = start.to_map(floor.x0_m + (j + 0.5) * 0.1 + shift_m, floor.y0_m + (i + 0.5) * 0.1)
    grid[np.floor((y + 10.0) / 0.1).astype(int), np.floor((x + 10.0) / 0.1).astype(int)] = 50
    return grid


@pytest.mark.parametrize("start", [StartPose(0.0, 0.0, 0.0, 0.0), StartPose(1.3, 0.7, 0.0, 0.41)])
def test_a_map_that_is_right_scores_one_also_when_it_is_turned(start):
    floor = room()
    found, true = map_score.wall_shares(floor, start, perfect(floor, start), -10.0, -10.0, 0.1)
    assert found == 1.0 and true == 1.0


def test_walls_that_are_missing_or_in_the_wrong_place_cost_their_share():
    floor, start = room(), StartPose(0.0, 0.0, 0.0, 0.0)
    grid = perfect(floor, start)
    gone = grid.copy()
    gone[102:128, 140] = 0                   # the wall at x = 4.05 is column 140: 26 of its cells are not marked; those one cell beside the rest still count
    found, true = map_score.wall_shares(floor, start, gone, -10.0, -10.0, 0.1)
    assert found == pytest.approx(1.0 - 24 / 140) and true == 1.0
    ghosts = grid.copy()
    ghosts[115, 110:130] = 50                # 20 cells that are not there, in the middle of the room
    found, true = map_score.wall_shares(floor, start, ghosts, -10.0, -10.0, 0.1)
    marked = np.count_nonzero(grid)
    assert found == 1.0 and true == pytest.approx(marked / (marked + 20))
    found, _ = map_score.wall_shares(floor, start, perfect(floor, start, 0.3), -10.0, -10.0, 0.1)
    assert found < 0.7                       # three cells off: the walls across x are lost
    assert map_score.wall_shares(floor, start, np.zeros((5, 5), np.int8), 0.0, 0.0, 0.1) == (0.0, None)


def poses(*rows):
    columns = np.array(rows, float).T
    return {"t_s": columns[0], "x_m": columns[1], "y_m": columns[2], "z_m": columns[3], "yaw_rad": columns[4], "armed": columns[5] > 0}


def test_the_camera_sees_its_sector_up_to_four_metres_and_only_in_flight():
    floor = room()
    look = lambda *row: map_score.camera_seen_fraction(floor, poses(row), 0.0)
    # One look along +x from (0.05, 1.55): a sector of 1.2 rad, cut by the walls at y = 0 and 3.
    half = math.tan(0.6)
    sector = sum(1 for i in range(30) for j in range(40)
                 if abs(i + 0.5 - 15.5) <= half * (j + 0.5 - 0.5) + 1e-9 and math.hypot(j, i - 15) < 40) / 1200
    assert look(0.0, 0.05, 1.55, 1.0, 0.0, 1) == pytest.approx(sector, abs=0.03)
    assert look(0.0, 0.05, 1.55, 1.0, math.pi, 1) < 0.01          # nose at the wall
    assert look(0.0, 0.05, 1.55, 1.0, 0.0, 0) == 0.0              # not armed
    assert look(0.0, 0.05, 1.55, 0.1, 0.0, 1) == 0.0              # on the ground
    turn = poses(*[(0.2 * k, 2.0, 1.5, 1.0, 0.4 * k, 1) for k in range(16)])
    assert map_score.camera_seen_fraction(floor, turn, 0.0) > 0.99


def test_the_camera_does_not_see_through_walls():
    boxes = [Box((2.0, -0.05, 1.25), (2.1, 0.05, 1.25)), Box((2.0, 3.05, 1.25), (2.1, 0.05, 1.25)), Box((-0.05, 1.5, 1.25), (0.05, 1.5, 1.25)),
             Box((4.05, 1.5, 1.25), (0.05, 1.5, 1.25)), Box((2.0, 0.9, 1.25), (0.05, 0.9, 1.25))]
    floor = truth.floor_truth(boxes, 0.0, 1.0, 1.0)
    turn = poses(*[(0.2 * k, 1.0, 0.5, 1.0, 0.4 * k, 1) for k in range(16)])
    share = map_score.camera_seen_fraction(floor, turn, 0.0)
    assert 0.5 < share < 0.75       # its own half and what the gap of 1.2 m shows of the other
