"""A recorded flight again on a bare Cortex-M7 (qemu) and, with the same capacities, on this machine: frames.py [STEPS] [FLIGHT.LCM].

The samples that each step consumed, as NAV says, become a file; frame_replay reads it (on the board by semihosting) and prints
its estimates. The two must agree within the tolerances below; without a log, maze_a is flown first.
"""

from __future__ import annotations

import math
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

from noctule.record import message_type
from noctule.replay import read_flight_log

ROOT = Path(__file__).resolve().parents[2]
# kind of sample -> channel, message, layout, its fields; the order is that of the file (frame_replay.cpp reads it)
SAMPLES = {
    "imu": ("IMU", "imu_t", "<q3f3f", lambda m: (m.t_us, *m.accel_m_s2, *m.gyro_rad_s)),
    "attitude": ("ATTITUDE", "attitude_t", "<qff", lambda m: (m.t_us, m.roll_rad, m.pitch_rad)),
    "range_up": ("RANGE_UP", "range_t", "<qfff", lambda m: (m.t_us, m.range_m, m.range_min_m, m.range_max_m)),
    "range_down": ("RANGE_DOWN", "range_t", "<qfff", lambda m: (m.t_us, m.range_m, m.range_min_m, m.range_max_m)),
    "vehicle": ("VEHICLE", "vehicle_t", "<qiiiifi4f", lambda m: (m.t_us, m.armed, m.offboard, m.landed, m.mission_lost, m.battery_remaining,
                                                               m.local_position_valid, m.local_x_m, m.local_y_m, m.local_z_m, m.local_yaw_rad)),
    "command": ("COMMAND", "command_t", "<qi", lambda m: (m.t_us, m.command)),
}
# What may differ between the board and this machine (libm and the compiler round differently, which grows along a flight).
TOLERANCE_M = 0.02
TOLERANCE_RAD = 0.02


def write(log: Path, out: Path, steps: int) -> int:
    """Writes the frames; the number of steps that were there."""
    waiting = {kind: [] for kind in SAMPLES}
    kinds = {channel: kind for kind, (channel, *_) in SAMPLES.items()}
    scan = b""
    frames = []
    for channel, data in read_flight_log(log).events:
        if channel in kinds:
            _, name, layout, fields = SAMPLES[kinds[channel]]
            waiting[kinds[channel]].append(struct.pack(layout, *fields(message_type(name).decode(data))))
        elif channel == "SCAN":
            m = message_type("scan_t").decode(data)
            scan = struct.pack("<qii5f", m.t_us, m.seq, m.count, m.time_increment_us, m.bearing_first_rad, m.bearing_increment_rad, m.range_min_m, m.range_max_m)
            scan += struct.pack(f"<{m.count}f", *m.range_m[:m.count])
        elif channel == "NAV":
            m = message_type("nav_t").decode(data)
            frame = b""
            for kind, samples in waiting.items():
                used = getattr(m, f"{kind}_used")
                frame += struct.pack("<i", used) + b"".join(samples[:used])
                del samples[:used]
            frames.append(frame + scan)
            if len(frames) == steps:
                break
    out.write_bytes(struct.pack("<i", len(frames)) + b"".join(frames))
    return len(frames)


def judge(one: Path, two: Path) -> list[str]:
    """What is wrong with the second output against the first; nothing: they agree."""
    rows = [[[float(word) for word in line.split()] for line in path.read_text(encoding="ascii").splitlines() if line[:1].isdigit()] for path in (one, two)]
    if len(rows[0]) != len(rows[1]) or not rows[0]:
        return [f"{len(rows[0])} steps against {len(rows[1])}"]
    most = [0.0] * 5
    for a, b in zip(*rows):   # t_us x y yaw z state
        away = [abs(a[0] - b[0]), math.hypot(a[1] - b[1], a[2] - b[2]), abs(math.remainder(a[3] - b[3], 2.0 * math.pi)), abs(a[4] - b[4]), abs(a[5] - b[5])]
        most = [max(m, d) if not math.isnan(d) else math.inf for m, d in zip(most, away)]
    limits = (0.0, TOLERANCE_M, TOLERANCE_RAD, TOLERANCE_M, 0.0)
    print(f"{len(rows[0])} steps; greatest difference: {most[1]:.5f} m, {most[2]:.5f} rad, height {most[3]:.5f} m; states {'equal' if most[4] == 0 else 'differ'}")
    return [f"{what} off by {value:g}, allowed {limit:g}" for what, value, limit in zip(("time", "place", "heading", "height", "state"), most, limits) if not value <= limit]


def replayed(command: list[str], folder: Path, out: str) -> Path:
    """What frame_replay printed, run in the folder with the frames; its last line is shown."""
    with (folder / out).open("w", encoding="ascii") as file:
        done = subprocess.run(command, cwd=folder, stdout=file, stdin=subprocess.DEVNULL)
    lines = (folder / out).read_text(encoding="ascii").splitlines()
    print(f"{out}: {lines[-1] if lines else 'said nothing'}", flush=True)
    if done.returncode != 0:
        raise SystemExit(f"frames: {command[-1]} ended with {done.returncode}")
    return folder / out


def main(steps: int, log: Path | None) -> int:
    """1 where the two differ."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if log is None:
            log = folder / "run" / "flight.lcm"
            subprocess.run([ROOT / ".venv/bin/noctule", "fly", "maze_a", "--seed", "1", "--no-camera", "--quiet", "--max-time", str(steps / 20 + 10), "--out", log.parent],
                           stdout=subprocess.DEVNULL)
        print(f"{write(log, folder / 'frames.bin', steps)} steps of a flight", flush=True)
        native = replayed([str(ROOT / "build/micro/bin/frame_replay")], folder, "here")
        board = replayed(["qemu-system-arm", "-M", "mps2-an500", "-nographic", "-semihosting-config", "enable=on,target=native", "-kernel",
                          str(ROOT / "build/cortex-m7/bin/frame_replay")], folder, "Cortex-M7")
        wrong = judge(native, board)
    print("\n".join(wrong) or "equal within the tolerances")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 600, Path(sys.argv[2]) if len(sys.argv) > 2 else None))
