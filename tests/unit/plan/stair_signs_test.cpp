// Stairs are known by the ground under the way, and what is hit of them counts as nearer.
#include <memory>

#include "plan/stair_signs.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;
using test::ClosedLoop;
using test::FlatWorld;

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

void what_is_hit_of_stairs_counts_as_nearer() {
    const Parameters p;
    FlatWorld world;
    world.add_wall(-3.0, -3.0, 3.0, -3.0);
    world.add_wall(-3.0, 3.0, 3.0, 3.0);
    world.add_wall(-3.0, -3.0, -3.0, 3.0);
    world.add_wall(3.0, -3.0, 3.0, 3.0);
    const auto loop = std::make_unique<ClosedLoop>(p, world, 1U);
    static_cast<void>(test::fly(*loop, 60.0));
    const auto where = std::make_unique<Traversability>(p);
    const auto settle = [&] {
        for (int k = 0; k < 200; ++k) { where->update(loop->grid, 0.0F, 0.0F); }
    };
    settle();
    // The walls of the map lie where the flight began: looked for along x.
    CellId beside = kNoCell;
    float beside_x_m = 0.0F;
    for (float x_m = 0.0F; x_m < 3.0F && beside == kNoCell; x_m += 0.05F) {
        if (where->clearance_cm(loop->grid.find(x_m, 0.0F)) <= 55 && where->passable(loop->grid.find(x_m, 0.0F))) {
            beside = loop->grid.find(x_m, 0.0F);
            beside_x_m = x_m;
        }
    }
    TEST_ASSERT_TRUE(beside != kNoCell);
    const std::int32_t before_cm = where->clearance_cm(beside);
    where->add_stairs(1, beside_x_m, 0.0F);   // of another floor: nothing
    settle();
    TEST_ASSERT_EQUAL_INT32(before_cm, where->clearance_cm(beside));
    where->add_stairs(0, beside_x_m, 0.0F);
    settle();
    TEST_ASSERT_INT32_WITHIN(3, before_cm - 30, where->clearance_cm(beside));
    TEST_ASSERT_FALSE(where->passable(beside));
    TEST_ASSERT_TRUE_MESSAGE(where->passable(loop->grid.find(beside_x_m - 1.0F, 0.0F)), "the floor before the stairs is free");
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(treads_are_told_from_furniture);
    RUN_TEST(the_ground_of_another_floor_is_no_step);
    RUN_TEST(what_is_hit_of_stairs_counts_as_nearer);
    return UNITY_END();
}
