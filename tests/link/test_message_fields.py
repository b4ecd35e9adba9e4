"""Each message between autopilot and bridge, field by field and at its extremes, with pymavlink on the other side and rotations by numpy."""

import itertools
import math

import noctule_lcm
import numpy as np
import pytest
from bridge_peers import Peers, mavlink

HEADINGS = {"north": 0.0, "east": 0.5 * math.pi, "south": math.pi, "west": -0.5 * math.pi}   # yaw of north-east-down, clockwise
G = 9.80665
SEQUENCE = itertools.count(1)


@pytest.fixture(scope="module")
def peers(tmp_path_factory):
    with Peers(tmp_path_factory.mktemp("messages")) as scene:
        scene.nav_runs = False
        scene.heard = {}
        for channel, kind in (("ATTITUDE", noctule_lcm.attitude_t), ("RANGE_UP", noctule_lcm.range_t), ("RANGE_DOWN", noctule_lcm.range_t), ("BARO", noctule_lcm.baro_t)):
            scene.lcm.subscribe(channel, lambda name, data, kind=kind: scene.heard.setdefault(name, []).append(kind.decode(data)))
        scene.run(0.5)
        yield scene


def told(peers, message, channel):
    """What reaches the bus of one message of the autopilot, whose clock has gone on by 1.5 s: no better kind of it is fresh then."""
    store = peers.imu if channel == "IMU" else peers.vehicle if channel == "VEHICLE" else peers.heard.setdefault(channel, [])
    count = len(store)
    peers._autopilot_says(message)
    assert peers._wait(lambda: len(store) > count), f"{message.get_type()} did not arrive on {channel}"
    return store[-1]


def later(peers):
    peers.t_us += 1_500_000
    return peers.t_us


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["most", "least"])
def test_inertial_data_of_every_kind(peers, sign):
    axes = [sign * v for v in (150.0, 90.5, 0.25)]
    turns = [sign * v for v in (30.0, 2.5, 0.001)]
    sample = told(peers, mavlink.MAVLink_highres_imu_message(later(peers), *axes, *turns, 0, 0, 0, 0, 0, 0, 0, 0x3F), "IMU")
    assert (sample.t_us, *sample.accel_m_s2) == pytest.approx((peers.t_us, axes[0], -axes[1], -axes[2]))
    assert tuple(sample.gyro_rad_s) == pytest.approx((turns[0], -turns[1], -turns[2]))
    whole = [32767, -32768, 1] if sign > 0 else [-32768, 32767, -1]
    kinds = (mavlink.MAVLink_scaled_imu_message, mavlink.MAVLink_scaled_imu2_message, mavlink.MAVLink_scaled_imu3_message)
    for kind in kinds:
        sample = told(peers, kind(later(peers) // 1000, *whole, *reversed(whole), 0, 0, 0), "IMU")
        assert (sample.t_us, *sample.accel_m_s2) == pytest.approx((peers.t_us // 1000 * 1000, *(s * 1e-3 * G * v for s, v in zip((1, -1, -1), whole))), rel=1e-6)
        assert tuple(sample.gyro_rad_s) == pytest.approx(tuple(s * 1e-3 * v for s, v in zip((1, -1, -1), reversed(whole))), rel=1e-6)


@pytest.mark.parametrize("heading", HEADINGS.values(), ids=HEADINGS)
@pytest.mark.parametrize("roll,pitch", [(0.0, 0.0), (1.2, 0.4), (-1.2, -0.4), (0.3, 1.5), (-0.3, -1.5)])
def test_attitude_in_both_forms_at_four_headings(peers, heading, roll, pitch):
    cr, sr, cp, sp, cy, sy = *(f(0.5 * a) for a in (roll, pitch, heading) for f in (math.cos, math.sin)),
    q = (cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy)
    quaternion, angles = mavlink.MAVLink_attitude_quaternion_message, mavlink.MAVLink_attitude_message
    for kind, fields in ((quaternion, q), (angles, (roll, pitch, heading))):
        attitude = told(peers, kind(later(peers) // 1000, *fields, 0, 0, 0), "ATTITUDE")
        # Forward-left-up against forward-right-down: the same axis forward, the other two turned round.
        assert (attitude.roll_rad, attitude.pitch_rad) == pytest.approx((roll, -pitch), abs=1e-5)
        vehicle = told(peers, mavlink.MAVLink_extended_sys_state_message(0, 2 if peers.vehicle[-1].landed == 1 else 1), "VEHICLE")
        assert math.cos(vehicle.local_yaw_rad + heading) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("low,high,said,expected", [(10, 1200, 10, 0.10), (10, 1200, 1200, 12.0), (0, 65535, 65535, 655.35), (10, 1200, 9, math.nan), (10, 1200, 1201, math.nan), (10, 1200, 0, math.nan)])
def test_distances_in_whole_centimetres_within_their_limits(peers, low, high, said, expected):
    for orientation, channel in ((mavlink.MAV_SENSOR_ROTATION_PITCH_90, "RANGE_UP"), (mavlink.MAV_SENSOR_ROTATION_PITCH_270, "RANGE_DOWN")):
        r = told(peers, mavlink.MAVLink_distance_sensor_message(later(peers) // 1000, low, high, said, 0, 1, orientation, 255), channel)
        assert (r.t_us, r.range_min_m, r.range_max_m) == pytest.approx((peers.t_us // 1000 * 1000, 0.01 * low, 0.01 * high))
        assert r.range_m == pytest.approx(expected, nan_ok=True)


def test_a_distance_to_the_side_or_without_room_between_its_limits_goes_nowhere(peers):
    counts = {name: len(store) for name, store in peers.heard.items()}
    for orientation, low, high in ((mavlink.MAV_SENSOR_ROTATION_NONE, 10, 1200), (mavlink.MAV_SENSOR_ROTATION_YAW_90, 10, 1200), (mavlink.MAV_SENSOR_ROTATION_PITCH_90, 1200, 1200)):
        peers._autopilot_says(mavlink.MAVLink_distance_sensor_message(later(peers) // 1000, low, high, 100, 0, 1, orientation, 255))
    told(peers, mavlink.MAVLink_distance_sensor_message(later(peers) // 1000, 10, 1200, 100, 0, 1, mavlink.MAV_SENSOR_ROTATION_PITCH_90, 255), "RANGE_UP")
    assert len(peers.heard["RANGE_UP"]) == counts.get("RANGE_UP", 0) + 1 and len(peers.heard.get("RANGE_DOWN", [])) == counts.get("RANGE_DOWN", 0)


@pytest.mark.parametrize("hpa,height_m", [(1013.25, 0.0), (954.61, 500.0), (1100.0, -699.0)])
def test_pressure_is_height_in_the_standard_atmosphere(peers, hpa, height_m):
    baro = told(peers, mavlink.MAVLink_scaled_pressure_message(later(peers) // 1000, hpa, 0.0, 2000), "BARO")
    assert baro.height_m == pytest.approx(height_m, abs=2.0)


@pytest.mark.parametrize("state,landed", [(mavlink.MAV_LANDED_STATE_ON_GROUND, 1), (mavlink.MAV_LANDED_STATE_IN_AIR, 2), (mavlink.MAV_LANDED_STATE_TAKEOFF, 2),
                                          (mavlink.MAV_LANDED_STATE_LANDING, 2), (mavlink.MAV_LANDED_STATE_UNDEFINED, 0)])
def test_landed_state_and_battery_share(peers, state, landed):
    share = {0: 0, 1: 100, 2: 37}[landed]
    peers._autopilot_says(mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, -1, share, 0, 0, 0, 0, 0, 0), mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, -1, -1, 0, 0, 0, 0, 0, 0))
    peers._autopilot_says(mavlink.MAVLink_extended_sys_state_message(0, state))
    peers._autopilot_says(mavlink.MAVLink_system_time_message(0, later(peers) // 1000))
    assert peers._wait(lambda: peers.vehicle[-1].t_us >= peers.t_us // 1000 * 1000)
    assert peers.vehicle[-1].landed == landed
    assert peers.vehicle[-1].battery_remaining == pytest.approx(0.01 * share)      # a share of -1 is not known and changes nothing


@pytest.mark.parametrize("heading", HEADINGS.values(), ids=HEADINGS)
@pytest.mark.parametrize("x,y,z", [(1234.5, -987.25, 41.0), (-0.001, 0.002, -12.0)])
def test_odometry_field_by_field(peers, heading, x, y, z):
    odom = noctule_lcm.odom_t()
    odom.t_us, odom.at_scan, odom.quality = later(peers), 1, 100
    odom.seq = next(SEQUENCE)
    odom.reset_counter = 255
    odom.x_m, odom.y_m, odom.z_m, odom.yaw_rad, odom.roll_rad, odom.pitch_rad = x, y, z, -heading, 0.2, -0.1
    odom.vx_m_s, odom.vy_m_s, odom.vz_m_s, odom.yaw_rate_rad_s = 1.5, -0.75, 0.5, -1.25
    odom.position_var_m2, odom.velocity_var_m2_s2, odom.yaw_var_rad2 = [1e-8, 4.0, 0.25], [0.01, 0.04, 0.09], 0.16
    count = len(Peers.of(peers.at_autopilot, "ODOMETRY"))
    peers._autopilot_says(mavlink.MAVLink_system_time_message(0, peers.t_us // 1000))
    peers.lcm.publish("ODOM", odom.encode())
    assert peers._wait(lambda: len(Peers.of(peers.at_autopilot, "ODOMETRY")) > count)
    m = Peers.of(peers.at_autopilot, "ODOMETRY")[-1]
    assert (m.time_usec, m.frame_id, m.child_frame_id, m.quality, m.reset_counter) == (peers.t_us, mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, 100, 255)
    assert m.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_VISION                   # PX4 takes no other
    assert (m.x, m.y, m.z) == pytest.approx((x, -y, -z))
    body = rotation(0.2, 0.1, heading)                                            # BODY_FRD to LOCAL_FRD
    w, i, j, k = m.q
    assert np.array([[1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)], [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
                     [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)]]) == pytest.approx(body, abs=1e-6)
    assert body @ np.array([m.vx, m.vy, m.vz]) == pytest.approx((1.5, 0.75, -0.5), abs=1e-6)
    assert body @ np.array([m.rollspeed, m.pitchspeed, m.yawspeed]) == pytest.approx((0.0, 0.0, 1.25), abs=1e-6)
    diagonal = (0, 6, 11, 15, 18, 20)
    assert [m.pose_covariance[at] for at in (*diagonal[:3], 20)] == pytest.approx([1e-8, 4.0, 0.25, 0.16])
    assert all(m.pose_covariance[at] == 0.0 for at in range(21) if at not in diagonal)


def rotation(roll, pitch, yaw):
    """Z-Y-X, forward-right-down."""
    def about(axis, angle):
        c, s = math.cos(angle), math.sin(angle)
        return np.array({"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}[axis])

    return about("z", yaw) @ about("y", pitch) @ about("x", roll)
