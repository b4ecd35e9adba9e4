// The way home and what it costs: lengths over the trail, consumption from readings in whole per cents, when to turn.
#include <cmath>
#include <memory>

#include "plan/energy.hpp"
#include "plan/trail.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// A ring of corridors 2 m wide round a block of 6 x 4 m, wholly seen.
struct Ring {
    Parameters p;
    OccupancyGrid grid{p};
    Trail trail;

    Ring() {
        test::FlatWorld world;
        world.add_wall(-1.0, -1.0, 9.0, -1.0);
        world.add_wall(9.0, -1.0, 9.0, 7.0);
        world.add_wall(9.0, 7.0, -1.0, 7.0);
        world.add_wall(-1.0, 7.0, -1.0, -1.0);
        world.add_wall(1.0, 1.0, 7.0, 1.0);
        world.add_wall(7.0, 1.0, 7.0, 5.0);
        world.add_wall(7.0, 5.0, 1.0, 5.0);
        world.add_wall(1.0, 5.0, 1.0, 1.0);
        std::mt19937 rng(1);
        LevelScan scan;
        Estimate e;
        e.planar.quality = 100;
        e.altitude.valid = true;
        e.altitude.z_m = 1.0F;
        for (const auto& [x, y] : {std::pair{0.0, 0.0}, {8.0, 0.0}, {8.0, 6.0}, {0.0, 6.0}, {4.0, 0.0}, {4.0, 6.0}, {8.0, 3.0}, {0.0, 3.0}}) {
            for (const double yaw : {0.0, 3.0}) {
                e.planar.pose_map_body = {static_cast<float>(x), static_cast<float>(y), static_cast<float>(yaw)};
                for (int k = 0; k < 4; ++k) {
                    test::sweep(world, x, y, yaw, 10.0, 0.0, rng, scan);
                    grid.integrate(e, scan);
                }
            }
        }
        trail.begin(grid, 0.0F, 0.0F);
    }
    void fly(const float x0, const float y0, const float x1, const float y1) {
        const float length = std::hypot(x1 - x0, y1 - y0);
        for (float s = 0.0F; s <= length; s += 0.03F) { trail.step(grid, x0 + s / length * (x1 - x0), y0 + s / length * (y1 - y0)); }
    }
};

void the_way_home_is_the_way_flown_until_a_loop_closes() {
    const auto r = std::make_unique<Ring>();
    r->fly(0, 0, 8, 0);
    TEST_ASSERT_FLOAT_WITHIN(0.3F, 8.0F, r->trail.way_home_m());
    r->fly(8, 0, 8, 6);
    r->fly(8, 6, 0, 6);
    TEST_ASSERT_FLOAT_WITHIN(2.0F, 22.0F, r->trail.way_home_m());      // GIVEN it went round three sides: corners are cut by a little
    r->fly(0, 6, 0, 1.2F);
    TEST_ASSERT_FLOAT_WITHIN(0.3F, 1.2F, r->trail.way_home_m());       // WHEN it comes back to the start THEN home is near at once
    r->fly(0, 1.2F, 0, 6);
    for (int k = 0; k < 200; ++k) { r->trail.step(r->grid, 0.0F, 6.0F); }
    TEST_ASSERT_FLOAT_WITHIN(0.4F, 6.0F, r->trail.way_home_m());       // AND from the far side, by the short way
    TEST_ASSERT_TRUE(r->trail.longest_m() > 19.0F);
    TEST_ASSERT_TRUE(r->trail.size() < 60U);                           // places, not time, take memory
}

void a_wall_between_two_lanes_is_no_way() {
    const auto r = std::make_unique<Ring>();
    r->fly(0, 0, 4, 0);                                                // along the inner wall of the block: from (4, 0.6)...
    const float before_m = r->trail.way_home_m();
    r->trail.step(r->grid, 4.0F, 1.5F);                                // ...a point inside the block, 0.5 m behind it, cannot join straight
    TEST_ASSERT_TRUE(r->trail.way_home_m() >= before_m + 1.55F);
}

void consumption_is_learned_from_whole_per_cents() {
    Parameters p;
    Energy e{p};
    e.begin();
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 1.0F / p.battery_flight_time_s, e.rate_per_s());
    // GIVEN a battery that lasts 400 s, read in steps of 1 %
    std::int64_t t_us = 0;
    const auto fly = [&](const float seconds, const float per_s, float& left) {
        for (float t = 0.0F; t < seconds; t += 0.05F) {
            t_us += 50000;
            left -= 0.05F * per_s;
            e.step(std::floor(100.0F * left) / 100.0F, 0.6F, t_us);
        }
    };
    float left = 0.999F;
    fly(100.0F, 1.0F / 400.0F, left);
    TEST_ASSERT_FLOAT_WITHIN(0.0002F, 1.0F / 400.0F, e.rate_per_s());  // THEN the rate is found
    TEST_ASSERT_FLOAT_WITHIN(0.05F, 0.6F, e.cruise_m_s());             // AND the speed
    fly(20.0F, 1.0F / 100.0F, left);                                   // WHEN a cell fails
    TEST_ASSERT_FLOAT_WITHIN(0.002F, 1.0F / 100.0F, e.rate_per_s());   // THEN the last per cents count, not the mean
}

void it_turns_when_the_way_home_needs_what_is_above_the_reserve() {
    Parameters p;
    p.battery_return = 0.20F;
    Energy e{p};
    e.begin();
    std::int64_t t_us = 0;
    float left = 1.0F;
    float turned_at = -1.0F;
    const float way_m = 40.0F;
    while (turned_at < 0.0F && left > 0.0F) {
        t_us += 50000;
        left -= 0.05F / 500.0F;
        e.step(left, 0.5F, t_us);
        TEST_ASSERT_FALSE(e.must_return(5.0F) && !e.must_return(way_m));
        if (e.must_return(way_m)) { turned_at = left; }
    }
    // 40 m at 0.5 m/s are 80 s or 0.16 of this battery; the landing, turning and slack come on top
    TEST_ASSERT_TRUE(turned_at > 0.20F + 0.16F);
    TEST_ASSERT_TRUE(turned_at < 0.20F + 0.16F + 0.12F);
    Energy unknown{p};
    unknown.begin();
    for (int k = 1; k < 100; ++k) { unknown.step(-1.0F, 0.5F, k * 50000); }
    TEST_ASSERT_FALSE(unknown.must_return(1000.0F));                   // no battery monitor: nothing can be said
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(the_way_home_is_the_way_flown_until_a_loop_closes);
    RUN_TEST(a_wall_between_two_lanes_is_no_way);
    RUN_TEST(consumption_is_learned_from_whole_per_cents);
    RUN_TEST(it_turns_when_the_way_home_needs_what_is_above_the_reserve);
    return UNITY_END();
}
