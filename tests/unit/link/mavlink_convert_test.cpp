// Units and frames of every conversion, checked against values worked out by hand, then forth and back over extremes and headings.
#include <unity.h>

#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "core/angle.hpp"
#include "link/mavlink_convert.hpp"

using namespace noctule;

namespace {

constexpr float kHalfPi = 0.5F * kPi;
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

bool not_a_number(const float value) { return value != value; }  // Unity makes isnan a macro
void within(const float tolerance, const float expected, const float actual) { TEST_ASSERT_FLOAT_WITHIN(tolerance, expected, actual); }
void angle_within(const float tolerance, const float expected, const float actual) { TEST_ASSERT_FLOAT_WITHIN(tolerance, 0.0F, wrap_angle(expected - actual)); }

odom_t odometry_facing(const float yaw_rad) {
    odom_t m{};
    m.t_us = 123456789;
    m.x_m = 1.0F;
    m.y_m = 2.0F;
    m.z_m = 3.0F;
    m.yaw_rad = yaw_rad;
    m.quality = 80;
    return m;
}

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void gravity_at_rest_is_minus_z_of_frd_and_plus_z_of_flu() {
    mavlink_highres_imu_t in{};
    in.time_usec = 5000000;
    in.zacc = -9.81F;
    in.yacc = 0.5F;
    in.zgyro = 0.3F;  // clockwise from above
    in.fields_updated = 0x3F;
    imu_t out{};
    TEST_ASSERT_TRUE(from_mavlink(in, out));
    TEST_ASSERT_EQUAL_INT64(5000000, out.t_us);
    within(1e-6F, 9.81F, out.accel_m_s2[2]);
    within(1e-6F, -0.5F, out.accel_m_s2[1]);
    within(1e-6F, -0.3F, out.gyro_rad_s[2]);
}

static void an_imu_message_without_all_six_axes_or_with_nan_is_refused() {
    mavlink_highres_imu_t in{};
    imu_t out{};
    in.fields_updated = 0x1F;
    TEST_ASSERT_FALSE(from_mavlink(in, out));
    in.fields_updated = 0x3F;
    in.xgyro = kNaN;
    TEST_ASSERT_FALSE(from_mavlink(in, out));
}

static void pressure_altitude_comes_as_it_is_and_pressure_by_the_standard_atmosphere() {
    mavlink_highres_imu_t in{};
    baro_t out{};
    in.time_usec = 7000000;
    in.pressure_alt = -12.5F;
    in.abs_pressure = 954.6083F;  // 500 m in the tables of the standard atmosphere
    in.fields_updated = 0x3F;
    TEST_ASSERT_FALSE(says_pressure(in));
    TEST_ASSERT_FALSE(from_mavlink(in, out));
    in.fields_updated = 0x0A3F;
    TEST_ASSERT_TRUE(from_mavlink(in, out));
    TEST_ASSERT_EQUAL_INT64(7000000, out.t_us);
    within(0.0F, -12.5F, out.height_m);
    in.fields_updated = 0x0200;
    TEST_ASSERT_TRUE(from_mavlink(in, out));
    within(0.2F, 500.0F, out.height_m);
    mavlink_scaled_pressure_t scaled{};
    scaled.time_boot_ms = 1500;
    scaled.press_abs = 898.7457F;  // 1000 m
    TEST_ASSERT_TRUE(from_mavlink(scaled, out));
    TEST_ASSERT_EQUAL_INT64(1500000, out.t_us);
    within(0.2F, 1000.0F, out.height_m);
}

static void a_pressure_that_is_none_is_refused() {
    mavlink_highres_imu_t in{};
    mavlink_scaled_pressure_t scaled{};
    baro_t out{};
    in.fields_updated = 0x0800;
    in.pressure_alt = kNaN;
    TEST_ASSERT_TRUE(says_pressure(in));
    TEST_ASSERT_FALSE(from_mavlink(in, out));
    in.fields_updated = 0x0200;
    for (const float pressure_hpa : {0.0F, -5.0F, 5000.0F, kNaN}) {
        in.abs_pressure = pressure_hpa;
        scaled.press_abs = pressure_hpa;
        TEST_ASSERT_FALSE(from_mavlink(in, out));
        TEST_ASSERT_FALSE(from_mavlink(scaled, out));
    }
}

static void scaled_imu_is_in_milli_g_and_milliradians() {
    mavlink_scaled_imu_t in{};
    in.time_boot_ms = 4294967295U;
    in.zacc = -1000;
    in.xgyro = 1500;
    imu_t out{};
    TEST_ASSERT_TRUE(from_mavlink(in, out));
    TEST_ASSERT_EQUAL_INT64(4294967295000LL, out.t_us);
    within(1e-4F, 9.80665F, out.accel_m_s2[2]);
    within(1e-6F, 1.5F, out.gyro_rad_s[0]);
}

static void imu_goes_forth_and_back() {
    std::mt19937 random{7};
    std::uniform_real_distribution<float> value{-30.0F, 30.0F};
    for (int i = 0; i < 200; ++i) {
        imu_t in{};
        in.t_us = 1000LL * i;
        for (int k = 0; k < 3; ++k) {
            in.accel_m_s2[k] = value(random);
            in.gyro_rad_s[k] = value(random);
        }
        imu_t fine{};
        imu_t coarse{};
        TEST_ASSERT_TRUE(from_mavlink(to_highres_imu(in), fine));
        TEST_ASSERT_TRUE(from_mavlink(to_scaled_imu(in), coarse));
        TEST_ASSERT_EQUAL_INT64(in.t_us, fine.t_us);
        TEST_ASSERT_EQUAL_INT64(in.t_us, coarse.t_us);
        for (int k = 0; k < 3; ++k) {
            within(0.0F, in.accel_m_s2[k], fine.accel_m_s2[k]);
            within(0.0F, in.gyro_rad_s[k], fine.gyro_rad_s[k]);
            within(0.005F, in.accel_m_s2[k], coarse.accel_m_s2[k]);
            within(0.0006F, in.gyro_rad_s[k], coarse.gyro_rad_s[k]);
        }
    }
}

static void nose_up_and_turned_east_in_ned_is_nose_up_and_right_in_map() {
    // MAVLink: pitch positive nose up, yaw positive clockwise. Ours: pitch positive nose down, yaw anticlockwise.
    mavlink_attitude_t in{};
    in.roll = 0.2F;
    in.pitch = 0.1F;
    in.yaw = kHalfPi;
    FullAttitude out;
    TEST_ASSERT_TRUE(from_mavlink(in, out));
    within(1e-6F, 0.2F, out.roll_rad);
    within(1e-6F, -0.1F, out.pitch_rad);
    within(1e-6F, -kHalfPi, out.yaw_rad);
}

static void quaternion_and_euler_messages_agree_at_all_headings() {
    for (int heading = -12; heading <= 12; ++heading) {
        for (const float roll : {-3.0F, -0.4F, 0.0F, 0.4F, 3.0F}) {
            for (const float pitch : {-1.5F, -0.3F, 0.0F, 0.3F, 1.5F}) {
                const FullAttitude in{77000, roll, pitch, wrap_angle(static_cast<float>(heading) * kPi / 12.0F)};
                FullAttitude a;
                FullAttitude b;
                TEST_ASSERT_TRUE(from_mavlink(to_attitude_quaternion(in), a));
                TEST_ASSERT_TRUE(from_mavlink(to_attitude(in), b));
                TEST_ASSERT_EQUAL_INT64(in.t_us, a.t_us);
                for (const FullAttitude& out : {a, b}) {
                    angle_within(2e-4F, in.roll_rad, out.roll_rad);
                    angle_within(2e-4F, in.pitch_rad, out.pitch_rad);
                    angle_within(2e-4F, in.yaw_rad, out.yaw_rad);
                    TEST_ASSERT_TRUE(out.yaw_rad > -kPi - 1e-6F && out.yaw_rad <= kPi);
                }
            }
        }
    }
}

static void straight_up_and_down_give_finite_angles() {
    for (const float pitch : {-kHalfPi, kHalfPi}) {
        FullAttitude out;
        TEST_ASSERT_TRUE(from_mavlink(to_attitude_quaternion({0, 0.0F, pitch, 0.7F}), out));
        within(2e-3F, pitch, out.pitch_rad);
        angle_within(2e-3F, 0.7F, out.yaw_rad);
    }
}

static void a_quaternion_that_is_no_rotation_is_refused() {
    FullAttitude out;
    TEST_ASSERT_FALSE(from_mavlink(mavlink_attitude_quaternion_t{}, out));
    mavlink_attitude_quaternion_t bad = to_attitude_quaternion({});
    bad.q3 = kNaN;
    TEST_ASSERT_FALSE(from_mavlink(bad, out));
}

static void distances_are_whole_centimetres_with_their_direction() {
    mavlink_distance_sensor_t in{};
    in.time_boot_ms = 1500;
    in.min_distance = 10;
    in.max_distance = 1200;
    in.current_distance = 123;
    in.orientation = 24;
    range_t out{};
    RangeDirection direction = RangeDirection::other;
    TEST_ASSERT_TRUE(from_mavlink(in, out, direction));
    TEST_ASSERT_EQUAL(RangeDirection::up, direction);
    TEST_ASSERT_EQUAL_INT64(1500000, out.t_us);
    within(1e-6F, 1.23F, out.range_m);
    within(1e-6F, 0.10F, out.range_min_m);
    within(1e-6F, 12.0F, out.range_max_m);
    in.orientation = 25;
    TEST_ASSERT_TRUE(from_mavlink(in, out, direction));
    TEST_ASSERT_EQUAL(RangeDirection::down, direction);
    in.orientation = 0;
    TEST_ASSERT_TRUE(from_mavlink(in, out, direction));
    TEST_ASSERT_EQUAL(RangeDirection::other, direction);
}

static void a_distance_out_of_limits_or_marked_invalid_is_nan() {
    mavlink_distance_sensor_t in{};
    in.min_distance = 10;
    in.max_distance = 1200;
    in.orientation = 25;
    range_t out{};
    RangeDirection direction = RangeDirection::other;
    for (const std::uint16_t distance : {std::uint16_t{0}, std::uint16_t{9}, std::uint16_t{1201}, std::uint16_t{65535}}) {
        in.current_distance = distance;
        TEST_ASSERT_TRUE(from_mavlink(in, out, direction));
        TEST_ASSERT_TRUE(not_a_number(out.range_m));
    }
    in.current_distance = 500;
    in.signal_quality = 1;  // MAVLink: 1 is an invalid signal, 0 is unknown
    TEST_ASSERT_TRUE(from_mavlink(in, out, direction));
    TEST_ASSERT_TRUE(not_a_number(out.range_m));
    in.max_distance = in.min_distance;
    TEST_ASSERT_FALSE(from_mavlink(in, out, direction));
}

static void distances_are_rounded_not_truncated() {
    range_t in{};
    in.range_min_m = 0.1F;
    in.range_max_m = 12.0F;
    in.range_m = 1.2372F;
    TEST_ASSERT_EQUAL_UINT16(124, to_distance_sensor(in, RangeDirection::down).current_distance);
    in.range_m = kNaN;
    range_t out{};
    RangeDirection direction = RangeDirection::other;
    TEST_ASSERT_TRUE(from_mavlink(to_distance_sensor(in, RangeDirection::up), out, direction));
    TEST_ASSERT_TRUE(not_a_number(out.range_m));
    TEST_ASSERT_EQUAL(RangeDirection::up, direction);
}

static void east_of_the_start_is_right_and_down_is_below() {
    mavlink_local_position_ned_t in{};
    in.x = 1.0F;
    in.y = 2.0F;
    in.z = -3.0F;
    in.vx = 0.1F;
    in.vy = 0.2F;
    in.vz = -0.3F;
    LocalPosition out;
    TEST_ASSERT_TRUE(from_mavlink(in, out));
    within(0.0F, 1.0F, out.x_m);
    within(0.0F, -2.0F, out.y_m);
    within(0.0F, 3.0F, out.z_m);
    within(0.0F, -0.2F, out.vy_m_s);
    within(0.0F, 0.3F, out.vz_m_s);
    LocalPosition again;
    TEST_ASSERT_TRUE(from_mavlink(to_local_position_ned(out), again));
    TEST_ASSERT_EQUAL_MEMORY(&out.x_m, &again.x_m, 6 * sizeof(float));
    in.vy = kNaN;
    TEST_ASSERT_FALSE(from_mavlink(in, out));
}

static void setpoint_has_mask_09c0_in_local_ned() {
    const Setpoint in{true, 1.0F, 2.0F, 3.0F, 0.4F, 0.5F, 0.6F, kHalfPi};
    const mavlink_set_position_target_local_ned_t out = to_set_position_target(in, 7654321, {3, 1});
    TEST_ASSERT_EQUAL_HEX16(0x09C0, out.type_mask);
    TEST_ASSERT_EQUAL_UINT8(1, out.coordinate_frame);
    TEST_ASSERT_EQUAL_UINT32(7654, out.time_boot_ms);
    TEST_ASSERT_EQUAL_UINT8(3, out.target_system);
    TEST_ASSERT_EQUAL_UINT8(1, out.target_component);
    within(0.0F, -2.0F, out.y);
    within(0.0F, -3.0F, out.z);
    within(0.0F, -0.5F, out.vy);
    within(0.0F, -0.6F, out.vz);
    within(1e-6F, -kHalfPi, out.yaw);
    mavlink_set_position_target_local_ned_t other = out;
    Setpoint back;
    TEST_ASSERT_TRUE(from_mavlink(out, back));
    within(1e-6F, in.yaw_rad, back.yaw_rad);
    within(0.0F, in.y_m, back.y_m);
    other.coordinate_frame = MAV_FRAME_BODY_NED;
    TEST_ASSERT_FALSE(from_mavlink(other, back));
}

static void half_a_turn_stays_in_the_half_open_interval() {
    const Setpoint in{true, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F, kPi};
    within(0.0F, kPi, to_set_position_target(in, 0, {}).yaw);  // -pi is not in (-pi, pi]
}

static void velocity_of_odometry_is_in_body_frd_at_four_headings() {
    // Moving along Map x at 1 m/s. Facing x: forward. Facing left (+y): to the right. Facing back: backwards. Facing right: to the left.
    const std::array<std::array<float, 3>, 4> expected_yaw_vx_vy{{{0.0F, 1.0F, 0.0F}, {kHalfPi, 0.0F, 1.0F}, {kPi, -1.0F, 0.0F}, {-kHalfPi, 0.0F, -1.0F}}};
    for (const auto& row : expected_yaw_vx_vy) {
        odom_t in = odometry_facing(row[0]);
        in.vx_m_s = 1.0F;
        in.vz_m_s = 0.25F;
        const mavlink_odometry_t out = to_odometry(in);
        within(1e-6F, row[1], out.vx);
        within(1e-6F, row[2], out.vy);
        within(1e-6F, -0.25F, out.vz);
        within(0.0F, 1.0F, out.x);
        within(0.0F, -2.0F, out.y);
        within(0.0F, -3.0F, out.z);
    }
}

static void odometry_says_frames_estimator_quality_and_covariance() {
    odom_t in = odometry_facing(kHalfPi);
    in.position_var_m2[0] = 0.01F;
    in.position_var_m2[1] = 0.02F;
    in.position_var_m2[2] = 0.03F;
    in.yaw_var_rad2 = 0.04F;
    in.velocity_var_m2_s2[0] = 0.1F;
    in.velocity_var_m2_s2[1] = 0.2F;
    in.velocity_var_m2_s2[2] = 0.3F;
    in.reset_counter = 257;
    in.yaw_rate_rad_s = 0.5F;
    const mavlink_odometry_t out = to_odometry(in);
    TEST_ASSERT_EQUAL_UINT64(123456789, out.time_usec);
    TEST_ASSERT_EQUAL_UINT8(MAV_FRAME_LOCAL_FRD, out.frame_id);
    TEST_ASSERT_EQUAL_UINT8(MAV_FRAME_BODY_FRD, out.child_frame_id);
    TEST_ASSERT_EQUAL_UINT8(MAV_ESTIMATOR_TYPE_LIDAR, out.estimator_type);
    TEST_ASSERT_EQUAL_INT8(80, out.quality);
    TEST_ASSERT_EQUAL_UINT8(1, out.reset_counter);
    within(1e-6F, 0.01F, out.pose_covariance[0]);
    within(1e-6F, 0.02F, out.pose_covariance[6]);
    within(1e-6F, 0.03F, out.pose_covariance[11]);
    within(1e-6F, 0.04F, out.pose_covariance[20]);
    within(1e-6F, 0.2F, out.velocity_covariance[0]);  // Body x is Map y
    within(1e-6F, 0.1F, out.velocity_covariance[6]);
    within(1e-6F, 0.3F, out.velocity_covariance[11]);
    within(1e-6F, -0.5F, out.yawspeed);
    in.quality = -1;
    TEST_ASSERT_EQUAL_INT8(-1, to_odometry(in).quality);
}

static void odometry_goes_forth_and_back_at_all_headings_and_tilts() {
    std::mt19937 random{11};
    std::uniform_real_distribution<float> position{-1000.0F, 1000.0F};
    std::uniform_real_distribution<float> speed{-20.0F, 20.0F};
    std::uniform_real_distribution<float> tilt{-1.2F, 1.2F};
    for (int i = 0; i < 360; ++i) {
        odom_t in = odometry_facing(wrap_angle(static_cast<float>(i) * kPi / 180.0F));
        in.x_m = position(random);
        in.y_m = position(random);
        in.z_m = position(random);
        in.roll_rad = tilt(random);
        in.pitch_rad = tilt(random);
        in.vx_m_s = speed(random);
        in.vy_m_s = speed(random);
        in.vz_m_s = speed(random);
        in.yaw_rate_rad_s = tilt(random);
        for (float& variance : in.velocity_var_m2_s2) { variance = 0.09F; }
        odom_t out{};
        TEST_ASSERT_TRUE(from_mavlink(to_odometry(in), out));
        TEST_ASSERT_EQUAL_INT64(in.t_us, out.t_us);
        within(0.0F, in.x_m, out.x_m);
        within(0.0F, in.y_m, out.y_m);
        within(0.0F, in.z_m, out.z_m);
        angle_within(1e-4F, in.roll_rad, out.roll_rad);
        angle_within(1e-4F, in.pitch_rad, out.pitch_rad);
        angle_within(1e-4F, in.yaw_rad, out.yaw_rad);
        within(1e-3F, in.vx_m_s, out.vx_m_s);
        within(1e-3F, in.vy_m_s, out.vy_m_s);
        within(1e-3F, in.vz_m_s, out.vz_m_s);
        within(1e-4F, in.yaw_rate_rad_s, out.yaw_rate_rad_s);
        within(1e-5F, 0.09F, out.velocity_var_m2_s2[0]);
    }
}

static void landed_states_and_battery_percent() {
    mavlink_extended_sys_state_t state{};
    const std::array<std::int8_t, 5> expected{0, 1, 2, 2, 2};
    for (std::uint8_t i = 0; i < expected.size(); ++i) {
        state.landed_state = i;
        TEST_ASSERT_EQUAL_INT8(expected[i], landed_from_mavlink(state));
    }
    for (std::int8_t i = 0; i < 3; ++i) { TEST_ASSERT_EQUAL_INT8(i, landed_from_mavlink(to_extended_sys_state(i))); }
    within(1e-6F, 0.55F, battery_from_percent(55));
    within(0.0F, -1.0F, battery_from_percent(-1));
    TEST_ASSERT_EQUAL_INT8(55, battery_to_percent(0.55F));
    TEST_ASSERT_EQUAL_INT8(-1, battery_to_percent(kNaN));
    TEST_ASSERT_EQUAL_INT8(100, battery_to_percent(7.0F));
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(gravity_at_rest_is_minus_z_of_frd_and_plus_z_of_flu);
    RUN_TEST(an_imu_message_without_all_six_axes_or_with_nan_is_refused);
    RUN_TEST(pressure_altitude_comes_as_it_is_and_pressure_by_the_standard_atmosphere);
    RUN_TEST(a_pressure_that_is_none_is_refused);
    RUN_TEST(scaled_imu_is_in_milli_g_and_milliradians);
    RUN_TEST(imu_goes_forth_and_back);
    RUN_TEST(nose_up_and_turned_east_in_ned_is_nose_up_and_right_in_map);
    RUN_TEST(quaternion_and_euler_messages_agree_at_all_headings);
    RUN_TEST(straight_up_and_down_give_finite_angles);
    RUN_TEST(a_quaternion_that_is_no_rotation_is_refused);
    RUN_TEST(distances_are_whole_centimetres_with_their_direction);
    RUN_TEST(a_distance_out_of_limits_or_marked_invalid_is_nan);
    RUN_TEST(distances_are_rounded_not_truncated);
    RUN_TEST(east_of_the_start_is_right_and_down_is_below);
    RUN_TEST(setpoint_has_mask_09c0_in_local_ned);
    RUN_TEST(half_a_turn_stays_in_the_half_open_interval);
    RUN_TEST(velocity_of_odometry_is_in_body_frd_at_four_headings);
    RUN_TEST(odometry_says_frames_estimator_quality_and_covariance);
    RUN_TEST(odometry_goes_forth_and_back_at_all_headings_and_tilts);
    RUN_TEST(landed_states_and_battery_percent);
    return UNITY_END();
}
