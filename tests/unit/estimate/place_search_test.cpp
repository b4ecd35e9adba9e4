// A loop is closed: a place from before is found, alone among those that look alike, and the way since is bent to it.
#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "estimate/keyframes.hpp"
#include "estimate/place_search.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

using Corner = std::array<float, 2>;
using Room = std::vector<Corner>;

/// No two walls alike, and all of them seen from everywhere inside.
Room crooked(const float x_m, const float y_m, const float dent_m) {
    Room room{{-6.0F, -4.0F}, {1.0F, -6.0F}, {6.5F - dent_m, -2.5F}, {6.0F - dent_m, 4.0F}, {0.5F, 6.5F}, {-5.0F, 3.0F}};
    for (Corner& corner : room) {
        corner[0] += x_m;
        corner[1] += y_m;
    }
    return room;
}

/// What a level laser of 180 beams all round sees from a pose in a room.
ScanShape seen_from(const Pose2<Map, Body>& pose, const Room& room) {
    ScanShape shape;
    for (int k = 0; k < 180; ++k) {
        const float bearing = 2.0F * kPi * static_cast<float>(k) / 180.0F;
        const float c = std::cos(pose.yaw_rad + bearing);
        const float s = std::sin(pose.yaw_rad + bearing);
        float range_m = 1e3F;
        for (std::size_t i = 0; i < room.size(); ++i) {
            const Corner& a = room[i];
            const Corner& b = room[(i + 1) % room.size()];
            const float ex = b[0] - a[0], ey = b[1] - a[1];
            const float across = c * ey - s * ex;
            if (std::abs(across) < 1e-6F) { continue; }
            const float ax = a[0] - pose.x_m, ay = a[1] - pose.y_m;
            const float r = (ax * ey - ay * ex) / across;
            const float on = (ax * s - ay * c) / across;
            if (r > 0.0F && on >= 0.0F && on <= 1.0F) { range_m = std::fmin(range_m, r); }
        }
        static_cast<void>(shape.push({range_m * std::cos(bearing), range_m * std::sin(bearing)}));
    }
    return shape;
}

Matrix<float, 3, 3> doubt_of(const float sigma_m, const float sigma_rad) {
    Matrix<float, 3, 3> p;
    p(0, 0) = p(1, 1) = sigma_m * sigma_m;
    p(2, 2) = sigma_rad * sigma_rad;
    return p;
}

struct World {
    Parameters parameters;
    std::unique_ptr<Keyframes> frames = std::make_unique<Keyframes>();
    std::unique_ptr<PlaceSearch> search = std::make_unique<PlaceSearch>(parameters);

    /// Keyframes at even steps on a line through a room.
    void fly(const Room& room, const Corner& from, const Corner& to, const int count, const FrameDoubt& doubt) {
        for (int k = 0; k < count; ++k) {
            const float share = static_cast<float>(k) / static_cast<float>(count - 1);
            const Pose2<Map, Body> pose{from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]), 0.1F * share};
            frames->add(seen_from(pose, room), pose, doubt, 0);
        }
    }

    /// Drifts on by 2 cm a step from a true pose; off: of the estimate. Steps until something was found, or 0.
    int look(const Room& room, Pose2<Map, Body> truth, const Pose2<Map, Map>& off, const Matrix<float, 3, 3>& covariance, const int most) {
        for (int step = 1; step <= most; ++step) {
            truth.x_m += 0.02F * std::cos(0.01F * static_cast<float>(step));
            truth.yaw_rad += 0.002F;
            if (search->step(*frames, seen_from(truth, room), off * truth, covariance, false, 0)) {
                last = truth;
                return step;
            }
        }
        return 0;
    }
    Pose2<Map, Body> last;
};

/// The newest keyframes are not looked at: the way just flown, in doubt as now.
void way_just_flown(World& world, const FrameDoubt& doubt) { world.fly(crooked(200.0F, 0.0F, 0.0F), {198.0F, 0.0F}, {202.0F, 1.0F}, 45, doubt); }

void closes_a_loop_and_bends_the_way_since() {
    World world;
    const Room room = crooked(0.0F, 0.0F, 0.0F);
    world.fly(room, {-3.0F, -1.0F}, {2.0F, 0.5F}, 15, {1e-6F, 1e-8F});
    way_just_flown(world, {0.04F, 1e-4F});
    const std::size_t newest = world.frames->size() - 1;
    const Pose2<Map, Body> newest_before = world.frames->pose(newest);
    const Pose2<Map, Map> off{0.22F, -0.15F, 0.015F};
    TEST_ASSERT_TRUE(world.look(room, {-1.0F, 0.2F, 0.3F}, off, doubt_of(0.2F, 0.01F), 200) > 0);
    const Relocation& found = world.search->relocation();
    const Pose2<Map, Body> corrected = found.correction * (off * world.last);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, world.last.x_m, corrected.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, world.last.y_m, corrected.y_m);
    TEST_ASSERT_FLOAT_WITHIN(0.004F, world.last.yaw_rad, corrected.yaw_rad);
    world.frames->move(found);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, -3.0F, world.frames->pose(0).x_m);   // what was known stays
    const Pose2<Map, Body> moved = found.correction * newest_before;
    TEST_ASSERT_FLOAT_WITHIN(0.05F, moved.x_m, world.frames->pose(newest).x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.05F, moved.y_m, world.frames->pose(newest).y_m);
}

void a_place_beside_the_old_way_is_found_although_another_on_it_looks_alike() {
    World world;
    const Room room = crooked(0.0F, 0.0F, 0.0F);
    const Room alike = crooked(20.0F, 0.0F, 0.5F);
    world.fly(room, {-3.5F, 2.4F}, {-1.0F, 4.2F}, 10, {1e-6F, 1e-8F});   // 5 m from where it comes back
    world.fly(alike, {21.0F, -3.0F}, {22.5F, -2.0F}, 10, {1e-6F, 1e-8F});
    way_just_flown(world, {64.0F, 1e-4F});
    TEST_ASSERT_TRUE(world.look(room, {1.0F, -2.6F, 0.2F}, {9.0F, 1.0F, 0.01F}, doubt_of(8.0F, 0.01F), 600) > 0);
    const Pose2<Map, Body> corrected = world.search->relocation().correction * (Pose2<Map, Map>{9.0F, 1.0F, 0.01F} * world.last);
    TEST_ASSERT_FLOAT_WITHIN(0.05F, world.last.x_m, corrected.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.05F, world.last.y_m, corrected.y_m);
}

void two_places_that_look_the_same_are_none() {
    World world;
    const Room room = crooked(0.0F, 0.0F, 0.0F);
    world.fly(room, {-1.0F, -2.0F}, {2.0F, -2.0F}, 10, {1e-6F, 1e-8F});
    world.fly(crooked(20.0F, 0.0F, 0.0F), {19.0F, -2.0F}, {22.0F, -2.0F}, 10, {1e-6F, 1e-8F});
    way_just_flown(world, {64.0F, 1e-4F});
    TEST_ASSERT_EQUAL_INT(0, world.look(room, {0.0F, -2.2F, 0.2F}, {9.0F, 0.0F, 0.0F}, doubt_of(8.0F, 0.01F), 200));
    TEST_ASSERT_TRUE(world.search->counters().ambiguous > 0);
}

void the_way_just_flown_is_no_loop() {
    World world;
    const Room room = crooked(0.0F, 0.0F, 0.0F);
    world.fly(room, {-3.0F, -1.0F}, {2.0F, 0.5F}, 30, {1e-6F, 1e-8F});
    TEST_ASSERT_EQUAL_INT(0, world.look(room, {-1.0F, 0.2F, 0.3F}, {0.2F, 0.0F, 0.0F}, doubt_of(0.2F, 0.01F), 150));
    TEST_ASSERT_EQUAL_UINT32(0U, world.search->counters().rounds);
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    if (kMaxKeyframes >= 128U) {   // the micro profile keeps the way just flown only, and never looks for a place
        RUN_TEST(closes_a_loop_and_bends_the_way_since);
        RUN_TEST(a_place_beside_the_old_way_is_found_although_another_on_it_looks_alike);
        RUN_TEST(two_places_that_look_the_same_are_none);
    }
    RUN_TEST(the_way_just_flown_is_no_loop);
    return UNITY_END();
}
