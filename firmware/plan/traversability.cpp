#include "plan/traversability.hpp"

#include <algorithm>
#include <cmath>

#include "plan/target.hpp"

namespace noctule {

namespace {

constexpr std::int32_t kNearTiles = 1;        ///< tiles round the vehicle looked at in every step
constexpr std::int32_t kFarTilesPerStep = 8;  ///< others, in turn
constexpr std::int32_t kSide = 3 * kBlockCells;
constexpr float kUnknownCells = 2.5F;         ///< an unknown cell whose centre is nearer than this is under the hull (0.25 m at 0.10 m)

}  // namespace

Traversability::Traversability(const Parameters& parameters) : p_(parameters), fence_(parameters) { load_parameters(); }

void Traversability::reset() {
    for (auto& tile : value_) { tile.fill(0); }
    for (auto& tile : seen_) { tile.fill(0); }
    waiting_.fill(0);
    queue_head_ = queue_size_ = 0;
    next_tile_ = 0;
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
    need_cm_ = std::clamp(static_cast<std::int32_t>(std::lround(100.0F * (p_.hull_radius_m + p_.plan_margin_m))), 1, kCapCm);
    for (std::int32_t k = 0; k <= kCapCm; ++k) {
        slowness_[static_cast<std::size_t>(k)] = p_.speed_max_m_s / speed_at_clearance_m_s(p_, 0.01F * static_cast<float>(k));
    }
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

void Traversability::compute(const OccupancyGrid& grid, const std::int32_t block) {
    ++blocks_done_;
    const std::int32_t slot = block >> 6;
    const GridTile& tile = grid.tile(slot);
    const std::int32_t x0 = tile.tile_x * kTileCells + (block & 7) * kBlockCells;       // first cell of the block
    const std::int32_t y0 = tile.tile_y * kTileCells + ((block >> 3) & 7) * kBlockCells;
    std::array<CellClass, static_cast<std::size_t>(kSide * kSide)> cells{};
    std::array<float, static_cast<std::size_t>(kSide * kSide)> hit_x{};
    std::array<float, static_cast<std::size_t>(kSide * kSide)> hit_y{};
    std::size_t hits = 0;
    bool any_unknown = false;
    for (std::int32_t by = -1; by <= 1; ++by) {
        for (std::int32_t bx = -1; bx <= 1; ++bx) {
            const std::int32_t cx = x0 + bx * kBlockCells;
            const std::int32_t cy = y0 + by * kBlockCells;
            const std::int32_t s = grid.tile_slot(cx >> 6, cy >> 6);
            for (std::int32_t j = 0; j < kBlockCells; ++j) {
                for (std::int32_t i = 0; i < kBlockCells; ++i) {
                    const CellId id = s < 0 ? kNoCell : s * kTileArea + ((cy + j) & 63) * kTileCells + ((cx + i) & 63);
                    const CellClass k = grid.cell_class(id);
                    cells[static_cast<std::size_t>((by * kBlockCells + j + kBlockCells) * kSide + bx * kBlockCells + i + kBlockCells)] = k;
                    any_unknown = any_unknown || k == CellClass::unknown;
                    if (k != CellClass::occupied) { continue; }
                    float x_m = 0.0F;
                    float y_m = 0.0F;
                    grid.hit_point(id, x_m, y_m);
                    hit_x[hits] = x_m;
                    hit_y[hits] = y_m;
                    ++hits;
                }
            }
        }
    }
    const float cap_m = 0.01F * static_cast<float>(kCapCm);
    constexpr auto kReach = static_cast<std::int32_t>(kUnknownCells);
    for (std::int32_t j = 0; j < kBlockCells; ++j) {
        for (std::int32_t i = 0; i < kBlockCells; ++i) {
            const std::int32_t at = (j + kBlockCells) * kSide + i + kBlockCells;
            std::uint8_t result = 0;
            if (cells[static_cast<std::size_t>(at)] == CellClass::free) {
                const float x_m = grid.geometry().centre_x_m({x0 + i, 0});
                const float y_m = grid.geometry().centre_y_m({0, y0 + j});
                const bool inside = fence_.depth_m(x_m, y_m) >= kFenceInsetM;
                float best = cap_m * cap_m;
                for (std::size_t k = 0; k < hits; ++k) {
                    const float dx = hit_x[k] - x_m;
                    const float dy = hit_y[k] - y_m;
                    best = std::min(best, dx * dx + dy * dy);
                }
                result = inside ? static_cast<std::uint8_t>(std::clamp(static_cast<std::int32_t>(100.0F * std::sqrt(best)), 1, kCapCm)) : std::uint8_t{0};
                if (any_unknown && inside) {
                    for (std::int32_t dy = -kReach; dy <= kReach; ++dy) {
                        for (std::int32_t dx = -kReach; dx <= kReach; ++dx) {
                            const auto d2 = static_cast<float>(dx * dx + dy * dy);
                            if (d2 <= kUnknownCells * kUnknownCells && cells[static_cast<std::size_t>(at + dy * kSide + dx)] == CellClass::unknown) {
                                result |= 0x80U;
                            }
                        }
                    }
                }
            }
            const CellId id = slot * kTileArea + ((y0 + j) & 63) * kTileCells + ((x0 + i) & 63);
            value_[static_cast<std::size_t>(slot)][static_cast<std::size_t>(id & 4095)] = result;
        }
    }
}

}  // namespace noctule
