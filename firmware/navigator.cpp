#include "navigator.hpp"

#include <cmath>
#include <limits>

namespace noctule {

namespace {

constexpr float kThroughOpeningM = 0.5F;   ///< ground this far under the floor

}  // namespace

Navigator::Navigator(const Parameters& parameters)
    : localiser_(parameters), altitude_(parameters), grid_(parameters), mission_(parameters), reference_(parameters), guard_(parameters) {}

void Navigator::update_estimate(const SensorFrame& frame) {
    estimate_.t_us = frame.scan.t_us;
    for (const AttitudeSample& sample : frame.attitude) {
        if (!std::isfinite(sample.roll_rad) || !std::isfinite(sample.pitch_rad)) { continue; }
        estimate_.roll_rad = sample.roll_rad;
        estimate_.pitch_rad = sample.pitch_rad;
    }
    // Heights for the laser's tilt count from the floor that the mission was on one step ago; what lies deeper is seen through an opening.
    AltitudeEstimate last = estimate_.altitude;
    last.floor_z_m = mission_.floors().floor_z_m(last);
    if (last.ground_z_m < last.floor_z_m - kThroughOpeningM) { last.ground_z_m = std::numeric_limits<float>::quiet_NaN(); }
    localiser_.enter_layer(mission_.floors().layer());
    estimate_.planar = localiser_.update(frame, last);
    estimate_.altitude = altitude_.update(frame, estimate_.planar);
}

const NavOutput& Navigator::step(const SensorFrame& frame) {
    if (!frame.vehicle.empty()) { vehicle_ = frame.vehicle.back(); }
    const std::int64_t t_us = frame.scan.t_us;

    update_estimate(frame);
    const FloorPlanner& floors = mission_.floors();
    mission_.see(estimate_, frame, localiser_.level_scan(), grid_);
    static_cast<void>(grid_.select_floor(floors.current()));
    grid_.set_published_floors(floors.confirmed_bits());
    if (floors.layer() != FloorPlanner::kShaft) {
        Estimate on_floor = estimate_;
        on_floor.altitude.floor_z_m = floors.floor_z_m(estimate_.altitude);
        grid_.integrate(on_floor, localiser_.level_scan());
    }
    mission_.hear(frame.goal);
    const Target& target = mission_.step(estimate_, grid_, vehicle_, frame.command, reference_.pose(), t_us);
    const Setpoint& wanted = reference_.step(estimate_, target, t_us);
    const bool vertical_free = mission_.state() == MissionState::taking_off || mission_.state() == MissionState::landing;
    const Setpoint& sent = guard_.decide(estimate_, localiser_.level_scan(), grid_, wanted, vertical_free, t_us, mission_.explorer().where().stairs());
    reference_.settle(sent);

    output_.t_us = t_us;
    output_.scan_seq = frame.scan.seq;
    output_.estimate = estimate_;
    output_.setpoint = sent.trimmed();
    output_.state = mission_.state();
    output_.reason = mission_.reason();
    output_.ready = mission_.ready();
    output_.want_disarm = mission_.want_disarm();
    output_.goal_valid = mission_.goal(output_.goal_x_m, output_.goal_y_m);
    output_.floor = floors.name_of(floors.current());
    for (std::int32_t i = 0; i < kMaxFloors; ++i) { output_.floor_names[static_cast<std::size_t>(i)] = floors.name_of(i); }
    output_.openings_refused = static_cast<std::int32_t>(floors.judged().size());
    output_.ask = mission_.explorer().external().ask();
    output_.policy = mission_.explorer().kind();
    output_.known_area_m2 = grid_.known_area_m2();
    output_.explored_share = -1.0F;
    if (const std::int32_t behind = mission_.explorer().behind_cells(); behind >= 0) {
        const float known_m2 = grid_.known_area_m2(floors.current());
        const float behind_m2 = static_cast<float>(behind) * grid_.geometry().cell_m() * grid_.geometry().cell_m();
        if (known_m2 > 0.0F) { output_.explored_share = known_m2 / (known_m2 + behind_m2); }
    }
    output_.clearance_m = guard_.clearance_m();
    output_.guard_interventions = guard_.interventions();
    output_.guard_rule = guard_.rule();
    return output_;
}

}  // namespace noctule
