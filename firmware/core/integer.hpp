/// Whole numbers from floats without a call into the C library, for inner loops. The argument must fit std::int32_t.
#pragma once

#include <cstdint>

namespace noctule {

/// The greatest whole number not above x: std::floor.
[[nodiscard]] constexpr std::int32_t floor_int(const float x) {
    const auto toward_zero = static_cast<std::int32_t>(x);
    return toward_zero - (static_cast<float>(toward_zero) > x ? 1 : 0);
}

/// The nearest whole number, halves away from zero: std::lround.
[[nodiscard]] constexpr std::int32_t round_int(const float x) {
    const auto toward_zero = static_cast<std::int32_t>(x);
    const float rest = x - static_cast<float>(toward_zero);
    return toward_zero + (rest >= 0.5F ? 1 : 0) - (rest <= -0.5F ? 1 : 0);
}

}  // namespace noctule
