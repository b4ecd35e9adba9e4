"""Object databases as the host reads them: older, newer and foreign files; the grade; the exports."""

import json
import sqlite3

import pytest
from noctule_sim.world import load_world

from noctule import objects, vision_abi
from noctule.record import RecordError
from noctule.score import StartPose

needs_library = pytest.mark.skipif(vision_abi.library("noctule_vision_abi") is None, reason="libnoctule_vision_abi.so is not built")


def stored(number, x, y, sightings=5, z=0.6):
    return objects.StoredObject(number, True, 0, (x, y, z), (0.01, 0.0, 0.0025), 0.5, 1.2, 1.0, 9.0, sightings, False, [0.0] * 25)


def test_grade_counts_found_missed_twice_and_false():
    world = load_world("gallery")
    start = StartPose(0.0, 0.0, 0.0, 0.0)          # Map is World
    kiosk, crate = world.objects[0].primitive.centre_m, world.objects[1].primitive.centre_m
    grade = objects.grade([stored(1, kiosk[0] + 0.1, kiosk[1]), stored(2, kiosk[0] - 0.3, kiosk[1]), stored(3, 7.0, 5.0),
                           stored(4, crate[0], crate[1] + 0.2)], world, start)
    assert [name for _, name, _, _ in grade.rows] == ["kiosk", "kiosk", None, "crate"]
    assert (grade.found, grade.duplicated, grade.false, len(grade.missed)) == (2, 1, 1, 10)
    assert grade.errors_m == pytest.approx([0.1, 0.2])


def test_exports_hold_every_object():
    found = [stored(1, 1.0, 2.0), stored(7, 3.5, -2.0)]
    assert objects.as_csv(found).splitlines()[0].startswith("id,kind,floor,x_m")
    assert len(objects.as_csv(found).splitlines()) == 3
    assert [o["id"] for o in json.loads(objects.as_json(found))["objects"]] == [1, 7]
    page = objects.gallery(found, "Objects <of> a run", {0: objects.plan_svg(found, 0)})
    assert "object7" in page and "&lt;of&gt;" in page and found[0].sigma_m == pytest.approx(0.1)


@needs_library
def test_report_shows_each_object_with_its_true_name(tmp_path):
    assert objects.section(tmp_path, {}, None, None) == ""
    world, start = load_world("gallery"), StartPose(0.0, 0.0, 0.0, 0.0)
    kiosk = world.objects[0].primitive.centre_m
    vision_abi.Vision(tmp_path / "objects.db").close()
    with sqlite3.connect(tmp_path / "objects.db") as base:
        for number, (x, y) in ((3, (kiosk[0] + 0.1, kiosk[1])), (4, (7.0, 5.0))):
            base.execute("INSERT INTO object(id, session, confirmed, floor, x_m, y_m, z_m, xx_m2, xy_m2, yy_m2, width_m, height_m, first_seen_us, last_seen_us, sightings, "
                         "state, textured, colour, moments) VALUES(?, 1, 1, 0, ?, ?, 0.6, 0.01, 0, 0.01, 0.5, 1.2, 1, 2, 9, x'', 0, x'', x'')", (number, x, y))
    base.close()
    page = objects.section(tmp_path, objects.report_fields(tmp_path, world, start), world, start)
    assert "2 listed; missed 11, duplicated 0, false 1" in page
    assert "<td>3</td><td>kiosk</td>" in page and "<td>4</td><td>none</td>" in page and "10.0 cm" in page


@needs_library
def test_an_older_schema_is_brought_up_and_keeps_its_rows(tmp_path):
    path = tmp_path / "objects.db"
    vision_abi.Vision(path).close()
    with sqlite3.connect(path) as base:      # back to schema 1, as its program left it
        for column in ("textured", "colour", "moments"):
            base.execute(f"ALTER TABLE object DROP COLUMN {column}")
        base.execute("INSERT INTO object VALUES(5, 1, 1, 0, 1.5, 2.5, 0.6, 0.01, 0, 0.01, 0.5, 1.2, 1000000, 2000000, 9, x'')")
        base.execute("PRAGMA user_version=1")
    base.close()
    assert [o.id for o in objects.read(path)] == [5]
    vision_abi.Vision(path).close()
    with sqlite3.connect(path) as base:
        assert base.execute("PRAGMA user_version").fetchone()[0] == objects.SCHEMA
    base.close()
    kept = objects.read(path)
    assert [(o.id, o.position_m, o.sightings) for o in kept] == [(5, (1.5, 2.5, 0.6), 9)]


@needs_library
def test_newer_and_foreign_files_are_refused_and_left_alone(tmp_path):
    newer = tmp_path / "newer.db"
    vision_abi.Vision(newer).close()
    with sqlite3.connect(newer) as base:
        base.execute(f"PRAGMA user_version={objects.SCHEMA + 1}")
    base.close()
    with pytest.raises(RuntimeError, match="schema 3"):
        vision_abi.Vision(newer)
    with pytest.raises(RecordError):
        objects.read(newer)
    foreign = tmp_path / "foreign.db"
    with sqlite3.connect(foreign) as base:
        base.execute("CREATE TABLE mine(a)")
    base.close()
    with pytest.raises(RuntimeError, match="another program"):
        vision_abi.Vision(foreign)
    with sqlite3.connect(foreign) as base:
        assert base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 1
    base.close()
    (tmp_path / "text.db").write_text("no database at all, only text that is long enough to be read as a page")
    with pytest.raises(RuntimeError):
        vision_abi.Vision(tmp_path / "text.db")


def test_missing_database_is_one_line(tmp_path):
    with pytest.raises(RecordError, match="no such file"):
        objects.read(tmp_path / "objects.db")
