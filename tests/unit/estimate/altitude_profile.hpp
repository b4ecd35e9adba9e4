/// Test-only flight over a profile of floors, tables, treads and ceilings, with the sensors of the `default` profile.
///
/// The vehicle moves in the x-z plane of Map along legs of minimum jerk; its thrust points where it must to make the
/// horizontal acceleration, so the accelerometer, the attitude and the tilt of the ranges belong together.
/// Truth and readings come from here alone: nothing of the filter is used to make them.
#pragma once

#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "estimate/altitude_filter.hpp"

namespace altitude_test {

inline constexpr double kGravity = 9.81;

struct Leg {
    double duration_s;
    double dx_m;
    double dz_m;
};

struct World {
    std::function<double(double)> ground_m;    // elevation of the surface below at x
    std::function<double(double)> ceiling_m;   // elevation of the surface above at x
};

struct Sensors {
    double range_sigma_m = 0.02;
    double range_step_m = 0.01;
    double range_min_m = 0.10;
    double range_max_m = 12.0;
    double dropout = 0.01;
    double outlier = 0.0;
    double scale_down = 0.0;
    double scale_up = 0.0;
    double accel_bias_m_s2 = 0.05;
    double accel_density = 150.0e-6 * 9.81;    // m/s^2/sqrt(Hz)
    double attitude_sigma_rad = 0.002;
    double tilt_rad = 0.0;                     // amplitude of a slow roll on top of the flight
    std::vector<std::pair<double, double>> silent_s;  // both ranges silent between these times
    int imu_hz = 250;
    double baro_sigma_m = 0.0;                 // 0: there is no barometer
    double baro_drift_m = 0.10;                // amplitude of each of two slow waves
};

struct Truth {
    double t_s = 0.0;
    double x_m = 0.0;
    double z_m = 0.0;
    double vx_m_s = 0.0;
    double vz_m_s = 0.0;
    double ax_m_s2 = 0.0;
    double az_m_s2 = 0.0;
};

struct Result {
    double mean_m = 0.0;        // mean of |z error| after take-off
    double max_m = 0.0;
    double end_m = 0.0;         // signed error at the end
    double nees_end = 0.0;      // squared error over variance at the end
    double nees_mean = 0.0;     // the same, mean over the flight
    int invalid_steps = 0;
};

class Flight {
public:
    static constexpr double kRest_s = 1.0;
    static constexpr double kClearance_m = 0.12;

    Flight(World world, std::vector<Leg> legs) : world_(std::move(world)), legs_(std::move(legs)) {}

    [[nodiscard]] double duration_s() const {
        double sum = kRest_s;
        for (const Leg& leg : legs_) { sum += leg.duration_s; }
        return sum;
    }

    [[nodiscard]] Truth at(const double t_s) const {
        Truth truth;
        truth.t_s = t_s;
        truth.z_m = kClearance_m;
        double left = t_s - kRest_s;
        for (const Leg& leg : legs_) {
            if (left <= 0.0) { break; }
            const double u = std::fmin(left / leg.duration_s, 1.0);
            const double s = u * u * u * (10.0 + u * (-15.0 + 6.0 * u));
            const double ds = u * u * (30.0 + u * (-60.0 + 30.0 * u)) / leg.duration_s;
            const double dds = u * (60.0 + u * (-180.0 + 120.0 * u)) / (leg.duration_s * leg.duration_s);
            truth.x_m += leg.dx_m * s;
            truth.z_m += leg.dz_m * s;
            const bool inside = left < leg.duration_s;
            truth.vx_m_s = inside ? leg.dx_m * ds : 0.0;
            truth.vz_m_s = inside ? leg.dz_m * ds : 0.0;
            truth.ax_m_s2 = inside ? leg.dx_m * dds : 0.0;
            truth.az_m_s2 = inside ? leg.dz_m * dds : 0.0;
            left -= leg.duration_s;
        }
        return truth;
    }

    /// Flies once. each(truth, estimate) is called after every step.
    Result run(noctule::AltitudeFilter& filter, const Sensors& sensors, const std::uint32_t seed,
               const std::function<void(const Truth&, const noctule::AltitudeEstimate&)>& each = {}) {
        std::mt19937 rng{seed};
        std::normal_distribution<double> unit{0.0, 1.0};
        std::uniform_real_distribution<double> uniform{0.0, 1.0};
        std::mt19937 baro_rng{seed + 1000U};  // its own, so that the other readings stay as they are
        std::normal_distribution<double> baro_unit{0.0, 1.0};
        std::uniform_real_distribution<double> baro_phase{0.0, 6.283185307};
        const double phase_fast = baro_phase(baro_rng);
        const double phase_slow = baro_phase(baro_rng);
        const double place_error_m = 0.03 * unit(rng);
        const int ticks = static_cast<int>(std::lround(duration_s() * 20.0));
        std::int64_t imu_us = 0;
        std::int64_t attitude_us = 0;
        const std::int64_t imu_step_us = 1000000 / sensors.imu_hz;
        const double accel_sigma = sensors.accel_density * std::sqrt(static_cast<double>(sensors.imu_hz));
        Result result;
        int counted = 0;
        for (int tick = 1; tick <= ticks; ++tick) {
            const std::int64_t t_us = static_cast<std::int64_t>(tick) * 50000;
            noctule::SensorFrame& frame = frame_;
            frame.imu.clear();
            frame.attitude.clear();
            frame.range_up.clear();
            frame.range_down.clear();
            frame.baro.clear();
            frame.vehicle.clear();
            frame.command.clear();
            frame.scan.t_us = t_us;
            for (; imu_us + imu_step_us <= t_us;) {
                imu_us += imu_step_us;
                const Truth m = at(static_cast<double>(imu_us - imu_step_us / 2) * 1.0e-6);  // mean over the sample
                const auto [roll, pitch] = tilt_of(m, sensors);
                const double up = m.az_m_s2 + kGravity;
                noctule::ImuSample s;
                s.t_us = imu_us;
                // a_B = R^T (a + g) with yaw zero
                const double x = std::cos(pitch) * m.ax_m_s2 - std::sin(pitch) * up;
                const double y = std::sin(roll) * (std::sin(pitch) * m.ax_m_s2 + std::cos(pitch) * up);
                const double z = std::cos(roll) * (std::sin(pitch) * m.ax_m_s2 + std::cos(pitch) * up);
                s.accel_m_s2 = {static_cast<float>(x + sensors.accel_bias_m_s2 + accel_sigma * unit(rng)),
                                static_cast<float>(y - sensors.accel_bias_m_s2 + accel_sigma * unit(rng)),
                                static_cast<float>(z + sensors.accel_bias_m_s2 + accel_sigma * unit(rng))};
                (void)frame.imu.push(s);
            }
            for (; attitude_us + 20000 <= t_us;) {
                attitude_us += 20000;
                const auto [roll, pitch] = tilt_of(at(static_cast<double>(attitude_us) * 1.0e-6), sensors);
                (void)frame.attitude.push({attitude_us, static_cast<float>(roll + sensors.attitude_sigma_rad * unit(rng)),
                                           static_cast<float>(pitch + sensors.attitude_sigma_rad * unit(rng))});
            }
            const Truth truth = at(static_cast<double>(t_us) * 1.0e-6);
            for (const bool is_up : {true, false}) {
                const double range = measure(truth, is_up, sensors, unit, uniform, rng);
                (void)(is_up ? frame.range_up : frame.range_down)
                    .push({t_us, static_cast<float>(range), static_cast<float>(sensors.range_min_m),
                           static_cast<float>(sensors.range_max_m)});
            }
            if (sensors.baro_sigma_m > 0.0) {
                const double drift = sensors.baro_drift_m * (std::sin(0.11 * truth.t_s + phase_fast) + std::sin(0.05 * truth.t_s + phase_slow));
                (void)frame.baro.push({t_us, static_cast<float>(57.0 + truth.z_m + drift + sensors.baro_sigma_m * baro_unit(baro_rng))});
            }
            if (tick % 4 == 1) {
                noctule::VehicleSample vehicle;
                vehicle.t_us = t_us;
                vehicle.armed = truth.t_s > kRest_s - 0.3;
                vehicle.landed = truth.t_s > kRest_s ? noctule::VehicleSample::Landed::in_air
                                                     : noctule::VehicleSample::Landed::on_ground;
                (void)frame.vehicle.push(vehicle);
            }
            noctule::PlanarEstimate planar;
            planar.pose_map_body.x_m = static_cast<float>(truth.x_m + place_error_m);
            planar.vx_m_s = static_cast<float>(truth.vx_m_s);
            planar.quality = 100;
            const noctule::AltitudeEstimate& estimate = filter.update(frame, planar);
            if (each) { each(truth, estimate); }
            if (!estimate.valid) { ++result.invalid_steps; }
            if (truth.t_s <= kRest_s) { continue; }
            const double error = static_cast<double>(estimate.z_m) - truth.z_m;
            result.mean_m += std::fabs(error);
            result.max_m = std::fmax(result.max_m, std::fabs(error));
            result.nees_mean += error * error / static_cast<double>(estimate.z_var_m2);
            result.end_m = error;
            result.nees_end = error * error / static_cast<double>(estimate.z_var_m2);
            ++counted;
        }
        result.mean_m /= counted;
        result.nees_mean /= counted;
        return result;
    }

private:
    [[nodiscard]] static std::pair<double, double> tilt_of(const Truth& m, const Sensors& sensors) {
        const double flying = m.t_s > kRest_s ? 1.0 : 0.0;
        const double roll = flying * sensors.tilt_rad * std::sin(1.1 * (m.t_s - kRest_s));
        return {roll, std::atan2(m.ax_m_s2, kGravity + m.az_m_s2)};
    }

    [[nodiscard]] double measure(const Truth& truth, const bool is_up, const Sensors& sensors,
                                 std::normal_distribution<double>& unit, std::uniform_real_distribution<double>& uniform,
                                 std::mt19937& rng) const {
        const double noise = unit(rng);
        const double lost = uniform(rng);
        const double wild = uniform(rng);
        const double where = uniform(rng);
        for (const auto& [from, to] : sensors.silent_s) {
            if (truth.t_s >= from && truth.t_s < to) { return std::numeric_limits<double>::quiet_NaN(); }
        }
        if (lost < sensors.dropout) { return std::numeric_limits<double>::quiet_NaN(); }
        const auto [roll, pitch] = tilt_of(truth, sensors);
        const double cosine = std::cos(roll) * std::cos(pitch);
        const double lean = std::cos(roll) * std::sin(pitch);  // Body z, forward part
        const double mount = is_up ? 0.05 : -0.05;
        const double sensor_z = truth.z_m + mount * cosine;
        const double way = is_up ? 1.0 : -1.0;
        double range = 0.0;
        for (int i = 0; i < 4; ++i) {  // the beam lands beside the vehicle when it is tilted
            const double x = truth.x_m + lean * (mount + way * range);
            const double surface = is_up ? world_.ceiling_m(x) : world_.ground_m(x);
            range = way * (surface - sensor_z) / cosine;
        }
        range = range * (1.0 + (is_up ? sensors.scale_up : sensors.scale_down)) + sensors.range_sigma_m * noise;
        if (wild < sensors.outlier) {
            range = sensors.range_min_m + where * (sensors.range_max_m - sensors.range_min_m);
        }
        if (sensors.range_step_m > 0.0) { range = std::round(range / sensors.range_step_m) * sensors.range_step_m; }
        if (range < sensors.range_min_m || range > sensors.range_max_m) { return std::numeric_limits<double>::quiet_NaN(); }
        return range;
    }

    World world_;
    std::vector<Leg> legs_;
    noctule::SensorFrame frame_;
};

/// Section F: floor 0, a table 0.55, an upper floor 2.41, a ceiling 4.66; 676 steps.
inline Flight paper_flight() {
    World world;
    world.ground_m = [](const double x) { return x > 2.5 && x < 3.7 ? 0.55 : (x > 7.0 ? 2.41 : 0.0); };
    world.ceiling_m = [](double) { return 4.66; };
    return Flight{world, {{2.5, 0.0, 0.88}, {8.0, 6.0, 0.0}, {4.5, 0.0, 2.4}, {8.0, 5.0, 0.0}, {8.0, -5.0, 0.0}, {1.8, 0.0, 0.0}}};
}

/// length_m of flat floor under a ceiling of 2.5 m at 1 m over the floor, 1 m/s on average.
inline Flight flat_flight(const double length_m) {
    World world;
    world.ground_m = [](double) { return 0.0; };
    world.ceiling_m = [](double) { return 2.5; };
    std::vector<Leg> legs{{2.5, 0.0, 0.88}};
    for (double x = 0.0; x < length_m; x += 5.0) { legs.push_back({5.0, 5.0, 0.0}); }
    return Flight{world, legs};
}

/// Back and forth over one table under a ceiling of 2.5 m.
inline Flight table_flight(const int crossings) {
    World world;
    world.ground_m = [](const double x) { return x > 1.5 && x < 2.7 ? 0.55 : 0.0; };
    world.ceiling_m = [](double) { return 2.5; };
    std::vector<Leg> legs{{2.5, 0.0, 0.88}};
    for (int i = 0; i < crossings; ++i) { legs.push_back({5.0, i % 2 == 0 ? 4.0 : -4.0, 0.0}); }
    return Flight{world, legs};
}

/// Up a staircase of 14 treads, 0.172 m high and 0.28 m deep, from x = 2 m; the ceiling opens to 4.66 m over it.
inline Flight stair_flight() {
    World world;
    world.ground_m = [](const double x) {
        if (x < 2.0) { return 0.0; }
        return std::fmin(std::floor((x - 2.0) / 0.28) + 1.0, 14.0) * (2.41 / 14.0);
    };
    world.ceiling_m = [](const double x) { return x < 1.5 ? 2.2 : 4.66; };
    return Flight{world, {{2.5, 0.0, 0.88}, {3.0, 1.8, 0.0}, {9.0, 4.2, 2.41}, {6.0, 4.0, 0.0}, {6.0, -4.0, 0.0}, {9.0, -4.2, -2.41}, {3.0, -1.8, 0.0}}};
}

}  // namespace altitude_test
