#include "link/parameter_server.hpp"

#include <algorithm>
#include <bit>
#include <cstring>

namespace noctule {

std::string_view parameter_id(const char (&id)[16]) { return {id, strnlen(id, sizeof id)}; }

float integer_to_wire(const std::int32_t value, const bool cast) { return cast ? static_cast<float>(value) : std::bit_cast<float>(value); }

bool value_from_wire(const float wire, const std::uint8_t type, const bool cast, float& value) {
    const auto bits = std::bit_cast<std::uint32_t>(wire);
    const bool integer = type >= MAV_PARAM_TYPE_UINT8 && type <= MAV_PARAM_TYPE_INT32;
    value = wire;
    if (type == MAV_PARAM_TYPE_REAL32 || (integer && cast)) { return true; }
    switch (type) {
        case MAV_PARAM_TYPE_UINT8: value = static_cast<float>(bits & 0xFFU); return true;
        case MAV_PARAM_TYPE_INT8: value = static_cast<float>(static_cast<std::int8_t>(bits & 0xFFU)); return true;
        case MAV_PARAM_TYPE_UINT16: value = static_cast<float>(bits & 0xFFFFU); return true;
        case MAV_PARAM_TYPE_INT16: value = static_cast<float>(static_cast<std::int16_t>(bits & 0xFFFFU)); return true;
        case MAV_PARAM_TYPE_UINT32: value = static_cast<float>(bits); return true;
        case MAV_PARAM_TYPE_INT32: value = static_cast<float>(std::bit_cast<std::int32_t>(bits)); return true;
        default: return false;
    }
}

mavlink_param_value_t ParameterServer::next() {
    const std::size_t row = next_;
    next_ = (next_ + 1) % kParameterTable.size();
    --left_;
    return value(row);
}

mavlink_param_value_t ParameterServer::value(const std::size_t row) const {
    mavlink_param_value_t out{};
    const ParameterRow& parameter = kParameterTable[row];
    std::copy_n(parameter.id.data(), std::min(parameter.id.size(), sizeof out.param_id), out.param_id);
    const bool integer = parameter.as_int != nullptr;
    out.param_value = integer ? integer_to_wire(stored_.*parameter.as_int, cast_) : stored_.*parameter.as_float;
    out.param_type = integer ? MAV_PARAM_TYPE_INT32 : MAV_PARAM_TYPE_REAL32;
    out.param_count = static_cast<std::uint16_t>(kParameterTable.size());
    out.param_index = static_cast<std::uint16_t>(row);
    return out;
}

std::size_t ParameterServer::find(const char (&id)[16], const std::int16_t index) {
    if (index >= 0) { return std::min(static_cast<std::size_t>(index), kParameterTable.size()); }
    const std::string_view wanted = parameter_id(id);
    const auto* found = std::find_if(kParameterTable.begin(), kParameterTable.end(), [wanted](const ParameterRow& row) { return row.id == wanted; });
    return static_cast<std::size_t>(found - kParameterTable.begin());
}

ParameterWrite ParameterServer::write(const mavlink_param_set_t& in, std::size_t& row) {
    row = find(in.param_id, -1);
    if (row >= kParameterTable.size()) { return ParameterWrite::rejected_unknown; }
    const ParameterRow& parameter = kParameterTable[row];
    float value = 0.0F;
    if (!value_from_wire(in.param_value, in.param_type, cast_, value)) { return ParameterWrite::rejected_type; }
    const float before = parameter_value(stored_, parameter);
    switch (set_parameter(stored_, parameter, value)) {
        case ParameterSet::rejected_range: return ParameterWrite::rejected_range;
        case ParameterSet::rejected_not_whole: return ParameterWrite::rejected_not_whole;
        case ParameterSet::stored: break;
    }
    if (parameter_value(stored_, parameter) == before) { return ParameterWrite::unchanged; }
    if (!parameter.reboot) { static_cast<void>(set_parameter(live_, parameter, value)); }
    dirty_ = true;
    return ParameterWrite::stored;
}

}  // namespace noctule
