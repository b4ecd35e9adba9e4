// Parameters through the bridge: written, refused, handed to nav, stored; and the autopilot's own before a start.
#include <unity.h>

#include <bit>
#include <limits>

#include "unit/link/bridge_scene.hpp"

using namespace noctule;
using scene::Scene;

namespace {

void write(Scene& s, const char* id, const float value, const std::uint8_t type = MAV_PARAM_TYPE_REAL32) {
    mavlink_param_set_t set{};
    set.target_system = scene::kSystem;
    set.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
    set.param_value = value;
    set.param_type = type;
    std::memcpy(set.param_id, id, strnlen(id, sizeof set.param_id));
    s.from_ground(mavlink_msg_param_set_encode_status, set);
}

mavlink_param_value_t newest_value(const Scene& s) {
    mavlink_param_value_t value{};
    for (const mavlink_message_t& m : s.out.ground) {
        if (m.msgid == MAVLINK_MSG_ID_PARAM_VALUE && m.compid == MAV_COMP_ID_ONBOARD_COMPUTER) { mavlink_msg_param_value_decode(&m, &value); }
    }
    return value;
}

int newest_error(const Scene& s) {
    int error = -1;
    for (const mavlink_message_t& m : s.out.ground) {
        if (m.msgid == MAVLINK_MSG_ID_PARAM_ERROR) { error = mavlink_msg_param_error_get_error(&m); }
    }
    return error;
}

float sent_to_nav(const Scene& s, const char* id) {
    return s.out.tables.back().value[static_cast<std::size_t>(find_parameter(id) - kParameterTable.data())];
}

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void a_write_takes_effect_here_reaches_nav_and_is_stored() {
    static Scene s;
    s.run(2.0);
    TEST_ASSERT_EQUAL_size_t(0, s.out.tables.size());
    write(s, "SPEED_MAX", 0.75F);
    TEST_ASSERT_EQUAL_FLOAT(0.75F, s.parameters.speed_max_m_s);
    TEST_ASSERT_EQUAL_FLOAT(0.75F, newest_value(s).param_value);
    TEST_ASSERT_EQUAL_size_t(1, s.out.tables.size());
    TEST_ASSERT_EQUAL_FLOAT(0.75F, sent_to_nav(s, "SPEED_MAX"));
    TEST_ASSERT_EQUAL_size_t(1, s.out.stored.size());
    TEST_ASSERT_EQUAL_FLOAT(0.75F, s.out.stored[0].speed_max_m_s);
    write(s, "SPEED_MAX", 0.75F);  // a repeat is answered and changes nothing
    TEST_ASSERT_EQUAL_size_t(1, s.out.tables.size());
    TEST_ASSERT_EQUAL_size_t(1, s.out.stored.size());
}

static void a_bad_value_is_refused_with_the_limits_and_the_value_that_holds() {
    static Scene s;
    s.run(2.0);
    const ParameterRow& row = *find_parameter("SPEED_MAX");
    const float before = s.parameters.speed_max_m_s;
    for (const float bad : {row.max * 1.01F, row.min - 0.01F, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
        s.out.ground.clear();
        write(s, "SPEED_MAX", bad);
        TEST_ASSERT_EQUAL_FLOAT(before, s.parameters.speed_max_m_s);
        TEST_ASSERT_EQUAL_FLOAT(before, newest_value(s).param_value);
        TEST_ASSERT_EQUAL_INT(MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE, newest_error(s));
        s.run(6.0);
    }
    s.out.ground.clear();
    write(s, "SPEED_MAX", 99.0F);
    TEST_ASSERT_TRUE(s.said("SPEED_MAX refused: 0."));
    write(s, "NO_SUCH_THING", 1.0F);
    TEST_ASSERT_EQUAL_INT(MAV_PARAM_ERROR_DOES_NOT_EXIST, newest_error(s));
    TEST_ASSERT_TRUE(s.said("no parameter NO_SUCH_THING"));
    write(s, "LNK_PREFLIGHT", 0.5F);
    TEST_ASSERT_TRUE(s.said("LNK_PREFLIGHT refused: a whole number"));
    write(s, "SPEED_MAX", 1.0F, MAV_PARAM_TYPE_REAL64);
    TEST_ASSERT_TRUE(s.said("SPEED_MAX refused: unknown type"));
    TEST_ASSERT_EQUAL_size_t(0, s.out.stored.size());
    TEST_ASSERT_EQUAL_size_t(0, s.out.tables.size());
}

static void whole_numbers_go_in_the_encoding_of_the_autopilot() {
    static Scene px4;
    px4.run(2.0);
    write(px4, "LNK_PREFLIGHT", std::bit_cast<float>(std::int32_t{1}), MAV_PARAM_TYPE_INT32);
    TEST_ASSERT_EQUAL_INT32(1, px4.parameters.link_preflight);
    TEST_ASSERT_EQUAL_UINT8(MAV_PARAM_TYPE_INT32, newest_value(px4).param_type);
    TEST_ASSERT_EQUAL_INT32(1, std::bit_cast<std::int32_t>(newest_value(px4).param_value));
    write(px4, "LNK_PREFLIGHT", 0.0F);  // as a plain float: the same in both
    TEST_ASSERT_EQUAL_INT32(0, px4.parameters.link_preflight);
    static Scene ardupilot;
    ardupilot.autopilot_type = MAV_AUTOPILOT_ARDUPILOTMEGA;
    ardupilot.run(2.0);
    write(ardupilot, "LNK_PREFLIGHT", 1.0F, MAV_PARAM_TYPE_INT32);
    TEST_ASSERT_EQUAL_INT32(1, ardupilot.parameters.link_preflight);
    TEST_ASSERT_EQUAL_FLOAT(1.0F, newest_value(ardupilot).param_value);
}

static void a_row_that_needs_a_restart_is_stored_and_says_so() {
    static Scene s;
    s.run(2.0);
    write(s, "HULL_RADIUS", 0.4F);
    TEST_ASSERT_EQUAL_FLOAT(0.3F, s.parameters.hull_radius_m);
    TEST_ASSERT_EQUAL_FLOAT(0.4F, newest_value(s).param_value);
    TEST_ASSERT_EQUAL_FLOAT(0.4F, s.out.stored.at(0).hull_radius_m);
    TEST_ASSERT_TRUE(s.said("HULL_RADIUS takes effect at the next start"));
    TEST_ASSERT_EQUAL_size_t(0, s.out.tables.size());
}

static void in_flight_a_write_takes_effect_and_the_file_waits_for_the_ground() {
    static Scene s;
    s.fly();
    write(s, "SPEED_MAX", 0.5F);
    TEST_ASSERT_EQUAL_FLOAT(0.5F, sent_to_nav(s, "SPEED_MAX"));
    TEST_ASSERT_EQUAL_size_t(0, s.out.stored.size());
    s.armed = false;
    s.run(2.0);
    TEST_ASSERT_EQUAL_size_t(1, s.out.stored.size());
}

static void the_table_is_sent_again_until_nav_flies_it() {
    static Scene s;
    s.run(3.0);
    s.obeys_tables = false;
    write(s, "SPEED_MAX", 0.5F);
    s.run(3.5);
    TEST_ASSERT_GREATER_OR_EQUAL_size_t(4, s.out.tables.size());
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_TEMPORARILY_REJECTED, s.results(MAV_CMD_MISSION_START).at(0));
    TEST_ASSERT_TRUE(s.said("nav has other parameter values"));
    s.obeys_tables = true;
    s.run(0.1);
    const std::size_t before = s.out.tables.size();
    s.run(3.0);
    TEST_ASSERT_EQUAL_size_t(before, s.out.tables.size());
}

static void two_lists_at_once_cost_neither_a_row() {
    static Scene s;
    s.run(2.0);
    mavlink_param_request_list_t list{};
    list.target_system = scene::kSystem;
    s.from_ground(mavlink_msg_param_request_list_encode_status, list);
    s.run(1.0);
    const std::size_t begin = s.out.ground.size();
    s.from_ground(mavlink_msg_param_request_list_encode_status, list);
    s.run(20.0);
    std::array<int, kParameterTable.size()> seen_by_second{};
    for (std::size_t i = begin; i < s.out.ground.size(); ++i) {
        const mavlink_message_t& m = s.out.ground[i];
        if (m.msgid != MAVLINK_MSG_ID_PARAM_VALUE || m.compid != MAV_COMP_ID_ONBOARD_COMPUTER) { continue; }
        mavlink_param_value_t value{};
        mavlink_msg_param_value_decode(&m, &value);
        ++seen_by_second[value.param_index];
    }
    for (const int seen : seen_by_second) { TEST_ASSERT_EQUAL_INT(1, seen); }
}

static void wrong_autopilot_parameters_refuse_the_start_and_are_named() {
    static Scene s;
    s.autopilot_parameters = {{"EKF2_HGT_REF", 1.0F}, {"EKF2_EV_CTRL", 7.0F}};
    s.run(3.0);
    TEST_ASSERT_TRUE(s.said("EKF2_HGT_REF is 1, should be 3"));
    TEST_ASSERT_TRUE(s.said("EKF2_EV_CTRL is 7, should be 15"));
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_DENIED, s.results(MAV_CMD_MISSION_START).at(0));
    TEST_ASSERT_TRUE(s.said("start refused: autopilot's parameters"));
    // Mended on the autopilot, which tells so: the start goes through.
    for (const char* id : {"EKF2_HGT_REF", "EKF2_EV_CTRL"}) {
        mavlink_param_value_t value{};
        std::memcpy(value.param_id, id, 12);
        value.param_type = MAV_PARAM_TYPE_INT32;
        value.param_value = integer_to_wire(id[5] == 'H' ? 3 : 31, false);
        s.from_autopilot(mavlink_msg_param_value_encode_status, value);
    }
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_MISSION_START).at(1));
}

static void an_autopilot_that_does_not_answer_is_not_flown_unless_told() {
    static Scene s;
    s.autopilot_type = MAV_AUTOPILOT_ARDUPILOTMEGA;
    s.mode = 5;
    s.autopilot_parameters = {{"VISO_TYPE", std::numeric_limits<float>::quiet_NaN()}};
    s.run(3.0);
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(s.said("reading the autopilot's parameters"));
    s.run(4.0);
    TEST_ASSERT_TRUE(s.said("VISO_TYPE not answered"));
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_DENIED, s.results(MAV_CMD_MISSION_START).at(1));
    write(s, "LNK_PREFLIGHT", 1.0F);
    s.run(0.1);
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_MISSION_START).at(2));
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_write_takes_effect_here_reaches_nav_and_is_stored);
    RUN_TEST(a_bad_value_is_refused_with_the_limits_and_the_value_that_holds);
    RUN_TEST(whole_numbers_go_in_the_encoding_of_the_autopilot);
    RUN_TEST(a_row_that_needs_a_restart_is_stored_and_says_so);
    RUN_TEST(in_flight_a_write_takes_effect_and_the_file_waits_for_the_ground);
    RUN_TEST(the_table_is_sent_again_until_nav_flies_it);
    RUN_TEST(two_lists_at_once_cost_neither_a_row);
    RUN_TEST(wrong_autopilot_parameters_refuse_the_start_and_are_named);
    RUN_TEST(an_autopilot_that_does_not_answer_is_not_flown_unless_told);
    return UNITY_END();
}
