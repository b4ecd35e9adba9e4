// Similarity and homography out of matches of which many are wrong.
#include <array>
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "recognise/plane_fit.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::PlaneFit;
using noctule::PlaneFitSettings;
using noctule::PointPair;

namespace {

constexpr std::array<double, 9> kTilted{0.76, -0.30, 225.0, 0.33, 1.01, -77.0, 3.5e-4, -1.4e-5, 1.0};

/// `right` pairs that follow H with 0.5 px of noise, `wrong` pairs anywhere in 640 x 480.
std::vector<PointPair> pairs_of(const std::array<double, 9>& H, const int right, const int wrong, const unsigned seed) {
    std::mt19937 rng{seed};
    std::uniform_real_distribution<double> x{0.0, 640.0};
    std::uniform_real_distribution<double> y{0.0, 480.0};
    std::normal_distribution<double> noise{0.0, 0.5};
    std::vector<PointPair> out;
    for (int k = 0; k < right + wrong; ++k) {
        const double px = x(rng);
        const double py = y(rng);
        const double w = H[6] * px + H[7] * py + H[8];
        double u = (H[0] * px + H[1] * py + H[2]) / w + noise(rng);
        double v = (H[3] * px + H[4] * py + H[5]) / w + noise(rng);
        if (k >= right) {
            u = x(rng);
            v = y(rng);
        }
        out.push_back({static_cast<float>(px), static_cast<float>(py), static_cast<float>(u), static_cast<float>(v)});
    }
    return out;
}

double corner_error(const std::array<double, 9>& a, const std::array<double, 9>& b) {
    double worst = 0.0;
    for (const double x : {0.0, 640.0}) {
        for (const double y : {0.0, 480.0}) {
            double u0 = 0.0;
            double v0 = 0.0;
            double u1 = 0.0;
            double v1 = 0.0;
            TEST_ASSERT_TRUE(noctule::map_point(a, x, y, u0, v0));
            TEST_ASSERT_TRUE(noctule::map_point(b, x, y, u1, v1));
            worst = std::fmax(worst, std::hypot(u1 - u0, v1 - v0));
        }
    }
    return worst;
}

void homography_is_found_among_twice_as_many_wrong_matches() {
    const auto fit = std::make_unique<PlaneFit>();
    for (unsigned seed = 1; seed <= 5; ++seed) {
        const auto pairs = pairs_of(kTilted, 60, 120, seed);
        TEST_ASSERT_TRUE(noctule::fit_homography(pairs, PlaneFitSettings{3.0F, 2000, 1}, *fit));
        TEST_ASSERT_TRUE(fit->inliers >= 57 && fit->inliers <= 66);
        TEST_ASSERT_TRUE(corner_error(kTilted, fit->H) < 2.0);
        for (std::size_t k = 0; k < 60; ++k) { TEST_ASSERT_TRUE(fit->agrees[k]); }
    }
}

void similarity_is_found_and_nothing_more_general() {
    const double c = 0.7 * std::cos(0.9);
    const double s = 0.7 * std::sin(0.9);
    const std::array<double, 9> H{c, -s, 40.0, s, c, -15.0, 0.0, 0.0, 1.0};
    const auto fit = std::make_unique<PlaneFit>();
    const auto pairs = pairs_of(H, 20, 60, 3);
    TEST_ASSERT_TRUE(noctule::fit_similarity(pairs, PlaneFitSettings{3.0F, 500, 1}, *fit));
    TEST_ASSERT_TRUE(fit->inliers >= 19 && fit->inliers <= 24);
    TEST_ASSERT_TRUE(corner_error(H, fit->H) < 1.5);
    TEST_ASSERT_EQUAL_DOUBLE(fit->H[0], fit->H[4]);
    TEST_ASSERT_EQUAL_DOUBLE(fit->H[1], -fit->H[3]);
}

void pictures_without_anything_in_common_agree_in_few() {
    const auto fit = std::make_unique<PlaneFit>();
    for (unsigned seed = 1; seed <= 5; ++seed) {
        const auto pairs = pairs_of(kTilted, 0, 60, seed);
        static_cast<void>(noctule::fit_similarity(pairs, PlaneFitSettings{}, *fit));
        TEST_ASSERT_TRUE(fit->inliers < 6);
    }
}

void mirrored_match_is_no_homography() {
    std::vector<PointPair> pairs;
    for (int k = 0; k < 40; ++k) {
        const float x = static_cast<float>(k % 8) * 20.0F;
        const float y = static_cast<float>(k / 8) * 25.0F;
        pairs.push_back({x, y, 200.0F - x, y});
    }
    const auto fit = std::make_unique<PlaneFit>();
    TEST_ASSERT_FALSE(noctule::fit_homography(pairs, PlaneFitSettings{}, *fit));
}

void same_matches_give_the_same_bits_and_few_matches_none() {
    const auto a = std::make_unique<PlaneFit>();
    const auto b = std::make_unique<PlaneFit>();
    const auto pairs = pairs_of(kTilted, 30, 30, 9);
    TEST_ASSERT_TRUE(noctule::fit_homography(pairs, PlaneFitSettings{}, *a));
    TEST_ASSERT_TRUE(noctule::fit_homography(pairs, PlaneFitSettings{}, *b));
    TEST_ASSERT_TRUE(a->H == b->H);
    TEST_ASSERT_FALSE(noctule::fit_homography({pairs.data(), 3}, PlaneFitSettings{}, *a));
    TEST_ASSERT_FALSE(noctule::fit_similarity({pairs.data(), 1}, PlaneFitSettings{}, *a));
    const std::vector<PointPair> one_place(12, PointPair{10.0F, 10.0F, 20.0F, 20.0F});
    TEST_ASSERT_FALSE(noctule::fit_homography(one_place, PlaneFitSettings{}, *a));
    TEST_ASSERT_FALSE(noctule::fit_similarity(one_place, PlaneFitSettings{}, *a));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(homography_is_found_among_twice_as_many_wrong_matches);
    RUN_TEST(similarity_is_found_and_nothing_more_general);
    RUN_TEST(pictures_without_anything_in_common_agree_in_few);
    RUN_TEST(mirrored_match_is_no_homography);
    RUN_TEST(same_matches_give_the_same_bits_and_few_matches_none);
    return UNITY_END();
}
