#include "estimate/altitude_joint.hpp"

#include <algorithm>

namespace noctule {

void AltitudeJoint::start(const std::array<double, kFirstLevel>& mean,
                          const std::array<double, kFirstLevel>& variance) {
    states_ = kFirstLevel;
    for (auto& row : P_) { row.fill(0.0); }
    mean_.fill(0.0);
    for (std::size_t i = 0; i < kFirstLevel; ++i) {
        mean_[i] = mean[i];
        P_[i][i] = variance[i];
    }
}

void AltitudeJoint::predict_mean(const double accel_up_m_s2, const Up& up, const double dt_s) {
    const double a = accel_up_m_s2 - up[0] * mean_[kBias] - up[1] * mean_[kBias + 1] - up[2] * mean_[kBias + 2];
    mean_[kZ] += dt_s * mean_[kVz] + 0.5 * dt_s * dt_s * a;  // equation (1)
    mean_[kVz] += dt_s * a;
}

void AltitudeJoint::predict_covariance(const double dt_s, const Up& up, const double accel_density,
                                       const double bias_walk, const double baro_walk) {
    // Equation (2): F differs from the identity in two rows only, so rows and then columns of z and vz are enough.
    const double half = 0.5 * dt_s * dt_s;
    for (std::size_t j = 0; j < states_; ++j) {
        const double bias = up[0] * P_[kBias][j] + up[1] * P_[kBias + 1][j] + up[2] * P_[kBias + 2][j];
        P_[kZ][j] += dt_s * P_[kVz][j] - half * bias;
        P_[kVz][j] -= dt_s * bias;
    }
    for (std::size_t i = 0; i < states_; ++i) {
        const double bias = up[0] * P_[i][kBias] + up[1] * P_[i][kBias + 1] + up[2] * P_[i][kBias + 2];
        P_[i][kZ] += dt_s * P_[i][kVz] - half * bias;
        P_[i][kVz] -= dt_s * bias;
    }
    const double q = accel_density * accel_density;
    P_[kZ][kZ] += q * dt_s * dt_s * dt_s / 3.0;
    P_[kZ][kVz] += q * half;
    P_[kVz][kZ] += q * half;
    P_[kVz][kVz] += q * dt_s;
    for (std::size_t k = kBias; k < kBias + 3; ++k) { P_[k][k] += bias_walk * bias_walk * dt_s; }
    P_[kBaro][kBaro] += baro_walk * baro_walk * dt_s;
}

double AltitudeJoint::expect(const Row& row) const {
    double sum = 0.0;
    for (std::size_t k = 0; k < row.count; ++k) { sum += row.coefficient[k] * mean_[row.state[k]]; }
    return sum;
}

double AltitudeJoint::variance(const Row& row) const {
    double sum = 0.0;
    for (std::size_t a = 0; a < row.count; ++a) {
        for (std::size_t b = 0; b < row.count; ++b) {
            sum += row.coefficient[a] * row.coefficient[b] * P_[row.state[a]][row.state[b]];
        }
    }
    return sum;
}

void AltitudeJoint::correct(const Row& row, const double observation, const double variance) {
    std::array<double, kMaxStates> PHt;
    for (std::size_t i = 0; i < states_; ++i) {
        double sum = 0.0;
        for (std::size_t k = 0; k < row.count; ++k) { sum += row.coefficient[k] * P_[row.state[k]][i]; }
        PHt[i] = sum;
    }
    double S = variance;
    for (std::size_t k = 0; k < row.count; ++k) { S += row.coefficient[k] * PHt[row.state[k]]; }
    const double innovation = observation - expect(row);
    const double inverse = 1.0 / S;
    for (std::size_t i = 0; i < states_; ++i) {  // equation (4)
        const double gain = PHt[i] * inverse;
        mean_[i] += gain * innovation;
        for (std::size_t j = 0; j < states_; ++j) { P_[i][j] -= gain * PHt[j]; }
    }
    // Rounding may leave a well-known state a hair below zero.
    for (std::size_t i = 0; i < states_; ++i) { P_[i][i] = std::max(P_[i][i], 1.0e-12); }
}

void AltitudeJoint::correct_only(const std::size_t state, const Row& row, const double observation, const double variance) {
    std::array<double, kMaxStates> PHt;
    for (std::size_t i = 0; i < states_; ++i) {
        double sum = 0.0;
        for (std::size_t k = 0; k < row.count; ++k) { sum += row.coefficient[k] * P_[row.state[k]][i]; }
        PHt[i] = sum;
    }
    double S = variance;
    for (std::size_t k = 0; k < row.count; ++k) { S += row.coefficient[k] * PHt[row.state[k]]; }
    const double gain = PHt[state] / S;
    mean_[state] += gain * (observation - expect(row));
    for (std::size_t j = 0; j < states_; ++j) {  // equation (11)
        P_[state][j] -= gain * PHt[j];
        P_[j][state] = P_[state][j];
    }
    P_[state][state] = std::max(P_[state][state], 1.0e-12);
}

void AltitudeJoint::restart_state(const std::size_t state, const Row& row, const double offset, const double variance) {
    mean_[state] = expect(row) + offset;
    double own = variance;
    for (std::size_t i = 0; i < states_; ++i) {
        if (i == state) { continue; }
        double sum = 0.0;
        for (std::size_t k = 0; k < row.count; ++k) { sum += row.coefficient[k] * P_[row.state[k]][i]; }
        P_[state][i] = sum;
        P_[i][state] = sum;
    }
    for (std::size_t k = 0; k < row.count; ++k) { own += row.coefficient[k] * P_[state][row.state[k]]; }
    P_[state][state] = own;
}

bool AltitudeJoint::add_level(const Row& row, const double offset, const double variance) {
    if (states_ == kMaxStates) { return false; }
    const std::size_t n = states_;
    for (std::size_t i = 0; i < n; ++i) {  // equation (5)
        double sum = 0.0;
        for (std::size_t k = 0; k < row.count; ++k) { sum += row.coefficient[k] * P_[row.state[k]][i]; }
        P_[n][i] = sum;
        P_[i][n] = sum;
    }
    double own = variance;
    for (std::size_t k = 0; k < row.count; ++k) { own += row.coefficient[k] * P_[n][row.state[k]]; }
    P_[n][n] = own;
    mean_[n] = expect(row) + offset;
    ++states_;
    return true;
}

void AltitudeJoint::remove_level_unordered(const std::size_t i) {
    const std::size_t gone = kFirstLevel + i;
    const std::size_t last = states_ - 1;
    if (gone != last) {
        mean_[gone] = mean_[last];
        for (std::size_t k = 0; k < last; ++k) {
            if (k == gone) { continue; }
            P_[gone][k] = P_[last][k];
            P_[k][gone] = P_[k][last];
        }
        P_[gone][gone] = P_[last][last];
    }
    --states_;
}

void AltitudeJoint::loosen(const double z_var_m2, const double vz_var_m2_s2) {
    P_[kZ][kZ] += z_var_m2;
    P_[kVz][kVz] += vz_var_m2_s2;
}

}  // namespace noctule
