/// explored_share of closed_world.hpp.
#pragma once

#include <set>

#include "closed_world.hpp"

namespace noctule::test {

inline double explored_share(const FlatWorld& world, const OccupancyGrid& grid, const double range_m, std::vector<Cell>* missing) {
    constexpr double kFine = 0.05;
    constexpr int kHalf = 1400;   // 70 m each way
    const auto key = [](const int i, const int j) { return static_cast<std::size_t>(j + kHalf) * (2 * kHalf) + static_cast<std::size_t>(i + kHalf); };
    std::vector<bool> seen(static_cast<std::size_t>(4) * kHalf * kHalf, false);
    std::vector<std::pair<int, int>> open{{0, 0}};
    seen[key(0, 0)] = true;
    std::set<std::pair<int, int>> cells;
    while (!open.empty()) {
        const auto [i, j] = open.back();
        open.pop_back();
        cells.insert({static_cast<int>(std::floor(i * kFine / 0.1)), static_cast<int>(std::floor(j * kFine / 0.1))});
        for (int d = 0; d < 8; ++d) {
            const int a = i + kNeighbourX[d];
            const int b = j + kNeighbourY[d];
            if (std::abs(a) >= kHalf || std::abs(b) >= kHalf || seen[key(a, b)]) { continue; }
            seen[key(a, b)] = true;
            if (world.clearance(a * kFine, b * kFine) < 0.36) { continue; }
            open.emplace_back(a, b);
        }
    }
    // Seeable: rays from every fourth reachable cell (and all where they are few).
    std::vector<bool> free_truth(static_cast<std::size_t>(4) * kHalf * kHalf, false);
    std::vector<bool> wall_truth(static_cast<std::size_t>(4) * kHalf * kHalf, false);
    for (const auto& [ci, cj] : cells) {
        if (((ci & 3) != 0 || (cj & 3) != 0) && cells.size() > 400) { continue; }
        const double cx = (ci + 0.5) * 0.1;
        const double cy = (cj + 0.5) * 0.1;
        const auto near = world.within(cx, cy, range_m);
        for (int k = 0; k < 720; ++k) {
            const double angle = 2.0 * 3.14159265358979 * k / 720.0;
            const double r = world.cast(cx, cy, angle, range_m, near);
            for (double s = 0.0; s < r - 0.03; s += 0.05) {
                free_truth[key(static_cast<int>(std::floor((cx + s * std::cos(angle)) / 0.1)), static_cast<int>(std::floor((cy + s * std::sin(angle)) / 0.1)))] = true;
            }
            if (r < range_m) {
                wall_truth[key(static_cast<int>(std::floor((cx + r * std::cos(angle)) / 0.1)), static_cast<int>(std::floor((cy + r * std::sin(angle)) / 0.1)))] = true;
            }
        }
    }
    std::size_t all = 0;
    std::size_t right = 0;
    for (int j = -kHalf + 1; j < kHalf - 1; ++j) {
        for (int i = -kHalf + 1; i < kHalf - 1; ++i) {
            if (!free_truth[key(i, j)] && !wall_truth[key(i, j)]) { continue; }
            ++all;
            const CellClass got = grid.cell_class(Cell{i, j});
            bool ok = false;
            for (int d = 0; d < 9 && got != CellClass::unknown; ++d) {
                const int a = i + d % 3 - 1;
                const int b = j + d / 3 - 1;
                ok = ok || (got == CellClass::free ? free_truth[key(a, b)] : wall_truth[key(a, b)]);
            }
            if (ok) {
                ++right;
            } else if (missing != nullptr) {
                missing->push_back({i, j});
            }
        }
    }
    return all == 0U ? 0.0 : static_cast<double>(right) / static_cast<double>(all);
}

}  // namespace noctule::test
