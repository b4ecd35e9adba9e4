/// noctule-lidar: a Hokuyo laser on the bus. Publishes what the simulator publishes on SCAN, on the autopilot's clock.
///
/// That clock comes from the stamps of IMU, which noctule-bridge publishes: their arrival here gives its offset from this
/// machine's clock, the sensor's stamps give its own (drivers/sensor_clock.hpp). Without IMU no scan is published.
#include <poll.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <string>

#include <CLI/CLI.hpp>

#include "app/parameter_file.hpp"
#include "app/realtime.hpp"
#include "app/signals.hpp"
#include "drivers/byte_stream.hpp"
#include "drivers/hokuyo.hpp"
#include "drivers/scan_stamper.hpp"
#include "lcmtypes/noctule/imu_t.hpp"
#include "link/lcm_bus.hpp"
#include "streams.gen.hpp"

namespace {

using noctule::LcmBus;

constexpr int kPoll_ms = 20;
constexpr std::int64_t kSayAgain_us = 10000000;
constexpr std::int64_t kSilence_us = 3000000;

std::int64_t monotonic_us() {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// One line at most every ten seconds.
class Complaint {
public:
    template <class... Arguments>
    void say(const std::int64_t now_us, const char* format, const Arguments... arguments) {
        if (now_us < next_us_) { return; }
        next_us_ = now_us + kSayAgain_us;
        std::fprintf(stderr, format, arguments...);
    }
    void settle() { next_us_ = 0; }

private:
    std::int64_t next_us_ = 0;
};

struct Driver final : noctule::HokuyoSink {
    explicit Driver(const noctule::Parameters& parameters, const noctule::HokuyoWish& wish) : hokuyo(*this, wish), stamper(parameters) {}

    LcmBus bus;
    noctule::ByteStream stream;
    noctule::Hokuyo hokuyo;
    noctule::ScanStamper stamper;
    noctule::scan_t message{};
    float range_max_m = 0.0F;  ///< 0: what the sensor says
    std::int64_t last_imu_us = 0;

    void send(const std::string_view command) override { static_cast<void>(stream.send(command)); }
    void scan(const noctule::scip::Measurement& measurement, const std::int64_t sensor_us, const std::int64_t arrival_us) override {
        if (stamper.fill(hokuyo, measurement, sensor_us, arrival_us, range_max_m, message)) { bus.publish(noctule::kChannelScan, message); }
    }
};

noctule::Parameters parameters;

void write_stats(const char* path, const Driver& driver) {
    std::FILE* file = std::fopen(path, "w");
    if (file == nullptr) {
        std::fprintf(stderr, "noctule-lidar: cannot write %s\n", path);
        return;
    }
    const noctule::Hokuyo::Counters counters = driver.hokuyo.counters();
    const noctule::ScanStamper::Counters stamps = driver.stamper.counters();
    std::fprintf(file,
                 "{\"scans\": %u, \"published\": %u, \"bad_sum\": %u, \"bad_form\": %u, \"overlong\": %u, \"repeated\": %u, \"sensor_errors\": %u, "
                 "\"without_clock\": %u, \"time_backwards\": %u, \"clock_restarts\": %u}\n",
                 counters.scans, stamps.published, counters.bad_sum, counters.bad_form, counters.overlong, counters.repeated, counters.sensor_errors,
                 stamps.without_clock, stamps.backwards, stamps.clock_restarts);
    std::fclose(file);
}

void describe(const Driver& driver) {
    const noctule::Hokuyo& hokuyo = driver.hokuyo;
    std::fprintf(stderr, "noctule-lidar: %s on %s: %zu beams, %.1f Hz\n", hokuyo.parameters().model.data(), driver.stream.url().c_str(), hokuyo.beams(),
                 static_cast<double>(hokuyo.rate_hz()));
    if (hokuyo.beams_left_out() > 0) { std::fprintf(stderr, "noctule-lidar: %d beams are left out: more than a scan can hold\n", static_cast<int>(hokuyo.beams_left_out())); }
}

/// Everything that waits on the line; then its state.
void serve(Driver& driver, const std::int64_t now_us, Complaint& complaint) {
    static std::array<std::uint8_t, 16384> buffer;
    if (driver.stream.keep(now_us)) {
        driver.stamper.sensor_restarted();
        driver.hokuyo.connected(now_us);
    }
    const bool was_open = driver.stream.is_open();
    const bool was_measuring = driver.hokuyo.measuring();
    for (auto bytes = driver.stream.receive(buffer); !bytes.empty(); bytes = driver.stream.receive(buffer)) { driver.hokuyo.receive(bytes, now_us); }
    driver.hokuyo.tick(now_us);
    if (driver.stream.is_open() && driver.hokuyo.failed()) {
        complaint.say(now_us, "noctule-lidar: %s: %s; trying again every second\n", driver.stream.url().c_str(), driver.hokuyo.why());
        driver.stream.close();
    } else if (!driver.stream.is_open() && !driver.stream.is_opening() && (was_open || !driver.stream.error().empty())) {
        complaint.say(now_us, "noctule-lidar: %s: %s; trying again every second\n", driver.stream.url().c_str(), driver.stream.error().c_str());
    }
    if (!was_measuring && driver.hokuyo.measuring()) {
        complaint.settle();
        describe(driver);
    }
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-lidar: a Hokuyo laser (SCIP 2.0, TCP or USB) on the bus of the flight."};
    std::string parameter_path;
    std::string device = "tcp:192.168.0.10:10940";
    std::string url = "udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2097152";
    std::string stats_path;
    noctule::HokuyoWish wish;
    float range_max_m = 0.0F;
    noctule::RealtimeOptions realtime;
    options.add_option("--parameters", parameter_path, "TOML file with `name = value` lines; defaults hold for what is not named");
    options.add_option("--device", device, "tcp:ADDRESS:PORT (UST, UTM-LX-EW) or serial:PATH[:BAUD] (URG, UTM over USB)")->capture_default_str();
    options.add_option("--lcm-url", url, "LCM bus of the flight")->capture_default_str();
    options.add_option("--rate", wish.rate_hz, "scans a second that are wanted; a faster sensor leaves some out")->check(CLI::Range(1.0, 50.0))->capture_default_str();
    options.add_option("--range-max", range_max_m, "farther returns count as none [m]; 0: as the sensor says")->check(CLI::Range(0.0, 200.0))->capture_default_str();
    options.add_option("--stats", stats_path, "write counters to this JSON file at the end");
    noctule::add_realtime_options(options, realtime);
    CLI11_PARSE(options, argc, argv);

    std::array<char, 512> error{};
    if (!parameter_path.empty() && !noctule::load_parameters(parameter_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-lidar: %s\n", error.data());
        return 2;
    }
    static Driver driver(parameters, wish);
    driver.range_max_m = range_max_m;
    if (!driver.stream.set_url(device)) {
        std::fprintf(stderr, "noctule-lidar: %s\n", driver.stream.error().c_str());
        return 2;
    }
    noctule::apply_realtime("noctule-lidar", realtime);
    if (!driver.bus.open(url.c_str())) {
        std::fprintf(stderr, "noctule-lidar: %s\n", driver.bus.error());
        return 2;
    }
    noctule::install_stop_signals();
    auto on_imu = [&](const noctule::imu_t& message) {
        driver.last_imu_us = monotonic_us();
        driver.stamper.add_imu(message.t_us, driver.last_imu_us);
    };
    if (!driver.bus.subscribe<noctule::imu_t>(noctule::kChannelImu, on_imu)) {
        std::fprintf(stderr, "noctule-lidar: cannot subscribe on %s\n", url.c_str());
        return 1;
    }

    noctule::Watchdog watchdog;
    watchdog.ready();
    Complaint no_laser;
    Complaint no_imu;
    driver.last_imu_us = monotonic_us();
    while (!noctule::stop_requested()) {
        std::array<pollfd, 2> waits{{{driver.bus.fd(), POLLIN, 0}, {driver.stream.fd(), static_cast<short>(driver.stream.is_opening() ? POLLOUT : POLLIN), 0}}};
        static_cast<void>(::poll(waits.data(), waits.size(), kPoll_ms));
        if (driver.bus.handle(0) < 0) {
            if (noctule::stop_requested()) { break; }
            std::fprintf(stderr, "noctule-lidar: the LCM bus failed\n");
            return 1;
        }
        const std::int64_t now_us = monotonic_us();
        serve(driver, now_us, no_laser);
        if (now_us - driver.last_imu_us > kSilence_us) {
            no_imu.say(now_us, "noctule-lidar: no IMU on %s for %lld s: scans cannot be stamped; is noctule-bridge running?\n", url.c_str(),
                       static_cast<long long>((now_us - driver.last_imu_us) / 1000000));
        } else {
            no_imu.settle();
        }
        watchdog.alive(now_us);
    }
    watchdog.stopping();
    static_cast<void>(driver.stream.send("QT\n"));  // the laser goes dark with us
    if (!stats_path.empty()) { write_stats(stats_path.c_str(), driver); }
    return 0;
}
