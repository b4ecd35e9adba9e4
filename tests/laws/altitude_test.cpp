// Statements about the altitude filter that hold over many seeds, and its Gaussian against independent routes.
#include <cmath>
#include <memory>
#include <new>
#include <random>

#include "estimate/altitude_filter.hpp"
#include "unit/estimate/altitude_profile.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using altitude_test::Flight;
using altitude_test::Result;
using altitude_test::Sensors;
using noctule::AltitudeFilter;
using noctule::AltitudeJoint;
using noctule::Level;
using noctule::Parameters;

namespace {

const Parameters kDefaults{};

struct Batch {
    double mean_m = 0.0;
    double worst_m = 0.0;
    double max_m = 0.0;
    double end_m = 0.0;
    double nees_end = 0.0;
    int invalid_steps = 0;
    int floors_max = 0;
    double table_error_m = 0.0;   // greatest error of each level over all seeds, 9 if one was not found
    double upper_error_m = 0.0;
    double ceiling_error_m = 0.0;
};

double error_of(const AltitudeFilter& filter, const double z_m, const int facing) {
    double best = 9.0;
    for (const Level& level : filter.levels()) {
        if (level.facing == facing) { best = std::fmin(best, std::fabs(static_cast<double>(level.z_m) - z_m)); }
    }
    return best;
}

Batch fly(Flight flight, Sensors sensors, const int seeds, const Parameters& parameters = kDefaults, const double scale = 0.0) {
    Batch batch;
    std::mt19937 rng{4711};
    std::uniform_real_distribution<double> draw{-scale, scale};
    for (int i = 0; i < seeds; ++i) {
        const auto filter = std::make_unique<AltitudeFilter>(parameters);
        if (scale > 0.0) {
            sensors.scale_down = draw(rng);
            sensors.scale_up = draw(rng);
        }
        const Result r = flight.run(*filter, sensors, 100U + static_cast<std::uint32_t>(i));
        batch.mean_m += r.mean_m / seeds;
        batch.worst_m = std::fmax(batch.worst_m, r.mean_m);
        batch.max_m = std::fmax(batch.max_m, r.max_m);
        batch.end_m += std::fabs(r.end_m) / seeds;
        batch.nees_end += r.nees_end / seeds;
        batch.invalid_steps += r.invalid_steps;
        int floors = 0;
        for (const Level& level : filter->levels()) { floors += level.floor ? 1 : 0; }
        batch.floors_max = std::max(batch.floors_max, floors);
        batch.table_error_m = std::fmax(batch.table_error_m, error_of(*filter, 0.55, 1));
        batch.upper_error_m = std::fmax(batch.upper_error_m, error_of(*filter, 2.41, 1));
        batch.ceiling_error_m = std::fmax(batch.ceiling_error_m, error_of(*filter, 4.66, -1));
    }
    return batch;
}

void papers_flight_within_the_target() {
    const Batch b = fly(altitude_test::paper_flight(), Sensors{}, 20);
    TEST_ASSERT_TRUE(b.mean_m < 0.006);
    TEST_ASSERT_TRUE(b.worst_m < 0.01);
    TEST_ASSERT_TRUE(b.max_m < 0.03);
    TEST_ASSERT_TRUE(b.table_error_m < 0.02);    // sixteen readings of the table a flight
    TEST_ASSERT_TRUE(b.upper_error_m < 0.015);
    TEST_ASSERT_TRUE(b.ceiling_error_m < 0.015);
    TEST_ASSERT_EQUAL_INT(2, b.floors_max);
    TEST_ASSERT_EQUAL_INT(0, b.invalid_steps);
}

void paper_preset_reproduces_the_published_error() {
    Parameters paper{};
    paper.alt_joint = 0;
    paper.alt_accel_noise_m_s2 = 0.03F;
    paper.range_sigma_m = 0.05F;
    const Batch b = fly(altitude_test::paper_flight(), Sensors{}, 20, paper);
    TEST_ASSERT_TRUE(b.mean_m < 0.03);
    TEST_ASSERT_TRUE_MESSAGE(b.mean_m > 0.01, "as good as the joint filter: this is not the paper's form");
}

void hundred_metres_of_floor_neither_drift_nor_lie() {
    // Chi-square with 40 degrees of freedom, divided by 40: 95 % lie in [0.61, 1.48].
    const Batch b = fly(altitude_test::flat_flight(100.0), Sensors{}, 40);
    TEST_ASSERT_TRUE(b.end_m < 0.01);
    TEST_ASSERT_TRUE(b.nees_end > 0.61);
    TEST_ASSERT_TRUE(b.nees_end < 1.48);
}

void twenty_table_crossings_do_not_drift() {
    const Batch b = fly(altitude_test::table_flight(20), Sensors{}, 10);
    TEST_ASSERT_TRUE(b.end_m < 0.005);
    TEST_ASSERT_TRUE(b.mean_m < 0.006);
    TEST_ASSERT_EQUAL_INT(1, b.floors_max);
}

void harder_flights_stay_within_bounds_and_find_no_false_floor() {
    const Batch stairs = fly(altitude_test::stair_flight(), Sensors{}, 10);
    TEST_ASSERT_TRUE(stairs.mean_m < 0.01);
    TEST_ASSERT_EQUAL_INT(2, stairs.floors_max);

    Sensors echoes;
    echoes.outlier = 0.05;
    const Batch b_echoes = fly(altitude_test::paper_flight(), echoes, 10);
    TEST_ASSERT_TRUE(b_echoes.mean_m < 0.01);
    TEST_ASSERT_EQUAL_INT(2, b_echoes.floors_max);

    Sensors silent;
    silent.silent_s = {{8.0, 10.0}, {20.0, 22.0}};
    const Batch b_silent = fly(altitude_test::paper_flight(), silent, 10);
    TEST_ASSERT_TRUE(b_silent.mean_m < 0.01);
    TEST_ASSERT_EQUAL_INT(0, b_silent.invalid_steps);
    TEST_ASSERT_EQUAL_INT(2, b_silent.floors_max);

    Sensors tilted;
    tilted.tilt_rad = 0.26;
    const Batch b_tilted = fly(altitude_test::paper_flight(), tilted, 10);
    TEST_ASSERT_TRUE(b_tilted.mean_m < 0.01);
    TEST_ASSERT_EQUAL_INT(2, b_tilted.floors_max);
}

void scale_errors_are_covered_when_the_parameter_admits_them() {
    Parameters wide{};
    wide.range_scale = 0.006F;
    Sensors harsh;
    harsh.accel_bias_m_s2 = 0.10;
    harsh.imu_hz = 50;
    const Batch b = fly(altitude_test::paper_flight(), harsh, 20, wide, 0.01);
    TEST_ASSERT_TRUE(b.mean_m < 0.025);
    TEST_ASSERT_TRUE(b.nees_end < 1.71);  // upper 97.5 % of chi-square with 20 degrees of freedom, divided by 20
}

// The Gaussian against brute force: sampled states through the model, and one batch least squares.

void predicted_covariance_matches_sampled_spread() {
    static AltitudeJoint joint;
    std::array<double, AltitudeJoint::kFirstLevel> mean{1.0, 0.2, 0.0, 0.0, 0.05, 0.0, 0.0};
    const std::array<double, AltitudeJoint::kFirstLevel> variance{0.01, 0.04, 0.02, 0.02, 0.01, 0.0, 0.0};
    joint.start(mean, variance);
    const AltitudeJoint::Up up{-0.2, 0.1, 0.97};
    for (int i = 0; i < 10; ++i) {
        joint.predict_mean(0.3, up, 0.05);
        joint.predict_covariance(0.05, up, 0.2, 0.0, 0.0);
    }
    std::mt19937 rng{7};
    std::normal_distribution<double> unit{0.0, 1.0};
    double sum = 0.0, zz = 0.0, zv = 0.0, zb = 0.0;
    constexpr int kSamples = 40000;
    for (int i = 0; i < kSamples; ++i) {
        double z = 1.0 + 0.1 * unit(rng);
        double v = 0.2 + 0.2 * unit(rng);
        const double bias = -0.2 * std::sqrt(0.02) * unit(rng) + 0.1 * std::sqrt(0.02) * unit(rng);
        const double bz = 0.05 + 0.1 * unit(rng);
        constexpr int kFine = 50;
        constexpr double dt = 0.5 / kFine;
        for (int k = 0; k < kFine; ++k) {
            const double a = 0.3 - bias - 0.97 * bz + 0.2 / std::sqrt(dt) * unit(rng);
            z += v * dt + 0.5 * a * dt * dt;
            v += a * dt;
        }
        sum += z;
        const double e = z - joint.mean(AltitudeJoint::kZ);
        zz += e * e;
        zv += e * (v - joint.mean(AltitudeJoint::kVz));
        zb += e * (bz - 0.05);
    }
    using J = AltitudeJoint;
    TEST_ASSERT_DOUBLE_WITHIN(0.004, joint.mean(J::kZ), sum / kSamples);
    TEST_ASSERT_DOUBLE_WITHIN(0.02 * joint.covariance(J::kZ, J::kZ), joint.covariance(J::kZ, J::kZ), zz / kSamples);
    TEST_ASSERT_DOUBLE_WITHIN(0.04 * joint.covariance(J::kZ, J::kVz), joint.covariance(J::kZ, J::kVz), zv / kSamples);
    TEST_ASSERT_DOUBLE_WITHIN(1.0e-4, joint.covariance(J::kZ, J::kBias + 2), zb / kSamples);
}

void two_levels_and_z_match_batch_least_squares() {
    // z ~ N(1, 0.04); level A = z - 0.9 (+ noise 0.01); then readings z - A = 0.95 (0.02) and a prior on A of 0 (0.005).
    using J = AltitudeJoint;
    static AltitudeJoint joint;
    joint.start({1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, {0.04, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0});
    J::Row birth;
    birth.add(J::kZ, 1.0);
    TEST_ASSERT_TRUE(joint.add_level(birth, -0.9, 0.01));
    J::Row reading;
    reading.add(J::kZ, 1.0);
    reading.add(J::kFirstLevel, -1.0);
    joint.correct(reading, 0.95, 0.02);
    J::Row prior;
    prior.add(J::kFirstLevel, 1.0);
    joint.correct(prior, 0.0, 0.005);

    // The same four facts as normal equations in (z, A).
    const double facts[4][4] = {{1.0, 0.0, 1.0, 0.04}, {1.0, -1.0, 0.9, 0.01}, {1.0, -1.0, 0.95, 0.02}, {0.0, 1.0, 0.0, 0.005}};
    double n00 = 0.0, n01 = 0.0, n11 = 0.0, r0 = 0.0, r1 = 0.0;
    for (const auto& f : facts) {
        n00 += f[0] * f[0] / f[3];
        n01 += f[0] * f[1] / f[3];
        n11 += f[1] * f[1] / f[3];
        r0 += f[0] * f[2] / f[3];
        r1 += f[1] * f[2] / f[3];
    }
    const double det = n00 * n11 - n01 * n01;
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, (n11 * r0 - n01 * r1) / det, joint.mean(J::kZ));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, (n00 * r1 - n01 * r0) / det, joint.mean(J::kFirstLevel));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, n11 / det, joint.covariance(J::kZ, J::kZ));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -n01 / det, joint.covariance(J::kFirstLevel, J::kZ));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, n00 / det, joint.covariance(J::kFirstLevel, J::kFirstLevel));
}

void offset_that_learns_alone_keeps_a_true_covariance() {
    using J = AltitudeJoint;
    static AltitudeJoint joint;
    joint.start({1.0}, {0.04, 1.0});
    J::Row offset;
    offset.add(J::kZ, -1.0);
    joint.restart_state(J::kBaro, offset, 58.0, 0.25);
    J::Row reading;
    reading.add(J::kZ, 1.0);
    reading.add(J::kBaro, 1.0);
    joint.correct_only(J::kBaro, reading, 58.5, 0.25);
    // Two readings of one offset: their mean less z, with half of their variance and z's.
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 57.25, joint.mean(J::kBaro));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.165, joint.covariance(J::kBaro, J::kBaro));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -0.04, joint.covariance(J::kBaro, J::kZ));
    joint.loosen(0.04, 0.0);
    const double a = joint.covariance(J::kZ, J::kZ);
    const double b = joint.covariance(J::kZ, J::kBaro);
    const double c = joint.covariance(J::kBaro, J::kBaro);
    const double k = (b + c) / (a + 2.0 * b + c + 0.25);
    joint.correct_only(J::kBaro, reading, 58.0, 0.25);
    // (I - K H) P (I - K H)^T + K R K^T with K = (0, k), H = (1, 1), written out.
    TEST_ASSERT_EQUAL_DOUBLE(1.0, joint.mean(J::kZ));
    TEST_ASSERT_EQUAL_DOUBLE(a, joint.covariance(J::kZ, J::kZ));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, b * (1.0 - k) - a * k, joint.covariance(J::kZ, J::kBaro));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, k * k * a - 2.0 * k * (1.0 - k) * b + (1.0 - k) * (1.0 - k) * c + k * k * 0.25,
                              joint.covariance(J::kBaro, J::kBaro));
    TEST_ASSERT_EQUAL_DOUBLE(joint.covariance(J::kZ, J::kBaro), joint.covariance(J::kBaro, J::kZ));
}

void forgetting_a_level_leaves_the_others_as_they_were() {
    using J = AltitudeJoint;
    static AltitudeJoint joint;
    joint.start({1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, {0.04, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0});
    for (int i = 0; i < 4; ++i) {
        J::Row birth;
        birth.add(J::kZ, 1.0);
        TEST_ASSERT_TRUE(joint.add_level(birth, -0.1 * i, 0.01 * (i + 1)));
    }
    const double z3 = joint.mean(J::kFirstLevel + 3);
    const double p33 = joint.covariance(J::kFirstLevel + 3, J::kFirstLevel + 3);
    const double p32 = joint.covariance(J::kFirstLevel + 3, J::kFirstLevel + 2);
    joint.remove_level_unordered(1);  // the last, 3, takes its index
    TEST_ASSERT_EQUAL_size_t(3, joint.levels());
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, z3, joint.mean(J::kFirstLevel + 1));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, p33, joint.covariance(J::kFirstLevel + 1, J::kFirstLevel + 1));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, p32, joint.covariance(J::kFirstLevel + 1, J::kFirstLevel + 2));
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, p32, joint.covariance(J::kFirstLevel + 2, J::kFirstLevel + 1));
    for (std::size_t i = joint.levels(); i < noctule::kMaxLevels; ++i) {
        TEST_ASSERT_TRUE(joint.add_level(J::Row{}, 0.0, 1.0));
    }
    TEST_ASSERT_FALSE(joint.add_level(J::Row{}, 0.0, 1.0));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(papers_flight_within_the_target);
    RUN_TEST(paper_preset_reproduces_the_published_error);
    RUN_TEST(hundred_metres_of_floor_neither_drift_nor_lie);
    RUN_TEST(twenty_table_crossings_do_not_drift);
    RUN_TEST(harder_flights_stay_within_bounds_and_find_no_false_floor);
    RUN_TEST(scale_errors_are_covered_when_the_parameter_admits_them);
    RUN_TEST(predicted_covariance_matches_sampled_spread);
    RUN_TEST(two_levels_and_z_match_batch_least_squares);
    RUN_TEST(offset_that_learns_alone_keeps_a_true_covariance);
    RUN_TEST(forgetting_a_level_leaves_the_others_as_they_were);
    return UNITY_END();
}
