"""`noctule paper`: the arithmetic of its figures, and that the page sets every published number beside ours."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from noctule import paper, paper_page
from noctule.paper import Figure, Overhead, Row
from noctule.params_gen import PRESETS
from test_replay import built

needs_library = pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")
PNG = b"\x89PNG"


def test_the_preset_holds_the_published_values():
    values = PRESETS["paper"]
    assert values["particles"] == 100 and values["alt_paper_ceiling_m"] == 15.0 and values["alt_paper_level_m"] == 0.10
    assert values["alt_level_radius_m"] == 1.0 and values["alt_match_m"] == 0.2
    assert values["policy"] == 2 and values["potential_window_m"] == 2.0 and values["floor_safety_m"] == 1.5
    assert paper.MULTI_FLOOR["potential_window_m"] == 3.0
    assert round(paper.PAPER_S / 0.05) == 676


def test_odometry_integrates_section_b():
    """Constant turn and forward acceleration, noise-free, level: the textbook's answer."""
    t_us = np.arange(4000, 2_000_001, 4000)
    scan = np.arange(50_000, 2_000_001, 50_000)
    imu = np.zeros((len(t_us), 6))
    imu[:, 0], imu[:, 2], imu[:, 5] = 0.5, 9.80665, 0.0
    flown = SimpleNamespace(imu_t_us=t_us, imu=imu, scan_t_us=scan, attitude_t_us=np.array([0]), roll_pitch=np.zeros((1, 2)))
    track = paper.odometry(flown)
    assert track[-1] == pytest.approx([0.5 * 0.5 * 4.0, 0.0, 0.0], abs=0.01)
    imu[:, 5] = math.pi / 4
    assert paper.odometry(flown)[-1, 2] == pytest.approx(math.pi / 2, abs=0.05)


def test_modes_are_split_and_transitions_are_far_from_the_near_ceiling():
    low, high, far = paper.two_means(np.array([2.3, 2.31, 2.29, 4.8, 4.79]))
    assert (low, high) == (pytest.approx(2.30), pytest.approx(4.795)) and far.tolist() == [False] * 3 + [True] * 2
    places = np.array([[0.0, 0.0], [0.0, 1.0], [3.0, 0.0], [1.2, 0.0]])
    seen = Overhead(places, np.array([2.3, 2.3, 4.8, 4.8]), 2.3, 4.8, np.array([False, False, True, True]))
    assert paper.transitions(seen) == pytest.approx([3.0, 1.2])
    assert paper.transitions(Overhead(places, places[:, 0], 2.3, 2.3, np.zeros(4, bool))).size == 0


def test_a_level_is_the_nearest_of_its_facing():
    levels = [SimpleNamespace(z_m=z, facing=f) for z, f in ((0.0, 1), (0.52, 1), (0.5, -1))]
    assert paper.nearest_level(levels, 0.55, 1) == 0.52 and paper.nearest_level(levels, 0.55, -1) == 0.5
    assert math.isnan(paper.nearest_level([], 0.55, 1))


def test_the_page_has_each_figure_with_published_ours_and_default():
    text = paper_page.page([Figure("3", "Trajectory", "Set-up.", [Row("error", "8 cm", "1 cm", "2 cm")], "Remark.", {"figure-3.png": PNG})], "Run.", "pictures/paper")
    assert "| error | 8 cm | 1 cm | 2 cm |" in text and "](pictures/paper/figure-3.png)" in text and "Remark." in text and "## Figure 3" in text


@needs_library
def test_pose_and_altitude_figures_are_measured():
    three, four = paper.poses(1)
    six, seven = paper.altitude(2)
    assert [f.number for f in (three, four, six, seven)] == ["3", "4", "6", "7"]
    assert 0.0 < float(three.rows[0].ours.split()[0]) < 8.0                 # cm; published: about 8
    assert [row.published for row in seven.rows] == [v + " m" for v in paper.PUBLISHED_LEVELS_M.values()]
    for row, (z_m, _) in zip(seven.rows, paper.LEVELS_M):
        first, second = (float(v) for v in row.ours.removesuffix(" m").split(" / "))
        assert first == pytest.approx(z_m, abs=0.15) and second == pytest.approx(z_m, abs=0.15)
    for figure in (three, four, six, seven):
        assert all(content.startswith(PNG) and len(content) < 150_000 for content in figure.pictures.values()) and figure.pictures


def test_the_shipped_page_is_whole():
    from pathlib import Path

    docs = Path(__file__).parents[2] / "docs"
    text = (docs / "paper.md").read_text(encoding="utf-8")
    for number in (3, 4, 6, 7, 8, 9, 10, 11, 12, 13):
        assert f"## Figure {number}:" in text
        assert (docs / "pictures" / "paper" / f"figure-{number}.png").is_file() and f"pictures/paper/figure-{number}.png" in text
    for published in (*paper.PUBLISHED_LEVELS_M.values(), "2.3 / 1.8 cm", "about 8 cm", "660 s"):
        assert published in text
    assert sum(p.stat().st_size for p in (docs / "pictures" / "paper").iterdir()) < 1_500_000
