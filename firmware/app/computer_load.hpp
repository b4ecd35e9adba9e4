/// Load, memory and temperature of this computer, from /proc and /sys. Linux only; reading allocates nothing.
#pragma once

#include <cstdint>

#include "link/bridge.hpp"

namespace noctule {

class ComputerWatch {
public:
    /// The load since the last call, and what holds now. What cannot be read is marked as not known.
    [[nodiscard]] ComputerLoad read(std::int64_t monotonic_us);

private:
    std::uint64_t busy_ = 0;
    std::uint64_t total_ = 0;
};

}  // namespace noctule
