"""Flies one simulated flight: starts the processes, plays ground station, shows progress, and leaves a run directory."""

from __future__ import annotations

import datetime
import json
import math
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

from noctule import record, report, score
from noctule.ground import GroundStation
from noctule.policy_host import READY, WAIT_S
from noctule.processes import (Child, PortLock, end_all, find_program, build_folder, lcm_url, multicast_problem,
                               need_program)
from noctule.score import ExploredScore, StartPose
from noctule.settings import FlightSettings, InputError, SkippedFlight, parameter_values, parameters_toml, run_folder

GROUND_PORT = 14550          # where ground stations listen by custom
START_S = 3.0                # autopilot time of the start: late enough for every process to be up
REAL_START_S = 20.0          # a real autopilot first boots and finds its position
BRIDGE_WAIT_S = 10.0         # wall time
RECORDER_WAIT_S = 10.0       # wall time
POLICY_WAIT_S = 60.0         # wall time
NOT_STARTED_S = 90.0         # simulated time after which a mission that has not armed is given up
AFTER_LANDING_S = 5.0        # wall time that the simulator has to end by itself
SILENCE_S = 60.0             # wall time without a step or an end after which a flight is given up
FIRST_STEP_S = 300.0         # the same before the first step: rendering in software takes a minute to set up on a loaded machine
CAMERA_PROBE = "import mujoco; c = mujoco.GLContext(32, 32); c.make_current(); c.free()"


def camera_problem() -> str | None:
    """One line on why the camera cannot run, else None: no vision process, or nothing to render with."""
    if find_program("noctule-vision") is None:
        return "noctule-vision is not built"
    try:
        done = subprocess.run([sys.executable, "-c", CAMERA_PROBE], env={**_environment(), "MUJOCO_GL": "egl"},
                              capture_output=True, timeout=60, check=False)
    except subprocess.TimeoutExpired:
        return "EGL does not answer"
    return None if done.returncode == 0 else "no EGL to render with"


def _environment() -> dict[str, str]:
    import os

    return dict(os.environ)


class Progress:
    """What the operator sees: one line that is rewritten on a terminal, else a line every few seconds."""

    def __init__(self, quiet: bool):
        self.quiet = quiet
        self.terminal = sys.stdout.isatty()
        self._next = 0.0
        self._open = False

    def say(self, text: str) -> None:
        """A line that stays."""
        if self.quiet:
            return
        print(("\r\033[K" if self._open else "") + text, flush=True)
        self._open = False

    def show(self, text) -> None:
        """The line of the moment; text is called only when it is due."""
        now = time.monotonic()
        if self.quiet or now < self._next:
            return
        self._next = now + (0.2 if self.terminal else 5.0)
        if self.terminal:
            print("\r\033[K" + text()[:118], end="", flush=True)
            self._open = True
        else:
            print(text(), flush=True)


class Follower:
    """Follows the flight on the bus: newest step, explored share, pose error from truth.csv. For the display only."""

    def __init__(self, url: str, world, truth_path: Path):
        import lcm

        start = world.start
        self._lcm = lcm.LCM(url)
        self._nav_type = record.message_type("nav_t")
        self._truth_path = truth_path
        self._truth_offset = 0
        self._truth_head: list[str] = []
        self._truth_rest = ""
        self._truth: dict[int, tuple[float, float]] = {}
        self._poses: dict[int, tuple[float, float]] = {}
        self._start = StartPose(start.x_m, start.y_m, start.z_m, start.yaw_rad)
        self._grade = ExploredScore(score.cached_floor_truth(world.primitives(), start.z_m, start.x_m, start.y_m),
                                    self._start)
        self.nav = None
        self.steps = 0
        self.error_m: float | None = None
        self.step_wall_s = time.monotonic()
        for channel, handler in (("NAV", self._on_nav), ("GRID_TILE", self._on_tile)):
            self._lcm.subscribe(channel, handler).set_queue_capacity(2000)

    def _on_nav(self, _, data) -> None:
        self.nav = self._nav_type.decode(data)
        self.steps += 1
        self.step_wall_s = time.monotonic()
        self._poses[int(self.nav.t_us)] = (self.nav.x_m, self.nav.y_m)

    def _on_tile(self, _, data) -> None:
        tile = record.decode_tile(data)
        if tile.floor == 0:
            self._grade.update(tile.t_us * 1e-6, tile.tile_x, tile.tile_y, tile.cell_m, tile.log_odds)

    def fileno(self) -> int:
        """For select()."""
        return self._lcm.fileno()

    def receive(self) -> None:
        """Takes in what has arrived."""
        for _ in range(500):
            if self._lcm.handle_timeout(0) == 0:
                return

    @property
    def explored(self) -> float:
        """Explored share of the start's floor so far."""
        return self._grade.explored_fraction

    @property
    def time_s(self) -> float:
        """Time of the newest step."""
        return self.nav.t_us * 1e-6 if self.nav is not None else 0.0

    def look_at_truth(self) -> None:
        """Reads the rows of truth.csv that are new; sets the newest pose error."""
        try:
            with self._truth_path.open(encoding="utf-8") as file:
                file.seek(self._truth_offset)
                text = self._truth_rest + file.read()
                self._truth_offset = file.tell()
        except OSError:
            return
        *lines, self._truth_rest = text.split("\n")
        for line in lines:
            cells = line.split(",")
            if not self._truth_head:
                self._truth_head = [c.strip() for c in cells]
                continue
            row = dict(zip(self._truth_head, cells))
            try:
                t_us = round(float(row["t_s"]) * 1e6)
                x_m, y_m = float(row["x_m"]), float(row["y_m"])
            except (KeyError, ValueError):
                continue
            pose = self._poses.get(t_us)
            if pose is not None:
                x, y = self._start.to_world(*pose)
                self.error_m = math.hypot(x - x_m, y - y_m)
        if self.nav is not None:
            oldest = self.nav.t_us - 10_000_000
            for t_us in [t for t in self._poses if t < oldest]:
                del self._poses[t_us]

    def line(self) -> str:
        """The progress line."""
        if self.nav is None:
            return "waiting for the first step"
        self.look_at_truth()
        error = "-" if self.error_m is None else f"{100.0 * self.error_m:.1f} cm"
        state = report.STATES[self.nav.state] if 0 <= self.nav.state < len(report.STATES) else str(self.nav.state)
        return (f"{self.time_s:7.1f} s  explored {100.0 * self.explored:5.1f} %  pose error {error:>8}  "
                f"floor {self.nav.floor}  {state}")


class Flight:
    """One flight from its settings to its report."""

    def __init__(self, settings: FlightSettings, world, quiet: bool = False):
        self.settings = settings
        self.world = world
        self.progress = Progress(quiet)
        self.folder = Path()
        self.locks: list[PortLock] = []
        self.children: list[Child] = []
        self.interrupted = False
        self.died: str | None = None
        self.last_text: str | None = None

    def _port(self) -> int:
        lock = PortLock.take_any()
        self.locks.append(lock)
        return lock.port

    def _start_child(self, name: str, command: list, environment=None) -> Child:
        child = Child(name, [str(c) for c in command], self.folder / "log" / f"{name}.txt", environment)
        self.children.append(child)
        return child

    def _start_recorder(self, name: str, url: str, file: str, channels: str) -> None:
        """A recorder that is at work when this returns, so that the log begins with the first message."""
        recorder = self._start_child(name, [sys.executable, "-m", "noctule.recorder", url, self.folder / file,
                                            "--channels", channels])
        deadline = time.monotonic() + RECORDER_WAIT_S
        while recorder.running and not recorder.last_line() and time.monotonic() < deadline:
            time.sleep(0.02)

    def run(self) -> dict:
        """Flies and returns the report.

        Raises:
            InputError: something that the user must put right; nothing was flown.
            RecordError: the flight left nothing to report on.
        """
        problem = multicast_problem()
        if problem:
            raise InputError(problem)
        programs = {name: need_program(name) for name in ("noctule-bridge", "noctule-nav")}
        camera = self.settings.camera
        if camera:
            problem = camera_problem()
            if problem:
                self.progress.say(f"camera off: {problem}")
                camera = False
        self.folder = run_folder(self.settings, self.world.name)
        self._write_inputs(camera)
        self.progress.say(f"{self.world.name}, seed {self.settings.seed}: {self.folder}")
        previous = signal.signal(signal.SIGINT, self._on_interrupt)
        previous_term = signal.signal(signal.SIGTERM, self._on_interrupt)
        begin = time.monotonic()
        station = None
        try:
            ground_port = self._port()
            station = GroundStation(ground_port, self.folder / "flight.tlog")
            begin = self._fly(station, ground_port, camera, programs) or begin
        finally:
            wall_time_s = time.monotonic() - begin
            self._end()
            if station is not None:
                station.receive()
                station.close()
            for lock in self.locks:
                lock.release()
            self._write_settings(camera, wall_time_s)
            signal.signal(signal.SIGINT, previous)
            signal.signal(signal.SIGTERM, previous_term)
        return report.write(self.folder)

    def _on_interrupt(self, *_):
        self.interrupted = True

    def _write_inputs(self, camera: bool) -> None:
        from noctule_sim.world import dump_world

        (self.folder / "parameters.toml").write_text(parameters_toml(parameter_values(self.settings)), encoding="utf-8")
        dump_world(self.world, self.folder / "world.yaml")
        self._write_settings(camera, 0.0)

    def _write_settings(self, camera: bool, wall_time_s: float) -> None:
        s = self.settings
        content = {"world": self.world.name, "seed": s.seed, "profile": s.profile, "preset": s.preset, "policy_class": s.policy_class,
                   "autopilot": s.autopilot, "real_autopilot": s.real, "parameters": s.parameters, "faults": s.faults, "camera": camera,
                   "realtime": s.realtime, "max_time_s": s.max_time_s, "wall_time_s": wall_time_s,
                   "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
                   "interrupted": self.interrupted, "died": self.died, "last_text": self.last_text}
        (self.folder / "run.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")

    def _fly(self, station: GroundStation, ground_port: int, camera: bool, programs: dict) -> float | None:
        """Starts everything and follows the flight to its end; returns the wall time of the simulator's start."""
        url, camera_url = lcm_url(self._port()), lcm_url(self._port())
        autopilot_port = self._port()
        parameters = self.folder / "parameters.toml"
        follower = Follower(url, self.world, self.folder / "truth.csv")
        self._start_recorder("recorder", url, "flight.lcm", ".*")
        bridge = ["--parameters", parameters, "--autopilot", f"udpin:127.0.0.1:{autopilot_port}",
                  "--ground", f"udpout:127.0.0.1:{ground_port}", "--lcm-url", url]
        bridge += ["--camera-url", camera_url] if camera else []
        watchers = PortLock.folder() / f"{GROUND_PORT}.claim"
        if self._claim_watchers(watchers):
            bridge += ["--ground", f"udpout:127.0.0.1:{GROUND_PORT}"]
        nav_more = self._start_policy(url, parameters) + (["--camera-url", camera_url] if camera else [])
        counter = build_folder() / "lib" / "libnoctule_heap_count.so"
        counted = {"LD_PRELOAD": str(counter)} if counter.is_file() else None
        self._start_child("noctule-bridge", [programs["noctule-bridge"], *bridge, "--stats", self.folder / "log" / "bridge-stats.json"], counted)
        self._start_child("noctule-nav", [programs["noctule-nav"], "--parameters", parameters, "--lcm-url", url,
                                          "--stats", self.folder / "log" / "nav-stats.json", "--atlas", self.folder / "atlas", *nav_more],
                          counted)
        if camera:
            from noctule_sim.camera import write_calibration

            write_calibration(self.folder / "camera.yaml")
            for name in ("objects.db", "objects.db-wal", "objects.db-shm"):
                (self.folder / name).unlink(missing_ok=True)     # a run directory that is flown into again
            self._start_child("noctule-vision", [find_program("noctule-vision"), "--parameters", parameters,
                                                 "--lcm-url", camera_url, "--stats", self.folder / "log" / "vision-stats.json",
                                                 "--flight-lcm-url", url, "--calibration", self.folder / "camera.yaml",
                                                 "--database", self.folder / "objects.db"])
            if self.settings.video:
                self._start_child("noctule-video", [need_program("noctule-video"), "--lcm-url", camera_url, "--to", self.settings.video,
                                                    "--stats", self.folder / "log" / "video-stats.json"])
            channels = "IMAGE|OBJECTS" if self.settings.log_images else "OBJECTS"
            self._start_recorder("recorder-camera", camera_url, "camera.lcm", channels)
        if not self._order_start(station):
            return None
        begin = time.monotonic()
        sim = self._start_child("noctule-sim", self._sim_command(autopilot_port, url, camera_url, camera),
                                {"MUJOCO_GL": "egl"})
        self._follow(station, follower, sim)
        return begin

    def _start_policy(self, url: str, parameters: Path) -> list:
        """The process of a policy in Python, where one was asked for; what noctule-nav must be told of it."""
        if not self.settings.policy_class:
            return []
        child = self._start_child("policy", [sys.executable, "-u", "-m", "noctule.policy_host", self.settings.policy_class, "--parameters", parameters, "--lcm-url", url])
        deadline = time.monotonic() + POLICY_WAIT_S
        while child.running and READY not in child.last_line():
            if time.monotonic() > deadline:
                raise InputError(f"--policy {self.settings.policy_class}: not ready after {POLICY_WAIT_S:g} s ({child.log})")
            time.sleep(0.02)
        if not child.running:
            raise InputError(f"--policy {self.settings.policy_class}: {child.last_line()}")
        return [] if self.settings.realtime else ["--policy-wait-ms", round(1000 * WAIT_S)]

    def _claim_watchers(self, path: Path) -> bool:
        # Only one flight at a time shows itself to the ground stations of the machine.
        import fcntl

        try:
            file = open(path, "a")
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        self.locks.append(PortLock(GROUND_PORT, file))
        return True

    def _sim_command(self, autopilot_port: int, url: str, camera_url: str, camera: bool) -> list:
        s = self.settings
        command = [sys.executable, "-m", "noctule_sim", self.folder / "world.yaml", "--seed", s.seed, "--profile",
                   s.profile, "--out", self.folder, "--autopilot-port", autopilot_port, "--lcm-url", url,
                   "--camera-lcm-url", camera_url, "--max-time", f"{s.max_time_s:g}", "--autopilot-flavour", s.autopilot]
        if s.real:
            command += ["--autopilot", s.real]
            command += ["--autopilot-binary", s.autopilot_binary] if s.autopilot_binary else []
            command += ["--connect", s.connect] if s.connect else []
        command += [] if camera else ["--no-camera"]
        command += ["--realtime"] if s.realtime else []
        for fault in s.faults:
            command += ["--fault", fault]
        changed = {k: v for k, v in parameter_values(s).items()}
        from noctule import params_gen

        for name, value in changed.items():
            if value != params_gen.DEFAULTS[name]:
                command += ["--param", f"{name}={value!r}"]
        return command

    def _order_start(self, station: GroundStation) -> bool:
        """Hands the start to the bridge before simulated time runs; False if that was interrupted or a process died.

        The bridge holds it back until its time on the autopilot's clock, so that the start is the same in every run
        (docs/decisions/0002-start-gate.md).
        """
        deadline = time.monotonic() + BRIDGE_WAIT_S
        while not station.start_pending and time.monotonic() < deadline:
            if self.interrupted or self._report_dead():
                return False
            select.select([station.socket], [], [], 0.05)
            station.receive()
            station.tick()
            station.start_mission(REAL_START_S if self.settings.real else START_S)
        if not station.start_pending:
            self.died = "noctule-bridge did not take the start"
            self.progress.say(f"{self.died} within {BRIDGE_WAIT_S:g} s, see log/noctule-bridge.txt")
            return False
        return True

    def _report_dead(self) -> bool:
        """Tells once of each child that has died; True if one has that the flight cannot do without."""
        dead = False
        for child in self.children:
            if child.name == "noctule-sim" or child.running:
                continue
            ours = child.name not in ("policy", "noctule-video")      # the flight goes on without those
            dead = dead or ours
            if not child.told:
                child.told = True
                line = child.last_line()
                if ours:
                    self.died = self.died or f"{child.name} ended with {child.how_it_ended()}" + (f": {line}" if line else "")
                self.progress.say(f"{child.name} ended with {child.how_it_ended()}" + (f": {line}" if line else "")
                                  + f" (log/{child.log.name})")
        return dead

    def _follow(self, station: GroundStation, follower: Follower, sim: Child) -> None:
        landed_since = None
        dead_since = None
        while sim.running and not self.interrupted:
            select.select([station.socket, follower], [], [], 0.05)
            station.receive()
            station.tick()
            follower.receive()
            for _, text in station.texts:
                self.last_text = text
                self.progress.say(f"{follower.time_s:7.1f} s  {text}")
            station.texts.clear()
            self.progress.show(follower.line)
            now = time.monotonic()
            if self._report_dead():
                dead_since = dead_since or now
                if now - dead_since > SILENCE_S:
                    break
            patience_s = FIRST_STEP_S if follower.nav is None and dead_since is None else SILENCE_S
            if now - max(follower.step_wall_s, dead_since or 0.0) > patience_s:
                self.died = self.died or f"no step for {patience_s:g} s of wall time"
                self.progress.say(f"no step for {patience_s:g} s, giving up")
                break
            if not station.was_armed and follower.time_s > NOT_STARTED_S:
                self.progress.say(f"not armed after {NOT_STARTED_S:g} s, giving up")
                break
            if station.was_armed and not station.armed:
                landed_since = landed_since or now
                if now - landed_since > AFTER_LANDING_S:
                    break
            else:
                landed_since = None
        if not sim.running and sim.process.returncode == 2:
            raise InputError(sim.last_line() or "the simulator refused its input")
        if not sim.running and sim.process.returncode != 0 and not self.interrupted:
            line = sim.last_line()
            self.died = f"noctule-sim ended with {sim.how_it_ended()}" + (f": {line}" if line else "")
            self.progress.say(f"{self.died} (log/{sim.log.name})")

    def _end(self) -> None:
        """Ends the simulator first, so that the log is complete, then the others, the recorders last."""
        if self.interrupted:
            self.progress.say("stopping")
        order = (("noctule-sim",), ("noctule-nav", "noctule-vision", "noctule-video"), ("noctule-bridge", "policy"),
                 ("recorder", "recorder-camera"))
        forced = []
        for names in order:
            group = [c for c in self.children if c.name in names]
            if names[0] == "recorder" and group:
                time.sleep(0.3)                  # what was sent last is still on its way into the log
            forced += end_all(group, 10.0 if names[0] == "noctule-sim" else 5.0)
        if forced:
            self.progress.say(f"had to be killed: {', '.join(forced)}")


def summary(result: dict) -> str:
    """The end of a flight in a few lines."""
    floor = result["floors"][0]
    mean = result["pose_error_m"]["mean"]
    altitude = result["altitude_error_m"]["mean"]
    lines = [f"{result['outcome'].replace('_', ' ')}: {result['reason']}",
             f"explored {100.0 * floor['explored_fraction']:.1f} % of {floor['explorable_area_m2']:.0f} m2 in "
             f"{result['sim_time_s']:.0f} s simulated, {result['wall_time_s']:.0f} s of wall time"
             + (f" ({result['realtime_factor']:.1f} times real time)" if result["realtime_factor"] else ""),
             f"collisions {result['collisions']}, pose error mean "
             + ("-" if mean is None else f"{100.0 * mean:.1f} cm") + ", altitude error mean "
             + ("-" if altitude is None else f"{100.0 * altitude:.1f} cm") + f", path {result['path_length_m']:.0f} m"]
    if result.get("objects_missed") is not None:
        errors = [o["error_m"] for o in result["objects"] if o["error_m"] is not None]
        lines.append(f"objects {len(result['objects'])}: missed {result['objects_missed']}, duplicated {result['objects_duplicated']}, "
                     f"false {result['objects_false']}" + (f", position error mean {100.0 * sum(errors) / len(errors):.0f} cm" if errors else ""))
    if result["lockstep_broken"]:
        lines.append("lockstep was broken: this flight is not reproducible")
    return "\n".join(lines)


def exit_code(result: dict) -> int:
    """0 completed without a collision, 130 interrupted, else 1."""
    if result["outcome"] == "interrupted":
        return 130
    return 0 if result["outcome"] == "completed" and result["collisions"] == 0 else 1


def need_autopilot(settings: FlightSettings) -> None:
    """Sees to it that the real autopilot that is asked for can be started.

    Raises:
        SkippedFlight: its program is not there. InputError: it was named wrongly; one line.
    """
    from noctule_sim import sitl

    if settings.real is None:
        if settings.connect or settings.autopilot_binary:
            raise InputError("--connect and --autopilot-binary go with --autopilot ardupilot or px4")
        return
    try:
        if settings.connect:
            sitl.parse_connect(settings.connect)
        elif sitl.find(settings.real, settings.autopilot_binary) is None:
            raise SkippedFlight(sitl.skipped_line(settings.real))
    except ValueError as error:
        raise InputError(str(error)) from None


def fly(settings: FlightSettings, quiet: bool = False) -> dict:
    """Flies the settings and returns the report.

    Raises:
        InputError: bad input; one line.
        RecordError: the flight left nothing to report on.
    """
    from noctule_sim.world import WorldError, load_world

    need_autopilot(settings)
    radius = parameter_values(settings)["hull_radius_m"]
    try:
        world = load_world(settings.world, radius)
    except WorldError as error:
        raise InputError(str(error)) from None
    return Flight(settings, world, quiet).run()
