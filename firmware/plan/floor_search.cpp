// FloorPlanner's search: which opening is next, and where to look for one. docs/maths/floors.md.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "plan/floors.hpp"

namespace noctule {

namespace {

constexpr std::uint32_t kLeastVotes = 8;      ///< places that make a cluster
constexpr std::size_t kMostBeyond = 1024;     ///< places beyond looked at in one search; more are left out
constexpr std::int32_t kLeastBeside = 4;      ///< a place beyond counts with so many of its like round it
constexpr float kBesideM = 0.45F;
constexpr float kJudgedM = 1.2F;              ///< round an opening that was judged
constexpr float kBandM = 0.4F;                ///< of the ground below an opening
constexpr float kLocalM = 2.5F;               ///< the slab's underside is that beside the opening
constexpr float kLinkedShare = 0.5F;         ///< of the time for the search where one other floor is known
constexpr float kRoundCornerM = 4.0F;         ///< way that a place out of the line of sight costs more

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
    const Cell c = grid.geometry().cell(x_m, y_m);
    for (std::size_t i = 0; i < floors_.size(); ++i) {
        const Floor& f = floors_[i];
        if (!f.empty || f.parent != current_ || (f.elevation_m > floors_[static_cast<std::size_t>(current_)].elevation_m) != up) { continue; }
        const std::int32_t slot = grid.tile_slot(static_cast<std::int32_t>(i), c.ix >> 6, c.iy >> 6);
        if (slot >= 0 && grid.cell_class(slot * kTileArea + (c.iy & 63) * kTileCells + (c.ix & 63)) == CellClass::free) { return true; }
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
    if (linked(up) || floors_.size() >= std::min(kFloorSlots, static_cast<std::size_t>(p_.floors_max))) { return seed; }   // no room for one more
    const float elevation_m = floors_[static_cast<std::size_t>(current_)].elevation_m;
    const VerticalSide side = up ? VerticalSide::over : VerticalSide::under;
    const auto of_this = [&](const VerticalCell& v) { return v.floor == current_ && v.side == side; };
    ElevationHistogram histogram;
    for (const VerticalCell& v : vertical_.cells()) {
        if (of_this(v)) { histogram.add(up ? v.z_m - elevation_m : elevation_m - v.z_m); }
    }
    if (up) {
        const FloorModes modes = find_modes(histogram, p_.floor_mode_step_m, kLeastVotes);
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
        if (beside <= kLeastBeside || was_judged(grid, up, s.x_m, s.y_m)) { continue; }
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

// The nearest place that was not looked at, as long as there is time for the search.
bool FloorPlanner::next_search(const OccupancyGrid& grid, const Explorer& explorer, const Pose2<Map, Body>& pose) {
    const Floor& floor = floors_[static_cast<std::size_t>(current_)];
    const bool up = linked(true);
    const bool down = linked(false);
    const float share = up || down ? kLinkedShare : 1.0F;
    const float time_s = share * (p_.floor_search_s + p_.floor_search_share * floor.explored_s);
    if (vertical_.size() == 0U || floor.searched_s >= time_s || (up && down)) { return false; }
    float best = std::numeric_limits<float>::infinity();
    for (std::int32_t slot = 0; slot < grid.tile_count(); ++slot) {
        const GridTile& tile = grid.tile(slot);
        if (tile.floor != current_) { continue; }
        for (std::int32_t block = 0; block < kTileBlocks; ++block) {
            if ((covered_[static_cast<std::size_t>(slot)] >> static_cast<unsigned>(block) & 1U) != 0U) { continue; }
            for (const std::int32_t at : {4 * kTileCells + 4, 2 * kTileCells + 2, 2 * kTileCells + 6, 6 * kTileCells + 2, 6 * kTileCells + 6}) {
                const CellId id = slot * kTileArea + (block >> 3) * kBlockCells * kTileCells + (block & 7) * kBlockCells + at;
                if (!explorer.where().passable(id)) { continue; }
                const Cell c = grid.cell(id);
                const float x_m = grid.geometry().centre_x_m(c);
                const float y_m = grid.geometry().centre_y_m(c);
                float way = std::hypot(x_m - pose.x_m, y_m - pose.y_m);
                if (way < best && !grid.line_is_free(pose.x_m, pose.y_m, x_m, y_m)) { way += kRoundCornerM; }
                if (way < best) {
                    best = way;
                    goal_x_m_ = x_m;
                    goal_y_m_ = y_m;
                    goal_block_ = slot * kTileBlocks + block;
                }
                break;
            }
        }
    }
    if (best >= std::numeric_limits<float>::max()) { return false; }
    since_us_ = t_us_;
    way_us_ = -1;
    return true;
}

}  // namespace noctule
