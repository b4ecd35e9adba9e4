import math

import numpy as np
import pytest

from fixture import Flight, hall
from noctule_sim.autopilot import Mode
from noctule_sim.simulation import Simulation, vehicle_parameters
from noctule_sim.vehicle import GRAVITY_M_S2, Airframe, Vehicle


def fingerprint(seed):
    flight = Flight(seed=seed).run(6.0)
    return [(d.imu, d.attitude, d.range_up_m, d.range_down_m, d.scan_m.tobytes(), d.magnet_gauss, d.local, d.truth) for d in flight.ticks]


def test_the_same_seed_gives_the_same_bits():
    first, again, other = repr(fingerprint(7)), repr(fingerprint(7)), repr(fingerprint(8))
    assert first == again
    assert first != other


def test_streams_come_at_their_rates_and_end_at_the_tick():
    simulation = Simulation(hall())
    ticks = [simulation.tick() for _ in range(40)]
    assert sum(len(d.imu) for d in ticks) == 500
    assert sum(len(d.attitude) for d in ticks) == 100
    for d in ticks:
        assert d.imu[-1].t_us == d.attitude[-1].t_us == d.t_us
    times = np.array([s.t_us for d in ticks for s in d.imu])
    assert set(np.diff(times)) <= {2000, 4000, 6000}


def test_the_slow_stream_is_50_hz():
    simulation = Simulation(hall(), profile="harsh")
    assert sum(len(simulation.tick().imu) for _ in range(40)) == 100


def test_inertial_samples_integrate_to_the_motion():
    """With an ideal IMU, dead reckoning from the samples alone ends where the vehicle is."""
    flight = Flight(profile="ideal", noise_m=0.0, setpoints=lambda t: (1.0 if t > 6 else 0.0, 0, 1.0, 0, 0, 0, 0.8 if t > 7 else 0.0)).run(12.0)
    yaw0 = flight.simulation.world.start.yaw_rad
    q = np.array([math.cos(yaw0 / 2), 0, 0, math.sin(yaw0 / 2)])
    p, v = np.array([10.3, 9.7, 0.12]), np.zeros(3)
    t_before, worst = 0, 0.0
    for d in flight.ticks:
        for s in d.imu:
            dt = (s.t_us - t_before) * 1e-6
            t_before = s.t_us
            w, turn = np.array(s[4:7]), np.linalg.norm(s[4:7]) * dt
            half = np.concatenate([[math.cos(turn / 4)], w * dt / 4 * np.sinc(turn / 4 / math.pi)])
            middle = multiply(q, half)
            a = rotate(middle, np.array(s[1:4])) - (0, 0, GRAVITY_M_S2)
            p, v, q = p + v * dt + a * dt * dt / 2, v + a * dt, multiply(middle, half)
        t = d.truth
        worst = max(worst, np.abs(v - (t.vx_m_s, t.vy_m_s, t.vz_m_s)).max())
    assert p == pytest.approx([t.x_m, t.y_m, t.z_m], abs=5e-4)
    assert worst < 3e-4      # 7e-3 if the force were not taken in the attitude half way


def multiply(a, b):
    w, x, y, z = a
    return np.array([w * b[0] - x * b[1] - y * b[2] - z * b[3], w * b[1] + x * b[0] + y * b[3] - z * b[2],
                     w * b[2] - x * b[3] + y * b[0] + z * b[1], w * b[3] + x * b[2] - y * b[1] + z * b[0]])


def rotate(q, v):
    return multiply(multiply(q, np.concatenate([[0.0], v])), q * (1, -1, -1, -1))[1:]


def test_hover_thrust_carries_the_weight_and_lag_delays_it():
    vehicle = Vehicle(hall(), Airframe())
    share = vehicle.airframe.hover_share
    vehicle.advance(2, [share] * 4)
    after_4_ms = vehicle.rotor_speed_rad_s[0]
    for _ in range(200):
        force = vehicle.advance(2, [share] * 4)[2]
    assert force == pytest.approx(GRAVITY_M_S2, rel=1e-3)
    assert vehicle.rotor_speed_rad_s[0] == pytest.approx(1100.0 * math.sqrt(share), rel=1e-3)
    assert after_4_ms == pytest.approx(1100.0 * math.sqrt(share) * (1.0 - math.exp(-4.0 / 30.0)), rel=1e-6)


def test_drag_slows_a_glide():
    vehicle = Vehicle(hall(), Airframe())
    vehicle.data.qpos[2] = 3.0
    vehicle.data.qvel[0] = 2.0
    vehicle.velocity_m_s = [2.0, 0.0, 0.0]
    share = vehicle.airframe.hover_share
    vehicle.rotor_speed_rad_s = [1100.0 * math.sqrt(share)] * 4
    force = vehicle.advance(1, [share] * 4)
    assert force[0] * math.cos(vehicle.euler_rad()[2]) < -0.1


def test_sensors_on_the_ground_and_in_the_air():
    flight = Flight(profile="ideal", noise_m=0.0).run(8.0)
    assert math.isnan(flight.ticks[0].range_down_m)                       # blind zone
    last = flight.ticks[-1]
    assert last.range_down_m == pytest.approx(last.truth.z_m - 0.05, abs=1e-3)
    assert last.range_up_m == pytest.approx(6.0 - last.truth.z_m - 0.05, abs=1e-3)
    assert np.nanmin(last.scan_m) == pytest.approx(9.6, abs=0.2)


def test_an_answer_takes_effect_one_latency_later():
    simulation = Simulation(hall())
    simulation.tick()
    heard = []
    simulation.post(lambda: heard.append(simulation.autopilot.estimator.t_us))
    simulation.tick()
    assert heard == [50_000 + 26_000]      # the last inertial sample before 80 ms; it flies on the next, at 80 or later


def test_a_wall_in_the_way_is_one_collision_and_clearance_zero():
    def into_the_wall(t):
        return (0.0, 0.0, 1.0, 0, 0, 0, 0.0) if t < 6 else (min(12.0, 1.2 * (t - 6)), 0.0, 1.0, 1.2, 0, 0, 0.0)

    flight = Flight(setpoints=into_the_wall).run(17.0)
    assert flight.simulation.collisions >= 1
    assert flight.simulation.min_clearance_m < 0.01
    assert "walls[1]" in flight.simulation.touched[0]


def test_hover_keeps_the_halls_clearance():
    flight = Flight().run(8.0)
    assert flight.simulation.collisions == 0
    assert flight.simulation.min_clearance_m == pytest.approx(3.0)        # cut there: everything is farther


def test_landing_by_command():
    flight = Flight().run(6.0)
    flight.simulation.autopilot.set_mode(Mode.land)
    flight.run(20.0)
    assert flight.simulation.outcome.name == "landed"


def test_the_laser_can_be_cut():
    simulation = Simulation(hall(), faults={"lidar-cut": 0.1})
    assert [simulation.tick().scan_m is None for _ in range(4)] == [False, True, True, True]


def test_bad_settings_are_refused():
    for settings in ({"profile": "best"}, {"faults": {"gremlins": 1.0}}, {"flavour": "inav"}, {"parameters": {"NO_SUCH": 1}}):
        with pytest.raises(ValueError):
            Simulation(hall(), **settings)
    assert vehicle_parameters({"HULL_RADIUS": 0.4})["hull_radius_m"] == 0.4
