/// The generated MAVLink 2 headers (dialect common), and framing on spans of bytes.
///
/// Nothing here uses the per-channel statics of the generated headers: a reader and a writer own their state, so any number of
/// links can run side by side. No heap, no clock. A frame whose message is not in the dialect is reported as unknown (it can be
/// passed on, not read); one whose checksum is wrong is skipped from its second byte on, so that a start byte inside garbage
/// costs nothing but itself.
#pragma once

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Waddress-of-packed-member"
#include <common/mavlink.h>
#pragma GCC diagnostic pop

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>

namespace noctule {

// The generated `..._get_...` functions read words where they lie, and they lie anywhere in the packed message: use `..._decode`.
inline constexpr std::size_t kMaxMavlinkFrame = MAVLINK_MAX_PACKET_LEN;  ///< bytes of the longest frame, signature included

/// Where a message of this frame wants to go. 0: everybody.
struct MavlinkTarget {
    std::uint8_t system = 0;
    std::uint8_t component = 0;
};

/// One frame as it came in.
struct MavlinkFrame {
    mavlink_message_t message{};              ///< payload zero-filled to its full length; valid when `known`
    bool known = false;                       ///< in the dialect and the checksum holds
    MavlinkTarget target;
    std::span<const std::uint8_t> bytes;      ///< the frame as received; holds until the handler returns
};

/// The frame as it came, with another sequence number, in `buffer`. The checksum follows from the old one, so that messages outside the dialect
/// can be numbered, too. A signed frame is handed back as it is.
[[nodiscard]] std::span<const std::uint8_t> with_sequence(const MavlinkFrame& frame, std::uint8_t sequence, std::array<std::uint8_t, kMaxMavlinkFrame>& buffer);

class MavlinkReader {
public:
    struct Counters {
        std::uint64_t frames = 0;         ///< good ones, known
        std::uint64_t unknown = 0;        ///< message not in the dialect: checksum cannot be told
        std::uint64_t bad_checksum = 0;
        std::uint64_t skipped_bytes = 0;  ///< bytes that belong to no frame
    };

    /// Takes bytes in, calls on_frame(const MavlinkFrame&) for every complete frame. Frames may be cut anywhere between calls.
    template <class OnFrame>
    void push(std::span<const std::uint8_t> bytes, OnFrame&& on_frame) {
        while (!bytes.empty()) {
            const std::size_t room = buffer_.size() - used_;
            const std::size_t taken = bytes.size() < room ? bytes.size() : room;
            std::memcpy(buffer_.data() + used_, bytes.data(), taken);
            used_ += taken;
            bytes = bytes.subspan(taken);
            scan(on_frame);
        }
    }

    /// The same for a datagram link, where a frame never spans two datagrams: what looks like a cut frame at the end is garbage,
    /// and is searched for whole frames.
    template <class OnFrame>
    void push_datagram(const std::span<const std::uint8_t> bytes, OnFrame&& on_frame) {
        push(bytes, on_frame);
        while (used_ > 0) {
            ++counters_.skipped_bytes;
            std::memmove(buffer_.data(), buffer_.data() + 1, --used_);
            scan(on_frame);
        }
    }

    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    /// Hands out the whole frames in the buffer, keeps what follows them.
    template <class OnFrame>
    void scan(OnFrame& on_frame) {
        std::size_t begin = 0;
        while (next(begin)) {
            on_frame(static_cast<const MavlinkFrame&>(frame_));
            begin += frame_.bytes.size();
        }
        std::memmove(buffer_.data(), buffer_.data() + begin, used_ - begin);
        used_ -= begin;
    }

    /// Finds the next whole frame at or after begin, and moves begin to it. False: more bytes are needed.
    [[nodiscard]] bool next(std::size_t& begin);
    void fill(const std::uint8_t* bytes, std::size_t header, std::size_t length, std::size_t total);

    std::array<std::uint8_t, 2 * kMaxMavlinkFrame> buffer_{};
    std::size_t used_ = 0;
    MavlinkFrame frame_;
    Counters counters_{};
};

/// Our side of one link: sender's ids and sequence number.
class MavlinkWriter {
public:
    void set_ids(const std::uint8_t system, const std::uint8_t component) {
        system_ = system;
        component_ = component;
    }

    [[nodiscard]] std::uint8_t system() const { return system_; }
    [[nodiscard]] std::uint8_t component() const { return component_; }

    /// Bytes of one message, packed by a generated `..._encode_status` function:
    /// writer.pack(mavlink_msg_heartbeat_encode_status, heartbeat). They hold until the next pack().
    template <class Payload>
    [[nodiscard]] std::span<const std::uint8_t> pack(std::uint16_t (*encode)(std::uint8_t, std::uint8_t, mavlink_status_t*, mavlink_message_t*, const Payload*),
                                                     const Payload& payload) {
        encode(system_, component_, &status_, &message_, &payload);
        return {buffer_.data(), mavlink_msg_to_send_buffer(buffer_.data(), &message_)};
    }

private:
    std::uint8_t system_ = 1;
    std::uint8_t component_ = 1;
    mavlink_status_t status_{};
    mavlink_message_t message_{};
    std::array<std::uint8_t, kMaxMavlinkFrame> buffer_{};
};

}  // namespace noctule
