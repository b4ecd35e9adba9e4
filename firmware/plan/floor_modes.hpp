/// Whether the elevations seen over (or under) a floor have two modes: the paper's k-means with k = 2 (section I), and a test that
/// says whether there are two at all. Pure functions of a histogram. docs/maths/floors.md, equations (1) to (3). SI.
#pragma once

#include <array>
#include <cstdint>

#include "core/capacity.hpp"

namespace noctule {

/// Distances from the floor, one vote a place (not a reading: hovering must not weigh), in bins of kBinM from zero.
struct ElevationHistogram {
    static constexpr float kBinM = 0.05F;
    std::array<std::uint32_t, kMaxElevationBins> count{};
    std::uint32_t total = 0;

    void clear() {
        count.fill(0);
        total = 0;
    }
    /// Left out: negative, not finite, beyond the last bin.
    void add(float distance_m);
};

struct FloorModes {
    float near_m = 0.0F;       ///< centre of the nearer cluster, distance from the floor
    float far_m = 0.0F;        ///< centre of the farther one
    float split_m = 0.0F;      ///< middle of the empty gap between them
    float near_edge_m = 0.0F;  ///< where the nearer cluster ends
    std::uint32_t near_votes = 0;
    std::uint32_t far_votes = 0;
    bool two = false;          ///< there are two modes, farther apart than the step
};

/// Clusters a histogram. step_m: least distance of the centres; least_votes: least size of a cluster.
/// Cost: bins x iterations, under 20 us.
[[nodiscard]] FloorModes find_modes(const ElevationHistogram& histogram, float step_m, std::uint32_t least_votes);

/// The distance, at least least_m, at which most places lie together (within 0.3 m), for an opening in the floor: stairs in it
/// fill the gap between the modes. False: fewer than least_votes there.
[[nodiscard]] bool deepest_mode(const ElevationHistogram& histogram, float least_m, std::uint32_t least_votes, float& distance_m);

}  // namespace noctule
