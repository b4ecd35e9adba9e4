#include "plan/soundings.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace noctule {

namespace {

constexpr float kStepM = 0.05F;
constexpr float kPatchPerRadius = 1.8F; ///< edge of a patch: a straight way through its middle passes all of it
constexpr float kLeastShare = 0.15F;    ///< of a patch, a metre of the radius wanted; less than that is not worth a flight
constexpr float kDeep = 1.15F;          ///< a place that is so much farther from the way than was wanted is worth a flight, however small the patch
constexpr std::uint8_t kNearCm = 70;
constexpr float kRoundShare = 0.6F;
constexpr std::int32_t kSampleCells = 2;

}  // namespace

Soundings::Soundings() {
    for (auto& tile : centimetres_) { tile.fill(std::numeric_limits<std::uint8_t>::max()); }
}

void Soundings::pass(const OccupancyGrid& grid, const float x_m, const float y_m) {
    if (std::hypot(x_m - last_x_m_, y_m - last_y_m_) < kStepM) { return; }
    last_x_m_ = x_m;
    last_y_m_ = y_m;
    const float cell_m = grid.geometry().cell_m();
    const Cell here = grid.geometry().cell(x_m, y_m);
    const auto reach = static_cast<std::int32_t>(kReachM / cell_m) / kBlock * kBlock;
    const std::int32_t x0 = (here.ix & ~(kBlock - 1)) - reach;
    const std::int32_t y0 = (here.iy & ~(kBlock - 1)) - reach;
    for (std::int32_t iy = y0; iy <= y0 + 2 * reach; iy += kBlock) {
        for (std::int32_t ix = x0; ix <= x0 + 2 * reach; ix += kBlock) {
            const CellId id = grid.find(Cell{ix, iy});
            if (id == kNoCell) { continue; }
            const float dx = (static_cast<float>(ix) + 0.5F * kBlock) * cell_m - x_m;
            const float dy = (static_cast<float>(iy) + 0.5F * kBlock) * cell_m - y_m;
            const float d = std::sqrt(dx * dx + dy * dy);
            if (d >= kReachM) { continue; }
            std::uint8_t& kept = centimetres_[static_cast<std::size_t>(id >> 12)][block(id)];
            const auto now = static_cast<std::uint8_t>(100.0F * d);
            if (now <= kNearCm && kept > kNearCm) { ++blocks_; }
            kept = std::min(kept, now);
        }
    }
}

bool Soundings::passed_round(const OccupancyGrid& grid, const CellId id) const {
    const Cell middle = grid.cell(id);
    const auto reach = static_cast<std::int32_t>(kRoundShare * wanted_m_ / grid.geometry().cell_m());
    for (std::int32_t dy = -reach; dy <= reach; dy += kBlock) {
        for (std::int32_t dx = -reach; dx <= reach; dx += kBlock) {
            const CellId at = dx * dx + dy * dy <= reach * reach ? grid.find(Cell{middle.ix + dx, middle.iy + dy}) : kNoCell;
            if (at != kNoCell && grid.cell_class(at) == CellClass::free && !passed(at)) { return false; }
        }
    }
    return true;
}

// One patch, given by cells of the tile: the place in it nearest to the middle of what was not passed.
void SoundingSearch::look_into(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried,
                               const Soundings& soundings, const std::int64_t t_us, const std::int32_t x0, const std::int32_t y0, const std::int32_t x1,
                               const std::int32_t y1) {
    const auto need_cm = static_cast<std::int32_t>(100.0F * (p_.hull_radius_m + kTreadM));
    const auto left = [&](const std::int32_t x, const std::int32_t y) {
        const CellId id = tile_ * kTileArea + y * kTileCells + x;
        return !soundings.passed(id) && where.passable(id) && where.clearance_cm(id) >= need_cm && from.cost(id) != CostField::kFar;
    };
    std::int32_t n = 0;
    std::int32_t sum_x = 0;
    std::int32_t sum_y = 0;
    float deepest_m = 0.0F;
    for (std::int32_t y = y0; y < y1; y += kSampleCells) {
        for (std::int32_t x = x0; x < x1; x += kSampleCells) {
            if (!left(x, y)) { continue; }
            ++n;
            sum_x += x;
            sum_y += y;
            deepest_m = std::max(deepest_m, soundings.distance_m(tile_ * kTileArea + y * kTileCells + x));
        }
    }
    const std::int32_t all = (x1 - x0) * (y1 - y0) / (kSampleCells * kSampleCells);
    const bool small = static_cast<float>(n) < kLeastShare * soundings.wanted_m() * static_cast<float>(all);
    if (n == 0 || (small && !(soundings.thorough() && deepest_m >= kDeep * soundings.wanted_m()))) { return; }
    Frontier f;
    std::int32_t nearest = std::numeric_limits<std::int32_t>::max();
    for (std::int32_t y = y0; y < y1; y += kSampleCells) {
        for (std::int32_t x = x0; x < x1; x += kSampleCells) {
            const std::int32_t dx = x - sum_x / n;
            const std::int32_t dy = y - sum_y / n;
            if (dx * dx + dy * dy >= nearest || !left(x, y)) { continue; }
            nearest = dx * dx + dy * dy;
            f.look = tile_ * kTileArea + y * kTileCells + x;
        }
    }
    const Cell c = grid.cell(f.look);
    f.view = f.look;
    f.x_m = f.view_x_m = grid.geometry().centre_x_m(c);
    f.y_m = f.view_y_m = grid.geometry().centre_y_m(c);
    f.cost = from.cost(f.look);
    f.cells = n;
    f.sounding = true;
    if (!(tried.distance_allowed_m(f.x_m, f.y_m, t_us) > 0.0F)) { return; }
    if (found_.push(f)) { return; }
    Frontier& farthest = *std::max_element(found_.begin(), found_.end(), [](const Frontier& a, const Frontier& b) { return a.cost < b.cost; });
    if (f.cost < farthest.cost) { farthest = f; }
}

bool SoundingSearch::run(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried, const Soundings& soundings,
                         const std::int64_t t_us) {
    const float tile_m = grid.geometry().to_metres(static_cast<float>(kTileCells));
    const std::int32_t parts = std::clamp<std::int32_t>(static_cast<std::int32_t>(std::lround(tile_m / (kPatchPerRadius * std::max(soundings.wanted_m(), 0.2F)))), 1, 16);
    const auto edge = [&](const std::int32_t k) { return k * kTileCells / parts / kSampleCells * kSampleCells; };
    for (std::int32_t n = 0; n < kTilesPerSlice && tile_ < grid.tile_count(); ++tile_) {
        if (!grid.on_floor(tile_)) { continue; }
        ++n;
        for (std::int32_t j = 0; j < parts; ++j) {
            for (std::int32_t i = 0; i < parts; ++i) {
                look_into(grid, where, from, tried, soundings, t_us, edge(i), edge(j), edge(i + 1), edge(j + 1));
            }
        }
    }
    return tile_ >= grid.tile_count();
}

}  // namespace noctule
