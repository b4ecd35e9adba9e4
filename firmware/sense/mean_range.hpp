/// A beam's range averaged with those beside it: noise makes of a thousand beams some that end centimetres before a wall.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "sense/level_scan.hpp"

namespace noctule {

inline constexpr float kMeanArcM = 0.008F;   ///< points this far to either side count into a mean range: noise has no say

/// Noise of one range that is reckoned with: as estimated, within what is believed.
[[nodiscard]] inline float believed_sigma_m(const LevelScan& scan) {
    constexpr float kLeastSigmaM = 0.003F;
    constexpr float kMostSigmaM = 0.04F;
    return std::clamp(scan.range_noise_m, kLeastSigmaM, kMostSigmaM);
}

struct MeanRange {
    float range_m = 0.0F;
    std::size_t side = 1;   ///< beams to either side that would fit; so dense are the beams there
};

/// Over 8 mm of arc to either side, at least one beam and at most eight, as far as all are of one surface. The same number on both sides: at the edge of a
/// surface seen aslant the others are all deeper. Cost: proportional to them.
[[nodiscard]] inline MeanRange mean_range(const LevelScan& scan, const std::size_t k) {
    constexpr float kMostBeams = 8.0F;
    constexpr float kAlikeSigmas = 5.0F;   // ranges that differ by less may be of one surface
    const float range_m = scan.points[k].range_m;
    const float alike_m = kAlikeSigmas * believed_sigma_m(scan);
    const auto side = static_cast<std::size_t>(std::clamp(kMeanArcM / std::max(scan.bearing_increment_rad * range_m, 1e-4F), 1.0F, kMostBeams));
    float sum_m = range_m;
    float count = 1.0F;
    for (std::size_t n = 1; n <= side && n <= k && k + n < scan.points.size(); ++n) {
        const ScanPoint& a = scan.points[k - n];
        const ScanPoint& b = scan.points[k + n];
        if (!a.hit || !b.hit || std::fabs(a.range_m - range_m) > alike_m || std::fabs(b.range_m - range_m) > alike_m) { break; }
        sum_m += a.range_m + b.range_m;
        count += 2.0F;
    }
    return {sum_m / count, side};
}

}  // namespace noctule
