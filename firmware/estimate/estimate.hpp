/// What the estimators hand down the line after one scan.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/frames.hpp"
#include "sense/level_scan.hpp"

namespace noctule {

/// Planar pose and velocity at the stamp of a scan.
struct PlanarEstimate {
    Pose2<Map, Body> pose_map_body;
    float vx_m_s = 0.0F;            ///< frame Map
    float vy_m_s = 0.0F;            ///< frame Map
    float yaw_rate_rad_s = 0.0F;    ///< about Map z
    std::array<float, 6> covariance{};           ///< upper triangle of (x, y, yaw): xx, xy, xyaw, yy, yyaw, yawyaw
    std::array<float, 3> velocity_covariance{};  ///< xx, xy, yy [m^2/s^2]
    std::int32_t quality = -1;      ///< 0 to 100; -1: lost
    std::int32_t reset_counter = 0; ///< counts jumps of the pose
    std::int32_t walls_seen = 0;
    std::int32_t walls_matched = 0;
    std::int32_t landmarks = 0;
    float effective_particles = 0.0F;
};

/// Height and climb at the stamp of a scan, and what is under and over the vehicle.
struct AltitudeEstimate {
    float z_m = 0.0F;               ///< of the Body origin, frame Map (zero: the floor at the start)
    float vz_m_s = 0.0F;
    float z_var_m2 = 1.0F;
    float vz_var_m2_s2 = 1.0F;
    float ground_z_m = std::numeric_limits<float>::quiet_NaN();   ///< surface under the vehicle
    float ceiling_z_m = std::numeric_limits<float>::quiet_NaN();  ///< surface over the vehicle
    float floor_z_m = 0.0F;         ///< elevation of the building's floor at this place (not of a table); on stairs the lower one
    bool on_stairs = false;         ///< the surfaces below came one after the other as treads do
    bool valid = false;             ///< false: no range reading for so long that z is not to be trusted
};

/// The whole estimate.
struct Estimate {
    std::int64_t t_us = 0;
    PlanarEstimate planar;
    AltitudeEstimate altitude;
    float roll_rad = 0.0F;
    float pitch_rad = 0.0F;
};

}  // namespace noctule
