/// Harmonic potential round the vehicle in log space, and the path that follows its gradient to the goal.
///
/// Model: docs/maths/potential.md. phi = 1 at the goal, 0 where the hull does not fit; elsewhere phi is the weighted mean of the
/// eight neighbours, less what is absorbed near obstacles. Kept as v = -ln(phi), so it does not underflow. It starts from the
/// cost field, which is a lower bound of phi with a way up in every cell; relaxing only raises phi and keeps that way up,
/// so the gradient is usable in every reachable cell after any number of sweeps.
/// A cell is relaxed again only when something round it changed. No heap. Cost per relax(): at most sweeps x window cells x 8.
#pragma once

#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/target.hpp"
#include "plan/traversability.hpp"

namespace noctule {

class Potential {
public:
    explicit Potential(const Parameters& parameters) : p_(parameters) {}

    /// The cost field was computed anew: all values start again from it.
    void restart() { full_ = false; }

    /// Moves the window to a place and relaxes it.
    void relax(const OccupancyGrid& grid, const Traversability& where, const CostField& field, float x_m, float y_m, std::int32_t sweeps);

    /// -ln(phi) of a cell: relaxed inside the window, from the cost field elsewhere; infinity where nothing leads to the goal.
    [[nodiscard]] float value(const OccupancyGrid& grid, const CostField& field, CellId id) const;

    /// Follows the gradient from a point, up to the capacity of the path or to the goal (then its last point is the goal
    /// itself), and draws the steps out into a smooth line that keeps to the middle of narrow places.
    /// False: no way from there (the path is empty).
    bool trace(const OccupancyGrid& grid, const Traversability& where, const CostField& field, float x_m, float y_m,
               float goal_x_m, float goal_y_m, Bounded<PathPoint, kMaxPathPoints>& path);

    /// The place that the line traced last was cut off before, as it has too little room for hull and margin; null: there is none.
    [[nodiscard]] const PathPoint* cut() const { return is_cut_ ? &cut_ : nullptr; }

    /// Greatest change of v in the last sweep.
    [[nodiscard]] float residual() const { return residual_; }

private:
    static constexpr auto kWindow = static_cast<std::int32_t>(kPotentialWindow);   ///< ring of cells in both directions; the window uses up to three less
    static_assert((kWindow & (kWindow - 1)) == 0, "addressed by mask");
    struct Entry {
        Cell cell;
        float value;
        std::uint8_t byte;   ///< what Traversability said of it
        bool stale;          ///< its neighbourhood changed since it was relaxed last
    };
    void refresh(const OccupancyGrid& grid, const Traversability& where, const CostField& field, std::int32_t half);
    void mark_stale_round(Cell c);
    [[nodiscard]] static std::size_t at(const Cell c) { return static_cast<std::size_t>((c.iy & (kWindow - 1)) * kWindow + (c.ix & (kWindow - 1))); }
    [[nodiscard]] float way_m(const OccupancyGrid& grid, const PathPoint& from, float ux, float uy) const;
    [[nodiscard]] static bool may_move(const OccupancyGrid& grid, const Traversability& where, const PathPoint& from, float x_m, float y_m);
    void refine(const OccupancyGrid& grid, const Traversability& where, std::array<float, kMaxPathPoints>& room_least_m,
                Bounded<PathPoint, kMaxPathPoints>& path) const;
    void centre(const OccupancyGrid& grid, const Traversability& where, const std::array<float, kMaxPathPoints>& room_least_m,
                Bounded<PathPoint, kMaxPathPoints>& path) const;
    void smooth(const OccupancyGrid& grid, const Traversability& where, Bounded<PathPoint, kMaxPathPoints>& path);

    const Parameters& p_;
    std::array<Entry, static_cast<std::size_t>(kWindow) * kWindow> ring_{};
    bool full_ = false;
    Cell centre_;
    std::uint32_t meaning_ = 0;   ///< of Traversability's bytes
    float residual_ = 0.0F;
    bool backwards_ = false;
    bool is_cut_ = false;
    PathPoint cut_;
};

}  // namespace noctule
