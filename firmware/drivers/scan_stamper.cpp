#include "drivers/scan_stamper.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

namespace noctule {

namespace {

constexpr std::uint32_t kNoReturn_mm = 65533;  // UST: nothing within range (its protocol specification, section on distances)

static_assert(scan_t::MAX_BEAMS == kMaxBeams);

}  // namespace

ScanStamper::Counters ScanStamper::counters() const {
    Counters all = counters_;
    all.clock_restarts = autopilot_.restarts();
    return all;
}

bool ScanStamper::fill(const Hokuyo& sensor, const scip::Measurement& measurement, const std::int64_t sensor_us, const std::int64_t arrival_us,
                       const float range_max_m, scan_t& message) {
    laser_.add(sensor_us, arrival_us);
    if (!autopilot_.valid(arrival_us)) {
        ++counters_.without_clock;
        return false;
    }
    const auto offset_us = static_cast<std::int64_t>(std::lround(parameters_.lidar_stamp_offset_s * 1e6F));
    const std::int64_t t_us = autopilot_.from_host_us(laser_.to_host_us(sensor_us)) + offset_us;
    if (autopilot_.restarts() != restarts_seen_) {
        restarts_seen_ = autopilot_.restarts();
        published_ = false;
    }
    if (published_ && t_us <= last_us_) {
        ++counters_.backwards;
        return false;
    }
    published_ = true;
    last_us_ = t_us;

    const scip::SensorParameters& known = sensor.parameters();
    message.t_us = t_us;
    message.seq = seq_++;
    message.count = static_cast<std::int32_t>(measurement.count);
    message.time_increment_us = sensor.time_increment_us();
    message.bearing_first_rad = sensor.bearing_first_rad();
    message.bearing_increment_rad = sensor.bearing_increment_rad();
    message.range_min_m = static_cast<float>(known.range_min_mm) * 1e-3F;
    message.range_max_m = static_cast<float>(known.range_max_mm) * 1e-3F;
    if (range_max_m > 0.0F) { message.range_max_m = std::min(message.range_max_m, range_max_m); }
    std::fill(std::begin(message.range_m), std::end(message.range_m), 0.0F);
    for (std::size_t i = 0; i < measurement.count; ++i) {
        const std::uint32_t distance_mm = measurement.distance_mm[i];
        const float range_m = static_cast<float>(distance_mm) * 1e-3F;
        if (distance_mm < static_cast<std::uint32_t>(known.range_min_mm)) {
            message.range_m[i] = std::numeric_limits<float>::quiet_NaN();
        } else if (distance_mm >= kNoReturn_mm || range_m > message.range_max_m) {
            message.range_m[i] = std::numeric_limits<float>::infinity();
        } else {
            message.range_m[i] = range_m;
        }
    }
    ++counters_.published;
    return true;
}

}  // namespace noctule
