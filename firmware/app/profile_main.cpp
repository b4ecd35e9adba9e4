/// noctule-profile: the autonomy over a recorded flight, for counting instructions with callgrind.
///
/// Run by `noctule bench instructions` under `valgrind --tool=callgrind --instr-atstart=no --toggle-collect=...`. Instrumentation is
/// on for blocks of steps only, drawn with a fixed seed; each step of a block makes one dump. Without callgrind it just runs.
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>

#include <CLI/CLI.hpp>
#include <lcm/lcm.h>

#include "app/parameter_file.hpp"
#include "link/bridge.hpp"
#include "link/lcm_bus.hpp"
#include "link/nav_node.hpp"

#if __has_include(<valgrind/callgrind.h>)
#include <valgrind/callgrind.h>
#else  // no valgrind on this machine: nothing can be measured here, the flight still runs
#define CALLGRIND_START_INSTRUMENTATION static_cast<void>(0)
#define CALLGRIND_STOP_INSTRUMENTATION static_cast<void>(0)
#define CALLGRIND_ZERO_STATS static_cast<void>(0)
#define CALLGRIND_DUMP_STATS_AT(text) static_cast<void>(text)
#endif

namespace {

constexpr int kWarmSteps = 5;  ///< of a block, before its measured ones: the code is being translated

/// Which steps are measured: `length` in a row, once in every stretch of `every`, at a place that changes from stretch to stretch.
class Blocks {
public:
    Blocks(const int every, const int length) : every_(every), length_(length) { draw(); }

    /// What the coming step is for.
    enum class Use { plain, warm, measured };
    Use next() {
        const int at = step_++;
        if (at == every_) {
            step_ = 1;
            draw();
            return use(0);
        }
        return use(at);
    }

private:
    [[nodiscard]] Use use(const int at) const {
        if (at < begin_ || at >= begin_ + kWarmSteps + length_) { return Use::plain; }
        return at < begin_ + kWarmSteps ? Use::warm : Use::measured;
    }
    void draw() {
        state_ = state_ * 6364136223846793005ULL + 1442695040888963407ULL;
        const int room = every_ - length_ - kWarmSteps;
        begin_ = room > 0 ? static_cast<int>((state_ >> 33) % static_cast<std::uint64_t>(room + 1)) : 0;
    }

    int every_;
    int length_;
    int begin_ = 0;
    int step_ = 0;
    std::uint64_t state_ = 1;
};

void drop(void* /*context*/, const char* /*channel*/, const std::uint8_t* /*bytes*/, std::size_t /*size*/) {}

noctule::Parameters parameters;

/// Steps run; negative: the log cannot be opened.
int run(const std::string& log_path, Blocks blocks, int& measured) {
    lcm_eventlog_t* log = lcm_eventlog_create(log_path.c_str(), "r");
    if (log == nullptr) { return -1; }
    static noctule::NavNode node(parameters, drop, nullptr, nullptr);
    int steps = 0;
    bool counting = false;
    while (lcm_eventlog_event_t* event = lcm_eventlog_read_next_event(log)) {
        const std::string channel(event->channel, static_cast<std::size_t>(event->channellen));
        static_cast<void>(node.receive(channel.c_str(), static_cast<const std::uint8_t*>(event->data), static_cast<std::size_t>(event->datalen)));
        lcm_eventlog_free_event(event);
        if (!node.step_due()) { continue; }
        ++steps;
        const Blocks::Use use = blocks.next();
        if (use != Blocks::Use::plain && !counting) { CALLGRIND_START_INSTRUMENTATION; }
        if (use == Blocks::Use::plain && counting) { CALLGRIND_STOP_INSTRUMENTATION; }
        counting = use != Blocks::Use::plain;
        CALLGRIND_ZERO_STATS;
        node.step();
        if (use == Blocks::Use::measured) {
            ++measured;
            CALLGRIND_DUMP_STATS_AT("step");
        }
        CALLGRIND_ZERO_STATS;
    }
    lcm_eventlog_destroy(log);
    return steps;
}

/// Bytes of the objects that hold the flight's memory, as JSON (docs/memory.md is made of it).
void print_sizes() {
    using namespace noctule;
    struct Row {
        const char* name;
        std::size_t bytes;
    };
    constexpr std::array<Row, 16> kRows{{{"NavNode", sizeof(NavNode)},
                                         {"Navigator", sizeof(Navigator)},
                                         {"Localiser", sizeof(Localiser)},
                                         {"AltitudeFilter", sizeof(AltitudeFilter)},
                                         {"OccupancyGrid", sizeof(OccupancyGrid)},
                                         {"Mission", sizeof(Mission)},
                                         {"Reference", sizeof(Reference)},
                                         {"Guard", sizeof(Guard)},
                                         {"OutputPredictor", sizeof(OutputPredictor)},
                                         {"SensorFrame", sizeof(SensorFrame)},
                                         {"kMaxImuPerStep", sizeof(SensorFrame::imu)},
                                         {"kMaxAttitudePerStep", sizeof(SensorFrame::attitude)},
                                         {"kMaxVehiclePerStep", sizeof(SensorFrame::vehicle)},
                                         {"kMaxRangePerStep", sizeof(SensorFrame::range_up)},
                                         {"Bridge", sizeof(Bridge)},
                                         {"LcmBus", sizeof(LcmBus)}}};
    std::printf("{");
    for (std::size_t i = 0; i < kRows.size(); ++i) { std::printf("%s\"%s\": %zu", i == 0 ? "" : ", ", kRows[i].name, kRows[i].bytes); }
    std::printf("}\n");
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App options{"noctule-profile: the autonomy over a recorded flight, for counting instructions (`noctule bench instructions`)."};
    std::string log_path;
    std::string parameter_path;
    int every = 100;
    int length = 15;
    bool sizes = false;
    options.add_option("log", log_path, "flight.lcm");
    options.add_flag("--sizes", sizes, "print the bytes of the objects that hold the flight's memory, and end");
    options.add_option("--parameters", parameter_path, "the flight's parameters.toml");
    options.add_option("--every", every, "steps between the beginnings of two measured blocks, on average")->check(CLI::Range(1, 100000))->capture_default_str();
    options.add_option("--length", length, "measured steps of a block")->check(CLI::Range(1, 100000))->capture_default_str();
    CLI11_PARSE(options, argc, argv);
    if (sizes) {
        print_sizes();
        return 0;
    }

    std::array<char, 512> error{};
    if (!parameter_path.empty() && !noctule::load_parameters(parameter_path.c_str(), parameters, error.data(), error.size())) {
        std::fprintf(stderr, "noctule-profile: %s\n", error.data());
        return 2;
    }
    int measured = 0;
    const int steps = run(log_path, Blocks(every, length), measured);
    if (steps < 0) {
        std::fprintf(stderr, "noctule-profile: %s: no LCM log\n", log_path.c_str());
        return 2;
    }
    std::printf("%d steps, %d measured\n", steps, measured);
    return 0;
}
