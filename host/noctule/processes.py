"""Ports under a lock, and children that never outlive the flight."""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

from noctule.settings import InputError

PORT_FIRST, PORT_LAST = 20000, 29999
PR_SET_PDEATHSIG = 1


class PortLock:
    """A UDP port of one's own: a lock file a port, held until released. Two runs on one port would leak into each other."""

    def __init__(self, port: int, file):
        self.port = port
        self._file = file

    @staticmethod
    def folder() -> Path:
        """Where the lock files lie: one folder for all users of the machine."""
        return Path(tempfile.gettempdir()) / "noctule-ports"

    @classmethod
    def take(cls, port: int) -> "PortLock | None":
        """That port, or None if another run or another program has it."""
        folder = cls.folder()
        folder.mkdir(exist_ok=True, mode=0o777)
        try:
            file = open(folder / f"{port}.lock", "a")
        except OSError:
            return None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            return None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                file.close()
                return None
        return cls(port, file)

    @classmethod
    def take_any(cls) -> "PortLock":
        """Some free port.

        Raises:
            InputError: none is free.
        """
        span = PORT_LAST - PORT_FIRST + 1
        begin = (os.getpid() * 7) % span
        for n in range(span):
            lock = cls.take(PORT_FIRST + (begin + n) % span)
            if lock is not None:
                return lock
        raise InputError(f"no free UDP port in {PORT_FIRST} to {PORT_LAST}")

    def release(self) -> None:
        """Gives the port back."""
        self._file.close()


def lcm_url(port: int) -> str:
    """The bus of one run: loopback only (ttl 0), a receive buffer that holds images."""
    return f"udpm://239.255.76.67:{port}?ttl=0&recv_buf_size=2097152"


def multicast_problem() -> str | None:
    """One line on what to do where LCM has no route for its multicast, else None."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("239.255.76.67", 7667))
        except OSError:
            return "no route for LCM's multicast; run: ip route add 224.0.0.0/4 dev lo (as root)"
    return None


def build_folder() -> Path:
    """Where the built programs are: $NOCTULE_BUILD, else build/release of the checkout."""
    named = os.environ.get("NOCTULE_BUILD")
    return Path(named) if named else Path(__file__).resolve().parents[2] / "build" / "release"


def find_program(name: str) -> Path | None:
    """A built program, or None."""
    path = build_folder() / "bin" / name
    return path if os.access(path, os.X_OK) else None


def need_program(name: str) -> Path:
    """A built program.

    Raises:
        InputError: it has not been built.
    """
    path = find_program(name)
    if path is None:
        raise InputError(f"{name} is not built ({build_folder() / 'bin'}); run: make build")
    return path


def _die_with_parent(parent: int):
    libc = ctypes.CDLL(None, use_errno=True)

    def before_exec():
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
        if os.getppid() != parent:       # the parent died before the wish was made
            os._exit(1)

    return before_exec


class Child:
    """One process of a flight in a session of its own, its output in a file."""

    def __init__(self, name: str, command: list[str], log: Path, environment: dict[str, str] | None = None):
        self.name = name
        self.log = log
        self.told = False            # its end has been reported
        self._output = open(log, "wb")
        self.process = subprocess.Popen(
            [str(c) for c in command], stdin=subprocess.DEVNULL, stdout=self._output, stderr=subprocess.STDOUT,
            start_new_session=True, preexec_fn=_die_with_parent(os.getpid()), env={**os.environ, **(environment or {})})

    @property
    def running(self) -> bool:
        """Whether it still runs."""
        return self.process.poll() is None

    def last_line(self) -> str:
        """The last line that it wrote, or ''."""
        try:
            lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:
            return ""
        return lines[-1].strip() if lines else ""

    def how_it_ended(self) -> str:
        """'exit code 3' or 'signal SIGSEGV'."""
        code = self.process.poll()
        if code is not None and code < 0:
            try:
                return f"signal {signal.Signals(-code).name}"
            except ValueError:
                return f"signal {-code}"
        return f"exit code {code}"

    def ask_to_end(self, number: int = signal.SIGINT) -> None:
        """Sends a signal to its whole session; none if it has ended."""
        if self.running:
            try:
                os.killpg(self.process.pid, number)
            except ProcessLookupError:
                pass

    def wait(self, seconds: float) -> bool:
        """Whether it ended within that time."""
        try:
            self.process.wait(seconds)
            return True
        except subprocess.TimeoutExpired:
            return False

    def close(self) -> None:
        """Closes its log file."""
        self._output.close()


def end_all(children: list[Child], patience_s: float = 5.0) -> list[str]:
    """Ends children politely, then by force; returns the names of those that needed force."""
    forced: list[str] = []
    for number, seconds in ((signal.SIGINT, patience_s), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0)):
        left = [c for c in children if c.running]
        if number == signal.SIGKILL:
            forced = [c.name for c in left]
        for child in left:
            child.ask_to_end(number)
        deadline = time.monotonic() + seconds
        for child in left:
            child.wait(max(0.0, deadline - time.monotonic()))
    for child in children:
        child.close()
    return forced
