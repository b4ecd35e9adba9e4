// The front camera as ground stations find it: heartbeat, camera, stream, as QGroundControl and MAVSDK ask; gone when noctule-video is.
#include <unity.h>

#include <string>

#include "unit/link/bridge_scene.hpp"

using namespace noctule;
using scene::Scene;

namespace {

constexpr std::int64_t kSecond_us = 1000000;

/// A scene with a clock and a noctule-video that speaks once a second.
struct FrontCamera {
    Scene scene;
    video_t video{};
    std::int64_t wall_us = 5 * kSecond_us;

    FrontCamera() {
        video.running = 1;
        video.port = 5600;
        video.width_px = 320;
        video.height_px = 240;
        video.rate_hz = 5.0F;
        video.bit_rate = 400000;
        scene.bridge.set_clock(wall_us);
        scene.run(1.0);
    }

    void pass(const bool told) {
        wall_us += kSecond_us;
        scene.bridge.set_clock(wall_us);
        if (told) { scene.bridge.on_video(video); }
    }

    void ask(const std::uint16_t command, const float param1, const float param2 = 0.0F) {
        mavlink_command_long_t c{};
        c.target_system = scene::kSystem;
        c.target_component = MAV_COMP_ID_CAMERA;
        c.command = command;
        c.param1 = param1;
        c.param2 = param2;
        scene.from_ground(mavlink_msg_command_long_encode_status, c);
    }

    /// Messages of one kind that the ground station got from the camera.
    [[nodiscard]] std::vector<mavlink_message_t> from_camera(const std::uint32_t msgid) const {
        std::vector<mavlink_message_t> found;
        for (const mavlink_message_t& m : scene.out.ground) {
            if (m.msgid == msgid && m.compid == MAV_COMP_ID_CAMERA && m.sysid == scene::kSystem) { found.push_back(m); }
        }
        return found;
    }
};

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void a_camera_beats_while_the_video_lives() {
    static FrontCamera c;
    TEST_ASSERT_EQUAL(0, c.from_camera(MAVLINK_MSG_ID_HEARTBEAT).size());
    for (int i = 0; i < 3; ++i) { c.pass(true); }
    const auto beats = c.from_camera(MAVLINK_MSG_ID_HEARTBEAT);
    TEST_ASSERT_EQUAL(3, beats.size());
    mavlink_heartbeat_t beat{};
    mavlink_msg_heartbeat_decode(&beats.back(), &beat);
    TEST_ASSERT_EQUAL(MAV_TYPE_CAMERA, beat.type);
    TEST_ASSERT_EQUAL(MAV_AUTOPILOT_INVALID, beat.autopilot);
    TEST_ASSERT_TRUE(c.scene.said("UDP port 5600"));
}

static void the_stream_is_told_in_the_new_way_and_the_old() {
    static FrontCamera c;
    c.pass(true);
    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_CAMERA_INFORMATION);
    c.ask(MAV_CMD_REQUEST_CAMERA_INFORMATION, 1.0F);
    const auto cameras = c.from_camera(MAVLINK_MSG_ID_CAMERA_INFORMATION);
    TEST_ASSERT_EQUAL(2, cameras.size());
    mavlink_camera_information_t camera{};
    mavlink_msg_camera_information_decode(&cameras[0], &camera);
    TEST_ASSERT_EQUAL_UINT32(CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM, camera.flags);
    TEST_ASSERT_EQUAL_STRING("front camera", reinterpret_cast<const char*>(camera.model_name));
    TEST_ASSERT_EQUAL_UINT16(320, camera.resolution_h);
    TEST_ASSERT_EQUAL_CHAR('\0', camera.cam_definition_uri[0]);

    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION, 1.0F);
    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION, 0.0F);
    c.ask(MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION, 0.0F);
    const auto streams = c.from_camera(MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION);
    TEST_ASSERT_EQUAL(3, streams.size());
    mavlink_video_stream_information_t stream{};
    mavlink_msg_video_stream_information_decode(&streams[0], &stream);
    TEST_ASSERT_EQUAL_UINT8(1, stream.stream_id);
    TEST_ASSERT_EQUAL_UINT8(1, stream.count);
    TEST_ASSERT_EQUAL_UINT8(VIDEO_STREAM_TYPE_RTPUDP, stream.type);
    TEST_ASSERT_EQUAL_UINT8(VIDEO_STREAM_ENCODING_H264, stream.encoding);
    TEST_ASSERT_EQUAL_UINT16(VIDEO_STREAM_STATUS_FLAGS_RUNNING, stream.flags);
    TEST_ASSERT_EQUAL_STRING("5600", stream.uri);
    TEST_ASSERT_EQUAL_FLOAT(5.0F, stream.framerate);
    TEST_ASSERT_EQUAL_UINT32(400000, stream.bitrate);
    TEST_ASSERT_EQUAL_UINT16(240, stream.resolution_v);

    c.video.running = 0;                                    // the encoder has ended
    c.pass(true);
    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_VIDEO_STREAM_STATUS, 1.0F);
    c.ask(MAV_CMD_REQUEST_VIDEO_STREAM_STATUS, 1.0F);
    const auto states = c.from_camera(MAVLINK_MSG_ID_VIDEO_STREAM_STATUS);
    TEST_ASSERT_EQUAL(2, states.size());
    mavlink_video_stream_status_t state{};
    mavlink_msg_video_stream_status_decode(&states[0], &state);
    TEST_ASSERT_EQUAL_UINT16(0, state.flags);
    for (const int result : c.scene.results(MAV_CMD_REQUEST_MESSAGE)) { TEST_ASSERT_EQUAL(MAV_RESULT_ACCEPTED, result); }
}

static void what_the_camera_has_not_is_refused_and_stays_with_it() {
    static FrontCamera c;
    c.pass(true);
    const std::size_t passed = Scene::count(c.scene.out.autopilot, MAVLINK_MSG_ID_COMMAND_LONG);
    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION, 2.0F);
    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_STORAGE_INFORMATION);
    c.ask(MAV_CMD_REQUEST_MESSAGE, -1.0F);
    c.ask(MAV_CMD_IMAGE_START_CAPTURE, 0.0F);
    const std::vector<int> results = c.scene.results(MAV_CMD_REQUEST_MESSAGE);
    TEST_ASSERT_EQUAL(3, results.size());
    TEST_ASSERT_EQUAL(MAV_RESULT_DENIED, results[0]);
    TEST_ASSERT_EQUAL(MAV_RESULT_UNSUPPORTED, results[1]);
    TEST_ASSERT_EQUAL(MAV_RESULT_UNSUPPORTED, results[2]);
    TEST_ASSERT_EQUAL(MAV_RESULT_UNSUPPORTED, c.scene.results(MAV_CMD_IMAGE_START_CAPTURE).back());
    TEST_ASSERT_EQUAL(0, c.from_camera(MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION).size());
    TEST_ASSERT_EQUAL(passed, Scene::count(c.scene.out.autopilot, MAVLINK_MSG_ID_COMMAND_LONG));
    TEST_ASSERT_EQUAL(0, c.scene.results(MAV_CMD_MISSION_START).size());
    c.ask(MAV_CMD_MISSION_START, 0.0F);                     // the camera starts no mission
    TEST_ASSERT_EQUAL(MAV_RESULT_UNSUPPORTED, c.scene.results(MAV_CMD_MISSION_START).back());
    TEST_ASSERT_FALSE(c.scene.ordered(command_t::START));
}

static void without_a_video_there_is_no_camera_of_ours() {
    static FrontCamera c;
    c.video.port = 0;                                       // nonsense is not believed
    c.pass(true);
    c.video.port = 5600;
    c.video.width_px = -320;
    c.pass(true);
    TEST_ASSERT_EQUAL(0, c.from_camera(MAVLINK_MSG_ID_HEARTBEAT).size());
    const std::size_t before = Scene::count(c.scene.out.autopilot, MAVLINK_MSG_ID_COMMAND_LONG);
    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_CAMERA_INFORMATION);   // another camera's matter: on to the vehicle
    TEST_ASSERT_EQUAL(before + 1, Scene::count(c.scene.out.autopilot, MAVLINK_MSG_ID_COMMAND_LONG));
    c.video.width_px = 320;
    c.pass(true);
    for (int i = 0; i < 4; ++i) { c.pass(false); }          // noctule-video has ended
    c.ask(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_CAMERA_INFORMATION);
    TEST_ASSERT_EQUAL(0, c.from_camera(MAVLINK_MSG_ID_CAMERA_INFORMATION).size());
    TEST_ASSERT_EQUAL(1, c.from_camera(MAVLINK_MSG_ID_HEARTBEAT).size());
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_camera_beats_while_the_video_lives);
    RUN_TEST(the_stream_is_told_in_the_new_way_and_the_old);
    RUN_TEST(what_the_camera_has_not_is_refused_and_stays_with_it);
    RUN_TEST(without_a_video_there_is_no_camera_of_ours);
    return UNITY_END();
}
