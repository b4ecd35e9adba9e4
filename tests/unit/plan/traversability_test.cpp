// Where the hull fits: a place closed because it held the vehicle, what is hit of stairs, the room in a cell beside a wall.
#include <cmath>
#include <cstdio>
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

/// A room of 6 x 6 m, explored.
std::unique_ptr<ClosedLoop> explored_room(const Parameters& p, const FlatWorld& world) {
    auto loop = std::make_unique<ClosedLoop>(p, world, 1U);
    static_cast<void>(test::fly(*loop, 60.0));
    return loop;
}

FlatWorld room() {
    FlatWorld world;
    world.add_wall(-3.0, -3.0, 3.0, -3.0);
    world.add_wall(-3.0, 3.0, 3.0, 3.0);
    world.add_wall(-3.0, -3.0, -3.0, 3.0);
    world.add_wall(3.0, -3.0, 3.0, 3.0);
    return world;
}

void what_is_hit_of_stairs_counts_as_nearer() {
    const Parameters p;
    const FlatWorld world = room();
    const auto loop = explored_room(p, world);
    const auto where = std::make_unique<Traversability>(p);
    settle(*where, loop->grid);
    // Beside the wall along x, where the hull still fits.
    CellId beside = kNoCell;
    float beside_x_m = 0.0F;
    for (float x_m = 0.0F; x_m < 3.0F && beside == kNoCell; x_m += 0.05F) {
        const CellId at = loop->grid.find(x_m, 0.0F);
        if (where->clearance_cm(at) <= 55 && where->passable(at)) {
            beside = at;
            beside_x_m = x_m;
        }
    }
    TEST_ASSERT_TRUE(beside != kNoCell);
    const std::int32_t before_cm = where->clearance_cm(beside);
    where->add_stairs(1, beside_x_m, 0.0F);   // of another floor: nothing
    settle(*where, loop->grid);
    TEST_ASSERT_EQUAL_INT32(before_cm, where->clearance_cm(beside));
    where->add_stairs(0, beside_x_m, 0.0F);
    settle(*where, loop->grid);
    TEST_ASSERT_INT32_WITHIN(3, before_cm - 30, where->clearance_cm(beside));
    TEST_ASSERT_FALSE(where->passable(beside));
    TEST_ASSERT_TRUE_MESSAGE(where->passable(loop->grid.find(beside_x_m - 1.0F, 0.0F)), "the floor before the stairs is free");
}

void a_closed_place_is_not_passed_until_its_time_is_over() {
    const Parameters p;
    const FlatWorld world = room();
    const auto loop = explored_room(p, world);
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

// The way to a place ends there: in a passable cell it has to be a point where the hull fits.
void a_place_beside_a_wall_is_moved_to_where_the_hull_fits() {
    const Parameters p;   // hull 0.30 m and 0.06 m
    FlatWorld world = room();
    world.turn(0.3);
    const auto loop = explored_room(p, world);
    const auto where = std::make_unique<Traversability>(p);
    settle(*where, loop->grid);
    int moved = 0;
    for (float y_m = -2.95F; y_m < 3.0F; y_m += 0.1F) {
        for (float x_m = -2.97F; x_m < 3.0F; x_m += 0.1F) {
            float to_x_m = x_m;
            float to_y_m = y_m;
            where->make_room(loop->grid, to_x_m, to_y_m);
            const CellId at = loop->grid.find(x_m, y_m);
            if (!where->passable(at) || loop->grid.clearance_m(x_m, y_m, 0.5F) >= 0.36F) {
                TEST_ASSERT_TRUE(to_x_m == x_m && to_y_m == y_m);
                continue;
            }
            ++moved;
            TEST_ASSERT_TRUE(loop->grid.clearance_m(to_x_m, to_y_m, 0.5F) > 0.352F);   // a place once open stays so with 5 mm less
            TEST_ASSERT_TRUE(std::fabs(to_x_m - x_m) < 0.101F && std::fabs(to_y_m - y_m) < 0.101F);
        }
    }
    std::printf("  %d places moved\n", moved);
    TEST_ASSERT_TRUE(moved > 20);
}

// Asked again at every step while there is no way, with nothing closed, it works once a second.
void opening_what_is_not_closed_is_done_once_a_second() {
    const Parameters p;
    const FlatWorld world = room();
    const auto loop = explored_room(p, world);
    const auto where = std::make_unique<Traversability>(p);
    const auto work = [&](const std::int64_t t_us) {
        const std::uint32_t before = where->blocks_done();
        where->reopen(t_us);
        where->reopen_all();
        settle(*where, loop->grid);
        return where->blocks_done() - before;
    };
    TEST_ASSERT_TRUE(work(1'000'000) > 0U);
    TEST_ASSERT_EQUAL_UINT32(0U, work(1'050'000));
    TEST_ASSERT_EQUAL_UINT32(0U, work(1'950'000));
    TEST_ASSERT_TRUE(work(2'050'000) > 0U);
    where->close(1.05F, 1.05F, 90'000'000);
    settle(*where, loop->grid);
    TEST_ASSERT_TRUE(work(2'100'000) > 0U);
    TEST_ASSERT_TRUE(where->passable(loop->grid.find(1.05F, 1.05F)));
}

/// A sweep that sees two posts across the way, each this far from the middle of the cell at (0.55, 0.05), and far between them.
void look_between_posts(OccupancyGrid& grid, const double half_m) {
    LevelScan scan;
    scan.range_max_m = 10.0F;
    scan.bearing_increment_rad = 0.0044F;
    const auto beam = [&scan](const double x_m, const double y_m) {
        ScanPoint q;
        q.x_m = static_cast<float>(x_m);
        q.y_m = static_cast<float>(y_m);
        q.range_m = static_cast<float>(std::hypot(x_m, y_m));
        q.hit = true;
        TEST_ASSERT_TRUE(scan.points.push(q));
    };
    const auto nothing_behind = [&scan] {   // the rest of a sweep
        ScanPoint q;
        q.x_m = -1.0F;
        q.range_m = 1.0F;
        q.hit = false;
        for (int k = 0; k < 5; ++k) { TEST_ASSERT_TRUE(scan.points.push(q)); }
    };
    nothing_behind();
    beam(0.55, -half_m);
    beam(3.0, 0.0);
    beam(0.55, half_m);
    nothing_behind();
    Estimate e;
    e.planar.pose_map_body = {0.0F, 0.05F, 0.0F};
    e.planar.quality = 100;
    e.altitude.valid = true;
    e.altitude.z_m = 1.0F;
    for (int k = 0; k < 30; ++k) { grid.integrate(e, scan); }
}

void a_gap_found_closed_does_not_open_by_noise() {
    Parameters p;   // hull 0.30 m and 0.06 m
    const auto grid = std::make_unique<OccupancyGrid>(p);
    const auto where = std::make_unique<Traversability>(p);
    std::int64_t now_us = 0;
    const auto open = [&](const double half_m) {
        look_between_posts(*grid, half_m);
        where->reopen(now_us += 1'000'000);
        where->reopen_all();   // taken up at once; lenient from the next step on only
        settle(*where, *grid);
        return where->clearance_cm(grid->find(0.55F, 0.05F)) >= 36;
    };
    TEST_ASSERT_TRUE(open(0.372));
    TEST_ASSERT_TRUE_MESSAGE(open(0.3585), "open, it stays so with a little less");
    TEST_ASSERT_FALSE(open(0.352));
    where->reopen(9'000'000);   // the four seconds are over
    const auto later = [&](const double half_m, const std::int64_t t_us) {
        look_between_posts(*grid, half_m);
        where->reopen(t_us);
        settle(*where, *grid);
        return where->clearance_cm(grid->find(0.55F, 0.05F)) >= 36;
    };
    TEST_ASSERT_FALSE_MESSAGE(later(0.368, 10'000'000), "as much as noise adds");
    TEST_ASSERT_TRUE_MESSAGE(later(0.368, 61'000'000), "once a minute less is enough");
    TEST_ASSERT_FALSE(later(0.352, 70'000'000));
    TEST_ASSERT_FALSE(later(0.368, 71'000'000));
    TEST_ASSERT_TRUE(later(0.395, 72'000'000));
    TEST_ASSERT_FALSE(later(0.352, 73'000'000));
    p.plan_reopen_m = 0.005F;
    TEST_ASSERT_TRUE_MESSAGE(later(0.368, 74'000'000), "a laser with less noise");
}

// A gap that is 5 mm too narrow: closed, open at last resort, and closed again after a minute.
void at_last_resort_a_little_less_is_enough() {
    const Parameters p;
    const auto grid = std::make_unique<OccupancyGrid>(p);
    const auto where = std::make_unique<Traversability>(p);
    const auto open = [&](const std::int64_t t_us) {
        where->reopen(t_us);
        settle(*where, *grid);
        return where->clearance_cm(grid->find(0.55F, 0.05F)) >= 36;
    };
    look_between_posts(*grid, 0.355);
    TEST_ASSERT_FALSE(open(10'000'000));
    TEST_ASSERT_FALSE(where->at_last_resort());
    where->last_resort();
    TEST_ASSERT_TRUE(where->at_last_resort());
    TEST_ASSERT_TRUE(open(10'050'000));
    TEST_ASSERT_TRUE(open(69'000'000));
    TEST_ASSERT_FALSE_MESSAGE(open(70'050'000), "the minute is over");
    TEST_ASSERT_FALSE(where->at_last_resort());
    where->last_resort();
    look_between_posts(*grid, 0.345);
    TEST_ASSERT_FALSE_MESSAGE(open(70'100'000), "more is lacking than that");
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(what_is_hit_of_stairs_counts_as_nearer);
    RUN_TEST(a_closed_place_is_not_passed_until_its_time_is_over);
    RUN_TEST(a_place_beside_a_wall_is_moved_to_where_the_hull_fits);
    RUN_TEST(opening_what_is_not_closed_is_done_once_a_second);
    RUN_TEST(a_gap_found_closed_does_not_open_by_noise);
    RUN_TEST(at_last_resort_a_little_less_is_enough);
    return UNITY_END();
}
