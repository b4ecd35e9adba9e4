// Regions of a frame: the paper's threshold, the default under changing light, and what the recogniser makes of a frame.
#include <cmath>
#include <memory>
#include <random>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "recognise/recogniser.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::Recogniser;
using noctule::Region;
using noctule::Segmentation;
using noctule::SegmentationMode;
using noctule::SegmentationSettings;

namespace {

struct Light {
    double gain = 1.0;
    double blue = 1.0;   // tint
    double red = 1.0;
    double noise = 2.0;
};

/// A grey room (wall over floor) with a plain red box at (80, 150) and a grey box of uneven patches at (220, 140).
cv::Mat room(const Light& light, const bool objects = true) {
    cv::Mat image(240, 320, CV_8UC3);
    std::mt19937 rng{1};
    std::normal_distribution<double> grain{0.0, light.noise};
    for (int y = 0; y < image.rows; ++y) {
        for (int x = 0; x < image.cols; ++x) {
            double b = y < 130 ? 150.0 : 110.0;
            double g = b;
            double r = b;
            if (objects && std::abs(x - 80) < 20 && std::abs(y - 150) < 15) {
                b = 50.0;
                g = 45.0;
                r = 160.0;
            }
            if (objects && std::abs(x - 220) < 24 && std::abs(y - 140) < 18) {
                const unsigned patch = static_cast<unsigned>(x / 6 * 31 + y / 6) * 2654435761U;
                b = g = r = 30.0 + static_cast<double>(patch >> 24U) * 0.65;
            }
            const double value[3] = {b * light.blue, g, r * light.red};
            for (int c = 0; c < 3; ++c) {
                image.ptr<std::uint8_t>(y)[3 * x + c] =
                    static_cast<std::uint8_t>(std::lround(std::fmin(std::fmax(value[c] * light.gain + grain(rng), 0.0), 255.0)));
            }
        }
    }
    return image;
}

const Region* near(const noctule::Regions& regions, const float x, const float y) {
    for (const Region& r : regions) {
        if (std::hypot(r.x_px - x, r.y_px - y) < 6.0F) { return &r; }
    }
    return nullptr;
}

/// Finer than the default, which leaves speckled walls alone: this room has none.
SegmentationSettings fine() {
    SegmentationSettings settings;
    settings.texture = 0.02F;
    return settings;
}

void two_objects_are_found_under_any_light() {
    Segmentation segmentation;
    for (const Light& light : {Light{}, Light{0.4, 1.0, 1.0, 2.0}, Light{1.3, 1.0, 1.0, 2.0}, Light{0.9, 0.75, 1.1, 2.0}, Light{0.8, 1.15, 0.8, 2.0}}) {
        const noctule::Regions& regions = segmentation.find(room(light), fine());
        TEST_ASSERT_EQUAL_size_t(2, regions.size());
        const Region* const red = near(regions, 80.0F, 150.0F);
        const Region* const patched = near(regions, 220.0F, 140.0F);
        TEST_ASSERT_NOT_NULL(red);
        TEST_ASSERT_NOT_NULL(patched);
        TEST_ASSERT_FLOAT_WITHIN(0.3F * 39.0F * 29.0F, 39.0F * 29.0F, static_cast<float>(red->area_px));
        TEST_ASSERT_TRUE(regions[0].area_px >= regions[1].area_px);
    }
}

void empty_room_has_no_region() {
    Segmentation segmentation;
    for (const double gain : {0.4, 1.0, 1.3}) {
        TEST_ASSERT_EQUAL_size_t(0, segmentation.find(room({gain, 1.0, 1.0, 2.0}, false), fine()).size());
    }
}

void object_that_fills_the_frame_does_not_make_the_room_an_object() {
    Segmentation segmentation;
    for (int k = 0; k < 5; ++k) { static_cast<void>(segmentation.find(room({}, false), fine())); }
    cv::Mat image = room({}, false);
    image.colRange(0, 200).setTo(cv::Scalar(20, 30, 190));         // more than half of it is vivid red: the median's colour
    TEST_ASSERT_EQUAL_size_t(0, segmentation.find(image, fine()).size());
    // A wall in a pale colour of its own under white light is no object either, and neither is a white door in it.
    Segmentation fresh;
    cv::Mat pale(240, 320, CV_8UC3, cv::Scalar(190, 150, 140));
    pale.colRange(100, 160).setTo(cv::Scalar(200, 200, 200));
    TEST_ASSERT_EQUAL_size_t(0, fresh.find(pale, fine()).size());
}

void two_things_that_touch_in_the_picture_are_two_regions() {
    Segmentation segmentation;
    cv::Mat image = room({}, false);
    image(cv::Rect(100, 90, 30, 60)).setTo(cv::Scalar(20, 190, 190));    // yellow, farther back
    image(cv::Rect(130, 110, 40, 70)).setTo(cv::Scalar(190, 30, 20));    // blue, before it
    image(cv::Rect(220, 100, 50, 60)).setTo(cv::Scalar(40, 20, 180));    // one thing with a picture: red with spots in blue
    for (int k = 0; k < 9; ++k) { cv::circle(image, {226 + 19 * (k % 3), 108 + 22 * (k / 3)}, 7, cv::Scalar(190, 30, 20), -1); }
    const noctule::Regions& regions = segmentation.find(image, fine());
    TEST_ASSERT_EQUAL_size_t(3, regions.size());
    const Region* const back = near(regions, 114.5F, 119.5F);
    const Region* const front = near(regions, 149.5F, 144.5F);
    TEST_ASSERT_NOT_NULL(back);
    TEST_ASSERT_NOT_NULL(front);
    TEST_ASSERT_NOT_NULL(near(regions, 244.5F, 129.5F));
    TEST_ASSERT_TRUE(back->hidden_beside);
    TEST_ASSERT_FALSE(front->hidden_beside);
    TEST_ASSERT_EQUAL_INT(back->label, segmentation.labels().at<int>(120, 110));
    TEST_ASSERT_EQUAL_INT(front->label, segmentation.labels().at<int>(140, 150));
}

void papers_threshold_is_the_union_of_the_channels() {
    Segmentation segmentation;
    SegmentationSettings settings;
    settings.mode = SegmentationMode::threshold;
    settings.intensity = 200;
    settings.open_px = 1;
    settings.close_px = 1;
    cv::Mat image(100, 100, CV_8UC3, cv::Scalar(10, 10, 10));
    image(cv::Rect(10, 10, 10, 12)).setTo(cv::Scalar(200, 0, 0));   // exactly at I0 in one channel
    image(cv::Rect(40, 10, 12, 12)).setTo(cv::Scalar(0, 0, 250));
    image(cv::Rect(70, 10, 12, 12)).setTo(cv::Scalar(199, 199, 199));
    const noctule::Regions& regions = segmentation.find(image, settings);
    TEST_ASSERT_EQUAL_size_t(2, regions.size());
    TEST_ASSERT_EQUAL_INT(144, regions[0].area_px);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 45.5F, regions[0].x_px);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 15.5F, regions[0].y_px);
    TEST_ASSERT_EQUAL_INT(120, regions[1].area_px);
    TEST_ASSERT_EQUAL_INT(10, regions[1].left_px);
    TEST_ASSERT_EQUAL_INT(12, regions[1].height_px);
}

void specks_go_and_the_largest_stay_when_there_are_too_many() {
    Segmentation segmentation;
    SegmentationSettings settings;
    settings.mode = SegmentationMode::threshold;
    settings.close_px = 1;
    cv::Mat image(240, 320, CV_8UC3, cv::Scalar(0, 0, 0));
    for (int i = 0; i < 40; ++i) { image(cv::Rect(4 + 31 * (i % 10), 5 + 50 * (i / 10), 10 + i / 4, 10 + i / 4)).setTo(cv::Scalar(255, 255, 255)); }
    for (int i = 0; i < 50; ++i) { image.at<cv::Vec3b>(235, 6 * i) = cv::Vec3b(255, 255, 255); }
    const noctule::Regions& regions = segmentation.find(image, settings);
    TEST_ASSERT_EQUAL_size_t(noctule::kMaxRegions, regions.size());
    TEST_ASSERT_EQUAL_UINT32(8U, segmentation.dropped());
    for (std::size_t i = 1; i < regions.size(); ++i) { TEST_ASSERT_TRUE(regions[i - 1].area_px >= regions[i].area_px); }
    TEST_ASSERT_TRUE(regions[noctule::kMaxRegions - 1].area_px > 110);
}

void frame_gives_regions_with_their_features() {
    noctule::Parameters parameters{};
    parameters.seg_texture = fine().texture;
    const auto recogniser = std::make_unique<Recogniser>(parameters);
    const cv::Mat image = room({});
    const std::size_t bytes = static_cast<std::size_t>(image.rows * image.cols * 3);
    const Recogniser::Sightings& sightings = recogniser->process(image.data, bytes, image.cols, image.rows);
    TEST_ASSERT_EQUAL_size_t(2, sightings.size());
    int textured = 0;
    for (const noctule::Sighting& s : sightings) {
        TEST_ASSERT_EQUAL_INT(0, s.object_id);
        textured += s.features >= 6 ? 1 : 0;
    }
    TEST_ASSERT_EQUAL_INT(1, textured);  // the patched box; the plain red one has no texture
}

void frames_that_do_not_fit_their_bytes_are_refused() {
    const noctule::Parameters parameters{};
    const auto recogniser = std::make_unique<Recogniser>(parameters);
    const cv::Mat image = room({});
    TEST_ASSERT_EQUAL_size_t(0, recogniser->process(image.data, 230400, 321, 240).size());
    TEST_ASSERT_EQUAL_size_t(0, recogniser->process(image.data, 230400, -320, 240).size());
    TEST_ASSERT_EQUAL_size_t(0, recogniser->process(image.data, 230400, 0, 240).size());
    TEST_ASSERT_EQUAL_size_t(0, recogniser->process(image.data, 230400, 70000, 1).size());
    TEST_ASSERT_EQUAL_size_t(0, recogniser->process(nullptr, 230400, 320, 240).size());
    TEST_ASSERT_EQUAL_UINT32(5U, recogniser->counters().refused_frames);
    TEST_ASSERT_EQUAL_UINT32(0U, recogniser->counters().frames);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(two_objects_are_found_under_any_light);
    RUN_TEST(empty_room_has_no_region);
    RUN_TEST(object_that_fills_the_frame_does_not_make_the_room_an_object);
    RUN_TEST(two_things_that_touch_in_the_picture_are_two_regions);
    RUN_TEST(papers_threshold_is_the_union_of_the_channels);
    RUN_TEST(specks_go_and_the_largest_stay_when_there_are_too_many);
    RUN_TEST(frame_gives_regions_with_their_features);
    RUN_TEST(frames_that_do_not_fit_their_bytes_are_refused);
    return UNITY_END();
}
