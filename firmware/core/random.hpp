/// Random numbers that are the same on every machine: PCG32 (O'Neill 2014, XSH RR 64/32) and normals by Box and Muller.
///
/// No globals: each owner holds its generator and its seed. 16 bytes of state.
#pragma once

#include <cmath>
#include <cstdint>

namespace noctule {

class Random {
public:
    explicit Random(const std::uint64_t seed) : state_(seed + kIncrement) { static_cast<void>(bits()); }

    /// 32 random bits.
    [[nodiscard]] std::uint32_t bits() {
        const std::uint64_t old = state_;
        state_ = old * 6364136223846793005ULL + kIncrement;
        const auto shifted = static_cast<std::uint32_t>(((old >> 18U) ^ old) >> 27U);
        const auto turn = static_cast<std::uint32_t>(old >> 59U);
        return (shifted >> turn) | (shifted << ((32U - turn) & 31U));
    }

    /// Uniform in (0, 1), never 0 or 1.
    [[nodiscard]] float uniform() { return (static_cast<float>(bits() >> 9U) + 0.5F) * (1.0F / 8388608.0F); }

    /// Integer in [0, n), n > 0. The bias is below n / 2^32.
    [[nodiscard]] std::uint32_t below(const std::uint32_t n) {
        return static_cast<std::uint32_t>((static_cast<std::uint64_t>(bits()) * n) >> 32U);
    }

    /// Standard normal.
    [[nodiscard]] float normal() {
        const float radius = std::sqrt(-2.0F * std::log(uniform()));
        return radius * std::cos(6.28318530717959F * uniform());
    }

private:
    static constexpr std::uint64_t kIncrement = 1442695040888963407ULL;
    std::uint64_t state_;
};

}  // namespace noctule
