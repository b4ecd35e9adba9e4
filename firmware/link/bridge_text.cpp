#include "link/bridge_text.hpp"

#include "link/mavlink.hpp"
#include "plan/mission.hpp"

namespace noctule {

const char* state_text(const std::int32_t state) {
    switch (static_cast<MissionState>(state)) {
        case MissionState::waiting: return "waiting";
        case MissionState::taking_off: return "taking off";
        case MissionState::looking_around: return "looking around";
        case MissionState::exploring: return "exploring";
        case MissionState::returning_home: return "returning home";
        case MissionState::landing: return "landing";
        case MissionState::landed: return "landed";
        case MissionState::aborted: return "aborted";
        case MissionState::paused: return "paused";
        case MissionState::changing_floor: return "changing floor";
    }
    return "unknown";
}

const char* reason_text(const std::int32_t reason) {
    switch (static_cast<StateReason>(reason)) {
        case StateReason::none: return "";
        case StateReason::start_ordered: return "start ordered";
        case StateReason::height_reached: return "height reached";
        case StateReason::looked_around: return "looked around";
        case StateReason::nothing_left: return "nothing left to explore";
        case StateReason::return_ordered: return "return ordered";
        case StateReason::land_ordered: return "landing ordered";
        case StateReason::abort_ordered: return "abort ordered";
        case StateReason::pause_ordered: return "pause ordered";
        case StateReason::resume_ordered: return "resume ordered";
        case StateReason::at_home: return "at home";
        case StateReason::on_ground: return "on the ground";
        case StateReason::control_lost: return "control taken from us";
        case StateReason::localisation_lost: return "localisation lost";
        case StateReason::height_lost: return "height lost";
        case StateReason::takeoff_timed_out: return "take-off timed out";
        case StateReason::battery_low: return "battery low";
        case StateReason::frames_disagree: return "autopilot's position differs";
        case StateReason::home_unreachable: return "no way home";
        case StateReason::not_ready: return "not ready";
        case StateReason::no_progress: return "nothing new for long";
        case StateReason::floor_reached: return "floor reached";
    }
    return "unknown";
}

const char* fault_text(const Fault fault) {
    switch (fault) {
        case Fault::none: return "";
        case Fault::nav_restarted: return "nav restarted in flight";
        case Fault::frames_diverge: return "estimate and autopilot differ";
        case Fault::vision_lost: return "estimate lost";
        case Fault::nav_silent: return "nav silent";
        case Fault::setpoint_absurd: return "absurd setpoints";
        case Fault::setpoint_missing: return "no setpoint";
    }
    return "";
}

const char* notice_text(const Notice notice) {
    switch (notice) {
        case Notice::none: return "";
        case Notice::start_sequence: return "start accepted";
        case Notice::asking_mode: return "asking for offboard mode";
        case Notice::asking_arm: return "asking to arm";
        case Notice::armed: return "armed";
        case Notice::held: return "holding position";
        case Notice::resumed: return "setpoints are back, going on";
        case Notice::landing_ordered: return "landing";
        case Notice::touched_down: return "on the floor, landing mode";
        case Notice::completed: return "disarmed";
        case Notice::pilot_took_over: return "yielded, mode is";
        case Notice::pilot_armed: return "yielded: armed by somebody else";
        case Notice::disarmed_in_flight: return "disarmed, mission over";
        case Notice::no_setpoint: return "start given up: nav sends no setpoint";
        case Notice::mode_refused: return "start given up: offboard mode refused";
        case Notice::arm_refused: return "start given up: arming refused";
    }
    return "";
}

std::uint8_t notice_severity(const Notice notice) {
    switch (notice) {
        case Notice::landing_ordered:
        case Notice::disarmed_in_flight: return MAV_SEVERITY_CRITICAL;
        case Notice::held:
        case Notice::pilot_took_over:
        case Notice::pilot_armed:
        case Notice::no_setpoint:
        case Notice::mode_refused:
        case Notice::arm_refused: return MAV_SEVERITY_WARNING;
        default: return MAV_SEVERITY_INFO;
    }
}

}  // namespace noctule
