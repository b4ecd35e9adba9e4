/// MAVLink messages to our types and back: one pair of functions a message.
///
/// The only place that knows forward-right-down, centimetres, milli-g and milliseconds (docs/frames.md). Map and Body are
/// forward-left-up; MAVLink's LOCAL_NED/LOCAL_FRD and BODY_FRD are (x, -y, -z). Turning by pi about x on both sides leaves roll as it
/// is and changes the sign of pitch and yaw. The autopilot takes its yaw from our ODOMETRY, so its north is our x.
/// `from_mavlink` is false for a message that says nothing usable (not finite, a field marked as missing); the output is then
/// unspecified. Sequence numbers are not touched. Pure functions, no heap.
#pragma once

#include <cstdint>

#include "command/setpoint.hpp"
#include "lcmtypes/noctule/baro_t.hpp"
#include "lcmtypes/noctule/imu_t.hpp"
#include "lcmtypes/noctule/odom_t.hpp"
#include "lcmtypes/noctule/range_t.hpp"
#include "link/mavlink.hpp"

namespace noctule {

/// The autopilot's own position and velocity, frame Map (as far as its frame agrees with ours).
struct LocalPosition {
    std::int64_t t_us = 0;
    float x_m = 0.0F;
    float y_m = 0.0F;
    float z_m = 0.0F;
    float vx_m_s = 0.0F;
    float vy_m_s = 0.0F;
    float vz_m_s = 0.0F;
};

/// Attitude with the yaw that the autopilot believes in (for comparison only: it came from us).
struct FullAttitude {
    std::int64_t t_us = 0;
    float roll_rad = 0.0F;   ///< forward-left-up, Z-Y-X
    float pitch_rad = 0.0F;  ///< positive: nose down
    float yaw_rad = 0.0F;    ///< anticlockwise from Map x
};

enum class RangeDirection : std::uint8_t { up, down, other };

/// HIGHRES_IMU. False unless accelerometer and gyroscope are all marked as updated, and finite.
[[nodiscard]] bool from_mavlink(const mavlink_highres_imu_t& in, imu_t& out);
[[nodiscard]] mavlink_highres_imu_t to_highres_imu(const imu_t& in);

/// The message claims to have the pressure or the height by it.
[[nodiscard]] bool says_pressure(const mavlink_highres_imu_t& in);
/// HIGHRES_IMU's pressure_alt; where it is not marked as updated, abs_pressure through the standard atmosphere. False: neither, or nonsense.
[[nodiscard]] bool from_mavlink(const mavlink_highres_imu_t& in, baro_t& out);

/// SCALED_PRESSURE through the standard atmosphere.
[[nodiscard]] bool from_mavlink(const mavlink_scaled_pressure_t& in, baro_t& out);

/// SCALED_IMU, SCALED_IMU2, SCALED_IMU3 and ArduPilot's RAW_IMU (all in milli-g, mrad/s): the coarser substitutes.
[[nodiscard]] bool from_mavlink(const mavlink_scaled_imu_t& in, imu_t& out);
[[nodiscard]] bool from_mavlink(const mavlink_scaled_imu2_t& in, imu_t& out);
[[nodiscard]] bool from_mavlink(const mavlink_scaled_imu3_t& in, imu_t& out);
[[nodiscard]] bool from_mavlink(const mavlink_raw_imu_t& in, imu_t& out);
[[nodiscard]] mavlink_scaled_imu_t to_scaled_imu(const imu_t& in);

/// ATTITUDE_QUATERNION. False when the quaternion's length is not near one.
[[nodiscard]] bool from_mavlink(const mavlink_attitude_quaternion_t& in, FullAttitude& out);
[[nodiscard]] mavlink_attitude_quaternion_t to_attitude_quaternion(const FullAttitude& in);

/// ATTITUDE.
[[nodiscard]] bool from_mavlink(const mavlink_attitude_t& in, FullAttitude& out);
[[nodiscard]] mavlink_attitude_t to_attitude(const FullAttitude& in);

/// DISTANCE_SENSOR in whole centimetres. A reading outside the sensor's own limits, or marked invalid, becomes NaN. The direction
/// is `other` for every orientation but 24 (up) and 25 (down). False when the limits make no sense.
[[nodiscard]] bool from_mavlink(const mavlink_distance_sensor_t& in, range_t& out, RangeDirection& direction);
[[nodiscard]] mavlink_distance_sensor_t to_distance_sensor(const range_t& in, RangeDirection direction);

/// LOCAL_POSITION_NED.
[[nodiscard]] bool from_mavlink(const mavlink_local_position_ned_t& in, LocalPosition& out);
[[nodiscard]] mavlink_local_position_ned_t to_local_position_ned(const LocalPosition& in);

/// EXTENDED_SYS_STATE to vehicle_t.landed: 0 unknown, 1 on the ground, 2 in the air (taking off and landing are in the air).
[[nodiscard]] std::int8_t landed_from_mavlink(const mavlink_extended_sys_state_t& in);
[[nodiscard]] mavlink_extended_sys_state_t to_extended_sys_state(std::int8_t landed);

/// Battery charge in percent (SYS_STATUS, BATTERY_STATUS) to 0 .. 1; -1 unknown.
[[nodiscard]] float battery_from_percent(std::int8_t percent);
[[nodiscard]] std::int8_t battery_to_percent(float remaining);

/// Acceleration in Map.
struct Acceleration {
    float x_m_s2 = 0.0F;
    float y_m_s2 = 0.0F;
    float z_m_s2 = 0.0F;
};

/// SET_POSITION_TARGET_LOCAL_NED with position, velocity and yaw, frame MAV_FRAME_LOCAL_NED: mask 0x09C0, with an acceleration 0x0800.
/// from_mavlink is false for any other frame or mask.
[[nodiscard]] mavlink_set_position_target_local_ned_t to_set_position_target(const Setpoint& in, std::int64_t t_us, MavlinkTarget target, const Acceleration* acceleration = nullptr);
[[nodiscard]] bool from_mavlink(const mavlink_set_position_target_local_ned_t& in, Setpoint& out);

/// ODOMETRY: pose in MAV_FRAME_LOCAL_FRD, velocity in MAV_FRAME_BODY_FRD, covariances of both, quality, reset counter.
/// odom_t has variances only; the velocity's are turned into Body by the yaw (roll and pitch are small). from_mavlink is false for other
/// frames; it leaves at_scan at 0.
[[nodiscard]] mavlink_odometry_t to_odometry(const odom_t& in);
[[nodiscard]] bool from_mavlink(const mavlink_odometry_t& in, odom_t& out);

/// VISION_POSITION_ESTIMATE: the same pose, in the same frame (LOCAL_FRD), with Euler angles; no velocity, no quality.
[[nodiscard]] mavlink_vision_position_estimate_t to_vision_position_estimate(const odom_t& in);

}  // namespace noctule
