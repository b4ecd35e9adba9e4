/// The bridge's ground side: commands with their acknowledgements, and routing.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>

#include "link/bridge.hpp"
#include "link/bridge_text.hpp"
#include "metadata.gen.hpp"
#include "plan/mission.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kPendingStart_us = 30000000;  // a start that waits for its time is refused this long after it
constexpr std::uint16_t kAbortCommand = MAV_CMD_USER_1;
constexpr std::uint32_t kComponentMetadata = 397;     // COMPONENT_METADATA, newer than the headers

struct ComponentMetadata {
    std::uint32_t time_boot_ms;
    std::uint32_t file_crc;
    char uri[100];
};
static_assert(sizeof(ComponentMetadata) == 108);

std::uint16_t encode_component_metadata(const std::uint8_t system, const std::uint8_t component, mavlink_status_t* status, mavlink_message_t* message, const ComponentMetadata* payload) {
    constexpr std::uint8_t kLength = sizeof(ComponentMetadata);
    constexpr std::uint8_t kExtra = 182;
    std::memcpy(message->payload64, payload, kLength);
    message->msgid = kComponentMetadata;
    return mavlink_finalize_message_buffer(message, system, component, status, kLength, kLength, kExtra);
}

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
    const bool to_camera = our_system && frame.target.component == MAV_COMP_ID_CAMERA && has_video();
    const bool to_all = (frame.target.system == 0 || our_system) && frame.target.component == 0;
    if (starves_us(frame)) {
        text(MAV_SEVERITY_NOTICE, "autopilot's lists and files wait until landed");
    } else if (!to_us && !to_camera) {
        sink_.to_autopilot(frame.bytes);
        if (heard_ && slows_our_streams(frame.message)) { wake_streams(); }
    }
    const MavlinkTarget asked_by{frame.message.sysid, frame.message.compid};
    ground_heard_us_ = now_us_;
    switch (frame.message.msgid) {
        case MAVLINK_MSG_ID_COMMAND_LONG: {
            mavlink_command_long_t in;
            mavlink_msg_command_long_decode(&frame.message, &in);
            const Asked asked{in.command, in.param1, in.param2, in.param3, asked_by};
            if (to_us) { take_command(asked); }
            if (to_camera) { take_camera_command(asked); }
            return;
        }
        case MAVLINK_MSG_ID_COMMAND_INT: {
            mavlink_command_int_t in;
            mavlink_msg_command_int_decode(&frame.message, &in);
            const Asked asked{in.command, in.param1, in.param2, in.param3, asked_by};
            if (to_us) { take_command(asked); }
            if (to_camera) { take_camera_command(asked); }
            return;
        }
        case MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
        case MAVLINK_MSG_ID_PARAM_REQUEST_READ:
        case MAVLINK_MSG_ID_PARAM_SET:
            if (to_us || to_all) { take_parameter_request(frame.message, asked_by); }
            return;
        case MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL:
            if (to_us) { take_file_request(frame.message, asked_by); }
            return;
        default: return;
    }
}

/// In a mission nobody else's download may take the inertial data and the ranges away (docs/ardupilot.md).
bool Bridge::starves_us(const MavlinkFrame& frame) const {
    const bool download = frame.message.msgid == MAVLINK_MSG_ID_PARAM_REQUEST_LIST || frame.message.msgid == MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL;
    const bool of_autopilot = frame.target.component == MAV_COMP_ID_AUTOPILOT1 || frame.target.component == 0;
    return download && of_autopilot && flavour_ != nullptr && flavour_->lists_slow_streams && flight_.active();
}

/// A ground station asks the autopilot for rates. They hold for its whole link, ours with them: what we need is asked for again right behind.
bool Bridge::slows_our_streams(const mavlink_message_t& message) const {
    if (message.msgid == MAVLINK_MSG_ID_REQUEST_DATA_STREAM) { return true; }
    if (message.msgid != MAVLINK_MSG_ID_COMMAND_LONG) { return false; }
    mavlink_command_long_t in;
    mavlink_msg_command_long_decode(&message, &in);
    return in.command == MAV_CMD_SET_MESSAGE_INTERVAL &&
           std::any_of(streams_.begin(), streams_.end(), [&](const Stream& s) { return in.param1 == static_cast<float>(s.msgid) || (s.substitute != 0 && in.param1 == static_cast<float>(s.substitute)); });
}

void Bridge::acknowledge(const std::uint16_t command, const std::uint8_t result, const MavlinkTarget asked_by) { acknowledge_as(to_ground_, command, result, asked_by); }

void Bridge::acknowledge_as(MavlinkWriter& writer, const std::uint16_t command, const std::uint8_t result, const MavlinkTarget asked_by) {
    mavlink_command_ack_t ack{};
    ack.command = command;
    ack.result = result;
    ack.target_system = asked_by.system;
    ack.target_component = asked_by.component;
    sink_.to_ground(writer.pack(mavlink_msg_command_ack_encode_status, ack));
}

void Bridge::order(const std::int32_t command) {
    command_.t_us = now_us_;
    command_.seq += 1;
    command_.command = command;
    last_order_ = command;
    last_order_us_ = now_us_;
    sink_.publish(command_);
}

void Bridge::take_command(const Asked& asked) {
    switch (asked.command) {
        case MAV_CMD_MISSION_START: take_start(asked.param3, asked.by); return;
        case MAV_CMD_REQUEST_MESSAGE:
        case MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: take_message_request(asked); return;
        case MAV_CMD_DO_PAUSE_CONTINUE:
        case MAV_CMD_NAV_RETURN_TO_LAUNCH:
        case MAV_CMD_NAV_LAND:
        case kAbortCommand: take_mission_command(asked); return;
        default: acknowledge(asked.command, MAV_RESULT_UNSUPPORTED, asked.by); return;
    }
}

/// Pause, resume, return, land, abort. A repeat of what is under way is answered ACCEPTED and changes nothing.
void Bridge::take_mission_command(const Asked& asked) {
    std::int32_t wanted = 0;
    switch (asked.command) {
        case MAV_CMD_DO_PAUSE_CONTINUE:
            if (asked.param1 != 0.0F && asked.param1 != 1.0F) {
                text(MAV_SEVERITY_WARNING, "refused: param1 is 0 (pause) or 1 (resume)");
                acknowledge(asked.command, MAV_RESULT_DENIED, asked.by);
                return;
            }
            wanted = asked.param1 == 1.0F ? std::int32_t{command_t::RESUME} : std::int32_t{command_t::PAUSE};
            break;
        case MAV_CMD_NAV_RETURN_TO_LAUNCH: wanted = command_t::RETURN_HOME; break;
        case MAV_CMD_NAV_LAND: wanted = command_t::LAND; break;
        default: wanted = command_t::ABORT; break;
    }
    if (pending_start_.active && wanted != command_t::RESUME) {
        pending_start_.active = false;
        acknowledge(MAV_CMD_MISSION_START, MAV_RESULT_FAILED, pending_start_.asked_by);
    }
    if (!flight_.active()) {
        text(MAV_SEVERITY_WARNING, "refused: no mission is under way");
        acknowledge(asked.command, MAV_RESULT_TEMPORARILY_REJECTED, asked.by);
        return;
    }
    if (!under_way(wanted)) { order(wanted); }
    acknowledge(asked.command, MAV_RESULT_ACCEPTED, asked.by);
}

/// The order was given already and stands: nav is doing it, or has just been told.
bool Bridge::under_way(const std::int32_t wanted) const {
    constexpr std::int64_t kJustTold_us = 1000000;
    if (last_order_ == wanted && last_order_us_ >= 0 && now_us_ - last_order_us_ < kJustTold_us) { return true; }
    const auto state = static_cast<MissionState>(nav_.state);
    const bool landing = state == MissionState::landing || state == MissionState::landed;
    switch (wanted) {
        case command_t::PAUSE: return state == MissionState::paused;
        case command_t::RETURN_HOME: return state == MissionState::returning_home || landing;
        case command_t::LAND:
        case command_t::ABORT: return landing;
        default: return false;
    }
}

void Bridge::take_message_request(const Asked& asked) {
    const auto wanted = asked.command == MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES ? std::uint32_t{MAVLINK_MSG_ID_AUTOPILOT_VERSION}
                        : asked.param1 >= 0.0F && asked.param1 < 16777216.0F   ? static_cast<std::uint32_t>(asked.param1)
                                                                               : UINT32_MAX;
    const bool known = wanted == MAVLINK_MSG_ID_AUTOPILOT_VERSION || wanted == kComponentMetadata;
    acknowledge(asked.command, known ? MAV_RESULT_ACCEPTED : MAV_RESULT_UNSUPPORTED, asked.by);
    if (wanted == MAVLINK_MSG_ID_AUTOPILOT_VERSION) { send_version(); }
    if (wanted == kComponentMetadata) { send_component_metadata(); }
}

/// Where the metadata of the parameters lies, so that a ground station shows units and meanings.
void Bridge::send_component_metadata() {
    ComponentMetadata out{};
    out.time_boot_ms = static_cast<std::uint32_t>(std::max<std::int64_t>(now_us_, 0) / 1000);
    out.file_crc = kMetadataFiles[0].crc;
    std::snprintf(out.uri, sizeof out.uri, "mftp:///%.*s", static_cast<int>(kMetadataFiles[0].path.size()), kMetadataFiles[0].path.data());
    send_ground(&encode_component_metadata, out);
}

void Bridge::take_file_request(const mavlink_message_t& message, const MavlinkTarget asked_by) {
    mavlink_file_transfer_protocol_t in;
    mavlink_msg_file_transfer_protocol_decode(&message, &in);
    mavlink_file_transfer_protocol_t answer;
    if (ftp_.take(in, asked_by, answer)) { send_ground(mavlink_msg_file_transfer_protocol_encode_status, answer); }
}

void Bridge::send_file_packets(int at_most) {
    mavlink_file_transfer_protocol_t packet;
    for (; at_most > 0 && ftp_.next(packet); --at_most) { send_ground(mavlink_msg_file_transfer_protocol_encode_status, packet); }
}

void Bridge::send_version() {
    mavlink_autopilot_version_t out{};
    const bool cast = flavour_ != nullptr && flavour_->cast_integers;
    out.capabilities = MAV_PROTOCOL_CAPABILITY_MAVLINK2 | MAV_PROTOCOL_CAPABILITY_FTP | MAV_PROTOCOL_CAPABILITY_COMMAND_INT |
                       static_cast<std::uint64_t>(cast ? MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST : MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE);
    out.uid = kParametersCrc;  // tells one parameter table from another
    send_ground(mavlink_msg_autopilot_version_encode_status, out);
}

/// Why a start is not possible now. DENIED is what time alone does not mend.
Bridge::Obstacle Bridge::start_obstacle(const bool by_pilot) const {
    constexpr std::uint8_t kDenied = MAV_RESULT_DENIED;
    constexpr std::int64_t kOtherFresh_us = 5000000;
    if (map_only_) { return {"map only, no flying", kDenied}; }
    if (!by_pilot && p_.link_start_by == 1) { return {"the pilot's switch starts (LNK_START_BY)", kDenied}; }
    if (!heard_) { return {"no autopilot heard"}; }
    if (flavour_ == nullptr) { return {"autopilot is neither PX4 nor ArduPilot", kDenied}; }
    if (!nav_heard_ || !supervisor_.nav_fresh(now_us_)) { return {"nav is not running"}; }
    if (nav_.parameters_crc != static_cast<std::int32_t>(kParametersCrc)) { return {"parameter tables differ", kDenied}; }
    if (!values_agree_) { return {"nav has other parameter values"}; }
    if (p_.link_system_id == 0 && other_autopilot_us_ >= 0 && now_us_ - other_autopilot_us_ < kOtherFresh_us) { return {"two autopilots, set LNK_SYSID", kDenied}; }
    if (armed_ && !by_pilot) { return {"vehicle is armed already"}; }
    if (landed_ == 2) { return {"vehicle is in the air"}; }
    if (const char* why = preflight_obstacle(); why != nullptr) { return {why, preflight_.complete() ? kDenied : std::uint8_t{MAV_RESULT_TEMPORARILY_REJECTED}}; }
    if (!supervisor_.vision_fresh(now_us_)) { return {"no estimate"}; }
    if (estimator_lost()) { return {"EKF has no position"}; }
    if (lands_elsewhere()) { return {"global origin, no global position", kDenied}; }
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
    if (const Obstacle obstacle = start_obstacle(false); obstacle.why != nullptr) {
        refuse_start(obstacle, asked_by);
        return;
    }
    if (begin_start(false)) { acknowledge(MAV_CMD_MISSION_START, MAV_RESULT_ACCEPTED, asked_by); }
}

void Bridge::try_pending_start() {
    if (!pending_start_.active || now_us_ < pending_start_.earliest_us) { return; }
    const Obstacle obstacle = start_obstacle(false);
    if (obstacle.why == nullptr) {
        pending_start_.active = false;
        if (begin_start(false)) { acknowledge(MAV_CMD_MISSION_START, MAV_RESULT_ACCEPTED, pending_start_.asked_by); }
    } else if (now_us_ > pending_start_.give_up_us || obstacle.result == MAV_RESULT_DENIED) {
        pending_start_.active = false;
        refuse_start(obstacle, pending_start_.asked_by);
    }
}

bool Bridge::begin_start(const bool by_pilot) {
    if (!(by_pilot ? flight_.start_by_pilot(view()) : flight_.start(view()))) { return false; }
    supervisor_.begin_flight(now_us_);
    battery_landing_ = false;
    ground_lost_ = false;
    text(notice_severity(Notice::start_sequence), "%s", notice_text(Notice::start_sequence));
    publish_vehicle();
    order(command_t::START);
    return true;
}

/// The pilot's switch starts: until then the autopilot gets setpoints on the spot, so that it accepts the mode.
bool Bridge::awaits_pilot() const {
    return p_.link_start_by == 1 && !map_only_ && !flight_.active() && flavour_ != nullptr && landed_ != 2 && nav_heard_ && nav_.ready != 0 && supervisor_.vision_fresh(now_us_);
}

/// The pilot switched to the offboard mode: that is the start. He arms; the bridge does not.
void Bridge::step_pilot_start() {
    if (p_.link_start_by != 1 || flavour_ == nullptr || flight_.active()) { return; }
    if (custom_mode_ != flavour_->offboard.custom_mode) {
        switch_seen_off_ = true;
        return;
    }
    if (!switch_seen_off_) { return; }
    switch_seen_off_ = false;  // one switch, one start
    if (const Obstacle obstacle = start_obstacle(true); obstacle.why != nullptr) {
        text(MAV_SEVERITY_WARNING, "start refused: %s", obstacle.why);
        return;
    }
    static_cast<void>(begin_start(true));
}

/// All ground stations silent in flight: where the parameter says so, home.
void Bridge::step_ground_silence() {
    if (ground_heard_us_ < 0 || p_.link_ground_timeout_s <= 0.0F || !flight_.active() || !armed_) { return; }
    const bool lost = static_cast<float>(now_us_ - ground_heard_us_) * 1e-6F > p_.link_ground_timeout_s;
    if (lost && !ground_lost_) {
        text(MAV_SEVERITY_CRITICAL, "ground station silent: returning home");
        if (!under_way(command_t::RETURN_HOME)) { order(command_t::RETURN_HOME); }
    }
    ground_lost_ = lost;
}

}  // namespace noctule
