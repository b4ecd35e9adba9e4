// A sweep from a moving, tilted vehicle becomes points that lie on the walls they came from.
#include <cmath>
#include <limits>
#include <memory>

#include "sense/leveller.hpp"
#include "unit/support/planar_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

constexpr double kTurn_rad_s = 1.0;

/// A flight made by hand: constant speed along world x, constant yaw rate, constant tilt.
test::Flight turning_flight(const double roll_rad, const double pitch_rad) {
    test::Flight flight({{0.0, 0.0}, {0.1, 0.0}}, 1.0, 0.0);
    flight.states.clear();
    for (int i = 0; i <= 2000; ++i) {
        test::Truth p;
        p.t_s = 1e-3 * i;
        p.x_m = 2.0 + 1.0 * p.t_s;
        p.y_m = 2.5;
        p.yaw_rad = 0.3 + kTurn_rad_s * p.t_s;
        p.vx_m_s = 1.0;
        p.yaw_rate_rad_s = kTurn_rad_s;
        p.roll_rad = roll_rad;
        p.pitch_rad = pitch_rad;
        flight.states.push_back(p);
    }
    return flight;
}

/// Greatest distance of a levelled point from the walls of a 6 x 5 m room.
double worst_distance_m(const Parameters& parameters, const double roll_rad, const double pitch_rad) {
    test::PlanarWorld world;
    world.box(0.0, 0.0, 6.0, 5.0);
    const test::Flight flight = turning_flight(roll_rad, pitch_rad);
    test::Noise none{0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    test::Sensors sensors(world, flight, none, 1U);
    sensors.laser_height_m = static_cast<double>(parameters.lidar_z_m);
    const double t_s = 1.0;
    auto scan = std::make_unique<Scan>(sensors.scan(t_s));
    auto motion = std::make_unique<SweepMotion>();
    for (int i = 12; i >= 0; --i) {
        const test::Truth p = flight.at(t_s - 0.004 * i);
        static_cast<void>(motion->push({test::Sensors::us(t_s - 0.004 * i), p.x_m, p.y_m, p.yaw_rad, static_cast<float>(p.roll_rad), static_cast<float>(p.pitch_rad)}));
    }
    auto leveller = std::make_unique<Leveller>(parameters);
    auto level = std::make_unique<LevelScan>();
    leveller->level(*scan, *motion, HeightBounds{}, *level);
    TEST_ASSERT_EQUAL_size_t(1080, level->points.size());
    const test::Truth p = flight.at(t_s);
    double worst = 0.0;
    for (const ScanPoint& point : level->points) {
        const double c = std::cos(p.yaw_rad), s = std::sin(p.yaw_rad);
        const double x = p.x_m + c * static_cast<double>(point.x_m) - s * static_cast<double>(point.y_m);
        const double y = p.y_m + s * static_cast<double>(point.x_m) + c * static_cast<double>(point.y_m);
        const double d = std::min(std::min(std::abs(x), std::abs(x - 6.0)), std::min(std::abs(y), std::abs(y - 5.0)));
        worst = std::max(worst, d);
    }
    return worst;
}

void deskews_a_sweep_at_one_radian_a_second() {
    Parameters parameters;
    // What is left is the range's 1 mm step.
    TEST_ASSERT_TRUE(worst_distance_m(parameters, 0.0, 0.0) < 0.0012);
    parameters.deskew = 0;
    TEST_ASSERT_TRUE(worst_distance_m(parameters, 0.0, 0.0) > 0.05);
}

void compensates_tilt() {
    const Parameters parameters;
    TEST_ASSERT_TRUE(worst_distance_m(parameters, 0.2, -0.15) < 0.0012);
}

Scan flat_scan() {
    Scan scan;
    scan.t_us = 1000000;
    scan.count = 5;
    scan.bearing_first_rad = -0.2F;
    scan.bearing_increment_rad = 0.1F;
    scan.range_min_m = 0.06F;
    scan.range_max_m = 10.0F;
    scan.range_m.fill(3.0F);
    return scan;
}

void drops_beams_that_end_on_floor_or_ceiling() {
    const Parameters parameters;
    auto leveller = std::make_unique<Leveller>(parameters);
    auto level = std::make_unique<LevelScan>();
    SweepMotion motion;
    static_cast<void>(motion.push({1000000, 0.0, 0.0, 0.0, 0.0F, 0.3F}));  // nose down: 3 m forward is 0.9 m lower
    leveller->level(flat_scan(), motion, {-0.5F, 5.0F}, *level);
    TEST_ASSERT_EQUAL_size_t(0, level->points.size());
    TEST_ASSERT_EQUAL_UINT32(5U, leveller->counters().beams_floor);
    leveller->level(flat_scan(), motion, {-2.0F, 5.0F}, *level);
    TEST_ASSERT_EQUAL_size_t(5, level->points.size());
    motion.clear();
    static_cast<void>(motion.push({1000000, 0.0, 0.0, 0.0, 0.0F, -0.3F}));
    leveller->level(flat_scan(), motion, {-2.0F, 0.8F}, *level);
    TEST_ASSERT_EQUAL_UINT32(5U, leveller->counters().beams_ceiling);
}

void refuses_bad_beams_and_keeps_empty_ones() {
    const Parameters parameters;
    auto leveller = std::make_unique<Leveller>(parameters);
    auto level = std::make_unique<LevelScan>();
    SweepMotion motion;
    static_cast<void>(motion.push({1000000, 0.0, 0.0, 0.0, 0.0F, 0.0F}));
    Scan scan = flat_scan();
    scan.range_m[0] = std::nanf("");
    scan.range_m[1] = -1.0F;
    scan.range_m[2] = 11.0F;
    scan.range_m[3] = std::numeric_limits<float>::infinity();
    leveller->level(scan, motion, HeightBounds{}, *level);
    TEST_ASSERT_EQUAL_size_t(2, level->points.size());
    TEST_ASSERT_EQUAL_UINT32(3U, leveller->counters().beams_refused);
    TEST_ASSERT_FALSE(level->points[0].hit);
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 10.0F, std::hypot(level->points[0].x_m, level->points[0].y_m));
    TEST_ASSERT_EQUAL(3, level->points[0].beam);
    TEST_ASSERT_TRUE(level->points[1].hit);
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(deskews_a_sweep_at_one_radian_a_second);
    RUN_TEST(compensates_tilt);
    RUN_TEST(drops_beams_that_end_on_floor_or_ceiling);
    RUN_TEST(refuses_bad_beams_and_keeps_empty_ones);
    return UNITY_END();
}
