/// noctule-vision: objects in the camera's frames. Reads IMAGE on the camera bus, answers each frame with OBJECTS, and keeps the objects in a database.
/// The pose and the laser come from the flight bus (NAV, SCAN); nothing is ever sent there.
/// A process of its own because OpenCV and SQLite allocate and a slow frame here must never delay flight.
#include <malloc.h>
#include <poll.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>

#include "app/parameter_file.hpp"
#include "app/signals.hpp"
#include "app/vision_node.hpp"
#include "link/lcm_bus.hpp"
#include "streams.gen.hpp"

namespace {

using noctule::image_t;
using noctule::LcmBus;
using noctule::nav_t;
using noctule::objects_t;
using noctule::scan_t;
using noctule::VisionNode;

constexpr std::int64_t kSilenceFirst_us = 3000000;   // before a missing camera is named
constexpr std::int64_t kSilenceAgain_us = 10000000;
constexpr std::int64_t kPoseWait_us = 100000;        // wall time that a frame waits for its pose at most
constexpr std::uint32_t kWarm = 50;                  // frames after which the heap should have its size
constexpr int kPoll_ms = 50;

std::int64_t monotonic_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::string date_now() {
    const std::time_t now = std::time(nullptr);
    std::tm utc{};
    gmtime_r(&now, &utc);
    std::array<char, 32> text{};
    std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &utc);
    return text.data();
}

/// Takes in what both buses bring.
struct Inbox {
    VisionNode& node;
    LcmBus& camera;
    std::int64_t heard_us = monotonic_us();

    void operator()(const image_t& image) {
        heard_us = monotonic_us();
        objects_t given_way{};
        if (node.receive(image, given_way)) { camera.publish(noctule::kChannelObjects, given_way); }
    }
    void operator()(const nav_t& nav) { node.receive(nav); }
    void operator()(const scan_t& scan) { node.receive(scan); }
};

struct Times {
    std::int64_t busy_us = 0;
    std::int64_t longest_us = 0;
    std::size_t heap_warm = 0;      ///< bytes in use after kWarm frames
    std::size_t heap_end = 0;
};

bool write_stats(const std::string& path, VisionNode& node, const Times& times) {
    std::FILE* const file = std::fopen(path.c_str(), "w");
    if (file == nullptr) {
        std::fprintf(stderr, "noctule-vision: cannot write %s\n", path.c_str());
        return false;
    }
    const noctule::RecogniserCounters& c = node.recogniser().counters();
    const noctule::MemoryCounters& m = node.recogniser().memory().counters();
    const noctule::StoreCounters& s = node.recogniser().store().counters();
    std::fprintf(file,
                 "{\"frames\": %u, \"dropped\": %llu, \"refused\": %u, \"without_pose\": %u, \"frame_us\": {\"mean\": %.1f, \"max\": %lld}, "
                 "\"objects\": %d, \"observations\": %u, \"without_place\": %u, \"matched\": %u, \"verified\": %u, \"outliers\": %u, \"created\": %u, "
                 "\"merged\": %u, \"candidates_dropped\": %u, \"no_room\": %u, \"reunited\": %u, \"commits\": %u, \"commits_failed\": %u, "
                 "\"heap_bytes\": {\"warm\": %zu, \"end\": %zu}}\n",
                 c.frames, static_cast<unsigned long long>(node.dropped()), c.refused_frames, c.without_pose,
                 static_cast<double>(times.busy_us) / (c.frames > 0 ? static_cast<double>(c.frames) : 1.0), static_cast<long long>(times.longest_us),
                 node.recogniser().memory().confirmed(), m.observations, m.without_place, m.matched, m.verified, m.outliers, m.created, m.merged,
                 m.dropped, m.refused, m.reunited, s.commits, s.failed, times.heap_warm, times.heap_end);
    std::fclose(file);
    return true;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-vision: finds objects in the frames of the camera, knows them again and keeps them in a database."};
    std::string parameter_path;
    std::string url = "udpm://239.255.76.67:7668?ttl=0&recv_buf_size=2097152";
    std::string flight_url;
    std::string stats_path;
    std::string calibration_path;
    std::string database_path;
    bool resume = false;
    options.add_option("--parameters", parameter_path, "TOML file with `name = value` lines; defaults hold for what is not named");
    options.add_option("--lcm-url", url, "LCM bus of the camera")->capture_default_str();
    options.add_option("--flight-lcm-url", flight_url, "LCM bus of NAV and SCAN; without it regions are found, but no object is placed or kept");
    options.add_option("--calibration", calibration_path, "camera calibration, OpenCV's YAML or XML (default: the simulator's camera)");
    options.add_option("--database", database_path, "SQLite file of the objects, made if absent (default: kept in memory alone)");
    options.add_flag("--resume", resume, "the flight goes on after a restart of this process: the places in the database hold");
    options.add_option("--stats", stats_path, "write frame counts and times to this JSON file at the end");
    CLI11_PARSE(options, argc, argv);

    static noctule::Parameters parameters;
    std::array<char, 512> error{};
    if (!parameter_path.empty() && !noctule::load_parameters(parameter_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-vision: %s\n", error.data());
        return 2;
    }
    const auto node = std::make_unique<VisionNode>(parameters);
    noctule::Recogniser& recogniser = node->recogniser();
    std::string problem;
    if (!calibration_path.empty() && !noctule::load_camera(calibration_path, recogniser.camera(), problem)) {
        std::fprintf(stderr, "noctule-vision: %s\n", problem.c_str());
        return 2;
    }
    if (!database_path.empty() &&
        !(recogniser.store().open(database_path, date_now()) && recogniser.store().load(recogniser.memory(), resume))) {
        std::fprintf(stderr, "noctule-vision: %s\n", recogniser.store().error().c_str());
        return 2;
    }
    static LcmBus camera;
    static LcmBus flight;
    if (!camera.open(url.c_str()) || (!flight_url.empty() && !flight.open(flight_url.c_str()))) {
        std::fprintf(stderr, "noctule-vision: %s\n", camera.is_open() ? flight.error() : camera.error());
        return 2;
    }
    Inbox inbox{*node, camera};
    bool listening = camera.subscribe<image_t>(noctule::kChannelImage, inbox);
    if (!flight_url.empty()) {
        listening = listening && flight.subscribe<scan_t>(noctule::kChannelScan, inbox) && flight.subscribe<nav_t>(noctule::kChannelNav, inbox);
    }
    if (!listening) {
        std::fprintf(stderr, "noctule-vision: cannot subscribe\n");
        return 2;
    }
    noctule::install_stop_signals();

    Times times;
    std::int64_t next_complaint_us = 0;
    std::int64_t waiting_since_us = 0;
    int status = 0;
    while (!noctule::stop_requested()) {
        std::array<pollfd, 2> sources{pollfd{camera.fd(), POLLIN, 0}, pollfd{flight.fd(), POLLIN, 0}};
        if (flight.is_open()) {
            static_cast<void>(poll(sources.data(), sources.size(), node->waiting() ? 5 : kPoll_ms));
            if (flight.handle(0) < 0) { status = 1; }
        }
        if (camera.handle(flight.is_open() ? 0 : kPoll_ms) < 0) { status = 1; }
        if (status != 0) {
            if (noctule::stop_requested()) {
                status = 0;
                break;
            }
            std::fprintf(stderr, "noctule-vision: the LCM bus failed\n");
            break;
        }
        const std::int64_t now_us = monotonic_us();
        if (!node->waiting()) { waiting_since_us = now_us; }
        if (node->waiting() && (node->ready() || !flight.is_open() || now_us - waiting_since_us > kPoseWait_us)) {
            camera.publish(noctule::kChannelObjects, node->look());
            const std::int64_t took_us = monotonic_us() - now_us;
            times.busy_us += took_us;
            times.longest_us = took_us > times.longest_us ? took_us : times.longest_us;
            if (recogniser.counters().frames == kWarm) { times.heap_warm = mallinfo2().uordblks; }
        }
        if (now_us - inbox.heard_us >= kSilenceFirst_us && now_us >= next_complaint_us) {
            std::fprintf(stderr, "noctule-vision: no frame on the camera bus for %lld s: is the camera (or the simulator with its camera on) running on the same --lcm-url?\n",
                         static_cast<long long>((now_us - inbox.heard_us) / 1000000));
            next_complaint_us = now_us + kSilenceAgain_us;
        }
    }
    times.heap_end = mallinfo2().uordblks;
    recogniser.store().close();
    if (!stats_path.empty() && !write_stats(stats_path, *node, times)) { return 1; }
    return status;
}
