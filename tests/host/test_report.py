"""The report of a recorded flight whose every figure is known."""

import copy
import json
import math

import numpy as np
import pytest

from noctule import cli, compare, record, report


def test_every_figure_of_a_known_flight(make_run):
    folder = make_run("a")
    result = report.write(folder)
    assert report.validate(result) == []
    assert result == json.loads((folder / "report.json").read_text())
    assert result["outcome"] == "completed" and result["landed"]
    assert result["world"] == "hall" and result["seed"] == 7
    assert result["pose_error_m"]["mean"] == pytest.approx(0.05, abs=1e-5)
    assert result["pose_error_m"]["max"] == pytest.approx(0.05, abs=1e-5)
    assert result["altitude_error_m"]["p95"] == pytest.approx(0.02, abs=1e-5)
    assert result["yaw_error_rad"]["mean"] == pytest.approx(0.01, abs=1e-5)
    assert result["home_error_m"] == pytest.approx(0.0, abs=1e-6)
    assert result["path_length_m"] == pytest.approx(2 * 2.0 + 2 * 0.9, abs=0.01)
    assert result["armed_s"] == pytest.approx(2.0) and result["touchdown_s"] == pytest.approx(16.85, abs=0.1)
    assert result["realtime_factor"] == pytest.approx(5.0)
    assert result["step_ms"] == {"p50": 0.9, "p99": 2.0, "max": 2.5}
    assert result["memory"] == {"navigator_bytes": 1000000, "rss_kib": 9000, "heap_allocations_after_start": 0}
    assert result["guard_interventions"] == 1
    (floor,) = result["floors"]
    # Every cell of the hall's 6 x 4 m and the ring of wall cells; the map lies 3 mm and 2 cm off the lattice.
    assert floor["explorable_area_m2"] == pytest.approx(24.0 + 2.0, abs=0.05)
    assert floor["explored_fraction"] == 1.0
    assert floor["time_to_95_s"] == floor["time_to_99_s"] == pytest.approx(7.55)
    assert result["levels"][0] == {"elevation_m": 0.004, "true_elevation_m": 0.0, "sigma_m": 0.001, "facing": 1,
                                   "extent_m": [-2.0, 0.0, 0.0, 3.0]}
    assert [level["facing"] for level in result["levels"]] == [1, -1]


def test_unknown_cells_lower_the_explored_share_and_its_times_are_null(make_run):
    floor = report.write(make_run("a", mistakes=0.1))["floors"][0]
    assert floor["explored_fraction"] == pytest.approx(0.90, abs=0.02)
    assert floor["time_to_95_s"] is None


def test_the_page_needs_no_other_file_and_the_trajectories_are_in_world(make_run):
    folder = make_run("a")
    report.write(folder)
    page = (folder / "report.html").read_text()
    assert "data:image/png;base64," in page and "<svg" in page and "explored_fraction" in page
    for outside in ("src=\"http", "href=\"http", "<script", "<link"):
        assert outside not in page
    assert (folder / "map.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    true = np.loadtxt(folder / "trajectory_truth.tum")
    estimate = np.loadtxt(folder / "trajectory_estimate.tum")
    assert true.shape == estimate.shape == (400, 8)
    # Map x points along World y here, so an error along Map x is one along World y.
    assert np.allclose(estimate[:, 1] - true[:, 1], -0.04, atol=1e-5)
    assert np.allclose(estimate[:, 2] - true[:, 2], 0.03, atol=1e-5)
    assert np.allclose(true[:, 6:], [math.sin(math.pi / 4), math.cos(math.pi / 4)], atol=1e-6)


def states(*parts):
    return np.concatenate([np.full(n, s) for s, n in parts])


@pytest.mark.parametrize("states_and_reasons, settings, landed, time_s, expected", [
    ([(3, 3)], {"sim": {"outcome": "crashed", "reasons": ["the vehicle lies on its side"]}}, False, 9.0, "crashed"),
    ([(3, 3), (4, 4), (5, 10), (6, 11)], {}, True, 50.0, "completed"),
    ([(3, 3), (4, 16), (5, 10), (6, 11)], {}, True, 50.0, "not_completed"),      # came home for the battery
    ([(3, 3), (4, 4), (5, 18), (6, 11)], {}, True, 50.0, "not_completed"),       # landed elsewhere
    ([(3, 3), (4, 4), (5, 10), (6, 11)], {}, False, 50.0, "not_completed"),      # says landed, is not
    ([(3, 3), (7, 12)], {}, True, 50.0, "aborted"),
    ([(3, 3)], {"max_time_s": 60.0}, False, 60.0, "max_time"),
    ([(3, 3)], {"interrupted": True}, False, 60.0, "interrupted"),
    ([(3, 3)], {"died": "noctule-nav ended with signal SIGSEGV"}, False, 60.0, "failed"),
    ([], {}, False, 0.0, "failed"),
])
def test_the_outcome_is_judged_by_what_happened(states_and_reasons, settings, landed, time_s, expected):
    s = [a for a, _ in states_and_reasons]
    r = [b for _, b in states_and_reasons]
    outcome, reason = report.judge(settings, settings.get("sim", {}), s, r, landed, time_s)
    assert outcome == expected and reason.endswith(".")


def test_the_schema_refuses_a_missing_field_a_wrong_type_and_an_unknown_one(make_run):
    result = report.write(make_run("a"))
    for change in (lambda r: r.pop("seed"), lambda r: r.update(collisions=-1), lambda r: r.update(extra=1),
                   lambda r: r["floors"][0].update(explored_fraction=1.2), lambda r: r.update(outcome="fine")):
        broken = copy.deepcopy(result)
        change(broken)
        assert report.validate(broken)


def test_equal_runs_compare_equal_but_for_what_the_machine_decides(make_run, capsys):
    a = report.write(make_run("a"))
    b = report.write(make_run("b", run={"wall_time_s": 9.0, "date": "2027-01-01"}))
    assert a["wall_time_s"] != b["wall_time_s"] and a["run"] != b["run"]
    assert compare.differences(a, b) == []
    b["pose_error_m"]["mean"] += 1e-6
    b["levels"].append({"elevation_m": 1.0, "true_elevation_m": None})
    lines = compare.differences(a, b)
    assert any(line.startswith("pose_error_m.mean") for line in lines) and any("levels" in line for line in lines)
    assert cli.main(["compare", str(make_run("c")), "nowhere"]) == 2
    assert "no report.json" in capsys.readouterr().err


def test_a_torn_run_still_gives_a_report(make_run):
    folder = make_run("a")
    log = (folder / "flight.lcm").read_bytes()
    (folder / "flight.lcm").write_bytes(log[:len(log) // 2 + 7])
    text = (folder / "truth.csv").read_text()
    (folder / "truth.csv").write_text(text[:len(text) // 2])
    (folder / "sim.json").unlink()
    (folder / "log" / "nav-stats.json").write_text("{")
    result = report.write(folder)
    assert result["outcome"] == "not_completed" and result["lockstep_broken"] is True
    assert result["memory"]["navigator_bytes"] is None


def test_a_flight_that_never_began_gives_a_report(make_run):
    folder = make_run("a")
    for name in ("flight.lcm", "truth.csv", "sim.json"):
        (folder / name).unlink()
    result = report.write(folder)
    assert result["outcome"] == "failed" and result["pose_error_m"]["mean"] is None
    assert result["floors"][0]["explored_fraction"] == 0.0


def test_a_tile_of_another_length_is_refused():
    with pytest.raises(record.RecordError):
        record.decode_tile(b"\0" * 100)


def test_tiles_read_fast_are_the_tiles_that_lcm_reads(make_run):
    folder = make_run("a")
    slow = [record.message_type("grid_tile_t").decode(d) for c, _, d in record.events(folder / "flight.lcm") if c == "GRID_TILE"]
    fast = record.read_flight(folder / "flight.lcm").tiles
    assert len(slow) == len(fast) > 1
    for a, b in zip(slow, fast):
        assert (a.t_us, a.floor, a.tile_x, a.tile_y) == (b.t_us, b.floor, b.tile_x, b.tile_y)
        assert list(a.log_odds) == b.log_odds.tolist()


def test_a_floors_elevation_is_that_of_its_level():
    from types import SimpleNamespace

    from noctule.report import floor_elevation_m

    levels = SimpleNamespace(count=4, z_m=[0.004, 2.31, 2.47, 2.90, 2.52], facing=[1, -1, 1, 1, 1])
    assert floor_elevation_m(levels, 2.50) == 2.47       # the nearest that faces up; what lies beyond count is none
    assert floor_elevation_m(levels, 0.0) == 0.004
    assert floor_elevation_m(levels, 5.4) == 5.4         # no level there: as it was read
    assert floor_elevation_m(None, 0.0) is None and floor_elevation_m(levels, None) is None
