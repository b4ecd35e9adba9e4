#include "plan/frontier.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace noctule {

namespace {

constexpr float kBeyondCells = 1.7F;      ///< within which a line of sight must meet the unknown behind a frontier cell
constexpr std::int32_t kSteepDeep = 2;
constexpr float kFarBeyondCells = 3.2F;   ///< the same where nothing else is left
constexpr float kSamePlaceM = 0.35F;      ///< tried places within this are one
constexpr float kFirstTryShare = 0.6F;    ///< each try in vain brings the next viewpoint nearer by this
constexpr float kCutsCells = 0.4F;        ///< a line of sight this near to a hit point is cut there
constexpr std::size_t kEdgeMembers = 6;   ///< cells of a group that are tried last of all, about
constexpr std::int32_t kTriesPerRound = 3;
constexpr float kFarM = 1000.0F;          ///< what a viewpoint beyond ViewRule::near_m costs

/// Class of the cell at a point, remembering the tile: rays stay in one for long.
class Reader {
public:
    explicit Reader(const OccupancyGrid& grid) : grid_(grid) {}
    CellId find(const float x_m, const float y_m) { return find(grid_.geometry().cell(x_m, y_m)); }
    CellId find(const Cell c) {
        if (!known_ || (c.ix >> 6) != tile_x_ || (c.iy >> 6) != tile_y_) {
            tile_x_ = c.ix >> 6;
            tile_y_ = c.iy >> 6;
            slot_ = grid_.tile_slot(tile_x_, tile_y_);
            known_ = true;
        }
        return slot_ < 0 ? kNoCell : slot_ * kTileArea + (c.iy & 63) * kTileCells + (c.ix & 63);
    }

private:
    const OccupancyGrid& grid_;
    bool known_ = false;
    std::int32_t tile_x_ = 0;
    std::int32_t tile_y_ = 0;
    std::int32_t slot_ = -1;
};

/// True: a place of the edge that is entered from a passable cell, not over a chain of its like.
bool beside_passable(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const CellId id) {
    const Cell c = grid.cell(id);
    const std::uint32_t cost = from.cost(id);
    const bool inside = (c.ix & 63) - 2 >= 0 && (c.ix & 63) + 2 < kTileCells && (c.iy & 63) - 2 >= 0 && (c.iy & 63) + 2 < kTileCells;   // of one tile
    for (std::int32_t dy = -2; dy <= 2; ++dy) {
        for (std::int32_t dx = -2; dx <= 2; ++dx) {
            const CellId n = inside ? id + dy * kTileCells + dx : grid.find(Cell{c.ix + dx, c.iy + dy});
            if (where.passable(n) && from.cost(n) < cost) { return true; }
        }
    }
    return false;
}

}  // namespace

void TriedPlaces::add(const float x_m, const float y_m, const float view_distance_m, const std::int64_t t_us) {
    const auto wait_us = [this](const std::int32_t tries) {
        const std::int32_t rounds = std::min<std::int32_t>(tries / kTriesPerRound, 6);
        return rounds < 1 ? std::int64_t{0} : static_cast<std::int64_t>(1e6F * p_.blacklist_s) << static_cast<unsigned>(rounds - 1);
    };
    for (Entry& e : entries_) {
        if (std::hypot(e.x_m - x_m, e.y_m - y_m) > kSamePlaceM) { continue; }
        ++e.tries;
        e.distance_m = std::min(e.distance_m, view_distance_m);
        e.until_us = t_us + (e.tries % kTriesPerRound == 0 ? wait_us(e.tries) : 0);
        return;
    }
    if (entries_.full()) {  // the one whose time is over first gives way
        std::size_t oldest = 0;
        for (std::size_t k = 1; k < entries_.size(); ++k) {
            if (entries_[k].until_us < entries_[oldest].until_us) { oldest = k; }
        }
        entries_.remove_unordered(oldest);
    }
    static_cast<void>(entries_.push({x_m, y_m, view_distance_m, 1, t_us}));
}

float TriedPlaces::distance_allowed_m(const float x_m, const float y_m, const std::int64_t t_us) const {
    for (const Entry& e : entries_) {
        if (std::hypot(e.x_m - x_m, e.y_m - y_m) > kSamePlaceM) { continue; }
        if (t_us < e.until_us) { return 0.0F; }
        // After a wait it gets one more look from as near as before.
        return e.tries % kTriesPerRound == 0 ? std::max(e.distance_m, 0.4F) : kFirstTryShare * e.distance_m;
    }
    return p_.view_range_m;
}

FrontierSearch::FrontierSearch(const Parameters& parameters) : p_(parameters) {
    for (std::int32_t k = 0; k < kRays; ++k) {
        const float angle = 2.0F * kPi * static_cast<float>(k) / static_cast<float>(kRays);
        ray_x_[static_cast<std::size_t>(k)] = std::cos(angle);
        ray_y_[static_cast<std::size_t>(k)] = std::sin(angle);
    }
}

std::int32_t TriedPlaces::tries(const float x_m, const float y_m) const {
    for (const Entry& e : entries_) {
        if (std::hypot(e.x_m - x_m, e.y_m - y_m) <= kSamePlaceM) { return e.tries; }
    }
    return 0;
}

void FrontierSearch::start() {
    cells_.clear();
    found_.clear();
    for (auto& tile : marks_) { tile.fill(0); }
    tile_ = 0;
    next_cell_ = 0;
    slivers_ = 0;
}

bool FrontierSearch::is_frontier(const OccupancyGrid& grid, const CellId id) {
    if (grid.cell_class(id) != CellClass::free) { return false; }
    for (std::int32_t d = 0; d < 8; d += 2) {
        if (grid.cell_class(grid.neighbour(id, d)) == CellClass::unknown) { return true; }
    }
    return false;
}

void FrontierSearch::scan_tile(const OccupancyGrid& grid, const std::int32_t slot) {
    if (!grid.on_floor(slot)) { return; }
    const Fence fence{p_};
    // Rows of bits, a bit a cell: free cells with an unknown one over, under, left or right of them.
    std::array<std::uint64_t, kTileCells> free_cells{};
    std::array<std::uint64_t, kTileCells> unknown{};
    for (std::int32_t j = 0; j < kTileCells; ++j) {
        for (std::int32_t i = 0; i < kTileCells; i += 8) {
            const ClassBits bits = grid.classes_of_eight(OccupancyGrid::id_in(slot, {i, j}));
            free_cells[static_cast<std::size_t>(j)] |= std::uint64_t{bits.free} << static_cast<unsigned>(i);
            unknown[static_cast<std::size_t>(j)] |= std::uint64_t{bits.unknown()} << static_cast<unsigned>(i);
        }
    }
    constexpr std::uint64_t kRim = std::uint64_t{1} | std::uint64_t{1} << 63U;   // their neighbours lie in other tiles
    for (std::size_t j = 0; j < kTileCells; ++j) {
        const bool rim_row = j == 0U || j == kTileCells - 1U;
        const std::uint64_t beside = rim_row ? ~std::uint64_t{0} : unknown[j - 1U] | unknown[j + 1U] | unknown[j] << 1U | unknown[j] >> 1U | kRim;
        for (std::uint64_t left = free_cells[j] & beside; left != 0U; left &= left - 1U) {
            const std::int32_t i = std::countr_zero(left);
            const CellId id = OccupancyGrid::id_in(slot, {i, static_cast<std::int32_t>(j)});
            if ((rim_row || (kRim >> static_cast<unsigned>(i) & 1U) != 0U) && !is_frontier(grid, id)) { continue; }
            const Cell c = grid.cell(id);
            if (fence.depth_m(grid.geometry().centre_x_m(c), grid.geometry().centre_y_m(c)) < 0.0F) { continue; }
            if (!cells_.push(id)) { return; }
            mark(id, true);
        }
    }
}

// Cells that hang together with the seed and lie within kGroupRadius of it.
void FrontierSearch::gather(const OccupancyGrid& grid, const CellId seed) {
    group_.clear();
    static_cast<void>(group_.push(seed));
    mark(seed, false);
    const Cell s = grid.cell(seed);
    for (std::size_t k = 0; k < group_.size(); ++k) {
        for (std::int32_t d = 0; d < 8; ++d) {
            const CellId n = grid.neighbour(group_[k], d);
            if (n == kNoCell || !marked(n)) { continue; }
            const Cell c = grid.cell(n);
            if (std::abs(c.ix - s.ix) > kGroupRadius || std::abs(c.iy - s.iy) > kGroupRadius) { continue; }
            if (!group_.push(n)) { return; }
            mark(n, false);
        }
    }
}

// Unknown cells that hang together across edges with those beside the group.
std::int32_t FrontierSearch::unknown_behind(const OccupancyGrid& grid) const {
    constexpr std::int32_t kSide = 2 * kBehindCells + 1;
    std::array<bool, static_cast<std::size_t>(kSide * kSide)> taken{};
    std::array<std::int16_t, static_cast<std::size_t>(kSide * kSide)> queue{};
    std::size_t size = 0;
    const Cell middle = grid.cell(group_[group_.size() / 2U]);
    Reader reader{grid};
    const auto offer = [&](const std::int32_t x, const std::int32_t y) {
        if (x < 0 || y < 0 || x >= kSide || y >= kSide) { return; }
        const auto at = static_cast<std::size_t>(y * kSide + x);
        if (taken[at]) { return; }
        if (grid.cell_class(reader.find(Cell{middle.ix + x - kBehindCells, middle.iy + y - kBehindCells})) != CellClass::unknown) { return; }
        taken[at] = true;
        queue[size++] = static_cast<std::int16_t>(at);
    };
    const auto spread = [&](const std::int32_t x, const std::int32_t y) {
        for (std::int32_t d = 0; d < 8; d += 2) { offer(x + kNeighbourX[d], y + kNeighbourY[d]); }
    };
    for (const CellId id : group_) {
        const Cell c = grid.cell(id);
        spread(c.ix - middle.ix + kBehindCells, c.iy - middle.iy + kBehindCells);
    }
    for (std::size_t k = 0; k < size; ++k) { spread(queue[k] % kSide, queue[k] / kSide); }
    return static_cast<std::int32_t>(size);
}

// Rays from the frontier cell through free cells find the places that see it.
bool FrontierSearch::view(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const ViewRule& rule,
                          const float distance_m, const CellId look, Frontier& best, const float home_x_m, const float home_y_m, const Round round,
                          const std::int32_t tries) const {
    const GridGeometry& g = grid.geometry();
    const Cell c = grid.cell(look);
    const float x_m = g.centre_x_m(c);
    const float y_m = g.centre_y_m(c);
    const float step_m = g.cell_m();
    const float beyond = tries > 0 || round == Round::edge ? kFarBeyondCells : kBeyondCells;
    Reader reader{grid};
    const float near_m = reveals_m2(p_, best) < rule.small_m2 ? rule.near_small_m : rule.near_m;
    const auto score_of = [&](const CellId id, const std::uint32_t cost, const float away_m) {
        return static_cast<float>(cost) / static_cast<float>(CostField::kUnit) * step_m + rule.distance_cost * away_m +
               rule.tight_cost * (where.slowness(id) - 1.0F) + (near_m > 0.0F && away_m > near_m ? kFarM : 0.0F);
    };
    float best_score = best.view == kNoCell ? 1e9F : score_of(best.view, best.cost, std::hypot(best.view_x_m - best.x_m, best.view_y_m - best.y_m));
    bool found = false;
    float turn_x = 1.0F;   // by which the lines are turned
    float turn_y = 0.0F;
    for (std::int32_t n = 0; n < (rule.fine ? kFineParts : 1) * kRays; ++n) {
        const auto k = static_cast<std::size_t>(n % kRays);
        if (k == 0U && n > 0) {
            const float turn = 2.0F * kPi * static_cast<float>(n / kRays) / static_cast<float>(kFineParts * kRays);
            turn_x = std::cos(turn);
            turn_y = std::sin(turn);
        }
        const float ux = ray_x_[k] * turn_x - ray_y_[k] * turn_y;
        const float uy = ray_x_[k] * turn_y + ray_y_[k] * turn_x;
        bool looked = false;
        bool into_unknown = false;
        std::int32_t deep = 0;   // half cells of unknown in a row behind the frontier cell
        const float reach_m = rule.fine ? p_.grid_range_max_m : tries > 0 ? std::max(distance_m, p_.view_range_m) : distance_m;
        for (float r = 0.0F; r <= reach_m; r += step_m) {
            const CellId id = reader.find(x_m + r * ux, y_m + r * uy);
            const CellClass kind = grid.cell_class(id);
            if (kind == CellClass::occupied) {
                if (round == Round::clear) { break; }
                // A corner fills a part of its cell only: the line is cut where it passes near the hit point itself.
                float hx = 0.0F;
                float hy = 0.0F;
                grid.hit_point(id, hx, hy);
                if (std::fabs((hx - x_m) * uy - (hy - y_m) * ux) < kCutsCells * step_m) { break; }
                continue;
            }
            if (kind == CellClass::unknown) { break; }
            if (!where.passable(id) && (round != Round::edge || !where.at_edge(id))) { continue; }
            const std::uint32_t cost = from.cost(id);
            if (cost == CostField::kFar) { continue; }
            const float score = score_of(id, cost, r);
            const bool sights = r <= rule.sight_m && cost < best.sight_cost;
            if (score >= best_score && !sights) { continue; }
            if (round == Round::edge && !where.passable(id) && !beside_passable(grid, where, from, id)) { continue; }
            const Cell v = grid.cell(id);
            if (std::hypot(g.centre_x_m(v) - x_m, g.centre_y_m(v) - y_m) > reach_m) { continue; }
            if (std::hypot(g.centre_x_m(v) - home_x_m, g.centre_y_m(v) - home_y_m) > p_.fence_radius_m - 0.5F) { continue; }
            // From there the laser must look into the unknown, not along its edge: the line goes on into something unknown at once.
            if (!looked) {
                looked = true;
                for (float behind = 0.7F; behind <= beyond; behind += 0.5F) {
                    const CellClass there = grid.cell_class(reader.find(x_m - behind * step_m * ux, y_m - behind * step_m * uy));
                    if (there == CellClass::occupied || (into_unknown && there != CellClass::unknown)) { break; }
                    if (there == CellClass::unknown) {
                        into_unknown = true;
                        ++deep;
                    }
                }
            }
            if (!into_unknown) { break; }
            // What was looked at in vain is looked at from nearer, or more steeply.
            if (tries > 0 && r > distance_m && deep < kSteepDeep + tries) { break; }
            if (sights) {
                best.sight = id;
                best.sight_x_m = g.centre_x_m(v);
                best.sight_y_m = g.centre_y_m(v);
                best.sight_cost = cost;
                if (score >= best_score) { continue; }
            }
            best_score = score;
            best.look = look;
            best.x_m = x_m;
            best.y_m = y_m;
            best.view = id;
            best.view_x_m = g.centre_x_m(v);
            best.view_y_m = g.centre_y_m(v);
            best.cost = cost;
            found = true;
        }
    }
    return found;
}

void FrontierSearch::keep(const Frontier& f) {
    if (found_.push(f)) { return; }
    std::size_t smallest = 0;
    for (std::size_t k = 1; k < found_.size(); ++k) {
        if (found_[k].cells < found_[smallest].cells) { smallest = k; }
    }
    if (found_[smallest].cells < f.cells) { found_[smallest] = f; }
}

bool FrontierSearch::run(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried,
                         const ViewRule& rule, const float home_x_m, const float home_y_m, const std::int64_t t_us) {
    if (tile_ < grid.tile_count()) {
        for (std::int32_t k = 0; k < kTilesPerSlice && tile_ < grid.tile_count(); ++k) { scan_tile(grid, tile_++); }
        if (tile_ < grid.tile_count()) { return false; }
    }
    for (std::int32_t groups = 0; next_cell_ < cells_.size(); ++next_cell_) {
        const CellId seed = cells_[next_cell_];
        if (!marked(seed)) { continue; }
        if (groups >= kGroupsPerSlice) { return false; }
        gather(grid, seed);
        if (static_cast<std::int32_t>(group_.size()) < p_.frontier_min_cells) { continue; }
        Frontier f;
        f.behind = unknown_behind(grid);
        if (f.behind < rule.behind_min) { continue; }
        groups += rule.fine ? kFineGroups : 1;
        f.cells = static_cast<std::int32_t>(group_.size());
        bool waits = false;
        const std::size_t count = group_.size();
        // The middle of the group first, then its ends; what no such line shows is looked at past corners, then by any of its cells and
        // from places at the very edge of the unknown: a bend of a narrow passage may offer no other.
        for (const Round round : {Round::clear, Round::past_corners, Round::edge}) {
            if (f.view != kNoCell || waits) { break; }
            const std::size_t step = round == Round::edge ? std::max<std::size_t>(1U, count / kEdgeMembers) : std::max<std::size_t>(1U, count / 2U);
            if (round == Round::edge) { ++groups; }
            for (std::size_t k = 0; k < count + step; k += step) {
                const CellId member = group_[std::min(k, count - 1U)];
                const Cell c = grid.cell(member);
                const float f_x_m = grid.geometry().centre_x_m(c);
                const float f_y_m = grid.geometry().centre_y_m(c);
                const float distance_m = tried.distance_allowed_m(f_x_m, f_y_m, t_us);
                if (!(distance_m > 0.0F)) {
                    waits = true;
                    continue;
                }
                static_cast<void>(view(grid, where, from, rule, distance_m, member, f, home_x_m, home_y_m, round, tried.tries(f_x_m, f_y_m)));
            }
        }
        if (f.view != kNoCell) {
            if (f.sight == kNoCell || f.sight_cost > f.cost) { f.sight_as_view(); }
            keep(f);
        } else if (!waits) {
            ++slivers_;
        }
    }
    return true;
}

}  // namespace noctule
