/// What decides where to look next: one class, four ways of doing it.
///
/// A policy is asked once a step with a view of the map, the pose and a budget, and answers with a goal and where to look from
/// there. It sees nothing else of the vehicle and moves nothing: the explorer finds the way and flies it. An answer may be
/// older than the question (a policy may think over several steps, or sit in another process). Frame Map, SI. No heap.
#pragma once

#include <cstdint>

#include "core/bounded.hpp"
#include "core/frames.hpp"
#include "map/occupancy_grid.hpp"
#include "plan/cost_field.hpp"
#include "plan/frontier.hpp"
#include "plan/target.hpp"
#include "plan/traversability.hpp"

namespace noctule {

class Soundings;
class Survey;

/// Values of the parameter `policy`.
enum class PolicyKind : std::int32_t {
    tour = 0,      ///< the default: open tour over all that is left
    frontier = 1,  ///< nearest frontier, the baseline
    paper = 2,     ///< windowed harmonic potential as published
    external = 3,  ///< another process (external_policy.hpp)
};

/// What became of the goal answered last.
enum class GoalFate : std::uint8_t {
    under_way,
    unreachable,  ///< no way leads there
    stuck,        ///< the vehicle did not come nearer for long
};

/// What a policy may look at, and the working memory that it may use.
struct MapView {
    const OccupancyGrid& grid;
    const Traversability& where;
    Pose2<Map, Body> home;      ///< middle of the fence
    Pose2<Map, Body> from;      ///< last setpoint: where ways begin
    std::int64_t t_us = 0;
    GoalFate fate = GoalFate::under_way;
    Survey& survey;             ///< costs from the vehicle and the edge of the unknown, in passes
    CostField& scratch;         ///< free for use until the policy answers with a new number
    const Soundings* soundings = nullptr;   ///< where ceiling and ground were looked at, if openings are looked for
};

struct PolicyAnswer {
    bool valid = false;         ///< there is a goal
    bool seen = false;          ///< what it was to show has been seen; it is flown on only until the next answer
    bool finished = false;      ///< nothing reachable and worth it is left
    std::uint32_t number = 0;   ///< rises with every new goal
    CellId cell = kNoCell;      ///< of the goal
    float x_m = 0.0F;           ///< where to fly
    float y_m = 0.0F;
    float look_x_m = 0.0F;      ///< what to look at from there: gives the yaw
    float look_y_m = 0.0F;
    const Bounded<PathPoint, kMaxPathPoints>* path = nullptr;  ///< a way of the policy's own, flown as it is; else the explorer finds one
};

/// What has been counted since the begin.
struct PolicyCounters {
    std::uint32_t passes = 0;
    std::uint32_t switches = 0;   ///< goals left for a better one before they were done
    std::uint32_t stuck = 0;      ///< goals given up because the vehicle did not come nearer
    std::uint32_t in_vain = 0;    ///< looks that showed nothing new
};

class Policy {
public:
    Policy() = default;
    Policy(const Policy&) = delete;
    Policy& operator=(const Policy&) = delete;
    /// A new exploration.
    virtual void begin(const Pose2<Map, Body>& home) = 0;
    /// One step: at most about `budget_cells` cells are settled or swept (0: only what is cheap).
    virtual const PolicyAnswer& step(const MapView& map, const Pose2<Map, Body>& pose, std::int32_t budget_cells) = 0;
    [[nodiscard]] const PolicyCounters& counters() const { return counters_; }

protected:
    ~Policy() = default;
    PolicyCounters counters_;
};

}  // namespace noctule
