/// Least cost from every reachable cell to one place, computed a slice at a time.
///
/// Dijkstra's method over the eight neighbours with integer costs and a ring of buckets. Cost of an edge: its length times
/// the slowness of the cell entered (docs/maths/potential.md, equation (5)), so a cost is a flight time. One unit is
/// 1/kUnit of a cell at full speed. The field is also the start of the potential: potential.hpp.
/// No heap. Work per call is bounded by the budget.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "core/capacity.hpp"
#include "map/occupancy_grid.hpp"
#include "plan/traversability.hpp"

namespace noctule {

/// The open list of one search at a time; searches that run one after the other share it.
class OpenCells {
public:
    static constexpr std::int32_t kBuckets = 2048;   ///< more than the dearest edge
    void clear();
    /// False: full, the entry was dropped (and counted).
    bool push(CellId id, std::uint32_t cost);
    /// The cheapest entry; false: none left.
    bool pop(CellId& id, std::uint32_t& cost);
    [[nodiscard]] std::uint32_t refused() const { return refused_; }

private:
    struct Node { CellId id; std::int32_t next; };
    std::array<Node, kMaxOpenCells> nodes_{};
    std::array<std::int32_t, kBuckets> head_{};
    std::int32_t free_ = -1;
    std::int32_t used_ = 0;
    std::int32_t size_ = 0;
    std::uint32_t base_ = 0;   ///< cost of the bucket looked at
    std::uint32_t refused_ = 0;
};

class CostField {
public:
    static constexpr std::uint32_t kUnit = 64;
    static constexpr std::uint32_t kFar = std::numeric_limits<std::uint32_t>::max();

    /// Starts a new field from a cell. Costs of the field before become unreachable at once (they carry its number).
    /// Cells within `free_radius` cells of the root may be tight and still lead on.
    void start(const OccupancyGrid& grid, CellId root, std::int32_t free_radius, OpenCells& open);

    /// Settles up to `budget` cells; true: done. Stops early once `until` is settled and all that costs `beyond` more.
    bool run(const OccupancyGrid& grid, const Traversability& where, OpenCells& open, std::int32_t budget, CellId until, std::uint32_t beyond);

    /// kFar: not reached (yet).
    [[nodiscard]] std::uint32_t cost(const CellId id) const {
        if (id == kNoCell) { return kFar; }
        const auto slot = static_cast<std::size_t>(id >> 12);
        return tile_run_[slot] == run_ ? cost_[slot][static_cast<std::size_t>(id & 4095)] : kFar;
    }
    [[nodiscard]] bool valid() const { return run_ != 0U && done_; }
    [[nodiscard]] CellId root() const { return root_; }
    [[nodiscard]] std::int32_t settled() const { return settled_; }
    void clear() { run_ = 0; done_ = false; root_ = kNoCell; }

private:
    void set(CellId id, std::uint32_t cost);

    std::array<std::array<std::uint32_t, kTileArea>, kMaxTiles> cost_{};
    std::array<std::uint32_t, kMaxTiles> tile_run_{};   ///< number of the run that a tile's costs belong to
    std::uint32_t run_ = 0;
    std::uint32_t runs_ = 0;
    CellId root_ = kNoCell;
    Cell root_cell_;
    std::int32_t free_radius_ = 0;
    std::int32_t settled_ = 0;
    std::uint32_t stop_at_ = kFar;
    bool done_ = false;
};

}  // namespace noctule
