/// What the bridge tells besides flying: obstacles, progress, the computer's load, the global origin, clocks; and REQUEST_MESSAGE.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "link/bridge.hpp"
#include "link/obstacle_ring.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kSecond_us = 1000000;
constexpr std::int64_t kObstaclePeriod_us = 100000;
constexpr std::int64_t kOriginAgain_us = 2 * kSecond_us;
constexpr int kOriginTries = 10;
constexpr float kNoElevation_m = 0.5F;      // 0 counts as unknown
constexpr std::int64_t kGlobalFresh_us = 3 * kSecond_us;
constexpr double kE7PerRadian = 180.0 / 3.14159265358979323846 * 1e7;
constexpr float kDrainSeen = 0.02F;         // share of the battery that must be gone before its drain is believed
constexpr std::uint16_t kHorizontalVelocity = 0x0002;
constexpr std::uint16_t kHorizontalPosition = 0x0018;   // relative or absolute
constexpr std::int64_t kEstimatorFresh_us = 3 * kSecond_us;
constexpr float kRejected = 1.0F;           // test ratio from which on the estimator leaves our position out

}  // namespace

void Bridge::on_scan(const scan_t& message) {
    if (p_.link_obstacles == 0 || !heard_ || (message.t_us < next_obstacles_us_ && message.t_us > next_obstacles_us_ - kSecond_us)) { return; }
    next_obstacles_us_ = message.t_us + kObstaclePeriod_us - kObstaclePeriod_us / 4;  // scans come in steps of their own
    const bool known = counters_.odometry_sent > 0 && last_odom_.quality >= 0;
    const float z_m = known ? last_odom_.z_m : std::numeric_limits<float>::quiet_NaN();
    const mavlink_obstacle_distance_t out = to_obstacle_distance(message, p_, attitude_.roll_rad, attitude_.pitch_rad, z_m);
    send_autopilot(mavlink_msg_obstacle_distance_encode_status, out);
    send_ground(mavlink_msg_obstacle_distance_encode_status, out);
}

void Bridge::on_objects(const objects_t& message) {
    const auto count = static_cast<std::size_t>(std::clamp<std::int32_t>(message.count, 0, objects_t::MAX_REGIONS));
    for (std::size_t i = 0; i < count; ++i) {
        if (message.object_id[i] <= newest_object_) { continue; }
        newest_object_ = message.object_id[i];
        text(MAV_SEVERITY_INFO, "object %d seen from %.1f %.1f, floor %d", static_cast<int>(newest_object_), static_cast<double>(nav_.x_m), static_cast<double>(nav_.y_m), static_cast<int>(nav_.floor));
    }
}

void Bridge::on_computer(const ComputerLoad& load) {
    mavlink_onboard_computer_status_t out{};
    out.time_usec = static_cast<std::uint64_t>(std::max<std::int64_t>(now_us_, 0));
    out.uptime = load.uptime_ms;
    // All ones and their like: not known.
    std::memset(out.cpu_cores, 0xFF, sizeof out.cpu_cores);
    std::memset(out.cpu_combined, 0xFF, sizeof out.cpu_combined);
    std::memset(out.gpu_cores, 0xFF, sizeof out.gpu_cores);
    std::memset(out.gpu_combined, 0xFF, sizeof out.gpu_combined);
    std::memset(out.temperature_core, INT8_MAX, sizeof out.temperature_core);
    for (std::size_t i = 0; i < sizeof out.fan_speed / sizeof out.fan_speed[0]; ++i) { out.fan_speed[i] = INT16_MAX; }
    std::memset(out.storage_type, 0xFF, sizeof out.storage_type);
    std::memset(out.storage_usage, 0xFF, sizeof out.storage_usage);
    std::memset(out.storage_total, 0xFF, sizeof out.storage_total);
    std::memset(out.link_type, 0xFF, sizeof out.link_type);
    std::memset(out.link_tx_rate, 0xFF, sizeof out.link_tx_rate);
    std::memset(out.link_rx_rate, 0xFF, sizeof out.link_rx_rate);
    std::memset(out.link_tx_max, 0xFF, sizeof out.link_tx_max);
    std::memset(out.link_rx_max, 0xFF, sizeof out.link_rx_max);
    out.cpu_combined[0] = load.cpu_percent;
    out.temperature_board = load.temperature_c;
    out.ram_usage = load.ram_used_mib;
    out.ram_total = load.ram_total_mib;
    send_ground(mavlink_msg_onboard_computer_status_encode_status, out);
}

/// Seconds of flight until the battery is at battery_return, from its drain since take-off; -1 unknown.
float Bridge::time_left_s() const {
    if (!armed_ || battery_ < 0.0F || drain_from_ < 0.0F || drain_from_ - battery_ < kDrainSeen) { return -1.0F; }
    const float flown_s = static_cast<float>(now_us_ - drain_since_us_) * 1e-6F;
    return std::max(0.0F, (battery_ - p_.battery_return) * flown_s / (drain_from_ - battery_));
}

void Bridge::send_progress() {
    if (!nav_heard_) { return; }
    const auto send = [this](const char* name, const float value) {
        mavlink_named_value_float_t out{};
        out.time_boot_ms = static_cast<std::uint32_t>(now_us_ / 1000);
        std::copy_n(name, std::min(std::strlen(name), sizeof out.name), out.name);
        out.value = value;
        send_ground(mavlink_msg_named_value_float_encode_status, out);
    };
    send("nav_state", static_cast<float>(nav_.state));
    send("nav_ready", static_cast<float>(nav_.ready));
    send("area_m2", nav_.known_area_m2);
    send("explored", nav_.explored_share);
    send("floor", static_cast<float>(nav_.floor));
    send("quality", static_cast<float>(nav_.quality));
    send("time_left", time_left_s());
}

/// An autopilot without a global origin is given one, on the ground only, and asked whether it has it now. One that cannot use it is only asked.
void Bridge::step_origin() {
    if (p_.link_origin == 0 || armed_ || origin_known_ || origin_tries_ > kOriginTries || now_us_ < next_origin_us_) { return; }
    next_origin_us_ = now_us_ + kOriginAgain_us;
    const bool gives = flavour_ != nullptr && flavour_->origin_serves;
    if (origin_tries_++ == kOriginTries) {
        if (gives) { text(MAV_SEVERITY_NOTICE, "global origin not confirmed: no place on the map"); }
        return;
    }
    // The first time it is only asked: an origin that is there stays. The second prepares for it.
    if (origin_tries_ == 2 && gives && flavour_->elevation_parameter != nullptr) {
        mavlink_param_set_t out{};
        out.target_system = autopilot().system;
        out.target_component = autopilot().component;
        std::memcpy(out.param_id, flavour_->elevation_parameter, strnlen(flavour_->elevation_parameter, sizeof out.param_id));
        out.param_type = MAV_PARAM_TYPE_REAL32;
        out.param_value = p_.link_origin_altitude_m != 0.0F ? p_.link_origin_altitude_m : kNoElevation_m;
        send_autopilot(mavlink_msg_param_set_encode_status, out);
    } else if (origin_tries_ > 1 && gives) {
        const auto latitude = static_cast<std::int32_t>(std::lround(static_cast<double>(p_.link_origin_latitude_rad) * kE7PerRadian));
        const auto longitude = static_cast<std::int32_t>(std::lround(static_cast<double>(p_.link_origin_longitude_rad) * kE7PerRadian));
        if (origin_tries_ % 2 == 1) {
            mavlink_command_int_t out{};
            out.target_system = autopilot().system;
            out.target_component = autopilot().component;
            out.frame = MAV_FRAME_GLOBAL;
            out.command = kSetGlobalOrigin;
            out.x = latitude;
            out.y = longitude;
            out.z = p_.link_origin_altitude_m;
            send_autopilot(mavlink_msg_command_int_encode_status, out);
        } else {
            mavlink_set_gps_global_origin_t out{};
            out.target_system = autopilot().system;
            out.latitude = latitude;
            out.longitude = longitude;
            out.altitude = static_cast<std::int32_t>(std::lround(p_.link_origin_altitude_m * 1000.0F));
            out.time_usec = static_cast<std::uint64_t>(now_us_);
            send_autopilot(mavlink_msg_set_gps_global_origin_encode_status, out);
        }
    }
    send_command(MAV_CMD_REQUEST_MESSAGE, {static_cast<float>(MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)});
}

void Bridge::take_origin(const mavlink_message_t& message) {
    mavlink_gps_global_origin_t in;
    mavlink_msg_gps_global_origin_decode(&message, &in);
    if (origin_known_ || (in.latitude == 0 && in.longitude == 0)) { return; }
    origin_known_ = true;
    if (origin_tries_ > 1 && flavour_ != nullptr && flavour_->origin_serves) { text(MAV_SEVERITY_INFO, "global origin set"); }
}

/// Somebody gave an origin to an autopilot that makes no global position of it: its landing mode would fly off.
bool Bridge::lands_elsewhere() const {
    return flavour_ != nullptr && !flavour_->origin_serves && origin_known_ && (global_us_ < 0 || now_us_ - global_us_ > kGlobalFresh_us);
}

/// TIMESYNC both ways. We answer with the autopilot's own clock as we know it: all stamps that we send are on it, so the offset it finds is
/// our delay alone. What it answers to us gives the offset of our clock, for drivers that stamp with it (VEHICLE.clock_offset_us).
void Bridge::take_timesync(const mavlink_message_t& message) {
    constexpr std::int64_t kNanoseconds = 1000;
    mavlink_timesync_t in;
    mavlink_msg_timesync_decode(&message, &in);
    if (in.tc1 != 0) {
        if (in.ts1 == timesync_sent_ns_ && in.ts1 != 0) { time_sync_.add(in.ts1 / kNanoseconds, in.tc1 / kNanoseconds, wall_us_); }
        timesync_sent_ns_ = 0;
        return;
    }
    if (now_us_ < 0) { return; }
    mavlink_timesync_t out{};
    out.tc1 = now_us_ * kNanoseconds;
    out.ts1 = in.ts1;
    send_autopilot(mavlink_msg_timesync_encode_status, out);
}

void Bridge::send_timesync() {
    if (wall_us_ <= 0) { return; }
    mavlink_timesync_t out{};
    out.ts1 = timesync_sent_ns_ = wall_us_ * 1000;
    send_autopilot(mavlink_msg_timesync_encode_status, out);
}

void Bridge::take_estimator(const std::uint16_t flags, const float position_ratio) {
    estimator_us_ = now_us_;
    estimator_flags_ = flags;
    if (position_ratio > kRejected && armed_ && flight_.active()) {
        text(MAV_SEVERITY_WARNING, "autopilot rejects our position, ratio %.1f", static_cast<double>(position_ratio));
    }
}

/// ESTIMATOR_STATUS or EKF_STATUS_REPORT, where one is sent, must claim a horizontal position. In flight they tell of a loss far too late.
/// Their flag of a constant position says nothing: PX4 sets it at rest, whatever it knows.
bool Bridge::estimator_lost() const {
    if (estimator_us_ < 0 || now_us_ - estimator_us_ > kEstimatorFresh_us) { return false; }
    return (estimator_flags_ & kHorizontalVelocity) == 0 || (estimator_flags_ & kHorizontalPosition) == 0;
}

/// EKF_STATUS_REPORT is of ArduPilot's dialect, which the headers do not have: read by hand, checksum included.
void Bridge::take_unknown(const std::span<const std::uint8_t> frame) {
    constexpr std::size_t kHeader = 10;
    constexpr std::uint8_t kExtra = 71;
    if (frame.size() < kHeader + 2 || frame[0] != MAVLINK_STX || frame[5] != system_ || frame[6] != MAV_COMP_ID_AUTOPILOT1) { return; }
    const std::uint32_t id = static_cast<std::uint32_t>(frame[7]) | static_cast<std::uint32_t>(frame[8]) << 8U | static_cast<std::uint32_t>(frame[9]) << 16U;
    const std::size_t length = frame[1];
    if (id != kEkfStatusReport || frame.size() < kHeader + length + 2 || length > 26) { return; }
    std::uint16_t crc = crc_calculate(frame.data() + 1, static_cast<std::uint16_t>(kHeader - 1 + length));
    crc_accumulate(kExtra, &crc);
    if (frame[kHeader + length] != (crc & 0xFFU) || frame[kHeader + length + 1] != crc >> 8U) { return; }
    std::array<std::uint8_t, 26> payload{};  // five variances, flags, one more variance; trailing zeros are not sent
    std::copy_n(frame.begin() + kHeader, length, payload.begin());
    float position = 0.0F;
    std::memcpy(&position, payload.data() + 4, sizeof position);
    const auto flags = static_cast<std::uint16_t>(payload[20] | payload[21] << 8U);
    for (Stream& stream : streams_) {
        if (stream.substitute == kEkfStatusReport) { ++stream.count; }
    }
    take_estimator(flags, position);
}

}  // namespace noctule
