/// NavNode: what a message becomes, when a step runs, and in which order its output leaves.
#include <memory>
#include <string>
#include <vector>

#include "link/nav_node.hpp"
#include "streams.gen.hpp"
#include "unity.h"

using namespace noctule;

namespace {

struct Box {
    std::vector<std::string> channels;
    std::vector<odom_t> odometry;
    nav_t nav{};
    static void publish(void* context, const char* channel, const std::uint8_t* bytes, std::size_t size) {
        Box& box = *static_cast<Box*>(context);
        box.channels.emplace_back(channel);
        if (box.channels.back() == kChannelNav) { TEST_ASSERT_EQUAL(size, box.nav.decode(bytes, 0, static_cast<int>(size))); }
        if (box.channels.back() == kChannelOdom) {
            odom_t odom{};
            TEST_ASSERT_EQUAL(size, odom.decode(bytes, 0, static_cast<int>(size)));
            box.odometry.push_back(odom);
        }
    }
};

Parameters parameters;

struct Bench {
    Box box;
    std::unique_ptr<NavNode> node = std::make_unique<NavNode>(parameters, Box::publish, &box, nullptr);
    std::vector<std::uint8_t> bytes = std::vector<std::uint8_t>(65536);

    template <class Message>
    Input send(const char* channel, const Message& message) {
        const int size = message.encode(bytes.data(), 0, static_cast<int>(bytes.size()));
        return node->receive(channel, bytes.data(), static_cast<std::size_t>(size));
    }
    Input imu(std::int64_t t_us) {
        imu_t message{};
        message.t_us = t_us;
        message.accel_m_s2[2] = 9.81F;
        return send(kChannelImu, message);
    }
    /// A sweep in a room of 8 x 6 m, the vehicle at rest in its middle.
    Input scan(std::int64_t t_us, std::int32_t seq) {
        scan_t message{};
        message.t_us = t_us;
        message.seq = seq;
        message.count = 541;
        message.time_increment_us = 60.0F;
        message.bearing_first_rad = -2.356F;
        message.bearing_increment_rad = 4.712F / 540.0F;
        message.range_min_m = 0.06F;
        message.range_max_m = 10.0F;
        for (int i = 0; i < message.count; ++i) {
            const double a = static_cast<double>(message.bearing_first_rad) + i * static_cast<double>(message.bearing_increment_rad);
            message.range_m[i] = static_cast<float>(std::min(4.0 / std::abs(std::cos(a)), 3.0 / std::abs(std::sin(a))));
        }
        return send(kChannelScan, message);
    }
};

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void a_step_waits_for_inertial_data_up_to_the_stamp() {
    Bench bench;
    TEST_ASSERT_EQUAL(Input::accepted, bench.imu(96000));
    TEST_ASSERT_EQUAL(Input::accepted, bench.scan(100000, 0));
    TEST_ASSERT_TRUE(bench.node->scan_waiting());
    TEST_ASSERT_FALSE(bench.node->step_due());
    TEST_ASSERT_EQUAL(Input::accepted, bench.imu(100000));
    TEST_ASSERT_TRUE(bench.node->step_due());
}

static void samples_later_than_the_scan_stay_for_the_next_step() {
    Bench bench;
    for (std::int64_t t_us = 4000; t_us <= 108000; t_us += 4000) { static_cast<void>(bench.imu(t_us)); }
    static_cast<void>(bench.scan(100000, 0));
    bench.node->step();
    TEST_ASSERT_EQUAL(25, bench.box.nav.imu_used);
    static_cast<void>(bench.scan(108000, 1));
    bench.node->step();
    TEST_ASSERT_EQUAL(2, bench.box.nav.imu_used);
}

static void floats_survive_the_decoder() {
    // LCM's coders alias floats as int32_t; an optimised build once decoded every float as zero.
    Bench bench;
    for (std::int64_t t_us = 4000; t_us <= 200000; t_us += 4000) { static_cast<void>(bench.imu(t_us)); }
    attitude_t attitude{};
    attitude.t_us = 200000;
    attitude.roll_rad = 0.05F;
    attitude.pitch_rad = -0.04F;
    static_cast<void>(bench.send(kChannelAttitude, attitude));
    static_cast<void>(bench.scan(200000, 0));
    bench.node->step();
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.05F, bench.box.nav.roll_rad);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, -0.04F, bench.box.nav.pitch_rad);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.0F, bench.box.nav.vz_m_s);  // with an accelerometer of zero it falls at 2 m/s
}

static void nav_comes_before_the_odometry_that_closes_the_tick() {
    Bench bench;
    static_cast<void>(bench.imu(1000000));
    static_cast<void>(bench.scan(1000000, 0));
    bench.node->step();
    TEST_ASSERT_TRUE(bench.box.channels.size() >= 4);  // walls and levels were due
    TEST_ASSERT_EQUAL_STRING(kChannelNav, bench.box.channels[0].c_str());
    TEST_ASSERT_EQUAL_STRING(kChannelOdom, bench.box.channels[1].c_str());
    TEST_ASSERT_EQUAL(1, bench.box.odometry.back().at_scan);
    TEST_ASSERT_EQUAL_INT64(1000000, bench.box.odometry.back().t_us);
}

static void between_scans_odometry_leaves_every_twenty_milliseconds() {
    Bench bench;
    static_cast<void>(bench.imu(100000));
    static_cast<void>(bench.scan(100000, 0));
    bench.node->step();
    bench.box.odometry.clear();
    for (std::int64_t t_us = 104000; t_us <= 148000; t_us += 4000) { static_cast<void>(bench.imu(t_us)); }
    TEST_ASSERT_EQUAL(2, bench.box.odometry.size());
    TEST_ASSERT_EQUAL_INT64(120000, bench.box.odometry[0].t_us);
    TEST_ASSERT_EQUAL_INT64(140000, bench.box.odometry[1].t_us);
    TEST_ASSERT_EQUAL(0, bench.box.odometry[0].at_scan);
}

static void garbage_is_refused_and_counted_and_changes_nothing() {
    Bench bench;
    const std::uint8_t garbage[32] = {1, 2, 3};
    for (const char* channel : {kChannelImu, kChannelScan, kChannelAttitude, kChannelRangeUp, kChannelRangeDown, kChannelVehicle, kChannelCommand, kChannelPolicyGoal}) {
        TEST_ASSERT_EQUAL(Input::rejected_malformed, bench.node->receive(channel, garbage, sizeof garbage));
        TEST_ASSERT_EQUAL(Input::rejected_malformed, bench.node->receive(channel, garbage, 0));
    }
    TEST_ASSERT_EQUAL_UINT32(16, bench.node->refused());
    TEST_ASSERT_EQUAL(Input::other_channel, bench.node->receive("ELSE", garbage, sizeof garbage));
    command_t order{};
    order.command = 99;
    TEST_ASSERT_EQUAL(Input::rejected_malformed, bench.send(kChannelCommand, order));
    TEST_ASSERT_FALSE(bench.node->scan_waiting());
}

static void a_repeated_scan_is_refused_and_a_newer_one_replaces_the_waiting_one() {
    Bench bench;
    TEST_ASSERT_EQUAL(Input::accepted, bench.scan(100000, 0));
    TEST_ASSERT_EQUAL(Input::rejected_repeat, bench.scan(100000, 0));
    TEST_ASSERT_EQUAL(Input::accepted, bench.scan(150000, 1));
    TEST_ASSERT_EQUAL_UINT32(1, bench.node->scans_replaced());
    static_cast<void>(bench.imu(150000));
    bench.node->step();
    TEST_ASSERT_EQUAL(1, bench.box.nav.scan_seq);
}

static void a_full_queue_refuses_the_newest() {
    Bench bench;
    for (std::size_t i = 0; i < kMaxImuPerStep; ++i) { TEST_ASSERT_EQUAL(Input::accepted, bench.imu(static_cast<std::int64_t>(4000 * (i + 1)))); }
    TEST_ASSERT_EQUAL(Input::refused_full, bench.imu(4000 * (kMaxImuPerStep + 1)));
}

static void barometer_samples_wait_for_their_step_and_are_counted() {
    Bench bench;
    baro_t sample{};
    sample.height_m = 12.0F;
    for (std::int64_t t_us = 50000; t_us <= 150000; t_us += 50000) {
        sample.t_us = t_us;
        TEST_ASSERT_EQUAL(Input::accepted, bench.send(kChannelBaro, sample));
    }
    static_cast<void>(bench.scan(100000, 0));
    static_cast<void>(bench.imu(100000));
    bench.node->step();
    TEST_ASSERT_EQUAL(2, bench.box.nav.baro_used);
    static_cast<void>(bench.scan(150000, 1));
    Consumed consumed;
    consumed.baro = 2;
    TEST_ASSERT_FALSE(bench.node->step_with(consumed));
    consumed.baro = 1;
    TEST_ASSERT_TRUE(bench.node->step_with(consumed));
    TEST_ASSERT_EQUAL(1, bench.box.nav.baro_used);
    for (std::size_t i = 0; i < kMaxBaroPerStep; ++i) { TEST_ASSERT_EQUAL(Input::accepted, bench.send(kChannelBaro, sample)); }
    TEST_ASSERT_EQUAL(Input::refused_full, bench.send(kChannelBaro, sample));
    TEST_ASSERT_EQUAL_UINT32(1, bench.node->refused());
}

static void answers_of_a_policy_outside_are_taken_up_by_the_next_step_and_counted() {
    Bench bench;
    policy_goal_t answer{};
    answer.kind = policy_goal_t::GOAL;
    for (std::size_t i = 0; i < kMaxGoalPerStep; ++i) { TEST_ASSERT_EQUAL(Input::accepted, bench.send(kChannelPolicyGoal, answer)); }
    TEST_ASSERT_EQUAL(Input::refused_full, bench.send(kChannelPolicyGoal, answer));
    static_cast<void>(bench.imu(100000));
    static_cast<void>(bench.scan(100000, 0));
    Consumed consumed;
    consumed.policy = kMaxGoalPerStep + 1U;
    TEST_ASSERT_FALSE(bench.node->step_with(consumed));
    bench.node->step();
    TEST_ASSERT_EQUAL(kMaxGoalPerStep, bench.box.nav.policy_used);
    TEST_ASSERT_FALSE(bench.node->answer_awaited());   // nothing is explored: nothing was asked
}

static void replay_obeys_the_counts_of_the_log() {
    Bench bench;
    for (std::int64_t t_us = 4000; t_us <= 100000; t_us += 4000) { static_cast<void>(bench.imu(t_us)); }
    static_cast<void>(bench.scan(100000, 0));
    Consumed consumed;
    consumed.imu = 26;
    TEST_ASSERT_FALSE(bench.node->step_with(consumed));
    TEST_ASSERT_TRUE(bench.node->scan_waiting());
    consumed.imu = 20;
    TEST_ASSERT_TRUE(bench.node->step_with(consumed));
    TEST_ASSERT_EQUAL(20, bench.box.nav.imu_used);
    TEST_ASSERT_FALSE(bench.node->step_with(consumed));
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_step_waits_for_inertial_data_up_to_the_stamp);
    RUN_TEST(samples_later_than_the_scan_stay_for_the_next_step);
    RUN_TEST(floats_survive_the_decoder);
    RUN_TEST(nav_comes_before_the_odometry_that_closes_the_tick);
    RUN_TEST(between_scans_odometry_leaves_every_twenty_milliseconds);
    RUN_TEST(garbage_is_refused_and_counted_and_changes_nothing);
    RUN_TEST(a_repeated_scan_is_refused_and_a_newer_one_replaces_the_waiting_one);
    RUN_TEST(a_full_queue_refuses_the_newest);
    RUN_TEST(barometer_samples_wait_for_their_step_and_are_counted);
    RUN_TEST(answers_of_a_policy_outside_are_taken_up_by_the_next_step_and_counted);
    RUN_TEST(replay_obeys_the_counts_of_the_log);
    return UNITY_END();
}
