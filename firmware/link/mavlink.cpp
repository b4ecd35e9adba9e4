#include "link/mavlink.hpp"

namespace noctule {

namespace {

constexpr std::size_t kChecksumBytes = 2;
constexpr std::size_t kHeader1 = 6;   // MAVLink 1: start, length, sequence, system, component, message
constexpr std::size_t kHeader2 = 10;  // MAVLink 2: two flag bytes and a message id of three bytes more

std::uint32_t message_id(const std::uint8_t* frame, const std::size_t header) {
    if (header == kHeader1) { return frame[5]; }
    return static_cast<std::uint32_t>(frame[7]) | static_cast<std::uint32_t>(frame[8]) << 8U | static_cast<std::uint32_t>(frame[9]) << 16U;
}

bool checksum_holds(const std::uint8_t* frame, const std::size_t header, const std::size_t length, const std::uint8_t extra) {
    std::uint16_t crc = crc_calculate(frame + 1, static_cast<std::uint16_t>(header - 1 + length));
    crc_accumulate(extra, &crc);
    const std::uint8_t* tail = frame + header + length;
    return tail[0] == (crc & 0xFFU) && tail[1] == (crc >> 8U);
}

}  // namespace

std::span<const std::uint8_t> with_sequence(const MavlinkFrame& frame, const std::uint8_t sequence, std::array<std::uint8_t, kMaxMavlinkFrame>& buffer) {
    const bool second = frame.bytes[0] == MAVLINK_STX;
    if (second && (frame.bytes[2] & MAVLINK_IFLAG_SIGNED) != 0) { return frame.bytes; }
    const std::size_t at = second ? 4 : 2;
    const std::size_t crc_at = (second ? kHeader2 : kHeader1) + frame.bytes[1];
    std::memcpy(buffer.data(), frame.bytes.data(), frame.bytes.size());
    // The CRC is linear: that of the difference, begun with zero, is the difference of the two. The extra byte at the end has none.
    std::uint16_t difference = 0;
    crc_accumulate(static_cast<std::uint8_t>(buffer[at] ^ sequence), &difference);
    for (std::size_t rest = crc_at - at; rest > 0; --rest) { crc_accumulate(0, &difference); }
    buffer[at] = sequence;
    buffer[crc_at] = static_cast<std::uint8_t>(buffer[crc_at] ^ (difference & 0xFFU));
    buffer[crc_at + 1] = static_cast<std::uint8_t>(buffer[crc_at + 1] ^ (difference >> 8U));
    return {buffer.data(), frame.bytes.size()};
}

bool MavlinkReader::next(std::size_t& begin) {
    while (begin < used_) {
        const std::uint8_t* bytes = buffer_.data() + begin;
        const std::size_t left = used_ - begin;
        const bool second = bytes[0] == MAVLINK_STX;
        if (!second && bytes[0] != MAVLINK_STX_MAVLINK1) {
            ++begin;
            ++counters_.skipped_bytes;
            continue;
        }
        const std::size_t header = second ? kHeader2 : kHeader1;
        if (left < header) { return false; }
        // Flags that we do not know may change the frame's length: not ours to read.
        const std::uint8_t flags = second ? bytes[2] : std::uint8_t{0};
        const std::size_t length = bytes[1];
        const std::size_t signature = (flags & MAVLINK_IFLAG_SIGNED) != 0 ? std::size_t{MAVLINK_SIGNATURE_BLOCK_LEN} : 0;
        const std::size_t total = header + length + kChecksumBytes + signature;
        const bool flags_known = (flags & ~MAVLINK_IFLAG_MASK) == 0;
        if (flags_known && left < total) { return false; }
        const mavlink_msg_entry_t* entry = flags_known ? mavlink_get_msg_entry(message_id(bytes, header)) : nullptr;
        const bool good = entry != nullptr && checksum_holds(bytes, header, length, entry->crc_extra);
        // A start byte inside garbage would swallow what follows it: a frame that cannot be checked must end where the bytes
        // end or where another frame starts.
        const bool ends_well = left == total || (left > total && (bytes[total] == MAVLINK_STX || bytes[total] == MAVLINK_STX_MAVLINK1));
        if (!flags_known || (entry != nullptr && !good) || (entry == nullptr && !ends_well)) {
            ++begin;
            ++counters_.skipped_bytes;
            ++counters_.bad_checksum;
            continue;
        }
        fill(bytes, header, length, total);
        frame_.known = good;
        frame_.target = {};
        if (good) {
            ++counters_.frames;
            const auto* payload = reinterpret_cast<const std::uint8_t*>(frame_.message.payload64);
            if ((entry->flags & MAV_MSG_ENTRY_FLAG_HAVE_TARGET_SYSTEM) != 0) { frame_.target.system = payload[entry->target_system_ofs]; }
            if ((entry->flags & MAV_MSG_ENTRY_FLAG_HAVE_TARGET_COMPONENT) != 0) { frame_.target.component = payload[entry->target_component_ofs]; }
        } else {
            ++counters_.unknown;
        }
        return true;
    }
    return false;
}

void MavlinkReader::fill(const std::uint8_t* bytes, const std::size_t header, const std::size_t length, const std::size_t total) {
    const bool second = header == kHeader2;
    mavlink_message_t& m = frame_.message;
    m.magic = bytes[0];
    m.len = static_cast<std::uint8_t>(length);
    m.incompat_flags = second ? bytes[2] : std::uint8_t{0};
    m.compat_flags = second ? bytes[3] : std::uint8_t{0};
    m.seq = bytes[second ? 4 : 2];
    m.sysid = bytes[second ? 5 : 3];
    m.compid = bytes[second ? 6 : 4];
    m.msgid = message_id(bytes, header) & 0xFFFFFFU;
    // A sender drops trailing zeros: what is missing is zero. The array is one word longer than any payload.
    std::memset(m.payload64, 0, sizeof m.payload64);
    std::memcpy(m.payload64, bytes + header, length);
    frame_.bytes = {bytes, total};
}

}  // namespace noctule
