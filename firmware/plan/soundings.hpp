/// Where over and under the vehicle the ranges have looked, and the places that are still to be passed in search of openings.
///
/// docs/maths/floors.md, "Search". Ceiling and ground are seen along the way flown only. An opening that holds a disc of a given radius has been met
/// once no place that the hull fits at is farther than that from the way. Frame Map. No heap, not thread-safe.
#pragma once

#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/frontier.hpp"
#include "plan/traversability.hpp"

namespace noctule {

class Soundings {
public:
    Soundings();

    /// The vehicle is over and under a place of the grid's floor. Bounded cost; calls less than 5 cm apart cost nothing.
    void pass(const OccupancyGrid& grid, float x_m, float y_m);
    /// The next pass() counts, wherever it is: another floor begins.
    void restart() { last_x_m_ = 1e9F; }

    /// What is looked for: openings that hold a disc of this radius; 0: none. At most kReachM. thorough: small patches too, where one could lie.
    void want(const float radius_m, const bool thorough = false) {
        wanted_m_ = radius_m < kReachM ? radius_m : kReachM;
        thorough_ = thorough;
    }
    [[nodiscard]] float wanted_m() const { return wanted_m_; }
    [[nodiscard]] bool thorough() const { return thorough_; }
    /// True: no opening wanted can have its middle in that cell and not have been met.
    [[nodiscard]] bool passed(const CellId id) const { return distance_m(id) <= wanted_m_; }
    /// True: nothing within 0.6 of the radius wanted is left, but for what is not on the map. Cost: the blocks of that disc.
    [[nodiscard]] bool passed_round(const OccupancyGrid& grid, CellId id) const;
    /// From the cell to the way flown, known up to kReachM; beyond: more than that.
    [[nodiscard]] float distance_m(const CellId id) const {
        return 0.01F * static_cast<float>(centimetres_[static_cast<std::size_t>(id >> 12)][block(id)]);
    }
    static constexpr float kReachM = 2.5F;
    /// Blocks that were first passed near; never decreases.
    [[nodiscard]] std::uint32_t blocks() const { return blocks_; }

private:
    static constexpr std::int32_t kBlock = 2;                              ///< cells of the edge of a block, for which one distance is kept
    static constexpr std::int32_t kSide = kTileCells / kBlock;             ///< blocks of the edge of a tile
    [[nodiscard]] static std::size_t block(const CellId id) {
        return static_cast<std::size_t>(((id >> 6) & 63) / kBlock * kSide + (id & 63) / kBlock);
    }
    std::array<std::array<std::uint8_t, static_cast<std::size_t>(kSide* kSide)>, kMaxTiles> centimetres_;
    float wanted_m_ = 0.0F;
    bool thorough_ = false;
    std::uint32_t blocks_ = 0;
    float last_x_m_ = 1e9F;
    float last_y_m_ = 1e9F;
};

/// Patches of a floor that are to be passed, each a place to fly to, beside those of the edge of the unknown.
class SoundingSearch {
public:
    explicit SoundingSearch(const Parameters& parameters) : p_(parameters) {}

    void start() {
        tile_ = 0;
        found_.clear();
    }
    /// One slice; true: complete.
    bool run(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried, const Soundings& soundings, std::int64_t t_us);
    /// Patches with Frontier::sounding set; the place to see and the viewpoint are one. The nearest, where there are too many.
    [[nodiscard]] const Bounded<Frontier, kMaxFrontiers>& found() const { return found_; }

private:
    static constexpr std::int32_t kTilesPerSlice = 12;
    void look_into(const OccupancyGrid& grid, const Traversability& where, const CostField& from, const TriedPlaces& tried, const Soundings& soundings,
                   std::int64_t t_us, std::int32_t x0, std::int32_t y0, std::int32_t x1, std::int32_t y1);

    const Parameters& p_;
    std::int32_t tile_ = 0;
    Bounded<Frontier, kMaxFrontiers> found_;
};

}  // namespace noctule
