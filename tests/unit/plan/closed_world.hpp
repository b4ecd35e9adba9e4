/// A flat world of walls, a vehicle without dynamics worth the name, and perfect knowledge of its pose: enough to fly
/// grid, mission, reference and guard to the end of an exploration. For tests only.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <ctime>
#include <functional>
#include <limits>
#include <memory>
#include <random>
#include <vector>

#include "command/guard.hpp"
#include "command/reference.hpp"
#include "map/occupancy_grid.hpp"
#include "plan/mission.hpp"

namespace noctule::test {

struct Segment { double x0, y0, x1, y1; };

/// Walls as thin segments; a wall with thickness is four of them. Frame World = Map at start (0, 0, 0).
class FlatWorld {
public:
    void add_segment(double x0, double y0, double x1, double y1) { segments_.push_back({x0, y0, x1, y1}); }
    /// A wall of the given thickness, centred on the line.
    void add_wall(const double x0, const double y0, const double x1, const double y1, const double thickness = 0.10) {
        const double length = std::hypot(x1 - x0, y1 - y0);
        if (length < 1e-6) { return; }
        const double nx = -(y1 - y0) / length * thickness / 2.0;
        const double ny = (x1 - x0) / length * thickness / 2.0;
        add_segment(x0 + nx, y0 + ny, x1 + nx, y1 + ny);
        add_segment(x0 - nx, y0 - ny, x1 - nx, y1 - ny);
        add_segment(x0 + nx, y0 + ny, x0 - nx, y0 - ny);
        add_segment(x1 + nx, y1 + ny, x1 - nx, y1 - ny);
    }
    void add_pillar(const double x, const double y, const double r) {
        for (int k = 0; k < 16; ++k) {
            const double a = 2.0 * 3.14159265358979 * k / 16.0;
            const double b = 2.0 * 3.14159265358979 * (k + 1) / 16.0;
            add_segment(x + r * std::cos(a), y + r * std::sin(a), x + r * std::cos(b), y + r * std::sin(b));
        }
    }
    /// Turns everything about the origin.
    void turn(const double angle) {
        const double c = std::cos(angle);
        const double s = std::sin(angle);
        for (Segment& w : segments_) { w = {c * w.x0 - s * w.y0, s * w.x0 + c * w.y0, c * w.x1 - s * w.y1, s * w.x1 + c * w.y1}; }
    }
    void shift(const double dx, const double dy) {
        for (Segment& w : segments_) { w = {w.x0 + dx, w.y0 + dy, w.x1 + dx, w.y1 + dy}; }
    }
    [[nodiscard]] double cast(const double x, const double y, const double angle, const double most, const std::vector<Segment>& among) const {
        const double ux = std::cos(angle);
        const double uy = std::sin(angle);
        double best = most;
        for (const Segment& w : among) {
            const double ex = w.x1 - w.x0;
            const double ey = w.y1 - w.y0;
            const double det = ex * uy - ey * ux;
            if (std::fabs(det) < 1e-12) { continue; }
            const double rx = w.x0 - x;
            const double ry = w.y0 - y;
            const double t = (ex * ry - ey * rx) / det;
            if (t < 0.0 || t >= best) { continue; }
            const double s = (ux * ry - uy * rx) / det;
            if (s >= 0.0 && s <= 1.0) { best = t; }
        }
        return best;
    }
    [[nodiscard]] static double distance(const Segment& w, const double x, const double y) {
        const double ex = w.x1 - w.x0;
        const double ey = w.y1 - w.y0;
        const double t = std::clamp(((x - w.x0) * ex + (y - w.y0) * ey) / std::max(ex * ex + ey * ey, 1e-12), 0.0, 1.0);
        return std::hypot(w.x0 + t * ex - x, w.y0 + t * ey - y);
    }
    [[nodiscard]] double clearance(const double x, const double y) const {
        double best = 1e9;
        for (const Segment& w : segments_) { best = std::min(best, distance(w, x, y)); }
        return best;
    }
    [[nodiscard]] std::vector<Segment> within(const double x, const double y, const double radius) const {
        std::vector<Segment> out;
        for (const Segment& w : segments_) {
            if (distance(w, x, y) <= radius) { out.push_back(w); }
        }
        return out;
    }
    [[nodiscard]] const std::vector<Segment>& segments() const { return segments_; }

private:
    std::vector<Segment> segments_;
};

/// A hall of 12 x 9 m, or a scale of it, with a wall across a part of it, turned off the grid's lines.
inline FlatWorld hall(const double scale = 1.0) {
    FlatWorld w;
    const auto wall = [&w, scale](const double x0, const double y0, const double x1, const double y1) { w.add_wall(scale * x0, scale * y0, scale * x1, scale * y1); };
    wall(-2.0, -3.0, 10.0, -3.0);
    wall(10.0, -3.0, 10.0, 6.0);
    wall(10.0, 6.0, -2.0, 6.0);
    wall(-2.0, 6.0, -2.0, -3.0);
    wall(4.0, -3.0, 4.0, 1.2);
    w.turn(0.297);
    return w;
}

/// A sweep of 1080 beams over 270 degrees from a place in the world.
inline void sweep(const FlatWorld& world, const double x, const double y, const double yaw, const double range_max_m,
                  const double range_noise_m, std::mt19937& rng, LevelScan& scan) {
    constexpr int kBeams = 1080;
    std::normal_distribution<double> range_noise(0.0, std::max(range_noise_m, 1e-12));
    const auto near = world.within(x, y, range_max_m);
    scan.range_max_m = static_cast<float>(range_max_m);
    scan.bearing_increment_rad = static_cast<float>(1.5 * 3.14159265358979 / (kBeams - 1));
    scan.points.clear();
    for (int k = 0; k < kBeams; ++k) {
        const double bearing = -0.75 * 3.14159265358979 + k * static_cast<double>(scan.bearing_increment_rad);
        const double r = world.cast(x, y, yaw + bearing, range_max_m, near);
        const bool hit = r < range_max_m;
        const double measured = hit ? r + range_noise(rng) : range_max_m;
        ScanPoint q;
        q.x_m = static_cast<float>(measured * std::cos(bearing));
        q.y_m = static_cast<float>(measured * std::sin(bearing));
        q.range_m = static_cast<float>(measured);
        q.beam = static_cast<std::int16_t>(k);
        q.hit = hit;
        static_cast<void>(scan.points.push(q));
    }
}

/// Grid, mission, reference and guard around a vehicle that follows setpoints with a lag.
class ClosedLoop {
public:
    ClosedLoop(const Parameters& parameters, const FlatWorld& world, const unsigned seed)
        : p(parameters), world_(world), rng_(seed), grid(parameters), mission(parameters), reference(parameters), guard(parameters) {}

    static constexpr double kDt = 0.05;
    double pose_noise_m = 0.0;    ///< white error of the pose handed to the firmware
    double range_noise_m = 0.01;
    double range_max_m = 10.0;
    /// Elevation of what is over and under the vehicle at (x, y, z); set: the ranges are handed to the firmware.
    std::function<double(double, double, double)> over_m;
    std::function<double(double, double, double)> under_m = [](double, double, double) { return 0.0; };
    double slab_m = 1e9;   ///< over this elevation the vehicle is on the upper floor; the walls are those of the lower one

    void step(const Order order = Order::none) {
        t_us_ += 50000;
        scan();
        commands_.clear();
        if (order != Order::none) { static_cast<void>(commands_.push({t_us_, order})); }
        vehicle_.t_us = t_us_;
        vehicle_.landed = z < 0.02 ? VehicleSample::Landed::on_ground : VehicleSample::Landed::in_air;
        vehicle_.battery_remaining = 1.0F;
        const double began_us = cpu_us();
        if (over_m) { look_up_and_down(); }
        if (mission.floors().layer() != FloorPlanner::kShaft) {
            Estimate on_floor = estimate_;
            on_floor.altitude.floor_z_m = mission.floors().floor_z_m(estimate_.altitude);
            grid.integrate(on_floor, scan_);
        }
        target = mission.step(estimate_, grid, vehicle_, commands_, reference.pose(), t_us_);
        const Setpoint& wanted = reference.step(estimate_, target, t_us_);
        const bool vertical_free = mission.state() == MissionState::taking_off || mission.state() == MissionState::landing;
        sent = guard.decide(estimate_, scan_, grid, wanted, vertical_free, t_us_);
        reference.settle(sent);
        plan_us = cpu_us() - began_us;
        if (mission.state() == MissionState::taking_off) { vehicle_.armed = vehicle_.offboard = true; }
        if (mission.want_disarm()) { vehicle_.armed = vehicle_.offboard = false; }
        fly();
    }

    const Parameters& p;
    double x = 0.0, y = 0.0, z = 0.0, yaw = 0.0, vx = 0.0, vy = 0.0, vz = 0.0;
    double length = 0.0;                 ///< flown
    double least_clearance = 1e9;        ///< centre to the nearest wall while off the ground
    double fastest = 0.0;
    double plan_us = 0.0;                ///< processor time of the last step of the firmware (told, never judged)
    [[nodiscard]] double time_s() const { return static_cast<double>(t_us_) * 1e-6; }
    Setpoint sent;
    Target target;
    VehicleSample vehicle_;
    const Estimate& estimate() const { return estimate_; }
    const LevelScan& level_scan() const { return scan_; }

private:
    static double cpu_us() { return 1e6 * static_cast<double>(std::clock()) / static_cast<double>(CLOCKS_PER_SEC); }
    void scan() {
        std::normal_distribution<double> pose_noise(0.0, std::max(pose_noise_m, 1e-12));
        sweep(world_, x, y, yaw, range_max_m, range_noise_m, rng_, scan_);
        scan_.t_us = t_us_;
        estimate_.t_us = t_us_;
        estimate_.planar.pose_map_body = {static_cast<float>(x + pose_noise(rng_)), static_cast<float>(y + pose_noise(rng_)), wrap_angle(static_cast<float>(yaw))};
        estimate_.planar.vx_m_s = static_cast<float>(vx);
        estimate_.planar.vy_m_s = static_cast<float>(vy);
        estimate_.planar.quality = 100;
        estimate_.altitude.z_m = static_cast<float>(z);
        estimate_.altitude.ground_z_m = 0.0F;
        estimate_.altitude.ceiling_z_m = 2.5F;
        estimate_.altitude.floor_z_m = 0.0F;
        estimate_.altitude.valid = true;
    }

    void look_up_and_down() {
        SensorFrame& frame = *frame_;
        frame.range_up.clear();
        frame.range_down.clear();
        const double over = over_m(x, y, z);
        const double under = under_m(x, y, z);
        static_cast<void>(frame.range_up.push({t_us_, static_cast<float>(over - z) - p.range_up_z_m, 0.1F, 12.0F}));
        static_cast<void>(frame.range_down.push({t_us_, static_cast<float>(z - under) + p.range_down_z_m, 0.1F, 12.0F}));
        estimate_.altitude.ceiling_z_m = static_cast<float>(over);
        estimate_.altitude.ground_z_m = static_cast<float>(under);
        estimate_.altitude.floor_z_m = z > slab_m ? static_cast<float>(slab_m) : 0.0F;
        mission.see(estimate_, frame, scan_, grid);
        static_cast<void>(grid.select_floor(mission.floors().current()));
    }

    // Follows the setpoint of one step before: position error and feed-forward give a velocity, reached with a lag.
    void fly() {
        const Setpoint s = delayed_;
        delayed_ = sent;
        if (!vehicle_.armed || !s.valid) { return; }
        constexpr int kSub = 5;
        constexpr double kLag = 0.15;
        constexpr double kGain = 1.2;
        for (int k = 0; k < kSub; ++k) {
            const double dt = kDt / kSub;
            const double wx = static_cast<double>(s.vx_m_s) + kGain * (static_cast<double>(s.x_m) - x);
            const double wy = static_cast<double>(s.vy_m_s) + kGain * (static_cast<double>(s.y_m) - y);
            const double wz = static_cast<double>(s.vz_m_s) + kGain * (static_cast<double>(s.z_m) - z);
            vx += (wx - vx) * dt / kLag;
            vy += (wy - vy) * dt / kLag;
            vz += (wz - vz) * dt / kLag;
            x += vx * dt;
            y += vy * dt;
            z = std::max(0.0, z + vz * dt);
            yaw += 3.0 * static_cast<double>(wrap_angle(static_cast<float>(static_cast<double>(s.yaw_rad) - yaw))) * dt;
            length += std::hypot(vx, vy) * dt;
            fastest = std::max(fastest, std::hypot(vx, vy));
        }
        if (z > 0.1) { least_clearance = std::min(least_clearance, world_.clearance(x, y)); }
    }

    const FlatWorld& world_;
    std::mt19937 rng_;
    std::int64_t t_us_ = 1000000;
    LevelScan scan_;
    Estimate estimate_;
    std::unique_ptr<SensorFrame> frame_ = std::make_unique<SensorFrame>();
    Bounded<CommandSample, kMaxCommandPerStep> commands_;
    Setpoint delayed_;

public:
    OccupancyGrid grid;
    Mission mission;
    Reference reference;
    Guard guard;
};

struct Result {
    bool completed = false;
    double time_s = 0.0;
    double length_m = 0.0;
    double least_clearance_m = 0.0;
    double home_error_m = 0.0;
};

/// Starts the mission and flies until it has landed or time is over.
inline Result fly(ClosedLoop& loop, const double most_s) {
    for (int k = 0; k < 60 && !loop.mission.ready(); ++k) { loop.step(); }
    loop.step(Order::start);
    Result r;
    while (loop.time_s() < most_s && loop.mission.state() != MissionState::landed && loop.mission.state() != MissionState::aborted) { loop.step(); }
    r.completed = loop.mission.state() == MissionState::landed && loop.mission.reason() == StateReason::on_ground;
    r.time_s = loop.time_s();
    r.length_m = loop.length;
    r.least_clearance_m = loop.least_clearance;
    r.home_error_m = std::hypot(loop.x, loop.y);
    return r;
}

/// Share of the cells that can be seen from some reachable place, and are classed rightly (within one cell). Lattice 0.10 m,
/// places at least 0.36 m from everything, 8-connected to the start on a lattice of 0.05 m.
inline double explored_share(const FlatWorld& world, const OccupancyGrid& grid, double range_m, std::vector<Cell>* missing = nullptr);

}  // namespace noctule::test
