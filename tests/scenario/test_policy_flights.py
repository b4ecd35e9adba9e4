"""A policy in Python over LCM, beside the built processes: in lockstep, and gone in the middle of a flight."""

import os

from test_flights import fly

from noctule import replay


def test_a_python_policy_flies_in_lockstep_and_replays(tmp_path):
    _, result, _ = fly(tmp_path / "run", "levels", "--seed", "1", "--max-time", "25", "--policy", "noctule.policies.widest:Widest")
    assert result["policy"] == {"name": "noctule.policies.widest:Widest", "refused": 0, "timeouts": 0, "given_up_s": None}
    assert result["explorer"]["goals"] >= 1 and not result["lockstep_broken"] and result["memory"]["heap_allocations_after_start"] == 0
    assert result["floors"][0]["explored_fraction"] > 0.5
    again = replay.replay_flight(tmp_path / "run" / "flight.lcm")
    assert again.equal and again.compared["POLICY_ASK"] > 50, again.difference


def test_the_tour_takes_over_from_a_policy_that_dies_and_the_pilot_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.path.join(os.path.dirname(__file__), "..", "host"))
    _, result, output = fly(tmp_path / "run", "levels", "--seed", "1", "--max-time", "30", "--policy", "bad_policies:Dies",
                            "--param", "policy_timeout_s=0.5", "--param", "policy_patience=2")
    assert result["policy"]["timeouts"] == 2 and result["policy"]["given_up_s"] is not None
    assert "policy ended with exit code 3" in output and "policy given up after 0 refusals, 2 timeouts" in output
    assert result["outcome"] == "max_time" and result["floors"][0]["explored_fraction"] > 0.8 and not result["lockstep_broken"]
