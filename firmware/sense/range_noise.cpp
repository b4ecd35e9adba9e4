#include "sense/range_noise.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr std::size_t kLeast = 60;            // differences of one sweep; fewer say nothing
constexpr float kJump_m = 0.30F;              // between neighbours: an edge, not noise
constexpr std::int32_t kMemory = 40;          // sweeps over which the variance is averaged
constexpr float kMedianToSigma = 0.331522F;   // 1 / (0.674490 sqrt(20)), docs/maths/walls.md, equation 8

}  // namespace

void RangeNoise::add(const Scan& scan) {
    if (parameters_.laser_noise_learn == 0) { return; }
    const auto valid = [&](const float range_m) { return range_m >= scan.range_min_m && range_m < scan.range_max_m; };
    std::size_t n = 0;
    for (std::size_t i = 3; i < static_cast<std::size_t>(scan.count); ++i) {
        const float a = scan.range_m[i - 3];
        const float b = scan.range_m[i - 2];
        const float c = scan.range_m[i - 1];
        const float d = scan.range_m[i];
        if (!valid(a) || !valid(b) || !valid(c) || !valid(d)) { continue; }
        if (std::abs(b - a) > kJump_m || std::abs(c - b) > kJump_m || std::abs(d - c) > kJump_m) { continue; }
        difference_m_[n++] = std::abs(a - 3.0F * b + 3.0F * c - d);
    }
    if (n < kLeast) { return; }
    const auto middle = difference_m_.begin() + static_cast<std::ptrdiff_t>(n / 2);
    std::nth_element(difference_m_.begin(), middle, difference_m_.begin() + static_cast<std::ptrdiff_t>(n));
    const float sigma_m = kMedianToSigma * *middle;
    sweeps_ = std::min(sweeps_ + 1, kMemory);
    variance_m2_ += (sigma_m * sigma_m - variance_m2_) / static_cast<float>(sweeps_);
}

float RangeNoise::sigma_m() const {
    return std::max(parameters_.laser_range_noise_m, std::min(kMost_m, std::sqrt(variance_m2_)));
}

}  // namespace noctule
