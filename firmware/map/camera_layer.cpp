/// The grid's camera layer: which free cells the front camera has had in view. docs/maths/grid.md, "camera layer".
#include <algorithm>
#include <cmath>

#include "core/angle.hpp"
#include "map/occupancy_grid.hpp"

namespace noctule {

namespace {

constexpr float kStepCells = 0.7F;   ///< along a ray: no cell that it crosses for long is stepped over

}  // namespace

// Rays over the field of view, as dense as cells at the range. A ray ends at the first cell that is not known to be free.
// visit(cell, area): the piece of the sector that a step of a ray stands for, in cells.
template <class F> void OccupancyGrid::each_in_view(const float x_m, const float y_m, const float yaw_rad, F&& visit) const {
    const float range = geometry_.to_cells(p_.camera_range_m);
    const auto rays = std::clamp(static_cast<std::int32_t>(std::ceil(p_.camera_fov_rad * range)), std::int32_t{8}, std::int32_t{512});
    const float spread = p_.camera_fov_rad / static_cast<float>(rays);
    const float ox = geometry_.to_cells(x_m);
    const float oy = geometry_.to_cells(y_m);
    std::int32_t tile_x = 0;
    std::int32_t tile_y = 0;
    std::int32_t slot = -2;
    for (std::int32_t k = 0; k < rays; ++k) {
        const float angle = yaw_rad + p_.camera_fov_rad * ((static_cast<float>(k) + 0.5F) / static_cast<float>(rays) - 0.5F);
        const float dx = std::cos(angle);
        const float dy = std::sin(angle);
        for (float r = 0.0F; r <= range; r += kStepCells) {
            const auto ix = floor_int(ox + r * dx);
            const auto iy = floor_int(oy + r * dy);
            if (slot == -2 || (ix >> 6) != tile_x || (iy >> 6) != tile_y) {
                tile_x = ix >> 6;
                tile_y = iy >> 6;
                slot = tile_slot(tile_x, tile_y);
            }
            const CellId id = slot < 0 ? kNoCell : slot * kTileArea + (iy & 63) * kTileCells + (ix & 63);
            if (cell_class(id) != CellClass::free) { break; }
            visit(id, r * spread * kStepCells);
        }
    }
}

void OccupancyGrid::look(const Pose2<Map, Body>& pose) {
    each_in_view(pose.x_m, pose.y_m, pose.yaw_rad, [this](const CellId id, const float) {
        tiles_[static_cast<std::size_t>(id >> 12)].camera[static_cast<std::size_t>((id >> 6) & 63)] |= std::uint64_t{1} << static_cast<unsigned>(id & 63);
    });
}

float OccupancyGrid::unseen_in_view_m2(const float x_m, const float y_m, const float yaw_rad) const {
    float cells = 0.0F;
    each_in_view(x_m, y_m, yaw_rad, [&](const CellId id, const float area) { cells += camera_saw(id) ? 0.0F : area; });
    return cells * geometry_.cell_m() * geometry_.cell_m();
}

float OccupancyGrid::camera_seen_fraction() const {
    std::int32_t free_cells = 0;
    std::int32_t seen = 0;
    for (std::int32_t id = 0; id < tile_count_ * kTileArea; ++id) {
        if (cell_class(id) != CellClass::free) { continue; }
        ++free_cells;
        seen += camera_saw(id) ? 1 : 0;
    }
    return free_cells == 0 ? 0.0F : static_cast<float>(seen) / static_cast<float>(free_cells);
}

std::int32_t OccupancyGrid::unseen_in_block(const std::int32_t slot, const std::int32_t block) const {
    std::int32_t count = 0;
    for (std::int32_t j = 0; j < kBlockCells; ++j) {
        for (std::int32_t i = 0; i < kBlockCells; ++i) {
            const CellId id = slot * kTileArea + ((block >> 3) * kBlockCells + j) * kTileCells + (block & 7) * kBlockCells + i;
            count += cell_class(id) == CellClass::free && !camera_saw(id) ? 1 : 0;
        }
    }
    return count;
}

}  // namespace noctule
