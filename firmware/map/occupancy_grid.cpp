#include "map/occupancy_grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/length.hpp"
#include "sense/mean_range.hpp"

namespace noctule {

namespace {

constexpr float kUnitsPerNat = 16.0F;          ///< grid_tile_t's unit
constexpr float kPassesByCells = 0.25F;        ///< a beam farther than this from a cell's mean hit does not contradict it
constexpr float kGrazesCells = 3.0F;           ///< nor does one that ends within this behind it: it grazes the same wall
constexpr float kGrazesFarCells = 12.0F;       ///< nor one that ends within this behind it,
constexpr float kPassesFarByCells = 0.1F;      ///< unless it passes the mean hit nearer than this
constexpr float kHalfDiagonalCells = 0.75F;    ///< and what rounding may add
constexpr float kReachSlackCells = 0.02F;       ///< for rounding
constexpr float kLevelCells = 2.0F;            ///< a beam farther than this over or under the vehicle's plane does not contradict a hit
constexpr float kHitBandM = 0.5F;              ///< a hit farther than this over the vehicle's plane is not in the hull's way
constexpr float kTrend = 1.5F;                 ///< a wall's ranges grow faster than linearly with the beam
constexpr float kTrendSlackM = 0.05F;          ///< for noise
constexpr std::int32_t kGapBeams = 3;          ///< beams missing between two neighbours of a sweep
constexpr std::int64_t kRepublishUs = 2000000; ///< scans between publications of a tile whose classes stand still
constexpr std::uint32_t kCameraEvery = 4;      ///< a power of two: 20 sweeps and 5 images a second
constexpr std::uint32_t kRefreshScans = 128;   ///< a power of two
constexpr float kGain = 0.25F;                ///< by which the mean hit of a cell follows a facet
constexpr float kSureGain = 0.06F;            ///< the same where the cell is all but sure and the ends are scattered
constexpr std::size_t kRimBeams = 4;           ///< at both ends of a sweep: noise may put the last end into another cell
constexpr std::size_t kDenseSide = 2;          ///< beams over which the ends are averaged to either side, from where what protrudes stands out of the noise
constexpr std::int32_t kGeometryStep = 10;     ///< move of a mean hit (1/256 cell) that makes clearances stale

std::size_t hash_of(const std::int32_t tile_x, const std::int32_t tile_y, const std::int32_t floor) {
    const std::uint32_t h = static_cast<std::uint32_t>(tile_x) * 0x9E3779B1U ^ static_cast<std::uint32_t>(tile_y) * 0x85EBCA77U ^
                            static_cast<std::uint32_t>(floor) * 0xC2B2AE35U;
    return (h ^ (h >> 15U)) & (kTileDirectory - 1U);
}

bool is_touched(const std::uint64_t* const rows, const CellId id) {
    return rows != nullptr && (rows[(id >> 6) & 63] >> static_cast<unsigned>(id & 63) & 1U) != 0U;
}

void mark_touched(std::uint64_t* const rows, const CellId id) {
    if (rows != nullptr) { rows[(id >> 6) & 63] |= std::uint64_t{1} << static_cast<unsigned>(id & 63); }
}

std::int32_t units(const float nats) { return static_cast<std::int32_t>(std::lround(nats * kUnitsPerNat)); }

std::size_t block_of(const CellId id) { return static_cast<std::size_t>(((id >> 9) & 7) * 8 + ((id >> 3) & 7)); }

}  // namespace

static_assert((kTileDirectory & (kTileDirectory - 1U)) == 0U && kTileDirectory > 2U * kMaxTiles, "open addressing needs room");

OccupancyGrid::OccupancyGrid(const Parameters& parameters) : p_(parameters), geometry_(parameters.grid_cell_m) {
    directory_.fill(-1);
    load_parameters();
}

void OccupancyGrid::load_parameters() {
    occupied_ = static_cast<std::int8_t>(std::max<std::int32_t>(1, units(p_.grid_occupied_log_odds)));
    free_ = static_cast<std::int8_t>(std::min<std::int32_t>(-1, units(p_.grid_free_log_odds)));
    add_hit_ = std::max<std::int32_t>(1, units(p_.grid_hit_log_odds));
    add_miss_ = std::max<std::int32_t>(1, units(p_.grid_miss_log_odds));
    log_max_ = std::min<std::int32_t>(127, units(p_.grid_log_odds_max));
    log_min_ = std::max<std::int32_t>(-127, units(p_.grid_log_odds_min));
}

void OccupancyGrid::reset() {
    directory_.fill(-1);
    tile_count_ = 0;
    cached_slot_ = -1;
    publish_next_ = 0;
    floor_ = 0;
    known_cells_.fill(0);
    touched_scan_.fill(0);
}

bool OccupancyGrid::select_floor(const std::int32_t floor) {
    if (floor < 0 || floor >= kMaxFloors) { return false; }
    floor_ = floor;
    cached_slot_ = -1;
    return true;
}

// A sweep reaches some 25 tiles; should it ever touch more than there are pages for, the rest forgets that it was touched.
std::uint64_t* OccupancyGrid::touched_rows(const std::int32_t slot) {
    const auto k = static_cast<std::size_t>(slot);
    if (touched_scan_[k] != scans_) {
        if (touched_pages_ == kMaxTouchedTiles) { return nullptr; }
        touched_scan_[k] = scans_;
        touched_page_[k] = static_cast<std::int16_t>(touched_pages_);
        touched_[touched_pages_].fill(0);
        ++touched_pages_;
    }
    return touched_[static_cast<std::size_t>(touched_page_[k])].data();
}

std::int32_t OccupancyGrid::tile_slot(const std::int32_t floor, const std::int32_t tile_x, const std::int32_t tile_y) const {
    for (std::size_t at = hash_of(tile_x, tile_y, floor);; at = (at + 1U) & (kTileDirectory - 1U)) {
        const std::int32_t slot = directory_[at];
        if (slot < 0) { return -1; }
        const GridTile& t = tiles_[static_cast<std::size_t>(slot)];
        if (t.tile_x == tile_x && t.tile_y == tile_y && t.floor == floor) { return slot; }
    }
}

// Neighbour of a cell at the rim of its tile; i and j are its column and row counted from that tile.
CellId OccupancyGrid::neighbour_across(const CellId id, const std::int32_t i, const std::int32_t j) const {
    const std::int32_t dx = i < 0 ? -1 : (i >> 6);
    const std::int32_t dy = j < 0 ? -1 : (j >> 6);
    std::int32_t toward = 0;
    while (kNeighbourX[toward] != dx || kNeighbourY[toward] != dy) { ++toward; }
    const std::int32_t slot = tiles_[static_cast<std::size_t>(id >> 12)].neighbour[static_cast<std::size_t>(toward)];
    return slot < 0 ? kNoCell : id_in(slot, {i, j});
}

// The tile with these coordinates, laid down if it is new; -1: the pool is full.
std::int32_t OccupancyGrid::slot_or_lay(const std::int32_t tile_x, const std::int32_t tile_y) {
    if (cached_slot_ >= 0 && tile_x == cached_x_ && tile_y == cached_y_) { return cached_slot_; }
    std::int32_t slot = tile_slot(tile_x, tile_y);
    if (slot < 0) { slot = lay(tile_x, tile_y); }
    if (slot < 0) { return -1; }
    cached_x_ = tile_x;
    cached_y_ = tile_y;
    cached_slot_ = slot;
    return slot;
}

std::int32_t OccupancyGrid::lay(const std::int32_t tile_x, const std::int32_t tile_y) {
    if (tile_count_ == static_cast<std::int32_t>(kMaxTiles)) {
        ++counters_.tiles_refused;
        return -1;
    }
    const std::int32_t slot = tile_count_++;
    GridTile& t = tiles_[static_cast<std::size_t>(slot)];
    t.tile_x = tile_x;
    t.tile_y = tile_y;
    t.floor = floor_;
    t.log_odds.fill(0);
    t.hit_x.fill(kNeverHit);
    t.hit_y.fill(0);
    t.camera.fill(0);
    for (std::uint16_t& v : t.version) { ++v; }
    t.class_changed = t.value_changed = false;
    t.published_us = -1;
    std::size_t at = hash_of(tile_x, tile_y, floor_);
    while (directory_[at] >= 0) { at = (at + 1U) & (kTileDirectory - 1U); }
    directory_[at] = static_cast<std::int16_t>(slot);
    for (std::int32_t d = 0; d < 8; ++d) {
        const std::int32_t other = tile_slot(tile_x + kNeighbourX[d], tile_y + kNeighbourY[d]);
        t.neighbour[static_cast<std::size_t>(d)] = other;
        if (other >= 0) { tiles_[static_cast<std::size_t>(other)].neighbour[static_cast<std::size_t>((d + 4) & 7)] = slot; }
    }
    return slot;
}

void OccupancyGrid::touch(const CellId id, const CellClass before) {
    GridTile& t = tiles_[static_cast<std::size_t>(id >> 12)];
    t.value_changed = true;
    const CellClass after = cell_class(id);
    if (after == before) { return; }
    t.class_changed = true;
    ++t.version[block_of(id)];
    std::int32_t& known = known_cells_[static_cast<std::size_t>(t.floor)];
    if (before == CellClass::unknown) { ++known; }
    if (after == CellClass::unknown) { --known; }
}

// Section G, "occupied": the cell in which the beams of a facet end. The mean hit follows the facets, with a gain that falls as the cell
// becomes sure, so that clearances come from measured points and not from the square of the cell.
void OccupancyGrid::hit(const CellId id, const float x_cells, const float y_cells, const bool dense) {
    GridTile& t = tiles_[static_cast<std::size_t>(id >> 12)];
    const auto k = static_cast<std::size_t>(id & 4095);
    const Cell c = cell(id);
    const float dx = (x_cells - static_cast<float>(c.ix) - 0.5F) * kOffsetUnits;
    const float dy = (y_cells - static_cast<float>(c.iy) - 0.5F) * kOffsetUnits;
    const bool fresh = t.log_odds[k] <= 0 || t.hit_x[k] == kNeverHit;
    // Scattered ends move a sure cell's mean along the wall, to and fro: a little only, and not at all once dense ones have told it.
    const float scattered = t.log_odds[k] < log_max_ - 1 ? kGain : (t.log_odds[k] < log_max_ ? kSureGain : 0.0F);
    const float gain = fresh ? 1.0F : (dense ? kGain : scattered);
    const float old_x = static_cast<float>(t.hit_x[k]);
    const float old_y = static_cast<float>(t.hit_y[k]);
    const std::int32_t new_x = round_int(fresh ? dx : old_x + gain * (dx - old_x));
    const std::int32_t new_y = round_int(fresh ? dy : old_y + gain * (dy - old_y));
    const bool moved = std::abs(new_x - t.hit_x[k]) > kGeometryStep || std::abs(new_y - t.hit_y[k]) > kGeometryStep;
    t.hit_x[k] = static_cast<std::int8_t>(std::clamp<std::int32_t>(new_x, -127, 127));
    t.hit_y[k] = static_cast<std::int8_t>(std::clamp<std::int32_t>(new_y, -127, 127));
    // Large moves make the clearances round the block stale at once; slow drift is taken up every kRefreshScans, blocks in turn.
    const std::size_t block = block_of(id);
    const bool turn = (scans_ & (kRefreshScans - 1U)) == ((static_cast<std::uint32_t>(block) * 37U + static_cast<std::uint32_t>(id >> 12)) & (kRefreshScans - 1U));
    if (moved || turn) { ++t.version[block]; }
    std::uint64_t* const rows = touched_rows(id >> 12);
    if (is_touched(rows, id)) { return; }  // the evidence of a sweep counts once; its points all count for the mean
    mark_touched(rows, id);
    const CellClass before = class_of(t.log_odds[k]);
    t.log_odds[k] = static_cast<std::int8_t>(std::max<std::int32_t>(t.log_odds[k], std::min(t.log_odds[k] + add_hit_, dense ? log_max_ : log_max_ - 1)));
    touch(id, before);
}

// Section G, "free": the cells that a beam crosses before its end.
void OccupancyGrid::miss(const CellId id, std::uint64_t* const rows, const Beam& beam, const float end, const float rise) {
    GridTile& t = tiles_[static_cast<std::size_t>(id >> 12)];
    const auto k = static_cast<std::size_t>(id & 4095);
    const std::int8_t l = t.log_odds[k];
    if (l <= log_min_) {
        mark_touched(rows, id);
        return;
    }
    const CellClass before = class_of(l);
    if (t.hit_x[k] != kNeverHit) {
        // A wall fills a part of its cell only: a beam through the other part says nothing about it. Also where the cell does not
        // count as occupied (yet): else cells at the very edge of a wall wander between the classes.
        const Cell c = cell(id);
        const float hx = static_cast<float>(c.ix) + 0.5F + static_cast<float>(t.hit_x[k]) / kOffsetUnits - beam.origin_x;
        const float hy = static_cast<float>(c.iy) + 0.5F + static_cast<float>(t.hit_y[k]) / kOffsetUnits - beam.origin_y;
        const float aside = std::fabs(hx * beam.dir_y - hy * beam.dir_x);
        const float along = hx * beam.dir_x + hy * beam.dir_y;
        const float behind = end - along;
        if (std::fabs(rise * along) > kLevelCells) { return; }  // it passed over or under what stands there
        if (aside > kPassesByCells || behind < kGrazesCells || (behind < kGrazesFarCells && aside > kPassesFarByCells)) { return; }
    }
    mark_touched(rows, id);
    t.log_odds[k] = static_cast<std::int8_t>(std::max(l - add_miss_, log_min_));
    if (t.log_odds[k] == log_min_) { t.hit_x[k] = kNeverHit; }
    touch(id, before);
}

/// A walk over the cells along a beam, from its origin (Amanatides and Woo 1987).
struct OccupancyGrid::Walk {
    explicit Walk(const Beam& beam) : ix(floor_int(beam.origin_x)), iy(floor_int(beam.origin_y)), step_x(beam.dir_x > 0.0F ? 1 : -1), step_y(beam.dir_y > 0.0F ? 1 : -1) {
        const auto to_edge = [](const float at, const std::int32_t cell, const std::int32_t step) {
            return step > 0 ? static_cast<float>(cell + 1) - at : at - static_cast<float>(cell);
        };
        if (std::fabs(beam.dir_x) > 1e-7F) {
            per_x = 1.0F / std::fabs(beam.dir_x);
            next_x = to_edge(beam.origin_x, ix, step_x) * per_x;
        }
        if (std::fabs(beam.dir_y) > 1e-7F) {
            per_y = 1.0F / std::fabs(beam.dir_y);
            next_y = to_edge(beam.origin_y, iy, step_y) * per_y;
        }
    }
    void step() {
        if (next_x < next_y) {
            entered = next_x;
            next_x += per_x;
            ix += step_x;
        } else {
            entered = next_y;
            next_y += per_y;
            iy += step_y;
        }
    }
    /// How far along the beam the cell's centre lies: never less than that of the cell before, at most half a diagonal past `entered`.
    [[nodiscard]] float centre_along(const Beam& beam, const Cell counted_from = {}) const {
        return (static_cast<float>(counted_from.ix + ix) + 0.5F - beam.origin_x) * beam.dir_x + (static_cast<float>(counted_from.iy + iy) + 0.5F - beam.origin_y) * beam.dir_y;
    }

    static constexpr float kFar = 1e9F;
    std::int32_t ix;
    std::int32_t iy;
    std::int32_t step_x;
    std::int32_t step_y;
    float per_x = kFar;
    float per_y = kFar;
    float next_x = kFar;
    float next_y = kFar;
    float entered = 0.0F;   ///< how far along the beam the cell begins
};

// Cells whose centre, projected on the beam, lies before `clear_to` are crossed. Most of them a beam beside this one has entered already.
void OccupancyGrid::clear_along(const Beam& beam, const float clear_to, const float rise) {
    static constexpr std::array<std::uint64_t, kTileCells> kUntouched{};
    Walk at{beam};
    Cell corner{at.ix - kTileCells, at.iy};   // of the tile that the beam is in: the walk counts its cells from there
    at.ix = kTileCells;                       // not in one yet
    at.iy = 0;
    std::int32_t slot = -1;
    std::uint64_t* rows = nullptr;
    const std::uint64_t* done = kUntouched.data();
    const float surely = std::min(clear_to - kHalfDiagonalCells, beam.length);
    for (; at.entered < surely || (at.entered <= beam.length && at.centre_along(beam, corner) < clear_to); at.step()) {
        if (static_cast<std::uint32_t>(at.ix | at.iy) >= static_cast<std::uint32_t>(kTileCells)) {
            const Cell c{corner.ix + at.ix, corner.iy + at.iy};
            at.ix = c.ix & 63;
            at.iy = c.iy & 63;
            corner = {c.ix - at.ix, c.iy - at.iy};
            slot = slot_or_lay(c.ix >> 6, c.iy >> 6);
            rows = slot < 0 ? nullptr : touched_rows(slot);
            done = rows == nullptr ? kUntouched.data() : rows;
        }
        if ((done[at.iy] >> static_cast<unsigned>(at.ix) & 1U) != 0U) { continue; }
        if (slot >= 0) { miss(id_in(slot, {at.ix, at.iy}), rows, beam, clear_to, rise); }
    }
}

// Cells whose centre lies between `mark_from` and `mark_to` are occupied (obstacle thickness over one cell).
void OccupancyGrid::mark_along(const Beam& beam, const float mark_from, const float mark_to) {
    for (Walk at{beam}; at.entered <= beam.length; at.step()) {
        const float along = at.centre_along(beam);
        if (along < mark_from || along > mark_to) { continue; }
        const CellId id = find_or_lay({at.ix, at.iy});
        if (id != kNoCell) { hit(id, static_cast<float>(at.ix) + 0.5F, static_cast<float>(at.iy) + 0.5F, true); }
    }
}

void OccupancyGrid::integrate(const Estimate& estimate, const LevelScan& scan) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    const float height = estimate.altitude.z_m - estimate.altitude.floor_z_m - p_.cruise_height_m;
    const bool pose_good = estimate.planar.quality >= 0 && std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.yaw_rad);
    if (!pose_good || !estimate.altitude.valid || !(std::fabs(height) <= p_.grid_height_band_m)) {
        ++counters_.scans_refused;
        return;
    }
    load_parameters();
    ++scans_;
    touched_pages_ = 0;
    const float c = std::cos(pose.yaw_rad);
    const float s = std::sin(pose.yaw_rad);
    const float range_max = geometry_.to_cells(p_.grid_range_max_m);
    const float half = 0.5F * geometry_.to_cells(p_.obstacle_thickness_m);
    const auto origin = [&](const ScanPoint& p) {
        return Point2<Map>{geometry_.to_cells(pose.x_m + c * p.origin_x_m - s * p.origin_y_m),
                           geometry_.to_cells(pose.y_m + s * p.origin_x_m + c * p.origin_y_m)};
    };
    const auto beam_to = [](const Point2<Map>& o, const float ex, const float ey) {
        const float dx = ex - o.x_m;
        const float dy = ey - o.y_m;
        const float length = length_of(dx, dy);
        return Beam{o.x_m, o.y_m, dx / length, dy / length, length > 1e-3F ? length : -1.0F};
    };
    const auto end = [&](const ScanPoint& p) {
        return Point2<Map>{geometry_.to_cells(pose.x_m + c * p.x_m - s * p.y_m), geometry_.to_cells(pose.y_m + s * p.x_m + c * p.y_m)};
    };
    const auto mean_end = [&](const std::size_t k, const float mean_m) {
        const ScanPoint& p = scan.points[k];
        const Point2<Map> o = origin(p);
        const Point2<Map> raw = end(p);
        const float share = mean_m / std::max(p.range_m, 1e-3F);
        return Point2<Map>{o.x_m + share * (raw.x_m - o.x_m), o.y_m + share * (raw.y_m - o.y_m)};
    };
    Facet facet;
    std::size_t first = 0;
    std::size_t last = 0;
    const auto finish = [&]() {
        facet.at_rim = first < kRimBeams || last + kRimBeams >= scan.points.size();
        if (facet.dense) {
            const std::size_t before = beyond(scan, first, false);
            const std::size_t after = beyond(scan, last, true);
            facet.before = mean_end(before, mean_range(scan, before).range_m);
            facet.after = mean_end(after, mean_range(scan, after).range_m);
        }
        enter(facet);
    };
    // Hits first: a cell in which any beam of the sweep ended is not cleared by its neighbours in the same sweep.
    for (std::size_t k = 0; k < scan.points.size(); ++k) {
        const ScanPoint& p = scan.points[k];
        if (!p.hit) { continue; }
        const Point2<Map> o = origin(p);
        const MeanRange mean = mean_range(scan, k);
        const Point2<Map> e = mean_end(k, mean.range_m);
        const float length = length_of(e.x_m - o.x_m, e.y_m - o.y_m);
        if (!(length <= range_max)) { continue; }  // too far, or not a number
        ++counters_.beams_used;
        if (half > 0.5F) {
            const float stretch = (length + half) / std::max(length, 1e-3F);
            mark_along(beam_to(o, o.x_m + (e.x_m - o.x_m) * stretch, o.y_m + (e.y_m - o.y_m) * stretch), length - half, length + half);
        } else {
            const CellId id = find_or_lay({floor_int(e.x_m), floor_int(e.y_m)});
            // A door's lintel, met by a tilted beam, does not close the door that level beams went through.
            const bool other_height = p.z_m > kHitBandM && cell_class(id) == CellClass::free;
            if (id == kNoCell || other_height) { continue; }
            if (id != facet.id || facet.ends.full()) {
                finish();
                first = k;
                facet.id = id;
                facet.origin = o;
                facet.dense = mean.side >= kDenseSide;
                facet.ends.clear();
            }
            static_cast<void>(facet.ends.push(e));
            last = k;
        }
    }
    finish();
    for (std::size_t k = 0; k < scan.points.size(); ++k) {
        const ScanPoint& p = scan.points[k];
        const Point2<Map> o = origin(p);
        const Point2<Map> e = end(p);
        const float length = length_of(e.x_m - o.x_m, e.y_m - o.y_m);
        if (!std::isfinite(length) || length < 1e-3F) { continue; }
        float clear_to = std::min(length - std::max(half, 0.5F), range_max);
        if (!p.hit) {
            clear_to = std::min(open_range_m(scan, k), p_.grid_range_max_m);
            clear_to = geometry_.to_cells(clear_to);
        }
        if (!(clear_to > 0.0F)) { continue; }
        const float cut = std::min(1.0F, (clear_to + 1.0F) / length);
        clear_along(beam_to(o, o.x_m + (e.x_m - o.x_m) * cut, o.y_m + (e.y_m - o.y_m) * cut), clear_to, geometry_.to_cells(p.z_m) / length);
    }
    cached_slot_ = -1;
    if ((scans_ & (kCameraEvery - 1U)) == 0U) { look(pose); }
}

// How far a beam without return may clear: 0 unless the returns on both sides of the gap come from near the greatest range and are
// about to leave it, as those of a hall or corridor that goes on do; then up to the chord between them, so that a flat pane between two frames stays
// unknown. docs/maths/grid.md, "no return".
float OccupancyGrid::open_range_m(const LevelScan& scan, const std::size_t k) {
    const auto& points = scan.points;
    if (!(p_.no_return_open > 0.0F)) { return scan.range_max_m; }
    if (!(p_.no_return_open <= 1.0F)) { return 0.0F; }
    if (gap_stamp_ != scans_ || k < gap_from_ || k >= gap_to_) {
        gap_stamp_ = scans_;
        gap_from_ = k;
        while (gap_from_ > 0U && !points[gap_from_ - 1U].hit) { --gap_from_; }
        gap_to_ = k + 1U;
        while (gap_to_ < points.size() && !points[gap_to_].hit) { ++gap_to_; }
        gap_open_ = false;
        if (gap_from_ > 0U && gap_to_ < points.size()) {
            const ScanPoint& a = points[gap_from_ - 1U];
            const ScanPoint& b = points[gap_to_];
            // A wall that goes on out of range leaves it by a trend: at that pace the next beam would have missed. A wall across
            // that only something dark hides does not.
            const auto leaves = [&](const std::size_t last, const std::size_t before) {
                const ScanPoint& p = points[last];
                const ScanPoint& q = points[before];
                return p.range_m >= p_.no_return_open * scan.range_max_m && q.hit && std::abs(p.beam - q.beam) <= kGapBeams &&
                       p.range_m + kTrend * (p.range_m - q.range_m) >= scan.range_max_m - kTrendSlackM;
            };
            gap_open_ = points[gap_from_].beam - a.beam <= kGapBeams && b.beam - points[gap_to_ - 1U].beam <= kGapBeams && gap_from_ > 1U &&
                        gap_to_ + 1U < points.size() && leaves(gap_from_ - 1U, gap_from_ - 2U) && leaves(gap_to_, gap_to_ + 1U);
        }
    }
    if (!gap_open_) { return 0.0F; }
    const ScanPoint& a = points[gap_from_ - 1U];
    const ScanPoint& b = points[gap_to_];
    const ScanPoint& p = points[k];
    // Where the beam crosses the line from a to b, all seen from the place of the vehicle.
    const float ux = p.x_m - p.origin_x_m;
    const float uy = p.y_m - p.origin_y_m;
    const float length = std::hypot(ux, uy);
    const float ex = b.x_m - a.x_m;
    const float ey = b.y_m - a.y_m;
    const float det = ux * ey - uy * ex;
    if (std::fabs(det) < 1e-6F) { return 0.0F; }
    const float along = ((a.x_m - p.origin_x_m) * ey - (a.y_m - p.origin_y_m) * ex) / det;
    return std::clamp(along, 0.0F, 1.0F) * length;
}

float OccupancyGrid::clearance_m(const float x_m, const float y_m, const float radius_m, float* const at_x_m, float* const at_y_m) const {
    const Cell centre = geometry_.cell(x_m, y_m);
    const float x = geometry_.to_cells(x_m);
    const float y = geometry_.to_cells(y_m);
    float reach = geometry_.to_cells(radius_m) + kReachSlackCells;   // what is nearer than the best lies in cells that this circle meets
    float best = radius_m * radius_m;
    CellId nearest = kNoCell;
    Cell tile{std::numeric_limits<std::int32_t>::min(), 0};
    std::int32_t slot = -1;
    // Rows from the middle outwards, eight cells at a time; those outside the circle are masked.
    for (std::int32_t turn = 1; static_cast<float>(turn / 2 - 1) <= reach; ++turn) {
        const std::int32_t iy = centre.iy + ((turn & 1) != 0 ? turn / 2 : -(turn / 2));
        const float aside = std::max({static_cast<float>(iy) - y, y - static_cast<float>(iy + 1), 0.0F});
        if (aside > reach) { continue; }
        const float half = std::sqrt(reach * reach - aside * aside);
        const std::int32_t x0 = floor_int(x - half);
        const std::int32_t x1 = floor_int(x + half);
        for (std::int32_t x8 = x0 & ~7; x8 <= x1; x8 += 8) {
            if (const Cell at{x8 >> 6, iy >> 6}; !(at == tile)) {
                tile = at;
                slot = tile_slot(at.ix, at.iy);
            }
            if (slot < 0) { continue; }
            const CellId id8 = id_in(slot, {x8, iy});
            std::uint32_t left = classes_of_eight(id8).occupied;
            if (left == 0U) { continue; }
            if (x8 < x0) { left &= 0xFFU << static_cast<unsigned>(x0 - x8); }
            if (x8 + 7 > x1) { left &= 0xFFU >> static_cast<unsigned>(x8 + 7 - x1); }
            for (; left != 0U; left &= left - 1U) {
                const CellId id = id8 + std::countr_zero(left);
                float hx = 0.0F;
                float hy = 0.0F;
                hit_point(id, hx, hy);
                const float d2 = (hx - x_m) * (hx - x_m) + (hy - y_m) * (hy - y_m);
                if (!(d2 < best) && !(d2 == best && nearest != kNoCell && comes_before(id, nearest))) { continue; }
                best = d2;
                nearest = id;
                if (at_x_m != nullptr) { *at_x_m = hx; }
                if (at_y_m != nullptr) { *at_y_m = hy; }
            }
        }
        if (nearest != kNoCell) { reach = geometry_.to_cells(std::sqrt(best)) + kReachSlackCells; }
    }
    return std::sqrt(best);
}

// Of two hits equally far the one in the lower row counts, then the one farther left.
bool OccupancyGrid::comes_before(const CellId a, const CellId b) const {
    const Cell ca = cell(a);
    const Cell cb = cell(b);
    return ca.iy != cb.iy ? ca.iy < cb.iy : ca.ix < cb.ix;
}

bool OccupancyGrid::line_is_free(const float x0_m, const float y0_m, const float x1_m, const float y1_m) const {
    const float length = std::hypot(x1_m - x0_m, y1_m - y0_m);
    const auto steps = static_cast<std::int32_t>(std::ceil(geometry_.to_cells(length) * 2.0F)) + 1;
    for (std::int32_t k = 0; k <= steps; ++k) {
        const float f = static_cast<float>(k) / static_cast<float>(steps);
        if (cell_class(find(x0_m + f * (x1_m - x0_m), y0_m + f * (y1_m - y0_m))) != CellClass::free) { return false; }
    }
    return true;
}

const GridTile* OccupancyGrid::take_changed_tile(const std::int64_t t_us) {
    for (int urgent = 1; urgent >= 0; --urgent) {
        for (std::int32_t k = 0; k < tile_count_; ++k) {
            const std::int32_t slot = (publish_next_ + k) % tile_count_;
            GridTile& t = tiles_[static_cast<std::size_t>(slot)];
            if (!t.value_changed || t.published_us == t_us || (published_floors_ >> static_cast<unsigned>(t.floor) & 1U) == 0U) { continue; }
            if (urgent == 1 ? !t.class_changed : t_us - t.published_us < kRepublishUs) { continue; }
            t.class_changed = t.value_changed = false;
            t.published_us = t_us;
            publish_next_ = (slot + 1) % tile_count_;
            return &t;
        }
    }
    return nullptr;
}

float OccupancyGrid::known_area_m2() const {
    float sum_m2 = 0.0F;
    for (std::int32_t floor = 0; floor < kMaxFloors; ++floor) { sum_m2 += known_area_m2(floor); }
    return sum_m2;
}

float OccupancyGrid::known_area_m2(const std::int32_t floor) const {
    return static_cast<float>(known_cells_[static_cast<std::size_t>(floor)]) * geometry_.cell_m() * geometry_.cell_m();
}

}  // namespace noctule
