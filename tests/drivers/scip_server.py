"""A Hokuyo laser as its specification describes it, over TCP or a pseudo terminal, with faults on demand.

Source: "Communication Protocol Specification for SCIP2.0 Standard", C-42-03320B; what a UST-10LX says of itself.
"""

import os
import select
import socket
import threading
import time

WRAP_MS = 1 << 24


def checksum(text: str) -> str:
    """Lower six bits of the sum, plus 0x30 (section 7)."""
    return chr((sum(text.encode("ascii")) & 0x3F) + 0x30)


def encode(value: int, characters: int) -> str:
    """Six bits a character, 0x30 added (section 6)."""
    return "".join(chr(((value >> (6 * i)) & 0x3F) + 0x30) for i in reversed(range(characters)))


def blocks(data: str) -> str:
    """Lines of 64 characters, each with its sum."""
    return "".join(data[i:i + 64] + checksum(data[i:i + 64]) + "\n" for i in range(0, len(data), 64))


class Laser:
    """The sensor's side of the protocol. distances(n) gives the n-th scan in mm; spoil(n, bytes) may damage its message."""

    def __init__(self, distances, start_ms=0, rate_hz=40.0, spoil=None):
        self.distances = distances
        self.spoil = spoil or (lambda n, message: message)
        self.period_s = 1.0 / rate_hz
        self.start_s = time.monotonic()
        self.start_ms = start_ms
        self.lit = False
        self.echo = None             # of the running MD command
        self.every = 1
        self.between = (0, 1080)
        self.scans = 0
        self.turns = 0
        self.commands = []
        self.next_s = 0.0
        self.status = "99"
        self.stamped_s = {}          # time.monotonic() of each scan's stamp

    def clock_ms(self) -> int:
        return (self.start_ms + round((time.monotonic() - self.start_s) * 1000)) % WRAP_MS

    def reply(self, command: str, status: str, rest: str = "") -> bytes:
        return f"{command}\n{status}{checksum(status)}\n{rest}\n".encode("ascii")

    def fields(self, lines) -> str:
        return "".join(f"{line};{checksum(line)}\n" for line in lines)

    def command(self, command: str) -> bytes:
        """The answer to one line."""
        self.commands.append(command)
        if command == "VV":
            return self.reply(command, "00", self.fields(["VEND:Hokuyo Automatic Co., Ltd.", "PROD:UST-10LX", "PROT:SCIP 2.2", "SERI:H0000001"]))
        if command == "PP":
            return self.reply(command, "00", self.fields(["MODL:UST-10LX", "DMIN:20", "DMAX:30000", "ARES:1440", "AMIN:0", "AMAX:1080",
                                                          "AFRT:540", "SCAN:2400"]))
        if command == "BM":
            status, self.lit = ("02" if self.lit else "00"), True
            return self.reply(command, status)
        if command == "QT":
            self.lit, self.echo = False, None
            return self.reply(command, "00")
        if command.startswith(("MD", "GD")) and len(command) in (12, 15) and command[2:].isdigit():
            first, last = int(command[2:6]), int(command[6:10])
            if last > 1080:
                return self.reply(command, "04")
            if last < first:
                return self.reply(command, "05")
            self.between = first, last
            if command.startswith("GD"):
                return self.reply(command, "00", self.measurement()) if self.lit else self.reply(command, "10")
            self.every, self.lit, self.echo, self.next_s = int(command[12]) + 1, True, command, time.monotonic() + self.period_s
            return self.reply(command, "00")
        return self.reply(command, "0E")

    def measurement(self) -> str:
        self.stamped_s[self.scans] = time.monotonic()
        stamp = encode(self.clock_ms(), 4)
        data = "".join(encode(mm, 3) for mm in self.distances(self.scans)[self.between[0]:self.between[1] + 1])
        return stamp + checksum(stamp) + "\n" + blocks(data)

    def due(self) -> bytes:
        """The next scan's message when its time has come."""
        if self.echo is None or time.monotonic() < self.next_s:
            return b""
        self.next_s += self.period_s
        self.turns += 1
        if self.turns % self.every:
            return b""
        message = self.reply(self.echo, self.status, self.measurement() if self.status == "99" else "")
        self.scans += 1
        return self.spoil(self.scans - 1, message)

    def serve(self, read, write, stop) -> None:
        """Until the line ends or stop is set. read(timeout_s) gives bytes, b'' for none, None at the end."""
        waiting = ""
        while not stop.is_set():
            data = read(0.002)
            if data is None:
                return
            waiting += data.decode("ascii", "replace").replace("\r", "\n")
            while "\n" in waiting:
                line, waiting = waiting.split("\n", 1)
                if line:
                    write(self.command(line))
            if message := self.due():
                write(message)


class TcpLaser:
    """A laser at 127.0.0.1:port; unplug() closes the connection and the port, plug() opens them again."""

    def __init__(self, laser: Laser):
        self.laser, self.port = laser, 0
        self.plug()

    def plug(self) -> None:
        self.stop = threading.Event()
        self.listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.listener.bind(("127.0.0.1", self.port))
        self.port = self.listener.getsockname()[1]
        self.listener.listen(1)
        self.listener.settimeout(0.05)
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def unplug(self) -> None:
        self.stop.set()
        self.thread.join(5.0)
        self.listener.close()

    def _run(self) -> None:
        while not self.stop.is_set():
            try:
                line, _ = self.listener.accept()
            except TimeoutError:
                continue
            line.settimeout(None)

            def read(timeout_s, line=line):
                if not select.select([line], [], [], timeout_s)[0]:
                    return b""
                try:
                    return line.recv(4096) or None
                except OSError:
                    return None

            try:
                self.laser.echo = None
                self.laser.serve(read, line.sendall, self.stop)
            except OSError:
                pass
            line.close()


class SerialLaser:
    """A laser behind a pseudo terminal that `link` points at; unplug() takes terminal and link away."""

    def __init__(self, laser: Laser, link):
        self.laser, self.link = laser, link
        self.plug()

    def plug(self) -> None:
        import pty
        import tty

        self.stop = threading.Event()
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(slave))
        self.slave = slave           # held open: a master whose last slave has closed reads errors
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def unplug(self) -> None:
        self.stop.set()
        self.thread.join(5.0)
        self.link.unlink()
        os.close(self.slave)
        os.close(self.master)

    def _run(self) -> None:
        def read(timeout_s):
            if not select.select([self.master], [], [], timeout_s)[0]:
                return b""
            try:
                return os.read(self.master, 4096)
            except OSError:
                return None

        self.laser.echo = None
        self.laser.serve(read, lambda data: os.write(self.master, data), self.stop)
