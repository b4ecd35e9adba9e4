// How high the mission flies: over floors, furniture and stairs, and under low ceilings.
#include <cmath>
#include <limits>
#include <memory>

#include "plan/mission.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// Height that the mission asks for, in flight, of a vehicle that sees this.
float height_m(const float floor_m, const float ground_m, const float ceiling_m, const bool on_stairs, const std::int32_t floors_max = 8) {
    static Parameters p;
    p.floors_max = floors_max;
    const auto room = std::make_unique<OccupancyGrid>(p);
    const OccupancyGrid& grid = *room;
    const auto mission = std::make_unique<Mission>(p);
    Estimate estimate;
    estimate.planar.quality = 80;
    estimate.altitude.valid = true;
    estimate.altitude.floor_z_m = floor_m;
    estimate.altitude.ground_z_m = ground_m;
    estimate.altitude.ceiling_z_m = ceiling_m;
    estimate.altitude.on_stairs = on_stairs;
    VehicleSample vehicle;
    vehicle.landed = VehicleSample::Landed::on_ground;
    Bounded<CommandSample, kMaxCommandPerStep> orders;
    float z_m = std::numeric_limits<float>::quiet_NaN();
    for (std::int64_t t_us = 50000; t_us <= 5000000; t_us += 50000) {
        orders.clear();
        if (mission->ready() && mission->state() == MissionState::waiting) {
            static_cast<void>(orders.push({t_us, Order::start}));
            vehicle.armed = vehicle.offboard = true;
        }
        estimate.t_us = vehicle.t_us = t_us;
        z_m = mission->step(estimate, grid, vehicle, orders, Pose2<Map, Body>{}, t_us).z_m;
    }
    TEST_ASSERT_EQUAL(MissionState::taking_off, mission->state());
    return z_m;
}

void furniture_does_not_lift_the_vehicle_unless_it_must() {
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.0F, height_m(0.0F, 0.0F, 2.5F, false));
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.0F, height_m(0.0F, 0.55F, 2.5F, false));
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.2F, height_m(0.0F, 0.90F, 2.5F, false));   // hull half and vertical clearance over a counter
}

void treads_are_passed_at_half_a_metre_once_the_lower_floor_allows_no_more() {
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.0F, height_m(0.0F, 0.36F, 5.0F, true));
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.04F, height_m(0.0F, 0.54F, 5.0F, true));
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 2.64F, height_m(0.0F, 2.14F, 5.0F, true));
}

void stairs_down_to_a_floor_not_yet_seen_are_followed_by_their_treads_where_there_is_one_floor_only() {
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, -0.5F, height_m(0.0F, -1.0F, 2.5F, true, 1));
}

void what_is_seen_through_an_opening_does_not_lower_the_vehicle() {
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.0F, height_m(0.0F, -1.0F, 2.5F, true));    // treads in the opening
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.0F, height_m(-2.7F, -2.7F, 2.5F, false));  // the floor below, taken for the floor
}

void low_ceiling_wins() {
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.9F, height_m(0.0F, 0.0F, 1.2F, false));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(furniture_does_not_lift_the_vehicle_unless_it_must);
    RUN_TEST(treads_are_passed_at_half_a_metre_once_the_lower_floor_allows_no_more);
    RUN_TEST(stairs_down_to_a_floor_not_yet_seen_are_followed_by_their_treads_where_there_is_one_floor_only);
    RUN_TEST(what_is_seen_through_an_opening_does_not_lower_the_vehicle);
    RUN_TEST(low_ceiling_wins);
    return UNITY_END();
}
