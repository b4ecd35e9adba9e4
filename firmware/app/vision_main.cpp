/// noctule-vision: objects in the camera's frames. Reads IMAGE on the camera bus, answers each frame with OBJECTS.
/// A process of its own because OpenCV allocates and a slow frame here must never delay flight.
#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>

#include "app/parameter_file.hpp"
#include "app/signals.hpp"
#include "lcmtypes/noctule/image_t.hpp"
#include "lcmtypes/noctule/objects_t.hpp"
#include "link/lcm_bus.hpp"
#include "recognise/recogniser.hpp"
#include "streams.gen.hpp"

namespace {

using noctule::image_t;
using noctule::LcmBus;
using noctule::objects_t;
using noctule::Recogniser;

constexpr std::int64_t kSilenceFirst_us = 3000000;   // before a missing camera is named
constexpr std::int64_t kSilenceAgain_us = 10000000;
constexpr int kPoll_ms = 50;

static_assert(noctule::kMaxRegions == static_cast<std::size_t>(objects_t::MAX_REGIONS));

std::int64_t monotonic_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// What one frame is answered with. sightings null: the frame was not looked at.
objects_t answer_to(const image_t& image, const std::int32_t seq, const Recogniser::Sightings* const sightings) {
    objects_t out{};
    out.t_us = image.t_us;
    out.seq = seq;
    out.image_seq = image.seq;
    if (sightings == nullptr) { return out; }
    for (const noctule::Sighting& sighting : *sightings) {
        out.u_px[out.count] = static_cast<std::int32_t>(sighting.region.x_px + 0.5F);
        out.v_px[out.count] = static_cast<std::int32_t>(sighting.region.y_px + 0.5F);
        out.area_px[out.count] = sighting.region.area_px;
        out.object_id[out.count] = sighting.object_id;
        ++out.count;
    }
    return out;
}

/// The frames that wait, newest last: when the process is late only the newest is looked at, the older ones get an empty answer.
struct Inbox {
    image_t newest{};
    bool waiting = false;
    std::int64_t heard_us = 0;
    std::uint64_t received = 0;
    std::uint64_t dropped = 0;
    std::int32_t answers = 0;
    LcmBus* bus = nullptr;

    void operator()(const image_t& image) {
        heard_us = monotonic_us();
        ++received;
        if (waiting) {
            ++dropped;
            bus->publish(noctule::kChannelObjects, answer_to(newest, answers++, nullptr));
        }
        newest = image;
        waiting = true;
    }
};

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-vision: finds objects in the frames of the camera."};
    std::string parameter_path;
    std::string url = "udpm://239.255.76.67:7668?ttl=0&recv_buf_size=2097152";
    std::string stats_path;
    options.add_option("--parameters", parameter_path, "TOML file with `name = value` lines; defaults hold for what is not named");
    options.add_option("--lcm-url", url, "LCM bus of the camera")->capture_default_str();
    options.add_option("--stats", stats_path, "write frame counts and times to this JSON file at the end");
    CLI11_PARSE(options, argc, argv);

    static noctule::Parameters parameters;
    std::array<char, 512> error{};
    if (!parameter_path.empty() && !noctule::load_parameters(parameter_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-vision: %s\n", error.data());
        return 2;
    }
    static LcmBus bus;
    if (!bus.open(url.c_str())) {
        std::fprintf(stderr, "noctule-vision: %s\n", bus.error());
        return 2;
    }
    static Inbox inbox;
    inbox.bus = &bus;
    inbox.heard_us = monotonic_us();
    if (!bus.subscribe<image_t>(noctule::kChannelImage, inbox)) {
        std::fprintf(stderr, "noctule-vision: cannot subscribe to %s\n", noctule::kChannelImage);
        return 2;
    }
    noctule::install_stop_signals();

    const auto recogniser = std::make_unique<Recogniser>(parameters);
    std::int64_t next_complaint_us = 0;
    std::int64_t busy_us = 0;
    std::int64_t longest_us = 0;
    int status = 0;
    while (!noctule::stop_requested()) {
        if (bus.handle(kPoll_ms) < 0) {
            if (noctule::stop_requested()) { break; }
            std::fprintf(stderr, "noctule-vision: the LCM bus failed\n");
            status = 1;
            break;
        }
        if (inbox.waiting) {
            const std::int64_t start_us = monotonic_us();
            const image_t& image = inbox.newest;
            const auto& sightings = recogniser->process(image.bgr, sizeof image.bgr, image.width, image.height);
            bus.publish(noctule::kChannelObjects, answer_to(image, inbox.answers++, &sightings));
            inbox.waiting = false;
            const std::int64_t took_us = monotonic_us() - start_us;
            busy_us += took_us;
            longest_us = took_us > longest_us ? took_us : longest_us;
        }
        const std::int64_t now_us = monotonic_us();
        if (now_us - inbox.heard_us >= kSilenceFirst_us && now_us >= next_complaint_us) {
            std::fprintf(stderr, "noctule-vision: no frame on the camera bus for %lld s: is the camera (or the simulator with its camera on) running on the same --lcm-url?\n",
                         static_cast<long long>((now_us - inbox.heard_us) / 1000000));
            next_complaint_us = now_us + kSilenceAgain_us;
        }
    }
    if (!stats_path.empty()) {
        std::FILE* const file = std::fopen(stats_path.c_str(), "w");
        if (file == nullptr) {
            std::fprintf(stderr, "noctule-vision: cannot write %s\n", stats_path.c_str());
            return 1;
        }
        const noctule::RecogniserCounters& c = recogniser->counters();
        const double frames = c.frames > 0 ? static_cast<double>(c.frames) : 1.0;
        std::fprintf(file, "{\"frames\": %u, \"dropped\": %llu, \"refused\": %u, \"frame_us\": {\"mean\": %.1f, \"max\": %lld}}\n",
                     c.frames, static_cast<unsigned long long>(inbox.dropped), c.refused_frames,
                     static_cast<double>(busy_us) / frames, static_cast<long long>(longest_us));
        std::fclose(file);
    }
    return status;
}
