// The point map: a match finds the pose, knows what it does not see, and a full table gives way.
#include <cmath>
#include <memory>
#include <random>

#include "estimate/point_map.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

Matrix<float, 3, 3> doubt(const float sigma_m, const float sigma_rad) {
    Matrix<float, 3, 3> p;
    p(0, 0) = p(1, 1) = sigma_m * sigma_m;
    p(2, 2) = sigma_rad * sigma_rad;
    return p;
}

/// Points of some pillars as seen from a pose, with 1 cm noise.
MatchPoints pillars(const Pose2<Map, Body>& pose, std::mt19937& rng) {
    std::normal_distribution<float> noise(0.0F, 0.01F);
    MatchPoints points;
    const Pose2<Body, Map> inverse = pose.inverse();
    for (int k = 0; k < 6; ++k) {
        const float x0 = 3.0F * std::cos(1.1F * static_cast<float>(k)), y0 = 2.5F * std::sin(1.1F * static_cast<float>(k));
        for (int i = 0; i < 24; ++i) {
            const float a = 0.26F * static_cast<float>(i);
            static_cast<void>(points.push(inverse * Point2<Map>{x0 + 0.15F * std::cos(a) + noise(rng), y0 + 0.15F * std::sin(a) + noise(rng)}));
        }
    }
    return points;
}

void match_finds_the_pose() {
    const Parameters parameters;
    auto map = std::make_unique<PointMap>(parameters);
    std::mt19937 rng(3);
    for (int i = 0; i < 30; ++i) { map->add(0, pillars({}, rng), {}); }
    const Pose2<Map, Body> truth{0.3F, -0.2F, 0.4F};
    const Pose2<Map, Body> guess{0.36F, -0.24F, 0.42F};
    const PoseMatch match = map->match(0, pillars(truth, rng), guess, doubt(0.05F, 0.02F));
    TEST_ASSERT_TRUE(match.valid);
    TEST_ASSERT_FLOAT_WITHIN(0.015F, truth.x_m, match.pose.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.015F, truth.y_m, match.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(0.006F, truth.yaw_rad, match.pose.yaw_rad);
    // Never more certain than the floor says.
    TEST_ASSERT_TRUE(match.lambda(0, 0) <= 1.001F / (parameters.point_floor_m * parameters.point_floor_m));
}

void a_line_of_points_says_nothing_along_itself() {
    const Parameters parameters;
    auto map = std::make_unique<PointMap>(parameters);
    MatchPoints points;
    for (int k = 0; k < 10; ++k) {
        points.clear();
        for (int i = 0; i < 200; ++i) { static_cast<void>(points.push({-4.0F + 0.04F * static_cast<float>(i), 1.0F + 0.003F * static_cast<float>((i + k * k + i * k) % 3)})); }
        map->add(0, points, {});
    }
    const PoseMatch match = map->match(0, points, {}, doubt(0.05F, 0.02F));
    TEST_ASSERT_TRUE(match.valid);
    TEST_ASSERT_TRUE(match.lambda(0, 0) < 0.2F * match.lambda(1, 1));
}

void too_few_points_are_no_match() {
    const Parameters parameters;
    auto map = std::make_unique<PointMap>(parameters);
    std::mt19937 rng(3);
    TEST_ASSERT_FALSE(map->match(0, pillars({}, rng), {}, doubt(0.05F, 0.02F)).valid);  // empty map
    for (int i = 0; i < 10; ++i) { map->add(0, pillars({}, rng), {}); }
    TEST_ASSERT_FALSE(map->match(0, pillars({}, rng), {50.0F, 50.0F, 0.0F}, doubt(0.05F, 0.02F)).valid);  // nothing there
    TEST_ASSERT_EQUAL_UINT32(1U, map->counters().unmatched);
    TEST_ASSERT_FALSE(map->match(0, MatchPoints{}, {}, doubt(0.05F, 0.02F)).valid);
}

void a_full_table_gives_way_and_counts() {
    const Parameters parameters;
    auto map = std::make_unique<PointMap>(parameters);
    MatchPoints points;
    for (int i = 0; i < 120000; ++i) {
        points.clear();
        static_cast<void>(points.push({0.25F * static_cast<float>(i % 400), 0.25F * static_cast<float>(i / 400)}));
        map->add(0, points, {});
    }
    TEST_ASSERT_TRUE(map->size() <= kMaxPointCells);
    TEST_ASSERT_TRUE(map->counters().evicted > 60000U);
    map->clear(0);
    TEST_ASSERT_EQUAL_size_t(0, map->size());
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(match_finds_the_pose);
    RUN_TEST(a_line_of_points_says_nothing_along_itself);
    RUN_TEST(too_few_points_are_no_match);
    RUN_TEST(a_full_table_gives_way_and_counts);
    return UNITY_END();
}
