// Stamps of a laser on the autopilot's clock: delays, drift, wrap, clocks set anew.
#include <cmath>
#include <cstdlib>
#include <random>

#include "drivers/scan_stamper.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

constexpr std::int64_t kHostAtAutopilotZero_us = 987654321;

struct NoSink final : HokuyoSink {
    void send(std::string_view /*command*/) override {}
    void scan(const scip::Measurement& /*measurement*/, std::int64_t /*sensor_us*/, std::int64_t /*arrival_us*/) override {}
};

void finds_the_offset_through_jitter_and_drift() {
    SensorClock clock;
    std::minstd_rand random(7);
    std::exponential_distribution<double> delay_us(1.0 / 3000.0);
    std::int64_t worst_us = 0;
    for (int i = 0; i < 60 * 250; ++i) {
        const std::int64_t source_us = 4000 * i;
        const std::int64_t true_host_us = kHostAtAutopilotZero_us + source_us + source_us / 20000;  // 50 ppm
        clock.add(source_us, true_host_us + static_cast<std::int64_t>(delay_us(random)));
        if (i > 250) { worst_us = std::max(worst_us, std::abs(clock.to_host_us(source_us) - true_host_us)); }
    }
    TEST_ASSERT_LESS_THAN_INT64(700, worst_us);
    TEST_ASSERT_EQUAL_UINT32(0U, clock.restarts());
}

void one_wild_stamp_is_no_new_clock_but_five_are() {
    SensorClock clock;
    for (int i = 0; i < 100; ++i) { clock.add(4000 * i, 4000 * i + 500); }
    clock.add(99000000, 404000);
    TEST_ASSERT_EQUAL_INT64(500, clock.to_host_us(0));
    for (int i = 0; i < 5; ++i) { clock.add(4000 * i, 500000 + 2000000 + 4000 * i); }  // the autopilot started anew
    TEST_ASSERT_EQUAL_INT64(2500000, clock.to_host_us(0));
    TEST_ASSERT_EQUAL_UINT32(1U, clock.restarts());
    TEST_ASSERT_TRUE(clock.valid(2600000));
    TEST_ASSERT_FALSE(clock.valid(9600000));
}

/// A sensor that has described itself as a UST-10LX.
Hokuyo& sensor() {
    static NoSink sink;
    static Hokuyo hokuyo(sink);
    const std::string_view text =
        "PP\n00P\nMODL:UST-10LX;D\nDMIN:20;4\nDMAX:30000;G\nARES:1440;^\nAMIN:0;?\nAMAX:1080;Z\nAFRT:540;0\nSCAN:2400;U\n\nBM\n00P\n\n";
    hokuyo.connected(0);
    hokuyo.tick(600000);
    hokuyo.tick(1200000);
    hokuyo.receive({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}, 1300000);
    return hokuyo;
}

void codes_are_not_distances() {
    Parameters parameters;
    static ScanStamper stamper(parameters);
    static scip::Measurement measurement;
    static scan_t message{};
    TEST_ASSERT_EQUAL_size_t(1081, sensor().beams());
    measurement.count = 1081;
    measurement.distance_mm.fill(2500);
    measurement.distance_mm[0] = 0;
    measurement.distance_mm[1] = 19;
    measurement.distance_mm[2] = 20;
    measurement.distance_mm[3] = 65533;
    measurement.distance_mm[4] = 10001;
    TEST_ASSERT_FALSE(stamper.fill(sensor(), measurement, 1000000, 2000000, 10.0F, message));  // no IMU yet
    stamper.add_imu(5000000, 2000000);
    TEST_ASSERT_TRUE(stamper.fill(sensor(), measurement, 1000000, 2000000, 10.0F, message));
    TEST_ASSERT_EQUAL_INT64(5000000, message.t_us);
    TEST_ASSERT_FLOAT_IS_NAN(message.range_m[0]);
    TEST_ASSERT_FLOAT_IS_NAN(message.range_m[1]);
    TEST_ASSERT_EQUAL_FLOAT(0.020F, message.range_m[2]);
    TEST_ASSERT_FLOAT_IS_INF(message.range_m[3]);
    TEST_ASSERT_FLOAT_IS_INF(message.range_m[4]);
    TEST_ASSERT_EQUAL_FLOAT(2.5F, message.range_m[5]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, -2.3561945F, message.bearing_first_rad);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 25000.0F / 1440.0F, message.time_increment_us);
    TEST_ASSERT_FALSE(stamper.fill(sensor(), measurement, 1000000, 2000000, 10.0F, message));  // the same time again
    TEST_ASSERT_EQUAL_UINT32(1U, stamper.counters().backwards);
}

void scans_are_stamped_to_two_milliseconds() {
    Parameters parameters;
    parameters.lidar_stamp_offset_s = -0.0005F;  // this laser needs 2.5 ms at the least, the inertial samples 2 ms
    static ScanStamper stamper(parameters);
    static scip::Measurement measurement;
    static scan_t message{};
    measurement.count = 1081;
    std::minstd_rand random(3);
    std::exponential_distribution<double> jitter_us(1.0 / 1500.0);
    std::int64_t worst_us = 0;
    // Host time runs; the autopilot's clock is 40 ppm slow, the sensor's 60 ppm fast and counts whole milliseconds.
    for (std::int64_t i = 1; i < 60 * 40; ++i) {
        const std::int64_t host_us = kHostAtAutopilotZero_us + 25000 * i;
        const auto autopilot_at = [](const std::int64_t at_us) { return (at_us - kHostAtAutopilotZero_us) * 24999 / 25000; };
        for (std::int64_t k = 0; k < 6; ++k) {
            const std::int64_t sampled_us = host_us - 25000 + 4000 * k;
            stamper.add_imu(autopilot_at(sampled_us), sampled_us + 2000 + static_cast<std::int64_t>(jitter_us(random)));
        }
        const std::int64_t sensor_us = (host_us + host_us * 3 / 50000) / 1000 * 1000;
        const bool good = stamper.fill(sensor(), measurement, sensor_us, host_us + 2500 + static_cast<std::int64_t>(jitter_us(random)), 0.0F, message);
        if (i > 80) {
            TEST_ASSERT_TRUE(good);
            worst_us = std::max(worst_us, std::abs(message.t_us - autopilot_at(host_us)));
        }
    }
    TEST_ASSERT_LESS_THAN_INT64(2000, worst_us);
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(finds_the_offset_through_jitter_and_drift);
    RUN_TEST(one_wild_stamp_is_no_new_clock_but_five_are);
    RUN_TEST(codes_are_not_distances);
    RUN_TEST(scans_are_stamped_to_two_milliseconds);
    return UNITY_END();
}
