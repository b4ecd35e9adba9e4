// A place closed because it held the vehicle.
#include <memory>

#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;
using test::ClosedLoop;
using test::FlatWorld;

namespace {

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
    RUN_TEST(a_closed_place_is_not_passed_until_its_time_is_over);
    return UNITY_END();
}
