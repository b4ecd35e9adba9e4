// The output predictor: the estimate itself at the scan, an honest prediction after it, and -1 when scans stop.
#include <cmath>

#include "estimate/output_predictor.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

const Parameters kDefaults{};

Estimate moving(const std::int64_t t_us) {
    Estimate e;
    e.t_us = t_us;
    e.planar.pose_map_body = {1.0F, 2.0F, 0.5F * kPi};
    e.planar.vx_m_s = 0.0F;
    e.planar.vy_m_s = 1.0F;
    e.planar.covariance = {1e-6F, 0.0F, 0.0F, 1e-6F, 0.0F, 1e-7F};
    e.planar.velocity_covariance = {1e-4F, 0.0F, 1e-4F};
    e.planar.quality = 90;
    e.planar.reset_counter = 3;
    e.altitude.z_m = 1.2F;
    e.altitude.vz_m_s = 0.1F;
    e.altitude.z_var_m2 = 1e-4F;
    e.altitude.valid = true;
    return e;
}

void is_the_estimate_itself_at_the_scan() {
    OutputPredictor predictor(kDefaults);
    Odometry o;
    TEST_ASSERT_FALSE(predictor.odometry(1000, o));
    predictor.correct(moving(1000000));
    TEST_ASSERT_FALSE(predictor.odometry(999999, o));
    TEST_ASSERT_TRUE(predictor.odometry(1000000, o));
    TEST_ASSERT_TRUE(o.at_scan);
    TEST_ASSERT_EQUAL_FLOAT(1.0F, o.x_m);
    TEST_ASSERT_EQUAL_FLOAT(1.2F, o.z_m);
    TEST_ASSERT_EQUAL_INT32(90, o.quality);
    TEST_ASSERT_EQUAL_INT32(3, o.reset_counter);
    TEST_ASSERT_EQUAL_FLOAT(1e-6F, o.position_var_m2[0]);
}

void carries_the_estimate_with_the_inertial_data() {
    OutputPredictor predictor(kDefaults);
    // Samples that came before the estimate, as when the step took long, count from its time on only.
    for (int k = -5; k <= 10; ++k) {
        ImuSample s;
        s.t_us = 1000000 + 4000 * k;
        s.accel_m_s2 = {2.0F, 0.0F, 9.80665F};  // forward is Map +y
        s.gyro_rad_s = {0.0F, 0.0F, 0.0F};
        predictor.add(s);
        if (k == 2) { predictor.correct(moving(1000000)); }
    }
    Odometry o;
    TEST_ASSERT_TRUE(predictor.odometry(1040000, o));
    TEST_ASSERT_FALSE(o.at_scan);
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.0F, o.x_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 2.0F + 0.04F + 0.5F * 2.0F * 0.0016F, o.y_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.08F, o.vy_m_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.204F, o.z_m);
    TEST_ASSERT_TRUE(o.position_var_m2[1] > 1e-6F);
    // Between two samples the later one holds.
    TEST_ASSERT_TRUE(predictor.odometry(1010000, o));
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 2.0F + 0.01F + 0.5F * 2.0F * 0.0001F, o.y_m);
}

void turns_with_the_gyro_and_tilts_with_the_attitude() {
    OutputPredictor predictor(kDefaults);
    predictor.correct(moving(1000000));
    for (int k = 1; k <= 10; ++k) { predictor.add(ImuSample{1000000 + 4000 * k, {0.0F, 0.0F, 9.80665F}, {0.0F, 0.0F, 1.0F}}); }
    predictor.add(AttitudeSample{1030000, 0.0F, 0.0F});
    Odometry o;
    TEST_ASSERT_TRUE(predictor.odometry(1040000, o));
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 0.5F * kPi + 0.04F, o.yaw_rad);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 1.0F, o.yaw_rate_rad_s);
    predictor.add(AttitudeSample{1040000, 0.1F, -0.05F});
    TEST_ASSERT_TRUE(predictor.odometry(1040000, o));
    TEST_ASSERT_EQUAL_FLOAT(0.1F, o.roll_rad);
}

void claims_nothing_without_a_height() {
    OutputPredictor predictor(kDefaults);
    Estimate e = moving(1000000);
    e.altitude.valid = false;
    predictor.correct(e);
    Odometry o;
    TEST_ASSERT_TRUE(predictor.odometry(1000000, o));
    TEST_ASSERT_EQUAL_INT32(-1, o.quality);
}

void claims_nothing_when_scans_stop() {
    OutputPredictor predictor(kDefaults);
    predictor.correct(moving(1000000));
    const auto stale_us = static_cast<std::int64_t>(1e6F * kDefaults.stale_scan_s);
    Odometry o;
    TEST_ASSERT_TRUE(predictor.odometry(1000000 + stale_us - 1000, o));
    TEST_ASSERT_EQUAL_INT32(90, o.quality);
    TEST_ASSERT_TRUE(predictor.odometry(1000000 + stale_us + 1000, o));
    TEST_ASSERT_EQUAL_INT32(-1, o.quality);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 2.3F, o.y_m);  // no inertial data: straight on
}

void refuses_bad_samples_and_old_estimates() {
    OutputPredictor predictor(kDefaults);
    predictor.correct(moving(1000000));
    predictor.add(ImuSample{1004000, {std::nanf(""), 0.0F, 9.8F}, {}});
    predictor.add(ImuSample{1008000, {0.0F, 0.0F, 9.8F}, {}});
    predictor.add(ImuSample{1008000, {50.0F, 0.0F, 9.8F}, {}});
    predictor.add(AttitudeSample{1008000, std::nanf(""), 0.0F});
    TEST_ASSERT_EQUAL_UINT32(3U, predictor.refused());
    predictor.correct(moving(900000));
    Odometry o;
    TEST_ASSERT_FALSE(predictor.odometry(950000, o));
    for (int k = 0; k < 1000; ++k) { predictor.add(ImuSample{1010000 + 4000 * k, {0.0F, 0.0F, 9.8F}, {}}); }  // the ring wraps
    TEST_ASSERT_TRUE(predictor.odometry(5000000, o));
    TEST_ASSERT_TRUE(std::isfinite(o.x_m));
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(is_the_estimate_itself_at_the_scan);
    RUN_TEST(carries_the_estimate_with_the_inertial_data);
    RUN_TEST(turns_with_the_gyro_and_tilts_with_the_attitude);
    RUN_TEST(claims_nothing_without_a_height);
    RUN_TEST(claims_nothing_when_scans_stop);
    RUN_TEST(refuses_bad_samples_and_old_estimates);
    return UNITY_END();
}
