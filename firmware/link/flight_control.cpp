#include "link/flight_control.hpp"

namespace noctule {

namespace {

constexpr float kMicroseconds = 1e6F;
constexpr std::int64_t kRepeat_us = 1000000;         // an autopilot shows mode and arming in its heartbeat, once a second
constexpr std::int64_t kStreamGiveUp_us = 10000000;  // nav must give a setpoint within this time after the start
constexpr std::int64_t kPressed_us = 1000000;        // on the floor for so long: no bump, no gust
constexpr std::int64_t kTakeoffWait_us = 10000000;   // after this the take-off command has failed: go on by setpoints

std::int64_t to_us(const float seconds) { return static_cast<std::int64_t>(seconds * kMicroseconds); }

/// With these the setpoints' frame or the autopilot's own position is not to be trusted: holding would be pretence.
bool must_land(const Fault fault) { return fault == Fault::nav_restarted || fault == Fault::frames_diverge || fault == Fault::vision_lost; }

}  // namespace

bool FlightControl::start(const FlightView& view) {
    if (active()) { return false; }
    mission_lost_ = false;
    takeoff_pending_ = false;
    land_mode_seen_ = false;
    pressed_since_us_ = -1;
    stream_since_us_ = -1;
    mode_before_ = view.custom_mode;
    by_pilot_ = false;
    static_cast<void>(enter(Phase::streaming, view, Notice::start_sequence));
    return true;
}

bool FlightControl::start_by_pilot(const FlightView& view) {
    if (!start(view)) { return false; }
    by_pilot_ = true;
    static_cast<void>(enter(Phase::arming, view, Notice::start_sequence));
    return true;
}

void FlightControl::autopilot_restarted() {
    if (active()) { mission_lost_ = true; }
    phase_ = active() ? Phase::yielded : phase_;
    takeoff_pending_ = false;
}

FlightStep FlightControl::enter(const Phase next, const FlightView& view, const Notice notice, const Fault fault) {
    phase_ = next;
    entered_us_ = view.now_us;
    next_request_us_ = view.now_us;
    return {Request::none, notice, fault};
}

FlightStep FlightControl::yield(const FlightView& view, const Notice notice) {
    mission_lost_ = true;
    takeoff_pending_ = false;
    return enter(Phase::yielded, view, notice);
}

Request FlightControl::repeat(const Request request, const FlightView& view) {
    if (view.now_us < next_request_us_) { return Request::none; }
    next_request_us_ = view.now_us + kRepeat_us;
    return request;
}

/// Before the mode is ours, somebody else chose another one.
bool FlightControl::mode_taken(const FlightView& view) const { return view.custom_mode != mode_before_ && view.custom_mode != view.offboard_mode; }

FlightStep FlightControl::step(const FlightView& view) {
    switch (phase_) {
        case Phase::idle:
        case Phase::yielded: return {};
        case Phase::streaming: return step_streaming(view);
        case Phase::entering: return step_entering(view);
        case Phase::arming: return step_arming(view);
        case Phase::flying: return step_flying(view);
        case Phase::holding: return step_holding(view);
        case Phase::landing: return step_landing(view);
    }
    return {};
}

FlightStep FlightControl::step_streaming(const FlightView& view) {
    if (mode_taken(view)) { return yield(view, Notice::pilot_took_over); }
    if (view.armed) { return yield(view, Notice::pilot_armed); }
    if (!view.setpoint_fresh) {
        stream_since_us_ = -1;
        if (view.now_us - entered_us_ > kStreamGiveUp_us) { return yield(view, Notice::no_setpoint); }
        return {};
    }
    if (stream_since_us_ < 0) { stream_since_us_ = view.now_us; }
    if (view.now_us - stream_since_us_ < to_us(p_.link_stream_s)) { return {}; }
    return enter(Phase::entering, view, Notice::asking_mode);
}

FlightStep FlightControl::step_entering(const FlightView& view) {
    if (mode_taken(view)) { return yield(view, Notice::pilot_took_over); }
    if (view.armed) { return yield(view, Notice::pilot_armed); }
    if (view.custom_mode == view.offboard_mode) { return enter(Phase::arming, view, Notice::asking_arm); }
    if (view.now_us - entered_us_ > to_us(p_.link_mode_timeout_s)) { return yield(view, Notice::mode_refused); }
    return {repeat(Request::offboard_mode, view)};
}

FlightStep FlightControl::step_arming(const FlightView& view) {
    if (view.custom_mode != view.offboard_mode) { return yield(view, Notice::pilot_took_over); }
    if (view.armed && (!by_pilot_ || view.setpoint_fresh)) {  // a pilot's start: nav's first setpoint may be a scan away
        takeoff_pending_ = view.takeoff_command;
        return enter(Phase::flying, view, Notice::armed);
    }
    if (!by_pilot_ && !view.setpoint_fresh && view.fault != Fault::none) { return yield(view, Notice::no_setpoint); }
    if (view.now_us - entered_us_ > to_us(p_.link_arm_timeout_s)) { return yield(view, Notice::arm_refused); }
    return {by_pilot_ ? Request::none : repeat(Request::arm, view)};
}

FlightStep FlightControl::step_flying(const FlightView& view) {
    if (!view.armed) {
        takeoff_pending_ = false;
        if (view.nav_landing) { return enter(Phase::idle, view, Notice::completed); }
        return yield(view, Notice::disarmed_in_flight);
    }
    if (view.custom_mode != view.offboard_mode) { return yield(view, Notice::pilot_took_over); }
    if (view.nav_done && view.on_ground) { return {repeat(Request::disarm, view)}; }
    // Landed in nav's opinion: it sends no setpoint any more, and that is no fault.
    if (view.fault != Fault::none && !view.nav_done) {
        takeoff_pending_ = false;
        if (must_land(view.fault)) {
            mission_lost_ = true;
            return enter(Phase::landing, view, Notice::landing_ordered, view.fault);
        }
        return enter(Phase::holding, view, Notice::held, view.fault);
    }
    // Not every autopilot's land detector looks at a descent by setpoints (PX4 wants a faster one than is kind to the legs): its own landing
    // mode does, on the spot.
    const bool pressed = view.nav_landing && !view.nav_done && view.below_floor;
    if (!pressed) {
        pressed_since_us_ = -1;
    } else if (pressed_since_us_ < 0) {
        pressed_since_us_ = view.now_us;
    } else if (view.now_us - pressed_since_us_ > kPressed_us) {
        return enter(Phase::landing, view, Notice::touched_down);
    }
    if (takeoff_pending_) {
        if (view.in_air || view.now_us - entered_us_ > kTakeoffWait_us) {
            takeoff_pending_ = false;
        } else {
            return {repeat(Request::takeoff, view)};
        }
    }
    return {};
}

FlightStep FlightControl::step_holding(const FlightView& view) {
    if (!view.armed) { return yield(view, Notice::disarmed_in_flight); }
    if (view.custom_mode != view.offboard_mode) { return yield(view, Notice::pilot_took_over); }
    if (view.fault == Fault::none) { return enter(Phase::flying, view, Notice::resumed); }
    if (must_land(view.fault) || view.now_us - entered_us_ > to_us(p_.link_hold_s)) {
        mission_lost_ = true;
        return enter(Phase::landing, view, Notice::landing_ordered, view.fault);
    }
    return {};
}

FlightStep FlightControl::step_landing(const FlightView& view) {
    if (!view.armed) { return enter(Phase::idle, view, Notice::completed); }
    if (view.custom_mode == view.land_mode) {
        land_mode_seen_ = true;
        return {};
    }
    if (land_mode_seen_ || view.custom_mode != view.offboard_mode) { return yield(view, Notice::pilot_took_over); }
    return {repeat(Request::land_mode, view)};
}

}  // namespace noctule
