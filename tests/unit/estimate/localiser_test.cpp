// The whole planar estimator on a small world: accuracy in rooms, honesty where the laser is blind, and every kind of bad input.
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>

#include "estimate/localiser.hpp"
#include "unit/support/planar_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

using test::Flight;
using test::Noise;
using test::PlanarWorld;
using test::Sensors;
using Way = std::vector<std::array<double, 2>>;

constexpr double kTurn_rad = 0.2967;  // worlds do not lie along the axes

struct Place {
    PlanarWorld world;
    Way way;
    void turn() {
        world.move(kTurn_rad, 0.37, -1.23);
        const double c = std::cos(kTurn_rad), s = std::sin(kTurn_rad);
        for (auto& p : way) { p = {c * p[0] - s * p[1] + 0.37, s * p[0] + c * p[1] - 1.23}; }
    }
};

Place one_room() {
    Place place;
    place.world.box(0, 0, 8, 6);
    place.world.box(3, 2.5, 3.6, 3.4);
    place.way = {{1, 1}, {6.5, 1}, {7, 5}, {1.2, 5}, {1, 1.2}};
    place.turn();
    return place;
}

Place two_rooms() {
    Place place;
    place.world.box(0, 0, 12, 7);
    place.world.wall(6, 0, 6, 1.5);
    place.world.wall(6, 2.5, 6, 4.5);
    place.world.wall(6, 5.5, 6, 7);
    place.world.box(2.5, 3, 3.2, 3.8);
    place.world.box(8.5, 3.1, 9, 3.9);
    place.way = {{1.2, 1.2}, {5, 2}, {7, 2}, {10.8, 1.5}, {11, 5.8}, {7, 5}, {5, 5}, {1, 5.8}, {1.2, 1.4}, {3, 1.6}};
    place.turn();
    return place;
}

struct Errors {
    double mean_m = 0.0, worst_m = 0.0, mean_yaw_rad = 0.0, mean_speed_m_s = 0.0, last_m = 0.0;
    int lost = 0, steps = 0;
};

/// Flies a place; spoil(frame, t_s) may damage each frame before it is handed in.
template <class Spoil>
Errors fly(const Place& place, Localiser& localiser, const Noise& noise, const std::uint32_t seed, const Parameters& parameters, const double imu_rate_hz,
           Spoil&& spoil) {
    const Flight flight(place.way, 0.8, 1.0);
    Sensors sensors(place.world, flight, noise, seed);
    sensors.laser_height_m = static_cast<double>(parameters.lidar_z_m);
    sensors.imu_rate_hz = imu_rate_hz;
    auto frame = std::make_unique<SensorFrame>();
    const AltitudeEstimate altitude;
    Errors errors;
    const test::Truth start = flight.at(0.0);
    for (double t_s = 0.0; t_s <= flight.duration_s(); t_s += 0.05) {
        sensors.frame(t_s, *frame);
        if (!spoil(*frame, t_s)) { continue; }
        const PlanarEstimate& e = localiser.update(*frame, altitude);
        const test::Truth p = flight.at(t_s);
        double x_m = 0.0, y_m = 0.0, yaw_rad = 0.0;
        test::in_map(start, p, x_m, y_m, yaw_rad);
        const double error_m = std::hypot(static_cast<double>(e.pose_map_body.x_m) - x_m, static_cast<double>(e.pose_map_body.y_m) - y_m);
        TEST_ASSERT_TRUE(std::isfinite(error_m));
        errors.mean_m += error_m;
        errors.worst_m = std::max(errors.worst_m, error_m);
        errors.last_m = error_m;
        errors.mean_yaw_rad += std::abs(std::remainder(static_cast<double>(e.pose_map_body.yaw_rad) - yaw_rad, 2.0 * M_PI));
        errors.mean_speed_m_s += std::abs(std::hypot(static_cast<double>(e.vx_m_s), static_cast<double>(e.vy_m_s)) - std::hypot(p.vx_m_s, p.vy_m_s));
        errors.lost += e.quality < 0 ? 1 : 0;
        ++errors.steps;
    }
    errors.mean_m /= errors.steps;
    errors.mean_yaw_rad /= errors.steps;
    errors.mean_speed_m_s /= errors.steps;
    return errors;
}

const auto kUnspoilt = [](SensorFrame&, double) { return true; };

void stays_within_a_centimetre_in_a_room() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    const Errors errors = fly(one_room(), *localiser, Noise{}, 1U, parameters, 250.0, kUnspoilt);
    TEST_ASSERT_TRUE(errors.mean_m < 0.006);
    TEST_ASSERT_TRUE(errors.worst_m < 0.02);
    TEST_ASSERT_TRUE(errors.mean_yaw_rad < 0.002);
    TEST_ASSERT_TRUE(errors.mean_speed_m_s < 0.01);
    TEST_ASSERT_EQUAL_INT(0, errors.lost);
    TEST_ASSERT_EQUAL_INT32(0, localiser->estimate().reset_counter);
}

void closes_a_loop_through_two_rooms() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    const Errors errors = fly(two_rooms(), *localiser, Noise{}, 2U, parameters, 250.0, kUnspoilt);
    TEST_ASSERT_TRUE(errors.mean_m < 0.008);
    TEST_ASSERT_TRUE(errors.last_m < 0.01);  // back in the first room
    // No wall twice: no two landmarks lie on one another with the same face.
    Bounded<WallSegment, kMaxWalls> walls;
    localiser->walls(walls);
    TEST_ASSERT_TRUE(walls.size() >= 12 && walls.size() <= 30);
    for (std::size_t i = 0; i < walls.size(); ++i) {
        for (std::size_t j = 0; j < i; ++j) {
            const bool same = walls[i].line.v == walls[j].line.v && std::abs(walls[i].line.r_m - walls[j].line.r_m) < 0.02F &&
                              std::abs(wrap_angle(walls[i].line.alpha_rad - walls[j].line.alpha_rad)) < 0.005F && walls[i].seen > 20 && walls[j].seen > 20;
            const Point2<Map> a = walls[i].end0;
            const bool near = std::hypot(a.x_m - walls[j].end0.x_m, a.y_m - walls[j].end0.y_m) < 1.0F;
            TEST_ASSERT_FALSE(same && near);
        }
    }
}

void works_with_fifty_hertz_and_three_centimetres() {
    Parameters parameters;
    parameters.laser_range_noise_m = 0.03F;
    auto localiser = std::make_unique<Localiser>(parameters);
    Noise noise;
    noise.range_m = 0.03;
    noise.accel_bias = 0.1;
    const Errors errors = fly(one_room(), *localiser, noise, 3U, parameters, 50.0, kUnspoilt);
    TEST_ASSERT_TRUE(errors.mean_m < 0.025);
    TEST_ASSERT_EQUAL_INT(0, errors.lost);
}

void paper_preset_works() {
    Parameters parameters;
    parameters.wall_method = 1;
    parameters.wall_points_min = 25;
    parameters.wall_curvature_sigma = 100.0F;
    parameters.landmarks_max = 12;
    parameters.association_floor_m = 0.0F;
    parameters.association_floor_rad = 0.0F;
    parameters.association_gap_m = 100.0F;
    parameters.outlier_sigma = 100.0F;
    parameters.resample_share = 1.0F;
    parameters.visibility_through = 0;
    parameters.point_match = 0;
    auto localiser = std::make_unique<Localiser>(parameters);
    const Errors errors = fly(one_room(), *localiser, Noise{}, 4U, parameters, 250.0, kUnspoilt);
    TEST_ASSERT_TRUE(errors.mean_m < 0.08);
    TEST_ASSERT_TRUE(localiser->estimate().landmarks <= 12);
}

/// Flies, is carried back by some seconds of the way while nothing is measured, and flies on from there.
void carried_back_it_says_lost_and_finds_the_place_in_the_old_map() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    const Place place = two_rooms();
    const Flight flight(place.way, 0.8, 1.0);
    Sensors sensors(place.world, flight, Noise{}, 9U);
    sensors.laser_height_m = static_cast<double>(parameters.lidar_z_m);
    auto frame = std::make_unique<SensorFrame>();
    constexpr double kAt_s = 22.0, kBack_s = 17.0;
    const test::Truth start = flight.at(0.0);
    int first_lost = -1, found = -1, silent = 0;
    double error_m = 0.0;
    std::int32_t resets_before = 0;
    for (int k = 0; k * 0.05 <= kAt_s + 24.0; ++k) {
        const double t_s = k * 0.05;
        const double on_way_s = t_s > kAt_s ? t_s - kBack_s : t_s;
        sensors.frame(on_way_s, *frame);
        // The clock goes on.
        const std::int64_t late_us = Sensors::us(t_s) - Sensors::us(on_way_s);
        frame->scan.t_us += late_us;
        for (ImuSample& sample : frame->imu) { sample.t_us += late_us; }
        for (AttitudeSample& sample : frame->attitude) { sample.t_us += late_us; }
        const PlanarEstimate& e = localiser->update(*frame, AltitudeEstimate{});
        double x_m = 0.0, y_m = 0.0, yaw_rad = 0.0;
        test::in_map(start, flight.at(on_way_s), x_m, y_m, yaw_rad);
        error_m = std::hypot(static_cast<double>(e.pose_map_body.x_m) - x_m, static_cast<double>(e.pose_map_body.y_m) - y_m);
        if (t_s <= kAt_s) {
            TEST_ASSERT_TRUE(e.quality >= 0);
            resets_before = e.reset_counter;
            continue;
        }
        if (e.quality < 0 && first_lost < 0) { first_lost = k; }
        if (e.quality >= 0 && found < 0 && first_lost >= 0) {
            found = k;
            TEST_ASSERT_TRUE(error_m < 0.05);
            TEST_ASSERT_TRUE(e.reset_counter > resets_before);
        }
        silent += e.quality >= 0 && error_m > 0.1 ? 1 : 0;
    }
    TEST_ASSERT_EQUAL_INT(0, silent);
    TEST_ASSERT_TRUE(first_lost >= 0);
    TEST_ASSERT_TRUE(found >= 0);
    TEST_ASSERT_TRUE(error_m < 0.02);
    TEST_ASSERT_EQUAL_UINT32(1U, localiser->counters().carried);
    TEST_ASSERT_EQUAL_UINT32(1U, localiser->counters().recognised);
}

void carried_to_where_it_never_was_it_stays_lost() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    Place here = one_room();
    Place there;
    there.world.box(0, 0, 14, 9);
    there.world.box(4, 5, 7, 5.6);
    there.world.box(9.3, 2, 9.8, 4.4);
    there.world.circles = {{2.2, 6.5, 0.4}};
    there.way = {{1, 1}, {8, 1.4}, {12.5, 4.5}, {8, 7.5}, {2, 3.2}};
    there.turn();
    Sensors* sensors = nullptr;
    auto frame = std::make_unique<SensorFrame>();
    const Flight first(here.way, 0.8, 1.0), second(there.way, 0.8, 1.0);
    Sensors at_home(here.world, first, Noise{}, 3U), elsewhere(there.world, second, Noise{}, 4U);
    at_home.laser_height_m = elsewhere.laser_height_m = static_cast<double>(parameters.lidar_z_m);
    constexpr double kAt_s = 12.0;
    for (int k = 0; k * 0.05 <= kAt_s + 18.0; ++k) {
        const double t_s = k * 0.05;
        sensors = t_s > kAt_s ? &elsewhere : &at_home;
        const double on_way_s = t_s > kAt_s ? t_s - kAt_s + 1.0 : t_s;
        sensors->frame(on_way_s, *frame);
        const std::int64_t late_us = Sensors::us(t_s) - Sensors::us(on_way_s);
        frame->scan.t_us += late_us;
        for (ImuSample& sample : frame->imu) { sample.t_us += late_us; }
        for (AttitudeSample& sample : frame->attitude) { sample.t_us += late_us; }
        const PlanarEstimate& e = localiser->update(*frame, AltitudeEstimate{});
        if (t_s > kAt_s + 0.3) { TEST_ASSERT_TRUE(e.quality < 0); }
    }
    TEST_ASSERT_EQUAL_UINT32(0U, localiser->counters().recognised);
}

void a_long_blind_corridor_is_called_lost() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    Place place;
    place.world.box(-60, 0, 60, 2.2);
    place.way = {{0, 1.1}, {20, 1.1}};
    Noise noise;
    const Errors errors = fly(place, *localiser, noise, 5U, parameters, 250.0, kUnspoilt);
    TEST_ASSERT_TRUE(errors.lost > 50);
    TEST_ASSERT_TRUE(localiser->estimate().covariance[0] > 0.1F);         // along
    TEST_ASSERT_TRUE(localiser->estimate().covariance[3] < 0.2F * 0.2F);  // across
}

void a_slow_error_of_the_attitude_is_taken_out_of_the_sweep() {
    // Roll and pitch are told with an error of 5 mrad that goes and comes in six seconds; the accelerations do not fit that.
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    const Place place = two_rooms();
    const Flight flight(place.way, 0.8, 1.0);
    double told2 = 0.0, used2 = 0.0;
    const auto spoil = [&](SensorFrame& frame, const double t_s) {
        if (t_s > 6.0) {   // of the step before, whose last sample was at t_s - 0.05
            const test::Truth p = flight.at(t_s - 0.05);
            const LevelScan& scan = localiser->level_scan();
            const double roll = std::asin(static_cast<double>(scan.rise_left) / std::cos(p.pitch_rad)) - p.roll_rad;
            const double pitch = -std::asin(static_cast<double>(scan.rise_forward)) - p.pitch_rad;
            const double error = 0.005 * std::sin(t_s - 0.05);
            used2 += roll * roll + pitch * pitch;
            told2 += 2.0 * error * error;
        }
        for (AttitudeSample& sample : frame.attitude) {
            const auto error = static_cast<float>(0.005 * std::sin(1e-6 * static_cast<double>(sample.t_us)));
            sample.roll_rad += error;
            sample.pitch_rad += error;
        }
        return true;
    };
    fly(place, *localiser, Noise{}, 7U, parameters, 250.0, spoil);
    std::printf("error of roll and pitch left in the sweep: %.2f of that told\n", std::sqrt(used2 / told2));
    TEST_ASSERT_TRUE(used2 < 0.85 * 0.85 * told2);
}

void walls_lead_in_a_shaft() {
    // Where hardly a hit lies on a wall the match leads, but never in a shaft: one particle is left where it does.
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    Place place;
    place.world.circles = {{0, 0, 4}, {1.5, 1, 0.3}, {-1.5, 1.4, 0.4}, {0.5, -2, 0.25}};
    place.way = {{-2.5, -1.5}, {2.5, -1.0}, {2.5, 1.5}};
    int led = 0, followed = 0;
    const auto spoil = [&](SensorFrame&, const double t_s) {
        if (t_s > 1.0 && t_s < 3.0) { led += localiser->estimate().effective_particles <= 1.0F ? 1 : 0; }
        if (std::abs(t_s - 3.0) < 0.02) { localiser->enter_layer(Localiser::kShaftLayer); }
        if (t_s > 3.08) { followed += localiser->estimate().effective_particles <= 1.0F ? 1 : 0; }
        return true;
    };
    fly(place, *localiser, Noise{}, 8U, parameters, 250.0, spoil);
    TEST_ASSERT_TRUE(led > 30);
    TEST_ASSERT_EQUAL_INT(0, followed);
}

void walls_of_a_new_layer_are_not_doubted() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    float before = -1.0F, after = -1.0F;
    const auto spoil = [&](SensorFrame&, const double t_s) {
        if (std::abs(t_s - 5.0) < 0.02) {
            before = localiser->filter().doubtful_walls();
            localiser->enter_layer(Localiser::kShaftLayer);
        }
        if (std::abs(t_s - 5.05) < 0.02) { after = localiser->filter().doubtful_walls(); }
        return true;
    };
    fly(one_room(), *localiser, Noise{}, 9U, parameters, 250.0, spoil);
    TEST_ASSERT_TRUE(before >= 0.0F);
    TEST_ASSERT_TRUE(after >= 0.0F && after <= before);
}

void a_round_room_is_localised_by_points() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    Place place;
    place.world.circles = {{0, 0, 4}, {1.5, 1, 0.3}, {-1.5, 1.4, 0.4}, {0.5, -2, 0.25}};
    place.way = {{-2.5, -1.5}, {2.5, -1.0}, {2.5, 1.5}, {0, 2.5}, {-2.8, 0.5}};
    const Errors errors = fly(place, *localiser, Noise{}, 6U, parameters, 250.0, kUnspoilt);
    TEST_ASSERT_TRUE(errors.mean_m < 0.04);
}

void bad_frames_are_bridged_and_counted() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    auto kept = std::make_unique<SensorFrame>();
    const Errors errors = fly(one_room(), *localiser, Noise{}, 7U, parameters, 250.0, [&kept](SensorFrame& f, const double t_s) {
        const int k = static_cast<int>(std::lround(t_s / 0.05));
        if (k % 20 == 7) { f.scan.count = 7000; }                                        // layout
        if (k % 20 == 11) { f.scan.range_m.fill(std::nanf("")); }                        // no beam
        if (k % 20 == 13) { f.scan.range_m.fill(std::numeric_limits<float>::infinity()); }
        if (k % 20 == 15) { f.imu[3].accel_m_s2[0] = 1e9F; }
        if (k % 20 == 16) { f.imu[3].t_us = 5; }
        if (k % 20 == 17) { f.attitude[0].roll_rad = std::nanf(""); }
        if (k % 20 == 18) { f.scan.t_us -= 500000; }
        if (k % 20 == 3) { f = *kept; }                                                  // a duplicate
        *kept = f;
        return true;
    });
    TEST_ASSERT_TRUE(errors.mean_m < 0.03);
    TEST_ASSERT_TRUE(errors.worst_m < 0.12);  // a duplicate gives the old pose again: up to 5 cm at 0.8 m/s
    const SampleChecker::Counters& counters = localiser->sample_counters();
    TEST_ASSERT_TRUE(counters.scan_layout > 10U && counters.scan_time > 20U && counters.imu_value > 10U && counters.imu_time > 10U && counters.attitude_value > 10U);
    TEST_ASSERT_EQUAL_UINT32(counters.refused(), localiser->counters().refused_samples);
    TEST_ASSERT_TRUE(localiser->counters().blind_scans > 20U);
}

void a_gap_of_two_seconds_is_bridged() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    const Errors errors = fly(one_room(), *localiser, Noise{}, 8U, parameters, 250.0, [](SensorFrame&, const double t_s) { return t_s < 6.0 || t_s > 8.0; });
    TEST_ASSERT_TRUE(errors.last_m < 0.03);
    TEST_ASSERT_TRUE(localiser->counters().coasted > 0U);
}

void a_frozen_inertial_sensor_is_done_without() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    const Errors errors = fly(one_room(), *localiser, Noise{}, 9U, parameters, 250.0, [](SensorFrame& f, const double t_s) {
        if (t_s > 8.0) {
            for (ImuSample& s : f.imu) {
                s.accel_m_s2 = {0.3F, 0.0F, 9.8F};
                s.gyro_rad_s = {0.0F, 0.0F, 0.4F};
            }
        }
        return true;
    });
    TEST_ASSERT_TRUE(localiser->sample_counters().imu_frozen > 1000U);
    TEST_ASSERT_TRUE(errors.mean_m < 0.03);
    TEST_ASSERT_TRUE(errors.last_m < 0.05);
}

void starts_at_the_origin_and_forgets_nothing_of_empty_frames() {
    const Parameters parameters;
    auto localiser = std::make_unique<Localiser>(parameters);
    auto frame = std::make_unique<SensorFrame>();
    const AltitudeEstimate altitude;
    TEST_ASSERT_EQUAL_INT32(-1, localiser->update(*frame, altitude).quality);  // an empty scan is refused: still nothing known
    TEST_ASSERT_EQUAL_UINT32(1U, localiser->counters().refused_samples);
    const Place place = one_room();
    const Flight flight(place.way, 0.8, 1.0);
    Sensors sensors(place.world, flight, Noise{}, 1U);
    sensors.frame(0.0, *frame);
    const PlanarEstimate& e = localiser->update(*frame, altitude);
    TEST_ASSERT_FLOAT_WITHIN(0.005F, 0.0F, e.pose_map_body.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.005F, 0.0F, e.pose_map_body.y_m);
    TEST_ASSERT_TRUE(e.quality > 0);
    TEST_ASSERT_TRUE(localiser->level_scan().points.size() > 1000);
}

void the_same_data_give_the_same_bits() {
    const Parameters parameters;
    auto a = std::make_unique<Localiser>(parameters);
    auto b = std::make_unique<Localiser>(parameters);
    const Place place = one_room();
    fly(place, *a, Noise{}, 10U, parameters, 250.0, kUnspoilt);
    fly(place, *b, Noise{}, 10U, parameters, 250.0, kUnspoilt);
    TEST_ASSERT_TRUE(a->estimate().pose_map_body.x_m == b->estimate().pose_map_body.x_m);
    TEST_ASSERT_TRUE(a->estimate().pose_map_body.yaw_rad == b->estimate().pose_map_body.yaw_rad);
    TEST_ASSERT_TRUE(a->estimate().covariance == b->estimate().covariance);
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(stays_within_a_centimetre_in_a_room);
    RUN_TEST(closes_a_loop_through_two_rooms);
    RUN_TEST(works_with_fifty_hertz_and_three_centimetres);
    RUN_TEST(paper_preset_works);
    RUN_TEST(carried_back_it_says_lost_and_finds_the_place_in_the_old_map);
    RUN_TEST(carried_to_where_it_never_was_it_stays_lost);
    RUN_TEST(a_long_blind_corridor_is_called_lost);
    RUN_TEST(a_slow_error_of_the_attitude_is_taken_out_of_the_sweep);
    RUN_TEST(walls_lead_in_a_shaft);
    RUN_TEST(walls_of_a_new_layer_are_not_doubted);
    RUN_TEST(a_round_room_is_localised_by_points);
    RUN_TEST(bad_frames_are_bridged_and_counted);
    RUN_TEST(a_gap_of_two_seconds_is_bridged);
    RUN_TEST(a_frozen_inertial_sensor_is_done_without);
    RUN_TEST(starts_at_the_origin_and_forgets_nothing_of_empty_frames);
    RUN_TEST(the_same_data_give_the_same_bits);
    return UNITY_END();
}
