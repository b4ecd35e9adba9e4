// Signing: what pymavlink signed is good, what anybody else did is not.
#include <unity.h>

#include <vector>

#include "link/signing.hpp"

using namespace noctule;
using Verdict = Signing::Verdict;

namespace {

// Written by pymavlink 2.4.50 with this key (bytes 0 to 31), system 255, component 190, link 3, timestamp 1000001: a heartbeat of type 6.
const std::vector<std::uint8_t> kSigned{0xFD, 0x09, 0x01, 0x00, 0x00, 0xFF, 0xBE, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x06, 0x08, 0x00, 0x04, 0x03, 0xDA,
                                        0xB0, 0x03, 0x41, 0x42, 0x0F, 0x00, 0x00, 0x00, 0x0C, 0x49, 0x33, 0x2E, 0x31, 0x93};
const std::vector<std::uint8_t> kUnsigned{0xFD, 0x09, 0x00, 0x00, 0x00, 0xFF, 0xBE, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x06, 0x08, 0x00, 0x04, 0x03, 0x3D, 0x48};

std::array<std::uint8_t, 32> key() {
    std::array<std::uint8_t, 32> k{};
    for (std::size_t i = 0; i < k.size(); ++i) { k[i] = static_cast<std::uint8_t>(i); }
    return k;
}

bool reads(const std::span<const std::uint8_t> frame) {
    MavlinkReader reader;
    bool known = false;
    reader.push_datagram(frame, [&](const MavlinkFrame& f) { known = f.known; });
    return known;
}

}  // namespace

extern "C" void setUp() {}
extern "C" void tearDown() {}

static void what_pymavlink_signed_is_good_once() {
    Signing s(key());
    s.set_time(1000000);
    TEST_ASSERT_EQUAL(Verdict::good, s.check(kSigned));
    TEST_ASSERT_EQUAL(Verdict::rejected_replay, s.check(kSigned));
    TEST_ASSERT_EQUAL_UINT64(1000001, s.timestamp());
    const auto plain = s.unsign(kSigned);
    TEST_ASSERT_EQUAL_size_t(kUnsigned.size(), plain.size());
    TEST_ASSERT_EQUAL_MEMORY(kUnsigned.data(), plain.data(), plain.size());
}

static void our_signature_is_the_same_as_pymavlinks() {
    Signing s(key());
    s.set_time(1000000);
    const auto ours = s.sign(kUnsigned, 3);
    TEST_ASSERT_EQUAL_size_t(kSigned.size(), ours.size());
    TEST_ASSERT_EQUAL_MEMORY(kSigned.data(), ours.data(), ours.size());
    TEST_ASSERT_TRUE(reads(ours));
}

static void forged_changed_unsigned_and_old_frames_are_refused() {
    Signing s(key());
    s.set_time(1000000);
    TEST_ASSERT_EQUAL(Verdict::rejected_unsigned, s.check(kUnsigned));
    for (std::size_t i = 4; i < kSigned.size(); ++i) {
        std::vector<std::uint8_t> changed = kSigned;
        changed[i] ^= 0x10;
        TEST_ASSERT_EQUAL(Verdict::rejected_signature, s.check(changed));
    }
    auto other = key();
    other[31] ^= 1;
    Signing stranger(other);
    TEST_ASSERT_EQUAL(Verdict::rejected_signature, stranger.check(kSigned));
    Signing later(key());
    later.set_time(1000001 + 6000001);
    TEST_ASSERT_EQUAL(Verdict::rejected_old, later.check(kSigned));
    TEST_ASSERT_EQUAL_UINT32(1, later.counters().refused);
    TEST_ASSERT_EQUAL_size_t(0, s.sign(kSigned, 1).size());              // signed already
    const std::vector<std::uint8_t> first{0xFE, 0, 0, 1, 1, 0, 0, 0};    // MAVLink 1
    TEST_ASSERT_EQUAL_size_t(0, s.sign(first, 1).size());
}

static void streams_are_told_apart_and_their_number_is_bounded() {
    Signing sender(key());
    Signing s(key());
    std::vector<std::uint8_t> frame = kUnsigned;
    for (std::size_t i = 0; i < kMaxSignedStreams + 1; ++i) {
        const auto out = sender.sign(frame, static_cast<std::uint8_t>(i));
        TEST_ASSERT_EQUAL(i < kMaxSignedStreams ? Verdict::good : Verdict::refused_full, s.check(out));
    }
}

int main() {
    UNITY_BEGIN();
    RUN_TEST(what_pymavlink_signed_is_good_once);
    RUN_TEST(our_signature_is_the_same_as_pymavlinks);
    RUN_TEST(forged_changed_unsigned_and_old_frames_are_refused);
    RUN_TEST(streams_are_told_apart_and_their_number_is_bounded);
    return UNITY_END();
}
