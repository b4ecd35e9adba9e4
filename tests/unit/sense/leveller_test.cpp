// A sweep from a moving, tilted vehicle becomes points that lie on the walls they came from.
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>

#include "core/angle.hpp"
#include "core/random.hpp"
#include "sense/leveller.hpp"
#include "sense/walls.hpp"
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

void knows_what_doubt_about_its_tilt_does() {
    // Independent route: the same sweep levelled with 300 attitudes that err as TILT_NOISE says. What moves and turns its points alike is an
    // error of the pose; what moves each wall is an error of that wall. Laser and sweep without noise, so that nothing else is left.
    Parameters parameters;
    parameters.laser_range_noise_m = 0.002F;
    parameters.laser_noise_learn = 0;
    parameters.wall_floor_m = 0.0F;
    parameters.wall_floor_rad = 0.0F;
    parameters.lidar_z_m = 0.0F;
    test::PlanarWorld world;
    world.box(0.0, 0.0, 6.0, 5.0);
    const test::Flight flight = turning_flight(0.12, -0.10);
    test::Sensors sensors(world, flight, test::Noise{0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, 1U);
    sensors.sweep_s = 0.0;
    auto scan = std::make_unique<Scan>(sensors.scan(1.0));
    auto leveller = std::make_unique<Leveller>(parameters);
    auto extractor = std::make_unique<WallExtractor>(parameters);
    auto level = std::make_unique<LevelScan>();
    const auto look = [&](const float roll_rad, const float pitch_rad) -> const WallObservations& {
        SweepMotion motion;
        static_cast<void>(motion.push({1000000, 0.0, 0.0, 0.0, roll_rad, pitch_rad}));
        leveller->level(*scan, motion, HeightBounds{}, *level);
        return extractor->extract(*level);
    };
    const WallObservations walls = look(0.12F, -0.10F);
    const auto straight = std::make_unique<LevelScan>(*level);
    TEST_ASSERT_TRUE(walls.size() >= 3);
    double claimed_m2 = 0.0, claimed_rad2 = 0.0;
    for (const WallObservation& wall : walls) {
        claimed_m2 += static_cast<double>(wall.covariance.sheared(-wall.lever_m).rho_rho) / static_cast<double>(walls.size());
        claimed_rad2 += static_cast<double>(wall.covariance.alpha_alpha) / static_cast<double>(walls.size());
    }
    Random random(3U);
    constexpr int kDraws = 300;
    double moved_m2 = 0.0, turned_rad2 = 0.0, wall_m2 = 0.0, wall_rad2 = 0.0;
    int seen = 0;
    for (int draw = 0; draw < kDraws; ++draw) {
        const WallObservations& again = look(0.12F + parameters.tilt_noise_rad * random.normal(), -0.10F + parameters.tilt_noise_rad * random.normal());
        TEST_ASSERT_EQUAL_size_t(straight->points.size(), level->points.size());
        double mx = 0.0, my = 0.0, dx = 0.0, dy = 0.0, turn = 0.0, arm2 = 0.0;
        const auto n = static_cast<double>(level->points.size());
        for (const ScanPoint& p : straight->points) {
            mx += static_cast<double>(p.x_m) / n;
            my += static_cast<double>(p.y_m) / n;
        }
        for (std::size_t i = 0; i < level->points.size(); ++i) {
            const double x = static_cast<double>(straight->points[i].x_m), y = static_cast<double>(straight->points[i].y_m);
            const double ex = static_cast<double>(level->points[i].x_m) - x, ey = static_cast<double>(level->points[i].y_m) - y;
            dx += ex / n;
            dy += ey / n;
            turn += (x - mx) * ey - (y - my) * ex;
            arm2 += (x - mx) * (x - mx) + (y - my) * (y - my);
        }
        moved_m2 += 0.5 * (dx * dx + dy * dy) / kDraws;
        turned_rad2 += turn / arm2 * turn / arm2 / kDraws;
        for (const WallObservation& wall : walls) {
            for (const WallObservation& other : again) {
                const float d_alpha = wrap_angle(other.alpha_rad - wall.alpha_rad);
                if (std::abs(d_alpha) > 0.1F || std::abs(other.rho_m - wall.rho_m) > 0.2F) { continue; }
                const double d_rho = static_cast<double>(other.rho_m - wall.rho_m - wall.lever_m * d_alpha);
                wall_m2 += d_rho * d_rho;
                wall_rad2 += static_cast<double>(d_alpha) * static_cast<double>(d_alpha);
                ++seen;
            }
        }
    }
    TEST_ASSERT_TRUE(seen > kDraws * static_cast<int>(walls.size()) * 9 / 10);
    const double m_ratio = moved_m2 / static_cast<double>(straight->tilt_m2), rad_ratio = turned_rad2 / static_cast<double>(straight->tilt_rad2);
    // Half of it, in standard deviation, counts as noise of the walls.
    const double wall_m_ratio = 0.25 * wall_m2 / seen / claimed_m2, wall_rad_ratio = 0.25 * wall_rad2 / seen / claimed_rad2;
    std::printf("moved over claimed: pose %.2f, turn %.2f; walls: offset %.2f, direction %.2f\n", m_ratio, rad_ratio, wall_m_ratio, wall_rad_ratio);
    // One number for all directions: which way the room is long makes a factor of two.
    TEST_ASSERT_TRUE(m_ratio > 0.4 && m_ratio < 2.5);
    TEST_ASSERT_TRUE(rad_ratio > 0.4 && rad_ratio < 2.5);
    TEST_ASSERT_TRUE(wall_m_ratio > 0.7 && wall_m_ratio < 1.4);
    TEST_ASSERT_TRUE(wall_rad_ratio > 0.7 && wall_rad_ratio < 1.4);

    static_cast<void>(look(0.0F, 0.0F));
    TEST_ASSERT_TRUE(level->tilt_m2 < 1e-9F);
    TEST_ASSERT_TRUE(level->tilt_rad2 < 1e-12F);
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
    RUN_TEST(knows_what_doubt_about_its_tilt_does);
    RUN_TEST(drops_beams_that_end_on_floor_or_ceiling);
    RUN_TEST(refuses_bad_beams_and_keeps_empty_ones);
    return UNITY_END();
}
