#include "link/mavlink_convert.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/angle.hpp"
#include "core/gravity.hpp"

namespace noctule {

namespace {

constexpr float kMilli = 1e-3F;
constexpr float kCentimetres_m = 100.0F;
constexpr std::uint16_t kPositionVelocityYawMask = 0x09C0;  // ignores acceleration and yaw rate
constexpr std::uint16_t kWithAccelerationMask = 0x0800;     // ignores the yaw rate
constexpr std::uint16_t kAccelGyroUpdated = 0x003F;         // three accelerometer and three gyroscope bits
constexpr std::uint16_t kPressureUpdated = 0x0200;
constexpr std::uint16_t kPressureAltUpdated = 0x0800;
constexpr float kAttitudeVar_rad2 = 1e-4F;                  // roll and pitch are the autopilot's own: (0.01 rad)^2
constexpr float kRateVar_rad2_s2 = 1e-2F;
constexpr float kPolePitch = 0.999999F;

using Vector = std::array<float, 3>;
using Matrix = std::array<Vector, 3>;

/// Forward-left-up to forward-right-down and back.
Vector flip(const Vector& v) { return {v[0], -v[1], -v[2]}; }

bool finite(const Vector& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

/// Turns Body into Map; Z-Y-X Euler angles, forward-left-up.
Matrix rotation(const float roll, const float pitch, const float yaw) {
    const float cr = std::cos(roll);
    const float sr = std::sin(roll);
    const float cp = std::cos(pitch);
    const float sp = std::sin(pitch);
    const float cy = std::cos(yaw);
    const float sy = std::sin(yaw);
    return {{{cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr},
             {sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr},
             {-sp, cp * sr, cp * cr}}};
}

Vector times(const Matrix& m, const Vector& v) {
    Vector out{};
    for (std::size_t i = 0; i < 3; ++i) { out[i] = m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2]; }
    return out;
}

Vector transposed_times(const Matrix& m, const Vector& v) {
    Vector out{};
    for (std::size_t i = 0; i < 3; ++i) { out[i] = m[0][i] * v[0] + m[1][i] * v[1] + m[2][i] * v[2]; }
    return out;
}

/// Quaternion (w, x, y, z) of forward-right-down axes.
std::array<float, 4> to_quaternion(const float roll_flu, const float pitch_flu, const float yaw_flu) {
    const float r = 0.5F * roll_flu;
    const float p = -0.5F * pitch_flu;
    const float y = -0.5F * yaw_flu;
    const float cr = std::cos(r);
    const float sr = std::sin(r);
    const float cp = std::cos(p);
    const float sp = std::sin(p);
    const float cy = std::cos(y);
    const float sy = std::sin(y);
    return {cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy};
}

struct Euler {
    float roll = 0.0F;
    float pitch = 0.0F;
    float yaw = 0.0F;
};

/// False when the quaternion's length is not near one.
bool from_quaternion(const float w0, const float x0, const float y0, const float z0, Euler& out_flu) {
    const float square = w0 * w0 + x0 * x0 + y0 * y0 + z0 * z0;
    if (!(square > 0.9F && square < 1.1F)) { return false; }
    const float scale = 1.0F / std::sqrt(square);
    const float w = w0 * scale;
    const float x = x0 * scale;
    const float y = y0 * scale;
    const float z = z0 * scale;
    const float sine = std::clamp(2.0F * (w * y - z * x), -1.0F, 1.0F);
    if (std::fabs(sine) > kPolePitch) {  // nose straight up or down: roll and yaw are one angle, call it yaw
        out_flu = {0.0F, -std::copysign(0.5F * kPi, sine), -wrap_angle(std::copysign(2.0F, -sine) * std::atan2(x, w))};
        return true;
    }
    out_flu = {wrap_angle(std::atan2(2.0F * (w * x + y * z), 1.0F - 2.0F * (x * x + y * y))), -std::asin(sine),
               wrap_angle(-std::atan2(2.0F * (w * z + x * y), 1.0F - 2.0F * (y * y + z * z)))};
    return true;
}

std::int64_t from_boot_ms(const std::uint32_t time_boot_ms) { return static_cast<std::int64_t>(time_boot_ms) * 1000; }
std::uint32_t to_boot_ms(const std::int64_t t_us) { return static_cast<std::uint32_t>(t_us / 1000); }

std::int16_t to_int16(const float value) { return static_cast<std::int16_t>(std::lround(std::clamp(value, -32768.0F, 32767.0F))); }
std::uint16_t to_centimetres(const float value_m) {
    return static_cast<std::uint16_t>(std::lround(std::clamp(value_m * kCentimetres_m, 0.0F, 65535.0F)));
}

void set_imu(const Vector& accel_frd, const Vector& gyro_frd, imu_t& out) {
    const Vector accel = flip(accel_frd);
    const Vector gyro = flip(gyro_frd);
    std::copy(accel.begin(), accel.end(), out.accel_m_s2);
    std::copy(gyro.begin(), gyro.end(), out.gyro_rad_s);
}

Vector vector(const float (&v)[3]) { return {v[0], v[1], v[2]}; }

/// Standard atmosphere (ISA, troposphere), hPa to metres. False where it means nothing.
bool from_pressure(const float pressure_hpa, float& height_m) {
    constexpr double kSeaLevel_hpa = 1013.25;
    constexpr double kScale_m = 44330.77;
    constexpr double kExponent = 0.1902632;
    if (!(pressure_hpa > 100.0F && pressure_hpa < 1200.0F)) { return false; }
    height_m = static_cast<float>(kScale_m * (1.0 - std::pow(static_cast<double>(pressure_hpa) / kSeaLevel_hpa, kExponent)));
    return true;
}

}  // namespace

bool says_pressure(const mavlink_highres_imu_t& in) { return (in.fields_updated & (kPressureUpdated | kPressureAltUpdated)) != 0; }

bool from_mavlink(const mavlink_highres_imu_t& in, baro_t& out) {
    out.t_us = static_cast<std::int64_t>(in.time_usec);
    if ((in.fields_updated & kPressureAltUpdated) != 0) {
        out.height_m = in.pressure_alt;
        return std::isfinite(in.pressure_alt);
    }
    return (in.fields_updated & kPressureUpdated) != 0 && from_pressure(in.abs_pressure, out.height_m);
}

bool from_mavlink(const mavlink_scaled_pressure_t& in, baro_t& out) {
    out.t_us = from_boot_ms(in.time_boot_ms);
    return from_pressure(in.press_abs, out.height_m);
}

bool from_mavlink(const mavlink_highres_imu_t& in, imu_t& out) {
    const Vector accel{in.xacc, in.yacc, in.zacc};
    const Vector gyro{in.xgyro, in.ygyro, in.zgyro};
    if ((in.fields_updated & kAccelGyroUpdated) != kAccelGyroUpdated || !finite(accel) || !finite(gyro)) { return false; }
    out.t_us = static_cast<std::int64_t>(in.time_usec);
    set_imu(accel, gyro, out);
    return true;
}

mavlink_highres_imu_t to_highres_imu(const imu_t& in) {
    const Vector accel = flip(vector(in.accel_m_s2));
    const Vector gyro = flip(vector(in.gyro_rad_s));
    mavlink_highres_imu_t out{};
    out.time_usec = static_cast<std::uint64_t>(in.t_us);
    out.xacc = accel[0];
    out.yacc = accel[1];
    out.zacc = accel[2];
    out.xgyro = gyro[0];
    out.ygyro = gyro[1];
    out.zgyro = gyro[2];
    out.fields_updated = kAccelGyroUpdated;
    return out;
}

namespace {

/// Milli-g and milliradians a second, whatever the message is called.
template <class Message>
void set_milli_imu(const Message& in, imu_t& out) {
    constexpr float kAccel = kMilli * static_cast<float>(kGravity_m_s2);
    set_imu({static_cast<float>(in.xacc) * kAccel, static_cast<float>(in.yacc) * kAccel, static_cast<float>(in.zacc) * kAccel},
            {static_cast<float>(in.xgyro) * kMilli, static_cast<float>(in.ygyro) * kMilli, static_cast<float>(in.zgyro) * kMilli}, out);
}

template <class Message>
bool from_scaled(const Message& in, imu_t& out) {
    out.t_us = from_boot_ms(in.time_boot_ms);
    set_milli_imu(in, out);
    return true;
}

}  // namespace

bool from_mavlink(const mavlink_scaled_imu_t& in, imu_t& out) { return from_scaled(in, out); }
bool from_mavlink(const mavlink_scaled_imu2_t& in, imu_t& out) { return from_scaled(in, out); }
bool from_mavlink(const mavlink_scaled_imu3_t& in, imu_t& out) { return from_scaled(in, out); }

bool from_mavlink(const mavlink_raw_imu_t& in, imu_t& out) {
    out.t_us = static_cast<std::int64_t>(in.time_usec);
    set_milli_imu(in, out);
    return true;
}

mavlink_scaled_imu_t to_scaled_imu(const imu_t& in) {
    constexpr float kAccel = kMilli * static_cast<float>(kGravity_m_s2);
    const Vector accel = flip(vector(in.accel_m_s2));
    const Vector gyro = flip(vector(in.gyro_rad_s));
    mavlink_scaled_imu_t out{};
    out.time_boot_ms = to_boot_ms(in.t_us);
    out.xacc = to_int16(accel[0] / kAccel);
    out.yacc = to_int16(accel[1] / kAccel);
    out.zacc = to_int16(accel[2] / kAccel);
    out.xgyro = to_int16(gyro[0] / kMilli);
    out.ygyro = to_int16(gyro[1] / kMilli);
    out.zgyro = to_int16(gyro[2] / kMilli);
    return out;
}

bool from_mavlink(const mavlink_attitude_quaternion_t& in, FullAttitude& out) {
    Euler euler;
    if (!from_quaternion(in.q1, in.q2, in.q3, in.q4, euler)) { return false; }
    out = {from_boot_ms(in.time_boot_ms), euler.roll, euler.pitch, euler.yaw};
    return true;
}

mavlink_attitude_quaternion_t to_attitude_quaternion(const FullAttitude& in) {
    const std::array<float, 4> q = to_quaternion(in.roll_rad, in.pitch_rad, in.yaw_rad);
    mavlink_attitude_quaternion_t out{};
    out.time_boot_ms = to_boot_ms(in.t_us);
    out.q1 = q[0];
    out.q2 = q[1];
    out.q3 = q[2];
    out.q4 = q[3];
    return out;
}

bool from_mavlink(const mavlink_attitude_t& in, FullAttitude& out) {
    if (!finite({in.roll, in.pitch, in.yaw})) { return false; }
    out = {from_boot_ms(in.time_boot_ms), wrap_angle(in.roll), -in.pitch, wrap_angle(-in.yaw)};
    return true;
}

mavlink_attitude_t to_attitude(const FullAttitude& in) {
    mavlink_attitude_t out{};
    out.time_boot_ms = to_boot_ms(in.t_us);
    out.roll = in.roll_rad;
    out.pitch = -in.pitch_rad;
    out.yaw = wrap_angle(-in.yaw_rad);
    return out;
}

bool from_mavlink(const mavlink_distance_sensor_t& in, range_t& out, RangeDirection& direction) {
    if (in.max_distance <= in.min_distance) { return false; }
    constexpr std::uint8_t kInvalidSignal = 1;
    direction = in.orientation == MAV_SENSOR_ROTATION_PITCH_90    ? RangeDirection::up
                : in.orientation == MAV_SENSOR_ROTATION_PITCH_270 ? RangeDirection::down
                                                                  : RangeDirection::other;
    const bool valid = in.signal_quality != kInvalidSignal && in.current_distance >= in.min_distance && in.current_distance <= in.max_distance;
    out.t_us = from_boot_ms(in.time_boot_ms);
    out.range_m = valid ? static_cast<float>(in.current_distance) / kCentimetres_m : std::numeric_limits<float>::quiet_NaN();
    out.range_min_m = static_cast<float>(in.min_distance) / kCentimetres_m;
    out.range_max_m = static_cast<float>(in.max_distance) / kCentimetres_m;
    return true;
}

mavlink_distance_sensor_t to_distance_sensor(const range_t& in, const RangeDirection direction) {
    constexpr std::uint8_t kInvalidSignal = 1;
    constexpr std::uint8_t kFullSignal = 100;
    mavlink_distance_sensor_t out{};
    out.time_boot_ms = to_boot_ms(in.t_us);
    out.min_distance = to_centimetres(in.range_min_m);
    out.max_distance = to_centimetres(in.range_max_m);
    const bool valid = std::isfinite(in.range_m);
    out.current_distance = valid ? to_centimetres(in.range_m) : out.max_distance;
    out.signal_quality = valid ? kFullSignal : kInvalidSignal;
    out.type = MAV_DISTANCE_SENSOR_LASER;
    out.orientation = direction == RangeDirection::up     ? std::uint8_t{MAV_SENSOR_ROTATION_PITCH_90}
                      : direction == RangeDirection::down ? std::uint8_t{MAV_SENSOR_ROTATION_PITCH_270}
                                                          : std::uint8_t{MAV_SENSOR_ROTATION_NONE};
    out.covariance = UINT8_MAX;
    return out;
}

bool from_mavlink(const mavlink_local_position_ned_t& in, LocalPosition& out) {
    if (!finite({in.x, in.y, in.z}) || !finite({in.vx, in.vy, in.vz})) { return false; }
    out = {from_boot_ms(in.time_boot_ms), in.x, -in.y, -in.z, in.vx, -in.vy, -in.vz};
    return true;
}

mavlink_local_position_ned_t to_local_position_ned(const LocalPosition& in) {
    mavlink_local_position_ned_t out{};
    out.time_boot_ms = to_boot_ms(in.t_us);
    out.x = in.x_m;
    out.y = -in.y_m;
    out.z = -in.z_m;
    out.vx = in.vx_m_s;
    out.vy = -in.vy_m_s;
    out.vz = -in.vz_m_s;
    return out;
}

std::int8_t landed_from_mavlink(const mavlink_extended_sys_state_t& in) {
    switch (in.landed_state) {
        case MAV_LANDED_STATE_ON_GROUND: return 1;
        case MAV_LANDED_STATE_IN_AIR:
        case MAV_LANDED_STATE_TAKEOFF:
        case MAV_LANDED_STATE_LANDING: return 2;
        default: return 0;
    }
}

mavlink_extended_sys_state_t to_extended_sys_state(const std::int8_t landed) {
    mavlink_extended_sys_state_t out{};
    out.vtol_state = MAV_VTOL_STATE_UNDEFINED;
    out.landed_state = landed == 1 ? std::uint8_t{MAV_LANDED_STATE_ON_GROUND} : landed == 2 ? std::uint8_t{MAV_LANDED_STATE_IN_AIR} : std::uint8_t{MAV_LANDED_STATE_UNDEFINED};
    return out;
}

float battery_from_percent(const std::int8_t percent) {
    constexpr float kPercent = 100.0F;
    return percent < 0 || percent > 100 ? -1.0F : static_cast<float>(percent) / kPercent;
}

std::int8_t battery_to_percent(const float remaining) {
    constexpr float kPercent = 100.0F;
    if (!(remaining >= 0.0F)) { return -1; }
    return static_cast<std::int8_t>(std::lround(std::min(remaining, 1.0F) * kPercent));
}

mavlink_set_position_target_local_ned_t to_set_position_target(const Setpoint& in, const std::int64_t t_us, const MavlinkTarget target, const Acceleration* const acceleration) {
    mavlink_set_position_target_local_ned_t out{};
    out.time_boot_ms = to_boot_ms(t_us);
    out.target_system = target.system;
    out.target_component = target.component;
    out.coordinate_frame = MAV_FRAME_LOCAL_NED;
    out.type_mask = kPositionVelocityYawMask;
    if (acceleration != nullptr) {
        out.type_mask = kWithAccelerationMask;
        out.afx = acceleration->x_m_s2;
        out.afy = -acceleration->y_m_s2;
        out.afz = -acceleration->z_m_s2;
    }
    out.x = in.x_m;
    out.y = -in.y_m;
    out.z = -in.z_m;
    out.vx = in.vx_m_s;
    out.vy = -in.vy_m_s;
    out.vz = -in.vz_m_s;
    out.yaw = wrap_angle(-in.yaw_rad);
    return out;
}

bool from_mavlink(const mavlink_set_position_target_local_ned_t& in, Setpoint& out) {
    if (in.coordinate_frame != MAV_FRAME_LOCAL_NED || (in.type_mask != kPositionVelocityYawMask && in.type_mask != kWithAccelerationMask)) { return false; }
    if (!finite({in.x, in.y, in.z}) || !finite({in.vx, in.vy, in.vz}) || !std::isfinite(in.yaw)) { return false; }
    out = {true, in.x, -in.y, -in.z, in.vx, -in.vy, -in.vz, wrap_angle(-in.yaw)};
    return true;
}

namespace {

/// Upper triangle of 6 x 6, row by row: the diagonal stands at 0, 6, 11, 15, 18, 20.
std::array<float, 21> pose_covariance(const odom_t& in) {
    std::array<float, 21> out{};
    out[0] = in.position_var_m2[0];
    out[6] = in.position_var_m2[1];
    out[11] = in.position_var_m2[2];
    out[15] = kAttitudeVar_rad2;
    out[18] = kAttitudeVar_rad2;
    out[20] = in.yaw_var_rad2;
    return out;
}

}  // namespace

mavlink_vision_position_estimate_t to_vision_position_estimate(const odom_t& in) {
    mavlink_vision_position_estimate_t out{};
    out.usec = static_cast<std::uint64_t>(in.t_us);
    out.x = in.x_m;
    out.y = -in.y_m;
    out.z = -in.z_m;
    out.roll = in.roll_rad;
    out.pitch = -in.pitch_rad;
    out.yaw = wrap_angle(-in.yaw_rad);
    const std::array<float, 21> covariance = pose_covariance(in);
    std::memcpy(out.covariance, covariance.data(), sizeof out.covariance);
    out.reset_counter = static_cast<std::uint8_t>(in.reset_counter & 0xFF);
    return out;
}

mavlink_odometry_t to_odometry(const odom_t& in) {
    const Matrix map_body = rotation(in.roll_rad, in.pitch_rad, in.yaw_rad);
    const Vector velocity = flip(transposed_times(map_body, {in.vx_m_s, in.vy_m_s, in.vz_m_s}));
    const Vector rate = flip(transposed_times(map_body, {0.0F, 0.0F, in.yaw_rate_rad_s}));
    const std::array<float, 4> q = to_quaternion(in.roll_rad, in.pitch_rad, in.yaw_rad);
    const float c2 = std::cos(in.yaw_rad) * std::cos(in.yaw_rad);
    const float s2 = 1.0F - c2;
    mavlink_odometry_t out{};
    out.time_usec = static_cast<std::uint64_t>(in.t_us);
    out.frame_id = MAV_FRAME_LOCAL_FRD;
    out.child_frame_id = MAV_FRAME_BODY_FRD;
    out.x = in.x_m;
    out.y = -in.y_m;
    out.z = -in.z_m;
    std::copy(q.begin(), q.end(), out.q);
    out.vx = velocity[0];
    out.vy = velocity[1];
    out.vz = velocity[2];
    out.rollspeed = rate[0];
    out.pitchspeed = rate[1];
    out.yawspeed = rate[2];
    const std::array<float, 21> covariance = pose_covariance(in);
    std::memcpy(out.pose_covariance, covariance.data(), sizeof out.pose_covariance);
    out.velocity_covariance[0] = c2 * in.velocity_var_m2_s2[0] + s2 * in.velocity_var_m2_s2[1];
    out.velocity_covariance[6] = s2 * in.velocity_var_m2_s2[0] + c2 * in.velocity_var_m2_s2[1];
    out.velocity_covariance[11] = in.velocity_var_m2_s2[2];
    out.velocity_covariance[15] = kRateVar_rad2_s2;
    out.velocity_covariance[18] = kRateVar_rad2_s2;
    out.velocity_covariance[20] = kRateVar_rad2_s2;
    out.reset_counter = static_cast<std::uint8_t>(in.reset_counter & 0xFF);
    out.estimator_type = MAV_ESTIMATOR_TYPE_LIDAR;
    out.quality = static_cast<std::int8_t>(std::clamp<std::int32_t>(in.quality, -1, 100));
    return out;
}

bool from_mavlink(const mavlink_odometry_t& in, odom_t& out) {
    Euler euler;
    if (in.frame_id != MAV_FRAME_LOCAL_FRD || in.child_frame_id != MAV_FRAME_BODY_FRD || !from_quaternion(in.q[0], in.q[1], in.q[2], in.q[3], euler)) { return false; }
    if (!finite({in.x, in.y, in.z}) || !finite({in.vx, in.vy, in.vz})) { return false; }
    const Matrix map_body = rotation(euler.roll, euler.pitch, euler.yaw);
    const Vector velocity = times(map_body, flip({in.vx, in.vy, in.vz}));
    const Vector rate = times(map_body, flip({in.rollspeed, in.pitchspeed, in.yawspeed}));
    const float c2 = std::cos(euler.yaw) * std::cos(euler.yaw);
    const float s2 = 1.0F - c2;
    out = {};
    out.t_us = static_cast<std::int64_t>(in.time_usec);
    out.x_m = in.x;
    out.y_m = -in.y;
    out.z_m = -in.z;
    out.roll_rad = euler.roll;
    out.pitch_rad = euler.pitch;
    out.yaw_rad = euler.yaw;
    out.vx_m_s = velocity[0];
    out.vy_m_s = velocity[1];
    out.vz_m_s = velocity[2];
    out.yaw_rate_rad_s = rate[2];
    out.position_var_m2[0] = in.pose_covariance[0];
    out.position_var_m2[1] = in.pose_covariance[6];
    out.position_var_m2[2] = in.pose_covariance[11];
    out.yaw_var_rad2 = in.pose_covariance[20];
    // The cross term is not carried, so this is exact only where both variances are equal or yaw is a multiple of pi/2.
    out.velocity_var_m2_s2[0] = c2 * in.velocity_covariance[0] + s2 * in.velocity_covariance[6];
    out.velocity_var_m2_s2[1] = s2 * in.velocity_covariance[0] + c2 * in.velocity_covariance[6];
    out.velocity_var_m2_s2[2] = in.velocity_covariance[11];
    out.reset_counter = in.reset_counter;
    out.quality = in.quality;
    return true;
}

}  // namespace noctule
