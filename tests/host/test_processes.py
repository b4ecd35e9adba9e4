"""Ports are one's own, and no child outlives its flight."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from noctule import processes
from noctule.ground import GroundStation, mavlink
from noctule.processes import Child, PortLock, end_all


@pytest.fixture(autouse=True)
def own_lock_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(PortLock, "folder", staticmethod(lambda: tmp_path / "locks"))


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def gone_within(pid, seconds):
    deadline = time.monotonic() + seconds
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    return not alive(pid)


def test_a_port_is_given_once_until_it_is_released():
    first = PortLock.take_any()
    assert PortLock.take(first.port) is None
    other = PortLock.take_any()
    assert other.port != first.port
    first.release()
    again = PortLock.take(first.port)
    assert again is not None
    again.release()
    other.release()


def test_a_port_that_another_program_has_is_not_given():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        assert PortLock.take(taken.getsockname()[1]) is None


def test_a_stubborn_child_and_its_own_children_are_ended(tmp_path):
    code = ("import signal, subprocess, sys, time; signal.signal(signal.SIGINT, signal.SIG_IGN); "
            "signal.signal(signal.SIGTERM, signal.SIG_IGN); "
            "p = subprocess.Popen(['sleep', '60']); print(p.pid, flush=True); time.sleep(60)")
    child = Child("stubborn", [sys.executable, "-c", code], tmp_path / "log.txt")
    deadline = time.monotonic() + 10
    while not child.last_line() and time.monotonic() < deadline:
        time.sleep(0.02)
    grandchild = int(child.last_line())
    assert end_all([child], 0.2) == ["stubborn"]
    assert not child.running and gone_within(grandchild, 5.0)


def test_a_child_dies_when_the_command_is_killed(tmp_path):
    code = ("import sys, time; from pathlib import Path; from noctule.processes import Child; "
            f"c = Child('c', ['sleep', '60'], Path(r'{tmp_path}') / 'c.txt'); print(c.process.pid, flush=True); time.sleep(60)")
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pid = int(parent.stdout.readline())
    assert alive(pid)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    assert gone_within(pid, 5.0)


def test_how_a_child_ended_is_said(tmp_path):
    child = Child("c", [sys.executable, "-c", "print('first'); print('why'); raise SystemExit(3)"], tmp_path / "c.txt")
    assert child.wait(20.0)
    assert child.how_it_ended() == "exit code 3" and child.last_line() == "why"
    child.close()
    child = Child("c", ["sleep", "60"], tmp_path / "d.txt")
    child.ask_to_end(signal.SIGTERM)
    assert child.wait(5.0) and child.how_it_ended() == "signal SIGTERM"
    child.close()


def test_the_recorder_loses_nothing_of_a_burst_and_ends_when_asked(tmp_path):
    # lcm-logger keeps 30 messages waiting and drops the rest; a tick of the lockstep brings about as many.
    import lcm

    from noctule import record

    lock = PortLock.take_any()
    url = processes.lcm_url(lock.port)
    recorder = Child("r", [sys.executable, "-m", "noctule.recorder", url, tmp_path / "a.lcm"], tmp_path / "r.txt")
    deadline = time.monotonic() + 20
    while not recorder.last_line() and time.monotonic() < deadline:
        time.sleep(0.02)
    bus = lcm.LCM(url)
    for burst in range(10):
        for i in range(100):
            bus.publish("IMU", bytes([burst, i]) * 40)
        time.sleep(0.01)
    time.sleep(0.3)
    assert end_all([recorder]) == [] and recorder.process.returncode == 0
    data = [d[:2] for channel, _, d in record.events(tmp_path / "a.lcm") if channel == "IMU"]
    assert data == [bytes([burst, i]) for burst in range(10) for i in range(100)]
    lock.release()


def test_the_programs_are_looked_for_where_they_are_built(tmp_path, monkeypatch):
    monkeypatch.setenv("NOCTULE_BUILD", str(tmp_path))
    assert processes.find_program("noctule-nav") is None
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "noctule-nav").write_text("#!/bin/sh\n")
    (tmp_path / "bin" / "noctule-nav").chmod(0o755)
    assert processes.find_program("noctule-nav") == tmp_path / "bin" / "noctule-nav"


def test_the_ground_station_starts_a_mission_and_joins_long_texts(tmp_path):
    lock = PortLock.take_any()
    station = GroundStation(lock.port, tmp_path / "a.tlog")
    companion = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.settimeout(5.0)

        def send(message):
            peer.sendto(message.pack(companion), ("127.0.0.1", lock.port))

        station.start_mission(3.0)                                  # nobody known yet: nothing is sent
        send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        text = "landing: " + "x" * 60
        send(mavlink.MAVLink_statustext_message(4, text[:50].encode(), 7, 0))
        send(mavlink.MAVLink_statustext_message(4, text[50:].encode(), 7, 1))
        deadline = time.monotonic() + 5
        while not station.texts and time.monotonic() < deadline:
            station.receive()
        assert station.texts == [(4, text)]
        station.start_mission(3.0)
        (order,) = [m for m in mavlink.MAVLink(None).parse_buffer(peer.recv(1000))]
        assert (order.command, order.target_system, order.target_component) == (300, 1, 191)
        assert (order.get_srcSystem(), order.get_srcComponent()) == (255, 190)
        assert order.param3 == 3.0
        assert not station.start_pending
        send(mavlink.MAVLink_command_ack_message(300, mavlink.MAV_RESULT_IN_PROGRESS))
        while not station.start_pending and time.monotonic() < deadline:
            station.receive()
        assert station.start_pending
    station.close()
    lock.release()
    from pymavlink import mavutil
    log = mavutil.mavlink_connection(str(tmp_path / "a.tlog"))
    kinds = []
    while (message := log.recv_msg()) is not None:
        kinds.append(message.get_type())
    assert kinds == ["HEARTBEAT", "STATUSTEXT", "STATUSTEXT", "COMMAND_LONG", "COMMAND_ACK"]
