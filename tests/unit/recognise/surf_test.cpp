// SURF: blobs found where and as large as they are, the same points and descriptors under turn, zoom and light.
#include <cmath>
#include <memory>
#include <span>

#include "core/angle.hpp"
#include "recognise/surf_match.hpp"
#include "unit/recognise/test_image.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::Surf;
using noctule::SurfFeature;
using noctule::SurfMatch;
using noctule::SurfMatches;
using noctule::SurfPoint;
using noctule::SurfSettings;
using vision_test::Picture;
using vision_test::Similarity;
using vision_test::Texture;

namespace {

constexpr int kWidth = 320;
constexpr int kHeight = 240;

std::span<const SurfFeature> all(const Surf& surf) { return {surf.features().begin(), surf.features().size()}; }

Picture blob(const double x0, const double y0, const double sigma, const double tall) {
    Picture p{kWidth, kHeight, std::vector<std::uint8_t>(static_cast<std::size_t>(kWidth * kHeight))};
    for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) {
            const double d2 = (x - x0) * (x - x0) + (y - y0) * (y - y0);
            p.pixels[static_cast<std::size_t>(y * kWidth + x)] =
                static_cast<std::uint8_t>(std::lround(120.0 + tall * std::exp(-d2 / (2.0 * sigma * sigma))));
        }
    }
    return p;
}

void blob_is_found_where_it_is_and_as_large() {
    const auto surf = std::make_unique<Surf>();
    for (const std::int32_t step : {1, 2}) {
        for (const double sigma : {2.5, 4.0, 6.0, 9.0}) {
            for (const double tall : {100.0, -100.0}) {
                SurfSettings settings;
                settings.step_px = step;
                const Picture p = blob(150.3, 101.7, sigma, tall);
                TEST_ASSERT_TRUE(surf->extract(p.view(), settings).size() >= 1);
                const SurfPoint& best = surf->features()[0].point;
                TEST_ASSERT_FLOAT_WITHIN(0.6F, 150.3F, best.x_px);
                TEST_ASSERT_FLOAT_WITHIN(0.6F, 101.7F, best.y_px);
                // A Gaussian blob answers strongest to a box filter of about its own size: 0.70 to 0.76 of it between two layers.
                TEST_ASSERT_FLOAT_WITHIN(0.33F * static_cast<float>(sigma), static_cast<float>(sigma), best.scale_px);
                TEST_ASSERT_EQUAL(tall > 0.0, best.bright);
            }
        }
    }
}

void straight_edge_has_no_point() {
    const auto surf = std::make_unique<Surf>();
    Picture p{kWidth, kHeight, std::vector<std::uint8_t>(static_cast<std::size_t>(kWidth * kHeight))};
    for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) { p.pixels[static_cast<std::size_t>(y * kWidth + x)] = x < 160 ? 60 : 180; }
    }
    TEST_ASSERT_EQUAL_size_t(0, surf->extract(p.view(), SurfSettings{}).size());
}

struct Pair {
    int inside = 0;       // points of the first picture that the second shows, away from its border
    int repeated = 0;     // of them found there too: within 2 px and 35 % in scale
    int matches = 0;
    int correct = 0;      // matches within 3 px
    double angle_error_rad = 0.0;
};

Pair compare(const Similarity& s, const double noise, const double gain, const std::uint32_t seed) {
    const Texture texture{seed, 700, 170.0};
    const auto first = std::make_unique<Surf>();
    const auto second = std::make_unique<Surf>();
    first->extract(texture.draw(kWidth, kHeight, {1.0, 0.0, 160.0, 120.0}).view(), SurfSettings{});
    second->extract(texture.draw(kWidth, kHeight, s, noise, 2, gain).view(), SurfSettings{});
    Pair pair;
    for (const SurfFeature& a : all(*first)) {
        double x = 0.0, y = 0.0;
        s.map(static_cast<double>(a.point.x_px) - 160.0, static_cast<double>(a.point.y_px) - 120.0, x, y);
        if (x < 25.0 || y < 25.0 || x > kWidth - 25.0 || y > kHeight - 25.0) { continue; }
        ++pair.inside;
        for (const SurfFeature& b : all(*second)) {
            const double off = std::hypot(static_cast<double>(b.point.x_px) - x, static_cast<double>(b.point.y_px) - y);
            const double zoom = std::log(static_cast<double>(b.point.scale_px / a.point.scale_px) / s.scale);
            if (off < 2.0 && std::fabs(zoom) < 0.3) {
                ++pair.repeated;
                break;
            }
        }
    }
    const auto matches = std::make_unique<SurfMatches>();
    noctule::match_surf(all(*first), all(*second), 0.8F, false, *matches);
    for (const SurfMatch& m : *matches) {
        const SurfPoint& a = first->features()[static_cast<std::size_t>(m.first)].point;
        const SurfPoint& b = second->features()[static_cast<std::size_t>(m.second)].point;
        double x = 0.0, y = 0.0;
        s.map(static_cast<double>(a.x_px) - 160.0, static_cast<double>(a.y_px) - 120.0, x, y);
        ++pair.matches;
        if (std::hypot(static_cast<double>(b.x_px) - x, static_cast<double>(b.y_px) - y) > 3.0) { continue; }
        ++pair.correct;
        pair.angle_error_rad += static_cast<double>(
            std::fabs(noctule::wrap_angle(b.orientation_rad - a.orientation_rad - static_cast<float>(s.angle_rad))));
    }
    pair.angle_error_rad /= std::max(pair.correct, 1);
    return pair;
}

void points_and_descriptors_survive_turn_and_zoom() {
    for (const auto& [scale, angle] : {std::pair{1.0, 0.3}, std::pair{1.0, 1.5708}, std::pair{1.3, 0.0}, std::pair{1.3, 0.7}, std::pair{0.8, 2.5}}) {
        const Pair p = compare({scale, angle, 160.0, 120.0}, 2.0, 1.0, 3);
        TEST_ASSERT_TRUE(p.inside > 60);
        TEST_ASSERT_TRUE(10 * p.repeated > 6 * p.inside);
        TEST_ASSERT_TRUE(p.matches > 40);
        TEST_ASSERT_TRUE(100 * p.correct >= 85 * p.matches);
        TEST_ASSERT_TRUE(p.angle_error_rad < 0.2);
    }
}

void half_the_light_gives_the_same_descriptors() {
    const Pair p = compare({1.0, 0.0, 160.0, 120.0}, 0.0, 0.5, 9);
    TEST_ASSERT_TRUE(p.matches > 20);
    TEST_ASSERT_TRUE(100 * p.correct >= 95 * p.matches);
}

void descriptor_is_near_for_the_same_place_and_far_for_another() {
    const Texture texture{21, 700, 170.0};
    const auto first = std::make_unique<Surf>();
    const auto second = std::make_unique<Surf>();
    first->extract(texture.draw(kWidth, kHeight, {1.0, 0.0, 160.0, 120.0}).view(), SurfSettings{});
    second->extract(texture.draw(kWidth, kHeight, {1.0, 0.0, 163.0, 118.0}, 3.0, 5).view(), SurfSettings{});
    double same = 0.0, other = 0.0;
    int n_same = 0, n_other = 0;
    for (const SurfFeature& a : all(*first)) {
        float length = 0.0F;
        for (const float v : a.descriptor) { length += v * v; }
        TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.0F, length);
        for (const SurfFeature& b : all(*second)) {
            const bool here = std::hypot(b.point.x_px - a.point.x_px - 3.0F, b.point.y_px - a.point.y_px + 2.0F) < 1.5F &&
                              std::fabs(b.point.scale_px - a.point.scale_px) < 0.5F;
            const double d = static_cast<double>(noctule::surf_distance(a.descriptor, b.descriptor));
            (here ? same : other) += d;
            ++(here ? n_same : n_other);
        }
    }
    TEST_ASSERT_TRUE(n_same > 50);
    TEST_ASSERT_TRUE(same / n_same < 0.25);
    TEST_ASSERT_TRUE(other / n_other > 0.55);
}

void most_keeps_the_strongest_and_counts_the_others() {
    const Texture texture{4, 700, 170.0};
    const Picture p = texture.draw(kWidth, kHeight, {1.0, 0.0, 160.0, 120.0});
    const auto surf = std::make_unique<Surf>();
    SurfSettings settings;
    surf->extract(p.view(), settings);
    const std::size_t whole = surf->features().size();
    TEST_ASSERT_TRUE(whole > 60);
    const float thirtieth = surf->features()[29].point.response;
    settings.most = 30;
    surf->extract(p.view(), settings);
    TEST_ASSERT_EQUAL_size_t(30, surf->features().size());
    TEST_ASSERT_EQUAL_FLOAT(thirtieth, surf->features()[29].point.response);
    for (std::size_t i = 1; i < 30; ++i) {
        TEST_ASSERT_TRUE(surf->features()[i - 1].point.response >= surf->features()[i].point.response);
    }
    TEST_ASSERT_EQUAL_UINT32(whole - 30, surf->counters().weak_dropped);
}

void odd_and_tiny_images_are_safe() {
    const auto surf = std::make_unique<Surf>();
    const Texture texture{4, 200, 60.0};
    for (const auto& [w, h] : {std::pair{1, 1}, std::pair{8, 200}, std::pair{33, 31}, std::pair{61, 45}, std::pair{101, 67}}) {
        for (const std::int32_t step : {1, 2}) {
            SurfSettings settings;
            settings.step_px = step;
            settings.octaves = 5;
            settings.threshold = 1.0e-6F;
            const Picture p = texture.draw(w, h, {0.5, 0.0, 0.5 * w, 0.5 * h}, 10.0);
            for (const SurfFeature& f : surf->extract(p.view(), settings)) {
                TEST_ASSERT_TRUE(f.point.x_px >= 0.0F && f.point.x_px < static_cast<float>(w));
                TEST_ASSERT_TRUE(f.point.y_px >= 0.0F && f.point.y_px < static_cast<float>(h));
            }
        }
    }
    TEST_ASSERT_EQUAL_size_t(0, surf->extract({nullptr, 3, 3, 3}, SurfSettings{}).size());
    TEST_ASSERT_EQUAL_UINT32(1U, surf->counters().refused_images);
}

void ratio_test_refuses_what_looks_like_two_things() {
    std::array<SurfFeature, 3> set{};
    set[0].descriptor[0] = 1.0F;
    set[1].descriptor[0] = std::cos(0.30F);
    set[1].descriptor[1] = std::sin(0.30F);
    set[2].descriptor[2] = 1.0F;
    std::array<SurfFeature, 1> query{};
    query[0].descriptor[0] = std::cos(0.14F);  // between the first two, a little nearer to the first
    query[0].descriptor[1] = std::sin(0.14F);
    const auto matches = std::make_unique<SurfMatches>();
    noctule::match_surf(query, set, 0.8F, false, *matches);
    TEST_ASSERT_EQUAL_size_t(0, matches->size());
    noctule::match_surf(query, set, 0.95F, true, *matches);
    TEST_ASSERT_EQUAL_size_t(1, matches->size());
    TEST_ASSERT_EQUAL_INT(0, (*matches)[0].second);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.14F, (*matches)[0].distance);
    query[0].point.bright = true;  // a bright blob is never a dark one
    noctule::match_surf(query, set, 1.0F, false, *matches);
    TEST_ASSERT_EQUAL_size_t(0, matches->size());
}

void mutual_check_drops_the_second_that_claims_the_same() {
    std::array<SurfFeature, 2> set{};
    set[0].descriptor[0] = 1.0F;
    set[1].descriptor[2] = 1.0F;
    std::array<SurfFeature, 2> query{};
    query[0].descriptor[0] = std::cos(0.3F);
    query[0].descriptor[1] = std::sin(0.3F);
    query[1].descriptor[0] = 1.0F;
    const auto matches = std::make_unique<SurfMatches>();
    noctule::match_surf(query, set, 0.8F, false, *matches);
    TEST_ASSERT_EQUAL_size_t(2, matches->size());
    noctule::match_surf(query, set, 0.8F, true, *matches);
    TEST_ASSERT_EQUAL_size_t(1, matches->size());
    TEST_ASSERT_EQUAL_INT(1, (*matches)[0].first);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(blob_is_found_where_it_is_and_as_large);
    RUN_TEST(straight_edge_has_no_point);
    RUN_TEST(points_and_descriptors_survive_turn_and_zoom);
    RUN_TEST(half_the_light_gives_the_same_descriptors);
    RUN_TEST(descriptor_is_near_for_the_same_place_and_far_for_another);
    RUN_TEST(most_keeps_the_strongest_and_counts_the_others);
    RUN_TEST(odd_and_tiny_images_are_safe);
    RUN_TEST(ratio_test_refuses_what_looks_like_two_things);
    RUN_TEST(mutual_check_drops_the_second_that_claims_the_same);
    return UNITY_END();
}
