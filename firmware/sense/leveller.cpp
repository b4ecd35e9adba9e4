#include "sense/leveller.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

/// Pose of Body in the level frame at the stamp: the first two columns of the rotation, and the laser's place.
struct BodyPose {
    std::array<float, 3> forward{};  ///< Body x in the level frame
    std::array<float, 3> left{};     ///< Body y in the level frame
    std::array<float, 3> laser_m{};  ///< optical centre in the level frame
};

[[nodiscard]] MotionNode interpolate(const SweepMotion& motion, std::size_t& hint, const double t_us) {
    while (hint + 1 < motion.size() && static_cast<double>(motion[hint + 1].t_us) <= t_us) { ++hint; }
    const MotionNode& a = motion[hint];
    if (hint + 1 >= motion.size() || t_us <= static_cast<double>(a.t_us)) { return a; }
    const MotionNode& b = motion[hint + 1];
    const double share = (t_us - static_cast<double>(a.t_us)) / static_cast<double>(b.t_us - a.t_us);
    const auto share_f = static_cast<float>(share);
    return {a.t_us, a.x_m + share * (b.x_m - a.x_m), a.y_m + share * (b.y_m - a.y_m), a.yaw_rad + share * (b.yaw_rad - a.yaw_rad),
            a.roll_rad + share_f * (b.roll_rad - a.roll_rad), a.pitch_rad + share_f * (b.pitch_rad - a.pitch_rad)};
}

/// Z-Y-X rotation (algorithms B) with yaw taken from the stamp's yaw, and the shift since the stamp.
[[nodiscard]] BodyPose relative_to(const MotionNode& node, const MotionNode& stamp, const Parameters& p) {
    const auto yaw = static_cast<float>(node.yaw_rad - stamp.yaw_rad);
    const float cps = std::cos(yaw);
    const float sps = std::sin(yaw);
    const float cth = std::cos(node.pitch_rad);
    const float sth = std::sin(node.pitch_rad);
    const float cph = std::cos(node.roll_rad);
    const float sph = std::sin(node.roll_rad);
    BodyPose pose;
    pose.forward = {cth * cps, cth * sps, -sth};
    pose.left = {sph * sth * cps - cph * sps, sph * sth * sps + cph * cps, sph * cth};
    const std::array<float, 3> up{cph * sth * cps + sph * sps, cph * sth * sps - sph * cps, cph * cth};
    const double dx = node.x_m - stamp.x_m;
    const double dy = node.y_m - stamp.y_m;
    const double c = std::cos(stamp.yaw_rad);
    const double s = std::sin(stamp.yaw_rad);
    const std::array<float, 3> shift{static_cast<float>(c * dx + s * dy), static_cast<float>(c * dy - s * dx), 0.0F};
    for (std::size_t i = 0; i < 3; ++i) {
        pose.laser_m[i] = shift[i] + pose.forward[i] * p.lidar_x_m + pose.left[i] * p.lidar_y_m + up[i] * p.lidar_z_m;
    }
    return pose;
}

[[nodiscard]] float lerp(const float a, const float b, const float share) { return a + share * (b - a); }

}  // namespace

void Leveller::prepare_directions(const Scan& scan) {
    if (scan.count == count_ && scan.bearing_first_rad == bearing_first_rad_ && scan.bearing_increment_rad == bearing_increment_rad_ &&
        parameters_.lidar_yaw_rad == yaw_rad_) {
        return;
    }
    count_ = scan.count;
    bearing_first_rad_ = scan.bearing_first_rad;
    bearing_increment_rad_ = scan.bearing_increment_rad;
    yaw_rad_ = parameters_.lidar_yaw_rad;
    for (std::size_t i = 0; i < static_cast<std::size_t>(count_); ++i) {
        const double direction = static_cast<double>(yaw_rad_) + static_cast<double>(bearing_first_rad_) +
                                 static_cast<double>(i) * static_cast<double>(bearing_increment_rad_);
        cos_[i] = static_cast<float>(std::cos(direction));
        sin_[i] = static_cast<float>(std::sin(direction));
    }
}

void Leveller::level(const Scan& scan, const SweepMotion& motion, const HeightBounds& bounds, LevelScan& out) {
    prepare_directions(scan);
    noise_.add(scan);
    out.range_noise_m = noise_.sigma_m();
    out.t_us = scan.t_us;
    out.range_max_m = scan.range_max_m;
    out.bearing_increment_rad = std::abs(scan.bearing_increment_rad);
    out.points.clear();

    const MotionNode& stamp = motion.back();
    float heights_m = 0.0F;   // of the hits over the laser, summed
    std::int32_t hits = 0;
    const auto count = static_cast<std::size_t>(scan.count);
    const bool moves = parameters_.deskew != 0 && scan.time_increment_us > 0.0F;
    // The rotation is exact at every kBlock-th beam (0.6 ms apart on the default laser) and linear between.
    constexpr std::size_t kBlock = 16;
    std::size_t hint = 0;
    BodyPose block_start = relative_to(stamp, stamp, parameters_);
    BodyPose block_end = block_start;
    const auto pose_at_beam = [&](const std::size_t beam) {
        const double t_us = static_cast<double>(scan.t_us) -
                            (static_cast<double>(count) - 1.0 - static_cast<double>(beam)) * static_cast<double>(scan.time_increment_us);
        return relative_to(interpolate(motion, hint, t_us), stamp, parameters_);
    };
    if (moves) { block_end = pose_at_beam(0); }

    for (std::size_t i = 0; i < count; ++i) {
        if (moves && i % kBlock == 0) {
            block_start = block_end;
            block_end = pose_at_beam(i + kBlock);
        }
        const float measured_m = scan.range_m[i];
        const bool nothing_hit = measured_m == std::numeric_limits<float>::infinity();
        if (!nothing_hit && !(measured_m >= scan.range_min_m && measured_m <= scan.range_max_m)) {
            ++counters_.beams_refused;  // a NaN comes here, too
            continue;
        }
        const float range_m = nothing_hit ? scan.range_max_m : measured_m;
        const float share = static_cast<float>(i % kBlock) / static_cast<float>(kBlock);
        std::array<float, 3> laser{};
        std::array<float, 3> end{};
        for (std::size_t k = 0; k < 3; ++k) {
            const float forward = lerp(block_start.forward[k], block_end.forward[k], share);
            const float left = lerp(block_start.left[k], block_end.left[k], share);
            laser[k] = lerp(block_start.laser_m[k], block_end.laser_m[k], share);
            end[k] = laser[k] + range_m * (cos_[i] * forward + sin_[i] * left);
        }
        const float margin_m = parameters_.tilt_margin_m + range_m * parameters_.tilt_noise_rad;
        if (end[2] < laser[2] && end[2] < bounds.floor_m + margin_m) {
            ++counters_.beams_floor;
            continue;
        }
        if (end[2] > laser[2] && end[2] > bounds.ceiling_m - margin_m) {
            ++counters_.beams_ceiling;
            continue;
        }
        static_cast<void>(out.points.push({end[0], end[1], end[2], laser[0], laser[1], range_m, static_cast<std::int16_t>(i), !nothing_hit}));
        if (nothing_hit) { continue; }
        heights_m += end[2] - laser[2];
        ++hits;
    }
    // A sweep turned about a level axis by a small error moves each point by its height (docs/maths/walls.md, equation 9).
    const BodyPose level = relative_to(stamp, stamp, parameters_);
    out.rise_forward = level.forward[2];
    out.rise_left = level.left[2];
    const float doubt_rad2 = parameters_.tilt_noise_rad * parameters_.tilt_noise_rad;
    const float mean_m = hits > 0 ? heights_m / static_cast<float>(hits) : 0.0F;
    out.tilt_m2 = doubt_rad2 * mean_m * mean_m;
    out.tilt_rad2 = 0.25F * doubt_rad2 * (out.rise_forward * out.rise_forward + out.rise_left * out.rise_left);
}

}  // namespace noctule
