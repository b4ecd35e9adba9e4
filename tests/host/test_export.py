"""`noctule export`: what it writes is what was recorded, and evo finds the report's errors in it."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

from noctule import cli, record, report


def export(folder, kind, capsys):
    assert cli.main(["export", str(folder), "--to", kind]) == 0
    return capsys.readouterr().out.split()


def test_evo_finds_the_error_of_the_report(make_run, capsys):
    """evo_ape, no alignment, horizontal: within 1 mm of pose_error_m."""
    from evo.core import metrics, sync
    from evo.core.trajectory import Plane
    from evo.tools import file_interface

    folder = make_run("a")
    expected = report.write(folder)["pose_error_m"]
    estimate, truth = (file_interface.read_tum_trajectory_file(path) for path in export(folder, "tum", capsys))
    truth, estimate = sync.associate_trajectories(truth, estimate)
    for trajectory in (truth, estimate):
        trajectory.project(Plane.XY)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((truth, estimate))
    found = error.get_all_statistics()
    assert found["mean"] == pytest.approx(expected["mean"], abs=1e-3)
    assert found["max"] == pytest.approx(expected["max"], abs=1e-3)


def test_trajectories_are_of_the_flight_alone(make_run, capsys):
    folder = make_run("a")
    result = report.write(folder)
    estimate, truth = (np.loadtxt(path) for path in export(folder, "tum", capsys))
    assert estimate.shape == truth.shape and np.array_equal(estimate[:, 0], truth[:, 0])
    assert truth[0, 0] == pytest.approx(result["armed_s"], abs=0.051) and truth[-1, 0] == pytest.approx(result["touchdown_s"], abs=0.051)


def test_the_ros_map_is_the_recorded_one(make_run, capsys):
    folder = make_run("a")
    image_path, yaml_path = export(folder, "ros", capsys)
    image = np.array(Image.open(image_path))
    told = dict(line.split(": ") for line in open(yaml_path).read().splitlines())
    assert told["image"] == "map_0.pgm" and float(told["resolution"]) == pytest.approx(0.1)
    x0, y0, _ = json.loads(told["origin"])
    flight = record.read_flight(folder / "flight.lcm")
    last = {(t.tile_x, t.tile_y): t for t in flight.tiles}
    walls = 0
    for (tile_x, tile_y), tile in last.items():
        for j, i in zip(*np.nonzero(tile.log_odds.reshape(64, 64) >= 8)):
            x, y = (tile_x * 64 + i + 0.5) * 0.1, (tile_y * 64 + j + 0.5) * 0.1
            assert image[image.shape[0] - 1 - int((y - y0) / 0.1), int((x - x0) / 0.1)] == 0
            walls += 1
    assert walls > 150 and np.count_nonzero(image == 0) == walls
    (png,) = export(folder, "png", capsys)
    assert np.array_equal(np.array(Image.open(png)), image)


def test_the_table_has_a_row_a_step_and_the_truth_beside_it(make_run, capsys):
    (path,) = export(make_run("a"), "csv", capsys)
    rows = list(csv.DictReader(open(path)))
    assert len(rows) == 400
    assert float(rows[100]["true_t_s"]) == pytest.approx(int(rows[100]["t_us"]) * 1e-6, abs=1e-3)


def test_what_was_never_recorded_is_said_in_one_line(make_run, tmp_path, capsys):
    assert cli.main(["export", str(tmp_path), "--to", "tum"]) == 2
    assert "not a run directory" in capsys.readouterr().err
    folder = make_run("b")
    lines = (folder / "truth.csv").read_text().splitlines()
    armed = lines[0].split(",").index("armed")
    (folder / "truth.csv").write_text("\n".join([lines[0], *(",".join([*f[:armed], "0", *f[armed + 1:]]) for f in (l.split(",") for l in lines[1:]))]) + "\n")
    assert cli.main(["export", str(folder), "--to", "tum"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
