/// The explorer: which piece of the unknown to look into next, the way there, and where to look.
///
/// docs/maths/explore.md. Works in passes over the map, a slice a step: costs from the vehicle, edge of the unknown, choice,
/// cost field of the goal; the potential round the vehicle is relaxed in every step. Frame Map, SI. No heap.
#pragma once

#include <cstdint>

#include "core/frames.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/frontier.hpp"
#include "plan/potential.hpp"
#include "plan/target.hpp"
#include "plan/traversability.hpp"

namespace noctule {

class Explorer {
public:
    explicit Explorer(const Parameters& parameters);

    /// Takes up the map's changes; to be called in every step, whatever the state.
    void observe(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, std::int64_t t_us);

    /// A new exploration begins: forgets goals and tried places.
    void begin(const Pose2<Map, Body>& home);

    /// One step of exploring: fills path and yaw of the target. `from` is the last setpoint, `pose` the estimate.
    void explore(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, std::int64_t t_us, Target& target);

    /// One step of flying to a given place.
    void go_to(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, float x_m, float y_m, std::int64_t t_us, Target& target);

    /// True: nothing reachable and worth a visit is left (two passes in a row found nothing).
    [[nodiscard]] bool finished() const { return empty_passes_ >= 2; }
    /// True: the present goal has a known way, and the vehicle gets on along it.
    [[nodiscard]] bool has_way() const { return has_way_ && !blocked_; }
    [[nodiscard]] bool has_goal() const { return goal_.valid; }
    [[nodiscard]] float goal_x_m() const { return goal_.x_m; }
    [[nodiscard]] float goal_y_m() const { return goal_.y_m; }
    [[nodiscard]] float look_x_m() const { return goal_.frontier.x_m; }   ///< what is to be seen from the goal
    [[nodiscard]] float look_y_m() const { return goal_.frontier.y_m; }
    [[nodiscard]] const Traversability& where() const { return where_; }
    [[nodiscard]] const Bounded<Frontier, kMaxFrontiers>& known() const { return known_; }  ///< groups of the last complete pass
    [[nodiscard]] const FrontierSearch& frontiers() const { return search_; }

    struct Counters {
        std::uint32_t passes = 0;
        std::uint32_t goals = 0;        ///< goals chosen
        std::uint32_t switches = 0;     ///< goals left for a better one before they were done
        std::uint32_t stuck = 0;        ///< goals given up because the vehicle did not come nearer
        std::uint32_t in_vain = 0;      ///< looks that showed nothing new
    };
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    enum class Phase : std::uint8_t { costs, frontiers, field };
    struct Goal {
        bool valid = false;
        bool seen = false;        ///< nothing unknown is left there; flown on until the next choice
        bool to_place = false;    ///< a given place, not a look into the unknown
        Frontier frontier;
        float x_m = 0.0F;
        float y_m = 0.0F;
        std::uint32_t cost = CostField::kFar;
    };
    void work(const OccupancyGrid& grid, const Pose2<Map, Body>& from, std::int64_t t_us, bool exploring);
    void begin_costs(const OccupancyGrid& grid, const Pose2<Map, Body>& from);
    void begin_field(const OccupancyGrid& grid);
    void choose(const OccupancyGrid& grid, std::int64_t t_us);
    bool take_next(const OccupancyGrid& grid, std::int64_t t_us);
    void set_goal(const Frontier& frontier);
    void follow(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, Target& target);
    [[nodiscard]] bool stuck(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, std::int64_t t_us);
    [[nodiscard]] bool resolved(const OccupancyGrid& grid) const;
    [[nodiscard]] float value_of(const Frontier& f) const;

    const Parameters& p_;
    Traversability where_;
    OpenCells open_;
    CostField from_vehicle_;
    CostField fields_[2];        ///< one is flown while the other is computed
    std::int32_t flown_ = 0;
    Potential potential_;
    FrontierSearch search_;
    Bounded<Frontier, kMaxFrontiers> known_;   ///< result of the last complete pass
    TriedPlaces tried_;
    Goal goal_;
    Pose2<Map, Body> home_;
    Phase phase_ = Phase::costs;
    bool phase_started_ = false;
    bool field_wanted_ = false;
    bool has_way_ = false;
    std::int32_t empty_passes_ = 0;
    std::int64_t dwell_since_us_ = -1;
    std::int64_t pass_us_ = 0;
    std::int64_t progress_us_ = -1;   ///< when the vehicle last came nearer to the goal; -1: begins now
    std::uint32_t least_cost_ = 0;    ///< of the way left, so far
    bool blocked_ = false;
    Counters counters_;
};

}  // namespace noctule
