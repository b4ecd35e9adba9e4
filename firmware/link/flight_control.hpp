/// Who flies: the start sequence, holding, landing, and giving way to the pilot. A table of phases (docs/safety_bridge.md).
///
/// Only this class decides to change the mode or to arm, once a start, and never after somebody else changed the mode: then it
/// yields until the next start. It looks at the autopilot and at the supervisor's verdict, and says what to ask for; it
/// sends nothing itself. Time is the autopilot's clock. No heap, no clock.
#pragma once

#include <cstdint>

#include "link/supervisor.hpp"
#include "params.gen.hpp"

namespace noctule {

enum class Phase : std::uint8_t {
    idle,       ///< not in charge
    streaming,  ///< start accepted: setpoints flow, nothing is asked yet
    entering,   ///< asking for the offboard mode
    arming,     ///< in the mode, asking to arm
    flying,     ///< nav's setpoints are flown
    holding,    ///< nav failed: standing at the last good setpoint
    landing,    ///< the autopilot was asked to land
    yielded,    ///< somebody else took over: not in charge until the next start
};

/// What the autopilot is to be asked for now. At most one a step; repeated each second until it shows effect.
enum class Request : std::uint8_t { none, offboard_mode, land_mode, arm, disarm, takeoff };

/// What has just happened, for the pilot and for nav.
enum class Notice : std::uint8_t {
    none,
    start_sequence,
    asking_mode,
    asking_arm,
    armed,
    held,
    resumed,
    landing_ordered,
    touched_down,         ///< nav has set it down: the autopilot's own landing finds that out and switches off
    completed,            ///< landed and disarmed
    pilot_took_over,      ///< mode changed by somebody else
    pilot_armed,          ///< armed by somebody else during the start
    disarmed_in_flight,
    no_setpoint,          ///< start given up: nav sent none
    mode_refused,         ///< start given up: the mode was not entered
    arm_refused,          ///< start given up: did not arm
};

/// The autopilot and nav as they are now.
struct FlightView {
    std::int64_t now_us = 0;
    std::uint32_t custom_mode = 0;
    std::uint32_t offboard_mode = 0;   ///< custom_mode of the offboard mode
    std::uint32_t land_mode = 0;       ///< custom_mode of the landing mode
    bool takeoff_command = false;      ///< the autopilot wants a command to leave the ground
    bool armed = false;
    bool on_ground = false;
    bool in_air = false;
    bool setpoint_fresh = false;       ///< a good setpoint within the time-out
    bool nav_done = false;             ///< nav says landed and wants the motors off
    bool nav_landing = false;          ///< nav is landing or has landed
    bool below_floor = false;          ///< nav's setpoint is below what can be reached: the vehicle is on the floor
    Fault fault = Fault::none;         ///< the supervisor's verdict
};

struct FlightStep {
    Request request = Request::none;
    Notice notice = Notice::none;
    Fault fault = Fault::none;         ///< why, with held and landing_ordered
};

class FlightControl {
public:
    explicit FlightControl(const Parameters& parameters) : p_(parameters) {}

    /// A start was accepted at the view's time. False: one is under way already; nothing changes.
    [[nodiscard]] bool start(const FlightView& view);

    /// The pilot chose the offboard mode and arms himself: nothing is asked for. False as above.
    [[nodiscard]] bool start_by_pilot(const FlightView& view);

    /// One look at the world, at rising times. Cost is constant.
    FlightStep step(const FlightView& view);

    /// The autopilot restarted: whatever was under way is over.
    void autopilot_restarted();

    /// The autopilot answered the take-off command with a refusal: it flies by setpoints alone.
    void takeoff_refused() { takeoff_pending_ = false; }

    [[nodiscard]] Phase phase() const { return phase_; }
    /// A start was accepted and the flight is not over.
    [[nodiscard]] bool active() const { return phase_ != Phase::idle && phase_ != Phase::yielded; }
    /// Nav's setpoints go out to the autopilot.
    [[nodiscard]] bool passes_setpoints() const {
        return (phase_ == Phase::streaming || phase_ == Phase::entering || phase_ == Phase::arming || phase_ == Phase::flying) && !takeoff_pending_;
    }
    /// The last good setpoint is to be repeated with velocity zero.
    [[nodiscard]] bool holds() const { return phase_ == Phase::holding || (phase_ == Phase::landing && !land_mode_seen_); }
    /// Control was taken from nav since the last start.
    [[nodiscard]] bool mission_lost() const { return mission_lost_; }

private:
    FlightStep enter(Phase next, const FlightView& view, Notice notice, Fault fault = Fault::none);
    FlightStep yield(const FlightView& view, Notice notice);
    FlightStep step_streaming(const FlightView& view);
    FlightStep step_entering(const FlightView& view);
    FlightStep step_arming(const FlightView& view);
    FlightStep step_flying(const FlightView& view);
    FlightStep step_holding(const FlightView& view);
    FlightStep step_landing(const FlightView& view);
    [[nodiscard]] Request repeat(Request request, const FlightView& view);
    [[nodiscard]] bool mode_taken(const FlightView& view) const;

    const Parameters& p_;
    Phase phase_ = Phase::idle;
    bool mission_lost_ = false;
    bool by_pilot_ = false;                  ///< the pilot arms
    bool takeoff_pending_ = false;
    bool land_mode_seen_ = false;
    std::uint32_t mode_before_ = 0;          ///< mode when the start was accepted
    std::int64_t entered_us_ = 0;            ///< when the phase was entered
    std::int64_t stream_since_us_ = -1;      ///< since when good setpoints flow
    std::int64_t next_request_us_ = 0;
    std::int64_t pressed_since_us_ = -1;     ///< since when the vehicle has been on the floor while nav lands it
};

}  // namespace noctule
