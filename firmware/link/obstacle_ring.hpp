/// A laser scan as OBSTACLE_DISTANCE: the nearest point in each of 72 sectors of 5 degrees about the vehicle, clockwise from straight ahead.
///
/// Distances from the Body origin in the horizontal plane, whole centimetres. A sector in which no beam looked (outside the laser's field,
/// dropouts, or beams that point to floor or ceiling because the vehicle leans) is UINT16_MAX, unknown; one in which all beams looked and
/// none came back is max_distance + 1, free. Frame in: Lidar; out: Body, forward-right-down. Pure, no heap.
#pragma once

#include "lcmtypes/noctule/scan_t.hpp"
#include "link/mavlink.hpp"
#include "params.gen.hpp"

namespace noctule {

/// roll, pitch [rad], forward-left-up; z_m of the Body origin over the floor, NaN unknown (then no beam is left out for its height).
[[nodiscard]] mavlink_obstacle_distance_t to_obstacle_distance(const scan_t& scan, const Parameters& parameters, float roll_rad, float pitch_rad, float z_m);

}  // namespace noctule
