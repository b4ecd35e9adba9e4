/// The edge of the unknown: free cells beside unknown ones, in groups, each with the cheapest place to look into it from.
///
/// docs/maths/explore.md. A pass over the map is cut into slices: scan the tiles, gather groups, find their viewpoints.
/// A group that no reachable place can look into is a sliver and is left out. Frame Map. No heap.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/traversability.hpp"

namespace noctule {

/// A group of frontier cells.
struct Frontier {
    CellId look = kNoCell;    ///< the free cell that the viewpoint sees, unknown behind it
    float x_m = 0.0F;         ///< that cell
    float y_m = 0.0F;
    CellId view = kNoCell;    ///< passable cell from which it is seen
    float view_x_m = 0.0F;
    float view_y_m = 0.0F;
    std::uint32_t cost = CostField::kFar;  ///< of the way to the viewpoint from the root of the field
    CellId sight = kNoCell;   ///< cheapest cell from which it is seen from afar: what the order counts with
    float sight_x_m = 0.0F;
    float sight_y_m = 0.0F;
    std::uint32_t sight_cost = CostField::kFar;
    std::int32_t cells = 0;   ///< size of the group
    void sight_as_view() {
        sight = view;
        sight_x_m = view_x_m;
        sight_y_m = view_y_m;
        sight_cost = cost;
    }
    bool camera = false;      ///< a patch of floor that the camera has not seen (plan/unseen), not an edge of the unknown
    bool sounding = false;    ///< a place to pass in search of openings (plan/soundings), not an edge of the unknown
    std::int32_t behind = 0;  ///< unknown cells that hang together behind it, within kBehindCells of its middle
};

/// All that is unknown behind a stop [m^2].
[[nodiscard]] inline float behind_m2(const Parameters& p, const Frontier& f) { return p.grid_cell_m * p.grid_cell_m * static_cast<float>(f.behind); }

/// What a stop will reveal [m^2]: all that is unknown behind it, but a pocket is not much deeper than its mouth is wide.
[[nodiscard]] inline float reveals_m2(const Parameters& p, const Frontier& f) {
    constexpr float kDepth = 2.0F;   // area of a pocket over the square of its mouth
    const float mouth_m = p.grid_cell_m * static_cast<float>(f.cells);
    return std::min(behind_m2(p, f), kDepth * mouth_m * mouth_m);
}

/// What a stop leaves unknown while it is not visited [m^2]: a door seen at a slant is a narrow mouth with a room behind it, so what it seems to reveal
/// and all that is unknown behind it count alike (their geometric mean).
[[nodiscard]] inline float leaves_m2(const Parameters& p, const Frontier& f) { return std::sqrt(reveals_m2(p, f) * behind_m2(p, f)); }

/// What makes a good viewpoint, and which groups are looked for.
struct ViewRule {
    float distance_cost = 0.6F;   ///< metres of way that a metre less of viewing distance is worth
    float tight_cost = 1.2F;      ///< metres of way that a viewpoint with room round it is worth, times its slowness over one
    float sight_m = 0.0F;         ///< distance from which a group counts as seen for the order; 0: that of the viewpoint
    float near_m = 0.0F;          ///< over 0: a viewpoint farther than this only where there is none nearer
    float small_m2 = 0.0F;        ///< a group that may reveal less than this leads nowhere: near_small_m holds for it
    float near_small_m = 0.0F;
    bool camera = false;          ///< patches of floor that the camera has not seen are looked for, too
    bool soundings = false;       ///< places to pass in search of openings are looked for, too
    bool fine = false;            ///< lines of sight as long as the laser's in the grid, and kFineParts times as close: a narrow door far off lies between two others
    std::int32_t behind_min = 0;  ///< groups with fewer unknown cells behind them are left out
};

/// Places that were looked at in vain.
class TriedPlaces {
public:
    explicit TriedPlaces(const Parameters& parameters) : p_(parameters) {}
    void clear() { entries_.clear(); }
    /// A look from `view_distance_m` away showed nothing new.
    void add(float x_m, float y_m, float view_distance_m, std::int64_t t_us);
    /// The way there did not lead on: left alone at once for a round.
    void give_up(const float x_m, const float y_m, const float view_distance_m, const std::int64_t t_us) {
        do { add(x_m, y_m, view_distance_m, t_us); } while (distance_allowed_m(x_m, y_m, t_us) > 0.0F);
    }
    /// Greatest distance from which to try next; 0: leave it alone now.
    [[nodiscard]] float distance_allowed_m(float x_m, float y_m, std::int64_t t_us) const;
    /// Looks that were in vain there.
    [[nodiscard]] std::int32_t tries(float x_m, float y_m) const;
    [[nodiscard]] std::size_t size() const { return entries_.size(); }

private:
    struct Entry { float x_m; float y_m; float distance_m; std::int32_t tries; std::int64_t until_us; };
    const Parameters& p_;
    Bounded<Entry, kMaxTriedPlaces> entries_;
};

class FrontierSearch {
public:
    explicit FrontierSearch(const Parameters& parameters);

    void start();
    /// One slice; true: the pass is complete and found() holds it.
    bool run(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried, const ViewRule& rule,
             float home_x_m, float home_y_m, std::int64_t t_us);
    [[nodiscard]] const Bounded<Frontier, kMaxFrontiers>& found() const { return found_; }
    /// One more place worth a visit, found elsewhere; full: it is left out.
    void add(Frontier f) {
        f.sight_as_view();
        static_cast<void>(found_.push(f));
    }
    /// Groups of the last pass that are large enough but that nothing reachable can look into.
    [[nodiscard]] std::int32_t slivers() const { return slivers_; }
    [[nodiscard]] std::size_t cells() const { return cells_.size(); }   ///< at the edge, of the pass under way

    /// True: the cell is free and has an unknown neighbour across an edge.
    [[nodiscard]] static bool is_frontier(const OccupancyGrid& grid, CellId id);

private:
    static constexpr std::int32_t kRays = 96;         ///< lines of sight from a frontier cell
    static constexpr std::int32_t kFineParts = 4;     ///< ViewRule::fine: lines in place of one
    static constexpr std::int32_t kFineGroups = 12;   ///< and groups that one counts as in a slice: its lines are longer, too
    static constexpr std::int32_t kTilesPerSlice = 24;
    static constexpr std::int32_t kGroupsPerSlice = 24;
    static constexpr std::int32_t kGroupRadius = 7;   ///< cells from the first one of a group; wider edges are several groups
    static constexpr std::size_t kGroupCells = 256;
    static constexpr std::int32_t kBehindCells = 12;  ///< half edge of the square in which the unknown behind a group is counted
    /// What counts as a viewpoint, in the order of trying.
    enum class Round : std::uint8_t {
        clear,         ///< a passable cell, nothing occupied on the line of sight
        past_corners,  ///< the line may cross occupied cells, passing their hit points
        edge,          ///< and the hull may stand over the edge of the unknown
    };
    void scan_tile(const OccupancyGrid& grid, std::int32_t slot);
    void gather(const OccupancyGrid& grid, CellId seed);
    [[nodiscard]] std::int32_t unknown_behind(const OccupancyGrid& grid) const;
    bool view(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const ViewRule& rule, float distance_m, CellId look,
              Frontier& best, float home_x_m, float home_y_m, Round round, std::int32_t tries) const;
    [[nodiscard]] bool marked(const CellId id) const {
        return (marks_[static_cast<std::size_t>(id >> 12)][static_cast<std::size_t>((id >> 6) & 63)] >> static_cast<unsigned>(id & 63) & 1U) != 0U;
    }
    void mark(const CellId id, const bool on) {
        std::uint64_t& word = marks_[static_cast<std::size_t>(id >> 12)][static_cast<std::size_t>((id >> 6) & 63)];
        const std::uint64_t bit = std::uint64_t{1} << static_cast<unsigned>(id & 63);
        word = on ? (word | bit) : (word & ~bit);
    }
    void keep(const Frontier& f);

    const Parameters& p_;
    std::array<float, kRays> ray_x_{};
    std::array<float, kRays> ray_y_{};
    std::array<std::array<std::uint64_t, kTileCells>, kMaxTiles> marks_{};
    Bounded<CellId, kMaxFrontierCells> cells_;
    Bounded<CellId, kGroupCells> group_;
    Bounded<Frontier, kMaxFrontiers> found_;
    std::int32_t tile_ = 0;
    std::size_t next_cell_ = 0;
    std::int32_t slivers_ = 0;
};

}  // namespace noctule
