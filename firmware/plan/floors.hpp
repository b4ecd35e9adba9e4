/// The floors of the building: which there are, the openings between them, and the way from one to the next.
///
/// docs/maths/floors.md (section I of the paper's method). Watches what the ranges see over and under the vehicle, finds openings,
/// looks round in them, goes through, and leads home. The mission asks it for a target while it changes floors. Floor 0 is the
/// start's. Frame Map, SI. One instance, no heap, not thread-safe; bounded work a step (one judgement of an opening, under 3 ms).
#pragma once

#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "estimate/estimate.hpp"
#include "map/occupancy_grid.hpp"
#include "map/vertical_map.hpp"
#include "params.gen.hpp"
#include "plan/explorer.hpp"
#include "plan/floor_modes.hpp"
#include "plan/opening.hpp"
#include "plan/soundings.hpp"
#include "plan/stair_signs.hpp"
#include "plan/target.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// A way between two floors: a vertical shaft.
struct Passage {
    std::int8_t low = 0;         ///< layer of the floor below
    std::int8_t high = 0;        ///< layer of the floor above
    float x_m = 0.0F;
    float y_m = 0.0F;
    float slab_low_m = 0.0F;     ///< the slab it leads through lies between these elevations, as far as is known
    float slab_high_m = 0.0F;
};

struct Floor {
    float elevation_m = 0.0F;
    bool confirmed = false;      ///< its ground was seen from above
    bool empty = false;          ///< nothing to stand over was found there: not a floor
    std::int8_t entry = -1;      ///< passage by which it was first entered; -1: the start's
    std::int8_t parent = -1;     ///< layer at the other end of it
    float seen_x_m = 0.0F;       ///< place beyond by which that opening was found
    float seen_y_m = 0.0F;
    float explored_s = 0.0F;     ///< time that its exploration took
    float searched_s = 0.0F;     ///< time spent in search of openings after its exploration
    std::int32_t pass = 0;       ///< of that search: each looks for narrower openings
    bool searched = false;       ///< it is over
};

class FloorPlanner {
public:
    enum class Result : std::uint8_t { busy, arrived, nothing };
    enum class Doing : std::uint8_t { idle, searching, surveying, centring, shifting };
    /// Why an opening was not taken.
    enum class Refusal : std::uint8_t { none, too_small, not_seen_round, no_way, no_room, clearance_gone, no_floor_behind, too_many_floors };
    struct Judged {
        std::int8_t floor = 0;
        float x_m = 0.0F;
        float y_m = 0.0F;
        bool up = true;
        Refusal why = Refusal::none;
        float seen_x_m = 0.0F;   ///< place beyond by which it was found: in a high room that can be far from the place chosen to go through
        float seen_y_m = 0.0F;
    };
    static constexpr std::int32_t kShaft = kMaxFloors;   ///< layer() between two floors

    explicit FloorPlanner(const Parameters& parameters);

    /// Every step, whatever the state: the ranges of the step, and the layer that the height tells.
    void observe(const Estimate& estimate, const SensorFrame& frame, const LevelScan& scan, const OccupancyGrid& grid);

    /// A step of exploring lasted so long.
    void note_exploring(const float dt_s) { floors_[static_cast<std::size_t>(current_)].explored_s += dt_s; }

    /// True: with this floor explored there is something for step() to do.
    [[nodiscard]] bool more(const OccupancyGrid& grid, const Pose2<Map, Body>& pose) const {
        return p_.floors_max > 1 && (current_ != 0 || wants_search() || find_opening(grid, pose).valid);
    }

    /// One step of looking for another floor, and of going there. arrived: on a floor that wants exploring; nothing: no floor is left, and
    /// the vehicle is on the floor of the start.
    Result step(const Estimate& estimate, const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& from, std::int64_t t_us, Target& target);
    /// One step of the way back to the floor of the start. nothing: there already.
    Result go_home(const Estimate& estimate, const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& from, std::int64_t t_us, Target& target);

    /// True: in a shaft, or about to go through one.
    [[nodiscard]] bool shifting() const { return doing_ == Doing::shifting; }
    [[nodiscard]] Doing doing() const { return doing_; }
    [[nodiscard]] bool on_start_floor() const { return current_ == 0; }
    [[nodiscard]] std::int32_t current() const { return current_; }
    /// True: the ground under the vehicle shows a step of stairs, in this step.
    [[nodiscard]] bool over_stairs() const { return over_stairs_; }
    /// True: a passage of the present floor is near, and stairs with it.
    [[nodiscard]] bool by_passage(float x_m, float y_m) const;
    /// Layer for grid and localiser: a floor, or kShaft.
    [[nodiscard]] std::int32_t layer() const { return layer_; }
    /// Elevation to count heights from, given what the altitude filter says of the floor.
    [[nodiscard]] float floor_z_m(const AltitudeEstimate& altitude) const;
    /// Number of a layer's floor: floors in the order in which they were found, those that were none left out; -1 for such.
    [[nodiscard]] std::int32_t name_of(std::int32_t layer) const;
    /// Bits of the layers that are sure to be floors.
    [[nodiscard]] std::uint32_t confirmed_bits() const;

    [[nodiscard]] const Bounded<Floor, kFloorSlots>& floors() const { return floors_; }
    [[nodiscard]] const Bounded<Passage, kFloorSlots>& passages() const { return passages_; }
    [[nodiscard]] const Bounded<Judged, kMaxOpenings>& judged() const { return judged_; }
    [[nodiscard]] const VerticalMap& vertical() const { return vertical_; }
    [[nodiscard]] const Soundings& soundings() const { return soundings_; }

private:
    struct Seed {
        bool valid = false;
        bool up = true;
        float x_m = 0.0F;
        float y_m = 0.0F;
        float seen_x_m = 0.0F;   ///< place beyond by which it was found; x_m, y_m move on to the place to go through
        float seen_y_m = 0.0F;
        BeyondBand beyond;
        float slab_m = 0.0F;   ///< underside (up) or top (down) of the slab with the opening
        float far_m = 0.0F;    ///< elevation seen beyond
    };
    void see(const RangeSample& sample, VerticalSide side, const Estimate& estimate);
    void search(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, float dt_s, Target& target);
    void centre(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, Target& target);
    [[nodiscard]] bool lasted(const std::int64_t since_us, const float seconds) const {
        return since_us >= 0 && static_cast<float>(t_us_ - since_us) >= 1e6F * seconds;
    }
    void start(Doing doing);
    void follow_layer(float z_m);
    void confirm(const AltitudeEstimate& altitude);
    [[nodiscard]] Seed find_opening(const OccupancyGrid& grid, const Pose2<Map, Body>& pose) const;
    [[nodiscard]] Seed find_opening(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, bool up) const;
    [[nodiscard]] bool was_judged(const OccupancyGrid& grid, bool up, float x_m, float y_m) const;
    [[nodiscard]] bool linked(bool up) const;
    [[nodiscard]] bool full() const;
    [[nodiscard]] bool wants_search() const;
    /// Width of the openings that a pass of the search looks for.
    [[nodiscard]] float width_m(std::int32_t pass) const;
    void refuse(Refusal why);
    void decide(const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& pose);
    void leave_by(std::int8_t passage);
    [[nodiscard]] bool begin_shift(const Estimate& estimate);
    void turn_back();
    void fly(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, float x_m, float y_m, Target& target);
    Result work(const Estimate& estimate, const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& from, float dt_s, Target& target);
    void survey(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, Target& target);
    [[nodiscard]] bool shift(const Estimate& estimate, Target& target);

    const Parameters& p_;
    VerticalMap vertical_;
    OpeningJudge judge_;
    Bounded<Floor, kFloorSlots> floors_;
    Bounded<Passage, kFloorSlots> passages_;
    Bounded<Judged, kMaxOpenings> judged_;
    Soundings soundings_;
    StairSigns stairs_;
    bool over_stairs_ = false;
    std::int32_t current_ = 0;
    std::int32_t layer_ = 0;
    Doing doing_ = Doing::idle;
    Seed seed_;
    float goal_x_m_ = 0.0F;       ///< surveying, centring: where to look, or to stand
    float goal_y_m_ = 0.0F;
    std::int8_t passage_ = -1;    ///< the one that is being taken; -1: a new one
    std::int8_t to_ = -1;         ///< layer at the far end
    float shift_z_m_ = 0.0F;      ///< height to reach
    float start_z_m_ = 0.0F;
    float least_left_m_ = 1e9F;   ///< nearest to the height wanted so far
    bool turned_back_ = false;
    bool new_floor_ = false;      ///< the far end was never explored
    std::int64_t since_us_ = -1;  ///< of the present task
    std::int64_t stood_us_ = -1;
    std::int64_t looked_us_ = -1;
    std::int64_t way_us_ = -1;
    std::int64_t there_us_ = -1;  ///< over the place to look at
    std::int64_t t_us_ = 0;
    float nearest_side_m_ = 1e9F; ///< of the scan, in a shaft
    std::int32_t ground_votes_ = 0;
    float ground_sum_m_ = 0.0F;
};

}  // namespace noctule
