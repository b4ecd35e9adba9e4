/// The autonomy as one object behind the wire format: LCM messages in, LCM messages out.
///
/// noctule-nav, the in-process bench and the replay all drive this same class, so that they compute the same.
/// It collects samples until the inertial data has reached a scan's stamp, runs one Navigator::step, and publishes
/// what the step returned: NAV, ODOM, then what only a watcher wants: GRID_TILE, WALLS, LEVELS, POLICY_ASK. Between scans it publishes ODOM from the
/// output predictor every 20 ms of data time. Samples later than the scan stay for the next step. A PARAMETERS message
/// takes effect between two steps; rows that need a restart keep the value they started with.
/// Frames Map and Body (docs/frames.md), SI units. No heap, no clock, not thread-safe. All storage is inside.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "estimate/output_predictor.hpp"
#include "lcmtypes/noctule/attitude_t.hpp"
#include "lcmtypes/noctule/baro_t.hpp"
#include "lcmtypes/noctule/command_t.hpp"
#include "lcmtypes/noctule/grid_tile_t.hpp"
#include "lcmtypes/noctule/imu_t.hpp"
#include "lcmtypes/noctule/levels_t.hpp"
#include "lcmtypes/noctule/nav_t.hpp"
#include "lcmtypes/noctule/odom_t.hpp"
#include "lcmtypes/noctule/parameters_t.hpp"
#include "lcmtypes/noctule/policy_ask_t.hpp"
#include "lcmtypes/noctule/policy_goal_t.hpp"
#include "lcmtypes/noctule/range_t.hpp"
#include "lcmtypes/noctule/scan_t.hpp"
#include "lcmtypes/noctule/vehicle_t.hpp"
#include "lcmtypes/noctule/walls_t.hpp"
#include "navigator.hpp"
#include "params.gen.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// What became of a message.
enum class Input : std::uint8_t { accepted, other_channel, rejected_malformed, rejected_repeat, refused_full };

/// How many samples a step consumed; NAV carries it, replay obeys it.
struct Consumed {
    std::size_t imu = 0;
    std::size_t attitude = 0;
    std::size_t range_up = 0;
    std::size_t range_down = 0;
    std::size_t vehicle = 0;
    std::size_t command = 0;
    std::size_t baro = 0;
    std::size_t parameters = 0;
    std::size_t policy = 0;
};

class NavNode {
public:
    /// Called once a message; `bytes` hold until the call returns.
    using Publish = void (*)(void* context, const char* channel, const std::uint8_t* bytes, std::size_t size);
    /// Monotonic nanoseconds, for NAV.step_us only; null: step_us is 0.
    using Stopwatch = std::int64_t (*)();

    NavNode(const Parameters& parameters, Publish sink, void* context, Stopwatch stopwatch);

    /// One message off the bus. Malformed, repeated or surplus ones change nothing and are counted.
    Input receive(const char* channel, const std::uint8_t* bytes, std::size_t size);

    /// A scan waits for its step.
    [[nodiscard]] bool scan_waiting() const { return scan_waiting_; }
    /// A scan waits and the inertial data has reached its stamp.
    [[nodiscard]] bool step_due() const;

    /// A policy outside was asked and its answer has not come. In lockstep the caller waits a while with the next step.
    [[nodiscard]] bool answer_awaited() const { return asked_ > answered_; }

    /// Runs one step on the waiting scan with the samples up to its stamp. No effect when no scan waits.
    void step();
    /// The same with the samples that a log says were consumed (replay). False: fewer are there; nothing is changed.
    [[nodiscard]] bool step_with(const Consumed& consumed);

    [[nodiscard]] const Navigator& navigator() const { return navigator_; }
    /// Stamp of the newest scan that was stepped; 0 before the first.
    [[nodiscard]] std::int64_t newest_t_us() const { return frame_.scan.t_us; }
    [[nodiscard]] std::uint32_t refused() const { return refused_; }
    [[nodiscard]] std::uint32_t scans_replaced() const { return scans_replaced_; }

private:
    template <class Message>
    [[nodiscard]] bool decode(Message& message, const std::uint8_t* bytes, std::size_t size);
    template <class Message>
    void publish(const char* const channel, const Message& message) {
        const int size = message.encode(encoded_.data(), 0, static_cast<int>(encoded_.size()));
        if (size > 0) { publish_(context_, channel, encoded_.data(), static_cast<std::size_t>(size)); }
    }

    Input receive_imu(const std::uint8_t* bytes, std::size_t size);
    Input receive_attitude(const std::uint8_t* bytes, std::size_t size);
    Input receive_range(const std::uint8_t* bytes, std::size_t size, bool up);
    Input receive_baro(const std::uint8_t* bytes, std::size_t size);
    Input receive_vehicle(const std::uint8_t* bytes, std::size_t size);
    Input receive_command(const std::uint8_t* bytes, std::size_t size);
    Input receive_parameters(const std::uint8_t* bytes, std::size_t size);
    Input receive_goal(const std::uint8_t* bytes, std::size_t size);
    Input receive_scan(const std::uint8_t* bytes, std::size_t size);

    void run(const Consumed& consumed);
    void publish_maps(const NavOutput& output);
    void publish_walls(const NavOutput& output);
    void publish_levels(const NavOutput& output);
    void publish_ask(const NavOutput& output);
    void publish_nav(const NavOutput& output, const Consumed& consumed, float step_us);
    void publish_odometry(std::int64_t t_us, bool at_scan);

    Parameters parameters_;  ///< the live ones: all below read them here, PARAMETERS changes them between two steps
    std::int32_t values_crc_;
    Navigator navigator_;
    OutputPredictor predictor_;
    Publish publish_;
    void* context_;
    Stopwatch stopwatch_;

    SensorFrame pending_;  ///< in order of arrival; `scan` is the newest one received
    SensorFrame frame_;    ///< what the running step consumes
    Bounded<parameters_t, kMaxParametersPerStep> pending_parameters_;
    bool scan_waiting_ = false;
    bool scan_seen_ = false;
    std::int64_t newest_imu_us_ = 0;
    std::int64_t last_odometry_us_ = 0;
    std::int64_t last_walls_us_ = 0;
    std::int64_t last_levels_us_ = 0;
    std::int32_t nav_seq_ = 0;
    std::int32_t odom_seq_ = 0;
    std::int32_t tile_seq_ = 0;
    std::int32_t walls_seq_ = 0;
    std::int32_t levels_seq_ = 0;
    std::int32_t asked_ = 0;       ///< number of the newest request to a policy outside
    std::int32_t answered_ = 0;    ///< newest request that an answer has come to
    std::uint32_t refused_ = 0;
    std::uint32_t scans_replaced_ = 0;

    scan_t scan_message_{};
    parameters_t parameters_message_{};
    nav_t nav_message_{};
    grid_tile_t tile_message_{};
    walls_t walls_message_{};
    Bounded<WallSegment, kMaxWalls> walls_;
    levels_t levels_message_{};
    std::array<std::uint8_t, 65536> encoded_{};
};

}  // namespace noctule
