#include "command/reference.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/angle.hpp"

namespace noctule {

namespace {

constexpr float kMaxGapS = 0.2F;
constexpr float kOpenBrakeShare = 0.6F;  ///< where there is room for the vehicle to swing past the end
constexpr float kOpenM = 0.75F;          ///< clearance that counts as room
constexpr float kCurveShare = 0.21F;     ///< of the acceleration limit in curves: a vehicle with a lag swings out in proportion to it
constexpr float kOpenCurveShare = 0.45F;  ///< where there is room for that
constexpr float kGentleShare = 0.25F;    ///< of the acceleration limit in the narrowest place
constexpr float kRoomAheadM = 1.0F;       ///< of the path over which narrow places are looked for
constexpr float kVelocityTimeS = 0.2F;   ///< in which the velocity wanted is reached, limits permitting
constexpr float kAheadM = 0.12F;         ///< least distance at which the path is aimed at
constexpr float kAheadS = 0.20F;         ///< and more with speed
constexpr std::size_t kCurveSpan = 3;    ///< points before and after over which the path's curve is measured
constexpr float kUnheldShare = 0.7F;      ///< of the speed from which the guard would stop the vehicle
constexpr float kSlowest = 0.4F;          ///< share of the least speed at least where the way straight on is short
constexpr float kDoneM = 0.01F;
constexpr float kHeightTimeS = 0.5F;
constexpr float kHeightAheadM = 0.35F;   ///< of the reference over or under the estimate, at most
constexpr float kYawAheadRad = 0.6F;
constexpr float kTurnNearShare = 0.3F;   ///< of the yaw rate beside obstacles: an autopilot whose accelerometer has a bias sways as it turns
constexpr float kTurnNearM = 0.10F;      ///< hull to obstacle there
constexpr float kTurnFreeM = 0.30F;      ///< from which it turns at the full rate
constexpr float kTakesEffectS = 0.03F;   ///< from a scan to the moment in which its setpoint takes effect
constexpr float kMostFeedbackM_S = 0.25F;
constexpr float kExpectedStrayM = 0.02F; ///< what a vehicle may stray without being slowed down for it
constexpr float kStrayLeastM = 0.025F;   ///< off the reference by this much it is waited for, however narrow the place
constexpr float kAsideLeastM = 0.010F;   ///< beside the line by this much, too,
constexpr float kAsideShare = 0.15F;     ///< or by this share of the room to the sides
constexpr float kStraySlowest = 0.15F;   ///< share of the speed left then

float clamp_step(const float from, const float to, const float step) { return from + std::clamp(to - from, -step, step); }

}  // namespace

void Reference::start_at(const Estimate& estimate) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    now_ = Setpoint{};
    now_.x_m = pose.x_m;
    now_.y_m = pose.y_m;
    now_.z_m = estimate.altitude.z_m;
    now_.yaw_rad = pose.yaw_rad;
    ax_m_s2_ = ay_m_s2_ = yaw_rate_rad_s_ = 0.0F;
    response_.rest();
}

void Reference::settle(const Setpoint& sent) {
    if (!sent.valid) { return; }
    const bool changed = sent.x_m != sent_.x_m || sent.y_m != sent_.y_m || sent.vx_m_s != sent_.vx_m_s || sent.vy_m_s != sent_.vy_m_s;
    const float vx_m_s = now_.vx_m_s;
    const float vy_m_s = now_.vy_m_s;
    now_ = sent;
    if (changed) {
        ax_m_s2_ = ay_m_s2_ = 0.0F;
        response_.rest();
    } else {
        now_.vx_m_s = vx_m_s;
        now_.vy_m_s = vy_m_s;
    }
}

// Where the vehicle should be by now, less where it is.
void Reference::measure(const Estimate& estimate, const float dt_s) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    short_x_m_ = now_.x_m + (dt_s - kTakesEffectS) * now_.vx_m_s - pose.x_m;
    short_y_m_ = now_.y_m + (dt_s - kTakesEffectS) * now_.vy_m_s - pose.y_m;
    short_vx_m_s_ = now_.vx_m_s - estimate.planar.vx_m_s;
    short_vy_m_s_ = now_.vy_m_s - estimate.planar.vy_m_s;
}

// docs/maths/command.md, equations (1) to (3): greatest speed now from which every limit ahead can still be met.
float Reference::allowed_speed_m_s(const Target& target) const {
    const auto& path = target.path;
    float speed = 0.0F;  // at the end of the path the reference stands
    for (std::size_t k = path.size(); k-- > 0;) {
        if (k + 1U < path.size()) {
            const float ds = std::hypot(path[k + 1U].x_m - path[k].x_m, path[k + 1U].y_m - path[k].y_m);
            const float room = std::clamp((path[k].clearance_m - p_.hull_radius_m) / (kOpenM - p_.hull_radius_m), 0.0F, 1.0F);
            const float share = (kBrakeShare + (kOpenBrakeShare - kBrakeShare) * room) * tight_share(p_, path[k].clearance_m);
            speed = std::sqrt(speed * speed + 2.0F * share * p_.accel_max_m_s2 * ds);
        }
        // Equation (7): what the vehicle strays is not there to fly in.
        const float stray_m = std::max(0.0F, response_.strays_m() - kExpectedStrayM);
        float limit = speed_at_clearance_m_s(p_, path[k].clearance_m - stray_m);
        limit *= tight_share(p_, path[k].clearance_m);
        limit = std::min(limit, std::max(kSlowest * p_.speed_near_m_s, kUnheldShare * stops_from_m_s(p_, path[k].way_m - stray_m)));
        if (k >= kCurveSpan && k + kCurveSpan < path.size()) {
            const PathPoint& a = path[k - kCurveSpan];
            const PathPoint& b = path[k];
            const PathPoint& c = path[k + kCurveSpan];
            const float in = std::hypot(b.x_m - a.x_m, b.y_m - a.y_m);
            const float out = std::hypot(c.x_m - b.x_m, c.y_m - b.y_m);
            if (in > 1e-3F && out > 1e-3F) {
                const float turn = std::fabs(wrap_angle(std::atan2(c.y_m - b.y_m, c.x_m - b.x_m) - std::atan2(b.y_m - a.y_m, b.x_m - a.x_m)));
                const float curvature_per_m = 2.0F * turn / (in + out);
                const float room = std::clamp((path[k].clearance_m - p_.hull_radius_m) / (kOpenM - p_.hull_radius_m), 0.0F, 1.0F);
                const float share = (kCurveShare + (kOpenCurveShare - kCurveShare) * room) * tight_share(p_, path[k].clearance_m);
                limit = std::min(limit, std::sqrt(share * p_.accel_max_m_s2 / std::max(curvature_per_m, 1e-3F)));
            }
        }
        speed = std::min(speed, limit);
    }
    return speed;
}

// Least clearance of the next metre.
float Reference::least_ahead_m(const Target& target) {
    const auto& path = target.path;
    float least_m = 10.0F;
    float gone_m = 0.0F;
    for (std::size_t k = 0; k < path.size() && gone_m < kRoomAheadM; ++k) {
        if (k > 0U) { gone_m += std::hypot(path[k].x_m - path[k - 1U].x_m, path[k].y_m - path[k - 1U].y_m); }
        least_m = std::min(least_m, path[k].clearance_m);
    }
    return least_m;
}

// Equation (8): a vehicle that is off the reference by more than half the room to the sides ahead is waited for.
float Reference::patience(const Target& target, const float ux, const float uy) const {
    const float room_m = least_ahead_m(target) - p_.hull_radius_m;
    const float off = std::hypot(short_x_m_, short_y_m_) / std::max(kStrayLeastM, 0.5F * room_m);
    const float aside = std::fabs(short_x_m_ * uy - short_y_m_ * ux) / std::max(kAsideLeastM, kAsideShare * room_m);
    return std::clamp(2.0F - std::max(off, aside), kStraySlowest, 1.0F);
}

void Reference::move_along(const Target& target, const Estimate& estimate, const float dt_s) {
    const auto& path = target.path;
    float want_vx = 0.0F;
    float want_vy = 0.0F;
    const float speed = std::hypot(now_.vx_m_s, now_.vy_m_s);
    if (target.mode != Target::Mode::hold && !path.empty()) {
        const float ahead_m = kAheadM + kAheadS * speed;
        // The point of the path that far ahead; the path begins at the reference itself.
        float px = now_.x_m;
        float py = now_.y_m;
        float gone = 0.0F;
        float left = 0.0F;
        float aim_x = path.back().x_m;
        float aim_y = path.back().y_m;
        bool aimed = false;
        for (const PathPoint& p : path) {
            const float ds = std::hypot(p.x_m - px, p.y_m - py);
            if (!aimed && gone + ds >= ahead_m && ds > 1e-4F) {
                const float f = (ahead_m - gone) / ds;
                aim_x = px + f * (p.x_m - px);
                aim_y = py + f * (p.y_m - py);
                aimed = true;
            }
            gone += ds;
            px = p.x_m;
            py = p.y_m;
        }
        left = gone;
        const float dx = aim_x - now_.x_m;
        const float dy = aim_y - now_.y_m;
        const float distance = std::hypot(dx, dy);
        if (left > kDoneM && distance > 1e-4F) {
            const float ux = dx / distance;
            const float uy = dy / distance;
            float v = allowed_speed_m_s(target);
            if (path.size() == 1U) {  // a single point: straight to it
                v = std::min(speed_at_clearance_m_s(p_, path[0].clearance_m), std::sqrt(2.0F * kBrakeShare * p_.accel_max_m_s2 * left));
            }
            v = std::min(v, left / kVelocityTimeS * 0.7F) * patience(target, ux, uy);
            if (speed > 0.15F) {  // turning round: brake first, so that the old motion does not carry into what the path avoids
                const float along = (now_.vx_m_s * ux + now_.vy_m_s * uy) / speed;
                v *= std::clamp(along, 0.1F, 1.0F);
            }
            // Wait for a vehicle that lags.
            const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
            const float lead_x = now_.x_m - pose.x_m;
            const float lead_y = now_.y_m - pose.y_m;
            const float lead = std::hypot(lead_x, lead_y);
            const float most = p_.setpoint_ahead_s * p_.speed_max_m_s;
            if (lead_x * ux + lead_y * uy > 0.0F) { v *= std::clamp((0.9F * most - lead) / (0.5F * most), 0.0F, 1.0F); }
            want_vx = v * ux;
            want_vy = v * uy;
        }
    }
    // Acceleration towards the velocity wanted, limited in size and in change.
    float ax = (want_vx - now_.vx_m_s) / kVelocityTimeS;
    float ay = (want_vy - now_.vy_m_s) / kVelocityTimeS;
    // Before and in narrow places it is gentle: a vehicle that answers with a lag swings in proportion to the acceleration.
    const float a = std::hypot(ax, ay);
    const float most_a = p_.accel_max_m_s2 * (kGentleShare + (1.0F - kGentleShare) * speed_at_clearance_m_s(p_, least_ahead_m(target)) / p_.speed_max_m_s);
    if (a > most_a) {
        ax *= most_a / a;
        ay *= most_a / a;
    }
    const float change = std::hypot(ax - ax_m_s2_, ay - ay_m_s2_);
    const float most_change = p_.jerk_max_m_s3 * dt_s;
    const float share = change > most_change ? most_change / change : 1.0F;
    ax_m_s2_ += share * (ax - ax_m_s2_);
    ay_m_s2_ += share * (ay - ay_m_s2_);
    now_.vx_m_s += ax_m_s2_ * dt_s;
    now_.vy_m_s += ay_m_s2_ * dt_s;
    const float faster = std::hypot(now_.vx_m_s, now_.vy_m_s);
    if (faster > p_.speed_max_m_s) {
        now_.vx_m_s *= p_.speed_max_m_s / faster;
        now_.vy_m_s *= p_.speed_max_m_s / faster;
    }
    now_.x_m += now_.vx_m_s * dt_s;
    now_.y_m += now_.vy_m_s * dt_s;
    // A vehicle that does not come along at all: the reference stops where the lead ends.
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    const float lead_m = std::hypot(now_.x_m - pose.x_m, now_.y_m - pose.y_m);
    const float most_m = p_.setpoint_ahead_s * p_.speed_max_m_s;
    if (lead_m > most_m) {
        const float share_left = most_m / lead_m;
        now_.x_m = pose.x_m + share_left * (now_.x_m - pose.x_m);
        now_.y_m = pose.y_m + share_left * (now_.y_m - pose.y_m);
        now_.vx_m_s *= 0.5F;
        now_.vy_m_s *= 0.5F;
    }
}

void Reference::move_height(const Target& target, const Estimate& estimate, const float dt_s) {
    const float up = target.z_m - now_.z_m;
    const float brake = std::sqrt(2.0F * kBrakeShare * p_.vertical_accel_m_s2 * std::fabs(up));
    const float rate = std::min({target.climb_rate_m_s, brake, std::fabs(up) / kHeightTimeS});
    const float lead = now_.z_m - estimate.altitude.z_m;
    const bool waits = std::fabs(lead) > kHeightAheadM && lead * up > 0.0F;
    const float want = waits ? 0.0F : std::copysign(rate, up);
    now_.vz_m_s = clamp_step(now_.vz_m_s, want, p_.vertical_accel_m_s2 * dt_s);
    now_.z_m += now_.vz_m_s * dt_s;
}

void Reference::turn(const float yaw_rad, const float clearance_m, const Estimate& estimate, const float dt_s) {
    const float room = std::clamp((clearance_m - p_.hull_radius_m - kTurnNearM) / (kTurnFreeM - kTurnNearM), 0.0F, 1.0F);
    const float most = p_.yaw_rate_max_rad_s * (kTurnNearShare + (1.0F - kTurnNearShare) * room);
    const float left = wrap_angle(yaw_rad - now_.yaw_rad);
    const float brake = std::sqrt(2.0F * kBrakeShare * p_.yaw_accel_rad_s2 * std::fabs(left));
    const float rate = std::min({most, brake, std::fabs(left) / kVelocityTimeS});
    const float lead = wrap_angle(now_.yaw_rad - estimate.planar.pose_map_body.yaw_rad);
    const bool waits = std::fabs(lead) > kYawAheadRad && lead * left > 0.0F;
    yaw_rate_rad_s_ = clamp_step(yaw_rate_rad_s_, waits ? 0.0F : std::copysign(rate, left), p_.yaw_accel_rad_s2 * dt_s);
    now_.yaw_rad = wrap_angle(now_.yaw_rad + yaw_rate_rad_s_ * dt_s);
}

const Setpoint& Reference::step(const Estimate& estimate, const Target& target, const std::int64_t t_us) {
    const float dt_s = t_us_ < 0 ? 0.0F : std::clamp(static_cast<float>(t_us - t_us_) * 1e-6F, 0.0F, kMaxGapS);
    t_us_ = t_us;
    if (target.mode == Target::Mode::none) {
        start_at(estimate);
        return sent_ = now_;
    }
    if (!now_.valid) { start_at(estimate); }
    now_.valid = true;
    if (target.mode == Target::Mode::ground) { return sent_ = now_; }
    if (dt_s > 0.0F) {
        measure(estimate, dt_s);
        if (target.mode == Target::Mode::land) {
            response_.rest();
            short_x_m_ = short_y_m_ = short_vx_m_s_ = short_vy_m_s_ = 0.0F;
        } else {
            response_.step(ax_m_s2_, ay_m_s2_, short_x_m_, short_y_m_, short_vx_m_s_, short_vy_m_s_, dt_s);
        }
        move_along(target, estimate, dt_s);
        move_height(target, estimate, dt_s);
        turn(target.mode == Target::Mode::hold ? now_.yaw_rad : target.yaw_rad, least_ahead_m(target), estimate, dt_s);
    }
    sent_ = now_;
    // Equation (6): lead and feedback, as far as the speed limit lets them through.
    const float ex = short_vx_m_s_ * response_.velocity_gain() + short_x_m_ * response_.place_gain();
    const float ey = short_vy_m_s_ * response_.velocity_gain() + short_y_m_ * response_.place_gain();
    const float share = std::min(1.0F, kMostFeedbackM_S / std::max(std::hypot(ex, ey), 1e-3F));
    sent_.trim_x_m = response_.trim_x_m();
    sent_.trim_y_m = response_.trim_y_m();
    sent_.vx_m_s += response_.lead_s() * ax_m_s2_ + share * ex;
    sent_.vy_m_s += response_.lead_s() * ay_m_s2_ + share * ey;
    const float speed = std::hypot(sent_.vx_m_s, sent_.vy_m_s);
    if (speed > p_.speed_max_m_s) {
        sent_.vx_m_s *= p_.speed_max_m_s / speed;
        sent_.vy_m_s *= p_.speed_max_m_s / speed;
    }
    return sent_;
}

}  // namespace noctule
