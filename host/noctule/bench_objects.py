"""The part of `noctule bench vision` that flies: objects found and placed, kills of noctule-vision, its heap over an hour."""

from __future__ import annotations

import json
import random
import signal
import sqlite3
import struct
import subprocess
import time
from pathlib import Path

from noctule import record
from noctule.bench import FOLDER, row
from noctule.settings import FlightSettings

WORLD = "gallery"       # its first flight logs the images: for the heap, the kills and the time a frame
WORLDS = ("two_floor", "gallery")
SEEDS = (1, 2, 3, 4, 5)
QUICK_SEEDS = (1, 4)
WALKS = tuple(range(21, 33))     # held back: nothing was tuned on them (on 1 to 12 it was)
QUICK_WALKS = (21, 22, 24)
MAX_TIME_S = 1500.0
FRAME_MS = 200.0        # between two frames
KILLS, QUICK_KILLS = 100, 10
HOUR_FRAMES, QUICK_FRAMES = 18000, 1500
HEAP_SLACK_BYTES = 65536   # SQLite's page cache and the allocator's own rounding


def fly(world: str, seed: int, weight: float, camera: bool, fresh: bool) -> dict:
    """The report of one flight in-process; kept ones are not flown again. Images are logged for one flight."""
    from noctule import bench, inprocess_flight
    from noctule_sim.world import load_world

    label = f"vision-{world}-{seed}" + ("" if camera else "-blind")
    folder = FOLDER / label
    key = {"programs": bench._programs(), "library": _fingerprint(), "weight": weight, "camera": camera}
    kept = record.read_json(folder / "report.json")
    if kept and not fresh and record.read_json(folder / "bench.json") == key:
        print(f"{label}: kept", flush=True)
        return kept
    settings = FlightSettings(world=world, seed=seed, camera=camera, log_images=camera and (world, seed) == (WORLD, SEEDS[0]), max_time_s=MAX_TIME_S,
                              parameters={"camera_weight": weight})
    result = inprocess_flight.fly(settings, load_world(world), folder)
    (folder / "bench.json").write_text(json.dumps(key) + "\n", encoding="utf-8")
    if camera:
        errors = [o["error_m"] for o in result["objects"] if o["error_m"] is not None]
        print(f"{label}: {result['outcome']} after {result['sim_time_s']:.0f} s, {len(result['objects'])} objects, missed {result['objects_missed']}, "
              f"duplicated {result['objects_duplicated']}, false {result['objects_false']}, error mean {sum(errors) / max(1, len(errors)):.3f} m", flush=True)
    return result


def _fingerprint() -> str:
    import hashlib

    from noctule.processes import build_folder

    path = Path(build_folder()) / "lib" / "libnoctule_vision_abi.so"
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else ""


def flight_rows(world: str, quick: bool, fresh: bool) -> list[dict]:
    """Found, duplicates, false, position error over the seeds; what the camera's weight costs in time."""
    from noctule_sim.world import load_world

    seeds = QUICK_SEEDS if quick else SEEDS
    count = len(load_world(world).objects)
    reports = [fly(world, seed, 1.0, True, fresh) for seed in seeds]
    plain = [fly(world, seed, 0.0, False, fresh) for seed in seeds[:2]]
    errors = [o["error_m"] for r in reports for o in r["objects"] if o["error_m"] is not None]
    cost = sum(r["sim_time_s"] for r in reports[:2]) / sum(r["sim_time_s"] for r in plain)
    name = f"{world}, {count} objects, {len(reports)} seeds"
    return [*_graded(name, count * len(reports), sum(r["objects_missed"] for r in reports), sum(r["objects_duplicated"] for r in reports),
                     sum(r["objects_false"] for r in reports), errors),
            row(f"{name}: collisions", sum(r["collisions"] for r in reports), "-", None, "== 0"),
            row(f"{world}: flight time with camera weight over without", cost, "-")]


def _graded(name: str, count: int, missed: int, twice: int, false: int, errors: list[float]) -> list[dict]:
    return [
        row(f"{name}: found", (count - missed) / count, "-", None, ">= 0.95", ">= 1.0"),
        row(f"{name}: duplicates", twice, "-", None, "== 0"),
        row(f"{name}: false", false, "-", None, "== 0"),
        row(f"{name}: position error, mean", sum(errors) / len(errors) if errors else None, "m", None, "<= 0.15", "<= 0.05"),
        row(f"{name}: position error, greatest", max(errors) if errors else None, "m"),
    ]


def walk_rows(quick: bool, fresh: bool) -> list[dict]:
    """The same over random buildings, without a navigator; what the camera never had in view is not counted. And the time a frame."""
    from noctule import object_walks

    missed = twice = false = count = 0
    errors, times = [], []
    seeds = QUICK_WALKS if quick else WALKS
    for seed in seeds:
        folder = FOLDER / f"vision-walk-{seed}"
        if fresh or not (folder / "shown.json").is_file():
            object_walks.walk(seed, folder)
        graded, frame_ms = object_walks.look(folder)
        print(f"walk {seed}: {graded.found} found, missed {graded.missed}, {graded.duplicated} duplicates, {graded.false} false, "
              f"error mean {sum(graded.errors_m) / max(1, len(graded.errors_m)):.3f} m", flush=True)
        count += graded.found + len(graded.missed)
        missed += len(graded.missed)
        twice += graded.duplicated
        false += graded.false
        errors += graded.errors_m
        times += frame_ms
        (folder / "camera.lcm").unlink()          # a quarter of a gigabyte
        (folder / "shown.json").unlink()
    name = f"{len(seeds)} walks, {count} objects shown"
    return [*_graded(name, count, missed, twice, false, errors),
            row("time a frame, median", percentile(times, 50.0), "ms"), row("time a frame, p99", percentile(times, 99.0), "ms", None, f"<= {FRAME_MS:g}"),
            row("time a frame, greatest", max(times), "ms", None, f"<= {FRAME_MS:g}")]


def percentile(values, share: float) -> float:
    """The value that `share` percent of the values do not exceed, by rank.

    >>> percentile([3.0, 1.0, 2.0], 50.0)
    2.0
    """
    return sorted(values)[min(len(values) - 1, int(len(values) * share / 100.0))]


def recorded(folder: Path) -> list[tuple[str, bytes]]:
    """NAV, SCAN and IMAGE of a flight with logged images, each frame after the pose that it needs."""
    images = [(t, data) for channel, t, data in record.events(folder / "camera.lcm") if channel == "IMAGE"]
    out, k = [], 0
    for channel, t, data in record.events(folder / "flight.lcm"):
        if channel not in ("NAV", "SCAN"):
            continue
        while k < len(images) and images[k][0] < t:
            out.append(("IMAGE", images[k][1]))
            k += 1
        out.append((channel, data))
    return out


def _later(message: bytes, shift_us: int) -> bytes:
    """The same message, its stamp later: t_us is the first field of each type."""
    return message[:8] + struct.pack(">q", struct.unpack_from(">q", message, 8)[0] + shift_us) + message[16:]


def heap_rows(quick: bool) -> list[dict]:
    """Heap in use by the recognition over an hour of frames: a recorded flight again and again."""
    from noctule.vision_abi import Vision

    folder = FOLDER / f"vision-{WORLD}-{SEEDS[0]}"
    messages = recorded(folder)
    frames_wanted = QUICK_FRAMES if quick else HOUR_FRAMES
    path = FOLDER / "vision-heap.db"
    for end in ("", "-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)
    span_us = 1_000_000_000
    frames, lap, warm = 0, 0, None
    begin = time.monotonic()
    with Vision(path) as vision:
        while frames < frames_wanted:
            for channel, data in messages:
                vision.receive(channel, _later(data, lap * span_us))
                if channel == "IMAGE":
                    vision.look()
                    frames += 1
            lap += 1
            if warm is None:
                warm = vision.heap_bytes()
        growth = vision.heap_bytes() - warm
    size = path.stat().st_size / 2**20
    print(f"heap: {frames} frames in {lap} laps, {time.monotonic() - begin:.0f} s, {1e3 * (time.monotonic() - begin) / frames:.1f} ms a frame, "
          f"growth {growth} bytes after the first lap, database {size:.1f} MiB", flush=True)
    return [row(f"heap growth over {frames} frames", growth, "bytes", None, f"<= {HEAP_SLACK_BYTES}"),
            row("database after them", size, "MiB")]


def kill_rows(quick: bool) -> list[dict]:
    """SIGKILL of noctule-vision at random moments; after each the database opens and holds every frame that was answered."""
    import lcm

    from noctule.processes import PortLock, lcm_url, need_program

    program = need_program("noctule-vision")
    folder = FOLDER / f"vision-{WORLD}-{SEEDS[0]}"
    messages = recorded(folder)
    start = next(i for i, (c, _) in enumerate(messages) if c == "IMAGE")
    path = (FOLDER / "vision-kills.db").resolve()
    for end in ("", "-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)
    kind = record.message_type("objects_t")
    chance = random.Random(7)
    wanted = QUICK_KILLS if quick else KILLS
    kills = broken = lost = answered = at_work = 0
    position, shift, worst = start, 0, 0
    with_locks = [PortLock.take_any(), PortLock.take_any()]
    try:
        urls = [lcm_url(lock.port) for lock in with_locks]
        camera, flight = lcm.LCM(urls[0]), lcm.LCM(urls[1])
        answers = []
        camera.subscribe("OBJECTS", lambda _, data: answers.append(kind.decode(data)))
        while kills < wanted:
            process = subprocess.Popen([program, "--lcm-url", urls[0], "--flight-lcm-url", urls[1], "--database", str(path), "--resume",
                                        "--calibration", str(folder / "camera.yaml")], stderr=subprocess.DEVNULL)
            answers.clear()
            begin = time.monotonic()
            # Waits until it answers at all, then kills it at any moment of the next half second.
            end = None
            while True:
                now = time.monotonic()
                if end is None and answers:
                    end = now + chance.uniform(0.0, 0.5)
                if (end is not None and now >= end) or now - begin > 20.0:
                    break
                channel, data = messages[position]
                (camera if channel == "IMAGE" else flight).publish(channel, _later(data, shift))
                if channel == "IMAGE":
                    camera.handle_timeout(40)
                position += 1
                if position == len(messages):
                    position, shift = start, shift + 1_000_000_000
            process.send_signal(signal.SIGKILL)
            process.wait()
            while camera.handle_timeout(20) > 0:
                pass
            kills += 1
            try:
                with sqlite3.connect(path) as base:
                    if base.execute("PRAGMA integrity_check").fetchone()[0] != "ok":
                        broken += 1
                    stamps = {t for (t,) in base.execute("SELECT t_us FROM sighting")}
                    worst = max([worst, *(n for (n,) in base.execute("SELECT count(*) FROM view GROUP BY object"))])
            except sqlite3.DatabaseError:
                broken += 1
                continue
            seen = [a for a in answers if a.looked and any(a.object_id[:a.count])]
            at_work += bool(seen)
            answered += len(seen)
            lost += sum(a.t_us not in stamps for a in seen[-20:])
    finally:
        for lock in with_locks:
            lock.release()
    print(f"kills: {kills}, of them {at_work} with objects in hand, {answered} answered frames with objects, at most {worst} pictures an object", flush=True)
    return [row(f"{kills} kills of noctule-vision: database does not open or is not sound", broken, "-", None, "== 0"),
            row(f"{kills} kills: sightings of answered frames that are lost", lost, "-", None, "== 0"),
            row(f"{kills} kills: answered frames with objects", answered, "-", None, ">= 1"),
            row("most pictures of one object", worst, "-", None, "<= 8")]


def object_rows(quick: bool, fresh: bool) -> list[dict]:
    """All rows that need the renderer."""
    from noctule import vision_abi
    from noctule.bench_vision import skipped
    from noctule.flight import camera_problem

    problem = camera_problem()
    if problem or vision_abi.library("noctule_vision_abi") is None:
        return [skipped("objects in flight", problem or "libnoctule_vision_abi.so is not built")]
    return [r for world in WORLDS for r in flight_rows(world, quick, fresh)] + walk_rows(quick, fresh) + heap_rows(quick) + kill_rows(quick)
