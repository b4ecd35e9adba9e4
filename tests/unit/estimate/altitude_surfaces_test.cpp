// Floors and ceilings out of the levels, stairs told from furniture, and the noise of a slow inertial stream.
#include <cmath>
#include <memory>

#include "estimate/altitude_filter.hpp"
#include "unit/estimate/altitude_profile.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using altitude_test::Flight;
using altitude_test::Sensors;
using altitude_test::Truth;
using noctule::AltitudeEstimate;
using noctule::AltitudeFilter;
using noctule::Bounded;
using noctule::kMaxSurfaces;
using noctule::Level;
using noctule::Parameters;

namespace {

const Parameters kDefaults{};
using Surfaces = Bounded<Level, kMaxSurfaces>;

void check_surface(const Level& surface, const int facing, const double z_m, const double x_min_m, const double x_max_m) {
    TEST_ASSERT_EQUAL_INT(facing, surface.facing);
    TEST_ASSERT_EQUAL(facing > 0, surface.floor);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, z_m, surface.z_m);
    TEST_ASSERT_TRUE(surface.z_var_m2 > 0.0F);
    TEST_ASSERT_TRUE(surface.z_var_m2 < 4.0e-4F);
    TEST_ASSERT_DOUBLE_WITHIN(0.3, x_min_m, surface.x_min_m);
    TEST_ASSERT_DOUBLE_WITHIN(0.3, x_max_m, surface.x_max_m);
}

void stairwell_gives_two_floors_and_two_ceilings_and_no_tread() {
    for (std::uint32_t seed = 1; seed <= 5; ++seed) {
        const auto filter = std::make_unique<AltitudeFilter>(kDefaults);
        Flight flight = altitude_test::stair_flight();
        (void)flight.run(*filter, Sensors{}, seed);
        Surfaces surfaces;
        filter->surfaces(surfaces);
        TEST_ASSERT_EQUAL_size_t(4, surfaces.size());
        check_surface(surfaces[0], 1, 0.0, 0.0, 2.0);
        check_surface(surfaces[1], -1, 2.2, 0.0, 1.5);
        check_surface(surfaces[2], 1, 2.41, 5.64, 10.0);
        check_surface(surfaces[3], -1, 4.66, 1.5, 10.0);
    }
}

void table_and_lintel_are_no_surfaces_of_the_building() {
    altitude_test::World world;
    world.ground_m = [](const double x) { return x > 1.5 && x < 3.5 ? 0.75 : 0.0; };
    world.ceiling_m = [](const double x) { return x > 4.5 && x < 4.8 ? 2.0 : 2.6; };
    Flight flight{world, {{2.5, 0.0, 1.2}, {12.0, 7.0, 0.0}}};
    const auto filter = std::make_unique<AltitudeFilter>(kDefaults);
    (void)flight.run(*filter, Sensors{}, 3);
    TEST_ASSERT_TRUE(filter->levels().size() >= 4);  // floor, table, lintel, ceiling
    Surfaces surfaces;
    filter->surfaces(surfaces);
    TEST_ASSERT_EQUAL_size_t(2, surfaces.size());
    check_surface(surfaces[0], 1, 0.0, 0.0, 7.0);
    check_surface(surfaces[1], -1, 2.6, 0.0, 7.0);
}

void stairs_are_known_on_the_third_surface_up_and_down() {
    const auto filter = std::make_unique<AltitudeFilter>(kDefaults);
    Flight flight = altitude_test::stair_flight();
    int wrong = 0;
    int on = 0;
    double lowest_floor_m = 9.0;
    double highest_floor_m = -9.0;
    (void)flight.run(*filter, Sensors{}, 2, [&](const Truth& truth, const AltitudeEstimate& e) {
        // Well inside the flight of steps, and well away from it (on the upper floor after it was recognised as one).
        if (truth.x_m > 2.9 && truth.x_m < 5.2) {
            wrong += e.on_stairs ? 0 : 1;
            ++on;
            lowest_floor_m = std::fmin(lowest_floor_m, static_cast<double>(e.floor_z_m));
            highest_floor_m = std::fmax(highest_floor_m, static_cast<double>(e.floor_z_m));
        }
        if (truth.x_m < 1.8 || truth.x_m > 7.5) { wrong += e.on_stairs ? 1 : 0; }
    });
    TEST_ASSERT_TRUE(on > 100);
    TEST_ASSERT_TRUE_MESSAGE(wrong <= 4, "stairs not told, or told where there are none");
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.0, lowest_floor_m);
    TEST_ASSERT_DOUBLE_WITHIN(0.02, 0.0, highest_floor_m);
}

void turning_round_on_the_stairs_leaves_them_stairs() {
    altitude_test::World world;
    world.ground_m = [](const double x) { return x < 1.0 ? 0.0 : std::fmin(std::floor((x - 1.0) / 0.28) + 1.0, 14.0) * 0.18; };
    world.ceiling_m = [](double) { return 4.66; };
    // Up over eight treads, then to and fro over the edge of one.
    Flight flight{world, {{2.5, 0.0, 0.88}, {2.0, 0.9, 0.0}, {8.0, 2.3, 1.0}, {2.0, -0.3, 0.0}, {2.0, 0.3, 0.0}, {2.0, -0.3, 0.0}, {2.0, 0.3, 0.0}}};
    const auto filter = std::make_unique<AltitudeFilter>(kDefaults);
    int changes = 0;
    int off = 0;
    float before_m = 0.0F;
    (void)flight.run(*filter, Sensors{}, 7, [&](const Truth& truth, const AltitudeEstimate& e) {
        if (truth.t_s < 13.5) { return; }
        off += e.on_stairs ? 0 : 1;
        changes += std::fabs(e.ground_z_m - before_m) > 0.1F ? 1 : 0;
        before_m = e.ground_z_m;
    });
    TEST_ASSERT_TRUE_MESSAGE(changes >= 4, "the scene has no turn over an edge");
    TEST_ASSERT_EQUAL_INT(0, off);
}

void tables_are_never_stairs() {
    const auto filter = std::make_unique<AltitudeFilter>(kDefaults);
    Flight flight = altitude_test::table_flight(6);
    int told = 0;
    (void)flight.run(*filter, Sensors{}, 5, [&](const Truth&, const AltitudeEstimate& e) { told += e.on_stairs ? 1 : 0; });
    TEST_ASSERT_EQUAL_INT(0, told);
}

void slow_inertial_stream_counts_as_noisier() {
    // No ranges in flight: the variance of z grows by the accelerometer alone.
    const auto variance_after = [](const int imu_hz) {
        const auto filter = std::make_unique<AltitudeFilter>(kDefaults);
        Sensors sensors;
        sensors.imu_hz = imu_hz;
        sensors.silent_s = {{0.0, 100.0}};
        Flight flight{{[](double) { return 0.0; }, [](double) { return 2.5; }}, {{2.5, 0.0, 0.88}, {3.5, 0.0, 0.0}}};
        (void)flight.run(*filter, sensors, 1);
        return static_cast<double>(filter->estimate().z_var_m2);
    };
    const double fast = variance_after(250);
    const double slow = variance_after(50);
    // Five times the density in variance; the share of the bias in it is larger, too, as it is learnt with the same noise.
    TEST_ASSERT_TRUE(slow > 2.0 * fast);
    TEST_ASSERT_TRUE(slow < 6.0 * fast);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(stairwell_gives_two_floors_and_two_ceilings_and_no_tread);
    RUN_TEST(table_and_lintel_are_no_surfaces_of_the_building);
    RUN_TEST(stairs_are_known_on_the_third_surface_up_and_down);
    RUN_TEST(turning_round_on_the_stairs_leaves_them_stairs);
    RUN_TEST(tables_are_never_stairs);
    RUN_TEST(slow_inertial_stream_counts_as_noisier);
    return UNITY_END();
}
