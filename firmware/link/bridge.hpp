/// The bridge between flight controller, ground stations and the autonomy: bytes and messages in, bytes and messages out.
///
/// No sockets and no clock: app/ gives it datagrams and LCM messages, it answers through a BridgeSink. Time is the autopilot's
/// (time_usec, time_boot_ms); wall time serves only to notice that the autopilot is silent. docs/safety_bridge.md says when it
/// holds, lands or yields; docs/frames.md what it converts. Frames Map and Body, SI. No heap after construction, not thread-safe.
///
/// Order matters to the lockstep: what one datagram causes is sent before push returns, orders and vehicle state before the sample
/// that advanced the clock.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "lcmtypes/noctule/attitude_t.hpp"
#include "lcmtypes/noctule/baro_t.hpp"
#include "lcmtypes/noctule/command_t.hpp"
#include "lcmtypes/noctule/imu_t.hpp"
#include "lcmtypes/noctule/nav_t.hpp"
#include "lcmtypes/noctule/objects_t.hpp"
#include "lcmtypes/noctule/odom_t.hpp"
#include "lcmtypes/noctule/parameters_t.hpp"
#include "lcmtypes/noctule/range_t.hpp"
#include "lcmtypes/noctule/scan_t.hpp"
#include "lcmtypes/noctule/vehicle_t.hpp"
#include "lcmtypes/noctule/video_t.hpp"
#include "link/flavour.hpp"
#include "link/flight_control.hpp"
#include "link/ftp_server.hpp"
#include "link/mavlink.hpp"
#include "link/mavlink_convert.hpp"
#include "link/parameter_server.hpp"
#include "link/preflight.hpp"
#include "link/supervisor.hpp"
#include "link/time_sync.hpp"
#include "params.gen.hpp"

namespace noctule {

/// Where the bridge's output goes. Called from within the bridge's own functions; must not call back.
class BridgeSink {
public:
    virtual ~BridgeSink() = default;
    virtual void to_autopilot(std::span<const std::uint8_t> frame) = 0;
    virtual void to_ground(std::span<const std::uint8_t> frame) = 0;  ///< every ground endpoint
    virtual void publish(const imu_t& message) = 0;
    virtual void publish(const attitude_t& message) = 0;
    virtual void publish_up(const range_t& message) = 0;
    virtual void publish_down(const range_t& message) = 0;
    virtual void publish(const baro_t& message) = 0;
    virtual void publish(const vehicle_t& message) = 0;
    virtual void publish(const command_t& message) = 0;
    virtual void publish(const parameters_t& message) = 0;
    virtual void store(const Parameters& parameters) = 0;  ///< on disk, at once and whole or not at all; never called in flight
};

/// The computer that the bridge runs on, for ONBOARD_COMPUTER_STATUS.
struct ComputerLoad {
    std::uint32_t uptime_ms = 0;
    std::uint8_t cpu_percent = UINT8_MAX;    ///< UINT8_MAX: not known
    std::int8_t temperature_c = INT8_MAX;    ///< INT8_MAX: not known
    std::uint32_t ram_used_mib = UINT32_MAX;
    std::uint32_t ram_total_mib = UINT32_MAX;
};

class Bridge {
public:
    struct Counters {
        std::uint64_t imu = 0;
        std::uint64_t setpoints_sent = 0;
        std::uint64_t odometry_sent = 0;
        std::uint64_t refused_samples = 0;   ///< repeated, out of order or unusable samples of the autopilot
        std::uint64_t texts_dropped = 0;     ///< STATUSTEXT held back by the rate limit
        std::uint64_t other_autopilots = 0;  ///< heartbeats of a second autopilot
    };

    /// The table is the live one: a ground station's writes change it. It outlives the bridge.
    Bridge(Parameters& parameters, BridgeSink& sink);

    /// One datagram of the autopilot's link.
    void from_autopilot(std::span<const std::uint8_t> bytes);
    /// One datagram of a ground station.
    void from_ground(std::span<const std::uint8_t> bytes);
    void on_nav(const nav_t& message);
    void on_odom(const odom_t& message);
    void on_scan(const scan_t& message);
    void on_objects(const objects_t& message);
    void on_computer(const ComputerLoad& load);
    /// The front camera streams: ground stations see a camera with a video while these come.
    void on_video(const video_t& message);

    /// Our clock, monotonic, now: for TIMESYNC. Set it before datagrams are handed in; without it no offset is known.
    void set_clock(std::int64_t wall_us) { wall_us_ = wall_us; }
    /// The vehicle is carried by hand: no setpoint, mode or arming is ever sent, and a start is refused.
    void set_map_only() { map_only_ = true; }

    /// Wall time, rising; a few times a second. Only for heartbeats before an autopilot is heard and for its silence.
    void on_wall(std::int64_t wall_us);

    [[nodiscard]] bool autopilot_heard() const { return heard_; }
    /// The autopilot was heard within link_autopilot_timeout_s of wall time.
    [[nodiscard]] bool autopilot_alive() const { return alive_; }
    [[nodiscard]] std::int64_t now_us() const { return now_us_; }
    [[nodiscard]] const FlightControl& flight() const { return flight_; }
    [[nodiscard]] const Supervisor& supervisor() const { return supervisor_; }
    [[nodiscard]] const Counters& counters() const { return counters_; }
    [[nodiscard]] const MavlinkReader::Counters& autopilot_bytes() const { return autopilot_reader_.counters(); }
    [[nodiscard]] const MavlinkReader::Counters& ground_bytes() const { return ground_reader_.counters(); }

private:
    struct PendingStart {
        bool active = false;
        MavlinkTarget asked_by;
        std::int64_t earliest_us = 0;
        std::int64_t give_up_us = 0;
    };
    struct Stream {
        const char* name;
        std::uint32_t msgid;
        std::uint32_t substitute;  ///< asked for as well when msgid never comes; 0 none
        float rate_hz;
        std::uint32_t count;       ///< since the last look
        int futile;                ///< times it was asked for and did not come
    };

    // bridge.cpp: what comes from the autopilot
    void autopilot_frame(const MavlinkFrame& frame);
    void take(const mavlink_message_t& message);
    void take_heartbeat(const mavlink_message_t& message);
    template <class Message>
    void take_imu(std::size_t rank, void (*decode)(const mavlink_message_t*, Message*), const mavlink_message_t& message);
    void take_imu(imu_t& sample, std::size_t rank);
    void take_highres(const mavlink_message_t& message);
    void take_attitude(const FullAttitude& attitude, bool substitute);
    void take_range(const mavlink_message_t& message);
    void take_baro(baro_t& sample, bool substitute);
    void take_battery(std::int8_t percent);
    void take_ack(const mavlink_message_t& message);
    void advance(std::int64_t t_us);
    void forget_autopilot_clock(std::int64_t t_us);
    void pass_to_ground(const MavlinkFrame& frame);
    [[nodiscard]] bool passes_to_ground(const MavlinkFrame& frame);

    // bridge_ground.cpp: what comes from a ground station
    void ground_frame(const MavlinkFrame& frame);
    struct Asked {
        std::uint16_t command;
        float param1;
        float param2;
        float param3;
        MavlinkTarget by;
    };
    void take_command(const Asked& asked);
    void take_mission_command(const Asked& asked);
    void take_message_request(const Asked& asked);
    void send_version();
    void send_component_metadata();
    void take_file_request(const mavlink_message_t& message, MavlinkTarget asked_by);
    void send_file_packets(int at_most);
    [[nodiscard]] bool under_way(std::int32_t wanted) const;
    [[nodiscard]] bool awaits_pilot() const;
    void step_pilot_start();
    void step_ground_silence();
    void take_start(float earliest_s, MavlinkTarget asked_by);
    void try_pending_start();
    struct Obstacle {
        const char* why = nullptr;   ///< null: none
        std::uint8_t result = MAV_RESULT_TEMPORARILY_REJECTED;
    };
    [[nodiscard]] Obstacle start_obstacle(bool by_pilot) const;
    void refuse_start(const Obstacle& obstacle, MavlinkTarget asked_by);
    bool begin_start(bool by_pilot);
    void acknowledge(std::uint16_t command, std::uint8_t result, MavlinkTarget asked_by);
    void acknowledge_as(MavlinkWriter& writer, std::uint16_t command, std::uint8_t result, MavlinkTarget asked_by);
    void order(std::int32_t command);

    // bridge_camera.cpp
    [[nodiscard]] bool has_video() const;
    void take_camera_command(const Asked& asked);
    void send_about_camera(std::uint32_t msgid);

    // bridge_telemetry.cpp
    void take_timesync(const mavlink_message_t& message);
    void send_timesync();
    void take_origin(const mavlink_message_t& message);
    void step_origin();
    void take_estimator(std::uint16_t flags, float position_ratio);
    void take_unknown(std::span<const std::uint8_t> frame);
    [[nodiscard]] bool estimator_lost() const;
    [[nodiscard]] bool lands_elsewhere() const;
    [[nodiscard]] float time_left_s() const;

    // bridge_parameters.cpp
    void take_parameter_request(const mavlink_message_t& message, MavlinkTarget asked_by);
    void write_parameter(const mavlink_message_t& message, MavlinkTarget asked_by);
    void refuse_parameter(const char (&id)[16], std::int16_t index, std::uint8_t error, MavlinkTarget asked_by);
    void store_parameters();
    void publish_parameters();
    void compare_values();
    void send_listed_parameters(std::size_t at_most);
    void send_parameters_on_wall();
    void begin_preflight();
    void step_preflight();
    [[nodiscard]] const char* preflight_obstacle() const;

    // bridge_periodic.cpp: what the passing time brings
    void step_flight();
    [[nodiscard]] FlightView view() const;
    void act(const FlightStep& step);
    void request(Request request);
    void send_mode(const FlightMode& mode);
    void send_command(std::uint16_t command, const std::array<float, 7>& params);
    void send_setpoint(const Setpoint& setpoint, std::int64_t t_us);
    [[nodiscard]] bool acceleration_of(const Setpoint& setpoint, std::int64_t t_us, Acceleration& out) const;
    void send_heartbeat();
    void send_progress();
    void publish_vehicle();
    void ask_for(std::uint32_t msgid, float rate_hz);
    void ask_for_streams();
    void wake_streams();
    [[nodiscard]] bool slows_our_streams(const mavlink_message_t& message) const;
    [[nodiscard]] bool starves_us(const MavlinkFrame& frame) const;
    void text(std::uint8_t severity, const char* format, ...) __attribute__((format(printf, 3, 4)));

    template <class Payload>
    void send_autopilot(std::uint16_t (*encode)(std::uint8_t, std::uint8_t, mavlink_status_t*, mavlink_message_t*, const Payload*), const Payload& payload) {
        sink_.to_autopilot(to_autopilot_.pack(encode, payload));
    }
    template <class Payload>
    void send_ground(std::uint16_t (*encode)(std::uint8_t, std::uint8_t, mavlink_status_t*, mavlink_message_t*, const Payload*), const Payload& payload) {
        sink_.to_ground(to_ground_.pack(encode, payload));
    }
    [[nodiscard]] bool is_us(const mavlink_message_t& message) const { return message.sysid == system_ && message.compid == MAV_COMP_ID_ONBOARD_COMPUTER; }
    [[nodiscard]] MavlinkTarget autopilot() const { return {system_, MAV_COMP_ID_AUTOPILOT1}; }

    static constexpr std::size_t kImuRanks = 5;                ///< HIGHRES_IMU, RAW_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3
    static constexpr std::uint32_t kEkfStatusReport = 193;     ///< ArduPilot's dialect
    static constexpr std::uint16_t kSetGlobalOrigin = 611;     ///< MAV_CMD_DO_SET_GLOBAL_ORIGIN, newer than the headers
    static constexpr float kTextReserve = 3.0F;  ///< texts that a long list leaves to others

    Parameters& p_;
    BridgeSink& sink_;
    Supervisor supervisor_;
    FlightControl flight_;
    MavlinkReader autopilot_reader_;
    MavlinkReader ground_reader_;
    MavlinkWriter to_autopilot_;
    MavlinkWriter to_ground_;
    MavlinkWriter camera_to_ground_;       ///< the same link, as the camera
    Counters counters_;

    // The autopilot
    bool heard_ = false;
    bool alive_ = false;
    bool spoke_ = false;                   ///< since the last on_wall
    std::uint8_t system_ = 1;
    const Flavour* flavour_ = nullptr;
    std::uint32_t custom_mode_ = 0;
    bool armed_ = false;
    std::int8_t landed_ = 0;
    float battery_ = -1.0F;
    bool battery_landing_ = false;
    LocalPosition local_;
    std::int64_t local_us_ = -1;
    float local_yaw_rad_ = 0.0F;
    std::int64_t local_yaw_us_ = -1;

    // Samples on their way to nav
    imu_t imu_{};
    attitude_t attitude_{};
    range_t range_up_{};
    range_t range_down_{};
    baro_t baro_{};
    vehicle_t vehicle_{};
    command_t command_{};
    std::array<std::int64_t, kImuRanks> imu_heard_us_;  ///< when each kind last came
    std::int64_t fine_baro_us_ = -1;       ///< when HIGHRES_IMU last had the pressure
    std::int64_t quaternion_us_ = -1;      ///< when ATTITUDE_QUATERNION last came

    // Nav
    bool nav_heard_ = false;
    nav_t nav_{};
    std::int64_t nav_us_ = -1;             ///< when it came
    odom_t last_odom_{};                   ///< last one that was sent with a claim
    std::int32_t reset_offset_ = 0;        ///< restarts of nav, so that the autopilot sees its pose jump

    // Time
    std::int64_t now_us_ = -1;
    std::int64_t wall_us_ = 0;
    std::int64_t autopilot_wall_us_ = -1;
    std::int64_t next_wall_beat_us_ = 0;
    std::int64_t next_wall_ask_us_ = 0;
    std::int64_t next_second_us_ = 0;
    std::int64_t next_vehicle_us_ = 0;
    std::int64_t next_hold_us_ = 0;
    Setpoint sent_;                        ///< the last setpoint
    std::int64_t sent_us_ = -1;            ///< and its stamp
    std::int64_t next_ground_imu_us_ = 0;
    std::uint32_t withheld_ = 0;           ///< the autopilot's frames that no ground station got
    std::int64_t next_ground_odometry_us_ = 0;
    std::int64_t next_streams_us_ = 0;
    std::int64_t streams_since_us_ = 0;

    // What it tells
    TimeSync time_sync_;
    std::int64_t timesync_sent_ns_ = 0;    ///< of the question under way; 0 none
    bool origin_known_ = false;
    int origin_tries_ = 0;
    std::int64_t next_origin_us_ = 0;
    std::int64_t global_us_ = -1;          ///< when GLOBAL_POSITION_INT last came
    std::int64_t next_obstacles_us_ = 0;
    std::int64_t estimator_us_ = -1;
    std::uint16_t estimator_flags_ = 0;
    std::int32_t newest_object_ = 0;
    float drain_from_ = -1.0F;             ///< battery at take-off
    std::int64_t drain_since_us_ = 0;
    video_t video_{};
    std::int64_t video_wall_us_ = -1;      ///< when it last came
    bool map_only_ = false;
    std::int64_t other_autopilot_us_ = -1; ///< when a second autopilot was last heard
    bool switch_seen_off_ = false;         ///< the offboard mode was not on since the last start
    std::int32_t last_order_ = 0;
    std::int64_t last_order_us_ = -1;
    std::int64_t ground_heard_us_ = -1;
    bool ground_lost_ = false;

    FtpServer ftp_;

    // Parameters
    ParameterServer table_;
    Preflight preflight_;
    bool preflight_told_ = false;
    std::size_t tell_row_ = kMaxPreflightRows;  ///< next row of the list of wrong ones
    parameters_t parameters_message_{};
    bool values_agree_ = false;            ///< nav flies our values
    std::int64_t next_table_us_ = 0;
    std::int64_t listed_at_us_ = -1;

    // Ground station
    PendingStart pending_start_;
    std::array<Stream, 8> streams_;
    float text_tokens_ = 8.0F;
    std::int64_t text_tokens_us_ = 0;
    std::uint16_t text_id_ = 0;
    std::array<char, 160> last_text_{};
    std::int64_t last_text_us_ = -1;
};

}  // namespace noctule
