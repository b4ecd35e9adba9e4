// Wall extraction in scenes, and its covariance against the spread of many noisy sweeps.
#include <cmath>
#include <memory>

#include "core/angle.hpp"
#include "sense/leveller.hpp"
#include "sense/walls.hpp"
#include "unit/support/planar_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

/// One sweep from a vehicle that stands still, levelled and searched for walls.
class Eye {
public:
    Eye(const test::PlanarWorld& world, const double x_m, const double y_m, const double yaw_rad, const double range_noise_m, const std::uint32_t seed,
        const Parameters& parameters)
        : flight_({{x_m, y_m}, {x_m + std::cos(yaw_rad), y_m + std::sin(yaw_rad)}}, 0.5, 0.1),
          sensors_(world, flight_, test::Noise{range_noise_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, seed),
          leveller(parameters),
          extractor(parameters) {
        flight_.states.resize(1);
        static_cast<void>(motion_.push({test::Sensors::us(0.0), 0.0, 0.0, 0.0, 0.0F, 0.0F}));
    }
    const WallObservations& look() {
        const Scan scan = sensors_.scan(0.0);
        leveller.level(scan, motion_, HeightBounds{}, level);
        return extractor.extract(level);
    }

private:
    test::Flight flight_;
    test::Sensors sensors_;
    SweepMotion motion_;

public:
    Leveller leveller;
    WallExtractor extractor;
    LevelScan level;
};

Parameters standing() {
    Parameters parameters;
    parameters.lidar_z_m = 0.0F;
    return parameters;
}

/// The observation nearest to a line given by hand, or nullptr.
const WallObservation* find(const WallObservations& walls, const float rho_m, const float alpha_rad) {
    for (const WallObservation& wall : walls) {
        if (std::abs(wall.rho_m - rho_m) < 0.05F && std::abs(wrap_angle(wall.alpha_rad - alpha_rad)) < 0.05F) { return &wall; }
    }
    return nullptr;
}

void finds_the_four_walls_of_a_room(const std::int32_t method) {
    Parameters parameters = standing();
    parameters.wall_method = method;
    test::PlanarWorld world;
    world.box(0.0, 0.0, 6.0, 4.0);
    auto eye = std::make_unique<Eye>(world, 4.0, 1.5, 0.0, 0.01, 3U, parameters);
    const WallObservations& walls = eye->look();
    // Nose along +x: ahead at 2 m, left at 2.5 m, right at 1.5 m; behind at 4 m in two pieces beside the blind sector at most.
    for (const auto& [rho_m, alpha_rad] : {std::pair{2.0F, 0.0F}, std::pair{2.5F, 0.5F * kPi}, std::pair{1.5F, -0.5F * kPi}}) {
        const WallObservation* wall = find(walls, rho_m, alpha_rad);
        TEST_ASSERT_NOT_NULL(wall);
        TEST_ASSERT_FLOAT_WITHIN(0.006F, rho_m, wall->rho_m);
        TEST_ASSERT_TRUE(std::abs(wrap_angle(wall->alpha_rad - alpha_rad)) < 0.006F);
    }
    const WallObservation* ahead = find(walls, 2.0F, 0.0F);
    TEST_ASSERT_FLOAT_WITHIN(0.06F, -1.5F, ahead->from_m);  // ends at the corners
    TEST_ASSERT_FLOAT_WITHIN(0.06F, 2.5F, ahead->to_m);
    TEST_ASSERT_TRUE(walls.size() <= 6);
}

void split_and_merge_finds_a_room() { finds_the_four_walls_of_a_room(0); }
void ransac_finds_a_room() { finds_the_four_walls_of_a_room(1); }

void keeps_a_wall_whole_and_two_offset_walls_apart() {
    const Parameters parameters = standing();
    test::PlanarWorld world;
    world.segments.push_back({-3.0, 2.0, 0.0, 2.0});
    world.segments.push_back({0.0, 2.0, 0.0, 2.12});  // a step of 12 cm
    world.segments.push_back({0.0, 2.12, 3.0, 2.12});
    for (std::uint32_t seed = 1; seed <= 20; ++seed) {
        auto eye = std::make_unique<Eye>(world, -0.4, 0.0, 0.0, 0.01, seed, parameters);
        const WallObservations& walls = eye->look();
        TEST_ASSERT_NOT_NULL(find(walls, 2.0F, 0.5F * kPi));
        TEST_ASSERT_NOT_NULL(find(walls, 2.12F, 0.5F * kPi));
        TEST_ASSERT_EQUAL_size_t(2, walls.size());
    }
}

void round_walls_are_no_walls() {
    const Parameters parameters = standing();
    test::PlanarWorld world;
    world.circles.push_back({0.0, 0.0, 3.0});
    std::size_t walls = 0;
    for (std::uint32_t seed = 1; seed <= 20; ++seed) {
        auto eye = std::make_unique<Eye>(world, 0.5, 0.3, 0.0, 0.01, seed, parameters);
        walls += eye->look().size();
        TEST_ASSERT_TRUE(eye->extractor.counters().round_refused + eye->extractor.counters().rough_refused > 0U);
    }
}

void labels_the_points_of_each_wall() {
    const Parameters parameters = standing();
    test::PlanarWorld world;
    world.box(0.0, 0.0, 6.0, 4.0);
    world.circles.push_back({4.8, 2.0, 0.15});
    auto eye = std::make_unique<Eye>(world, 3.0, 2.0, 0.0, 0.01, 5U, parameters);
    const WallObservations& walls = eye->look();
    for (std::size_t i = 0; i < eye->level.points.size(); ++i) {
        const ScanPoint& p = eye->level.points[i];
        const std::int16_t owner = eye->extractor.wall_of_point()[i];
        if (std::abs(p.y_m) < 0.1F && p.x_m > 1.0F && p.x_m < 2.5F) { TEST_ASSERT_EQUAL(-1, owner); }  // the pillar
        if (owner < 0) { continue; }
        const WallObservation& wall = walls[static_cast<std::size_t>(owner)];
        TEST_ASSERT_TRUE(std::abs(p.x_m * std::cos(wall.alpha_rad) + p.y_m * std::sin(wall.alpha_rad) - wall.rho_m) < 0.04F);
    }
}

void covariance_matches_the_spread_of_many_sweeps() {
    // Independent route: 600 sweeps with fresh noise; a wall seen off to one side, so that rho and alpha are correlated.
    Parameters parameters = standing();
    parameters.laser_bearing_noise_rad = 0.0F;
    parameters.wall_floor_m = 0.0F;
    parameters.wall_floor_rad = 0.0F;
    test::PlanarWorld world;
    world.segments.push_back({1.0, 2.0, 3.5, 2.0});
    double rr = 0.0, ra = 0.0, aa = 0.0, mm = 0.0;  // mm: across the wall at its middle
    LineCovariance claimed;
    int n = 0;
    auto eye = std::make_unique<Eye>(world, 0.0, 0.0, 0.0, 0.01, 11U, parameters);
    double mean_r = 0.0, mean_a = 0.0, mean_m = 0.0, claimed_m = 0.0;
    for (int i = 0; i < 600; ++i) {
        const WallObservations& walls = eye->look();
        const WallObservation* wall = find(walls, 2.0F, 0.5F * kPi);
        TEST_ASSERT_NOT_NULL(wall);
        const double r = static_cast<double>(wall->rho_m) - 2.0;
        const double a = static_cast<double>(wrap_angle(wall->alpha_rad - 0.5F * kPi));
        mean_r += r;
        mean_a += a;
        rr += r * r;
        ra += r * a;
        aa += a * a;
        const double m = r - static_cast<double>(wall->lever_m) * a;
        mean_m += m;
        mm += m * m;
        claimed_m += static_cast<double>(wall->covariance.sheared(-wall->lever_m).rho_rho) / 600.0;
        claimed = claimed + wall->covariance;
        ++n;
    }
    mean_r /= n;
    mean_a /= n;
    rr = rr / n - mean_r * mean_r;
    ra = ra / n - mean_r * mean_a;
    aa = aa / n - mean_a * mean_a;
    mm = mm / n - mean_m * mean_m / n / n;
    claimed = claimed.scaled(1.0F / static_cast<float>(n));
    TEST_ASSERT_TRUE(std::abs(mean_r) < 5e-4);
    TEST_ASSERT_TRUE(rr / static_cast<double>(claimed.rho_rho) > 0.7 && rr / static_cast<double>(claimed.rho_rho) < 1.4);
    TEST_ASSERT_TRUE(aa / static_cast<double>(claimed.alpha_alpha) > 0.7 && aa / static_cast<double>(claimed.alpha_alpha) < 1.4);
    TEST_ASSERT_TRUE(ra / static_cast<double>(claimed.rho_alpha) > 0.7 && ra / static_cast<double>(claimed.rho_alpha) < 1.4);
    TEST_ASSERT_TRUE(mm / claimed_m > 0.7 && mm / claimed_m < 1.4);
}

void more_walls_than_fit_lose_the_shortest() {
    Parameters parameters = standing();
    parameters.wall_length_min_m = 0.05F;
    parameters.wall_points_min = 4;
    test::PlanarWorld world;
    for (int i = 0; i < 80; ++i) {  // a crown of short plates
        const double a = -2.3 + 4.6 * i / 79.0;
        const double r = i % 2 == 0 ? 2.0 : 3.0;
        const double x = r * std::cos(a), y = r * std::sin(a), tx = -0.04 * std::sin(a + 0.3), ty = 0.04 * std::cos(a + 0.3);
        world.segments.push_back({x - tx, y - ty, x + tx, y + ty});
    }
    auto eye = std::make_unique<Eye>(world, 0.0, 0.0, 0.0, 0.0, 1U, parameters);
    const WallObservations& walls = eye->look();
    TEST_ASSERT_EQUAL_size_t(kMaxWallsPerScan, walls.size());
    TEST_ASSERT_TRUE(eye->extractor.counters().too_many > 0U);
    for (std::size_t i = 1; i < walls.size(); ++i) { TEST_ASSERT_TRUE(walls[i - 1].points >= walls[i].points); }
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(split_and_merge_finds_a_room);
    RUN_TEST(ransac_finds_a_room);
    RUN_TEST(keeps_a_wall_whole_and_two_offset_walls_apart);
    RUN_TEST(round_walls_are_no_walls);
    RUN_TEST(labels_the_points_of_each_wall);
    RUN_TEST(covariance_matches_the_spread_of_many_sweeps);
    RUN_TEST(more_walls_than_fit_lose_the_shortest);
    return UNITY_END();
}
