// What the bridge does when nav, the estimate or the autopilot fails in flight.
#include <unity.h>

#include <limits>

#include "unit/link/bridge_scene.hpp"

using namespace noctule;
using scene::Scene;

namespace {

constexpr std::uint32_t kLand = 4U << 16U | 6U << 24U;
constexpr std::uint32_t kPosition = 3U << 16U;
constexpr std::uint16_t kArm = MAV_CMD_COMPONENT_ARM_DISARM;
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void a_silent_nav_is_held_at_its_last_setpoint_then_landed() {
    static Scene s;
    s.fly();
    s.nav.setpoint_x_m = 0.4F;
    s.nav.setpoint_vx_m_s = 0.5F;
    s.run(0.5);
    s.nav_runs = false;
    s.odom_runs = false;
    s.run(1.0);
    TEST_ASSERT_EQUAL(Phase::holding, s.bridge.flight().phase());
    mavlink_set_position_target_local_ned_t held{};
    for (const mavlink_message_t& m : s.out.autopilot) {
        if (m.msgid == MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED) { mavlink_msg_set_position_target_local_ned_decode(&m, &held); }
    }
    TEST_ASSERT_EQUAL_FLOAT(0.4F, held.x);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, held.vx);
    TEST_ASSERT_EQUAL_UINT32(static_cast<std::uint32_t>(s.t_us / 1000), held.time_boot_ms);
    s.run(3.0);
    TEST_ASSERT_EQUAL_UINT32(kLand, s.mode);
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().mission_lost);
    TEST_ASSERT_TRUE(s.said("holding position: nav silent"));
    TEST_ASSERT_TRUE(s.said("landing: nav silent"));
}

static void the_heartbeat_stops_while_nav_is_dead() {
    static Scene s;
    s.run(3.0);
    s.nav_runs = false;
    s.run(3.0);
    const auto beats = [] {
        std::size_t n = 0;
        for (const mavlink_message_t& m : s.out.ground) { n += m.msgid == MAVLINK_MSG_ID_HEARTBEAT && m.compid == MAV_COMP_ID_ONBOARD_COMPUTER ? 1U : 0U; }
        return n;
    };
    const std::size_t before = beats();
    s.run(10.0);
    TEST_ASSERT_EQUAL_size_t(before, beats());
    s.nav_runs = true;
    s.run(2.0);
    TEST_ASSERT_GREATER_THAN_size_t(before, beats());
}

static void setpoints_that_come_back_in_time_are_flown_again() {
    static Scene s;
    s.fly();
    s.nav.setpoint_valid = 0;
    s.run(1.0);
    TEST_ASSERT_EQUAL(Phase::holding, s.bridge.flight().phase());
    TEST_ASSERT_TRUE(s.said("holding position: no setpoint"));
    s.hold_setpoint();
    s.run(0.2);
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
    TEST_ASSERT_EQUAL_INT8(0, s.out.vehicle.back().mission_lost);
}

static void absurd_setpoints_are_never_sent() {
    for (int kind = 0; kind < 5; ++kind) {
        Scene s;
        s.fly();
        const std::size_t before = Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED);
        switch (kind) {
            case 0: s.nav.setpoint_x_m = kNaN; break;
            case 1: s.nav.setpoint_y_m = 50.0F; break;
            case 2: s.nav.setpoint_vz_m_s = -9.0F; break;
            case 3: s.nav.setpoint_yaw_rad = std::numeric_limits<float>::infinity(); break;
            default: s.nav.setpoint_z_m = -1e30F; break;
        }
        s.run(0.45);
        TEST_ASSERT_EQUAL_size_t(before, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED));
        TEST_ASSERT_GREATER_THAN_UINT32(5U, s.bridge.supervisor().counters().setpoints_refused);
        s.run(4.0);
        TEST_ASSERT_EQUAL_UINT32(kLand, s.mode);
        TEST_ASSERT_TRUE(s.said("absurd setpoints"));
    }
}

static void old_and_repeated_nav_messages_are_not_sent_again() {
    static Scene s;
    s.fly();
    const std::size_t before = Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED);
    for (int i = 0; i < 5; ++i) { s.bridge.on_nav(s.nav); }
    nav_t old = s.nav;
    old.t_us -= 200000;
    ++old.seq;
    s.bridge.on_nav(old);
    TEST_ASSERT_EQUAL_size_t(before, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED));
}

static void lasting_divergence_from_the_autopilot_lands() {
    for (const bool by_yaw : {false, true}) {
        Scene s;
        s.fly();
        if (by_yaw) { s.yaw_offset_rad = 0.8F; } else { s.local_offset.y_m = 1.3F; }
        s.run(0.9);
        TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
        s.run(1.5);
        TEST_ASSERT_EQUAL_UINT32(kLand, s.mode);
        TEST_ASSERT_TRUE(s.said("estimate and autopilot differ"));
        TEST_ASSERT_TRUE(s.ordered(command_t::ABORT));
    }
}

static void a_jump_of_our_pose_gives_the_autopilot_time_to_follow() {
    static Scene s;
    s.fly();
    ++s.odom.reset_counter;
    s.local_offset.x_m = 1.3F;
    s.run(2.8);
    s.local_offset.x_m = 0.0F;
    s.run(3.0);
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
}

static void an_estimate_that_stays_lost_lands_before_the_autopilot_notices() {
    static Scene s;
    s.fly();
    s.odom.quality = -1;
    s.run(3.0);
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
    s.run(2.5);
    TEST_ASSERT_EQUAL_UINT32(kLand, s.mode);
    TEST_ASSERT_TRUE(s.said("landing: estimate lost"));
}

static void a_nav_that_restarts_in_flight_is_not_trusted_again() {
    static Scene s;
    s.fly();
    s.nav.seq = 0;
    s.odom.seq = 0;
    s.odom.x_m = 5.0F;  // its new Map
    s.hold_setpoint();
    s.run(2.0);
    TEST_ASSERT_EQUAL_UINT32(kLand, s.mode);
    TEST_ASSERT_TRUE(s.said("nav restarted"));
    mavlink_odometry_t last{};
    for (const mavlink_message_t& m : s.out.autopilot) {
        if (m.msgid == MAVLINK_MSG_ID_ODOMETRY) { mavlink_msg_odometry_decode(&m, &last); }
    }
    TEST_ASSERT_EQUAL_INT8(-1, last.quality);
    TEST_ASSERT_EQUAL_UINT64(static_cast<std::uint64_t>(s.t_us), last.time_usec);  // every scan is answered all the same
}

static void on_the_ground_a_restarted_nav_shows_as_a_reset() {
    static Scene s;
    s.run(3.0);
    s.nav.seq = 0;
    s.odom.seq = 0;
    s.run(1.0);
    mavlink_odometry_t last{};
    for (const mavlink_message_t& m : s.out.autopilot) {
        if (m.msgid == MAVLINK_MSG_ID_ODOMETRY) { mavlink_msg_odometry_decode(&m, &last); }
    }
    TEST_ASSERT_EQUAL_INT8(90, last.quality);
    TEST_ASSERT_EQUAL_UINT8(1, last.reset_counter);
}

static void odometry_that_is_not_finite_is_never_passed_on() {
    static Scene s;
    s.run(3.0);
    s.odom.vx_m_s = kNaN;
    s.run(1.0);
    for (const mavlink_message_t& m : s.out.autopilot) {
        if (m.msgid != MAVLINK_MSG_ID_ODOMETRY) { continue; }
        mavlink_odometry_t o{};
        mavlink_msg_odometry_decode(&m, &o);
        TEST_ASSERT_TRUE(o.vx == o.vx && o.x == o.x);
        if (o.time_usec > 4100000U) { TEST_ASSERT_EQUAL_INT8(-1, o.quality); }
    }
}

static void a_disarm_in_flight_ends_the_mission() {
    static Scene s;
    s.fly();
    s.armed = false;
    s.run(1.5);
    TEST_ASSERT_EQUAL(Phase::yielded, s.bridge.flight().phase());
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().mission_lost);
    const std::size_t arms = s.commands(kArm).size();
    s.run(20.0);
    TEST_ASSERT_EQUAL_size_t(arms, s.commands(kArm).size());
}

static void an_autopilot_that_restarts_ends_the_flight_and_time_goes_on() {
    static Scene s;
    s.fly();
    s.run(10.0);
    s.t_us = 500000;
    s.armed = false;
    s.mode = kPosition;
    s.run(2.0);
    TEST_ASSERT_FALSE(s.bridge.flight().active());
    TEST_ASSERT_TRUE(s.said("autopilot restarted"));
    TEST_ASSERT_EQUAL_INT64(s.t_us, s.out.imu.back().t_us);
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().mission_lost);
}

static void the_pilot_may_take_over_while_the_bridge_lands() {
    static Scene s;
    s.fly();
    s.nav_runs = false;
    s.run(4.5);
    TEST_ASSERT_EQUAL_UINT32(kLand, s.mode);
    s.run(1.0);
    const std::size_t modes = s.commands(MAV_CMD_DO_SET_MODE).size();
    s.mode = kPosition;
    s.run(10.0);
    TEST_ASSERT_EQUAL(Phase::yielded, s.bridge.flight().phase());
    TEST_ASSERT_EQUAL_size_t(modes, s.commands(MAV_CMD_DO_SET_MODE).size());
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_silent_nav_is_held_at_its_last_setpoint_then_landed);
    RUN_TEST(the_heartbeat_stops_while_nav_is_dead);
    RUN_TEST(setpoints_that_come_back_in_time_are_flown_again);
    RUN_TEST(absurd_setpoints_are_never_sent);
    RUN_TEST(old_and_repeated_nav_messages_are_not_sent_again);
    RUN_TEST(lasting_divergence_from_the_autopilot_lands);
    RUN_TEST(a_jump_of_our_pose_gives_the_autopilot_time_to_follow);
    RUN_TEST(an_estimate_that_stays_lost_lands_before_the_autopilot_notices);
    RUN_TEST(a_nav_that_restarts_in_flight_is_not_trusted_again);
    RUN_TEST(on_the_ground_a_restarted_nav_shows_as_a_reset);
    RUN_TEST(odometry_that_is_not_finite_is_never_passed_on);
    RUN_TEST(a_disarm_in_flight_ends_the_mission);
    RUN_TEST(an_autopilot_that_restarts_ends_the_flight_and_time_goes_on);
    RUN_TEST(the_pilot_may_take_over_while_the_bridge_lands);
    return UNITY_END();
}
