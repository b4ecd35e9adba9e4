// FloorPlanner's search: which opening is next, and where to look for one. docs/maths/floors.md.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "plan/floors.hpp"

namespace noctule {

namespace {

constexpr std::uint32_t kLeastVotes = 8;      ///< places that make a cluster of what lies below
constexpr std::uint32_t kLeastOver = 3;       ///< the same over the vehicle: a way along an opening's edge shows few, and a look round tells
constexpr std::size_t kMostBeyond = 1024;     ///< places beyond looked at in one search; more are left out
constexpr std::int32_t kLeastBeside = 4;      ///< a place beyond, below the vehicle, counts with so many of its like round it
constexpr std::int32_t kLeastBesideOver = 2;  ///< the same over the vehicle
constexpr float kBesideM = 0.45F;
constexpr float kJudgedM = 1.2F;              ///< round an opening that was judged
constexpr float kBandM = 0.4F;                ///< of the ground below an opening
constexpr float kAsideM = 0.4F;              ///< of a place beyond, that a place known to lie in a high room may be
constexpr float kNarrower = 0.7F;             ///< what a pass of the search looks for, against the pass before
constexpr float kLocalM = 2.5F;               ///< the slab's underside is that beside the opening

struct Spot {
    float x_m = 0.0F;
    float y_m = 0.0F;
};

}  // namespace

// One way up and one way down a floor is enough: further openings of the same storey lead to the same floor.
bool FloorPlanner::linked(const bool up) const {
    for (const Passage& p : passages_) {
        const std::int8_t here = up ? p.low : p.high;
        const std::int8_t there = up ? p.high : p.low;
        if (here == current_ && !floors_[static_cast<std::size_t>(there)].empty) { return true; }
    }
    return false;
}

// Near a judged opening, or in the part of a high room that was flown through without finding a floor.
bool FloorPlanner::was_judged(const OccupancyGrid& grid, const bool up, const float x_m, const float y_m) const {
    for (const Judged& j : judged_) {
        if (j.floor != current_ || j.up != up) { continue; }
        if (std::hypot(j.x_m - x_m, j.y_m - y_m) < kJudgedM || std::hypot(j.seen_x_m - x_m, j.seen_y_m - y_m) < kJudgedM) { return true; }
    }
    for (std::size_t i = 0; i < floors_.size(); ++i) {
        const Floor& f = floors_[i];
        if (!f.empty || f.parent != current_ || (f.elevation_m > floors_[static_cast<std::size_t>(current_)].elevation_m) != up) { continue; }
        // A place at the room's side is seen a little aside: what is free beside it counts.
        for (const auto& [dx, dy] : {std::pair{0.0F, 0.0F}, {kAsideM, 0.0F}, {-kAsideM, 0.0F}, {0.0F, kAsideM}, {0.0F, -kAsideM}}) {
            const Cell c = grid.geometry().cell(x_m + dx, y_m + dy);
            const std::int32_t slot = grid.tile_slot(static_cast<std::int32_t>(i), c.ix >> 6, c.iy >> 6);
            if (slot >= 0 && grid.cell_class(slot * kTileArea + (c.iy & 63) * kTileCells + (c.ix & 63)) == CellClass::free) { return true; }
        }
    }
    return false;
}

FloorPlanner::Seed FloorPlanner::find_opening(const OccupancyGrid& grid, const Pose2<Map, Body>& pose) const {
    const Seed up = find_opening(grid, pose, true);
    const Seed down = find_opening(grid, pose, false);
    if (!up.valid || !down.valid) { return up.valid ? up : down; }
    return std::hypot(up.x_m - pose.x_m, up.y_m - pose.y_m) <= std::hypot(down.x_m - pose.x_m, down.y_m - pose.y_m) ? up : down;
}

FloorPlanner::Seed FloorPlanner::find_opening(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const bool up) const {
    Seed seed;
    seed.up = up;
    if (linked(up) || full()) { return seed; }
    const float elevation_m = floors_[static_cast<std::size_t>(current_)].elevation_m;
    const VerticalSide side = up ? VerticalSide::over : VerticalSide::under;
    const auto of_this = [&](const VerticalCell& v) { return v.floor == current_ && v.side == side; };
    ElevationHistogram histogram;
    for (const VerticalCell& v : vertical_.cells()) {
        if (of_this(v)) { histogram.add(up ? v.z_m - elevation_m : elevation_m - v.z_m); }
    }
    if (up) {
        const FloorModes modes = find_modes(histogram, p_.floor_mode_step_m, kLeastOver);
        if (!modes.two) { return seed; }
        seed.beyond = {elevation_m + modes.split_m, std::numeric_limits<float>::max()};
        seed.slab_m = elevation_m + modes.near_m;
        seed.far_m = elevation_m + modes.far_m;
    } else {
        float depth_m = 0.0F;
        if (!deepest_mode(histogram, p_.floor_mode_step_m, kLeastVotes, depth_m)) { return seed; }
        seed.far_m = elevation_m - depth_m;
        seed.beyond = {seed.far_m - kBandM, seed.far_m + kBandM};
        seed.slab_m = elevation_m;
    }
    Bounded<Spot, kMostBeyond> beyond;
    for (const VerticalCell& v : vertical_.cells()) {
        if (of_this(v) && seed.beyond.holds(v.z_m)) { static_cast<void>(beyond.push({vertical_.geometry().centre_x_m(v.cell), vertical_.geometry().centre_y_m(v.cell)})); }
    }
    float best = std::numeric_limits<float>::infinity();
    for (const Spot& s : beyond) {
        const float way = std::hypot(s.x_m - pose.x_m, s.y_m - pose.y_m);
        if (way >= best) { continue; }
        std::int32_t beside = 0;
        for (const Spot& o : beyond) { beside += std::hypot(o.x_m - s.x_m, o.y_m - s.y_m) < kBesideM ? 1 : 0; }
        if (beside <= (up ? kLeastBesideOver : kLeastBeside) || was_judged(grid, up, s.x_m, s.y_m)) { continue; }
        best = way;
        seed.valid = true;
        seed.x_m = seed.seen_x_m = s.x_m;
        seed.y_m = seed.seen_y_m = s.y_m;
    }
    if (seed.valid && up) {
        float sum_m = 0.0F;
        float n = 0.0F;
        for (const VerticalCell& v : vertical_.cells()) {
            if (!of_this(v) || seed.beyond.holds(v.z_m) || v.z_m < seed.slab_m - kBandM) { continue; }
            const float dx = vertical_.geometry().centre_x_m(v.cell) - seed.x_m;
            const float dy = vertical_.geometry().centre_y_m(v.cell) - seed.y_m;
            if (dx * dx + dy * dy > kLocalM * kLocalM) { continue; }
            sum_m += v.z_m;
            n += 1.0F;
        }
        if (n > 0.5F) { seed.slab_m = sum_m / n; }
    }
    return seed;
}

// True: there is room for no further floor.
bool FloorPlanner::full() const { return floors_.size() >= std::min(kFloorSlots, static_cast<std::size_t>(p_.floors_max)); }

// True: the floor is to be passed over and under more closely than its exploration did.
bool FloorPlanner::wants_search() const {
    const Floor& floor = floors_[static_cast<std::size_t>(current_)];
    const bool up = linked(true);
    const bool down = linked(false);
    return vertical_.size() > 0U && !floor.searched && !full() && !(up && down) &&
           ((floor.pass == 0 && !up && !down) || floor.searched_s < (up || down ? p_.floor_search_linked_s : p_.floor_search_s) + p_.floor_search_share * floor.explored_s);
}

// Where the search is flown to its end few passes are the shortest way; where it has little time the widest openings come first.
float FloorPlanner::width_m(const std::int32_t pass) const {
    const float least_m = std::min(p_.floor_search_fine_m, p_.floor_search_gap_m);
    if (pass > 1 && !linked(true) && !linked(false)) { return least_m; }
    return std::max(p_.floor_search_gap_m * std::pow(kNarrower, static_cast<float>(pass)), least_m);
}

}  // namespace noctule
