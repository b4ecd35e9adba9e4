// Objects reach the atlas: the sure ones, each once, at the mean of their places.
#include "app/atlas_objects.hpp"

#include <limits>
#include <memory>

#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

objects_t frame_with(const std::int32_t id, const float x_m, const float sigma_m = 0.1F) {
    objects_t m{};
    m.looked = 1;
    m.count = 1;
    m.object_id[0] = id;
    m.x_m[0] = x_m;
    m.y_m[0] = 2.0F;
    m.z_m[0] = 0.6F;
    m.along_sigma_m[0] = sigma_m;
    return m;
}

void an_object_is_listed_once_it_was_seen_three_times_where_the_frames_agree() {
    const auto objects = std::make_unique<AtlasObjects>();
    Bounded<AtlasObject, kMaxAtlasObjects> out;
    objects->note(frame_with(7, 1.0F), 0);
    objects->note(frame_with(7, 1.2F), 0);
    objects->list(out);
    TEST_ASSERT_EQUAL_UINT32(0U, out.size());
    objects->note(frame_with(7, 1.1F), 1);   // it stays on the floor where it was first seen
    objects->list(out);
    TEST_ASSERT_EQUAL_UINT32(1U, out.size());
    TEST_ASSERT_EQUAL_INT32(7, out[0].id);
    TEST_ASSERT_EQUAL_INT32(0, out[0].floor);
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.1F, out[0].x_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.6F, out[0].z_m);
    for (int k = 0; k < 3; ++k) { objects->note(frame_with(7, 9.0F, 100.0F), 0); }   // hardly known: hardly counts
    objects->list(out);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 1.1F, out[0].x_m);
}

void what_is_not_sure_or_has_no_place_is_left_out() {
    const auto objects = std::make_unique<AtlasObjects>();
    for (int k = 0; k < 5; ++k) {
        objects->note(frame_with(0, 1.0F), 0);
        objects->note(frame_with(3, std::numeric_limits<float>::quiet_NaN()), 0);
        objects->note(frame_with(4, 1.0F), -1);
        objects_t given_way = frame_with(5, 1.0F);
        given_way.looked = 0;
        objects->note(given_way, 0);
        objects_t wild = frame_with(6, 1.0F);
        wild.count = -4;
        objects->note(wild, 0);
    }
    Bounded<AtlasObject, kMaxAtlasObjects> out;
    objects->list(out);
    TEST_ASSERT_EQUAL_UINT32(0U, out.size());
}

void what_does_not_fit_is_left_out() {
    const auto objects = std::make_unique<AtlasObjects>();
    for (int k = 0; k < 3; ++k) {
        for (std::int32_t id = 1; id <= 200; ++id) { objects->note(frame_with(id, static_cast<float>(id)), 0); }
    }
    Bounded<AtlasObject, kMaxAtlasObjects> out;
    objects->list(out);
    TEST_ASSERT_EQUAL_UINT32(kMaxAtlasObjects, out.size());
    TEST_ASSERT_EQUAL_INT32(1, out[0].id);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(an_object_is_listed_once_it_was_seen_three_times_where_the_frames_agree);
    RUN_TEST(what_is_not_sure_or_has_no_place_is_left_out);
    RUN_TEST(what_does_not_fit_is_left_out);
    return UNITY_END();
}
