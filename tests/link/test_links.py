"""Links of the real noctule-bridge: a serial line that loses and spoils bytes, signing, files over MAVLink FTP."""

import json
import lzma
import os
import pty
import random
import struct
import subprocess
import time
import tty
import zlib

import pytest
from bridge_peers import BUILD, COMPANION, SYSTEM, Peers, mavlink

from noctule import params_gen
from noctule.processes import PortLock, lcm_url

KEY = bytes(range(32))


class Line:
    """A pseudo-terminal as a serial line; what passes loses and spoils a share of its bytes."""

    def __init__(self, loss):
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        self.slave = slave
        os.set_blocking(self.master, False)
        self.loss, self.random = loss, random.Random(5)

    def spoil(self, data):
        out = bytearray()
        for byte in data:
            chance = self.random.random()
            if chance >= self.loss:
                out.append(byte if chance < 1.0 - self.loss else byte ^ 0x40)
        return bytes(out)

    def send(self, data):
        os.write(self.master, self.spoil(data))

    def receive(self):
        try:
            return self.spoil(os.read(self.master, 65536))
        except (BlockingIOError, OSError):
            return b""

    def close(self):
        for end in (self.master, self.slave):
            try:
                os.close(end)
            except OSError:
                pass


def pump(line, parser, seconds, until=lambda messages: False):
    messages, deadline = [], time.monotonic() + seconds
    while time.monotonic() < deadline and not until(messages):
        messages += parser.parse_buffer(line.receive()) or []
        time.sleep(0.01)
    return messages


def test_a_serial_autopilot_is_heard_through_lost_and_spoilt_bytes_and_again_after_it_was_unplugged(tmp_path):
    line, lock = Line(0.001), PortLock.take_any()
    link = tmp_path / "autopilot"
    link.symlink_to(line.name)
    bridge = subprocess.Popen([str(BUILD / "bin" / "noctule-bridge"), "--autopilot", f"serial:{link}:921600", "--lcm-url", lcm_url(lock.port),
                               "--stats", str(tmp_path / "stats.json")], stderr=subprocess.PIPE, text=True)
    try:
        for attempt in range(2):
            mav, ours = mavlink.MAVLink(None, SYSTEM, 1), mavlink.MAVLink(None, 255, 190)
            mav.robust_parsing = ours.robust_parsing = True
            deadline, t_ms, messages = time.monotonic() + 10.0, 1000 + 100_000 * attempt, []
            heard = False
            while time.monotonic() < deadline and not heard:
                t_ms += 50
                for message in (mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 3, 3), mavlink.MAVLink_system_time_message(0, t_ms)):
                    line.send(message.pack(mav))
                    mav.seq = (mav.seq + 1) % 256
                messages += pump(line, ours, 0.05)
                heard = any(m.get_type() == "HEARTBEAT" and m.get_srcSystem() == SYSTEM and m.get_srcComponent() == COMPANION for m in messages)
            assert heard
            if attempt == 0:
                line.close()                       # unplugged; another device appears under the same name
                line = Line(0.001)
                link.unlink()
                link.symlink_to(line.name)
        bridge.send_signal(2)
        _, said = bridge.communicate(timeout=10)
        assert bridge.returncode == 0 and "is gone, waiting" in said and "is back" in said
    finally:
        if bridge.poll() is None:
            bridge.kill()
            bridge.communicate()
        line.close()
        lock.release()


@pytest.mark.parametrize("url", ["serial:/dev/ttyX", "serial:/dev/ttyX:12345", "serial::57600"])
def test_a_serial_url_that_makes_no_sense_is_named(url, tmp_path):
    done = subprocess.run([str(BUILD / "bin" / "noctule-bridge"), "--autopilot", url], capture_output=True, text=True, timeout=10)
    assert done.returncode == 2 and "is no serial endpoint" in done.stderr and done.stderr.count("\n") == 1


def signed(mav):
    mav.signing.secret_key, mav.signing.sign_outgoing = KEY, True
    mav.signing.timestamp = int((time.time() - 1420070400) * 1e5)
    mav.signing.link_id = 9


def test_with_signing_on_unsigned_and_replayed_packets_are_refused(tmp_path):
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    with Peers(tmp_path, options=("--signing-key", str(key))) as peers:
        peers.ground_mav.signing.secret_key = KEY                               # from here on the ground station checks what it hears
        peers.at_ground.clear()
        peers.run(1.0)
        heard = {m.get_srcComponent() for m in peers.at_ground}
        assert {1, COMPANION} <= heard and all(m.get_signed() for m in peers.at_ground)  # what the autopilot said, too
        request = mavlink.MAVLink_param_request_read_message(SYSTEM, COMPANION, b"SPEED_MAX", -1)
        answers = lambda: len([m for m in Peers.of(peers.at_ground, "PARAM_VALUE") if m.param_id == "SPEED_MAX"])  # noqa: E731
        peers.say(request)
        assert not peers.run(1.0, answers)
        signed(peers.ground_mav)
        packet = request.pack(peers.ground_mav)
        peers.ground.send(packet)
        assert peers.run(1.0, answers) and answers() == 1
        peers.ground.send(packet)                                               # replayed
        assert not peers.run(1.0, lambda: answers() > 1)
        peers.ground_mav.signing.secret_key = bytes(32)                         # another key
        peers.say(request)
        assert not peers.run(1.0, lambda: answers() > 1)
        # A command for the autopilot arrives there without the signature, which its link does not have.
        peers.ground_mav.signing.secret_key = KEY
        peers.say(mavlink.MAVLink_command_long_message(SYSTEM, 1, mavlink.MAV_CMD_DO_SET_HOME, 0, 1, 0, 0, 0, 0, 0, 0))
        assert peers.run(1.0, lambda: any(m.command == mavlink.MAV_CMD_DO_SET_HOME for m in Peers.of(peers.at_autopilot, "COMMAND_LONG")))
        assert not any(m.get_signed() for m in peers.at_autopilot)
        assert peers.stop() == 0
        stats = json.loads(peers.stats.read_text())
        assert stats["signed_refused"] == 3 and stats["signed_good"] == 2


def test_a_key_that_others_may_read_is_refused(tmp_path):
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o644)
    done = subprocess.run([str(BUILD / "bin" / "noctule-bridge"), "--signing-key", str(key)], capture_output=True, text=True, timeout=10)
    assert done.returncode == 2 and "chmod 600" in done.stderr


class Ftp:
    """A client of MAVLink FTP in small, as ground stations do it: open, burst, then read what is missing."""

    def __init__(self, peers):
        self.peers, self.seq = peers, 0

    def ask(self, opcode, session=0, offset=0, data=b"", size=None):
        self.seq = (self.seq + 2) % 65536
        head = struct.pack("<HBBBBBBI", self.seq, session, opcode, len(data) if size is None else size, 0, 0, 0, offset)
        self.peers.say(mavlink.MAVLink_file_transfer_protocol_message(0, SYSTEM, COMPANION, list((head + data).ljust(251, b"\0"))))

    def answers(self):
        for m in Peers.of(self.peers.at_ground, "FILE_TRANSFER_PROTOCOL"):
            raw = bytes(m.payload)
            seq, session, opcode, size, asked, last, _, offset = struct.unpack_from("<HBBBBBBI", raw)
            yield seq, session, opcode, asked, last, offset, raw[12:12 + size]

    def call(self, opcode, **arguments):
        for _ in range(20):
            self.ask(opcode, **arguments)
            wanted = (self.seq + 1) % 65536
            found = lambda: [a for a in self.answers() if a[0] == wanted and a[3] == opcode]  # noqa: E731
            if self.peers.run(0.5, found):
                return found()[0]
        raise AssertionError("no answer")

    def read(self, path):
        _, session, opcode, _, _, _, data = self.call(4, data=path.encode())
        assert opcode == 128
        total, got = struct.unpack("<I", data)[0], {}
        before = len(list(self.answers()))            # what an earlier read of this session number brought is not of this file
        self.ask(15, session=session, size=239)
        self.peers.run(4.0, lambda: any(a[3] == 15 and a[4] for a in list(self.answers())[before:]))
        for _, number, opcode, asked, _, offset, part in list(self.answers())[before:]:
            if asked == 15 and opcode == 128 and number == session:
                got[offset] = part
        for offset in range(0, total, 239):
            if offset not in got:
                got[offset] = self.call(5, session=session, offset=offset, size=239)[6]
        self.call(1, session=session)
        return b"".join(got[offset] for offset in sorted(got))


def crc(data):
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def test_the_parameters_metadata_comes_over_a_lossy_link_and_tells_units_and_meanings(tmp_path):
    with Peers(tmp_path, loss=0.05) as peers:
        peers.run(1.0)
        uri = None
        for _ in range(10):
            peers.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, 397.0)
            raw = lambda: [m for m in peers.at_ground if m.get_type() == "UNKNOWN_397"]  # noqa: E731
            if peers.run(0.5, raw):
                frame = bytes(raw()[0].get_msgbuf())
                payload = frame[10:10 + frame[1]].ljust(108, b"\0")
                general_crc, uri = struct.unpack_from("<I", payload, 4)[0], payload[8:].rstrip(b"\0").decode()
                break
        assert uri == "mftp:///noctule/general.json"
        ftp = Ftp(peers)
        general = ftp.read("/noctule/general.json")
        assert crc(general) == general_crc
        entry = json.loads(general)["metadataTypes"][0]
        assert entry["type"] == 1
        path = entry["uri"].removeprefix("mftp://")
        packed = ftp.read(path)
        assert crc(packed) == entry["fileCrc"]
        assert struct.unpack("<I", ftp.call(14, data=path.encode())[6])[0] == entry["fileCrc"]
        parameters = {p["name"]: p for p in json.loads(lzma.decompress(packed))["parameters"]}
        assert set(parameters) == {row.param for row in params_gen.TABLE}
        for row in params_gen.TABLE:
            p = parameters[row.param]
            assert (p["min"], p["max"], p["default"]) == (row.min, row.max, row.default) and p["longDesc"].startswith(row.doc)
            assert p.get("rebootRequired", False) == row.reboot and p["type"] == ("Int32" if row.type == "int" else "Float")
        assert parameters["SPEED_MAX"]["units"] == "m/s"
        listed = ftp.call(3, data=b"/noctule")[6].split(b"\0")
        assert b"Fgeneral.json\t%d" % len(general) in listed
        for opcode, data in ((6, b"/noctule/new"), (8, b"/noctule/general.json"), (7, b"x"), (9, b"/noctule/d")):
            assert ftp.call(opcode, data=data)[2] == 129                        # nothing can be written
        assert ftp.call(4, data=b"/etc/passwd")[6] == b"\x0a"                   # not found
        assert ftp.call(5, session=7, size=10)[6] == b"\x04"                    # no such session
