// The edge of the unknown: a room seen only through a door that the hull cannot pass, some metres behind it.
#include <cmath>
#include <memory>

#include "plan/frontier.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// A room of 3.5 x 5 m, a door of 0.55 m in its wall and a room of 7 x 8 m behind it, mapped from one place.
struct TwoRooms {
    Parameters p;
    test::FlatWorld world;
    OccupancyGrid grid{p};
    Traversability where{p};
    OpenCells open;
    CostField from;
    TriedPlaces tried{p};
    FrontierSearch search{p};

    TwoRooms() {
        world.add_wall(-1.5, -2.5, 2.0, -2.5);
        world.add_wall(-1.5, 2.5, 2.0, 2.5);
        world.add_wall(-1.5, -2.5, -1.5, 2.5);
        world.add_wall(2.0, -4.0, 2.0, 0.2);
        world.add_wall(2.0, 0.75, 2.0, 4.0);
        world.add_wall(2.0, -4.0, 9.0, -4.0);
        world.add_wall(9.0, -4.0, 9.0, 4.0);
        world.add_wall(9.0, 4.0, 2.0, 4.0);
        std::mt19937 rng(1);
        LevelScan scan;
        Estimate e;
        e.planar.quality = 100;
        e.altitude.valid = true;
        e.altitude.z_m = 1.0F;
        for (const double yaw : {0.0, 3.0}) {
            e.planar.pose_map_body = {0.0F, 0.0F, static_cast<float>(yaw)};
            test::sweep(world, 0.0, 0.0, yaw, 10.0, 0.0, rng, scan);
            for (int k = 0; k < 3; ++k) { grid.integrate(e, scan); }
        }
        for (int k = 0; k < 100; ++k) { where.update(grid, 0.0F, 0.0F); }
        from.start(grid, grid.find(0.0F, 0.0F), 5, open);
        while (!from.run(grid, where, open, 10000, kNoCell, 0)) {}
    }
    std::size_t found(const bool fine) {
        ViewRule rule;
        rule.fine = fine;
        rule.behind_min = p.reveal_min_cells;
        search.start();
        while (!search.run(grid, where, from, tried, rule, 0.0F, 0.0F, 0)) {}
        return search.found().size();
    }
};

/// Groups with a viewpoint by coarse and by fine lines; the viewpoints of the latter see what they are to show.
void expect_more_by_fine_lines(TwoRooms& r) {
    const std::size_t coarse = r.found(false);
    const std::size_t fine = r.found(true);
    std::printf("  %d groups with a viewpoint, %d by fine lines\n", static_cast<int>(coarse), static_cast<int>(fine));
    TEST_ASSERT_TRUE_MESSAGE(fine > coarse, "no more than by coarse lines");
    for (const Frontier& f : r.search.found()) {
        TEST_ASSERT_TRUE(r.where.passable(f.view));
        const auto x_m = static_cast<double>(f.view_x_m);
        const auto y_m = static_cast<double>(f.view_y_m);
        const double dx_m = static_cast<double>(f.x_m) - x_m;
        const double dy_m = static_cast<double>(f.y_m) - y_m;
        const double away_m = std::hypot(dx_m, dy_m);
        TEST_ASSERT_TRUE_MESSAGE(r.world.cast(x_m, y_m, std::atan2(dy_m, dx_m), 20.0, r.world.segments()) > away_m - 0.15, "a wall is in between");
    }
}

void fine_lines_are_longer() { expect_more_by_fine_lines(*std::make_unique<TwoRooms>()); }

void fine_lines_pass_a_narrow_door() {
    const auto r = std::make_unique<TwoRooms>();
    r->p.view_range_m = r->p.grid_range_max_m;
    expect_more_by_fine_lines(*r);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(fine_lines_are_longer);
    RUN_TEST(fine_lines_pass_a_narrow_door);
    return UNITY_END();
}
