#include "plan/trail.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace noctule {

namespace {

constexpr float kJoinM = 2.2F;              ///< nodes within this may be joined: more than two steps, so that no gap stays open
constexpr std::size_t kRelaxedPerStep = 6;
constexpr float kOffTrail = 1.5F;           ///< what a metre beside the trail counts where no line to it is known to be free

}  // namespace

void Trail::begin(const OccupancyGrid& grid, const float x_m, const float y_m) {
    nodes_.clear();
    static_cast<void>(nodes_.push({x_m, y_m, 0.0F, grid.floor()}));
    next_ = 0;
    way_home_m_ = longest_m_ = 0.0F;
}

void Trail::relax(const OccupancyGrid& grid, Node& node) {
    for (const Node& other : nodes_) {
        if (other.floor != node.floor || std::fabs(other.x_m - node.x_m) > kJoinM || std::fabs(other.y_m - node.y_m) > kJoinM) { continue; }
        const float through_m = other.way_m + std::hypot(other.x_m - node.x_m, other.y_m - node.y_m);
        if (through_m < node.way_m - 0.01F && grid.line_is_free(other.x_m, other.y_m, node.x_m, node.y_m)) { node.way_m = through_m; }
    }
}

void Trail::step(const OccupancyGrid& grid, const float x_m, const float y_m) {
    if (nodes_.empty()) { return; }
    // From the end before, should no line be known to be free (unknown cells under the vehicle, a jump of the estimate).
    Node here{x_m, y_m, std::numeric_limits<float>::max(), grid.floor()};
    const Node* nearest = nullptr;
    float away_m = std::numeric_limits<float>::max();
    for (const Node& n : nodes_) {
        const float d = std::hypot(n.x_m - x_m, n.y_m - y_m);
        if (n.floor == here.floor && d < away_m) {
            away_m = d;
            nearest = &n;
        }
    }
    relax(grid, here);
    if (here.way_m == std::numeric_limits<float>::max()) {
        // A floor just come to: the way so far goes on.
        here.way_m = nearest == nullptr ? way_home_m_ : nearest->way_m + kOffTrail * away_m;
    }
    way_home_m_ = here.way_m;
    longest_m_ = std::max(longest_m_, here.way_m);
    if (away_m > kTrailStepM) { static_cast<void>(nodes_.push(here)); }
    for (std::size_t k = 0; k < std::min(kRelaxedPerStep, nodes_.size()); ++k) {
        next_ = (next_ + 1U) % nodes_.size();
        if (nodes_[next_].floor == grid.floor()) { relax(grid, nodes_[next_]); }
    }
}

}  // namespace noctule
