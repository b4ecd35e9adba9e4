"""A whole flight in this process: the simulator's Simulation and the firmware's NavNode, no sockets, no MAVLink.

For benches that need hundreds of flights. It leaves the same run directory as `noctule fly` (flight.lcm, truth.csv,
sim.json, run.json), so that the same report is made of it. What the bridge does, in its plainest form, is played here:
start when ready, setpoints for a second, mode, arming, disarming after landing.
"""

import csv
import datetime
import json
import math
import struct
import time
from pathlib import Path

import lcm
import numpy as np

from noctule import record, report
from noctule.inprocess import Node, navigator_bytes
from noctule.policy_host import Peer
from noctule.settings import FlightSettings, parameter_values, parameters_toml
from noctule_sim.autopilot import Landed, Mode
from noctule_sim.simulation import OdometryIn, SetpointIn, Simulation, TickData

STREAM_S = 1.2          # setpoints flow so long before the mode is asked for
RETRY_S = 1.0
VEHICLE_US = 200_000    # VEHICLE at 5 Hz and on every change
TRUTH_COLUMNS = ("t_s", "x_m", "y_m", "z_m", "yaw_rad", "roll_rad", "pitch_rad", "vx_m_s", "vy_m_s", "vz_m_s", "clearance_m",
                 "contacts_total", "armed", "mode")


class _Encoder:
    """Fills and encodes the messages that the bridge and the laser's driver publish."""

    def __init__(self, simulation: Simulation):
        profile = simulation.profile
        self._types = {n: record.message_type(f"{n}_t") for n in ("imu", "attitude", "range", "baro", "vehicle", "command", "scan")}
        self._seq = dict.fromkeys(("imu", "attitude", "up", "down", "baro", "vehicle", "command", "scan"), -1)
        scan = self._types["scan"]()
        bearings = simulation.laser.bearings_rad
        scan.count = len(bearings)
        scan.bearing_first_rad = float(bearings[0])
        scan.bearing_increment_rad = float(bearings[1] - bearings[0])
        scan.time_increment_us = simulation.laser.sweep_s * 1e6 / (len(bearings) - 1)
        scan.range_min_m, scan.range_max_m = profile.laser_min_m, profile.laser_max_m
        self._scan = scan
        self._pad = [0.0] * (len(scan.range_m) - scan.count)
        self._range_limits = profile.range_min_m, profile.range_max_m

    def _next(self, name: str) -> int:
        self._seq[name] += 1
        return self._seq[name]

    def imu(self, sample) -> bytes:
        m = self._types["imu"]()
        m.t_us, m.seq = sample.t_us, self._next("imu")
        m.accel_m_s2, m.gyro_rad_s = sample[1:4], sample[4:7]
        return m.encode()

    def attitude(self, sample) -> bytes:
        m = self._types["attitude"]()
        m.t_us, m.seq = sample.t_us, self._next("attitude")
        m.roll_rad, m.pitch_rad, _ = sample.euler_rad
        return m.encode()

    def range(self, t_us: int, range_m: float, up: bool) -> bytes:
        m = self._types["range"]()
        m.t_us, m.seq, m.range_m = t_us, self._next("up" if up else "down"), range_m
        m.range_min_m, m.range_max_m = self._range_limits
        return m.encode()

    def baro(self, t_us: int, height_m: float) -> bytes:
        m = self._types["baro"]()
        m.t_us, m.seq, m.height_m = t_us, self._next("baro"), height_m
        return m.encode()

    def scan(self, t_us: int, range_m: np.ndarray) -> bytes:
        m = self._scan
        m.t_us, m.seq = t_us, self._next("scan")
        m.range_m = range_m.tolist() + self._pad
        return m.encode()

    def vehicle(self, data: TickData, autopilot, lost: bool) -> bytes:
        m = self._types["vehicle"]()
        m.t_us, m.seq = data.t_us, self._next("vehicle")
        m.armed, m.offboard = int(autopilot.armed), int(autopilot.mode is Mode.offboard)
        m.landed = 1 if autopilot.landed is Landed.on_ground else 2
        m.mission_lost = int(lost)
        m.battery_remaining = autopilot.battery
        m.local_position_valid = int(autopilot.position_known)
        m.local_x_m, m.local_y_m, m.local_z_m, m.local_yaw_rad = data.local[0], data.local[1], data.local[2], data.local[6]
        return m.encode()

    def start(self, t_us: int) -> bytes:
        m = self._types["command"]()
        m.t_us, m.seq, m.command = t_us, self._next("command"), m.START
        return m.encode()


class Eye:
    """noctule-vision's part in a flight: frames in, objects.db and camera.lcm out."""

    def __init__(self, folder: Path, log_images: bool, parameters: dict[str, float]):
        from noctule.vision_abi import Vision
        from noctule_sim.camera import write_calibration

        write_calibration(folder / "camera.yaml")
        for name in ("objects.db", "objects.db-wal", "objects.db-shm"):
            (folder / name).unlink(missing_ok=True)
        self._vision = Vision(folder / "objects.db", folder / "camera.yaml", parameters=parameters)
        self._log = lcm.EventLog(str(folder / "camera.lcm"), "w", overwrite=True)
        self._log_images = log_images
        self._frames = 0

    def receive(self, channel: str, message: bytes) -> None:
        """NAV and SCAN."""
        self._vision.receive(channel, message)

    def see(self, t_us: int, bgr, now_us: int) -> None:
        """One frame: (240, 320, 3) uint8."""
        kind = record.message_type("image_t")
        message = struct.pack(">8sqiii", kind._get_packed_fingerprint(), t_us, self._frames, bgr.shape[1], bgr.shape[0]) + bgr.tobytes()
        self._frames += 1
        if self._log_images:
            self._log.write_event(now_us, "IMAGE", message)
        self._vision.receive("IMAGE", message)
        self._log.write_event(now_us, "OBJECTS", self._vision.look())

    def close(self) -> None:
        """Database and log are complete."""
        self._vision.close()
        self._log.close()


class _Starter:
    """The bridge's part in a flight: start, mode, arm, disarm. Once a flight; a mode that is taken away is not asked for again."""

    def __init__(self):
        self.started_us: int | None = None
        self.setpoints_since_us: int | None = None
        self.retry_us = 0
        self.armed_once = False
        self.flying = False
        self.lost = False

    def act(self, simulation: Simulation, nav) -> None:
        """After one step: what to ask of the autopilot."""
        autopilot, t_us = simulation.autopilot, simulation.t_us
        if nav.setpoint_valid and self.setpoints_since_us is None:
            self.setpoints_since_us = t_us
        if self.flying and autopilot.armed and autopilot.mode is not Mode.offboard:
            self.lost = True
        if nav.want_disarm and autopilot.armed:
            simulation.post(autopilot.disarm)
        ready_to_ask = (self.setpoints_since_us is not None and t_us - self.setpoints_since_us >= STREAM_S * 1e6
                        and not self.armed_once and t_us >= self.retry_us)
        if ready_to_ask:
            self.retry_us = t_us + int(RETRY_S * 1e6)
            simulation.post(lambda: self._ask(autopilot))

    def _ask(self, autopilot) -> None:
        if autopilot.set_mode(Mode.offboard) is None and autopilot.arm() is None:
            self.armed_once = self.flying = True


def fly(settings: FlightSettings, world, folder: Path) -> dict:
    """Flies one flight and returns its report; the run directory is left in `folder`.

    Args:
        settings: realtime and out are not looked at. camera: the recognition runs in-process, too.
        world: the building.
        folder: where to write; made if absent.

    Raises:
        LibraryMissing: the shared library was not built.
    """
    from noctule_sim.world import dump_world

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "log").mkdir(exist_ok=True)
    values = parameter_values(settings)
    (folder / "parameters.toml").write_text(parameters_toml(values), encoding="utf-8")
    dump_world(world, folder / "world.yaml")
    faults = {name: float(t) for name, _, t in (f.partition("@") for f in settings.faults)}
    simulation = Simulation(world, settings.seed, settings.profile, values, camera=settings.camera, flavour=settings.autopilot, faults=faults,
                            max_time_s=settings.max_time_s)
    eye = Eye(folder, settings.log_images, values) if settings.camera else None
    policy = Peer(settings.policy_class, folder / "parameters.toml", folder / "log" / "policy.txt") if settings.policy_class else None
    begin = time.monotonic()
    log = lcm.EventLog(str(folder / "flight.lcm"), "w", overwrite=True)
    try:
        with Node(values) as node, (folder / "truth.csv").open("w", newline="", encoding="utf-8") as truth:
            steps_us = _loop(simulation, node, log, csv.writer(truth), eye, policy)
            explorer = node.explorer()
    finally:
        if eye is not None:
            eye.close()
        if policy is not None:
            policy.close()
        log.close()
        simulation.close()
    _write_ends(folder, settings, world, simulation, steps_us, explorer, time.monotonic() - begin)
    return report.write(folder)


def _loop(simulation: Simulation, node: Node, log, truth, eye=None, policy=None) -> list[float]:
    """Ticks until the simulation has an outcome; returns the step times [us]."""
    encoder, starter = _Encoder(simulation), _Starter()
    nav_type, odom_type = record.message_type("nav_t"), record.message_type("odom_t")
    truth.writerow(TRUTH_COLUMNS)
    nav, steps_us, shown, next_vehicle_us = None, [], None, 0

    def send(channel: str, message: bytes) -> None:
        log.write_event(simulation.t_us, channel, message)
        node.receive(channel, message)

    while simulation.outcome is None:
        data = simulation.tick()
        autopilot = simulation.autopilot
        state = (autopilot.armed, autopilot.mode, autopilot.landed, starter.lost)
        if state != shown or data.t_us >= next_vehicle_us:
            shown, next_vehicle_us = state, data.t_us + VEHICLE_US
            send("VEHICLE", encoder.vehicle(data, autopilot, starter.lost))
        if nav is not None and nav.ready and starter.started_us is None:
            starter.started_us = data.t_us
            send("COMMAND", encoder.start(data.t_us))
        for attitude in data.attitude:
            send("ATTITUDE", encoder.attitude(attitude))
        send("RANGE_UP", encoder.range(data.t_us, data.range_up_m, True))
        send("RANGE_DOWN", encoder.range(data.t_us, data.range_down_m, False))
        send("BARO", encoder.baro(data.t_us, data.baro_m))
        for sample in data.imu:
            send("IMU", encoder.imu(sample))
        if data.scan_m is not None:
            scan = encoder.scan(data.t_us, data.scan_m)
            if eye is not None:
                eye.receive("SCAN", scan)
            send("SCAN", scan)
        t = data.truth
        truth.writerow([f"{v:.6f}" for v in (t.t_s, t.x_m, t.y_m, t.z_m, t.yaw_rad, t.roll_rad, t.pitch_rad, t.vx_m_s, t.vy_m_s,
                                             t.vz_m_s, t.clearance_m)] + [t.contacts_total, int(autopilot.armed), autopilot.name()])
        setpoint, odometries = None, []
        for channel, message in node.outputs():
            log.write_event(simulation.t_us, channel, message)
            if policy is not None and channel in ("GRID_TILE", "POLICY_ASK"):
                policy.send(channel, message)
            elif channel == "NAV":
                nav = nav_type.decode(message)
                if eye is not None:
                    eye.receive(channel, message)
                steps_us.append(nav.step_us)
                if nav.setpoint_valid and not starter.lost:
                    setpoint = SetpointIn(nav.setpoint_x_m, nav.setpoint_y_m, nav.setpoint_z_m, nav.setpoint_vx_m_s,
                                          nav.setpoint_vy_m_s, nav.setpoint_vz_m_s, nav.setpoint_yaw_rad)
            elif channel == "ODOM":
                o = odom_type.decode(message)
                odometries.append(OdometryIn(o.t_us, o.x_m, o.y_m, o.z_m, o.vx_m_s, o.vy_m_s, o.vz_m_s, o.yaw_rad, o.quality,
                                             o.reset_counter & 0xFF))
        for answer in policy.answers() if policy is not None else ():
            send("POLICY_GOAL", answer)
        if eye is not None and data.image is not None:
            eye.see(*data.image, simulation.t_us)
        simulation.apply(setpoint, odometries)
        if nav is not None:
            starter.act(simulation, nav)
    return steps_us


def _write_ends(folder: Path, settings: FlightSettings, world, simulation: Simulation, steps_us: list[float], explorer: dict, wall_s: float) -> None:
    outcome = simulation.outcome
    clearance = simulation.min_clearance_m
    sim = {"outcome": outcome.name, "text": outcome.text, "reasons": simulation.touched, "collisions": simulation.collisions,
           "min_clearance_m": clearance if math.isfinite(clearance) else None, "sim_time_s": simulation.t_us * 1e-6,
           "lockstep_broken": False}
    (folder / "sim.json").write_text(json.dumps(sim) + "\n", encoding="utf-8")
    times = np.array(steps_us) if steps_us else np.zeros(1)
    stats = {"steps": len(steps_us), "step_us": {"p50": float(np.percentile(times, 50)), "p99": float(np.percentile(times, 99)),
                                                "max": float(times.max())},
             "navigator_bytes": navigator_bytes(), "rss_kib": None, "heap_allocations_after_start": None, "explorer": explorer}
    (folder / "log" / "nav-stats.json").write_text(json.dumps(stats) + "\n", encoding="utf-8")
    run = {"world": world.name, "seed": settings.seed, "profile": settings.profile, "preset": settings.preset, "policy_class": settings.policy_class,
           "autopilot": settings.autopilot, "parameters": settings.parameters, "faults": settings.faults, "camera": settings.camera,
           "realtime": False, "max_time_s": settings.max_time_s, "wall_time_s": wall_s,
           "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"), "interrupted": False,
           "died": None, "last_text": outcome.text}
    (folder / "run.json").write_text(json.dumps(run) + "\n", encoding="utf-8")
