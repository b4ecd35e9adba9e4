#include "plan/traversability.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "core/integer.hpp"
#include "plan/target.hpp"

namespace noctule {

namespace {

constexpr std::int32_t kNearTiles = 1;        ///< tiles round the vehicle looked at in every step
constexpr std::int32_t kFarTilesPerStep = 8;  ///< others, in turn
constexpr std::int32_t kSide = 3 * kBlockCells;
constexpr float kClosedM = 0.2F;              ///< radius of a closed place
constexpr float kLenientM = 0.005F;           ///< over hull and margin: a place that was closed opens, where one look is enough
constexpr std::int64_t kLastResortUs = 60000000;
constexpr std::int64_t kLenientEveryUs = 60000000;   ///< but now and then one look is enough: what was measured too narrow is not lost
constexpr std::int64_t kLenientUs = 4000000;
constexpr std::int64_t kAskedAgainUs = 1000000;      ///< while there is no way it is asked for at every step
constexpr float kStepsCells[] = {0.4F, 0.2F, 0.1F};   ///< in which the roomiest point of a cell is looked for
constexpr float kStairsApartM = 0.2F;
constexpr float kBlockM = 1.2F;                ///< across a block, and more
// An unknown cell is under the hull within 2.5 cells (0.25 m at 0.10 m) of it: half the cells of a row that this circle covers, by rows from its middle.
constexpr std::size_t kUnderHull[] = {2, 2, 1};
// One without a hit in the eight cells round it may hide a wall anywhere: 4 cells, so that 5 cm are left beside the hull wherever in the cell the wall stands.
constexpr std::size_t kUnderHullUnseen[] = {4, 3, 3, 2, 0};

constexpr float kCapM = 0.01F * static_cast<float>(Traversability::kCapCm);

using Row = std::array<float, kBlockCells>;
using Rows = std::array<std::uint32_t, kSide>;   ///< a bit a cell

std::uint32_t with_sides(const std::uint32_t row) { return row | row << 1U | row >> 1U; }

// Bit kBlockCells + i of row j: something set lies within the circle round that cell. Only for the middle block.
template <std::size_t N>
void spread(const Rows& cells, const std::size_t (&half_widths)[N], Rows& out) {
    for (std::size_t from = 0; from < kSide; ++from) {
        if (cells[from] == 0U) { continue; }
        std::array<std::uint32_t, 5> wide{cells[from]};
        for (std::size_t k = 1; k < wide.size(); ++k) { wide[k] = with_sides(wide[k - 1U]); }
        for (std::size_t dy = 0; dy < N; ++dy) {
            if (from >= dy) { out[from - dy] |= wide[half_widths[dy]]; }
            if (from + dy < kSide) { out[from + dy] |= wide[half_widths[dy]]; }
        }
    }
}

// Squared distance of a hit from the rectangle that the middles of a block's cells span.
float away_m2(const float x_m, const float y_m, const Row& middle_x_m, const Row& middle_y_m) {
    const auto outside = [](const float at, const Row& middle) { return std::max({middle.front() - at, at - middle.back(), 0.0F}); };
    const float away_x_m = outside(x_m, middle_x_m);
    const float away_y_m = outside(y_m, middle_y_m);
    return away_x_m * away_x_m + away_y_m * away_y_m;
}

// Takes a hit into account in the squared distances of the cells of a block, whose middles are given; the greatest of them is the cap. It counts as nearer by
// wider_m.
void near(const float x_m, const float y_m, const float wider_m, const Row& middle_x_m, const Row& middle_y_m, std::array<Row, kBlockCells>& nearest_m2) {
    Row x2_m2{};
    for (std::size_t i = 0; i < kBlockCells; ++i) { x2_m2[i] = (x_m - middle_x_m[i]) * (x_m - middle_x_m[i]); }
    for (std::size_t j = 0; j < kBlockCells; ++j) {
        const float y2_m2 = (y_m - middle_y_m[j]) * (y_m - middle_y_m[j]);
        Row& row = nearest_m2[j];
        if (wider_m > 0.0F) {
            for (std::size_t i = 0; i < kBlockCells; ++i) {
                const float d_m = std::max(std::sqrt(x2_m2[i] + y2_m2) - wider_m, 0.0F);
                row[i] = std::min(row[i], d_m * d_m);
            }
        } else {
            for (std::size_t i = 0; i < kBlockCells; ++i) { row[i] = std::min(row[i], x2_m2[i] + y2_m2); }
        }
    }
}

}  // namespace

Traversability::Traversability(const Parameters& parameters) : p_(parameters), fence_(parameters) { load_parameters(); }

void Traversability::reset() {
    for (auto& tile : value_) { tile.fill(0); }
    for (auto& tile : seen_) { tile.fill(0); }
    waiting_.fill(0);
    stairs_.clear();
    queue_head_ = queue_size_ = 0;
    next_tile_ = 0;
    slack_m_ = kClosesM;
    closed_.clear();
}

void Traversability::close(const float x_m, const float y_m, const std::int64_t until_us) {
    if (closed_.full()) { closed_.clear(); }
    static_cast<void>(closed_.push({x_m, y_m, until_us}));
    mark_all_stale();
}

void Traversability::add_stairs(const std::int32_t floor, const float x_m, const float y_m) {
    if (stairs_near(stairs_, floor, x_m, y_m, kStairsApartM) != nullptr) { return; }
    if (stairs_.full()) { stairs_.drop_front(1); }
    static_cast<void>(stairs_.push({x_m, y_m, floor}));
    mark_all_stale();
}

void Traversability::reopen_last() {
    if (closed_.empty()) { return; }
    std::size_t last = 0;
    for (std::size_t k = 1; k < closed_.size(); ++k) {
        if (closed_[k].until_us >= closed_[last].until_us) { last = k; }
    }
    closed_.remove_unordered(last);
    mark_all_stale();
}

void Traversability::reopen_all() {
    if (closed_.empty() && now_us_ + kLenientUs < lenient_until_us_ + kAskedAgainUs) { return; }
    lenient_until_us_ = now_us_ + kLenientUs;
    closed_.clear();
    mark_all_stale();
}

void Traversability::last_resort() {
    reopen_all();
    last_resort_until_us_ = now_us_ + kLastResortUs;
    if (!at_last_resort()) { mark_all_stale(); }
    slack_m_ = kLastResortM;
}

void Traversability::reopen(const std::int64_t t_us) {
    if (t_us / kLenientEveryUs != now_us_ / kLenientEveryUs) {
        lenient_until_us_ = t_us + kLenientUs;
        mark_all_stale();
    }
    now_us_ = t_us;
    lenient_ = t_us < lenient_until_us_;
    if (at_last_resort() && t_us >= last_resort_until_us_) {
        slack_m_ = kClosesM;
        mark_all_stale();
    }
    for (std::size_t k = closed_.size(); k-- > 0;) {
        if (closed_[k].until_us >= t_us) { continue; }
        closed_.remove_unordered(k);
        mark_all_stale();
    }
}

// Only the number that was taken up is changed: the blocks are found stale in turn, those near the vehicle first.
void Traversability::mark_all_stale() {
    for (auto& tile : seen_) {
        for (std::uint16_t& version : tile) { --version; }
    }
}

void Traversability::load_parameters() {
    if (const Fence fence{p_}; !(fence == fence_)) {
        fence_ = fence;
        mark_all_stale();
    }
    const std::int32_t need_cm = std::clamp<std::int32_t>(round_int(100.0F * (p_.hull_radius_m + p_.plan_margin_m)), 1, kCapCm);
    bool changed = need_cm != need_cm_;
    need_cm_ = need_cm;
    for (std::int32_t k = 0; k <= kCapCm; ++k) {
        float& kept = slowness_[static_cast<std::size_t>(k)];
        float slow = p_.speed_max_m_s / speed_at_clearance_m_s(p_, 0.01F * static_cast<float>(k));
        if (keeps_off_ && k < round_int(100.0F * (p_.hull_radius_m + kTreadM))) { slow = std::max(slow, std::min(kOffFactor * slow, kOffMost)); }
        changed = changed || slow != kept;
        kept = slow;
    }
    meaning_ += changed ? 1U : 0U;
}

void Traversability::enqueue(const std::int32_t block) {
    const auto slot = static_cast<std::size_t>(block >> 6);
    const std::uint64_t bit = std::uint64_t{1} << static_cast<unsigned>(block & 63);
    if ((waiting_[slot] & bit) != 0U || queue_size_ == kMaxDirtyBlocks) { return; }
    waiting_[slot] |= bit;
    queue_[(queue_head_ + queue_size_) % kMaxDirtyBlocks] = block;
    ++queue_size_;
}

// A change in a block makes the distances of the eight blocks round it stale, too: a block is as wide as the cap.
void Traversability::look_for_changes(const OccupancyGrid& grid, const std::int32_t slot) {
    const GridTile& tile = grid.tile(slot);
    auto& seen = seen_[static_cast<std::size_t>(slot)];
    for (std::int32_t b = 0; b < kTileBlocks; ++b) {
        const auto k = static_cast<std::size_t>(b);
        if (seen[k] == tile.version[k]) { continue; }
        seen[k] = tile.version[k];
        for (std::int32_t dy = -1; dy <= 1; ++dy) {
            for (std::int32_t dx = -1; dx <= 1; ++dx) {
                const std::int32_t bx = (b & 7) + dx;
                const std::int32_t by = (b >> 3) + dy;
                std::int32_t at = slot;
                if (((bx | by) & ~7) != 0) {
                    at = grid.tile_slot(tile.tile_x + (bx < 0 ? -1 : bx >> 3), tile.tile_y + (by < 0 ? -1 : by >> 3));
                    if (at < 0) { continue; }
                }
                enqueue(at * kTileBlocks + (by & 7) * 8 + (bx & 7));
            }
        }
    }
}

void Traversability::update(const OccupancyGrid& grid, const float x_m, const float y_m) {
    load_parameters();
    const Cell here = grid.geometry().cell(x_m, y_m);
    for (std::int32_t dy = -kNearTiles; dy <= kNearTiles; ++dy) {
        for (std::int32_t dx = -kNearTiles; dx <= kNearTiles; ++dx) {
            const std::int32_t slot = grid.tile_slot((here.ix >> 6) + dx, (here.iy >> 6) + dy);
            if (slot >= 0) { look_for_changes(grid, slot); }
        }
    }
    const std::int32_t tiles = grid.tile_count();
    for (std::int32_t k = 0; k < std::min(kFarTilesPerStep, tiles); ++k) {
        next_tile_ = (next_tile_ + 1) % tiles;
        if (grid.on_floor(next_tile_)) { look_for_changes(grid, next_tile_); }
    }
    // Blocks round the vehicle jump the queue.
    std::int32_t budget = kBlocksPerStep;
    for (std::int32_t dy = -3; dy <= 3; ++dy) {
        for (std::int32_t dx = -3; dx <= 3; ++dx) {
            const std::int32_t cx = here.ix + dx * kBlockCells;
            const std::int32_t cy = here.iy + dy * kBlockCells;
            const std::int32_t slot = grid.tile_slot(cx >> 6, cy >> 6);
            if (slot < 0) { continue; }
            const std::int32_t block = ((cy >> 3) & 7) * 8 + ((cx >> 3) & 7);
            std::uint64_t& waiting = waiting_[static_cast<std::size_t>(slot)];
            const std::uint64_t bit = std::uint64_t{1} << static_cast<unsigned>(block);
            if ((waiting & bit) == 0U) { continue; }
            waiting &= ~bit;  // its entry in the queue is skipped when its turn comes
            compute(grid, slot * kTileBlocks + block);
            --budget;
        }
    }
    while (budget > 0 && queue_size_ > 0U) {
        const std::int32_t block = queue_[queue_head_];
        queue_head_ = (queue_head_ + 1U) % kMaxDirtyBlocks;
        --queue_size_;
        std::uint64_t& waiting = waiting_[static_cast<std::size_t>(block >> 6)];
        const std::uint64_t bit = std::uint64_t{1} << static_cast<unsigned>(block & 63);
        if ((waiting & bit) == 0U) { continue; }
        waiting &= ~bit;
        if (!grid.on_floor(block >> 6)) {  // another floor is active now: taken up again when this one is
            --seen_[static_cast<std::size_t>(block >> 6)][static_cast<std::size_t>(block & 63)];
            continue;
        }
        compute(grid, block);
        --budget;
    }
}

void Traversability::make_room(const OccupancyGrid& grid, float& x_m, float& y_m) const {
    if (!passable(grid.find(x_m, y_m)) || grid.clearance_m(x_m, y_m, kCapM) >= 0.01F * static_cast<float>(need_cm_)) { return; }
    const Cell cell = grid.geometry().cell(x_m, y_m);
    x_m = grid.geometry().centre_x_m(cell);
    y_m = grid.geometry().centre_y_m(cell);
    roomiest_m(grid, nullptr, x_m, y_m, grid.clearance_m(x_m, y_m, kCapM));
}

// A gap's middle seldom lies on a cell's centre: where the hull just does not fit there, the roomiest point of the cell counts. The hits round it, if they
// are at hand. (x_m, y_m) becomes that point.
float Traversability::roomiest_m(const OccupancyGrid& grid, const Hits* const hits, float& x_m, float& y_m, const float centre_m) const {
    const float need_m = 0.01F * static_cast<float>(need_cm_);
    const float cell_m = grid.geometry().cell_m();
    if (centre_m >= need_m || centre_m <= need_m - cell_m) { return centre_m; }
    // As OccupancyGrid::clearance_m, from the hits at hand; of two equally far the first counts there, too.
    const auto clearance_m = [&](const float from_x_m, const float from_y_m, const float radius_m, float& hit_x_m, float& hit_y_m) {
        if (hits == nullptr || hits->full()) { return grid.clearance_m(from_x_m, from_y_m, radius_m, &hit_x_m, &hit_y_m); }
        float best_m2 = radius_m * radius_m;
        for (const Point2<Map>& hit : *hits) {
            const float d_m2 = (hit.x_m - from_x_m) * (hit.x_m - from_x_m) + (hit.y_m - from_y_m) * (hit.y_m - from_y_m);
            if (!(d_m2 < best_m2)) { continue; }
            best_m2 = d_m2;
            hit_x_m = hit.x_m;
            hit_y_m = hit.y_m;
        }
        return std::sqrt(best_m2);
    };
    float at_x_m = x_m;
    float at_y_m = y_m;
    float hit_x_m = x_m;
    float hit_y_m = y_m;
    float room_m = clearance_m(x_m, y_m, need_m, hit_x_m, hit_y_m);
    for (const float step : kStepsCells) {
        const float away = step * cell_m / std::max(room_m, cell_m);
        const float to_x_m = std::clamp(at_x_m + away * (at_x_m - hit_x_m), x_m - 0.5F * cell_m, x_m + 0.5F * cell_m);
        const float to_y_m = std::clamp(at_y_m + away * (at_y_m - hit_y_m), y_m - 0.5F * cell_m, y_m + 0.5F * cell_m);
        float there_x_m = hit_x_m;
        float there_y_m = hit_y_m;
        const float there_m = clearance_m(to_x_m, to_y_m, need_m + cell_m, there_x_m, there_y_m);
        if (!(there_m > room_m)) { continue; }
        room_m = there_m;
        at_x_m = to_x_m;
        at_y_m = to_y_m;
        hit_x_m = there_x_m;
        hit_y_m = there_y_m;
    }
    x_m = at_x_m;
    y_m = at_y_m;
    return std::max(centre_m, room_m);
}

void Traversability::compute(const OccupancyGrid& grid, const std::int32_t block) {
    ++blocks_done_;
    const std::int32_t slot = block >> 6;
    const GridTile& tile = grid.tile(slot);
    const std::int32_t x0 = tile.tile_x * kTileCells + (block & 7) * kBlockCells;       // first cell of the block
    const std::int32_t y0 = tile.tile_y * kTileCells + ((block >> 3) & 7) * kBlockCells;
    Row middle_x_m{};   // of its columns and rows
    Row middle_y_m{};
    for (std::int32_t k = 0; k < kBlockCells; ++k) {
        middle_x_m[static_cast<std::size_t>(k)] = grid.geometry().centre_x_m({x0 + k, 0});
        middle_y_m[static_cast<std::size_t>(k)] = grid.geometry().centre_y_m({0, y0 + k});
    }
    // Squared distance to the nearest hit, up to the cap, of the cells of the block; unknown cells of the 24 x 24 round it, a bit each.
    std::array<Row, kBlockCells> nearest_m2{};
    for (Row& row : nearest_m2) { row.fill(kCapM * kCapM); }
    Rows unknown{};
    Rows occupied{};
    std::array<std::uint32_t, kBlockCells> free_cells{};
    const bool stairs = stairs_near(stairs_, tile.floor, middle_x_m[kBlockCells / 2], middle_y_m[kBlockCells / 2], kStairsReachM + kCapM + kTreadM + kBlockM) != nullptr;
    const float roomiest_reach_m = 0.01F * static_cast<float>(need_cm_) + 2.0F * grid.geometry().cell_m();   // from the cells' middles
    Hits hits;   // within that, in rows from below
    bool any_unknown = false;
    for (std::int32_t by = -1; by <= 1; ++by) {
        std::array<std::int32_t, 3> slots{};
        for (std::int32_t bx = 0; bx < 3; ++bx) {
            slots[static_cast<std::size_t>(bx)] = grid.tile_slot((x0 + (bx - 1) * kBlockCells) >> 6, (y0 + by * kBlockCells) >> 6);
        }
        for (std::int32_t j = 0; j < kBlockCells; ++j) {
            for (std::int32_t bx = -1; bx <= 1; ++bx) {
                const std::int32_t s = slots[static_cast<std::size_t>(bx + 1)];
                const CellId id = s < 0 ? kNoCell : OccupancyGrid::id_in(s, {x0 + bx * kBlockCells, y0 + by * kBlockCells + j});
                const ClassBits bits = s < 0 ? ClassBits{} : grid.classes_of_eight(id);
                unknown[static_cast<std::size_t>((by + 1) * kBlockCells + j)] |= bits.unknown() << static_cast<unsigned>((bx + 1) * kBlockCells);
                occupied[static_cast<std::size_t>((by + 1) * kBlockCells + j)] |= bits.occupied << static_cast<unsigned>((bx + 1) * kBlockCells);
                any_unknown = any_unknown || bits.unknown() != 0U;
                if (bx == 0 && by == 0) { free_cells[static_cast<std::size_t>(j)] = bits.free; }
                for (std::uint32_t left = bits.occupied; left != 0U; left &= left - 1U) {
                    float x_m = 0.0F;
                    float y_m = 0.0F;
                    grid.hit_point(id + std::countr_zero(left), x_m, y_m);
                    const float wider_m = stairs && stairs_near(stairs_, tile.floor, x_m, y_m, kStairsReachM) != nullptr ? kTreadM : 0.0F;
                    const float away2_m2 = away_m2(x_m, y_m, middle_x_m, middle_y_m);
                    if (away2_m2 >= (kCapM + wider_m) * (kCapM + wider_m)) { continue; }
                    near(x_m, y_m, wider_m, middle_x_m, middle_y_m, nearest_m2);
                    if (away2_m2 < roomiest_reach_m * roomiest_reach_m) { static_cast<void>(hits.push({x_m, y_m})); }
                }
            }
        }
    }
    Rows under{};   // something unknown lies under the hull there
    if (any_unknown) {
        Rows unseen{};   // unknown, and no hit beside it tells where the wall is
        for (std::size_t j = 1; j + 1U < kSide; ++j) { unseen[j] = unknown[j] & ~with_sides(occupied[j - 1U] | occupied[j] | occupied[j + 1U]); }
        spread(unknown, kUnderHull, under);
        spread(unseen, kUnderHullUnseen, under);
    }
    auto& values = value_[static_cast<std::size_t>(slot)];
    const float need_m = 0.01F * static_cast<float>(need_cm_);
    for (std::int32_t j = 0; j < kBlockCells; ++j) {
        for (std::int32_t i = 0; i < kBlockCells; ++i) {
            const auto ki = static_cast<std::size_t>(i);
            const auto kj = static_cast<std::size_t>(j);
            std::uint8_t result = 0;
            if ((free_cells[kj] >> ki & 1U) != 0U && fence_.depth_m(middle_x_m[ki], middle_y_m[kj]) >= kFenceInsetM) {
                const float centre_m = std::sqrt(nearest_m2[kj][ki]);
                float at_x_m = middle_x_m[ki];
                float at_y_m = middle_y_m[kj];
                const float room_m = stairs ? centre_m : roomiest_m(grid, &hits, at_x_m, at_y_m, centre_m);
                result = static_cast<std::uint8_t>(std::clamp<std::int32_t>(static_cast<std::int32_t>(std::lround(100.0F * room_m)), 1, kCapCm));
                // A gap that opens and closes with the noise of hits draws the vehicle to and fro: what was found closed opens with more room only.
                const std::int32_t before_cm = values[static_cast<std::size_t>(((y0 + j) & 63) * kTileCells + ((x0 + i) & 63))] & 0x7F;
                const bool was_closed = before_cm > 0 && before_cm < need_cm_;
                const float more_m = at_last_resort() || before_cm >= need_cm_ ? -slack_m_ : !was_closed ? 0.0F : lenient_ ? std::min(kLenientM, p_.plan_reopen_m) : p_.plan_reopen_m;
                if (room_m >= need_m + more_m) {
                    result = std::max(result, static_cast<std::uint8_t>(need_cm_));
                } else {
                    result = std::min(result, static_cast<std::uint8_t>(need_cm_ - 1));
                }
                for (const Closed& c : closed_) {
                    if (std::hypot(c.x_m - middle_x_m[ki], c.y_m - middle_y_m[kj]) < kClosedM) { result = std::min(result, std::uint8_t{1}); }
                }
                if ((under[kBlockCells + kj] >> (kBlockCells + ki) & 1U) != 0U) { result |= 0x80U; }
            }
            values[static_cast<std::size_t>(((y0 + j) & 63) * kTileCells + ((x0 + i) & 63))] = result;
        }
    }
}

}  // namespace noctule
