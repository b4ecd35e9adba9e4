// Samples that must not reach the filters: each reason once, and streams that recover.
#include <cmath>
#include <limits>

#include "sense/plausibility.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

int as_int(const SampleVerdict verdict) { return static_cast<int>(verdict); }

ImuSample imu_at(const std::int64_t t_us, const float wobble = 0.0F) {
    return {t_us, {0.1F + wobble, 0.0F, 9.81F}, {0.0F, 0.0F, 0.01F}};
}

Scan scan_at(const std::int64_t t_us) {
    Scan scan;
    scan.t_us = t_us;
    scan.count = 1080;
    scan.time_increment_us = 34.7F;
    scan.bearing_first_rad = -2.356F;
    scan.bearing_increment_rad = 0.004367F;
    scan.range_min_m = 0.06F;
    scan.range_max_m = 10.0F;
    scan.range_m.fill(2.0F);
    return scan;
}

void refuses_time_that_does_not_rise() {
    SampleChecker checker;
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::accepted), as_int(checker.check(imu_at(1000))));
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::rejected_time), as_int(checker.check(imu_at(1000, 0.1F))));
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::rejected_time), as_int(checker.check(imu_at(900, 0.1F))));
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::accepted), as_int(checker.check(imu_at(1001, 0.1F))));
    TEST_ASSERT_EQUAL_UINT32(2U, checker.counters().imu_time);
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::accepted), as_int(checker.check(AttitudeSample{5, 0.0F, 0.0F})));
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::rejected_time), as_int(checker.check(AttitudeSample{5, 0.0F, 0.0F})));
}

void refuses_values_no_sensor_gives() {
    SampleChecker checker;
    ImuSample bad = imu_at(1000);
    bad.accel_m_s2[1] = std::numeric_limits<float>::quiet_NaN();
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::rejected_value), as_int(checker.check(bad)));
    bad = imu_at(1001);
    bad.gyro_rad_s[2] = -std::numeric_limits<float>::infinity();
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::rejected_value), as_int(checker.check(bad)));
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::rejected_value), as_int(checker.check(AttitudeSample{1, std::nanf(""), 0.0F})));
    TEST_ASSERT_EQUAL_UINT32(3U, checker.counters().refused());
}

void refuses_an_inertial_sensor_that_repeats_itself_and_takes_it_back() {
    SampleChecker checker;
    std::uint32_t refused = 0;
    for (int i = 0; i < 100; ++i) {
        if (checker.check(imu_at(1000 + 4000 * i)) == SampleVerdict::rejected_frozen) { ++refused; }
    }
    TEST_ASSERT_EQUAL_UINT32(100U - SampleChecker::kFrozenAfter, refused);
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::accepted), as_int(checker.check(imu_at(500000, 0.01F))));
}

void refuses_a_sweep_whose_layout_makes_no_sense() {
    const auto refused = [](auto&& change) {
        SampleChecker checker;
        Scan scan = scan_at(1000);
        change(scan);
        return checker.check(scan) == SampleVerdict::rejected_layout && checker.counters().scan_layout == 1U;
    };
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.count = 0; }));
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.count = -5; }));
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.count = static_cast<std::int32_t>(kMaxBeams) + 1; }));
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.bearing_increment_rad = std::nanf(""); }));
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.bearing_increment_rad = 0.0F; }));
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.time_increment_us = -1.0F; }));
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.range_max_m = 0.0F; }));
    TEST_ASSERT_TRUE(refused([](Scan& s) { s.range_max_m = std::numeric_limits<float>::infinity(); }));
}

void believes_a_clock_that_went_back_for_good() {
    SampleChecker checker;
    TEST_ASSERT_EQUAL(as_int(SampleVerdict::accepted), as_int(checker.check(scan_at(900000000))));
    std::uint32_t until_accepted = 0;
    while (checker.check(scan_at(50000 * (1 + static_cast<std::int64_t>(until_accepted)))) != SampleVerdict::accepted) { ++until_accepted; }
    TEST_ASSERT_EQUAL_UINT32(SampleChecker::kClockPatience - 1, until_accepted);
    TEST_ASSERT_TRUE(checker.take_restart());
    TEST_ASSERT_FALSE(checker.take_restart());
    TEST_ASSERT_EQUAL_UINT32(1U, checker.counters().clock_restarts);
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(refuses_time_that_does_not_rise);
    RUN_TEST(refuses_values_no_sensor_gives);
    RUN_TEST(refuses_an_inertial_sensor_that_repeats_itself_and_takes_it_back);
    RUN_TEST(refuses_a_sweep_whose_layout_makes_no_sense);
    RUN_TEST(believes_a_clock_that_went_back_for_good);
    return UNITY_END();
}
