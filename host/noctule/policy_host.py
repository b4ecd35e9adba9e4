"""The process of a Python policy: GRID_TILE and POLICY_ASK in, one POLICY_GOAL for each request out.

`python -m noctule.policy_host package.module:Class --parameters FILE --lcm-url URL` beside noctule-nav; with --pipe the same
over stdin and stdout, for flights in the process (Peer is their end of it). Whatever the policy does, it harms only
itself: what it throws is answered with FAILED, what it answers is judged by the firmware.
"""

from __future__ import annotations

import argparse
import importlib
import math
import os
import select
import signal
import struct
import subprocess
import sys
import time
import tomllib
import traceback
from pathlib import Path

from noctule import record
from noctule.policy import ARRIVED_M, FATES, FINISHED, Goal, MapView, Pose
from noctule.settings import InputError

READY = "policy ready"
WAIT_S = 1.5               # wall time that a flight in lockstep waits for an answer
MAX_UNSENT = 1 << 26
MAX_TRACES = 20            # of a policy that throws again and again
_HEAD = struct.Struct(">ii")


def load(name: str):
    """The class of `package.module:Class`; the working directory counts as a place to import from.

    Raises:
        InputError: there is none; one line.
    """
    module_name, _, class_name = name.partition(":")
    if not module_name or not class_name:
        raise InputError(f"--policy {name}: tour, frontier, paper, or package.module:Class")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found = getattr(importlib.import_module(module_name), class_name, None)
    except Exception as error:        # whatever the module does on import
        raise InputError(f"--policy {name}: {module_name} cannot be imported ({type(error).__name__}: {error})") from None
    if not callable(getattr(found, "step", None)):
        raise InputError(f"--policy {name}: {module_name} has no class {class_name} with a method step")
    return found


class Host:
    """Keeps the view, asks the policy, and writes its answers down.

    Args:
        make: makes the policy; called before the first exploration.
        parameters: of the flight.
    """

    def __init__(self, make, parameters: dict[str, float]):
        self._make = make
        self._policy = None
        self._exploration = -1
        self._view = MapView(parameters)
        self._ask_type, self._goal_type = record.message_type("policy_ask_t"), record.message_type("policy_goal_t")
        self._seq = -1
        self._came_s = 0.0
        self.traces = 0
        self._view.frontiers()           # what is compiled or imported late is so before the flight, not in it
        _ = self._view.way_m

    def receive(self, channel: str, data: bytes) -> bytes | None:
        """One message in; the answer, where it was a request."""
        if channel == "GRID_TILE":
            tile = record.decode_tile(data)
            self._view.put(tile.floor, tile.tile_x, tile.tile_y, tile.log_odds)
            return None
        return self._answer(self._ask_type.decode(data)) if channel == "POLICY_ASK" else None

    def _answer(self, ask) -> bytes:
        goal = self._goal_type()
        self._seq += 1
        goal.t_us, goal.seq, goal.ask = ask.t_us, self._seq, ask.seq
        try:
            self._fill(goal, ask)
            return goal.encode()
        except (Exception, SystemExit):  # the policy's own fault, whatever it is
            self.traces += 1
            if self.traces <= MAX_TRACES:
                traceback.print_exc()
            goal.kind = goal.FAILED
            goal.x_m = goal.y_m = goal.look_x_m = goal.look_y_m = 0.0
            return goal.encode()

    def _fill(self, goal, ask) -> None:
        view = self._view
        view.enter(ask.floor)
        view.t_s, view.known_area_m2 = ask.t_us * 1e-6, ask.known_area_m2
        view.goal = (ask.goal_x_m, ask.goal_y_m) if ask.goal_valid else None
        view.home = Pose(ask.home_x_m, ask.home_y_m)
        if view.goal is None or math.hypot(view.goal[0] - ask.x_m, view.goal[1] - ask.y_m) > ARRIVED_M:
            self._came_s = view.t_s
        view.at_goal_s = view.t_s - self._came_s
        view.moved(Pose(ask.from_x_m, ask.from_y_m))
        view.fate = FATES[ask.fate]
        pose = Pose(ask.x_m, ask.y_m, ask.yaw_rad)
        if self._policy is None:
            self._policy = self._make()
        if ask.exploration != self._exploration:
            self._exploration = ask.exploration
            if hasattr(self._policy, "begin"):
                self._policy.begin(view.home)
        told = self._policy.step(view, pose, ask.budget_cells)
        if told is None:
            goal.kind = goal.NOTHING
        elif told is FINISHED:
            goal.kind = goal.FINISHED
        elif isinstance(told, Goal):
            goal.kind = goal.GOAL
            goal.x_m, goal.y_m = float(told.x_m), float(told.y_m)
            goal.look_x_m, goal.look_y_m = told.look_at(pose)
        else:
            raise TypeError(f"step() answered {told!r}; a Goal, None or FINISHED is wanted")


class Peer:
    """A policy's process, seen from a flight in the process.

    Args:
        name: package.module:Class.
        parameters: parameters.toml of the flight.
        log: file that takes what the policy prints.

    Raises:
        InputError: it cannot be loaded; one line.
    """

    def __init__(self, name: str, parameters: Path, log: Path):
        load(name)
        self._log = log.open("wb")
        self._process = subprocess.Popen([sys.executable, "-m", "noctule.policy_host", name, "--parameters", str(parameters), "--pipe"],
                                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log)
        os.set_blocking(self._process.stdin.fileno(), False)
        self._asked = self._answered = 0
        self._buffer, self._unsent = b"", bytearray()
        self.waits_over = 0
        self._take(60.0)                 # its first word, when it is ready

    def send(self, channel: str, data: bytes) -> None:
        """One message to it. One that does not read is not waited for: what it has not taken up is kept, up to MAX_UNSENT bytes."""
        if channel == "POLICY_ASK":
            self._asked += 1
        if len(self._unsent) < MAX_UNSENT:
            self._unsent += _HEAD.pack(len(channel), len(data)) + channel.encode() + data
        self._push()

    def _push(self) -> None:
        while self._unsent:
            try:
                del self._unsent[:os.write(self._process.stdin.fileno(), self._unsent)]
            except BlockingIOError:
                return
            except OSError:              # it died; the firmware counts the silence
                self._unsent.clear()

    def answers(self) -> list[bytes]:
        """What has come; waits for the newest request once, for up to WAIT_S, unless an older one was left unanswered before."""
        out = []
        behind = self._asked - self._answered > 1
        deadline = time.monotonic() + (0.0 if behind else WAIT_S)
        while self._asked > self._answered:
            data = self._take(max(deadline - time.monotonic(), 0.0))
            if data is None:
                self.waits_over += 0 if behind else 1
                break
            self._answered += 1
            out.append(data)
        return out

    def _take(self, timeout_s: float) -> bytes | None:
        deadline = time.monotonic() + timeout_s
        pipe = self._process.stdout.fileno()
        while True:
            if len(self._buffer) >= 4:
                size = int.from_bytes(self._buffer[:4], "big")
                if len(self._buffer) >= 4 + size:
                    data, self._buffer = self._buffer[4:4 + size], self._buffer[4 + size:]
                    return data
            readable, writable, _ = select.select([pipe], [self._process.stdin.fileno()] if self._unsent else [], [], max(deadline - time.monotonic(), 0.0))
            if writable:
                self._push()
            elif not readable:
                return None
            if not readable:
                continue
            more = os.read(pipe, 65536)
            if not more:
                return None
            self._buffer += more

    def close(self) -> None:
        """Ends the process."""
        self._process.kill()
        self._process.wait()
        for file in (self._process.stdin, self._process.stdout, self._log):
            try:
                file.close()
            except OSError:
                pass


def _serve_pipe(host: Host) -> None:
    out, in_ = os.dup(1), sys.stdin.buffer
    os.dup2(2, 1)                        # what the policy prints goes to its log

    def write(data: bytes) -> None:
        os.write(out, len(data).to_bytes(4, "big") + data)

    write(READY.encode())
    while len(head := in_.read(_HEAD.size)) == _HEAD.size:
        name_size, size = _HEAD.unpack(head)
        answer = host.receive(in_.read(name_size).decode(), in_.read(size))
        if answer is not None:
            write(answer)


def _serve_lcm(host: Host, url: str) -> None:
    import lcm

    bus = lcm.LCM(url)

    def take(channel: str, data: bytes) -> None:
        answer = host.receive(channel, data)
        if answer is not None:
            bus.publish("POLICY_GOAL", answer)

    bus.subscribe("GRID_TILE|POLICY_ASK", take).set_queue_capacity(0)      # 0: no limit; in order
    print(READY, flush=True)
    while True:
        try:
            bus.handle()
        except OSError:                  # a signal came while it waited
            return


def main(arguments=None) -> int:
    """Serves until it is ended."""
    parser = argparse.ArgumentParser(prog="noctule.policy_host", description="Runs a Python policy beside noctule-nav.")
    parser.add_argument("policy", metavar="package.module:Class")
    parser.add_argument("--parameters", type=Path, required=True, metavar="FILE", help="parameters.toml of the flight")
    parser.add_argument("--lcm-url", metavar="URL", help="LCM bus of the flight")
    parser.add_argument("--pipe", action="store_true", help="messages over stdin and stdout instead")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        host = Host(load(options.policy), tomllib.loads(options.parameters.read_text(encoding="utf-8")))
    except InputError as error:
        print(f"noctule: {error}", file=sys.stderr)
        return 2
    try:
        _serve_pipe(host) if options.pipe else _serve_lcm(host, options.lcm_url)
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
