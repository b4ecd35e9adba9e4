/// Where the vehicle was at a frame's time, and what the laser saw then.
///
/// Model: linear between two poses of noctule-nav, each beam cast from the pose at its own time (docs/maths/vision.md, "Time").
/// Frame Map. Fixed memory, no heap, not thread-safe.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "recognise/camera_model.hpp"

namespace noctule {

/// One pose of the vehicle as noctule-nav estimated it.
struct VehiclePose {
    std::int64_t t_us = 0;
    double x_m = 0.0;
    double y_m = 0.0;
    double z_m = 0.0;
    double roll_rad = 0.0;
    double pitch_rad = 0.0;
    double yaw_rad = 0.0;
    double position_var_m2 = 0.0;   ///< greater of x and y
    double yaw_var_rad2 = 0.0;
    double ground_z_m = 0.0;        ///< elevation of the floor under the vehicle; NaN unknown
    double ceiling_z_m = 0.0;       ///< NaN unknown
    double yaw_rate_rad_s = 0.0;    ///< about Map z, set by PoseHistory::at
    std::int32_t floor = 0;
    std::int32_t reset_counter = 0;
    bool usable = false;            ///< localised

    /// A point in Body carried to Map.
    [[nodiscard]] Vec3 to_map(const Vec3& point_body_m) const;
    /// A direction in Body carried to Map.
    [[nodiscard]] Vec3 turn_to_map(const Vec3& direction_body) const;
    /// A point in Map carried to Body.
    [[nodiscard]] Vec3 to_body(const Vec3& point_map_m) const;
};

/// One sweep of the laser, as it came.
struct LaserSweep {
    std::int64_t t_us = 0;               ///< last beam
    std::int32_t count = 0;
    float time_increment_us = 0.0F;
    float bearing_first_rad = 0.0F;
    float bearing_increment_rad = 0.0F;
    std::array<float, kMaxBeams> range_m{};
};

class PoseHistory {
public:
    /// Appends a pose; one that is not newer than the last empties the history first (a restart of the clock).
    void add(const VehiclePose& pose);

    void add(const LaserSweep& sweep);

    [[nodiscard]] std::int64_t newest_us() const { return count_ > 0 ? at_index(count_ - 1).t_us : -1; }

    /// The pose at t_us. False: before the first or after the newest, a gap over 0.25 s, a jump, or not localised.
    [[nodiscard]] bool at(std::int64_t t_us, VehiclePose& out) const;

    /// Hit points of the sweep nearest to t_us whose poses are known, in Map, in the order of the beams. Empty: none within 0.2 s.
    /// mount: x, y, z [m] and yaw [rad] of the laser in Body.
    std::span<const Vec3> points(std::int64_t t_us, const std::array<double, 4>& mount);

private:
    static constexpr std::size_t kPoses = 64;
    static constexpr std::size_t kSweeps = 4;

    [[nodiscard]] const VehiclePose& at_index(const std::size_t i) const { return poses_[(first_ + i) % kPoses]; }

    std::array<VehiclePose, kPoses> poses_{};
    std::size_t first_ = 0;
    std::size_t count_ = 0;
    std::array<LaserSweep, kSweeps> sweeps_{};
    std::size_t next_sweep_ = 0;
    Bounded<Vec3, kMaxBeams> points_;
};

}  // namespace noctule
