#include "estimate/localiser.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace noctule {

namespace {

// A longer silence of the inertial sensor is bridged without it. 50 Hz with two samples lost still passes.
constexpr std::int64_t kImuGap_us = 100000;
// Below this the laser says nothing about any direction: (5 cm)^-2.
constexpr double kInformation_1_m2 = 400.0;

// Share of the walls that no landmark explains, from which the scan match leads, and below which walls do again.
constexpr float kWallsPoor = 0.22F;
constexpr float kWallsGood = 0.08F;
constexpr float kWallsUnproven = 0.3F;
// Share of the hits on walls below which they are not asked (round rooms).
constexpr float kWallsMatter = 0.1F;

// Doubt about velocity, in the speed limit, that is not believed.
constexpr double kSpeedDoubt = 3.0;

// What the vehicle may have done while its clock began anew.
constexpr double kRestartSpeed_m_s = 0.5;

/// Newest inertial time of a frame that is not further ahead than one frame can hold.
[[nodiscard]] std::int64_t newest_plausible(const SensorFrame& frame) {
    const std::int64_t first_us = frame.imu[0].t_us;
    const std::int64_t last_us = frame.imu.back().t_us;
    return last_us - first_us < 1000000 ? last_us : first_us;
}

template <std::size_t... I>
[[nodiscard]] std::array<PointMap, sizeof...(I)> point_maps(const Parameters& parameters, std::index_sequence<I...>) {
    return {((void)I, PointMap(parameters))...};
}

[[nodiscard]] double seconds(const std::int64_t from_us, const std::int64_t to_us) { return 1e-6 * static_cast<double>(to_us - from_us); }

}  // namespace

Localiser::Localiser(const Parameters& parameters)
    : parameters_(parameters), leveller_(parameters), extractor_(parameters), inertial_(parameters), filter_(parameters),
      points_(point_maps(parameters, std::make_index_sequence<kFloorSlots + 1>{})), tracker_(parameters) {}

void Localiser::enter_layer(const std::int32_t layer) {
    const auto next = static_cast<std::size_t>(std::clamp<std::int32_t>(layer, 0, kShaftLayer));
    if (next == layer_) { return; }
    if (next == static_cast<std::size_t>(kShaftLayer)) {
        stored_[next].count = 0;
        points_[next].clear();
    }
    filter_.change_layer(stored_[layer_], stored_[next]);
    layer_ = next;
    tracker_.clear();   // sweeps of another floor match nothing here
}

void Localiser::take_attitude(const SensorFrame& frame) {
    if (attitude_.size() > 1) {
        const AttitudeSample last = attitude_.back();
        attitude_.clear();
        static_cast<void>(attitude_.push(last));
    }
    for (const AttitudeSample& sample : frame.attitude) {
        if (checker_.check(sample) == SampleVerdict::accepted) { static_cast<void>(attitude_.push(sample)); }
    }
}

AttitudeSample Localiser::attitude_at(const std::int64_t t_us) const {
    if (attitude_.empty()) { return {t_us, 0.0F, 0.0F}; }
    std::size_t i = 0;
    while (i < attitude_.size() && attitude_[i].t_us < t_us) { ++i; }
    if (i == 0) { return {t_us, attitude_[0].roll_rad, attitude_[0].pitch_rad}; }
    if (i == attitude_.size()) { return {t_us, attitude_.back().roll_rad, attitude_.back().pitch_rad}; }
    const AttitudeSample& a = attitude_[i - 1];
    const AttitudeSample& b = attitude_[i];
    const auto share = static_cast<float>(seconds(a.t_us, t_us) / seconds(a.t_us, b.t_us));
    return {t_us, a.roll_rad + share * (b.roll_rad - a.roll_rad), a.pitch_rad + share * (b.pitch_rad - a.pitch_rad)};
}

void Localiser::push_node() {
    const AttitudeSample attitude = attitude_at(now_us_);
    const auto& x = inertial_.state();
    double yaw_rad = x(InertialFilter::kYaw, 0);
    if (!motion_.empty()) {
        // Unwrapped within one sweep, so that it can be interpolated.
        yaw_rad = motion_.back().yaw_rad + std::remainder(yaw_rad - motion_.back().yaw_rad, 6.283185307179586);
    }
    const MotionNode node{now_us_, x(InertialFilter::kX, 0), x(InertialFilter::kY, 0), yaw_rad, attitude.roll_rad, attitude.pitch_rad};
    if (!motion_.push(node)) { motion_.back() = node; }
}

void Localiser::advance(const ImuSample& from, const ImuSample& to, const std::int64_t until_us) {
    const std::int64_t middle_us = now_us_ + (until_us - now_us_) / 2;
    const AttitudeSample attitude = attitude_at(middle_us);
    InertialFilter::Input input;
    for (std::size_t i = 0; i < 3; ++i) {
        input.accel_m_s2[i] = 0.5 * (static_cast<double>(from.accel_m_s2[i]) + static_cast<double>(to.accel_m_s2[i]));
        input.gyro_rad_s[i] = 0.5 * (static_cast<double>(from.gyro_rad_s[i]) + static_cast<double>(to.gyro_rad_s[i]));
    }
    input.roll_rad = static_cast<double>(attitude.roll_rad);
    input.pitch_rad = static_cast<double>(attitude.pitch_rad);
    inertial_.predict(input, seconds(now_us_, until_us));
    now_us_ = until_us;
    push_node();
}

void Localiser::predict_to(const SensorFrame& frame, const std::int64_t t_us) {
    if (motion_.empty()) { push_node(); }
    const auto coast_to = [this](const std::int64_t until_us) {
        ++coasted_;
        while (now_us_ < until_us) {
            const std::int64_t next_us = std::min(until_us, now_us_ + std::max<std::int64_t>(20000, (until_us - now_us_) / 64));
            inertial_.coast(seconds(now_us_, next_us));
            now_us_ = next_us;
            push_node();
        }
    };
    for (const ImuSample& sample : frame.imu) {
        if (checker_.check(sample) != SampleVerdict::accepted) { continue; }
        if (sample.t_us > now_us_ && now_us_ < t_us) {
            const std::int64_t until_us = std::min(sample.t_us, t_us);
            if (have_imu_ && sample.t_us - last_imu_.t_us <= kImuGap_us) {
                advance(last_imu_, sample, until_us);
            } else if (sample.t_us - now_us_ <= kImuGap_us) {
                advance(sample, sample, until_us);
            } else {
                coast_to(until_us);
            }
        }
        last_imu_ = sample;
        have_imu_ = true;
    }
    if (now_us_ < t_us) {
        // The last sample holds for a short while; a longer silence is coasted.
        if (have_imu_ && t_us - last_imu_.t_us <= kImuGap_us / 2) {
            advance(last_imu_, last_imu_, t_us);
        } else {
            coast_to(t_us);
        }
    }
}

const PlanarEstimate& Localiser::update(const SensorFrame& frame, const AltitudeEstimate& last_altitude) {
    take_attitude(frame);
    const SampleVerdict verdict = checker_.check(frame.scan);
    if (verdict != SampleVerdict::accepted) {
        // The inertial data still count: the interval stays open until a scan is accepted.
        if (started_ && !frame.imu.empty()) { predict_to(frame, std::max(now_us_, newest_plausible(frame))); }
        return estimate_;
    }
    if (checker_.take_restart() || !started_) {
        // The first scan, or a clock that began anew: nothing is known of the time between.
        now_us_ = frame.scan.t_us;
        have_imu_ = false;
        motion_.clear();
        if (started_) { inertial_.widen_velocity(kRestartSpeed_m_s); }
    }
    predict_to(frame, frame.scan.t_us);
    return finish(frame, last_altitude, inertial_.increment());
}

const PlanarEstimate& Localiser::update(const SensorFrame& frame, const AltitudeEstimate& last_altitude, const MotionIncrement& motion) {
    if (!external_motion_) {
        // Wheels carry less well from sweep to sweep than inertia: there the walls have yet to prove themselves.
        filter_.doubt_walls(kWallsUnproven);
        match_leads_ = true;
    }
    external_motion_ = true;
    take_attitude(frame);
    const SampleVerdict verdict = checker_.check(frame.scan);
    // The increment is kept even if the scan is not: the next scan is that much farther.
    const double c = std::cos(odometry_pose_[2]);
    const double s = std::sin(odometry_pose_[2]);
    if (!std::isfinite(motion.dx_m) || !std::isfinite(motion.dy_m) || !std::isfinite(motion.dyaw_rad)) { return estimate_; }
    const MotionNode before{now_us_, odometry_pose_[0], odometry_pose_[1], odometry_pose_[2], 0.0F, 0.0F};
    odometry_pose_[0] += c * static_cast<double>(motion.dx_m) - s * static_cast<double>(motion.dy_m);
    odometry_pose_[1] += s * static_cast<double>(motion.dx_m) + c * static_cast<double>(motion.dy_m);
    odometry_pose_[2] += static_cast<double>(motion.dyaw_rad);
    if (verdict != SampleVerdict::accepted) {
        filter_.predict(motion);
        return estimate_;
    }
    if (checker_.take_restart() || !started_) { now_us_ = frame.scan.t_us - 1; }
    motion_.clear();
    static_cast<void>(motion_.push(before));
    now_us_ = frame.scan.t_us;
    static_cast<void>(motion_.push({now_us_, odometry_pose_[0], odometry_pose_[1], odometry_pose_[2], attitude_at(now_us_).roll_rad,
                                    attitude_at(now_us_).pitch_rad}));
    return finish(frame, last_altitude, motion);
}

void Localiser::collect_match_points() {
    match_points_.clear();
    const auto& wall_of_point = extractor_.wall_of_point();
    std::size_t free_points = 0;
    for (std::size_t i = 0; i < level_scan_.points.size(); ++i) {
        if (level_scan_.points[i].hit && wall_of_point[i] < 0) { ++free_points; }
    }
    // Thinned evenly to what fits.
    const std::size_t stride = (free_points + kMaxMatchPoints - 1) / kMaxMatchPoints;
    std::size_t n = 0;
    for (std::size_t i = 0; i < level_scan_.points.size(); ++i) {
        const ScanPoint& point = level_scan_.points[i];
        if (!point.hit || wall_of_point[i] >= 0) { continue; }
        if (n++ % stride == 0) { static_cast<void>(match_points_.push({point.x_m, point.y_m})); }
    }
}

const PlanarEstimate& Localiser::finish(const SensorFrame& frame, const AltitudeEstimate& last_altitude, const MotionIncrement& motion) {
    HeightBounds bounds;
    if (last_altitude.valid) {
        float floor_z_m = last_altitude.floor_z_m;
        if (std::isfinite(last_altitude.ground_z_m)) { floor_z_m = std::min(floor_z_m, last_altitude.ground_z_m); }
        bounds.floor_m = floor_z_m - last_altitude.z_m;
        if (std::isfinite(last_altitude.ceiling_z_m)) { bounds.ceiling_m = last_altitude.ceiling_z_m - last_altitude.z_m; }
    }
    leveller_.level(frame.scan, motion_, bounds, level_scan_);
    const WallObservations& walls = extractor_.extract(level_scan_);
    collect_match_points();
    points_[layer_].set_noise(level_scan_.range_noise_m);

    if (!started_) {
        started_ = true;
        informed_us_ = frame.scan.t_us;
    } else {
        filter_.predict(motion);
    }
    const Pose2<Map, Body> predicted = filter_.mean();
    PoseMatch match;
    const bool lead = match_leads();
    if (parameters_.scan_match != 0) { tracker_.take(level_scan_); }
    if (lead) {
        static_cast<void>(tracker_.match(predicted, filter_.predicted_covariance()));
    } else if (parameters_.point_match != 0) {
        match = points_[layer_].match(match_points_, predicted, filter_.predicted_covariance());
    }
    const WallFilter::Result& result = lead ? filter_.follow(walls, tracker_.fit(), level_scan_) : filter_.update(walls, match, level_scan_);

    if (!external_motion_) {
        inertial_.correct(result.laser);
        inertial_.bound_speed(kSpeedDoubt * static_cast<double>(parameters_.speed_max_m_s));
        inertial_.place(static_cast<double>(result.pose.x_m), static_cast<double>(result.pose.y_m), static_cast<double>(result.pose.yaw_rad));
        inertial_.mark();
        motion_.clear();
    }
    const bool informed = result.laser.lambda(0, 0) + result.laser.lambda(1, 1) > kInformation_1_m2;
    if (informed) {
        informed_us_ = frame.scan.t_us;
    } else {
        ++blind_scans_;
    }
    estimate_.walls_seen = static_cast<std::int32_t>(walls.size());
    estimate_.walls_matched = result.walls_matched;
    estimate_.landmarks = filter_.best_landmarks();
    estimate_.effective_particles = result.effective_particles;
    estimate_.pose_map_body = result.pose;
    publish(predicted, result, informed);
    if (parameters_.point_match != 0 && estimate_.quality >= 0) { points_[layer_].add(match_points_, result.pose); }
    if (parameters_.scan_match != 0 && estimate_.quality >= 0) { tracker_.keep(result.pose); }
    return estimate_;
}

bool Localiser::match_leads() {
    // Walls are good or poor in a building, not in a sweep: two thresholds (docs/maths/scan_match.md#lead).
    const float doubtful = filter_.doubtful_walls();
    const bool walls_matter = filter_.hits_on_walls() > kWallsMatter || external_motion_;
    if (!match_leads_ && doubtful > kWallsPoor && walls_matter) { match_leads_ = true; }
    if (match_leads_ && doubtful < kWallsGood) { match_leads_ = false; }
    return parameters_.scan_match == 2 || (parameters_.scan_match == 1 && match_leads_);
}

void Localiser::publish(const Pose2<Map, Body>& predicted, const WallFilter::Result& result, const bool informed) {
    const Pose2<Map, Body>& pose = estimate_.pose_map_body;
    // Doubt about the pose among the walls in view, and about those walls against the start: both are published, the first says lost.
    Matrix<float, 3, 3> local = result.spread;
    if (!external_motion_) {
        const auto& x = inertial_.state();
        const auto& q = inertial_.covariance();
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j = 0; j < 3; ++j) { local(i, j) = static_cast<float>(q(i, j)); }
        }
        estimate_.vx_m_s = static_cast<float>(x(InertialFilter::kVx, 0));
        estimate_.vy_m_s = static_cast<float>(x(InertialFilter::kVy, 0));
        estimate_.yaw_rate_rad_s = static_cast<float>(inertial_.yaw_rate_rad_s());
        estimate_.velocity_covariance = {static_cast<float>(q(InertialFilter::kVx, InertialFilter::kVx)),
                                         static_cast<float>(q(InertialFilter::kVx, InertialFilter::kVy)),
                                         static_cast<float>(q(InertialFilter::kVy, InertialFilter::kVy))};
    } else if (motion_.size() == 2 && motion_[1].t_us > motion_[0].t_us) {
        const double dt_s = seconds(motion_[0].t_us, motion_[1].t_us);
        const double turn = static_cast<double>(pose.yaw_rad) - motion_[1].yaw_rad;
        const double dx = (motion_[1].x_m - motion_[0].x_m) / dt_s;
        const double dy = (motion_[1].y_m - motion_[0].y_m) / dt_s;
        estimate_.vx_m_s = static_cast<float>(std::cos(turn) * dx - std::sin(turn) * dy);
        estimate_.vy_m_s = static_cast<float>(std::sin(turn) * dx + std::cos(turn) * dy);
        estimate_.yaw_rate_rad_s = static_cast<float>((motion_[1].yaw_rad - motion_[0].yaw_rad) / dt_s);
        estimate_.velocity_covariance = {0.01F, 0.0F, 0.01F};
    }
    local(0, 0) += parameters_.pose_floor_m * parameters_.pose_floor_m;
    local(1, 1) += parameters_.pose_floor_m * parameters_.pose_floor_m;
    local(2, 2) += parameters_.pose_floor_rad * parameters_.pose_floor_rad;
    for (std::size_t k = 0, i = 0; i < 3; ++i) {
        for (std::size_t j = i; j < 3; ++j, ++k) { estimate_.covariance[k] = local(i, j) + result.map_drift(i, j); }
    }

    const float jump_m = std::hypot(pose.x_m - predicted.x_m, pose.y_m - predicted.y_m);
    const float jump_rad = std::abs(wrap_angle(pose.yaw_rad - predicted.yaw_rad));
    if (jump_m > parameters_.reset_jump_m || jump_rad > parameters_.reset_jump_rad) { ++estimate_.reset_counter; }

    const float worst_m = std::sqrt(std::max(0.0F, eigen_symmetric(local(0, 0), local(0, 1), local(1, 1)).large));
    const float worst_rad = std::sqrt(local(2, 2));
    const float share = std::max(worst_m / parameters_.lost_sigma_m, worst_rad / parameters_.lost_sigma_rad);
    const bool was_lost = estimate_.quality < 0;
    const bool blind_too_long = !informed && seconds(informed_us_, level_scan_.t_us) > 10.0 * static_cast<double>(parameters_.stale_scan_s);
    if (share >= 1.0F || blind_too_long || !std::isfinite(pose.x_m + pose.y_m + pose.yaw_rad)) {
        if (!was_lost) { ++lost_; }
        estimate_.quality = -1;
    } else {
        estimate_.quality = static_cast<std::int32_t>(std::lround(100.0F * (1.0F - share)));
    }
}

Localiser::Counters Localiser::counters() const {
    Counters counters;
    counters.refused_samples = checker_.counters().refused();
    counters.refused_beams = leveller_.counters().beams_refused;
    counters.coasted = coasted_;
    counters.blind_scans = blind_scans_;
    counters.lost = lost_;
    counters.landmarks_evicted = filter_.counters().evicted;
    for (const PointMap& points : points_) { counters.cells_evicted += points.counters().evicted; }
    return counters;
}

}  // namespace noctule
