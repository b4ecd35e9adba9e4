"""noctule-lidar against a SCIP 2.0 server: scans arrive whole and stamped, whatever the line does."""

import json
import signal
import subprocess
import threading
import time

import lcm
import noctule_lcm
import pytest

from noctule.processes import PortLock, find_program, lcm_url, multicast_problem
from scip_server import Laser, SerialLaser, TcpLaser, blocks, checksum, encode

pytestmark = [
    pytest.mark.skipif(find_program("noctule-lidar") is None, reason="noctule-lidar is not built"),
    pytest.mark.skipif(multicast_problem() is not None, reason="no multicast route"),
]
AUTOPILOT_AHEAD_US = 123_456_789


def ramp(scan):
    """Distances in mm that tell the scan and the beam: 1000 + scan, then the beam's own."""
    return [1000 + scan % 1000] + [500 + beam for beam in range(1, 1081)]


def test_the_servers_frames_are_the_specifications():
    """Examples of C-42-03320B: sections 6 and 8.12, and the statuses' sums of 8.1."""
    assert (encode(1234, 2), encode(5432, 3), encode(16_000_000, 4)) == ("CB", "1Dh", "m2@0")
    assert (checksum("00"), checksum("99")) == ("P", "b")
    for line in ("DMIN:20;4", "DMAX:5600;_", "AMIN:44;7", "AMAX:725;o", "AFRT:384;6", "SCAN:600;e", "PROT:SCIP 2.0;N"):
        assert checksum(line[:-2]) == line[-1]
    laser = Laser(lambda n: [1] * 1081)
    assert laser.command("BM") == b"BM\n00P\n\n" and laser.command("BM") == b"BM\n02R\n\n"
    assert laser.command("MD0000108101001") .endswith(b"04T\n\n")
    assert blocks("0" * 130) == ("0" * 64 + "0\n") * 2 + "00P\n"


class Bus:
    """The rest of the vehicle: sends IMU stamped by an autopilot's clock, collects SCAN."""

    def __init__(self):
        self.lock = PortLock.take_any()
        self.url = lcm_url(self.lock.port)
        self.bus = lcm.LCM(self.url)
        self.scans, self.arrived_us = [], []
        self.sending = threading.Event()
        self.sending.set()
        self.stop = threading.Event()
        self.bus.subscribe("SCAN", self._on_scan)
        self.thread = threading.Thread(target=self._imu, daemon=True)
        self.thread.start()

    def _on_scan(self, _, data):
        self.arrived_us.append(self.now_us())
        self.scans.append(noctule_lcm.scan_t.decode(data))

    @staticmethod
    def now_us():
        return round(time.monotonic() * 1e6) + AUTOPILOT_AHEAD_US

    def _imu(self):
        out, message = lcm.LCM(self.url), noctule_lcm.imu_t()
        while not self.stop.wait(0.01):
            if self.sending.is_set():
                message.t_us, message.seq = self.now_us(), message.seq + 1
                out.publish("IMU", message.encode())

    def wait_for(self, count, timeout_s=15.0):
        end = time.monotonic() + timeout_s
        while len(self.scans) < count and time.monotonic() < end:
            self.bus.handle_timeout(20)
        return len(self.scans) >= count

    def close(self):
        self.stop.set()
        self.thread.join(5.0)
        self.lock.release()


@pytest.fixture
def bus():
    bus = Bus()
    yield bus
    bus.close()


@pytest.fixture
def start(bus, tmp_path):
    processes = []

    def run(device, *more):
        process = subprocess.Popen([find_program("noctule-lidar"), "--device", device, "--lcm-url", bus.url, "--stats", tmp_path / "stats.json", *more],
                                   stderr=subprocess.PIPE, text=True)
        processes.append(process)
        return process

    yield run
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.wait()


def end(process, tmp_path):
    """Stops the driver; its counters and what it said."""
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=10)
    assert process.returncode == 0
    return json.loads((tmp_path / "stats.json").read_text()), said


def check(scan, index=None):
    """A scan of ramp(), whole."""
    assert scan.count == 1081
    assert scan.bearing_first_rad == pytest.approx(-2.35619, abs=1e-5)
    assert scan.bearing_increment_rad == pytest.approx(0.00436332, abs=1e-8)
    assert scan.range_min_m == pytest.approx(0.02)
    assert scan.range_m[1:1081] == pytest.approx([(500 + beam) / 1000 for beam in range(1, 1081)], abs=1e-4)


def test_scans_over_tcp_are_stamped_by_the_autopilots_clock(bus, start, tmp_path):
    laser = TcpLaser(Laser(ramp, start_ms=(1 << 24) - 500))      # its clock wraps half a second after its start
    process = start(f"tcp:127.0.0.1:{laser.port}")
    assert bus.wait_for(40)
    stats, said = end(process, tmp_path)
    deadline = time.monotonic() + 5.0
    while laser.laser.lit and time.monotonic() < deadline:
        time.sleep(0.01)
    laser.unplug()
    for scan in bus.scans:
        check(scan)
    # What the sensor's clock says between two scans is what their stamps say, through its wrap and whatever the line delays.
    stamps = [(scan.t_us, laser.laser.stamped_s[round(scan.range_m[0] * 1000) - 1000] * 1e6) for scan in bus.scans]
    errors = sorted(abs((b[0] - a[0]) - (b[1] - a[1])) for a, b in zip(stamps, stamps[1:]))
    assert errors[len(errors) // 2] < 2_000
    # The stamps are those of the autopilot's clock: least delays count as none, a busy machine adds some.
    ahead = sorted(t_us - AUTOPILOT_AHEAD_US - stamped_us for t_us, stamped_us in stamps[10:])
    assert -20_000 < ahead[len(ahead) // 2] < 100_000
    assert [s.seq for s in bus.scans] == list(range(len(bus.scans)))
    assert stats["bad_sum"] == stats["bad_form"] == stats["time_backwards"] == 0
    assert "UST-10LX" in said and "1081 beams, 20.0 Hz" in said
    assert laser.laser.commands[:2] == ["QT", "SCIP2.0"]
    assert laser.laser.commands[-1] == "QT" and not laser.laser.lit      # it goes dark with the driver


def test_damaged_scans_are_dropped_and_counted(bus, start, tmp_path):
    def spoil(n, message):
        if n % 5 == 1:
            return message[:900] + bytes([message[900] ^ 1]) + message[901:]      # one bit
        if n % 5 == 2:
            return message[:1500]                                                 # cut: runs into the next one
        if n % 5 == 4:
            return b"\xff\x00rubbish" + message[200:1200] + b"\n\n"
        return message

    laser = TcpLaser(Laser(ramp, spoil=spoil))
    process = start(f"tcp:127.0.0.1:{laser.port}", "--rate", "40")
    assert bus.wait_for(30)
    stats, _ = end(process, tmp_path)
    laser.unplug()
    for scan in bus.scans:
        check(scan)
    seen = {round(scan.range_m[0] * 1000) - 1000 for scan in bus.scans}
    assert not seen & set(range(1, 1000, 5)) and not seen & set(range(2, 1000, 5)) and not seen & set(range(4, 1000, 5))
    last = max(seen)
    assert set(range(10, last - 5, 5)) <= seen        # whole ones all arrive ...
    assert set(range(13, last - 5, 5)) <= seen        # ... also right behind one that was cut
    assert stats["bad_sum"] >= 5 and stats["bad_form"] >= 10


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_a_laser_that_was_unplugged_comes_back(bus, start, tmp_path, kind):
    laser = TcpLaser(Laser(ramp)) if kind == "tcp" else SerialLaser(Laser(ramp), tmp_path / "laser")
    process = start(f"tcp:127.0.0.1:{laser.port}" if kind == "tcp" else f"serial:{tmp_path / 'laser'}")
    assert bus.wait_for(5)
    laser.unplug()
    bus.wait_for(10_000, timeout_s=1.5)
    before = len(bus.scans)
    laser.laser.__init__(ramp)                        # power was off: its clock begins anew
    laser.plug()
    assert bus.wait_for(before + 10)
    stats, said = end(process, tmp_path)
    laser.unplug()
    stamps = [s.t_us for s in bus.scans]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] - stamps[before - 1] > 1_000_000
    assert stats["time_backwards"] == 0
    late = [a - s.t_us for a, s in zip(bus.arrived_us[before:], bus.scans[before:])]
    assert -5_000 < min(late) and max(late) < 200_000
    assert "trying again" in said and said.count("1081 beams") == 2


def test_a_hung_laser_is_connected_to_anew(bus, start, tmp_path):
    laser = TcpLaser(Laser(ramp))
    process = start(f"tcp:127.0.0.1:{laser.port}")
    assert bus.wait_for(5)
    laser.laser.echo = None                           # it says nothing more, the line stays open
    before = len(bus.scans)
    assert bus.wait_for(before + 5)
    _, said = end(process, tmp_path)
    laser.unplug()
    assert "no scan for a second" in said


def test_a_hardware_fault_is_named(bus, start, tmp_path):
    laser = TcpLaser(Laser(ramp))
    process = start(f"tcp:127.0.0.1:{laser.port}")
    assert bus.wait_for(5)
    laser.laser.status = "70"
    time.sleep(0.3)
    laser.laser.status = "99"
    assert bus.wait_for(len(bus.scans) + 5)
    stats, said = end(process, tmp_path)
    laser.unplug()
    assert stats["sensor_errors"] >= 1 and "hardware fault" in said


def test_without_the_autopilots_clock_nothing_is_published(bus, start, tmp_path):
    laser = TcpLaser(Laser(ramp))
    bus.sending.clear()
    process = start(f"tcp:127.0.0.1:{laser.port}")
    assert not bus.wait_for(1, timeout_s=4.5)
    bus.sending.set()
    assert bus.wait_for(5)
    stats, said = end(process, tmp_path)
    laser.unplug()
    assert "no IMU" in said and stats["without_clock"] > 20


@pytest.mark.parametrize("device", ["tcp:10.0.0.1", "usb:3", "serial:/dev/x:12345", "tcp:host.example:10940"])
def test_a_device_that_is_none_is_refused(start, device):
    process = start(device)
    _, said = process.communicate(timeout=10)
    assert process.returncode == 2 and said.count("\n") == 1 and device in said
