"""`python -m noctule.recorder URL FILE`: writes everything on an LCM bus into an LCM log, and loses nothing.

lcm-logger keeps at most 30 messages of a subscription waiting, and a tick of the lockstep brings about 30 at once: in
a trial with bursts of 100 it dropped six of ten. Here the queue has no limit. SIGINT and SIGTERM end it, after what
has arrived is written.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time

FLUSH_WAIT_MS = 100


def record(url: str, path: str, channels: str, stop) -> int:
    """Writes messages whose channel matches `channels` until stop() is true and nothing is left; their number."""
    import lcm

    bus = lcm.LCM(url)
    log = lcm.EventLog(path, "w", overwrite=True)
    count = 0

    def write(channel: str, data: bytes) -> None:
        nonlocal count
        log.write_event(int(time.time() * 1e6), channel, data)
        count += 1

    bus.subscribe(channels, write).set_queue_capacity(0)     # 0: no limit
    print("recording", flush=True)
    more = 1
    while more > 0 or not stop():
        try:
            more = bus.handle_timeout(FLUSH_WAIT_MS)
        except OSError:
            more = 1          # a signal came while waiting; look again
    log.close()
    return count


def main(arguments=None) -> int:
    """Records until a signal; returns the exit code."""
    parser = argparse.ArgumentParser(prog="noctule.recorder", description="Writes an LCM bus into a log.")
    parser.add_argument("url", metavar="URL", help="LCM bus, for instance udpm://239.255.76.67:7667?ttl=0")
    parser.add_argument("file", metavar="FILE", help="log to be written")
    parser.add_argument("--channels", default=".*", metavar="REGEX", help="channels to write (default all)")
    options = parser.parse_args(arguments)
    stopped = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.append(True))
    try:
        count = record(options.url, options.file, options.channels, lambda: bool(stopped))
    except OSError as error:
        print(f"noctule.recorder: {options.file}: {error}", file=sys.stderr)
        return 2
    print(f"{count} messages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
