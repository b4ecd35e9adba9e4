#include "link/obstacle_ring.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "core/angle.hpp"

namespace noctule {

namespace {

constexpr std::size_t kSectors = MAVLINK_MSG_OBSTACLE_DISTANCE_FIELD_DISTANCES_LEN;
constexpr float kSector_rad = 2.0F * kPi / static_cast<float>(kSectors);
constexpr float kCentimetres_m = 100.0F;
constexpr float kFloorMargin_m = 0.15F;     // a point this low is floor
constexpr float kLeanMost_rad = 0.35F;      // leaning more than this the plane of the laser says nothing useful

std::uint16_t to_centimetres(const float metres) { return static_cast<std::uint16_t>(std::lround(std::clamp(metres * kCentimetres_m, 0.0F, 65533.0F))); }

}  // namespace

mavlink_obstacle_distance_t to_obstacle_distance(const scan_t& scan, const Parameters& parameters, const float roll_rad, const float pitch_rad, const float z_m) {
    mavlink_obstacle_distance_t out{};
    out.time_usec = static_cast<std::uint64_t>(scan.t_us);
    out.sensor_type = MAV_DISTANCE_SENSOR_LASER;
    out.frame = MAV_FRAME_BODY_FRD;
    out.increment = static_cast<std::uint8_t>(360 / kSectors);
    out.increment_f = 360.0F / static_cast<float>(kSectors);
    out.angle_offset = 0.0F;
    out.min_distance = to_centimetres(scan.range_min_m);
    out.max_distance = to_centimetres(scan.range_max_m);
    std::memset(out.distances, 0xFF, sizeof out.distances);  // the fields are packed: no reference to them
    std::array<std::uint16_t, kSectors> nearest_cm;
    nearest_cm.fill(UINT16_MAX);
    if (std::fabs(roll_rad) > kLeanMost_rad || std::fabs(pitch_rad) > kLeanMost_rad) { return out; }
    const auto free_cm = static_cast<std::uint16_t>(out.max_distance + 1);
    const auto count = static_cast<std::size_t>(std::clamp<std::int32_t>(scan.count, 0, scan_t::MAX_BEAMS));
    const float up_x = -std::sin(pitch_rad);  // the z of Map in Body axes
    const float up_y = std::cos(pitch_rad) * std::sin(roll_rad);
    for (std::size_t i = 0; i < count; ++i) {
        const float range_m = scan.range_m[i];
        if (std::isnan(range_m) || range_m < scan.range_min_m) { continue; }
        const bool hit = range_m <= scan.range_max_m;
        const float bearing = scan.bearing_first_rad + static_cast<float>(i) * scan.bearing_increment_rad + parameters.lidar_yaw_rad;
        const float reach_m = hit ? range_m : scan.range_max_m;
        const float x = parameters.lidar_x_m + reach_m * std::cos(bearing);
        const float y = parameters.lidar_y_m + reach_m * std::sin(bearing);
        if (hit && std::isfinite(z_m) && z_m + parameters.lidar_z_m + up_x * x + up_y * y < kFloorMargin_m && z_m + parameters.lidar_z_m > kFloorMargin_m) { continue; }
        const float clockwise = -std::atan2(y, x) + 0.5F * kSector_rad;
        const auto sector = static_cast<std::size_t>((clockwise < 0.0F ? clockwise + 2.0F * kPi : clockwise) / kSector_rad) % kSectors;
        const std::uint16_t cm = hit ? std::min(to_centimetres(std::hypot(x, y)), free_cm) : free_cm;
        nearest_cm[sector] = std::min(nearest_cm[sector], cm);  // unknown is the greatest number of all
    }
    std::memcpy(out.distances, nearest_cm.data(), sizeof out.distances);
    return out;
}

}  // namespace noctule
