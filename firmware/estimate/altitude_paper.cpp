#include "estimate/altitude_paper.hpp"

#include <cmath>

namespace noctule {

void AltitudePaper::start() {
    z_ = static_cast<double>(p_.ground_clearance_m);
    vz_ = 0.0;
    p_zz_ = static_cast<double>(p_.alt_start_sigma_m) * static_cast<double>(p_.alt_start_sigma_m);
    p_zv_ = 0.0;
    p_vv_ = static_cast<double>(p_.alt_rest_sigma_m_s) * static_cast<double>(p_.alt_rest_sigma_m_s);
    bias_ = 0.0;
    bias_samples_ = 0;
    levels_.clear();
    // The two levels that the paper starts with "to avoid drifting"; they hold at the start, like any other entry.
    Level ground;
    ground.z_var_m2 = p_.alt_floor_sigma_m * p_.alt_floor_sigma_m;
    ground.floor = true;
    Level ceiling;
    ceiling.z_m = p_.alt_paper_ceiling_m;
    ceiling.z_var_m2 = p_.alt_paper_level_m * p_.alt_paper_level_m;
    ceiling.facing = -1;
    last_ = {0, -1};
    (void)levels_.push(ground);
    (void)levels_.push(ceiling);
}

void AltitudePaper::predict(const double accel_up_m_s2, const double dt_s, const bool measured) {
    const double a = measured ? accel_up_m_s2 - bias_ : 0.0;
    const double noise = static_cast<double>(measured ? p_.alt_accel_noise_m_s2 : p_.alt_accel_blind_m_s2);
    z_ += dt_s * vz_ + 0.5 * dt_s * dt_s * a;
    vz_ += dt_s * a;
    const double q = noise * noise;
    p_zz_ += dt_s * (2.0 * p_zv_ + dt_s * p_vv_) + q * dt_s * dt_s * dt_s / 3.0;
    p_zv_ += dt_s * p_vv_ + 0.5 * q * dt_s * dt_s;
    p_vv_ += q * dt_s;
}

void AltitudePaper::learn_bias(const double accel_up_m_s2) {
    constexpr std::int32_t kLongest = 5000;  // samples; after that the mean forgets slowly
    bias_samples_ += bias_samples_ < kLongest ? 1 : 0;
    bias_ += (accel_up_m_s2 - bias_) / static_cast<double>(bias_samples_);
}

void AltitudePaper::rest(const double variance_m2_s2) {
    const double gain = 1.0 / (p_vv_ + variance_m2_s2);
    const double k_z = p_zv_ * gain;
    const double k_v = p_vv_ * gain;
    const double v = vz_;
    z_ -= k_z * v;
    vz_ -= k_v * v;
    p_zz_ -= k_z * p_zv_;
    p_zv_ -= k_z * p_vv_;
    p_vv_ -= k_v * p_vv_;
}

bool AltitudePaper::near(const Level& level, const AltitudeReading& reading) const {
    return level.facing == facing_of(reading.side) &&
           (!reading.place_known || level.distance_m(reading.x_m, reading.y_m) <= p_.alt_level_radius_m);
}

bool AltitudePaper::fuse(const AltitudeReading& reading) {
    const double up = reading.side == RangeSide::up ? 1.0 : -1.0;
    const double offset = reading.mount_m + up * reading.drop_m - vz_ * reading.age_s;
    const double seen = z_ + offset;  // predicted elevation of the surface
    const std::size_t side = static_cast<std::size_t>(reading.side);
    const auto matches = [&](const Level& level, const double elevation) {
        return near(level, reading) &&
               std::fabs(static_cast<double>(level.z_m) - elevation) <= static_cast<double>(p_.alt_match_m);
    };

    double weight = 0.0;  // equation (5): precision-weighted mean of N levels
    double weighted = 0.0;
    std::int32_t nearest = -1;
    for (std::size_t i = 0; i < levels_.size(); ++i) {
        const Level& level = levels_[i];
        if (!matches(level, seen)) { continue; }
        const double w = 1.0 / (static_cast<double>(level.z_var_m2) + 1.0e-12);
        weight += w;
        weighted += w * static_cast<double>(level.z_m);
        if (nearest < 0 || std::fabs(static_cast<double>(level.z_m) - seen) <
                               std::fabs(static_cast<double>(levels_[static_cast<std::size_t>(nearest)].z_m) - seen)) {
            nearest = static_cast<std::int32_t>(i);
        }
    }
    const bool found = weight > 0.0;
    if (found) {
        const double Q = reading.variance_m2 + 1.0 / weight;
        const double gain = 1.0 / (p_zz_ + Q);  // equation (6)
        const double innovation = weighted / weight - offset - z_;
        z_ += p_zz_ * gain * innovation;
        vz_ += p_zv_ * gain * innovation;
        p_vv_ -= p_zv_ * p_zv_ * gain;
        p_zv_ -= p_zz_ * gain * p_zv_;
        p_zz_ -= p_zz_ * gain * p_zz_;
    }

    // Each level near has its own filter, fed with the elevation seen from the corrected z.
    const double elevation = z_ + offset;
    const double variance = p_zz_ + reading.variance_m2;
    bool covered = false;
    for (std::size_t i = 0; i < levels_.size(); ++i) {
        Level& level = levels_[i];
        if (!matches(level, elevation)) { continue; }
        const double prior = static_cast<double>(level.z_var_m2);
        const double gain = prior / (prior + variance);
        level.z_m = static_cast<float>(static_cast<double>(level.z_m) + gain * (elevation - static_cast<double>(level.z_m)));
        level.z_var_m2 = static_cast<float>((1.0 - gain) * prior);
        ++level.seen;
        level.last_t_us = reading.t_us;
        covered = true;
    }
    if (!covered) {
        if (levels_.full()) {
            std::size_t oldest = 1;
            for (std::size_t i = 2; i < levels_.size(); ++i) {
                if (levels_[i].last_t_us < levels_[oldest].last_t_us) { oldest = i; }
            }
            remove(oldest);
        }
        Level level;
        level.z_m = static_cast<float>(elevation);
        level.z_var_m2 = static_cast<float>(p_zz_) + p_.alt_paper_level_m * p_.alt_paper_level_m;
        level.facing = facing_of(reading.side);
        level.x_min_m = reading.x_m;
        level.x_max_m = reading.x_m;
        level.y_min_m = reading.y_m;
        level.y_max_m = reading.y_m;
        level.seen = 1;
        level.first_t_us = reading.t_us;
        level.last_t_us = reading.t_us;
        nearest = static_cast<std::int32_t>(levels_.size());
        (void)levels_.push(level);
    }
    if (nearest >= 0) { last_[side] = nearest; }
    merge_near(reading);
    return found;
}

void AltitudePaper::merge_near(const AltitudeReading& reading) {
    for (std::size_t i = 0; i < levels_.size(); ++i) {
        if (!near(levels_[i], reading)) { continue; }
        for (std::size_t j = i + 1; j < levels_.size();) {
            Level& a = levels_[i];
            const Level& b = levels_[j];
            if (!near(b, reading) || std::fabs(a.z_m - b.z_m) > p_.alt_merge_m) {
                ++j;
                continue;
            }
            const float sum = a.z_var_m2 + b.z_var_m2;  // equation (5) for two
            a.z_m = sum > 0.0F ? (a.z_m * b.z_var_m2 + b.z_m * a.z_var_m2) / sum : a.z_m;
            a.z_var_m2 = sum > 0.0F ? a.z_var_m2 * b.z_var_m2 / sum : 0.0F;
            a.extend(b.x_min_m, b.y_min_m);
            a.extend(b.x_max_m, b.y_max_m);
            a.seen += b.seen;
            a.last_t_us = reading.t_us;
            for (std::int32_t& last : last_) {
                if (last == static_cast<std::int32_t>(j)) { last = static_cast<std::int32_t>(i); }
            }
            remove(j);
        }
    }
}

void AltitudePaper::remove(const std::size_t i) {
    const std::int32_t gone = static_cast<std::int32_t>(i);
    const std::int32_t moved = static_cast<std::int32_t>(levels_.size() - 1);
    for (std::int32_t& last : last_) {
        if (last == gone) {
            last = -1;
        } else if (last == moved) {
            last = gone;
        }
    }
    levels_.remove_unordered(i);
}

}  // namespace noctule
