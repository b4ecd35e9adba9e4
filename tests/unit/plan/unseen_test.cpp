// Floor that the camera has not seen: where patches are found, that their viewpoints see them, and that looking from all of them leaves none.
#include <cmath>
#include <memory>

#include "plan/unseen.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// A room of 8 x 6 m with a wall that hides a part, mapped by the laser from four places.
struct Room {
    Parameters p;
    OccupancyGrid grid{p};
    Traversability where{p};
    OpenCells open;
    CostField from;
    TriedPlaces tried{p};
    UnseenSearch search{p};

    Room() {
        p.camera_weight = 1.0F;
        test::FlatWorld world;
        world.add_wall(-2.0, -3.0, 6.0, -3.0);
        world.add_wall(6.0, -3.0, 6.0, 3.0);
        world.add_wall(6.0, 3.0, -2.0, 3.0);
        world.add_wall(-2.0, 3.0, -2.0, -3.0);
        world.add_wall(3.0, -3.0, 3.0, 0.5);
        world.turn(0.297);
        std::mt19937 rng(1);
        LevelScan scan;
        Estimate e;
        e.planar.quality = 100;
        e.altitude.valid = true;
        e.altitude.z_m = 1.0F;
        for (const auto& [x, y] : {std::pair{0.0, 0.0}, {2.0, 2.2}, {4.0, 1.5}, {4.0, 0.0}}) {
            for (const double yaw : {0.0, 3.0}) {
                e.planar.pose_map_body = {static_cast<float>(x), static_cast<float>(y), static_cast<float>(yaw)};
                test::sweep(world, x, y, yaw, 10.0, 0.0, rng, scan);
                grid.integrate(e, scan);
                if ((grid.scans() & 3U) == 3U) { grid.integrate(e, scan); }   // keeps clear of the grid's own looks, every fourth sweep
                grid.integrate(e, scan);
            }
        }
        for (int k = 0; k < 100; ++k) { where.update(grid, 0.0F, 0.0F); }
        from.start(grid, grid.find(0.0F, 0.0F), 5, open);
        while (!from.run(grid, where, open, 10000, kNoCell, 0)) {}
    }
    std::size_t patches(const std::int64_t t_us = 0) {
        search.start();
        while (!search.run(grid, where, from, tried, t_us)) {}
        return search.found().size();
    }
};

void what_was_never_in_view_is_found_with_a_place_that_sees_it() {
    const auto r = std::make_unique<Room>();
    TEST_ASSERT_TRUE(r->patches() > 3U);
    for (const Frontier& f : r->search.found()) {
        TEST_ASSERT_TRUE(f.camera);
        TEST_ASSERT_FALSE(r->grid.camera_saw(f.look));
        TEST_ASSERT_TRUE(r->where.passable(f.view));
        const float away_m = std::hypot(f.view_x_m - f.x_m, f.view_y_m - f.y_m);
        TEST_ASSERT_TRUE(away_m < r->p.camera_range_m && away_m > 0.4F);
        TEST_ASSERT_EQUAL_UINT32(r->from.cost(f.view), f.cost);
    }
}

void looking_from_every_viewpoint_leaves_nothing() {
    const auto r = std::make_unique<Room>();
    const float before = r->grid.camera_seen_fraction();
    int looks = 0;
    while (r->patches() > 0U && looks < 60) {
        const Frontier f = r->search.found()[0];
        r->grid.look({f.view_x_m, f.view_y_m, std::atan2(f.y_m - f.view_y_m, f.x_m - f.view_x_m)});
        TEST_ASSERT_TRUE_MESSAGE(r->grid.camera_saw(f.look), "the viewpoint does not see its patch");
        ++looks;
    }
    TEST_ASSERT_TRUE(looks < 60);
    TEST_ASSERT_TRUE(r->grid.camera_seen_fraction() > 0.9F && before < 0.9F);
}

void a_small_weight_and_a_place_tried_in_vain_leave_patches_out() {
    const auto r = std::make_unique<Room>();
    const std::size_t all = r->patches();
    r->p.camera_weight = 0.32F;                                   // 62 cells of 64
    r->tried.clear();
    TEST_ASSERT_TRUE(r->patches() < all);
    r->p.camera_weight = 1.0F;
    const std::size_t whole = r->patches();
    const Frontier f = r->search.found()[0];
    r->tried.give_up(f.x_m, f.y_m, 1.0F, 0);
    static_cast<void>(r->patches(1));
    for (const Frontier& other : r->search.found()) { TEST_ASSERT_TRUE(other.look != f.look); }
    TEST_ASSERT_TRUE(whole > 0U);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(what_was_never_in_view_is_found_with_a_place_that_sees_it);
    RUN_TEST(looking_from_every_viewpoint_leaves_nothing);
    RUN_TEST(a_small_weight_and_a_place_tried_in_vain_leave_patches_out);
    return UNITY_END();
}
