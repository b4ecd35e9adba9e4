/// core/integer: the same whole numbers as the C library.
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>

#include <unity.h>

#include "core/integer.hpp"
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

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(whole_and_half_numbers_and_their_neighbours);
    RUN_TEST(numbers_of_every_size);
    RUN_TEST(what_fits_no_integer_stays_at_the_end);
    return UNITY_END();
}
