#include "command/guard.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/length.hpp"
#include "plan/fence.hpp"
#include "plan/target.hpp"
#include "sense/mean_range.hpp"

namespace noctule {

namespace {

constexpr float kReachM = 1.6F;         ///< hit points farther than this cannot matter within a step
constexpr float kBlindReachM = 1.0F;    ///< in the sector that the laser does not see the grid's hits stand in
constexpr float kForesightS = 0.4F;     ///< motion this far ahead must stay clear
constexpr float kGentleShare = 0.85F;    ///< of the speed from which it can stop: from there on it is slowed, at that speed it is stopped
constexpr float kTurnBackS = 0.5F;      ///< the setpoint is drawn back by what is too fast in this time
constexpr float kRounding = 1e-5F;      ///< of a cross product, as a share of its terms
constexpr float kMeanSigmas = 2.0F;     ///< but not what lies deeper or nearer than the noise explains: a wall seen along its face recedes
constexpr float kMiddleM = 0.01F;       ///< a setpoint off the middle of a gap by less is not pushed
constexpr float kPassedM = 0.035F;      ///< hull and less than this to both sides: no gap that the planner enters, it is pushed out again
constexpr float kOppositeShare = 0.3F;  ///< cosine from which a hit point is on the other side
constexpr float kPushM_S = 0.2F;        ///< at which pushes move a setpoint that would hardly move by itself
constexpr float kPushedM = 0.001F;      ///< from which a push takes the velocity against it away
constexpr float kNotableM = 0.01F;      ///< smaller changes do not count as interventions
constexpr std::size_t kTreadEvery = 4;  ///< hit points of stairs before which a tread is put
constexpr float kMostTrimM = 0.06F;     ///< per axis; the clearances are those of the setpoint without it
constexpr float kTrimStepM = 0.05F;     ///< per step and axis, what the guard draws the vehicle by included
constexpr float kMaxGapS = 0.2F;
constexpr float kStepSlackM = 0.02F;
constexpr int kPushRounds = 10;
constexpr int kFenceRounds = 12;        ///< halvings: to 1/4096 of a setpoint's step

bool finite(const Setpoint& s) {
    return std::isfinite(s.x_m) && std::isfinite(s.y_m) && std::isfinite(s.z_m) && std::isfinite(s.vx_m_s) && std::isfinite(s.vy_m_s) &&
           std::isfinite(s.vz_m_s) && std::isfinite(s.yaw_rad) && std::isfinite(s.trim_x_m) && std::isfinite(s.trim_y_m);
}

}  // namespace

void Guard::note(const GuardRule rule) {
    ++acted_[static_cast<std::size_t>(rule)];
    if (rule_ == GuardRule::none) { rule_ = rule; }
}

void Guard::gather(const Estimate& estimate, const LevelScan& scan, const OccupancyGrid& grid, const StairPlaces& stairs) {
    near_.clear();
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    float widest_rad = 0.0F;
    float widest_x_m = 0.0F;   // a point that is seen at that angle
    float widest_y_m = 0.0F;
    float nearest = kReachM;
    const auto count = static_cast<std::int32_t>(scan.points.size());
    const float like_m = kMeanSigmas * believed_sigma_m(scan);
    for (std::int32_t k = 0; k < count; ++k) {
        const ScanPoint& p = scan.points[static_cast<std::size_t>(k)];
        // Its angle is worked out only if it may be wider than the widest so far: by the sine of what it is wider, and what rounding may take.
        const float wider = std::fabs(p.y_m) * widest_x_m - p.x_m * widest_y_m;
        const float rounding = kRounding * (std::fabs(p.y_m) * std::fabs(widest_x_m) + std::fabs(p.x_m) * widest_y_m);
        if (!(wider < -rounding)) {
            const float off_rad = std::fabs(std::atan2(p.y_m, p.x_m));
            if (off_rad > widest_rad) {
                widest_rad = off_rad;
                widest_x_m = p.x_m;
                widest_y_m = std::fabs(p.y_m);
            }
        }
        if (!p.hit) { continue; }
        const float r = length_of(p.x_m, p.y_m);
        if (!(r < kReachM)) { continue; }
        // The nearest of a thousand noisy points is always too near: a point counts by the mean range of its neighbours.
        float sum = r;
        std::int32_t summed = 1;
        for (const std::int32_t side : {-1, 1}) {
            for (std::int32_t n = k + side; n >= 0 && n < count; n += side) {
                const ScanPoint& q = scan.points[static_cast<std::size_t>(n)];
                if (std::fabs(p.x_m * q.y_m - p.y_m * q.x_m) > kMeanArcM * r + 1e-6F) { break; }   // about the arc times both ranges
                const float q_m = length_of(q.x_m, q.y_m);
                if (!q.hit || std::fabs(q_m - r) > like_m) { continue; }
                sum += q_m;
                ++summed;
            }
        }
        const float mean = sum / static_cast<float>(summed);
        nearest = std::min(nearest, mean);
        const Point2<Map> q = pose * Point2<Body>{p.x_m * mean / r, p.y_m * mean / r};
        static_cast<void>(near_.push({q.x_m, q.y_m}));
    }
    const Cell here = grid.geometry().cell(pose.x_m, pose.y_m);
    const auto reach = static_cast<std::int32_t>(grid.geometry().to_cells(kBlindReachM));
    for (std::int32_t dy = -reach; dy <= reach; ++dy) {
        for (std::int32_t dx = -reach; dx <= reach; ++dx) {
            const CellId id = grid.find(Cell{here.ix + dx, here.iy + dy});
            if (grid.cell_class(id) != CellClass::occupied) { continue; }
            float x_m = 0.0F;
            float y_m = 0.0F;
            grid.hit_point(id, x_m, y_m);
            const float bearing = wrap_angle(std::atan2(y_m - pose.y_m, x_m - pose.x_m) - pose.yaw_rad);
            if (std::fabs(bearing) < widest_rad) { continue; }
            nearest = std::min(nearest, std::hypot(x_m - pose.x_m, y_m - pose.y_m));
            static_cast<void>(near_.push({x_m, y_m}));
        }
    }
    // Stairs rise from the tread that was under the vehicle to what is hit of them: a tread before that is not seen.
    const std::size_t seen = near_.size();
    for (std::size_t k = 0; !stairs.empty() && k < seen; k += kTreadEvery) {
        const Near n = near_[k];
        const StairPlace* const tread = stairs_near(stairs, grid.floor(), n.x_m, n.y_m, kStairsReachM);
        if (tread == nullptr) { continue; }
        const float share = kTreadM / std::max(std::hypot(tread->x_m - n.x_m, tread->y_m - n.y_m), kTreadM);
        static_cast<void>(near_.push({n.x_m + share * (tread->x_m - n.x_m), n.y_m + share * (tread->y_m - n.y_m)}));
    }
    clearance_m_ = nearest < kReachM ? nearest - p_.hull_radius_m : std::numeric_limits<float>::quiet_NaN();
}

float Guard::nearest_m(const float x_m, const float y_m, float& at_x_m, float& at_y_m) const {
    float best = kReachM * kReachM;
    for (const Near& n : near_) {
        const float d2 = (n.x_m - x_m) * (n.x_m - x_m) + (n.y_m - y_m) * (n.y_m - y_m);
        if (d2 < best) {
            best = d2;
            at_x_m = n.x_m;
            at_y_m = n.y_m;
        }
    }
    return std::sqrt(best);
}

// Hull and margin, or where both sides are nearer than that, half of the gap less a little: a setpoint in its middle is left alone.
// Pushes from both sides at once would hold it before the throat, and shoot it out behind.
float Guard::berth_m(const float x_m, const float y_m) const {
    const float wanted_m = p_.hull_radius_m + p_.guard_margin_m;
    const float least_m = least_held_m(p_);
    float hx = 0.0F;
    float hy = 0.0F;
    const float one_m = nearest_m(x_m, y_m, hx, hy);
    if (one_m < 1e-3F) { return wanted_m; }
    const float nx = (hx - x_m) / one_m;
    const float ny = (hy - y_m) / one_m;
    float other_m = kReachM;
    for (const Near& n : near_) {
        const float rx = n.x_m - x_m;
        const float ry = n.y_m - y_m;
        const float r_m = std::hypot(rx, ry);
        if (rx * nx + ry * ny < -kOppositeShare * r_m) { other_m = std::min(other_m, r_m); }
    }
    const float half_m = 0.5F * (one_m + other_m);
    return half_m < p_.hull_radius_m + kPassedM ? wanted_m : std::clamp(half_m - kMiddleM, least_m, wanted_m);
}

// The setpoint may not come nearer to a hit point than hull and margin: it is pushed out to that distance, away from the nearest
// point, again and again; between two sides that ends in the middle. What is still too near then is not sent.
bool Guard::keep_clear(const Estimate& estimate, const float dt_s) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    const float least_m = least_held_m(p_);
    float hx = 0.0F;
    float hy = 0.0F;
    const float x0 = out_.x_m;
    const float y0 = out_.y_m;
    bool acted = false;
    // The way from the vehicle to the setpoint: cut where it would pass too near (and nearer than the vehicle is already).
    const float here_m = nearest_m(pose.x_m, pose.y_m, hx, hy);
    const float dx = out_.x_m - pose.x_m;
    const float dy = out_.y_m - pose.y_m;
    for (int k = 1; k <= 8; ++k) {
        const float f = static_cast<float>(k) / 8.0F;
        if (nearest_m(pose.x_m + f * dx, pose.y_m + f * dy, hx, hy) >= std::min(least_m, here_m) - 0.005F) { continue; }
        const float safe = static_cast<float>(k - 1) / 8.0F;
        out_.x_m = pose.x_m + safe * dx;
        out_.y_m = pose.y_m + safe * dy;
        break;
    }
    const float wanted_m = berth_m(out_.x_m, out_.y_m);
    for (int round = 0; round < kPushRounds; ++round) {
        const float d = nearest_m(out_.x_m, out_.y_m, hx, hy);
        if (d >= wanted_m || d < 1e-3F) { break; }
        const float push = (round + 1 < kPushRounds ? 0.6F : 0.5F) * (wanted_m - d) / d;
        out_.x_m += push * (out_.x_m - hx);
        out_.y_m += push * (out_.y_m - hy);
    }
    // Pushed at a walk: out of a throat the pushes of both sides add up along it, and the setpoint would shoot through.
    if (last_.valid) {
        const float step = std::hypot(out_.x_m - last_.x_m, out_.y_m - last_.y_m);
        const float most = std::max(std::hypot(x0 - last_.x_m, y0 - last_.y_m), kPushM_S * dt_s);
        if (step > most) {
            out_.x_m = last_.x_m + (out_.x_m - last_.x_m) * most / step;
            out_.y_m = last_.y_m + (out_.y_m - last_.y_m) * most / step;
        }
    }
    const float moved = std::hypot(out_.x_m - x0, out_.y_m - y0);
    if (moved > kNotableM) { acted = true; }
    if (moved > kPushedM) {  // the velocity must not lead back: a vehicle settles where position and feed-forward balance
        const float back = (out_.vx_m_s * (out_.x_m - x0) + out_.vy_m_s * (out_.y_m - y0)) / moved;
        if (back < 0.0F) {
            out_.vx_m_s -= back * (out_.x_m - x0) / moved;
            out_.vy_m_s -= back * (out_.y_m - y0) / moved;
        }
    }
    // A vehicle that is off its setpoint on the wrong side: it is drawn as far to the other side of the margin, no farther.
    if (here_m < wanted_m && here_m > 1e-3F) {
        static_cast<void>(nearest_m(pose.x_m, pose.y_m, hx, hy));
        const float nx = (pose.x_m - hx) / here_m;
        const float ny = (pose.y_m - hy) / here_m;
        const float have = (out_.x_m - hx) * nx + (out_.y_m - hy) * ny;
        const float push = std::max(0.0F, 2.0F * wanted_m - here_m - have);
        draw_x_m_ += push * nx;
        draw_y_m_ += push * ny;
    }
    // Velocity towards a point that the motion of the next moment would reach: that component is taken out.
    const float px = out_.x_m + kForesightS * out_.vx_m_s;
    const float py = out_.y_m + kForesightS * out_.vy_m_s;
    const float ahead_m = nearest_m(px, py, hx, hy);
    if (ahead_m < wanted_m && ahead_m > 1e-3F) {
        const float rx = out_.x_m - hx;
        const float ry = out_.y_m - hy;
        const float r = std::max(std::hypot(rx, ry), 1e-3F);
        const float towards = -(out_.vx_m_s * rx + out_.vy_m_s * ry) / r;
        const float allowed = std::max(0.0F, (r - wanted_m) / kForesightS);
        if (towards > allowed) {
            out_.vx_m_s += (towards - allowed) * rx / r;
            out_.vy_m_s += (towards - allowed) * ry / r;
            acted = acted || (towards - allowed) * dt_s > kNotableM;
        }
    }
    return acted;
}

// What the vehicle does, not what it was told: as it moves now, it goes on for kAnswerS and then brakes. Where that leads nearer to a
// hit point than the least margin, the setpoint loses velocity along the motion, and is drawn back along it as far as the vehicle is too fast: aside
// it would push the vehicle against the other side of a gap.
bool Guard::brake(const Estimate& estimate) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    const float vx = estimate.planar.vx_m_s;
    const float vy = estimate.planar.vy_m_s;
    const float speed = std::hypot(vx, vy);
    if (!(speed > 0.05F)) { return false; }
    const float ux = vx / speed;
    const float uy = vy / speed;
    const float stop_m = stopping_m(p_, speed / kGentleShare);
    const float least_m = least_held_m(p_);
    float worst = 0.0F;
    float held_share = 0.0F;
    float may_m_s = 0.0F;
    float over_m_s = 0.0F;
    float cosine = 0.0F;
    for (const Near& n : near_) {
        const float rx = n.x_m - pose.x_m;
        const float ry = n.y_m - pose.y_m;
        const float along = rx * ux + ry * uy;
        if (along <= 0.0F) { continue; }                       // left behind
        const float aside2 = rx * rx + ry * ry - along * along;
        if (aside2 >= least_m * least_m) { continue; }         // passed with room
        // The hull meets it after this way: what is left to brake in, against what braking takes.
        const float way_m = along - std::sqrt(least_m * least_m - aside2);
        if (way_m >= stop_m) { continue; }
        const float allowed = stops_from_m_s(p_, way_m);
        // Along the line to the point, of which the motion has this share.
        const float r = std::max(std::hypot(rx, ry), 1e-3F);
        const float share = along / r;
        const float excess = (speed - kGentleShare * allowed) * share;
        if (excess > worst) {
            worst = excess;
            held_share = speed < allowed ? (speed - kGentleShare * allowed) / ((1.0F - kGentleShare) * allowed) : 1.0F;
            may_m_s = (1.0F - held_share) * allowed * share;
            over_m_s = std::max(0.0F, speed - allowed) * share;
            cosine = share;
        }
    }
    if (worst <= 0.0F) { return false; }
    // Stopped at once it swings, beside the very thing: it is slowed before, the more the nearer it is to what it could not stop from.
    const float here = ((out_.x_m - pose.x_m) * ux + (out_.y_m - pose.y_m) * uy) * cosine;
    const float back = held_share * (here + kTurnBackS * over_m_s);
    if (back > 0.0F) {
        draw_x_m_ -= back * ux;
        draw_y_m_ -= back * uy;
    }
    const float towards = (out_.vx_m_s * ux + out_.vy_m_s * uy) * cosine;
    if (towards > may_m_s) {
        out_.vx_m_s -= (towards - may_m_s) * ux;
        out_.vy_m_s -= (towards - may_m_s) * uy;
    }
    return true;
}

// Outside the fence: back along the line to the last setpoint, or to the vehicle, whichever is inside, up to where the fence is met.
// Nothing inside (a fence drawn anew in flight): only what leads farther in is let through.
bool Guard::keep_inside(const Pose2<Map, Body>& pose) {
    const Fence fence{p_};
    const float depth = fence.depth_m(out_.x_m, out_.y_m);
    if (depth >= 0.0F && out_.z_m <= p_.fence_height_m) { return false; }
    if (depth < 0.0F) {
        const bool last_inside = last_.valid && fence.depth_m(last_.x_m, last_.y_m) >= 0.0F;
        const float x0 = last_inside ? last_.x_m : pose.x_m;
        const float y0 = last_inside ? last_.y_m : pose.y_m;
        if (last_inside || fence.depth_m(x0, y0) >= 0.0F) {
            float in = 0.0F;
            float out = 1.0F;
            for (int k = 0; k < kFenceRounds; ++k) {
                const float f = 0.5F * (in + out);
                (fence.depth_m(x0 + f * (out_.x_m - x0), y0 + f * (out_.y_m - y0)) >= 0.0F ? in : out) = f;
            }
            out_.x_m = x0 + in * (out_.x_m - x0);
            out_.y_m = y0 + in * (out_.y_m - y0);
            out_.vx_m_s = out_.vy_m_s = 0.0F;
        } else if (last_.valid && depth < fence.depth_m(last_.x_m, last_.y_m)) {
            out_.x_m = last_.x_m;
            out_.y_m = last_.y_m;
            out_.vx_m_s = out_.vy_m_s = 0.0F;
        }
    }
    if (out_.z_m > p_.fence_height_m) {
        out_.z_m = p_.fence_height_m;
        out_.vz_m_s = std::min(out_.vz_m_s, 0.0F);
    }
    return true;
}

const Setpoint& Guard::decide(const Estimate& estimate, const LevelScan& scan, const OccupancyGrid& grid, const Setpoint& wanted,
                              const bool vertical_free, const std::int64_t t_us, const StairPlaces& stairs) {
    rule_ = GuardRule::none;
    const float dt_s = last_us_ < 0 ? 0.05F : std::clamp(static_cast<float>(t_us - last_us_) * 1e-6F, 0.0F, kMaxGapS);
    last_us_ = t_us;
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    const bool lost = estimate.planar.quality < 0 || !std::isfinite(pose.x_m) || !std::isfinite(pose.y_m) || !std::isfinite(pose.yaw_rad);
    const bool stale = static_cast<float>(t_us - scan.t_us) > 1e6F * p_.guard_stale_s;
    if (!lost) { gather(estimate, scan, grid, stairs); }
    if (!wanted.valid) {
        out_ = wanted;
        last_ = out_;
        return out_;
    }
    out_ = wanted;
    if (!finite(out_)) {
        note(GuardRule::not_finite);
        out_ = last_;
        out_.vx_m_s = out_.vy_m_s = out_.vz_m_s = 0.0F;
        if (!last_.valid || !finite(last_)) { out_ = Setpoint{}; }
        ++interventions_;
        return out_;
    }
    draw_x_m_ = draw_y_m_ = 0.0F;
    out_.trim_x_m = std::clamp(out_.trim_x_m, -kMostTrimM, kMostTrimM);
    out_.trim_y_m = std::clamp(out_.trim_y_m, -kMostTrimM, kMostTrimM);
    if ((lost || stale) && last_.valid) {
        if (std::hypot(out_.x_m - last_.x_m, out_.y_m - last_.y_m) > 1e-4F || std::hypot(out_.vx_m_s, out_.vy_m_s) > 1e-3F) { note(GuardRule::scan_stale); }
        out_.x_m = last_.x_m;
        out_.y_m = last_.y_m;
        out_.yaw_rad = last_.yaw_rad;
        out_.trim_x_m = last_.trim_x_m;
        out_.trim_y_m = last_.trim_y_m;
        out_.vx_m_s = out_.vy_m_s = 0.0F;
    }
    if (keep_inside(pose)) { note(GuardRule::fence); }
    if (!lost) {
        const float lead = std::hypot(out_.x_m - pose.x_m, out_.y_m - pose.y_m);
        const float most = p_.setpoint_ahead_s * p_.speed_max_m_s;
        if (lead > most) {
            note(GuardRule::ahead);
            out_.x_m = pose.x_m + (out_.x_m - pose.x_m) * most / lead;
            out_.y_m = pose.y_m + (out_.y_m - pose.y_m) * most / lead;
        }
    }
    const float speed = std::hypot(out_.vx_m_s, out_.vy_m_s);
    if (speed > 1.05F * p_.speed_max_m_s) {
        note(GuardRule::speed);
        out_.vx_m_s *= p_.speed_max_m_s / speed;
        out_.vy_m_s *= p_.speed_max_m_s / speed;
    }
    if (!lost && !stale && brake(estimate)) { note(GuardRule::motion); }
    if (!lost && !stale && keep_clear(estimate, dt_s)) { note(GuardRule::clearance); }
    // Drawn off one side it may not come nearer to the other than the margin.
    if (draw_x_m_ != 0.0F || draw_y_m_ != 0.0F) {
        float hx = 0.0F;
        float hy = 0.0F;
        const float keep_m = std::min(nearest_m(out_.x_m, out_.y_m, hx, hy), berth_m(out_.x_m, out_.y_m)) - 0.005F;
        float share = 1.0F;
        while (share > 0.05F && nearest_m(out_.x_m + share * draw_x_m_, out_.y_m + share * draw_y_m_, hx, hy) < keep_m) { share *= 0.7F; }
        if (share > 0.05F) {
            out_.trim_x_m += share * draw_x_m_;
            out_.trim_y_m += share * draw_y_m_;
        }
    }
    // After the pushes, so that the answer never jumps whatever moved it.
    if (last_.valid) {
        out_.trim_x_m = last_.trim_x_m + std::clamp(out_.trim_x_m - last_.trim_x_m, -kTrimStepM, kTrimStepM);
        out_.trim_y_m = last_.trim_y_m + std::clamp(out_.trim_y_m - last_.trim_y_m, -kTrimStepM, kTrimStepM);
        const float step = std::hypot(out_.x_m - last_.x_m, out_.y_m - last_.y_m);
        const float most = 1.1F * p_.speed_max_m_s * dt_s + kStepSlackM;
        if (step > most) {
            note(GuardRule::step);
            out_.x_m = last_.x_m + (out_.x_m - last_.x_m) * most / step;
            out_.y_m = last_.y_m + (out_.y_m - last_.y_m) * most / step;
        }
        const float most_up = 2.0F * p_.climb_rate_m_s * dt_s + kStepSlackM;
        if (std::fabs(out_.z_m - last_.z_m) > most_up) {
            note(GuardRule::step);
            out_.z_m = last_.z_m + std::copysign(most_up, out_.z_m - last_.z_m);
        }
    }
    if (!vertical_free) {
        const AltitudeEstimate& a = estimate.altitude;
        const float half_m = 0.5F * p_.hull_height_m + 0.5F * p_.vertical_clearance_m;
        const float low = std::isfinite(a.ground_z_m) ? a.ground_z_m + half_m : -std::numeric_limits<float>::infinity();
        const float high = std::isfinite(a.ceiling_z_m) ? a.ceiling_z_m - half_m : std::numeric_limits<float>::infinity();
        if (low <= high && (out_.z_m < low - 1e-3F || out_.z_m > high + 1e-3F)) {
            note(GuardRule::ceiling);
            out_.z_m = std::clamp(out_.z_m, low, high);
            out_.vz_m_s = 0.0F;
        }
    }
    if (rule_ != GuardRule::none) { ++interventions_; }
    last_ = out_;
    return out_;
}

}  // namespace noctule
