/// Cells and metres: the one place that turns the one into the other.
#pragma once

#include <cstdint>

#include "core/integer.hpp"

namespace noctule {

/// A cell of the lattice over frame Map. Cell (ix, iy) covers [ix, ix + 1) x [iy, iy + 1) cell edges.
struct Cell {
    std::int32_t ix = 0;
    std::int32_t iy = 0;
    [[nodiscard]] bool operator==(const Cell&) const = default;
};

/// The eight neighbours, anticlockwise from +x; even ones share an edge.
inline constexpr std::int32_t kNeighbourX[8] = {1, 1, 0, -1, -1, -1, 0, 1};
inline constexpr std::int32_t kNeighbourY[8] = {0, 1, 1, 1, 0, -1, -1, -1};

/// Lattice with cells of a fixed edge. Frame Map, metres.
class GridGeometry {
public:
    explicit GridGeometry(const float cell_m) : cell_m_(cell_m), per_m_(1.0F / cell_m) {}

    [[nodiscard]] float cell_m() const { return cell_m_; }
    /// Position along an axis in cell edges (not rounded).
    [[nodiscard]] float to_cells(const float metres) const { return metres * per_m_; }
    [[nodiscard]] float to_metres(const float cells) const { return cells * cell_m_; }
    [[nodiscard]] Cell cell(const float x_m, const float y_m) const {
        return {floor_int(x_m * per_m_), floor_int(y_m * per_m_)};
    }
    [[nodiscard]] float centre_x_m(const Cell c) const { return (static_cast<float>(c.ix) + 0.5F) * cell_m_; }
    [[nodiscard]] float centre_y_m(const Cell c) const { return (static_cast<float>(c.iy) + 0.5F) * cell_m_; }

private:
    float cell_m_;
    float per_m_;
};

}  // namespace noctule
