/// A sweep after de-skew and tilt compensation: what every later stage reads instead of raw ranges.
#pragma once

#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"

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
    float range_noise_m = 0.0F;       ///< standard deviation to reckon with (RangeNoise)
    float rise_forward = 0.0F;        ///< of the sweep's plane, per metre forward and left
    float rise_left = 0.0F;
    float tilt_m2 = 0.0F;             ///< what doubt about roll and pitch leaves of doubt about the pose (docs/maths/walls.md, equation 9)
    float tilt_rad2 = 0.0F;
    Bounded<ScanPoint, kMaxBeams> points;
};

}  // namespace noctule
