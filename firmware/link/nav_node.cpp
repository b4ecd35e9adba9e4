#include "link/nav_node.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "link/parameter_values.hpp"
#include "streams.gen.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kOdometryPeriod_us = 20000;   // design.md, ODOMETRY

static_assert(scan_t::MAX_BEAMS == kMaxBeams, "scan_t.lcm and core/capacity.hpp disagree");

/// Samples at the head of the queue that are not later than the scan.
template <class Queue>
std::size_t up_to(const Queue& queue, const std::int64_t t_us) {
    std::size_t n = 0;
    while (n < queue.size() && queue[n].t_us <= t_us) { ++n; }
    return n;
}

/// Moves the first n entries of one queue to the end of another of the same capacity, which is empty.
template <class Queue>
void take(Queue& from, Queue& to, const std::size_t n) {
    to.clear();
    for (std::size_t i = 0; i < n; ++i) { static_cast<void>(to.push(from[i])); }
    from.drop_front(n);
}

}  // namespace

NavNode::NavNode(const Parameters& parameters, const Publish sink, void* const context, const Stopwatch stopwatch)
    : parameters_(parameters), values_crc_(parameter_values_crc(parameters)), navigator_(parameters_), predictor_(parameters_), publish_(sink), context_(context), stopwatch_(stopwatch) {}

template <class Message>
bool NavNode::decode(Message& message, const std::uint8_t* const bytes, const std::size_t size) {
    // lcm-gen's decoder reads constant lengths only and checks the type's fingerprint; a longer message is another type.
    const bool good = message.decode(bytes, 0, static_cast<int>(size)) == static_cast<int>(size);
    if (!good) { ++refused_; }
    return good;
}

Input NavNode::receive(const char* const channel, const std::uint8_t* const bytes, const std::size_t size) {
    const auto is = [channel](const char* name) { return std::strcmp(channel, name) == 0; };
    if (is(kChannelImu)) { return receive_imu(bytes, size); }
    if (is(kChannelScan)) { return receive_scan(bytes, size); }
    if (is(kChannelAttitude)) { return receive_attitude(bytes, size); }
    if (is(kChannelRangeDown)) { return receive_range(bytes, size, false); }
    if (is(kChannelRangeUp)) { return receive_range(bytes, size, true); }
    if (is(kChannelBaro)) { return receive_baro(bytes, size); }
    if (is(kChannelVehicle)) { return receive_vehicle(bytes, size); }
    if (is(kChannelCommand)) { return receive_command(bytes, size); }
    if (is(kChannelParameters)) { return receive_parameters(bytes, size); }
    if (is(kChannelPolicyGoal)) { return receive_goal(bytes, size); }
    return Input::other_channel;
}

Input NavNode::receive_imu(const std::uint8_t* const bytes, const std::size_t size) {
    imu_t message{};
    if (!decode(message, bytes, size)) { return Input::rejected_malformed; }
    ImuSample sample;
    sample.t_us = message.t_us;
    for (std::size_t i = 0; i < 3; ++i) {
        sample.accel_m_s2[i] = message.accel_m_s2[i];
        sample.gyro_rad_s[i] = message.gyro_rad_s[i];
    }
    if (!pending_.imu.push(sample)) {
        ++refused_;
        return Input::refused_full;
    }
    newest_imu_us_ = sample.t_us;
    predictor_.add(sample);
    if (scan_seen_ && sample.t_us - last_odometry_us_ >= kOdometryPeriod_us && !(scan_waiting_ && step_due())) {
        publish_odometry(sample.t_us, false);
    }
    return Input::accepted;
}

Input NavNode::receive_attitude(const std::uint8_t* const bytes, const std::size_t size) {
    attitude_t message{};
    if (!decode(message, bytes, size)) { return Input::rejected_malformed; }
    const AttitudeSample sample{message.t_us, message.roll_rad, message.pitch_rad};
    if (!pending_.attitude.push(sample)) {
        ++refused_;
        return Input::refused_full;
    }
    predictor_.add(sample);
    return Input::accepted;
}

Input NavNode::receive_range(const std::uint8_t* const bytes, const std::size_t size, const bool up) {
    range_t message{};
    if (!decode(message, bytes, size)) { return Input::rejected_malformed; }
    auto& queue = up ? pending_.range_up : pending_.range_down;
    if (!queue.push(RangeSample{message.t_us, message.range_m, message.range_min_m, message.range_max_m})) {
        ++refused_;
        return Input::refused_full;
    }
    return Input::accepted;
}

Input NavNode::receive_baro(const std::uint8_t* const bytes, const std::size_t size) {
    baro_t message{};
    if (!decode(message, bytes, size)) { return Input::rejected_malformed; }
    if (!pending_.baro.push(BaroSample{message.t_us, message.height_m})) {
        ++refused_;
        return Input::refused_full;
    }
    return Input::accepted;
}

Input NavNode::receive_vehicle(const std::uint8_t* const bytes, const std::size_t size) {
    vehicle_t message{};
    if (!decode(message, bytes, size)) { return Input::rejected_malformed; }
    VehicleSample sample;
    sample.t_us = message.t_us;
    sample.armed = message.armed != 0;
    sample.offboard = message.offboard != 0;
    sample.landed = message.landed == 1   ? VehicleSample::Landed::on_ground
                    : message.landed == 2 ? VehicleSample::Landed::in_air
                                          : VehicleSample::Landed::unknown;
    sample.mission_lost = message.mission_lost != 0;
    sample.battery_remaining = message.battery_remaining;
    sample.local_position_valid = message.local_position_valid != 0;
    sample.local_map_m = {message.local_x_m, message.local_y_m, message.local_z_m};
    sample.local_yaw_rad = message.local_yaw_rad;
    if (!pending_.vehicle.push(sample)) {
        ++refused_;
        return Input::refused_full;
    }
    return Input::accepted;
}

Input NavNode::receive_command(const std::uint8_t* const bytes, const std::size_t size) {
    command_t message{};
    if (!decode(message, bytes, size)) { return Input::rejected_malformed; }
    if (message.command < static_cast<std::int32_t>(Order::start) || message.command > static_cast<std::int32_t>(Order::abort)) {
        ++refused_;
        return Input::rejected_malformed;
    }
    if (!pending_.command.push(CommandSample{message.t_us, static_cast<Order>(message.command)})) {
        ++refused_;
        return Input::refused_full;
    }
    return Input::accepted;
}

Input NavNode::receive_parameters(const std::uint8_t* const bytes, const std::size_t size) {
    if (!decode(parameters_message_, bytes, size)) { return Input::rejected_malformed; }
    if (!fits_table(parameters_message_)) {
        ++refused_;
        return Input::rejected_malformed;
    }
    if (!pending_parameters_.push(parameters_message_)) {
        ++refused_;
        return Input::refused_full;
    }
    return Input::accepted;
}

Input NavNode::receive_goal(const std::uint8_t* const bytes, const std::size_t size) {
    policy_goal_t message{};
    if (!decode(message, bytes, size)) { return Input::rejected_malformed; }
    const GoalSample sample{message.t_us, message.ask, static_cast<GoalSample::Kind>(message.kind), message.x_m, message.y_m, message.look_x_m, message.look_y_m};
    if (!pending_.goal.push(sample)) {
        ++refused_;
        return Input::refused_full;
    }
    if (message.ask <= asked_) { answered_ = std::max(answered_, message.ask); }
    return Input::accepted;
}

Input NavNode::receive_scan(const std::uint8_t* const bytes, const std::size_t size) {
    if (!decode(scan_message_, bytes, size)) { return Input::rejected_malformed; }
    const scan_t& message = scan_message_;
    if (scan_seen_ && message.seq == pending_.scan.seq && message.t_us == pending_.scan.t_us) {
        ++refused_;
        return Input::rejected_repeat;
    }
    if (scan_waiting_) { ++scans_replaced_; }  // overrun: the newest scan wins, the skipped one is counted
    Scan& scan = pending_.scan;
    scan.t_us = message.t_us;
    scan.seq = message.seq;
    scan.count = message.count;
    scan.time_increment_us = message.time_increment_us;
    scan.bearing_first_rad = message.bearing_first_rad;
    scan.bearing_increment_rad = message.bearing_increment_rad;
    scan.range_min_m = message.range_min_m;
    scan.range_max_m = message.range_max_m;
    std::copy(std::begin(message.range_m), std::end(message.range_m), scan.range_m.begin());
    scan_waiting_ = true;
    scan_seen_ = true;
    return Input::accepted;
}

bool NavNode::step_due() const { return scan_waiting_ && newest_imu_us_ >= pending_.scan.t_us; }

void NavNode::step() {
    if (!scan_waiting_) { return; }
    const std::int64_t t_us = pending_.scan.t_us;
    run(Consumed{up_to(pending_.imu, t_us), up_to(pending_.attitude, t_us), up_to(pending_.range_up, t_us),
                 up_to(pending_.range_down, t_us), up_to(pending_.vehicle, t_us), up_to(pending_.command, t_us),
                 up_to(pending_.baro, t_us), up_to(pending_parameters_, t_us), pending_.goal.size()});
}

bool NavNode::step_with(const Consumed& consumed) {
    if (!scan_waiting_ || consumed.imu > pending_.imu.size() || consumed.attitude > pending_.attitude.size() ||
        consumed.range_up > pending_.range_up.size() || consumed.range_down > pending_.range_down.size() ||
        consumed.vehicle > pending_.vehicle.size() || consumed.command > pending_.command.size() ||
        consumed.baro > pending_.baro.size() || consumed.parameters > pending_parameters_.size() ||
        consumed.policy > pending_.goal.size()) {
        return false;
    }
    run(consumed);
    return true;
}

void NavNode::run(const Consumed& consumed) {
    const std::int64_t start_ns = stopwatch_ != nullptr ? stopwatch_() : 0;
    take(pending_.imu, frame_.imu, consumed.imu);
    take(pending_.attitude, frame_.attitude, consumed.attitude);
    take(pending_.range_up, frame_.range_up, consumed.range_up);
    take(pending_.range_down, frame_.range_down, consumed.range_down);
    take(pending_.vehicle, frame_.vehicle, consumed.vehicle);
    take(pending_.command, frame_.command, consumed.command);
    take(pending_.baro, frame_.baro, consumed.baro);
    take(pending_.goal, frame_.goal, consumed.policy);
    for (std::size_t i = 0; i < consumed.parameters; ++i) { refused_ += apply(pending_parameters_[i], parameters_); }
    pending_parameters_.drop_front(consumed.parameters);
    if (consumed.parameters > 0) { values_crc_ = parameter_values_crc(parameters_); }
    frame_.scan = pending_.scan;
    scan_waiting_ = false;

    const NavOutput& output = navigator_.step(frame_);
    predictor_.correct(output.estimate);
    const float step_us = stopwatch_ != nullptr ? static_cast<float>(stopwatch_() - start_ns) * 1e-3F : 0.0F;

    publish_nav(output, consumed, step_us);
    publish_odometry(frame_.scan.t_us, true);
    publish_maps(output);  // last: nobody flies by them
    if (output.ask.t_us == output.t_us) { publish_ask(output); }   // after the tiles that it is about
}

void NavNode::publish_odometry(const std::int64_t t_us, const bool at_scan) {
    Odometry odometry;
    last_odometry_us_ = t_us;
    if (!predictor_.odometry(t_us, odometry)) { return; }
    odom_t message{};
    message.t_us = t_us;
    message.seq = odom_seq_++;
    message.at_scan = at_scan ? 1 : 0;
    message.x_m = odometry.x_m;
    message.y_m = odometry.y_m;
    message.z_m = odometry.z_m;
    message.roll_rad = odometry.roll_rad;
    message.pitch_rad = odometry.pitch_rad;
    message.yaw_rad = odometry.yaw_rad;
    message.vx_m_s = odometry.vx_m_s;
    message.vy_m_s = odometry.vy_m_s;
    message.vz_m_s = odometry.vz_m_s;
    message.yaw_rate_rad_s = odometry.yaw_rate_rad_s;
    for (std::size_t i = 0; i < 3; ++i) {
        message.position_var_m2[i] = odometry.position_var_m2[i];
        message.velocity_var_m2_s2[i] = odometry.velocity_var_m2_s2[i];
    }
    message.yaw_var_rad2 = odometry.yaw_var_rad2;
    message.quality = odometry.quality;
    message.reset_counter = odometry.reset_counter;
    publish(kChannelOdom, message);
}

}  // namespace noctule
