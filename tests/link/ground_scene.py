"""A simulated flight of the three real processes that waits for a ground station on a UDP port, for clients that are programs of others."""

import os
import subprocess
import sys
import time
from pathlib import Path

from noctule.processes import PortLock, lcm_url

BUILD = Path(os.environ.get("NOCTULE_BUILD", Path(__file__).resolve().parents[2] / "build" / "release")).resolve()
COMPANION, SYSTEM = 191, 1
EXPLORING, RETURNING, LANDING, LANDED, PAUSED = 3, 4, 5, 6, 8     # NAMED_VALUE_FLOAT nav_state

class SimulatedFlight:
    """noctule-bridge, noctule-nav and the simulator with its own autopilot; the ground station listens at `port`, the bridge at `camera_url` for what has a camera."""

    def __init__(self, folder: Path, world: str = "maze_a", flavour: str = "px4"):
        self.locks = [PortLock.take_any() for _ in range(4)]
        self.port, autopilot, bus, camera = (lock.port for lock in self.locks)
        url, self.camera_url = lcm_url(bus), lcm_url(camera)
        self.log = open(folder / "processes.txt", "wb")
        commands = [
            [BUILD / "bin" / "noctule-bridge", "--autopilot", f"udpin:127.0.0.1:{autopilot}", "--ground", f"udpout:127.0.0.1:{self.port}", "--lcm-url", url,
             "--camera-url", self.camera_url, "--store", folder / "stored.toml"],
            [BUILD / "bin" / "noctule-nav", "--lcm-url", url],
            [sys.executable, "-m", "noctule_sim", world, "--seed", "3", "--autopilot-port", autopilot, "--lcm-url", url, "--no-camera", "--max-time", "600",
             "--autopilot-flavour", flavour]]
        self.processes = [subprocess.Popen([str(c) for c in command], stdout=self.log, stderr=self.log) for command in commands]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in reversed(self.processes):
            process.terminate()
        for process in self.processes:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.log.close()
        for lock in self.locks:
            lock.release()


def wait_for(what, seconds=60.0):
    """Whether it came true within that wall time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if what():
            return True
        time.sleep(0.02)
    return bool(what())
