/// What the sensors say, with time, unit and frame, and the frame of samples that one step consumes.
///
/// Times are std::int64_t microseconds of the autopilot's clock. NaN in a range means that nothing is known;
/// infinity in a scan means that nothing was hit within range_max_m.
#pragma once

#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"

namespace noctule {

/// Inertial sample, frame Body: specific force (at rest 0, 0, +9.81) and angular rate.
struct ImuSample {
    std::int64_t t_us = 0;
    std::array<float, 3> accel_m_s2{};
    std::array<float, 3> gyro_rad_s{};
};

/// Roll and pitch of Body with respect to gravity (Z-Y-X, forward-left-up). Yaw is never taken from the autopilot.
struct AttitudeSample {
    std::int64_t t_us = 0;
    float roll_rad = 0.0F;
    float pitch_rad = 0.0F;
};

/// Range along +z or -z of Body.
struct RangeSample {
    std::int64_t t_us = 0;
    float range_m = 0.0F;
    float range_min_m = 0.0F;
    float range_max_m = 0.0F;
};

/// Height by air pressure; the origin is arbitrary and drifts.
struct BaroSample {
    std::int64_t t_us = 0;
    float height_m = 0.0F;
};

/// One sweep of the planar laser, frame Lidar. Beam i was cast at t_us - (count - 1 - i) * time_increment_us.
struct Scan {
    std::int64_t t_us = 0;  ///< time of the last beam
    std::int32_t seq = 0;
    std::int32_t count = 0;
    float time_increment_us = 0.0F;
    float bearing_first_rad = 0.0F;
    float bearing_increment_rad = 0.0F;
    float range_min_m = 0.0F;
    float range_max_m = 0.0F;
    std::array<float, kMaxBeams> range_m{};
};

/// What the autopilot says of itself.
struct VehicleSample {
    enum class Landed : std::int8_t { unknown = 0, on_ground = 1, in_air = 2 };
    std::int64_t t_us = 0;
    bool armed = false;
    bool offboard = false;
    Landed landed = Landed::unknown;
    bool mission_lost = false;
    float battery_remaining = -1.0F;  ///< 0 to 1, -1 unknown
    bool local_position_valid = false;
    std::array<float, 3> local_map_m{};
    float local_yaw_rad = 0.0F;
};

/// An order of the operator or of the bridge's supervisor. Values as in command_t.lcm.
enum class Order : std::int32_t { none = 0, start = 1, pause = 2, resume = 3, return_home = 4, land = 5, abort = 6 };

struct CommandSample {
    std::int64_t t_us = 0;
    Order order = Order::none;
};

/// What a policy outside answered. Frame Map. Values of kind as in policy_goal_t.lcm.
struct GoalSample {
    enum class Kind : std::int32_t { nothing = 0, goal = 1, finished = 2, failed = 3 };
    std::int64_t t_us = 0;   ///< of the step that asked
    std::int32_t ask = 0;    ///< number of the request
    Kind kind = Kind::nothing;
    float x_m = 0.0F;
    float y_m = 0.0F;
    float look_x_m = 0.0F;
    float look_y_m = 0.0F;
};

/// Everything that arrived since the step before, in order of arrival, and the scan that ends it.
struct SensorFrame {
    Bounded<ImuSample, kMaxImuPerStep> imu;
    Bounded<AttitudeSample, kMaxAttitudePerStep> attitude;
    Bounded<RangeSample, kMaxRangePerStep> range_up;
    Bounded<RangeSample, kMaxRangePerStep> range_down;
    Bounded<BaroSample, kMaxBaroPerStep> baro;
    Bounded<VehicleSample, kMaxVehiclePerStep> vehicle;
    Bounded<CommandSample, kMaxCommandPerStep> command;
    Bounded<GoalSample, kMaxGoalPerStep> goal;
    Scan scan;
};

}  // namespace noctule
