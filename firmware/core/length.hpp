/// Length of a vector in the plane without a call into the C library, for inner loops: std::hypot of floats, bit for bit as glibc has it.
#pragma once

#include <cmath>

namespace noctule {

/// Squares of floats neither overflow nor vanish in double, so nothing has to be scaled.
[[nodiscard]] inline float length_of(const float x, const float y) {
    const auto wide_x = static_cast<double>(x);
    const auto wide_y = static_cast<double>(y);
    return static_cast<float>(std::sqrt(wide_x * wide_x + wide_y * wide_y));
}

}  // namespace noctule
