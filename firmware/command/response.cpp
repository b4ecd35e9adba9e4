#include "command/response.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr float kVelocityGain = 2.5F;     ///< 1/s, nominal: between a brisk and a slow autopilot
constexpr float kPositionGain = 1.2F;     ///< 1/s
constexpr float kRate = 0.4F;             ///< 1/s: what a second of full excitation moves the lead by
constexpr float kPowerTimeS = 2.0F;
constexpr float kPowerLeastM2 = 1e-4F;    ///< model errors under a centimetre teach little
constexpr float kLeastLeadS = -0.15F;
constexpr float kMostLeadS = 0.7F;
constexpr float kFreeLeadS = 0.05F;       ///< a vehicle that needs no more lead than this gets no feedback of velocity: it would ring
constexpr float kPlaceGainPerLead = 2.5F; ///< 1/s for each second of lead
constexpr float kVelocityGainPerLead = 2.5F;
constexpr float kLaggingS = 0.15F;        ///< lead from which a vehicle counts as one with a lag
constexpr float kTrimShare = 0.8F;        ///< of the error at once in the trim
constexpr float kLaggingTrimShare = 0.5F; ///< for a vehicle with a lag: it would swing
constexpr float kTrimDampS = 0.3F;        ///< and of the error of velocity, so that it settles; none for a vehicle with a lag
constexpr float kTrimTimeS = 1.2F;        ///< in which an error that lasts goes into the trim
constexpr float kTrimTimePerLead = 6.0F;  ///< and longer for a vehicle that needs lead: it would overshoot
constexpr float kMostTrimM = 0.05F;
constexpr float kStraysTimeS = 3.0F;      ///< in which what it strayed is forgotten

}  // namespace

void Response::rest() { model_x_m_ = model_y_m_ = model_vx_m_s_ = model_vy_m_s_ = 0.0F; }

float Response::place_gain() const { return kPlaceGainPerLead * std::max(0.0F, lead_s_ - kFreeLeadS); }

float Response::velocity_gain() const { return kVelocityGainPerLead * std::max(0.0F, lead_s_ - kFreeLeadS); }

void Response::step(const float ax_m_s2, const float ay_m_s2, const float error_x_m, const float error_y_m, const float error_vx_m_s,
                    const float error_vy_m_s, const float dt_s) {
    // Equation (4): the error of a vehicle without any lead, m'' = a - kv (m' + kp m).
    model_vx_m_s_ += (ax_m_s2 - kVelocityGain * (model_vx_m_s_ + kPositionGain * model_x_m_)) * dt_s;
    model_vy_m_s_ += (ay_m_s2 - kVelocityGain * (model_vy_m_s_ + kPositionGain * model_y_m_)) * dt_s;
    model_x_m_ += model_vx_m_s_ * dt_s;
    model_y_m_ += model_vy_m_s_ * dt_s;
    // Equation (5): the lead moves until error and model have nothing in common.
    const float power = model_x_m_ * model_x_m_ + model_y_m_ * model_y_m_;
    power_m2_ += (power - power_m2_) * std::min(1.0F, dt_s / kPowerTimeS);
    const float common = (error_x_m * model_x_m_ + error_y_m * model_y_m_) / (power_m2_ + power + kPowerLeastM2);
    lead_s_ = std::clamp(lead_s_ + kRate / kVelocityGain * common * dt_s, kLeastLeadS, kMostLeadS);
    const float brisk = std::clamp((kLaggingS - lead_s_) / (kLaggingS - kFreeLeadS), 0.0F, 1.0F);
    const float trim_share = kLaggingTrimShare + (kTrimShare - kLaggingTrimShare) * brisk;
    const float trim_damp_s = kTrimDampS * brisk;
    const float trim_time_s = kTrimTimeS + kTrimTimePerLead * std::max(0.0F, lead_s_ - kFreeLeadS);
    lasting_x_m_ = std::clamp(lasting_x_m_ + error_x_m * dt_s / trim_time_s, -kMostTrimM, kMostTrimM);
    lasting_y_m_ = std::clamp(lasting_y_m_ + error_y_m * dt_s / trim_time_s, -kMostTrimM, kMostTrimM);
    trim_x_m_ = std::clamp(lasting_x_m_ + trim_share * error_x_m + trim_damp_s * error_vx_m_s, -kMostTrimM, kMostTrimM);
    trim_y_m_ = std::clamp(lasting_y_m_ + trim_share * error_y_m + trim_damp_s * error_vy_m_s, -kMostTrimM, kMostTrimM);
    strays_m_ = std::max(strays_m_ * std::exp(-dt_s / kStraysTimeS), std::hypot(error_x_m, error_y_m));
}

}  // namespace noctule
