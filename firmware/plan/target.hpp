/// What the mission wants of the reference: where to go, how high, which way to look. Frame Map.
#pragma once

#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"

namespace noctule {

/// A point of the path ahead.
struct PathPoint {
    float x_m = 0.0F;
    float y_m = 0.0F;
    float clearance_m = 0.0F;  ///< from here to the nearest known hit point, at most about 0.8 m
};

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
