// The vehicle's answer is learned: a slow vehicle gets the lead that its lag needs, a quick one none, and it strays less than without.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>

#include "command/reference.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

constexpr float kDt = 0.05F;

/// A vehicle whose velocity follows what its position loop wants with a lag, in two axes.
struct Vehicle {
    float lag_s = 0.15F;
    float position_gain = 1.0F;
    Setpoint at;

    void follow(const Setpoint& s) {
        constexpr int kParts = 10;
        constexpr float kPart = kDt / kParts;
        for (int k = 0; k < kParts; ++k) {
            at.vx_m_s += (s.vx_m_s + position_gain * (s.x_m - at.x_m) - at.vx_m_s) * kPart / lag_s;
            at.vy_m_s += (s.vy_m_s + position_gain * (s.y_m - at.y_m) - at.vy_m_s) * kPart / lag_s;
            at.x_m += at.vx_m_s * kPart;
            at.y_m += at.vy_m_s * kPart;
        }
        at.z_m = s.z_m;
        at.yaw_rad = s.yaw_rad;
    }
    [[nodiscard]] Estimate estimate() const {
        Estimate e;
        e.planar.pose_map_body = {at.x_m, at.y_m, at.yaw_rad};
        e.planar.vx_m_s = at.vx_m_s;
        e.planar.vy_m_s = at.vy_m_s;
        e.planar.quality = 100;
        e.altitude.z_m = at.z_m;
        e.altitude.valid = true;
        return e;
    }
};

/// Round a square of 2 m; how far the vehicle is from where it should be at most, over the laps from `from` on.
float strays_m(Reference& r, Vehicle& v, const int from_s, const int to_s) {
    float corner_x[] = {2.0F, 2.0F, 0.0F, 0.0F};
    float corner_y[] = {0.0F, 2.0F, 2.0F, 0.0F};
    std::size_t next = 0;
    float worst = 0.0F;
    for (int k = 0; k < to_s * 20; ++k) {
        Target t;
        t.mode = Target::Mode::follow;
        t.z_m = v.at.z_m;
        const Pose2<Map, Body> from = r.pose();
        const float dx = corner_x[next] - from.x_m;
        const float dy = corner_y[next] - from.y_m;
        const float length = std::hypot(dx, dy);
        const int n = std::max(1, static_cast<int>(length / 0.1F));
        for (int i = 0; i <= n; ++i) {
            const float f = static_cast<float>(i) / static_cast<float>(n);
            static_cast<void>(t.path.push({from.x_m + f * dx, from.y_m + f * dy, 2.0F}));
        }
        if (length < 0.1F) { next = (next + 1U) % 4U; }
        const Setpoint s = r.step(v.estimate(), t, 1000000 + 50000LL * k);
        r.settle(s);
        v.follow(s.trimmed());
        if (k >= from_s * 20) { worst = std::max(worst, std::hypot(r.pose().x_m - v.at.x_m, r.pose().y_m - v.at.y_m)); }
    }
    return worst;
}

void a_slow_vehicle_is_led_by_its_lag() {
    for (const float lag_s : {0.15F, 0.3F, 0.5F}) {
        const Parameters p;
        Reference r{p};
        Vehicle v;
        v.lag_s = lag_s;
        v.at.z_m = 1.0F;
        static_cast<void>(strays_m(r, v, 0, 60));
        TEST_ASSERT_FLOAT_WITHIN(0.4F * lag_s, lag_s, r.response().lead_s());
    }
}

void it_then_keeps_to_the_reference() {
    const Parameters p;
    Reference r{p};
    Vehicle v;
    v.lag_s = 0.5F;
    v.at.z_m = 1.0F;
    const float unlearned_m = strays_m(r, v, 0, 6);
    const float learned_m = strays_m(r, v, 40, 60);
    TEST_ASSERT_TRUE_MESSAGE(unlearned_m > 0.05F, "the vehicle is not sluggish: the test shows nothing");
    TEST_ASSERT_TRUE_MESSAGE(learned_m < 0.5F * unlearned_m, "learned nothing");
    TEST_ASSERT_TRUE(learned_m < 0.05F);
}

void an_autopilot_that_sways_as_it_turns_is_held_to_its_place() {
    // A brisk autopilot whose own velocity is wrong by 4 cm/s in a direction that turns: it would stand 2.3 cm beside its setpoint.
    const Parameters p;
    Reference r{p};
    Vehicle v;
    v.position_gain = 1.7F;
    v.lag_s = 0.25F;
    v.at.z_m = 1.0F;
    Target t;
    t.mode = Target::Mode::hold;
    t.z_m = 1.0F;
    float worst = 0.0F;
    for (int k = 0; k < 800; ++k) {
        const Setpoint s = r.step(v.estimate(), t, 1000000 + 50000LL * k);
        r.settle(s);
        Setpoint swayed = s.trimmed();
        const float phase = 0.45F * kDt * static_cast<float>(k);
        swayed.vx_m_s += 0.04F * std::cos(phase);
        swayed.vy_m_s += 0.04F * std::sin(phase);
        v.follow(swayed);
        if (k > 100) { worst = std::max(worst, std::hypot(v.at.x_m - r.pose().x_m, v.at.y_m - r.pose().y_m)); }
    }
    std::printf("  beside its place: %.4f m\n", static_cast<double>(worst));
    TEST_ASSERT_TRUE(worst < 0.012F);
    TEST_ASSERT_TRUE_MESSAGE(worst > 0.003F, "nothing sways: the test shows nothing");
}

void a_vehicle_that_follows_at_once_gets_no_lead() {
    Response r;
    for (int k = 0; k < 2000; ++k) { r.step(k % 80 < 40 ? 0.5F : -0.5F, 0.2F, 0.0F, 0.0F, 0.0F, 0.0F, kDt); }
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.0F, r.lead_s());
    TEST_ASSERT_EQUAL_FLOAT(0.0F, r.strays_m());
}

void errors_without_motion_teach_no_lead() {
    Response r;
    for (int k = 0; k < 2000; ++k) { r.step(0.0F, 0.0F, 0.05F, -0.03F, 0.0F, 0.0F, kDt); }
    TEST_ASSERT_EQUAL_FLOAT(0.0F, r.lead_s());
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, std::hypot(0.05F, 0.03F), r.strays_m());
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_slow_vehicle_is_led_by_its_lag);
    RUN_TEST(it_then_keeps_to_the_reference);
    RUN_TEST(an_autopilot_that_sways_as_it_turns_is_held_to_its_place);
    RUN_TEST(a_vehicle_that_follows_at_once_gets_no_lead);
    RUN_TEST(errors_without_motion_teach_no_lead);
    return UNITY_END();
}
