/// What the upward and the downward range saw, cell by cell: elevations of what is over and under a place.
///
/// A small map beside the occupancy grid, one for all floors. A cell is laid down where a range met a surface, in a table
/// addressed by hash; when it is full the new place is refused and counted. Frame Map, metres. No heap, not thread-safe.
/// docs/maths/floors.md.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/capacity.hpp"
#include "map/cell.hpp"

namespace noctule {

enum class VerticalSide : std::uint8_t { under = 0, over = 1 };

/// One place of one floor, seen from there in one direction.
struct VerticalCell {
    Cell cell;
    std::int8_t floor = -1;       ///< floor the vehicle was on; -1: the entry is empty
    VerticalSide side = VerticalSide::under;
    std::int16_t votes = 0;       ///< readings for z_m less those against it
    float z_m = 0.0F;             ///< elevation of the surface
};

class VerticalMap {
public:
    explicit VerticalMap(const float cell_m) : geometry_(cell_m) {}

    /// One range that met a surface at (x, y, z). The elevation that most readings of a cell agree on holds (Boyer-Moore vote).
    void add(std::int8_t floor, VerticalSide side, float x_m, float y_m, float z_m);

    /// The entry of a place, or nullptr. Constant cost.
    [[nodiscard]] const VerticalCell* find(std::int8_t floor, VerticalSide side, Cell cell) const;

    /// Forgets one floor.
    void forget(std::int8_t floor);

    /// All entries, the empty ones (floor -1) included.
    [[nodiscard]] const std::array<VerticalCell, kMaxVerticalCells>& cells() const { return cells_; }
    [[nodiscard]] const GridGeometry& geometry() const { return geometry_; }
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] std::uint32_t refused() const { return refused_; }

private:
    [[nodiscard]] static std::size_t slot(std::int8_t floor, VerticalSide side, Cell cell);

    GridGeometry geometry_;
    std::array<VerticalCell, kMaxVerticalCells> cells_{};
    std::size_t size_ = 0;        ///< entries that were ever laid down; forgotten ones still hold their place
    std::uint32_t refused_ = 0;
};

}  // namespace noctule
