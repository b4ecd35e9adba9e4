/// Where the hull fits: per cell the distance to the nearest hit point, kept up to date block by block.
///
/// A free cell is passable when somewhere in it no hit point is nearer than the hull radius and a margin, and no unknown cell
/// lies under the hull, and the place is inside the fence. Distances are measured to hit points, not to squares of cells: docs/maths/grid.md, "clearance".
/// Recomputed in blocks of 8 x 8 cells whose neighbourhood changed: blocks near the vehicle at once, the others in turn,
/// a bounded number a step. No heap.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "map/occupancy_grid.hpp"
#include "plan/fence.hpp"
#include "plan/stair_signs.hpp"
#include "params.gen.hpp"

namespace noctule {

class Traversability {
public:
    explicit Traversability(const Parameters& parameters);

    /// Takes up what changed in the grid. Cost: at most kBlocksPerStep blocks of 64 cells.
    void update(const OccupancyGrid& grid, float x_m, float y_m);

    /// Forgets everything (the grid was reset).
    void reset();

    /// No way leads through this place until then: the vehicle was held fast there. Full: all are forgotten.
    void close(float x_m, float y_m, std::int64_t until_us);
    /// The place closed last is open again.
    void reopen_last();
    /// And for a while one look is enough to find a gap open. Asked again within a second, with nothing closed, it does nothing.
    void reopen_all();
    /// There is no way at all: for a minute what is narrower by a little than it should be counts as open, so that the vehicle comes out where it came in.
    void last_resort();
    [[nodiscard]] bool at_last_resort() const { return slack_m_ > kClosesM; }
    /// Those whose time is over.
    void reopen(std::int64_t t_us);

    /// Places where the hull is nearer than a tread's depth to a hit are gone round where that is not much farther: beside stairs the top of a tread that is
    /// a little under the laser's plane is not seen and lies in the hull's way. Taken up with the next update.
    void keep_off(const bool on) { keeps_off_ = on; }

    /// Stairs lie under that place: what is hit near it counts as nearer by a tread's depth, because of the tread before it that is not seen. More than
    /// kMaxStairPlaces: the first are forgotten.
    void add_stairs(std::int32_t floor, float x_m, float y_m);
    [[nodiscard]] const StairPlaces& stairs() const { return stairs_; }

    static constexpr std::int32_t kCapCm = 80;   ///< distances are known up to here

    /// Distance of a free cell's centre to the nearest hit [cm], at most kCapCm; where the hull hardly fits, of the cell's roomiest
    /// point. 0: not free, or outside the fence.
    [[nodiscard]] std::int32_t clearance_cm(const CellId id) const { return id == kNoCell ? 0 : byte(id) & 0x7F; }
    /// True: hull and margin fit, and nothing unknown is under the hull.
    [[nodiscard]] bool passable(const CellId id) const { return id != kNoCell && passable_byte(byte(id)); }
    /// True: free, and the vehicle may stand there if it came there, but no path leads through.
    [[nodiscard]] bool tight(const CellId id) const { return id != kNoCell && tight_byte(byte(id)); }
    /// True: something unknown is under the hull.
    [[nodiscard]] bool over_unknown(const CellId id) const { return id != kNoCell && byte(id) >= 0x80; }
    /// True: hull and margin fit, but something unknown is under the hull.
    [[nodiscard]] bool at_edge(const CellId id) const { return id != kNoCell && byte(id) >= 0x80 && (byte(id) & 0x7F) >= need_cm_; }
    /// Moves a place where the hull does not fit, in a passable cell, to the roomiest point of its cell.
    void make_room(const OccupancyGrid& grid, float& x_m, float& y_m) const;
    /// Time to cross a unit of length there, against crossing it at full speed; at least 1. docs/maths/potential.md, equation (5).
    [[nodiscard]] float slowness(const CellId id) const { return slowness_[static_cast<std::size_t>(clearance_cm(id))]; }

    // The same by the byte that is kept of a cell, for loops that look at many: clearance in cm; +128: something unknown under the hull.
    [[nodiscard]] std::int32_t byte(const CellId id) const { return *bytes(id); }
    /// Where it stands; those of the other cells of the tile stand round it, as their handles do.
    [[nodiscard]] const std::uint8_t* bytes(const CellId id) const { return &value_[static_cast<std::size_t>(id >> 12)][static_cast<std::size_t>(id & 4095)]; }
    [[nodiscard]] bool passable_byte(const std::int32_t byte) const { return byte >= need_cm_ && byte < 0x80; }
    [[nodiscard]] static bool tight_byte(const std::int32_t byte) { return (byte & 0x7F) >= kTightCm; }
    [[nodiscard]] float slowness_byte(const std::int32_t byte) const { return slowness_[static_cast<std::size_t>(std::min(byte & 0x7F, kCapCm))]; }
    /// Rises when parameters change what a byte means.
    [[nodiscard]] std::uint32_t meaning() const { return meaning_; }

    [[nodiscard]] std::size_t blocks_waiting() const { return queue_size_; }
    [[nodiscard]] std::uint32_t blocks_done() const { return blocks_done_; }

private:
    struct Closed { float x_m; float y_m; std::int64_t until_us; };
    using Hits = Bounded<Point2<Map>, 96>;   ///< round a block, enough for walls two cells thick all through it; full: the grid is asked
    static constexpr std::size_t kMaxClosed = 16;
    static constexpr std::int32_t kTightCm = 15;
    static constexpr float kClosesM = 0.003F;        ///< lacking to hull and margin: a place that was open closes
    static constexpr float kLastResortM = 0.007F;   ///< lacking to them: what counts as open at last resort
    static constexpr float kOffFactor = 4.0F;
    static constexpr float kOffMost = 20.0F;   ///< slowness: the dearest edge must fit in the ring of OpenCells
    static constexpr std::int32_t kBlocksPerStep = 160;
    void load_parameters();
    void mark_all_stale();
    void look_for_changes(const OccupancyGrid& grid, std::int32_t slot);
    void enqueue(std::int32_t block);
    void compute(const OccupancyGrid& grid, std::int32_t block);
    float roomiest_m(const OccupancyGrid& grid, const Hits* hits, float& x_m, float& y_m, float centre_m) const;

    const Parameters& p_;
    std::array<std::array<std::uint8_t, kTileArea>, kMaxTiles> value_{};
    std::array<std::array<std::uint16_t, kTileBlocks>, kMaxTiles> seen_{}; ///< versions taken up
    std::array<std::uint64_t, kMaxTiles> waiting_{};                       ///< bit: block is in the queue
    std::array<std::int32_t, kMaxDirtyBlocks> queue_{};                    ///< ring of slot * 64 + block
    std::size_t queue_head_ = 0;
    std::size_t queue_size_ = 0;
    std::array<float, kCapCm + 1> slowness_{};
    bool keeps_off_ = false;
    bool lenient_ = false;
    std::int64_t now_us_ = 0;
    std::int64_t lenient_until_us_ = 0;
    std::int64_t last_resort_until_us_ = 0;
    float slack_m_ = kClosesM;
    std::int32_t need_cm_ = 33;
    std::uint32_t meaning_ = 0;
    Fence fence_;
    Bounded<Closed, kMaxClosed> closed_;
    StairPlaces stairs_;
    std::int32_t next_tile_ = 0;
    std::uint32_t blocks_done_ = 0;
};

static_assert(kMaxDirtyBlocks >= kMaxTiles * static_cast<std::size_t>(kTileBlocks), "every block must fit in the queue");

}  // namespace noctule
