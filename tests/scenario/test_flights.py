"""Whole flights through the built processes; at most three in the suite."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from noctule import compare, processes, record, report

ROOT = Path(__file__).resolve().parents[2]
NOCTULE = ROOT / ".venv" / "bin" / "noctule"


def fly(folder, *arguments):
    """Exit code, report and output of a flight."""
    done = subprocess.run([str(NOCTULE), "fly", "--no-camera", "--out", str(folder), *arguments], capture_output=True,
                          text=True, timeout=600, env={**os.environ}, check=False)
    path = Path(folder) / "report.json"
    assert path.is_file(), f"no report; exit code {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.returncode, json.loads(path.read_text()), done.stdout + done.stderr


@pytest.fixture(scope="module", autouse=True)
def built():
    """The programs of the release build."""
    for name in ("noctule-bridge", "noctule-nav"):
        if processes.find_program(name) is None:
            pytest.fail(f"{name} is not built: make build")
    if (problem := processes.multicast_problem()) is not None:
        pytest.fail(problem)


@pytest.mark.flight
@pytest.mark.slow
def test_maze_a_is_explored_without_a_scratch(tmp_path):
    code, result, output = fly(tmp_path / "run", "maze_a", "--seed", "1")
    assert result["outcome"] == "completed", result["reason"]
    assert code == 0
    assert result["collisions"] == 0 and result["min_clearance_m"] > 0.0
    assert result["landed"] and result["home_error_m"] <= 0.5
    assert result["floors"][0]["explored_fraction"] >= 0.95
    assert result["pose_error_m"]["mean"] <= 0.08 and result["altitude_error_m"]["mean"] <= 0.023
    assert result["memory"]["heap_allocations_after_start"] == 0
    assert not result["lockstep_broken"]
    assert report.validate(result) == []
    names = {p.name for p in (tmp_path / "run").iterdir()}
    assert {"report.html", "report.json", "map.png", "flight.lcm", "flight.tlog", "truth.csv", "world.yaml",
            "parameters.toml", "trajectory_estimate.tum", "trajectory_truth.tum", "log"} <= names
    assert "explored" in output and "pose error" in output


@pytest.mark.flight
@pytest.mark.slow
def test_without_odometry_the_autopilot_drifts_and_its_failsafe_acts(tmp_path):
    # Were the autopilot fed with truth, cutting our ODOMETRY would change nothing.
    cut_s = 25.0
    _, result, _ = fly(tmp_path / "run", "maze_a", "--seed", "1", "--max-time", "60", "--fault", f"odometry-cut@{cut_s:g}")
    assert result["outcome"] != "completed"
    true = record.read_truth(tmp_path / "run" / "truth.csv")
    start = report.open_run(tmp_path / "run").start
    x, y = start.to_world(true["autopilot_x_m"], true["autopilot_y_m"])
    error = np.hypot(x - true["x_m"], y - true["y_m"])
    t, armed = true["t_s"], true["armed"] > 0
    before = error[armed & (t > 10.0) & (t < cut_s)]
    after = error[armed & (t > cut_s)]
    assert before.max() < 0.3                                   # it knew where it was
    assert after.max() > 3.0 * before.max()                     # and then it did not
    modes = true["mode"][armed & (t < cut_s) & (t > 10.0)]
    assert len(set(modes)) == 1                                 # offboard until the cut
    assert set(true["mode"][t > cut_s + 0.1]) - set(modes), "no failsafe: the mode never changed"


@pytest.mark.flight
@pytest.mark.slow
def test_the_same_seed_twice_gives_the_same_report(tmp_path):
    # One short flight flown twice; another seed must differ, or the comparison would prove nothing.
    reports = {}
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        _, reports[name], _ = fly(tmp_path / name, "maze_b", "--seed", seed, "--max-time", "14")
    assert not reports["a"]["lockstep_broken"] and reports["a"]["steps"] > 200
    assert compare.differences(reports["a"], reports["b"]) == []
    assert any("pose_error_m" in line for line in compare.differences(reports["a"], reports["c"]))
