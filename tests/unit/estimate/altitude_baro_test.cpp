// The barometer as a weak input: off it is not there, on it changes nothing while ranges speak and bounds z when they do not.
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "estimate/altitude_filter.hpp"
#include "unit/estimate/altitude_profile.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using altitude_test::Result;
using altitude_test::Sensors;
using noctule::AltitudeEstimate;
using noctule::AltitudeFilter;
using noctule::Parameters;

namespace {

Parameters with_barometer() {
    Parameters p{};
    p.alt_baro_sigma_m = 0.12F;
    return p;
}

const Parameters kOff{};
const Parameters kOn = with_barometer();

struct Step {
    float z_m, vz_m_s, z_var_m2, vz_var_m2_s2, ground_z_m, ceiling_z_m, floor_z_m;
};

std::vector<Step> fly(AltitudeFilter& filter, const Sensors& sensors, Result* const result = nullptr) {
    altitude_test::Flight flight = altitude_test::flat_flight(60.0);
    std::vector<Step> steps;
    const Result got = flight.run(filter, sensors, 7, [&](const altitude_test::Truth&, const AltitudeEstimate& e) {
        steps.push_back({e.z_m, e.vz_m_s, e.z_var_m2, e.vz_var_m2_s2, e.ground_z_m, e.ceiling_z_m, e.floor_z_m});
    });
    if (result != nullptr) { *result = got; }
    return steps;
}

bool same_bits(const std::vector<Step>& a, const std::vector<Step>& b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(Step)) == 0;
}

/// A filter that hovers at 1 m over floor 0 under a ceiling of 2.5 m, by hand.
class Hover {
public:
    explicit Hover(const Parameters& parameters) : filter(parameters) {}

    void step(const float baro_m, const bool ranges = true, const std::int64_t baro_age_us = 0) {
        t_us += 50000;
        frame.imu.clear();
        frame.attitude.clear();
        frame.range_up.clear();
        frame.range_down.clear();
        frame.baro.clear();
        frame.vehicle.clear();
        for (int k = 1; k <= 12; ++k) { (void)frame.imu.push({t_us - 50000 + k * 4000, {0.0F, 0.0F, 9.80665F}, {}}); }
        (void)frame.attitude.push({t_us, 0.0F, 0.0F});
        if (ranges) {
            (void)frame.range_down.push({t_us, 0.95F, 0.1F, 12.0F});
            (void)frame.range_up.push({t_us, 1.45F, 0.1F, 12.0F});
        }
        (void)frame.baro.push({t_us - baro_age_us, baro_m});
        noctule::VehicleSample vehicle;
        vehicle.t_us = t_us;
        vehicle.armed = true;
        vehicle.landed = noctule::VehicleSample::Landed::in_air;
        (void)frame.vehicle.push(vehicle);
        frame.scan.t_us = t_us;
        noctule::PlanarEstimate planar;
        planar.quality = 100;
        filter.update(frame, planar);
    }
    void steps(const int n, const float baro_m, const bool ranges = true) {
        for (int i = 0; i < n; ++i) { step(baro_m, ranges); }
    }

    AltitudeFilter filter;
    noctule::SensorFrame frame;
    std::int64_t t_us = 0;
};

void off_it_is_not_there() {
    Sensors without;
    without.silent_s = {{20.0, 50.0}};
    Sensors with = without;
    with.baro_sigma_m = 0.10;
    const auto a = std::make_unique<AltitudeFilter>(kOff);
    const auto b = std::make_unique<AltitudeFilter>(kOff);
    TEST_ASSERT_TRUE(same_bits(fly(*a, without), fly(*b, with)));
    TEST_ASSERT_EQUAL_UINT32(0, b->counters().baro_used);
    TEST_ASSERT_EQUAL_UINT32(0, b->counters().baro_refused);
}

void while_ranges_speak_it_changes_no_bit_of_the_height() {
    Sensors sensors;
    sensors.baro_sigma_m = 0.10;
    const auto off = std::make_unique<AltitudeFilter>(kOff);
    const auto on = std::make_unique<AltitudeFilter>(kOn);
    TEST_ASSERT_TRUE(same_bits(fly(*off, sensors), fly(*on, sensors)));
    TEST_ASSERT_GREATER_THAN_UINT32(1200, on->counters().baro_used);
}

void thirty_seconds_of_silence_stay_bounded_and_the_variance_is_honest() {
    // To and fro over the same floor: after the silence it is known again.
    altitude_test::World world;
    world.ground_m = [](double) { return 0.0; };
    world.ceiling_m = [](double) { return 2.5; };
    std::vector<altitude_test::Leg> legs{{2.5, 0.0, 0.88}};
    for (int i = 0; i < 8; ++i) { legs.push_back({7.0, i % 2 == 0 ? 2.0 : -2.0, i % 2 == 0 ? 0.4 : -0.4}); }
    altitude_test::Flight flight{world, legs};
    double worst_off_m = 0.0;
    double worst_on_m = 0.0;
    double end_m = 0.0;
    double sum = 0.0;
    int inside = 0;
    int steps = 0;
    for (std::uint32_t seed = 1; seed <= 20; ++seed) {
        Sensors sensors;
        sensors.silent_s = {{20.0, 50.0}};
        sensors.baro_sigma_m = 0.10;
        const auto off = std::make_unique<AltitudeFilter>(kOff);
        const auto on = std::make_unique<AltitudeFilter>(kOn);
        worst_off_m = std::fmax(worst_off_m, flight.run(*off, sensors, seed).max_m);
        const Result result = flight.run(*on, sensors, seed, [&](const altitude_test::Truth& truth, const AltitudeEstimate& e) {
            if (truth.t_s < 21.0 || truth.t_s >= 50.0) { return; }
            const double error = static_cast<double>(e.z_m) - truth.z_m;
            const double nees = error * error / static_cast<double>(e.z_var_m2);
            sum += nees;
            inside += nees < 4.0 ? 1 : 0;
            ++steps;
        });
        worst_on_m = std::fmax(worst_on_m, result.max_m);
        end_m = std::fmax(end_m, std::fabs(result.end_m));
    }
    std::printf("worst error in silence: off %.3f m, on %.3f m; on: NEES %.2f, within two sigmas %.3f, at the end %.3f m\n", worst_off_m,
                worst_on_m, sum / steps, static_cast<double>(inside) / steps, end_m);
    TEST_ASSERT_TRUE(worst_on_m < 0.6);
    TEST_ASSERT_TRUE(end_m < 0.03);  // the ranges bring it back
    TEST_ASSERT_TRUE(worst_off_m > 2.0 * worst_on_m);
    TEST_ASSERT_TRUE(sum / steps > 0.2 && sum / steps < 1.5);
    TEST_ASSERT_TRUE(inside > 0.9 * steps);
}

void wrong_values_are_refused_and_counted() {
    const auto hover = std::make_unique<Hover>(kOn);
    hover->steps(100, 57.0F);
    const float z_m = hover->filter.estimate().z_m;
    const noctule::AltitudeCounters before = hover->filter.counters();
    TEST_ASSERT_EQUAL_UINT32(100, before.baro_used);
    hover->step(std::numeric_limits<float>::quiet_NaN());
    hover->step(-std::numeric_limits<float>::infinity());
    hover->step(1.0e6F);
    hover->step(57.0F, true, 900000);    // late
    hover->step(57.0F, true, 50000);     // good: the moment of the refused one
    hover->step(57.0F, true, 100000);    // not newer than the one before
    hover->step(57.0F, true, -900000);   // from the future
    hover->step(60.0F);                  // beyond the gate
    TEST_ASSERT_EQUAL_UINT32(before.baro_refused + 7U, hover->filter.counters().baro_refused);
    TEST_ASSERT_EQUAL_UINT32(before.baro_used + 1U, hover->filter.counters().baro_used);
    TEST_ASSERT_FLOAT_WITHIN(0.005F, z_m, hover->filter.estimate().z_m);
    TEST_ASSERT_EQUAL_UINT32(0, hover->filter.counters().baro_restarts);
}

void a_jump_of_the_pressure_founds_the_offset_anew_and_leaves_z() {
    const auto hover = std::make_unique<Hover>(kOn);
    hover->steps(100, 57.0F);
    hover->steps(40, 57.0F, false);
    const float z_m = hover->filter.estimate().z_m;
    hover->steps(40, 59.0F, false);      // a door: 2 m for good
    TEST_ASSERT_EQUAL_UINT32(1, hover->filter.counters().baro_restarts);
    TEST_ASSERT_EQUAL_UINT32(20, hover->filter.counters().baro_refused);
    TEST_ASSERT_FLOAT_WITHIN(0.03F, z_m, hover->filter.estimate().z_m);
}

void the_papers_form_does_not_use_it() {
    Parameters paper = kOn;
    paper.alt_joint = 0;
    const auto hover = std::make_unique<Hover>(paper);
    hover->steps(20, 57.0F);
    TEST_ASSERT_EQUAL_UINT32(0, hover->filter.counters().baro_used);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(off_it_is_not_there);
    RUN_TEST(while_ranges_speak_it_changes_no_bit_of_the_height);
    RUN_TEST(thirty_seconds_of_silence_stay_bounded_and_the_variance_is_honest);
    RUN_TEST(wrong_values_are_refused_and_counted);
    RUN_TEST(a_jump_of_the_pressure_founds_the_offset_anew_and_leaves_z);
    RUN_TEST(the_papers_form_does_not_use_it);
    return UNITY_END();
}
