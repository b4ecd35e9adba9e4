#include "estimate/inertial_filter.hpp"

#include <cmath>

namespace noctule {

namespace {

// Without inertial data the vehicle may do what its limits allow.
constexpr double kCoastAccel_m_s2 = 1.0;      // per root hertz
constexpr double kCoastYawRate_rad_s = 0.5;   // per root hertz

[[nodiscard]] double wrap(const double angle_rad) { return std::remainder(angle_rad, 6.283185307179586); }

[[nodiscard]] double square(const double value) { return value * value; }

}  // namespace

void InertialFilter::start() {
    x_ = Vector{};
    p_ = Square{};
    for (const std::size_t i : {kX, kY, kYaw}) { p_(i, i) = 1e-8; }
    for (const std::size_t i : {kVx, kVy}) { p_(i, i) = square(0.05); }
    for (const std::size_t i : {kBiasX, kBiasY}) { p_(i, i) = square(static_cast<double>(parameters_.accel_bias_start_m_s2)); }
    p_(kBiasYaw, kBiasYaw) = square(static_cast<double>(parameters_.gyro_bias_start_rad_s));
    for (const std::size_t i : {kTiltX, kTiltY}) { p_(i, i) = square(static_cast<double>(parameters_.accel_tilt_m_s2)); }
    yaw_rate_rad_s_ = 0.0;
    mark();
}

void InertialFilter::mark() {
    mark_x_m_ = x_(kX, 0);
    mark_y_m_ = x_(kY, 0);
    mark_yaw_rad_ = x_(kYaw, 0);
    mark_dt_s_ = 0.0;
    p_increment_ = p_;
    for (std::size_t i = 0; i < kVx; ++i) {
        for (std::size_t j = 0; j < kStates; ++j) {
            p_increment_(i, j) = 0.0;
            p_increment_(j, i) = 0.0;
        }
    }
}

InertialFilter::Vector InertialFilter::propagate(const Vector& x, const Input& input, const double dt_s, Square& J_next_now) {
    const double cph = std::cos(input.roll_rad);
    const double sph = std::sin(input.roll_rad);
    const double cth = std::cos(input.pitch_rad);
    const double sth = std::sin(input.pitch_rad);
    const double fx = input.accel_m_s2[0] - x(kBiasX, 0) - x(kTiltX, 0);
    const double fy = input.accel_m_s2[1] - x(kBiasY, 0) - x(kTiltY, 0);
    const double fz = input.accel_m_s2[2];
    // Algorithms B, first in the level frame (yaw 0); gravity acts on z alone.
    const double level_x = cth * fx + sph * sth * fy + cph * sth * fz;
    const double level_y = cph * fy - sph * fz;
    const double to_yaw_rate = cph / cth;
    const double yaw_rate = (input.gyro_rad_s[1] * sph) / cth + (input.gyro_rad_s[2] - x(kBiasYaw, 0)) * to_yaw_rate;
    const double yaw_mid = x(kYaw, 0) + 0.5 * dt_s * yaw_rate;
    const double c = std::cos(yaw_mid);
    const double s = std::sin(yaw_mid);
    const double ax = c * level_x - s * level_y;
    const double ay = s * level_x + c * level_y;

    Vector next = x;
    next(kX, 0) += dt_s * x(kVx, 0) + 0.5 * dt_s * dt_s * ax;
    next(kY, 0) += dt_s * x(kVy, 0) + 0.5 * dt_s * dt_s * ay;
    next(kYaw, 0) = wrap(x(kYaw, 0) + dt_s * yaw_rate);
    next(kVx, 0) += dt_s * ax;
    next(kVy, 0) += dt_s * ay;

    J_next_now = Square::identity();
    const double half = 0.5 * dt_s * dt_s;
    const std::array<double, 2> J_ax_bias{-c * cth, -(c * sph * sth - s * cph)};
    const std::array<double, 2> J_ay_bias{-s * cth, -(s * sph * sth + c * cph)};
    const double J_yawmid_biasyaw = -0.5 * dt_s * to_yaw_rate;
    J_next_now(kX, kVx) = dt_s;
    J_next_now(kY, kVy) = dt_s;
    J_next_now(kX, kYaw) = -half * ay;
    J_next_now(kY, kYaw) = half * ax;
    J_next_now(kVx, kYaw) = -dt_s * ay;
    J_next_now(kVy, kYaw) = dt_s * ax;
    for (const std::size_t first : {kBiasX, kTiltX}) {
        for (std::size_t i = 0; i < 2; ++i) {
            J_next_now(kX, first + i) = half * J_ax_bias[i];
            J_next_now(kY, first + i) = half * J_ay_bias[i];
            J_next_now(kVx, first + i) = dt_s * J_ax_bias[i];
            J_next_now(kVy, first + i) = dt_s * J_ay_bias[i];
        }
    }
    J_next_now(kX, kBiasYaw) = -half * ay * J_yawmid_biasyaw;
    J_next_now(kY, kBiasYaw) = half * ax * J_yawmid_biasyaw;
    J_next_now(kVx, kBiasYaw) = -dt_s * ay * J_yawmid_biasyaw;
    J_next_now(kVy, kBiasYaw) = dt_s * ax * J_yawmid_biasyaw;
    J_next_now(kYaw, kBiasYaw) = -dt_s * to_yaw_rate;
    return next;
}

void InertialFilter::advance(const Square& J_next_now, const Square& noise) {
    p_ = J_next_now * p_ * transpose(J_next_now) + noise;
    p_increment_ = J_next_now * p_increment_ * transpose(J_next_now) + noise;
    symmetrise(p_);
    symmetrise(p_increment_);
}

void InertialFilter::predict(const Input& input, const double dt_s) {
    Square J_next_now;
    const double yaw_before = x_(kYaw, 0);
    x_ = propagate(x_, input, dt_s, J_next_now);
    yaw_rate_rad_s_ = wrap(x_(kYaw, 0) - yaw_before) / dt_s;
    // An autopilot's roll and pitch err slowly, but not for ever (equation 13).
    const double kept = std::exp(-dt_s / static_cast<double>(parameters_.accel_tilt_s));
    const double tilt_var = square(static_cast<double>(parameters_.accel_tilt_m_s2)) * (1.0 - kept * kept);
    for (const std::size_t i : {kTiltX, kTiltY}) {
        x_(i, 0) *= kept;
        J_next_now(i, i) = kept;
    }
    const double accel_var = square(static_cast<double>(parameters_.accel_noise_m_s2));
    const double gyro_var = square(static_cast<double>(parameters_.gyro_noise_rad_s));
    const double accel_walk_var = square(static_cast<double>(parameters_.accel_bias_walk_m_s2));
    const double gyro_walk_var = square(static_cast<double>(parameters_.gyro_bias_walk_rad_s));
    Square noise;
    for (std::size_t i = 0; i < 2; ++i) {
        // White acceleration integrated over dt.
        noise(kX + i, kX + i) = accel_var * dt_s * dt_s * dt_s / 3.0;
        noise(kX + i, kVx + i) = accel_var * dt_s * dt_s / 2.0;
        noise(kVx + i, kX + i) = noise(kX + i, kVx + i);
        noise(kVx + i, kVx + i) = accel_var * dt_s;
        noise(kBiasX + i, kBiasX + i) = accel_walk_var * dt_s;
        noise(kTiltX + i, kTiltX + i) = tilt_var;
    }
    noise(kYaw, kYaw) = gyro_var * dt_s;
    noise(kBiasYaw, kBiasYaw) = gyro_walk_var * dt_s;
    advance(J_next_now, noise);
    mark_dt_s_ += dt_s;
}

void InertialFilter::coast(const double dt_s) {
    Square J_next_now = Square::identity();
    J_next_now(kX, kVx) = dt_s;
    J_next_now(kY, kVy) = dt_s;
    x_(kX, 0) += dt_s * x_(kVx, 0);
    x_(kY, 0) += dt_s * x_(kVy, 0);
    x_(kYaw, 0) = wrap(x_(kYaw, 0) + dt_s * yaw_rate_rad_s_);
    Square noise;
    const double accel_var = square(kCoastAccel_m_s2);
    for (std::size_t i = 0; i < 2; ++i) {
        noise(kX + i, kX + i) = accel_var * dt_s * dt_s * dt_s / 3.0;
        noise(kX + i, kVx + i) = accel_var * dt_s * dt_s / 2.0;
        noise(kVx + i, kX + i) = noise(kX + i, kVx + i);
        noise(kVx + i, kVx + i) = accel_var * dt_s;
    }
    noise(kYaw, kYaw) = square(kCoastYawRate_rad_s) * dt_s;
    advance(J_next_now, noise);
    mark_dt_s_ += dt_s;
}

MotionIncrement InertialFilter::increment() const {
    const double c = std::cos(mark_yaw_rad_);
    const double s = std::sin(mark_yaw_rad_);
    const double dx = x_(kX, 0) - mark_x_m_;
    const double dy = x_(kY, 0) - mark_y_m_;
    MotionIncrement motion;
    motion.dx_m = static_cast<float>(c * dx + s * dy);
    motion.dy_m = static_cast<float>(c * dy - s * dx);
    motion.dyaw_rad = static_cast<float>(wrap(x_(kYaw, 0) - mark_yaw_rad_));
    motion.dt_s = static_cast<float>(mark_dt_s_);
    Matrix<double, 3, 3> turn = Matrix<double, 3, 3>::identity();
    turn(0, 0) = c;
    turn(0, 1) = s;
    turn(1, 0) = -s;
    turn(1, 1) = c;
    Matrix<double, 3, 3> p_map;
    for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = 0; j < 3; ++j) {
            p_map(i, j) = p_increment_(i, j);
            motion.pose_covariance(i, j) = static_cast<float>(p_(i, j));
        }
    }
    const Matrix<double, 3, 3> p_body = turn * p_map * transpose(turn);
    for (std::size_t i = 0; i < 9; ++i) { motion.covariance.values[i] = static_cast<float>(p_body.values[i]); }
    return motion;
}

void InertialFilter::keep_along(Matrix<double, kStates, 3>& k, const double blind_rad) const {
    const auto take_out = [&k](const std::size_t row, const double c, const double s) {
        for (std::size_t j = 0; j < 3; ++j) {
            const double along = c * k(row, j) + s * k(row + 1, j);
            k(row, j) -= c * along;
            k(row + 1, j) -= s * along;
        }
    };
    take_out(kX, std::cos(blind_rad), std::sin(blind_rad));
    take_out(kVx, std::cos(blind_rad), std::sin(blind_rad));
    const double in_body_rad = blind_rad - x_(kYaw, 0);
    for (const std::size_t i : {kBiasX, kTiltX}) { take_out(i, std::cos(in_body_rad), std::sin(in_body_rad)); }
}

void InertialFilter::bound_speed(const double most_m_s) {
    for (const std::size_t i : {kVx, kVy}) {
        if (p_(i, i) < square(most_m_s)) { continue; }
        Vector k;
        const double total = p_(i, i) + square(most_m_s);
        for (std::size_t j = 0; j < kStates; ++j) { k(j, 0) = p_(j, i) / total; }
        const double off = -x_(i, 0);
        for (std::size_t j = 0; j < kStates; ++j) { x_(j, 0) += k(j, 0) * off; }
        p_ -= total * (k * transpose(k));
        symmetrise(p_);
    }
}

void InertialFilter::correct(const LaserInformation& laser) {
    // K b = P H^T (I + Lambda H P H^T)^-1 b, H = [I3 0]: the same as the Kalman gain times the innovation, but Lambda may be singular.
    Matrix<double, 3, 3> p_pose;
    Matrix<double, kStates, 3> p_all_pose;
    for (std::size_t j = 0; j < 3; ++j) {
        for (std::size_t i = 0; i < kStates; ++i) { p_all_pose(i, j) = p_(i, j); }
        for (std::size_t i = 0; i < 3; ++i) { p_pose(i, j) = p_(i, j); }
    }
    Matrix<double, 3, 3> gain;
    if (!invert(Matrix<double, 3, 3>::identity() + laser.lambda * p_pose, gain)) { return; }
    Matrix<double, kStates, 3> k = p_all_pose * gain;
    if (laser.blind) { keep_along(k, laser.blind_rad); }
    x_ += k * laser.b;
    x_(kYaw, 0) = wrap(x_(kYaw, 0));
    if (!laser.blind) {
        p_ -= k * laser.lambda * transpose(p_all_pose);
    } else {
        // For a gain that is not the best one (equation 11): (I - K Lambda H) P (I - K Lambda H)^T + K Lambda K^T.
        const Matrix<double, kStates, 3> kl = k * laser.lambda;
        const Square cross = kl * transpose(p_all_pose);
        p_ -= cross + transpose(cross);
        p_ += kl * p_pose * transpose(kl) + kl * transpose(k);
    }
    symmetrise(p_);
    for (std::size_t i = 0; i < kStates; ++i) { p_(i, i) = std::max(p_(i, i), 1e-14); }
}

void InertialFilter::place(const double x_m, const double y_m, const double yaw_rad) {
    // Velocity belongs to Map: a turn of the pose turns it along.
    const double turn = wrap(yaw_rad - x_(kYaw, 0));
    const double c = std::cos(turn);
    const double s = std::sin(turn);
    const double vx = x_(kVx, 0);
    const double vy = x_(kVy, 0);
    x_(kVx, 0) = c * vx - s * vy;
    x_(kVy, 0) = s * vx + c * vy;
    x_(kX, 0) = x_m;
    x_(kY, 0) = y_m;
    x_(kYaw, 0) = wrap(yaw_rad);
}

void InertialFilter::relocate(const double x_m, const double y_m, const double yaw_rad, const double sigma_m, const double sigma_rad) {
    const double turn = wrap(yaw_rad - x_(kYaw, 0));
    place(x_m, y_m, yaw_rad);
    // Velocity's covariance turns with it; biases belong to Body.
    Square rotate = Square::identity();
    rotate(kVx, kVx) = rotate(kVy, kVy) = std::cos(turn);
    rotate(kVx, kVy) = -std::sin(turn);
    rotate(kVy, kVx) = std::sin(turn);
    p_ = rotate * p_ * transpose(rotate);
    for (std::size_t i = 0; i < kVx; ++i) {
        for (std::size_t j = 0; j < kStates; ++j) { p_(i, j) = p_(j, i) = 0.0; }
    }
    p_(kX, kX) = p_(kY, kY) = square(sigma_m);
    p_(kYaw, kYaw) = square(sigma_rad);
    symmetrise(p_);
    mark();
}

void InertialFilter::widen_velocity(const double sigma_m_s) {
    p_(kVx, kVx) += square(sigma_m_s);
    p_(kVy, kVy) += square(sigma_m_s);
}

}  // namespace noctule
