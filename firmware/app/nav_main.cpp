/// noctule-nav: the autonomy. One Navigator::step per scan; reads SCAN, IMU, ATTITUDE, RANGE_*, VEHICLE, COMMAND, POLICY_GOAL from
/// the bus and publishes what the step returned. All storage is static; nothing is allocated after start-up.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>

#include <CLI/CLI.hpp>
#include <poll.h>
#include <sys/resource.h>

#include "app/atlas_contents.hpp"
#include "app/atlas_objects.hpp"
#include "app/atlas_writer.hpp"
#include "app/heap_start.hpp"
#include "app/parameter_file.hpp"
#include "app/realtime.hpp"
#include "app/signals.hpp"
#include "link/lcm_bus.hpp"
#include "link/nav_node.hpp"
#include "streams.gen.hpp"

namespace {

using noctule::LcmBus;
using noctule::NavNode;

constexpr std::int64_t kNanosecondsPerMillisecond = 1000000;
constexpr std::int64_t kScanHold_ms = 100;      // how long a scan waits for its inertial data
constexpr std::int64_t kSilenceFirst_ms = 3000; // before a missing peer is named
constexpr std::int64_t kSilenceAgain_ms = 10000;
constexpr int kPoll_ms = 20;
constexpr float kScanPeriod_us = 50000.0F;      // a step that takes longer is an overrun
constexpr std::array<float, 11> kLimits_us{0.0F, 100.0F, 200.0F, 500.0F, 1000.0F, 2000.0F, 5000.0F, 10000.0F, 20000.0F, 50000.0F, 100000.0F};

std::int64_t monotonic_ns() {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Step times in bins of 10 us, so that percentiles need no list.
class Histogram {
public:
    void add(const float us) {
        const float bin = std::clamp(us / kBin_us, 0.0F, static_cast<float>(bins_.size() - 1));
        ++bins_[static_cast<std::size_t>(bin)];
        ++count_;
        max_us_ = std::max(max_us_, us);
    }
    [[nodiscard]] float percentile_us(const double share) const {
        const auto target = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(count_)));
        std::uint64_t sum = 0;
        for (std::size_t i = 0; i < bins_.size(); ++i) {
            sum += bins_[i];
            if (sum >= target && sum > 0) { return std::min(static_cast<float>(i + 1) * kBin_us, max_us_); }
        }
        return max_us_;
    }
    [[nodiscard]] float max_us() const { return max_us_; }
    /// Steps that took limit_us or longer; limit_us is a multiple of the bins' width.
    [[nodiscard]] std::uint64_t at_least(const float limit_us) const {
        std::uint64_t sum = 0;
        for (auto i = static_cast<std::size_t>(limit_us / kBin_us); i < bins_.size(); ++i) { sum += bins_[i]; }
        return sum;
    }
    [[nodiscard]] std::uint64_t count() const { return count_; }

private:
    static constexpr float kBin_us = 10.0F;
    std::array<std::uint64_t, 10001> bins_{};
    std::uint64_t count_ = 0;
    float max_us_ = 0.0F;
};

struct Process {
    LcmBus bus;
    LcmBus camera_bus;
    Histogram step_times;
    std::int64_t last_heard_ns = 0;
    std::int64_t scan_since_ns = 0;
    std::int64_t policy_wait_ns = 0;   // longest wait for a policy outside; 0: none
    bool policy_given_time = false;    // the wait for the newest request has run out
    std::uint64_t policy_waits_over = 0;
};

Process process;  // static: the whole memory of the process is known at link time
noctule::Parameters parameters;

void publish(void* context, const char* channel, const std::uint8_t* bytes, const std::size_t size) {
    static_cast<Process*>(context)->bus.publish_raw(channel, bytes, size);
}

/// In lockstep a step waits for the policy outside, once a request that it leaves unanswered: later ones are not waited for until it answers.
bool wait_for_policy(const NavNode& node, const std::int64_t now_ns) {
    if (!node.answer_awaited()) {
        process.policy_given_time = false;
        return false;
    }
    if (process.policy_wait_ns == 0 || process.policy_given_time) { return false; }
    if (now_ns - process.scan_since_ns < process.policy_wait_ns) { return true; }
    process.policy_given_time = true;
    ++process.policy_waits_over;
    return false;
}

/// heap_after_start: allocations since the first step; negative where they were not counted.
void write_stats(const char* path, const std::int64_t heap_after_start, const NavNode& node) {
    std::FILE* file = std::fopen(path, "w");
    if (file == nullptr) {
        std::fprintf(stderr, "noctule-nav: cannot write %s\n", path);
        return;
    }
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    std::fprintf(file, "{\"steps\": %llu, \"step_us\": {\"p50\": %.1f, \"p99\": %.1f, \"max\": %.1f}, \"navigator_bytes\": %zu, \"rss_kib\": %ld, ",
                 static_cast<unsigned long long>(process.step_times.count()), static_cast<double>(process.step_times.percentile_us(0.5)),
                 static_cast<double>(process.step_times.percentile_us(0.99)), static_cast<double>(process.step_times.max_us()),
                 sizeof(noctule::Navigator), usage.ru_maxrss);
    // Counts between these limits; the last is of all that took longer.
    std::fprintf(file, "\"step_us_histogram\": [");
    for (std::size_t i = 0; i < kLimits_us.size(); ++i) {
        const std::uint64_t beyond = i + 1 < kLimits_us.size() ? process.step_times.at_least(kLimits_us[i + 1]) : 0;
        std::fprintf(file, "%s[%.0f, %llu]", i == 0 ? "" : ", ", static_cast<double>(kLimits_us[i]),
                     static_cast<unsigned long long>(process.step_times.at_least(kLimits_us[i]) - beyond));
    }
    std::fprintf(file, "], \"overruns\": %llu, ", static_cast<unsigned long long>(process.step_times.at_least(kScanPeriod_us)));
    if (heap_after_start >= 0) {
        std::fprintf(file, "\"heap_allocations_after_start\": %lld, ", static_cast<long long>(heap_after_start));
    } else {
        std::fprintf(file, "\"heap_allocations_after_start\": null, ");
    }
    const noctule::Explorer::Counters explored = node.navigator().mission().explorer().counters();
    std::fprintf(file, "\"explorer\": {\"goals\": %u, \"switches\": %u, \"back_and_forth\": %u, \"in_vain\": %u, \"stuck\": %u, \"passes\": %u}, ",
                 explored.goals, explored.policy.switches, explored.back_and_forth, explored.policy.in_vain, explored.policy.stuck, explored.policy.passes);
    std::fprintf(file, "\"policy_waits_over\": %llu, ", static_cast<unsigned long long>(process.policy_waits_over));
    std::fprintf(file, "\"refused_messages\": %u, \"scans_replaced\": %u}\n", node.refused(), node.scans_replaced());
    std::fclose(file);
}

/// Overruns: the newest scan is taken, the one it replaced is skipped and counted; said at most every ten seconds.
void report_overruns(const std::int64_t now_ns, const std::uint32_t skipped) {
    static std::uint32_t told = 0;
    static std::int64_t next_ns = 0;
    if (skipped == told || now_ns < next_ns) { return; }
    std::fprintf(stderr, "noctule-nav: %u scans were skipped: steps take up to %.1f ms\n", skipped - told, static_cast<double>(process.step_times.max_us()) * 1e-3);
    told = skipped;
    next_ns = now_ns + kSilenceAgain_ms * kNanosecondsPerMillisecond;
}

/// Names the missing peer, at most every ten seconds.
void complain_when_silent(const std::int64_t now_ns, std::int64_t& next_complaint_ns) {
    if (now_ns < next_complaint_ns || now_ns - process.last_heard_ns < kSilenceFirst_ms * kNanosecondsPerMillisecond) { return; }
    std::fprintf(stderr, "noctule-nav: no scan and no inertial data on the bus for %lld s: is the laser's driver (or simulator) and noctule-bridge running on the same --lcm-url?\n",
                 static_cast<long long>((now_ns - process.last_heard_ns) / (1000 * kNanosecondsPerMillisecond)));
    next_complaint_ns = now_ns + kSilenceAgain_ms * kNanosecondsPerMillisecond;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-nav: localisation, mapping and exploration; one step per laser scan."};
    std::string parameter_path;
    std::string url = "udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2097152";
    std::string store_path;
    std::string stats_path;
    std::string atlas_path;
    options.add_option("--parameters", parameter_path, "TOML file with `name = value` lines; defaults hold for what is not named");
    options.add_option("--store", store_path, "what ground stations changed, as noctule-bridge --store writes it; read after --parameters where it exists");
    options.add_option("--lcm-url", url, "LCM bus of the flight")->capture_default_str();
    options.add_option("--stats", stats_path, "write step times and memory to this JSON file at the end");
    options.add_option("--atlas", atlas_path, "write the atlas (docs/atlas.md) to this file while flying");
    std::string camera_url;
    options.add_option("--camera-url", camera_url, "LCM bus of the camera and noctule-vision: its objects go into the atlas");
    std::int64_t policy_wait_ms = 0;
    options.add_option("--policy-wait-ms", policy_wait_ms, "lockstep: wait so long for a policy outside (parameter policy = 3); 0: never, as in flight")->check(CLI::Range(0, 10000));
    noctule::RealtimeOptions realtime;
    noctule::add_realtime_options(options, realtime);
    CLI11_PARSE(options, argc, argv);

    std::array<char, 512> error{};
    if (!parameter_path.empty() && !noctule::load_parameters(parameter_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-nav: %s\n", error.data());
        return 2;
    }
    if (!store_path.empty() && !noctule::load_stored_parameters(store_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-nav: %s\n", error.data());
        return 2;
    }
    noctule::apply_realtime("noctule-nav", realtime);
    if (!process.bus.open(url.c_str())) {
        std::fprintf(stderr, "noctule-nav: %s\n", process.bus.error());
        return 2;
    }
    if (!camera_url.empty() && !process.camera_bus.open(camera_url.c_str())) {
        std::fprintf(stderr, "noctule-nav: %s\n", process.camera_bus.error());
        return 2;
    }
    noctule::install_stop_signals();

    static NavNode node(parameters, publish, &process, monotonic_ns);
    static noctule::PosixDisk disk;
    static noctule::AtlasContents contents;
    static noctule::AtlasObjects objects;
    std::optional<noctule::AtlasWriter> atlas;
    if (!atlas_path.empty()) { atlas.emplace(disk, atlas_path, noctule::kMaxAtlasBytes); }
    const auto write_down = [&atlas] {
        const std::int64_t t_us = node.newest_t_us();
        if (!atlas || t_us <= 0 || !atlas->wants(t_us)) { return; }
        noctule::fill_atlas(node.navigator(), t_us, contents);
        objects.list(contents.objects);
        atlas->give(noctule::encode_atlas(contents, node.navigator().grid(), atlas->buffer()), t_us);
    };
    process.policy_wait_ns = policy_wait_ms * kNanosecondsPerMillisecond;
    static const auto step_when_due = [](const std::int64_t now_ns) {
        if (!node.step_due() || wait_for_policy(node, now_ns)) { return; }
        node.step();
        process.step_times.add(static_cast<float>(monotonic_ns() - now_ns) * 1e-3F);
    };
    auto on_message = [](const char* channel, const std::uint8_t* bytes, const std::size_t size) {
        process.last_heard_ns = monotonic_ns();
        const bool waited = node.scan_waiting();
        static_cast<void>(node.receive(channel, bytes, size));
        if (!waited && node.scan_waiting()) { process.scan_since_ns = process.last_heard_ns; }
        step_when_due(monotonic_ns());
    };
    for (const char* name : {noctule::kChannelScan, noctule::kChannelImu, noctule::kChannelAttitude, noctule::kChannelRangeUp, noctule::kChannelRangeDown, noctule::kChannelBaro, noctule::kChannelVehicle, noctule::kChannelCommand, noctule::kChannelParameters, noctule::kChannelPolicyGoal}) {
        if (!process.bus.subscribe_raw(name, on_message)) {
            std::fprintf(stderr, "noctule-nav: cannot subscribe to %s\n", name);
            return 2;
        }
    }

    auto on_objects = [](const noctule::objects_t& seen) {
        const noctule::FloorPlanner& floors = node.navigator().mission().floors();
        objects.note(seen, floors.layer() == noctule::FloorPlanner::kShaft ? -1 : floors.name_of(floors.layer()));
    };
    if (!camera_url.empty() && !process.camera_bus.subscribe<noctule::objects_t>(noctule::kChannelObjects, on_objects)) {
        std::fprintf(stderr, "noctule-nav: cannot subscribe to %s\n", noctule::kChannelObjects);
        return 2;
    }

    process.last_heard_ns = monotonic_ns();
    std::int64_t next_complaint_ns = 0;
    noctule::Watchdog watchdog;
    watchdog.ready();
    // Start-up ends with the first step: until then the bus's own reader may still allocate. LCM sets up a bus's lock with its first message: that of the camera's bus is start-up, too.
    std::int64_t heap_at_first_step = -1;
    while (!noctule::stop_requested()) {
        if (!camera_url.empty()) {
            const std::int64_t start = noctule::handle_and_count_start(process.camera_bus);
            if (heap_at_first_step >= 0) { heap_at_first_step += start; }
        }
        if (process.bus.handle(kPoll_ms) < 0) {
            if (noctule::stop_requested()) { break; }
            std::fprintf(stderr, "noctule-nav: the LCM bus failed\n");
            return 1;
        }
        const std::int64_t now_ns = monotonic_ns();
        step_when_due(now_ns);
        if (node.scan_waiting() && !node.step_due() && now_ns - process.scan_since_ns > kScanHold_ms * kNanosecondsPerMillisecond) {
            node.step();  // inertial data is late: go on with what there is
        }
        if (heap_at_first_step < 0 && process.step_times.count() > 0 && noctule_heap_allocations != nullptr) {
            heap_at_first_step = noctule_heap_allocations();
        }
        write_down();
        complain_when_silent(now_ns, next_complaint_ns);
        report_overruns(now_ns, node.scans_replaced());
        watchdog.alive(now_ns / 1000);
    }
    watchdog.stopping();
    if (atlas && atlas->failed() > 0U) { std::fprintf(stderr, "noctule-nav: the atlas could not be written %llu times\n", static_cast<unsigned long long>(atlas->failed())); }
    const std::int64_t heap_after_start = heap_at_first_step < 0 ? -1 : noctule_heap_allocations() - heap_at_first_step;
    if (!stats_path.empty()) { write_stats(stats_path.c_str(), heap_after_start, node); }
    return 0;
}
