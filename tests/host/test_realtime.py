"""Real-time options: systemd is told, what is not permitted is said once, and the process goes on."""

import json
import os
import resource
import signal
import socket
import subprocess

import pytest

from noctule.processes import PortLock, find_program, lcm_url, multicast_problem

PROCESSES = {"noctule-nav": [], "noctule-bridge": ["--autopilot", "udpout:127.0.0.1:9"], "noctule-lidar": ["--device", "tcp:127.0.0.1:9"]}

pytestmark = [
    pytest.mark.skipif(any(find_program(name) is None for name in PROCESSES), reason="not built"),
    pytest.mark.skipif(multicast_problem() is not None, reason="no multicast route"),
]


@pytest.fixture
def url():
    lock = PortLock.take_any()
    yield lcm_url(lock.port)
    lock.release()


@pytest.mark.parametrize("name", PROCESSES)
def test_systemd_hears_ready_watchdog_and_stopping(name, url, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(10)
        process = subprocess.Popen([find_program(name), "--lcm-url", url, *PROCESSES[name]], stderr=subprocess.DEVNULL,
                                   env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "300000"})
        try:
            heard = [systemd.recv(100) for _ in range(5)]
            process.send_signal(signal.SIGTERM)
            while heard[-1] != b"STOPPING=1":
                heard.append(systemd.recv(100))
            assert process.wait(10) == 0
        finally:
            process.kill()
            process.wait()
    assert heard[0] == b"READY=1" and set(heard[1:-1]) == {b"WATCHDOG=1"}


def forbid():
    """As an unprivileged user without limits of its own."""
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)


@pytest.mark.skipif(os.getuid() != 0, reason="a user of the system may have these permissions")
def test_what_is_not_permitted_is_said_and_done_without(url, tmp_path):
    os.chmod(tmp_path, 0o777)
    program = tmp_path / "noctule-nav"
    program.write_bytes(find_program("noctule-nav").read_bytes())      # the checkout may be closed to others
    program.chmod(0o755)
    for folder in list(tmp_path.parents)[:3]:
        if folder != folder.parent and folder.stat().st_uid == 0 and str(folder).startswith("/tmp/"):
            folder.chmod(folder.stat().st_mode | 0o055)
    process = subprocess.Popen([program, "--lcm-url", url, "--lock-memory", "--fifo", "20", "--stats", tmp_path / "stats.json"],
                               stderr=subprocess.PIPE, text=True, preexec_fn=forbid)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.0)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=10)
    assert process.returncode == 0
    lines = [line for line in said.splitlines() if "going on without" in line]
    assert len(lines) == 2 and "memory is not locked" in lines[0] and "no real-time priority" in lines[1]
    stats = json.loads((tmp_path / "stats.json").read_text())
    assert sum(count for _, count in stats["step_us_histogram"]) == stats["steps"] == 0 and stats["overruns"] == 0


def test_a_priority_that_is_none_is_refused(url):
    done = subprocess.run([find_program("noctule-nav"), "--lcm-url", url, "--fifo", "100"], capture_output=True, timeout=10)
    assert done.returncode != 0
