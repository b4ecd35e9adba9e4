#include "estimate/altitude_filter.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "core/gravity.hpp"

namespace noctule {
namespace {

constexpr float kAccelLimit_m_s2 = 200.0F;  // beyond any sensor's scale
constexpr std::int64_t kFuture_us = 50000;  // a range may be stamped this much after the scan that ends its frame
constexpr std::int32_t kStairTreads = 2;    // so many risers in a row are stairs
constexpr float kBaroLimit_m = 20000.0F;    // beyond any place to fly
constexpr std::int32_t kBaroPatience = 20;  // so many samples beyond the gate in a row: the offset has jumped (a door, a fan)
constexpr std::int64_t kPair_us = 20000;    // an up and a down range this close are judged together

double seconds(const std::int64_t us) { return static_cast<double>(us) * 1.0e-6; }
double square(const double v) { return v * v; }
std::size_t index_of(const RangeSide side) { return static_cast<std::size_t>(side); }

bool finite3(const std::array<float, 3>& v) {
    return std::all_of(v.begin(), v.end(),
                       [](const float c) { return std::isfinite(c) && std::fabs(c) < kAccelLimit_m_s2; });
}

}  // namespace

AltitudeFilter::AltitudeFilter(const Parameters& parameters)
    : p_(parameters), paper_(parameters), use_joint_(parameters.alt_joint != 0) {
    start();
}

void AltitudeFilter::start() {
    using J = AltitudeJoint;
    std::array<double, J::kFirstLevel> mean{};
    std::array<double, J::kFirstLevel> variance{};
    mean[J::kZ] = static_cast<double>(p_.ground_clearance_m);
    variance[J::kZ] = square(static_cast<double>(p_.alt_start_sigma_m));
    variance[J::kVz] = square(static_cast<double>(p_.alt_rest_sigma_m_s));
    for (std::size_t k = J::kBias; k < J::kBias + 3; ++k) {
        variance[k] = square(static_cast<double>(p_.alt_accel_bias_m_s2));
    }
    variance[J::kScaleDown] = square(static_cast<double>(p_.range_scale));
    variance[J::kScaleUp] = variance[J::kScaleDown];
    joint_.start(mean, variance);
    paper_.start();
    slots_.clear();
    (void)joint_.add_level(J::Row{}, 0.0, square(static_cast<double>(p_.alt_floor_sigma_m)));
    Slot floor;
    floor.level.floor = true;
    floor.confirmed = true;
    (void)slots_.push(floor);
    last_ = {0, -1};
    shown_ = {0, -1};
    floor_slot_ = 0;
    publish(0);
}

const AltitudeEstimate& AltitudeFilter::update(const SensorFrame& frame, const PlanarEstimate& planar) {
    const std::int64_t t_scan_us = frame.scan.t_us;
    if (started_ && t_scan_us <= scan_t_us_) {
        ++counters_.frames_refused;
        return estimate_;
    }
    imu_next_ = 0;
    attitude_next_ = 0;
    if (!started_) {
        started_ = true;
        t_us_ = frame.imu.empty() ? t_scan_us : std::min(frame.imu[0].t_us, t_scan_us);
        imu_t_us_ = t_us_ - 1;
        last_range_t_us_ = {t_us_ - 1000000, t_us_ - 1000000};
        last_baro_t_us_ = t_us_ - 1000000;
        last_match_t_us_ = t_us_;
        slots_[0].level.first_t_us = t_us_;
        slots_[0].level.last_t_us = t_us_;
    }
    scan_t_us_ = t_scan_us;
    read_vehicle(frame);

    // Ranges in order of time, a downward and an upward one of the same moment together.
    std::size_t i_down = 0;
    std::size_t i_up = 0;
    while (i_down < frame.range_down.size() || i_up < frame.range_up.size()) {
        const bool has_down = i_down < frame.range_down.size();
        const bool has_up = i_up < frame.range_up.size();
        const std::int64_t t_down = has_down ? frame.range_down[i_down].t_us : std::numeric_limits<std::int64_t>::max();
        const std::int64_t t_up = has_up ? frame.range_up[i_up].t_us : std::numeric_limits<std::int64_t>::max();
        const bool pair = has_down && has_up && t_down - t_up <= kPair_us && t_up - t_down <= kPair_us;
        const bool take_down = has_down && (pair || t_down <= t_up);
        const bool take_up = has_up && (pair || !take_down);
        const std::int64_t t_newest = pair ? std::max(t_down, t_up) : std::min(t_down, t_up);
        propagate(frame, std::min(t_newest, t_scan_us));
        AltitudeReading down;
        AltitudeReading up;
        const bool down_good = take_down && read_range(frame.range_down[i_down], RangeSide::down, t_scan_us, planar, down);
        const bool up_good = take_up && read_range(frame.range_up[i_up], RangeSide::up, t_scan_us, planar, up);
        i_down += take_down ? 1 : 0;
        i_up += take_up ? 1 : 0;
        if (use_joint_) {
            flush_covariance();
            fuse(down_good ? &down : nullptr, up_good ? &up : nullptr);
        } else {
            if (down_good) { ++(paper_.fuse(down) ? counters_.matched : counters_.founded); }
            if (up_good) { ++(paper_.fuse(up) ? counters_.matched : counters_.founded); }
        }
    }
    propagate(frame, t_scan_us);
    while (attitude_next_ < frame.attitude.size()) { set_attitude(frame, frame.attitude[attitude_next_].t_us); }
    flush_covariance();
    if (at_rest_) { rest(); }
    take_baro(frame);
    if (use_joint_) { forget_tentative(t_scan_us); }
    publish(t_scan_us);
    return estimate_;
}

void AltitudeFilter::read_vehicle(const SensorFrame& frame) {
    if (frame.vehicle.empty()) { return; }
    const VehicleSample& newest = frame.vehicle.back();
    const bool airborne = newest.armed || newest.landed == VehicleSample::Landed::in_air;
    if (!vehicle_heard_ && newest.landed == VehicleSample::Landed::in_air) {
        // Woken up in the air: the landing gear says nothing about z, the first downward range does.
        joint_.loosen(4.0, 1.0);
    }
    vehicle_heard_ = true;
    at_rest_ = !airborne && newest.landed == VehicleSample::Landed::on_ground;
}

void AltitudeFilter::set_attitude(const SensorFrame& frame, const std::int64_t t_us) {
    // Samples up to t_us move into attitude_before_; between it and the next one roll and pitch are interpolated.
    while (attitude_next_ < frame.attitude.size() && frame.attitude[attitude_next_].t_us <= t_us) {
        const AttitudeSample& s = frame.attitude[attitude_next_++];
        if (!std::isfinite(s.roll_rad) || !std::isfinite(s.pitch_rad) ||
            (attitude_heard_ && s.t_us < attitude_before_.t_us)) {
            ++counters_.inertial_refused;
            continue;
        }
        attitude_before_ = s;
        attitude_heard_ = true;
    }
    roll_rad_ = attitude_before_.roll_rad;
    pitch_rad_ = attitude_before_.pitch_rad;
    if (attitude_next_ >= frame.attitude.size()) { return; }
    const AttitudeSample& next = frame.attitude[attitude_next_];
    if (!std::isfinite(next.roll_rad) || !std::isfinite(next.pitch_rad)) { return; }
    if (!attitude_heard_) {
        roll_rad_ = next.roll_rad;
        pitch_rad_ = next.pitch_rad;
        return;
    }
    const std::int64_t span_us = next.t_us - attitude_before_.t_us;
    if (span_us <= 0) { return; }
    const float share = static_cast<float>(static_cast<double>(t_us - attitude_before_.t_us) / static_cast<double>(span_us));
    roll_rad_ += share * wrap_angle(next.roll_rad - attitude_before_.roll_rad);
    pitch_rad_ += share * (next.pitch_rad - attitude_before_.pitch_rad);
}

void AltitudeFilter::propagate(const SensorFrame& frame, const std::int64_t t_us) {
    const std::int64_t gap_us = static_cast<std::int64_t>(p_.alt_imu_gap_s * 1.0e6F);
    while (imu_next_ < frame.imu.size() && frame.imu[imu_next_].t_us <= t_us) {
        const ImuSample& s = frame.imu[imu_next_++];
        if (s.t_us <= imu_t_us_ || !finite3(s.accel_m_s2)) {
            ++counters_.inertial_refused;
            continue;
        }
        set_attitude(frame, s.t_us);
        // Third row of R_WB (section B of the paper): specific force to vertical acceleration.
        const double sr = std::sin(static_cast<double>(roll_rad_));
        const double cr = std::cos(static_cast<double>(roll_rad_));
        const double sp = std::sin(static_cast<double>(pitch_rad_));
        const double cp = std::cos(static_cast<double>(pitch_rad_));
        up_ = {-sp, sr * cp, cr * cp};
        accel_up_m_s2_ = up_[0] * static_cast<double>(s.accel_m_s2[0]) + up_[1] * static_cast<double>(s.accel_m_s2[1]) +
                         up_[2] * static_cast<double>(s.accel_m_s2[2]) - kGravity_m_s2;
        // A slower stream leaves samples out; each stands for longer than it was measured over.
        const double span_s = static_cast<double>(p_.alt_imu_span_s);
        noise_share_ = imu_t_us_ < 0 ? 1.0 : std::max(1.0, seconds(s.t_us - imu_t_us_) / span_s);
        if (at_rest_ && !use_joint_) { paper_.learn_bias(accel_up_m_s2_); }
        const bool hole = s.t_us - imu_t_us_ > gap_us && imu_t_us_ >= 0;
        if (hole) { advance(s.t_us - gap_us, true); }
        advance(s.t_us, false);
        imu_t_us_ = s.t_us;
    }
    advance(t_us, t_us - imu_t_us_ > gap_us);
    set_attitude(frame, t_us);
}

void AltitudeFilter::advance(const std::int64_t t_us, const bool blind) {
    if (t_us <= t_us_) { return; }
    const double dt_s = seconds(t_us - t_us_);
    t_us_ = t_us;
    // Blind: the best guess is no acceleration, and the bias does not come in.
    const double accel = blind ? 0.0 : accel_up_m_s2_;
    if (!use_joint_) {
        paper_.predict(accel, dt_s, !blind);
        return;
    }
    if (pending_s_ > 0.0 && blind != pending_blind_) { flush_covariance(); }
    const AltitudeJoint::Up up = blind ? AltitudeJoint::Up{} : up_;
    joint_.predict_mean(accel, up, dt_s);
    for (std::size_t k = 0; k < up.size(); ++k) { pending_up_[k] += up[k] * dt_s; }
    pending_s_ += dt_s;
    pending_noise_s_ += dt_s * (blind ? 1.0 : noise_share_);
    pending_blind_ = blind;
}

void AltitudeFilter::flush_covariance() {
    if (pending_s_ <= 0.0) { return; }
    for (double& u : pending_up_) { u /= pending_s_; }
    const double noise = static_cast<double>(pending_blind_ ? p_.alt_accel_blind_m_s2 : p_.alt_accel_noise_m_s2);
    joint_.predict_covariance(pending_s_, pending_up_, noise * std::sqrt(pending_noise_s_ / pending_s_),
                              static_cast<double>(p_.alt_accel_walk_m_s2),
                              p_.alt_baro_sigma_m > 0.0F ? static_cast<double>(p_.alt_baro_walk_m) : 0.0);
    pending_s_ = 0.0;
    pending_noise_s_ = 0.0;
    pending_up_ = {};
}

void AltitudeFilter::rest() {
    const double variance = square(static_cast<double>(p_.alt_rest_sigma_m_s));
    if (use_joint_) {
        AltitudeJoint::Row row;
        row.add(AltitudeJoint::kVz, 1.0);
        joint_.correct(row, 0.0, variance);
    } else {
        paper_.rest(variance);
    }
}

void AltitudeFilter::take_baro(const SensorFrame& frame) {
    if (!use_joint_ || !(p_.alt_baro_sigma_m > 0.0F)) { return; }
    for (const BaroSample& s : frame.baro) {
        const bool timely = s.t_us > last_baro_t_us_ && s.t_us <= scan_t_us_ + kFuture_us &&
                            seconds(t_us_ - s.t_us) <= static_cast<double>(p_.range_late_s);
        if (!timely || !std::isfinite(s.height_m) || std::fabs(s.height_m) > kBaroLimit_m) {
            ++counters_.baro_refused;
            continue;
        }
        last_baro_t_us_ = s.t_us;
        fuse_baro(static_cast<double>(s.height_m), std::max(seconds(t_us_ - s.t_us), 0.0));
    }
}

// Equations (9) to (11).
void AltitudeFilter::fuse_baro(const double height_m, const double age_s) {
    using J = AltitudeJoint;
    const double variance = square(static_cast<double>(p_.alt_baro_sigma_m));
    J::Row row;
    row.add(J::kZ, 1.0);
    row.add(J::kVz, -age_s);
    row.add(J::kBaro, 1.0);
    if (baro_known_) {
        const double nu2 = square(height_m - joint_.expect(row)) / (joint_.variance(row) + variance);
        if (nu2 > square(static_cast<double>(p_.alt_gate_sigma))) {
            ++counters_.baro_refused;
            if (++baro_misses_ < kBaroPatience) { return; }
            baro_known_ = false;
            ++counters_.baro_restarts;
            return;  // the next sample founds it
        }
    }
    baro_misses_ = 0;
    ++counters_.baro_used;
    if (!baro_known_) {
        J::Row offset;
        offset.add(J::kZ, -1.0);
        offset.add(J::kVz, age_s);
        joint_.restart_state(J::kBaro, offset, height_m, variance);
        baro_known_ = true;
        return;
    }
    // While something better knows z the barometer only learns its own offset: its drift must not lean on z.
    const bool z_known = at_rest_ || seconds(t_us_ - last_match_t_us_) <= static_cast<double>(p_.alt_hold_s);
    if (z_known) {
        joint_.correct_only(J::kBaro, row, height_m, variance);
    } else {
        joint_.correct(row, height_m, variance);
    }
}

bool AltitudeFilter::read_range(const RangeSample& sample, const RangeSide side, const std::int64_t t_scan_us,
                                const PlanarEstimate& planar, AltitudeReading& out) {
    const std::size_t s = index_of(side);
    if (sample.t_us <= last_range_t_us_[s] || sample.t_us > t_scan_us + kFuture_us ||
        seconds(t_us_ - sample.t_us) > static_cast<double>(p_.range_late_s)) {
        ++counters_.refused_time;
        return false;
    }
    last_range_t_us_[s] = sample.t_us;
    if (std::isnan(sample.range_m)) {
        ++counters_.refused_empty;
        return false;
    }
    if (!std::isfinite(sample.range_m) || sample.range_m < 0.0F || !(sample.range_min_m >= 0.0F) ||
        !(sample.range_max_m > sample.range_min_m)) {
        ++counters_.refused_input;
        return false;
    }
    // Many sensors report their limit itself where they see nothing, so the limits do not count as readings.
    blind_[s] = sample.range_m <= sample.range_min_m;
    if (blind_[s] || sample.range_m >= sample.range_max_m) {
        ++counters_.refused_range;
        return false;
    }
    const float sr = std::sin(roll_rad_);
    const float cr = std::cos(roll_rad_);
    const float sp = std::sin(pitch_rad_);
    const float cosine = cr * std::cos(pitch_rad_);  // vertical part of Body z
    const float tilt_rad = std::acos(std::clamp(cosine, -1.0F, 1.0F));
    if (!(tilt_rad <= p_.alt_tilt_max_rad)) {
        ++counters_.refused_tilt;
        return false;
    }
    ++readings_[s];
    const float mount_m = side == RangeSide::up ? p_.range_up_z_m : p_.range_down_z_m;
    out.side = side;
    out.t_us = sample.t_us;
    out.age_s = std::max(seconds(t_us_ - sample.t_us), 0.0);
    out.drop_m = static_cast<double>(sample.range_m * cosine);
    out.mount_m = static_cast<double>(mount_m * cosine);
    out.tilt_rad = tilt_rad;
    const double noise = square(static_cast<double>(p_.range_sigma_m)) + square(static_cast<double>(p_.range_step_m)) / 12.0;
    out.variance_m2 = noise * square(static_cast<double>(cosine)) +
                      square(static_cast<double>(sample.range_m * std::sin(tilt_rad) * p_.alt_tilt_sigma_rad));
    // Where the beam met the surface: along Body z from the Body origin, equation (3).
    const float along_m = side == RangeSide::up ? mount_m + sample.range_m : mount_m - sample.range_m;
    const float level_x_m = along_m * cr * sp;
    const float level_y_m = -along_m * sr;
    const float before_s = static_cast<float>(seconds(t_scan_us - sample.t_us));
    const float c = std::cos(planar.pose_map_body.yaw_rad);
    const float n = std::sin(planar.pose_map_body.yaw_rad);
    out.x_m = planar.pose_map_body.x_m - planar.vx_m_s * before_s + c * level_x_m - n * level_y_m;
    out.y_m = planar.pose_map_body.y_m - planar.vy_m_s * before_s + n * level_x_m + c * level_y_m;
    out.place_known = planar.quality >= 0 && std::isfinite(out.x_m) && std::isfinite(out.y_m);
    return true;
}

// Stairs are surfaces that follow each other in one direction, each a riser from the one before.
void AltitudeFilter::count_treads() {
    const std::int32_t slot = shown_[index_of(RangeSide::down)];
    if (slot < 0) { return; }
    const double z = elevation(static_cast<std::size_t>(slot));
    const double rise = z - walked_z_m_;
    if (std::fabs(rise) < static_cast<double>(p_.alt_merge_m)) {
        walked_z_m_ = z;  // the same surface, known better
    } else {
        const bool riser = std::fabs(rise) <= static_cast<double>(p_.stair_riser_max_m);
        const std::int32_t way = rise > 0.0 ? 1 : -1;
        if (!riser) {
            treads_ = 0;
        } else if (treads_ * way > 0) {
            treads_ += way;
        } else {  // turned round: on stairs that does not make them anything else
            treads_ = std::abs(treads_) >= kStairTreads ? way * kStairTreads : way;
        }
        walked_z_m_ = z;
    }
    estimate_.on_stairs = std::abs(treads_) >= kStairTreads && !slots_[static_cast<std::size_t>(slot)].level.floor;
}

double AltitudeFilter::floor_under(const double z_m) const {
    double best = elevation(static_cast<std::size_t>(floor_slot_));
    bool found = best <= z_m;
    for (std::size_t i = 0; i < slots_.size(); ++i) {
        const double z = elevation(i);
        if (!slots_[i].level.floor || z > z_m || (found && z <= best)) { continue; }
        best = z;
        found = true;
    }
    return best;
}

void AltitudeFilter::publish(const std::int64_t t_us) {
    constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();
    using J = AltitudeJoint;
    published_.clear();
    if (use_joint_) {
        estimate_.z_m = static_cast<float>(joint_.mean(J::kZ));
        estimate_.vz_m_s = static_cast<float>(joint_.mean(J::kVz));
        estimate_.z_var_m2 = static_cast<float>(joint_.covariance(J::kZ, J::kZ));
        estimate_.vz_var_m2_s2 = static_cast<float>(joint_.covariance(J::kVz, J::kVz));
        for (std::size_t i = 0; i < slots_.size(); ++i) {
            Level& level = slots_[i].level;
            level.z_m = static_cast<float>(elevation(i));
            level.z_var_m2 = static_cast<float>(joint_.covariance(J::kFirstLevel + i, J::kFirstLevel + i));
            if (slots_[i].confirmed) { (void)published_.push(level); }
        }
        count_treads();
        estimate_.floor_z_m = static_cast<float>(estimate_.on_stairs ? floor_under(walked_z_m_)
                                                                     : elevation(static_cast<std::size_t>(floor_slot_)));
    } else {
        estimate_.z_m = static_cast<float>(paper_.z_m());
        estimate_.vz_m_s = static_cast<float>(paper_.vz_m_s());
        estimate_.z_var_m2 = static_cast<float>(paper_.z_var_m2());
        estimate_.vz_var_m2_s2 = static_cast<float>(paper_.vz_var_m2_s2());
        for (const Level& level : paper_.levels()) {
            // The paper has no floors; the start's entry stands for it. Single echoes and what does not fit stay out.
            if ((level.seen >= p_.alt_confirm_hits || level.floor) && !published_.full()) { (void)published_.push(level); }
        }
        estimate_.floor_z_m = 0.0F;
    }
    for (const RangeSide side : {RangeSide::down, RangeSide::up}) {
        const std::size_t s = index_of(side);
        const std::int32_t slot = use_joint_ ? shown_[s] : paper_.last(side);
        float& out = side == RangeSide::down ? estimate_.ground_z_m : estimate_.ceiling_z_m;
        out = kUnknown;
        if (slot < 0) { continue; }
        const Level& level = use_joint_ ? slots_[static_cast<std::size_t>(slot)].level
                                        : paper_.levels()[static_cast<std::size_t>(slot)];
        const bool fresh = seconds(t_us - level.last_t_us) <= static_cast<double>(p_.alt_hold_s);
        // Standing on it, or so near that the sensor is blind: the surface is still there.
        const bool touching = side == RangeSide::down && (at_rest_ || blind_[s]);
        if (fresh || touching) { out = level.z_m; }
    }
    estimate_.valid = std::isfinite(estimate_.z_m) &&
                      estimate_.z_var_m2 <= p_.alt_valid_sigma_m * p_.alt_valid_sigma_m;
}

}  // namespace noctule
