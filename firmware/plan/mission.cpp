#include "plan/mission.hpp"

#include <algorithm>
#include <cmath>

#include "plan/fence.hpp"

namespace noctule {

namespace {

constexpr std::uint32_t bit(const MissionState s) { return 1U << static_cast<unsigned>(s); }

constexpr std::uint32_t kFlying = bit(MissionState::taking_off) | bit(MissionState::looking_around) | bit(MissionState::exploring) |
                                  bit(MissionState::returning_home) | bit(MissionState::paused) | bit(MissionState::changing_floor);
constexpr std::uint32_t kStarted = kFlying | bit(MissionState::landing);
constexpr std::uint32_t kOut = bit(MissionState::looking_around) | bit(MissionState::exploring) | bit(MissionState::paused) |
                               bit(MissionState::changing_floor);

constexpr std::int64_t kVehicleStaleUs = 2000000;
constexpr std::int64_t kSettledUs = 500000;     ///< a height or place must hold this long to count as reached
constexpr std::int64_t kNoWayUs = 10000000;     ///< no known way home for this long: land where it is
constexpr std::uint32_t kLearnedBlocks = 20;    ///< the same, of ceiling and ground (plan/soundings)
constexpr float kLearnedM2 = 0.2F;              ///< growth of the known area that counts as progress
constexpr std::int64_t kLongStepUs = 200000;    ///< a longer silence does not count as time explored
constexpr float kHeightToleranceM = 0.12F;
constexpr float kOpeningBelowM = 0.5F;         ///< ground this far under the floor lies beyond an opening
constexpr float kSlowM_S = 0.15F;
constexpr float kLookAheadRad = 0.7F;           ///< the turn in place keeps its heading this far ahead
constexpr float kFastDescentAboveM = 0.6F;      ///< height over the floor above which a landing descends at the climb rate

}  // namespace

/// Everything a row of the table may ask.
struct Mission::Now {
    bool armed = false;
    bool offboard = false;
    bool on_ground = false;
    bool mission_lost = false;
    bool lost_long = false;
    bool height_lost = false;
    bool offset = false;
    bool battery_low = false;
    bool at_height = false;
    bool at_home = false;
    bool no_way = false;
    bool looked = false;
    bool finished = false;
    bool no_progress = false;
    bool more_floors = false;
    bool floor_reached = false;
    bool no_floor_left = false;
    bool timed_out = false;
    bool ready = false;
    Order order = Order::none;
};

struct MissionRow {
    std::uint32_t from;
    bool (*when)(const Mission::Now&);
    MissionState to;
    StateReason why;
};

namespace {
using S = MissionState;
using R = StateReason;
}  // namespace

Mission::Mission(const Parameters& parameters) : p_(parameters), explorer_(parameters), floors_(parameters), energy_(parameters) {}

bool Mission::goal(float& x_m, float& y_m) const {
    if (!explorer_.has_goal() || (state_ != S::exploring && state_ != S::returning_home)) { return false; }
    x_m = explorer_.goal_x_m();
    y_m = explorer_.goal_y_m();
    return true;
}

void Mission::take_order(const Order order) {
    // The graver order of one step wins: abort, then land, then the rest as they came.
    if (pending_ == Order::abort || (pending_ == Order::land && order != Order::abort)) { return; }
    pending_ = order;
}

// What must last before it counts.
void Mission::watch(const Estimate& estimate, const VehicleSample& vehicle, const std::int64_t t_us) {
    const auto since = [t_us](const bool holds, std::int64_t& start_us) {
        if (!holds) {
            start_us = -1;
        } else if (start_us < 0) {
            start_us = t_us;
        }
    };
    const bool heard = vehicle.t_us > 0 && t_us - vehicle.t_us < kVehicleStaleUs;
    localised_ = estimate.planar.quality >= 0;
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    const bool offset = heard && localised_ && vehicle.local_position_valid &&
                        std::hypot(vehicle.local_map_m[0] - pose.x_m, vehicle.local_map_m[1] - pose.y_m) > p_.frame_offset_max_m;
    const bool inside = Fence{p_}.depth_m(pose.x_m, pose.y_m) >= kFenceInsetM;
    since(estimate.planar.quality >= p_.ready_quality && estimate.altitude.valid && heard && !offset && inside, good_since_us_);
    since(!localised_, lost_since_us_);
    since(!estimate.altitude.valid, height_lost_since_us_);
    since(offset, offset_since_us_);
    ready_ = (state_ == S::waiting || state_ == S::landed || state_ == S::aborted) && good_since_us_ >= 0 &&
             static_cast<float>(t_us - good_since_us_) >= 1e6F * p_.ready_time_s && !vehicle.mission_lost;
}

// What the flight costs, how far home is, and whether the map still grows.
void Mission::account(const Estimate& estimate, const OccupancyGrid& grid, const VehicleSample& vehicle) {
    if ((kFlying & bit(state_)) == 0U) { return; }
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    if (airborne_ || state_ != S::taking_off) {
        energy_.step(vehicle.battery_remaining, std::hypot(estimate.planar.vx_m_s, estimate.planar.vy_m_s), t_us_);
    }
    if (localised_) { trail_.step(grid, pose.x_m, pose.y_m); }
    const std::uint32_t passed = floors_.soundings().blocks();   // ceiling and ground that were looked at count as well
    if (state_ != S::exploring || grid.known_area_m2() > learned_m2_ + kLearnedM2 || passed > learned_blocks_ + kLearnedBlocks) {
        learned_m2_ = grid.known_area_m2();
        learned_blocks_ = passed;
        learned_us_ = t_us_;
    }
}

// Crossing what is known from one end to the other is the most that a flight to the next new thing can take.
bool Mission::gets_nowhere() const {
    const float limit_s = p_.progress_time_s + 2.0F * trail_.longest_m() / std::max(energy_.cruise_m_s(), 0.1F);
    return state_ == S::exploring && static_cast<float>(t_us_ - learned_us_) > 1e6F * limit_s;
}

void Mission::enter(const MissionState next, const StateReason why, const Pose2<Map, Body>& last_setpoint) {
    floor_result_ = FloorPlanner::Result::busy;
    if (next == S::paused) { paused_from_ = state_; }
    state_ = next;
    reason_ = why;
    entered_us_ = t_us_;
    arrived_since_us_ = -1;
    no_way_since_us_ = -1;
    turned_rad_ = 0.0F;
    anchor_ = last_setpoint;
    target_.yaw_rad = last_setpoint.yaw_rad;
}

float Mission::height_wanted_m(const Estimate& estimate) const {
    const AltitudeEstimate& a = estimate.altitude;
    const float half_hull_m = 0.5F * p_.hull_height_m;
    const float floor_z_m = floors_.floor_z_m(a);
    float z_m = floor_z_m + p_.cruise_height_m;
    if (std::isfinite(a.ground_z_m)) {
        const float furniture_m = half_hull_m + p_.vertical_clearance_m;
        // Treads that lead down from the floor are seen through an opening: that is not the way down.
        const bool through_opening = p_.floors_max > 1 && a.ground_z_m < floor_z_m - kOpeningBelowM;
        if (a.on_stairs && !through_opening) {
            const float tread_m = a.ground_z_m + std::max(furniture_m, p_.stair_height_m);
            z_m = floor_z_m > a.ground_z_m ? tread_m : std::max(z_m, tread_m);  // down to a floor not yet seen: by the treads alone
        } else {
            z_m = std::max(z_m, a.ground_z_m + furniture_m);
        }
    }
    if (std::isfinite(a.ceiling_z_m)) { z_m = std::min(z_m, a.ceiling_z_m - half_hull_m - p_.vertical_clearance_m); }
    return z_m;
}

const Target& Mission::advance(const Estimate& estimate, const OccupancyGrid& grid, const VehicleSample& vehicle,
                               const Pose2<Map, Body>& last_setpoint, const std::int64_t t_us) {
    before_us_ = t_us_;
    t_us_ = t_us;
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    if (localised_ || estimate.planar.quality >= 0) { explorer_.observe(grid, pose, t_us); }
    watch(estimate, vehicle, t_us);
    account(estimate, grid, vehicle);

    const auto lasted = [t_us](const std::int64_t since_us, const float seconds) {
        return since_us >= 0 && static_cast<float>(t_us - since_us) >= 1e6F * seconds;
    };
    Now now;
    now.armed = vehicle.armed;
    now.offboard = vehicle.offboard;
    now.on_ground = vehicle.landed == VehicleSample::Landed::on_ground;
    now.mission_lost = vehicle.mission_lost;
    now.lost_long = lasted(lost_since_us_, p_.lost_land_s);
    now.height_lost = lasted(height_lost_since_us_, p_.lost_land_s);
    now.offset = lasted(offset_since_us_, p_.frame_offset_time_s);
    now.battery_low = energy_.must_return(trail_.way_home_m());
    now.ready = ready_;
    now.order = pending_;
    now.finished = explorer_.finished();
    now.no_progress = gets_nowhere();
    now.more_floors = state_ == S::exploring && now.finished && floors_.more(grid, pose);
    now.floor_reached = floor_result_ == FloorPlanner::Result::arrived;
    now.no_floor_left = floor_result_ == FloorPlanner::Result::nothing;
    now.looked = turned_rad_ >= p_.look_around_rad;
    now.timed_out = airborne_ && lasted(entered_us_, p_.takeoff_time_s);
    const float speed_m_s = std::hypot(estimate.planar.vx_m_s, estimate.planar.vy_m_s);
    const bool high = std::fabs(estimate.altitude.z_m - height_wanted_m(estimate)) < kHeightToleranceM;
    const bool home = floors_.on_start_floor() && !floors_.shifting() && std::hypot(pose.x_m - home_.x_m, pose.y_m - home_.y_m) < p_.home_tolerance_m && speed_m_s < kSlowM_S;
    const bool arrived = (state_ == S::taking_off && now.armed && high) || (state_ == S::returning_home && home);
    if (!arrived) {
        arrived_since_us_ = -1;
    } else if (arrived_since_us_ < 0) {
        arrived_since_us_ = t_us;
    }
    const bool settled = arrived_since_us_ >= 0 && t_us - arrived_since_us_ >= kSettledUs;
    now.at_height = state_ == S::taking_off && settled;
    now.at_home = state_ == S::returning_home && settled;
    if (state_ != S::returning_home || explorer_.has_way() || floors_.shifting()) {
        no_way_since_us_ = -1;
    } else if (no_way_since_us_ < 0) {
        no_way_since_us_ = t_us;
    }
    now.no_way = no_way_since_us_ >= 0 && t_us - no_way_since_us_ > kNoWayUs;

    // First row that matches wins. docs/safety.md says why each is there.
    static constexpr MissionRow kTable[] = {
        {kStarted, [](const Now& n) { return n.mission_lost; }, S::aborted, R::control_lost},
        {kStarted, [](const Now& n) { return n.on_ground && !n.armed && n.order == Order::abort; }, S::waiting, R::abort_ordered},
        {kFlying, [](const Now& n) { return n.armed && n.order == Order::abort; }, S::landing, R::abort_ordered},
        {kFlying, [](const Now& n) { return n.armed && n.order == Order::land; }, S::landing, R::land_ordered},
        {bit(S::taking_off), [](const Now& n) { return !n.armed && (n.order == Order::abort || n.order == Order::land); }, S::waiting, R::abort_ordered},
        {kFlying, [](const Now& n) { return n.armed && n.lost_long; }, S::landing, R::localisation_lost},
        {kFlying, [](const Now& n) { return n.armed && n.height_lost; }, S::landing, R::height_lost},
        {kFlying, [](const Now& n) { return n.armed && n.offset; }, S::landing, R::frames_disagree},
        {bit(S::landing), [](const Now& n) { return n.on_ground; }, S::landed, R::on_ground},
        {kOut, [](const Now& n) { return n.battery_low; }, S::returning_home, R::battery_low},
        {kOut, [](const Now& n) { return n.order == Order::return_home; }, S::returning_home, R::return_ordered},
        {bit(S::looking_around) | bit(S::exploring) | bit(S::returning_home) | bit(S::changing_floor), [](const Now& n) { return n.order == Order::pause; }, S::paused, R::pause_ordered},
        {bit(S::waiting) | bit(S::landed) | bit(S::aborted), [](const Now& n) { return n.order == Order::start && n.ready; }, S::taking_off, R::start_ordered},
        {bit(S::waiting) | bit(S::landed) | bit(S::aborted), [](const Now& n) { return n.order == Order::start; }, S::waiting, R::not_ready},
        {bit(S::taking_off), [](const Now& n) { return n.at_height; }, S::looking_around, R::height_reached},
        {bit(S::taking_off), [](const Now& n) { return n.timed_out; }, S::landing, R::takeoff_timed_out},
        {bit(S::looking_around), [](const Now& n) { return n.looked; }, S::exploring, R::looked_around},
        {bit(S::exploring), [](const Now& n) { return n.finished && n.more_floors; }, S::changing_floor, R::nothing_left},
        {bit(S::exploring), [](const Now& n) { return n.finished; }, S::returning_home, R::nothing_left},
        {bit(S::changing_floor), [](const Now& n) { return n.floor_reached; }, S::looking_around, R::floor_reached},
        {bit(S::changing_floor), [](const Now& n) { return n.no_floor_left; }, S::returning_home, R::nothing_left},
        {bit(S::exploring), [](const Now& n) { return n.no_progress; }, S::returning_home, R::no_progress},
        {bit(S::returning_home), [](const Now& n) { return n.at_home; }, S::landing, R::at_home},
        {bit(S::returning_home), [](const Now& n) { return n.no_way; }, S::landing, R::home_unreachable},
    };
    bool changed = false;
    for (const MissionRow& row : kTable) {
        if ((row.from & bit(state_)) == 0U || !row.when(now)) { continue; }
        enter(row.to, row.why, last_setpoint);
        changed = true;
        break;
    }
    if (!changed && state_ == S::paused && pending_ == Order::resume) {  // the one change whose end depends on the past
        enter(paused_from_, R::resume_ordered, last_setpoint);
        changed = true;
    }
    pending_ = Order::none;
    if (changed && state_ == S::taking_off) {
        home_ = pose;
        anchor_ = pose;
        target_.yaw_rad = pose.yaw_rad;
        explorer_.begin(home_);
        energy_.begin();
        trail_.begin(grid, home_.x_m, home_.y_m);
    }
    if (changed && state_ == S::landing && reason_ == R::at_home) {
        anchor_.x_m = home_.x_m;
        anchor_.y_m = home_.y_m;
    }
    if (changed && state_ == S::looking_around && reason_ == R::floor_reached) { explorer_.begin(home_); }
    airborne_ = state_ == S::taking_off && (airborne_ ? now.armed : now.armed && now.offboard);
    if (state_ == S::taking_off && !airborne_) { entered_us_ = t_us; }  // the clock of the climb starts with the climb
    target_.mode = Target::Mode::none;
    aim(estimate, grid, last_setpoint);
    return target_;
}

// What the present state asks of the reference.
void Mission::aim(const Estimate& estimate, const OccupancyGrid& grid, const Pose2<Map, Body>& last_setpoint) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    const auto stand = [&](const Target::Mode mode) {
        target_.mode = mode;
        target_.path.clear();
        static_cast<void>(target_.path.push({anchor_.x_m, anchor_.y_m, 0.8F}));
    };
    explorer_.keep_off(state_ == S::changing_floor || floors_.by_passage(pose.x_m, pose.y_m));
    if (floors_.over_stairs()) { explorer_.add_stairs(grid.floor(), pose.x_m, pose.y_m); }
    target_.climb_rate_m_s = p_.climb_rate_m_s;
    if (state_ != S::waiting && state_ != S::landed && state_ != S::aborted && state_ != S::landing) { target_.z_m = height_wanted_m(estimate); }
    switch (state_) {
        case S::waiting:
        case S::landed:
        case S::aborted:
            target_.path.clear();
            return;
        case S::taking_off:
            stand(airborne_ ? Target::Mode::follow : Target::Mode::ground);
            return;
        case S::looking_around: {
            stand(Target::Mode::follow);
            const float turned = wrap_angle(pose.yaw_rad - last_yaw_rad_);
            if (t_us_ != entered_us_) { turned_rad_ += turned; }
            last_yaw_rad_ = pose.yaw_rad;
            target_.yaw_rad = wrap_angle(pose.yaw_rad + kLookAheadRad);
            return;
        }
        case S::exploring:
        case S::returning_home:
        case S::changing_floor:
            if (!localised_ || !estimate.altitude.valid) {  // hover where the last setpoint was; watch() counts the time
                anchor_ = last_setpoint;
                stand(Target::Mode::hold);
                return;
            }
            target_.mode = Target::Mode::follow;
            if (state_ == S::exploring) {
                floors_.note_exploring(1e-6F * static_cast<float>(std::clamp<std::int64_t>(t_us_ - before_us_, 0, kLongStepUs)));
                explorer_.explore(grid, pose, last_setpoint, t_us_, target_);
            } else if (state_ == S::changing_floor) {
                floor_result_ = floors_.step(estimate, grid, explorer_, last_setpoint, t_us_, target_);
                if (floor_result_ == FloorPlanner::Result::nothing) {   // the last step before the way home: stays where it is
                    anchor_ = last_setpoint;
                    stand(Target::Mode::follow);
                }
            } else if (floors_.go_home(estimate, grid, explorer_, last_setpoint, t_us_, target_) == FloorPlanner::Result::nothing) {
                explorer_.go_to(grid, pose, last_setpoint, home_.x_m, home_.y_m, t_us_, target_);
            }
            return;
        case S::paused:
            stand(Target::Mode::follow);
            return;
        case S::landing: {
            stand(Target::Mode::land);
            const float ground_m = std::isfinite(estimate.altitude.ground_z_m) ? estimate.altitude.ground_z_m : estimate.altitude.floor_z_m;
            const bool high = estimate.altitude.valid && estimate.altitude.z_m - ground_m > kFastDescentAboveM;
            target_.climb_rate_m_s = high ? p_.climb_rate_m_s : p_.land_rate_m_s;
            target_.z_m = ground_m - 1.0F;   // through the floor: only the autopilot's word ends the descent
            return;
        }
    }
}

}  // namespace noctule
