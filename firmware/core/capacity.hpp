/// Every capacity of the firmware, in one place; docs/memory.md says what happens when each is full.
#pragma once

#include <cstddef>

namespace noctule {

// One step's input.
inline constexpr std::size_t kMaxBeams = 1200;           ///< beams of one sweep; a longer one is refused
inline constexpr std::size_t kMaxImuPerStep = 128;       ///< inertial samples between two scans; the newest are refused
inline constexpr std::size_t kMaxAttitudePerStep = 32;   ///< attitude samples between two scans; the newest are refused
inline constexpr std::size_t kMaxRangePerStep = 16;      ///< range samples of one direction between two scans; the newest are refused
inline constexpr std::size_t kMaxVehiclePerStep = 16;    ///< vehicle messages between two scans; the newest are refused
inline constexpr std::size_t kMaxCommandPerStep = 8;     ///< commands between two scans; the newest are refused

// Link.
inline constexpr std::size_t kMaxLcmBytes = 61440;       ///< encoded LCM message; a larger one is not sent (LCM would allocate)
inline constexpr int kMaxLcmQueue = 1024;                ///< messages that wait on one subscription; the newest are refused
inline constexpr std::size_t kMaxLcmSubscriptions = 16;  ///< channels one process listens to; more are refused at start-up

}  // namespace noctule
