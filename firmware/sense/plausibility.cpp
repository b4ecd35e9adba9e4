#include "sense/plausibility.hpp"

#include <cmath>

namespace noctule {

namespace {

// Beyond any sensor a small vehicle carries: 16 g and 2000 deg/s, with room.
constexpr float kAccelLimit_m_s2 = 200.0F;
constexpr float kGyroLimit_rad_s = 40.0F;
constexpr float kTiltLimit_rad = 1.3F;
constexpr float kSweepLimit_us = 500000.0F;

[[nodiscard]] bool within(const std::array<float, 3>& values, const float limit) {
    for (const float value : values) {
        if (!(std::abs(value) <= limit)) { return false; }  // also false for NaN
    }
    return true;
}

}  // namespace

bool SampleChecker::rises(Clock& clock, const std::int64_t t_us) {
    if (clock.started && t_us <= clock.last_us) {
        ++clock.refused_in_a_row;
        if (clock.refused_in_a_row < kClockPatience) { return false; }
        ++counters_.clock_restarts;
        restarted_ = true;
    }
    clock.started = true;
    clock.refused_in_a_row = 0;
    clock.last_us = t_us;
    return true;
}

bool SampleChecker::take_restart() {
    const bool restarted = restarted_;
    restarted_ = false;
    return restarted;
}

SampleVerdict SampleChecker::check(const ImuSample& sample) {
    if (!within(sample.accel_m_s2, kAccelLimit_m_s2) || !within(sample.gyro_rad_s, kGyroLimit_rad_s)) {
        ++counters_.imu_value;
        return SampleVerdict::rejected_value;
    }
    if (!rises(imu_clock_, sample.t_us)) {
        ++counters_.imu_time;
        return SampleVerdict::rejected_time;
    }
    const bool same = sample.accel_m_s2 == last_imu_.accel_m_s2 && sample.gyro_rad_s == last_imu_.gyro_rad_s;
    imu_repeats_ = same ? imu_repeats_ + 1 : 0;
    last_imu_ = sample;
    if (imu_repeats_ >= kFrozenAfter) {
        ++counters_.imu_frozen;
        return SampleVerdict::rejected_frozen;
    }
    return SampleVerdict::accepted;
}

SampleVerdict SampleChecker::check(const AttitudeSample& sample) {
    if (!(std::abs(sample.roll_rad) <= kTiltLimit_rad && std::abs(sample.pitch_rad) <= kTiltLimit_rad)) {
        ++counters_.attitude_value;
        return SampleVerdict::rejected_value;
    }
    if (!rises(attitude_clock_, sample.t_us)) {
        ++counters_.attitude_time;
        return SampleVerdict::rejected_time;
    }
    return SampleVerdict::accepted;
}

SampleVerdict SampleChecker::check(const Scan& scan) {
    const bool count_fits = scan.count >= 1 && scan.count <= static_cast<std::int32_t>(kMaxBeams);
    const float span_us = static_cast<float>(scan.count) * scan.time_increment_us;
    const float span_rad = static_cast<float>(scan.count) * std::abs(scan.bearing_increment_rad);
    const bool times_fit = scan.time_increment_us >= 0.0F && span_us <= kSweepLimit_us;
    const bool bearings_fit = std::abs(scan.bearing_first_rad) <= 10.0F && span_rad > 0.0F && span_rad <= 6.6F;
    const bool ranges_fit = scan.range_min_m >= 0.0F && scan.range_max_m > scan.range_min_m && scan.range_max_m < 1000.0F;
    if (!(count_fits && times_fit && bearings_fit && ranges_fit)) {
        ++counters_.scan_layout;
        return SampleVerdict::rejected_layout;
    }
    if (!rises(scan_clock_, scan.t_us)) {
        ++counters_.scan_time;
        return SampleVerdict::rejected_time;
    }
    return SampleVerdict::accepted;
}

}  // namespace noctule
