#include "plan/unseen.hpp"

#include <algorithm>
#include <cmath>

#include "core/angle.hpp"

namespace noctule {

namespace {

constexpr float kCellsAtWeightOne = 20.0F;   ///< unseen cells of a block of 64 that make it worth a visit
constexpr float kOnePatchM = 1.6F;           ///< blocks within this of a patch are seen with it
constexpr float kNearestM = 0.5F;            ///< viewpoints keep so far off, so that the heading to look along is well defined
constexpr float kRangeShare = 0.75F;         ///< of the camera's range from which a patch is looked at
constexpr std::int32_t kRays = 24;
constexpr float kDistanceCost = 0.3F;        ///< metres of way that a metre of viewing distance costs

}  // namespace

// Rays from the patch through free cells find the places that see it.
bool UnseenSearch::view(const OccupancyGrid& grid, const Traversability& where, const CostField& from, Frontier& patch) const {
    const float step_m = grid.geometry().cell_m();
    float best = 1e9F;
    for (std::int32_t k = 0; k < kRays; ++k) {
        const float angle = 2.0F * kPi * static_cast<float>(k) / static_cast<float>(kRays);
        for (float r = 0.0F; r <= kRangeShare * p_.camera_range_m; r += step_m) {
            const CellId id = grid.find(patch.x_m + r * std::cos(angle), patch.y_m + r * std::sin(angle));
            if (grid.cell_class(id) != CellClass::free) { break; }
            if (r < kNearestM || !where.passable(id)) { continue; }
            const std::uint32_t cost = from.cost(id);
            if (cost == CostField::kFar) { continue; }
            const float score = static_cast<float>(cost) / static_cast<float>(CostField::kUnit) * step_m + kDistanceCost * r;
            if (score >= best) { continue; }
            best = score;
            const Cell v = grid.cell(id);
            patch.view = id;
            patch.view_x_m = grid.geometry().centre_x_m(v);
            patch.view_y_m = grid.geometry().centre_y_m(v);
            patch.cost = cost;
        }
    }
    return patch.view != kNoCell;
}

bool UnseenSearch::run(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried, const std::int64_t t_us) {
    const auto least = static_cast<std::int32_t>(std::clamp(kCellsAtWeightOne / std::max(p_.camera_weight, 0.01F), 8.0F, 64.0F));
    for (std::int32_t n = 0; n < kTilesPerSlice && tile_ < grid.tile_count(); ++n, ++tile_) {
        if (!grid.on_floor(tile_)) { continue; }
        const GridTile& tile = grid.tile(tile_);
        for (std::int32_t block = 0; block < kTileBlocks && !found_.full(); ++block) {
            Frontier f;
            f.cells = grid.unseen_in_block(tile_, block);
            if (f.cells < least) { continue; }
            // The unseen free cell nearest to the block's middle stands for it.
            const Cell middle{tile.tile_x * kTileCells + (block & 7) * kBlockCells + kBlockCells / 2, tile.tile_y * kTileCells + (block >> 3) * kBlockCells + kBlockCells / 2};
            std::int32_t nearest = 1000;
            for (std::int32_t j = -kBlockCells / 2; j < kBlockCells / 2; ++j) {
                for (std::int32_t i = -kBlockCells / 2; i < kBlockCells / 2; ++i) {
                    const Cell c{middle.ix + i, middle.iy + j};
                    const CellId id = grid.find(c);
                    if (i * i + j * j >= nearest || grid.cell_class(id) != CellClass::free || grid.camera_saw(id)) { continue; }
                    nearest = i * i + j * j;
                    f.look = id;
                    f.x_m = grid.geometry().centre_x_m(c);
                    f.y_m = grid.geometry().centre_y_m(c);
                }
            }
            f.camera = true;
            const bool taken = std::any_of(found_.begin(), found_.end(), [&](const Frontier& other) { return std::hypot(other.x_m - f.x_m, other.y_m - f.y_m) < kOnePatchM; });
            if (taken || !(tried.distance_allowed_m(f.x_m, f.y_m, t_us) > 0.0F) || !view(grid, where, from, f)) { continue; }
            static_cast<void>(found_.push(f));
        }
    }
    return tile_ >= grid.tile_count();
}

}  // namespace noctule
