"""The atlas's reader against bytes made by hand, damage of every kind, and the picture."""

import struct
import zlib

import numpy as np
import pytest

from noctule import atlas, bench_floors, cli
from noctule.floor_worlds import building
from noctule_sim.world import build_world, check_start


def section(kind, floor, count, body):
    return struct.pack("<IiII", kind, floor, count, len(body)) + body


def encoded(sections, version=1):
    body = b"".join(sections)
    head = struct.pack("<8sIIQqQI", b"NOCTATLS", version, len(sections), 7, 12_500_000, len(body), zlib.crc32(body))
    return head + struct.pack("<I", zlib.crc32(head)) + body


def two_floors():
    tile = np.zeros((64, 64), np.int8)
    tile[3, :] = 40
    tile[4:8, :10] = -20
    out = []
    for name, z in ((0, 0.0), (1, 2.5)):
        out.append(section(atlas.FLOOR, name, 1, struct.pack("<f", z)))
        out.append(section(atlas.WALLS, name, 1, struct.pack("<8f2i", 3.0, 0.5, 0.0, 1.0, 2.0, 1.0, 1e-4, 1e-6, -1, 55)))
        out.append(section(atlas.TILES, name, 1, struct.pack("<fii", 0.1, -1, name) + tile.tobytes()))
    out.append(section(atlas.LEVELS, -1, 1, struct.pack("<6f2i", 2.5, 1e-4, 0, 0, 3, 3, 1, 99)))
    out.append(section(atlas.PASSAGES, -1, 1, struct.pack("<iiff", 0, 1, 4.5, -1.5)))
    out.append(section(atlas.REFUSED, -1, 1, struct.pack("<iiff", 0, 1, 8.0, 2.0)))
    out.append(section(atlas.OBJECTS, -1, 1, struct.pack("<iifff", 3, 1, 1.0, 2.0, 3.5)))
    out.append(section(99, -1, 1, b"from a later version"))
    return out


def test_everything_written_is_read(tmp_path, capsys):
    path = tmp_path / "atlas"
    path.write_bytes(encoded(two_floors()))
    building = atlas.read(path)
    assert (building.sequence, building.t_us) == (7, 12_500_000)
    assert building.floors[1].elevation_m == 2.5
    assert building.floors[0].walls[0, 9] == 55 and building.floors[0].walls[0, 8] == -1
    assert building.floors[1].tiles[-1, 1][3, 60] == 40
    assert building.floors[0].area_m2() == pytest.approx((64 + 40) * 0.01)
    assert building.passages == [(0, 1, 4.5, -1.5)] and building.refused == [(0, 1, 8.0, 2.0)]
    assert building.objects == [(3, 1, 1.0, 2.0, 3.5)]
    assert cli.main(["atlas", str(path), "--picture", str(tmp_path / "b.png")]) == 0
    assert (tmp_path / "b.png").read_bytes()[:4] == b"\x89PNG"
    said = capsys.readouterr().out
    assert "floor 1: elevation 2.500 m" in said and "refused: too small" in said


def test_damage_is_found_wherever_it_is(tmp_path):
    whole = encoded(two_floors())
    for at in range(0, len(whole), 97):
        hurt = bytearray(whole)
        hurt[at] ^= 0x10
        with pytest.raises(atlas.AtlasError):
            atlas.parse(bytes(hurt))
    for size in (0, 20, 47, 48, len(whole) - 1):
        with pytest.raises(atlas.AtlasError):
            atlas.parse(whole[:size])
    with pytest.raises(atlas.AtlasError, match="version 2"):
        atlas.parse(encoded(two_floors(), version=2))
    assert cli.main(["atlas", str(tmp_path / "none")]) == 2


def test_false_and_missed_floors_are_counted():
    assert bench_floors.judge_floors([0.0, 2.49], [0.0, 2.5]) == (0, 0)
    assert bench_floors.judge_floors([0.0], [0.0, 2.5]) == (0, 1)
    assert bench_floors.judge_floors([0.0, 2.4, 2.6], [0.0, 2.5]) == (1, 0)   # one floor mapped twice
    assert bench_floors.judge_floors([0.0, 3.6], [0.0]) == (1, 0)


@pytest.mark.parametrize("n", range(len(bench_floors.OPENINGS_M)))
def test_the_bench_s_openings_lie_inside(n):
    world = build_world(bench_floors.opening_world(bench_floors.OPENINGS_M[n], n))
    check_start(world, 0.3)
    (x0, y0, x1, y1), = world.floors[1].openings
    assert x1 - x0 == pytest.approx(bench_floors.OPENINGS_M[n]) and 0.5 < x0 and x1 < 8.5 and 0.5 < y0 and y1 < 5.5


def distance_m(solid, x, y):
    c, s = np.cos(solid.yaw_rad), np.sin(solid.yaw_rad)
    dx, dy = x - solid.centre_m[0], y - solid.centre_m[1]
    return np.hypot(max(abs(c * dx + s * dy) - solid.half_extent_m[0], 0.0), max(abs(c * dy - s * dx) - solid.half_extent_m[1], 0.0))


@pytest.mark.parametrize("number", bench_floors.BUILDINGS)
def test_drawn_buildings_can_be_flown(number):
    world = build_world(building(number))
    check_start(world, 0.3)
    assert len(world.floors) in (2, 3)
    for floor, over in zip(world.floors, world.floors[1:]):
        ((x0, y0, x1, y1),) = over.openings
        assert over.elevation_m == pytest.approx(floor.elevation_m + floor.height_m + over.slab_m, abs=0.01)
        assert min(x1 - x0, y1 - y0) >= 1.6
        # The hull gets through somewhere: a place 0.6 m from the opening's edges, 0.4 m from all that stands from one floor to the other.
        places = [(x, y) for x in np.arange(x0 + 0.6, x1 - 0.59, 0.1) for y in np.arange(y0 + 0.6, y1 - 0.59, 0.1)]
        solid = [s for s in world.solids if s.tag != "slab" and s.centre_m[2] + s.half_extent_m[2] > floor.elevation_m + 0.8
                 and s.centre_m[2] - s.half_extent_m[2] < over.elevation_m + 1.2]
        assert any(all(distance_m(s, x, y) > 0.4 for s in solid) for x, y in places)


def test_the_way_flown_tells_the_passages():
    nav = {"floor": np.array([0, 0, 1, 1, 2, 1, 0]), "x_m": np.arange(7.0), "y_m": -np.arange(7.0)}
    building_of = atlas.of_record([], [0.0, 2.5, -2.5], nav)
    assert building_of.passages == [(0, 1, 2.0, -2.0), (2, 1, 4.0, -4.0)]   # low first; coming back shows no new one
    assert atlas.picture(building_of, np.zeros((4, 4))).startswith(b"\x89PNG")
