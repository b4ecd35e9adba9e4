/// Occupancy grid of up to kMaxFloors floors: log-odds per cell, and in each occupied cell the mean place of its hits.
///
/// Model and numbers: docs/maths/grid.md (section G of the paper's method: Bayes filter in log-odds).
/// Frame Map, metres. Cells lie in tiles of 64 x 64 that are laid down where beams go, from a fixed pool:
/// no size is needed in advance. Pool full: the tile is refused, its cells stay unknown, the refusal is counted.
/// The floors share the pool. One of them is active: find, neighbour, integrate and all that is asked by place mean it alone;
/// a CellId names a cell of whatever floor for good. One instance, no heap, not thread-safe.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "core/capacity.hpp"
#include "estimate/estimate.hpp"
#include "map/cell.hpp"
#include "params.gen.hpp"

namespace noctule {

inline constexpr std::int32_t kTileCells = 64;
inline constexpr std::int32_t kTileArea = kTileCells * kTileCells;
inline constexpr std::int32_t kTileBlocks = 64;   ///< blocks of 8 x 8 cells in a tile
inline constexpr std::int32_t kBlockCells = 8;

/// Handle of a stored cell: slot of its tile * 4096 + row * 64 + column.
using CellId = std::int32_t;
inline constexpr CellId kNoCell = -1;
/// From a cell's handle to those of its neighbours in the same tile, order of kNeighbourX.
inline constexpr CellId kNeighbourStep[8] = {1, kTileCells + 1, kTileCells, kTileCells - 1, -1, -kTileCells - 1, -kTileCells, -kTileCells + 1};

enum class CellClass : std::uint8_t { unknown, free, occupied };

/// One tile, as grid_tile_t wants it.
struct GridTile {
    std::int32_t tile_x = 0;
    std::int32_t tile_y = 0;
    std::int32_t floor = 0;
    std::array<std::int8_t, kTileArea> log_odds{};   ///< 1/16 nat; 0 unknown, positive occupied, negative free
    std::array<std::int8_t, kTileArea> hit_x{};      ///< mean hit from the cell's centre, 1/256 cell; -128: none
    std::array<std::int8_t, kTileArea> hit_y{};
    std::array<std::uint64_t, kTileCells> camera{};  ///< a bit a cell, row by row: free and once in the camera's view
    std::array<std::uint16_t, kTileBlocks> version{}; ///< rises with every change of a block's geometry
    std::array<std::int32_t, 8> neighbour{};         ///< slots of the tiles around, order of kNeighbourX; -1 none
    bool class_changed = false;                      ///< since it was last published
    bool value_changed = false;
    std::int64_t published_us = -1;
};

/// Classes of eight cells beside each other, a bit a cell. Without a tile all are unknown.
struct ClassBits {
    std::uint32_t free = 0;
    std::uint32_t occupied = 0;
    [[nodiscard]] std::uint32_t unknown() const { return ~(free | occupied) & 0xFFU; }
};

class OccupancyGrid {
public:
    explicit OccupancyGrid(const Parameters& parameters);

    /// Enters one sweep. Refused (and counted) when localisation is lost or the height is out of the band.
    /// Cost: proportional to the cells crossed; each cell changes at most once a sweep.
    void integrate(const Estimate& estimate, const LevelScan& scan);

    /// Forgets everything; counters stay. Floor 0 is active.
    void reset();

    /// Makes a floor active, 0 to kMaxFloors - 1; nothing is forgotten. False: no such floor, nothing was done.
    [[nodiscard]] bool select_floor(std::int32_t floor);
    [[nodiscard]] std::int32_t floor() const { return floor_; }
    /// True: the tile belongs to the active floor. Loops over all slots ask this first.
    [[nodiscard]] bool on_floor(const std::int32_t slot) const { return tiles_[static_cast<std::size_t>(slot)].floor == floor_; }

    [[nodiscard]] const GridGeometry& geometry() const { return geometry_; }
    [[nodiscard]] CellId find(const Cell cell) const {                 ///< kNoCell: nothing is known there
        const std::int32_t slot = tile_slot(cell.ix >> 6, cell.iy >> 6);
        return slot < 0 ? kNoCell : id_in(slot, cell);
    }
    [[nodiscard]] CellId find(float x_m, float y_m) const { return find(geometry_.cell(x_m, y_m)); }
    [[nodiscard]] Cell cell(const CellId id) const {
        const GridTile& t = tiles_[static_cast<std::size_t>(id >> 12)];
        return {t.tile_x * kTileCells + (id & 63), t.tile_y * kTileCells + ((id >> 6) & 63)};
    }
    /// Handle of a cell that lies in the tile with this slot.
    [[nodiscard]] static constexpr CellId id_in(const std::int32_t slot, const Cell c) { return slot * kTileArea + (c.iy & 63) * kTileCells + (c.ix & 63); }
    /// True: the eight neighbours are in the same tile; their handles are kNeighbourStep away.
    [[nodiscard]] static constexpr bool inside_tile(const CellId id) {
        return (static_cast<std::uint32_t>(id) & 63U) - 1U < 62U && (static_cast<std::uint32_t>(id >> 6) & 63U) - 1U < 62U;
    }
    [[nodiscard]] CellId neighbour(const CellId id, const std::int32_t direction) const {  ///< direction 0 to 7; kNoCell: no tile there
        const std::int32_t i = (id & 63) + kNeighbourX[direction];
        const std::int32_t j = ((id >> 6) & 63) + kNeighbourY[direction];
        return ((i | j) & ~63) == 0 ? (id & ~4095) + j * kTileCells + i : neighbour_across(id, i, j);
    }
    [[nodiscard]] CellClass cell_class(const CellId id) const {
        if (id == kNoCell) { return CellClass::unknown; }
        return class_of(tiles_[static_cast<std::size_t>(id >> 12)].log_odds[static_cast<std::size_t>(id & 4095)]);
    }
    /// Of the cells id to id + 7, which must lie in one tile.
    [[nodiscard]] ClassBits classes_of_eight(const CellId id) const {
        std::uint64_t log_odds = 0;   // eight numbers at once; bit 7 of each is its sign, occupied_ > 0 > free_
        std::memcpy(&log_odds, &tiles_[static_cast<std::size_t>(id >> 12)].log_odds[static_cast<std::size_t>(id & 4095)], sizeof log_odds);
        const std::uint64_t low = log_odds & ~kSigns;
        const std::uint64_t occupied = (low + kEach * static_cast<std::uint64_t>(128 - occupied_)) & ~log_odds & kSigns;
        const std::uint64_t free = ~(low + kEach * static_cast<std::uint64_t>(-1 - free_)) & log_odds & kSigns;
        return {packed_signs(free), packed_signs(occupied)};
    }
    [[nodiscard]] CellClass cell_class(const Cell c) const { return cell_class(find(c)); }
    /// Mean hit of an occupied cell, frame Map.
    void hit_point(const CellId id, float& x_m, float& y_m) const {
        const GridTile& t = tiles_[static_cast<std::size_t>(id >> 12)];
        const auto k = static_cast<std::size_t>(id & 4095);
        const Cell c = cell(id);
        x_m = geometry_.to_metres(static_cast<float>(c.ix) + 0.5F + static_cast<float>(t.hit_x[k]) / kOffsetUnits);
        y_m = geometry_.to_metres(static_cast<float>(c.iy) + 0.5F + static_cast<float>(t.hit_y[k]) / kOffsetUnits);
    }
    /// Distance from a point to the nearest hit, searched up to radius_m; radius_m if there is none.
    /// at_x_m and at_y_m receive the hit. Cost: at most (2 radius / cell)^2.
    [[nodiscard]] float clearance_m(float x_m, float y_m, float radius_m, float* at_x_m = nullptr, float* at_y_m = nullptr) const;
    /// True: the straight line between two points meets no occupied cell and no unknown one.
    [[nodiscard]] bool line_is_free(float x0_m, float y0_m, float x1_m, float y1_m) const;

    // Camera layer (camera_layer.cpp): floor within camera_range_m and camera_fov_rad of the front camera, in line of sight over free cells.
    /// What the camera sees from a pose is seen. integrate() does it every fourth sweep.
    void look(const Pose2<Map, Body>& pose);
    [[nodiscard]] bool camera_saw(const CellId id) const {
        return (tiles_[static_cast<std::size_t>(id >> 12)].camera[static_cast<std::size_t>((id >> 6) & 63)] >> static_cast<unsigned>(id & 63) & 1U) != 0U;
    }
    /// Floor that would be seen for the first time from there.
    [[nodiscard]] float unseen_in_view_m2(float x_m, float y_m, float yaw_rad) const;
    /// Free cells not yet seen in a block of 8 x 8 cells (slot, and 0 to 63 in the tile): where unseen floor lies.
    [[nodiscard]] std::int32_t unseen_in_block(std::int32_t slot, std::int32_t block) const;
    /// Of all free cells of all floors; walks over the whole map.
    [[nodiscard]] float camera_seen_fraction() const;

    [[nodiscard]] std::int32_t tile_count() const { return tile_count_; }
    [[nodiscard]] const GridTile& tile(const std::int32_t slot) const { return tiles_[static_cast<std::size_t>(slot)]; }
    [[nodiscard]] std::int32_t tile_slot(std::int32_t tile_x, std::int32_t tile_y) const { return tile_slot(floor_, tile_x, tile_y); }  ///< of the active floor; -1: none
    [[nodiscard]] std::int32_t tile_slot(std::int32_t floor, std::int32_t tile_x, std::int32_t tile_y) const;
    /// Tiles of a floor whose bit is not set wait until it is (what is not sure to be a floor is not published).
    void set_published_floors(const std::uint32_t bits) { published_floors_ = bits; }

    /// The next tile to publish, or nullptr. Call up to four times a step. Tiles in which a cell changed its class come
    /// first, in turn; those with other changes at most once every two seconds. Every change is published in the end.
    [[nodiscard]] const GridTile* take_changed_tile(std::int64_t t_us);

    [[nodiscard]] float known_area_m2() const;                        ///< of all floors
    [[nodiscard]] float known_area_m2(std::int32_t floor) const;      ///< of one, 0 to kMaxFloors - 1
    [[nodiscard]] std::uint32_t scans() const { return scans_; }
    [[nodiscard]] std::size_t touched_tiles() const { return touched_pages_; }   ///< by the last sweep

    struct Counters {
        std::uint32_t scans_refused = 0;
        std::uint32_t tiles_refused = 0;   ///< requests for a tile that the full pool could not serve
        std::uint32_t beams_used = 0;
    };
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    static constexpr float kOffsetUnits = 256.0F;   ///< hit offsets per cell edge
    static constexpr std::int8_t kNeverHit = -128;  ///< in hit_x: no beam ended in the cell since it was last sure to be free
    static constexpr std::uint64_t kEach = 0x0101010101010101ULL;
    static constexpr std::uint64_t kSigns = kEach << 7U;
    /// Bit k: the sign of byte k.
    [[nodiscard]] static constexpr std::uint32_t packed_signs(const std::uint64_t signs) {
        static_assert(std::endian::native == std::endian::little);
        return static_cast<std::uint32_t>(((signs >> 7U) * 0x0102040810204080ULL) >> 56U);
    }
    [[nodiscard]] CellClass class_of(const std::int8_t log_odds) const {
        if (log_odds >= occupied_) { return CellClass::occupied; }
        return log_odds <= free_ ? CellClass::free : CellClass::unknown;
    }
    [[nodiscard]] CellId neighbour_across(CellId id, std::int32_t i, std::int32_t j) const;
    [[nodiscard]] std::int32_t slot_or_lay(std::int32_t tile_x, std::int32_t tile_y);
    [[nodiscard]] std::int32_t lay(std::int32_t tile_x, std::int32_t tile_y);
    [[nodiscard]] CellId find_or_lay(const Cell c) {
        const std::int32_t slot = slot_or_lay(c.ix >> 6, c.iy >> 6);
        return slot < 0 ? kNoCell : id_in(slot, c);
    }
    template <class F> void each_in_view(float x_m, float y_m, float yaw_rad, F&& visit) const;
    /// Rows of a tile with a bit for each cell touched by the sweep being entered; nullptr: there was no page left.
    [[nodiscard]] std::uint64_t* touched_rows(std::int32_t slot);
    void load_parameters();
    static constexpr std::size_t kMaxFacet = 64;
    /// The beams of a sweep that end in one cell side by side. In cells.
    struct Facet {
        CellId id = kNoCell;
        Point2<Map> origin;
        Bounded<Point2<Map>, kMaxFacet> ends;
        bool dense = false;   ///< beams so close that noise is averaged out
        bool at_rim = false;  ///< it is at the first or the last beams of the sweep: how far its surface reaches is not known
        Point2<Map> before;   ///< if dense: what its surface goes on to on both sides
        Point2<Map> after;
        /// The point that it shows; true: one that stands out of it.
        [[nodiscard]] bool protrudes(float protrudes_cells, float corner_cells, Point2<Map>& shown) const;
    };
    [[nodiscard]] static std::size_t beyond(const LevelScan& scan, std::size_t from, bool after);
    void enter(const Facet& facet);
    void hit(CellId id, float x_cells, float y_cells, bool dense);
    struct Beam { float origin_x; float origin_y; float dir_x; float dir_y; float length; };   ///< in cells, direction of unit length
    struct Walk;
    [[nodiscard]] bool comes_before(CellId a, CellId b) const;
    void miss(CellId id, std::uint64_t* touched_rows, const Beam& beam, float end, float rise);
    [[nodiscard]] float open_range_m(const LevelScan& scan, std::size_t k);
    void touch(CellId id, CellClass before);
    void clear_along(const Beam& beam, float clear_to, float rise);
    void mark_along(const Beam& beam, float mark_from, float mark_to);

    const Parameters& p_;
    GridGeometry geometry_;
    std::array<GridTile, kMaxTiles> tiles_{};
    std::array<std::int16_t, kTileDirectory> directory_{};  ///< open addressing by tile coordinates; -1 empty
    std::int32_t tile_count_ = 0;
    std::int32_t floor_ = 0;
    std::uint32_t published_floors_ = ~0U;
    std::array<std::array<std::uint64_t, kTileCells>, kMaxTouchedTiles> touched_{};  ///< a bit a cell, row by row
    std::array<std::int16_t, kMaxTiles> touched_page_{};   ///< page of touched_, if touched_scan_ is this sweep
    std::array<std::uint32_t, kMaxTiles> touched_scan_{};
    std::size_t touched_pages_ = 0;
    std::int32_t cached_x_ = 0;       ///< tile found last while casting
    std::int32_t cached_y_ = 0;
    std::int32_t cached_slot_ = -1;
    std::size_t gap_from_ = 0;        ///< run of beams without return looked at last
    std::size_t gap_to_ = 0;
    bool gap_open_ = false;
    std::uint32_t gap_stamp_ = 0;
    std::int32_t publish_next_ = 0;
    std::array<std::int32_t, kMaxFloors> known_cells_{};
    std::uint32_t scans_ = 0;
    std::int8_t occupied_ = 8;
    std::int8_t free_ = -4;
    std::int32_t add_hit_ = 14;
    std::int32_t add_miss_ = 6;
    std::int32_t log_max_ = 80;
    std::int32_t log_min_ = -48;
    Counters counters_;
};

}  // namespace noctule
