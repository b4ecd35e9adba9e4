"""Every frame conversion of the real noctule-bridge at four headings, going up and down, against pymavlink and rotations written here anew."""

import json
import math
from pathlib import Path

import noctule_lcm
import numpy as np
import pytest
from bridge_peers import Peers, mavlink

ROOT = Path(__file__).resolve().parents[2]
SPEED, CLIMB = 0.5, 0.25


def rotation(w, x, y, z):
    """The matrix of a unit quaternion (from child to parent)."""
    v = np.array([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * (np.outer(v, v) - v @ v * np.eye(3))


@pytest.fixture(scope="module")
def peers(tmp_path_factory):
    with Peers(tmp_path_factory.mktemp("frames")) as scene:
        assert scene.start()
        yield scene


@pytest.fixture(scope="module")
def older(tmp_path_factory):
    with Peers(tmp_path_factory.mktemp("older"), parameters="link_vision_message = 1\n") as scene:
        scene.run(1.0)
        yield scene


@pytest.mark.parametrize("up", [1.0, -1.0], ids=["up", "down"])
@pytest.mark.parametrize("heading", [0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi], ids=["north", "west", "south", "east"])
def test_pose_velocity_and_setpoint_at_four_headings(peers, heading, up):
    ahead = (math.cos(heading), math.sin(heading))
    odom, nav = peers.odom, peers.nav
    odom.x_m, odom.y_m, odom.z_m, odom.yaw_rad = 0.3, 0.2, 1.0, heading
    odom.roll_rad, odom.pitch_rad = 0.1, 0.05
    odom.vx_m_s, odom.vy_m_s, odom.vz_m_s, odom.yaw_rate_rad_s = SPEED * ahead[0], SPEED * ahead[1], up * CLIMB, 0.2
    nav.setpoint_x_m, nav.setpoint_y_m, nav.setpoint_z_m, nav.setpoint_yaw_rad = 0.3 + 0.1 * ahead[0], 0.2 + 0.1 * ahead[1], 1.0 + 0.1 * up, heading
    nav.setpoint_vx_m_s, nav.setpoint_vy_m_s, nav.setpoint_vz_m_s = SPEED * ahead[0], SPEED * ahead[1], up * CLIMB
    peers.run(0.2)
    m = Peers.of(peers.at_autopilot, "ODOMETRY")[-1]
    body = rotation(*m.q)                                             # BODY_FRD to LOCAL_FRD
    nose, left_wing = body[:, 0], -body[:, 1]
    # Map is forward-left-up: its x is LOCAL_FRD's x, its y and z have the other sign.
    assert (m.x, m.y, m.z) == pytest.approx((0.3, -0.2, -1.0))
    assert nose[:2] == pytest.approx((math.cos(0.05) * ahead[0], -math.cos(0.05) * ahead[1]), abs=1e-5)
    assert nose[2] == pytest.approx(math.sin(0.05), abs=1e-5)         # pitch above zero is nose down: towards positive z
    assert left_wing[2] < 0.0                                         # roll above zero: the left wing is up
    assert body @ np.array([m.vx, m.vy, m.vz]) == pytest.approx((SPEED * ahead[0], -SPEED * ahead[1], -up * CLIMB), abs=1e-5)
    assert body @ np.array([m.rollspeed, m.pitchspeed, m.yawspeed]) == pytest.approx((0.0, 0.0, -0.2), abs=1e-5)
    s = Peers.of(peers.at_autopilot, "SET_POSITION_TARGET_LOCAL_NED")[-1]
    assert (s.x, s.y, s.z) == pytest.approx((0.3 + 0.1 * ahead[0], -0.2 - 0.1 * ahead[1], -1.0 - 0.1 * up), abs=1e-6)
    assert (s.vx, s.vy, s.vz) == pytest.approx((SPEED * ahead[0], -SPEED * ahead[1], -up * CLIMB), abs=1e-6)
    assert math.cos(s.yaw + heading) == pytest.approx(1.0, abs=1e-6)  # yaw of forward-right-down is clockwise


@pytest.mark.parametrize("up", [1.0, -1.0], ids=["up", "down"])
@pytest.mark.parametrize("heading", [0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi], ids=["north", "west", "south", "east"])
def test_the_autopilots_position_comes_back_in_map(older, heading, up):
    older.odom.x_m, older.odom.y_m, older.odom.z_m = 2.0 * math.cos(heading), 2.0 * math.sin(heading), 0.5 * up
    older.run(0.5)
    v = older.vehicle[-1]
    assert (v.local_x_m, v.local_y_m, v.local_z_m) == pytest.approx((older.odom.x_m, older.odom.y_m, 0.5 * up), abs=1e-6)


def test_the_buttons_for_qgroundcontrol_are_the_commands_of_the_bridge():
    actions = json.loads((ROOT / "docs" / "qgroundcontrol_actions.json").read_text())
    assert (actions["version"], actions["fileType"]) == (1, "MavlinkActions")
    commands = {a["label"].split(": ")[1]: (a["mavCmd"], a.get("param1")) for a in actions["actions"]}
    assert all(a["compId"] == mavlink.MAV_COMP_ID_ONBOARD_COMPUTER and a["description"] for a in actions["actions"])
    assert commands == {"start": (mavlink.MAV_CMD_MISSION_START, None), "pause": (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0),
                        "resume": (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1), "return": (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, None),
                        "land": (mavlink.MAV_CMD_NAV_LAND, None), "abort": (mavlink.MAV_CMD_USER_1, None)}


@pytest.mark.parametrize("up", [1.0, -1.0], ids=["up", "down"])
@pytest.mark.parametrize("heading", [0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi], ids=["north", "west", "south", "east"])
def test_the_older_vision_message_at_four_headings(older, heading, up):
    odom = older.odom
    odom.x_m, odom.y_m, odom.z_m, odom.yaw_rad = 3.0 * math.cos(heading), 3.0 * math.sin(heading), 1.0 + 0.5 * up, heading
    odom.roll_rad, odom.pitch_rad = 0.1 * up, -0.05 * up
    older.run(0.2)
    m = Peers.of(older.at_autopilot, "VISION_POSITION_ESTIMATE")[-1]
    assert m.usec == older.t_us
    assert (m.x, m.y, m.z) == pytest.approx((odom.x_m, -odom.y_m, -odom.z_m), abs=1e-6)
    assert (m.roll, m.pitch) == pytest.approx((0.1 * up, 0.05 * up), abs=1e-6)      # nose up is above zero there, below zero in forward-left-up
    assert math.cos(m.yaw + heading) == pytest.approx(1.0, abs=1e-6)
    assert not Peers.of(older.at_autopilot, "ODOMETRY")


@pytest.mark.parametrize("side,bearing", [("ahead", 0.0), ("right", -0.5 * math.pi), ("behind, to the left", 0.74 * math.pi), ("left", 0.5 * math.pi)])
def test_an_obstacle_is_told_where_it_stands_seen_from_the_vehicle(peers, side, bearing):
    scan = noctule_lcm.scan_t()
    scan.count, scan.bearing_first_rad, scan.bearing_increment_rad = 1080, -0.75 * math.pi, 1.5 * math.pi / 1079
    scan.range_min_m, scan.range_max_m = 0.06, 10.0
    bearings = scan.bearing_first_rad + scan.bearing_increment_rad * np.arange(1080)
    scan.range_m = [2.0 if abs(b - bearing) < 0.01 else 5.0 for b in bearings] + [math.nan] * 120
    peers.odom.roll_rad = peers.odom.pitch_rad = 0.0
    for _ in range(6):
        peers.tick()
        scan.t_us = peers.t_us
        peers.lcm.publish("SCAN", scan.encode())
    peers.run(0.2)
    m = Peers.of(peers.at_autopilot, "OBSTACLE_DISTANCE")[-1]
    assert m.time_usec > scan.t_us - 200_000
    assert (m.frame, m.increment_f, m.angle_offset, m.min_distance, m.max_distance) == (mavlink.MAV_FRAME_BODY_FRD, 5.0, 0.0, 6, 1000)
    near = [n for n, cm in enumerate(m.distances) if cm < 400]
    clockwise = math.degrees(-bearing) % 360.0                        # of forward-right-down
    assert near and all(abs((5.0 * n - clockwise + 180.0) % 360.0 - 180.0) <= 5.0 for n in near), (side, near)
    assert all(abs(m.distances[n] - 200) <= 12 for n in near)         # the laser sits a little off the middle
    assert all(cm == 65535 for n, cm in enumerate(m.distances) if 145.0 <= 5.0 * n <= 215.0)   # the laser does not look there
