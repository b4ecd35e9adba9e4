// Sums over rectangles against sums pixel by pixel.
#include <memory>
#include <random>

#include "recognise/integral_image.hpp"
#include "unit/recognise/test_image.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::IntegralImage;

namespace {

vision_test::Picture random_picture(const int width, const int height, const std::uint32_t seed) {
    std::mt19937 rng{seed};
    vision_test::Picture p{width, height, {}};
    for (int i = 0; i < width * height; ++i) { p.pixels.push_back(static_cast<std::uint8_t>(rng() % 256U)); }
    return p;
}

int naive(const vision_test::Picture& p, const int r0, const int c0, const int r1, const int c1) {
    int sum = 0;
    for (int y = std::max(r0, 0); y < std::min(r1, p.height); ++y) {
        for (int x = std::max(c0, 0); x < std::min(c1, p.width); ++x) { sum += p.pixels[static_cast<std::size_t>(y * p.width + x)]; }
    }
    return sum;
}

void any_rectangle_equals_the_naive_sum() {
    const auto image = std::make_unique<IntegralImage>();
    std::mt19937 rng{5};
    for (const auto& [w, h] : {std::pair{37, 23}, std::pair{1, 1}, std::pair{64, 3}, std::pair{2, 50}}) {
        const vision_test::Picture p = random_picture(w, h, 11);
        TEST_ASSERT_TRUE(image->build(p.view()));
        for (int i = 0; i < 200; ++i) {
            const int r0 = static_cast<int>(rng() % static_cast<unsigned>(h + 1));
            const int c0 = static_cast<int>(rng() % static_cast<unsigned>(w + 1));
            const int r1 = r0 + static_cast<int>(rng() % static_cast<unsigned>(h - r0 + 1));
            const int c1 = c0 + static_cast<int>(rng() % static_cast<unsigned>(w - c0 + 1));
            TEST_ASSERT_EQUAL_INT(naive(p, r0, c0, r1, c1), image->sum(r0, c0, r1, c1));
        }
    }
}

void rectangles_over_the_border_are_cut() {
    const auto image = std::make_unique<IntegralImage>();
    const vision_test::Picture p = random_picture(20, 15, 3);
    TEST_ASSERT_TRUE(image->build(p.view()));
    for (const auto& [r0, c0, r1, c1] : {std::array{-5, -5, 3, 4}, std::array{10, 15, 40, 40}, std::array{-9, -9, -2, -2}, std::array{-3, -3, 90, 90}}) {
        TEST_ASSERT_EQUAL_INT(naive(p, r0, c0, r1, c1), image->sum_clipped(r0, c0, r1, c1));
    }
}

void rows_with_padding_are_read_with_their_stride() {
    const auto image = std::make_unique<IntegralImage>();
    const vision_test::Picture p = random_picture(20, 15, 3);
    TEST_ASSERT_TRUE(image->build({p.pixels.data(), 12, 15, 20}));
    int sum = 0;
    for (int y = 0; y < 15; ++y) {
        for (int x = 0; x < 12; ++x) { sum += p.pixels[static_cast<std::size_t>(y * 20 + x)]; }
    }
    TEST_ASSERT_EQUAL_INT(sum, image->sum(0, 0, 15, 12));
}

void images_that_do_not_fit_are_refused() {
    const auto image = std::make_unique<IntegralImage>();
    const std::uint8_t pixel = 7;
    TEST_ASSERT_FALSE(image->build({nullptr, 4, 4, 4}));
    TEST_ASSERT_FALSE(image->build({&pixel, 0, 1, 1}));
    TEST_ASSERT_FALSE(image->build({&pixel, 4, 4, 3}));
    TEST_ASSERT_FALSE(image->build({&pixel, 2000, 2, 2000}));
    TEST_ASSERT_FALSE(image->build({&pixel, 1200, 1200, 1200}));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(any_rectangle_equals_the_naive_sum);
    RUN_TEST(rectangles_over_the_border_are_cut);
    RUN_TEST(rows_with_padding_are_read_with_their_stride);
    RUN_TEST(images_that_do_not_fit_are_refused);
    return UNITY_END();
}
