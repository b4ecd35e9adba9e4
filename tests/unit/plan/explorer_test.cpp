// Whole explorations in small worlds with perfect pose: they end, touch nothing, see everything, and come home.
#include <cmath>
#include <cstdio>
#include <memory>

#include "unit/plan/closed_world.hpp"
#include "unit/plan/closed_world_score.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;
using test::ClosedLoop;
using test::FlatWorld;

namespace {

constexpr double kTurn = 0.297;   // 17 degrees: walls off the grid's lines

void expect_explored(const FlatWorld& world, const double most_s, const double least_share, const unsigned seed) {
    const Parameters p;
    const auto loop = std::make_unique<ClosedLoop>(p, world, seed);
    loop->pose_noise_m = 0.01;
    const test::Result r = test::fly(*loop, most_s);
    const double share = test::explored_share(world, loop->grid, loop->range_max_m);
    const auto c = loop->mission.explorer().counters();
    std::printf("  %.0f s, %.0f m, nearest %.3f m, home within %.2f m, seen %.4f, goals %u, switched %u, in vain %u\n", r.time_s, r.length_m,
                r.least_clearance_m - static_cast<double>(p.hull_radius_m), r.home_error_m, share, c.goals, c.policy.switches, c.policy.in_vain);
    TEST_ASSERT_TRUE_MESSAGE(r.completed, "did not complete");
    TEST_ASSERT_TRUE_MESSAGE(r.least_clearance_m > static_cast<double>(p.hull_radius_m), "touched something");
    TEST_ASSERT_TRUE_MESSAGE(share >= least_share, "saw too little");
    TEST_ASSERT_TRUE_MESSAGE(r.home_error_m < 0.3, "landed away from the start");
    TEST_ASSERT_TRUE_MESSAGE(loop->fastest < 1.3 * static_cast<double>(p.speed_max_m_s), "too fast");
}

/// Three rooms in a row, doors of the given width in the walls between, a dead end.
FlatWorld rooms(const double door_m) {
    FlatWorld w;
    w.add_wall(-2.0, -2.5, 8.0, -2.5);
    w.add_wall(-2.0, 2.0, 8.0, 2.0);
    w.add_wall(-2.0, -2.5, -2.0, 2.0);
    w.add_wall(8.0, -2.5, 8.0, 2.0);
    w.add_wall(1.5, -2.5, 1.5, -1.0);
    w.add_wall(1.5, -1.0 + door_m, 1.5, 2.0);
    w.add_wall(4.8, -2.5, 4.8, 0.3);
    w.add_wall(4.8, 0.3 + door_m, 4.8, 2.0);
    w.add_wall(6.2, -2.5, 6.2, 0.0);
    w.turn(kTurn);
    return w;
}

void rooms_with_doors_of_0_9_m() { expect_explored(rooms(0.90), 240.0, 0.98, 1); }

void rooms_with_doors_of_0_8_m() { expect_explored(rooms(0.80), 300.0, 0.97, 2); }

// In a door the laser of 270 degrees sees both sides, wherever the vehicle would look otherwise.
void in_a_door_the_nose_is_near_the_way() {
    const Parameters p;
    const FlatWorld world = rooms(0.80);
    const auto loop = std::make_unique<ClosedLoop>(p, world, 3U);
    for (int k = 0; k < 60 && !loop->mission.ready(); ++k) { loop->step(); }
    loop->step(Order::start);
    int narrow = 0;
    while (loop->time_s() < 200.0 && loop->mission.state() != MissionState::landed) {
        loop->step();
        const auto& path = loop->target.path;
        if (loop->mission.state() != MissionState::exploring || path.size() < 2U) { continue; }
        float gone_m = 0.0F;
        float least_m = path[0].clearance_m;
        float heading_rad = 0.0F;
        for (std::size_t k = 1; k < path.size() && gone_m < 0.8F; ++k) {
            if (gone_m < 0.3F) { heading_rad = std::atan2(path[k].y_m - path[0].y_m, path[k].x_m - path[0].x_m); }
            gone_m += std::hypot(path[k].x_m - path[k - 1U].x_m, path[k].y_m - path[k - 1U].y_m);
            least_m = std::min(least_m, path[k].clearance_m);
        }
        const PathPoint& end = path.back();
        if (std::hypot(end.x_m - loop->estimate().planar.pose_map_body.x_m, end.y_m - loop->estimate().planar.pose_map_body.y_m) < 0.35F || least_m > 0.41F) { continue; }
        ++narrow;
        TEST_ASSERT_TRUE(std::fabs(wrap_angle(loop->target.yaw_rad - heading_rad)) < 0.7F);
    }
    TEST_ASSERT_TRUE(narrow > 50);
}

void pillars_and_dead_ends() {
    FlatWorld w;
    w.add_wall(-1.5, -3.0, 6.0, -3.0);
    w.add_wall(-1.5, 3.0, 6.0, 3.0);
    w.add_wall(-1.5, -3.0, -1.5, 3.0);
    w.add_wall(6.0, -3.0, 6.0, 3.0);
    w.add_pillar(1.8, 0.6, 0.25);
    w.add_pillar(3.2, -1.1, 0.25);
    w.add_pillar(4.3, 1.3, 0.15);
    w.add_wall(2.2, -3.0, 2.2, -1.7);
    w.add_wall(0.4, 3.0, 0.4, 1.3);
    w.add_wall(0.4, 1.3, 1.2, 1.3);
    w.turn(kTurn);
    expect_explored(w, 240.0, 0.97, 3);
}

void a_closed_cell_is_finished_at_once() {
    FlatWorld w;
    w.add_wall(-1.2, -1.2, 1.2, -1.2);
    w.add_wall(1.2, -1.2, 1.2, 1.2);
    w.add_wall(1.2, 1.2, -1.2, 1.2);
    w.add_wall(-1.2, 1.2, -1.2, -1.2);
    w.turn(kTurn);
    expect_explored(w, 60.0, 0.99, 4);
}

void the_unknown_behind_the_edges_shrinks_to_nothing() {
    const FlatWorld w = rooms(0.90);
    const Parameters p;
    const auto loop = std::make_unique<ClosedLoop>(p, w, 5);
    TEST_ASSERT_EQUAL_INT32(-1, loop->mission.explorer().behind_cells());
    std::int32_t most = 0;
    for (double t_s = 2.0; t_s < 40.0; t_s += 2.0) {
        static_cast<void>(test::fly(*loop, t_s));
        most = std::max(most, loop->mission.explorer().behind_cells());
    }
    TEST_ASSERT_GREATER_THAN_INT32(100, most);  // the first room has one door: more than 1 m2 shows behind it
    TEST_ASSERT_TRUE(test::fly(*loop, 240.0).completed);
    TEST_ASSERT_LESS_THAN_INT32(60, loop->mission.explorer().behind_cells());
}

void the_same_run_twice_is_the_same_to_the_bit() {
    const FlatWorld w = rooms(0.90);
    const Parameters p;
    double x[2] = {};
    double length[2] = {};
    for (int k = 0; k < 2; ++k) {
        const auto loop = std::make_unique<ClosedLoop>(p, w, 9);
        loop->pose_noise_m = 0.01;
        static_cast<void>(test::fly(*loop, 40.0));
        x[k] = loop->x;
        length[k] = loop->length;
    }
    TEST_ASSERT_TRUE(x[0] == x[1] && length[0] == length[1]);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(rooms_with_doors_of_0_9_m);
    RUN_TEST(rooms_with_doors_of_0_8_m);
    RUN_TEST(in_a_door_the_nose_is_near_the_way);
    RUN_TEST(pillars_and_dead_ends);
    RUN_TEST(a_closed_cell_is_finished_at_once);
    RUN_TEST(the_unknown_behind_the_edges_shrinks_to_nothing);
    RUN_TEST(the_same_run_twice_is_the_same_to_the_bit);
    return UNITY_END();
}
