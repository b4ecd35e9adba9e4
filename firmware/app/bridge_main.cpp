/// noctule-bridge: between flight controller, ground stations and the autonomy. The logic is link/bridge.hpp; here are sockets and time.
#include <poll.h>
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "app/computer_load.hpp"
#include "app/heap_start.hpp"
#include "app/parameter_file.hpp"
#include "app/port.hpp"
#include "app/realtime.hpp"
#include "app/signals.hpp"
#include "link/bridge.hpp"
#include "link/lcm_bus.hpp"
#include "streams.gen.hpp"

namespace {

using noctule::Bridge;
using noctule::LcmBus;
using noctule::Port;

constexpr std::int64_t kSilenceFirst_us = 3000000;   // before a missing peer is named
constexpr std::int64_t kSilenceAgain_us = 10000000;
constexpr std::int64_t kWallPeriod_us = 100000;
constexpr std::int64_t kLoadPeriod_us = 1000000;
constexpr int kPoll_ms = 50;
constexpr int kDatagramsPerTurn = 64;  // then the other sockets get their turn

std::int64_t monotonic_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// MAVLink's time for signing: 10 us since 2015-01-01.
std::uint64_t signing_time() {
    constexpr std::int64_t kEpoch_s = 1420070400;
    const auto since = std::chrono::system_clock::now().time_since_epoch() - std::chrono::seconds(kEpoch_s);
    return static_cast<std::uint64_t>(std::max<std::int64_t>(0, std::chrono::duration_cast<std::chrono::microseconds>(since).count() / 10));
}

struct Endpoints final : noctule::BridgeSink {
    LcmBus bus;
    LcmBus camera_bus;  ///< OBJECTS; open where --camera-url was given
    bool has_camera = false;
    std::optional<noctule::Signing> signing;
    std::unique_ptr<Port> autopilot;
    std::vector<std::unique_ptr<Port>> ground;
    noctule::Parameters base;  ///< defaults and --parameters, without what ground stations changed
    std::string store_path;    ///< empty: changes last until the end

    void to_autopilot(const std::span<const std::uint8_t> frame) override { autopilot->send(frame); }
    void to_ground(const std::span<const std::uint8_t> frame) override {
        for (const auto& port : ground) { port->send(frame); }
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

noctule::Parameters parameters;
Endpoints endpoints;

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
    if (endpoints.signing) {
        std::fprintf(file, "\"signed_good\": %u, \"signed_refused\": %u, ", endpoints.signing->counters().good, endpoints.signing->counters().refused);
    }
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

int run(Bridge& bridge, const std::string& url, const std::string& stats_path) {
    std::int64_t now_us = monotonic_us();
    Complaint no_autopilot(now_us);
    Complaint no_nav(now_us);
    auto on_nav = [&](const noctule::nav_t& message) {
        no_nav.heard(now_us);
        bridge.on_nav(message);
    };
    auto on_odom = [&](const noctule::odom_t& message) { bridge.on_odom(message); };
    auto on_scan = [&](const noctule::scan_t& message) { bridge.on_scan(message); };
    auto on_objects = [&](const noctule::objects_t& message) { bridge.on_objects(message); };
    auto on_video = [&](const noctule::video_t& message) { bridge.on_video(message); };
    if (endpoints.has_camera && (!endpoints.camera_bus.subscribe<noctule::objects_t>(noctule::kChannelObjects, on_objects) || !endpoints.camera_bus.subscribe<noctule::video_t>(noctule::kChannelVideo, on_video))) {
        std::fprintf(stderr, "noctule-bridge: cannot subscribe on the camera bus\n");
        return 1;
    }
    if (!endpoints.bus.subscribe<noctule::scan_t>(noctule::kChannelScan, on_scan) || !endpoints.bus.subscribe<noctule::nav_t>(noctule::kChannelNav, on_nav) || !endpoints.bus.subscribe<noctule::odom_t>(noctule::kChannelOdom, on_odom)) {
        std::fprintf(stderr, "noctule-bridge: cannot subscribe on %s\n", url.c_str());
        return 1;
    }
    std::vector<pollfd> waits;
    std::vector<Port*> ports{endpoints.autopilot.get()};
    for (const auto& port : endpoints.ground) { ports.push_back(port.get()); }
    waits.resize(ports.size());
    waits.push_back({endpoints.bus.fd(), POLLIN, 0});
    if (endpoints.has_camera) { waits.push_back({endpoints.camera_bus.fd(), POLLIN, 0}); }

    std::int64_t next_wall_us = now_us;
    std::int64_t next_load_us = now_us;
    static noctule::ComputerWatch computer;
    std::int64_t heap_at_start = -1;
    noctule::Watchdog watchdog;
    watchdog.ready();
    while (!noctule::stop_requested()) {
        watchdog.alive(monotonic_us());
        for (std::size_t i = 0; i < ports.size(); ++i) {  // a serial device comes and goes
            const noctule::Endpoint& end = ports[i]->endpoint();
            waits[i] = {end.fd(), static_cast<short>(end.wants_to_send() ? POLLIN | POLLOUT : POLLIN), 0};
        }
        if (::poll(waits.data(), waits.size(), kPoll_ms) < 0 && errno != EINTR) {
            std::perror("noctule-bridge: poll");
            return 1;
        }
        now_us = monotonic_us();
        bridge.set_clock(now_us);
        // The bus first: the answer to a scan ends the simulator's tick.
        if (endpoints.bus.handle(0) < 0) {
            if (noctule::stop_requested()) { break; }
            std::fprintf(stderr, "noctule-bridge: the LCM bus failed\n");
            return 1;
        }
        for (Port* const port : ports) { port->endpoint().tend(now_us); }
        static std::array<std::uint8_t, 65536> buffer;
        if (endpoints.autopilot->drain(buffer, kDatagramsPerTurn, [&](const std::span<const std::uint8_t> bytes) { bridge.from_autopilot(bytes); })) { no_autopilot.heard(now_us); }
        for (const auto& port : endpoints.ground) {
            port->drain(buffer, kDatagramsPerTurn, [&](const std::span<const std::uint8_t> bytes) { bridge.from_ground(bytes); });
        }
        if (endpoints.has_camera) {
            const std::int64_t start = noctule::handle_and_count_start(endpoints.camera_bus);
            if (heap_at_start >= 0) { heap_at_start += start; }
        }
        if (now_us >= next_load_us) {
            next_load_us = now_us + kLoadPeriod_us;
            bridge.on_computer(computer.read(now_us));
        }
        if (now_us >= next_wall_us) {
            next_wall_us = now_us + kWallPeriod_us;
            if (endpoints.signing) { endpoints.signing->set_time(signing_time()); }
            bridge.on_wall(now_us);
            no_autopilot.check(now_us, "noctule-bridge: no autopilot on %s for %lld s\n", endpoints.autopilot->endpoint().url().c_str());
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
    options.add_option("--autopilot", autopilot_url, "flight controller: udpin:ADDRESS:PORT, udpout:ADDRESS:PORT or serial:DEVICE:BAUD[:rtscts]")->capture_default_str();
    options.add_option("--ground", ground_urls, "ground station, as above; may be given several times (QGroundControl: udpout:127.0.0.1:14550)");
    options.add_option("--lcm-url", url, "LCM bus of the flight")->capture_default_str();
    std::string key_path;
    bool sign_autopilot = false;
    options.add_option("--signing-key", key_path, "MAVLink 2 signing on every --ground link, loopback included: unsigned and replayed packets are refused. A file of 32 bytes or 64 hexadecimal digits, mode 600");
    options.add_flag("--sign-autopilot", sign_autopilot, "the autopilot's link, too (else it is taken for a wire inside the vehicle)");
    std::string camera_url;
    bool map_only = false;
    options.add_option("--camera-url", camera_url, "LCM bus of the camera, to tell the pilot of new objects and of the video");
    options.add_flag("--map-only", map_only, "carried by hand, props off: no setpoint, mode or arming is ever sent; it maps and reports");
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
    std::string problem;
    const auto open_port = [&](const std::string& name, const bool with_key) -> std::unique_ptr<Port> {
        std::unique_ptr<noctule::Endpoint> endpoint = noctule::open_endpoint(name, problem);
        if (!endpoint) { return nullptr; }
        return std::make_unique<Port>(std::move(endpoint), with_key && endpoints.signing ? &*endpoints.signing : nullptr, static_cast<std::uint8_t>(endpoints.ground.size()));
    };
    if (!key_path.empty()) {
        std::array<std::uint8_t, 32> key{};
        if (!noctule::load_signing_key(key_path, key, problem)) {
            std::fprintf(stderr, "noctule-bridge: %s\n", problem.c_str());
            return 2;
        }
        endpoints.signing.emplace(key);
        endpoints.signing->set_time(signing_time());
    }
    bool opened = true;
    for (const std::string& ground_url : ground_urls) {
        endpoints.ground.push_back(open_port(ground_url, true));
        opened = opened && endpoints.ground.back() != nullptr;
    }
    endpoints.autopilot = opened ? open_port(autopilot_url, sign_autopilot) : nullptr;
    if (!endpoints.autopilot) {
        std::fprintf(stderr, "noctule-bridge: %s\n", problem.c_str());
        return 2;
    }
    noctule::apply_realtime("noctule-bridge", realtime);
    if (!endpoints.bus.open(url.c_str())) {
        std::fprintf(stderr, "noctule-bridge: %s\n", endpoints.bus.error());
        return 2;
    }
    endpoints.has_camera = !camera_url.empty();
    if (endpoints.has_camera && !endpoints.camera_bus.open(camera_url.c_str())) {
        std::fprintf(stderr, "noctule-bridge: %s\n", endpoints.camera_bus.error());
        return 2;
    }
    noctule::install_stop_signals();
    static Bridge bridge(parameters, endpoints);
    if (map_only) { bridge.set_map_only(); }
    return run(bridge, url, stats_path);
}
