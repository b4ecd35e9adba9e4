#include "drivers/scip.hpp"

#include <algorithm>
#include <charconv>
#include <system_error>
#include <utility>

namespace noctule::scip {

namespace {

constexpr char kZero = 0x30;  ///< added to each six bits
constexpr std::size_t kBlock = 64;
constexpr std::size_t kCharactersPerDistance = 3;

/// The next line without its LF; empty when nothing is left.
std::string_view next_line(std::string_view& text) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    return line;
}

/// Decodes what has gathered; up to two characters wait for their third in the next block.
Fault take_distances(std::string_view block, std::array<char, kCharactersPerDistance>& waiting, std::size_t& waits, Measurement& measurement) {
    for (const char letter : block) {
        waiting[waits++] = letter;
        if (waits < kCharactersPerDistance) { continue; }
        waits = 0;
        if (measurement.count == measurement.distance_mm.size()) { return Fault::count; }
        if (!decode({waiting.data(), waiting.size()}, measurement.distance_mm[measurement.count])) { return Fault::character; }
        ++measurement.count;
    }
    return Fault::none;
}

bool number(std::string_view text, std::int32_t& value) {
    while (!text.empty() && text.front() == ' ') { text.remove_prefix(1); }
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    return error == std::errc{} && end == text.data() + text.size();
}

}  // namespace

char checksum(const std::string_view text) {
    std::uint32_t sum = 0;
    for (const char letter : text) { sum += static_cast<std::uint8_t>(letter); }
    return static_cast<char>((sum & 0x3FU) + kZero);
}

bool strip_checksum(std::string_view& text) {
    if (text.size() < 2 || checksum(text.substr(0, text.size() - 1)) != text.back()) { return false; }
    text.remove_suffix(1);
    return true;
}

bool strip_field_checksum(std::string_view& text) {
    if (text.size() < 3 || text[text.size() - 2] != ';' || checksum(text.substr(0, text.size() - 2)) != text.back()) { return false; }
    text.remove_suffix(2);
    return true;
}

bool decode(const std::string_view characters, std::uint32_t& value) {
    value = 0;
    for (const char letter : characters) {
        if (letter < kZero || letter >= kZero + 64) { return false; }
        value = (value << 6U) | static_cast<std::uint32_t>(letter - kZero);
    }
    return true;
}

Fault read_reply(std::string_view message, Reply& reply) {
    reply.echo = next_line(message);
    std::string_view status = next_line(message);
    if (status.size() != 3) { return Fault::no_status; }
    if (!strip_checksum(status) || status.size() != 2) { return Fault::sum; }
    reply.status = {status[0], status[1]};
    reply.rest = message;
    return Fault::none;
}

Fault read_parameters(std::string_view rest, SensorParameters& parameters) {
    SensorParameters read;
    const std::array<std::pair<std::string_view, std::int32_t*>, 7> fields{{{"DMIN:", &read.range_min_mm},
                                                                            {"DMAX:", &read.range_max_mm},
                                                                            {"ARES:", &read.steps_per_turn},
                                                                            {"AMIN:", &read.first_step},
                                                                            {"AMAX:", &read.last_step},
                                                                            {"AFRT:", &read.front_step},
                                                                            {"SCAN:", &read.turns_per_minute}}};
    std::uint32_t seen = 0;
    while (!rest.empty()) {
        std::string_view line = next_line(rest);
        if (!strip_field_checksum(line)) { return Fault::sum; }
        if (line.starts_with("MODL:")) {
            line.remove_prefix(5);
            std::copy_n(line.begin(), std::min(line.size(), read.model.size() - 1), read.model.begin());
        }
        for (std::size_t i = 0; i < fields.size(); ++i) {
            if (!line.starts_with(fields[i].first)) { continue; }
            if (!number(line.substr(fields[i].first.size()), *fields[i].second)) { return Fault::field; }
            seen |= 1U << i;
        }
    }
    const bool all = seen == (1U << fields.size()) - 1U;
    const bool sensible = read.range_min_mm >= 0 && read.range_max_mm > read.range_min_mm && read.steps_per_turn > 0 && read.first_step >= 0 &&
                          read.last_step > read.first_step && read.last_step < 10000 && read.turns_per_minute > 0;
    if (!all || !sensible) { return Fault::field; }
    parameters = read;
    return Fault::none;
}

Fault read_measurement(std::string_view rest, const std::size_t expected, Measurement& measurement) {
    std::string_view stamp = next_line(rest);
    if (!strip_checksum(stamp)) { return Fault::sum; }
    if (stamp.size() != 4) { return Fault::field; }
    if (!decode(stamp, measurement.clock_ms)) { return Fault::character; }
    measurement.count = 0;
    std::array<char, kCharactersPerDistance> waiting{};
    std::size_t waits = 0;
    while (!rest.empty()) {
        std::string_view block = next_line(rest);
        if (block.size() > kBlock + 1) { return Fault::too_long; }
        if (!strip_checksum(block)) { return Fault::sum; }
        if (const Fault fault = take_distances(block, waiting, waits, measurement); fault != Fault::none) { return fault; }
    }
    return waits == 0 && measurement.count == expected ? Fault::none : Fault::count;
}

}  // namespace noctule::scip
