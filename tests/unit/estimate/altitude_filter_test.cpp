// The altitude filter in scenes: edges, echoes, blind zone, tilt, silence, a full pool, bad input.
#include <array>
#include <cmath>
#include <limits>
#include <new>

#include "estimate/altitude_filter.hpp"
#include "unit/estimate/altitude_profile.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::AltitudeEstimate;
using noctule::AltitudeFilter;
using noctule::Level;
using noctule::Parameters;
using noctule::RangeSample;
using noctule::SensorFrame;
using noctule::VehicleSample;

namespace {

constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
const Parameters kDefaults{};

/// Feeds noiseless steps of 50 ms by hand: the vehicle stands still in the air or on the ground.
class Hand {
public:
    explicit Hand(const Parameters& parameters = kDefaults) : filter(parameters) {}

    /// One step with these readings; NaN stands for no reading.
    const AltitudeEstimate& step(const float down_m, const float up_m, const float climb_accel_m_s2 = 0.0F) {
        t_us += 50000;
        clear();
        for (int k = 1; k <= 12; ++k) {
            noctule::ImuSample s;
            s.t_us = t_us - 50000 + k * 4000;
            s.accel_m_s2 = specific_force(climb_accel_m_s2);
            (void)frame.imu.push(s);
        }
        (void)frame.attitude.push({t_us, roll_rad, pitch_rad});
        (void)frame.range_down.push({t_us, down_m, 0.10F, 12.0F});
        (void)frame.range_up.push({t_us, up_m, 0.10F, 12.0F});
        frame.scan.t_us = t_us;
        VehicleSample vehicle;
        vehicle.t_us = t_us;
        vehicle.armed = flying;
        vehicle.landed = flying ? VehicleSample::Landed::in_air : VehicleSample::Landed::on_ground;
        (void)frame.vehicle.push(vehicle);
        planar.quality = 100;
        return filter.update(frame, planar);
    }

    /// At rest for a second, then in the air at 1 m (readings say so: floor 0, ceiling 2.5 m).
    void hover_at_one_metre() {
        for (int i = 0; i < 20; ++i) { step(kNothing, 2.33F); }
        flying = true;
        // Up with +-0.88 m/s^2 for one second each: 0.88 m.
        for (int i = 0; i < 20; ++i) { step(kNothing, kNothing, 0.88F); }
        for (int i = 0; i < 20; ++i) { step(kNothing, kNothing, -0.88F); }
        for (int i = 0; i < 60; ++i) { step(0.95F, 1.45F); }
    }

    void clear() {
        frame.imu.clear();
        frame.attitude.clear();
        frame.range_up.clear();
        frame.range_down.clear();
        frame.vehicle.clear();
    }

    [[nodiscard]] std::array<float, 3> specific_force(const float climb) const {
        const float g = 9.80665F + climb;
        return {-std::sin(pitch_rad) * g, std::sin(roll_rad) * std::cos(pitch_rad) * g,
                std::cos(roll_rad) * std::cos(pitch_rad) * g};
    }

    [[nodiscard]] const Level* level_at(const float z_m, const float tolerance_m) const {
        for (const Level& level : filter.levels()) {
            if (std::fabs(level.z_m - z_m) <= tolerance_m) { return &level; }
        }
        return nullptr;
    }

    AltitudeFilter filter;
    SensorFrame frame;
    noctule::PlanarEstimate planar;
    std::int64_t t_us = 1000000;
    float roll_rad = 0.0F;
    float pitch_rad = 0.0F;
    bool flying = false;
};

Hand hand;  // a filter is 50 kB: one at a time, rebuilt by each test

void fresh(const Parameters& parameters = kDefaults) {
    hand.~Hand();
    new (&hand) Hand(parameters);
}

void starts_on_its_landing_gear_with_the_range_blind() {
    fresh();
    for (int i = 0; i < 20; ++i) { hand.step(0.07F, 2.33F); }
    const AltitudeEstimate& e = hand.filter.estimate();
    TEST_ASSERT_TRUE(e.valid);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.12F, e.z_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.0F, e.vz_m_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.0F, e.ground_z_m);
    TEST_ASSERT_FLOAT_WITHIN(2e-2F, 2.5F, e.ceiling_z_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.0F, e.floor_z_m);
    TEST_ASSERT_EQUAL_UINT32(20U, hand.filter.counters().refused_range);
}

void table_edge_makes_a_level_and_leaves_z_alone() {
    fresh();
    hand.hover_at_one_metre();
    const float before_m = hand.filter.estimate().z_m;
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 1.0F, before_m);
    for (int i = 0; i < 20; ++i) {
        hand.planar.pose_map_body.x_m += 0.05F;
        const AltitudeEstimate& e = hand.step(0.40F, 1.45F);  // 0.55 m of table under the vehicle
        TEST_ASSERT_FLOAT_WITHIN(0.005F, before_m, e.z_m);
        if (i >= 2) { TEST_ASSERT_FLOAT_WITHIN(0.02F, 0.55F, e.ground_z_m); }
        TEST_ASSERT_FLOAT_WITHIN(0.005F, 0.0F, e.floor_z_m);  // a table is not a floor
    }
    const Level* const table = hand.level_at(0.55F, 0.01F);
    TEST_ASSERT_NOT_NULL(table);
    TEST_ASSERT_FALSE(table->floor);
    TEST_ASSERT_FLOAT_WITHIN(0.051F, 0.95F, table->x_max_m - table->x_min_m);
}

void ceiling_step_makes_a_level_and_leaves_z_alone() {
    fresh();
    hand.hover_at_one_metre();
    for (int i = 0; i < 20; ++i) {
        const AltitudeEstimate& e = hand.step(0.95F, 3.61F);
        TEST_ASSERT_FLOAT_WITHIN(0.005F, 1.0F, e.z_m);
    }
    const Level* const far = hand.level_at(4.66F, 0.02F);
    TEST_ASSERT_NOT_NULL(far);
    TEST_ASSERT_EQUAL_INT8(-1, far->facing);
}

void single_echo_is_forgotten() {
    fresh();
    hand.hover_at_one_metre();
    const std::size_t levels = hand.filter.levels().size();
    const float before_m = hand.filter.estimate().z_m;
    hand.step(0.30F, 1.45F);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, before_m, hand.filter.estimate().z_m);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.0F, hand.filter.estimate().ground_z_m);
    for (int i = 0; i < 20; ++i) { hand.step(0.95F, 1.45F); }
    TEST_ASSERT_EQUAL_size_t(levels, hand.filter.levels().size());
    TEST_ASSERT_EQUAL_UINT32(1U, hand.filter.counters().levels_forgotten);
}

void both_ranges_jumping_together_is_drift_not_two_surfaces() {
    fresh();
    hand.hover_at_one_metre();
    const std::size_t levels = hand.filter.levels().size();
    // 0.20 m lower by both ranges: their sum is unchanged, so the vehicle moved and the accelerometer missed it.
    for (int i = 0; i < 20; ++i) { hand.step(0.75F, 1.65F); }
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 0.80F, hand.filter.estimate().z_m);
    TEST_ASSERT_EQUAL_size_t(levels, hand.filter.levels().size());
    TEST_ASSERT_TRUE(hand.filter.counters().drifts >= 1U);
}

void step_smaller_than_the_gate_is_found_from_the_mean() {
    fresh();
    hand.hover_at_one_metre();
    for (int i = 0; i < 40; ++i) { hand.step(0.89F, 1.45F); }  // a podium of 6 cm, the ceiling unchanged
    TEST_ASSERT_TRUE(hand.filter.counters().shifts >= 1U);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 1.0F, hand.filter.estimate().z_m);
    TEST_ASSERT_FLOAT_WITHIN(0.015F, 0.06F, hand.filter.estimate().ground_z_m);
}

void tilted_range_is_not_a_height() {
    fresh();
    hand.hover_at_one_metre();
    hand.roll_rad = 0.26F;  // 15 degrees
    const float c = std::cos(0.26F);
    const float down_m = (1.0F - 0.05F * c) / c;
    for (int i = 0; i < 40; ++i) { hand.step(down_m, kNothing); }  // alone: the errors of two would cancel
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 1.0F, hand.filter.estimate().z_m);
    TEST_ASSERT_EQUAL_UINT32(0U, hand.filter.counters().refused_tilt);
    hand.roll_rad = 0.6F;
    hand.step(1.2F, 1.8F);
    TEST_ASSERT_EQUAL_UINT32(2U, hand.filter.counters().refused_tilt);
}

void tilted_beam_on_a_wall_founds_no_level() {
    fresh();
    hand.hover_at_one_metre();
    hand.pitch_rad = 0.25F;
    for (int i = 0; i < 10; ++i) { hand.step(0.97F, 0.70F); }  // the upward beam meets a wall
    TEST_ASSERT_EQUAL_UINT32(10U, hand.filter.counters().unmatched);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 1.0F, hand.filter.estimate().z_m);
}

void silence_grows_the_variance_until_z_is_not_valid() {
    fresh();
    hand.hover_at_one_metre();
    float before = hand.filter.estimate().z_var_m2;
    int steps = 0;
    while (hand.filter.estimate().valid && steps < 2400) {
        hand.step(kNothing, kNothing);
        TEST_ASSERT_TRUE(hand.filter.estimate().z_var_m2 > before);
        before = hand.filter.estimate().z_var_m2;
        ++steps;
        if (steps == 40) { TEST_ASSERT_TRUE_MESSAGE(hand.filter.estimate().valid, "two seconds are survived"); }
    }
    TEST_ASSERT_FALSE(hand.filter.estimate().valid);
    TEST_ASSERT_FLOAT_IS_NAN(hand.filter.estimate().ground_z_m);
    hand.step(0.95F, 1.45F);
    TEST_ASSERT_TRUE_MESSAGE(hand.filter.estimate().valid, "one pair of ranges brings it back");
}

void hole_in_the_inertial_samples_widens_the_gate() {
    fresh();
    hand.hover_at_one_metre();
    const float before = hand.filter.estimate().z_var_m2;
    hand.t_us += 1000000;  // a second without anything, meanwhile 0.30 m up
    hand.step(1.25F, 1.15F);
    hand.step(1.25F, 1.15F);
    TEST_ASSERT_FLOAT_WITHIN(0.03F, 1.30F, hand.filter.estimate().z_m);
    TEST_ASSERT_TRUE(hand.filter.estimate().z_var_m2 > before);
}

void accelerometer_bias_is_learnt_at_rest() {
    fresh();
    for (int i = 0; i < 40; ++i) { hand.step(kNothing, 2.33F, 0.05F); }
    TEST_ASSERT_FLOAT_WITHIN(0.005F, 0.05F, hand.filter.accel_bias_z_m_s2());
    TEST_ASSERT_FLOAT_WITHIN(0.002F, 0.12F, hand.filter.estimate().z_m);
}

void bad_input_is_refused_and_counted() {
    fresh();
    hand.hover_at_one_metre();
    const AltitudeEstimate good = hand.filter.estimate();
    const noctule::AltitudeCounters c0 = hand.filter.counters();

    TEST_ASSERT_EQUAL_FLOAT(good.z_m, hand.filter.update(hand.frame, hand.planar).z_m);  // the same frame again
    TEST_ASSERT_EQUAL_UINT32(c0.frames_refused + 1U, hand.filter.counters().frames_refused);

    hand.step(std::numeric_limits<float>::infinity(), -1.0F);
    TEST_ASSERT_EQUAL_UINT32(c0.refused_input + 2U, hand.filter.counters().refused_input);
    hand.step(12.0F, 0.05F);
    TEST_ASSERT_EQUAL_UINT32(c0.refused_range + 2U, hand.filter.counters().refused_range);
    hand.step(kNothing, 1.45F);
    TEST_ASSERT_EQUAL_UINT32(c0.refused_empty + 1U, hand.filter.counters().refused_empty);

    hand.clear();
    hand.t_us += 50000;
    hand.frame.scan.t_us = hand.t_us;
    (void)hand.frame.range_down.push({hand.t_us - 400000, 0.95F, 0.1F, 12.0F});   // too late
    (void)hand.frame.range_down.push({hand.t_us + 900000, 0.95F, 0.1F, 12.0F});   // from the future
    noctule::ImuSample wild;
    wild.t_us = hand.t_us - 10000;
    wild.accel_m_s2 = {0.0F, kNothing, 9.8F};
    (void)hand.frame.imu.push(wild);
    wild.accel_m_s2 = {0.0F, 0.0F, 1.0e6F};
    (void)hand.frame.imu.push(wild);
    (void)hand.frame.attitude.push({hand.t_us, kNothing, 0.0F});
    hand.filter.update(hand.frame, hand.planar);
    TEST_ASSERT_EQUAL_UINT32(c0.refused_time + 2U, hand.filter.counters().refused_time);
    TEST_ASSERT_EQUAL_UINT32(c0.inertial_refused + 3U, hand.filter.counters().inertial_refused);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 1.0F, hand.filter.estimate().z_m);
    TEST_ASSERT_TRUE(hand.filter.estimate().valid);
}

void full_pool_gives_way_and_keeps_z_and_the_first_floor() {
    fresh();
    hand.hover_at_one_metre();
    for (int k = 0; k < 100; ++k) {  // a hundred different shelves, 1.5 m apart, the ceiling constant
        hand.planar.pose_map_body.x_m += 1.5F;
        const float down_m = 0.20F + 0.07F * static_cast<float>(k % 10);
        for (int i = 0; i < 6; ++i) { hand.step(down_m, 1.45F); }
    }
    TEST_ASSERT_TRUE(hand.filter.levels().size() <= noctule::kMaxLevels);
    TEST_ASSERT_TRUE(hand.filter.counters().levels_evicted > 0U);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 1.0F, hand.filter.estimate().z_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, 0.0F, hand.filter.levels()[0].z_m);
    TEST_ASSERT_TRUE(hand.filter.levels()[0].floor);
}

void upper_floor_is_a_floor_and_a_wardrobe_is_not() {
    altitude_test::Flight up = altitude_test::paper_flight();
    static AltitudeFilter filter{kDefaults};
    new (&filter) AltitudeFilter(kDefaults);
    float floor_m = 0.0F;
    up.run(filter, altitude_test::Sensors{}, 5, [&](const altitude_test::Truth& truth, const AltitudeEstimate& e) {
        if (truth.x_m < 6.9 && truth.t_s < 15.0) { TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.0F, e.floor_z_m); }
        if (truth.x_m > 10.5) { floor_m = e.floor_z_m; }
    });
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 2.41F, floor_m);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.0F, filter.estimate().floor_z_m);  // and back over the lower floor

    fresh();
    hand.hover_at_one_metre();
    // Up to 2.6 m under a ceiling of 3.2 m (seen through an opening), then over a wardrobe of 2.0 m, 1.5 m long.
    for (int i = 0; i < 80; ++i) {
        hand.step(0.95F + 0.02F * static_cast<float>(i + 1), 3.2F - 1.05F - 0.02F * static_cast<float>(i + 1),
                  i == 0 ? 8.0F : (i == 79 ? -8.0F : 0.0F));
    }
    for (int i = 0; i < 30; ++i) {
        hand.planar.pose_map_body.x_m += 0.05F;
        hand.step(0.55F, 0.55F);
    }
    const Level* const wardrobe = hand.level_at(2.0F, 0.05F);
    TEST_ASSERT_NOT_NULL(wardrobe);
    TEST_ASSERT_FALSE(wardrobe->floor);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.0F, hand.filter.estimate().floor_z_m);
}

void paper_form_is_chosen_by_its_parameter() {
    Parameters paper{};
    paper.alt_joint = 0;
    paper.alt_accel_noise_m_s2 = 0.03F;
    paper.range_sigma_m = 0.05F;
    static AltitudeFilter filter{paper};
    new (&filter) AltitudeFilter(paper);
    altitude_test::Flight flight = altitude_test::paper_flight();
    const altitude_test::Result result = flight.run(filter, altitude_test::Sensors{}, 3);
    TEST_ASSERT_TRUE(result.mean_m < 0.06);
    bool table = false;
    for (const Level& level : filter.levels()) { table = table || std::fabs(level.z_m - 0.55F) < 0.10F; }
    TEST_ASSERT_TRUE(table);
    TEST_ASSERT_FLOAT_WITHIN(0.15F, 4.66F, filter.estimate().ceiling_z_m);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(starts_on_its_landing_gear_with_the_range_blind);
    RUN_TEST(table_edge_makes_a_level_and_leaves_z_alone);
    RUN_TEST(ceiling_step_makes_a_level_and_leaves_z_alone);
    RUN_TEST(single_echo_is_forgotten);
    RUN_TEST(both_ranges_jumping_together_is_drift_not_two_surfaces);
    RUN_TEST(step_smaller_than_the_gate_is_found_from_the_mean);
    RUN_TEST(tilted_range_is_not_a_height);
    RUN_TEST(tilted_beam_on_a_wall_founds_no_level);
    RUN_TEST(silence_grows_the_variance_until_z_is_not_valid);
    RUN_TEST(hole_in_the_inertial_samples_widens_the_gate);
    RUN_TEST(accelerometer_bias_is_learnt_at_rest);
    RUN_TEST(bad_input_is_refused_and_counted);
    RUN_TEST(full_pool_gives_way_and_keeps_z_and_the_first_floor);
    RUN_TEST(upper_floor_is_a_floor_and_a_wardrobe_is_not);
    RUN_TEST(paper_form_is_chosen_by_its_parameter);
    return UNITY_END();
}
