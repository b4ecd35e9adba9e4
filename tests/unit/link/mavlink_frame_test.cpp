// Framing on hostile bytes: garbage, cuts anywhere, wrong checksums, unknown messages.
#include <unity.h>

#include <cstdint>
#include <random>
#include <span>
#include <vector>

#include "link/mavlink.hpp"

using namespace noctule;

namespace {

using Bytes = std::vector<std::uint8_t>;

Bytes heartbeat(MavlinkWriter& writer, const std::uint32_t custom_mode) {
    mavlink_heartbeat_t m{};
    m.custom_mode = custom_mode;
    m.type = MAV_TYPE_QUADROTOR;
    const auto bytes = writer.pack(mavlink_msg_heartbeat_encode_status, m);
    return {bytes.begin(), bytes.end()};
}

bool is_heartbeat(const MavlinkFrame& f, std::uint32_t& custom_mode) {
    if (!f.known || f.message.msgid != MAVLINK_MSG_ID_HEARTBEAT) { return false; }
    mavlink_heartbeat_t m{};
    mavlink_msg_heartbeat_decode(&f.message, &m);
    custom_mode = m.custom_mode;
    return true;
}

std::vector<std::uint32_t> modes_in(MavlinkReader& reader, const std::span<const std::uint8_t> bytes) {
    std::vector<std::uint32_t> modes;
    reader.push(bytes, [&](const MavlinkFrame& f) {
        std::uint32_t mode = 0;
        if (is_heartbeat(f, mode)) { modes.push_back(mode); }
    });
    return modes;
}

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void a_frame_cut_at_any_byte_is_put_together_again() {
    MavlinkWriter writer;
    const Bytes frame = heartbeat(writer, 0xABCD1234U);
    for (std::size_t cut = 0; cut <= frame.size(); ++cut) {
        MavlinkReader reader;
        auto modes = modes_in(reader, std::span(frame).first(cut));
        for (const std::uint32_t mode : modes_in(reader, std::span(frame).subspan(cut))) { modes.push_back(mode); }
        TEST_ASSERT_EQUAL_size_t(1, modes.size());
        TEST_ASSERT_EQUAL_HEX32(0xABCD1234U, modes[0]);
    }
}

static void a_start_byte_inside_garbage_costs_no_good_frame() {
    std::mt19937 random{3};
    std::uniform_int_distribution<int> byte{0, 255};
    MavlinkWriter writer;
    MavlinkReader reader;
    std::uint32_t seen = 0;
    for (std::uint32_t i = 0; i < 500; ++i) {
        Bytes datagram;
        for (int k = byte(random) % 40; k > 0; --k) { datagram.push_back(k % 7 == 0 ? std::uint8_t{0xFD} : static_cast<std::uint8_t>(byte(random))); }
        const Bytes frame = heartbeat(writer, i);
        datagram.insert(datagram.end(), frame.begin(), frame.end());
        datagram.insert(datagram.end(), frame.begin(), frame.end());
        reader.push_datagram(datagram, [&](const MavlinkFrame& f) {
            std::uint32_t mode = 0;
            if (is_heartbeat(f, mode) && mode == i) { ++seen; }
        });
    }
    // Garbage that looks like a whole frame of a message we do not know, and ends where a frame starts, is believed. Rare.
    TEST_ASSERT_GREATER_THAN_UINT32(995U, seen);
}

static void every_flipped_bit_is_noticed() {
    MavlinkWriter writer;
    const Bytes good = heartbeat(writer, 5);
    for (std::size_t i = 1; i < good.size(); ++i) {
        for (unsigned bit = 0; bit < 8; ++bit) {
            Bytes bad = good;
            bad[i] = static_cast<std::uint8_t>(bad[i] ^ (1U << bit));
            MavlinkReader reader;
            reader.push(bad, [](const MavlinkFrame& f) { TEST_ASSERT_FALSE(f.known); });
        }
    }
}

static void an_unknown_message_is_passed_whole_and_marked() {
    Bytes frame{0xFD, 3, 0, 0, 9, 1, 1, 0x30, 0x2C, 0x00, 1, 2, 3, 0xAA, 0xBB};  // id 11312: not in the dialect
    MavlinkReader reader;
    int unknown = 0;
    reader.push(frame, [&](const MavlinkFrame& f) {
        TEST_ASSERT_FALSE(f.known);
        TEST_ASSERT_EQUAL_size_t(frame.size(), f.bytes.size());
        TEST_ASSERT_EQUAL_MEMORY(frame.data(), f.bytes.data(), frame.size());
        ++unknown;
    });
    TEST_ASSERT_EQUAL_INT(1, unknown);
}

/// A frame of either version with the checksum of this extra byte.
Bytes framed(const bool second, const std::uint8_t sequence, const std::uint32_t msgid, const std::uint8_t extra, const Bytes& payload) {
    Bytes frame = second ? Bytes{0xFD, 0, 0, 0, sequence, 1, 1, 0, 0, 0} : Bytes{0xFE, 0, sequence, 1, 1, 0};
    frame[1] = static_cast<std::uint8_t>(payload.size());
    frame[second ? 7 : 5] = static_cast<std::uint8_t>(msgid);
    if (second) { frame[8] = static_cast<std::uint8_t>(msgid >> 8U); }
    frame.insert(frame.end(), payload.begin(), payload.end());
    std::uint16_t crc = crc_calculate(frame.data() + 1, static_cast<std::uint16_t>(frame.size() - 1));
    crc_accumulate(extra, &crc);
    frame.push_back(static_cast<std::uint8_t>(crc & 0xFFU));
    frame.push_back(static_cast<std::uint8_t>(crc >> 8U));
    return frame;
}

static void a_frame_numbered_anew_has_the_checksum_of_its_new_number() {
    std::array<std::uint8_t, kMaxMavlinkFrame> buffer{};
    const Bytes payload{1, 2, 3, 250, 0, 7, 9, 4, 3};
    for (const bool second : {false, true}) {
        for (const std::uint32_t msgid : {0U, second ? 11312U : 193U}) {       // HEARTBEAT, and one that is not in the dialect
            for (const std::uint8_t extra : {std::uint8_t{50}, std::uint8_t{71}}) {
                if (msgid == 0 && extra != 50) { continue; }
                const Bytes frame = framed(second, 9, msgid, extra, payload);
                const Bytes expected = framed(second, 201, msgid, extra, payload);
                MavlinkReader reader;
                int seen = 0;
                reader.push(frame, [&](const MavlinkFrame& f) {
                    const auto out = with_sequence(f, 201, buffer);
                    TEST_ASSERT_EQUAL_size_t(expected.size(), out.size());
                    TEST_ASSERT_EQUAL_MEMORY(expected.data(), out.data(), expected.size());
                    ++seen;
                });
                TEST_ASSERT_EQUAL_INT(1, seen);
            }
        }
    }
    Bytes sealed = framed(true, 9, 0, 50, payload);
    sealed[2] = MAVLINK_IFLAG_SIGNED;
    sealed.resize(sealed.size() + MAVLINK_SIGNATURE_BLOCK_LEN);
    MavlinkFrame signed_frame;
    signed_frame.bytes = sealed;
    TEST_ASSERT_TRUE(with_sequence(signed_frame, 201, buffer).data() == sealed.data());
}

static void dropped_zeros_at_the_end_are_read_as_zeros() {
    MavlinkWriter writer;
    MavlinkReader reader;
    mavlink_command_long_t in{};
    in.command = MAV_CMD_MISSION_START;
    in.target_system = 7;
    in.target_component = 191;
    in.param7 = 0.0F;
    mavlink_command_long_t full = in;
    full.param7 = 9.0F;
    reader.push(writer.pack(mavlink_msg_command_long_encode_status, full), [](const MavlinkFrame&) {});
    int seen = 0;
    reader.push(writer.pack(mavlink_msg_command_long_encode_status, in), [&](const MavlinkFrame& f) {
        mavlink_command_long_t out{};
        mavlink_msg_command_long_decode(&f.message, &out);
        TEST_ASSERT_EQUAL_FLOAT(0.0F, out.param7);
        TEST_ASSERT_EQUAL_UINT8(7, f.target.system);
        TEST_ASSERT_EQUAL_UINT8(191, f.target.component);
        ++seen;
    });
    TEST_ASSERT_EQUAL_INT(1, seen);
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_frame_cut_at_any_byte_is_put_together_again);
    RUN_TEST(a_start_byte_inside_garbage_costs_no_good_frame);
    RUN_TEST(every_flipped_bit_is_noticed);
    RUN_TEST(an_unknown_message_is_passed_whole_and_marked);
    RUN_TEST(a_frame_numbered_anew_has_the_checksum_of_its_new_number);
    RUN_TEST(dropped_zeros_at_the_end_are_read_as_zeros);
    return UNITY_END();
}
