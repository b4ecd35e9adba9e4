/// The bridge's duties as time passes: the flight's phases, heartbeat, progress, vehicle state, message rates, texts.
#include <algorithm>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstring>

#include "link/bridge.hpp"
#include "link/bridge_text.hpp"
#include "plan/mission.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kSecond_us = 1000000;
constexpr std::int64_t kNavFault_us = 2 * kSecond_us;        // nav silent for so long: the companion is faulted, its heartbeat stops
constexpr std::int64_t kVehiclePeriod_us = kSecond_us / 5;   // streams.toml, VEHICLE
constexpr std::int64_t kStreamsPeriod_us = 5 * kSecond_us;
constexpr std::int64_t kAccelerationWithin_us = 200000;      // setpoints farther apart tell no acceleration
constexpr std::int64_t kLocalFresh_us = kSecond_us / 2;
constexpr std::int64_t kRepeatedText_us = 5 * kSecond_us;
constexpr float kBelowFloor_m = 0.2F;                        // a setpoint so far below the vehicle cannot be followed: the floor is there
constexpr float kTextBurst = 8.0F;
constexpr float kPlace_hz = 2.0F;
constexpr float kBaro_hz = 20.0F;                            // streams.toml, BARO
constexpr float kTexts_hz = 2.0F;

}  // namespace

FlightView Bridge::view() const {
    FlightView v;
    v.now_us = now_us_;
    v.custom_mode = custom_mode_;
    if (flavour_ != nullptr) {
        v.offboard_mode = flavour_->offboard.custom_mode;
        v.land_mode = flavour_->land.custom_mode;
        v.takeoff_command = flavour_->takeoff_command;
    }
    v.armed = armed_;
    v.on_ground = landed_ == 1;
    v.in_air = landed_ == 2;
    v.setpoint_fresh = supervisor_.setpoint_fresh(now_us_);
    v.nav_done = nav_heard_ && nav_.want_disarm != 0;
    const auto state = static_cast<MissionState>(nav_.state);
    v.nav_landing = nav_heard_ && (state == MissionState::landing || state == MissionState::landed);
    v.below_floor = nav_heard_ && nav_.setpoint_valid != 0 && nav_.setpoint_z_m < nav_.z_m - kBelowFloor_m;
    v.fault = supervisor_.judge(now_us_);
    return v;
}

void Bridge::step_flight() {
    if (!flight_.active()) { return; }
    const bool lost_before = flight_.mission_lost();
    const FlightStep step = flight_.step(view());
    act(step);
    if (flight_.mission_lost() != lost_before) { publish_vehicle(); }
}

void Bridge::act(const FlightStep& step) {
    if (step.request != Request::none) { request(step.request); }
    const std::uint8_t severity = notice_severity(step.notice);
    switch (step.notice) {
        case Notice::none: return;
        case Notice::held:
        case Notice::landing_ordered: text(severity, "%s: %s", notice_text(step.notice), fault_text(step.fault)); break;
        case Notice::pilot_took_over: text(severity, "%s %s", notice_text(step.notice), flavour_ != nullptr ? flavour_->mode_name(custom_mode_) : "?"); break;
        default: text(severity, "%s", notice_text(step.notice)); break;
    }
    if (step.notice == Notice::landing_ordered) { order(command_t::ABORT); }
}

void Bridge::request(const Request request) {
    switch (request) {
        case Request::none: return;
        case Request::offboard_mode: send_mode(flavour_->offboard); return;
        case Request::land_mode: send_mode(flavour_->land); return;
        case Request::arm: send_command(MAV_CMD_COMPONENT_ARM_DISARM, {1.0F}); return;
        case Request::disarm: send_command(MAV_CMD_COMPONENT_ARM_DISARM, {0.0F}); return;
        case Request::takeoff: send_command(MAV_CMD_NAV_TAKEOFF, {0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F, p_.cruise_height_m}); return;
    }
}

void Bridge::send_mode(const FlightMode& mode) { send_command(MAV_CMD_DO_SET_MODE, {float{MAV_MODE_FLAG_CUSTOM_MODE_ENABLED}, mode.main, mode.sub}); }

void Bridge::send_command(const std::uint16_t command, const std::array<float, 7>& params) {
    mavlink_command_long_t out{};
    out.target_system = autopilot().system;
    out.target_component = autopilot().component;
    out.command = command;
    out.param1 = params[0];
    out.param2 = params[1];
    out.param3 = params[2];
    out.param4 = params[3];
    out.param5 = params[4];
    out.param6 = params[5];
    out.param7 = params[6];
    send_autopilot(mavlink_msg_command_long_encode_status, out);
}

/// What the setpoint's velocity changed by since the last one: autopilots turn a change of velocity alone into thrust too late. A jump is no
/// acceleration: it is cut to the limit that the setpoints are made with. False: there is no last one to compare with.
bool Bridge::acceleration_of(const Setpoint& setpoint, const std::int64_t t_us, Acceleration& out) const {
    const std::int64_t dt_us = t_us - sent_us_;
    if (sent_us_ < 0 || dt_us <= 0 || dt_us > kAccelerationWithin_us) { return false; }
    const float scale = 1.0F / (static_cast<float>(dt_us) * 1e-6F);
    out = {scale * (setpoint.vx_m_s - sent_.vx_m_s), scale * (setpoint.vy_m_s - sent_.vy_m_s), scale * (setpoint.vz_m_s - sent_.vz_m_s)};
    const float size = std::hypot(out.x_m_s2, out.y_m_s2, out.z_m_s2);
    const float cut = size > p_.accel_max_m_s2 ? p_.accel_max_m_s2 / size : 1.0F;
    out = {cut * out.x_m_s2, cut * out.y_m_s2, cut * out.z_m_s2};
    return true;
}

void Bridge::send_setpoint(const Setpoint& setpoint, const std::int64_t t_us) {
    Acceleration acceleration;
    const bool known = acceleration_of(setpoint, t_us, acceleration);
    sent_ = setpoint;
    sent_us_ = t_us;
    send_autopilot(mavlink_msg_set_position_target_local_ned_encode_status, to_set_position_target(setpoint, t_us, autopilot(), known ? &acceleration : nullptr));
    ++counters_.setpoints_sent;
}

void Bridge::send_heartbeat() {
    const bool nav_dead = nav_heard_ && now_us_ >= 0 && now_us_ - nav_us_ > kNavFault_us;
    if (nav_dead) { return; }
    mavlink_heartbeat_t out{};
    out.type = MAV_TYPE_ONBOARD_CONTROLLER;
    out.autopilot = MAV_AUTOPILOT_INVALID;
    out.base_mode = 0;
    out.custom_mode = nav_heard_ ? static_cast<std::uint32_t>(nav_.state) : 0U;
    switch (flight_.phase()) {
        case Phase::idle:
        case Phase::yielded: out.system_status = nav_heard_ && nav_.ready != 0 ? MAV_STATE_STANDBY : MAV_STATE_BOOT; break;
        case Phase::holding: out.system_status = MAV_STATE_CRITICAL; break;
        case Phase::landing: out.system_status = MAV_STATE_EMERGENCY; break;
        default: out.system_status = MAV_STATE_ACTIVE; break;
    }
    send_autopilot(mavlink_msg_heartbeat_encode_status, out);
    send_ground(mavlink_msg_heartbeat_encode_status, out);
}

void Bridge::publish_vehicle() {
    next_vehicle_us_ = now_us_ + kVehiclePeriod_us;
    vehicle_.t_us = now_us_;
    vehicle_.seq += 1;
    vehicle_.armed = armed_ ? 1 : 0;
    vehicle_.offboard = flavour_ != nullptr && custom_mode_ == flavour_->offboard.custom_mode ? 1 : 0;
    vehicle_.landed = landed_;
    vehicle_.mission_lost = flight_.mission_lost() ? 1 : 0;
    vehicle_.battery_remaining = battery_;
    vehicle_.local_position_valid = local_us_ >= 0 && now_us_ - local_us_ <= kLocalFresh_us ? 1 : 0;
    vehicle_.local_x_m = local_.x_m;
    vehicle_.local_y_m = local_.y_m;
    vehicle_.local_z_m = local_.z_m;
    vehicle_.local_yaw_rad = local_yaw_rad_;
    const TimeSync::Estimate clock = time_sync_.estimate();
    vehicle_.clock_offset_us = clock.offset_us;
    vehicle_.clock_round_trip_us = clock.valid ? static_cast<std::int32_t>(clock.round_trip_us) : -1;
    sink_.publish(vehicle_);
}

void Bridge::ask_for(const std::uint32_t msgid, const float rate_hz) { send_command(MAV_CMD_SET_MESSAGE_INTERVAL, {static_cast<float>(msgid), 1e6F / rate_hz}); }

/// All that we need, at once. An autopilot that sends nothing unasked but its heartbeat (ArduPilot) has told no time yet, and without time nothing else happens here.
void Bridge::wake_streams() {
    for (const Stream& stream : streams_) { ask_for(stream.msgid, stream.rate_hz); }
}

/// Asks for what does not come at half its rate or more; looks again every five seconds.
void Bridge::ask_for_streams() {
    const float span_s = static_cast<float>(now_us_ - streams_since_us_) * 1e-6F;
    constexpr int kFutileAtMost = 3;
    for (Stream& stream : streams_) {
        if (static_cast<float>(stream.count) < 0.5F * stream.rate_hz * span_s) {
            if (stream.futile == kFutileAtMost && stream.rate_hz > 1.0F) {
                text(MAV_SEVERITY_NOTICE, "%s comes at %.0f of %.0f Hz", stream.name, static_cast<double>(static_cast<float>(stream.count) / span_s), static_cast<double>(stream.rate_hz));
            }
            ++stream.futile;
            ask_for(stream.msgid, stream.rate_hz);
            if (stream.count == 0 && stream.substitute != 0) { ask_for(stream.substitute, stream.rate_hz); }
        } else {
            stream.futile = 0;
        }
        stream.count = 0;
    }
    // Only for an autopilot whose HIGHRES_IMU has no pressure, and only where somebody wants it.
    if (p_.alt_baro_sigma_m > 0.0F && (baro_.seq == 0 || baro_.t_us < streams_since_us_)) { ask_for(MAVLINK_MSG_ID_SCALED_PRESSURE, kBaro_hz); }
    // The place on ground stations' maps; not every one of them asks the autopilot for it.
    if (flavour_ != nullptr && flavour_->origin_serves && origin_known_ && global_us_ < streams_since_us_) { ask_for(MAVLINK_MSG_ID_GLOBAL_POSITION_INT, kPlace_hz); }
    streams_since_us_ = now_us_;
    next_streams_us_ = now_us_ + kStreamsPeriod_us;
}

/// STATUSTEXT to both sides, in chunks of 50 characters. The same text within five seconds, and more than two a second after a burst of
/// eight, are dropped and counted.
void Bridge::text(const std::uint8_t severity, const char* format, ...) {
    std::array<char, 160> line{};
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(line.data(), line.size(), format, arguments);
    va_end(arguments);
    const std::int64_t t_us = now_us_ >= 0 ? now_us_ : wall_us_;
    const bool repeated = last_text_us_ >= 0 && t_us >= last_text_us_ && t_us - last_text_us_ < kRepeatedText_us && std::strcmp(line.data(), last_text_.data()) == 0;
    if (t_us > text_tokens_us_) { text_tokens_ = std::min(kTextBurst, text_tokens_ + kTexts_hz * static_cast<float>(t_us - text_tokens_us_) * 1e-6F); }
    text_tokens_us_ = t_us;
    if (repeated || text_tokens_ < 1.0F) {
        ++counters_.texts_dropped;
        return;
    }
    text_tokens_ -= 1.0F;
    last_text_ = line;
    last_text_us_ = t_us;
    mavlink_statustext_t out{};
    const std::size_t length = std::strlen(line.data());
    out.severity = severity;
    if (length > sizeof out.text) { out.id = ++text_id_ == 0 ? ++text_id_ : text_id_; }
    for (std::size_t begin = 0; begin < length; begin += sizeof out.text) {
        std::memset(out.text, 0, sizeof out.text);
        std::memcpy(out.text, line.data() + begin, std::min(length - begin, sizeof out.text));
        send_autopilot(mavlink_msg_statustext_encode_status, out);
        send_ground(mavlink_msg_statustext_encode_status, out);
        ++out.chunk_seq;
    }
}

}  // namespace noctule
