/// One range sample after the checks and the tilt compensation: what both forms of the altitude filter consume.
#pragma once

#include <cstdint>

namespace noctule {

/// Direction of a range sensor; the value indexes arrays.
enum class RangeSide : std::uint8_t { down = 0, up = 1 };

/// Facing of the levels that a sensor sees: +1 for surfaces under the vehicle, -1 for those over it.
[[nodiscard]] constexpr std::int8_t facing_of(const RangeSide side) { return side == RangeSide::down ? 1 : -1; }

/// Frame Map, SI units.
struct AltitudeReading {
    RangeSide side = RangeSide::down;
    std::int64_t t_us = 0;
    double age_s = 0.0;        ///< the filter's time minus t_us, >= 0
    double drop_m = 0.0;       ///< vertical part of the range, positive
    double mount_m = 0.0;      ///< height of the sensor over the Body origin at this tilt
    double variance_m2 = 0.0;  ///< of drop_m, scale error excluded
    float tilt_rad = 0.0F;     ///< angle between Body z and vertical
    float x_m = 0.0F;          ///< where the beam met the surface
    float y_m = 0.0F;
    bool place_known = true;   ///< false: the planar estimate is lost, x_m and y_m mean nothing
};

}  // namespace noctule
