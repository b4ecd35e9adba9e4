/// Where in an opening the vehicle may go through it: the paper's rule (the nearest place with the near ceiling is farther than the
/// safety distance), with a look round first, because a range finder sees one spot at a time. docs/maths/floors.md. Frame Map, SI.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/bounded.hpp"
#include "map/occupancy_grid.hpp"
#include "map/vertical_map.hpp"
#include "params.gen.hpp"
#include "plan/traversability.hpp"

namespace noctule {

/// What tells a place in the opening from one beside it: elevations between low_z_m and high_z_m lie beyond the opening.
struct BeyondBand {
    float low_z_m = 0.0F;
    float high_z_m = 0.0F;
    [[nodiscard]] bool holds(const float z_m) const { return z_m >= low_z_m && z_m <= high_z_m; }
};

struct OpeningVerdict {
    enum class What : std::uint8_t {
        survey,     ///< look at (look_x_m, look_y_m) first
        ready,      ///< (x_m, y_m) is clear all round
        too_small,  ///< no place is far enough from its edges
    };
    What what = What::too_small;
    float x_m = 0.0F;
    float y_m = 0.0F;
    float edge_m = 0.0F;      ///< from there to the nearest known edge
    float look_x_m = 0.0F;
    float look_y_m = 0.0F;
};

class OpeningJudge {
public:
    explicit OpeningJudge(const Parameters& parameters) : p_(parameters) {}

    /// Judges the opening round a place where something beyond was seen. Looks 3 m far. `from`: where the vehicle is.
    /// Cost: places x edges in that window, under 3 ms.
    [[nodiscard]] OpeningVerdict judge(const VerticalMap& map, const OccupancyGrid& grid, const Traversability& where, std::int8_t floor, VerticalSide side,
                                       const BeyondBand& beyond, float seed_x_m, float seed_y_m, float from_x_m, float from_y_m);

    /// A place that could not be looked at; it no longer holds the verdict up.
    void skip(float x_m, float y_m) { static_cast<void>(skipped_.push({x_m, y_m})); }
    /// Another opening is to be judged.
    void clear() {
        skipped_.clear();
        looks_farther_ = 0;
    }

private:
    static constexpr std::int32_t kReach = 30;                       ///< cells of the window on each side
    static constexpr std::int32_t kSide = 2 * kReach + 1;
    static constexpr std::size_t kMaxEdges = static_cast<std::size_t>(kSide* kSide);
    enum class Seen : std::uint8_t { nothing, edge, beyond };
    struct Spot {
        float x_m = 0.0F;
        float y_m = 0.0F;
    };
    void draw(const VerticalMap& map, std::int8_t floor, VerticalSide side, const BeyondBand& beyond, Cell centre);
    [[nodiscard]] Seen seen(std::int32_t i, std::int32_t j) const;
    [[nodiscard]] bool skipped(float x_m, float y_m) const;
    /// Spots round a place that were not looked at; next: the nearest. -1: solid things keep the vehicle too near to look all round the hull.
    [[nodiscard]] std::int32_t unknown_round(const OccupancyGrid& grid, const Traversability& where, float x_m, float y_m, float from_x_m, float from_y_m,
                                             Spot& next) const;

    const Parameters& p_;
    Cell centre_;
    float cell_m_ = 0.1F;
    std::array<Seen, static_cast<std::size_t>(kSide* kSide)> seen_{};
    Bounded<Spot, kMaxEdges> edges_;   ///< one a cell: all fit
    Bounded<Spot, 64> skipped_;
    Spot farther_;                     ///< last look at what is beside the part that was seen
    std::int32_t looks_farther_ = 0;
};

}  // namespace noctule
