/// core/integer, core/length: the same numbers as the C library.
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>

#include <unity.h>

#include "core/integer.hpp"
#include "core/length.hpp"
#include "core/random.hpp"

using noctule::floor_int;
using noctule::round_int;

extern "C" {
void setUp() {}
void tearDown() {}
}

namespace {

// The float itself and its neighbours on both sides.
void check_round(const float x) {
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    for (const float at : {std::nextafter(x, -kInfinity), x, std::nextafter(x, kInfinity)}) {
        TEST_ASSERT_EQUAL_INT32(static_cast<std::int32_t>(std::floor(at)), floor_int(at));
        TEST_ASSERT_EQUAL_INT32(static_cast<std::int32_t>(std::lround(at)), round_int(at));
    }
}

void whole_and_half_numbers_and_their_neighbours() {
    for (std::int32_t k = -3000; k <= 3000; ++k) { check_round(0.5F * static_cast<float>(k)); }
    check_round(16777216.0F);
    check_round(-16777216.0F);
    check_round(-0.0F);
}

void numbers_of_every_size() {
    noctule::Random random{7U};
    for (int k = 0; k < 20000; ++k) { check_round((random.uniform() - 0.5F) * std::exp2(40.0F * random.uniform() - 10.0F)); }
}

void what_fits_no_integer_stays_at_the_end() {
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    TEST_ASSERT_EQUAL_INT32(1000000000, floor_int(3.0e9F));
    TEST_ASSERT_EQUAL_INT32(1000000000, floor_int(kInfinity));
    TEST_ASSERT_EQUAL_INT32(-1000000000, floor_int(-kInfinity));
    TEST_ASSERT_EQUAL_INT32(-1000000000, floor_int(std::numeric_limits<float>::quiet_NaN()));
}

void lengths_are_rounded_to_the_nearest_float_at_every_size() {
    noctule::Random random{11U};
    for (int k = 0; k < 20000; ++k) {
        const float size = std::exp2(200.0F * random.uniform() - 100.0F);
        const float x = size * (random.uniform() - 0.5F);
        const float y = size * (random.uniform() - 0.5F);
        const double exact = std::hypot(static_cast<double>(x), static_cast<double>(y));
        TEST_ASSERT_TRUE(std::fabs(static_cast<double>(noctule::length_of(x, y)) - exact) <= exact * (std::exp2(-24.0) * (1.0 + 1e-6)));
    }
    TEST_ASSERT_EQUAL_FLOAT(5.0F, noctule::length_of(-3.0F, 4.0F));
    TEST_ASSERT_EQUAL_FLOAT(0.0F, noctule::length_of(0.0F, -0.0F));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(whole_and_half_numbers_and_their_neighbours);
    RUN_TEST(numbers_of_every_size);
    RUN_TEST(lengths_are_rounded_to_the_nearest_float_at_every_size);
    RUN_TEST(what_fits_no_integer_stays_at_the_end);
    return UNITY_END();
}
