// RangeNoise: what it says of sweeps with a known noise.
#include "sense/range_noise.hpp"

#include <cmath>
#include <limits>

#include "core/random.hpp"
#include "unity.h"

namespace {

using namespace noctule;

Parameters parameters;

/// A room of 8 x 6 m seen from its middle, with noise; a few beams are torn out by edges and dropouts.
void fill(Scan& scan, Random& random, const std::int32_t count, const float sigma_m) {
    scan.count = count;
    scan.range_min_m = 0.06F;
    scan.range_max_m = 30.0F;
    for (std::int32_t i = 0; i < count; ++i) {
        const float angle = -2.35F + 4.7F * static_cast<float>(i) / static_cast<float>(count);
        const float x = 4.0F / std::max(1e-3F, std::abs(std::cos(angle)));
        const float y = 3.0F / std::max(1e-3F, std::abs(std::sin(angle)));
        float range_m = std::min(x, y) + sigma_m * random.normal();
        if (i % 50 > 44) { range_m -= 1.5F; }
        if (i % 97 == 0) { range_m = std::numeric_limits<float>::infinity(); }
        scan.range_m[static_cast<std::size_t>(i)] = range_m;
    }
}

float estimate(const std::int32_t count, const float sigma_m) {
    RangeNoise noise(parameters);
    Random random(7);
    static Scan scan;
    for (int k = 0; k < 30; ++k) {
        fill(scan, random, count, sigma_m);
        noise.add(scan);
    }
    return noise.sigma_m();
}

void test_noise_is_found_with_fine_and_with_coarse_beams() {
    for (const std::int32_t count : {1080, 270}) {
        TEST_ASSERT_FLOAT_WITHIN(0.0012F, 0.01F, estimate(count, 0.01F));
        TEST_ASSERT_FLOAT_WITHIN(0.003F, 0.03F, estimate(count, 0.03F));
    }
}

void test_it_stays_between_the_told_noise_and_its_bound() {
    TEST_ASSERT_EQUAL_FLOAT(0.01F, estimate(1080, 0.002F));
    TEST_ASSERT_EQUAL_FLOAT(RangeNoise::kMost_m, estimate(1080, 0.4F));
}

void test_switched_off_it_says_what_was_told() {
    parameters.laser_noise_learn = 0;
    TEST_ASSERT_EQUAL_FLOAT(0.01F, estimate(1080, 0.03F));
}

void test_a_sweep_of_nothing_changes_nothing() {
    RangeNoise noise(parameters);
    static Scan scan;
    scan.count = 1080;
    scan.range_m.fill(std::numeric_limits<float>::quiet_NaN());
    noise.add(scan);
    TEST_ASSERT_EQUAL_FLOAT(0.01F, noise.sigma_m());
}

}  // namespace

extern "C" void setUp() { parameters = Parameters{}; }
extern "C" void tearDown() {}

int main() {
    UNITY_BEGIN();
    RUN_TEST(test_noise_is_found_with_fine_and_with_coarse_beams);
    RUN_TEST(test_it_stays_between_the_told_noise_and_its_bound);
    RUN_TEST(test_switched_off_it_says_what_was_told);
    RUN_TEST(test_a_sweep_of_nothing_changes_nothing);
    return UNITY_END();
}
