/// Standard gravity.
#pragma once

namespace noctule {

inline constexpr double kGravity_m_s2 = 9.80665;

}  // namespace noctule
