"""What the simulated camera adds to a picture, and the calibration it hands out."""

import cv2
import numpy as np
import pytest

from noctule_sim.camera import FOCAL_PX, HEIGHT_PX, ROW_TIME_S, WIDTH_PX, Optics, calibration
from noctule_sim.pictures import picture


def stripes():
    image = np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    image[:, 150:170] = 200
    return image


def middle(image, row):
    weight = image[row].sum(axis=1).astype(float)
    return (weight * np.arange(WIDTH_PX)).sum() / weight.sum()


def test_perfect_optics_change_nothing_and_the_others_are_the_seeds():
    image = stripes()
    assert (Optics(np.random.default_rng(1), perfect=True).apply(image, 3.0, 1.0, 1.0) == image).all()
    one, two = (Optics(np.random.default_rng(5)).apply(image, 3.0, 0.5, 0.0) for _ in range(2))
    assert (one == two).all()
    assert (one != Optics(np.random.default_rng(6)).apply(image, 3.0, 0.5, 0.0)).any()


def test_light_changes_but_stays_within_what_can_be_seen():
    optics = Optics(np.random.default_rng(2))
    gains = [optics.light(t).gain for t in np.arange(0.0, 120.0, 0.5)]
    assert 0.5 < min(gains) < 0.7 and 1.0 < max(gains) < 1.2


def test_rows_below_are_later_when_the_camera_turns(monkeypatch):
    optics = Optics(np.random.default_rng(3))
    monkeypatch.setattr(optics, "_bank", np.zeros_like(optics._bank))
    turned = optics.apply(stripes(), 1.0, 1.5, 0.0)     # to the left: what is seen moves to the right
    shift = middle(turned, HEIGHT_PX - 1) - middle(turned, 0)
    assert shift == pytest.approx(FOCAL_PX * 1.5 * ROW_TIME_S * (HEIGHT_PX - 1), abs=0.6)
    edge = turned[HEIGHT_PX // 2, 145:155].max(axis=1).astype(int)
    assert ((edge > 20) & (edge < 120)).sum() >= 2       # blurred over 3.5 px


def test_opencv_reads_the_calibration(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(calibration())
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera_matrix").mat()
    assert storage.getNode("image_width").real() == WIDTH_PX
    assert matrix[0, 0] == pytest.approx(FOCAL_PX) and matrix[1, 2] == (HEIGHT_PX - 1) / 2
    assert storage.getNode("distortion_coefficients").mat().shape == (1, 5)


def test_two_names_are_two_pictures():
    a, b = picture("one", (0.8, 0.1, 0.1)), picture("two", (0.8, 0.1, 0.1))
    assert a.shape == (256, 256, 3) and (a == picture("one", (0.8, 0.1, 0.1))).all()
    assert np.abs(a.astype(int) - b).mean() > 30
