/// The bridge as a camera: while noctule-video streams, ground stations find a camera with one video on component 100 of the vehicle.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>

#include "link/bridge.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kVideoFresh_us = 3000000;   // wall time; VIDEO comes once a second
constexpr std::int32_t kMostPixels = 65535;
constexpr std::uint8_t kStream = 1;
constexpr char kVendor[] = "Noctule";
constexpr char kModel[] = "front camera";

}  // namespace

bool Bridge::has_video() const { return video_wall_us_ >= 0 && wall_us_ - video_wall_us_ < kVideoFresh_us; }

/// The camera's heartbeat comes with each of these: it ends when they do.
void Bridge::on_video(const video_t& message) {
    const auto sensible = [](const std::int32_t value) { return value > 0 && value <= kMostPixels; };
    if (!heard_ || !sensible(message.port) || !sensible(message.width_px) || !sensible(message.height_px) || !std::isfinite(message.rate_hz)) { return; }
    const bool seen = has_video();
    video_ = message;
    video_wall_us_ = wall_us_;
    if (!seen) { text(MAV_SEVERITY_INFO, "front camera: H.264 by RTP on UDP port %d", static_cast<int>(message.port)); }
    mavlink_heartbeat_t out{};
    out.type = MAV_TYPE_CAMERA;
    out.autopilot = MAV_AUTOPILOT_INVALID;
    out.system_status = message.running != 0 ? MAV_STATE_ACTIVE : MAV_STATE_STANDBY;
    out.mavlink_version = 3;
    sink_.to_ground(camera_to_ground_.pack(mavlink_msg_heartbeat_encode_status, out));
}

/// Requests of the camera protocol, by REQUEST_MESSAGE and by the commands that it took the place of; there is nothing to set.
void Bridge::take_camera_command(const Asked& asked) {
    std::uint32_t msgid = UINT32_MAX;
    float stream = 0.0F;
    switch (asked.command) {
        case MAV_CMD_REQUEST_MESSAGE:
            if (asked.param1 >= 0.0F && asked.param1 < 16777216.0F) { msgid = static_cast<std::uint32_t>(asked.param1); }
            stream = asked.param2;
            break;
        case MAV_CMD_REQUEST_CAMERA_INFORMATION: msgid = MAVLINK_MSG_ID_CAMERA_INFORMATION; break;
        case MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION:
            msgid = MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION;
            stream = asked.param1;
            break;
        case MAV_CMD_REQUEST_VIDEO_STREAM_STATUS:
            msgid = MAVLINK_MSG_ID_VIDEO_STREAM_STATUS;
            stream = asked.param1;
            break;
        default: break;
    }
    const bool of_stream = msgid == MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION || msgid == MAVLINK_MSG_ID_VIDEO_STREAM_STATUS;
    if (!of_stream && msgid != MAVLINK_MSG_ID_CAMERA_INFORMATION) {
        acknowledge_as(camera_to_ground_, asked.command, MAV_RESULT_UNSUPPORTED, asked.by);
        return;
    }
    if (of_stream && stream != 0.0F && stream != static_cast<float>(kStream)) {   // 0: all of them
        acknowledge_as(camera_to_ground_, asked.command, MAV_RESULT_DENIED, asked.by);
        return;
    }
    acknowledge_as(camera_to_ground_, asked.command, MAV_RESULT_ACCEPTED, asked.by);
    send_about_camera(msgid);
}

void Bridge::send_about_camera(const std::uint32_t msgid) {
    const auto running = static_cast<std::uint16_t>(video_.running != 0 ? VIDEO_STREAM_STATUS_FLAGS_RUNNING : 0);
    const auto width_px = static_cast<std::uint16_t>(video_.width_px);
    const auto height_px = static_cast<std::uint16_t>(video_.height_px);
    const auto bit_rate = static_cast<std::uint32_t>(std::max(video_.bit_rate, std::int32_t{0}));
    if (msgid == MAVLINK_MSG_ID_CAMERA_INFORMATION) {
        mavlink_camera_information_t out{};
        out.time_boot_ms = static_cast<std::uint32_t>(std::max<std::int64_t>(now_us_, 0) / 1000);
        out.focal_length = out.sensor_size_h = out.sensor_size_v = std::numeric_limits<float>::quiet_NaN();
        out.flags = CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM;
        out.resolution_h = width_px;
        out.resolution_v = height_px;
        std::memcpy(out.vendor_name, kVendor, sizeof kVendor);
        std::memcpy(out.model_name, kModel, sizeof kModel);
        sink_.to_ground(camera_to_ground_.pack(mavlink_msg_camera_information_encode_status, out));
    } else if (msgid == MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION) {
        mavlink_video_stream_information_t out{};
        out.stream_id = out.count = kStream;
        out.type = VIDEO_STREAM_TYPE_RTPUDP;
        out.encoding = VIDEO_STREAM_ENCODING_H264;
        out.flags = running;
        out.framerate = video_.rate_hz;
        out.resolution_h = width_px;
        out.resolution_v = height_px;
        out.bitrate = bit_rate;
        std::memcpy(out.name, kModel, sizeof kModel);
        std::snprintf(out.uri, sizeof out.uri, "%d", static_cast<int>(video_.port));
        sink_.to_ground(camera_to_ground_.pack(mavlink_msg_video_stream_information_encode_status, out));
    } else {
        mavlink_video_stream_status_t out{};
        out.stream_id = kStream;
        out.flags = running;
        out.framerate = video_.rate_hz;
        out.resolution_h = width_px;
        out.resolution_v = height_px;
        out.bitrate = bit_rate;
        sink_.to_ground(camera_to_ground_.pack(mavlink_msg_video_stream_status_encode_status, out));
    }
}

}  // namespace noctule
