/// Whatever the autopilot's link, a ground station, nav and the clock bring: the bridge lets out whole frames only, no number that is none, no
/// setpoint and no arming without a start, and keeps every parameter inside its limits. A vehicle carried by hand is never commanded.
#include <memory>

#include "fuzz/fuzz.hpp"
#include "unit/link/bridge_scene.hpp"

namespace noctule::fuzz {

namespace {

enum class Deed : std::uint8_t { ticks, from_autopilot, from_ground, raw_autopilot, raw_ground, change_nav, change_odom, change_vehicle, order, wall, map_only, fly, video, end };

/// A message of the dialect with a good checksum and this payload.
std::span<const std::uint8_t> frame(Source& from, const std::uint8_t system, const std::uint8_t component) {
    static constexpr mavlink_msg_entry_t kEntries[] = MAVLINK_MESSAGE_CRCS;
    static std::array<std::uint8_t, kMaxMavlinkFrame> buffer;
    static mavlink_status_t status{};
    const mavlink_msg_entry_t& entry = kEntries[from.below(std::size(kEntries))];
    const std::uint8_t about = from.byte();
    const auto payload = from.bytes(std::min<std::size_t>(from.byte(), entry.max_msg_len));
    mavlink_message_t message{};
    std::memcpy(message.payload64, payload.data(), payload.size());
    auto* const bytes = reinterpret_cast<std::uint8_t*>(message.payload64);
    if ((about & 1U) != 0 && (entry.flags & MAV_MSG_ENTRY_FLAG_HAVE_TARGET_SYSTEM) != 0) { bytes[entry.target_system_ofs] = scene::kSystem; }
    if ((about & 1U) != 0 && (entry.flags & MAV_MSG_ENTRY_FLAG_HAVE_TARGET_COMPONENT) != 0) { bytes[entry.target_component_ofs] = (about & 2U) != 0 ? MAV_COMP_ID_CAMERA : MAV_COMP_ID_ONBOARD_COMPUTER; }
    message.msgid = entry.msgid & 0xFFFFFFU;
    mavlink_finalize_message_buffer(&message, system, component, &status, entry.min_msg_len, entry.max_msg_len, entry.crc_extra);
    return {buffer.data(), mavlink_msg_to_send_buffer(buffer.data(), &message)};
}

/// Index of a message in the dialect's table, as `frame` reads it.
/// about: 1 to us, 3 to the camera.
void message(Bytes& out, const std::uint32_t msgid, const Bytes& payload, const std::uint8_t about) {
    static constexpr mavlink_msg_entry_t kEntries[] = MAVLINK_MESSAGE_CRCS;
    const auto at = static_cast<std::size_t>(std::find_if(std::begin(kEntries), std::end(kEntries), [&](const auto& e) { return e.msgid == msgid; }) - std::begin(kEntries));
    if (std::size(kEntries) > 256) { out.push_back(static_cast<std::uint8_t>(at / 256)); }
    out.push_back(static_cast<std::uint8_t>(at % 256));
    out.push_back(about);
    out.push_back(static_cast<std::uint8_t>(payload.size()));
    out.insert(out.end(), payload.begin(), payload.end());
}

bool finite(const std::span<const float> values) {
    return std::all_of(values.begin(), values.end(), [](const float v) { return std::isfinite(v); });
}

/// Between what was true before a deed and what the bridge said since.
void judge(scene::Scene& s, const bool could_fly, const bool map_only) {
    for (const mavlink_message_t& m : s.out.autopilot) {
        if (m.sysid != s.bridge_system() || m.compid != MAV_COMP_ID_ONBOARD_COMPUTER) { continue; }  // passed on from a ground station
        if (m.msgid == MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED) {
            mavlink_set_position_target_local_ned_t p{};
            mavlink_msg_set_position_target_local_ned_decode(&m, &p);
            HOLDS(could_fly && !map_only);
            HOLDS(p.coordinate_frame == MAV_FRAME_LOCAL_NED && finite(std::array{p.x, p.y, p.z, p.vx, p.vy, p.vz, p.yaw}));
        } else if (m.msgid == MAVLINK_MSG_ID_ODOMETRY) {
            mavlink_odometry_t o{};
            mavlink_msg_odometry_decode(&m, &o);
            HOLDS(finite(std::array{o.x, o.y, o.z, o.q[0], o.q[1], o.q[2], o.q[3], o.vx, o.vy, o.vz, o.rollspeed, o.pitchspeed, o.yawspeed}));
        } else if (m.msgid == MAVLINK_MSG_ID_COMMAND_LONG) {
            mavlink_command_long_t c{};
            mavlink_msg_command_long_decode(&m, &c);
            const bool flies = c.command == MAV_CMD_COMPONENT_ARM_DISARM || c.command == MAV_CMD_DO_SET_MODE || c.command == MAV_CMD_NAV_TAKEOFF;
            HOLDS(!flies || (could_fly && !map_only));
        }
    }
    for (const mavlink_message_t& m : s.out.ground) {
        if (m.msgid != MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION || m.compid != MAV_COMP_ID_CAMERA) { continue; }
        mavlink_video_stream_information_t v{};
        mavlink_msg_video_stream_information_decode(&m, &v);
        HOLDS(std::isfinite(v.framerate) && v.resolution_h > 0 && v.resolution_v > 0 && v.uri[0] != '\0' && v.uri[0] != '-');
    }
    for (const ParameterRow& row : kParameterTable) {
        const float value = parameter_value(s.parameters, row);
        HOLDS(value >= row.min && value <= row.max);
    }
    for (const Parameters& stored : s.out.stored) {
        for (const ParameterRow& row : kParameterTable) { HOLDS(parameter_value(stored, row) >= row.min && parameter_value(stored, row) <= row.max); }
    }
    for (const imu_t& m : s.out.imu) { HOLDS(finite(m.accel_m_s2) && finite(m.gyro_rad_s)); }
    for (const attitude_t& m : s.out.attitude) { HOLDS(std::fabs(m.roll_rad) < 3.2F && std::fabs(m.pitch_rad) < 3.2F); }
    s.out.forget();
    s.obeyed = 0;
}

}  // namespace

std::vector<Bytes> seeds() {
    const auto deed = [](const Deed d) { return static_cast<std::uint8_t>(d); };
    Bytes flight{deed(Deed::ticks), 60, deed(Deed::fly), deed(Deed::ticks), 20, deed(Deed::order), 1, 0, deed(Deed::ticks), 20, deed(Deed::order), 3, 0, deed(Deed::ticks), 40};
    Bytes carried{deed(Deed::map_only)};
    carried.insert(carried.end(), flight.begin(), flight.end());
    // Every message that the bridge takes, with zeros, ones and a ramp.
    Bytes heard{deed(Deed::ticks), 25};
    Bytes asked{deed(Deed::ticks), 25};
    Bytes ramp(64);
    for (std::size_t i = 0; i < ramp.size(); ++i) { ramp[i] = static_cast<std::uint8_t>(i); }
    for (const std::uint32_t msgid : {MAVLINK_MSG_ID_HEARTBEAT, MAVLINK_MSG_ID_HIGHRES_IMU, MAVLINK_MSG_ID_RAW_IMU, MAVLINK_MSG_ID_SCALED_IMU, MAVLINK_MSG_ID_SCALED_IMU2, MAVLINK_MSG_ID_SCALED_IMU3,
                                      MAVLINK_MSG_ID_ATTITUDE, MAVLINK_MSG_ID_ATTITUDE_QUATERNION, MAVLINK_MSG_ID_DISTANCE_SENSOR, MAVLINK_MSG_ID_LOCAL_POSITION_NED, MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
                                      MAVLINK_MSG_ID_SYS_STATUS, MAVLINK_MSG_ID_BATTERY_STATUS, MAVLINK_MSG_ID_ESTIMATOR_STATUS, MAVLINK_MSG_ID_SCALED_PRESSURE, MAVLINK_MSG_ID_TIMESYNC,
                                      MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, MAVLINK_MSG_ID_PARAM_VALUE, MAVLINK_MSG_ID_COMMAND_ACK, MAVLINK_MSG_ID_SYSTEM_TIME}) {
        heard.push_back(deed(Deed::from_autopilot));
        message(heard, msgid, ramp, 0);
        heard.insert(heard.end(), {deed(Deed::ticks), 1});
    }
    for (const std::uint32_t msgid : {MAVLINK_MSG_ID_COMMAND_LONG, MAVLINK_MSG_ID_COMMAND_INT, MAVLINK_MSG_ID_PARAM_REQUEST_LIST, MAVLINK_MSG_ID_PARAM_REQUEST_READ, MAVLINK_MSG_ID_PARAM_SET,
                                      MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL, MAVLINK_MSG_ID_HEARTBEAT, MAVLINK_MSG_ID_TIMESYNC}) {
        asked.push_back(deed(Deed::from_ground));
        message(asked, msgid, ramp, 1);
        asked.insert(asked.end(), {deed(Deed::ticks), 1});
    }
    Bytes write{deed(Deed::ticks), 5, deed(Deed::from_ground)};  // PARAM_SET SPEED_MAX: value, target, id, type
    Bytes payload{0, 0, 0x40, 0x3F, scene::kSystem, MAV_COMP_ID_ONBOARD_COMPUTER, 'S', 'P', 'E', 'E', 'D', '_', 'M', 'A', 'X', 0, 0, 0, 0, 0, 0, 0, MAV_PARAM_TYPE_REAL32};
    message(write, MAVLINK_MSG_ID_PARAM_SET, payload, 1);
    write.insert(write.end(), {deed(Deed::ticks), 5});
    Bytes changes = flight;
    for (std::uint8_t at = 0; at < 60; at = static_cast<std::uint8_t>(at + 4)) {
        changes.insert(changes.end(), {deed(Deed::change_nav), 1, 0, static_cast<std::uint8_t>(2 * at), 0, 0, 0x80, 0x7F, deed(Deed::ticks), 3,
                                       deed(Deed::change_odom), 1, 0, at, 0, 0, 0xC0, 0x7F, deed(Deed::ticks), 3});
    }
    Bytes watched{deed(Deed::ticks), 25, deed(Deed::wall), 10, deed(Deed::video), 0};
    for (const std::uint32_t wanted : {MAVLINK_MSG_ID_CAMERA_INFORMATION, MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION}) {   // REQUEST_MESSAGE of the camera
        Bytes request(32);
        const auto asks = static_cast<float>(wanted);
        std::memcpy(request.data(), &asks, sizeof asks);
        request[29] = static_cast<std::uint8_t>(MAV_CMD_REQUEST_MESSAGE >> 8U);
        watched.push_back(deed(Deed::from_ground));
        message(watched, MAVLINK_MSG_ID_COMMAND_LONG, request, 3);
    }
    return {flight, carried, heard, asked, write, changes, watched, {deed(Deed::raw_autopilot), 3, 0xFD, 1, 2, deed(Deed::raw_ground), 2, 0xFE, 9, deed(Deed::wall), 200}};
}

}  // namespace noctule::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* const data, const std::size_t size) {
    using namespace noctule;
    fuzz::Source from(data, size);
    const auto s = std::make_unique<scene::Scene>();
    bool map_only = false;
    bool started = false;
    std::int64_t wall_us = 0;
    video_t video{};
    video.running = 1;
    video.port = 5600;
    video.width_px = 320;
    video.height_px = 240;
    for (int deeds = 0; deeds < 200 && !from.empty(); ++deeds) {
        switch (static_cast<fuzz::Deed>(from.byte() % static_cast<std::uint8_t>(fuzz::Deed::end))) {
            case fuzz::Deed::ticks:
                for (std::size_t n = from.below(64); n > 0; --n) { s->tick(); }
                break;
            case fuzz::Deed::from_autopilot: s->bridge.from_autopilot(fuzz::frame(from, scene::kSystem, MAV_COMP_ID_AUTOPILOT1)); break;
            case fuzz::Deed::from_ground:
                s->bridge.from_ground(fuzz::frame(from, 255, MAV_COMP_ID_MISSIONPLANNER));
                started = true;  // it may have been the order to start
                break;
            case fuzz::Deed::raw_autopilot: s->bridge.from_autopilot(from.bytes(from.byte())); break;
            case fuzz::Deed::raw_ground:
                s->bridge.from_ground(from.bytes(from.byte()));
                started = true;
                break;
            case fuzz::Deed::change_nav:
                from.patch({reinterpret_cast<std::uint8_t*>(&s->nav), sizeof s->nav});
                s->nav.want_disarm = static_cast<std::int8_t>(s->nav.want_disarm & 1);
                break;
            case fuzz::Deed::change_odom: from.patch({reinterpret_cast<std::uint8_t*>(&s->odom), sizeof s->odom}); break;
            case fuzz::Deed::change_vehicle: {
                const std::uint8_t bits = from.byte();
                s->armed = (bits & 1U) != 0;
                s->landed_state = (bits & 2U) != 0 ? MAV_LANDED_STATE_IN_AIR : MAV_LANDED_STATE_ON_GROUND;
                s->nav_runs = (bits & 4U) == 0;
                s->odom_runs = (bits & 8U) == 0;
                if ((bits & 16U) != 0) { s->mode = from.byte() * 65536U; }
                break;
            }
            case fuzz::Deed::order: {
                constexpr std::uint16_t kOrders[] = {MAV_CMD_MISSION_START, MAV_CMD_DO_PAUSE_CONTINUE, MAV_CMD_NAV_RETURN_TO_LAUNCH, MAV_CMD_NAV_LAND, MAV_CMD_USER_1, MAV_CMD_REQUEST_MESSAGE};
                const std::size_t which = from.below(std::size(kOrders));
                s->ask(kOrders[which], static_cast<float>(from.byte()));
                started = started || which == 0;
                break;
            }
            case fuzz::Deed::wall:
                wall_us += 100000 * from.byte();
                s->bridge.set_clock(wall_us);
                s->bridge.on_wall(wall_us);
                break;
            case fuzz::Deed::map_only:
                if (deeds == 0) {
                    s->bridge.set_map_only();
                    map_only = true;
                }
                break;
            case fuzz::Deed::fly:
                s->fly();
                started = true;
                break;
            case fuzz::Deed::video:
                from.patch({reinterpret_cast<std::uint8_t*>(&video), sizeof video});
                s->bridge.on_video(video);
                break;
            case fuzz::Deed::end: break;
        }
        fuzz::judge(*s, started || s->parameters.link_start_by == 1, map_only);
    }
    return 0;
}
