"""noctule-camera with numbered pictures for a camera: what is published, what happens when it goes away and comes back."""

import json
import signal
import subprocess
import threading
import time

import cv2
import lcm
import noctule_lcm
import numpy as np
import pytest

from noctule.processes import PortLock, find_program, lcm_url, multicast_problem

pytestmark = [
    pytest.mark.skipif(find_program("noctule-camera") is None, reason="noctule-camera is not built"),
    pytest.mark.skipif(multicast_problem() is not None, reason="no multicast route"),
]
AHEAD_US = 77_000_000


def picture(n):
    """(480, 800, 3): plain, tells n by its blue; a red bar 100 px wide stands at either side and is cut off by the 4:3 shape."""
    image = np.full((480, 800, 3), (10 * n + 5, 100, 30), np.uint8)
    image[:, :75] = image[:, -75:] = (0, 0, 255)
    return image


def write(folder, count=10):
    for n in range(count):
        cv2.imwrite(str(folder / f"{n:03d}.png"), picture(n))


@pytest.fixture
def rig(tmp_path):
    """(start, images, wait_for): a running driver and what it publishes."""
    flight, camera = PortLock.take_any(), PortLock.take_any()
    images, stop, process = [], threading.Event(), []
    bus = lcm.LCM(lcm_url(camera.port))
    bus.subscribe("IMAGE", lambda _, data: images.append(noctule_lcm.image_t.decode(data)))

    def imu():
        out, message = lcm.LCM(lcm_url(flight.port)), noctule_lcm.imu_t()
        while not stop.wait(0.01):
            message.t_us, message.seq = round(time.monotonic() * 1e6) + AHEAD_US, message.seq + 1
            out.publish("IMU", message.encode())

    thread = threading.Thread(target=imu, daemon=True)

    def start(device, clock=True):
        if clock:
            thread.start()
        process.append(subprocess.Popen(
            [find_program("noctule-camera"), "--device", device, "--rate", "20", "--lcm-url", lcm_url(flight.port),
             "--camera-lcm-url", lcm_url(camera.port), "--stats", tmp_path / "stats.json"], stderr=subprocess.PIPE, text=True))

    def wait_for(count, timeout_s=15.0):
        end = time.monotonic() + timeout_s
        while len(images) < count and time.monotonic() < end:
            bus.handle_timeout(20)
        return len(images) >= count

    def finish():
        process[0].send_signal(signal.SIGTERM)
        _, said = process[0].communicate(timeout=10)
        assert process[0].returncode == 0
        return json.loads((tmp_path / "stats.json").read_text()), said

    yield start, images, wait_for, finish
    stop.set()
    for p in process:
        if p.poll() is None:
            p.kill()
            p.wait()
    if thread.is_alive():
        thread.join(5)
    flight.release()
    camera.release()


def test_pictures_arrive_in_shape_and_stamped(rig, tmp_path):
    start, images, wait_for, finish = rig
    write(tmp_path)
    start(str(tmp_path / "%03d.png"))
    assert wait_for(8)
    now_us = round(time.monotonic() * 1e6) + AHEAD_US
    stats, said = finish()
    first = None
    for image in images:
        pixels = np.frombuffer(image.bgr, np.uint8).reshape(image.height, image.width, 3)
        assert pixels.shape == (240, 320, 3)
        assert (pixels == pixels[0, 0]).all(), "the bars at the sides are cut off, nothing else is there"
        n = (int(pixels[0, 0, 0]) - 5) / 10
        first = n if first is None else first
        assert n == (first + image.seq) % 10
    stamps = [image.t_us for image in images]
    assert stamps == sorted(set(stamps)) and now_us - 60_000_000 < stamps[0] and stamps[-1] < now_us + 100_000
    assert stats["published"] >= 8 and "open" in said


def test_a_camera_that_goes_away_comes_back(rig, tmp_path):
    start, images, wait_for, finish = rig
    start(str(tmp_path / "%03d.png"))
    assert not wait_for(1, timeout_s=1.5)
    write(tmp_path)
    assert wait_for(5)
    for path in tmp_path.glob("*.png"):
        path.unlink()
    wait_for(10_000, timeout_s=1.5)
    before = len(images)
    write(tmp_path)
    assert wait_for(before + 3)
    stats, said = finish()
    assert stats["opened"] >= 2 and "no camera" in said
    assert [image.seq for image in images] == list(range(len(images)))


def test_without_the_autopilots_clock_nothing_is_published(rig, tmp_path):
    start, images, wait_for, finish = rig
    write(tmp_path)
    start(str(tmp_path / "%03d.png"), clock=False)
    assert not wait_for(1, timeout_s=2.0)
    stats, said = finish()
    assert stats["without_clock"] > 0 and "no IMU" in said
