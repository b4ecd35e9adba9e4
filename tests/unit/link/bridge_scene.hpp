/// A bridge between a fake autopilot, a fake ground station and a fake nav: no sockets, time as the scene says.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "link/bridge.hpp"
#include "link/parameter_values.hpp"
#include "plan/mission.hpp"

namespace noctule::scene {

inline constexpr std::uint8_t kSystem = 7;
inline constexpr std::int64_t kTick_us = 50000;

/// Everything that the bridge let out.
class Recorder final : public BridgeSink {
public:
    void to_autopilot(const std::span<const std::uint8_t> frame) override { take(autopilot_reader_, frame, autopilot); }
    void to_ground(const std::span<const std::uint8_t> frame) override { take(ground_reader_, frame, ground); }
    void publish(const imu_t& m) override { imu.push_back(m); }
    void publish(const attitude_t& m) override { attitude.push_back(m); }
    void publish_up(const range_t& m) override { up.push_back(m); }
    void publish_down(const range_t& m) override { down.push_back(m); }
    void publish(const baro_t& m) override { baro.push_back(m); }
    void publish(const vehicle_t& m) override { vehicle.push_back(m); }
    void publish(const command_t& m) override { command.push_back(m); }
    void publish(const parameters_t& m) override { tables.push_back(m); }
    void store(const Parameters& m) override { stored.push_back(m); }

    void forget() {
        const auto empty = [](auto&... lists) { (lists.clear(), ...); };
        empty(autopilot, ground, imu, attitude, up, down, baro, vehicle, command, tables, stored);
    }

    std::vector<mavlink_message_t> autopilot;
    std::vector<mavlink_message_t> ground;
    std::vector<imu_t> imu;
    std::vector<attitude_t> attitude;
    std::vector<range_t> up;
    std::vector<range_t> down;
    std::vector<baro_t> baro;
    std::vector<vehicle_t> vehicle;
    std::vector<command_t> command;
    std::vector<parameters_t> tables;
    std::vector<Parameters> stored;

private:
    static void take(MavlinkReader& reader, const std::span<const std::uint8_t> frame, std::vector<mavlink_message_t>& out) {
        reader.push_datagram(frame, [&](const MavlinkFrame& f) { out.push_back(f.message); });
    }
    MavlinkReader autopilot_reader_;
    MavlinkReader ground_reader_;
};

/// An autopilot in small: obeys mode and arm commands at once (where it is told to), holds our position exactly.
struct Scene {
    Parameters parameters;
    Recorder out;
    Bridge bridge{parameters, out};
    MavlinkWriter autopilot_writer;
    MavlinkWriter ground_writer;

    std::uint8_t autopilot_type = MAV_AUTOPILOT_PX4;
    std::uint32_t mode = 3U << 16U;  // PX4 POSITION
    bool armed = false;
    bool obeys_mode = true;
    bool obeys_arm = true;
    std::uint8_t landed_state = MAV_LANDED_STATE_ON_GROUND;
    LocalPosition local_offset;      ///< autopilot's position minus ours
    float yaw_offset_rad = 0.0F;
    bool nav_runs = true;
    bool obeys_tables = true;        ///< nav flies the bridge's values
    std::vector<std::pair<std::string, float>> autopilot_parameters;  ///< what it answers with; empty: the wanted ones
    bool odom_runs = true;
    nav_t nav{};
    odom_t odom{};
    std::int64_t t_us = 1000000;
    std::size_t obeyed = 0;          ///< messages to the autopilot that it has looked at

    Scene() {
        autopilot_writer.set_ids(kSystem, MAV_COMP_ID_AUTOPILOT1);
        ground_writer.set_ids(255, MAV_COMP_ID_MISSIONPLANNER);
        nav.parameters_crc = static_cast<std::int32_t>(kParametersCrc);
        nav.ready = 1;
        nav.quality = 90;
        nav.z_m = 0.1F;
        odom.z_m = 0.1F;
        odom.quality = 90;
    }

    template <class Payload>
    void from_autopilot(std::uint16_t (*encode)(std::uint8_t, std::uint8_t, mavlink_status_t*, mavlink_message_t*, const Payload*), const Payload& payload) {
        bridge.from_autopilot(autopilot_writer.pack(encode, payload));
    }
    template <class Payload>
    void from_ground(std::uint16_t (*encode)(std::uint8_t, std::uint8_t, mavlink_status_t*, mavlink_message_t*, const Payload*), const Payload& payload) {
        bridge.from_ground(ground_writer.pack(encode, payload));
    }

    void heartbeat() {
        mavlink_heartbeat_t m{};
        m.autopilot = autopilot_type;
        m.type = MAV_TYPE_QUADROTOR;
        m.custom_mode = mode;
        m.base_mode = static_cast<std::uint8_t>(MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (armed ? MAV_MODE_FLAG_SAFETY_ARMED : 0));
        from_autopilot(mavlink_msg_heartbeat_encode_status, m);
    }

    void obey() {
        for (; obeyed < out.autopilot.size(); ++obeyed) {
            answer_parameter(out.autopilot[obeyed]);
            if (out.autopilot[obeyed].msgid != MAVLINK_MSG_ID_COMMAND_LONG) { continue; }
            mavlink_command_long_t c{};
            mavlink_msg_command_long_decode(&out.autopilot[obeyed], &c);
            if (c.command == MAV_CMD_DO_SET_MODE && obeys_mode) {
                mode = autopilot_type == MAV_AUTOPILOT_PX4 ? static_cast<std::uint32_t>(c.param2) << 16U | static_cast<std::uint32_t>(c.param3) << 24U
                                                           : static_cast<std::uint32_t>(c.param2);
            }
            if (c.command == MAV_CMD_COMPONENT_ARM_DISARM && obeys_arm) { armed = c.param1 > 0.5F; }
        }
    }

    /// PARAM_REQUEST_READ: what a well set autopilot says, or what the scene wants it to say (NaN: nothing).
    void answer_parameter(const mavlink_message_t& message) {
        if (message.msgid != MAVLINK_MSG_ID_PARAM_REQUEST_READ) { return; }
        mavlink_param_request_read_t in{};
        mavlink_msg_param_request_read_decode(&message, &in);
        const Flavour* flavour = flavour_of(autopilot_type);
        if (flavour == nullptr) { return; }
        for (const PreflightRow& row : flavour->preflight) {
            if (parameter_id(in.param_id) != row.id) { continue; }
            float value = row.bits != 0 ? static_cast<float>(row.bits) : row.low;
            for (const auto& [id, other] : autopilot_parameters) {
                if (id == row.id) { value = other; }
            }
            if (!(value == value)) { return; }
            mavlink_param_value_t answer{};
            std::memcpy(answer.param_id, in.param_id, sizeof answer.param_id);
            const bool whole = value == std::floor(value);
            answer.param_type = whole ? MAV_PARAM_TYPE_INT32 : MAV_PARAM_TYPE_REAL32;
            answer.param_value = whole ? integer_to_wire(static_cast<std::int32_t>(value), flavour->cast_integers) : value;
            from_autopilot(mavlink_msg_param_value_encode_status, answer);
        }
    }

    /// One tick of 50 ms in the order of the lockstep.
    void tick() {
        t_us += kTick_us;
        const auto ms = static_cast<std::uint32_t>(t_us / 1000);
        obey();
        if (ms % 1000 == 0) { heartbeat(); }
        if (ms % 200 == 0) {
            mavlink_extended_sys_state_t m{};
            m.landed_state = landed_state;
            from_autopilot(mavlink_msg_extended_sys_state_encode_status, m);
        }
        from_autopilot(mavlink_msg_attitude_quaternion_encode_status, to_attitude_quaternion({t_us, 0.0F, 0.0F, wrap_angle(odom.yaw_rad + yaw_offset_rad)}));
        LocalPosition local = local_offset;
        local.t_us = t_us;
        local.x_m += odom.x_m;
        local.y_m += odom.y_m;
        local.z_m += odom.z_m;
        from_autopilot(mavlink_msg_local_position_ned_encode_status, to_local_position_ned(local));
        imu_t imu{};
        imu.t_us = t_us;
        imu.accel_m_s2[2] = 9.81F;
        from_autopilot(mavlink_msg_highres_imu_encode_status, to_highres_imu(imu));
        if (nav_runs) {
            nav.t_us = t_us;
            if (obeys_tables) { nav.values_crc = parameter_values_crc(parameters); }
            ++nav.seq;
            nav.x_m = odom.x_m;
            nav.y_m = odom.y_m;
            nav.z_m = odom.z_m;
            bridge.on_nav(nav);
        }
        if (odom_runs) {
            odom.t_us = t_us;
            odom.at_scan = 1;
            ++odom.seq;
            bridge.on_odom(odom);
        }
    }

    void run(const double seconds) {
        for (int i = 0; i < static_cast<int>(std::lround(seconds * 20.0)); ++i) { tick(); }
    }

    void ask(const std::uint16_t command, const float param1 = 0.0F, const float param3 = 0.0F) {
        mavlink_command_long_t c{};
        c.target_system = kSystem;
        c.target_component = MAV_COMP_ID_ONBOARD_COMPUTER;
        c.command = command;
        c.param1 = param1;
        c.param3 = param3;
        from_ground(mavlink_msg_command_long_encode_status, c);
    }

    void hold_setpoint() {
        nav.setpoint_valid = 1;
        nav.setpoint_x_m = odom.x_m;
        nav.setpoint_y_m = odom.y_m;
        nav.setpoint_z_m = odom.z_m;
    }

    /// Ready, started, armed and in the air; nav sends setpoints on the spot.
    void fly() {
        run(3.0);
        ask(MAV_CMD_MISSION_START);
        hold_setpoint();
        nav.state = static_cast<std::int32_t>(MissionState::taking_off);
        nav.ready = 0;
        run(5.0);
        landed_state = MAV_LANDED_STATE_IN_AIR;
        odom.z_m = 1.0F;
        hold_setpoint();
        nav.state = static_cast<std::int32_t>(MissionState::exploring);
        run(1.0);
    }

    /// The system that the bridge speaks as.
    [[nodiscard]] std::uint8_t bridge_system() const { return bridge.autopilot_heard() ? kSystem : std::uint8_t{1}; }

    [[nodiscard]] std::vector<mavlink_command_long_t> commands(const std::uint16_t command) const {
        std::vector<mavlink_command_long_t> found;
        for (const mavlink_message_t& m : out.autopilot) {
            mavlink_command_long_t c{};
            if (m.msgid != MAVLINK_MSG_ID_COMMAND_LONG) { continue; }
            mavlink_msg_command_long_decode(&m, &c);
            if (c.command == command) { found.push_back(c); }
        }
        return found;
    }

    [[nodiscard]] static std::size_t count(const std::vector<mavlink_message_t>& messages, const std::uint32_t msgid) {
        std::size_t n = 0;
        for (const mavlink_message_t& m : messages) { n += m.msgid == msgid ? 1U : 0U; }
        return n;
    }

    /// COMMAND_ACK results that the ground station got for a command, in order.
    [[nodiscard]] std::vector<int> results(const std::uint16_t command) const {
        std::vector<int> found;
        for (const mavlink_message_t& m : out.ground) {
            if (m.msgid != MAVLINK_MSG_ID_COMMAND_ACK) { continue; }
            mavlink_command_ack_t ack{};
            mavlink_msg_command_ack_decode(&m, &ack);
            if (ack.command == command) { found.push_back(ack.result); }
        }
        return found;
    }

    [[nodiscard]] bool said(const std::string& words) const {
        for (const mavlink_message_t& m : out.ground) {
            if (m.msgid != MAVLINK_MSG_ID_STATUSTEXT) { continue; }
            mavlink_statustext_t text{};
            mavlink_msg_statustext_decode(&m, &text);
            if (std::string(text.text, strnlen(text.text, sizeof text.text)).find(words) != std::string::npos) { return true; }
        }
        return false;
    }

    [[nodiscard]] bool ordered(const std::int32_t command) const {
        for (const command_t& c : out.command) {
            if (c.command == command) { return true; }
        }
        return false;
    }
};

}  // namespace noctule::scene
