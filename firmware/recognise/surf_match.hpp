/// Nearest-neighbour matching of SURF features with the ratio test.
///
/// docs/maths/vision.md, equation (7). Brute force: cost first x second x 64. No heap.
#pragma once

#include <cstdint>
#include <span>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "recognise/surf.hpp"

namespace noctule {

struct SurfMatch {
    std::int32_t first = 0;    ///< index into the first set
    std::int32_t second = 0;   ///< index into the second set
    float distance = 0.0F;     ///< Euclidean distance of the descriptors, 0 to 2
    float ratio = 0.0F;        ///< over the distance of the second best, 0 to 1
};

using SurfMatches = Bounded<SurfMatch, kMaxSurfFeatures>;

/// Euclidean distance of two descriptors.
[[nodiscard]] float surf_distance(const SurfDescriptor& a, const SurfDescriptor& b);

/// Matches each feature of `first` with its nearest of `second` of the same brightness, if it is nearer than
/// ratio_max times the second best (0 to 1; 1 keeps all). mutual: the nearest must also point back.
/// out is cleared first. A set with fewer than two candidates matches nothing: the ratio says nothing there.
void match_surf(std::span<const SurfFeature> first, std::span<const SurfFeature> second, float ratio_max, bool mutual,
                SurfMatches& out);

}  // namespace noctule
