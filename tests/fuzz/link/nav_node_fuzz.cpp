/// Whatever comes over the bus, noctule-nav's messages say nothing that is no number: a pose that is claimed is finite, a setpoint is finite and near
/// that pose, and what is not one of its messages is refused.
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <string>

#include "fuzz/fuzz.hpp"
#include "link/nav_node.hpp"
#include "link/parameter_values.hpp"
#include "streams.gen.hpp"

namespace noctule::fuzz {

namespace {

constexpr std::int64_t kScan_us = 50000;
constexpr float kReach_m = 3.0F;         // half a second at the greatest speed and room for the guard
constexpr std::size_t kStepsAtMost = 8;  // of one input: a step is the costly part

enum class Deed : std::uint8_t { time, imu, attitude, range_down, range_up, vehicle, baro, command, parameters, scan, garbage, end };

bool finite(const std::span<const float> values) {
    return std::all_of(values.begin(), values.end(), [](const float v) { return std::isfinite(v); });
}

struct Judge {
    nav_t nav{};
    static void take(void* context, const char* channel, const std::uint8_t* bytes, const std::size_t size) {
        const std::string name = channel;
        if (name == kChannelNav) {
            nav_t& nav = static_cast<Judge*>(context)->nav;
            HOLDS(nav.decode(bytes, 0, static_cast<int>(size)) == static_cast<int>(size));
            HOLDS(nav.quality >= -1 && nav.quality <= 100);
            if (nav.quality >= 0) { HOLDS(finite(std::array{nav.x_m, nav.y_m, nav.z_m, nav.roll_rad, nav.pitch_rad, nav.yaw_rad, nav.vx_m_s, nav.vy_m_s, nav.vz_m_s})); }
            if (nav.setpoint_valid != 0) {
                HOLDS(finite(std::array{nav.setpoint_x_m, nav.setpoint_y_m, nav.setpoint_z_m, nav.setpoint_yaw_rad, nav.setpoint_vx_m_s, nav.setpoint_vy_m_s, nav.setpoint_vz_m_s}));
                HOLDS(std::hypot(nav.setpoint_x_m - nav.x_m, nav.setpoint_y_m - nav.y_m) < kReach_m);
            }
        } else if (name == kChannelOdom) {
            odom_t odom{};
            HOLDS(odom.decode(bytes, 0, static_cast<int>(size)) == static_cast<int>(size));
            HOLDS(odom.quality >= -1 && odom.quality <= 100);
            if (odom.quality >= 0) {
                HOLDS(finite(std::array{odom.x_m, odom.y_m, odom.z_m, odom.roll_rad, odom.pitch_rad, odom.yaw_rad, odom.vx_m_s, odom.vy_m_s, odom.vz_m_s, odom.yaw_rate_rad_s}));
                HOLDS(finite(odom.position_var_m2) && finite(odom.velocity_var_m2_s2) && odom.position_var_m2[0] >= 0.0F);
            }
        }
    }
};

Parameters parameters;
Judge judge;

/// Encodes a good message, changes a few of its bytes and its length as the input says, and hands it in.
template <class Message>
void send(NavNode& node, Source& from, const char* channel, const Message& message) {
    static std::array<std::uint8_t, 65536> buffer;
    auto size = static_cast<std::size_t>(message.encode(buffer.data(), 0, static_cast<int>(buffer.size())));
    const std::size_t good = size;
    from.patch({buffer.data(), size});
    const std::uint8_t cut = from.byte();
    if (cut == 0xFF) { size += from.byte(); }
    if (cut == 0xFE) { size -= std::min<std::size_t>(size, from.byte()); }
    const std::uint32_t refused = node.refused();
    const Input input = node.receive(channel, buffer.data(), size);
    HOLDS(size == good || input == Input::rejected_malformed);
    HOLDS(input == Input::accepted || node.refused() == refused + 1);
}

}  // namespace

std::vector<Bytes> seeds() {
    const auto deed = [](const Deed d) { return static_cast<std::uint8_t>(d); };
    Bytes steps;
    for (int i = 0; i < 4; ++i) {
        for (const Deed d : {Deed::attitude, Deed::range_down, Deed::range_up, Deed::baro, Deed::vehicle, Deed::scan, Deed::time}) { steps.insert(steps.end(), {deed(d), 0, 0}); }
    }
    Bytes orders;
    for (std::uint8_t order = 1; order <= 7; ++order) {
        orders.insert(orders.end(), {deed(Deed::command), order, 0, 0});
        orders.insert(orders.end(), {deed(Deed::scan), 0, 0, deed(Deed::time), 0, 0});
    }
    Bytes table{deed(Deed::parameters), 0, 0, deed(Deed::scan), 0, 0, deed(Deed::time), 0, 0};
    std::vector<Bytes> out{steps, orders, table, {deed(Deed::garbage), 3, 9, 1, 2, 3, 4, 5, 6, 7, 8, 9}};
    // One number of each kind of message that is none, infinite, or huge.
    constexpr std::array<std::array<std::uint8_t, 4>, 4> kBad{{{0x7F, 0xC0, 0, 0}, {0x7F, 0x80, 0, 0}, {0xFF, 0x80, 0, 0}, {0x7E, 0xFF, 0xFF, 0xFF}}};
    for (const Deed d : {Deed::imu, Deed::attitude, Deed::range_down, Deed::range_up, Deed::vehicle, Deed::baro, Deed::scan, Deed::parameters}) {
        Bytes one = steps;
        for (const auto& bad : kBad) {
            for (std::uint8_t at = 16; at < 60; at = static_cast<std::uint8_t>(at + 4)) {
                one.insert(one.end(), {deed(d), 1, at});
                if (d == Deed::scan || d == Deed::parameters) { one.insert(one.end() - 1, 0); }  // these are longer than 256 bytes
                one.insert(one.end(), bad.begin(), bad.end());
                one.push_back(0);
                if (at % 20 == 16) { one.insert(one.end(), {deed(Deed::scan), 0, 0, deed(Deed::time), 0, 0}); }
            }
            out.push_back(one);
            one = steps;
        }
    }
    return out;
}

}  // namespace noctule::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* const data, const std::size_t size) {
    using namespace noctule;
    const auto node = std::make_unique<NavNode>(fuzz::parameters, fuzz::Judge::take, &fuzz::judge, nullptr);
    std::int64_t t_us = 1000000;
    std::int32_t seq = 0;
    fuzz::Source from(data, size);
    std::size_t steps = 0;
    while (!from.empty() && steps < fuzz::kStepsAtMost) {
        const auto deed = static_cast<fuzz::Deed>(from.byte() % static_cast<std::uint8_t>(fuzz::Deed::end));
        switch (deed) {
            case fuzz::Deed::time: {  // good inertial data up to the next scan, and the step where one waits
                t_us += fuzz::kScan_us;
                for (std::int64_t at_us = t_us - fuzz::kScan_us + 10000; at_us <= t_us; at_us += 10000) {
                    imu_t imu{};
                    imu.t_us = at_us;
                    imu.accel_m_s2[2] = 9.81F;
                    fuzz::Source none(nullptr, 0);
                    fuzz::send(*node, none, kChannelImu, imu);
                }
                if (node->scan_waiting()) {
                    node->step();
                    ++steps;
                }
                break;
            }
            case fuzz::Deed::imu: {
                imu_t imu{};
                imu.t_us = t_us + 5000;
                imu.accel_m_s2[2] = 9.81F;
                fuzz::send(*node, from, kChannelImu, imu);
                break;
            }
            case fuzz::Deed::attitude: {
                attitude_t attitude{};
                attitude.t_us = t_us + 5000;
                fuzz::send(*node, from, kChannelAttitude, attitude);
                break;
            }
            case fuzz::Deed::range_down:
            case fuzz::Deed::range_up: {
                const bool down = deed == fuzz::Deed::range_down;
                range_t range{};
                range.t_us = t_us + 5000;
                range.range_m = 1.0F;
                range.range_min_m = 0.1F;
                range.range_max_m = 12.0F;
                fuzz::send(*node, from, down ? kChannelRangeDown : kChannelRangeUp, range);
                break;
            }
            case fuzz::Deed::vehicle: {
                vehicle_t vehicle{};
                vehicle.t_us = t_us + 5000;
                vehicle.armed = vehicle.offboard = 1;
                vehicle.landed = 2;
                vehicle.battery_remaining = 0.9F;
                fuzz::send(*node, from, kChannelVehicle, vehicle);
                break;
            }
            case fuzz::Deed::baro: {
                baro_t baro{};
                baro.t_us = t_us + 5000;
                baro.height_m = 100.0F;
                fuzz::send(*node, from, kChannelBaro, baro);
                break;
            }
            case fuzz::Deed::command: {
                command_t command{};
                command.t_us = t_us;
                command.command = from.byte() % 9;
                fuzz::send(*node, from, kChannelCommand, command);
                break;
            }
            case fuzz::Deed::parameters: {
                static parameters_t table;
                to_message(fuzz::parameters, table);
                fuzz::send(*node, from, kChannelParameters, table);
                break;
            }
            case fuzz::Deed::scan: {  // a room of 8 x 6 m, the vehicle in its middle
                static scan_t scan;
                scan = scan_t{};
                scan.t_us = t_us + fuzz::kScan_us;
                scan.seq = seq++;
                scan.count = 271;
                scan.time_increment_us = 120.0F;
                scan.bearing_first_rad = -2.356F;
                scan.bearing_increment_rad = 4.712F / 270.0F;
                scan.range_min_m = 0.06F;
                scan.range_max_m = 10.0F;
                for (int i = 0; i < scan.count; ++i) {
                    const float a = scan.bearing_first_rad + static_cast<float>(i) * scan.bearing_increment_rad;
                    scan.range_m[i] = std::min(4.0F / std::fabs(std::cos(a)), 3.0F / std::fabs(std::sin(a)));
                }
                fuzz::send(*node, from, kChannelScan, scan);
                break;
            }
            case fuzz::Deed::garbage: {
                constexpr const char* kNames[] = {kChannelScan, kChannelImu, kChannelAttitude, kChannelRangeDown, kChannelRangeUp, kChannelVehicle, kChannelCommand, kChannelParameters, "ELSE"};
                const char* name = kNames[from.below(std::size(kNames))];
                const auto bytes = from.bytes(from.byte());
                HOLDS(node->receive(name, bytes.data(), bytes.size()) != Input::accepted);  // 48 bytes of chance are no fingerprint
                break;
            }
            case fuzz::Deed::end: break;
        }
    }
    return 0;
}
