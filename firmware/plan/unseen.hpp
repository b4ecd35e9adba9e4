/// Floor that the laser has mapped but the camera has not seen, in patches, each with the cheapest place to look at it from.
///
/// docs/maths/explore.md, "seeing". Used by the survey when the parameter camera_weight is over 0: a patch then stands beside the groups of the
/// edge of the unknown, as one more place to visit. A slice of tiles a step. Frame Map. No heap.
#pragma once

#include <cstdint>

#include "core/bounded.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/frontier.hpp"
#include "plan/traversability.hpp"

namespace noctule {

class UnseenSearch {
public:
    explicit UnseenSearch(const Parameters& parameters) : p_(parameters) {}

    void start() {
        tile_ = 0;
        found_.clear();
    }
    /// One slice; true: complete.
    bool run(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried, std::int64_t t_us);
    /// Patches with Frontier::camera set; `cells` is how many unseen cells the block in their middle has.
    [[nodiscard]] const Bounded<Frontier, kMaxFrontiers>& found() const { return found_; }

private:
    static constexpr std::int32_t kTilesPerSlice = 4;
    bool view(const OccupancyGrid& grid, const Traversability& where, const CostField& from, Frontier& patch) const;

    const Parameters& p_;
    std::int32_t tile_ = 0;
    Bounded<Frontier, kMaxFrontiers> found_;
};

}  // namespace noctule
