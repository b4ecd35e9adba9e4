#include "recognise/surf_match.hpp"

#include <array>
#include <cmath>
#include <cstring>
#include <limits>

namespace noctule {
namespace {

using Float4 = float __attribute__((vector_size(16)));

Float4 load(const float* const p) {
    Float4 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}

float square_distance(const SurfDescriptor& a, const SurfDescriptor& b) {
    Float4 even{};
    Float4 odd{};
    for (std::size_t i = 0; i < a.size(); i += 8) {
        const Float4 d = load(&a[i]) - load(&b[i]);
        const Float4 e = load(&a[i + 4]) - load(&b[i + 4]);
        even += d * d;
        odd += e * e;
    }
    const Float4 sum = even + odd;
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

}  // namespace

float surf_distance(const SurfDescriptor& a, const SurfDescriptor& b) { return std::sqrt(square_distance(a, b)); }

void match_surf(const std::span<const SurfFeature> first, const std::span<const SurfFeature> second, const float ratio_max,
                const bool mutual, SurfMatches& out) {
    out.clear();
    // Nearest of the first set for each of the second, for the mutual check.
    std::array<float, kMaxSurfFeatures> back_distance;
    std::array<std::int32_t, kMaxSurfFeatures> back;
    if (second.size() > back.size()) { return; }
    back_distance.fill(std::numeric_limits<float>::max());
    back.fill(-1);
    for (std::size_t i = 0; i < first.size(); ++i) {
        float best = std::numeric_limits<float>::max();
        float next = std::numeric_limits<float>::max();
        std::int32_t nearest = -1;
        for (std::size_t j = 0; j < second.size(); ++j) {
            if (first[i].point.bright != second[j].point.bright) { continue; }
            const float d = square_distance(first[i].descriptor, second[j].descriptor);
            if (d < best) {
                next = best;
                best = d;
                nearest = static_cast<std::int32_t>(j);
            } else if (d < next) {
                next = d;
            }
            if (d < back_distance[j]) {
                back_distance[j] = d;
                back[j] = static_cast<std::int32_t>(i);
            }
        }
        if (nearest < 0 || next == std::numeric_limits<float>::max()) { continue; }
        const float ratio = next > 0.0F ? std::sqrt(best / next) : 1.0F;
        if (!(ratio <= ratio_max)) { continue; }
        static_cast<void>(out.push({static_cast<std::int32_t>(i), nearest, std::sqrt(best), ratio}));
    }
    if (!mutual) { return; }
    std::size_t kept = 0;
    for (std::size_t k = 0; k < out.size(); ++k) {
        if (back[static_cast<std::size_t>(out[k].second)] == out[k].first) { out[kept++] = out[k]; }
    }
    while (out.size() > kept) { out.remove_unordered(out.size() - 1); }
}

}  // namespace noctule
