/// The mission: which state it is in and why, and what the reference is to do next.
///
/// States and their changes are one table (mission.cpp); docs/safety.md explains each row. Exploration itself is in
/// explorer.hpp. Frame Map, SI. One instance, no heap, not thread-safe. Cost per step is bounded (docs/maths/explore.md).
#pragma once

#include <cstdint>

#include "core/frames.hpp"
#include "estimate/estimate.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/energy.hpp"
#include "plan/explorer.hpp"
#include "plan/floors.hpp"
#include "plan/target.hpp"
#include "plan/trail.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// Values travel in nav_t.state.
enum class MissionState : std::int32_t {
    waiting = 0,
    taking_off = 1,
    looking_around = 2,
    exploring = 3,
    returning_home = 4,
    landing = 5,
    landed = 6,
    aborted = 7,
    paused = 8,
    changing_floor = 9,   ///< looks for another floor and goes there
};

/// Why the present state was entered. Values travel in nav_t.reason.
enum class StateReason : std::int32_t {
    none = 0,
    start_ordered = 1,
    height_reached = 2,
    looked_around = 3,
    nothing_left = 4,         ///< nothing reachable and worth a visit is unknown
    return_ordered = 5,
    land_ordered = 6,
    abort_ordered = 7,
    pause_ordered = 8,
    resume_ordered = 9,
    at_home = 10,
    on_ground = 11,
    control_lost = 12,        ///< the pilot or a failsafe took over
    localisation_lost = 13,   ///< for longer than lost_land_s
    height_lost = 14,         ///< no range reading for so long that z is not to be trusted
    takeoff_timed_out = 15,
    battery_low = 16,
    frames_disagree = 17,     ///< the autopilot's position and ours differ lastingly
    home_unreachable = 18,    ///< no known way home for a stated time: landing where it is
    not_ready = 19,           ///< a start was ordered and refused
    floor_reached = 20,       ///< on a floor that was not explored before
    no_progress = 21,         ///< exploring showed nothing new for longer than the known map can explain
};

class Mission {
public:
    explicit Mission(const Parameters& parameters);

    /// One step. `last_setpoint` is what left the guard one step ago (the one arrow back); `orders` are this step's.
    /// The returned target is valid until the next call.
    template <std::size_t N>
    const Target& step(const Estimate& estimate, const OccupancyGrid& grid, const VehicleSample& vehicle,
                       const Bounded<CommandSample, N>& orders, const Pose2<Map, Body>& last_setpoint,
                       const std::int64_t t_us) {
        for (const CommandSample& command : orders) { take_order(command.order); }
        return advance(estimate, grid, vehicle, last_setpoint, t_us);
    }

    [[nodiscard]] MissionState state() const { return state_; }
    [[nodiscard]] StateReason reason() const { return reason_; }
    /// True: a start would be accepted.
    [[nodiscard]] bool ready() const { return ready_; }
    /// True: landed, the bridge may disarm.
    [[nodiscard]] bool want_disarm() const { return state_ == MissionState::landed; }
    [[nodiscard]] bool goal(float& x_m, float& y_m) const;
    [[nodiscard]] const Explorer& explorer() const { return explorer_; }
    [[nodiscard]] const FloorPlanner& floors() const { return floors_; }
    /// Before step(): what a policy outside answered.
    template <std::size_t N>
    void hear(const Bounded<GoalSample, N>& answers) {
        for (const GoalSample& answer : answers) { explorer_.hear(answer); }
    }
    /// Every step before step(): what the ranges see over and under the vehicle.
    void see(const Estimate& estimate, const SensorFrame& frame, const LevelScan& scan, const OccupancyGrid& grid) {
        floors_.observe(estimate, frame, scan, grid);
    }
    [[nodiscard]] const Pose2<Map, Body>& home() const { return home_; }
    [[nodiscard]] const Energy& energy() const { return energy_; }
    [[nodiscard]] const Trail& trail() const { return trail_; }

private:
    friend struct MissionRow;
    struct Now;   ///< what the rows of the table look at

    void take_order(Order order);
    const Target& advance(const Estimate& estimate, const OccupancyGrid& grid, const VehicleSample& vehicle,
                          const Pose2<Map, Body>& last_setpoint, std::int64_t t_us);
    void watch(const Estimate& estimate, const VehicleSample& vehicle, std::int64_t t_us);
    void account(const Estimate& estimate, const OccupancyGrid& grid, const VehicleSample& vehicle);
    [[nodiscard]] bool gets_nowhere() const;
    void enter(MissionState next, StateReason why, const Pose2<Map, Body>& last_setpoint);
    void aim(const Estimate& estimate, const OccupancyGrid& grid, const Pose2<Map, Body>& last_setpoint);
    [[nodiscard]] float height_wanted_m(const Estimate& estimate) const;

    const Parameters& p_;
    Explorer explorer_;
    FloorPlanner floors_;
    FloorPlanner::Result floor_result_ = FloorPlanner::Result::busy;
    Energy energy_;
    Trail trail_;
    std::uint32_t learned_blocks_ = 0;
    float learned_m2_ = 0.0F;          ///< known area when something new was learned last
    std::int64_t learned_us_ = 0;
    Target target_;
    MissionState state_ = MissionState::waiting;
    MissionState paused_from_ = MissionState::waiting;
    StateReason reason_ = StateReason::none;
    Order pending_ = Order::none;
    Pose2<Map, Body> home_;
    Pose2<Map, Body> anchor_;          ///< where to stand in the states that stand
    bool ready_ = false;
    bool localised_ = false;
    std::int64_t t_us_ = 0;
    std::int64_t before_us_ = 0;       ///< of the step before
    std::int64_t entered_us_ = 0;
    std::int64_t good_since_us_ = -1;
    std::int64_t lost_since_us_ = -1;
    std::int64_t height_lost_since_us_ = -1;
    std::int64_t offset_since_us_ = -1;
    std::int64_t arrived_since_us_ = -1;
    std::int64_t no_way_since_us_ = -1;
    bool airborne_ = false;            ///< armed and in our mode: the climb has begun
    float turned_rad_ = 0.0F;
    float last_yaw_rad_ = 0.0F;
};

}  // namespace noctule
