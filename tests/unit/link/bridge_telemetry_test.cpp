// What the bridge tells and asks besides flying; commands that repeat; the pilot's switch; the fence and jumps.
#include <unity.h>

#include <algorithm>
#include <limits>
#include <memory>

#include "link/obstacle_ring.hpp"
#include "unit/link/bridge_scene.hpp"

using namespace noctule;
using scene::Scene;

namespace {

constexpr std::uint32_t kOffboard = 6U << 16U;

template <class Message>
std::vector<Message> all(const std::vector<mavlink_message_t>& from, const std::uint32_t id, void (*decode)(const mavlink_message_t*, Message*)) {
    std::vector<Message> found;
    for (const mavlink_message_t& m : from) {
        if (m.msgid != id) { continue; }
        Message in{};
        decode(&m, &in);
        found.push_back(in);
    }
    return found;
}

int orders(const Scene& s, const std::int32_t command) {
    int n = 0;
    for (const command_t& c : s.out.command) { n += c.command == command ? 1 : 0; }
    return n;
}

scan_t one_hit(const float bearing_rad, const float range_m) {
    static scan_t scan{};
    scan = {};
    scan.t_us = 1000000;
    scan.count = 2;
    scan.bearing_first_rad = bearing_rad;
    scan.bearing_increment_rad = 0.001F;
    scan.range_min_m = 0.06F;
    scan.range_max_m = 10.0F;
    scan.range_m[0] = range_m;
    scan.range_m[1] = std::numeric_limits<float>::quiet_NaN();
    return scan;
}

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void the_shortest_round_trip_tells_the_offset() {
    constexpr std::int64_t kOffset_us = 123456789;
    TimeSync sync;
    std::uint32_t random = 1;
    std::int64_t shortest_us = 1 << 30;
    for (int i = 0; i < 12; ++i) {
        random = random * 1664525U + 1013904223U;
        const std::int64_t there_us = 200 + (random >> 8U) % 20000;
        random = random * 1664525U + 1013904223U;
        const std::int64_t back_us = 200 + (random >> 8U) % 3000;
        const std::int64_t sent_us = 1000000LL * i;
        sync.add(sent_us, sent_us + there_us + kOffset_us, sent_us + there_us + back_us);
        shortest_us = std::min(shortest_us, there_us + back_us);
        TEST_ASSERT_EQUAL(i >= 3, sync.estimate().valid);
    }
    TEST_ASSERT_EQUAL_INT64(shortest_us, sync.estimate().round_trip_us);
    TEST_ASSERT_INT64_WITHIN(shortest_us / 2, kOffset_us, sync.estimate().offset_us);
    // A clock is set: after three contradictions all is forgotten, and the new offset is found.
    for (int i = 0; i < 8; ++i) { sync.add(20000000LL + i, 20000000LL + i + 500, 20000000LL + i + 1000); }
    TEST_ASSERT_TRUE(sync.estimate().valid);
    TEST_ASSERT_INT64_WITHIN(500, 0, sync.estimate().offset_us);
    sync.add(5, 6, 2000000);  // took too long
    sync.add(5, 6, 4);        // came before it was sent
    TEST_ASSERT_EQUAL_INT64(1000, sync.estimate().round_trip_us);
}

static void timesync_goes_both_ways() {
    static Scene s;
    s.run(2.0);
    mavlink_timesync_t ask{};
    ask.ts1 = 77;
    s.from_autopilot(mavlink_msg_timesync_encode_status, ask);
    const auto answer = all(s.out.autopilot, MAVLINK_MSG_ID_TIMESYNC, mavlink_msg_timesync_decode).back();
    TEST_ASSERT_EQUAL_INT64(77, answer.ts1);
    TEST_ASSERT_EQUAL_INT64(s.t_us * 1000, answer.tc1);
    for (int i = 0; i < 6; ++i) {
        s.bridge.set_clock(5000000 + i * 1000000);
        s.run(1.0);
        const auto question = all(s.out.autopilot, MAVLINK_MSG_ID_TIMESYNC, mavlink_msg_timesync_decode).back();
        TEST_ASSERT_EQUAL_INT64(0, question.tc1);
        mavlink_timesync_t reply{};
        reply.ts1 = question.ts1;
        reply.tc1 = question.ts1 + 300 * 1000 + 9000000000LL;  // 9 s ahead, 300 us after it was sent
        s.bridge.set_clock(question.ts1 / 1000 + 600);
        s.from_autopilot(mavlink_msg_timesync_encode_status, reply);
        s.from_autopilot(mavlink_msg_timesync_encode_status, reply);  // a repeat counts once
    }
    s.run(0.5);
    TEST_ASSERT_EQUAL_INT64(9000000, s.out.vehicle.back().clock_offset_us);
    TEST_ASSERT_EQUAL_INT32(600, s.out.vehicle.back().clock_round_trip_us);
}

static void an_obstacle_stands_in_the_sector_where_it_is() {
    const Parameters p;
    struct Case { float bearing_rad; std::size_t sector; };
    for (const Case& c : {Case{0.0F, 0}, Case{-0.5F * kPi, 18}, Case{kPi - 0.001F, 36}, Case{0.5F * kPi, 54}, Case{0.04F, 0}, Case{-0.05F, 1}}) {
        const mavlink_obstacle_distance_t out = to_obstacle_distance(one_hit(c.bearing_rad, 2.345F), p, 0.0F, 0.0F, 1.0F);
        for (std::size_t i = 0; i < 72; ++i) { TEST_ASSERT_EQUAL_UINT16(i == c.sector ? 235 : UINT16_MAX, out.distances[i]); }
        TEST_ASSERT_EQUAL_UINT8(MAV_FRAME_BODY_FRD, out.frame);
        TEST_ASSERT_EQUAL_UINT16(6, out.min_distance);
        TEST_ASSERT_EQUAL_UINT16(1000, out.max_distance);
        TEST_ASSERT_EQUAL_FLOAT(5.0F, out.increment_f);
        TEST_ASSERT_EQUAL_UINT64(1000000, out.time_usec);
    }
    const float infinity = std::numeric_limits<float>::infinity();
    TEST_ASSERT_EQUAL_UINT16(1001, to_obstacle_distance(one_hit(0.0F, infinity), p, 0.0F, 0.0F, 1.0F).distances[0]);
    TEST_ASSERT_EQUAL_UINT16(UINT16_MAX, to_obstacle_distance(one_hit(0.0F, 0.01F), p, 0.0F, 0.0F, 1.0F).distances[0]);
    // Nose down by 0.2 rad at 1 m: a hit 6 m ahead is the floor, one at 2 m is not. Leaning far: nothing is claimed.
    TEST_ASSERT_EQUAL_UINT16(UINT16_MAX, to_obstacle_distance(one_hit(0.0F, 6.0F), p, 0.0F, 0.2F, 1.0F).distances[0]);
    TEST_ASSERT_EQUAL_UINT16(200, to_obstacle_distance(one_hit(0.0F, 2.0F), p, 0.0F, 0.2F, 1.0F).distances[0]);
    TEST_ASSERT_EQUAL_UINT16(600, to_obstacle_distance(one_hit(0.0F, 6.0F), p, 0.0F, -0.2F, 1.0F).distances[0]);
    TEST_ASSERT_EQUAL_UINT16(UINT16_MAX, to_obstacle_distance(one_hit(0.0F, 2.0F), p, 0.5F, 0.0F, 1.0F).distances[0]);
}

static void scans_become_obstacles_at_ten_hertz() {
    static Scene s;
    s.run(1.0);
    for (int i = 0; i < 40; ++i) {
        s.tick();
        scan_t scan = one_hit(0.0F, 3.0F);
        scan.t_us = s.t_us;
        s.bridge.on_scan(scan);
    }
    TEST_ASSERT_EQUAL_size_t(20, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_OBSTACLE_DISTANCE));
    TEST_ASSERT_EQUAL_size_t(20, Scene::count(s.out.ground, MAVLINK_MSG_ID_OBSTACLE_DISTANCE));
}

static void an_origin_is_given_and_verified_and_one_that_is_there_stays() {
    static Scene s;
    s.autopilot_type = MAV_AUTOPILOT_ARDUPILOTMEGA;
    s.run(3.5);
    const auto before = all(s.out.autopilot, MAVLINK_MSG_ID_PARAM_SET, mavlink_msg_param_set_decode);
    TEST_ASSERT_EQUAL_size_t(1, before.size());  // else it would count its rest height twice
    TEST_ASSERT_EQUAL_STRING("BARO_FIELD_ELV", before[0].param_id);
    TEST_ASSERT_EQUAL_FLOAT(488.0F, before[0].param_value);
    TEST_ASSERT_EQUAL_size_t(0, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_COMMAND_INT) + Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN));
    s.run(2.5);
    const auto set = all(s.out.autopilot, MAVLINK_MSG_ID_COMMAND_INT, mavlink_msg_command_int_decode);
    TEST_ASSERT_GREATER_OR_EQUAL_size_t(1, set.size());
    TEST_ASSERT_EQUAL_UINT16(611, set[0].command);
    TEST_ASSERT_INT32_WITHIN(1000, 473974000, set[0].x);  // 0.82724 rad
    TEST_ASSERT_INT32_WITHIN(2000, 85451000, set[0].y);
    TEST_ASSERT_EQUAL_FLOAT(488.0F, set[0].z);
    mavlink_gps_global_origin_t told{};
    told.latitude = set[0].x;
    told.longitude = set[0].y;
    s.from_autopilot(mavlink_msg_gps_global_origin_encode_status, told);
    TEST_ASSERT_TRUE(s.said("global origin set"));
    s.run(10.0);
    TEST_ASSERT_EQUAL_size_t(set.size(), Scene::count(s.out.autopilot, MAVLINK_MSG_ID_COMMAND_INT));
    static Scene has_one;
    has_one.autopilot_type = MAV_AUTOPILOT_ARDUPILOTMEGA;
    has_one.run(1.0);
    has_one.from_autopilot(mavlink_msg_gps_global_origin_encode_status, told);
    has_one.run(20.0);
    TEST_ASSERT_EQUAL_size_t(0, Scene::count(has_one.out.autopilot, MAVLINK_MSG_ID_COMMAND_INT));
    static Scene deaf;
    deaf.autopilot_type = MAV_AUTOPILOT_ARDUPILOTMEGA;
    deaf.run(40.0);
    TEST_ASSERT_TRUE(deaf.said("global origin not confirmed"));
    TEST_ASSERT_GREATER_OR_EQUAL_size_t(3, Scene::count(deaf.out.autopilot, MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN));
}

/// Rates that the bridge asked the autopilot for since `begin`, of one message.
int asked_since(const Scene& s, const std::size_t begin, const std::uint32_t msgid) {
    int n = 0;
    for (std::size_t i = begin; i < s.out.autopilot.size(); ++i) {
        const mavlink_message_t& m = s.out.autopilot[i];
        if (m.msgid != MAVLINK_MSG_ID_COMMAND_LONG || m.compid != MAV_COMP_ID_ONBOARD_COMPUTER) { continue; }
        mavlink_command_long_t c{};
        mavlink_msg_command_long_decode(&m, &c);
        n += c.command == MAV_CMD_SET_MESSAGE_INTERVAL && c.param1 == static_cast<float>(msgid) ? 1 : 0;
    }
    return n;
}

static void rates_that_a_ground_station_asks_for_do_not_slow_ours() {
    static Scene s;
    s.run(4.0);
    std::size_t before = s.out.autopilot.size();
    mavlink_request_data_stream_t all{};
    all.target_system = scene::kSystem;
    all.target_component = MAV_COMP_ID_AUTOPILOT1;
    all.req_message_rate = 4;
    all.start_stop = 1;
    s.from_ground(mavlink_msg_request_data_stream_encode_status, all);
    TEST_ASSERT_EQUAL_UINT32(MAVLINK_MSG_ID_REQUEST_DATA_STREAM, s.out.autopilot[before].msgid);   // first theirs, then ours
    for (const std::uint32_t msgid : {MAVLINK_MSG_ID_HIGHRES_IMU, MAVLINK_MSG_ID_DISTANCE_SENSOR, MAVLINK_MSG_ID_LOCAL_POSITION_NED}) {
        TEST_ASSERT_EQUAL_INT(1, asked_since(s, before, msgid));
    }
    mavlink_command_long_t one{};
    one.target_system = scene::kSystem;
    one.target_component = MAV_COMP_ID_AUTOPILOT1;
    one.command = MAV_CMD_SET_MESSAGE_INTERVAL;
    one.param2 = 1e6F;
    one.param1 = MAVLINK_MSG_ID_VFR_HUD;                        // none of ours
    before = s.out.autopilot.size();
    s.from_ground(mavlink_msg_command_long_encode_status, one);
    TEST_ASSERT_EQUAL_INT(0, asked_since(s, before, MAVLINK_MSG_ID_DISTANCE_SENSOR));
    one.param1 = MAVLINK_MSG_ID_DISTANCE_SENSOR;
    before = s.out.autopilot.size();
    s.from_ground(mavlink_msg_command_long_encode_status, one);
    TEST_ASSERT_EQUAL_INT(1, asked_since(s, before, MAVLINK_MSG_ID_DISTANCE_SENSOR));
}

static void in_a_mission_an_ardupilot_is_not_asked_for_its_lists() {
    for (const std::uint8_t type : {std::uint8_t{MAV_AUTOPILOT_ARDUPILOTMEGA}, std::uint8_t{MAV_AUTOPILOT_PX4}}) {
        const auto s = std::make_unique<Scene>();
        s->autopilot_type = type;
        mavlink_param_request_list_t list{};
        list.target_system = scene::kSystem;
        mavlink_file_transfer_protocol_t file{};
        file.target_system = scene::kSystem;
        file.target_component = MAV_COMP_ID_AUTOPILOT1;
        mavlink_param_request_read_t one{};
        one.target_system = scene::kSystem;
        one.target_component = MAV_COMP_ID_AUTOPILOT1;
        const auto passed = [&] {
            const std::size_t before = s->out.autopilot.size();
            for (const std::uint8_t component : {std::uint8_t{0}, std::uint8_t{MAV_COMP_ID_AUTOPILOT1}}) {
                list.target_component = component;
                s->from_ground(mavlink_msg_param_request_list_encode_status, list);
            }
            s->from_ground(mavlink_msg_file_transfer_protocol_encode_status, file);
            s->from_ground(mavlink_msg_param_request_read_encode_status, one);
            return std::count_if(s->out.autopilot.begin() + static_cast<std::ptrdiff_t>(before), s->out.autopilot.end(), [](const mavlink_message_t& m) { return m.sysid == 255; });
        };
        s->run(3.0);
        TEST_ASSERT_EQUAL(4, passed());                  // on the ground all pass
        TEST_ASSERT_FALSE(s->said("wait until landed"));
        s->fly();
        TEST_ASSERT_TRUE(s->bridge.flight().active());
        const bool ardupilot = type == MAV_AUTOPILOT_ARDUPILOTMEGA;
        TEST_ASSERT_EQUAL(ardupilot ? 1 : 4, passed());  // the single parameter
        TEST_ASSERT_EQUAL(ardupilot, s->said("wait until landed"));
        list.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;   // our own table is no matter of the autopilot's
        const std::size_t values = Scene::count(s->out.ground, MAVLINK_MSG_ID_PARAM_VALUE);
        s->from_ground(mavlink_msg_param_request_list_encode_status, list);
        s->run(2.0);
        TEST_ASSERT_GREATER_THAN_size_t(values + 20, Scene::count(s->out.ground, MAVLINK_MSG_ID_PARAM_VALUE));
    }
}

static int asks_for_the_place(const Scene& s) {
    int n = 0;
    for (const mavlink_command_long_t& c : s.commands(MAV_CMD_SET_MESSAGE_INTERVAL)) { n += c.param1 == static_cast<float>(MAVLINK_MSG_ID_GLOBAL_POSITION_INT) ? 1 : 0; }
    return n;
}

static void the_place_on_the_map_is_asked_for_where_there_is_one() {
    mavlink_gps_global_origin_t origin{};
    origin.latitude = 473974000;
    origin.longitude = 85451000;
    for (const std::uint8_t type : {std::uint8_t{MAV_AUTOPILOT_ARDUPILOTMEGA}, std::uint8_t{MAV_AUTOPILOT_PX4}}) {
        const auto s = std::make_unique<Scene>();
        s->autopilot_type = type;
        s->run(8.0);
        TEST_ASSERT_EQUAL_INT(0, asks_for_the_place(*s));       // no origin yet
        s->from_autopilot(mavlink_msg_gps_global_origin_encode_status, origin);
        s->run(12.0);
        if (type == MAV_AUTOPILOT_PX4) {
            TEST_ASSERT_EQUAL_INT(0, asks_for_the_place(*s));
            continue;
        }
        const int asked = asks_for_the_place(*s);
        TEST_ASSERT_GREATER_OR_EQUAL_INT(2, asked);             // again and again while it does not come
        for (int i = 0; i < 20; ++i) {
            s->run(1.0);
            s->from_autopilot(mavlink_msg_global_position_int_encode_status, mavlink_global_position_int_t{});
        }
        TEST_ASSERT_LESS_OR_EQUAL_INT(asked + 1, asks_for_the_place(*s));
    }
}

static void px4_gets_no_origin_and_does_not_start_with_one_that_it_makes_nothing_of() {
    static Scene s;
    s.run(40.0);
    TEST_ASSERT_EQUAL_size_t(0, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_PARAM_SET));
    TEST_ASSERT_EQUAL_size_t(0, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_COMMAND_INT));
    TEST_ASSERT_EQUAL_size_t(0, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN));
    TEST_ASSERT_FALSE(s.said("origin"));
    mavlink_gps_global_origin_t told{};
    told.latitude = 473974000;
    s.from_autopilot(mavlink_msg_gps_global_origin_encode_status, told);  // somebody else gave it one
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(s.said("global origin, no global position"));
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_DENIED, s.results(MAV_CMD_MISSION_START).at(0));
    s.from_autopilot(mavlink_msg_global_position_int_encode_status, mavlink_global_position_int_t{});  // it knows where it is
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_MISSION_START).at(1));
}

static void two_autopilots_refuse_the_start_until_one_is_chosen() {
    static Scene s;
    MavlinkWriter other;
    other.set_ids(9, MAV_COMP_ID_AUTOPILOT1);
    mavlink_heartbeat_t beat{};
    beat.autopilot = MAV_AUTOPILOT_PX4;
    s.run(3.0);
    s.bridge.from_autopilot(other.pack(mavlink_msg_heartbeat_encode_status, beat));
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_DENIED, s.results(MAV_CMD_MISSION_START).at(0));
    TEST_ASSERT_TRUE(s.said("two autopilots"));
    s.run(6.0);  // gone
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_MISSION_START).at(1));
}

static void an_estimator_without_a_position_refuses_the_start() {
    static Scene s;
    s.run(3.0);
    mavlink_estimator_status_t m{};
    m.flags = 0x0027;  // attitude, velocities, height: no horizontal position
    s.from_autopilot(mavlink_msg_estimator_status_encode_status, m);
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(s.said("EKF has no position"));
    m.flags = 0x01AF;  // PX4 1.17 at rest with a good position: the constant position mode is on
    s.from_autopilot(mavlink_msg_estimator_status_encode_status, m);
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_MISSION_START).at(1));
}

static void ardupilots_estimator_report_is_read_though_it_is_of_another_dialect() {
    static Scene s;
    s.run(3.0);
    // Written by pymavlink (dialect ardupilotmega): system 7, component 1, flags 0x0080 (constant position), position variance 0.25.
    const std::array<std::uint8_t, 33> frame{0xFD, 0x15, 0x00, 0x00, 0x00, 0x07, 0x01, 0xC1, 0x00, 0x00, 0x00, 0x00, 0x00, 0x3F, 0x00, 0x00, 0x80, 0x3E,
                                             0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x80, 0xF2, 0xED};
    s.bridge.from_autopilot(frame);
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(s.said("EKF has no position"));
}

static void repeated_orders_are_answered_and_given_once() {
    static Scene s;
    s.fly();
    for (int i = 0; i < 3; ++i) { s.ask(MAV_CMD_DO_PAUSE_CONTINUE, 0.0F); }
    TEST_ASSERT_EQUAL_INT(1, orders(s, command_t::PAUSE));
    s.nav.state = static_cast<std::int32_t>(MissionState::paused);
    s.run(3.0);
    s.ask(MAV_CMD_DO_PAUSE_CONTINUE, 0.0F);
    TEST_ASSERT_EQUAL_INT(1, orders(s, command_t::PAUSE));
    s.ask(MAV_CMD_DO_PAUSE_CONTINUE, 1.0F);
    TEST_ASSERT_EQUAL_INT(1, orders(s, command_t::RESUME));
    s.ask(MAV_CMD_DO_PAUSE_CONTINUE, 0.4F);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_DENIED, s.results(MAV_CMD_DO_PAUSE_CONTINUE).back());
    s.nav.state = static_cast<std::int32_t>(MissionState::returning_home);
    s.run(3.0);
    s.ask(MAV_CMD_NAV_RETURN_TO_LAUNCH);
    TEST_ASSERT_EQUAL_INT(0, orders(s, command_t::RETURN_HOME));
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_NAV_RETURN_TO_LAUNCH).back());
    s.ask(MAV_CMD_NAV_LAND);
    s.run(2.0);
    s.ask(MAV_CMD_NAV_LAND);  // nav has not begun: told again
    TEST_ASSERT_EQUAL_INT(2, orders(s, command_t::LAND));
    s.ask(MAV_CMD_USER_1);
    TEST_ASSERT_EQUAL_INT(1, orders(s, command_t::ABORT));
    s.ask(MAV_CMD_DO_JUMP);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_UNSUPPORTED, s.results(MAV_CMD_DO_JUMP).back());
}

static void the_pilots_switch_starts_and_the_pilot_arms() {
    static Scene s;
    s.parameters.link_start_by = 1;
    s.obeys_arm = s.obeys_mode = false;
    s.run(3.0);
    const std::size_t standing = Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED);
    TEST_ASSERT_UINT32_WITHIN(8, 44, static_cast<std::uint32_t>(standing));  // on the spot, so that PX4 accepts the mode
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_DENIED, s.results(MAV_CMD_MISSION_START).at(0));
    s.armed = true;
    s.run(1.0);
    TEST_ASSERT_EQUAL_INT(0, orders(s, command_t::START));
    s.mode = kOffboard;
    s.hold_setpoint();
    s.run(1.5);
    TEST_ASSERT_EQUAL_INT(1, orders(s, command_t::START));
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
    TEST_ASSERT_EQUAL_size_t(0, s.commands(MAV_CMD_COMPONENT_ARM_DISARM).size());
    TEST_ASSERT_EQUAL_size_t(0, s.commands(MAV_CMD_DO_SET_MODE).size());
    s.mode = 3U << 16U;  // and he takes it back
    s.run(2.0);
    TEST_ASSERT_EQUAL(Phase::yielded, s.bridge.flight().phase());
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().mission_lost);
    s.nav.ready = 0;
    s.mode = kOffboard;
    s.run(2.0);
    TEST_ASSERT_EQUAL_INT(1, orders(s, command_t::START));
    TEST_ASSERT_TRUE(s.said("start refused: nav is not ready"));
}

static void map_only_sends_no_setpoint_and_asks_for_nothing() {
    static Scene s;
    s.bridge.set_map_only();
    s.parameters.link_start_by = 1;
    s.run(3.0);
    s.parameters.link_start_by = 0;
    s.ask(MAV_CMD_MISSION_START);
    s.hold_setpoint();
    s.run(5.0);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_DENIED, s.results(MAV_CMD_MISSION_START).at(0));
    TEST_ASSERT_EQUAL_size_t(0, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED));
    TEST_ASSERT_EQUAL_size_t(0, s.commands(MAV_CMD_COMPONENT_ARM_DISARM).size());
    TEST_ASSERT_EQUAL_size_t(0, s.commands(MAV_CMD_DO_SET_MODE).size());
    TEST_ASSERT_GREATER_THAN_size_t(100, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_ODOMETRY));
}

static void a_setpoint_outside_the_fence_is_not_sent() {
    static Scene s;
    s.fly();
    s.parameters.fence_radius_m = 2.0F;
    s.nav.setpoint_x_m = 2.2F;  // within the margin of the guard's rounding
    s.run(0.5);
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
    s.nav.setpoint_x_m = 2.5F;
    s.run(1.0);
    TEST_ASSERT_EQUAL(Phase::holding, s.bridge.flight().phase());
    TEST_ASSERT_TRUE(s.said("holding position: absurd setpoints"));
}

static void a_setpoint_that_jumps_is_not_sent_but_one_that_stays_there_is_taken_after_a_hold() {
    static Scene s;
    s.parameters.link_setpoint_jump_m = 0.5F;
    s.parameters.link_setpoint_speed_m_s = 1.0F;
    s.fly();
    const auto farthest = [] {
        float x = 0.0F;
        for (const auto& m : all(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, mavlink_msg_set_position_target_local_ned_decode)) { x = std::max(x, m.x); }
        return x;
    };
    s.nav.setpoint_x_m = 1.5F;  // 0.5 m and what 1 m/s explains are allowed
    s.run(0.4);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, farthest());
    s.run(1.0);
    TEST_ASSERT_EQUAL_FLOAT(1.5F, farthest());
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
    TEST_ASSERT_GREATER_THAN_UINT32(5, s.bridge.supervisor().counters().setpoints_refused);
}

static void silence_of_the_ground_orders_the_return_where_it_is_wished() {
    static Scene s;
    s.fly();
    s.run(20.0);
    TEST_ASSERT_EQUAL_INT(0, orders(s, command_t::RETURN_HOME));
    s.parameters.link_ground_timeout_s = 5.0F;
    s.run(10.0);
    TEST_ASSERT_EQUAL_INT(1, orders(s, command_t::RETURN_HOME));
    TEST_ASSERT_TRUE(s.said("ground station silent"));
}

static void the_older_vision_message_is_a_choice_and_says_nothing_when_nothing_is_known() {
    static Scene s;
    s.parameters.link_vision_message = 1;
    s.odom.x_m = 1.0F;
    s.odom.y_m = 2.0F;
    s.odom.z_m = 3.0F;
    s.odom.roll_rad = 0.1F;
    s.odom.pitch_rad = 0.2F;
    s.odom.yaw_rad = 0.3F;
    s.odom.position_var_m2[1] = 0.5F;
    s.odom.reset_counter = 257;
    s.run(1.0);
    TEST_ASSERT_EQUAL_size_t(0, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_ODOMETRY));
    const auto sent = all(s.out.autopilot, MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE, mavlink_msg_vision_position_estimate_decode);
    TEST_ASSERT_EQUAL_size_t(20, sent.size());
    TEST_ASSERT_EQUAL_FLOAT(1.0F, sent[0].x);
    TEST_ASSERT_EQUAL_FLOAT(-2.0F, sent[0].y);
    TEST_ASSERT_EQUAL_FLOAT(-3.0F, sent[0].z);
    TEST_ASSERT_EQUAL_FLOAT(0.1F, sent[0].roll);
    TEST_ASSERT_EQUAL_FLOAT(-0.2F, sent[0].pitch);
    TEST_ASSERT_EQUAL_FLOAT(-0.3F, sent[0].yaw);
    TEST_ASSERT_EQUAL_FLOAT(0.5F, sent[0].covariance[6]);
    TEST_ASSERT_EQUAL_UINT8(1, sent[0].reset_counter);
    s.odom.quality = -1;
    s.run(1.0);
    TEST_ASSERT_EQUAL_size_t(20, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE));
}

static void progress_and_load_reach_the_ground() {
    static Scene s;
    s.nav.explored_share = 0.75F;
    s.fly();
    mavlink_sys_status_t power{};
    power.battery_remaining = 90;
    s.from_autopilot(mavlink_msg_sys_status_encode_status, power);
    s.armed = false;
    s.run(2.0);
    s.armed = true;
    s.run(100.0);
    power.battery_remaining = 80;
    s.from_autopilot(mavlink_msg_sys_status_encode_status, power);
    s.run(1.5);
    float left_s = -2.0F;
    float explored = -2.0F;
    for (const auto& m : all(s.out.ground, MAVLINK_MSG_ID_NAMED_VALUE_FLOAT, mavlink_msg_named_value_float_decode)) {
        if (std::strncmp(m.name, "time_left", sizeof m.name) == 0) { left_s = m.value; }
        if (std::strncmp(m.name, "explored", sizeof m.name) == 0) { explored = m.value; }
    }
    TEST_ASSERT_EQUAL_FLOAT(0.75F, explored);
    TEST_ASSERT_FLOAT_WITHIN(40.0F, (0.8F - s.parameters.battery_return) * 1030.0F, left_s);
    ComputerLoad load;
    load.cpu_percent = 42;
    load.ram_used_mib = 100;
    load.ram_total_mib = 4000;
    s.bridge.on_computer(load);
    const auto status = all(s.out.ground, MAVLINK_MSG_ID_ONBOARD_COMPUTER_STATUS, mavlink_msg_onboard_computer_status_decode).back();
    TEST_ASSERT_EQUAL_UINT8(42, status.cpu_combined[0]);
    TEST_ASSERT_EQUAL_UINT8(UINT8_MAX, status.cpu_combined[1]);
    TEST_ASSERT_EQUAL_UINT32(100, status.ram_usage);
    TEST_ASSERT_EQUAL_INT8(INT8_MAX, status.temperature_board);
    s.nav.floor = 1;
    s.run(0.1);
    TEST_ASSERT_TRUE(s.said("floor 1"));
    static objects_t objects{};
    objects.count = 1;
    objects.object_id[0] = 3;
    s.run(6.0);
    s.bridge.on_objects(objects);
    s.bridge.on_objects(objects);
    TEST_ASSERT_TRUE(s.said("object 3 seen"));
}

static void the_best_kind_of_inertial_data_that_comes_serves() {
    static Scene s;
    s.run(2.0);
    const std::size_t before = s.out.imu.size();
    mavlink_scaled_imu3_t third{};
    third.zacc = -1000;
    third.xgyro = 1000;
    for (int i = 1; i <= 75; ++i) {
        third.time_boot_ms = static_cast<std::uint32_t>(s.t_us / 1000 + 20 * i);
        s.from_autopilot(mavlink_msg_scaled_imu3_encode_status, third);
    }
    TEST_ASSERT_UINT32_WITHIN(2, 25, static_cast<std::uint32_t>(s.out.imu.size() - before));  // after a second of silence of the better ones
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 9.80665F, s.out.imu.back().accel_m_s2[2]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 1.0F, s.out.imu.back().gyro_rad_s[0]);
    mavlink_raw_imu_t raw{};
    raw.time_usec = static_cast<std::uint64_t>(s.t_us + 1600000);
    s.from_autopilot(mavlink_msg_raw_imu_encode_status, raw);
    TEST_ASSERT_NOT_EQUAL(s.t_us + 1600000, s.out.imu.back().t_us);  // PX4's raw units are the sensor's
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(the_shortest_round_trip_tells_the_offset);
    RUN_TEST(timesync_goes_both_ways);
    RUN_TEST(an_obstacle_stands_in_the_sector_where_it_is);
    RUN_TEST(scans_become_obstacles_at_ten_hertz);
    RUN_TEST(an_origin_is_given_and_verified_and_one_that_is_there_stays);
    RUN_TEST(rates_that_a_ground_station_asks_for_do_not_slow_ours);
    RUN_TEST(in_a_mission_an_ardupilot_is_not_asked_for_its_lists);
    RUN_TEST(the_place_on_the_map_is_asked_for_where_there_is_one);
    RUN_TEST(px4_gets_no_origin_and_does_not_start_with_one_that_it_makes_nothing_of);
    RUN_TEST(two_autopilots_refuse_the_start_until_one_is_chosen);
    RUN_TEST(an_estimator_without_a_position_refuses_the_start);
    RUN_TEST(ardupilots_estimator_report_is_read_though_it_is_of_another_dialect);
    RUN_TEST(repeated_orders_are_answered_and_given_once);
    RUN_TEST(the_pilots_switch_starts_and_the_pilot_arms);
    RUN_TEST(map_only_sends_no_setpoint_and_asks_for_nothing);
    RUN_TEST(a_setpoint_outside_the_fence_is_not_sent);
    RUN_TEST(a_setpoint_that_jumps_is_not_sent_but_one_that_stays_there_is_taken_after_a_hold);
    RUN_TEST(silence_of_the_ground_orders_the_return_where_it_is_wished);
    RUN_TEST(the_older_vision_message_is_a_choice_and_says_nothing_when_nothing_is_known);
    RUN_TEST(progress_and_load_reach_the_ground);
    RUN_TEST(the_best_kind_of_inertial_data_that_comes_serves);
    return UNITY_END();
}
