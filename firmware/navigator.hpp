/// The whole autonomy: one step per laser scan, a sensor frame in, estimate, setpoint and status out.
///
/// Data moves down the rooms only: sense -> estimate -> map -> plan -> command. What comes back up is the value of the
/// step before, explicit: the altitude (for the laser's tilt), the last setpoint (for the mission and the reference).
/// Frames Map and Body (docs/frames.md), SI units. All storage is inside; sizeof(Navigator) is the memory budget. No heap,
/// no clock, not thread-safe. Pure in (frame, own state): the same frames give the same output, so a log replays exactly.
#pragma once

#include <array>
#include <cstdint>

#include "command/guard.hpp"
#include "command/reference.hpp"
#include "command/setpoint.hpp"
#include "estimate/altitude_filter.hpp"
#include "estimate/estimate.hpp"
#include "estimate/localiser.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/mission.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// What one step returned.
struct NavOutput {
    std::int64_t t_us = 0;
    std::int32_t scan_seq = 0;
    Estimate estimate;
    Setpoint setpoint;
    MissionState state = MissionState::waiting;
    StateReason reason = StateReason::none;
    bool ready = false;         ///< a start would be accepted
    bool want_disarm = false;   ///< landed
    bool goal_valid = false;
    float goal_x_m = 0.0F;
    float goal_y_m = 0.0F;
    std::int32_t floor = 0;     ///< number of the floor, in the order in which floors were found; 0 is the start's
    std::array<std::int32_t, kFloorSlots> floor_names{};   ///< number of each layer of the grid
    std::int32_t openings_refused = 0;   ///< openings judged and not taken, or without a floor behind
    float known_area_m2 = 0.0F;
    float explored_share = -1.0F;   ///< of the present floor: what is known, of that and the unknown that shows behind its edges; -1 not known
    float clearance_m = 0.0F;   ///< hull to the nearest solid point seen; NaN unknown
    PolicyAsk ask;              ///< of a policy outside; asked in this step if its t_us is the step's
    PolicyKind policy = PolicyKind::tour;   ///< who decides where to look; not the parameter's once a policy outside was given up
    std::int32_t guard_interventions = 0;
    GuardRule guard_rule = GuardRule::none;
};

class Navigator {
public:
    explicit Navigator(const Parameters& parameters);

    /// One step; the result holds until the next. A bad frame is refused by the stage that sees it, and counted there.
    const NavOutput& step(const SensorFrame& frame);

    [[nodiscard]] const Localiser& localiser() const { return localiser_; }
    [[nodiscard]] const AltitudeFilter& altitude() const { return altitude_; }
    [[nodiscard]] OccupancyGrid& grid() { return grid_; }
    [[nodiscard]] const OccupancyGrid& grid() const { return grid_; }
    [[nodiscard]] const Mission& mission() const { return mission_; }
    [[nodiscard]] const Guard& guard() const { return guard_; }

private:
    void update_estimate(const SensorFrame& frame);

    Localiser localiser_;
    AltitudeFilter altitude_;
    OccupancyGrid grid_;
    Mission mission_;
    Reference reference_;
    Guard guard_;
    Estimate estimate_;
    VehicleSample vehicle_;   ///< newest one
    NavOutput output_;
};

}  // namespace noctule
