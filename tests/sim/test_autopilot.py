import math

import numpy as np
import pytest

from fixture import Flight, hold
from noctule_sim.autopilot import Autopilot, Landed, Mode
from noctule_sim.autopilot_estimator import Estimator
from noctule_sim.simulation import SetpointIn
from noctule_sim.vehicle import GRAVITY_M_S2, Airframe


def ramp(u, length, speed=1.0, accel=1.0):
    """Position and velocity along a line with a trapezoid of speed."""
    rise = speed / accel
    if u <= 0.0:
        return 0.0, 0.0
    if u < rise:
        return 0.5 * accel * u * u, accel * u
    if u < length / speed:
        return 0.5 * speed * rise + speed * (u - rise), speed
    if u < length / speed + rise:
        left = length / speed + rise - u
        return length - 0.5 * accel * left * left, accel * left
    return length, 0.0


def tour(t_s):
    """Up, 5 m forth and back to the left at 1 m/s, down."""
    climb = min(max(t_s - 3.0, 0.0) * 0.5, 0.88)
    forth, speed_forth = ramp(t_s - 8.0, 5.0)
    back, speed_back = ramp(t_s - 16.0, 5.0)
    z, vz = 0.12 + climb, 0.5 if 0.0 < climb < 0.88 else 0.0
    if t_s > 24.0:
        z, vz = max(-0.2, 1.0 - 0.4 * (t_s - 24.0)), -0.4 if t_s < 27.0 else 0.0
    return SetpointIn(forth, 0.6 * back, z, speed_forth, 0.6 * speed_back, vz, 0.0)


@pytest.fixture(scope="module")
def toured():
    return Flight(setpoints=tour).run(40.0)


def test_smooth_setpoints_are_tracked(toured):
    t, true = toured.t_s, toured.true
    flying = (t > 8.0) & (t < 24.0)
    wanted = np.array([tour(s)[:3] for s in t[flying]])
    off = np.hypot(*(true[flying, :2] - wanted[:, :2]).T)
    assert off.mean() < 0.04 and off.max() < 0.10
    assert np.abs(true[flying, 2] - 1.0).max() < 0.04


def test_it_lands_detects_it_and_disarms(toured):
    assert toured.simulation.outcome.name == "landed"
    assert toured.heard("Takeoff") < toured.heard("Landing detected") < toured.heard("Disarmed by landing")
    assert toured.simulation.collisions == 0


def test_believed_position_and_tilt_follow_the_truth(toured):
    flying = (toured.t_s > 4.0) & (toured.t_s < 27.0)
    off = np.abs(toured.believed - toured.true)[flying]
    assert off[:, :3].max() < 0.03 and off[:, 3].max() < 0.01
    # What the accelerometer's bias hides: 0.05 m/s^2 on each of two axes is 0.41 degrees.
    assert math.degrees(np.median(toured.tilt_error_rad[flying])) < 0.6


def test_a_step_settles_without_much_overshoot():
    flight = Flight(setpoints=lambda t: SetpointIn(1.0 if t > 8.0 else 0.0, 0, 1.0, 0, 0, 0, 0)).run(16.0)
    x = flight.true[:, 0]
    assert x[flight.t_s > 8.0].max() < 1.15
    assert np.abs(x[flight.t_s > 12.0] - 1.0).max() < 0.05


def test_yaw_reaches_its_setpoint_through_pi():
    flight = Flight(setpoints=lambda t: SetpointIn(0, 0, 1.0, 0, 0, 0, 0.0 if t < 6 else 3.0 if t < 10 else -3.0)).run(14.0)
    turn = np.unwrap(flight.true[:, 3])
    assert abs(math.remainder(flight.true[-1, 3] + 3.0, 2 * math.pi)) < 0.03
    assert turn[-1] == pytest.approx(2 * math.pi - 3.0, abs=0.05)


def test_arming_is_refused_without_odometry():
    flight = Flight(mute=lambda t: True).run(4.0)
    assert flight.heard("Arming denied") and not flight.simulation.autopilot.armed


def test_arming_is_refused_on_lost_quality():
    autopilot = Autopilot(Airframe())
    autopilot.mode = Mode.hold
    for k in range(1, 1000):
        autopilot.imu(4000 * k, 0.004, 0, 0, GRAVITY_M_S2, 0, 0, 0)
        autopilot.odometry(4000 * k, 0, 0, 0.1, 0, 0, 0, 0, -1, 0)
    assert "ODOMETRY" in autopilot.arm()


def test_offboard_wants_setpoints_for_a_second_and_a_half():
    refused = Flight(setpoints=lambda t: hold(t) if t > 1.5 else None, arm_at_s=2.0).run(3.0)
    assert refused.heard("denied: setpoints must flow")
    slow = Flight(setpoints=lambda t: hold(t) if round(t * 20) % 14 == 0 else None, arm_at_s=4.0).run(5.0)   # 1.4 Hz
    assert slow.heard("denied") and slow.simulation.autopilot.mode is Mode.hold
    enough = Flight(setpoints=lambda t: hold(t) if round(t * 20) % 8 == 0 else None, arm_at_s=4.0).run(4.5)             # 2.5 Hz
    assert enough.simulation.autopilot.mode is Mode.offboard


def test_guided_wants_no_stream():
    assert Flight(flavour="ardupilot", setpoints=lambda t: hold(t) if t > 1.9 else None).run(3.0).heard("Armed")


def test_px4_lands_when_setpoints_stop():
    flight = Flight(faults={"setpoint-cut": 10.0}).run(30.0)
    assert flight.heard("offboard control lost") == pytest.approx(11.05, abs=0.2)
    assert flight.heard("AUTO.LOITER") == pytest.approx(11.05, abs=0.2) and flight.heard("AUTO.LAND") == pytest.approx(13.05, abs=0.2)
    assert flight.simulation.outcome.name == "landed"


def test_px4_with_a_global_origin_does_not_land_where_it_is():
    def flown(origin):
        flight = Flight(faults={"setpoint-cut": 10.0})
        flight.simulation.autopilot.origin_given = origin
        flight.run(18.0)
        return np.hypot(*flight.true[-1, :2])

    assert flown(False) < 0.2 and flown(True) > 2.0


def test_ardupilot_holds_on_position_targets_and_stops_on_velocity_targets():
    still = Flight(flavour="ardupilot", faults={"setpoint-cut": 10.0}).run(20.0)
    assert still.heard("timed out") is None and still.true[-1, 2] == pytest.approx(1.0, abs=0.05)
    moving = Flight(flavour="ardupilot", faults={"setpoint-cut": 10.0},
                    setpoints=lambda t: SetpointIn(max(0.0, t - 8) * 0.3, 0, 1.0, 0.3 if t > 8 else 0.0, 0, 0, 0)).run(20.0)
    assert moving.heard("timed out") == pytest.approx(13.05, abs=0.2)
    # It flies on for these three seconds, and comes back to nothing: the target moved with it.
    at = lambda t: moving.true[np.searchsorted(moving.t_s, t), 0]
    assert at(13.0) - at(10.0) == pytest.approx(0.9, abs=0.15) and moving.true[-1, 0] > at(13.0) - 0.1


def test_without_odometry_the_position_drifts_and_the_failsafe_lands_it():
    flight = Flight(faults={"odometry-cut": 12.0}, noise_m=0.02).run(40.0)
    off = np.hypot(*(flight.believed - flight.true)[:, :2].T)
    aided, alone = (flight.t_s > 6.0) & (flight.t_s < 12.0), flight.t_s > 12.0
    assert flight.heard("position lost") == pytest.approx(17.05, abs=0.2)
    assert off[alone].max() > 3.0 * off[aided].mean()
    assert flight.simulation.outcome.name == "landed"


def test_ardupilot_notices_the_loss_of_vision_three_seconds_later_than_px4():
    flight = Flight(flavour="ardupilot", faults={"odometry-cut": 12.0}, noise_m=0.02).run(45.0)
    assert flight.heard("EKF variance") == pytest.approx(20.05, abs=0.2) and flight.heard("Mode LAND") == pytest.approx(20.05, abs=0.2)
    assert flight.simulation.outcome.name == "landed"


def test_ardupilot_refuses_to_arm_until_its_sensors_agree():
    autopilot = Autopilot(Airframe(), "ardupilot")
    autopilot.mode = Mode.offboard
    answers = {}
    for k in range(1, 6500):
        autopilot.imu(4000 * k, 0.004, 0, 0, GRAVITY_M_S2, 0, 0, 0)
        autopilot.odometry(4000 * k, 0, 0, 0.1, 0, 0, 0, 0, 90, 0)
        if k in (6200, 6300):
            answers[k] = autopilot.arm()
    assert "Accels inconsistent" in answers[6200] and answers[6300] is None


def test_the_autopilot_flies_what_it_is_told_not_the_truth():
    """ODOMETRY that lies by a slow drift takes the vehicle with it."""
    flight = Flight()
    s = flight.simulation
    inner = s.post_odometry
    s.post_odometry = lambda o: inner(o._replace(x_m=o.x_m - 0.1 * max(0.0, o.t_us * 1e-6 - 6.0)))
    flight.run(16.0)
    assert flight.true[-1, 0] == pytest.approx(1.0, abs=0.15)


def test_an_idle_armed_vehicle_disarms():
    flight = Flight(setpoints=lambda t: SetpointIn(0, 0, 0.1, 0, 0, 0, 0)).run(15.0)
    assert flight.heard("no take-off") == pytest.approx(12.0, abs=0.5)
    assert flight.true[:, 2].max() < 0.13


def test_it_does_not_disarm_in_flight():
    flight = Flight().run(6.0)
    autopilot = flight.simulation.autopilot
    assert autopilot.landed is not Landed.on_ground
    assert autopilot.disarm() == "not landed" and autopilot.armed
    assert autopilot.disarm(force=True) is None and not autopilot.armed


def fed(delay_us, gyro_bias=0.002, accel_bias=0.0, seconds=30, noise=0.01, delayed_stamp=True):
    """An estimator on a swing of 1 m with a period of 5 s along x, its ODOMETRY late by delay_us. Returns its largest errors over the last 10 s."""
    e, rng = Estimator(), np.random.default_rng(4)
    w, queue, worst = 2 * math.pi / 5, [], [0.0, 0.0, 0.0]
    at = lambda t: (math.sin(w * t), w * math.cos(w * t), -w * w * math.sin(w * t))
    dt = 0.004
    for k in range(1, int(seconds / dt)):
        t = k * dt
        x, v, _ = at(t)
        a = at(t - dt / 2)[2]
        e.predict(4000 * k, dt, a + accel_bias, 0.0, GRAVITY_M_S2, 0.0, gyro_bias, 0.0, False)
        if k % 5 == 0:
            n = rng.standard_normal(3) * noise
            queue.append((4000 * k, x + n[0], n[1], 1.0 + n[2], v, 0.0, 0.0))
        while queue and queue[0][0] + delay_us <= 4000 * k:
            stamp, *state = queue.pop(0)
            e.odometry(stamp if delayed_stamp else 4000 * k, *state, 0.0, 90, 0)
        if t > seconds - 10:
            pitch = math.asin(2 * (e.qw * e.qy - e.qz * e.qx))
            worst = [max(worst[0], abs(e.x - x)), max(worst[1], abs(e.vx - v)), max(worst[2], abs(pitch))]
    return worst


def test_late_odometry_is_compared_with_the_past():
    off, speed_off, tilt_off = fed(80_000)
    assert off < 0.03 and speed_off < 0.05 and tilt_off < math.radians(0.5)
    assert fed(80_000, delayed_stamp=False)[0] > 0.06   # what a filter without a memory would do


def test_a_stamp_between_two_samples_is_met_between_them():
    e = Estimator()
    for k in range(1, 3000):
        e.predict(4000 * k, 0.004, 0, 0, GRAVITY_M_S2, 0, 0, 0, False)
        if k % 5 == 0:
            stamp = 4000 * k - 1000          # the sample before is 3 ms older: 15 mm at 5 m/s
            e.odometry(stamp, 5.0 * stamp * 1e-6, 0, 1, 5.0, 0, 0, 0, 90, 0)
    assert e.x == pytest.approx(5.0 * e.t_us * 1e-6, abs=1e-3)


def test_the_gyros_bias_is_found():
    assert fed(30_000, gyro_bias=math.radians(0.3))[2] < math.radians(0.6)


def test_a_jump_with_a_new_reset_counter_is_followed_at_once():
    e = Estimator()
    for k in range(1, 500):
        e.predict(4000 * k, 0.004, 0, 0, GRAVITY_M_S2, 0, 0, 0, False)
        if k % 5 == 0:
            e.odometry(4000 * k, 0, 0, 1, 0, 0, 0, 0, 90, 0)
    e.odometry(4000 * 499, 2.0, 0, 1, 0, 0, 0, 0.5, 90, 1)
    assert e.x == pytest.approx(2.0, abs=1e-3) and e.yaw_rad == pytest.approx(0.5, abs=1e-3)


def test_bad_odometry_is_refused_and_counted():
    e = Estimator()
    for k in range(1, 100):
        e.predict(4000 * k, 0.004, 0, 0, GRAVITY_M_S2, 0, 0, 0, True)
    good = (0, 0, 1, 0, 0, 0, 0)
    assert e.odometry(392_000, *good, 90, 0)
    assert not e.odometry(392_000, *good, 90, 0)                       # again
    assert not e.odometry(800_000, *good, 90, 0)                       # of the future
    assert not e.odometry(396_000, math.nan, *good[1:], 90, 0)
    assert not e.odometry(396_000, *good, -1, 0)                       # lost
    assert e.refused == 4
