/// Angles: one function that wraps, used after every sum and difference.
#pragma once

#include <cmath>

namespace noctule {

inline constexpr float kPi = 3.14159265358979F;

/// The angle in (-pi, pi]. Any finite input; a non-finite input comes back as it is.
[[nodiscard]] inline float wrap_angle(const float angle_rad) {
    if (angle_rad > -kPi && angle_rad <= kPi) { return angle_rad; }
    constexpr float kTwoPi = 2.0F * kPi;
    float wrapped = angle_rad - kTwoPi * std::floor((angle_rad + kPi) / kTwoPi);
    if (wrapped <= -kPi) { wrapped += kTwoPi; }
    if (wrapped > kPi) { wrapped -= kTwoPi; }
    return wrapped;
}

}  // namespace noctule
