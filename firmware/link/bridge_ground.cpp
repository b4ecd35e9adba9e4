/// The bridge's ground side: commands with their acknowledgements, and routing.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "link/bridge.hpp"
#include "link/bridge_text.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kPendingStart_us = 30000000;  // a start that waits for its time is refused this long after it
constexpr std::uint16_t kAbortCommand = MAV_CMD_USER_1;

}  // namespace

void Bridge::from_ground(const std::span<const std::uint8_t> bytes) {
    ground_reader_.push_datagram(bytes, [this](const MavlinkFrame& frame) { ground_frame(frame); });
}

void Bridge::ground_frame(const MavlinkFrame& frame) {
    if (!frame.known) {
        sink_.to_autopilot(frame.bytes);
        return;
    }
    if (is_us(frame.message)) { return; }
    const bool our_system = frame.target.system == system_;
    const bool to_us = our_system && frame.target.component == MAV_COMP_ID_ONBOARD_COMPUTER;
    const bool to_all = (frame.target.system == 0 || our_system) && frame.target.component == 0;
    if (!to_us) { sink_.to_autopilot(frame.bytes); }
    const MavlinkTarget asked_by{frame.message.sysid, frame.message.compid};
    switch (frame.message.msgid) {
        case MAVLINK_MSG_ID_COMMAND_LONG: {
            if (!to_us) { return; }
            mavlink_command_long_t in;
            mavlink_msg_command_long_decode(&frame.message, &in);
            take_command(in.command, in.param1, in.param3, asked_by);
            return;
        }
        case MAVLINK_MSG_ID_COMMAND_INT: {
            if (!to_us) { return; }
            mavlink_command_int_t in;
            mavlink_msg_command_int_decode(&frame.message, &in);
            take_command(in.command, in.param1, in.param3, asked_by);
            return;
        }
        case MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
        case MAVLINK_MSG_ID_PARAM_REQUEST_READ:
        case MAVLINK_MSG_ID_PARAM_SET:
            if (to_us || to_all) { take_parameter_request(frame.message, asked_by); }
            return;
        default: return;
    }
}

void Bridge::acknowledge(const std::uint16_t command, const std::uint8_t result, const MavlinkTarget asked_by) {
    mavlink_command_ack_t ack{};
    ack.command = command;
    ack.result = result;
    ack.target_system = asked_by.system;
    ack.target_component = asked_by.component;
    send_ground(mavlink_msg_command_ack_encode_status, ack);
}

void Bridge::order(const std::int32_t command) {
    command_.t_us = now_us_;
    command_.seq += 1;
    command_.command = command;
    sink_.publish(command_);
}

void Bridge::take_command(const std::uint16_t command, const float param1, const float earliest_s, const MavlinkTarget asked_by) {
    std::int32_t wanted = 0;
    switch (command) {
        case MAV_CMD_MISSION_START: take_start(earliest_s, asked_by); return;
        case MAV_CMD_DO_PAUSE_CONTINUE: wanted = param1 >= 0.5F ? std::int32_t{command_t::RESUME} : std::int32_t{command_t::PAUSE}; break;
        case MAV_CMD_NAV_RETURN_TO_LAUNCH: wanted = command_t::RETURN_HOME; break;
        case MAV_CMD_NAV_LAND: wanted = command_t::LAND; break;
        case kAbortCommand: wanted = command_t::ABORT; break;
        default: acknowledge(command, MAV_RESULT_UNSUPPORTED, asked_by); return;
    }
    if (pending_start_.active && wanted != command_t::RESUME) {
        pending_start_.active = false;
        acknowledge(MAV_CMD_MISSION_START, MAV_RESULT_FAILED, pending_start_.asked_by);
    }
    if (!flight_.active()) {
        text(MAV_SEVERITY_WARNING, "refused: no mission is under way");
        acknowledge(command, MAV_RESULT_TEMPORARILY_REJECTED, asked_by);
        return;
    }
    order(wanted);
    acknowledge(command, MAV_RESULT_ACCEPTED, asked_by);
}

/// Why a start is not possible now. DENIED is what time alone does not mend.
Bridge::Obstacle Bridge::start_obstacle() const {
    constexpr std::uint8_t kDenied = MAV_RESULT_DENIED;
    if (!heard_) { return {"no autopilot heard"}; }
    if (flavour_ == nullptr) { return {"autopilot is neither PX4 nor ArduPilot", kDenied}; }
    if (!nav_heard_ || !supervisor_.nav_fresh(now_us_)) { return {"nav is not running"}; }
    if (nav_.parameters_crc != static_cast<std::int32_t>(kParametersCrc)) { return {"parameter tables differ", kDenied}; }
    if (!values_agree_) { return {"nav has other parameter values"}; }
    if (armed_) { return {"vehicle is armed already"}; }
    if (landed_ == 2) { return {"vehicle is in the air"}; }
    if (const char* why = preflight_obstacle(); why != nullptr) { return {why, preflight_.complete() ? kDenied : std::uint8_t{MAV_RESULT_TEMPORARILY_REJECTED}}; }
    if (!supervisor_.vision_fresh(now_us_)) { return {"no estimate"}; }
    if (!supervisor_.local_fresh(now_us_)) { return {"autopilot has no position"}; }
    if (!supervisor_.frames_agree()) { return {"estimate and autopilot differ"}; }
    if (battery_ >= 0.0F && battery_ <= std::max(p_.battery_land, p_.battery_return)) { return {"battery low"}; }
    if (nav_.ready == 0) { return {"nav is not ready"}; }
    return {};
}

void Bridge::refuse_start(const Obstacle& obstacle, const MavlinkTarget asked_by) {
    text(MAV_SEVERITY_WARNING, "start refused: %s", obstacle.why);
    acknowledge(MAV_CMD_MISSION_START, obstacle.result, asked_by);
    if (preflight_.wrong() > 0) {  // say again what is wrong; what was not answered may be by now
        tell_row_ = 0;
        preflight_.ask_silent_again();
    }
}

/// MAV_CMD_MISSION_START. param3 above 0 is the autopilot's time [s] before which the start is held back: in the flight's own time, it
/// makes the start the same in every run. A repeat of what is under way is answered again and changes nothing.
void Bridge::take_start(const float earliest_s, const MavlinkTarget asked_by) {
    if (flight_.active()) {
        acknowledge(MAV_CMD_MISSION_START, MAV_RESULT_ACCEPTED, asked_by);
        return;
    }
    if (earliest_s > 0.0F) {
        const auto earliest_us = static_cast<std::int64_t>(static_cast<double>(earliest_s) * 1e6);
        if (!pending_start_.active || pending_start_.earliest_us != earliest_us) {
            pending_start_ = {true, asked_by, earliest_us, std::max(earliest_us, now_us_) + kPendingStart_us};
        }
        acknowledge(MAV_CMD_MISSION_START, MAV_RESULT_IN_PROGRESS, asked_by);
        return;
    }
    if (const Obstacle obstacle = start_obstacle(); obstacle.why != nullptr) {
        refuse_start(obstacle, asked_by);
        return;
    }
    begin_start(asked_by);
}

void Bridge::try_pending_start() {
    if (!pending_start_.active || now_us_ < pending_start_.earliest_us) { return; }
    const Obstacle obstacle = start_obstacle();
    if (obstacle.why == nullptr) {
        pending_start_.active = false;
        begin_start(pending_start_.asked_by);
    } else if (now_us_ > pending_start_.give_up_us || obstacle.result == MAV_RESULT_DENIED) {
        pending_start_.active = false;
        refuse_start(obstacle, pending_start_.asked_by);
    }
}

void Bridge::begin_start(const MavlinkTarget asked_by) {
    if (!flight_.start(view())) { return; }
    supervisor_.begin_flight(now_us_);
    battery_landing_ = false;
    acknowledge(MAV_CMD_MISSION_START, MAV_RESULT_ACCEPTED, asked_by);
    text(notice_severity(Notice::start_sequence), "%s", notice_text(Notice::start_sequence));
    publish_vehicle();
    order(command_t::START);
}

}  // namespace noctule
