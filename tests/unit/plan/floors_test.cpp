// Whole missions with what is over and under the vehicle: openings are found wherever they are, gone through, refused, turned back from.
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

constexpr double kUndersideM = 2.4;
constexpr double kUpperM = 2.6;
constexpr double kRoofM = 5.0;
constexpr double kSmall = 0.6;
constexpr double kScale = kMaxTiles < 32U ? kSmall : 1.0;   ///< of the hall: two floors of it have to fit the tiles of the capacity profile

/// A square opening in the slab between two floors, turned.
struct Opening {
    double x, y, side, turn;
    [[nodiscard]] bool holds(const double at_x, const double at_y) const {
        const double u = std::cos(turn) * (at_x - x) + std::sin(turn) * (at_y - y);
        const double v = -std::sin(turn) * (at_x - x) + std::cos(turn) * (at_y - y);
        return std::max(std::fabs(u), std::fabs(v)) < side / 2.0;
    }
};

/// A mission in a hall whose slab has that opening.
struct Flight {
    Parameters p;
    FlatWorld world;
    ClosedLoop loop;

    /// An opening's place is that in the hall of full size.
    explicit Flight(Opening opening, const unsigned seed = 3U, const double scale = kScale) : world(test::hall(scale)), loop(p, world, seed) {
        opening.x *= scale;
        opening.y *= scale;
        p.floor_search_s = 600.0F;   // the search is flown to its end
        loop.slab_m = kUpperM;
        loop.over_m = [opening](const double x, const double y, const double z) { return z > kUndersideM || opening.holds(x, y) ? kRoofM : kUndersideM; };
        loop.under_m = [opening](const double x, const double y, const double z) { return z > kUpperM && !opening.holds(x, y) ? kUpperM : 0.0; };
    }
    /// Flies until it has landed, or shifts to another floor for the first time; true: that.
    bool until_shift() {
        for (int k = 0; k < 60 && !loop.mission.ready(); ++k) { loop.step(); }
        loop.step(Order::start);
        while (loop.time_s() < 600.0 && loop.mission.state() != MissionState::landed) {
            loop.step();
            if (loop.mission.floors().shifting()) { return true; }
        }
        return false;
    }
    void until_landed(const double most_s) {
        while (loop.time_s() < most_s && loop.mission.state() != MissionState::landed && loop.mission.state() != MissionState::aborted) {
            loop.step();
            if (loop.mission.state() == MissionState::changing_floor) { slowest_us = std::max(slowest_us, loop.plan_us); }
        }
    }
    double slowest_us = 0.0;   ///< processor time of a step on the way to another floor (told, never judged)
};

void openings_are_found_wherever_they_are() {
    // In the corners, behind the wall, in the middle: frame of the turned hall.
    for (Opening o : {Opening{2.0, -1.6, 1.5, 0.9}, {7.2, 5.4, 1.5, 0.9}, {7.4, 0.6, 1.5, 0.2}, {-0.6, 4.0, 1.5, 0.5}, {4.0, 4.5, 3.0, 0.2}}) {
        const auto flight = std::make_unique<Flight>(o);
        TEST_ASSERT_TRUE_MESSAGE(flight->until_shift(), "an opening was missed");
        std::printf("  %.1f m at (%.1f, %.1f): after %.0f s, from (%.2f, %.2f)\n", o.side, o.x, o.y, flight->loop.time_s(), flight->loop.x, flight->loop.y);
        o.x *= kScale;
        o.y *= kScale;
        for (double a = 0.0; a < 6.2; a += 0.5) {   // the whole hull is under it
            const double hull_m = static_cast<double>(flight->p.hull_radius_m);
            TEST_ASSERT_TRUE(o.holds(flight->loop.x + hull_m * std::cos(a), flight->loop.y + hull_m * std::sin(a)));
        }
    }
}

// In the corner of a small hall there is one place to go through, and from some of the spots to look from the hull fits beside the cell's middle only.
void an_opening_is_found_where_the_hull_only_just_fits() {
    for (const unsigned seed : {3U, 6U, 11U}) {
        const auto flight = std::make_unique<Flight>(Opening{2.0, -1.6, 1.5, 0.9}, seed, kSmall);
        TEST_ASSERT_TRUE_MESSAGE(flight->until_shift(), "the opening was missed");
        std::printf("  seed %u: after %.0f s\n", seed, flight->loop.time_s());
    }
}

void both_floors_are_explored_and_it_lands_at_home() {
    const auto flight = std::make_unique<Flight>(Opening{5.0, 4.0, 1.8, 0.4});
    TEST_ASSERT_TRUE(flight->until_shift());
    flight->until_landed(900.0);
    const FloorPlanner& floors = flight->loop.mission.floors();
    std::printf("  %.0f s, %.0f m; slowest step while changing floors %.1f ms\n", flight->loop.time_s(), flight->loop.length, 1e-3 * flight->slowest_us);
    TEST_ASSERT_TRUE(flight->loop.mission.state() == MissionState::landed);
    TEST_ASSERT_TRUE(flight->loop.mission.reason() == StateReason::on_ground);
    TEST_ASSERT_EQUAL_UINT32(2U, floors.floors().size());
    TEST_ASSERT_TRUE(floors.floors()[1].confirmed && !floors.floors()[1].empty);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, static_cast<float>(kUpperM), floors.floors()[1].elevation_m);
    TEST_ASSERT_EQUAL_INT32(0, floors.current());
    TEST_ASSERT_TRUE(std::hypot(flight->loop.x, flight->loop.y) < 0.3);
    TEST_ASSERT_TRUE(flight->loop.least_clearance > static_cast<double>(flight->p.hull_radius_m));
}

void an_opening_that_closes_over_the_vehicle_is_left_again() {
    Opening o{5.0, 4.0, 1.8, 0.4};
    const auto flight = std::make_unique<Flight>(o);
    o.x *= kScale;
    o.y *= kScale;
    TEST_ASSERT_TRUE(flight->until_shift());
    double highest = 0.0;
    flight->loop.over_m = [o](const double x, const double y, const double) { return o.holds(x, y) ? 2.5 : kUndersideM; };   // something lies over it now
    for (int k = 0; k < 400 && flight->loop.mission.floors().shifting(); ++k) {
        flight->loop.step();
        highest = std::max(highest, flight->loop.z);
    }
    const auto& judged = flight->loop.mission.floors().judged();
    TEST_ASSERT_TRUE(highest < 2.5 - 0.5 * static_cast<double>(flight->p.hull_height_m));
    TEST_ASSERT_FALSE(flight->loop.mission.floors().shifting());
    TEST_ASSERT_EQUAL_UINT32(1U, judged.size());
    TEST_ASSERT_TRUE(judged[0].why == FloorPlanner::Refusal::clearance_gone);
    TEST_ASSERT_EQUAL_INT32(0, flight->loop.mission.floors().layer());
    flight->until_landed(900.0);
    TEST_ASSERT_TRUE(flight->loop.mission.state() == MissionState::landed && std::hypot(flight->loop.x, flight->loop.y) < 0.3);
}

void an_opening_that_is_too_small_is_refused() {
    const auto flight = std::make_unique<Flight>(Opening{3.0, 3.0, 1.0, 0.4});
    TEST_ASSERT_FALSE(flight->until_shift());
    TEST_ASSERT_TRUE(flight->loop.mission.state() == MissionState::landed);
    for (const FloorPlanner::Judged& j : flight->loop.mission.floors().judged()) { TEST_ASSERT_TRUE(j.why == FloorPlanner::Refusal::too_small); }
}

void a_whole_ceiling_ends_the_search_and_leads_home() {
    const auto flight = std::make_unique<Flight>(Opening{100.0, 100.0, 1.0, 0.0});
    TEST_ASSERT_FALSE(flight->until_shift());
    const OccupancyGrid& grid = flight->loop.grid;
    const Traversability& where = flight->loop.mission.explorer().where();
    int all = 0;
    int left = 0;
    for (std::int32_t id = 0; id < grid.tile_count() * kTileArea; ++id) {
        if (!where.passable(id) || where.clearance_cm(id) < 45) { continue; }
        ++all;
        left += flight->loop.mission.floors().soundings().distance_m(id) > 0.5F * flight->p.floor_search_fine_m ? 1 : 0;
    }
    std::printf("  %.0f s, %.0f m; %d of %d cells not passed\n", flight->loop.time_s(), flight->loop.length, left, all);
    TEST_ASSERT_TRUE(flight->loop.mission.state() == MissionState::landed);
    TEST_ASSERT_TRUE(std::hypot(flight->loop.x, flight->loop.y) < 0.3);
    TEST_ASSERT_TRUE(all > static_cast<int>(5000.0 * kScale * kScale * kScale));   // the rim that is not passable does not shrink
    TEST_ASSERT_TRUE(left < all / 20);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(openings_are_found_wherever_they_are);
    if (kScale > kSmall) { RUN_TEST(an_opening_is_found_where_the_hull_only_just_fits); }   // else the test before was it
    RUN_TEST(both_floors_are_explored_and_it_lands_at_home);
    RUN_TEST(an_opening_that_closes_over_the_vehicle_is_left_again);
    RUN_TEST(an_opening_that_is_too_small_is_refused);
    RUN_TEST(a_whole_ceiling_ends_the_search_and_leads_home);
    return UNITY_END();
}
