/// Is what the autonomy sends fit to be flown? Watches setpoints, the estimate, and the autopilot's own position.
///
/// docs/safety_bridge.md has the table of faults. Everything counts the autopilot's clock. Frame Map, SI. No heap, no clock.
#pragma once

#include <cstdint>

#include "command/setpoint.hpp"
#include "lcmtypes/noctule/nav_t.hpp"
#include "lcmtypes/noctule/odom_t.hpp"
#include "link/mavlink_convert.hpp"
#include "params.gen.hpp"

namespace noctule {

/// What became of the setpoint in a NAV message.
enum class SetpointCheck : std::uint8_t {
    good,
    absent,               ///< nav gives none
    rejected_not_finite,
    rejected_time,        ///< older than one we had, or far off the autopilot's clock
    rejected_reach,       ///< too far from the estimate or from the autopilot's position
    rejected_speed,
    rejected_fence,       ///< outside the fence (docs/safety.md)
    rejected_jump,        ///< too far from the good one before it
};

/// What is wrong in flight, worst first where several hold.
enum class Fault : std::uint8_t {
    none,
    nav_restarted,     ///< its Map is a new one: nothing it says fits the flight
    frames_diverge,    ///< our estimate and the autopilot's differ lastingly
    vision_lost,       ///< no usable estimate for too long
    nav_silent,        ///< no NAV message for too long
    setpoint_absurd,   ///< NAV comes, its setpoints were refused for too long
    setpoint_missing,  ///< NAV comes without a setpoint for too long
};

class Supervisor {
public:
    struct Counters {
        std::uint32_t setpoints_good = 0;
        std::uint32_t setpoints_refused = 0;
    };

    explicit Supervisor(const Parameters& parameters) : p_(parameters) {}

    /// Takes one NAV message at now_us. `good` means that its setpoint may be sent; it then is last_good().
    SetpointCheck nav(const nav_t& message, std::int64_t now_us);

    /// Takes one ODOM message. False: not finite, out of order, or of a restarted nav: it must not be passed on as it is.
    [[nodiscard]] bool odometry(const odom_t& message, std::int64_t now_us);

    /// Takes the autopilot's own position, and its yaw when that is known (NaN: not).
    void local_position(const LocalPosition& position, float yaw_map_rad, std::int64_t now_us);

    /// What is wrong at now_us, for a vehicle that flies our setpoints.
    [[nodiscard]] Fault judge(std::int64_t now_us) const;

    /// Starts a flight: faults of the past are forgotten, a restart of nav counts from here.
    void begin_flight(std::int64_t now_us);

    /// The autopilot's clock starts anew: all ages are unknown.
    void clock_restarted();

    /// nav has restarted since begin_flight().
    [[nodiscard]] bool nav_restarted() const { return restarted_; }
    /// On the ground a restarted nav is welcome: go on with it.
    void accept_restart() { restarted_ = false; }

    [[nodiscard]] bool nav_fresh(std::int64_t now_us) const;
    [[nodiscard]] bool vision_fresh(std::int64_t now_us) const;      ///< a usable estimate within the setpoint time-out
    [[nodiscard]] bool local_fresh(std::int64_t now_us) const;
    [[nodiscard]] bool frames_agree() const { return local_seen_us_ >= 0 && diverging_since_us_ < 0; }
    [[nodiscard]] bool setpoint_fresh(std::int64_t now_us) const;
    [[nodiscard]] float divergence_m() const { return divergence_m_; }
    [[nodiscard]] const Setpoint& last_good() const { return last_good_; }
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    [[nodiscard]] SetpointCheck check(const nav_t& message, const Setpoint& setpoint) const;

    const Parameters& p_;
    Setpoint last_good_;
    SetpointCheck last_check_ = SetpointCheck::absent;
    LocalPosition local_;
    odom_t odom_{};
    float divergence_m_ = 0.0F;
    bool restarted_ = false;
    std::int32_t nav_seq_ = 0;
    std::int32_t odom_seq_ = 0;
    std::int64_t nav_t_us_ = -1;          ///< stamp of the newest NAV
    std::int64_t nav_seen_us_ = -1;       ///< when it came
    std::int64_t setpoint_seen_us_ = -1;  ///< when the newest good setpoint came
    std::int64_t odom_seen_us_ = -1;
    std::int64_t vision_seen_us_ = -1;    ///< when the newest usable ODOM came
    std::int64_t local_seen_us_ = -1;
    std::int64_t reset_us_ = -1;          ///< when our pose jumped: the autopilot needs time to follow
    std::int64_t diverging_since_us_ = -1;
    Counters counters_;
};

}  // namespace noctule
