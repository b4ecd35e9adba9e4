#include "plan/survey.hpp"

#include <algorithm>
#include <cstdlib>
#include <limits>

namespace noctule {

CellId root_near(const OccupancyGrid& grid, const Traversability& where, const float x_m, const float y_m) {
    const Cell here = grid.geometry().cell(x_m, y_m);
    const auto reach = static_cast<std::int32_t>(grid.geometry().to_cells(0.5F));
    CellId best = kNoCell;
    float nearest = std::numeric_limits<float>::infinity();
    for (std::int32_t dy = -reach; dy <= reach; ++dy) {
        for (std::int32_t dx = -reach; dx <= reach; ++dx) {
            const CellId id = grid.find(Cell{here.ix + dx, here.iy + dy});
            const auto d2 = static_cast<float>(dx * dx + dy * dy);
            if (d2 < nearest && where.clearance_cm(id) > 0) {
                nearest = d2;
                best = id;
            }
        }
    }
    return best;
}

std::int32_t lead_on_cells(const OccupancyGrid& grid, const Traversability& where, const CellId root) {
    constexpr std::int32_t kMost = 5;
    if (root == kNoCell || where.passable(root)) { return 0; }
    const Cell at = grid.cell(root);
    std::int32_t nearest = kMost + 1;
    for (std::int32_t dy = -kMost; dy <= kMost; ++dy) {
        for (std::int32_t dx = -kMost; dx <= kMost; ++dx) {
            const std::int32_t away = std::max(std::abs(dx), std::abs(dy));
            if (away < nearest && where.passable(grid.find(Cell{at.ix + dx, at.iy + dy}))) { nearest = away; }
        }
    }
    return nearest - 1;
}

bool Survey::run(const MapView& map, const ViewRule& rule, const std::int32_t budget_cells) {
    if (budget_cells <= 0) { return false; }
    if (phase_ == Phase::idle) {
        const CellId root = root_near(map.grid, map.where, map.from.x_m, map.from.y_m);
        costs_.start(map.grid, root, lead_on_cells(map.grid, map.where, root), open_);
        phase_ = Phase::costs;
    }
    if (phase_ == Phase::costs) {
        const std::int32_t before = costs_.settled();
        if (!costs_.run(map.grid, map.where, open_, budget_cells, kNoCell, 0)) { return false; }
        phase_ = Phase::edge;
        search_.start();
        if (costs_.settled() - before > budget_cells / 2) { return false; }  // the rest of the budget would not do
    }
    if (phase_ == Phase::edge) {
        if (!search_.run(map.grid, map.where, costs_, tried_, rule, map.home.x_m, map.home.y_m, map.t_us)) { return false; }
        behind_cells_ = 0;
        for (const Frontier& f : search_.found()) { behind_cells_ += f.behind; }
        if (rule.camera) {
            phase_ = Phase::unseen;
            unseen_.start();
            return false;
        }
        phase_ = Phase::passes;
        passes_.start();
    }
    if (phase_ == Phase::unseen) {
        if (!unseen_.run(map.grid, map.where, costs_, tried_, map.t_us)) { return false; }
        for (const Frontier& f : unseen_.found()) { search_.add(f); }
        phase_ = Phase::passes;
        passes_.start();
    }
    if (phase_ == Phase::passes && rule.soundings && map.soundings != nullptr && map.soundings->wanted_m() > 0.0F) {
        if (!passes_.run(map.grid, map.where, costs_, tried_, *map.soundings, map.t_us)) { return false; }
        for (const Frontier& f : passes_.found()) { search_.add(f); }
    }
    phase_ = Phase::idle;
    return true;
}

}  // namespace noctule
