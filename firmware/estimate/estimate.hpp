/// What the estimators hand down the line after one scan.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "core/frames.hpp"

namespace noctule {

/// One beam after de-skew and tilt compensation. Frame: Body at the stamp of the scan, turned level with gravity
/// (origin at the vehicle, x along its yaw, z up).
struct ScanPoint {
    float x_m = 0.0F;
    float y_m = 0.0F;
    float z_m = 0.0F;          ///< height over the vehicle
    float origin_x_m = 0.0F;   ///< where the laser stood when this beam was cast, same frame
    float origin_y_m = 0.0F;
    float range_m = 0.0F;      ///< measured; range_max_m where nothing was hit
    std::int16_t beam = 0;     ///< index in the scan, rising
    bool hit = false;          ///< false: nothing was hit up to range_max_m (the point lies at that range)
};

/// A sweep without its bad beams, as seen from the pose at its stamp.
struct LevelScan {
    std::int64_t t_us = 0;
    float range_max_m = 0.0F;
    float bearing_increment_rad = 0.0F;
    Bounded<ScanPoint, kMaxBeams> points;
};

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
    float floor_z_m = 0.0F;         ///< elevation of the building's floor at this place (not of a table)
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
