/// The reference pose: a point that flies the target with bounded speed, acceleration and jerk, never far ahead of the vehicle.
///
/// Model: docs/maths/command.md. Frame Map, SI. One instance, no heap, constant cost.
#pragma once

#include <cstdint>

#include "command/response.hpp"
#include "command/setpoint.hpp"
#include "estimate/estimate.hpp"
#include "params.gen.hpp"
#include "plan/target.hpp"

namespace noctule {

class Reference {
public:
    explicit Reference(const Parameters& parameters) : p_(parameters) {}

    /// Advances the reference from the last step to t_us. A gap in time counts as at most 0.2 s.
    const Setpoint& step(const Estimate& estimate, const Target& target, std::int64_t t_us);

    /// What the guard let pass: where that is not what `step` returned, the next step starts there.
    void settle(const Setpoint& sent);

    /// How the vehicle follows, as learned in this flight.
    [[nodiscard]] const Response& response() const { return response_; }

    /// Position and yaw of the last setpoint; before the first one, those of the estimate given last.
    [[nodiscard]] Pose2<Map, Body> pose() const { return {now_.x_m, now_.y_m, now_.yaw_rad}; }

private:
    void start_at(const Estimate& estimate);
    void move_along(const Target& target, const Estimate& estimate, float dt_s);
    void move_height(const Target& target, const Estimate& estimate, float dt_s);
    void turn(float yaw_rad, float clearance_m, const Estimate& estimate, float dt_s);
    [[nodiscard]] float allowed_speed_m_s(const Target& target) const;
    void measure(const Estimate& estimate, float dt_s);
    [[nodiscard]] static float least_ahead_m(const Target& target);
    [[nodiscard]] float patience(const Target& target, float ux, float uy) const;

    const Parameters& p_;
    Setpoint now_;
    Setpoint sent_;               ///< now_ with the lead that the vehicle needs in its velocity
    Response response_;
    std::int64_t t_us_ = -1;
    float ax_m_s2_ = 0.0F;
    float ay_m_s2_ = 0.0F;
    float yaw_rate_rad_s_ = 0.0F;
    float short_x_m_ = 0.0F;      ///< where the vehicle should be by now, less where it is
    float short_y_m_ = 0.0F;
    float short_vx_m_s_ = 0.0F;
    float short_vy_m_s_ = 0.0F;
};

}  // namespace noctule
