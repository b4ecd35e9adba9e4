"""A ground station in small: hears the bridge, keeps a telemetry log, and starts the mission."""

from __future__ import annotations

import os
import socket
import struct
import time
from pathlib import Path

os.environ.setdefault("MAVLINK20", "1")
from pymavlink.dialects.v20 import common as mavlink  # noqa: E402  (the protocol version is read at import)

GROUND_SYSTEM, GROUND_COMPONENT = 255, 190
COMPANION_COMPONENT = 191
AUTOPILOT_COMPONENT = 1
RETRY_S = 0.5
HEARTBEAT_S = 1.0


class GroundStation:
    """Listens on a UDP port of the loopback; answers go to whoever spoke last.

    Wall time serves retries and the tlog's stamps only.
    """

    def __init__(self, port: int, tlog: Path):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.bind(("127.0.0.1", port))
        self.socket.setblocking(False)
        self._tlog = open(tlog, "wb")
        self._mav = mavlink.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)
        self._mav.robust_parsing = True
        self._peer = None
        self._next_heartbeat = 0.0
        self._next_start = 0.0
        self._attempts = 0
        self.companion_system: int | None = None
        self.armed = False
        self.was_armed = False
        self.start_result: int | None = None     # MAV_RESULT of the last answer to a start
        self.texts: list[tuple[int, str]] = []   # severity and text, as they came; the caller empties it
        self._parts: dict[tuple, str] = {}

    def close(self) -> None:
        """Closes socket and log."""
        self.socket.close()
        self._tlog.close()

    def _log(self, data: bytes) -> None:
        self._tlog.write(struct.pack(">Q", int(time.time() * 1e6)) + data)

    def _send(self, message) -> None:
        if self._peer is None:
            return
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._log(data)
        try:
            self.socket.sendto(data, self._peer)
        except OSError:
            pass                                 # nobody listens at the moment; the next one may get through

    def receive(self) -> None:
        """Takes in everything that has arrived."""
        while True:
            try:
                data, self._peer = self.socket.recvfrom(65535)
            except BlockingIOError:
                return
            except OSError:
                continue
            for message in self._mav.parse_buffer(data) or []:
                if message.get_type() == "BAD_DATA":
                    continue
                self._log(bytes(message.get_msgbuf()))
                self._take(message)

    def _take(self, message) -> None:
        kind, component = message.get_type(), message.get_srcComponent()
        if kind == "HEARTBEAT":
            if component == COMPANION_COMPONENT:
                self.companion_system = message.get_srcSystem()
            elif component == AUTOPILOT_COMPONENT:
                self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                self.was_armed |= self.armed
        elif kind == "STATUSTEXT":
            self._text(message)
        elif kind == "COMMAND_ACK" and message.command == mavlink.MAV_CMD_MISSION_START \
                and component == COMPANION_COMPONENT:
            self.start_result = message.result

    def _text(self, message) -> None:
        # A long text comes in chunks of 50 characters under one id; a chunk that is not full ends it.
        key = (message.get_srcSystem(), message.get_srcComponent(), getattr(message, "id", 0))
        text = message.text.rstrip("\0") if isinstance(message.text, str) else message.text.decode("utf-8", "replace").rstrip("\0")
        if key[2] != 0:
            text = self._parts.pop(key, "") + text
            if len(message.text) >= 50:
                self._parts[key] = text
                return
        self.texts.append((message.severity, text))

    def tick(self) -> None:
        """The station's own duties: its heartbeat once a second."""
        now = time.monotonic()
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_S
            self._send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0,
                                                         mavlink.MAV_STATE_ACTIVE, 3))

    def start_mission(self, earliest_s: float) -> None:
        """Asks the companion to start, again and again until answered; call it often.

        Args:
            earliest_s: autopilot time before which the start is held back [s] (param3 of MAV_CMD_MISSION_START).
        """
        if self.companion_system is None or time.monotonic() < self._next_start:
            return
        self._next_start = time.monotonic() + RETRY_S
        self._send(mavlink.MAVLink_command_long_message(
            self.companion_system, COMPANION_COMPONENT, mavlink.MAV_CMD_MISSION_START, min(self._attempts, 255),
            0.0, 0.0, earliest_s, 0.0, 0.0, 0.0, 0.0))
        self._attempts += 1

    @property
    def start_pending(self) -> bool:
        """The companion has the start and holds it back, or has started."""
        return self.start_result in (mavlink.MAV_RESULT_IN_PROGRESS, mavlink.MAV_RESULT_ACCEPTED)
