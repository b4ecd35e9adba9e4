"""`noctule bench link`: from a complete scan to the setpoint on the wire, with the real noctule-nav and noctule-bridge at the pace of the clock.

The bench stands between bridge and simulated autopilot on the MAVLink link and listens to SCAN on the bus. A setpoint carries its scan's stamp
(time_boot_ms), so each is matched with its scan: the latency is from the scan's arrival on the bus to the setpoint's arrival on the wire.
"""

from __future__ import annotations

import math
import os
import select
import socket
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
SCAN_STAMP = slice(8, 16)       # of the encoded scan_t: t_us, big-endian, behind the fingerprint
WARM_UP = 40                    # first matched setpoints are left out: caches, page faults


class Tap:
    """Passes datagrams between simulator and bridge unchanged, and notes when each setpoint went by."""

    def __init__(self, bridge_port: int):
        self.front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)     # the simulator speaks to this one
        self.front.bind(("127.0.0.1", 0))
        self.back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)      # and the bridge to this one
        self.back.bind(("127.0.0.1", 0))
        for end in (self.front, self.back):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            end.setblocking(False)
        self.bridge = ("127.0.0.1", bridge_port)
        self.simulator = None
        self.mav = mavlink.MAVLink(None)
        self.mav.robust_parsing = True
        self.setpoints: dict[int, float] = {}    # time_boot_ms -> wall time [s]

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
                data, _ = self.back.recvfrom(65536)
            except (BlockingIOError, ConnectionRefusedError):
                return
            now = time.monotonic()
            if self.simulator is not None:
                self.front.sendto(data, self.simulator)
            for message in self.mav.parse_buffer(data) or []:
                if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                    self.setpoints.setdefault(message.time_boot_ms, now)

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
    import lcm

    locks = [PortLock.take_any() for _ in range(3)]
    autopilot, ground, bus_port = (lock.port for lock in locks)
    url = lcm_url(bus_port)
    bus, scans = lcm.LCM(url), {}
    bus.subscribe("SCAN", lambda _, data: scans.setdefault(int.from_bytes(data[SCAN_STAMP], "big") // 1000, time.monotonic()))
    tap, processes = Tap(autopilot), []
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
                select.select([tap.front, tap.back, bus.fileno(), station.socket], [], [], 0.02)
                tap.pump()
                while bus.handle_timeout(0) > 0:
                    pass
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
            for lock in locks:
                lock.release()
    return [tap.setpoints[stamp] - scans[stamp] for stamp in sorted(scans) if stamp in tap.setpoints][WARM_UP:]


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
