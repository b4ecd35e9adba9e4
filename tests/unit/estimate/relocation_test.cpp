// A correction bends the way where its doubt grew, and a recognised place ties both ends.
#include <cmath>
#include <memory>

#include "estimate/keyframes.hpp"
#include "estimate/relocation.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

Relocation a_loop() {
    Relocation r;
    r.correction = {0.3F, -0.2F, 0.05F};
    r.centre = {2.0F, 1.0F};
    r.before = {0.01F, 1e-5F};
    r.now = {0.21F, 9e-5F};
    return r;
}

void what_was_known_before_stays_and_what_is_now_moves_wholly() {
    const Relocation r = a_loop();
    const Pose2<Map, Body> pose{2.0F, 1.0F, 0.4F};
    const Pose2<Map, Body> stays = r.part(r.share(r.before)) * pose;
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, pose.x_m, stays.x_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, pose.yaw_rad, stays.yaw_rad);
    const Pose2<Map, Body> moves = r.part(r.share(r.now)) * pose;
    const Pose2<Map, Body> whole = r.correction * pose;
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, whole.x_m, moves.x_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, whole.y_m, moves.y_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, whole.yaw_rad, moves.yaw_rad);
    // Less known before than the place itself, or more doubtful than now: still between the two ends.
    TEST_ASSERT_EQUAL_FLOAT(0.0F, r.share({0.0F, 0.0F}));
    TEST_ASSERT_EQUAL_FLOAT(1.0F, r.share({5.0F, 0.0F}));
}

void a_chain_of_keyframes_is_bent_evenly() {
    auto frames = std::make_unique<Keyframes>();
    ScanShape shape;
    static_cast<void>(shape.push({1.0F, 0.0F}));
    Relocation r;
    r.correction = {0.0F, 0.4F, 0.0F};
    r.centre = {4.0F, 0.0F};
    r.now = {0.4F, 0.0F};
    for (int k = 0; k <= 4; ++k) { frames->add(shape, {static_cast<float>(k), 0.0F, 0.0F}, {0.1F * static_cast<float>(k), 0.0F}, 0); }
    frames->move(r);
    for (int k = 0; k <= 4; ++k) {
        TEST_ASSERT_FLOAT_WITHIN(1e-5F, 0.1F * static_cast<float>(k), frames->pose(static_cast<std::size_t>(k)).y_m);
        // Tied at both ends: the middle is known least, and better than it was.
        const float share = 0.25F * static_cast<float>(k);
        TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.4F * share * (1.0F - share), frames->doubt(static_cast<std::size_t>(k)).m2);
    }
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(what_was_known_before_stays_and_what_is_now_moves_wholly);
    RUN_TEST(a_chain_of_keyframes_is_bent_evenly);
    return UNITY_END();
}
