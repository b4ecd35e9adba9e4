/// noctule-profile: the autonomy over a recorded flight, for counting instructions with callgrind.
///
/// Run by `noctule bench instructions` under `valgrind --tool=callgrind --instr-atstart=no --toggle-collect=...`. Instrumentation is
/// on for blocks of steps only, drawn with a fixed seed; each step of a block makes one dump. Without callgrind it just runs.
#include <algorithm>
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

/// Greatest use of the pools over the steps of a flight, by the names of core/capacity.hpp.
class PoolUse {
public:
    void look(const noctule::Navigator& nav) {
        const noctule::Localiser& localiser = nav.localiser();
        const noctule::Explorer& explorer = nav.mission().explorer();
        const noctule::Survey& survey = explorer.survey();
        const noctule::FloorPlanner& floors = nav.mission().floors();
        note(0, "kMaxTiles", static_cast<std::size_t>(nav.grid().tile_count()));
        note(1, "kMaxTouchedTiles", nav.grid().touched_tiles());
        note(2, "kFloorSlots", floors.floors().size());
        note(3, "kMaxFieldTiles", std::max(survey.costs().tiles(), explorer.field().tiles()));
        note(4, "kMaxOpenCells", survey.open().used());
        note(5, "kMaxFrontierCells", survey.search().cells());
        note(6, "kMaxFrontiers", survey.search().found().size());
        note(7, "kMaxStops", explorer.tour().stops() + 1U);
        note(8, "kMaxTriedPlaces", survey.tried().size());
        note(9, "kMaxTrailNodes", nav.mission().trail().size());
        note(10, "kMaxDirtyBlocks", explorer.where().blocks_waiting());
        note(11, "kMaxVerticalCells", floors.vertical().size());
        note(12, "kMaxOpenings", floors.judged().size());
        note(13, "kMaxLevels", nav.altitude().levels().size());
        note(14, "kMaxWallsPerScan", localiser.extractor().walls().size());
        note(15, "kMaxLandmarks", static_cast<std::size_t>(localiser.filter().best_landmarks()));
        note(16, "kMaxPointCells", localiser.points().size());
        note(17, "kMaxScanCells", localiser.tracker().map().cells());
        note(18, "kMaxKeyframes", localiser.tracker().frames().size());
    }
    void print() const {
        std::printf("{");
        for (std::size_t i = 0; i < rows_.size(); ++i) { std::printf("%s\"%s\": %zu", i == 0 ? "" : ", ", rows_[i].name, rows_[i].most); }
        std::printf("}\n");
    }

private:
    struct Row {
        const char* name = "";
        std::size_t most = 0;
    };
    void note(const std::size_t row, const char* const name, const std::size_t used) { rows_[row] = {name, std::max(rows_[row].most, used)}; }
    std::array<Row, 19> rows_{};
};

/// Steps run; negative: the log cannot be opened.
int run(const std::string& log_path, Blocks blocks, int& measured, PoolUse& use) {
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
        const Blocks::Use part = blocks.next();
        if (part != Blocks::Use::plain && !counting) { CALLGRIND_START_INSTRUMENTATION; }
        if (part == Blocks::Use::plain && counting) { CALLGRIND_STOP_INSTRUMENTATION; }
        counting = part != Blocks::Use::plain;
        CALLGRIND_ZERO_STATS;
        node.step();
        use.look(node.navigator());
        if (part == Blocks::Use::measured) {
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
    constexpr std::size_t kFields = 3U;   // two of the explorer, one of the survey
    constexpr std::array<Row, 31> kRows{{{"NavNode", sizeof(NavNode)},
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
                                         {"kMaxTiles", sizeof(GridTile) * kMaxTiles},
                                         {"kMaxTouchedTiles", sizeof(GridTile::camera) * kMaxTouchedTiles},
                                         {"kMaxFieldTiles", kFields * sizeof(CostField) + sizeof(RootGraph)},
                                         {"kMaxOpenCells", 2U * sizeof(OpenCells)},
                                         {"kMaxFrontierCells", sizeof(CellId) * kMaxFrontierCells},
                                         {"kMaxFrontiers", sizeof(Bounded<Frontier, kMaxFrontiers>)},
                                         {"kMaxStops", sizeof(Tour)},
                                         {"kMaxTrailNodes", sizeof(Trail)},
                                         {"kMaxDirtyBlocks", sizeof(std::int32_t) * kMaxDirtyBlocks},
                                         {"kMaxVerticalCells", sizeof(VerticalMap)},
                                         {"kMaxParticles", sizeof(WallFilter)},
                                         {"kMaxPointCells", sizeof(PointMap) * (kFloorSlots + 1U)},
                                         {"kMaxScanCells", sizeof(ScanMap)},
                                         {"kMaxKeyframes", sizeof(Keyframes)},
                                         {"kMaxBeams", sizeof(LevelScan) + sizeof(WallExtractor) + sizeof(Leveller)},
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
    bool pools = false;
    options.add_option("log", log_path, "flight.lcm");
    options.add_flag("--sizes", sizes, "print the bytes of the objects that hold the flight's memory, and end");
    options.add_flag("--pools", pools, "print the greatest use of each pool in the flight, as JSON");
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
    PoolUse use;
    const int steps = run(log_path, Blocks(every, length), measured, use);
    if (steps < 0) {
        std::fprintf(stderr, "noctule-profile: %s: no LCM log\n", log_path.c_str());
        return 2;
    }
    if (pools) {
        use.print();
    } else {
        std::printf("%d steps, %d measured\n", steps, measured);
    }
    return 0;
}
