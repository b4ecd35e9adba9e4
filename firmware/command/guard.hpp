/// The guard: the last word on every setpoint.
///
/// A table of rules, tried in order, each of which may change the setpoint or take it back (guard.cpp, docs/safety.md).
/// It trusts nobody above it: it looks at the numbers, the newest sweep and, where the laser is blind, at the grid's hits.
/// Frame Map, SI. One instance, no heap, cost proportional to the beams.
#pragma once

#include <cstdint>

#include "command/setpoint.hpp"
#include "estimate/estimate.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/stair_signs.hpp"

namespace noctule {

/// Rules, in the order in which they are tried. Values travel in nav_t.guard_rule; the first that acted is told.
enum class GuardRule : std::int32_t {
    none = 0,
    not_finite = 1,      ///< a number that is none: hold the last good setpoint
    scan_stale = 2,      ///< the newest sweep is old, or localisation is lost: no horizontal motion
    fence = 3,           ///< out of the fence: cut back to it
    ahead = 4,           ///< too far ahead of the estimate: cut back
    step = 5,            ///< a jump against the last setpoint: limited to the greatest speed
    speed = 6,           ///< feed-forward above the limits: scaled
    clearance = 7,       ///< nearer to a hit point than hull and margin: stopped before it, or backed away
    ceiling = 8,         ///< nearer to what is above or below than the vertical clearance
    motion = 9,          ///< the vehicle itself, as fast as it is, could not stop before a hit point: drawn back
};

class Guard {
public:
    explicit Guard(const Parameters& parameters) : p_(parameters) {}

    /// Returns the setpoint to send. `vertical_free`: the rules on height are off (taking off from and setting down on the floor). `stairs`: beside them
    /// a tread that the laser does not see lies before what it sees.
    const Setpoint& decide(const Estimate& estimate, const LevelScan& scan, const OccupancyGrid& grid, const Setpoint& wanted,
                           bool vertical_free, std::int64_t t_us, const StairPlaces& stairs = {});

    [[nodiscard]] GuardRule rule() const { return rule_; }               ///< first rule that acted in the last call
    [[nodiscard]] std::int32_t interventions() const { return interventions_; }  ///< calls in which a rule acted, since start
    /// Hull to the nearest solid point seen, horizontal, at the estimate; NaN when nothing is within reach.
    [[nodiscard]] float clearance_m() const { return clearance_m_; }
    [[nodiscard]] std::int32_t acted(GuardRule rule) const { return acted_[static_cast<std::size_t>(rule)]; }

private:
    struct Near { float x_m; float y_m; };
    void gather(const Estimate& estimate, const LevelScan& scan, const OccupancyGrid& grid, const StairPlaces& stairs);
    [[nodiscard]] float nearest_m(float x_m, float y_m, float& at_x_m, float& at_y_m) const;
    [[nodiscard]] float berth_m(float x_m, float y_m) const;
    bool brake(const Estimate& estimate);
    bool keep_clear(const Estimate& estimate, float dt_s);
    bool keep_inside(const Pose2<Map, Body>& pose);
    void note(GuardRule rule);

    const Parameters& p_;
    Setpoint out_;
    Setpoint last_;
    std::int64_t last_us_ = -1;
    Bounded<Near, kMaxBeams + kMaxBeams / 4> near_;   ///< hit points within reach, frame Map; and treads before every fourth
    GuardRule rule_ = GuardRule::none;
    std::int32_t interventions_ = 0;
    std::array<std::int32_t, 10> acted_{};
    float clearance_m_ = 0.0F;
    float draw_x_m_ = 0.0F;           ///< by which this step draws the vehicle off, beside the setpoint that the reference goes on from
    float draw_y_m_ = 0.0F;
};

}  // namespace noctule
