/// A pass over the map, a slice a step: costs from the vehicle, then the edge of the unknown with its viewpoints.
///
/// Working memory that policies share; one of them runs at a time. Frame Map. No heap.
#pragma once

#include <cstdint>

#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/frontier.hpp"
#include "plan/policy.hpp"
#include "plan/soundings.hpp"
#include "plan/unseen.hpp"

namespace noctule {

/// The cell of a point, or the nearest free one within half a metre.
[[nodiscard]] CellId root_near(const OccupancyGrid& grid, const Traversability& where, float x_m, float y_m);

/// Cells round start or goal in which tight cells lead on: none where the hull fits, else as far as the nearest cell where it does, at most
/// half a metre. Not farther: a gap that is too narrow would be crossed from its mouth.
[[nodiscard]] std::int32_t lead_on_cells(const OccupancyGrid& grid, const Traversability& where, CellId root);

class Survey {
public:
    explicit Survey(const Parameters& parameters) : search_(parameters), unseen_(parameters), passes_(parameters), tried_(parameters) {}

    void begin() {
        restart();
        tried_.clear();
        costs_.clear();
        behind_cells_ = -1;
    }
    /// The pass under way is dropped, the next one begins with the costs.
    void restart() { phase_ = Phase::idle; }
    /// The edge is looked for anew with the costs at hand.
    void look_again() {
        if (phase_ != Phase::idle && phase_ != Phase::costs) {
            phase_ = Phase::edge;
            search_.start();
        }
    }
    /// One slice; true: the pass is complete, and the next call begins a new one.
    bool run(const MapView& map, const ViewRule& rule, std::int32_t budget_cells);

    [[nodiscard]] const CostField& costs() const { return costs_; }       ///< from the vehicle, of the last pass
    [[nodiscard]] const FrontierSearch& search() const { return search_; }
    /// Cells of the unknown that hang behind the edges of the last pass, each edge's counted within 1.2 m of it; -1 before the first pass.
    [[nodiscard]] std::int32_t behind_cells() const { return behind_cells_; }
    [[nodiscard]] TriedPlaces& tried() { return tried_; }
    [[nodiscard]] const TriedPlaces& tried() const { return tried_; }
    [[nodiscard]] OpenCells& open() { return open_; }                     ///< for searches between two passes
    [[nodiscard]] const OpenCells& open() const { return open_; }

private:
    enum class Phase : std::uint8_t { idle, costs, edge, unseen, passes };
    OpenCells open_;
    CostField costs_;
    FrontierSearch search_;
    UnseenSearch unseen_;
    SoundingSearch passes_;
    TriedPlaces tried_;
    Phase phase_ = Phase::idle;
    std::int32_t behind_cells_ = -1;
};

}  // namespace noctule
