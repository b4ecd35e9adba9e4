// The inertial filter: honest growth, increments, and corrections that carry the laser's information and nothing else.
#include <cmath>
#include <memory>
#include <random>

#include "estimate/inertial_filter.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

using F = InertialFilter;

F::Input at_rest() {
    F::Input input;
    input.accel_m_s2 = {0.0, 0.0, 9.81};
    return input;
}

void follows_a_known_acceleration_through_a_tilt() {
    const Parameters parameters;
    F filter(parameters);
    // 0.5 m/s^2 along Map x from a vehicle pitched nose down, as a multirotor accelerates: the specific force is along Body z.
    const double pitch = std::atan(0.5 / 9.81);
    F::Input input;
    input.pitch_rad = pitch;
    input.accel_m_s2 = {0.0, 0.0, 9.81 / std::cos(pitch)};
    for (int i = 0; i < 250; ++i) { filter.predict(input, 0.004); }
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.25, filter.state()(F::kX, 0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.5, filter.state()(F::kVx, 0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.0, filter.state()(F::kY, 0));
}

void covariance_matches_sampled_spread() {
    // Independent route: 4000 vehicles with their own bias, velocity and gyro bias, moved by the nonlinear model.
    Parameters parameters;
    parameters.accel_noise_m_s2 = 1e-4F;
    parameters.accel_bias_walk_m_s2 = 0.0F;
    parameters.accel_tilt_m_s2 = 0.0F;
    parameters.gyro_noise_rad_s = 1e-5F;
    parameters.gyro_bias_walk_rad_s = 0.0F;
    F filter(parameters);
    F::Input input = at_rest();
    input.accel_m_s2[0] = 0.8;
    input.gyro_rad_s[2] = 0.5;
    for (int i = 0; i < 200; ++i) { filter.predict(input, 0.01); }
    std::mt19937 rng(7);
    std::normal_distribution<double> normal;
    double xx = 0.0, yy = 0.0, yawyaw = 0.0;
    constexpr int kSamples = 4000;
    for (int k = 0; k < kSamples; ++k) {
        F::Vector x;
        x(F::kVx, 0) = 0.05 * normal(rng);
        x(F::kVy, 0) = 0.05 * normal(rng);
        x(F::kBiasX, 0) = 0.1 * normal(rng);
        x(F::kBiasY, 0) = 0.1 * normal(rng);
        x(F::kBiasYaw, 0) = 0.01 * normal(rng);
        F::Square unused;
        for (int i = 0; i < 200; ++i) { x = F::propagate(x, input, 0.01, unused); }
        xx += std::pow(x(F::kX, 0) - filter.state()(F::kX, 0), 2);
        yy += std::pow(x(F::kY, 0) - filter.state()(F::kY, 0), 2);
        yawyaw += std::pow(x(F::kYaw, 0) - filter.state()(F::kYaw, 0), 2);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.08, 1.0, xx / kSamples / filter.covariance()(F::kX, F::kX));
    TEST_ASSERT_DOUBLE_WITHIN(0.08, 1.0, yy / kSamples / filter.covariance()(F::kY, F::kY));
    TEST_ASSERT_DOUBLE_WITHIN(0.08, 1.0, yawyaw / kSamples / filter.covariance()(F::kYaw, F::kYaw));
}

void a_tilt_error_fades_in_mean_and_keeps_its_spread() {
    // Velocity from an error that fades in T with spread s, told by nothing: 2 s^2 T^2 (t/T - 1 + exp(-t/T)).
    Parameters parameters;
    parameters.accel_noise_m_s2 = 1e-4F;
    parameters.accel_bias_walk_m_s2 = 0.0F;
    parameters.accel_bias_start_m_s2 = 0.0F;
    parameters.gyro_noise_rad_s = 1e-5F;
    parameters.gyro_bias_start_rad_s = 0.0F;
    parameters.accel_tilt_m_s2 = 0.05F;
    parameters.accel_tilt_s = 2.0F;
    F filter(parameters);
    for (int i = 0; i < 2000; ++i) { filter.predict(at_rest(), 0.01); }
    const double told = 2.0 * 0.05 * 0.05 * 4.0 * (10.0 - 1.0 + std::exp(-10.0));
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 1.0, (filter.covariance()(F::kVx, F::kVx) - 0.05 * 0.05) / told);
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 0.05 * 0.05, filter.covariance()(F::kTiltX, F::kTiltX));
    // What a fix says of acceleration is the tilt's to the most part, and half of it is gone after T ln 2.
    LaserInformation laser;
    laser.lambda(0, 0) = 1e6;
    laser.b(0, 0) = 1e6 * 0.5;
    filter.correct(laser);
    const double tilt = filter.state()(F::kTiltX, 0);
    TEST_ASSERT_TRUE(std::abs(tilt) > 1e-4);
    for (int i = 0; i < 139; ++i) { filter.predict(at_rest(), 0.01); }
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.5, filter.state()(F::kTiltX, 0) / tilt);
}

void increment_is_seen_from_the_body_and_forgets_the_pose_before() {
    const Parameters parameters;
    F filter(parameters);
    filter.place(3.0, -2.0, 1.2);
    for (int i = 0; i < 100; ++i) { filter.predict(at_rest(), 0.01); }
    const double doubt_before = filter.covariance()(F::kX, F::kX);
    filter.mark();
    F::Input input = at_rest();
    input.accel_m_s2[0] = 1.0;
    input.gyro_rad_s[2] = 0.2;
    for (int i = 0; i < 12; ++i) { filter.predict(input, 0.004); }
    const MotionIncrement motion = filter.increment();
    TEST_ASSERT_FLOAT_WITHIN(2e-5F, 0.5F * 0.048F * 0.048F, motion.dx_m);  // ahead, whatever the yaw
    TEST_ASSERT_FLOAT_WITHIN(2e-5F, 0.0F, motion.dy_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.0096F, motion.dyaw_rad);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.048F, motion.dt_s);
    TEST_ASSERT_TRUE(static_cast<double>(motion.covariance(0, 0)) < 0.1 * doubt_before);
    TEST_ASSERT_TRUE(static_cast<double>(motion.pose_covariance(0, 0)) >= doubt_before);
}

void a_direction_the_laser_does_not_see_keeps_its_doubt() {
    const Parameters parameters;
    F filter(parameters);
    for (int i = 0; i < 200; ++i) { filter.predict(at_rest(), 0.01); }
    const double along = filter.covariance()(F::kX, F::kX);
    const double vx = filter.state()(F::kVx, 0);
    LaserInformation corridor;  // walls along x: only y and yaw are seen
    corridor.lambda(1, 1) = 1e6;
    corridor.lambda(2, 2) = 1e6;
    corridor.b(1, 0) = 1e6 * 0.02;
    for (int i = 0; i < 50; ++i) {
        filter.correct(corridor);
        corridor.b(1, 0) = 0.0;
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-9 * along, along, filter.covariance()(F::kX, F::kX));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, vx, filter.state()(F::kVx, 0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-4, 0.02, filter.state()(F::kY, 0));
    TEST_ASSERT_TRUE(filter.covariance()(F::kY, F::kY) < 1e-6);
}

void a_blind_direction_takes_nothing_from_what_leaks_into_it() {
    const Parameters parameters;
    F filter(parameters);
    for (int i = 0; i < 200; ++i) { filter.predict(at_rest(), 0.01); }
    const double along = filter.covariance()(F::kX, F::kX);
    const F::Vector before = filter.state();
    LaserInformation leaking;   // walls along x, and a little that seems to be known along them
    leaking.lambda(1, 1) = leaking.lambda(2, 2) = 1e6;
    leaking.lambda(0, 0) = 1e4;
    leaking.b(0, 0) = 1e4 * 0.5;
    leaking.b(1, 0) = 1e6 * 0.02;
    leaking.blind = true;
    leaking.blind_rad = 0.0;
    filter.correct(leaking);
    for (const std::size_t i : {F::kX, F::kVx, F::kBiasX, F::kTiltX}) { TEST_ASSERT_DOUBLE_WITHIN(1e-12, before(i, 0), filter.state()(i, 0)); }
    TEST_ASSERT_TRUE(filter.covariance()(F::kX, F::kX) >= (1.0 - 1e-9) * along);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.02, filter.state()(F::kY, 0));
}

void information_form_equals_the_kalman_gain() {
    const Parameters parameters;
    F filter(parameters);
    for (int i = 0; i < 100; ++i) { filter.predict(at_rest(), 0.01); }
    const F::Square p = filter.covariance();
    const F::Vector before = filter.state();
    LaserInformation laser;
    const double information = 1.0 / (0.003 * 0.003);
    laser.lambda(0, 0) = information;
    laser.b(0, 0) = information * 0.01;
    filter.correct(laser);
    const double s = p(F::kX, F::kX) + 0.003 * 0.003;
    for (std::size_t i = 0; i < F::kStates; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, before(i, 0) + p(i, F::kX) / s * 0.01, filter.state()(i, 0));
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, p(i, i) - p(i, F::kX) * p(i, F::kX) / s, filter.covariance()(i, i));
    }
}

void learns_biases_from_fixes_at_rest() {
    const Parameters parameters;
    F filter(parameters);
    F::Input input = at_rest();
    input.accel_m_s2[0] = 0.06;
    input.accel_m_s2[1] = -0.04;
    input.gyro_rad_s[2] = 0.003;
    LaserInformation laser;
    for (int k = 0; k < 600; ++k) {
        for (int i = 0; i < 12; ++i) { filter.predict(input, 0.05 / 12.0); }
        const std::array<double, 3> information{1e6, 1e6, 1e6};
        for (std::size_t i = 0; i < 3; ++i) {
            laser.lambda(i, i) = information[i];
            laser.b(i, 0) = information[i] * (0.0 - filter.state()(i, 0));
        }
        filter.correct(laser);
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.005, 0.06, filter.state()(F::kBiasX, 0));
    TEST_ASSERT_DOUBLE_WITHIN(0.005, -0.04, filter.state()(F::kBiasY, 0));
    TEST_ASSERT_DOUBLE_WITHIN(0.0003, 0.003, filter.state()(F::kBiasYaw, 0));
    TEST_ASSERT_DOUBLE_WITHIN(0.001, 0.0, filter.state()(F::kVx, 0));
}

void coasting_doubts_more_than_predicting() {
    const Parameters parameters;
    F with(parameters);
    F without(parameters);
    for (int i = 0; i < 25; ++i) { with.predict(at_rest(), 0.02); }
    for (int i = 0; i < 25; ++i) { without.coast(0.02); }
    for (const std::size_t i : {F::kX, F::kY, F::kYaw, F::kVx}) { TEST_ASSERT_TRUE(without.covariance()(i, i) > with.covariance()(i, i)); }
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(follows_a_known_acceleration_through_a_tilt);
    RUN_TEST(covariance_matches_sampled_spread);
    RUN_TEST(a_tilt_error_fades_in_mean_and_keeps_its_spread);
    RUN_TEST(increment_is_seen_from_the_body_and_forgets_the_pose_before);
    RUN_TEST(a_direction_the_laser_does_not_see_keeps_its_doubt);
    RUN_TEST(a_blind_direction_takes_nothing_from_what_leaks_into_it);
    RUN_TEST(information_form_equals_the_kalman_gain);
    RUN_TEST(learns_biases_from_fixes_at_rest);
    RUN_TEST(coasting_doubts_more_than_predicting);
    return UNITY_END();
}
