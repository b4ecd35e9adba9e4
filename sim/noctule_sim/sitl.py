"""The user's own software-in-the-loop programs: finding them, starting them with our parameters, ending them.

Nothing of either autopilot comes with Noctule. Where no program is found the caller says `skipped_line(kind)`.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

PROGRAM = {"ardupilot": "arducopter", "px4": "px4"}
VARIABLE = {"ardupilot": "NOCTULE_ARDUCOPTER", "px4": "NOCTULE_PX4"}
PARAMETERS = {"ardupilot": "ardupilot.parm", "px4": "px4.params"}
PATIENCE_S = 1.0              # between SIGTERM and SIGKILL: ArduCopter ignores the first while it waits for the physics
PX4_INSTANCES = range(0, 9)   # its tenth and later instances all send to one port
ARDUPILOT_INSTANCES = range(0, 40)


def skipped_line(kind: str) -> str:
    """What is said where the program is missing.

    >>> skipped_line("ardupilot")
    'skipped: no arducopter found (--autopilot-binary PATH or NOCTULE_ARDUCOPTER names it)'
    """
    return f"skipped: no {PROGRAM[kind]} found (--autopilot-binary PATH or {VARIABLE[kind]} names it)"


def find(kind: str, named: Path | None = None) -> Path | None:
    """The program: as named, else by its environment variable, else on PATH. None: there is none.

    Raises:
        ValueError: it was named and is not a program; one line.
    """
    for source, text in (("--autopilot-binary", named), (VARIABLE[kind], os.environ.get(VARIABLE[kind]))):
        if text:
            path = Path(text).expanduser()
            if not (path.is_file() and os.access(path, os.X_OK)):
                raise ValueError(f"{source} {text}: no such program")
            return path.resolve()
    found = shutil.which(PROGRAM[kind])
    return Path(found).resolve() if found else None


def parameter_file(kind: str) -> Path:
    """The shipped parameters of one autopilot."""
    return Path(__file__).parent / "autopilots" / PARAMETERS[kind]


def read_parameters(path: Path) -> dict[str, float]:
    """NAME VALUE of each line; `#` begins the reason.

    Raises:
        ValueError: a line that is neither; it is named.
    """
    out: dict[str, float] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        match = re.fullmatch(r"([A-Z][A-Z0-9_]{1,15})\s+(-?\d+(?:\.\d+)?)", text)
        if match is None:
            raise ValueError(f"{path.name}, line {number}: NAME VALUE is wanted, not '{text}'")
        if match[1] in out:
            raise ValueError(f"{path.name}, line {number}: {match[1]} is there twice")
        out[match[1]] = float(match[2])
    return out


class Instance:
    """An instance number of one's own: the programs derive their ports from it. Held until released."""

    def __init__(self, kind: str):
        """Take the first that is free.

        Raises:
            OSError: none is.
        """
        import fcntl

        folder = Path(tempfile.gettempdir()) / "noctule-ports"
        folder.mkdir(exist_ok=True, mode=0o777)
        for number in PX4_INSTANCES if kind == "px4" else ARDUPILOT_INSTANCES:
            try:
                file = open(folder / f"{kind}-{number}.lock", "a")
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            if all(_free(kind_, port) for kind_, port in ports(kind, number)):
                self.number, self._file = number, file
                return
            file.close()
        raise OSError(f"all instances of {PROGRAM[kind]} are taken")

    def release(self) -> None:
        """Give it back."""
        self._file.close()


def ports(kind: str, instance: int) -> tuple[tuple[int, int], ...]:
    """Socket type and number of the ports on our side: physics, then MAVLink."""
    if kind == "px4":
        return (socket.SOCK_STREAM, 4560 + instance), (socket.SOCK_DGRAM, 14540 + instance)
    return (socket.SOCK_DGRAM, 9002 + 10 * instance), (socket.SOCK_DGRAM, 15550 + 10 * instance)


def _free(kind: int, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind == socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def command(kind: str, binary: Path, instance: int, folder: Path) -> tuple[list[str], dict[str, str]]:
    """Command line and added environment of a program that works in `folder`.

    Raises:
        ValueError: the parameter file is not right, or PX4's own files are not where they belong; one line.
    """
    parameters = read_parameters(parameter_file(kind))
    (_, physics), (_, mavlink) = ports(kind, instance)
    if kind == "ardupilot":
        defaults = folder / "defaults.parm"
        defaults.write_text("".join(f"{name} {value:.9g}\n" for name, value in parameters.items()), encoding="ascii")
        return [str(binary), "--model", "JSON:127.0.0.1", "--rate", "800", "--wipe", "--instance", str(instance),
                "--defaults", str(defaults), "--serial0", f"udpclient:127.0.0.1:{mavlink}",
                "--sim-port-out", str(physics), "--home", "47.397742,8.545594,488.0,0"], {}
    etc = binary.parent.parent / "etc"
    if not (etc / "init.d-posix" / "rcS").is_file():
        raise ValueError(f"{binary}: no etc/init.d-posix/rcS beside it; name the program inside its build folder (bin/px4)")
    environment = {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in parameters.items()}
    environment["PX4_SIM_MODEL"] = "none_iris"
    return [str(binary), "-d", "-i", str(instance), "-w", str(folder), "-s", str(etc / "init.d-posix" / "rcS"), str(etc)], environment


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)


class Program:
    """One run of an autopilot's program.

    Args:
        kind: 'ardupilot' or 'px4'.
        binary: from `find`.
        folder: where it works and leaves its files; made.

    Attributes: instance; log, its output.

    Raises:
        OSError, ValueError: it cannot be started; one line.
    """

    def __init__(self, kind: str, binary: Path, folder: Path):
        folder = folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        self.kind = kind
        self.instance = Instance(kind)
        self.log = folder / "console.txt"
        self._folder = folder
        self._process: subprocess.Popen | None = None
        try:
            self._command, self._environment = command(kind, binary, self.instance.number, folder)
        except ValueError:
            self.instance.release()
            raise

    def start(self) -> None:
        """Start it; after our side has bound its ports."""
        with open(self.log, "wb") as output:
            self._process = subprocess.Popen(
                self._command, cwd=self._folder, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
                preexec_fn=_die_with_parent, env={**os.environ, **self._environment})

    def problem(self) -> str | None:
        """A line when it has ended by itself, else None."""
        if self._process is None or self._process.poll() is None:
            return None
        code = self._process.returncode
        lines = [line for line in self.log.read_text(errors="replace").splitlines() if line.strip()] if self.log.is_file() else []
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"{PROGRAM[self.kind]} ended with {how}" + (f": {lines[-1].strip()[:120]}" if lines else "")

    def end(self) -> None:
        """End it: SIGTERM, and SIGKILL where that is ignored. Safe to call again."""
        process, self._process = self._process, None
        if process is not None:
            for number in (signal.SIGTERM, signal.SIGKILL):
                try:
                    os.killpg(process.pid, number)
                except ProcessLookupError:
                    break
                deadline = time.monotonic() + PATIENCE_S
                while process.poll() is None and time.monotonic() < deadline:
                    time.sleep(0.02)
                if process.poll() is not None:
                    break
            process.wait()
            self.instance.release()


def parse_connect(text: str) -> tuple[str, str, int]:
    """udpin:HOST:PORT or tcp:HOST:PORT.

    Raises:
        ValueError: it is neither; one line.

    >>> parse_connect("udpin:127.0.0.1:14550")
    ('udpin', '127.0.0.1', 14550)
    """
    match = re.fullmatch(r"(udpin|tcp):([A-Za-z0-9.-]+):(\d{1,5})", text)
    if match is None or not 0 < int(match[3]) < 65536:
        raise ValueError(f"--connect {text}: udpin:HOST:PORT or tcp:HOST:PORT is wanted")
    return match[1], match[2], int(match[3])
