"""`noctule campaign`: what is flown, that a stopped one goes on, that a broken flight ends nothing, and the arithmetic of the table."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from noctule import campaign, campaign_table, cli
from noctule.campaign import Campaign, Trial
from noctule.settings import InputError
from test_replay import built

needs_library = pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_every_combination_is_flown_once_and_seeds_vary_slowest():
    c = Campaign("c", ["maze_a", "maze_b"], [1, 2], ["tour", "frontier"], {"speed_max_m_s": [0.5, 1.0]})
    trials = list(c.trials())
    assert len(trials) == len({t.label for t in trials}) == 16
    assert [t.seed for t in trials] == [1] * 8 + [2] * 8
    settings = c.settings(Trial("maze_a", 2, "frontier", (("speed_max_m_s", 0.5),)), None)
    assert settings.parameters == {"speed_max_m_s": 0.5, "policy": 1} and settings.seed == 2 and not settings.camera


@pytest.mark.parametrize("text, word", [
    ("worlds = ['maze_a']", "'seeds' is missing"),
    ("worlds = ['nowhere']\nseeds = [1]", "nowhere"),
    ("worlds = ['maze_a']\nseeds = [1.5]", "whole"),
    ("worlds = ['maze_a']\nseeds = [1]\npolicies = ['magic']", "no policy 'magic'"),
    ("worlds = ['maze_a']\nseeds = [1]\n[parameters]\nspeed_max_m_s = [99]", "outside"),
    ("worlds = ['maze_a']\nseeds = [1]\n[parameters]\nspeed_limit = [1]", "no such parameter"),
    ("worlds = ['maze_a']\nseeds = [1, 1]", "twice"),
    ("worlds = ['maze_a']\nseeds = [1]\ncolour = 3", "colour"),
    ("worlds = maze_a", "not TOML"),
])
def test_a_bad_file_is_refused_in_one_line(tmp_path, capsys, text, word):
    assert cli.main(["campaign", str(write(tmp_path / "c.toml", text))]) == 2
    said = capsys.readouterr().err
    assert word in said and said.count("\n") == 1


def fake_reports():
    """Two variants over two worlds and five seeds: the second is 3 s faster in each pair, over seeds that differ by much more."""
    reports = {}
    for world in ("a", "b"):
        for seed in range(1, 6):
            for policy, change in (("tour", 0.0), ("frontier", -3.0)):
                time_s = 100.0 * seed + change + (0.1 * seed if policy == "frontier" else 0.0)
                reports[Trial(world, seed, policy)] = {"outcome": "completed", "collisions": 0, "max_time_s": 1800.0, "path_length_m": 10.0,
                                                       "floors": [{"explored_fraction": 0.99, "time_to_95_s": time_s, "time_to_99_s": None}]}
    return reports


def test_paired_differences_show_what_means_hide():
    rows = {(r["figure"], r["variant"]): r for r in campaign_table.summary(fake_reports())}
    row = rows["time_to_95_s", "frontier"]
    assert row["mean"] == pytest.approx(297.3) and row["high"] - row["low"] > 100.0
    assert row["difference"] == pytest.approx(-2.7) and row["pairs"] == 10
    assert -2.9 < row["difference_low"] < -2.7 < row["difference_high"] < -2.5
    assert rows["time_to_99_s", "tour"]["mean"] == 1800.0          # never reached: --max-time
    assert rows["pose_error_mean_m", "tour"]["mean"] is None


def test_a_changed_python_policy_is_flown_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    keys = []
    for text in ("class P:\n    def step(self, *_): return None\n", "class P:\n    def step(self, *_): return 1\n"):
        write(tmp_path / "mine_for_campaign.py", text)
        campaign.policy_source.cache_clear()
        c = Campaign("c", ["maze_a"], [1], ["tour", "mine_for_campaign:P"])
        settings = [c.settings(trial, tmp_path) for trial in c.trials()]
        assert [s.parameters["policy"] for s in settings] == [0, 3] and [s.policy_class for s in settings] == [None, "mine_for_campaign:P"]
        keys.append([campaign._key(c, trial, "x")["policy"] for trial in c.trials()])
    sys.modules.pop("mine_for_campaign", None)
    sys.path.remove(str(tmp_path))
    assert keys[0][0] == keys[1][0] == "tour" and keys[0][1] != keys[1][1]


def test_the_interval_is_that_of_the_mean():
    values = np.random.default_rng(5).normal(3.0, 2.0, 400)
    low, high = campaign_table.interval(values)
    assert (high - low) / 2 == pytest.approx(1.96 * 2.0 / 20.0, rel=0.12) and low < values.mean() < high


def test_a_broken_flight_leaves_its_pair_out():
    reports = fake_reports()
    reports[Trial("a", 1, "frontier")] = {"outcome": "broken", "why": "exit code -11", "world": "a", "seed": 1}
    rows = {(r["figure"], r["variant"]): r for r in campaign_table.summary(reports)}
    assert rows["time_to_95_s", "frontier"]["pairs"] == 9 and rows["time_to_95_s", "frontier"]["of"] == 10
    assert rows["completed", "frontier"]["mean"] == pytest.approx(0.9)


@needs_library
def test_killed_it_goes_on_without_flying_a_flight_twice(tmp_path):
    """kill -9 of a worker, then of the campaign itself; then the same command again."""
    file = write(tmp_path / "c.toml", "worlds = ['maze_a']\nseeds = [1, 2, 3]\nmax_time_s = 4\n")
    command = [sys.executable, "-m", "noctule.cli", "campaign", str(file), "--out", str(tmp_path / "runs"), "--workers", "1"]
    runs = tmp_path / "runs"

    def wait_for(what):
        for _ in range(1200):
            found = what()
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError("did not come about")

    def children(pid):
        return [int(p) for p in subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True).stdout.split()]

    first = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        os.kill(wait_for(lambda: children(first.pid))[0], signal.SIGKILL)         # a worker: its flight is flown again
        wait_for(lambda: list(runs.glob("*/trial.json")))
        worker = wait_for(lambda: children(first.pid))[0]
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
        wait_for(lambda: not os.path.exists(f"/proc/{worker}"))                   # the worker went with it
    finally:
        first.kill()
        first.communicate()
    kept = {path: path.stat().st_mtime_ns for path in runs.glob("*/trial.json")}
    assert 1 <= len(kept) < 3
    said = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False).stdout
    assert f"{len(kept)} flights kept, {3 - len(kept)} to fly" in said
    assert all(path.stat().st_mtime_ns == then for path, then in kept.items())
    assert len(list(runs.glob("*/trial.json"))) == 3
    assert len((runs / "flights.csv").read_text().splitlines()) == 4
    assert json.loads((runs / "summary.json").read_text())[0]["of"] == 3


@needs_library
def test_a_flight_that_cannot_be_flown_is_broken_and_says_why(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "_start", lambda folder, *_: (folder.mkdir(parents=True, exist_ok=True),
                                                                subprocess.Popen(["sh", "-c", "exit 3"]))[1])
    c = Campaign("c", ["maze_a"], [1], max_time_s=4.0)
    said = []
    (report,) = campaign.run_local(c, tmp_path, "x", 1, said.append).values()
    assert report["outcome"] == "broken" and "exit code 3" in said[-1]


def test_without_dask_it_is_said_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="pip install distributed"):
        campaign.run_dask(Campaign("c", ["maze_a"], [1]), tmp_path, "x", "tcp://127.0.0.1:1", print)


@needs_library
def test_a_dask_cluster_gives_the_same_flight(tmp_path):
    from distributed import LocalCluster

    from noctule import compare

    c = Campaign("c", ["maze_a"], [1], max_time_s=4.0)
    (here,) = campaign.run_local(c, tmp_path / "here", "x", 1, print).values()
    with LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        (there,) = campaign.run_dask(c, tmp_path / "there", "x", cluster.scheduler_address, print).values()
        (again,) = campaign.run_dask(c, tmp_path / "there", "x", cluster.scheduler_address, print).values()
    assert here["outcome"] == "max_time" and compare.differences(here, there) == [] and again == there
    assert (tmp_path / "there" / "maze_a-1-tour" / "truth.csv").read_bytes() == (tmp_path / "here" / "maze_a-1-tour" / "truth.csv").read_bytes()
