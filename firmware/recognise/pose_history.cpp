#include "recognise/pose_history.hpp"

#include <cmath>
#include <cstdlib>

namespace noctule {
namespace {

constexpr std::int64_t kGap_us = 250000;
constexpr std::int64_t kSweepAge_us = 200000;
constexpr double kTurn_rad = 6.283185307179586;

double between(const double a, const double b, const double s) { return a + s * (b - a); }

double between_angles(const double a, const double b, const double s) { return a + s * std::remainder(b - a, kTurn_rad); }

/// Rows of the rotation Body to Map, Z-Y-X.
std::array<Vec3, 3> rotation(const VehiclePose& p) {
    const double cr = std::cos(p.roll_rad);
    const double sr = std::sin(p.roll_rad);
    const double cp = std::cos(p.pitch_rad);
    const double sp = std::sin(p.pitch_rad);
    const double cy = std::cos(p.yaw_rad);
    const double sy = std::sin(p.yaw_rad);
    return {Vec3{cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr}, Vec3{sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr},
            Vec3{-sp, cp * sr, cp * cr}};
}

double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

}  // namespace

Vec3 VehiclePose::turn_to_map(const Vec3& d) const {
    const auto R = rotation(*this);
    return {dot(R[0], d), dot(R[1], d), dot(R[2], d)};
}

Vec3 VehiclePose::to_map(const Vec3& p) const {
    const Vec3 d = turn_to_map(p);
    return {x_m + d[0], y_m + d[1], z_m + d[2]};
}

Vec3 VehiclePose::to_body(const Vec3& p) const {
    const auto R = rotation(*this);
    const Vec3 d{p[0] - x_m, p[1] - y_m, p[2] - z_m};
    return {R[0][0] * d[0] + R[1][0] * d[1] + R[2][0] * d[2], R[0][1] * d[0] + R[1][1] * d[1] + R[2][1] * d[2],
            R[0][2] * d[0] + R[1][2] * d[1] + R[2][2] * d[2]};
}

void PoseHistory::add(const VehiclePose& pose) {
    if (pose.t_us <= newest_us()) { count_ = 0; }
    if (count_ == kPoses) {
        first_ = (first_ + 1) % kPoses;
        --count_;
    }
    poses_[(first_ + count_) % kPoses] = pose;
    ++count_;
}

void PoseHistory::add(const LaserSweep& sweep) {
    sweeps_[next_sweep_] = sweep;
    next_sweep_ = (next_sweep_ + 1) % kSweeps;
}

bool PoseHistory::at(const std::int64_t t_us, VehiclePose& out) const {
    std::size_t after = count_;
    while (after > 0 && at_index(after - 1).t_us >= t_us) { --after; }
    if (after == count_) { return false; }
    const VehiclePose& b = at_index(after);
    if (b.t_us == t_us) {
        out = b;
        return b.usable;
    }
    if (after == 0) { return false; }
    const VehiclePose& a = at_index(after - 1);
    if (b.t_us - a.t_us > kGap_us || !a.usable || !b.usable || a.reset_counter != b.reset_counter) { return false; }
    const double s = static_cast<double>(t_us - a.t_us) / static_cast<double>(b.t_us - a.t_us);
    out = b;
    out.t_us = t_us;
    out.x_m = between(a.x_m, b.x_m, s);
    out.y_m = between(a.y_m, b.y_m, s);
    out.z_m = between(a.z_m, b.z_m, s);
    out.roll_rad = between_angles(a.roll_rad, b.roll_rad, s);
    out.pitch_rad = between_angles(a.pitch_rad, b.pitch_rad, s);
    out.yaw_rad = between_angles(a.yaw_rad, b.yaw_rad, s);
    out.yaw_rate_rad_s = std::remainder(b.yaw_rad - a.yaw_rad, kTurn_rad) * 1.0e6 / static_cast<double>(b.t_us - a.t_us);
    return true;
}

std::span<const Vec3> PoseHistory::points(const std::int64_t t_us, const std::array<double, 4>& mount) {
    points_.clear();
    const LaserSweep* best = nullptr;
    std::int64_t best_age_us = kSweepAge_us;
    for (const LaserSweep& sweep : sweeps_) {
        if (sweep.count <= 0 || sweep.t_us > newest_us()) { continue; }
        const std::int64_t age_us = std::llabs(sweep.t_us - t_us);
        if (age_us < best_age_us) {
            best = &sweep;
            best_age_us = age_us;
        }
    }
    if (best == nullptr) { return {}; }
    for (std::int32_t i = 0; i < best->count; ++i) {
        const double range_m = static_cast<double>(best->range_m[static_cast<std::size_t>(i)]);
        if (!std::isfinite(range_m) || range_m <= 0.0) { continue; }
        const double before_us = static_cast<double>(best->count - 1 - i) * static_cast<double>(best->time_increment_us);
        VehiclePose pose;
        if (!at(best->t_us - static_cast<std::int64_t>(before_us), pose)) { continue; }
        const double bearing_rad = mount[3] + static_cast<double>(best->bearing_first_rad) + i * static_cast<double>(best->bearing_increment_rad);
        const Vec3 body{mount[0] + range_m * std::cos(bearing_rad), mount[1] + range_m * std::sin(bearing_rad), mount[2]};
        static_cast<void>(points_.push(pose.to_map(body)));
    }
    return {points_.begin(), points_.size()};
}

}  // namespace noctule
