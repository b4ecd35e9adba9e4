// SCIP 2.0 against the specification's own examples, and damaged messages.
#include <string>

#include "drivers/scip.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule::scip {
namespace {

// Examples of C-42-03320B, sections 6 (numbers), 8.11 (VV), 8.12 (PP). The specification's sums of MODL and ARES are misprints:
// those here are computed.
constexpr const char* kParameters =
    "MODL:URG-04LX(Hokuyo Automatic Co., Ltd.);n\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\nAMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n";

int as_int(const Fault fault) { return static_cast<int>(fault); }

std::string line(const std::string& text) { return text + checksum(text) + "\n"; }

void numbers_are_as_the_specification_writes_them() {
    std::uint32_t value = 0;
    TEST_ASSERT_TRUE(decode("CB", value));
    TEST_ASSERT_EQUAL_UINT32(1234U, value);
    TEST_ASSERT_TRUE(decode("1Dh", value));
    TEST_ASSERT_EQUAL_UINT32(5432U, value);
    TEST_ASSERT_TRUE(decode("m2@0", value));
    TEST_ASSERT_EQUAL_UINT32(16000000U, value);
    TEST_ASSERT_TRUE(decode("oooo", value));
    TEST_ASSERT_EQUAL_UINT32(kClockWrap_ms - 1U, value);
    TEST_ASSERT_FALSE(decode("1/h", value));
    TEST_ASSERT_FALSE(decode("1ph", value));
}

void sums_are_as_the_specification_writes_them() {
    TEST_ASSERT_EQUAL_CHAR('P', checksum("00"));
    TEST_ASSERT_EQUAL_CHAR('b', checksum("99"));
    for (const std::string_view example : {"VEND:Hokuyo Automatic Co.,Ltd.;[", "FIRM:3.2.00(28/Aug./2007);f", "PROT:SCIP 2.0;N", "SERI:H0508486;T"}) {
        std::string_view text = example;
        TEST_ASSERT_TRUE(strip_field_checksum(text));
        TEST_ASSERT_EQUAL_size_t(example.size() - 2, text.size());
    }
    std::string_view no_semicolon = "PROT:SCIP 2.0N";
    TEST_ASSERT_FALSE(strip_field_checksum(no_semicolon));
    std::string_view empty;
    TEST_ASSERT_FALSE(strip_checksum(empty));
}

void a_sensor_describes_itself() {
    SensorParameters parameters;
    TEST_ASSERT_EQUAL(as_int(Fault::none), as_int(read_parameters(kParameters, parameters)));
    TEST_ASSERT_EQUAL_STRING("URG-04LX(Hokuyo Automatic Co., Ltd.)", parameters.model.data());
    TEST_ASSERT_EQUAL_INT(20, parameters.range_min_mm);
    TEST_ASSERT_EQUAL_INT(5600, parameters.range_max_mm);
    TEST_ASSERT_EQUAL_INT(1024, parameters.steps_per_turn);
    TEST_ASSERT_EQUAL_INT(44, parameters.first_step);
    TEST_ASSERT_EQUAL_INT(725, parameters.last_step);
    TEST_ASSERT_EQUAL_INT(384, parameters.front_step);
    TEST_ASSERT_EQUAL_INT(600, parameters.turns_per_minute);
}

void a_description_that_is_damaged_changes_nothing() {
    SensorParameters parameters;
    std::string text = kParameters;
    text[text.find("725")] = '9';
    TEST_ASSERT_EQUAL(as_int(Fault::sum), as_int(read_parameters(text, parameters)));
    text = kParameters;
    text.erase(text.find("AFRT"), 11);
    TEST_ASSERT_EQUAL(as_int(Fault::field), as_int(read_parameters(text, parameters)));
    TEST_ASSERT_EQUAL_INT(0, parameters.last_step);
}

/// A measurement of n distances i * 7 mm, blocks of 64 characters.
std::string measurement_text(const std::size_t n) {
    const auto encode = [](const std::uint32_t value, const int characters) {
        std::string text;
        for (int i = characters - 1; i >= 0; --i) { text += static_cast<char>(((value >> (6 * static_cast<std::uint32_t>(i))) & 0x3FU) + 0x30U); }
        return text;
    };
    std::string data;
    for (std::size_t i = 0; i < n; ++i) { data += encode(static_cast<std::uint32_t>(i * 7), 3); }
    std::string text = line(encode(123456, 4));
    for (std::size_t i = 0; i < data.size(); i += 64) { text += line(data.substr(i, 64)); }
    return text;
}

void distances_run_over_the_ends_of_blocks() {
    static Measurement measurement;
    for (const std::size_t n : {1UL, 21UL, 64UL, 682UL, 1081UL}) {  // 64: the last block is whole
        TEST_ASSERT_EQUAL(as_int(Fault::none), as_int(read_measurement(measurement_text(n), n, measurement)));
        TEST_ASSERT_EQUAL_UINT32(123456U, measurement.clock_ms);
        TEST_ASSERT_EQUAL_size_t(n, measurement.count);
        for (std::size_t i = 0; i < n; ++i) { TEST_ASSERT_EQUAL_UINT32(i * 7, measurement.distance_mm[i]); }
    }
}

void every_single_wrong_byte_is_seen() {
    static Measurement measurement;
    const std::string good = measurement_text(64);
    for (std::size_t i = 0; i < good.size(); ++i) {
        for (const char flip : {'\x01', '\x20'}) {
            std::string bad = good;
            bad[i] = static_cast<char>(bad[i] ^ flip);
            if (bad[i] == '\n' && good[i] != '\n') { continue; }
            TEST_ASSERT_NOT_EQUAL(as_int(Fault::none), as_int(read_measurement(bad, 64, measurement)));
        }
    }
}

void what_is_missing_or_too_much_is_seen() {
    static Measurement measurement;
    const std::string good = measurement_text(100);
    for (std::size_t size = 0; size + 1 < good.size(); ++size) {
        TEST_ASSERT_NOT_EQUAL(as_int(Fault::none), as_int(read_measurement(good.substr(0, size), 100, measurement)));
    }
    TEST_ASSERT_EQUAL(as_int(Fault::count), as_int(read_measurement(good, 99, measurement)));
    TEST_ASSERT_EQUAL(as_int(Fault::count), as_int(read_measurement(measurement_text(kMaxBeams + 1), kMaxBeams + 1, measurement)));
}

void messages_are_cut_at_empty_lines() {
    static MessageCutter cutter;
    std::string seen;
    const auto feed = [&](const std::string& text) {
        cutter.feed({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}, [&](const std::string_view message) { seen += std::string(message) + "|"; });
    };
    feed("\n\nQT\n0");
    feed("0P\n");
    TEST_ASSERT_EQUAL_STRING("", seen.c_str());
    feed("\nBM\n00P\n\n");
    TEST_ASSERT_EQUAL_STRING("QT\n00P|BM\n00P|", seen.c_str());
    feed(std::string(20000, 'x') + "\n\nQT\n\n");
    TEST_ASSERT_EQUAL_STRING("QT\n00P|BM\n00P|QT|", seen.c_str());
    TEST_ASSERT_EQUAL_UINT32(1U, cutter.overlong());
}

void a_reply_needs_a_status_with_its_sum() {
    Reply reply;
    TEST_ASSERT_EQUAL(as_int(Fault::none), as_int(read_reply("BM\n02R", reply)));
    TEST_ASSERT_EQUAL_CHAR('2', reply.status[1]);
    TEST_ASSERT_EQUAL(as_int(Fault::sum), as_int(read_reply("BM\n02P", reply)));
    TEST_ASSERT_EQUAL(as_int(Fault::no_status), as_int(read_reply("BM\n", reply)));
}

}  // namespace
}  // namespace noctule::scip

int main() {
    using namespace noctule::scip;
    UNITY_BEGIN();
    RUN_TEST(numbers_are_as_the_specification_writes_them);
    RUN_TEST(sums_are_as_the_specification_writes_them);
    RUN_TEST(a_sensor_describes_itself);
    RUN_TEST(a_description_that_is_damaged_changes_nothing);
    RUN_TEST(distances_run_over_the_ends_of_blocks);
    RUN_TEST(every_single_wrong_byte_is_seen);
    RUN_TEST(what_is_missing_or_too_much_is_seen);
    RUN_TEST(messages_are_cut_at_empty_lines);
    RUN_TEST(a_reply_needs_a_status_with_its_sum);
    return UNITY_END();
}
