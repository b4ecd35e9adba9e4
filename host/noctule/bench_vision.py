"""`noctule bench vision`: SURF against dlib, OpenCV's SIFT and ORB on real pictures; objects in flights; database under kills and cuts.

Pictures: ../shared/data (or NOCTULE_DATA) with published homographies. Every detector gets the same pictures, the same number of
key points, the same matcher (nearest neighbour, ratio 0.8) and one thread. Times are thread CPU times of alternating runs, medians.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from noctule import vision_abi
from noctule.bench import data_folder, row

RATIO = 0.8            # of Lowe's test, for every detector
CORRECT_PX = 4.0       # a match is correct within this distance of the published homography
REPEATED_OVERLAP = 0.4  # a point is repeated if the circles' overlap error is at most this (Mikolajczyk et al. 2005)
POINTS = 1000          # a picture, of each detector
FOUND_PX = 5.0         # corners of an object in clutter
TIMED = ((100, "100"), (300, "300"))
ROUNDS = 40            # of each detector, taken in turn


def skipped(name: str, why: str) -> dict:
    """A row that could not be measured; it is not judged."""
    return row(f"{name}: skipped: {why}", None, "-")


def read_grey(path: Path) -> np.ndarray:
    """(H, W) uint8."""
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(path)
    return image


def pairs(data: Path) -> list[tuple[str, Path, Path, np.ndarray]]:
    """Name, first and second picture, (3, 3) homography from the first to the second."""
    import cv2

    found = []
    folder = data / "obj_opencv"
    if (folder / "H1to3p.xml").is_file():
        storage = cv2.FileStorage(str(folder / "H1to3p.xml"), cv2.FILE_STORAGE_READ)
        found.append(("graf 1-3", folder / "graf1.png", folder / "graf3.png", storage.getNode("H13").mat()))
    folder = data / "obj_oxford_boat"
    for n in (2, 3, 4):
        if (folder / f"H1to{n}p").is_file():
            found.append((f"boat 1-{n}", folder / "img1.pgm", folder / f"img{n}.pgm", np.loadtxt(folder / f"H1to{n}p")))
    return found


def _opencv(detector, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) x, y, radius and (N, D) descriptors, strongest first."""
    keys, descriptors = detector.detectAndCompute(grey, None)
    order = sorted(range(len(keys)), key=lambda i: -keys[i].response)
    points = np.array([(*keys[i].pt, keys[i].size / 2.0) for i in order], np.float32).reshape(-1, 3)
    return points, descriptors[order]


def _surf_points(features) -> tuple[np.ndarray, np.ndarray]:
    """As _opencv; the radius of a blob of scale s is 2.5 s by custom."""
    return np.column_stack([features.points[:, :2], 2.5 * features.points[:, 2]]), features.descriptors


def dlib_points(grey: np.ndarray, count: int):
    """dlib's features, `count` of them where it finds so many, and what it had to be asked for: it drops points at the border after counting.

    (None, count) where the bench was built without dlib.
    """
    ask = count
    found = vision_abi.dlib_surf(grey, ask)
    while found is not None and len(found.points) < count and ask < 3 * count:
        ask += count - len(found.points)
        found = vision_abi.dlib_surf(grey, ask)
    return found, ask


def detectors(count: int) -> dict:
    """Name -> function of a grey picture that gives (N, 3) points and descriptors, N <= count."""
    import cv2

    cv2.setNumThreads(1)
    out = {"ours": lambda g: _surf_points(vision_abi.surf(g, count))}
    if vision_abi.library("noctule_bench_dlib") is not None:
        out["dlib"] = lambda g: _surf_points(dlib_points(g, count)[0])
    out["SIFT"] = lambda g: tuple(a[:count] for a in _opencv(cv2.SIFT_create(count), g))
    out["ORB"] = lambda g: tuple(a[:count] for a in _opencv(cv2.ORB_create(count), g))
    return out


def match(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(M, 2) indices of matches that pass the ratio test; binary descriptors by Hamming distance."""
    import cv2

    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if first.dtype == np.uint8 else cv2.NORM_L2)
    two = matcher.knnMatch(first, second, k=2)
    return np.array([(m[0].queryIdx, m[0].trainIdx) for m in two if len(m) == 2 and m[0].distance < RATIO * m[1].distance], int).reshape(-1, 2)


def project(H: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N, 2) points through a homography.

    >>> project(np.diag([2.0, 2.0, 1.0]), np.array([[1.0, 3.0]]))
    array([[2., 6.]])
    """
    p = np.column_stack([points[:, :2], np.ones(len(points))]) @ H.T
    return p[:, :2] / p[:, 2:]


def correct(H: np.ndarray, a: np.ndarray, b: np.ndarray, matches: np.ndarray) -> int:
    """Matches within CORRECT_PX of the homography."""
    if not len(matches):
        return 0
    return int((np.hypot(*(project(H, a[matches[:, 0]]) - b[matches[:, 1], :2]).T) < CORRECT_PX).sum())


def repeatability(H: np.ndarray, a: np.ndarray, b: np.ndarray, shape: tuple[int, int]) -> float | None:
    """Share of the points of the part seen in both pictures that were found again at the right place and size.

    A point counts as found again if a circle of the second picture overlaps its own, carried over, with an error of
    intersection over union of at most REPEATED_OVERLAP; both circles are scaled to radius 30 first.
    """
    there = project(H, a)
    inside = (there[:, 0] >= 0) & (there[:, 1] >= 0) & (there[:, 0] < shape[1]) & (there[:, 1] < shape[0])
    back = project(np.linalg.inv(H), b)
    seen = (back[:, 0] >= 0) & (back[:, 1] >= 0)
    # Scale of the homography at each point, by a small step.
    steps = [project(H, a[:, :2] + d) for d in ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))]
    du, dv = steps[0] - steps[1], steps[2] - steps[3]
    scale = np.sqrt(np.abs(du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0]))
    p, r, q = there[inside], (a[:, 2] * scale)[inside], b[seen]
    least = min(len(p), len(q))
    if least == 0:
        return None
    distance = np.hypot(p[:, None, 0] - q[None, :, 0], p[:, None, 1] - q[None, :, 1])
    ratio = 30.0 / r[:, None]
    error = 1.0 - _circle_overlap(distance * ratio, 30.0, q[None, :, 2] * ratio)
    used_a, used_b, hits = set(), set(), 0
    order = np.argsort(error, axis=None)
    for k in order[: int((error <= REPEATED_OVERLAP).sum())]:
        i, j = divmod(int(k), error.shape[1])
        if i not in used_a and j not in used_b:
            used_a.add(i)
            used_b.add(j)
            hits += 1
    return hits / least


def _circle_overlap(d: np.ndarray, r1: float, r2: np.ndarray) -> np.ndarray:
    """Intersection over union of circles of radii r1 and r2 at distance d."""
    r2 = np.broadcast_to(r2, d.shape)
    small = np.minimum(r1, r2)
    with np.errstate(invalid="ignore", divide="ignore"):
        c1 = np.clip((d * d + r1 * r1 - r2 * r2) / (2 * d * r1), -1, 1)
        c2 = np.clip((d * d + r2 * r2 - r1 * r1) / (2 * d * r2), -1, 1)
        lens = r1 * r1 * np.arccos(c1) + r2 * r2 * np.arccos(c2) - 0.5 * np.sqrt(
            np.maximum(0.0, (-d + r1 + r2) * (d + r1 - r2) * (d - r1 + r2) * (d + r1 + r2)))
    area = np.where(d >= r1 + r2, 0.0, np.where(d <= np.abs(r1 - r2), np.pi * small * small, lens))
    return area / (np.pi * (r1 * r1 + r2 * r2) - area)


def matching_rows(data: Path) -> list[dict]:
    """Correct matches and repeatability of each pair; ours over dlib's is judged."""
    rows = []
    for name, first, second, H in pairs(data):
        a_grey, b_grey = read_grey(first), read_grey(second)
        right, line, repeated = {}, [], []
        for label, detect in detectors(POINTS).items():
            (a, da), (b, db) = detect(a_grey), detect(b_grey)
            matches = match(da, db)
            right[label] = correct(H, a, b, matches)
            line.append(f"{label} {right[label]}/{len(matches)} of {min(len(a), len(b))}")
            share = repeatability(H, a, b, b_grey.shape)
            repeated.append(f"{label} {'-' if share is None else format(share, '.2f')}")
        print(f"{name}: correct/matches: {', '.join(line)}; repeatability: {', '.join(repeated)}", flush=True)
        if "dlib" in right:
            rows.append(row(f"{name}: correct matches over dlib's", right["ours"] / max(right["dlib"], 1), "-", "1.0", ">= 1.0"))
        else:
            rows.append(skipped(f"{name}: correct matches over dlib's", "built without dlib"))
        rows.append(row(f"{name}: correct matches over SIFT's", right["ours"] / max(right["SIFT"], 1), "-", None, None, ">= 1.0"))
    return rows


def time_rows(data: Path) -> list[dict]:
    """Time a frame of 320 x 240 at equal numbers of key points, one thread."""
    import time

    import cv2

    cv2.setNumThreads(1)
    pictures = [cv2.resize(read_grey(data / "obj_opencv" / n), (320, 240), interpolation=cv2.INTER_AREA) for n in ("box_in_scene.png", "graf1.png")]
    rows = []
    for wanted, label in TIMED:
        times = {"ours": [], "dlib": [], "SIFT": [], "ORB": []}
        counts = []
        sift, orb = cv2.SIFT_create(wanted), cv2.ORB_create(wanted)
        for picture in pictures:
            reference, ask = dlib_points(picture, wanted)
            count = wanted if reference is None else len(reference.points)
            for _ in range(ROUNDS):
                ours = vision_abi.surf(picture, count)
                times["ours"].append(ours.times_us[0])
                if reference is not None:
                    times["dlib"].append(vision_abi.dlib_surf(picture, ask).times_us[0])
            counts.append((len(ours.points), count))
            for name, detector in (("SIFT", sift), ("ORB", orb)):
                for _ in range(ROUNDS // 4):
                    begin = time.thread_time()
                    detector.detectAndCompute(picture, None)
                    times[name].append(1e6 * (time.thread_time() - begin))
        median = {name: float(np.median(t)) * 1e-3 for name, t in times.items() if t}
        print(f"320 x 240, {label} key points (ours, dlib: {counts}): " + ", ".join(f"{n} {t:.2f} ms" for n, t in median.items()), flush=True)
        rows.append(row(f"SURF, 320 x 240, {label} key points", median["ours"], "ms", f"SIFT {median['SIFT']:.1f}, ORB {median['ORB']:.1f}"))
        if "dlib" in median:
            rows.append(row(f"SURF time over dlib's, {label} key points", median["ours"] / median["dlib"], "-", f"dlib {median['dlib']:.1f} ms", "<= 0.7", "<= 0.3"))
        else:
            rows.append(skipped(f"SURF time over dlib's, {label} key points", "built without dlib"))
    return rows


def find_in(model: np.ndarray, scene: np.ndarray, fit, detect) -> tuple[np.ndarray | None, int]:
    """(3, 3) homography of a picture of an object into a scene, and the matches that agree; None: not found."""
    (a, da), (b, db) = detect(model), detect(scene)
    matches = match(da, db)
    if len(matches) < 4:
        return None, 0
    return fit(np.column_stack([a[matches[:, 0], :2], b[matches[:, 1], :2]]).astype(np.float32))


def clutter_rows(data: Path) -> list[dict]:
    """Objects in clutter: our points, our matches, our homography; the corners are held against SIFT with OpenCV's estimator."""
    import cv2

    def reference(pairs_):
        H, mask = cv2.findHomography(pairs_[:, :2], pairs_[:, 2:], cv2.USAC_MAGSAC, 2.0, maxIters=20000, confidence=0.9999)
        return H, 0 if mask is None else int(mask.sum())

    sift = cv2.SIFT_create()
    rows = []
    scenes = [("box in clutter", "obj_opencv/box.png", "obj_opencv/box_in_scene.png"),
              ("find-object 38", "obj_findobject/38.bmp", "obj_findobject/multi-scene.jpg"),
              ("find-object 39", "obj_findobject/39.bmp", "obj_findobject/multi-scene.jpg")]
    for name, model, scene in scenes:
        if not ((data / model).is_file() and (data / scene).is_file()):
            rows.append(skipped(name, "no data"))
            continue
        a, b = read_grey(data / model), read_grey(data / scene)
        ours, agree = find_in(a, b, vision_abi.plane_fit, lambda g: _surf_points(vision_abi.surf(g, 1500, step_px=1)))
        truth, others = find_in(a, b, reference, lambda g: _opencv(sift, g))
        corners = np.array([[0, 0], [a.shape[1], 0], [a.shape[1], a.shape[0]], [0, a.shape[0]]], float)
        error = None if ours is None or truth is None else float(np.hypot(*(project(ours, corners) - project(truth, corners)).T).max())
        print(f"{name}: {agree} of our matches agree (SIFT {others}), corners within {'-' if error is None else format(error, '.2f')} px", flush=True)
        rows.append(row(f"{name}: greatest corner distance to SIFT's homography", error, "px", None, f"<= {FOUND_PX:g}"))
    return rows


def picture_rows() -> list[dict]:
    """All that needs the shared pictures."""
    data = data_folder()
    if data is None or not (data / "obj_opencv").is_dir():
        return [skipped("SURF on real pictures", "no data")]
    return matching_rows(data) + time_rows(data) + clutter_rows(data)


def bench_vision(quick: bool, fresh: bool) -> list[dict]:
    """Rows of the objects issue."""
    from noctule.bench_objects import object_rows

    return picture_rows() + object_rows(quick, fresh)
