/// Whole numbers from floats without a call into the C library, for inner loops.
#pragma once

#include <algorithm>
#include <cstdint>

namespace noctule {

/// The greatest whole number not above x: std::floor. Beyond 1e9 either way it stays there; no number counts as -1e9.
[[nodiscard]] constexpr std::int32_t floor_int(const float x) {
    const float held = std::min(1.0e9F, std::max(-1.0e9F, x));
    const auto toward_zero = static_cast<std::int32_t>(held);
    return toward_zero - (static_cast<float>(toward_zero) > held ? 1 : 0);
}

/// The nearest whole number, halves away from zero: std::lround. x must fit std::int32_t.
[[nodiscard]] constexpr std::int32_t round_int(const float x) {
    const auto toward_zero = static_cast<std::int32_t>(x);
    const float rest = x - static_cast<float>(toward_zero);
    return toward_zero + (rest >= 0.5F ? 1 : 0) - (rest <= -0.5F ? 1 : 0);
}

}  // namespace noctule
