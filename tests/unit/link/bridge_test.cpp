// The bridge's conduct: start sequence, the pilot's word, what it passes on.
#include <memory>
#include <unity.h>

#include "unit/link/bridge_scene.hpp"

using namespace noctule;
using scene::Scene;

namespace {

constexpr std::uint32_t kOffboard = 6U << 16U;
constexpr std::uint32_t kPosition = 3U << 16U;
constexpr std::uint16_t kArm = MAV_CMD_COMPONENT_ARM_DISARM;

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void adopts_the_vehicles_system_and_beats_once_a_second_on_its_clock() {
    static Scene s;
    s.run(10.0);
    std::size_t beats = 0;
    for (const mavlink_message_t& m : s.out.ground) {
        if (m.msgid != MAVLINK_MSG_ID_HEARTBEAT || m.compid != MAV_COMP_ID_ONBOARD_COMPUTER) { continue; }
        if (++beats > 1) { TEST_ASSERT_EQUAL_UINT8(scene::kSystem, m.sysid); }
        TEST_ASSERT_EQUAL_UINT8(MAV_AUTOPILOT_INVALID, mavlink_msg_heartbeat_get_autopilot(&m));
        TEST_ASSERT_EQUAL_UINT8(MAV_TYPE_ONBOARD_CONTROLLER, mavlink_msg_heartbeat_get_type(&m));
    }
    TEST_ASSERT_UINT32_WITHIN(1, 10, static_cast<std::uint32_t>(beats));
}

static void samples_reach_nav_in_order_and_repeats_do_not() {
    static Scene s;
    s.run(2.0);
    const std::size_t before = s.out.imu.size();
    TEST_ASSERT_GREATER_THAN_size_t(10, before);
    for (std::size_t i = 0; i < before; ++i) { TEST_ASSERT_EQUAL_INT32(static_cast<std::int32_t>(i + 1), s.out.imu[i].seq); }
    imu_t repeat{};
    repeat.t_us = s.t_us;
    s.from_autopilot(mavlink_msg_highres_imu_encode_status, to_highres_imu(repeat));
    repeat.t_us = s.t_us - 4000;
    s.from_autopilot(mavlink_msg_highres_imu_encode_status, to_highres_imu(repeat));
    TEST_ASSERT_EQUAL_size_t(before, s.out.imu.size());
    TEST_ASSERT_EQUAL_UINT64(2, s.bridge.counters().refused_samples);
}

static void coarse_inertial_data_serves_only_while_the_fine_is_silent() {
    static Scene s;
    s.run(2.0);
    const std::size_t before = s.out.imu.size();
    mavlink_scaled_imu_t coarse{};
    coarse.zacc = -1000;
    coarse.time_boot_ms = static_cast<std::uint32_t>(s.t_us / 1000) + 20;
    s.from_autopilot(mavlink_msg_scaled_imu_encode_status, coarse);
    TEST_ASSERT_EQUAL_size_t(before, s.out.imu.size());
    for (int i = 0; i < 100; ++i) {
        coarse.time_boot_ms += 20;
        s.from_autopilot(mavlink_msg_scaled_imu_encode_status, coarse);
    }
    TEST_ASSERT_UINT32_WITHIN(3, 50, static_cast<std::uint32_t>(s.out.imu.size() - before));
}

static void start_streams_first_then_asks_the_mode_then_arms_once() {
    static Scene s;
    s.run(3.0);
    s.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_size_t(1, s.results(MAV_CMD_MISSION_START).size());
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_MISSION_START)[0]);
    TEST_ASSERT_TRUE(s.ordered(command_t::START));
    s.hold_setpoint();
    s.run(1.4);
    TEST_ASSERT_GREATER_THAN_size_t(25, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED));
    TEST_ASSERT_EQUAL_size_t(0, s.commands(MAV_CMD_DO_SET_MODE).size());
    s.run(3.6);
    TEST_ASSERT_EQUAL_UINT32(kOffboard, s.mode);
    TEST_ASSERT_TRUE(s.armed);
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
    const std::size_t arms = s.commands(kArm).size();
    TEST_ASSERT_TRUE(arms == 1 || arms == 2);  // a repeat may cross the heartbeat that shows it
    s.run(10.0);
    TEST_ASSERT_EQUAL_size_t(arms, s.commands(kArm).size());
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().armed);
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().offboard);
    TEST_ASSERT_EQUAL_INT8(0, s.out.vehicle.back().mission_lost);
}

static void a_repeated_start_is_answered_and_changes_nothing() {
    static Scene s;
    s.run(3.0);
    for (int i = 0; i < 4; ++i) { s.ask(MAV_CMD_MISSION_START); }
    TEST_ASSERT_EQUAL_size_t(4, s.results(MAV_CMD_MISSION_START).size());
    for (const int result : s.results(MAV_CMD_MISSION_START)) { TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, result); }
    TEST_ASSERT_EQUAL_size_t(1, s.out.command.size());
}

static void a_start_that_is_not_possible_is_refused_with_the_reason() {
    static Scene not_ready;
    not_ready.nav.ready = 0;
    not_ready.run(3.0);
    not_ready.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_TEMPORARILY_REJECTED, not_ready.results(MAV_CMD_MISSION_START).at(0));
    TEST_ASSERT_TRUE(not_ready.said("nav is not ready"));
    static Scene armed;
    armed.armed = true;
    armed.run(3.0);
    armed.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(armed.said("armed already"));
    static Scene shifted;
    shifted.local_offset.x_m = 1.5F;
    shifted.run(3.0);
    shifted.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(shifted.said("differ"));
    static Scene silent;
    silent.nav_runs = false;
    silent.run(3.0);
    silent.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(silent.said("nav is not running"));
    static Scene other_table;
    other_table.nav.parameters_crc ^= 1;
    other_table.run(3.0);
    other_table.ask(MAV_CMD_MISSION_START);
    TEST_ASSERT_TRUE(other_table.said("tables differ"));
    for (Scene* s : {&not_ready, &armed, &shifted, &silent, &other_table}) { TEST_ASSERT_TRUE(s->out.command.empty()); }
}

static void a_start_with_a_time_waits_for_it_on_the_autopilots_clock() {
    static Scene s;
    s.run(3.0);
    s.ask(MAV_CMD_MISSION_START, 0.0F, 6.0F);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_IN_PROGRESS, s.results(MAV_CMD_MISSION_START).at(0));
    s.run(1.9);
    TEST_ASSERT_TRUE(s.out.command.empty());
    s.run(0.2);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_ACCEPTED, s.results(MAV_CMD_MISSION_START).at(1));
    TEST_ASSERT_EQUAL_size_t(1, s.out.command.size());
    TEST_ASSERT_EQUAL_INT64(6000000, s.out.command[0].t_us);
}

static void the_pilots_mode_change_wins_and_is_never_undone() {
    static Scene s;
    s.fly();
    TEST_ASSERT_EQUAL(Phase::flying, s.bridge.flight().phase());
    const std::size_t modes = s.commands(MAV_CMD_DO_SET_MODE).size();
    s.mode = kPosition;
    s.run(1.1);
    TEST_ASSERT_EQUAL(Phase::yielded, s.bridge.flight().phase());
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().mission_lost);
    TEST_ASSERT_TRUE(s.said("yielded, mode is POSITION"));
    const std::size_t sent = Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED);
    s.run(30.0);
    TEST_ASSERT_EQUAL_size_t(sent, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED));
    TEST_ASSERT_EQUAL_size_t(modes, s.commands(MAV_CMD_DO_SET_MODE).size());
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().mission_lost);
}

static void the_pilot_may_take_over_in_the_middle_of_a_start() {
    static Scene s;
    s.obeys_mode = false;
    s.run(3.0);
    s.ask(MAV_CMD_MISSION_START);
    s.hold_setpoint();
    s.run(2.0);
    s.mode = 1U << 16U;
    s.run(2.0);
    TEST_ASSERT_EQUAL(Phase::yielded, s.bridge.flight().phase());
    TEST_ASSERT_TRUE(s.said("MANUAL"));
    TEST_ASSERT_TRUE(s.commands(kArm).empty());
}

static void refusals_to_change_mode_or_to_arm_end_the_start_in_time() {
    static Scene mode;
    mode.obeys_mode = false;
    mode.run(3.0);
    mode.ask(MAV_CMD_MISSION_START);
    mode.hold_setpoint();
    mode.run(15.0);
    TEST_ASSERT_EQUAL(Phase::yielded, mode.bridge.flight().phase());
    TEST_ASSERT_TRUE(mode.said("mode refused"));
    static Scene arm;
    arm.obeys_arm = false;
    arm.run(3.0);
    arm.ask(MAV_CMD_MISSION_START);
    arm.hold_setpoint();
    arm.run(30.0);
    TEST_ASSERT_EQUAL(Phase::arming, arm.bridge.flight().phase());  // an autopilot may need 25 s
    TEST_ASSERT_GREATER_THAN_size_t(20, arm.commands(kArm).size());
    arm.run(20.0);
    TEST_ASSERT_EQUAL(Phase::yielded, arm.bridge.flight().phase());
    TEST_ASSERT_TRUE(arm.said("arming refused"));
}

static void after_landing_it_disarms_only_on_the_ground() {
    static Scene s;
    s.fly();
    s.nav.state = static_cast<std::int32_t>(MissionState::landed);
    s.nav.want_disarm = 1;
    s.nav.setpoint_valid = 0;
    s.run(2.0);
    TEST_ASSERT_TRUE(s.armed);  // the autopilot says that it is in the air
    s.landed_state = MAV_LANDED_STATE_ON_GROUND;
    s.run(3.0);
    TEST_ASSERT_FALSE(s.armed);
    TEST_ASSERT_EQUAL(Phase::idle, s.bridge.flight().phase());
    TEST_ASSERT_EQUAL_INT8(0, s.out.vehicle.back().mission_lost);
    TEST_ASSERT_TRUE(s.said("disarmed"));
}

static void ardupilot_gets_guided_and_a_takeoff_command_before_setpoints() {
    static Scene s;
    s.autopilot_type = MAV_AUTOPILOT_ARDUPILOTMEGA;
    s.mode = 5;
    s.run(3.0);
    s.ask(MAV_CMD_MISSION_START);
    s.hold_setpoint();
    s.nav.state = static_cast<std::int32_t>(MissionState::taking_off);
    s.run(5.0);
    TEST_ASSERT_EQUAL_UINT32(4, s.mode);
    TEST_ASSERT_TRUE(s.armed);
    const auto takeoffs = s.commands(MAV_CMD_NAV_TAKEOFF);
    TEST_ASSERT_GREATER_THAN_size_t(0, takeoffs.size());
    TEST_ASSERT_EQUAL_FLOAT(s.parameters.cruise_height_m, takeoffs[0].param7);
    const std::size_t held_back = Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED);
    s.run(1.0);
    TEST_ASSERT_EQUAL_size_t(held_back, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED));
    s.landed_state = MAV_LANDED_STATE_IN_AIR;
    s.run(1.0);
    TEST_ASSERT_GREATER_THAN_size_t(held_back + 10, Scene::count(s.out.autopilot, MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED));
}

/// PX4 finds no landing in OFFBOARD unless the setpoint sinks faster than is kind: its own landing mode ends the flight.
static void on_the_floor_the_autopilots_own_landing_takes_over() {
    static Scene s;
    s.fly();
    s.nav.state = static_cast<std::int32_t>(MissionState::landing);
    s.odom.z_m = 0.4F;
    s.hold_setpoint();
    s.nav.setpoint_z_m = 0.25F;                    // still sinking: the setpoint is a little ahead
    s.run(3.0);
    TEST_ASSERT_EQUAL_UINT32(kOffboard, s.mode);
    s.odom.z_m = 0.12F;
    s.nav.setpoint_z_m = -0.3F;
    s.run(0.8);
    TEST_ASSERT_EQUAL_UINT32(kOffboard, s.mode);   // it may be a bump
    s.run(1.0);
    TEST_ASSERT_EQUAL_UINT32(4U << 16U | 6U << 24U, s.mode);
    TEST_ASSERT_TRUE(s.said("on the floor"));
    s.landed_state = MAV_LANDED_STATE_ON_GROUND;
    s.run(1.0);
    s.armed = false;                               // as the autopilot does after a landing of its own
    s.run(1.5);
    TEST_ASSERT_EQUAL_INT8(0, s.out.vehicle.back().mission_lost);
    TEST_ASSERT_EQUAL_INT8(1, s.out.vehicle.back().landed);
    TEST_ASSERT_FALSE(s.bridge.flight().active());
    TEST_ASSERT_FALSE(s.said("yielded"));
}

/// PX4 1.17 answers the estimator type LIDAR with "unsupported" and flies without a position; ArduCopter looks at none.
static void odometry_goes_out_under_an_estimator_type_that_the_autopilot_takes() {
    struct Case {
        std::uint8_t autopilot;
        std::uint8_t estimator;
    };
    for (const Case c : {Case{MAV_AUTOPILOT_PX4, MAV_ESTIMATOR_TYPE_VISION}, Case{MAV_AUTOPILOT_ARDUPILOTMEGA, MAV_ESTIMATOR_TYPE_LIDAR},
                         Case{MAV_AUTOPILOT_GENERIC, MAV_ESTIMATOR_TYPE_UNKNOWN}}) {
        auto s = std::make_unique<Scene>();
        s->autopilot_type = c.autopilot;
        s->run(2.0);                 // until the autopilot's heartbeat it is not known
        s->out.autopilot.clear();
        s->run(1.0);
        std::size_t found = 0;
        for (const mavlink_message_t& m : s->out.autopilot) {
            if (m.msgid != MAVLINK_MSG_ID_ODOMETRY) { continue; }
            TEST_ASSERT_EQUAL_UINT8(c.estimator, mavlink_msg_odometry_get_estimator_type(&m));
            TEST_ASSERT_EQUAL_UINT8(MAV_FRAME_LOCAL_FRD, mavlink_msg_odometry_get_frame_id(&m));
            TEST_ASSERT_EQUAL_UINT8(MAV_FRAME_BODY_FRD, mavlink_msg_odometry_get_child_frame_id(&m));
            ++found;
        }
        TEST_ASSERT_GREATER_THAN_size_t(15, found);
    }
}

static void orders_of_the_ground_station_reach_nav_in_flight_only() {
    static Scene s;
    s.run(3.0);
    s.ask(MAV_CMD_NAV_RETURN_TO_LAUNCH);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_TEMPORARILY_REJECTED, s.results(MAV_CMD_NAV_RETURN_TO_LAUNCH).at(0));
    TEST_ASSERT_TRUE(s.out.command.empty());
    static Scene f;
    f.fly();
    f.ask(MAV_CMD_DO_PAUSE_CONTINUE, 0.0F);
    f.ask(MAV_CMD_DO_PAUSE_CONTINUE, 1.0F);
    f.ask(MAV_CMD_NAV_RETURN_TO_LAUNCH);
    f.ask(MAV_CMD_NAV_LAND);
    f.ask(MAV_CMD_USER_1);
    for (const std::int32_t order : {std::int32_t{command_t::PAUSE}, std::int32_t{command_t::RESUME}, std::int32_t{command_t::RETURN_HOME}, std::int32_t{command_t::LAND},
                                     std::int32_t{command_t::ABORT}}) {
        TEST_ASSERT_TRUE(f.ordered(order));
    }
    f.ask(MAV_CMD_DO_REPEAT_SERVO);
    TEST_ASSERT_EQUAL_INT(MAV_RESULT_UNSUPPORTED, f.results(MAV_CMD_DO_REPEAT_SERVO).at(0));
}

static void ground_and_autopilot_hear_each_other_through_the_bridge() {
    static Scene s;
    s.run(2.0);
    TEST_ASSERT_GREATER_THAN_size_t(30, Scene::count(s.out.ground, MAVLINK_MSG_ID_LOCAL_POSITION_NED));
    mavlink_command_long_t c{};
    c.target_system = scene::kSystem;
    c.target_component = MAV_COMP_ID_AUTOPILOT1;
    c.command = MAV_CMD_DO_SET_HOME;
    s.from_ground(mavlink_msg_command_long_encode_status, c);
    TEST_ASSERT_EQUAL_size_t(1, s.commands(MAV_CMD_DO_SET_HOME).size());
    s.ask(MAV_CMD_DO_SET_HOME);  // for us alone: not the autopilot's business
    TEST_ASSERT_EQUAL_size_t(1, s.commands(MAV_CMD_DO_SET_HOME).size());
    // Inertial data at full rate stays on board.
    for (int i = 1; i <= 250; ++i) {
        imu_t imu{};
        imu.t_us = s.t_us + 4000 * i;
        s.from_autopilot(mavlink_msg_highres_imu_encode_status, to_highres_imu(imu));
    }
    TEST_ASSERT_LESS_THAN_size_t(35, Scene::count(s.out.ground, MAVLINK_MSG_ID_HIGHRES_IMU));
}

static void what_is_withheld_looks_like_no_loss_and_what_is_lost_does() {
    static Scene s;
    s.run(2.0);
    const std::size_t before = s.out.ground.size();
    for (int i = 1; i <= 100; ++i) {
        imu_t imu{};
        imu.t_us = s.t_us + 4000 * i;
        s.from_autopilot(mavlink_msg_highres_imu_encode_status, to_highres_imu(imu));
        s.from_autopilot(mavlink_msg_ping_encode_status, mavlink_ping_t{});
        if (i == 50) { static_cast<void>(s.autopilot_writer.pack(mavlink_msg_ping_encode_status, mavlink_ping_t{})); }   // lost on the way to us
    }
    TEST_ASSERT_LESS_THAN_size_t(30, Scene::count(s.out.ground, MAVLINK_MSG_ID_HIGHRES_IMU));
    int steps[3] = {};
    int last = -1;
    for (std::size_t i = before; i < s.out.ground.size(); ++i) {   // the recorder takes frames with a good checksum only
        if (s.out.ground[i].compid != MAV_COMP_ID_AUTOPILOT1) { continue; }
        const int step = last < 0 ? 1 : (s.out.ground[i].seq - last) & 0xFF;
        TEST_ASSERT_TRUE(step == 1 || step == 2);
        ++steps[step];
        last = s.out.ground[i].seq;
    }
    TEST_ASSERT_GREATER_THAN_INT(100, steps[1]);
    TEST_ASSERT_EQUAL_INT(1, steps[2]);
}

static void timesync_is_answered_on_the_autopilots_clock() {
    static Scene s;
    s.run(2.0);
    mavlink_timesync_t ask{};
    ask.ts1 = 12345;
    s.from_autopilot(mavlink_msg_timesync_encode_status, ask);
    mavlink_timesync_t answer{};
    for (const mavlink_message_t& m : s.out.autopilot) {
        if (m.msgid == MAVLINK_MSG_ID_TIMESYNC) { mavlink_msg_timesync_decode(&m, &answer); }
    }
    TEST_ASSERT_EQUAL_INT64(12345, answer.ts1);
    TEST_ASSERT_EQUAL_INT64(s.t_us * 1000, answer.tc1);
}

static void a_second_autopilot_is_ignored_and_named() {
    static Scene s;
    s.run(2.0);
    s.autopilot_writer.set_ids(9, MAV_COMP_ID_AUTOPILOT1);
    s.armed = true;
    s.heartbeat();
    TEST_ASSERT_TRUE(s.said("second autopilot, system 9"));
    TEST_ASSERT_EQUAL_INT8(0, s.out.vehicle.back().armed);
}

static void the_parameter_table_can_be_read() {
    static Scene s;
    s.run(2.0);
    mavlink_param_request_list_t list{};
    list.target_system = scene::kSystem;
    list.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
    s.from_ground(mavlink_msg_param_request_list_encode_status, list);
    s.run(20.0);
    std::size_t rows = 0;
    for (const mavlink_message_t& m : s.out.ground) { rows += m.msgid == MAVLINK_MSG_ID_PARAM_VALUE && m.compid == MAV_COMP_ID_ONBOARD_COMPUTER ? 1U : 0U; }
    TEST_ASSERT_EQUAL_size_t(kParameterTable.size(), rows);
    mavlink_param_request_read_t read{};
    read.target_system = scene::kSystem;
    read.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
    read.param_index = -1;
    std::memcpy(read.param_id, "SPEED_MAX", 9);
    s.from_ground(mavlink_msg_param_request_read_encode_status, read);
    mavlink_param_value_t value{};
    mavlink_msg_param_value_decode(&s.out.ground.back(), &value);
    TEST_ASSERT_EQUAL_FLOAT(s.parameters.speed_max_m_s, value.param_value);
}

static void pressure_reaches_nav_thinned_out_and_before_the_inertial_sample() {
    static Scene s;
    s.run(2.0);
    mavlink_highres_imu_t m{};
    m.zacc = -9.81F;
    m.fields_updated = 0x083F;
    const std::size_t imu_before = s.out.imu.size();
    for (int i = 1; i <= 250; ++i) {  // a second of PX4's: the pressure in each
        m.time_usec = static_cast<std::uint64_t>(s.t_us + i * 4000);
        m.pressure_alt = static_cast<float>(i);
        s.from_autopilot(mavlink_msg_highres_imu_encode_status, m);
        if (i == 1) { TEST_ASSERT_EQUAL_size_t(1, s.out.baro.size()); }
    }
    TEST_ASSERT_EQUAL_size_t(imu_before + 250, s.out.imu.size());
    TEST_ASSERT_EQUAL_size_t(25, s.out.baro.size());
    TEST_ASSERT_EQUAL_INT32(1, s.out.baro.front().seq);
    TEST_ASSERT_EQUAL_FLOAT(11.0F, s.out.baro[1].height_m);
    TEST_ASSERT_EQUAL_INT64(s.t_us + 44000, s.out.baro[1].t_us);

    const std::uint64_t refused = s.bridge.counters().refused_samples;
    m.time_usec += 50000;
    m.pressure_alt = NAN;
    s.from_autopilot(mavlink_msg_highres_imu_encode_status, m);
    TEST_ASSERT_EQUAL_size_t(25, s.out.baro.size());
    TEST_ASSERT_EQUAL_size_t(imu_before + 251, s.out.imu.size());  // the rest of the message is good
    TEST_ASSERT_EQUAL_UINT64(refused + 1, s.bridge.counters().refused_samples);
}

static void the_coarser_pressure_serves_while_the_better_is_silent_and_is_asked_for_when_wanted() {
    static Scene s;
    s.parameters.alt_baro_sigma_m = 0.12F;
    s.run(3.0);
    const auto asked = [&] {
        std::size_t n = 0;
        for (const auto& c : s.commands(MAV_CMD_SET_MESSAGE_INTERVAL)) { n += c.param1 == static_cast<float>(MAVLINK_MSG_ID_SCALED_PRESSURE) ? 1U : 0U; }
        return n;
    };
    TEST_ASSERT_EQUAL_size_t(1, asked());
    mavlink_scaled_pressure_t coarse{};
    coarse.press_abs = 1000.0F;
    coarse.time_boot_ms = static_cast<std::uint32_t>(s.t_us / 1000);
    s.from_autopilot(mavlink_msg_scaled_pressure_encode_status, coarse);
    TEST_ASSERT_EQUAL_size_t(1, s.out.baro.size());
    mavlink_highres_imu_t fine{};
    fine.time_usec = static_cast<std::uint64_t>(s.t_us + 50000);
    fine.fields_updated = 0x083F;
    s.from_autopilot(mavlink_msg_highres_imu_encode_status, fine);
    TEST_ASSERT_EQUAL_size_t(2, s.out.baro.size());
    coarse.time_boot_ms += 500;
    s.from_autopilot(mavlink_msg_scaled_pressure_encode_status, coarse);
    TEST_ASSERT_EQUAL_size_t(2, s.out.baro.size());  // the better one spoke half a second ago
    coarse.time_boot_ms += 1000;
    s.from_autopilot(mavlink_msg_scaled_pressure_encode_status, coarse);
    TEST_ASSERT_EQUAL_size_t(3, s.out.baro.size());

    static Scene off;
    off.run(3.0);
    for (const auto& c : off.commands(MAV_CMD_SET_MESSAGE_INTERVAL)) { TEST_ASSERT_NOT_EQUAL(static_cast<float>(MAVLINK_MSG_ID_SCALED_PRESSURE), c.param1); }
}

static void what_the_autopilot_does_not_send_is_asked_for() {
    static Scene s;
    s.run(3.0);
    bool imu = false;
    bool distance = false;
    bool local = false;
    for (const auto& c : s.commands(MAV_CMD_SET_MESSAGE_INTERVAL)) {
        imu = imu || (c.param1 == static_cast<float>(MAVLINK_MSG_ID_HIGHRES_IMU) && c.param2 == 4000.0F);
        distance = distance || c.param1 == static_cast<float>(MAVLINK_MSG_ID_DISTANCE_SENSOR);
        local = local || c.param1 == static_cast<float>(MAVLINK_MSG_ID_LOCAL_POSITION_NED);
    }
    TEST_ASSERT_TRUE(imu);        // 20 Hz come, 250 Hz are wanted
    TEST_ASSERT_TRUE(distance);   // none comes
    TEST_ASSERT_FALSE(local);     // comes as wanted
}

static void an_autopilot_that_only_beats_is_asked_for_everything() {
    static Scene s;
    s.autopilot_type = MAV_AUTOPILOT_ARDUPILOTMEGA;
    for (std::int64_t wall_us = 0; wall_us <= 2500000; wall_us += 100000) {  // no message with a time in it
        if (wall_us % 1000000 == 0) { s.heartbeat(); }
        s.bridge.on_wall(wall_us);
    }
    TEST_ASSERT_EQUAL_INT64(-1, s.bridge.now_us());
    std::size_t imu = 0;
    for (const auto& c : s.commands(MAV_CMD_SET_MESSAGE_INTERVAL)) { imu += c.param1 == static_cast<float>(MAVLINK_MSG_ID_HIGHRES_IMU) && c.param2 == 4000.0F ? 1U : 0U; }
    TEST_ASSERT_EQUAL_size_t(3, imu);
    TEST_ASSERT_EQUAL_size_t(24, s.commands(MAV_CMD_SET_MESSAGE_INTERVAL).size());  // eight streams, once a second
}

static void setpoints_carry_their_acceleration_and_a_jump_is_none() {
    static Scene s;
    s.fly();
    const auto sent = [] {
        std::vector<mavlink_set_position_target_local_ned_t> found;
        for (const mavlink_message_t& m : s.out.autopilot) {
            if (m.msgid != MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED) { continue; }
            found.emplace_back();
            mavlink_msg_set_position_target_local_ned_decode(&m, &found.back());
        }
        return found;
    };
    TEST_ASSERT_EQUAL_HEX16(0x09C0, sent().front().type_mask);  // nothing to compare the first with
    s.nav.setpoint_vx_m_s = 0.03F;
    s.nav.setpoint_vy_m_s = -0.02F;
    s.nav.setpoint_vz_m_s = 0.01F;
    s.run(0.05);
    const auto m = sent().back();
    TEST_ASSERT_EQUAL_HEX16(0x0800, m.type_mask);
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.6F, m.afx);   // in 50 ms; north-east-down against forward-left-up
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.4F, m.afy);
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, -0.2F, m.afz);
    s.nav.setpoint_vx_m_s = 0.8F;
    s.run(0.05);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, s.parameters.accel_max_m_s2, std::hypot(sent().back().afx, sent().back().afy, sent().back().afz));
}

static void texts_do_not_flood_the_link() {
    static Scene s;
    s.fly();
    const std::size_t before = Scene::count(s.out.ground, MAVLINK_MSG_ID_STATUSTEXT);
    for (int i = 0; i < 200; ++i) {
        s.nav.state = i % 2 == 0 ? static_cast<std::int32_t>(MissionState::exploring) : static_cast<std::int32_t>(MissionState::looking_around);
        s.run(0.05);
    }
    TEST_ASSERT_LESS_THAN_size_t(35, Scene::count(s.out.ground, MAVLINK_MSG_ID_STATUSTEXT) - before);
    TEST_ASSERT_GREATER_THAN_UINT64(100, s.bridge.counters().texts_dropped);
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(adopts_the_vehicles_system_and_beats_once_a_second_on_its_clock);
    RUN_TEST(samples_reach_nav_in_order_and_repeats_do_not);
    RUN_TEST(coarse_inertial_data_serves_only_while_the_fine_is_silent);
    RUN_TEST(start_streams_first_then_asks_the_mode_then_arms_once);
    RUN_TEST(a_repeated_start_is_answered_and_changes_nothing);
    RUN_TEST(a_start_that_is_not_possible_is_refused_with_the_reason);
    RUN_TEST(a_start_with_a_time_waits_for_it_on_the_autopilots_clock);
    RUN_TEST(the_pilots_mode_change_wins_and_is_never_undone);
    RUN_TEST(the_pilot_may_take_over_in_the_middle_of_a_start);
    RUN_TEST(refusals_to_change_mode_or_to_arm_end_the_start_in_time);
    RUN_TEST(after_landing_it_disarms_only_on_the_ground);
    RUN_TEST(ardupilot_gets_guided_and_a_takeoff_command_before_setpoints);
    RUN_TEST(on_the_floor_the_autopilots_own_landing_takes_over);
    RUN_TEST(odometry_goes_out_under_an_estimator_type_that_the_autopilot_takes);
    RUN_TEST(orders_of_the_ground_station_reach_nav_in_flight_only);
    RUN_TEST(ground_and_autopilot_hear_each_other_through_the_bridge);
    RUN_TEST(what_is_withheld_looks_like_no_loss_and_what_is_lost_does);
    RUN_TEST(timesync_is_answered_on_the_autopilots_clock);
    RUN_TEST(a_second_autopilot_is_ignored_and_named);
    RUN_TEST(the_parameter_table_can_be_read);
    RUN_TEST(pressure_reaches_nav_thinned_out_and_before_the_inertial_sample);
    RUN_TEST(the_coarser_pressure_serves_while_the_better_is_silent_and_is_asked_for_when_wanted);
    RUN_TEST(what_the_autopilot_does_not_send_is_asked_for);
    RUN_TEST(an_autopilot_that_only_beats_is_asked_for_everything);
    RUN_TEST(setpoints_carry_their_acceleration_and_a_jump_is_none);
    RUN_TEST(texts_do_not_flood_the_link);
    return UNITY_END();
}
