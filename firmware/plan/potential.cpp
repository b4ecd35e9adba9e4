#include "plan/potential.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace noctule {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
// Weights of a straight and a diagonal step sum to one over the eight neighbours, and their logarithms stand as 1 to sqrt(2):
// then the cost of the single best way is exactly the cost field. docs/maths/potential.md, equation (4).
constexpr float kStraight = 1.7775816F;
constexpr float kDiagonal = 2.5138800F;
constexpr float kNatsPerUnit = kStraight / static_cast<float>(CostField::kUnit);
constexpr float kNegligible = 12.0F;   ///< a neighbour this many nats behind adds nothing in float
constexpr std::int32_t kSmoothRounds = 12;
constexpr float kSoftPush = 0.2F;      ///< share of what is lacking to the clearance wanted that a round pushes a point away
constexpr float kHardPush = 0.5F;      ///< and of what is lacking to hull and kRoomM: more than the band pulls back round a corner
constexpr float kRoomM = 0.18F;
constexpr float kCentreM = 0.14F;      ///< hull and less than this: the line is centred exactly
constexpr float kCentreSteps[] = {0.02F, 0.01F, 0.005F, 0.0025F};
constexpr float kCapM = 0.01F * static_cast<float>(Traversability::kCapCm);
constexpr float kAstray = 0.2F;        ///< the way straight on is free if it is free within this angle to both sides
constexpr std::int32_t kSlideSteps = 8;
constexpr float kSlideLeastM = 0.01F;
constexpr float kEnoughShare = 1.25F;  ///< of what stopping takes, and kEnoughM: a way longer than this bounds no speed
constexpr float kEnoughM = 0.10F;
constexpr float kFeltShare = 1.1F;     ///< of the way over which the reference brakes: what lies farther ahead bounds no speed
constexpr float kLookM = 0.15F;        ///< beyond the clearance wanted, so that a point may move before it is looked up again
constexpr float kLeavesM = 0.007F;     ///< clearance lacking to hull and margin: with so little it still leads out of one
constexpr float kInsideM = 0.015F;     ///< over them: with less it begins in a gap
constexpr float kBeforeM = 0.02F;      ///< over them: before a gap that it does not enter it ends with this
constexpr float kRoundingM = 1e-4F;
constexpr float kLongestM = 3.0F;      ///< of the path ahead: twice what stopping from full speed needs

}  // namespace

float Potential::value(const OccupancyGrid& grid, const CostField& field, const CellId id) const {
    if (id == kNoCell) { return kInfinity; }
    if (full_) {
        const Entry& e = ring_[at(grid.cell(id))];
        if (e.cell == grid.cell(id)) { return e.value; }
    }
    const std::uint32_t cost = field.cost(id);
    return cost == CostField::kFar ? kInfinity : kNatsPerUnit * static_cast<float>(cost);
}

void Potential::mark_stale_round(const Cell c) {
    for (std::int32_t dy = -1; dy <= 1; ++dy) {
        for (std::int32_t dx = -1; dx <= 1; ++dx) { ring_[at({c.ix + dx, c.iy + dy})].stale = true; }
    }
}

// Cells that come into the window start from the cost field; those that stay keep what they have. Where something changed, the
// cells round it are stale.
void Potential::refresh(const OccupancyGrid& grid, const Traversability& where, const CostField& field, const std::int32_t half) {
    const bool all = !full_ || meaning_ != where.meaning();
    meaning_ = where.meaning();
    for (std::int32_t iy = centre_.iy - half; iy <= centre_.iy + half; ++iy) {
        std::int32_t slot = -1;
        for (std::int32_t ix = centre_.ix - half; ix <= centre_.ix + half; ++ix) {
            const Cell c{ix, iy};
            if (ix == centre_.ix - half || (ix & (kTileCells - 1)) == 0) { slot = grid.tile_slot(ix >> 6, iy >> 6); }
            const CellId id = slot < 0 ? kNoCell : OccupancyGrid::id_in(slot, c);
            const auto byte = static_cast<std::uint8_t>(slot < 0 ? 0 : where.byte(id));
            Entry& e = ring_[at(c)];
            const bool known = full_ && e.cell == c;
            if (known && e.byte == byte && !all) { continue; }
            if (!known) {
                const std::uint32_t cost = field.cost(id);
                e = {c, cost == CostField::kFar ? kInfinity : kNatsPerUnit * static_cast<float>(cost), byte, true};
            }
            e.byte = byte;
            mark_stale_round(c);
        }
    }
    if (full_) { return; }
    constexpr std::int32_t kNowhere = std::numeric_limits<std::int32_t>::max();
    // Entries outside the window still name cells of the field before: give them a name that no lookup asks for.
    for (Entry& e : ring_) {
        if (e.cell.ix == kNowhere) { continue; }
        if (std::abs(e.cell.ix - centre_.ix) > half || std::abs(e.cell.iy - centre_.iy) > half) { e.cell = {kNowhere, 0}; }
    }
    full_ = true;
}

void Potential::relax(const OccupancyGrid& grid, const Traversability& where, const CostField& field, const float x_m,
                      const float y_m, const std::int32_t sweeps) {
    centre_ = grid.geometry().cell(x_m, y_m);
    const auto half = std::min<std::int32_t>(static_cast<std::int32_t>(grid.geometry().to_cells(p_.potential_window_m)), kWindow / 2 - 2);
    refresh(grid, where, field, half);
    for (std::int32_t sweep = 0; sweep < sweeps; ++sweep) {
        residual_ = 0.0F;
        backwards_ = !backwards_;
        for (std::int32_t a = -half + 1; a < half; ++a) {
            for (std::int32_t b = -half + 1; b < half; ++b) {
                const Cell c{centre_.ix + (backwards_ ? -b : b), centre_.iy + (backwards_ ? -a : a)};
                Entry& e = ring_[at(c)];
                if (!e.stale) { continue; }
                e.stale = false;
                if (!(e.value > 0.0F) || e.value == kInfinity) { continue; }  // the goal, or not reached
                if (!where.passable_byte(e.byte)) { continue; }
                const float slow = where.slowness_byte(e.byte);
                const float straight = kStraight * slow;
                const float diagonal = kDiagonal * slow;
                std::array<float, 8> through{};
                float best = kInfinity;
                for (std::size_t d = 0; d < 8; ++d) {
                    const Entry& n = ring_[at({c.ix + kNeighbourX[d], c.iy + kNeighbourY[d]})];
                    // Where the hull does not fit phi is zero: those neighbours add nothing.
                    const bool counts = where.passable_byte(n.byte) || n.value <= 0.0F;
                    through[d] = counts ? n.value + ((d & 1U) != 0 ? diagonal : straight) : kInfinity;
                    best = std::min(best, through[d]);
                }
                if (best == kInfinity) { continue; }
                float sum = 0.0F;
                for (const float t : through) {
                    if (t - best < kNegligible) { sum += std::exp(best - t); }
                }
                const float relaxed = best - std::log(sum);
                if (relaxed < e.value) {  // phi only rises: docs/maths/potential.md, "why there is always a way up"
                    residual_ = std::max(residual_, e.value - relaxed);
                    e.value = relaxed;
                    for (std::size_t d = 0; d < 8; ++d) { ring_[at({c.ix + kNeighbourX[d], c.iy + kNeighbourY[d]})].stale = true; }
                }
            }
        }
    }
}

bool Potential::trace(const OccupancyGrid& grid, const Traversability& where, const CostField& field, const float x_m, const float y_m,
                      const float goal_x_m, const float goal_y_m, Bounded<PathPoint, kMaxPathPoints>& path) {
    path.clear();
    is_cut_ = false;
    const GridGeometry& g = grid.geometry();
    CellId at_id = grid.find(x_m, y_m);
    float v = value(grid, field, at_id);
    if (v == kInfinity) {
        // The point stands where nothing leads from (pushed there, or the map changed): the nearest cell that does, within 0.5 m.
        const Cell here = g.cell(x_m, y_m);
        const auto reach = static_cast<std::int32_t>(g.to_cells(0.5F));
        float nearest = kInfinity;
        for (std::int32_t dy = -reach; dy <= reach; ++dy) {
            for (std::int32_t dx = -reach; dx <= reach; ++dx) {
                const CellId id = grid.find(Cell{here.ix + dx, here.iy + dy});
                const auto d2 = static_cast<float>(dx * dx + dy * dy);
                if (d2 >= nearest || !where.passable(id) || value(grid, field, id) == kInfinity) { continue; }
                nearest = d2;
                at_id = id;
            }
        }
        if (nearest == kInfinity) { return false; }
        v = value(grid, field, at_id);
    }
    static_cast<void>(path.push({x_m, y_m, 0.0F}));
    float length_m = 0.0F;
    bool at_goal = at_id == field.root();
    while (!at_goal && length_m < kLongestM && path.size() + 2U < path.capacity()) {
        float steepest = 0.0F;
        CellId next = kNoCell;
        std::int32_t toward = 0;
        for (std::int32_t d = 0; d < 8; ++d) {
            const CellId n = grid.neighbour(at_id, d);
            if (n == kNoCell || (!where.passable(n) && !where.tight(n))) { continue; }
            const float slope = (v - value(grid, field, n)) * ((d & 1) != 0 ? 0.70710678F : 1.0F);
            if (slope > steepest) {
                steepest = slope;
                next = n;
                toward = d;
            }
        }
        if (next == kNoCell) { break; }  // the map changed under the field: stop here, the next field knows
        at_id = next;
        v = value(grid, field, next);
        const Cell c = grid.cell(next);
        static_cast<void>(path.push({g.centre_x_m(c), g.centre_y_m(c), 0.0F}));
        length_m += g.cell_m() * ((toward & 1) != 0 ? 1.41421356F : 1.0F);
        at_goal = next == field.root();
    }
    if (at_goal) {
        if (path.size() > 1U) {
            path.back() = {goal_x_m, goal_y_m, 0.0F};
        } else {
            static_cast<void>(path.push({goal_x_m, goal_y_m, 0.0F}));
        }
    }
    smooth(grid, where, path);
    return true;
}

// No point of the line leaves a cell for one where something unknown lies under the hull: what the hits leave free there nobody has seen.
bool Potential::may_move(const OccupancyGrid& grid, const Traversability& where, const PathPoint& from, const float x_m, const float y_m) {
    const Cell to = grid.geometry().cell(x_m, y_m);
    const Cell at = grid.geometry().cell(from.x_m, from.y_m);
    return to == at || !where.over_unknown(grid.find(to)) || where.over_unknown(grid.find(at));
}

// Where it is narrow a point stands in the middle of each step, too: a throat may lie between two cells.
void Potential::refine(const OccupancyGrid& grid, const Traversability& where, std::array<float, kMaxPathPoints>& room_least_m, Bounded<PathPoint, kMaxPathPoints>& path) const {
    const float narrow_m = p_.hull_radius_m + kCentreM + kRoundingM;
    const Bounded<PathPoint, kMaxPathPoints> coarse = path;
    const std::array<float, kMaxPathPoints> coarse_m = room_least_m;
    path.clear();
    for (std::size_t k = 0; k < coarse.size(); ++k) {
        if (k > 0U && std::min(coarse_m[k - 1U], coarse_m[k]) <= narrow_m && path.size() + coarse.size() - k < path.capacity()) {
            const PathPoint middle{0.5F * (coarse[k - 1U].x_m + coarse[k].x_m), 0.5F * (coarse[k - 1U].y_m + coarse[k].y_m), 0.0F};
            if (may_move(grid, where, coarse[k - 1U], middle.x_m, middle.y_m)) {
                room_least_m[path.size()] = 0.0F;
                static_cast<void>(path.push(middle));
            }
        }
        room_least_m[path.size()] = coarse_m[k];
        static_cast<void>(path.push(coarse[k]));
    }
}

// Where it is narrow each point goes across the line to where there is most room: in a gap, to its middle.
void Potential::centre(const OccupancyGrid& grid, const Traversability& where, const std::array<float, kMaxPathPoints>& room_least_m,
                       Bounded<PathPoint, kMaxPathPoints>& path) const {
    const float narrow_m = p_.hull_radius_m + kCentreM;
    for (std::size_t k = 1; k + 1U < path.size(); ++k) {
        if (room_least_m[k] > narrow_m + kRoundingM) { continue; }
        PathPoint& p = path[k];
        float room_m = grid.clearance_m(p.x_m, p.y_m, narrow_m);
        if (room_m >= narrow_m) { continue; }
        const float dx = path[k + 1U].x_m - path[k - 1U].x_m;
        const float dy = path[k + 1U].y_m - path[k - 1U].y_m;
        const float length = std::hypot(dx, dy);
        if (length < 1e-3F) { continue; }
        for (const float step : kCentreSteps) {
            for (const float side : {step, -step}) {
                for (int times = 0; times < 3; ++times) {
                    const float to_x_m = p.x_m - side * dy / length;
                    const float to_y_m = p.y_m + side * dx / length;
                    const float there_m = grid.clearance_m(to_x_m, to_y_m, narrow_m);
                    if (!(there_m > room_m) || !may_move(grid, where, p, to_x_m, to_y_m)) { break; }
                    room_m = there_m;
                    p.x_m = to_x_m;
                    p.y_m = to_y_m;
                }
            }
        }
    }
}

// The hull slides straight on, growing as it may stray from that line: each step is as long as nothing at all can be nearer.
float Potential::way_m(const OccupancyGrid& grid, const PathPoint& from, const float ux, const float uy) const {
    const float least_m = least_held_m(p_);
    const float enough_m = kEnoughShare * stopping_m(p_, speed_at_clearance_m_s(p_, from.clearance_m)) + kEnoughM;
    float way_m = 0.0F;
    float clear_m = from.clearance_m;
    for (std::int32_t step = 0; step < kSlideSteps; ++step) {
        const float free_m = clear_m - least_m - kAstray * way_m;
        way_m += std::max(0.0F, free_m) / (1.0F + kAstray);
        if (way_m >= enough_m) { return PathPoint{}.way_m; }
        if (free_m < kSlideLeastM) { break; }
        clear_m = grid.clearance_m(from.x_m + way_m * ux, from.y_m + way_m * uy, kCapM);
    }
    return way_m;
}

// An elastic band: each inner point is drawn to the middle of its neighbours and pushed away from the nearest hit point.
void Potential::smooth(const OccupancyGrid& grid, const Traversability& where, Bounded<PathPoint, kMaxPathPoints>& path) {
    const float wanted_m = std::min(p_.comfort_clearance_m, p_.hull_radius_m + 0.25F);
    std::array<float, kMaxPathPoints> room_m{};   // what each point has at least: the last clearance looked up, less what it moved since
    const auto moved_m = [](const float dx, const float dy) { return std::fabs(dx) + std::fabs(dy); };
    for (std::int32_t round = 0; round < kSmoothRounds; ++round) {
        for (std::size_t k = 1; k + 1U < path.size(); ++k) {
            PathPoint& p = path[k];
            float x_m = p.x_m + 0.5F * (0.5F * (path[k - 1U].x_m + path[k + 1U].x_m) - p.x_m);
            float y_m = p.y_m + 0.5F * (0.5F * (path[k - 1U].y_m + path[k + 1U].y_m) - p.y_m);
            float hit_x = 0.0F;
            float hit_y = 0.0F;
            float clear_m = room_m[k] - moved_m(x_m - p.x_m, y_m - p.y_m);
            if (clear_m < wanted_m + kRoundingM) { clear_m = grid.clearance_m(x_m, y_m, wanted_m + kLookM, &hit_x, &hit_y); }
            room_m[k] = clear_m;
            if (clear_m < wanted_m && clear_m > 1e-3F) {
                const float push = (kSoftPush * (wanted_m - clear_m) + kHardPush * std::max(0.0F, p_.hull_radius_m + kRoomM - clear_m)) / clear_m;
                // Between two walls a push away from the one is a push towards the other: as much of it is done as gives more room.
                for (const float share : {1.0F, 0.4F, 0.15F}) {
                    const float to_x_m = x_m + share * push * (x_m - hit_x);
                    const float to_y_m = y_m + share * push * (y_m - hit_y);
                    if (!may_move(grid, where, p, to_x_m, to_y_m) || !(grid.clearance_m(to_x_m, to_y_m, wanted_m) > clear_m)) { continue; }
                    room_m[k] = clear_m - moved_m(to_x_m - x_m, to_y_m - y_m);
                    x_m = to_x_m;
                    y_m = to_y_m;
                    break;
                }
            }
            if (!may_move(grid, where, p, x_m, y_m)) {
                room_m[k] -= moved_m(x_m - p.x_m, y_m - p.y_m);
                continue;
            }
            p.x_m = x_m;
            p.y_m = y_m;
        }
    }
    refine(grid, where, room_m, path);
    centre(grid, where, room_m, path);
    for (std::size_t k = 0; k < path.size(); ++k) {
        PathPoint& p = path[k];
        p.clearance_m = grid.clearance_m(p.x_m, p.y_m, kCapM);
        if (k == 0U || !(std::min(path[k - 1U].clearance_m, p.clearance_m) < p_.hull_radius_m + kCentreM)) { continue; }
        p.clearance_m = std::min(p.clearance_m, grid.clearance_m(0.5F * (path[k - 1U].x_m + p.x_m), 0.5F * (path[k - 1U].y_m + p.y_m), kCapM));
    }
    float gone_m = 0.0F;
    float felt_m = kLongestM;   // what is farther ahead than this is not felt: from there the speed allowed before it can still be braked
    for (std::size_t k = 0; k + 1U < path.size(); ++k) {
        const PathPoint& before = path[k > 0U ? k - 1U : 0U];
        gone_m += std::hypot(path[k].x_m - before.x_m, path[k].y_m - before.y_m);
        if (gone_m > felt_m) { break; }
        felt_m = std::min(felt_m, gone_m + kFeltShare * braking_m(p_, path[k].clearance_m));
        const float dx = path[k + 1U].x_m - before.x_m;
        const float dy = path[k + 1U].y_m - before.y_m;
        const float length = std::hypot(dx, dy);
        if (length > 1e-3F) { path[k].way_m = way_m(grid, path[k], dx / length, dy / length); }
    }
    // What the band may have drawn too near to something is cut off: the reference stops before it.
    // A gap that is narrower than it may be is not entered, and not stood in either; one that the vehicle is in is left with less.
    const bool inside = path[0].clearance_m < p_.hull_radius_m + p_.plan_margin_m + kInsideM || where.at_last_resort();
    const float least_m = std::min(p_.hull_radius_m + p_.plan_margin_m - (inside ? kLeavesM : 0.0F), path[0].clearance_m);
    std::size_t keep = 1;
    while (keep < path.size() && path[keep].clearance_m >= least_m) { ++keep; }
    if (keep == path.size()) { return; }
    is_cut_ = true;
    cut_ = path[keep];
    while (keep > 1U && path[keep - 1U].clearance_m < p_.hull_radius_m + p_.plan_margin_m + kBeforeM) { --keep; }
    const Bounded<PathPoint, kMaxPathPoints> whole = path;
    path.clear();
    for (std::size_t k = 0; k < keep; ++k) { static_cast<void>(path.push(whole[k])); }
}

}  // namespace noctule
