// The guard: each rule acts on the setpoint it is there for, is named and counted, and lets good setpoints pass untouched.
#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "command/guard.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

struct Desk {
    Parameters p;
    OccupancyGrid grid{p};
    Guard guard{p};
    Estimate estimate;
    LevelScan scan;
    std::int64_t t_us = 1000000;

    Desk() {
        estimate.planar.quality = 100;
        estimate.altitude.valid = true;
        estimate.altitude.z_m = 1.0F;
        estimate.altitude.ground_z_m = 0.0F;
        estimate.altitude.ceiling_z_m = 2.5F;
        scan.range_max_m = 10.0F;
    }
    void point(const float x_m, const float y_m) {
        ScanPoint q;
        q.x_m = x_m;
        q.y_m = y_m;
        q.range_m = std::hypot(x_m, y_m);
        q.hit = true;
        q.beam = static_cast<std::int16_t>(scan.points.size());
        TEST_ASSERT_TRUE(scan.points.push(q));
    }
    /// A wall across x, seen in points 2 cm apart.
    void wall_at(const float x_m) {
        for (int k = -50; k <= 50; ++k) { point(x_m, 0.02F * static_cast<float>(k)); }
    }
    const Setpoint& decide(const Setpoint& s, const bool vertical_free = false) {
        t_us += 50000;
        scan.t_us = t_us;
        return guard.decide(estimate, scan, grid, s, vertical_free, t_us);
    }
    [[nodiscard]] static Setpoint go(const float x_m, const float y_m, const float z_m = 1.0F) {
        Setpoint s;
        s.valid = true;
        s.x_m = x_m;
        s.y_m = y_m;
        s.z_m = z_m;
        return s;
    }
};

void a_good_setpoint_passes_untouched() {
    const auto d = std::make_unique<Desk>();
    d->wall_at(1.5F);
    Setpoint s = Desk::go(0.03F, 0.0F);
    s.vx_m_s = 0.5F;
    const Setpoint& out = d->decide(s);
    TEST_ASSERT_EQUAL_FLOAT(s.x_m, out.x_m);
    TEST_ASSERT_EQUAL_FLOAT(s.vx_m_s, out.vx_m_s);
    TEST_ASSERT_EQUAL(GuardRule::none, d->guard.rule());
    TEST_ASSERT_EQUAL_INT32(0, d->guard.interventions());
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 1.2F, d->guard.clearance_m());
}

void a_tread_before_what_is_seen_of_stairs_is_kept_clear_of() {
    StairPlaces stairs;
    const auto reached_m = [&](const StairPlaces& known) {   // where a setpoint that goes on and on is held
        const auto desk = std::make_unique<Desk>();
        desk->wall_at(0.9F);
        float x_m = 0.0F;
        for (int k = 0; k < 60; ++k) {
            desk->t_us += 50000;
            desk->scan.t_us = desk->t_us;
            x_m = desk->guard.decide(desk->estimate, desk->scan, desk->grid, Desk::go(x_m + 0.02F, 0.0F), false, desk->t_us, known).x_m;
        }
        return x_m;
    };
    const float wall_m = reached_m(stairs);
    TEST_ASSERT_TRUE(stairs.push({0.2F, 0.0F, 1}));   // of another floor
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, wall_m, reached_m(stairs));
    TEST_ASSERT_TRUE(stairs.push({0.2F, 0.0F, 0}));
    TEST_ASSERT_FLOAT_WITHIN(0.06F, wall_m - kTreadM, reached_m(stairs));
}

void a_setpoint_that_is_no_number_is_replaced_by_the_last_good_one() {
    const auto d = std::make_unique<Desk>();
    static_cast<void>(d->decide(Desk::go(0.02F, 0.0F)));
    for (int field = 0; field < 7; ++field) {
        Setpoint s = Desk::go(0.03F, 0.0F);
        float* const fields[] = {&s.x_m, &s.y_m, &s.z_m, &s.vx_m_s, &s.vy_m_s, &s.vz_m_s, &s.yaw_rad};
        *fields[field] = field % 2 == 0 ? std::numeric_limits<float>::quiet_NaN() : std::numeric_limits<float>::infinity();
        const Setpoint& out = d->decide(s);
        TEST_ASSERT_TRUE(out.valid);
        TEST_ASSERT_EQUAL_FLOAT(0.02F, out.x_m);
        TEST_ASSERT_EQUAL_FLOAT(0.0F, out.vx_m_s);
        TEST_ASSERT_EQUAL(GuardRule::not_finite, d->guard.rule());
    }
    TEST_ASSERT_EQUAL_INT32(7, d->guard.interventions());
    const auto fresh = std::make_unique<Desk>();
    TEST_ASSERT_FALSE(fresh->decide(Desk::go(std::nanf(""), 0.0F)).valid);   // nothing good yet: nothing is sent
}

void stale_scans_and_lost_localisation_stop_horizontal_motion() {
    const auto d = std::make_unique<Desk>();
    static_cast<void>(d->decide(Desk::go(0.02F, 0.0F)));
    d->t_us += 2000000;
    Setpoint s = Desk::go(0.06F, 0.0F);
    s.vx_m_s = 0.8F;
    const Setpoint& out = d->guard.decide(d->estimate, d->scan, d->grid, s, false, d->t_us);
    TEST_ASSERT_EQUAL_FLOAT(0.02F, out.x_m);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, out.vx_m_s);
    TEST_ASSERT_EQUAL(GuardRule::scan_stale, d->guard.rule());
    d->estimate.planar.quality = -1;
    TEST_ASSERT_EQUAL_FLOAT(0.02F, d->decide(s).x_m);
    TEST_ASSERT_EQUAL(GuardRule::scan_stale, d->guard.rule());
}

void the_fence_holds() {
    const auto d = std::make_unique<Desk>();
    d->p.fence_radius_m = 3.0F;
    d->estimate.planar.pose_map_body = {2.9F, 0.0F, 0.0F};
    const Setpoint& out = d->decide(Desk::go(3.2F, 0.0F));
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 3.0F, out.x_m);
    TEST_ASSERT_EQUAL(GuardRule::fence, d->guard.rule());
}

void a_fence_drawn_anew_round_nothing_lets_only_inwards() {
    const auto d = std::make_unique<Desk>();
    static_cast<void>(d->decide(Desk::go(0.0F, 0.0F)));
    d->p.fence_corners = 3;                                       // GIVEN a triangle that the vehicle is 1 m outside of
    d->p.fence_1_x_m = 1.0F;
    d->p.fence_1_y_m = -5.0F;
    d->p.fence_2_x_m = 9.0F;
    d->p.fence_2_y_m = 0.0F;
    d->p.fence_3_x_m = 1.0F;
    d->p.fence_3_y_m = 5.0F;
    TEST_ASSERT_EQUAL_FLOAT(0.0F, d->decide(Desk::go(-0.05F, 0.0F)).x_m);   // THEN farther out is refused
    TEST_ASSERT_EQUAL(GuardRule::fence, d->guard.rule());
    TEST_ASSERT_EQUAL_FLOAT(0.05F, d->decide(Desk::go(0.05F, 0.0F)).x_m);   // AND farther in is let through
}

void jumps_and_leads_are_cut() {
    const auto d = std::make_unique<Desk>();
    static_cast<void>(d->decide(Desk::go(0.0F, 0.0F)));
    const Setpoint& out = d->decide(Desk::go(5.0F, 0.0F, 2.0F));
    TEST_ASSERT_EQUAL(GuardRule::ahead, d->guard.rule());
    TEST_ASSERT_TRUE(out.x_m < 0.08F);
    TEST_ASSERT_TRUE(out.z_m < 1.08F);
    TEST_ASSERT_EQUAL_INT32(1, d->guard.acted(GuardRule::ahead));
    TEST_ASSERT_TRUE(d->guard.acted(GuardRule::step) >= 1);
    TEST_ASSERT_EQUAL_INT32(1, d->guard.interventions());       // one call, however many rules
    Setpoint fast = Desk::go(out.x_m, 0.0F, out.z_m);
    fast.vx_m_s = 5.0F;
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, d->p.speed_max_m_s, d->decide(fast).vx_m_s);
    TEST_ASSERT_EQUAL(GuardRule::speed, d->guard.rule());
}

void it_stops_before_a_wall_whatever_is_wanted() {
    // A planner gone mad wants through a wall 1 m ahead, at full speed; the vehicle follows what the guard sends.
    const auto d = std::make_unique<Desk>();
    float x_m = 0.0F;
    float nearest = 10.0F;
    for (int k = 0; k < 200; ++k) {
        d->scan.points.clear();
        d->wall_at(1.0F - x_m);
        d->estimate.planar.pose_map_body = {x_m, 0.0F, 0.0F};
        Setpoint s = Desk::go(x_m + 0.4F, 0.0F);
        s.vx_m_s = d->p.speed_max_m_s;
        const Setpoint& out = d->decide(s);
        x_m += 0.05F * (out.vx_m_s + 1.5F * (out.x_m - x_m));
        nearest = std::min(nearest, 1.0F - x_m);
    }
    TEST_ASSERT_TRUE_MESSAGE(nearest > d->p.hull_radius_m + 0.02F, "came too near");
    TEST_ASSERT_TRUE_MESSAGE(nearest < d->p.hull_radius_m + 0.2F, "never came near: the test shows nothing");
    TEST_ASSERT_TRUE(d->guard.acted(GuardRule::clearance) > 0);
}

void a_vehicle_that_flies_past_its_setpoint_is_drawn_back() {
    // GIVEN a setpoint that stands well clear of a wall, and a vehicle that flies on towards the wall at 0.6 m/s
    const auto d = std::make_unique<Desk>();
    d->wall_at(0.50F);
    d->estimate.planar.vx_m_s = 0.6F;
    static_cast<void>(d->decide(Desk::go(0.0F, 0.0F)));
    for (int k = 0; k < 3; ++k) { static_cast<void>(d->decide(Desk::go(0.05F, 0.0F))); }
    const Setpoint out = d->decide(Desk::go(0.05F, 0.0F)).trimmed();
    // THEN it is told to go back, while there is room
    TEST_ASSERT_EQUAL(GuardRule::motion, d->guard.rule());
    TEST_ASSERT_TRUE(out.x_m < -0.05F);
    TEST_ASSERT_TRUE(out.vx_m_s <= 0.0F);
    // AND one that is slow enough to stop, or flies along the wall, is left alone
    for (const float vx_m_s : {0.1F, 0.0F}) {
        const auto e = std::make_unique<Desk>();
        e->wall_at(0.50F);
        e->estimate.planar.vx_m_s = vx_m_s;
        e->estimate.planar.vy_m_s = 0.6F;
        static_cast<void>(e->decide(Desk::go(0.02F, 0.02F)));
        TEST_ASSERT_EQUAL_INT32(0, e->guard.interventions());
    }
}

void a_vehicle_that_flies_at_one_side_of_a_gap_is_not_thrown_at_the_other() {
    // GIVEN a post ahead on the left, and a setpoint that leads straight on
    const auto d = std::make_unique<Desk>();
    for (int k = -2; k <= 2; ++k) { d->point(0.55F, 0.22F + 0.01F * static_cast<float>(k)); }
    d->estimate.planar.vx_m_s = 0.6F;
    static_cast<void>(d->decide(Desk::go(0.0F, 0.0F)));
    Setpoint s = Desk::go(0.03F, 0.0F);
    s.vx_m_s = 0.5F;
    const Setpoint out = d->decide(s);
    // THEN it is slowed on its way, and not sent to the right
    TEST_ASSERT_EQUAL(GuardRule::motion, d->guard.rule());
    TEST_ASSERT_TRUE(out.vx_m_s < 0.3F);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.0F, out.vy_m_s);
    TEST_ASSERT_FLOAT_WITHIN(0.005F, 0.0F, out.trim_y_m);
}

void a_vehicle_nearly_too_fast_is_slowed_before_it_is_stopped() {
    // A wall 0.80 m ahead: with 0.25 s until it answers and 0.8 m/s^2 a vehicle stops before hull and least margin from 0.70 m/s.
    const auto asked = [](const float vx_m_s) {
        const auto d = std::make_unique<Desk>();
        d->wall_at(0.80F);
        d->estimate.planar.vx_m_s = vx_m_s;
        Setpoint s = Desk::go(0.02F, 0.0F);
        s.vx_m_s = vx_m_s;
        return d->decide(s).vx_m_s;
    };
    TEST_ASSERT_EQUAL_FLOAT(0.55F, asked(0.55F));
    const float little = asked(0.62F);
    const float more = asked(0.67F);
    TEST_ASSERT_TRUE(little > 0.4F && little < 0.6F);
    TEST_ASSERT_TRUE(more > 0.1F && more < little - 0.1F);
    TEST_ASSERT_TRUE(asked(0.71F) <= 0.0F);
}

void a_sluggish_vehicle_is_stopped_in_time() {
    // A vehicle that answers as PX4 does with its defaults, a planner that brakes too late: at 0.5 m/s to 0.40 m before the wall.
    const auto d = std::make_unique<Desk>();
    constexpr float kWall = 2.0F;
    float x_m = 0.0F;
    float v_m_s = 0.5F;
    float wanted_m = 0.0F;
    float nearest = 10.0F;
    for (int k = 0; k < 200; ++k) {
        d->scan.points.clear();
        d->wall_at(kWall - x_m);
        d->estimate.planar.pose_map_body = {x_m, 0.0F, 0.0F};
        d->estimate.planar.vx_m_s = v_m_s;
        Setpoint s = Desk::go(wanted_m, 0.0F);
        s.vx_m_s = wanted_m < kWall - 0.45F ? 0.5F : 0.0F;
        wanted_m += 0.05F * s.vx_m_s;
        const Setpoint out = d->decide(s).trimmed();
        for (int part = 0; part < 10; ++part) {
            v_m_s += 0.005F * 1.8F * (out.vx_m_s + 0.95F * (out.x_m - x_m) - v_m_s);
            x_m += 0.005F * v_m_s;
        }
        nearest = std::min(nearest, kWall - x_m);
    }
    TEST_ASSERT_TRUE_MESSAGE(nearest > d->p.hull_radius_m + 0.03F, "came too near");
    TEST_ASSERT_TRUE_MESSAGE(nearest < d->p.hull_radius_m + 0.2F, "never came near: the test shows nothing");
    TEST_ASSERT_TRUE(d->guard.acted(GuardRule::motion) > 0);
}

void noise_does_not_bring_a_wall_nearer() {
    const auto d = std::make_unique<Desk>();
    d->scan.range_noise_m = 0.03F;
    std::mt19937 rng(11);
    std::normal_distribution<float> noise_m(0.0F, 0.03F);
    float nearest_m = 10.0F;
    for (int k = -200; k <= 200; ++k) {                  // a wall at 0.40 m seen with 3 cm of noise, 1 mm apart
        const float bearing_rad = 0.0025F * static_cast<float>(k);
        const float range_m = 0.40F / std::cos(bearing_rad) + noise_m(rng);
        nearest_m = std::min(nearest_m, range_m);
        d->point(range_m * std::cos(bearing_rad), range_m * std::sin(bearing_rad));
    }
    TEST_ASSERT_TRUE_MESSAGE(nearest_m < 0.34F, "no noise: the test shows nothing");
    static_cast<void>(d->decide(Desk::go(0.0F, 0.0F)));
    TEST_ASSERT_FLOAT_WITHIN(0.045F, 0.10F, d->guard.clearance_m());
    TEST_ASSERT_TRUE(d->guard.clearance_m() > nearest_m - d->p.hull_radius_m + 0.02F);
}

void a_corner_is_not_smoothed_away() {
    // The end of a wall beside the vehicle: its face recedes along the beams, 0.35 m away.
    const auto d = std::make_unique<Desk>();
    d->scan.range_noise_m = 0.01F;
    for (int k = 0; k < 60; ++k) { d->point(-0.0004F * static_cast<float>(k), 0.35F + 0.012F * static_cast<float>(k)); }
    static_cast<void>(d->decide(Desk::go(0.0F, 0.0F)));
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.05F, d->guard.clearance_m());
}

void it_backs_away_from_what_is_inside_its_margin() {
    const auto d = std::make_unique<Desk>();
    d->wall_at(0.33F);
    const Setpoint& out = d->decide(Desk::go(0.0F, 0.0F));
    TEST_ASSERT_TRUE(out.x_m < -0.02F);
    TEST_ASSERT_EQUAL(GuardRule::clearance, d->guard.rule());
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.03F, d->guard.clearance_m());
}

void between_two_jambs_it_goes_to_the_middle() {
    const auto d = std::make_unique<Desk>();
    // A gap of 0.70 m, narrower than hull and margin on both sides (0.72 m): pushed from either side it must not stick to one.
    constexpr float kOff = 0.08F;                     // the vehicle is off the middle
    d->estimate.planar.pose_map_body = {0.05F, kOff, 0.0F};
    for (int k = 0; k <= 25; ++k) {
        d->point(0.02F * static_cast<float>(k) - 0.05F, 0.35F - kOff);
        d->point(0.02F * static_cast<float>(k) - 0.05F, -0.35F - kOff);
    }
    const Setpoint& out = d->decide(Desk::go(0.05F, kOff));
    TEST_ASSERT_TRUE(std::fabs(out.y_m) < 0.02F);
}

void a_setpoint_in_the_middle_of_a_throat_is_left_alone() {
    // A gap of 0.70 m ahead: nearer to both jambs than the margin, and yet nothing holds it back or hurries it.
    for (const float x_m : {-0.06F, -0.03F, 0.0F, 0.03F, 0.06F}) {
        const auto d = std::make_unique<Desk>();
        d->estimate.planar.pose_map_body = {x_m - 0.01F, 0.0F, 0.0F};
        for (int k = 0; k <= 40; ++k) {
            d->point(0.01F - x_m, 0.35F + 0.01F * static_cast<float>(k));
            d->point(0.01F - x_m, -0.35F - 0.01F * static_cast<float>(k));
        }
        Setpoint s = Desk::go(x_m, 0.0F);
        s.vx_m_s = 0.2F;
        const Setpoint& out = d->decide(s);
        TEST_ASSERT_FLOAT_WITHIN(0.002F, x_m, out.x_m);
        TEST_ASSERT_TRUE(out.vx_m_s > 0.12F);
    }
}

void the_blind_sector_is_guarded_by_the_map() {
    const auto d = std::make_unique<Desk>();
    LevelScan behind;
    behind.range_max_m = 10.0F;
    for (int k = -20; k <= 20; ++k) {
        ScanPoint q;
        q.x_m = -0.40F;
        q.y_m = 0.02F * static_cast<float>(k);
        q.range_m = std::hypot(q.x_m, q.y_m);
        q.hit = true;
        q.beam = static_cast<std::int16_t>(k + 20);
        TEST_ASSERT_TRUE(behind.points.push(q));
    }
    for (int k = 0; k < 5; ++k) { d->grid.integrate(d->estimate, behind); }
    for (int k = -60; k <= 60; ++k) { d->point(3.0F * std::cos(0.0349F * static_cast<float>(k)), 3.0F * std::sin(0.0349F * static_cast<float>(k))); }
    const Setpoint& out = d->decide(Desk::go(-0.2F, 0.0F));
    TEST_ASSERT_EQUAL(GuardRule::clearance, d->guard.rule());
    TEST_ASSERT_TRUE(out.x_m > -0.09F);
}

void floor_and_ceiling_are_kept_except_in_take_off_and_landing() {
    const auto d = std::make_unique<Desk>();
    d->estimate.altitude.ceiling_z_m = 1.15F;
    TEST_ASSERT_TRUE(d->decide(Desk::go(0.0F, 0.0F, 1.2F)).z_m < 0.96F);
    TEST_ASSERT_EQUAL(GuardRule::ceiling, d->guard.rule());
    const auto e = std::make_unique<Desk>();
    TEST_ASSERT_EQUAL_FLOAT(-0.2F, e->decide(Desk::go(0.0F, 0.0F, -0.2F), true).z_m);
    TEST_ASSERT_EQUAL_INT32(0, e->guard.interventions());
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_good_setpoint_passes_untouched);
    RUN_TEST(a_tread_before_what_is_seen_of_stairs_is_kept_clear_of);
    RUN_TEST(a_setpoint_that_is_no_number_is_replaced_by_the_last_good_one);
    RUN_TEST(stale_scans_and_lost_localisation_stop_horizontal_motion);
    RUN_TEST(the_fence_holds);
    RUN_TEST(a_fence_drawn_anew_round_nothing_lets_only_inwards);
    RUN_TEST(jumps_and_leads_are_cut);
    RUN_TEST(it_stops_before_a_wall_whatever_is_wanted);
    RUN_TEST(a_vehicle_that_flies_past_its_setpoint_is_drawn_back);
    RUN_TEST(a_vehicle_that_flies_at_one_side_of_a_gap_is_not_thrown_at_the_other);
    RUN_TEST(a_vehicle_nearly_too_fast_is_slowed_before_it_is_stopped);
    RUN_TEST(a_sluggish_vehicle_is_stopped_in_time);
    RUN_TEST(noise_does_not_bring_a_wall_nearer);
    RUN_TEST(a_corner_is_not_smoothed_away);
    RUN_TEST(it_backs_away_from_what_is_inside_its_margin);
    RUN_TEST(between_two_jambs_it_goes_to_the_middle);
    RUN_TEST(a_setpoint_in_the_middle_of_a_throat_is_left_alone);
    RUN_TEST(the_blind_sector_is_guarded_by_the_map);
    RUN_TEST(floor_and_ceiling_are_kept_except_in_take_off_and_landing);
    return UNITY_END();
}
