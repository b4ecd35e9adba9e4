/// Least cost from every reachable cell to one place, computed a slice at a time.
///
/// Dijkstra's method over the eight neighbours with integer costs and a ring of buckets. Cost of an edge: its length times
/// the slowness of the cell entered (docs/maths/potential.md, equation (5)), so a cost is a flight time. One unit is
/// 1/kUnit of a cell at full speed. The field is also the start of the potential: potential.hpp.
/// Memory: two bytes a cell, in pages of one tile that a run takes as it reaches them. Costs are kept with 14 significant bits,
/// rounded up: exact to 25 m of free flight, to 1.6 % of an edge at 100 m, and an edge always costs something up to kDearest.
/// Out of pages, or dearer than that: not reachable (counted).
/// No heap. Work per call is bounded by the budget.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
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
    [[nodiscard]] std::size_t used() const { return static_cast<std::size_t>(used_); }   ///< most at once since it was cleared

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

/// Which of several roots a cell is nearest to, and how far the roots are from each other; filled while a field is computed.
///
/// Distances are exact between roots whose regions touch on the shortest way (Mehlhorn 1988), and from then on shortest sums of
/// such. Root numbers are below kMaxStops.
class RootGraph {
public:
    void clear(std::size_t roots);
    /// Shortest sums: after the field is done.
    void close();
    [[nodiscard]] std::uint32_t between(const std::size_t a, const std::size_t b) const { return distance_[a][b]; }
    [[nodiscard]] std::size_t size() const { return size_; }

private:
    friend class CostField;
    void meet(std::uint8_t a, std::uint8_t b, std::uint32_t distance) {
        if (distance < distance_[a][b]) { distance_[a][b] = distance_[b][a] = distance; }
    }
    std::array<std::array<std::uint8_t, kTileArea>, kMaxFieldTiles> nearest_{};  ///< root of a cell, in the field's pages; holds where the field has a cost
    std::array<std::array<std::uint32_t, kMaxStops>, kMaxStops> distance_{};
    std::size_t size_ = 0;
};

class CostField {
public:
    static constexpr std::uint32_t kUnit = 64;
    static constexpr std::uint32_t kFar = std::numeric_limits<std::uint32_t>::max();
    /// A cost as way at full speed [m]; 10 km for what is not reached.
    [[nodiscard]] static float metres(const std::uint32_t cost, const float cell_m) {
        return cost == kFar ? 1e4F : static_cast<float>(cost) / static_cast<float>(kUnit) * cell_m;
    }

    /// Starts a new field from a cell. Costs of the field before become unreachable at once (they carry its number).
    /// Cells within `free_radius` cells of the root may be tight and still lead on.
    void start(const OccupancyGrid& grid, CellId root, std::int32_t free_radius, OpenCells& open);

    /// A further root at no cost. A cell is of one root, the last that was put there: one before it is met by none. False: the open list or the field is full.
    bool add_root(CellId root, std::uint8_t number, RootGraph& graph, OpenCells& open);

    /// Settles up to `budget` cells; true: done. Stops early once `until` is settled and all that costs `beyond` more.
    bool run(const OccupancyGrid& grid, const Traversability& where, OpenCells& open, std::int32_t budget, CellId until, std::uint32_t beyond,
             RootGraph* graph = nullptr);

    /// kFar: not reached (yet).
    [[nodiscard]] std::uint32_t cost(const CellId id) const {
        return id == kNoCell ? kFar : unpack(packed(id));
    }
    /// Cells that could not be given a cost, over all runs.
    [[nodiscard]] std::uint32_t refused() const { return refused_; }
    static constexpr std::uint32_t kDearest = 0x3FFEU << 6U;   ///< greatest cost that can be kept: 1.6 km at full speed

    /// Two bytes for a cost: three bits of exponent, thirteen of mantissa, a hidden bit as in floats. Rounds up.
    [[nodiscard]] static constexpr std::uint16_t pack(const std::uint32_t cost) {
        if (cost > kDearest) { return kPackedFar; }
        const auto shift = static_cast<std::uint32_t>(std::max(0, static_cast<int>(std::bit_width(cost)) - 14));
        std::uint32_t mantissa = (cost + (1U << shift) - 1U) >> shift;
        const std::uint32_t carry = mantissa >> 14U;   // rounded up to the next power of two
        mantissa >>= carry;
        if (mantissa < 0x2000U) { return static_cast<std::uint16_t>(mantissa); }
        return static_cast<std::uint16_t>(((shift + carry + 1U) << 13U) | (mantissa & 0x1FFFU));
    }
    [[nodiscard]] static constexpr std::uint32_t unpack(const std::uint16_t packed) {
        if (packed == kPackedFar) { return kFar; }
        const std::uint32_t exponent = packed >> 13U;
        return exponent == 0U ? packed : ((packed & 0x1FFFU) | 0x2000U) << (exponent - 1U);
    }
    /// pack(sum), from a cost not above it that is packed already: the same exponent most often.
    [[nodiscard]] static constexpr std::uint16_t packed_sum(const std::uint16_t from, const std::uint32_t sum) {
        const std::uint32_t shift = static_cast<std::uint32_t>(std::max(1, from >> 13)) - 1U;
        const std::uint32_t mantissa = (sum + (1U << shift) - 1U) >> shift;
        return mantissa < 0x4000U ? static_cast<std::uint16_t>((shift << 13U) + mantissa) : pack(sum);
    }
    [[nodiscard]] bool valid() const { return run_ != 0U && done_; }
    [[nodiscard]] CellId root() const { return root_; }
    [[nodiscard]] std::int32_t settled() const { return settled_; }
    [[nodiscard]] std::size_t tiles() const { return pages_; }   ///< that the last run reached
    void clear() { run_ = 0; done_ = false; root_ = kNoCell; }

private:
    static constexpr std::uint16_t kPackedFar = 0xFFFFU;
    [[nodiscard]] static std::size_t slot_of(const CellId id) { return static_cast<std::size_t>(id >> 12); }
    [[nodiscard]] static std::size_t in_tile(const CellId id) { return static_cast<std::size_t>(id & 4095); }
    [[nodiscard]] std::uint16_t packed(const CellId id) const {
        const std::size_t slot = slot_of(id);
        return tile_run_[slot] == run_ ? cost_[page_[slot]][in_tile(id)] : kPackedFar;
    }
    [[nodiscard]] bool near_root(const Cell c) const {
        return std::abs(c.ix - root_cell_.ix) <= free_radius_ && std::abs(c.iy - root_cell_.iy) <= free_radius_;
    }
    bool set(CellId id, std::uint16_t cost);   ///< packed; false: refused
    /// What is known of the cells round one at the rim of its tile.
    struct Rim {
        std::array<CellId, 8> id;
        std::array<std::uint16_t, 8> cost;
        std::array<std::uint8_t, 8> byte;
        std::array<std::uint8_t, 8> owner;   ///< root, where there is a cost
    };
    void gather(const OccupancyGrid& grid, const Traversability& where, const RootGraph* graph, CellId id, Rim& rim) const;

    std::array<std::array<std::uint16_t, kTileArea>, kMaxFieldTiles> cost_{};
    std::array<std::uint32_t, kMaxTiles> tile_run_{};   ///< number of the run that a tile's page belongs to
    std::array<std::uint16_t, kMaxTiles> page_{};
    std::size_t pages_ = 0;
    std::uint32_t refused_ = 0;
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
