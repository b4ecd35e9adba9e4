/// The values of the parameter table as they travel from bridge to nav, and what of them takes effect without a restart.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>

#include "lcmtypes/noctule/parameters_t.hpp"
#include "params.gen.hpp"

namespace noctule {

static_assert(kParameterTable.size() <= parameters_t::MAX_ROWS, "parameters_t.lcm is too short for the table");

/// FNV-1a over the values of the rows that take effect at once: equal on both sides when they fly the same numbers.
[[nodiscard]] inline std::int32_t parameter_values_crc(const Parameters& parameters) {
    std::uint32_t hash = 2166136261U;
    for (const ParameterRow& row : kParameterTable) {
        if (row.reboot) { continue; }
        const auto bits = std::bit_cast<std::uint32_t>(parameter_value(parameters, row));
        for (unsigned shift = 0; shift < 32; shift += 8) { hash = (hash ^ (bits >> shift & 0xFFU)) * 16777619U; }
    }
    return std::bit_cast<std::int32_t>(hash);
}

/// Fills all but t_us and seq.
inline void to_message(const Parameters& parameters, parameters_t& out) {
    out.parameters_crc = std::bit_cast<std::int32_t>(kParametersCrc);
    out.count = static_cast<std::int32_t>(kParameterTable.size());
    std::fill(std::begin(out.value), std::end(out.value), 0.0F);
    for (std::size_t i = 0; i < kParameterTable.size(); ++i) { out.value[i] = parameter_value(parameters, kParameterTable[i]); }
}

/// The message is of this table.
[[nodiscard]] inline bool fits_table(const parameters_t& message) {
    return message.parameters_crc == std::bit_cast<std::int32_t>(kParametersCrc) && message.count == static_cast<std::int32_t>(kParameterTable.size());
}

/// Takes over the rows that need no restart; a value out of its row's range leaves that row as it is. Returns the number refused.
inline std::uint32_t apply(const parameters_t& message, Parameters& parameters) {
    std::uint32_t refused = 0;
    for (std::size_t i = 0; i < kParameterTable.size(); ++i) {
        const ParameterRow& row = kParameterTable[i];
        if (!row.reboot && set_parameter(parameters, row, message.value[i]) != ParameterSet::stored) { ++refused; }
    }
    return refused;
}

}  // namespace noctule
