/// The explorer: asks a policy where to look next, finds the way there, and flies it with the eyes on the unknown.
///
/// docs/maths/explore.md. The cost field of a goal is computed in slices while the way to the last one is flown on; the
/// potential round the vehicle is relaxed in every step. Frame Map, SI. No heap.
#pragma once

#include <cstdint>

#include "core/frames.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/external_policy.hpp"
#include "plan/frontier_policy.hpp"
#include "plan/paper_policy.hpp"
#include "plan/policy.hpp"
#include "plan/potential.hpp"
#include "plan/soundings.hpp"
#include "plan/survey.hpp"
#include "plan/target.hpp"
#include "plan/tour_policy.hpp"
#include "plan/traversability.hpp"

namespace noctule {

class Explorer {
public:
    explicit Explorer(const Parameters& parameters);

    /// Takes up the map's changes; to be called in every step, whatever the state.
    void observe(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, std::int64_t t_us);

    /// A new exploration begins: forgets goals and tried places.
    void begin(const Pose2<Map, Body>& home);

    /// An answer of the policy outside arrived; taken up by the next explore().
    void hear(const GoalSample& answer) { external_.post(answer); }

    /// One step of exploring: fills path and yaw of the target. `from` is the last setpoint, `pose` the estimate. `soundings`: openings are looked for as well.
    void explore(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, std::int64_t t_us, Target& target,
                 const Soundings* soundings = nullptr);
    /// Exploring goes on after it finished, because more is wanted. What explore() does from here on is the default policy's, whatever the parameter
    /// says: no other one looks for openings.
    void sweep();

    /// One step of flying to a given place.
    void go_to(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, float x_m, float y_m, std::int64_t t_us, Target& target);

    /// Ways keep farther off what the laser sees (Traversability::keep_off).
    void keep_off(const bool on) { where_.keep_off(on); }
    /// Stairs under the vehicle (Traversability::add_stairs).
    void add_stairs(const std::int32_t floor, const float x_m, const float y_m) { where_.add_stairs(floor, x_m, y_m); }
    /// True: nothing reachable and worth a visit is left.
    [[nodiscard]] bool finished() const { return goal_.answer.finished; }
    /// True: the present goal has a known way, and the vehicle gets on along it.
    [[nodiscard]] bool has_way() const { return has_way_ && !blocked_; }
    [[nodiscard]] bool has_goal() const { return goal_.valid; }
    [[nodiscard]] float goal_x_m() const { return goal_.x_m; }
    [[nodiscard]] float goal_y_m() const { return goal_.y_m; }
    [[nodiscard]] float look_x_m() const { return goal_.answer.look_x_m; }   ///< what is to be seen from the goal
    [[nodiscard]] float look_y_m() const { return goal_.answer.look_y_m; }
    /// Cells of the unknown behind the known edges (Survey::behind_cells); -1 not known.
    [[nodiscard]] std::int32_t behind_cells() const { return survey_.behind_cells(); }
    [[nodiscard]] const Traversability& where() const { return where_; }
    [[nodiscard]] const TourPolicy& tour() const { return tour_; }
    [[nodiscard]] const Survey& survey() const { return survey_; }
    [[nodiscard]] const CostField& field() const { return fields_[flown_]; }   ///< of the goal that is flown to
    [[nodiscard]] const PaperPolicy& paper() const { return paper_; }
    [[nodiscard]] const ExternalPolicy& external() const { return external_; }
    /// Who decides, of this exploration.
    [[nodiscard]] PolicyKind kind() const { return kind_; }

    struct Counters {
        PolicyCounters policy;
        std::uint32_t goals = 0;          ///< goals flown to
        std::uint32_t back_and_forth = 0; ///< goals left for another and taken again although nothing had been learned
    };
    [[nodiscard]] Counters counters() const { return {policy_ != nullptr ? policy_->counters() : PolicyCounters{}, goals_, back_and_forth_}; }

private:
    struct Goal {
        bool valid = false;
        bool to_place = false;    ///< a given place, not a look into the unknown
        PolicyAnswer answer;
        std::int32_t tries = 0;   ///< looks in vain when it was taken
        float x_m = 0.0F;
        float y_m = 0.0F;
    };
    /// A goal that was flown to, for the count of changes of mind.
    struct Past {
        float x_m = 0.0F;
        float y_m = 0.0F;
        float known_m2 = -1.0F;   ///< when it was left; below 0: none
        bool open = false;        ///< its unknown was still there
    };
    [[nodiscard]] Policy& chosen();
    void choose(PolicyKind kind);
    void take(const OccupancyGrid& grid, const PolicyAnswer& answer);
    void begin_field(const OccupancyGrid& grid);
    /// One slice; true: the field of the goal is complete.
    bool run_field(const OccupancyGrid& grid, const Pose2<Map, Body>& from, std::int64_t t_us);
    void find_way(const OccupancyGrid& grid, const Pose2<Map, Body>& from, std::int64_t t_us);
    void follow(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, Target& target);
    void see_sides(const Pose2<Map, Body>& from, Target& target) const;
    void look(const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, Target& target) const;
    [[nodiscard]] bool stuck(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, std::int64_t t_us);

    /// Closes the narrow place ahead that holds the vehicle. False: there is none.
    bool close_ahead(const Target& target, std::int64_t t_us);

    const Parameters& p_;
    Traversability where_;
    OpenCells open_;             ///< of the goal's field
    CostField fields_[2];        ///< one is flown while the other is computed (and lent to the policy between)
    std::int32_t flown_ = 0;
    Potential potential_;
    Survey survey_;
    TourPolicy tour_;
    FrontierPolicy frontier_;
    PaperPolicy paper_;
    ExternalPolicy external_;
    PolicyKind kind_ = PolicyKind::tour;
    Policy* policy_ = nullptr;   ///< the one of this exploration
    Goal goal_;
    GoalFate fate_ = GoalFate::under_way;
    Pose2<Map, Body> home_;
    bool field_due_ = false;     ///< the goal's field is to be computed, or is being
    bool field_started_ = false;
    bool has_way_ = false;
    bool blocked_ = false;
    bool detour_ = false;        ///< the field under way is to show another way than through the place closed last
    std::int64_t field_us_ = 0;       ///< when the field flown was done
    std::int64_t progress_us_ = -1;   ///< when the vehicle last came nearer to the goal; -1: begins now
    std::uint32_t least_cost_ = 0;    ///< of the way left, so far
    Past left_;                       ///< goal left last
    std::uint32_t goals_ = 0;
    std::uint32_t back_and_forth_ = 0;
};

}  // namespace noctule
