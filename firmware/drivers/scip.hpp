/// SCIP 2.0, the protocol of Hokuyo lasers: characters, checksums, messages. No clock, no socket, no heap.
///
/// Source: Hokuyo Automatic, "Communication Protocol Specification for SCIP2.0 Standard", C-42-03320B (2006, rev. 2008).
/// A message from the sensor is lines that end in LF, closed by an empty line: the echo of the command, two characters of
/// status with their sum, then what the command asked for. Numbers are 6 bits a character, 0x30 added (section 6).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "core/capacity.hpp"

namespace noctule::scip {

/// The sum that closes a line: lower six bits of the sum of its bytes, plus 0x30 (section 7).
[[nodiscard]] char checksum(std::string_view text);

/// Takes the last character off when it is the sum of those before it. False: too short or wrong; `text` is then as it was.
[[nodiscard]] bool strip_checksum(std::string_view& text);

/// The same for a line of text, where a `;` stands before the sum and belongs to neither (sections 8.11 to 8.13).
[[nodiscard]] bool strip_field_checksum(std::string_view& text);

/// Number of 1 to 4 characters of six bits, greatest first. False: a character outside '0' to 'o'.
[[nodiscard]] bool decode(std::string_view characters, std::uint32_t& value);

/// What a sensor says of itself (PP). Steps are counted anticlockwise seen from above.
struct SensorParameters {
    std::array<char, 48> model{};  ///< zero-terminated, cut
    std::int32_t range_min_mm = 0;
    std::int32_t range_max_mm = 0;
    std::int32_t steps_per_turn = 0;
    std::int32_t first_step = 0;
    std::int32_t last_step = 0;
    std::int32_t front_step = 0;
    std::int32_t turns_per_minute = 0;
};

/// Status of a reply as its two characters; `ok` for "00".
using Status = std::array<char, 2>;
inline constexpr Status kOk{'0', '0'};
inline constexpr Status kScan{'9', '9'};

/// The sensor's clock: 24 bits of milliseconds.
inline constexpr std::uint32_t kClockWrap_ms = 1U << 24U;

/// Distances of one measurement.
struct Measurement {
    std::uint32_t clock_ms = 0;  ///< wraps at kClockWrap_ms
    std::size_t count = 0;
    std::array<std::uint32_t, kMaxBeams> distance_mm{};
};

/// Why a message was not taken.
enum class Fault : std::uint8_t { none, no_status, sum, character, count, field, too_long };

/// A message taken apart: echo and status are checked, `rest` is what follows, lines with their sums.
struct Reply {
    std::string_view echo;
    Status status{};
    std::string_view rest;
};

[[nodiscard]] Fault read_reply(std::string_view message, Reply& reply);

/// The rest of a PP reply. Fault::field: one is missing, no number, or makes no sense.
[[nodiscard]] Fault read_parameters(std::string_view rest, SensorParameters& parameters);

/// The rest of an MD or GD reply (3 characters a distance): the stamp, then blocks of 64 characters.
/// Fault::count: not as many distances as `expected`. `measurement` is whole or not to be used.
[[nodiscard]] Fault read_measurement(std::string_view rest, std::size_t expected, Measurement& measurement);

/// Cuts a byte stream into messages. What is longer than any message is dropped up to the next empty line, and counted.
class MessageCutter {
public:
    /// Calls handle(std::string_view message) for each whole message, without its closing empty line; it holds until the call returns.
    template <class Handler>
    void feed(const std::span<const std::uint8_t> bytes, Handler&& handle) {
        for (const std::uint8_t byte : bytes) {
            const char letter = static_cast<char>(byte);
            if (letter == '\n' && last_ == '\n') {
                if (!overflowed_ && size_ > 1) { handle(std::string_view(buffer_.data(), size_ - 1)); }
                reset();
                continue;
            }
            last_ = letter;
            if (size_ == buffer_.size()) {
                if (!overflowed_) { ++overlong_; }
                overflowed_ = true;
            } else {
                buffer_[size_++] = letter;
            }
        }
    }

    void reset() {
        size_ = 0;
        last_ = '\n';
        overflowed_ = false;
    }

    [[nodiscard]] std::uint32_t overlong() const { return overlong_; }

private:
    std::array<char, 2 * (3 * kMaxBeams + 2 * (3 * kMaxBeams / 64) + 64)> buffer_{};  ///< two scans: where a byte is lost they come as one
    std::size_t size_ = 0;
    char last_ = '\n';  ///< a leading empty line is no message
    bool overflowed_ = false;
    std::uint32_t overlong_ = 0;
};

}  // namespace noctule::scip
