// The bytes of every message between bridge and nav, as tests/conformance/messages.json has them: C++ reads and writes the same.
#include <unity.h>

#include <cstdint>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "lcmtypes/noctule/attitude_t.hpp"
#include "lcmtypes/noctule/baro_t.hpp"
#include "lcmtypes/noctule/command_t.hpp"
#include "lcmtypes/noctule/imu_t.hpp"
#include "lcmtypes/noctule/odom_t.hpp"
#include "lcmtypes/noctule/policy_ask_t.hpp"
#include "lcmtypes/noctule/policy_goal_t.hpp"
#include "lcmtypes/noctule/range_t.hpp"
#include "lcmtypes/noctule/vehicle_t.hpp"

using namespace noctule;

namespace {

using Bytes = std::vector<std::uint8_t>;

/// The agreed bytes of one type: the first "bytes" string after the type's name.
Bytes agreed(const std::string& type) {
    std::ifstream file("tests/conformance/messages.json");
    const std::string text{std::istreambuf_iterator<char>(file), {}};
    const std::string key = "\"bytes\": \"";
    const std::size_t begin = text.find(key, text.find("\"" + type + "\"")) + key.size();
    const std::size_t end = text.find('"', begin);
    TEST_ASSERT_TRUE_MESSAGE(end != std::string::npos && begin > key.size(), type.c_str());
    Bytes bytes;
    for (std::size_t i = begin; i + 1 < end; i += 2) { bytes.push_back(static_cast<std::uint8_t>(std::stoul(text.substr(i, 2), nullptr, 16))); }
    return bytes;
}

/// Decodes the agreed bytes, encodes what came out, and compares; a cut message must be refused.
template <class Message>
Message read_and_write(const std::string& type) {
    const Bytes bytes = agreed(type);
    const int size = static_cast<int>(bytes.size());
    Message message{};
    TEST_ASSERT_EQUAL_INT(size, message.getEncodedSize());
    TEST_ASSERT_EQUAL_INT(size, message.decode(bytes.data(), 0, size));
    Bytes written(bytes.size());
    TEST_ASSERT_EQUAL_INT(size, message.encode(written.data(), 0, size));
    TEST_ASSERT_EQUAL_MEMORY(bytes.data(), written.data(), bytes.size());
    Message cut{};
    for (int length = 0; length < size; ++length) { TEST_ASSERT_LESS_THAN_INT(0, cut.decode(bytes.data(), 0, length)); }
    return message;
}

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void imu() {
    const auto m = read_and_write<imu_t>("imu_t");
    TEST_ASSERT_EQUAL_INT64(1234567890123LL, m.t_us);
    TEST_ASSERT_EQUAL_INT32(7, m.seq);
    TEST_ASSERT_EQUAL_FLOAT(-0.25F, m.accel_m_s2[1]);
    TEST_ASSERT_EQUAL_FLOAT(9.8125F, m.accel_m_s2[2]);
    TEST_ASSERT_EQUAL_FLOAT(-1.5F, m.gyro_rad_s[0]);
}

static void attitude() {
    const auto m = read_and_write<attitude_t>("attitude_t");
    TEST_ASSERT_EQUAL_INT64(-1, m.t_us);
    TEST_ASSERT_EQUAL_INT32(2147483647, m.seq);
    TEST_ASSERT_EQUAL_FLOAT(-1.25F, m.pitch_rad);
}

static void range() {
    const auto m = read_and_write<range_t>("range_t");
    TEST_ASSERT_TRUE(m.range_m != m.range_m);
    TEST_ASSERT_EQUAL_FLOAT(12.0F, m.range_max_m);
}

static void baro() {
    const auto m = read_and_write<baro_t>("baro_t");
    TEST_ASSERT_EQUAL_INT64(150000, m.t_us);
    TEST_ASSERT_EQUAL_FLOAT(-123.625F, m.height_m);
}

static void command() {
    const auto m = read_and_write<command_t>("command_t");
    TEST_ASSERT_EQUAL_INT32(command_t::ABORT, m.command);
}

static void vehicle() {
    const auto m = read_and_write<vehicle_t>("vehicle_t");
    TEST_ASSERT_EQUAL_INT8(1, m.armed);
    TEST_ASSERT_EQUAL_INT8(0, m.offboard);
    TEST_ASSERT_EQUAL_INT8(2, m.landed);
    TEST_ASSERT_EQUAL_INT8(1, m.mission_lost);
    TEST_ASSERT_EQUAL_FLOAT(-1.0F, m.battery_remaining);
    TEST_ASSERT_EQUAL_FLOAT(-2.5F, m.local_y_m);
    TEST_ASSERT_EQUAL_FLOAT(-3.140625F, m.local_yaw_rad);
}

static void odom() {
    const auto m = read_and_write<odom_t>("odom_t");
    TEST_ASSERT_EQUAL_INT64(9000000000LL, m.t_us);
    TEST_ASSERT_EQUAL_INT8(1, m.at_scan);
    TEST_ASSERT_EQUAL_FLOAT(-3.0F, m.vz_m_s);
    TEST_ASSERT_EQUAL_FLOAT(0.25F, m.position_var_m2[1]);
    TEST_ASSERT_EQUAL_FLOAT(4.0F, m.velocity_var_m2_s2[2]);
    TEST_ASSERT_EQUAL_INT32(-1, m.quality);
    TEST_ASSERT_EQUAL_INT32(300, m.reset_counter);
}

static void policy_ask() {
    const auto m = read_and_write<policy_ask_t>("policy_ask_t");
    TEST_ASSERT_EQUAL_INT32(17, m.seq);
    TEST_ASSERT_EQUAL_INT32(policy_ask_t::REFUSED, m.fate);
    TEST_ASSERT_EQUAL_INT8(1, m.goal_valid);
    TEST_ASSERT_EQUAL_FLOAT(-100.5F, m.goal_x_m);
    TEST_ASSERT_EQUAL_INT32(2, m.timeouts);
}

static void policy_goal() {
    const auto m = read_and_write<policy_goal_t>("policy_goal_t");
    TEST_ASSERT_EQUAL_INT32(policy_goal_t::GOAL, m.kind);
    TEST_ASSERT_EQUAL_INT32(17, m.ask);
    TEST_ASSERT_TRUE(m.x_m != m.x_m);
    TEST_ASSERT_EQUAL_FLOAT(-2.5F, m.look_y_m);
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(imu);
    RUN_TEST(attitude);
    RUN_TEST(range);
    RUN_TEST(baro);
    RUN_TEST(command);
    RUN_TEST(vehicle);
    RUN_TEST(odom);
    RUN_TEST(policy_ask);
    RUN_TEST(policy_goal);
    return UNITY_END();
}
