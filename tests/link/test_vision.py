"""noctule-vision as a process: answers every frame, survives bad ones, names a missing camera, ends cleanly."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import lcm
import noctule_lcm
import numpy as np
import pytest

from noctule.processes import PortLock, find_program, lcm_url, multicast_problem

pytestmark = [
    pytest.mark.skipif(find_program("noctule-vision") is None, reason="noctule-vision is not built"),
    pytest.mark.skipif(multicast_problem() is not None, reason="no multicast route"),
]


def room(box_x):
    """A grey room with a plain red box of 40 x 30 px around (box_x, 150); (240, 320, 3) uint8, blue green red."""
    image = np.full((240, 320, 3), 150, np.uint8)
    image[130:] = 110
    image[135:165, box_x - 20:box_x + 20] = (50, 45, 160)
    noise = np.random.default_rng(1).normal(0.0, 2.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


class Camera:
    """The other end of the camera bus: sends IMAGE, keeps the OBJECTS that come back."""

    def __init__(self, url):
        self.bus = lcm.LCM(url)
        self.answers = []
        self.bus.subscribe("OBJECTS", lambda _, data: self.answers.append(noctule_lcm.objects_t.decode(data)))

    def send(self, seq, image, width=320, height=240):
        message = noctule_lcm.image_t()
        message.t_us, message.seq, message.width, message.height = 200_000 * seq, seq, width, height
        message.bgr = image.tobytes()
        self.bus.publish("IMAGE", message.encode())

    def wait_for(self, count, timeout_s=10.0):
        end = time.monotonic() + timeout_s
        while len(self.answers) < count and time.monotonic() < end:
            self.bus.handle_timeout(50)
        assert len(self.answers) == count


@pytest.fixture
def vision(tmp_path):
    lock = PortLock.take_any()
    url = lcm_url(lock.port)
    process = subprocess.Popen([find_program("noctule-vision"), "--lcm-url", url, "--stats", tmp_path / "stats.json"],
                               stderr=subprocess.PIPE, text=True, env={**os.environ, "LC_ALL": "C"})
    yield process, url, tmp_path / "stats.json"
    if process.poll() is None:
        process.kill()
    process.communicate()
    lock.release()


def first_answer(camera):
    """Sends frame 0 until it is answered: the process may still be starting."""
    for _ in range(100):
        camera.send(0, room(80))
        if camera.bus.handle_timeout(200) > 0:
            break
    assert camera.answers
    time.sleep(0.5)  # late answers to the repeated frame
    while camera.bus.handle_timeout(0) > 0:
        pass
    camera.answers.clear()


def test_every_frame_is_answered_and_the_end_is_clean(vision):
    process, url, stats = vision
    camera = Camera(url)
    first_answer(camera)
    for seq in range(1, 6):  # as in lockstep: the next frame after the answer
        x = 60 + 40 * seq
        camera.send(seq, room(x))
        camera.wait_for(seq)
        answer = camera.answers[-1]
        assert (answer.image_seq, answer.t_us, answer.count, answer.object_id[0]) == (seq, 200_000 * seq, 1, 0)
        assert abs(answer.u_px[0] - x) <= 2 and abs(answer.v_px[0] - 150) <= 2 and 900 < answer.area_px[0] < 1500

    camera.answers.clear()
    camera.bus.publish("IMAGE", b"garbage")
    camera.send(6, room(80), width=4000, height=4000)  # claims more pixels than it has
    camera.wait_for(1)
    assert camera.answers[0].count == 0
    camera.send(7, room(80))
    camera.wait_for(2)
    assert camera.answers[1].count == 1

    camera.answers.clear()
    for seq in range(10, 20):  # faster than any camera: the oldest give way, each still has its answer
        camera.send(seq, room(80))
    camera.wait_for(10)
    assert [a.image_seq for a in camera.answers] == list(range(10, 20))
    assert camera.answers[-1].count == 1

    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=5) == 0
    assert process.stderr.read() == ""
    counted = json.loads(stats.read_text())
    assert counted["refused"] == 1
    assert counted["frames"] + counted["dropped"] + counted["refused"] >= 18


def test_missing_camera_is_named_in_one_line(vision):
    process, _, _ = vision
    time.sleep(4.0)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=5) == 0
    lines = process.stderr.read().splitlines()
    assert len(lines) == 1
    assert "no frame on the camera bus" in lines[0]


def test_bad_parameter_file_is_refused(tmp_path):
    bad = Path(tmp_path / "bad.toml")
    bad.write_text("seg_chroma = 'red'\n")
    done = subprocess.run([find_program("noctule-vision"), "--parameters", bad], capture_output=True, text=True, timeout=20)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
