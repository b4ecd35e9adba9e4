"""`noctule bench link`: from a complete scan to the setpoint on the wire, with the real noctule-nav and noctule-bridge at the pace of the clock.

The bench stands between bridge and simulated autopilot on the MAVLink link and listens to the bus. A setpoint carries its scan's stamp
(time_boot_ms), so each is matched with its scan: the latency is from the scan's arrival on the bus to the setpoint's arrival on the wire. Both are
the kernel's stamps, so that the bench's own delays are in neither. Inertial data comes spread out, as from a real autopilot (simulator's --realtime).
"""

from __future__ import annotations

import math
import os
import re
import select
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from noctule.ground import GroundStation
from noctule.processes import PortLock, lcm_url, need_program
from noctule.settings import InputError

os.environ.setdefault("MAVLINK20", "1")
from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

WORLD, SEED = "maze_a", 1
STAMP_NS = 35                   # SO_TIMESTAMPNS of Linux: the kernel's time of arrival comes with each datagram
LCM_HEAD = b"LC02"              # then 4 bytes of sequence number, the channel's name up to a zero, the message
FINGERPRINT = 8                 # of the encoded scan_t; then t_us, big-endian
WARM_UP = 40                    # first matched setpoints are left out: caches, page faults


def arrival(receiver: socket.socket) -> tuple[bytes, float]:
    """A datagram and when it arrived, by the kernel [s].

    Raises:
        BlockingIOError: none waits.
    """
    data, ancillary, _, _ = receiver.recvmsg(65536, 64)
    for level, kind, value in ancillary:
        if level == socket.SOL_SOCKET and kind == STAMP_NS:
            seconds, nanoseconds = struct.unpack("@ll", value[:struct.calcsize("@ll")])
            return data, seconds + 1e-9 * nanoseconds
    raise InputError("bench link: the kernel gives no time of arrival")


def scan_stamp(datagram: bytes) -> int | None:
    """t_us of the SCAN that a datagram of the bus carries; None: it carries something else.

    >>> scan_stamp(LCM_HEAD + bytes(4) + b"SCAN\\0" + bytes(8) + (42).to_bytes(8, "big"))
    42
    >>> scan_stamp(LCM_HEAD + bytes(4) + b"IMU\\0" + bytes(16)) is None
    True
    """
    head = LCM_HEAD + datagram[4:8] + b"SCAN\0"
    if not datagram.startswith(head):
        return None
    return int.from_bytes(datagram[len(head) + FINGERPRINT:len(head) + FINGERPRINT + 8], "big")


class Ear:
    """Notes when each SCAN was on the bus."""

    def __init__(self, url: str):
        group, port = re.match(r"udpm://([0-9.]+):(\d+)", url).groups()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self.socket.setsockopt(socket.SOL_SOCKET, STAMP_NS, 1)
        self.socket.bind((group, int(port)))
        self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, struct.pack("=4sl", socket.inet_aton(group), socket.INADDR_ANY))
        self.socket.setblocking(False)
        self.scans: dict[int, float] = {}        # stamp [ms] -> arrival [s]

    def listen(self) -> None:
        """Takes what waits."""
        while True:
            try:
                data, at_s = arrival(self.socket)
            except BlockingIOError:
                return
            stamp = scan_stamp(data)
            if stamp is not None:
                self.scans.setdefault(stamp // 1000, at_s)

    def close(self) -> None:
        self.socket.close()


class Tap:
    """Passes datagrams between simulator and bridge unchanged, and notes when each setpoint went by."""

    def __init__(self, bridge_port: int):
        self.front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)     # the simulator speaks to this one
        self.front.bind(("127.0.0.1", 0))
        self.back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)      # and the bridge to this one
        self.back.bind(("127.0.0.1", 0))
        self.back.setsockopt(socket.SOL_SOCKET, STAMP_NS, 1)
        for end in (self.front, self.back):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            end.setblocking(False)
        self.bridge = ("127.0.0.1", bridge_port)
        self.simulator = None
        self.mav = mavlink.MAVLink(None)
        self.mav.robust_parsing = True
        self.setpoints: dict[int, float] = {}    # time_boot_ms -> arrival [s]

    @property
    def port(self) -> int:
        return self.front.getsockname()[1]

    def pump(self) -> None:
        """Passes on what waits."""
        while True:
            try:
                data, self.simulator = self.front.recvfrom(65536)
            except BlockingIOError:
                break
            self.back.sendto(data, self.bridge)
        while True:
            try:
                data, at_s = arrival(self.back)
            except (BlockingIOError, ConnectionRefusedError):
                return
            if self.simulator is not None:
                self.front.sendto(data, self.simulator)
            for message in self.mav.parse_buffer(data) or []:
                if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                    self.setpoints.setdefault(message.time_boot_ms, at_s)

    def close(self) -> None:
        self.front.close()
        self.back.close()


def measure(profile: str, seconds: float) -> list[float]:
    """Latencies [s] of a flight, in the order of the scans.

    Args:
        profile: sensors; 'default' has inertial data at 250 Hz, 'harsh' at 50 Hz.
        seconds: of flight after the start was accepted.

    Raises:
        InputError: the programs are not built, or the vehicle did not take off.
    """
    locks = [PortLock.take_any() for _ in range(3)]
    autopilot, ground, bus_port = (lock.port for lock in locks)
    url = lcm_url(bus_port)
    ear, tap, processes = Ear(url), Tap(autopilot), []
    with tempfile.TemporaryDirectory() as folder:
        station = GroundStation(ground, Path(folder) / "flight.tlog")
        try:
            for command in ([need_program("noctule-bridge"), "--autopilot", f"udpin:127.0.0.1:{autopilot}", "--ground", f"udpout:127.0.0.1:{ground}", "--lcm-url", url],
                            [need_program("noctule-nav"), "--lcm-url", url],
                            [sys.executable, "-m", "noctule_sim", WORLD, "--seed", str(SEED), "--profile", profile, "--autopilot-port", str(tap.port), "--lcm-url", url,
                             "--no-camera", "--realtime"]):
                processes.append(subprocess.Popen([str(c) for c in command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            deadline, begun = time.monotonic() + 90.0, None
            while time.monotonic() < deadline:
                select.select([tap.front, tap.back, ear.socket, station.socket], [], [], 0.02)
                tap.pump()
                ear.listen()
                station.receive()
                station.tick()
                if station.start_result != mavlink.MAV_RESULT_ACCEPTED:
                    station.start_mission(0.0)
                elif begun is None and station.armed:
                    begun = time.monotonic()
                    deadline = begun + seconds
            if begun is None:
                raise InputError("bench link: the vehicle did not arm")
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait()
            station.close()
            tap.close()
            ear.close()
            for lock in locks:
                lock.release()
    return [tap.setpoints[stamp] - ear.scans[stamp] for stamp in sorted(ear.scans) if stamp in tap.setpoints][WARM_UP:]


def percentile(values: list[float], share: float) -> float | None:
    """The smallest value that at least this share of the values does not exceed; None without values.

    >>> percentile([3.0, 1.0, 2.0], 0.5), percentile([], 0.5)
    (2.0, None)
    """
    if not values:
        return None
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


def bench_link(quick: bool, fresh: bool) -> list[dict]:
    """The table. A flight at the pace of the clock cannot be kept: `fresh` changes nothing."""
    from noctule.bench import row

    seconds = 30.0 if quick else 90.0
    out = []
    for profile, rate, median, most in (("default", 250, 3.0, 10.0), ("harsh", 50, None, 25.0)):
        latencies = measure(profile, seconds)
        value = lambda share: None if not latencies else 1e3 * percentile(latencies, share)  # noqa: E731
        out.append(row(f"scan to setpoint, inertial data at {rate} Hz, median", value(0.5), "ms", must=f"<= {median}" if median else None))
        out.append(row(f"scan to setpoint, inertial data at {rate} Hz, p99", value(0.99), "ms", must=f"<= {most}"))
        out.append(row(f"setpoints matched, inertial data at {rate} Hz", len(latencies), "-", must=">= 100"))
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    out.append(row("load of the machine per core while measuring", load, "-", reference="1 or less for a fair figure"))
    return out
