"""The same flight with noctule-nav and noctule-bridge as aarch64 programs under qemu, and as native ones: flight.py [MAX_TIME_S].

Both answer the simulator in lockstep, so time does not matter; floating point does: libm, and the order in which a compiler
adds, differ. Tolerance, stated in docs/results.md too: the estimates of every scan of the first COMPARED_S (take-off, the look
around, the first way) agree within 2 cm and 0.2 degrees. Later a tie may send the two different ways: what they differ by over
the whole flight is printed, not judged.
"""

from __future__ import annotations

import math
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

from noctule.record import message_type
from noctule.replay import read_flight_log

ROOT = Path(__file__).resolve().parents[2]
COMPARED_S = 40.0
POSITION_M, YAW_RAD = 0.02, math.radians(0.2)


def wrapped(folder: Path) -> Path:
    """A build folder whose programs start those of build/aarch64 under qemu."""
    (folder / "bin").mkdir(parents=True)
    libraries = ROOT / "build/deps/sysroot-arm64/usr/lib/aarch64-linux-gnu"
    for name in ("noctule-nav", "noctule-bridge"):
        script = folder / "bin" / name
        script.write_text(f"#!/bin/sh\nunset LD_PRELOAD\nexec qemu-aarch64 -L {ROOT}/build/deps/sysroot-arm64 "
                          f"-E LD_LIBRARY_PATH={libraries}/lapack:{libraries}/blas {ROOT}/build/aarch64/bin/{name} \"$@\"\n")
        script.chmod(script.stat().st_mode | stat.S_IXUSR)
    return folder


def fly(build: Path, out: Path, max_time_s: float) -> dict[int, tuple[float, float, float, float]]:
    """scan's time [us] -> x, y, z, yaw of NAV."""
    command = [str(ROOT / ".venv/bin/noctule"), "fly", "maze_a", "--seed", "1", "--no-camera", "--quiet", "--max-time", str(max_time_s), "--out", str(out)]
    done = subprocess.run(command, env={**os.environ, "NOCTULE_BUILD": str(build)}, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise SystemExit(f"flight: {done.stderr.strip() or done.stdout.strip()}")
    print(f"{build}: {done.stdout.strip().splitlines()[0]}")
    nav = message_type("nav_t")
    poses = {}
    for channel, data in read_flight_log(out / "flight.lcm").events:
        if channel == "NAV":
            m = nav.decode(data)
            poses[m.t_us] = m.x_m, m.y_m, m.z_m, m.yaw_rad
    return poses


def main(max_time_s: float) -> int:
    work = Path(tempfile.mkdtemp(prefix="noctule-boards-"))
    try:
        native = fly(ROOT / "build/release", work / "native", max_time_s)
        board = fly(wrapped(work / "build"), work / "aarch64", max_time_s)
        common = sorted(t for t in native if t in board)
        first = [t for t in common if t - common[0] <= COMPARED_S * 1e6]
        position = max(math.dist(native[t][:3], board[t][:3]) for t in first)
        yaw = max(abs(math.remainder(native[t][3] - board[t][3], math.tau)) for t in first)
        last = max(math.dist(native[t][:3], board[t][:3]) for t in common)
        equal = sum(native[t] == board[t] for t in common)
        moved = max(math.dist(native[t][:2], native[common[0]][:2]) for t in common)
        print(f"flight: {len(common)} of {len(native)} and {len(board)} scans compared, {equal} equal bit for bit; moved {moved:.2f} m; "
              f"over {(first[-1] - first[0]) * 1e-6:.0f} s greatest difference {position * 100:.2f} cm, {math.degrees(yaw):.3f} deg; over all {last * 100:.2f} cm")
        good = len(common) >= 0.98 * len(native) and position <= POSITION_M and yaw <= YAW_RAD
        print(f"flight: {'the same within tolerance' if good else 'NOT the same'}")
        return 0 if good else 1
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0))
