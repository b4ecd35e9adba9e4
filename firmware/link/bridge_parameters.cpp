/// The bridge's parameters: served to ground stations, handed to nav, persisted; and the autopilot's own, checked before a start.
#include <cmath>
#include <cstring>

#include "link/bridge.hpp"
#include "link/parameter_values.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kTableAgain_us = 1000000;
constexpr int kQuestionsPerStep = 4;
constexpr std::size_t kRowsPerWallTurn = 8;
constexpr int kPacketsPerWallTurn = 8;

}  // namespace

void Bridge::take_parameter_request(const mavlink_message_t& message, const MavlinkTarget asked_by) {
    if (message.msgid == MAVLINK_MSG_ID_PARAM_REQUEST_LIST) {
        table_.list();
        return;
    }
    if (message.msgid == MAVLINK_MSG_ID_PARAM_SET) {
        write_parameter(message, asked_by);
        return;
    }
    mavlink_param_request_read_t in;
    mavlink_msg_param_request_read_decode(&message, &in);
    const std::size_t row = ParameterServer::find(in.param_id, in.param_index);
    if (row < kParameterTable.size()) {
        send_ground(mavlink_msg_param_value_encode_status, table_.value(row));
    } else {
        refuse_parameter(in.param_id, in.param_index, MAV_PARAM_ERROR_DOES_NOT_EXIST, asked_by);
    }
}

void Bridge::write_parameter(const mavlink_message_t& message, const MavlinkTarget asked_by) {
    mavlink_param_set_t in;
    mavlink_msg_param_set_decode(&message, &in);
    std::size_t row = 0;
    const ParameterWrite result = table_.write(in, row);
    const std::string_view id = parameter_id(in.param_id);
    const int length = static_cast<int>(id.size());
    if (result == ParameterWrite::rejected_unknown) {
        text(MAV_SEVERITY_WARNING, "no parameter %.*s", length, id.data());
        refuse_parameter(in.param_id, -1, MAV_PARAM_ERROR_DOES_NOT_EXIST, asked_by);
        return;
    }
    const ParameterRow& parameter = kParameterTable[row];
    switch (result) {
        case ParameterWrite::stored:
            if (parameter.reboot) { text(MAV_SEVERITY_NOTICE, "%.*s takes effect at the next start", length, id.data()); }
            else { publish_parameters(); }
            break;
        case ParameterWrite::rejected_range:
            text(MAV_SEVERITY_WARNING, "%.*s refused: %g to %g", length, id.data(), static_cast<double>(parameter.min), static_cast<double>(parameter.max));
            break;
        case ParameterWrite::rejected_not_whole: text(MAV_SEVERITY_WARNING, "%.*s refused: a whole number", length, id.data()); break;
        case ParameterWrite::rejected_type: text(MAV_SEVERITY_WARNING, "%.*s refused: unknown type", length, id.data()); break;
        default: break;
    }
    if (result != ParameterWrite::stored && result != ParameterWrite::unchanged) {
        refuse_parameter(in.param_id, static_cast<std::int16_t>(row), MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE, asked_by);
    }
    send_ground(mavlink_msg_param_value_encode_status, table_.value(row));  // what holds now: to everybody
    store_parameters();
}

void Bridge::refuse_parameter(const char (&id)[16], const std::int16_t index, const std::uint8_t error, const MavlinkTarget asked_by) {
    mavlink_param_error_t out{};
    out.target_system = asked_by.system;
    out.target_component = asked_by.component;
    std::memcpy(out.param_id, id, sizeof out.param_id);
    out.param_index = index;
    out.error = error;
    send_ground(mavlink_msg_param_error_encode_status, out);
}

/// No file is written in flight: a slow disk must not stop the loop.
void Bridge::store_parameters() {
    if (!table_.dirty() || armed_) { return; }
    table_.clear_dirty();
    sink_.store(table_.stored());
}

void Bridge::publish_parameters() {
    parameters_message_.t_us = std::max<std::int64_t>(now_us_, 0);
    parameters_message_.seq += 1;
    to_message(p_, parameters_message_);
    next_table_us_ = now_us_ + kTableAgain_us;
    sink_.publish(parameters_message_);
}

/// nav says which values it flies: others are mended.
void Bridge::compare_values() {
    values_agree_ = nav_.values_crc == parameter_values_crc(p_);
    if (!values_agree_ && nav_.parameters_crc == static_cast<std::int32_t>(kParametersCrc) && now_us_ >= next_table_us_) { publish_parameters(); }
}

void Bridge::send_listed_parameters(std::size_t at_most) {
    for (; table_.listing() && at_most > 0; --at_most) { send_ground(mavlink_msg_param_value_encode_status, table_.next()); }
}

/// Rows of a list while the autopilot's clock stands still.
void Bridge::send_parameters_on_wall() {
    if (now_us_ == listed_at_us_) {
        send_listed_parameters(kRowsPerWallTurn);
        send_file_packets(kPacketsPerWallTurn);
    }
    listed_at_us_ = now_us_;
}

void Bridge::begin_preflight() {
    preflight_.begin(flavour_ != nullptr ? flavour_->preflight : std::span<const PreflightRow>{}, flavour_ != nullptr && flavour_->cast_integers);
    preflight_told_ = false;
    tell_row_ = kMaxPreflightRows;
}

/// Asks the autopilot for its parameters, and tells what is wrong, one line at a time.
void Bridge::step_preflight() {
    if (p_.link_preflight == 0 || flavour_ == nullptr) { return; }
    if (!armed_) {
        for (int i = 0; i < kQuestionsPerStep; ++i) {
            const PreflightRow* row = preflight_.ask(now_us_);
            if (row == nullptr) { break; }
            mavlink_param_request_read_t out{};
            out.target_system = autopilot().system;
            out.target_component = autopilot().component;
            out.param_index = -1;
            std::memcpy(out.param_id, row->id, strnlen(row->id, sizeof out.param_id));
            send_autopilot(mavlink_msg_param_request_read_encode_status, out);
        }
    }
    if (!preflight_told_ && preflight_.complete()) {
        preflight_told_ = true;
        tell_row_ = 0;
    }
    for (; tell_row_ < preflight_.size(); ++tell_row_) {
        const Preflight::State state = preflight_.state(tell_row_);
        if (state == Preflight::State::good || state == Preflight::State::unknown) { continue; }
        if (text_tokens_ < kTextReserve && now_us_ - text_tokens_us_ < 1000000) { return; }  // the rest when there is room again
        const PreflightRow& row = preflight_.row(tell_row_);
        if (state == Preflight::State::silent) {
            text(MAV_SEVERITY_WARNING, "%s not answered, should be %s", row.id, row.should);
        } else {
            text(MAV_SEVERITY_WARNING, "%s is %g, should be %s", row.id, static_cast<double>(preflight_.value(tell_row_)), row.should);
        }
    }
}

/// Why the autopilot's parameters forbid a start; null when they do not.
const char* Bridge::preflight_obstacle() const {
    if (p_.link_preflight < 2) { return nullptr; }
    if (!preflight_.complete()) { return "reading the autopilot's parameters"; }
    return preflight_.wrong() > 0 ? "autopilot's parameters, see list" : nullptr;
}

}  // namespace noctule
