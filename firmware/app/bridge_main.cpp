/// noctule-bridge: between flight controller, ground stations and the autonomy. The logic is link/bridge.hpp; here are sockets and time.
#include <poll.h>
#include <sys/resource.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "app/parameter_file.hpp"
#include "app/realtime.hpp"
#include "app/signals.hpp"
#include "app/udp_endpoint.hpp"
#include "link/bridge.hpp"
#include "link/lcm_bus.hpp"
#include "streams.gen.hpp"

extern "C" std::int64_t noctule_heap_allocations() __attribute__((weak));  // from the preloaded counter

namespace {

using noctule::Bridge;
using noctule::LcmBus;
using noctule::UdpEndpoint;

constexpr std::int64_t kSilenceFirst_us = 3000000;   // before a missing peer is named
constexpr std::int64_t kSilenceAgain_us = 10000000;
constexpr std::int64_t kWallPeriod_us = 100000;
constexpr int kPoll_ms = 50;
constexpr int kDatagramsPerTurn = 64;  // then the other sockets get their turn

std::int64_t monotonic_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

struct Endpoints final : noctule::BridgeSink {
    LcmBus bus;
    UdpEndpoint autopilot;
    std::vector<std::unique_ptr<UdpEndpoint>> ground;
    noctule::Parameters base;  ///< defaults and --parameters, without what ground stations changed
    std::string store_path;    ///< empty: changes last until the end

    void to_autopilot(const std::span<const std::uint8_t> frame) override { autopilot.send(frame); }
    void to_ground(const std::span<const std::uint8_t> frame) override {
        for (const auto& endpoint : ground) { endpoint->send(frame); }
    }
    void publish(const noctule::imu_t& message) override { bus.publish(noctule::kChannelImu, message); }
    void publish(const noctule::attitude_t& message) override { bus.publish(noctule::kChannelAttitude, message); }
    void publish_up(const noctule::range_t& message) override { bus.publish(noctule::kChannelRangeUp, message); }
    void publish_down(const noctule::range_t& message) override { bus.publish(noctule::kChannelRangeDown, message); }
    void publish(const noctule::baro_t& message) override { bus.publish(noctule::kChannelBaro, message); }
    void publish(const noctule::vehicle_t& message) override { bus.publish(noctule::kChannelVehicle, message); }
    void publish(const noctule::command_t& message) override { bus.publish(noctule::kChannelCommand, message); }
    void publish(const noctule::parameters_t& message) override { bus.publish(noctule::kChannelParameters, message); }
    void store(const noctule::Parameters& stored) override {
        if (!store_path.empty() && !noctule::store_parameters(store_path.c_str(), stored, base)) { std::perror(("noctule-bridge: " + store_path).c_str()); }
    }
};

/// A peer that is not heard is named after three seconds, then at most every ten.
class Complaint {
public:
    explicit Complaint(const std::int64_t now_us) : last_heard_us_(now_us) {}

    void heard(const std::int64_t now_us) { last_heard_us_ = now_us; }

    template <class... Arguments>
    void check(const std::int64_t now_us, const char* format, const Arguments... arguments) {
        const std::int64_t silent_us = now_us - last_heard_us_;
        if (silent_us < kSilenceFirst_us || now_us < next_us_) { return; }
        next_us_ = now_us + kSilenceAgain_us;
        std::fprintf(stderr, format, arguments..., static_cast<long long>(silent_us / 1000000));
    }

private:
    std::int64_t last_heard_us_;
    std::int64_t next_us_ = 0;
};

void write_stats(const char* path, const Bridge& bridge, const LcmBus& bus, const std::int64_t heap_after_start) {
    std::FILE* file = std::fopen(path, "w");
    if (file == nullptr) {
        std::fprintf(stderr, "noctule-bridge: cannot write %s\n", path);
        return;
    }
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    const auto number = [](const std::uint64_t value) { return static_cast<unsigned long long>(value); };
    std::fprintf(file, "{\"imu\": %llu, \"setpoints_sent\": %llu, \"odometry_sent\": %llu, \"refused_samples\": %llu, \"refused_setpoints\": %u, ", number(bridge.counters().imu),
                 number(bridge.counters().setpoints_sent), number(bridge.counters().odometry_sent), number(bridge.counters().refused_samples),
                 bridge.supervisor().counters().setpoints_refused);
    std::fprintf(file, "\"bad_checksum\": %llu, \"skipped_bytes\": %llu, \"undecodable\": %llu, \"publish_failed\": %llu, ",
                 number(bridge.autopilot_bytes().bad_checksum + bridge.ground_bytes().bad_checksum), number(bridge.autopilot_bytes().skipped_bytes + bridge.ground_bytes().skipped_bytes),
                 number(bus.counters().undecodable), number(bus.counters().publish_failed));
    if (noctule_heap_allocations != nullptr) {
        std::fprintf(file, "\"heap_allocations_after_start\": %lld, ", static_cast<long long>(heap_after_start));
    } else {
        std::fprintf(file, "\"heap_allocations_after_start\": null, ");
    }
    std::fprintf(file, "\"bridge_bytes\": %zu, \"rss_kib\": %ld}\n", sizeof(Bridge), usage.ru_maxrss);
    std::fclose(file);
}

/// Everything that waits on one socket, within its turn.
template <class Take>
bool drain(UdpEndpoint& endpoint, Take&& take) {
    static std::array<std::uint8_t, 65536> buffer;
    bool heard = false;
    for (int i = 0; i < kDatagramsPerTurn; ++i) {
        const std::span<const std::uint8_t> datagram = endpoint.receive(buffer);
        if (datagram.empty()) { break; }
        heard = true;
        take(datagram);
    }
    return heard;
}

noctule::Parameters parameters;
Endpoints endpoints;

int run(Bridge& bridge, const std::string& url, const std::string& stats_path) {
    std::int64_t now_us = monotonic_us();
    Complaint no_autopilot(now_us);
    Complaint no_nav(now_us);
    auto on_nav = [&](const noctule::nav_t& message) {
        no_nav.heard(now_us);
        bridge.on_nav(message);
    };
    auto on_odom = [&](const noctule::odom_t& message) { bridge.on_odom(message); };
    if (!endpoints.bus.subscribe<noctule::nav_t>(noctule::kChannelNav, on_nav) || !endpoints.bus.subscribe<noctule::odom_t>(noctule::kChannelOdom, on_odom)) {
        std::fprintf(stderr, "noctule-bridge: cannot subscribe on %s\n", url.c_str());
        return 1;
    }
    std::vector<pollfd> waits;
    waits.push_back({endpoints.autopilot.fd(), POLLIN, 0});
    waits.push_back({endpoints.bus.fd(), POLLIN, 0});
    for (const auto& endpoint : endpoints.ground) { waits.push_back({endpoint->fd(), POLLIN, 0}); }

    std::int64_t next_wall_us = now_us;
    std::int64_t heap_at_start = -1;
    noctule::Watchdog watchdog;
    watchdog.ready();
    while (!noctule::stop_requested()) {
        watchdog.alive(monotonic_us());
        if (::poll(waits.data(), waits.size(), kPoll_ms) < 0 && errno != EINTR) {
            std::perror("noctule-bridge: poll");
            return 1;
        }
        now_us = monotonic_us();
        // The bus first: the answer to a scan ends the simulator's tick.
        if (endpoints.bus.handle(0) < 0) {
            if (noctule::stop_requested()) { break; }
            std::fprintf(stderr, "noctule-bridge: the LCM bus failed\n");
            return 1;
        }
        if (drain(endpoints.autopilot, [&](const std::span<const std::uint8_t> datagram) { bridge.from_autopilot(datagram); })) { no_autopilot.heard(now_us); }
        for (const auto& endpoint : endpoints.ground) {
            drain(*endpoint, [&](const std::span<const std::uint8_t> datagram) { bridge.from_ground(datagram); });
        }
        if (now_us >= next_wall_us) {
            next_wall_us = now_us + kWallPeriod_us;
            bridge.on_wall(now_us);
            no_autopilot.check(now_us, "noctule-bridge: no autopilot on %s for %lld s\n", endpoints.autopilot.url().c_str());
            no_nav.check(now_us, "noctule-bridge: nothing from noctule-nav on %s for %lld s\n", url.c_str());
            if (heap_at_start < 0 && bridge.counters().odometry_sent > 0 && noctule_heap_allocations != nullptr) { heap_at_start = noctule_heap_allocations(); }
        }
    }
    watchdog.stopping();
    const std::int64_t heap_after_start = heap_at_start < 0 ? 0 : noctule_heap_allocations() - heap_at_start;
    if (!stats_path.empty()) { write_stats(stats_path.c_str(), bridge, endpoints.bus, heap_after_start); }
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-bridge: the link to the flight controller and to ground stations, and the safety supervisor."};
    std::string parameter_path;
    std::string autopilot_url = "udpin:0.0.0.0:14540";
    std::vector<std::string> ground_urls;
    std::string url = "udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2097152";
    std::string stats_path;
    options.add_option("--parameters", parameter_path, "TOML file with `name = value` lines; defaults hold for what is not named");
    options.add_option("--store", endpoints.store_path, "TOML file for what ground stations change; read after --parameters where it exists (give it to noctule-nav, too)");
    options.add_option("--autopilot", autopilot_url, "flight controller: udpin:ADDRESS:PORT or udpout:ADDRESS:PORT")->capture_default_str();
    options.add_option("--ground", ground_urls, "ground station, as above; may be given several times (QGroundControl: udpout:127.0.0.1:14550)");
    options.add_option("--lcm-url", url, "LCM bus of the flight")->capture_default_str();
    options.add_option("--stats", stats_path, "write counters and memory to this JSON file at the end");
    noctule::RealtimeOptions realtime;
    noctule::add_realtime_options(options, realtime);
    CLI11_PARSE(options, argc, argv);

    std::array<char, 512> error{};
    if (!parameter_path.empty() && !noctule::load_parameters(parameter_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-bridge: %s\n", error.data());
        return 2;
    }
    endpoints.base = parameters;
    if (!endpoints.store_path.empty() && !noctule::load_stored_parameters(endpoints.store_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-bridge: %s\n", error.data());
        return 2;
    }
    if (!endpoints.autopilot.open(autopilot_url)) {
        std::fprintf(stderr, "noctule-bridge: %s\n", endpoints.autopilot.error().c_str());
        return 2;
    }
    for (const std::string& ground_url : ground_urls) {
        endpoints.ground.push_back(std::make_unique<UdpEndpoint>());
        if (!endpoints.ground.back()->open(ground_url)) {
            std::fprintf(stderr, "noctule-bridge: %s\n", endpoints.ground.back()->error().c_str());
            return 2;
        }
    }
    noctule::apply_realtime("noctule-bridge", realtime);
    if (!endpoints.bus.open(url.c_str())) {
        std::fprintf(stderr, "noctule-bridge: %s\n", endpoints.bus.error());
        return 2;
    }
    noctule::install_stop_signals();
    static Bridge bridge(parameters, endpoints);
    return run(bridge, url, stats_path);
}
