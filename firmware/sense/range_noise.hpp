/// Standard deviation of the laser's ranges, from the ranges themselves.
///
/// Third differences of neighbouring beams know nothing of flat or gently bent surfaces, only noise (docs/maths/walls.md#noise).
/// Their median is deaf to edges; it is averaged over sweeps. Never below laser_range_noise_m, never above kMost_m. No heap.
#pragma once

#include <array>
#include <cstdint>

#include "core/capacity.hpp"
#include "params.gen.hpp"
#include "sense/samples.hpp"

namespace noctule {

class RangeNoise {
public:
    static constexpr float kMost_m = 0.06F;

    explicit RangeNoise(const Parameters& parameters) : parameters_(parameters) {}

    /// Takes a sweep in.
    void add(const Scan& scan);
    /// What to reckon with [m].
    [[nodiscard]] float sigma_m() const;

private:
    const Parameters& parameters_;
    float variance_m2_ = 0.0F;
    std::int32_t sweeps_ = 0;   ///< up to kMemory
    std::array<float, kMaxBeams> difference_m_{};
};

}  // namespace noctule
