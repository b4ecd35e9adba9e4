// Whether elevations have two modes: an opening beside a ceiling has, beams, lamps, slopes and stray echoes have not.
#include "plan/floor_modes.hpp"

#include <memory>

#include "core/random.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

constexpr float kStepM = 1.5F;
constexpr std::uint32_t kLeast = 8;

/// Places whose distances lie evenly about `at_m`.
void add(ElevationHistogram& h, Random& random, const int places, const float at_m, const float spread_m) {
    for (int i = 0; i < places; ++i) { h.add(at_m + spread_m * (random.uniform() - 0.5F)); }
}

void an_opening_beside_a_ceiling_makes_two_modes() {
    Random random(1);
    ElevationHistogram h;
    add(h, random, 600, 2.30F, 0.06F);
    add(h, random, 40, 4.80F, 0.06F);
    const FloorModes modes = find_modes(h, kStepM, kLeast);
    TEST_ASSERT_TRUE(modes.two);
    TEST_ASSERT_FLOAT_WITHIN(0.03F, 2.30F, modes.near_m);
    TEST_ASSERT_FLOAT_WITHIN(0.03F, 4.80F, modes.far_m);
    TEST_ASSERT_EQUAL_UINT32(600, modes.near_votes);
    TEST_ASSERT_EQUAL_UINT32(40, modes.far_votes);
    TEST_ASSERT_TRUE(modes.split_m > 2.4F && modes.split_m < 4.7F);
}

void door_lintels_and_lamps_under_the_ceiling_change_nothing() {
    Random random(2);
    ElevationHistogram h;
    add(h, random, 30, 2.00F, 0.02F);     // lintels
    add(h, random, 20, 1.70F, 0.02F);     // lamps
    add(h, random, 600, 2.50F, 0.06F);
    TEST_ASSERT_FALSE(find_modes(h, kStepM, kLeast).two);
    add(h, random, 40, 5.20F, 0.06F);
    TEST_ASSERT_TRUE(find_modes(h, kStepM, kLeast).two);
}

void one_ceiling_a_slope_and_echoes_are_not_two_modes() {
    Random random(3);
    ElevationHistogram flat;
    add(flat, random, 800, 2.50F, 0.06F);
    TEST_ASSERT_FALSE(find_modes(flat, kStepM, kLeast).two);
    add(flat, random, 6, 6.0F, 3.0F);     // fewer than make a cluster
    TEST_ASSERT_FALSE(find_modes(flat, kStepM, kLeast).two);
    ElevationHistogram slope;
    add(slope, random, 800, 4.0F, 4.0F);  // 2 to 6 m, evenly: the centres of k-means lie 2 m apart
    const FloorModes modes = find_modes(slope, kStepM, kLeast);
    TEST_ASSERT_TRUE(modes.far_m - modes.near_m > kStepM);
    TEST_ASSERT_FALSE(modes.two);
    TEST_ASSERT_FALSE(find_modes(ElevationHistogram{}, kStepM, kLeast).two);
}

void a_step_in_the_ceiling_lower_than_a_storey_is_none() {
    Random random(4);
    ElevationHistogram h;
    add(h, random, 300, 2.40F, 0.06F);
    add(h, random, 300, 3.60F, 0.06F);
    TEST_ASSERT_FALSE(find_modes(h, kStepM, kLeast).two);
    TEST_ASSERT_TRUE(find_modes(h, 1.0F, kLeast).two);
}

void two_openings_one_over_the_other_are_still_beyond() {
    Random random(5);
    ElevationHistogram h;
    add(h, random, 500, 2.50F, 0.06F);
    add(h, random, 40, 5.20F, 0.06F);
    add(h, random, 20, 7.90F, 0.06F);
    const FloorModes modes = find_modes(h, kStepM, kLeast);
    TEST_ASSERT_TRUE(modes.two);
    TEST_ASSERT_EQUAL_UINT32(60, modes.far_votes);
}

void ground_below_an_opening_is_found_among_the_treads_in_it() {
    Random random(6);
    ElevationHistogram h;
    add(h, random, 500, 0.0F, 0.04F);
    for (int tread = 1; tread < 16; ++tread) { add(h, random, 4, 0.19F * static_cast<float>(tread), 0.02F); }
    add(h, random, 60, 3.0F, 0.06F);
    float depth_m = 0.0F;
    TEST_ASSERT_TRUE(deepest_mode(h, kStepM, kLeast, depth_m));
    TEST_ASSERT_FLOAT_WITHIN(0.05F, 3.0F, depth_m);
    ElevationHistogram none;
    add(none, random, 500, 0.02F, 0.04F);
    TEST_ASSERT_FALSE(deepest_mode(none, kStepM, kLeast, depth_m));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(an_opening_beside_a_ceiling_makes_two_modes);
    RUN_TEST(door_lintels_and_lamps_under_the_ceiling_change_nothing);
    RUN_TEST(one_ceiling_a_slope_and_echoes_are_not_two_modes);
    RUN_TEST(a_step_in_the_ceiling_lower_than_a_storey_is_none);
    RUN_TEST(two_openings_one_over_the_other_are_still_beyond);
    RUN_TEST(ground_below_an_opening_is_found_among_the_treads_in_it);
    return UNITY_END();
}
