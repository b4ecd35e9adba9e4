// The reference pose: its limits hold whatever it is asked for, and it stops where it should.
#include <cmath>
#include <memory>
#include <random>

#include "command/reference.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// The estimate, a step later, of a vehicle that follows perfectly: a setpoint takes effect 0.03 s after its scan.
Estimate at(const Setpoint& s) {
    Estimate e;
    e.planar.pose_map_body = {s.x_m + 0.02F * s.vx_m_s, s.y_m + 0.02F * s.vy_m_s, s.yaw_rad};
    e.planar.vx_m_s = s.vx_m_s;
    e.planar.vy_m_s = s.vy_m_s;
    e.planar.quality = 100;
    e.altitude.z_m = s.z_m;
    e.altitude.valid = true;
    return e;
}

Target along(const float x0, const float y0, const float x1, const float y1, const float clearance_m = 2.0F) {
    Target t;
    t.mode = Target::Mode::follow;
    t.z_m = 1.0F;
    t.climb_rate_m_s = 0.5F;
    const float length = std::hypot(x1 - x0, y1 - y0);
    const int n = std::min(static_cast<int>(length / 0.1F) + 1, 50);
    for (int k = 0; k <= n; ++k) {
        const float f = std::min(1.0F, static_cast<float>(k) / static_cast<float>(n));
        static_cast<void>(t.path.push({x0 + f * (x1 - x0), y0 + f * (y1 - y0), clearance_m}));
    }
    return t;
}

void speed_acceleration_and_jerk_stay_bounded_for_any_targets() {
    const Parameters p;
    std::mt19937 rng(5);
    std::uniform_real_distribution<float> place(-4.0F, 4.0F);
    Reference r{p};
    Setpoint s;
    s.z_m = 1.0F;
    float goal_x = 1.0F;
    float goal_y = 0.0F;
    float vx = 0.0F;
    float vy = 0.0F;
    float ax = 0.0F;
    float ay = 0.0F;
    constexpr float kDt = 0.05F;
    for (int k = 0; k < 4000; ++k) {
        if (k % 37 == 0) {
            goal_x = place(rng);
            goal_y = place(rng);
        }
        Target t = along(s.x_m, s.y_m, goal_x, goal_y);
        t.yaw_rad = place(rng);
        const Setpoint before = s;
        s = r.step(at(s), t, 1000000 + 50000LL * k);
        TEST_ASSERT_TRUE(s.valid);
        TEST_ASSERT_TRUE(std::hypot(s.vx_m_s, s.vy_m_s) <= p.speed_max_m_s * 1.001F);
        if (k > 0) {
            const float nax = (s.vx_m_s - vx) / kDt;
            const float nay = (s.vy_m_s - vy) / kDt;
            TEST_ASSERT_TRUE(std::hypot(nax, nay) <= p.accel_max_m_s2 * 1.01F + 1e-3F);
            if (k > 1) { TEST_ASSERT_TRUE(std::hypot(nax - ax, nay - ay) <= p.jerk_max_m_s3 * kDt * 1.01F + 2e-3F); }
            ax = nax;
            ay = nay;
            TEST_ASSERT_FLOAT_WITHIN(1e-4F, s.vx_m_s * kDt, s.x_m - before.x_m);   // the feed-forward is the motion
            TEST_ASSERT_TRUE(std::fabs(wrap_angle(s.yaw_rad - before.yaw_rad)) <= p.yaw_rate_max_rad_s * kDt * 1.01F);
        }
        vx = s.vx_m_s;
        vy = s.vy_m_s;
    }
}

void it_arrives_at_the_end_of_the_path_and_stays_without_overshoot() {
    const Parameters p;
    Reference r{p};
    Setpoint s;
    s.z_m = 1.0F;
    float farthest = 0.0F;
    float fastest = 0.0F;
    int arrived = -1;
    for (int k = 0; k < 200; ++k) {
        s = r.step(at(s), along(s.x_m, s.y_m, 3.0F, 0.0F), 50000LL * k);
        farthest = std::max(farthest, s.x_m);
        fastest = std::max(fastest, s.vx_m_s);
        if (arrived < 0 && s.x_m > 2.95F) { arrived = k; }
    }
    TEST_ASSERT_FLOAT_WITHIN(0.03F, 3.0F, s.x_m);
    TEST_ASSERT_TRUE(farthest < 3.05F);
    TEST_ASSERT_TRUE(fastest > 0.9F * p.speed_max_m_s);
    TEST_ASSERT_TRUE_MESSAGE(arrived > 0 && arrived < 120, "3 m take less than 6 s at 1 m/s and 1 m/s^2");
}

void a_sharp_turn_is_braked_into() {
    const Parameters p;
    Reference r{p};
    Setpoint s;
    s.z_m = 1.0F;
    int k = 0;
    for (; k < 60; ++k) { s = r.step(at(s), along(s.x_m, s.y_m, 9.0F, 0.0F), 50000LL * k); }
    TEST_ASSERT_TRUE(s.vx_m_s > 0.9F);
    const float x_m = s.x_m;
    for (; s.vx_m_s > 0.5F; ++k) {                    // the new path leads to the side
        s = r.step(at(s), along(s.x_m, s.y_m, x_m, 5.0F), 50000LL * k);
        TEST_ASSERT_TRUE_MESSAGE(s.vy_m_s < 0.25F, "gained speed sideways before the old motion was gone");
    }
    TEST_ASSERT_TRUE(s.x_m - x_m < 0.7F);
}

void it_is_slow_where_it_is_narrow() {
    const Parameters p;
    Reference r{p};
    Setpoint s;
    s.z_m = 1.0F;
    float fastest = 0.0F;
    for (int k = 0; k < 100; ++k) {
        s = r.step(at(s), along(s.x_m, s.y_m, 5.0F, 0.0F, 0.45F), 50000LL * k);
        fastest = std::max(fastest, s.vx_m_s);
    }
    // Straight line between speed_near at the narrowest and the full speed at the comfortable clearance.
    const float low_m = p.hull_radius_m + p.plan_margin_m;
    const float limit = p.speed_near_m_s + (p.speed_max_m_s - p.speed_near_m_s) * (0.45F - low_m) / (p.comfort_clearance_m - low_m);
    TEST_ASSERT_TRUE(fastest < limit + 0.02F);
    TEST_ASSERT_TRUE(fastest > limit - 0.05F);
}

void it_heads_for_something_no_faster_than_the_guard_lets_it() {
    const Parameters p;
    const auto fastest = [&p](const float way_m, const float clearance_m) {
        Reference r{p};
        Setpoint s;
        s.z_m = 1.0F;
        float most = 0.0F;
        for (int k = 0; k < 80; ++k) {
            Target t = along(s.x_m, s.y_m, 9.0F, 0.0F, clearance_m);
            for (PathPoint& q : t.path) { q.way_m = way_m; }
            s = r.step(at(s), t, 50000LL * k);
            most = std::max(most, s.vx_m_s);
        }
        return most;
    };
    // Straight on it is free for 0.30 m: 0.52 m/s would be stopped.
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 0.365F, fastest(0.3F, 2.0F));
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 1.0F, fastest(10.0F, 2.0F));
    // Nothing bounds it below 0.4 of the least speed; in a gap with 0.07 m beside the hull it takes half of that speed.
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.08F, fastest(0.0F, 2.0F));
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.5F * speed_at_clearance_m_s(p, 0.37F), fastest(10.0F, 0.37F));
}

void what_is_farther_ahead_than_it_brakes_bounds_no_speed() {
    const Parameters p;
    // Speed after a while on a path whose way straight on is none at all from this far on.
    const auto speed_m_s = [&p](const float from_m, const float clearance_m) {
        Reference r{p};
        Setpoint s;
        for (int k = 0; k < 100; ++k) {
            Target t = along(s.x_m, 0.0F, s.x_m + 4.0F, 0.0F, clearance_m);
            for (PathPoint& q : t.path) {
                if (q.x_m - s.x_m > from_m) { q.way_m = 0.0F; }
            }
            s = r.step(at(s), t, 1000000 + 50000LL * k);
        }
        return s.vx_m_s;
    };
    for (const float clearance_m : {0.5F, 0.6F, 0.7F, 2.0F}) {
        const float felt_m = braking_m(p, clearance_m);
        TEST_ASSERT_TRUE(speed_m_s(10.0F, clearance_m) == speed_m_s(1.05F * felt_m, clearance_m));
        TEST_ASSERT_TRUE(speed_m_s(0.3F * felt_m, clearance_m) < speed_m_s(10.0F, clearance_m));
    }
}

void it_waits_for_a_vehicle_that_does_not_follow() {
    const Parameters p;
    Reference r{p};
    Setpoint origin;
    origin.z_m = 1.0F;
    Setpoint s = origin;
    for (int k = 0; k < 200; ++k) { s = r.step(at(origin), along(s.x_m, s.y_m, 8.0F, 0.0F), 50000LL * k); }
    TEST_ASSERT_TRUE(s.x_m <= p.setpoint_ahead_s * p.speed_max_m_s + 0.01F);
    TEST_ASSERT_TRUE(s.x_m > 0.2F);
}

void hold_stops_within_the_braking_distance() {
    const Parameters p;
    Reference r{p};
    Setpoint s;
    s.z_m = 1.0F;
    int k = 0;
    for (; k < 60; ++k) { s = r.step(at(s), along(s.x_m, s.y_m, 9.0F, 0.0F), 50000LL * k); }
    const float x_m = s.x_m;
    Target hold;
    hold.mode = Target::Mode::hold;
    hold.z_m = 1.0F;
    hold.climb_rate_m_s = 0.5F;
    for (; k < 160; ++k) { s = r.step(at(s), hold, 50000LL * k); }
    TEST_ASSERT_TRUE(s.x_m - x_m < 0.5F * p.speed_max_m_s * p.speed_max_m_s / p.accel_max_m_s2 + 0.3F);
    TEST_ASSERT_TRUE(std::fabs(s.vx_m_s) < 0.01F);
}

void landing_pushes_through_the_floor_slowly_and_never_far_below_the_vehicle() {
    const Parameters p;
    Reference r{p};
    Setpoint on_floor;
    on_floor.z_m = 0.05F;
    Target t;
    t.mode = Target::Mode::land;
    t.z_m = -1.0F;
    t.climb_rate_m_s = p.land_rate_m_s;
    static_cast<void>(t.path.push({0.0F, 0.0F, 1.0F}));
    Setpoint s;
    for (int k = 0; k < 200; ++k) { s = r.step(at(on_floor), t, 50000LL * k); }
    TEST_ASSERT_TRUE(s.z_m < -0.1F);
    TEST_ASSERT_TRUE(s.z_m > -0.5F);
}

void nothing_is_valid_before_a_target_and_the_ground_setpoint_stands_still() {
    const Parameters p;
    Reference r{p};
    Setpoint here;
    here.x_m = 0.3F;
    TEST_ASSERT_FALSE(r.step(at(here), Target{}, 50000).valid);
    Target ground;
    ground.mode = Target::Mode::ground;
    const Setpoint first = r.step(at(here), ground, 100000);
    TEST_ASSERT_TRUE(first.valid);
    here.x_m = 0.4F;
    const Setpoint second = r.step(at(here), ground, 150000);
    TEST_ASSERT_EQUAL_FLOAT(first.x_m, second.x_m);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(speed_acceleration_and_jerk_stay_bounded_for_any_targets);
    RUN_TEST(it_arrives_at_the_end_of_the_path_and_stays_without_overshoot);
    RUN_TEST(a_sharp_turn_is_braked_into);
    RUN_TEST(it_is_slow_where_it_is_narrow);
    RUN_TEST(it_heads_for_something_no_faster_than_the_guard_lets_it);
    RUN_TEST(what_is_farther_ahead_than_it_brakes_bounds_no_speed);
    RUN_TEST(it_waits_for_a_vehicle_that_does_not_follow);
    RUN_TEST(hold_stops_within_the_braking_distance);
    RUN_TEST(landing_pushes_through_the_floor_slowly_and_never_far_below_the_vehicle);
    RUN_TEST(nothing_is_valid_before_a_target_and_the_ground_setpoint_stands_still);
    return UNITY_END();
}
