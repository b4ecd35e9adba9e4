/// What differs between flight controllers: modes and take-off. One small file each: px4.cpp, ardupilot.cpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace noctule {

/// A mode as MAV_CMD_DO_SET_MODE wants it (param2, param3) and as HEARTBEAT.custom_mode shows it.
struct FlightMode {
    float main = 0.0F;
    float sub = 0.0F;
    std::uint32_t custom_mode = 0;
};

/// A parameter of the autopilot without which it cannot be flown indoors. Right when low <= value <= high; with `bits` when all of them are set.
struct PreflightRow {
    const char* id;
    float low;
    float high;
    std::uint32_t bits;
    const char* should;         ///< what it should be and why, in few words ("15: position, height, velocity, yaw")
};

inline constexpr std::size_t kMaxPreflightRows = 24;

struct Flavour {
    const char* name;
    FlightMode offboard;        ///< follows our setpoints
    FlightMode land;            ///< lands on the spot, needs nothing from us
    bool takeoff_command;       ///< setpoints are ignored on the ground: MAV_CMD_NAV_TAKEOFF comes first
    /// Short name of a mode for the pilot; "another mode" when it is not known.
    const char* (*mode_name)(std::uint32_t custom_mode);
    bool cast_integers;         ///< PARAM values of whole numbers are cast to float (else their bytes are copied)
    std::span<const PreflightRow> preflight;
    const char* elevation_parameter;  ///< to be set to the origin's altitude before the origin is given; null: none
    bool origin_serves;         ///< a global origin gives it a global position; else its own landing mode flies off to 0 N 0 E once it has one
    bool lists_slow_streams;    ///< while it hands out its parameters or files, all else comes at a fraction of its rate
    std::uint8_t odometry_estimator;  ///< MAV_ESTIMATOR_TYPE under which it takes our ODOMETRY
};

extern const Flavour kPx4;
extern const Flavour kArdupilot;

/// The flavour of HEARTBEAT.autopilot; null when it is none that we know how to fly.
[[nodiscard]] const Flavour* flavour_of(std::uint8_t mav_autopilot);

}  // namespace noctule
