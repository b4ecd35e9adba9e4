/// MAVLink 2 message signing on whole frames: signs what goes out, refuses unsigned, forged and replayed frames that come in.
///
/// The bridge itself knows nothing of it: what comes in is checked and handed on without its signature, what goes out gets one. A signature
/// changes one bit of the header, so the checksum is mended by its linearity, and messages outside the dialect can be signed, too.
/// Timestamps are in 10 us since 2015-01-01 (MAVLink's unit). No heap, no clock.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/bounded.hpp"
#include "link/mavlink.hpp"

namespace noctule {

inline constexpr std::size_t kMaxSignedStreams = 16;

class Signing {
public:
    enum class Verdict : std::uint8_t {
        good,
        rejected_unsigned,
        rejected_signature,  ///< made with another key, or the frame was changed
        rejected_replay,     ///< its timestamp is not newer than the last of its stream
        rejected_old,        ///< first of its stream, and more than a minute behind our clock
        refused_full,        ///< first of its stream, and kMaxSignedStreams are known
    };
    struct Counters {
        std::uint32_t good = 0;
        std::uint32_t refused = 0;
    };

    explicit Signing(const std::array<std::uint8_t, 32>& key) : key_(key) {}

    /// Our clock now; a step back is ignored, and so is one ahead of what signed frames have shown already.
    void set_time(std::uint64_t timestamp) { timestamp_ = timestamp > timestamp_ ? timestamp : timestamp_; }

    /// The frame with a signature of this link. Empty for MAVLink 1 (it cannot be signed). Holds until the next call of sign() or unsign().
    [[nodiscard]] std::span<const std::uint8_t> sign(std::span<const std::uint8_t> frame, std::uint8_t link);

    /// Judges a whole frame and, when it is good, takes note of its timestamp.
    [[nodiscard]] Verdict check(std::span<const std::uint8_t> frame);

    /// The frame without its signature, as one that was never signed. Holds as above.
    [[nodiscard]] std::span<const std::uint8_t> unsign(std::span<const std::uint8_t> frame);

    [[nodiscard]] const Counters& counters() const { return counters_; }
    [[nodiscard]] std::uint64_t timestamp() const { return timestamp_; }

private:
    struct Stream {
        std::uint8_t system = 0;
        std::uint8_t component = 0;
        std::uint8_t link = 0;
        std::uint64_t timestamp = 0;
    };

    [[nodiscard]] std::array<std::uint8_t, 6> signature(std::span<const std::uint8_t> signed_part) const;
    [[nodiscard]] Verdict judge(std::span<const std::uint8_t> frame);

    std::array<std::uint8_t, 32> key_;
    std::uint64_t timestamp_ = 0;
    Bounded<Stream, kMaxSignedStreams> streams_;
    std::array<std::uint8_t, kMaxMavlinkFrame> buffer_{};
    Counters counters_;
};

}  // namespace noctule
