#include "link/bridge.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "link/bridge_text.hpp"
#include "metadata.gen.hpp"
#include "plan/policy.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kSecond_us = 1000000;
constexpr std::int64_t kSubstituteAfter_us = kSecond_us;      // the better message is silent for so long: take the coarser one
constexpr std::int64_t kRestartJump_us = 5 * kSecond_us;      // the autopilot's clock went back this far: it restarted
constexpr std::int64_t kBaroPeriod_us = 40000;  // HIGHRES_IMU repeats the pressure far more often than the sensor is read
constexpr std::int64_t kLocalYawFresh_us = 200000;

}  // namespace

Bridge::Bridge(Parameters& parameters, BridgeSink& sink)
    : p_(parameters), sink_(sink), supervisor_(parameters), flight_(parameters), ftp_(kMetadataFiles), table_(parameters),
      streams_{{{"HIGHRES_IMU", MAVLINK_MSG_ID_HIGHRES_IMU, MAVLINK_MSG_ID_SCALED_IMU, static_cast<float>(parameters.link_imu_hz), 0, 0},
                {"ATTITUDE_QUATERNION", MAVLINK_MSG_ID_ATTITUDE_QUATERNION, MAVLINK_MSG_ID_ATTITUDE, 50.0F, 0, 0},
                {"DISTANCE_SENSOR", MAVLINK_MSG_ID_DISTANCE_SENSOR, 0, 20.0F, 0, 0},
                {"LOCAL_POSITION_NED", MAVLINK_MSG_ID_LOCAL_POSITION_NED, 0, 20.0F, 0, 0},
                {"EXTENDED_SYS_STATE", MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 0, 5.0F, 0, 0},
                {"SYS_STATUS", MAVLINK_MSG_ID_SYS_STATUS, 0, 1.0F, 0, 0},
                {"BATTERY_STATUS", MAVLINK_MSG_ID_BATTERY_STATUS, 0, 1.0F, 0, 0},
                {"ESTIMATOR_STATUS", MAVLINK_MSG_ID_ESTIMATOR_STATUS, kEkfStatusReport, 1.0F, 0, 0}}} {
    imu_heard_us_.fill(-1);
    if (p_.link_system_id != 0) { system_ = static_cast<std::uint8_t>(p_.link_system_id); }
    to_autopilot_.set_ids(system_, MAV_COMP_ID_ONBOARD_COMPUTER);
    to_ground_.set_ids(system_, MAV_COMP_ID_ONBOARD_COMPUTER);
    camera_to_ground_.set_ids(system_, MAV_COMP_ID_CAMERA);
}

void Bridge::from_autopilot(const std::span<const std::uint8_t> bytes) {
    autopilot_reader_.push_datagram(bytes, [this](const MavlinkFrame& frame) { autopilot_frame(frame); });
}

void Bridge::autopilot_frame(const MavlinkFrame& frame) {
    if (frame.known) {
        if (is_us(frame.message)) { return; }  // our own, echoed by a router
        if (frame.message.msgid == MAVLINK_MSG_ID_HEARTBEAT) { take_heartbeat(frame.message); }
        if (heard_ && frame.message.sysid == system_ && frame.message.compid == MAV_COMP_ID_AUTOPILOT1) {
            spoke_ = true;
            take(frame.message);
        }
    } else if (heard_) {
        take_unknown(frame.bytes);
    }
    pass_to_ground(frame);
}

/// What is withheld leaves no gap in the numbers of the rest: a ground station would take it for loss on its link.
void Bridge::pass_to_ground(const MavlinkFrame& frame) {
    const bool numbered = frame.message.sysid == system_ && frame.message.compid == MAV_COMP_ID_AUTOPILOT1;
    if (!passes_to_ground(frame)) {
        withheld_ += numbered ? 1 : 0;
        return;
    }
    std::array<std::uint8_t, kMaxMavlinkFrame> buffer;
    sink_.to_ground(numbered ? with_sequence(frame, static_cast<std::uint8_t>(frame.message.seq - withheld_), buffer) : frame.bytes);
}

bool Bridge::passes_to_ground(const MavlinkFrame& frame) {
    if (!frame.known) { return true; }
    if (frame.target.system == system_ && frame.target.component == MAV_COMP_ID_ONBOARD_COMPUTER) { return false; }
    if (frame.message.msgid != MAVLINK_MSG_ID_HIGHRES_IMU) { return true; }
    // We asked for this one at a rate that is no good to a ground station.
    if (p_.link_ground_imu_hz <= 0 || now_us_ < next_ground_imu_us_) { return false; }
    next_ground_imu_us_ = now_us_ + kSecond_us / p_.link_ground_imu_hz;
    return true;
}

void Bridge::take_heartbeat(const mavlink_message_t& message) {
    mavlink_heartbeat_t heartbeat;
    mavlink_msg_heartbeat_decode(&message, &heartbeat);
    if (message.compid != MAV_COMP_ID_AUTOPILOT1 || heartbeat.autopilot == MAV_AUTOPILOT_INVALID) { return; }
    const bool wanted = p_.link_system_id == 0 ? (!heard_ || message.sysid == system_) : message.sysid == p_.link_system_id;
    if (!wanted) {
        ++counters_.other_autopilots;
        other_autopilot_us_ = now_us_;
        text(MAV_SEVERITY_WARNING, "ignoring a second autopilot, system %u", static_cast<unsigned>(message.sysid));
        return;
    }
    if (!heard_) {
        heard_ = true;
        system_ = message.sysid;
        to_autopilot_.set_ids(system_, MAV_COMP_ID_ONBOARD_COMPUTER);
        to_ground_.set_ids(system_, MAV_COMP_ID_ONBOARD_COMPUTER);
        camera_to_ground_.set_ids(system_, MAV_COMP_ID_CAMERA);
        flavour_ = flavour_of(heartbeat.autopilot);
        if (flavour_ == nullptr) {
            text(MAV_SEVERITY_WARNING, "autopilot type %u cannot be flown, watching only", static_cast<unsigned>(heartbeat.autopilot));
        }
        table_.cast_integers(flavour_ != nullptr && flavour_->cast_integers);
        begin_preflight();
    }
    const bool armed = (heartbeat.base_mode & MAV_MODE_FLAG_SAFETY_ARMED) != 0;
    const bool changed = armed != armed_ || heartbeat.custom_mode != custom_mode_;
    armed_ = armed;
    custom_mode_ = heartbeat.custom_mode;
    if (!armed_) {
        battery_landing_ = false;
        store_parameters();
    }
    if (changed && now_us_ >= 0) {
        step_flight();
        publish_vehicle();
    }
}

void Bridge::take(const mavlink_message_t& message) {
    for (Stream& stream : streams_) {
        if (message.msgid == stream.msgid || (stream.substitute != 0 && message.msgid == stream.substitute)) { ++stream.count; }
    }
    const auto attitude = [&](auto decode, auto in, const bool substitute) {
        decode(&message, &in);
        FullAttitude out;
        if (from_mavlink(in, out)) { take_attitude(out, substitute); } else { ++counters_.refused_samples; }
    };
    switch (message.msgid) {
        case MAVLINK_MSG_ID_HIGHRES_IMU: take_highres(message); return;
        case MAVLINK_MSG_ID_RAW_IMU:
            if (flavour_ == &kArdupilot) { take_imu(1, mavlink_msg_raw_imu_decode, message); }  // elsewhere its units are the sensor's own
            return;
        case MAVLINK_MSG_ID_SCALED_IMU: take_imu(2, mavlink_msg_scaled_imu_decode, message); return;
        case MAVLINK_MSG_ID_SCALED_IMU2: take_imu(3, mavlink_msg_scaled_imu2_decode, message); return;
        case MAVLINK_MSG_ID_SCALED_IMU3: take_imu(4, mavlink_msg_scaled_imu3_decode, message); return;
        case MAVLINK_MSG_ID_SCALED_PRESSURE: {
            mavlink_scaled_pressure_t in;
            mavlink_msg_scaled_pressure_decode(&message, &in);
            baro_t height{};
            if (!from_mavlink(in, height)) { ++counters_.refused_samples; return; }
            take_baro(height, true);
            return;
        }
        case MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude(mavlink_msg_attitude_quaternion_decode, mavlink_attitude_quaternion_t{}, false); return;
        case MAVLINK_MSG_ID_ATTITUDE: attitude(mavlink_msg_attitude_decode, mavlink_attitude_t{}, true); return;
        case MAVLINK_MSG_ID_ESTIMATOR_STATUS: {
            mavlink_estimator_status_t in;
            mavlink_msg_estimator_status_decode(&message, &in);
            take_estimator(in.flags, in.pos_horiz_ratio);
            return;
        }
        case MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: take_origin(message); return;
        case MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_us_ = now_us_; return;
        case MAVLINK_MSG_ID_DISTANCE_SENSOR: take_range(message); return;
        case MAVLINK_MSG_ID_LOCAL_POSITION_NED: {
            mavlink_local_position_ned_t in;
            mavlink_msg_local_position_ned_decode(&message, &in);
            LocalPosition position;
            if (!from_mavlink(in, position)) { ++counters_.refused_samples; return; }
            advance(position.t_us);
            local_ = position;
            local_us_ = now_us_;
            const bool yaw_known = local_yaw_us_ >= 0 && now_us_ - local_yaw_us_ <= kLocalYawFresh_us;
            supervisor_.local_position(position, yaw_known ? local_yaw_rad_ : std::numeric_limits<float>::quiet_NaN(), now_us_);
            return;
        }
        case MAVLINK_MSG_ID_EXTENDED_SYS_STATE: {
            mavlink_extended_sys_state_t in;
            mavlink_msg_extended_sys_state_decode(&message, &in);
            const std::int8_t landed = landed_from_mavlink(in);
            const bool changed = landed != landed_;
            landed_ = landed;
            if (changed && now_us_ >= 0) { publish_vehicle(); }
            return;
        }
        case MAVLINK_MSG_ID_SYS_STATUS: take_battery(mavlink_msg_sys_status_get_battery_remaining(&message)); return;
        case MAVLINK_MSG_ID_BATTERY_STATUS:
            if (mavlink_msg_battery_status_get_id(&message) == 0) { take_battery(mavlink_msg_battery_status_get_battery_remaining(&message)); }
            return;
        case MAVLINK_MSG_ID_SYSTEM_TIME: {
            mavlink_system_time_t in;
            mavlink_msg_system_time_decode(&message, &in);
            advance(static_cast<std::int64_t>(in.time_boot_ms) * 1000);
            return;
        }
        case MAVLINK_MSG_ID_COMMAND_ACK: take_ack(message); return;
        case MAVLINK_MSG_ID_PARAM_VALUE: {
            mavlink_param_value_t in;
            mavlink_msg_param_value_decode(&message, &in);
            preflight_.take(in);
            return;
        }
        case MAVLINK_MSG_ID_TIMESYNC: take_timesync(message); return;
        default: return;
    }
}

void Bridge::take_highres(const mavlink_message_t& message) {
    mavlink_highres_imu_t in;
    mavlink_msg_highres_imu_decode(&message, &in);
    baro_t height{};
    if (from_mavlink(in, height)) {
        take_baro(height, false);
    } else if (says_pressure(in)) {
        ++counters_.refused_samples;
    }
    imu_t sample{};
    if (!from_mavlink(in, sample)) { ++counters_.refused_samples; return; }
    take_imu(sample, 0);
}

template <class Message>
void Bridge::take_imu(const std::size_t rank, void (*decode)(const mavlink_message_t*, Message*), const mavlink_message_t& message) {
    Message in;
    decode(&message, &in);
    imu_t sample{};
    if (!from_mavlink(in, sample)) { ++counters_.refused_samples; return; }
    take_imu(sample, rank);
}

/// Of several kinds the best that came within the last second serves; the others are left out.
void Bridge::take_imu(imu_t& sample, const std::size_t rank) {
    advance(sample.t_us);
    imu_heard_us_[rank] = now_us_;
    for (std::size_t better = 0; better < rank; ++better) {
        if (imu_heard_us_[better] >= 0 && now_us_ - imu_heard_us_[better] < kSubstituteAfter_us) { return; }
    }
    if (imu_.seq > 0 && sample.t_us <= imu_.t_us) { ++counters_.refused_samples; return; }
    sample.seq = imu_.seq + 1;
    imu_ = sample;
    ++counters_.imu;
    sink_.publish(imu_);
}

void Bridge::take_attitude(const FullAttitude& attitude, const bool substitute) {
    advance(attitude.t_us);
    if (!substitute) { quaternion_us_ = now_us_; }
    if (substitute && quaternion_us_ >= 0 && now_us_ - quaternion_us_ < kSubstituteAfter_us) { return; }
    if (attitude_.seq > 0 && attitude.t_us <= attitude_.t_us) { ++counters_.refused_samples; return; }
    attitude_.seq += 1;
    attitude_.t_us = attitude.t_us;
    attitude_.roll_rad = attitude.roll_rad;
    attitude_.pitch_rad = attitude.pitch_rad;
    local_yaw_rad_ = attitude.yaw_rad;
    local_yaw_us_ = now_us_;
    sink_.publish(attitude_);
}

void Bridge::take_range(const mavlink_message_t& message) {
    mavlink_distance_sensor_t in;
    mavlink_msg_distance_sensor_decode(&message, &in);
    range_t sample{};
    RangeDirection direction = RangeDirection::other;
    if (!from_mavlink(in, sample, direction)) { ++counters_.refused_samples; return; }
    if (direction == RangeDirection::other) { return; }
    advance(sample.t_us);
    range_t& last = direction == RangeDirection::up ? range_up_ : range_down_;
    if (last.seq > 0 && sample.t_us <= last.t_us) { ++counters_.refused_samples; return; }
    sample.seq = last.seq + 1;
    last = sample;
    if (direction == RangeDirection::up) { sink_.publish_up(last); } else { sink_.publish_down(last); }
}

/// Thinned out to the stream's rate; what is left out is not counted. A repeat is one of those.
void Bridge::take_baro(baro_t& sample, const bool substitute) {
    advance(sample.t_us);
    if (!substitute) { fine_baro_us_ = now_us_; }
    if (substitute && fine_baro_us_ >= 0 && now_us_ - fine_baro_us_ < kSubstituteAfter_us) { return; }
    if (baro_.seq > 0 && sample.t_us - baro_.t_us < kBaroPeriod_us) { return; }
    sample.seq = baro_.seq + 1;
    baro_ = sample;
    sink_.publish(baro_);
}

void Bridge::take_battery(const std::int8_t percent) {
    const float remaining = battery_from_percent(percent);
    if (remaining < 0.0F) { return; }
    battery_ = remaining;
    if (!armed_ || drain_from_ < 0.0F) {
        drain_from_ = battery_;
        drain_since_us_ = now_us_;
    }
    if (battery_ <= p_.battery_land && flight_.active() && armed_ && !battery_landing_) {
        battery_landing_ = true;
        text(MAV_SEVERITY_CRITICAL, "battery at %d%%: landing here", static_cast<int>(std::lround(battery_ * 100.0F)));
        order(command_t::LAND);
    }
}

void Bridge::take_ack(const mavlink_message_t& message) {
    mavlink_command_ack_t ack;
    mavlink_msg_command_ack_decode(&message, &ack);
    const bool refused = ack.result != MAV_RESULT_ACCEPTED && ack.result != MAV_RESULT_IN_PROGRESS && ack.result != MAV_RESULT_TEMPORARILY_REJECTED;
    if (ack.command == MAV_CMD_NAV_TAKEOFF && refused) { flight_.takeoff_refused(); }
}

void Bridge::advance(const std::int64_t t_us) {
    if (t_us < 0) { return; }
    if (now_us_ >= 0 && t_us < now_us_ - kRestartJump_us) { forget_autopilot_clock(t_us); }
    if (t_us <= now_us_) { return; }
    if (now_us_ < 0) {
        next_second_us_ = t_us;
        next_vehicle_us_ = t_us;
        next_streams_us_ = t_us + kSecond_us;  // what it sends unasked is seen by then
        streams_since_us_ = t_us;
    }
    now_us_ = t_us;
    try_pending_start();
    step_pilot_start();
    step_flight();
    if (flight_.holds() && now_us_ >= next_hold_us_ && supervisor_.last_good().valid) {
        constexpr std::int64_t kHoldPeriod_us = kSecond_us / 20;
        next_hold_us_ = now_us_ + kHoldPeriod_us;
        Setpoint stand = supervisor_.last_good();
        stand.vx_m_s = 0.0F;
        stand.vy_m_s = 0.0F;
        stand.vz_m_s = 0.0F;
        send_setpoint(stand, now_us_);
    }
    if (now_us_ >= next_vehicle_us_) { publish_vehicle(); }
    if (now_us_ >= next_second_us_) {
        next_second_us_ = now_us_ + kSecond_us;
        send_heartbeat();
        send_progress();
        send_timesync();
        step_ground_silence();
    }
    if (heard_) { step_origin(); }
    if (now_us_ >= next_streams_us_) { ask_for_streams(); }
    step_preflight();
    send_listed_parameters(1);
    send_file_packets(1);
}

void Bridge::forget_autopilot_clock(const std::int64_t t_us) {
    text(MAV_SEVERITY_CRITICAL, "autopilot restarted");
    flight_.autopilot_restarted();
    pending_start_.active = false;
    begin_preflight();
    now_us_ = -1;
    next_table_us_ = 0;
    imu_.t_us = t_us - 1;
    attitude_.t_us = t_us - 1;
    range_up_.t_us = t_us - 1;
    range_down_.t_us = t_us - 1;
    baro_.t_us = t_us - kBaroPeriod_us;
    imu_heard_us_.fill(-1);
    time_sync_.reset();
    origin_known_ = false;
    origin_tries_ = 0;
    next_origin_us_ = 0;
    next_obstacles_us_ = 0;
    estimator_us_ = -1;
    global_us_ = -1;
    other_autopilot_us_ = -1;
    ground_heard_us_ = -1;
    last_order_us_ = -1;
    fine_baro_us_ = -1;
    quaternion_us_ = -1;
    local_us_ = -1;
    local_yaw_us_ = -1;
    nav_us_ = -1;
    next_ground_imu_us_ = 0;
    next_ground_odometry_us_ = 0;
    next_hold_us_ = 0;
    sent_us_ = -1;
    last_text_us_ = -1;
    supervisor_.clock_restarted();
}

void Bridge::on_nav(const nav_t& message) {
    if (nav_heard_ && message.floor != nav_.floor) { text(MAV_SEVERITY_INFO, "floor %d", static_cast<int>(message.floor)); }
    if (nav_heard_ && nav_.policy == static_cast<std::int32_t>(PolicyKind::external) && message.policy == static_cast<std::int32_t>(PolicyKind::tour)) {
        text(MAV_SEVERITY_WARNING, "policy given up after %d refusals, %d timeouts", static_cast<int>(message.policy_refused), static_cast<int>(message.policy_timeouts));
    }
    const bool changed = nav_heard_ && (message.state != nav_.state || message.reason != nav_.reason);
    const SetpointCheck check = supervisor_.nav(message, now_us_);
    if (!nav_heard_ && message.parameters_crc != static_cast<std::int32_t>(kParametersCrc)) {
        text(MAV_SEVERITY_WARNING, "nav and bridge have different parameter tables");
    }
    nav_ = message;
    nav_us_ = now_us_;
    nav_heard_ = true;
    compare_values();
    if (check == SetpointCheck::good && flight_.passes_setpoints()) { send_setpoint(supervisor_.last_good(), message.t_us); }
    if (awaits_pilot()) { send_setpoint({true, message.x_m, message.y_m, message.z_m, 0.0F, 0.0F, 0.0F, message.yaw_rad}, message.t_us); }
    if (changed) {
        const char* reason = reason_text(message.reason);
        text(MAV_SEVERITY_INFO, reason[0] == '\0' ? "%s%s" : "%s: %s", state_text(message.state), reason);
    }
}

void Bridge::on_odom(const odom_t& message) {
    // Every scan is answered, even before the autopilot's clock is known: then the message's own stamp is the time.
    const std::int64_t heard_us = now_us_ >= 0 ? now_us_ : message.t_us;
    bool usable = supervisor_.odometry(message, heard_us);
    if (!usable && supervisor_.nav_restarted() && !flight_.active()) {
        supervisor_.accept_restart();
        ++reset_offset_;
        usable = supervisor_.odometry(message, heard_us);
    }
    // What cannot be vouched for still answers the scan (and ends a simulator's tick): the last pose with quality -1.
    odom_t out = usable ? message : last_odom_;
    if (!usable) {
        out.t_us = message.t_us;
        out.quality = -1;
    }
    out.reset_counter += reset_offset_;
    mavlink_odometry_t odometry = to_odometry(out);
    odometry.estimator_type = flavour_ != nullptr ? flavour_->odometry_estimator : std::uint8_t{MAV_ESTIMATOR_TYPE_UNKNOWN};
    if (p_.link_vision_message == 0) {
        send_autopilot(mavlink_msg_odometry_encode_status, odometry);
    } else if (out.quality >= 0) {  // it has no field for "nothing is known": then it is silent
        send_autopilot(mavlink_msg_vision_position_estimate_encode_status, to_vision_position_estimate(out));
    }
    ++counters_.odometry_sent;
    if (usable) { last_odom_ = message; }
    if (heard_us >= next_ground_odometry_us_) {
        constexpr std::int64_t kGroundPeriod_us = kSecond_us / 5;
        next_ground_odometry_us_ = heard_us + kGroundPeriod_us;
        send_ground(mavlink_msg_odometry_encode_status, odometry);
    }
}

void Bridge::on_wall(const std::int64_t wall_us) {
    wall_us_ = wall_us;
    send_parameters_on_wall();
    if (spoke_) {
        spoke_ = false;
        autopilot_wall_us_ = wall_us;
        alive_ = true;
    }
    if (alive_ && static_cast<float>(wall_us - autopilot_wall_us_) > p_.link_autopilot_timeout_s * 1e6F) {
        alive_ = false;
        text(MAV_SEVERITY_CRITICAL, "autopilot silent");
    }
    if (alive_ && now_us_ < 0 && wall_us >= next_wall_ask_us_) {
        next_wall_ask_us_ = wall_us + kSecond_us;
        wake_streams();
    }
    if (alive_ || wall_us < next_wall_beat_us_) { return; }
    next_wall_beat_us_ = wall_us + kSecond_us;
    send_heartbeat();
}

}  // namespace noctule
