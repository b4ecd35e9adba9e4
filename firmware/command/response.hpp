/// How the vehicle answers to the reference, learned in flight: the lead that it needs, how much feedback, how far it strays.
///
/// Model: docs/maths/command.md, equations (4) to (6). Frame Map, SI. One instance, no heap, constant cost.
#pragma once

namespace noctule {

class Response {
public:
    /// Forgets the motion, not what was learned: the vehicle stands, or the setpoints were not the reference's.
    void rest();

    /// The reference moved with this acceleration for dt_s; the vehicle was then measured (error_x, error_y) short of it and (error_vx, error_vy) slower.
    void step(float ax_m_s2, float ay_m_s2, float error_x_m, float error_y_m, float error_vx_m_s, float error_vy_m_s, float dt_s);

    /// Velocity to add to the feed-forward per acceleration of the reference [s].
    [[nodiscard]] float lead_s() const { return lead_s_; }
    /// Velocity to add against an error of place [1/s] and of velocity [-]: none for a vehicle that needs no lead.
    [[nodiscard]] float place_gain() const;
    [[nodiscard]] float velocity_gain() const;
    /// Shift of the setpoint against the error of place and what of it lasts [m].
    [[nodiscard]] float trim_x_m() const { return trim_x_m_; }
    [[nodiscard]] float trim_y_m() const { return trim_y_m_; }
    /// What the vehicle strayed from the reference lately [m].
    [[nodiscard]] float strays_m() const { return strays_m_; }

private:
    float lead_s_ = 0.0F;
    float strays_m_ = 0.0F;
    float power_m2_ = 0.0F;
    float lasting_x_m_ = 0.0F;
    float lasting_y_m_ = 0.0F;
    float trim_x_m_ = 0.0F;
    float trim_y_m_ = 0.0F;
    float model_x_m_ = 0.0F;     ///< where a vehicle with the nominal gains would be short by, and how that changes
    float model_y_m_ = 0.0F;
    float model_vx_m_s_ = 0.0F;
    float model_vy_m_s_ = 0.0F;
};

}  // namespace noctule
