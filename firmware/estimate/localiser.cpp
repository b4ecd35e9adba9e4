#include "estimate/localiser.hpp"

#include <algorithm>
#include <cmath>

#include "core/gravity.hpp"

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
// Share of the hits on walls below which the scan match leads (round rooms).
constexpr float kWallsMatter = 0.1F;

// Six floats cannot tell centimetres across from tens of metres along; what they lose, squared, and a linear filter with it.
constexpr float kRounding = 1.0e-6F;

// Doubt about velocity, in the speed limit, that is not believed.
constexpr double kSpeedDoubt = 3.0;

// Surroundings that are suddenly others: share of the sweep that the map explained before, and then no more, for so many sweeps.
constexpr float kClimb_m_s = 0.15F;
constexpr float kExplainedUsual = 0.6F;
constexpr float kExplainedLeast = 0.35F;
constexpr float kGoneLeast = 0.25F;
constexpr float kWatched_m = 8.0F;
constexpr std::int32_t kFamiliarSweeps = 20;   // in a row that it explained, before
constexpr std::int32_t kStrangeSweeps = 4;
constexpr std::size_t kCarriedPoints = 40;
constexpr float kAnywhere_m2 = 1.0e4F;
constexpr float kAnywhere_rad2 = 10.0F;

// How well a recognised place is known.
constexpr float kRecognised_m = 0.03F;
constexpr float kRecognised_rad = 0.008F;
constexpr std::int32_t kSlices = 2;   // of the search in one step
constexpr std::size_t kRebuiltAtOnce = 40;

// What the vehicle may have done while its clock began anew.
constexpr double kRestartSpeed_m_s = 0.5;

/// Newest inertial time of a frame that is not further ahead than one frame can hold.
[[nodiscard]] std::int64_t newest_plausible(const SensorFrame& frame) {
    const std::int64_t first_us = frame.imu[0].t_us;
    const std::int64_t last_us = frame.imu.back().t_us;
    return last_us - first_us < 1000000 ? last_us : first_us;
}

[[nodiscard]] double seconds(const std::int64_t from_us, const std::int64_t to_us) { return 1e-6 * static_cast<double>(to_us - from_us); }

}  // namespace

Localiser::Localiser(const Parameters& parameters)
    : parameters_(parameters), leveller_(parameters), extractor_(parameters), inertial_(parameters), filter_(parameters),
      points_(parameters), tracker_(parameters), search_(parameters) {}

void Localiser::enter_layer(const std::int32_t layer) {
    const auto next = static_cast<std::size_t>(std::clamp<std::int32_t>(layer, 0, kShaftLayer));
    if (next == layer_) { return; }
    if (next == static_cast<std::size_t>(kShaftLayer)) {
        stored_[next].count = 0;
        points_.clear(next);
    }
    filter_.change_layer(stored_[layer_], stored_[next]);
    layer_ = next;
    tracker_.clear();   // sweeps of another floor match nothing here
    search_.clear();
    strange_ = 0;
    rebuilt_ = kMaxKeyframes;
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
    // What the inertial filter found of the attitude's slow error (docs/maths/localisation.md, equation 13) is taken out of the sweep's.
    const double roll_rad = static_cast<double>(attitude.roll_rad) + x(InertialFilter::kTiltY, 0) / kGravity_m_s2;
    const double pitch_rad = static_cast<double>(attitude.pitch_rad) - x(InertialFilter::kTiltX, 0) / kGravity_m_s2;
    const MotionNode node{now_us_, x(InertialFilter::kX, 0), x(InertialFilter::kY, 0), yaw_rad, static_cast<float>(roll_rad), static_cast<float>(pitch_rad)};
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
    points_.set_noise(level_scan_.range_noise_m);

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
        static_cast<void>(tracker_.match(predicted, filter_.predicted_covariance(), !external_motion_));
    } else if (parameters_.point_match != 0) {
        match = points_.match(layer_, match_points_, predicted, filter_.predicted_covariance());
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
    if (parameters_.scan_match != 0 && !external_motion_) { watch_surroundings(result.pose, std::abs(last_altitude.vz_m_s) > kClimb_m_s); }
    if (parted_ && estimate_.quality < 0 && match_leads_ && tracker_.shape().size() >= kCarriedPoints) { anchor(); }
    if (strange_ == 0 && (estimate_.quality >= 0 || carried_)) { keep_sweep(result.pose); }
    if (parameters_.scan_match != 0 && parameters_.place_search != 0 && !external_motion_ && layer_ != static_cast<std::size_t>(kShaftLayer)) { recognise(); }
    return estimate_;
}

void Localiser::keep_sweep(const Pose2<Map, Body>& pose) {
    if (parameters_.point_match != 0) { points_.add(layer_, match_points_, pose); }
    if (parameters_.scan_match == 0) { return; }
    const Matrix<float, 3, 3> p = published_covariance();
    tracker_.keep(pose, {eigen_symmetric(p(0, 0), p(0, 1), p(1, 1)).large, p(2, 2)});
}

Matrix<float, 3, 3> Localiser::published_covariance() const {
    Matrix<float, 3, 3> p;
    for (std::size_t k = 0, i = 0; i < 3; ++i) {
        for (std::size_t j = i; j < 3; ++j, ++k) { p(i, j) = p(j, i) = estimate_.covariance[k]; }
    }
    return p;
}

void Localiser::watch_surroundings(const Pose2<Map, Body>& pose, const bool climbs) {
    // Another height shows other things, and a shaft is passed once.
    if (climbs || layer_ == static_cast<std::size_t>(kShaftLayer)) {
        strange_ = 0;
        familiar_ = 0;
        return;
    }
    // Surroundings change gradually as the vehicle moves; all at once only if it was carried (docs/maths/scan_match.md#place).
    const float explained = tracker_.explained(pose);
    // Much that is new alone is no wonder where walls come into range; what was there must be gone, too.
    const bool strange = tracker_.shape().size() >= kCarriedPoints && explained < kExplainedLeast && tracker_.passed_through(pose, kWatched_m) > kGoneLeast;
    if (!strange || (strange_ == 0 && familiar_ < kFamiliarSweeps)) {
        strange_ = 0;
        familiar_ = explained >= kExplainedUsual && estimate_.quality >= 0 ? familiar_ + 1 : 0;
        return;
    }
    estimate_.quality = -1;   // until it is known what this is
    if (++strange_ < kStrangeSweeps) { return; }
    strange_ = 0;
    familiar_ = 0;
    carried_ = true;
    ++carried_count_;
    ++lost_;
    inertial_.widen_velocity(kRestartSpeed_m_s);
    lose({kAnywhere_m2, kAnywhere_rad2});
}

void Localiser::anchor() {
    // Nothing of before is known here, but there is something to see: a map of its own begins, in doubt as the pose is.
    const auto& p = inertial_.covariance();
    Matrix<float, 3, 3> local;
    for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = 0; j < 3; ++j) { local(i, j) = static_cast<float>(p(i, j)); }
    }
    filter_.anchor(local);
    const Pose2<Map, Body>& pose = estimate_.pose_map_body;
    inertial_.relocate(static_cast<double>(pose.x_m), static_cast<double>(pose.y_m), static_cast<double>(pose.yaw_rad), 1e-3, 1e-4);
    estimate_.quality = 0;
    parted_ = false;
}

void Localiser::lose(const FrameDoubt& more) {
    filter_.begin_epoch(stored_[layer_], more);
    estimate_.covariance[0] += more.m2;
    estimate_.covariance[3] += more.m2;
    estimate_.covariance[5] += more.rad2;
    tracker_.begin_epoch();
    points_.clear(layer_);
    search_.clear();
    rebuilt_ = kMaxKeyframes;
}

void Localiser::recognise() {
    rebuild_points(1);
    bool found = false;
    for (std::int32_t slice = 0; slice < kSlices && !found; ++slice) {
        found = search_.step(tracker_.frames(), tracker_.shape(), estimate_.pose_map_body, published_covariance(), carried_, tracker_.epoch());
    }
    if (!found) { return; }
    const Relocation& relocation = search_.relocation();
    const Pose2<Map, Body> from = estimate_.pose_map_body;
    const Pose2<Map, Body> to = relocation.correction * from;
    filter_.relocate(relocation, stored_[layer_], kRecognised_m, kRecognised_rad);
    tracker_.relocate(relocation);
    inertial_.relocate(static_cast<double>(to.x_m), static_cast<double>(to.y_m), static_cast<double>(to.yaw_rad), static_cast<double>(kRecognised_m),
                       static_cast<double>(kRecognised_rad));
    points_.clear(layer_);
    rebuilt_ = 0;
    rebuild_points(kRebuiltAtOnce);
    carried_ = false;
    const float c = std::cos(relocation.correction.yaw_rad);
    const float s = std::sin(relocation.correction.yaw_rad);
    const float vx = estimate_.vx_m_s;
    estimate_.vx_m_s = c * vx - s * estimate_.vy_m_s;
    estimate_.vy_m_s = s * vx + c * estimate_.vy_m_s;
    estimate_.pose_map_body = to;
    const float m2 = relocation.before.m2 + kRecognised_m * kRecognised_m;
    estimate_.covariance = {m2, 0.0F, 0.0F, m2, 0.0F, relocation.before.rad2 + kRecognised_rad * kRecognised_rad};
    if (estimate_.quality < 0) { estimate_.quality = 0; }
    ++estimate_.reset_counter;
}

void Localiser::rebuild_points(const std::size_t most) {
    if (parameters_.point_match == 0) { return; }
    const Keyframes& frames = tracker_.frames();
    ScanShape shape;
    for (std::size_t n = 0; n < most && rebuilt_ < frames.size(); ++n, ++rebuilt_) {
        const std::size_t i = frames.size() - 1 - rebuilt_;   // the newest first
        frames.shape(i, shape);
        rebuild_.clear();
        for (const Point2<Body>& point : shape) { static_cast<void>(rebuild_.push(point)); }
        points_.add(layer_, rebuild_, frames.pose(i));
    }
}

bool Localiser::match_leads() {
    // Walls are good or poor in a building, not in a sweep: two thresholds (docs/maths/scan_match.md#lead).
    const float doubtful = filter_.doubtful_walls();
    // Where hardly a hit lies on a wall there is nothing to doubt; cells that adapt all the time turn with the vehicle there.
    const bool no_walls = filter_.hits_on_walls() < kWallsMatter;
    if (!match_leads_ && (doubtful > kWallsPoor || no_walls)) { match_leads_ = true; }
    if (match_leads_ && doubtful < kWallsGood && !no_walls) { match_leads_ = false; }
    // In a shaft the sweep changes with height, from the slab's sides to a floor's walls: a match of the whole turns with what it mistakes.
    if (layer_ == static_cast<std::size_t>(kShaftLayer)) { match_leads_ = false; }
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
    local(0, 0) += parameters_.pose_floor_m * parameters_.pose_floor_m + level_scan_.tilt_m2;
    local(1, 1) += parameters_.pose_floor_m * parameters_.pose_floor_m + level_scan_.tilt_m2;
    local(2, 2) += parameters_.pose_floor_rad * parameters_.pose_floor_rad + level_scan_.tilt_rad2;
    for (std::size_t k = 0, i = 0; i < 3; ++i) {
        for (std::size_t j = i; j < 3; ++j, ++k) { estimate_.covariance[k] = local(i, j) + result.map_drift(i, j); }
    }
    // The product of two errors (docs/maths/localisation.md, equation 7): metres along a corridor whose direction is in doubt lie across it, too.
    const auto [xx, xy, xyaw, yy, yyaw, yawyaw] = estimate_.covariance;
    const float rounding_m2 = kRounding * eigen_symmetric(xx, xy, yy).large;
    estimate_.covariance[0] += yawyaw * yy + rounding_m2;
    estimate_.covariance[1] -= yawyaw * xy;
    estimate_.covariance[3] += yawyaw * xx + rounding_m2;

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
        // Beyond this the walls of before are not found again by chance but by a search; what comes is a map of its own till then.
        if (share >= 1.0F && !parted_ && !external_motion_ && parameters_.scan_match != 0) { lose({}); }
        parted_ = parted_ || share >= 1.0F;
    } else if (carried_) {
        estimate_.quality = -1;
    } else {
        parted_ = false;
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
    counters.carried = carried_count_;
    counters.recognised = search_.counters().found;
    counters.landmarks_evicted = filter_.counters().evicted;
    counters.cells_evicted = points_.counters().evicted;
    return counters;
}

}  // namespace noctule
