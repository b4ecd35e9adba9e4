#include "link/signing.hpp"

#include <algorithm>
#include <cstring>

namespace noctule {

namespace {

constexpr std::size_t kHeader = 10;
constexpr std::size_t kChecksum = 2;
constexpr std::size_t kSignature = MAVLINK_SIGNATURE_BLOCK_LEN;  // link, six bytes of time, six of the hash
constexpr std::size_t kHash = 6;
constexpr std::uint64_t kMinute = 6000000;                       // in 10 us

bool is_signed(const std::span<const std::uint8_t> frame) { return (frame[2] & MAVLINK_IFLAG_SIGNED) != 0; }

/// Turns the bit "signed" over and mends the checksum. A CRC is linear: it changes by the CRC, begun at zero, of what changed.
void turn_signed_bit(std::uint8_t* frame) {
    frame[2] ^= MAVLINK_IFLAG_SIGNED;
    const std::size_t length = frame[1];
    std::uint16_t change = 0;
    crc_accumulate(MAVLINK_IFLAG_SIGNED, &change);
    for (std::size_t i = 0; i < kHeader - 3 + length + 1; ++i) { crc_accumulate(0, &change); }  // the rest of header and payload, and the extra byte
    frame[kHeader + length] ^= static_cast<std::uint8_t>(change & 0xFFU);
    frame[kHeader + length + 1] ^= static_cast<std::uint8_t>(change >> 8U);
}

std::uint64_t timestamp_of(const std::uint8_t* block) {
    std::uint64_t t = 0;
    for (std::size_t i = 0; i < 6; ++i) { t |= static_cast<std::uint64_t>(block[1 + i]) << (8U * i); }
    return t;
}

}  // namespace

std::array<std::uint8_t, 6> Signing::signature(const std::span<const std::uint8_t> signed_part) const {
    mavlink_sha256_ctx context;
    std::array<std::uint8_t, kHash> out{};
    mavlink_sha256_init(&context);
    mavlink_sha256_update(&context, key_.data(), static_cast<std::uint32_t>(key_.size()));
    mavlink_sha256_update(&context, signed_part.data(), static_cast<std::uint32_t>(signed_part.size()));
    mavlink_sha256_final_48(&context, out.data());
    return out;
}

std::span<const std::uint8_t> Signing::sign(const std::span<const std::uint8_t> frame, const std::uint8_t link) {
    if (frame.size() < kHeader + kChecksum || frame[0] != MAVLINK_STX || is_signed(frame) || frame.size() + kSignature > buffer_.size()) { return {}; }
    std::copy(frame.begin(), frame.end(), buffer_.begin());
    turn_signed_bit(buffer_.data());
    std::uint8_t* block = buffer_.data() + frame.size();
    ++timestamp_;
    block[0] = link;
    for (std::size_t i = 0; i < 6; ++i) { block[1 + i] = static_cast<std::uint8_t>(timestamp_ >> (8U * i) & 0xFFU); }
    const auto hash = signature({buffer_.data(), frame.size() + 7});
    std::copy(hash.begin(), hash.end(), block + 7);
    return {buffer_.data(), frame.size() + kSignature};
}

Signing::Verdict Signing::judge(const std::span<const std::uint8_t> frame) {
    if (frame.size() < kHeader + kChecksum + kSignature || frame[0] != MAVLINK_STX || !is_signed(frame)) { return Verdict::rejected_unsigned; }
    const std::uint8_t* block = frame.data() + frame.size() - kSignature;
    const auto hash = signature(frame.first(frame.size() - kHash));
    std::uint8_t difference = 0;
    for (std::size_t i = 0; i < kHash; ++i) { difference = static_cast<std::uint8_t>(difference | (hash[i] ^ block[7 + i])); }
    if (difference != 0) { return Verdict::rejected_signature; }
    const std::uint64_t timestamp = timestamp_of(block);
    auto* stream = std::find_if(streams_.begin(), streams_.end(), [&](const Stream& s) { return s.system == frame[5] && s.component == frame[6] && s.link == block[0]; });
    if (stream != streams_.end()) {
        if (timestamp <= stream->timestamp) { return Verdict::rejected_replay; }
        stream->timestamp = timestamp;
    } else {
        if (timestamp + kMinute < timestamp_) { return Verdict::rejected_old; }
        if (!streams_.push({frame[5], frame[6], block[0], timestamp})) { return Verdict::refused_full; }
    }
    set_time(timestamp);
    return Verdict::good;
}

Signing::Verdict Signing::check(const std::span<const std::uint8_t> frame) {
    const Verdict verdict = judge(frame);
    ++(verdict == Verdict::good ? counters_.good : counters_.refused);
    return verdict;
}

std::span<const std::uint8_t> Signing::unsign(const std::span<const std::uint8_t> frame) {
    if (frame.size() < kHeader + kChecksum + kSignature || frame.size() > buffer_.size() || frame[0] != MAVLINK_STX || !is_signed(frame)) { return frame; }
    std::copy(frame.begin(), frame.end() - kSignature, buffer_.begin());
    turn_signed_bit(buffer_.data());
    return {buffer_.data(), frame.size() - kSignature};
}

}  // namespace noctule
