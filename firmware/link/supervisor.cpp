#include "link/supervisor.hpp"

#include <cmath>

#include "core/angle.hpp"
#include "plan/fence.hpp"

namespace noctule {

namespace {

constexpr float kMicroseconds = 1e6F;
constexpr std::int64_t kStampTolerance_us = 1000000;  // a NAV stamped further off the autopilot's clock is not of this flight
constexpr std::int64_t kResetGrace_us = 3000000;      // time for the autopilot's estimator to follow a jump of ours
constexpr std::int64_t kOdomFresh_us = 200000;        // an older pose is not compared: the vehicle has moved on

std::int64_t to_us(const float seconds) { return static_cast<std::int64_t>(seconds * kMicroseconds); }

bool within(const std::int64_t seen_us, const std::int64_t now_us, const std::int64_t span_us) { return seen_us >= 0 && now_us - seen_us <= span_us; }

float distance(const float dx, const float dy, const float dz) { return std::sqrt(dx * dx + dy * dy + dz * dz); }

bool finite(const Setpoint& s) {
    return std::isfinite(s.x_m) && std::isfinite(s.y_m) && std::isfinite(s.z_m) && std::isfinite(s.vx_m_s) && std::isfinite(s.vy_m_s) && std::isfinite(s.vz_m_s) &&
           std::isfinite(s.yaw_rad);
}

bool finite(const odom_t& m) {
    return std::isfinite(m.x_m) && std::isfinite(m.y_m) && std::isfinite(m.z_m) && std::isfinite(m.roll_rad) && std::isfinite(m.pitch_rad) && std::isfinite(m.yaw_rad) &&
           std::isfinite(m.vx_m_s) && std::isfinite(m.vy_m_s) && std::isfinite(m.vz_m_s) && std::isfinite(m.yaw_rate_rad_s);
}

}  // namespace

SetpointCheck Supervisor::check(const nav_t& m, const Setpoint& setpoint) const {
    if (!finite(setpoint) || !std::isfinite(m.x_m) || !std::isfinite(m.y_m) || !std::isfinite(m.z_m)) { return SetpointCheck::rejected_not_finite; }
    if (distance(setpoint.x_m - m.x_m, setpoint.y_m - m.y_m, setpoint.z_m - m.z_m) > p_.link_setpoint_reach_m) { return SetpointCheck::rejected_reach; }
    if (within(local_seen_us_, nav_seen_us_, kOdomFresh_us) && !within(reset_us_, nav_seen_us_, kResetGrace_us) &&
        distance(setpoint.x_m - local_.x_m, setpoint.y_m - local_.y_m, setpoint.z_m - local_.z_m) > p_.link_setpoint_reach_m + p_.link_divergence_m) {
        return SetpointCheck::rejected_reach;
    }
    if (distance(setpoint.vx_m_s, setpoint.vy_m_s, setpoint.vz_m_s) > p_.link_setpoint_speed_m_s) { return SetpointCheck::rejected_speed; }
    constexpr float kFenceMargin_m = 0.3F;  // the guard in nav cuts back to the fence itself
    if (Fence(p_).depth_m(setpoint.x_m, setpoint.y_m) < -kFenceMargin_m || setpoint.z_m > p_.fence_height_m + kFenceMargin_m) { return SetpointCheck::rejected_fence; }
    if (last_good_.valid && within(setpoint_seen_us_, nav_seen_us_, to_us(p_.link_setpoint_timeout_s)) && !within(reset_us_, nav_seen_us_, kResetGrace_us)) {
        const float explained_m = p_.link_setpoint_speed_m_s * static_cast<float>(nav_seen_us_ - setpoint_seen_us_) / kMicroseconds;
        if (distance(setpoint.x_m - last_good_.x_m, setpoint.y_m - last_good_.y_m, setpoint.z_m - last_good_.z_m) > p_.link_setpoint_jump_m + explained_m) {
            return SetpointCheck::rejected_jump;
        }
    }
    return SetpointCheck::good;
}

SetpointCheck Supervisor::nav(const nav_t& m, const std::int64_t now_us) {
    if (nav_seen_us_ >= 0 && m.seq < nav_seq_) {
        restarted_ = true;
        nav_t_us_ = -1;
    }
    nav_seq_ = m.seq;
    nav_seen_us_ = now_us;
    SetpointCheck result = SetpointCheck::absent;
    if (m.t_us <= nav_t_us_ || std::abs(m.t_us - now_us) > kStampTolerance_us) {
        result = SetpointCheck::rejected_time;
    } else {
        nav_t_us_ = m.t_us;
        if (m.setpoint_valid != 0) {
            const Setpoint setpoint{true,           m.setpoint_x_m,    m.setpoint_y_m,    m.setpoint_z_m,
                                    m.setpoint_vx_m_s, m.setpoint_vy_m_s, m.setpoint_vz_m_s, wrap_angle(m.setpoint_yaw_rad)};
            result = check(m, setpoint);
            if (result == SetpointCheck::good) {
                last_good_ = setpoint;
                setpoint_seen_us_ = now_us;
                ++counters_.setpoints_good;
            }
        }
    }
    if (result != SetpointCheck::good && result != SetpointCheck::absent) { ++counters_.setpoints_refused; }
    last_check_ = result;
    return result;
}

bool Supervisor::odometry(const odom_t& m, const std::int64_t now_us) {
    if (odom_seen_us_ >= 0 && m.seq < odom_seq_) { restarted_ = true; }
    const bool in_order = odom_seen_us_ < 0 || m.seq > odom_seq_;
    odom_seq_ = m.seq;
    odom_seen_us_ = now_us;
    if (!in_order || restarted_ || !finite(m)) { return false; }
    if (vision_seen_us_ >= 0 && m.reset_counter != odom_.reset_counter) { reset_us_ = now_us; }
    if (m.quality >= 0) { vision_seen_us_ = now_us; }
    odom_ = m;
    return true;
}

void Supervisor::local_position(const LocalPosition& position, const float yaw_map_rad, const std::int64_t now_us) {
    local_ = position;
    local_seen_us_ = now_us;
    if (!within(vision_seen_us_, now_us, kOdomFresh_us) || within(reset_us_, now_us, kResetGrace_us)) {
        diverging_since_us_ = -1;
        return;
    }
    divergence_m_ = distance(position.x_m - odom_.x_m, position.y_m - odom_.y_m, position.z_m - odom_.z_m);
    const bool yaw_off = std::isfinite(yaw_map_rad) && std::fabs(wrap_angle(yaw_map_rad - odom_.yaw_rad)) > p_.link_divergence_rad;
    if (divergence_m_ > p_.link_divergence_m || yaw_off) {
        if (diverging_since_us_ < 0) { diverging_since_us_ = now_us; }
    } else {
        diverging_since_us_ = -1;
    }
}

Fault Supervisor::judge(const std::int64_t now_us) const {
    if (restarted_) { return Fault::nav_restarted; }
    if (diverging_since_us_ >= 0 && now_us - diverging_since_us_ > to_us(p_.link_divergence_s)) { return Fault::frames_diverge; }
    if (!within(vision_seen_us_, now_us, to_us(p_.link_vision_timeout_s))) { return Fault::vision_lost; }
    if (!nav_fresh(now_us)) { return Fault::nav_silent; }
    if (!setpoint_fresh(now_us)) { return last_check_ == SetpointCheck::absent ? Fault::setpoint_missing : Fault::setpoint_absurd; }
    return Fault::none;
}

void Supervisor::begin_flight(const std::int64_t now_us) {
    restarted_ = false;
    setpoint_seen_us_ = -1;
    diverging_since_us_ = -1;
    vision_seen_us_ = now_us;
}

void Supervisor::clock_restarted() {
    nav_t_us_ = -1;
    nav_seen_us_ = -1;
    setpoint_seen_us_ = -1;
    odom_seen_us_ = -1;
    vision_seen_us_ = -1;
    local_seen_us_ = -1;
    reset_us_ = -1;
    diverging_since_us_ = -1;
}

bool Supervisor::nav_fresh(const std::int64_t now_us) const { return within(nav_seen_us_, now_us, to_us(p_.link_setpoint_timeout_s)); }
bool Supervisor::vision_fresh(const std::int64_t now_us) const { return !restarted_ && within(vision_seen_us_, now_us, to_us(p_.link_setpoint_timeout_s)); }
bool Supervisor::local_fresh(const std::int64_t now_us) const { return within(local_seen_us_, now_us, kStampTolerance_us); }
bool Supervisor::setpoint_fresh(const std::int64_t now_us) const { return within(setpoint_seen_us_, now_us, to_us(p_.link_setpoint_timeout_s)); }

}  // namespace noctule
