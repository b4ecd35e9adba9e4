"""The same flight with noctule-nav and noctule-bridge as aarch64 programs under qemu, and as native ones: flight.py [MAX_TIME_S].

Both answer the simulator in lockstep, so emulation's slowness does not matter. Floating point does: libm and the compilers round
differently, a difference of one bit sooner or later turns a tie (which way round to look, which of two goals) the other way,
and the flights part. Judged is therefore the result, with the tolerances below; when the two part is printed.
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

from noctule.record import message_type, read_json
from noctule.replay import read_flight_log

ROOT = Path(__file__).resolve().parents[2]
PARTED_M = 0.02              # estimates that differ by more belong to flights that have parted
# value of report.json -> greatest difference between the two flights
TOLERANCES = {"explored_fraction": 0.01, "pose_error_m": 0.01, "altitude_error_m": 0.01, "home_error_m": 0.1}


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


def results(report: dict) -> dict[str, float]:
    """What is judged of a report."""
    return {"explored_fraction": report["floors"][0]["explored_fraction"], "pose_error_m": report["pose_error_m"]["mean"],
            "altitude_error_m": report["altitude_error_m"]["mean"], "home_error_m": report["home_error_m"]}


def fly(build: Path, out: Path, max_time_s: float) -> tuple[dict, dict[int, tuple[float, float, float]]]:
    """The report, and scan's time [us] -> x, y, z of NAV."""
    command = [str(ROOT / ".venv/bin/noctule"), "fly", "maze_a", "--seed", "1", "--no-camera", "--quiet", "--max-time", str(max_time_s), "--out", str(out)]
    done = subprocess.run(command, env={**os.environ, "NOCTULE_BUILD": str(build)}, capture_output=True, text=True)
    report = read_json(out / "report.json")
    first = (done.stdout.strip() or done.stderr.strip() or "said nothing").splitlines()[0]
    if done.returncode not in (0, 1) or not report or report["lockstep_broken"] or report["outcome"] == "failed":
        raise SystemExit(f"flight: {build}: {first}")
    print(f"{build.name}: {first}", flush=True)
    nav = message_type("nav_t")
    poses = {}
    for channel, data in read_flight_log(out / "flight.lcm").events:
        if channel == "NAV":
            m = nav.decode(data)
            poses[m.t_us] = m.x_m, m.y_m, m.z_m
    return report, poses


def main(max_time_s: float) -> int:
    work = Path(tempfile.mkdtemp(prefix="noctule-boards-"))
    try:
        native, native_poses = fly(ROOT / "build/release", work / "native", max_time_s)
        board, board_poses = fly(wrapped(work / "build"), work / "aarch64", max_time_s)
        common = sorted(t for t in native_poses if t in board_poses)
        parted = next((t for t in common if math.dist(native_poses[t], board_poses[t]) > PARTED_M), None)
        equal = next((n for n, t in enumerate(common) if native_poses[t] != board_poses[t]), len(common))
        print(f"flight: the first {equal} of {len(common)} estimates are equal bit for bit; " +
              ("never parted" if parted is None else f"parted (over {PARTED_M * 100:g} cm) after {(parted - common[0]) * 1e-6:.1f} s"))
        good = native["outcome"] == board["outcome"] == "completed" and native["collisions"] == board["collisions"] == 0
        for name, tolerance in TOLERANCES.items():
            a, b = results(native)[name], results(board)[name]
            within = a is not None and b is not None and abs(a - b) <= tolerance
            good = good and within
            print(f"flight: {name}: native {a}, aarch64 {b}, tolerance {tolerance:g}{'' if within else ': OUTSIDE'}")
        print(f"flight: {'the same within tolerance' if good else 'NOT the same'}")
        return 0 if good else 1
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 600.0))
