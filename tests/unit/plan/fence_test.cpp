// The fence: depth by an independent route, what the planner takes for passable, and a fence that is changed in flight.
#include <cmath>
#include <memory>
#include <random>

#include "plan/fence.hpp"
#include "plan/traversability.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// A house with a bay: six corners, not convex.
void house(Parameters& p) {
    const float corner[6][2] = {{-2.0F, -2.0F}, {6.0F, -2.0F}, {6.0F, 3.0F}, {3.0F, 3.0F}, {3.0F, 1.0F}, {-2.0F, 1.0F}};
    float* const x[6] = {&p.fence_1_x_m, &p.fence_2_x_m, &p.fence_3_x_m, &p.fence_4_x_m, &p.fence_5_x_m, &p.fence_6_x_m};
    float* const y[6] = {&p.fence_1_y_m, &p.fence_2_y_m, &p.fence_3_y_m, &p.fence_4_y_m, &p.fence_5_y_m, &p.fence_6_y_m};
    for (int k = 0; k < 6; ++k) {
        *x[k] = corner[k][0];
        *y[k] = corner[k][1];
    }
    p.fence_corners = 6;
}

void the_depth_of_a_polygon_is_the_distance_to_its_edge() {
    Parameters p;
    house(p);
    const Fence fence{p};
    std::mt19937 rng(4);
    std::uniform_real_distribution<float> any(-4.0F, 8.0F);
    for (int k = 0; k < 2000; ++k) {
        const float x = any(rng);
        const float y = any(rng);
        // Independent: the house is two boxes; points of its outline 1 cm apart.
        const bool inside = (x > -2.0F && x < 6.0F && y > -2.0F && y < 1.0F) || (x > 3.0F && x < 6.0F && y > -2.0F && y < 3.0F);
        float nearest = 100.0F;
        const auto side = [&](const float x0, const float y0, const float x1, const float y1) {
            for (float f = 0.0F; f <= 1.0F; f += 0.00125F) { nearest = std::min(nearest, std::hypot(x0 + f * (x1 - x0) - x, y0 + f * (y1 - y0) - y)); }
        };
        side(-2, -2, 6, -2);
        side(6, -2, 6, 3);
        side(6, 3, 3, 3);
        side(3, 3, 3, 1);
        side(3, 1, -2, 1);
        side(-2, 1, -2, -2);
        TEST_ASSERT_FLOAT_WITHIN(0.006F, inside ? nearest : -nearest, fence.depth_m(x, y));
    }
}

void circle_box_and_polygon_must_all_hold() {
    Parameters p;
    TEST_ASSERT_TRUE(Fence{p}.depth_m(100.0F, 0.0F) > 50.0F);
    p.fence_front_m = 5.0F;
    p.fence_right_m = 1.0F;
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.0F, Fence{p}.depth_m(4.0F, 0.0F));
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, -0.5F, Fence{p}.depth_m(0.0F, -1.5F));   // right is -y
    TEST_ASSERT_TRUE(Fence{p}.depth_m(-50.0F, 50.0F) > 0.0F);
    p.fence_radius_m = 3.0F;
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, -1.0F, Fence{p}.depth_m(4.0F, 0.0F));
    house(p);
    TEST_ASSERT_TRUE(Fence{p}.depth_m(0.0F, 2.0F) < 0.0F);                   // in circle and box, out of the polygon
    p.fence_corners = 2;
    TEST_ASSERT_TRUE(Fence{p}.depth_m(0.0F, 2.0F) > 0.0F);                   // two corners are no polygon
}

void outside_nothing_is_passable_and_a_new_fence_is_taken_up() {
    const auto p = std::make_unique<Parameters>();
    const auto grid = std::make_unique<OccupancyGrid>(*p);
    const auto where = std::make_unique<Traversability>(*p);
    test::FlatWorld world;
    world.add_wall(-4.0, -4.0, 6.0, -4.0);
    world.add_wall(-4.0, 4.0, 6.0, 4.0);
    world.add_wall(-4.0, -4.0, -4.0, 4.0);
    world.add_wall(6.0, -4.0, 6.0, 4.0);
    std::mt19937 rng(1);
    LevelScan scan;
    Estimate e;
    e.planar.quality = 100;
    e.altitude.valid = true;
    e.altitude.z_m = 1.0F;
    for (const float yaw : {0.0F, 3.0F}) {
        e.planar.pose_map_body = {0.0F, 0.0F, yaw};
        for (int k = 0; k < 4; ++k) {
            test::sweep(world, 0.0, 0.0, static_cast<double>(yaw), 10.0, 0.0, rng, scan);
            grid->integrate(e, scan);
        }
    }
    const auto settle = [&] {
        for (int k = 0; k < 60; ++k) { where->update(*grid, 0.0F, 0.0F); }
    };
    settle();
    TEST_ASSERT_TRUE(where->passable(grid->find(4.0F, 0.0F)));
    p->fence_front_m = 3.0F;                                                 // WHEN a fence is drawn
    settle();
    TEST_ASSERT_FALSE(where->passable(grid->find(4.0F, 0.0F)));              // THEN no way leads beyond it, and none along its very edge
    TEST_ASSERT_FALSE(where->tight(grid->find(4.0F, 0.0F)));
    TEST_ASSERT_FALSE(where->passable(grid->find(2.85F, 0.0F)));
    TEST_ASSERT_TRUE(where->passable(grid->find(2.65F, 0.0F)));
    p->fence_front_m = 100.0F;                                               // WHEN it is taken away THEN the way is open again
    settle();
    TEST_ASSERT_TRUE(where->passable(grid->find(4.0F, 0.0F)));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(the_depth_of_a_polygon_is_the_distance_to_its_edge);
    RUN_TEST(circle_box_and_polygon_must_all_hold);
    RUN_TEST(outside_nothing_is_passable_and_a_new_fence_is_taken_up);
    return UNITY_END();
}
