/// noctule-video: the camera's frames to ground stations, as H.264 by RTP. Reads IMAGE on the camera bus, tells noctule-bridge of the stream on VIDEO.
/// A process of its own, and GStreamer one beside it: no frame that is late or lost here has a part in the flight.
#include <poll.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "app/signals.hpp"
#include "app/video_encoder.hpp"
#include "lcmtypes/noctule/image_t.hpp"
#include "lcmtypes/noctule/video_t.hpp"
#include "link/lcm_bus.hpp"
#include "streams.gen.hpp"

namespace {

constexpr int kNoGStreamer = 77;                     // as of a skipped flight
constexpr std::int64_t kTell_us = 1000000;
constexpr std::int64_t kStill_us = 2000000;          // without a frame for longer nothing is running
constexpr std::int64_t kAgain_us = 3000000;          // after the encoder ended
constexpr int kPoll_ms = 20;

std::int64_t monotonic_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

struct Counters {
    unsigned frames = 0;
    unsigned sent = 0;
    unsigned dropped = 0;
    unsigned starts = 0;
};

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-video: the front camera to ground stations, H.264 by RTP. Wants GStreamer's programs; without them it says so and ends with 77."};
    std::string url = "udpm://239.255.76.67:7668?ttl=0&recv_buf_size=2097152";
    std::string stats_path;
    std::string encoder_words;
    noctule::VideoEncoder::Settings settings;
    settings.hosts = {"127.0.0.1"};
    settings.port = 5600;
    settings.width_px = 320;
    settings.height_px = 240;
    int rate_kbit_s = 400;
    options.add_option("--lcm-url", url, "LCM bus of the camera")->capture_default_str();
    options.add_option("--to", settings.hosts, "ground station's host or address; may be given several times")->capture_default_str();
    options.add_option("--port", settings.port, "UDP port there (QGroundControl: 5600)")->check(CLI::Range(1, 65535))->capture_default_str();
    options.add_option("--kbit", rate_kbit_s, "kilobits a second at most")->check(CLI::Range(50, 20000))->capture_default_str();
    options.add_option("--encoder", encoder_words, "another encoder in gst-launch's words, for instance one of the board's (default: x264enc)");
    options.add_option("--stats", stats_path, "write counters to this JSON file at the end");
    CLI11_PARSE(options, argc, argv);
    for (const std::string& host : settings.hosts) {
        if (host.empty() || host.find_first_of(", \t!") != std::string::npos) {
            std::fprintf(stderr, "noctule-video: --to '%s' is no host\n", host.c_str());
            return 2;
        }
    }
    settings.element = encoder_words.empty() ? "x264enc tune=zerolatency speed-preset=ultrafast key-int-max=10 bitrate=" + std::to_string(rate_kbit_s) + " ! video/x-h264,profile=baseline" : encoder_words;
    noctule::VideoEncoder encoder(settings);
    if (const std::string missing = encoder.missing(); !missing.empty()) {
        std::fprintf(stderr, "noctule-video: no video, GStreamer's %s is not installed: apt-get install gstreamer1.0-tools gstreamer1.0-plugins-base gstreamer1.0-plugins-good gstreamer1.0-plugins-ugly\n",
                     missing.c_str());
        return kNoGStreamer;
    }
    static noctule::LcmBus bus;
    if (!bus.open(url.c_str())) {
        std::fprintf(stderr, "noctule-video: %s\n", bus.error());
        return 2;
    }
    Counters counters;
    noctule::video_t told{};
    told.port = settings.port;
    told.width_px = settings.width_px;
    told.height_px = settings.height_px;
    told.bit_rate = 1000 * rate_kbit_s;
    std::int64_t taken_us = -kStill_us;
    unsigned sent_before = 0;
    auto on_image = [&](const noctule::image_t& image) {
        ++counters.frames;
        const bool fits = image.width == settings.width_px && image.height == settings.height_px;
        if (!fits || !encoder.put({image.bgr, sizeof image.bgr})) {
            ++counters.dropped;
            return;
        }
        ++counters.sent;
        told.t_us = image.t_us;
        taken_us = monotonic_us();
    };
    if (!bus.subscribe<noctule::image_t>(noctule::kChannelImage, on_image)) {
        std::fprintf(stderr, "noctule-video: cannot subscribe on %s\n", url.c_str());
        return 2;
    }
    noctule::install_stop_signals();
    std::int64_t next_start_us = 0;
    std::int64_t next_tell_us = 0;
    int status = 0;
    while (!noctule::stop_requested()) {
        std::array<pollfd, 2> waits{pollfd{bus.fd(), POLLIN, 0}, pollfd{encoder.busy() ? encoder.fd() : -1, POLLOUT, 0}};
        static_cast<void>(poll(waits.data(), waits.size(), kPoll_ms));
        if (bus.handle(0) < 0) {
            if (noctule::stop_requested()) { break; }
            std::fprintf(stderr, "noctule-video: the LCM bus failed\n");
            status = 1;
            break;
        }
        encoder.tend();
        const std::int64_t now_us = monotonic_us();
        const bool running = encoder.running();
        if (!running && now_us >= next_start_us) {
            next_start_us = now_us + kAgain_us;
            if (counters.starts++ > 0) { std::fprintf(stderr, "noctule-video: the encoder has ended; once more\n"); }
            if (!encoder.start()) { std::perror("noctule-video: gst-launch-1.0"); }
        }
        if (now_us >= next_tell_us) {
            next_tell_us = now_us + kTell_us;
            told.running = running && now_us - taken_us < kStill_us ? 1 : 0;
            told.rate_hz = static_cast<float>(counters.sent - sent_before) * 1e6F / static_cast<float>(kTell_us);
            sent_before = counters.sent;
            bus.publish(noctule::kChannelVideo, told);
            ++told.seq;
        }
    }
    encoder.stop();
    if (!stats_path.empty()) {
        if (std::FILE* file = std::fopen(stats_path.c_str(), "w"); file != nullptr) {
            std::fprintf(file, "{\"frames\": %u, \"sent\": %u, \"dropped\": %u, \"starts\": %u}\n", counters.frames, counters.sent, counters.dropped, counters.starts);
            std::fclose(file);
        }
    }
    return status;
}
