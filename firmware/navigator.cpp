#include "navigator.hpp"

namespace noctule {

Navigator::Navigator(const Parameters& parameters)
    : localiser_(parameters), altitude_(parameters), grid_(parameters), mission_(parameters), reference_(parameters), guard_(parameters) {}

void Navigator::update_estimate(const SensorFrame& frame) {
    estimate_.t_us = frame.scan.t_us;
    if (!frame.attitude.empty()) {
        estimate_.roll_rad = frame.attitude.back().roll_rad;
        estimate_.pitch_rad = frame.attitude.back().pitch_rad;
    }
    estimate_.planar = localiser_.update(frame, estimate_.altitude);
    estimate_.altitude = altitude_.update(frame, estimate_.planar);
}

const NavOutput& Navigator::step(const SensorFrame& frame) {
    if (!frame.vehicle.empty()) { vehicle_ = frame.vehicle.back(); }
    const std::int64_t t_us = frame.scan.t_us;

    update_estimate(frame);
    grid_.integrate(estimate_, localiser_.level_scan());
    const Target& target = mission_.step(estimate_, grid_, vehicle_, frame.command, reference_.pose(), t_us);
    const Setpoint& wanted = reference_.step(estimate_, target, t_us);
    const bool vertical_free = mission_.state() == MissionState::taking_off || mission_.state() == MissionState::landing;
    const Setpoint& sent = guard_.decide(estimate_, localiser_.level_scan(), grid_, wanted, vertical_free, t_us);
    reference_.settle(sent);

    output_.t_us = t_us;
    output_.scan_seq = frame.scan.seq;
    output_.estimate = estimate_;
    output_.setpoint = sent;
    output_.state = mission_.state();
    output_.reason = mission_.reason();
    output_.ready = mission_.ready();
    output_.want_disarm = mission_.want_disarm();
    output_.goal_valid = mission_.goal(output_.goal_x_m, output_.goal_y_m);
    output_.known_area_m2 = grid_.known_area_m2();
    output_.clearance_m = guard_.clearance_m();
    output_.guard_interventions = guard_.interventions();
    output_.guard_rule = guard_.rule();
    return output_;
}

}  // namespace noctule
