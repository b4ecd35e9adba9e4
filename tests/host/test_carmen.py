"""CARMEN logs: what is read, what is refused, the errors against relations, and the files."""

import gzip
import math

import numpy as np
import pytest
import yaml

from noctule import carmen, cli
from noctule.localise import between, compose
from noctule.record import RecordError
from test_replay import built

needs_library = pytest.mark.skipif(not built(), reason="libnoctule_sim_abi.so is not built here")
DRIFT = 0.02          # of the odometry: rad for each m


def cast(pose, bearings):
    """Ranges to a room of 8 x 7 m with a pier at one wall, turned by 17 degrees."""
    x, y, yaw = pose
    corners = [(-3, -2), (5, -2), (5, 5), (1, 5), (1, 4.3), (-1, 4.3), (-1, 5), (-3, 5)]
    c, s = math.cos(0.297), math.sin(0.297)
    corners = [(c * a - s * b, s * a + c * b) for a, b in corners]
    best = np.full(len(bearings), np.inf)
    dx, dy = np.cos(yaw + bearings), np.sin(yaw + bearings)
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1]):
        ex, ey = x1 - x0, y1 - y0
        det = dx * ey - dy * ex
        with np.errstate(divide="ignore", invalid="ignore"):
            along, share = ((x0 - x) * ey - (y0 - y) * ex) / det, ((x0 - x) * dy - (y0 - y) * dx) / det
        best = np.where((along > 0) & (share >= 0) & (share <= 1) & (along < best), along, best)
    return best


def drive(sweeps=120):
    """True and odometry poses, each (N, 3), from (0, 0, 0): an oval, with a heading error that grows with the path."""
    true, odometry = [(0.0, 0.0, 0.0)], [(0.0, 0.0, 0.0)]
    for k in range(sweeps - 1):
        step = (0.06, 0.0, 0.05 if k % 40 > 10 else 0.0)
        true.append(compose(true[-1], step))
        odometry.append(compose(odometry[-1], (step[0] * 1.01, 0.0, step[2] + DRIFT * step[0])))
    return np.array(true), np.array(odometry)


def write_log(path, robotlaser=False, odom_lines=False, laser_x_m=0.0, seed=1):
    """A log of that drive: 10 sweeps a second, 1 cm noise."""
    noise = np.random.default_rng(seed)
    true, odometry = drive()
    lines = ["# made for a test"]
    if robotlaser:
        bearings = -2.0 + np.arange(400) * 0.01
    else:
        bearings = -math.pi / 2 + np.arange(360) * math.pi / 360
    for k, (pose, told) in enumerate(zip(true, odometry)):
        t = 1000.0 + 0.1 * k
        laser = compose(pose, (laser_x_m, 0.0, 0.0))
        ranges = cast(laser, bearings) + 0.01 * noise.standard_normal(len(bearings))
        ranges[::97] = 20.0 if robotlaser else 81.9       # nothing came back
        told_laser = compose(told, (laser_x_m, 0.0, 0.0))
        poses = " ".join(f"{v:.6f}" for v in (*told_laser, *told))
        text = " ".join(f"{r:.3f}" for r in ranges)
        if odom_lines and k:
            middle = compose(odometry[k - 1], tuple(0.5 * v for v in between(odometry[k - 1], told)))
            lines.append("ODOM " + " ".join(f"{v:.6f}" for v in middle) + f" 0 0 0 {t - 0.05:.6f} host 0")
        if robotlaser:
            lines.append(f"ROBOTLASER1 0 -2.0 3.99 0.01 20.0 0.01 0 {len(ranges)} {text} 0 {poses} 0 0 0 0 0 {t:.6f} host {t:.6f}")
        else:
            lines.append(f"FLASER {len(ranges)} {text} {poses} {t:.6f} host {t - 1000.0:.6f}")
    data = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return true, odometry


@pytest.mark.parametrize("name, robotlaser", [("a.clf", False), ("a.clf.gz", False), ("b.clf.gz", True)])
def test_lines_are_read(tmp_path, name, robotlaser):
    _, odometry = write_log(tmp_path / name, robotlaser, odom_lines=True)
    log = carmen.read(tmp_path / name)
    assert len(log.ranges) == 120 and len(log.odometry_t_s) == 239 and log.bad_lines == 0 and not log.cut
    np.testing.assert_allclose(log.scan_pose, odometry, atol=1e-6)
    assert np.all(np.diff(log.odometry_t_s) > 0) and log.scan_t_s[1] == pytest.approx(1000.1)
    layout = log.layouts[0]
    if robotlaser:
        assert (layout.bearing_first_rad, layout.bearing_increment_rad, layout.range_max_m) == (-2.0, 0.01, 20.0)
        assert np.isinf(log.ranges[3][97])               # the reach is known: nothing within it
    else:
        assert layout.bearing_first_rad == pytest.approx(-math.pi / 2)
        assert layout.bearing_increment_rad == pytest.approx(math.pi / 360)
        assert np.isnan(log.ranges[3][97])               # it is not known: nothing can be said


@pytest.mark.parametrize("count, step_deg", [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)])
def test_bearings_of_half_a_circle(count, step_deg):
    first, step = carmen._flaser_bearings(count)
    assert math.degrees(first) == pytest.approx(-90.0) and math.degrees(step) == pytest.approx(step_deg)


@pytest.mark.parametrize("name", ["a.clf", "a.clf.gz"])
def test_a_cut_log_gives_what_it_holds(tmp_path, name):
    path = tmp_path / name
    write_log(path)
    data = path.read_bytes()
    path.write_bytes(data[:len(data) * 2 // 3])
    log = carmen.read(path)
    assert log.cut and 60 < len(log.ranges) < 90


def test_bad_lines_are_counted_and_do_no_harm(tmp_path):
    path = tmp_path / "a.clf"
    write_log(path)
    lines = path.read_text().splitlines()
    whole = carmen.read(path)
    bad = ["FLASER", "FLASER x 1 2 3", "FLASER 360 1 2 3", lines[5].replace("1000.4", "nan", 1).replace("FLASER 360", "FLASER 361"),
           "ODOM 1 2", "ODOM a b c 0 0 0 1 host 1", "ROBOTLASER1 0 0 0", "ODOM nan 0 0 0 0 0 1003.0 host 1", "ODOM 0 0 0 0 0 0 inf host 1"]
    path.write_text("\n".join(lines[:40] + bad + ["SYNC x", "PARAM a b", lines[20]] + lines[40:]) + "\n")
    log = carmen.read(path)
    assert log.bad_lines == len(bad) and log.other_lines == 2 and log.late == 1
    assert log.scan_t_s == whole.scan_t_s and log.odometry_pose == whole.odometry_pose


def test_covariance_counts_the_way_between_and_not_its_end_only(tmp_path):
    log = carmen.Log()
    log.scan_t_s, log.scan_pose = [0.0, 1.0], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    log.odometry_t_s, log.odometry_pose = [0.0, 0.5, 1.0], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.3), (0.0, 0.0, 0.0)]
    noise = carmen.OdometryNoise(0.0, 0.0, 0.1, 0.05, 0.2, 0.0)
    (motion, covariance) = carmen.increments(log, noise)[1]
    assert motion == pytest.approx((0.0, 0.0, 0.0, 1.0))
    assert math.sqrt(covariance[0]) == pytest.approx(0.2) and math.sqrt(covariance[5]) == pytest.approx(0.05 * 2.0 + 0.2 * 0.6)


def test_poses_between_sweeps_follow_odometry_and_meet_both_ends():
    """Turned map, drifting odometry: at the sweeps the estimate, between them the odometry's bend with its error spread."""
    log = carmen.Log()
    log.odometry_t_s = [0.0, 1.0, 2.0]
    log.odometry_pose = [(0.0, 0.0, 0.0), (1.0, 0.5, 0.0), (2.0, 0.0, 0.0)]
    log.scan_t_s, log.scan_pose = [0.0, 2.0], [log.odometry_pose[0], log.odometry_pose[2]]
    turn = math.pi / 2
    poses = np.array([(5.0, 5.0, turn), (5.0, 7.2, turn)])     # the odometry measured 2.0 m of 2.2 m
    t = np.array(log.scan_t_s)
    assert carmen.pose_at(log, t, poses, 0.0) == pytest.approx(poses[0])
    assert carmen.pose_at(log, t, poses, 2.0) == pytest.approx(poses[1])
    assert carmen.pose_at(log, t, poses, 1.0) == pytest.approx((4.5, 6.1, turn))
    assert carmen.pose_at(log, t, poses, 4.0) is None and carmen.pose_at(log, t, poses, -3.0) is None


def test_relation_errors_are_kuemmerles(tmp_path):
    log = carmen.Log()
    log.scan_t_s = log.odometry_t_s = [0.0, 1.0, 2.0]
    log.scan_pose = log.odometry_pose = [(0.0, 0.0, 0.3), (1.0, 0.0, 0.3), (2.0, 0.0, 0.3)]
    poses = np.array([(0.0, 0.0, 1.0), (0.0, 1.0, 1.0), (0.0, 2.0, 1.0)])
    rows = []
    for a, b in ((0, 1), (0, 2)):
        truth = between(poses[a], poses[b])
        rows.append((float(a), float(b), *compose(truth, (0.03, 0.04, 0.1))))
    rows.append((0.0, 99.0, 0.0, 0.0, 0.0))
    file = tmp_path / "r.relations"
    file.write_text("# comment\n" + "\n".join(f"{a} {b} {float(x)!r} {float(y)!r} 0 0 0 {float(yaw)!r}" for a, b, x, y, yaw in rows) + "\n")
    errors = carmen.relation_errors(log, np.array(log.scan_t_s), poses, carmen.read_relations(file))
    np.testing.assert_allclose(errors.translation_m, 0.05, atol=1e-12)
    np.testing.assert_allclose(errors.rotation_rad, 0.1, atol=1e-12)
    assert errors.unused == 1 and "1 outside" in errors.text()


@needs_library
@pytest.mark.parametrize("robotlaser, laser_x_m", [(False, 0.0), (True, 0.0), (False, 0.4)])
def test_the_firmware_corrects_drifting_odometry(tmp_path, robotlaser, laser_x_m):
    path = tmp_path / "a.clf"
    true, odometry = write_log(path, robotlaser, laser_x_m=laser_x_m)
    log = carmen.read(path)
    assert log.mounting == pytest.approx((laser_x_m, 0.0, 0.0), abs=1e-4)
    track = carmen.track(log)
    assert np.hypot(*(odometry - true)[:, :2].T).max() > 0.10
    assert np.hypot(*(track.poses - true)[:, :2].T).max() < 0.02
    assert track.counters["lost"] == 0 and track.counters["refused_samples"] == 0
    again = carmen.track(log)
    np.testing.assert_array_equal(track.poses, again.poses)
    np.testing.assert_array_equal(track.grid[0], again.grid[0])


@needs_library
def test_the_command_writes_trajectory_map_and_relations(tmp_path, capsys):
    true, _ = write_log(tmp_path / "a.clf.gz")
    relations = tmp_path / "a.relations"
    relations.write_text("".join(f"{1000.0 + 0.1 * a} {1000.0 + 0.1 * b} {d[0]} {d[1]} 0 0 0 {d[2]}\n"
                                 for a, b in ((0, 60), (10, 100)) for d in [between(true[a], true[b])]))
    out = tmp_path / "out"
    assert cli.main(["replay", str(tmp_path / "a.clf.gz"), "--out", str(out), "--relations", str(relations)]) == 0
    text = capsys.readouterr().out
    assert "120 sweeps of 360 beams" in text and "relations: 2 used" in text and "us median" in text
    rows = np.loadtxt(out / "trajectory.txt")
    assert rows.shape == (120, 4) and np.hypot(*(rows[:, 1:3] - true[:, :2]).T).max() < 0.02
    tum = np.loadtxt(out / "trajectory.tum")
    assert tum.shape == (120, 8)
    np.testing.assert_allclose(2.0 * np.arctan2(tum[:, 6], tum[:, 7]), rows[:, 3], atol=1e-5)
    # The map, read as ROS map_server reads it: walls where they are, free where the robot went.
    head = yaml.safe_load((out / "map.yaml").read_text())
    with (out / "map.pgm").open("rb") as file:
        assert file.readline() == b"P5\n"
        width, height = (int(v) for v in file.readline().split())
        assert file.readline() == b"255\n"
        image = np.frombuffer(file.read(), np.uint8).reshape(height, width)

    def value(x, y):
        column, row = ((v - o) / head["resolution"] for v, o in zip((x, y), head["origin"]))
        return image[height - 1 - math.floor(row), math.floor(column)]

    assert all(value(x, y) == 254 for x, y in true[:, :2])
    bearings = np.linspace(-1.4, 1.4, 60)
    hits = [(r * math.cos(b), r * math.sin(b)) for r, b in zip(cast((0.0, 0.0, 0.0), bearings), bearings)]
    near = [min(value(x + dx, y + dy) for dx in (-0.1, 0.0, 0.1) for dy in (-0.1, 0.0, 0.1)) for x, y in hits]
    assert np.mean(np.array(near) == 0) > 0.95
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")


@needs_library
def test_a_strange_log_ends_in_poses_all_the_same(tmp_path):
    """NaN and negative ranges, one sweep of another size, a gap of minutes, a jump of the odometry."""
    path = tmp_path / "a.clf"
    write_log(path)
    log = carmen.read(path)
    log.ranges[10][:] = np.nan
    log.ranges[20][:100] = -1.0
    log.ranges[30] = log.ranges[30][:7]
    log.scan_t_s[60:] = [t + 400.0 for t in log.scan_t_s[60:]]
    track = carmen.track(log)
    assert np.isfinite(track.poses).all() and track.counters["refused_beams"] > 400


@needs_library
def test_out_has_a_default_and_a_parameter_changes_the_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "a.clf")
    rows = []
    for more in ([], ["--param", "scan_match=0"]):
        assert cli.main(["replay", "a.clf", "--no-map", *more]) == 0
        rows.append(np.loadtxt(tmp_path / "runs" / "replay-a" / "trajectory.txt"))
    assert not np.array_equal(*rows)


def relations_between(rng, log, pairs, clock_s, point, jitter_s=0.0):
    """Relations (M, 5) between sweeps i and j of a log whose poses are right, stamped by a clock of their own, of a point of their own."""
    rows = []
    for i, j in pairs:
        a, b = (compose(log.scan_pose[k], (*point, 0.0)) for k in (i, j))
        stamps = [log.scan_t_s[k] - clock_s + jitter_s * rng.uniform(-1.0, 1.0) for k in (i, j)]
        rows.append((*stamps, *between(a, b)))
    return np.array(rows)


def winding_log(sweeps=300, gap_s=0.25):
    """Poses of a robot that winds through a plane, a sweep every 0.25 s; odometry is true."""
    log, pose = carmen.Log(), (0.0, 0.0, 0.0)
    for k in range(sweeps):
        log.scan_t_s.append(k * gap_s)
        log.scan_pose.append(pose)
        pose = compose(pose, (0.08, 0.0, 0.12 * math.sin(0.11 * k) + 0.06 * math.sin(0.7 * k)))
    log.odometry_t_s, log.odometry_pose = list(log.scan_t_s), list(log.scan_pose)
    return log


def test_relations_are_told_on_a_clock_and_of_a_point_of_their_own():
    """Stamps 0.13 s off and uneven, a point 4 cm ahead: found on one half, and the other half then agrees; as they stand they do not."""
    rng, log = np.random.default_rng(7), winding_log()
    t_s, poses = np.array(log.scan_t_s), np.array(log.scan_pose)
    relations = relations_between(rng, log, [(k, k + int(rng.integers(4, 60))) for k in range(4, 230)], -0.13, (0.04, -0.01), 0.02)
    convention, errors = carmen.calibrated_errors(log, t_s, poses, relations)
    assert convention.same_sweep_s > 0.0 and -0.16 <= convention.clock_s <= -0.05
    assert (convention.x_m, convention.y_m) == pytest.approx((0.04, -0.01), abs=1e-3)
    assert errors.translation_m.max() < 1e-3 and errors.rotation_rad.max() < 1e-6 and len(errors.translation_m) == 113
    plain = carmen.relation_errors(log, t_s, poses, relations)
    assert plain.translation_m.mean() > 0.01 and plain.rotation_rad.mean() > 0.005


def test_relations_as_the_log_tells_are_left_as_they_are():
    rng, log = np.random.default_rng(8), winding_log()
    del log.scan_t_s[5::2], log.scan_pose[5::2]     # half of the sweeps are missing: times between them, by odometry
    full = winding_log()
    relations = relations_between(rng, full, [(k, k + int(rng.integers(4, 60))) for k in range(4, 230)], 0.0, (0.0, 0.0))
    convention = carmen.calibrate(log, np.array(log.scan_t_s), np.array(log.scan_pose), relations)
    assert (convention.clock_s, convention.same_sweep_s) == (0.0, 0.0)
    assert math.hypot(convention.x_m, convention.y_m) < 1e-4


def test_relations_from_somewhere_else_calibrate_nothing():
    log = winding_log(20)
    far = np.array([(1e6, 1e6 + 1.0, 0.1, 0.0, 0.0)] * 4)
    convention, errors = carmen.calibrated_errors(log, np.array(log.scan_t_s), np.array(log.scan_pose), far)
    assert convention == carmen.Convention() and "none of 2" in errors.text()
