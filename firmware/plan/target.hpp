/// What the mission wants of the reference: where to go, how high, which way to look. Frame Map.
#pragma once

#include <cstdint>

#include <algorithm>
#include <cmath>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "params.gen.hpp"

namespace noctule {

/// A point of the path ahead.
struct PathPoint {
    float x_m = 0.0F;
    float y_m = 0.0F;
    float clearance_m = 0.0F;  ///< from here to the nearest known hit point, at most about 0.8 m
    float way_m = 10.0F;       ///< free straight on from here, along the path's direction; 10: more than stopping takes, or so far ahead that it bounds no speed
};

/// Speed allowed where the nearest hit point is this far from the centre of the hull: the full one from the comfortable
/// clearance on, falling linearly to speed_near_m_s where the hull just fits. docs/maths/command.md, equation (1).
[[nodiscard]] inline float speed_at_clearance_m_s(const Parameters& p, const float clearance_m) {
    const float low_m = p.hull_radius_m + p.plan_margin_m;
    const float high_m = std::max(p.comfort_clearance_m, low_m + 0.01F);
    const float near_m_s = std::min(p.speed_near_m_s, p.speed_max_m_s);
    return near_m_s + (p.speed_max_m_s - near_m_s) * std::clamp((clearance_m - low_m) / (high_m - low_m), 0.0F, 1.0F);
}

/// From the centre of the hull to a hit point: what the guard keeps at least.
[[nodiscard]] inline float least_held_m(const Parameters& p) { return p.hull_radius_m + std::min(p.guard_least_m, p.guard_margin_m); }

constexpr float kBrakeShare = 0.35F;  ///< of the acceleration limit that the speed profile counts on; the rest is for jerk and curves

/// Of speed, braking and curves that is left in a gap narrower than a door, where a centimetre counts. docs/maths/command.md, equation (1b).
[[nodiscard]] inline float tight_share(const Parameters& p, const float clearance_m) {
    constexpr float kTightM = 0.14F;      // hull to obstacle
    constexpr float kTightLeast = 0.4F;
    return std::clamp((clearance_m - p.hull_radius_m) / kTightM, kTightLeast, 1.0F);
}

/// The longest way over which the reference brakes to a stop from the speed at a clearance. docs/maths/command.md, equation (3).
[[nodiscard]] inline float braking_m(const Parameters& p, const float clearance_m) {
    const float speed_m_s = speed_at_clearance_m_s(p, clearance_m);
    return 0.5F * speed_m_s * speed_m_s / (kBrakeShare * tight_share(p, clearance_m) * p.accel_max_m_s2);
}

constexpr float kAnswerS = 0.25F;    ///< until the vehicle brakes because of a setpoint
constexpr float kStopShare = 0.8F;   ///< of the acceleration limit: what a vehicle is sure to brake with

/// Speed from which it stops within a way. docs/maths/command.md, equation (1a).
[[nodiscard]] inline float stops_from_m_s(const Parameters& p, const float way_m) {
    const float brake_m_s2 = kStopShare * p.accel_max_m_s2;
    const float lag_m_s = brake_m_s2 * kAnswerS;
    return way_m > 0.0F ? std::sqrt(lag_m_s * lag_m_s + 2.0F * brake_m_s2 * way_m) - lag_m_s : 0.0F;
}

/// The way it takes to stop from a speed.
[[nodiscard]] inline float stopping_m(const Parameters& p, const float speed_m_s) {
    return speed_m_s * kAnswerS + 0.5F * speed_m_s * speed_m_s / (kStopShare * p.accel_max_m_s2);
}

struct Target {
    enum class Mode : std::uint8_t {
        none,    ///< no setpoint is to be sent
        ground,  ///< the spot where the vehicle stands, motors not yet armed
        hold,    ///< stop, stay
        follow,  ///< fly the path and stop at its end
        land,    ///< stay over the last point of the path and go down until the autopilot says landed
    };
    Mode mode = Mode::none;
    Bounded<PathPoint, kMaxPathPoints> path;  ///< begins at the last setpoint
    float z_m = 0.0F;                         ///< height wanted of the Body origin
    float climb_rate_m_s = 0.0F;              ///< greatest rate, up or down
    float yaw_rad = 0.0F;                     ///< heading wanted
};

}  // namespace noctule
