// Laws of the line model (algorithms C and D): Jacobians against central differences, round trips, both forms of a landmark agree.
#include <cmath>
#include <random>

#include "estimate/inertial_filter.hpp"
#include "estimate/wall_landmark.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

struct Draw {
    std::mt19937 rng{17};
    float operator()(const float low, const float high) { return std::uniform_real_distribution<float>(low, high)(rng); }
};

/// A wall and a pose before its observed face. near_origin: the wall passes within a millimetre of the Map origin.
void draw_scene(Draw& draw, const bool near_origin, HessianLine& line, Pose2<Map, Body>& pose, LineMeasurement& z) {
    pose = {draw(-20.0F, 20.0F), draw(-20.0F, 20.0F), draw(-3.14F, 3.14F)};
    if (near_origin) {
        // Look along a direction whose line goes through the origin: rho = -n . p must be positive.
        float beta_rad = draw(-3.14F, 3.14F);
        float rho_m = -(pose.x_m * std::cos(beta_rad) + pose.y_m * std::sin(beta_rad));
        if (rho_m < 0.0F) {
            beta_rad += kPi;
            rho_m = -rho_m;
        }
        z = {rho_m + draw(-1e-3F, 1e-3F), wrap_angle(beta_rad - pose.yaw_rad)};
    } else {
        z = {draw(0.2F, 10.0F), draw(-3.14F, 3.14F)};
    }
    line = line_from_measurement(z, pose);
}

void a_measurement_makes_the_landmark_that_predicts_it() {
    Draw draw;
    int behind = 0;
    for (int i = 0; i < 4000; ++i) {
        HessianLine line;
        Pose2<Map, Body> pose;
        LineMeasurement z;
        draw_scene(draw, i % 4 == 0, line, pose, z);
        behind += line.v < 0 ? 1 : 0;
        TEST_ASSERT_TRUE(line.r_m >= 0.0F);
        const LineMeasurement again = predict_measurement(line, pose);
        TEST_ASSERT_FLOAT_WITHIN(3e-5F, z.rho_m, again.rho_m);
        TEST_ASSERT_FLOAT_WITHIN(3e-6F, 0.0F, wrap_angle(again.alpha_rad - z.alpha_rad));
    }
    TEST_ASSERT_TRUE(behind > 500 && behind < 3500);
}

void both_forms_of_a_landmark_predict_the_same() {
    Draw draw;
    for (int i = 0; i < 4000; ++i) {
        HessianLine line;
        Pose2<Map, Body> pose;
        LineMeasurement z;
        draw_scene(draw, i % 4 == 0, line, pose, z);
        WallObservation wall;
        wall.rho_m = z.rho_m;
        wall.alpha_rad = z.alpha_rad;
        wall.lever_m = draw(-5.0F, 5.0F);
        wall.from_m = wall.lever_m - 1.0F;
        wall.to_m = wall.lever_m + 1.0F;
        wall.covariance = LineCovariance{1e-6F, 0.0F, 1e-6F}.sheared(wall.lever_m);
        const Landmark landmark = make_landmark(wall, pose);
        const HessianLine published = landmark.hessian();
        TEST_ASSERT_FLOAT_WITHIN(2e-4F, static_cast<float>(line.v) * line.r_m, static_cast<float>(published.v) * published.r_m);
        const Pose2<Map, Body> other{pose.x_m + draw(-1.0F, 1.0F), pose.y_m + draw(-1.0F, 1.0F), wrap_angle(pose.yaw_rad + draw(-1.0F, 1.0F))};
        const LineMeasurement a = landmark.predict(other);
        const LineMeasurement b = predict_measurement(published, other);
        TEST_ASSERT_FLOAT_WITHIN(2e-4F, a.rho_m, b.rho_m);
        TEST_ASSERT_FLOAT_WITHIN(1e-5F, 0.0F, wrap_angle(a.alpha_rad - b.alpha_rad));
        // The middle of what was seen is the anchor, and there offset and direction are independent.
        TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.0F, landmark.before(landmark.anchor_x_m, landmark.anchor_y_m));
        TEST_ASSERT_FLOAT_WITHIN(1e-9F, 0.0F, landmark.covariance.rho_alpha);
    }
}

void jacobians_are_the_central_differences() {
    Draw draw;
    constexpr float kStep = 2e-3F;
    for (int i = 0; i < 2000; ++i) {
        HessianLine line;
        Pose2<Map, Body> pose;
        LineMeasurement z;
        draw_scene(draw, false, line, pose, z);
        if (i % 5 == 0) { pose.yaw_rad = 3.1415F; }
        if (line.r_m < 0.01F) { continue; }
        const auto difference = [](const LineMeasurement& high, const LineMeasurement& low, const std::size_t row) {
            return (row == 0 ? high.rho_m - low.rho_m : wrap_angle(high.alpha_rad - low.alpha_rad)) / (2.0F * kStep);
        };
        const Matrix<float, 2, 3> J_z_pose = J_measurement_pose(line);
        for (std::size_t column = 0; column < 3; ++column) {
            Pose2<Map, Body> high = pose, low = pose;
            (column == 0 ? high.x_m : column == 1 ? high.y_m : high.yaw_rad) += kStep;
            (column == 0 ? low.x_m : column == 1 ? low.y_m : low.yaw_rad) -= kStep;
            for (std::size_t row = 0; row < 2; ++row) {
                TEST_ASSERT_FLOAT_WITHIN(0.01F, difference(predict_measurement(line, high), predict_measurement(line, low), row), J_z_pose(row, column));
            }
        }
        const Matrix<float, 2, 2> J_z_line = J_measurement_line(line, pose);
        for (std::size_t column = 0; column < 2; ++column) {
            HessianLine high = line, low = line;
            (column == 0 ? high.r_m : high.alpha_rad) += kStep;
            (column == 0 ? low.r_m : low.alpha_rad) -= kStep;
            for (std::size_t row = 0; row < 2; ++row) {
                TEST_ASSERT_FLOAT_WITHIN(0.01F, difference(predict_measurement(high, pose), predict_measurement(low, pose), row), J_z_line(row, column));
            }
        }
    }
}

void inertial_jacobian_is_the_central_difference() {
    std::mt19937 rng(5);
    std::uniform_real_distribution<double> u(-1.0, 1.0);
    using F = InertialFilter;
    for (int i = 0; i < 300; ++i) {
        F::Vector x;
        for (double& value : x.values) { value = u(rng); }
        F::Input input;
        input.accel_m_s2 = {2.0 * u(rng), 2.0 * u(rng), 9.81 + u(rng)};
        input.gyro_rad_s = {u(rng), u(rng), u(rng)};
        input.roll_rad = 0.4 * u(rng);
        input.pitch_rad = 0.4 * u(rng);
        const double dt_s = 0.02;
        F::Square J;
        F::Square unused;
        static_cast<void>(F::propagate(x, input, dt_s, J));
        for (std::size_t column = 0; column < F::kStates; ++column) {
            F::Vector high = x, low = x;
            high(column, 0) += 1e-5;
            low(column, 0) -= 1e-5;
            const F::Vector a = F::propagate(high, input, dt_s, unused);
            const F::Vector b = F::propagate(low, input, dt_s, unused);
            for (std::size_t row = 0; row < F::kStates; ++row) {
                TEST_ASSERT_DOUBLE_WITHIN(1e-7, (a(row, 0) - b(row, 0)) / 2e-5, J(row, column));
            }
        }
    }
}

void shear_is_what_moving_the_foot_does() {
    // Covariance of (rho + lever alpha, alpha) against sampled spread.
    std::mt19937 rng(9);
    std::normal_distribution<double> normal;
    const LineCovariance c{4e-4F, 1e-4F, 9e-4F};
    const LineCovariance sheared = c.sheared(2.5F);
    const double l00 = 0.02, l10 = 1e-4 / 0.02, l11 = std::sqrt(9e-4 - l10 * l10);
    double rr = 0.0, ra = 0.0;
    constexpr int kSamples = 40000;
    for (int i = 0; i < kSamples; ++i) {
        const double a = normal(rng), b = normal(rng);
        const double rho = l00 * a, alpha = l10 * a + l11 * b;
        rr += (rho + 2.5 * alpha) * (rho + 2.5 * alpha);
        ra += (rho + 2.5 * alpha) * alpha;
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.03, 1.0, rr / kSamples / static_cast<double>(sheared.rho_rho));
    TEST_ASSERT_DOUBLE_WITHIN(0.03, 1.0, ra / kSamples / static_cast<double>(sheared.rho_alpha));
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(a_measurement_makes_the_landmark_that_predicts_it);
    RUN_TEST(both_forms_of_a_landmark_predict_the_same);
    RUN_TEST(jacobians_are_the_central_differences);
    RUN_TEST(inertial_jacobian_is_the_central_difference);
    RUN_TEST(shear_is_what_moving_the_foot_does);
    return UNITY_END();
}
