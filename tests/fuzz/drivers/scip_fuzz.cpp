/// Bytes of a laser, as they come or broken: what is taken of a message is whole and within its arrays.
#include <string>

#include "drivers/scip.hpp"
#include "fuzz/fuzz.hpp"

namespace noctule::fuzz {

namespace {

constexpr std::size_t kSteps = 64;

std::string summed(const std::string& text) { return text + scip::checksum(text) + "\n"; }

Bytes message(const std::string& text) { return Bytes(text.begin(), text.end()); }

}  // namespace

std::vector<Bytes> seeds() {
    std::string characters;
    for (std::size_t i = 0; i < 3 * kSteps; ++i) { characters += static_cast<char>(0x30 + i % 64); }
    std::string scan = "MD0000006301000\n" + summed("99") + summed("00A@");
    for (std::size_t at = 0; at < characters.size(); at += 64) { scan += summed(characters.substr(at, 64)); }
    std::string about = "PP\n" + summed("00");
    for (const std::string field : {"MODL:UST-10LX", "DMIN:20", "DMAX:30000", "ARES:1440", "AMIN:0", "AMAX:1080", "AFRT:540", "SCAN:2400"}) {
        about += field + ";" + scip::checksum(field) + "\n";
    }
    return {message(scan + "\n"), message(about + "\n"), message("BM\n" + summed("00") + "\n" + scan + "\n" + scan + "\n"), message("QT\n" + summed("00") + "\n")};
}

}  // namespace noctule::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* const data, const std::size_t size) {
    using namespace noctule;
    static scip::MessageCutter cutter;
    static scip::Measurement measurement;
    cutter.reset();
    std::size_t seen = 0;
    cutter.feed({data, size}, [&](const std::string_view text) {
        seen += text.size();
        HOLDS(text.find("\n\n") == std::string_view::npos);
        scip::Reply reply;
        if (scip::read_reply(text, reply) != scip::Fault::none) { return; }
        HOLDS(reply.echo.size() + reply.rest.size() <= text.size());
        scip::SensorParameters parameters;
        if (scip::read_parameters(reply.rest, parameters) == scip::Fault::none) {
            HOLDS(parameters.model.back() == '\0' && parameters.steps_per_turn > 0 && parameters.first_step <= parameters.last_step);
        }
        for (const std::size_t expected : {fuzz::kSteps, std::size_t{1081}, kMaxBeams, kMaxBeams + 1}) {
            if (scip::read_measurement(reply.rest, expected, measurement) != scip::Fault::none) { continue; }
            HOLDS(measurement.count == expected && expected <= kMaxBeams);
            HOLDS(std::all_of(measurement.distance_mm.begin(), measurement.distance_mm.begin() + static_cast<std::ptrdiff_t>(expected), [](const std::uint32_t d) { return d < (1U << 18U); }));
        }
    });
    HOLDS(seen <= size);
    return 0;
}
