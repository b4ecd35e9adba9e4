/// Words for the pilot: why something happened, in at most 50 characters (one STATUSTEXT) where possible.
#pragma once

#include <cstdint>

#include "link/flight_control.hpp"
#include "link/supervisor.hpp"

namespace noctule {

/// Names of nav_t.state and nav_t.reason (plan/mission.hpp); "unknown" for other values, "" for no reason.
[[nodiscard]] const char* state_text(std::int32_t state);
[[nodiscard]] const char* reason_text(std::int32_t reason);
[[nodiscard]] const char* fault_text(Fault fault);
[[nodiscard]] const char* notice_text(Notice notice);
/// MAV_SEVERITY of a notice.
[[nodiscard]] std::uint8_t notice_severity(Notice notice);

}  // namespace noctule
