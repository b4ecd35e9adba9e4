// Stairs are known by the ground under the way.
#include <cmath>
#include <memory>

#include "plan/floors.hpp"
#include "plan/stair_signs.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// Flies along x over ground of so many metres a stretch; the place of the first sign, or a negative number.
template <typename Ground>
float first_sign(StairSigns& signs, const Ground& ground_m, const std::int32_t floor = 0) {
    for (float x_m = 0.0F; x_m < 4.0F; x_m += 0.05F) {
        if (signs.note(floor, x_m, 1.0F, ground_m(x_m))) { return x_m; }
    }
    return -1.0F;
}

void treads_are_told_from_furniture() {
    for (const float run_m : {0.15F, 0.25F, 0.30F}) {
        StairSigns signs;
        const float at_m = first_sign(signs, [&](const float x_m) { return x_m < 2.0F ? 0.0F : 0.18F * (1.0F + std::floor((x_m - 2.0F) / run_m)); });
        TEST_ASSERT_FLOAT_WITHIN_MESSAGE(0.06F, 2.0F, at_m, "known at the first tread");
    }
    for (const float height_m : {0.04F, 0.40F, 0.75F}) {   // a carpet, a seat, a table
        StairSigns signs;
        TEST_ASSERT_TRUE(first_sign(signs, [&](const float x_m) { return x_m < 2.0F || x_m > 3.0F ? 0.01F * std::sin(40.0F * x_m) : height_m; }) < 0.0F);
    }
}

void the_ground_of_another_floor_is_no_step() {
    StairSigns signs;
    TEST_ASSERT_FALSE(signs.note(0, 1.0F, 1.0F, 0.0F));
    TEST_ASSERT_FALSE(signs.note(1, 1.0F, 1.0F, 0.18F));
    TEST_ASSERT_TRUE(signs.note(0, 1.0F, 1.1F, 0.18F));
}

void stairs_are_watched_for_on_a_single_floor_too() {
    for (const std::int32_t floors_max : {1, 8}) {
        Parameters p;
        p.floors_max = floors_max;
        const auto floors = std::make_unique<FloorPlanner>(p);
        const auto grid = std::make_unique<OccupancyGrid>(p);
        const auto scan = std::make_unique<LevelScan>();
        const auto frame = std::make_unique<SensorFrame>();
        Estimate estimate;
        estimate.planar.quality = 100;
        estimate.altitude.valid = true;
        estimate.altitude.z_m = p.cruise_height_m;
        bool stairs = false;
        for (int k = 0; k < 20; ++k) {
            estimate.planar.pose_map_body.x_m = 0.1F * static_cast<float>(k);
            estimate.altitude.ground_z_m = k < 10 ? 0.0F : 0.18F;
            floors->observe(estimate, *frame, *scan, *grid);
            TEST_ASSERT_TRUE(k >= 10 || !floors->over_stairs());
            stairs = stairs || floors->over_stairs();
        }
        TEST_ASSERT_TRUE(stairs);
    }
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(treads_are_told_from_furniture);
    RUN_TEST(the_ground_of_another_floor_is_no_step);
    RUN_TEST(stairs_are_watched_for_on_a_single_floor_too);
    return UNITY_END();
}
