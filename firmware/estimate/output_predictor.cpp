#include "estimate/output_predictor.hpp"

#include <algorithm>
#include <cmath>

#include "core/angle.hpp"
#include "core/gravity.hpp"

namespace noctule {

namespace {

// Growth of the published variance where only inertial data carry the pose.
constexpr float kVerticalNoise_m_s2 = 0.1F;    // per root hertz
constexpr float kHorizontalNoise_m_s2 = 0.1F;  // per root hertz, biases included
// A hole in the inertial data is crossed in a straight line.
constexpr std::int64_t kHole_us = 100000;

[[nodiscard]] bool finite(const std::array<float, 3>& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

}  // namespace

void OutputPredictor::correct(const Estimate& estimate) {
    if (started_ && estimate.t_us < estimate_.t_us) { return; }
    started_ = true;
    estimate_ = estimate;
}

void OutputPredictor::add(const ImuSample& sample) {
    if (!finite(sample.accel_m_s2) || !finite(sample.gyro_rad_s) || (count_ > 0 && sample.t_us <= imu_[newest_].t_us)) {
        ++refused_;
        return;
    }
    newest_ = count_ == 0 ? 0 : (newest_ + 1) % kMaxPredictorSamples;
    imu_[newest_] = sample;
    count_ = std::min(count_ + 1, kMaxPredictorSamples);
}

void OutputPredictor::add(const AttitudeSample& sample) {
    if (!std::isfinite(sample.roll_rad) || !std::isfinite(sample.pitch_rad) || (have_attitude_ && sample.t_us <= attitude_.t_us)) {
        ++refused_;
        return;
    }
    attitude_ = sample;
    have_attitude_ = true;
}

bool OutputPredictor::odometry(const std::int64_t t_us, Odometry& out) const {
    if (!started_ || t_us < estimate_.t_us) { return false; }
    const PlanarEstimate& planar = estimate_.planar;
    out = Odometry{};
    out.t_us = t_us;
    out.at_scan = t_us == estimate_.t_us;
    out.x_m = planar.pose_map_body.x_m;
    out.y_m = planar.pose_map_body.y_m;
    out.yaw_rad = planar.pose_map_body.yaw_rad;
    out.z_m = estimate_.altitude.z_m;
    out.roll_rad = estimate_.roll_rad;
    out.pitch_rad = estimate_.pitch_rad;
    out.vx_m_s = planar.vx_m_s;
    out.vy_m_s = planar.vy_m_s;
    out.vz_m_s = estimate_.altitude.vz_m_s;
    out.yaw_rate_rad_s = planar.yaw_rate_rad_s;
    if (!out.at_scan && have_attitude_ && attitude_.t_us >= estimate_.t_us) {
        out.roll_rad = attitude_.roll_rad;
        out.pitch_rad = attitude_.pitch_rad;
    }

    // Oldest sample of the ring to the newest; each holds from the sample before it to its own time.
    const float cph = std::cos(out.roll_rad);
    const float sph = std::sin(out.roll_rad);
    const float cth = std::cos(out.pitch_rad);
    const float sth = std::sin(out.pitch_rad);
    std::int64_t at_us = estimate_.t_us;
    const auto carry = [&](const std::int64_t to_us, const ImuSample* sample) {
        const float dt_s = 1e-6F * static_cast<float>(to_us - at_us);
        float ax = 0.0F;
        float ay = 0.0F;
        float az = 0.0F;
        if (sample != nullptr) {
            // Algorithms B.
            const auto& f = sample->accel_m_s2;
            const float level_x = cth * f[0] + sph * sth * f[1] + cph * sth * f[2];
            const float level_y = cph * f[1] - sph * f[2];
            out.yaw_rate_rad_s = (sample->gyro_rad_s[1] * sph + sample->gyro_rad_s[2] * cph) / std::max(0.1F, cth);
            const float yaw_mid = out.yaw_rad + 0.5F * dt_s * out.yaw_rate_rad_s;
            ax = std::cos(yaw_mid) * level_x - std::sin(yaw_mid) * level_y;
            ay = std::sin(yaw_mid) * level_x + std::cos(yaw_mid) * level_y;
            az = -sth * f[0] + sph * cth * f[1] + cph * cth * f[2] - static_cast<float>(kGravity_m_s2);
        }
        out.x_m += dt_s * (out.vx_m_s + 0.5F * dt_s * ax);
        out.y_m += dt_s * (out.vy_m_s + 0.5F * dt_s * ay);
        out.z_m += dt_s * (out.vz_m_s + 0.5F * dt_s * az);
        out.vx_m_s += dt_s * ax;
        out.vy_m_s += dt_s * ay;
        out.vz_m_s += dt_s * az;
        out.yaw_rad = wrap_angle(out.yaw_rad + dt_s * out.yaw_rate_rad_s);
        at_us = to_us;
    };
    for (std::size_t k = 0; k < count_ && at_us < t_us; ++k) {
        const ImuSample& sample = imu_[(newest_ + kMaxPredictorSamples + 1 - count_ + k) % kMaxPredictorSamples];
        if (sample.t_us <= at_us) { continue; }
        const std::int64_t to_us = std::min(sample.t_us, t_us);
        carry(to_us, sample.t_us - at_us <= kHole_us ? &sample : nullptr);
    }
    if (at_us < t_us) { carry(t_us, nullptr); }

    const float age_s = 1e-6F * static_cast<float>(t_us - estimate_.t_us);
    const float accel_var = kHorizontalNoise_m_s2 * kHorizontalNoise_m_s2 * age_s;
    const float climb_var = kVerticalNoise_m_s2 * kVerticalNoise_m_s2 * age_s;
    out.velocity_var_m2_s2 = {planar.velocity_covariance[0] + accel_var, planar.velocity_covariance[2] + accel_var,
                              estimate_.altitude.vz_var_m2_s2 + climb_var};
    const float age2 = age_s * age_s;
    out.position_var_m2 = {planar.covariance[0] + age2 * out.velocity_var_m2_s2[0], planar.covariance[3] + age2 * out.velocity_var_m2_s2[1],
                           estimate_.altitude.z_var_m2 + age2 * out.velocity_var_m2_s2[2]};
    const float turn_sigma_rad = age_s * parameters_.gyro_bias_start_rad_s;
    out.yaw_var_rad2 = planar.covariance[5] + turn_sigma_rad * turn_sigma_rad;
    out.reset_counter = planar.reset_counter;
    // One answer for the whole pose: with a height that is not to be trusted the autopilot must not follow z, and it cannot take a part.
    out.quality = age_s > parameters_.stale_scan_s || !estimate_.altitude.valid ? -1 : planar.quality;
    return true;
}

}  // namespace noctule
