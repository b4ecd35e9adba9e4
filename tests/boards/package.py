"""Installs the Debian package in a fresh bookworm, flies it against the simulator, removes it: package.py PACKAGE.deb (as root).

Nothing of the package may be left behind after a purge. systemd does not run in there: each unit's ExecStart is taken from
the installed file, with its EnvironmentFile, and started as its user; `systemd-analyze verify` reads the units.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from noctule.processes import PortLock, lcm_url, multicast_problem

FLIGHT_S = 8.0
# What any installation of other packages changes too.
FLEETING = re.compile(r"^(var/(lib/(dpkg|apt|systemd|ucf)|cache|log)|tmp|run|proc|sys|dev|etc/ld\.so\.cache|etc/(passwd|group|shadow|gshadow|subuid|subgid)-?$|root)(/|$)?")


class Root:
    """A folder with a Debian in it."""

    def __init__(self, folder: Path):
        self.folder = folder

    def run(self, *command: str, **how) -> subprocess.CompletedProcess:
        return subprocess.run(["chroot", str(self.folder), *command], check=True, capture_output=True, text=True,
                              env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C"}, **how)

    def files(self) -> set[str]:
        """Every path that is not fleeting."""
        found = set()
        for parent, folders, names in os.walk(self.folder):
            at = os.path.relpath(parent, self.folder)
            folders[:] = [f for f in folders if not FLEETING.match(os.path.normpath(os.path.join(at, f)))]
            found.update(os.path.normpath(os.path.join(at, n)) for n in folders + names)
        return {f for f in found if not FLEETING.match(f)}

    def accounts(self) -> set[str]:
        return {line for name in ("passwd", "group", "shadow", "gshadow") for line in (self.folder / "etc" / name).read_text().splitlines()}

    def unit_command(self, unit: str, settings: dict[str, str]) -> list[str]:
        """ExecStart as systemd would run it: ${A} is one word, $A is split into words."""
        text = (self.folder / "lib/systemd/system" / unit).read_text()
        user = re.search(r"^User=(.*)$", text, re.MULTILINE)[1]
        environment = {}
        for line in (self.folder / re.search(r"^EnvironmentFile=/(.*)$", text, re.MULTILINE)[1]).read_text().splitlines():
            if "=" in line and not line.startswith("#"):
                name, value = line.split("=", 1)
                environment[name] = value
        environment.update(settings)
        words = []
        for word in shlex.split(re.search(r"^ExecStart=(.*)$", text, re.MULTILINE)[1]):
            if re.fullmatch(r"\$\w+", word):
                words += environment[word[1:]].split()
            else:
                words.append(re.sub(r"\$\{(\w+)\}", lambda m: environment[m[1]], word))
        return ["chroot", str(self.folder), "setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", "--no-new-privs", *words]


def make(folder: Path, mirror: str) -> Root:
    """A minimal bookworm; kept as an archive in build/deps, so that a second run needs the network for the package's dependencies only."""
    kept = Path("build/deps/bookworm-minimal.tar")
    if not kept.exists():
        part = kept.with_name("part-" + kept.name)
        subprocess.run(["mmdebstrap", "--quiet", "--variant=minbase", "bookworm", str(part), f"deb {mirror} bookworm main"], check=True)
        part.rename(kept)
    folder.mkdir()
    subprocess.run(["tar", "-xf", str(kept), "-C", str(folder), "--exclude=./dev/*"], check=True)
    (folder / "dev/null").touch()
    for name in ("null", "zero", "random", "urandom"):
        path = folder / "dev" / name
        path.unlink(missing_ok=True)
        subprocess.run(["mknod", "-m", "666", str(path), "c", "1", {"null": "3", "zero": "5", "random": "8", "urandom": "9"}[name]], check=True)
    shutil.copy("/etc/resolv.conf", folder / "etc/resolv.conf")
    apt = folder / "etc/apt/apt.conf.d"
    for source in Path("/etc/apt/apt.conf.d").glob("*proxy*"):
        shutil.copy(source, apt / source.name)
    return Root(folder)


def fly(root: Root, work: Path) -> None:
    """The installed processes, as their units start them, against the simulator of this checkout."""
    autopilot, bus, ground = (PortLock.take_any() for _ in range(3))
    settings = {"LCM_URL": lcm_url(bus.port), "AUTOPILOT": f"udpin:127.0.0.1:{autopilot.port}", "GROUND": f"udpout:127.0.0.1:{ground.port}"}
    bus_log = work / "processes.txt"
    children = []
    try:
        with bus_log.open("w") as log:
            for unit in ("noctule-bridge.service", "noctule-nav.service", "noctule-log.service"):
                children.append(subprocess.Popen(root.unit_command(unit, settings), stdout=log, stderr=log))
        time.sleep(1.0)
        out = work / "simulation"
        done = subprocess.run([sys.executable, "-m", "noctule_sim", "maze_a", "--seed", "1", "--no-camera", "--max-time", str(FLIGHT_S), "--out", str(out),
                               "--autopilot-port", str(autopilot.port), "--lcm-url", settings["LCM_URL"]], capture_output=True, text=True, timeout=300)
        said = bus_log.read_text()
        assert all(child.poll() is None for child in children), f"a process ended: {said}"
        result = json.loads((out / "sim.json").read_text())
        assert done.returncode in (0, 1), done.stderr
        assert not result["lockstep_broken"], f"the processes did not answer the simulator: {said}"
        for child in children:
            child.send_signal(signal.SIGTERM)
        assert [child.wait(20) for child in children[:2]] == [0, 0], said
        children[2].wait(20)
        logs = list((root.folder / "var/lib/noctule/logs").glob("flight*"))
        assert logs and sum(p.stat().st_size for p in logs) > 1_000_000, "the flight recorder wrote nothing"
        assert logs[0].stat().st_uid != 0, "the recorder ran as root"
        print(f"package: answered every scan of {result['sim_time_s']:g} s; recorded {sum(p.stat().st_size for p in logs)} bytes")
    finally:
        for child in children:
            if child.poll() is None:
                child.kill()
                child.wait()
        for lock in (autopilot, bus, ground):
            lock.release()


def main(package: Path, mirror: str) -> int:
    if os.getuid() != 0 or multicast_problem():
        print(f"package: not tested: {multicast_problem() or 'needs root (chroot)'}")
        return 1
    work = Path(tempfile.mkdtemp(prefix="noctule-package-"))
    try:
        root = make(work / "root", mirror)
        depends = subprocess.run(["dpkg-deb", "-f", str(package), "Depends"], capture_output=True, text=True, check=True).stdout
        needed = [re.sub(r"\s*\(.*?\)", "", d).strip() for d in depends.split(",")]
        root.run("apt-get", "-qq", "update")
        root.run("apt-get", "-qq", "install", "-y", "--no-install-recommends", *needed)
        before, accounts = root.files(), root.accounts()
        shutil.copy(package, root.folder / "tmp/noctule.deb")
        root.run("dpkg", "-i", "/tmp/noctule.deb")
        for name in ("nav", "bridge", "vision", "lidar", "camera"):
            root.run(f"/usr/bin/noctule-{name}", "--help")
        added = sorted(root.files() - before)
        print(f"package: installed, {len(added)} paths")
        assert "var/lib/noctule/logs" in added and "etc/noctule/noctule.env" in added
        units = root.folder / "lib/systemd/system"
        if shutil.which("systemd-analyze") and Path("/lib/systemd/system/sysinit.target").exists():
            names = sorted(p.name for p in units.glob("noctule*"))
            checked = subprocess.run(["systemd-analyze", "verify", "--man=no", *names], capture_output=True, text=True,
                                     env={**os.environ, "SYSTEMD_UNIT_PATH": f"{units}:"})
            complaints = [line for line in checked.stderr.splitlines() if "noctule" in line and "is not executable" not in line]  # programs are in the root
            assert not complaints, f"systemd does not like the units: {complaints}"
        fly(root, work)
        root.run("dpkg", "-r", "noctule")
        left = sorted(root.files() - before)
        assert all(p.startswith(("etc/noctule", "var/lib/noctule")) for p in left), f"left behind after removal: {left}"
        assert "etc/noctule/parameters.toml" in left, "a removal keeps the configuration"
        root.run("dpkg", "-P", "noctule")
        assert root.files() == before, f"left behind after purge: {sorted(root.files() ^ before)}"
        assert root.accounts() == accounts, "an account was left behind"
        print("package: removed, nothing left behind")
        return 0
    except subprocess.CalledProcessError as error:
        print(f"package: {' '.join(map(str, error.cmd[2:]))}: {error.stderr}")
        return 1
    except AssertionError as error:
        print(f"package: {error}")
        return 1
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "http://deb.debian.org/debian"))
