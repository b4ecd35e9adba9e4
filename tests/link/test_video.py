"""noctule-video: pictures in on the camera bus, H.264 by RTP out, and the camera that ground stations find through the bridge."""

import json
import os
import signal
import socket
import subprocess
import time
from pathlib import Path

import cv2
import lcm
import noctule_lcm
import numpy as np
import pytest
from ground_scene import wait_for

from noctule.processes import PortLock, find_program, lcm_url, multicast_problem

pytestmark = [pytest.mark.skipif(find_program("noctule-video") is None, reason="noctule-video is not built"),
              pytest.mark.skipif(multicast_problem() is not None, reason="no multicast route")]
WIDTH, HEIGHT = 320, 240
SINGLE, STAP_A, FU_A = range(1, 24), 24, 28        # RFC 6184, NAL unit types


def has_gstreamer():
    try:
        return all(subprocess.run(["gst-inspect-1.0", "--exists", element], capture_output=True, check=False).returncode == 0
                   for element in ("x264enc", "rtph264pay", "rawvideoparse", "multiudpsink"))
    except FileNotFoundError:
        return False


def picture(n):
    """(240, 320, 3): left half grey by n below 10, right half blue."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[:, :WIDTH // 2] = 40 + 20 * n
    image[:, WIDTH // 2:, 0] = 250
    return image


def to_stream(packets):
    """RTP packets of one source, in order, as an H.264 byte stream (RFC 6184)."""
    out, start = bytearray(), b"\0\0\0\1"
    for packet in packets:
        assert packet[0] == 0x80 and packet[1] & 0x7F == 96
        payload = packet[12:]
        kind = payload[0] & 31
        if kind in SINGLE:
            out += start + payload
        elif kind == STAP_A:
            at = 1
            while at < len(payload):
                size = int.from_bytes(payload[at:at + 2], "big")
                out += start + payload[at + 2:at + 2 + size]
                at += 2 + size
        else:
            assert kind == FU_A
            if payload[1] & 0x80:
                out += start + bytes([payload[0] & 0xE0 | payload[1] & 31])
            out += payload[2:]
    return bytes(out)


class Video:
    """A noctule-video on a camera bus of its own, its receiver, and what it tells."""

    def __init__(self, folder, environment=None):
        self.lock = PortLock.take_any()
        self.folder = folder
        self.receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.receiver.bind(("127.0.0.1", 0))
        self.receiver.setblocking(False)
        self.port = self.receiver.getsockname()[1]
        self.bus = lcm.LCM(lcm_url(self.lock.port))
        self.told, self.packets, self.shown = [], [], 0
        self.bus.subscribe("VIDEO", lambda _, data: self.told.append(noctule_lcm.video_t.decode(data)))
        self.process = subprocess.Popen([find_program("noctule-video"), "--lcm-url", lcm_url(self.lock.port), "--to", "127.0.0.1",
                                         "--port", str(self.port), "--stats", folder / "stats.json"], stderr=subprocess.PIPE, text=True,
                                        env={**os.environ, **(environment or {})})

    def receive(self):
        while self.bus.handle_timeout(1):
            pass
        while True:
            try:
                self.packets.append(self.receiver.recv(65536))
            except BlockingIOError:
                return

    def show(self, n, seconds=0.05):
        message = noctule_lcm.image_t()
        message.t_us, message.seq, message.width, message.height, message.bgr = 1_000_000 + 200_000 * n, n, WIDTH, HEIGHT, picture(n // 4 % 10).tobytes()
        self.bus.publish("IMAGE", message.encode())
        self.shown += 1
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.receive()

    def close(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        said = self.process.communicate(timeout=10)[1]
        self.receiver.close()
        self.lock.release()
        return said


@pytest.mark.skipif(not has_gstreamer(), reason="GStreamer's programs with x264enc are not installed")
def test_the_pictures_come_out_at_the_other_end(tmp_path):
    video = Video(tmp_path)
    assert wait_for(lambda: (video.receive(), video.told)[1], 60.0)
    done = lambda: (video.show(video.shown), len({p[4:8] for p in video.packets}) > 40 and video.told[-1].running)[1]  # noqa: E731  as many stamps as pictures
    assert wait_for(done, 60.0)
    assert video.told[-1].port == video.port and video.told[-1].rate_hz > 0.0
    assert [told.seq for told in video.told] == list(range(video.told[0].seq, video.told[0].seq + len(video.told)))
    video.close()
    assert video.process.returncode == 0
    stats = json.loads((tmp_path / "stats.json").read_text())
    assert stats["starts"] == 1 and stats["sent"] > 12 and stats["sent"] + stats["dropped"] == stats["frames"]
    (tmp_path / "video.h264").write_bytes(to_stream(video.packets))
    capture, greys = cv2.VideoCapture(str(tmp_path / "video.h264")), []
    while True:
        good, image = capture.read()
        if not good:
            break
        assert image.shape == (HEIGHT, WIDTH, 3)
        left, right = image[40:200, 20:140].mean(axis=(0, 1)), image[40:200, 180:300].mean(axis=(0, 1))
        greys.append((left[1] - 40.0) / 20.0)
        assert right[0] > 120 and right[0] > 4 * max(right[1:])         # blue stayed blue
        assert max(abs(left - left[1])) < 20                        # and grey grey
    # Each picture is shown four times; where the bits do not suffice at once, one between two of them is a mixture.
    pictures = [round(grey) for grey in greys if abs(grey - round(grey)) < 0.3]
    assert len(greys) > 20 and len(pictures) > len(greys) // 2, greys
    changes = [(b - a) % 10 for a, b in zip(pictures, pictures[1:]) if a != b]
    assert len(changes) >= 4 and sum(change <= 2 for change in changes) > len(changes) // 2, greys     # in the order in which they were shown


@pytest.mark.skipif(not has_gstreamer(), reason="GStreamer's programs with x264enc are not installed")
def test_an_encoder_that_dies_is_started_again(tmp_path):
    video = Video(tmp_path)
    assert wait_for(lambda: (video.show(video.shown), video.packets)[1], 60.0)
    child = Path(f"/proc/{video.process.pid}/task/{video.process.pid}/children").read_text().split()
    os.kill(int(child[0]), signal.SIGKILL)
    assert wait_for(lambda: (video.show(video.shown), video.told and not video.told[-1].running)[1], 30.0)
    video.packets.clear()
    assert wait_for(lambda: (video.show(video.shown), video.packets)[1], 60.0)
    assert "once more" in video.close()
    assert video.process.returncode == 0


def test_without_gstreamer_one_line_says_so(tmp_path):
    video = Video(tmp_path, {"PATH": str(tmp_path)})
    assert video.process.wait(10) == 77
    video.receive()
    assert video.told == []                                         # and no ground station hears of a camera
    assert video.close().splitlines() == ["noctule-video: no video, GStreamer's gst-inspect-1.0 is not installed: apt-get install gstreamer1.0-tools "
                                          "gstreamer1.0-plugins-base gstreamer1.0-plugins-good gstreamer1.0-plugins-ugly"]


def test_a_host_with_more_in_it_than_a_host_is_refused():
    done = subprocess.run([find_program("noctule-video"), "--to", "10.0.0.1,10.0.0.2"], capture_output=True, text=True, timeout=10, check=False)
    assert done.returncode == 2 and "is no host" in done.stderr
