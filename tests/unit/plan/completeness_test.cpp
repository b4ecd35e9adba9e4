// An exploration ends with nothing left behind: narrow bends that are seen only from their very edge, and places closed because they held the vehicle.
#include <array>
#include <cstdio>
#include <memory>
#include <vector>

#include "unit/plan/closed_world.hpp"
#include "unit/plan/closed_world_score.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;
using test::ClosedLoop;
using test::FlatWorld;

namespace {

struct Maze {
    double cell_m;
    double start_x, start_y;   ///< in cells
    double yaw_rad;
    std::vector<std::array<int, 4>> walls;   ///< ends, in cells
};

const Maze kMazes[] = {
    {1.7016, 5.5, 0.5, 2.4539, {{0, 0, 6, 0}, {0, 4, 6, 4}, {0, 0, 0, 4}, {6, 0, 6, 4}, {0, 1, 1, 1}, {1, 2, 1, 3}, {1, 1, 2, 1}, {1, 2, 2, 2}, {2, 3, 2, 4}, {3, 0, 3, 1},
                                {3, 1, 3, 2}, {2, 2, 3, 2}, {3, 2, 3, 3}, {4, 0, 4, 1}, {3, 3, 4, 3}, {5, 1, 5, 2}, {4, 2, 5, 2}, {5, 3, 5, 4}}},
    {1.9583, 2.5, 2.5, 0.79, {{0, 0, 6, 0}, {0, 4, 6, 4}, {0, 0, 0, 4}, {6, 0, 6, 4}, {1, 0, 1, 1}, {0, 2, 1, 2}, {1, 2, 1, 3}, {1, 1, 2, 1}, {1, 2, 2, 2}, {2, 3, 2, 4},
                              {2, 1, 3, 1}, {2, 2, 3, 2}, {4, 1, 4, 2}, {3, 2, 4, 2}, {3, 3, 4, 3}, {4, 1, 5, 1}, {5, 1, 5, 2}, {5, 2, 5, 3}}},
};

FlatWorld world_of(const Maze& maze) {
    FlatWorld w;
    for (const auto& a : maze.walls) { w.add_wall(a[0] * maze.cell_m, a[1] * maze.cell_m, a[2] * maze.cell_m, a[3] * maze.cell_m); }
    w.shift(-maze.start_x * maze.cell_m, -maze.start_y * maze.cell_m);
    w.turn(maze.yaw_rad);
    return w;
}

void nothing_is_left_behind_in_narrow_mazes() {
    for (const Maze& maze : kMazes) {
        const Parameters p;
        const FlatWorld world = world_of(maze);
        const auto loop = std::make_unique<ClosedLoop>(p, world, 1U);
        loop->pose_noise_m = 0.005;
        const test::Result r = test::fly(*loop, 300.0);
        const double share = test::explored_share(world, loop->grid, loop->range_max_m);
        std::printf("  cells of %.2f m: %.0f s, seen %.4f\n", maze.cell_m, r.time_s, share);
        TEST_ASSERT_TRUE(r.completed);
        TEST_ASSERT_TRUE(share > 0.98);
    }
}

/// Steps of the traversability until every block is done.
void settle(Traversability& where, const OccupancyGrid& grid) {
    for (int k = 0; k < 200; ++k) { where.update(grid, 0.0F, 0.0F); }
}

void a_closed_place_is_not_passed_until_its_time_is_over() {
    const Parameters p;
    FlatWorld world;
    world.add_wall(-3.0, -3.0, 3.0, -3.0);
    world.add_wall(-3.0, 3.0, 3.0, 3.0);
    world.add_wall(-3.0, -3.0, -3.0, 3.0);
    world.add_wall(3.0, -3.0, 3.0, 3.0);
    const auto loop = std::make_unique<ClosedLoop>(p, world, 1U);
    static_cast<void>(test::fly(*loop, 60.0));
    const auto where = std::make_unique<Traversability>(p);
    settle(*where, loop->grid);
    const CellId here = loop->grid.find(1.05F, 1.05F);
    const CellId beside = loop->grid.find(1.55F, 1.05F);
    TEST_ASSERT_TRUE(where->passable(here));
    where->close(1.05F, 1.05F, 5'000'000);
    where->close(-1.05F, 1.05F, 9'000'000);
    settle(*where, loop->grid);
    TEST_ASSERT_FALSE(where->passable(here));
    TEST_ASSERT_FALSE_MESSAGE(where->tight(here), "the way would lead into it");
    TEST_ASSERT_TRUE(where->passable(beside));
    where->reopen(4'000'000);
    settle(*where, loop->grid);
    TEST_ASSERT_FALSE(where->passable(here));
    where->reopen(6'000'000);
    settle(*where, loop->grid);
    TEST_ASSERT_TRUE(where->passable(here));
    TEST_ASSERT_FALSE(where->passable(loop->grid.find(-1.05F, 1.05F)));
    where->reopen_last();
    settle(*where, loop->grid);
    TEST_ASSERT_TRUE(where->passable(loop->grid.find(-1.05F, 1.05F)));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(nothing_is_left_behind_in_narrow_mazes);
    RUN_TEST(a_closed_place_is_not_passed_until_its_time_is_over);
    return UNITY_END();
}
