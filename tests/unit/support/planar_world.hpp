/// A small world for tests of the planar estimator: walls, a vehicle that follows way points, and its sensors.
///
/// Truth and measurement are different types; every random number comes from one generator with a stated seed. The beam is cast from
/// the pose at its own time, tilt included; there is no floor and no ceiling. World frame = Map turned and shifted by the start pose.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <deque>
#include <vector>

#include "sense/samples.hpp"

namespace noctule::test {

struct Segment {
    double x0_m, y0_m, x1_m, y1_m;
};

struct Circle {
    double x_m, y_m, radius_m;
};

struct Truth {
    double t_s = 0.0, x_m = 0.0, y_m = 0.0, yaw_rad = 0.0, vx_m_s = 0.0, vy_m_s = 0.0, yaw_rate_rad_s = 0.0, ax_m_s2 = 0.0, ay_m_s2 = 0.0;
    double roll_rad = 0.0, pitch_rad = 0.0;
};

struct Noise {
    double range_m = 0.01, dropout = 0.002, gyro = 1.2e-4, gyro_bias = 1.7e-3, accel = 1.5e-3, accel_bias = 0.05, tilt_rad = 0.0;
};

class PlanarWorld {
public:
    std::vector<Segment> segments;
    std::vector<Circle> circles;

    void box(double x0, double y0, double x1, double y1) {
        segments.push_back({x0, y0, x1, y0});
        segments.push_back({x1, y0, x1, y1});
        segments.push_back({x1, y1, x0, y1});
        segments.push_back({x0, y1, x0, y0});
    }
    /// Wall of 0.1 m thickness along a line.
    void wall(double x0, double y0, double x1, double y1) {
        const double length = std::hypot(x1 - x0, y1 - y0);
        const double ux = (x1 - x0) / length * 0.05, uy = (y1 - y0) / length * 0.05;
        const std::array<std::array<double, 2>, 4> c{{{x0 - ux - uy, y0 - uy + ux}, {x1 + ux - uy, y1 + uy + ux}, {x1 + ux + uy, y1 + uy - ux}, {x0 - ux + uy, y0 - uy - ux}}};
        for (std::size_t i = 0; i < 4; ++i) {
            const auto& a = c[i];
            const auto& b = c[(i + 1) % 4];
            segments.push_back({a[0], a[1], b[0], b[1]});
        }
    }
    /// Horizontal distance along a direction, infinity where nothing is met.
    [[nodiscard]] double cast(double x, double y, double dx, double dy) const {
        double best = std::numeric_limits<double>::infinity();
        for (const Segment& s : segments) {
            const double ex = s.x1_m - s.x0_m, ey = s.y1_m - s.y0_m;
            const double det = dx * ey - dy * ex;
            if (std::abs(det) < 1e-12) { continue; }
            const double wx = s.x0_m - x, wy = s.y0_m - y;
            const double along = (wx * ey - wy * ex) / det;
            const double share = (wx * dy - wy * dx) / det;
            if (along > 0.0 && share >= 0.0 && share <= 1.0 && along < best) { best = along; }
        }
        for (const Circle& c : circles) {
            const double wx = c.x_m - x, wy = c.y_m - y;
            const double middle = wx * dx + wy * dy;
            const double d2 = wx * wx + wy * wy - middle * middle;
            if (d2 > c.radius_m * c.radius_m) { continue; }
            const double half = std::sqrt(c.radius_m * c.radius_m - d2);
            for (const double along : {middle - half, middle + half}) {
                if (along > 0.0 && along < best) { best = along; }
            }
        }
        return best;
    }
    /// Everything turned about the origin, then shifted.
    void move(double turn_rad, double shift_x, double shift_y) {
        const double c = std::cos(turn_rad), s = std::sin(turn_rad);
        for (Segment& g : segments) {
            g = {c * g.x0_m - s * g.y0_m + shift_x, s * g.x0_m + c * g.y0_m + shift_y, c * g.x1_m - s * g.y1_m + shift_x, s * g.x1_m + c * g.y1_m + shift_y};
        }
        for (Circle& o : circles) { o = {c * o.x_m - s * o.y_m + shift_x, s * o.x_m + c * o.y_m + shift_y, o.radius_m}; }
    }
};

/// Follows way points at a limited speed and acceleration, nose along the path, in steps of 1 ms.
class Flight {
public:
    Flight(const std::vector<std::array<double, 2>>& way, double speed_m_s, double wait_s) {
        Truth now;
        now.x_m = way[0][0];
        now.y_m = way[0][1];
        now.yaw_rad = std::atan2(way[1][1] - way[0][1], way[1][0] - way[0][0]);
        std::size_t next = 1;
        double ax = 0.0, ay = 0.0;
        for (long k = 0; next < way.size() && k < 2000000; ++k) {
            const double dt = 1e-3;
            states.push_back(now);
            double want_vx = 0.0, want_vy = 0.0, want_rate = 0.0;
            if (now.t_s > wait_s) {
                const double dx = way[next][0] - now.x_m, dy = way[next][1] - now.y_m;
                const double far = std::hypot(dx, dy);
                if (far < 0.25) { ++next; }
                const double speed = std::min(speed_m_s, 0.15 + 0.9 * far);
                const double off = std::remainder(std::atan2(dy, dx) - now.yaw_rad, 2.0 * M_PI);
                const double slow = std::abs(off) > 1.0 ? 0.25 : 1.0;
                want_vx = slow * speed * dx / far;
                want_vy = slow * speed * dy / far;
                want_rate = std::fmax(-1.0, std::fmin(1.0, 1.5 * off));
            }
            const auto limit = [](double v, double most) { return std::fmax(-most, std::fmin(most, v)); };
            // A smooth acceleration: first order towards what the speed error asks for.
            ax += dt / 0.15 * (limit(2.0 * (want_vx - now.vx_m_s), 1.0) - ax);
            ay += dt / 0.15 * (limit(2.0 * (want_vy - now.vy_m_s), 1.0) - ay);
            const double rate = now.yaw_rate_rad_s + dt / 0.2 * (want_rate - now.yaw_rate_rad_s);
            states.back().ax_m_s2 = ax;
            states.back().ay_m_s2 = ay;
            now.t_s += dt;
            now.x_m += dt * now.vx_m_s + 0.5 * dt * dt * ax;
            now.y_m += dt * now.vy_m_s + 0.5 * dt * dt * ay;
            now.yaw_rad += 0.5 * dt * (now.yaw_rate_rad_s + rate);
            now.yaw_rate_rad_s = rate;
            now.vx_m_s += dt * ax;
            now.vy_m_s += dt * ay;
            now.ax_m_s2 = ax;
            now.ay_m_s2 = ay;
            const double c = std::cos(now.yaw_rad), s = std::sin(now.yaw_rad);
            now.pitch_rad = std::atan((c * ax + s * ay) / 9.81);
            now.roll_rad = -std::atan((-s * ax + c * ay) / 9.81 * std::cos(now.pitch_rad));
        }
    }
    [[nodiscard]] Truth at(double t_s) const {
        const double k = std::fmax(0.0, t_s * 1000.0);
        const auto i = std::min(static_cast<std::size_t>(k), states.size() - 1);
        const auto j = std::min(i + 1, states.size() - 1);
        const double w = k - static_cast<double>(i);
        Truth a = states[i];
        const Truth& b = states[j];
        const auto mix = [w](double& u, double v) { u += w * (v - u); };
        mix(a.x_m, b.x_m);
        mix(a.y_m, b.y_m);
        mix(a.yaw_rad, b.yaw_rad);
        mix(a.vx_m_s, b.vx_m_s);
        mix(a.vy_m_s, b.vy_m_s);
        mix(a.roll_rad, b.roll_rad);
        mix(a.pitch_rad, b.pitch_rad);
        mix(a.ax_m_s2, b.ax_m_s2);
        mix(a.ay_m_s2, b.ay_m_s2);
        mix(a.yaw_rate_rad_s, b.yaw_rate_rad_s);
        return a;
    }
    [[nodiscard]] double duration_s() const { return static_cast<double>(states.size() - 1) * 1e-3; }
    std::deque<Truth> states;   // a vector doubles what it holds: two flights would not fit the board's heap
};

/// What the sensors of the default profile say along a flight.
class Sensors {
public:
    Sensors(const PlanarWorld& world, const Flight& flight, const Noise& noise, std::uint32_t seed) : world_(world), flight_(flight), noise_(noise), rng_(seed) {
        for (double& b : accel_bias_) { b = noise.accel_bias * normal(); }
        for (double& b : gyro_bias_) { b = noise.gyro_bias * normal(); }
    }

    double laser_height_m = 0.0;  ///< over the Body origin, along Body z: must equal the parameter in use
    int beams = 1080;
    double sweep_s = 0.0375;
    double imu_rate_hz = 250.0;

    [[nodiscard]] Scan scan(double t_s) {
        Scan scan;
        scan.t_us = us(t_s);
        scan.seq = seq_++;
        scan.count = beams;
        scan.time_increment_us = static_cast<float>(sweep_s * 1e6 / beams);
        const double increment = 1.5 * M_PI / (beams - 1);
        scan.bearing_first_rad = static_cast<float>(-0.75 * M_PI);
        scan.bearing_increment_rad = static_cast<float>(increment);
        scan.range_min_m = 0.06F;
        scan.range_max_m = 10.0F;
        for (int i = 0; i < beams; ++i) {
            const Truth p = flight_.at(t_s - (beams - 1 - i) * sweep_s / beams);
            const double bearing = static_cast<double>(scan.bearing_first_rad) + i * static_cast<double>(scan.bearing_increment_rad);
            const double b[3] = {std::cos(bearing), std::sin(bearing), 0.0};
            const double m[3] = {0.0, 0.0, laser_height_m};
            double d[3], o[3];
            rotate(p, b, d);
            rotate(p, m, o);
            const double flat = std::hypot(d[0], d[1]);
            double range = world_.cast(p.x_m + o[0], p.y_m + o[1], d[0] / flat, d[1] / flat) / flat;
            range += noise_.range_m * normal();
            auto& out = scan.range_m[static_cast<std::size_t>(i)];
            out = range > 10.0 ? std::numeric_limits<float>::infinity() : static_cast<float>(std::round(range * 1000.0) / 1000.0);
            if (uniform() < noise_.dropout) { out = std::numeric_limits<float>::quiet_NaN(); }
        }
        return scan;
    }

    [[nodiscard]] ImuSample imu(double t_s) {
        const Truth p = flight_.at(t_s);
        const double a[3] = {p.ax_m_s2, p.ay_m_s2, 9.81};
        double f[3];
        unrotate(p, a, f);
        // Small tilt rates are left out of x and y; the yaw rate is what the planar filter reads.
        const double w[3] = {-p.yaw_rate_rad_s * std::sin(p.pitch_rad), p.yaw_rate_rad_s * std::sin(p.roll_rad) * std::cos(p.pitch_rad),
                             p.yaw_rate_rad_s * std::cos(p.roll_rad) * std::cos(p.pitch_rad)};
        ImuSample sample;
        sample.t_us = us(t_s);
        const double root = std::sqrt(imu_rate_hz);
        for (std::size_t i = 0; i < 3; ++i) {
            sample.accel_m_s2[i] = static_cast<float>(f[i] + accel_bias_[i] + noise_.accel * root * normal());
            sample.gyro_rad_s[i] = static_cast<float>(w[i] + gyro_bias_[i] + noise_.gyro * root * normal());
        }
        return sample;
    }

    [[nodiscard]] AttitudeSample attitude(double t_s) {
        const Truth p = flight_.at(t_s);
        return {us(t_s), static_cast<float>(p.roll_rad + noise_.tilt_rad * normal()), static_cast<float>(p.pitch_rad + noise_.tilt_rad * normal())};
    }

    /// Everything in (t - 50 ms, t].
    void frame(double t_s, SensorFrame& out) {
        out.imu.clear();
        out.attitude.clear();
        const int samples = static_cast<int>(std::lround(imu_rate_hz * 0.05));
        for (int k = 1; k <= samples; ++k) { static_cast<void>(out.imu.push(imu(t_s - 0.05 + 0.05 * k / samples))); }
        for (const double back : {0.03, 0.01, 0.0}) { static_cast<void>(out.attitude.push(attitude(t_s - back))); }
        out.scan = scan(t_s);
    }

    [[nodiscard]] static std::int64_t us(double t_s) { return 1000000 + std::llround(t_s * 1e6); }
    [[nodiscard]] double normal() { return normal_(rng_); }
    [[nodiscard]] double uniform() { return uniform_(rng_); }

private:
    static void rotate(const Truth& p, const double* b, double* w) {
        const double cph = std::cos(p.roll_rad), sph = std::sin(p.roll_rad), cth = std::cos(p.pitch_rad), sth = std::sin(p.pitch_rad);
        const double cps = std::cos(p.yaw_rad), sps = std::sin(p.yaw_rad);
        w[0] = cth * cps * b[0] + (sph * sth * cps - cph * sps) * b[1] + (cph * sth * cps + sph * sps) * b[2];
        w[1] = cth * sps * b[0] + (sph * sth * sps + cph * cps) * b[1] + (cph * sth * sps - sph * cps) * b[2];
        w[2] = -sth * b[0] + sph * cth * b[1] + cph * cth * b[2];
    }
    static void unrotate(const Truth& p, const double* w, double* b) {
        double columns[3][3];
        for (int i = 0; i < 3; ++i) {
            double unit[3] = {0.0, 0.0, 0.0};
            unit[i] = 1.0;
            rotate(p, unit, columns[i]);
        }
        for (int i = 0; i < 3; ++i) { b[i] = columns[i][0] * w[0] + columns[i][1] * w[1] + columns[i][2] * w[2]; }
    }

    const PlanarWorld& world_;
    const Flight& flight_;
    Noise noise_;
    std::mt19937 rng_;
    std::normal_distribution<double> normal_{0.0, 1.0};
    std::uniform_real_distribution<double> uniform_{0.0, 1.0};
    std::array<double, 3> accel_bias_{};
    std::array<double, 3> gyro_bias_{};
    std::int32_t seq_ = 0;
};

/// Truth in Map: the start pose is the origin.
inline void in_map(const Truth& start, const Truth& p, double& x_m, double& y_m, double& yaw_rad) {
    const double c = std::cos(start.yaw_rad), s = std::sin(start.yaw_rad);
    const double dx = p.x_m - start.x_m, dy = p.y_m - start.y_m;
    x_m = c * dx + s * dy;
    y_m = -s * dx + c * dy;
    yaw_rad = std::remainder(p.yaw_rad - start.yaw_rad, 2.0 * M_PI);
}

}  // namespace noctule::test
