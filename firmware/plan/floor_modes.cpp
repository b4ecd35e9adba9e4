#include "plan/floor_modes.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr int kMostRounds = 40;
constexpr float kGapShare = 0.4F;     ///< of the step that must lie empty between the clusters
constexpr float kStrayShare = 0.01F;  ///< of the votes that may lie in the gap: echoes, edges

float centre_of(const std::size_t bin) { return (static_cast<float>(bin) + 0.5F) * ElevationHistogram::kBinM; }

}  // namespace

void ElevationHistogram::add(const float distance_m) {
    if (!(distance_m >= 0.0F) || !(distance_m < kBinM * static_cast<float>(kMaxElevationBins))) { return; }
    ++count[static_cast<std::size_t>(distance_m / kBinM)];
    ++total;
}

FloorModes find_modes(const ElevationHistogram& histogram, const float step_m, const std::uint32_t least_votes) {
    FloorModes out;
    std::size_t first = 0;
    std::size_t last = kMaxElevationBins;
    while (first < last && histogram.count[first] == 0U) { ++first; }
    while (last > first && histogram.count[last - 1U] == 0U) { --last; }
    if (first >= last) { return out; }
    // k-means, k = 2, from the two ends. In one dimension the clusters are the two sides of a threshold.
    float low_m = centre_of(first);
    float high_m = centre_of(last - 1U);
    for (int round = 0; round < kMostRounds; ++round) {
        float sum[2] = {};
        float votes[2] = {};
        for (std::size_t b = first; b < last; ++b) {
            const auto side = static_cast<std::size_t>(centre_of(b) > 0.5F * (low_m + high_m));
            sum[side] += static_cast<float>(histogram.count[b]) * centre_of(b);
            votes[side] += static_cast<float>(histogram.count[b]);
        }
        if (votes[0] < 0.5F || votes[1] < 0.5F) { break; }
        const float new_low_m = sum[0] / votes[0];
        const float new_high_m = sum[1] / votes[1];
        const bool still = std::fabs(new_low_m - low_m) + std::fabs(new_high_m - high_m) < 1e-4F;
        low_m = new_low_m;
        high_m = new_high_m;
        if (still) { break; }
    }
    out.near_m = low_m;
    out.far_m = high_m;
    // Two modes: the longest stretch between the centres that holds next to nothing is long enough, and both sides hold enough.
    const auto stray = static_cast<std::uint32_t>(kStrayShare * static_cast<float>(histogram.total));
    const auto from = static_cast<std::size_t>(std::max(0.0F, low_m / ElevationHistogram::kBinM));
    const auto to = std::min(last, static_cast<std::size_t>(high_m / ElevationHistogram::kBinM) + 1U);
    std::size_t best_begin = from;
    std::size_t best_end = from;
    std::uint32_t inside = 0;
    for (std::size_t begin = from, end = from; end < to; ++end) {
        inside += histogram.count[end];
        while (inside > stray && begin <= end) { inside -= histogram.count[begin++]; }
        if (end + 1U - begin > best_end - best_begin && end + 1U > begin) {
            best_begin = begin;
            best_end = end + 1U;
        }
    }
    for (std::size_t b = first; b < last; ++b) { (b < (best_begin + best_end) / 2U ? out.near_votes : out.far_votes) += histogram.count[b]; }
    out.split_m = 0.5F * ElevationHistogram::kBinM * static_cast<float>(best_begin + best_end);
    out.near_edge_m = ElevationHistogram::kBinM * static_cast<float>(best_begin);
    const float gap_m = ElevationHistogram::kBinM * static_cast<float>(best_end - best_begin);
    out.two = high_m - low_m >= step_m && gap_m >= kGapShare * step_m && out.near_votes >= least_votes && out.far_votes >= least_votes;
    return out;
}

bool deepest_mode(const ElevationHistogram& histogram, const float least_m, const std::uint32_t least_votes, float& distance_m) {
    constexpr std::size_t kWindow = 6;
    std::uint32_t best = 0;
    for (auto b = static_cast<std::size_t>(std::max(0.0F, least_m) / ElevationHistogram::kBinM); b + kWindow <= kMaxElevationBins; ++b) {
        std::uint32_t votes = 0;
        float sum = 0.0F;
        for (std::size_t k = b; k < b + kWindow; ++k) {
            votes += histogram.count[k];
            sum += static_cast<float>(histogram.count[k]) * centre_of(k);
        }
        if (votes > best) {
            best = votes;
            distance_m = sum / static_cast<float>(votes);
        }
    }
    return best >= least_votes;
}

}  // namespace noctule
