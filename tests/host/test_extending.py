"""The recipes of docs/extending.md that can be kept true cheaply: what the page shows is what works."""

import re
import sys
import textwrap
from pathlib import Path

import pytest

from noctule import kinematic
from noctule.policy import FINISHED, Goal, MapView, Pose
from noctule.settings import EXTERNAL_POLICY, FlightSettings, parameter_values
from noctule_sim.world import load_world
from test_policy import PARAMETERS, room
from test_replay import built

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"
ROOT = PAGE.parents[1]


def block(first_line):
    """The indented block of the page that begins with that line."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    begin = lines.index("    " + first_line)
    end = next(k for k in range(begin, len(lines)) if lines[k] and not lines[k].startswith("    "))
    return textwrap.dedent("\n".join(lines[begin:end]))


@pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")
def test_the_world_of_the_page_is_explored(tmp_path):
    path = tmp_path / "my_hut.yaml"
    path.write_text(block("# my_hut.yaml"), encoding="utf-8")
    flown = kinematic.explore(load_world(path), 1, {"floors_max": 1}, 200.0)
    assert flown.completed and flown.explored_fraction > 0.97 and flown.least_clearance_m > 0.0


def test_the_policy_of_the_page_works(tmp_path, monkeypatch):
    text = block("# my_policy.py, in the directory you fly from").split("noctule fly")[0]
    (tmp_path / "my_policy.py").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    from noctule.policy_host import load

    try:
        policy, view = load("my_policy:Nearest")(), room(MapView(PARAMETERS))
    finally:
        sys.modules.pop("my_policy", None)
        sys.path.remove(str(tmp_path))
    view.moved(Pose(1.5, 1.5))
    told = policy.step(view, Pose(1.5, 1.5), 1000)
    assert isinstance(told, Goal) and told.look[1] == pytest.approx(5.95)
    view.put(0, 0, 0, view.log_odds.ravel() * 0)
    assert policy.step(view, Pose(1.5, 1.5), 1000) is FINISHED


def test_every_file_that_a_recipe_names_is_there():
    # The recipes' own examples are the only names that do not exist.
    own = {"my_policy.py", "my_hut.yaml", "firmware/interface/lcm/energy_t.lcm", "firmware/sense/pillars.hpp", "firmware/estimate/pillar_map.hpp", "tests/laws/pillar_test.cpp"}
    named = set(re.findall(r"(?:firmware|host|sim|tests|docs)/[\w./]+\.(?:py|hpp|cpp|toml|lcm|md|json)", PAGE.read_text(encoding="utf-8"))) - own
    assert len(named) > 15
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_the_page_tells_the_value_of_the_parameter_policy():
    assert f"--param policy={EXTERNAL_POLICY}" in PAGE.read_text(encoding="utf-8")
    assert "policy_timeout_s" in parameter_values(FlightSettings("maze_a"))
