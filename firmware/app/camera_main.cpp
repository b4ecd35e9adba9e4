/// noctule-camera: a camera on the camera's bus. Publishes what the simulator publishes on IMAGE, on the autopilot's clock.
///
/// That clock comes from the stamps of IMU on the flight's bus (drivers/sensor_clock.hpp). Without IMU no image is published.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <thread>

#include <CLI/CLI.hpp>

#include "app/parameter_file.hpp"
#include "app/realtime.hpp"
#include "app/signals.hpp"
#include "drivers/camera_source.hpp"
#include "drivers/sensor_clock.hpp"
#include "lcmtypes/noctule/image_t.hpp"
#include "lcmtypes/noctule/imu_t.hpp"
#include "link/lcm_bus.hpp"
#include "streams.gen.hpp"

namespace {

constexpr int kWidth = 320;
constexpr int kHeight = 240;
static_assert(kWidth * kHeight * 3 == noctule::image_t::MAX_BYTES);
constexpr std::int64_t kSayAgain_us = 10000000;

std::int64_t monotonic_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// The camera's bus: an image is over what LcmBus sends, and this process may allocate.
class ImageBus {
public:
    ImageBus() = default;
    ImageBus(const ImageBus&) = delete;
    ImageBus& operator=(const ImageBus&) = delete;
    ~ImageBus() {
        if (lcm_ != nullptr) { lcm_destroy(lcm_); }
    }
    [[nodiscard]] bool open(const char* url) {
        lcm_ = lcm_create(url);
        return lcm_ != nullptr;
    }
    void publish(const noctule::image_t& message) {
        const int size = message.encode(bytes_.data(), 0, static_cast<int>(bytes_.size()));
        if (size > 0) { lcm_publish(lcm_, noctule::kChannelImage, bytes_.data(), static_cast<unsigned int>(size)); }
    }

private:
    lcm_t* lcm_ = nullptr;
    std::array<std::uint8_t, noctule::image_t::MAX_BYTES + 64> bytes_{};
};

struct Counters {
    unsigned published = 0;
    unsigned without_clock = 0;
    unsigned opened = 0;
};

noctule::Parameters parameters;
noctule::image_t message{};
ImageBus images;

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-camera: a V4L2 camera, a video or numbered pictures on the camera's bus."};
    std::string parameter_path;
    std::string device = "/dev/video0";
    std::string url = "udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2097152";
    std::string camera_url = "udpm://239.255.76.67:7668?ttl=0&recv_buf_size=2097152";
    std::string stats_path;
    double rate_hz = 5.0;
    options.add_option("--parameters", parameter_path, "TOML file with `name = value` lines; defaults hold for what is not named");
    options.add_option("--device", device, "/dev/videoN, a video file, or numbered pictures like p/%03d.png")->capture_default_str();
    options.add_option("--lcm-url", url, "LCM bus of the flight, for the autopilot's clock")->capture_default_str();
    options.add_option("--camera-lcm-url", camera_url, "LCM bus of the camera")->capture_default_str();
    options.add_option("--rate", rate_hz, "images a second")->check(CLI::Range(0.1, 60.0))->capture_default_str();
    options.add_option("--stats", stats_path, "write counters to this JSON file at the end");
    CLI11_PARSE(options, argc, argv);

    std::array<char, 512> error{};
    if (!parameter_path.empty() && !noctule::load_parameters(parameter_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-camera: %s\n", error.data());
        return 2;
    }
    static noctule::LcmBus bus;
    if (!bus.open(url.c_str()) || !images.open(camera_url.c_str())) {
        std::fprintf(stderr, "noctule-camera: %s\n", bus.is_open() ? camera_url.c_str() : bus.error());
        return 2;
    }
    noctule::install_stop_signals();
    noctule::SensorClock autopilot;
    auto on_imu = [&](const noctule::imu_t& sample) { autopilot.add(sample.t_us, monotonic_us()); };
    if (!bus.subscribe<noctule::imu_t>(noctule::kChannelImu, on_imu)) {
        std::fprintf(stderr, "noctule-camera: cannot subscribe on %s\n", url.c_str());
        return 1;
    }

    noctule::CameraSource source(device, kWidth, kHeight);
    noctule::Watchdog watchdog;
    watchdog.ready();
    Counters counters;
    cv::Mat image;
    cv::Mat small;
    const auto period_us = static_cast<std::int64_t>(1e6 / rate_hz);
    std::int64_t next_us = monotonic_us();
    std::int64_t next_say_us = 0;
    std::int64_t last_us = 0;
    const auto say = [&](const char* what) {
        if (monotonic_us() < next_say_us) { return; }
        next_say_us = monotonic_us() + kSayAgain_us;
        std::fprintf(stderr, "noctule-camera: %s: %s\n", device.c_str(), what);
    };
    while (!noctule::stop_requested()) {
        watchdog.alive(monotonic_us());
        if (bus.handle(source.is_open() ? 0 : 50) < 0) {
            if (noctule::stop_requested()) { break; }
            std::fprintf(stderr, "noctule-camera: the LCM bus failed\n");
            return 1;
        }
        if (source.keep(monotonic_us())) {
            ++counters.opened;
            next_say_us = 0;
            std::fprintf(stderr, "noctule-camera: %s: open\n", device.c_str());
        }
        if (!source.is_open()) {
            say("no camera; trying again every second");
            continue;
        }
        if (!source.is_camera()) {  // a file gives its pictures at once
            const std::int64_t wait_us = next_us - monotonic_us();
            if (wait_us > 0) {
                std::this_thread::sleep_for(std::chrono::microseconds(std::min<std::int64_t>(wait_us, 20000)));
                if (wait_us > 20000) { continue; }
            }
        }
        if (!source.grab()) {
            say("gives no picture; trying again every second");
            continue;
        }
        static_cast<void>(bus.handle(0));
        const std::int64_t now_us = monotonic_us();
        const std::int64_t taken_us = source.taken_us(now_us);
        if (taken_us < next_us - period_us / 10) { continue; }  // a camera is read at its own rate
        next_us = std::max(next_us + period_us, taken_us + period_us / 2);
        if (!source.read(image)) { continue; }
        if (!autopilot.valid(now_us)) {
            ++counters.without_clock;
            say("no IMU on the flight's bus: images cannot be stamped; is noctule-bridge running?");
            continue;
        }
        noctule::fit(image, kWidth, kHeight, small);
        message.t_us = autopilot.from_host_us(taken_us) + std::lround(parameters.camera_stamp_offset_s * 1e6F);
        if (message.t_us <= last_us && message.t_us > last_us - 1000000) { continue; }
        last_us = message.t_us;
        message.seq = static_cast<std::int32_t>(counters.published++);
        message.width = kWidth;
        message.height = kHeight;
        std::memcpy(message.bgr, small.ptr(), sizeof message.bgr);
        images.publish(message);
    }
    watchdog.stopping();
    if (!stats_path.empty()) {
        if (std::FILE* file = std::fopen(stats_path.c_str(), "w"); file != nullptr) {
            std::fprintf(file, "{\"published\": %u, \"without_clock\": %u, \"opened\": %u}\n", counters.published, counters.without_clock, counters.opened);
            std::fclose(file);
        }
    }
    return 0;
}
