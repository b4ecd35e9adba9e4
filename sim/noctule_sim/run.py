"""One simulated flight against real processes: lockstep over MAVLink and LCM, truth.csv and sim.json.

Each tick's MAVLink goes out, then its SCAN (and IMAGE) on LCM; then the ODOMETRY of the scan's stamp is awaited. Wall
time is only the watchdog, and the pace with realtime; there the inertial data of a tick goes out one sample after the other while the laser's latency passes,
then its SCAN.
"""

from __future__ import annotations

import json
import math
import struct
import sys
import time
from pathlib import Path

import numpy as np

from .mavlink import MavlinkLink
from .simulation import TICK_US, Outcome, Simulation, TickData

ANSWER_WAIT_S = 2.0       # no answer for this long: the lockstep is broken
CONNECT_WAIT_S = 10.0     # patience before the first answer
CONNECT_TICK_S = 1.0      # wall time of a tick while nobody has answered yet
LASER_LATENCY_S = 0.025   # of sensors.Profile.answer_latency_s
SETTLE_WALL_S = 0.3       # between the companion's first heartbeat and the first tick
SAY_FIRST_S, SAY_AGAIN_S = 3.0, 10.0
MAX_BEAMS = 1200
TRUTH_COLUMNS = (
    "t_s", "x_m", "y_m", "z_m", "yaw_rad", "roll_rad", "pitch_rad", "vx_m_s", "vy_m_s", "vz_m_s", "clearance_m", "floor_clearance_m",
    "ceiling_clearance_m", "contacts_total", "armed", "mode", "landed", "battery", "autopilot_x_m", "autopilot_y_m", "autopilot_z_m",
    "autopilot_vx_m_s", "autopilot_vy_m_s", "autopilot_vz_m_s", "autopilot_yaw_rad",
)


class ScanEncoder:
    """SCAN messages without building 1200 Python floats: the layout of scan_t.lcm, big-endian."""

    def __init__(self, simulation: Simulation):
        from noctule_lcm import scan_t

        laser, profile = simulation.laser, simulation.profile
        self._head = struct.Struct(">8sqiifffff")
        self._fingerprint = getattr(scan_t, "scan_t", scan_t)._get_packed_fingerprint()
        self._constant = (len(laser.bearings_rad), laser.time_increment_s * 1e6, laser.first_rad, laser.increment_rad, profile.laser_min_m, profile.laser_max_m)
        self._rest = np.full(MAX_BEAMS - len(laser.bearings_rad), np.nan, ">f4").tobytes()

    def encode(self, t_us: int, seq: int, range_m: np.ndarray) -> bytes:
        """One sweep. range_m: (B,) float32."""
        return self._head.pack(self._fingerprint, t_us, seq, *self._constant) + range_m.astype(">f4").tobytes() + self._rest


class TruthFile:
    """truth.csv: a row a tick, on the disk each second of simulated time."""

    def __init__(self, folder: Path):
        self._file = open(folder / "truth.csv", "w", encoding="ascii", newline="\n")
        self._file.write(",".join(TRUTH_COLUMNS) + "\n")

    def write(self, tick: TickData, simulation: Simulation) -> None:
        t, a = tick.truth, simulation.autopilot
        numbers = ",".join(f"{v:.6f}" for v in t[1:13])
        local = ",".join(f"{v:.6f}" for v in tick.local)
        self._file.write(f"{t[0]:.3f},{numbers},{t[13]},{int(a.armed)},{a.name()},{int(a.landed is a.landed.on_ground)},{a.battery:.4f},{local}\n")
        if simulation.ticks % 20 == 0:
            self._file.flush()

    def close(self) -> None:
        self._file.close()


class Nagger:
    """Says that a peer is missing: after 3 s of wall time, then every 10 s at most."""

    def __init__(self, text: str):
        self._text = text
        self._since = time.monotonic()
        self._next = self._since + SAY_FIRST_S

    def heard(self) -> None:
        self._next = time.monotonic() + SAY_FIRST_S

    def missing(self) -> None:
        if time.monotonic() >= self._next:
            print(f"noctule-sim: {self._text}", file=sys.stderr, flush=True)
            self._next = time.monotonic() + SAY_AGAIN_S


class Runner:
    """Flies a simulation against the companion's processes.

    Args:
        simulation: to be flown.
        port: of the companion's MAVLink on 127.0.0.1.
        lcm_url: bus of the flight.
        camera_lcm_url: bus of the images; needed with a camera.
        folder: where truth.csv and sim.json go; None: nowhere.
        realtime: a tick takes 50 ms of wall time, nothing is awaited.
        link: the autopilot's side of the MAVLink; None: the simulated autopilot's own.
    """

    def __init__(self, simulation: Simulation, port: int, lcm_url: str, camera_lcm_url: str | None = None,
                 folder: Path | None = None, realtime: bool = False, link=None):
        import lcm

        self.simulation = simulation
        self.link = link or MavlinkLink(simulation, port)
        self.bus = lcm.LCM(lcm_url)
        self.realtime = realtime
        self.lockstep_broken = False
        self.connected = False
        self.reasons: list[str] = []
        self.stop = False
        self._folder = folder
        self._truth = TruthFile(folder) if folder else None
        self._scan = ScanEncoder(simulation)
        self._companion = Nagger(f"no answer from the companion on 127.0.0.1:{port}, going on trying")
        self._vision = Nagger("no answer from noctule-vision on the camera's bus")
        self._seq = self._image_seq = 0
        self._started = time.monotonic()
        self._images = None
        if simulation.camera is not None:
            self._images = lcm.LCM(camera_lcm_url or lcm_url)
            self._images.subscribe("OBJECTS", self._objects)
            self._seen = -1
            self._vision_lost = False

    def run(self) -> Outcome:
        """Ticks until the simulation ends or `stop` is set; then writes sim.json."""
        simulation = self.simulation
        try:
            if not self.realtime:
                self._wait_for_companion()
            self._started = time.monotonic()
            while simulation.outcome is None and not self.stop:
                tick = simulation.tick()
                self._publish(tick)
                if self._truth:
                    self._truth.write(tick, simulation)
                self._await(tick)
        except KeyboardInterrupt:
            self.stop = True
        if simulation.outcome is None:
            simulation.outcome = Outcome("interrupted", "interrupted")
        self.close()
        return simulation.outcome

    def close(self) -> None:
        if self._truth:
            self._truth.close()
            (self._folder / "sim.json").write_text(json.dumps(self.summary(), indent=2) + "\n", encoding="utf-8")
            self._truth = None
        self.link.close()
        self.simulation.close()

    def summary(self) -> dict:
        """What sim.json holds."""
        s = self.simulation
        clearance = s.min_clearance_m
        return {
            "world": s.world.name, "seed": s.seed, "outcome": s.outcome.name if s.outcome else "running",
            "text": s.outcome.text if s.outcome else "", "reasons": [*self.reasons, *s.touched],
            "collisions": s.collisions, "min_clearance_m": None if math.isinf(clearance) else round(clearance, 4),
            "sim_time_s": round(s.t_us * 1e-6, 3), "wall_time_s": round(time.monotonic() - self._started, 3),
            "lockstep_broken": self.lockstep_broken, "camera": s.camera is not None or self._images is not None,
            "flew": s.flew, "armed": s.autopilot.armed, "mode": s.autopilot.name(), "battery": round(s.autopilot.battery, 4),
            "odometry_received": s.odometry_received, "odometry_used": s.odometry_used, "setpoints_received": s.setpoints_received,
        }

    # ------------------------------------------------------------ one tick on the wire

    def _wait_for_companion(self) -> None:
        """Heartbeats until the companion's own is heard, so that the first tick meets everybody."""
        end = time.monotonic() + CONNECT_WAIT_S
        while not self.link.companion_heard and time.monotonic() < end and not self.stop:
            self.link.send_heartbeat()
            self.link.receive(0.1, None)
            self._companion.missing()
        if self.link.companion_heard:
            time.sleep(SETTLE_WALL_S)
        self._connect_end = time.monotonic() + CONNECT_WAIT_S

    def _publish(self, tick: TickData) -> None:
        if self.realtime:
            begin = self._started + (tick.t_us - TICK_US) * 1e-6
            self.link.play(tick, lambda share: self._pace(begin + share * LASER_LATENCY_S))
            self._pace(begin + LASER_LATENCY_S)
        else:
            self.link.send(tick)
        self._publish_scan(tick)
        if tick.image is not None:
            self._publish_image(tick)

    def _publish_scan(self, tick: TickData) -> None:
        if tick.scan_m is not None:
            self.bus.publish("SCAN", self._scan.encode(tick.t_us, self._seq, tick.scan_m))
            self._seq += 1

    def _publish_image(self, tick: TickData) -> None:
        t_us, bgr = tick.image
        from noctule_lcm import image_t

        kind = getattr(image_t, "image_t", image_t)
        head = struct.pack(">8sqiii", kind._get_packed_fingerprint(), t_us, self._image_seq, bgr.shape[1], bgr.shape[0])
        self._images.publish("IMAGE", head + bgr.tobytes())
        self._image_seq += 1

    def _await(self, tick: TickData) -> None:
        now = time.monotonic()
        if self.realtime:
            self._pace(self._started + tick.t_us * 1e-6)
            return
        if tick.scan_m is None:
            # Without a scan nothing closes the tick: give the companion a moment.
            self._listen(now + 0.010, tick.t_us)
            return
        if not self.connected and not self.lockstep_broken:
            wait = CONNECT_TICK_S
        else:
            wait = TICK_US * 1e-6 if self.lockstep_broken else ANSWER_WAIT_S
        if self._listen(now + wait, tick.t_us):
            self.connected = True
            self._companion.heard()
            if tick.image is not None:
                self._await_vision()
            return
        self._companion.missing()
        if self.lockstep_broken or self.stop:
            return
        if self.connected or time.monotonic() > self._connect_end:
            self.lockstep_broken = True
            text = f"lockstep broken at {tick.t_us * 1e-6:.2f} s: no ODOMETRY of the scan's time for {ANSWER_WAIT_S if self.connected else CONNECT_WAIT_S:.0f} s"
            self.reasons.append(text)
            print(f"noctule-sim: {text}", file=sys.stderr, flush=True)

    def _listen(self, end: float, t_us: int | None) -> bool:
        while not self.stop:
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            if self.link.receive(min(left, 0.2), t_us):
                return True
        return False

    def _pace(self, end: float) -> None:
        """Listens until a moment of wall time."""
        while True:
            left = end - time.monotonic()
            self.link.receive(max(0.0, left), None)
            if end - time.monotonic() <= 0.0 or self.stop:
                return

    def _objects(self, _channel, data: bytes) -> None:
        from noctule_lcm import objects_t

        self._seen = getattr(objects_t, "objects_t", objects_t).decode(data).image_seq

    def _await_vision(self) -> None:
        """In lockstep the answer to each frame is awaited; who never answers is waited for once."""
        wait = 0.0 if self._vision_lost else ANSWER_WAIT_S
        end = time.monotonic() + wait
        while self._seen < self._image_seq - 1:
            left = end - time.monotonic()
            self._images.handle_timeout(int(max(0.0, left) * 1000))
            if left <= 0.0 or self.stop:
                break
        if self._seen >= self._image_seq - 1:
            self._vision_lost = False
            self._vision.heard()
        elif not self._vision_lost:
            self._vision_lost = True
            self.lockstep_broken = True
            self.reasons.append(f"noctule-vision did not answer frame {self._image_seq - 1}")
            self._vision.missing()
