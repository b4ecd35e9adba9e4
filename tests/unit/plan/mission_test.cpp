// The mission's table: every state is entered for its reason, and bad news end a flight in the stated way.
#include <cmath>
#include <memory>

#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

/// A mission in a room of 4 x 4 m whose world is told to it step by step.
struct Desk {
    Parameters p;
    OccupancyGrid grid{p};
    Mission mission{p};
    Estimate estimate;
    VehicleSample vehicle;
    Pose2<Map, Body> last;
    std::int64_t t_us = 0;
    Target::Mode mode = Target::Mode::none;
    float target_z_m = 0.0F;

    Desk() {
        estimate.planar.quality = 80;
        estimate.altitude.valid = true;
        estimate.altitude.z_m = 0.1F;
        estimate.altitude.ground_z_m = 0.0F;
        estimate.altitude.ceiling_z_m = 2.5F;
        vehicle.landed = VehicleSample::Landed::on_ground;
    }
    void step(const Order order = Order::none) {
        t_us += 50000;
        estimate.t_us = t_us;
        vehicle.t_us = t_us;
        Bounded<CommandSample, kMaxCommandPerStep> orders;
        if (order != Order::none) { static_cast<void>(orders.push({t_us, order})); }
        const Target& target = mission.step(estimate, grid, vehicle, orders, last, t_us);
        mode = target.mode;
        target_z_m = target.z_m;
    }
    void steps(const int n) {
        for (int k = 0; k < n; ++k) { step(); }
    }
    void look() {
        test::FlatWorld world;
        world.add_wall(-2.0, -2.0, 2.0, -2.0);
        world.add_wall(-2.0, 2.0, 2.0, 2.0);
        world.add_wall(-2.0, -2.0, -2.0, 2.0);
        world.add_wall(2.0, -2.0, 2.0, 2.0);
        std::mt19937 rng(1);
        LevelScan scan;
        for (const float yaw : {0.0F, 1.5F, 3.0F}) {
            Estimate e = estimate;
            e.planar.pose_map_body.yaw_rad = yaw;
            for (int k = 0; k < 4; ++k) {
                test::sweep(world, 0.0, 0.0, static_cast<double>(yaw), 10.0, 0.0, rng, scan);
                grid.integrate(e, scan);
            }
        }
    }
    /// A hall of 24 x 8 m seen from its middle: what is beyond 10 m is unknown.
    void look_hall() {
        test::FlatWorld world;
        world.add_wall(-12.0, -4.0, 12.0, -4.0);
        world.add_wall(-12.0, 4.0, 12.0, 4.0);
        world.add_wall(-12.0, -4.0, -12.0, 4.0);
        world.add_wall(12.0, -4.0, 12.0, 4.0);
        world.add_wall(4.0, -4.0, 4.0, 2.0);
        world.turn(0.297);
        std::mt19937 rng(1);
        LevelScan scan;
        for (const float yaw : {0.0F, 1.5F, 3.0F, 4.5F}) {
            Estimate e = estimate;
            e.planar.pose_map_body.yaw_rad = wrap_angle(yaw);
            for (int k = 0; k < 4; ++k) {
                test::sweep(world, 0.0, 0.0, static_cast<double>(yaw), 10.0, 0.0, rng, scan);
                grid.integrate(e, scan);
            }
        }
    }
    void explore_hall() {
        hall = true;
        explore();
    }
    bool hall = false;

    /// Flies up to exploring.
    void explore() {
        steps(30);
        step(Order::start);
        vehicle.armed = vehicle.offboard = true;
        step();
        estimate.altitude.z_m = 1.0F;
        vehicle.landed = VehicleSample::Landed::in_air;
        steps(12);
        TEST_ASSERT_EQUAL(MissionState::looking_around, mission.state());
        hall ? look_hall() : look();
        for (int k = 0; k < 60 && mission.state() == MissionState::looking_around; ++k) {
            estimate.planar.pose_map_body.yaw_rad = wrap_angle(estimate.planar.pose_map_body.yaw_rad + 0.05F);
            step();
        }
        TEST_ASSERT_EQUAL(MissionState::exploring, mission.state());
        TEST_ASSERT_EQUAL(StateReason::looked_around, mission.reason());
    }
};

void expect(const Desk& d, const MissionState state, const StateReason reason) {
    TEST_ASSERT_EQUAL(state, d.mission.state());
    TEST_ASSERT_EQUAL(reason, d.mission.reason());
}

void a_start_is_refused_until_the_estimates_have_been_good_for_a_while() {
    const auto d = std::make_unique<Desk>();
    d->estimate.planar.quality = -1;
    d->steps(40);
    TEST_ASSERT_FALSE(d->mission.ready());
    d->step(Order::start);
    expect(*d, MissionState::waiting, StateReason::not_ready);
    d->estimate.planar.quality = 80;
    d->steps(10);
    TEST_ASSERT_FALSE(d->mission.ready());
    d->steps(20);
    TEST_ASSERT_TRUE(d->mission.ready());
    d->step(Order::start);
    expect(*d, MissionState::taking_off, StateReason::start_ordered);
}

void a_start_is_refused_while_the_frames_disagree() {
    const auto d = std::make_unique<Desk>();
    d->vehicle.local_position_valid = true;
    d->vehicle.local_map_m = {2.0F, 0.0F, 0.0F};
    d->steps(60);
    TEST_ASSERT_FALSE(d->mission.ready());
}

void it_stands_until_armed_then_climbs_looks_round_and_explores() {
    const auto d = std::make_unique<Desk>();
    d->steps(30);
    TEST_ASSERT_EQUAL(Target::Mode::none, d->mode);
    d->step(Order::start);
    d->steps(100);                                   // not armed: the setpoint stays on the spot, and no clock runs out
    TEST_ASSERT_EQUAL(Target::Mode::ground, d->mode);
    expect(*d, MissionState::taking_off, StateReason::start_ordered);
    d->vehicle.armed = true;
    d->step();
    TEST_ASSERT_EQUAL(Target::Mode::ground, d->mode); // armed but not in our mode
    d->vehicle.offboard = true;
    d->step();
    TEST_ASSERT_EQUAL(Target::Mode::follow, d->mode);
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.0F, d->target_z_m);
}

void a_room_seen_whole_is_left_for_home_and_the_landing_ends_on_the_ground() {
    const auto d = std::make_unique<Desk>();
    d->explore();
    for (int k = 0; k < 200 && d->mission.state() == MissionState::exploring; ++k) { d->step(); }
    expect(*d, MissionState::returning_home, StateReason::nothing_left);
    d->steps(60);
    expect(*d, MissionState::landing, StateReason::at_home);
    TEST_ASSERT_EQUAL(Target::Mode::land, d->mode);
    TEST_ASSERT_TRUE(d->target_z_m < -0.5F);         // through the floor: only the autopilot ends it
    d->steps(200);
    TEST_ASSERT_FALSE(d->mission.want_disarm());
    d->vehicle.landed = VehicleSample::Landed::on_ground;
    d->step();
    expect(*d, MissionState::landed, StateReason::on_ground);
    TEST_ASSERT_TRUE(d->mission.want_disarm());
    TEST_ASSERT_EQUAL(Target::Mode::none, d->mode);
}

void lost_localisation_hovers_then_lands() {
    const auto d = std::make_unique<Desk>();
    d->explore();
    d->last = {0.3F, 0.2F, 0.1F};
    d->estimate.planar.quality = -1;
    d->step();
    TEST_ASSERT_EQUAL(Target::Mode::hold, d->mode);
    d->steps(60);                                    // 3 s: still hovering
    TEST_ASSERT_EQUAL(MissionState::exploring, d->mission.state());
    d->steps(45);
    expect(*d, MissionState::landing, StateReason::localisation_lost);
}

void short_losses_do_not_end_a_flight() {
    const auto d = std::make_unique<Desk>();
    d->explore_hall();   // in a room seen whole the flight is over soon, losses or not
    for (int k = 0; k < 5; ++k) {
        d->estimate.planar.quality = -1;
        d->steps(60);
        d->estimate.planar.quality = 80;
        d->step();
        TEST_ASSERT_TRUE(d->mission.state() == MissionState::exploring || d->mission.state() == MissionState::returning_home);
    }
}

void each_bad_news_has_its_end() {
    const auto lost_height = std::make_unique<Desk>();
    lost_height->explore();
    lost_height->estimate.planar.pose_map_body.x_m = 0.5F;
    lost_height->estimate.altitude.valid = false;
    lost_height->steps(110);
    expect(*lost_height, MissionState::landing, StateReason::height_lost);

    const auto pilot = std::make_unique<Desk>();
    pilot->explore();
    pilot->vehicle.mission_lost = true;
    pilot->step();
    expect(*pilot, MissionState::aborted, StateReason::control_lost);
    TEST_ASSERT_EQUAL(Target::Mode::none, pilot->mode);

    const auto battery = std::make_unique<Desk>();
    battery->explore();
    battery->vehicle.battery_remaining = 0.1F;
    battery->step();
    expect(*battery, MissionState::returning_home, StateReason::battery_low);

    const auto frames = std::make_unique<Desk>();
    frames->explore();
    frames->estimate.planar.pose_map_body.x_m = 0.5F;
    frames->vehicle.local_position_valid = true;
    frames->vehicle.local_map_m = {3.0F, 0.0F, 1.0F};
    frames->steps(70);
    expect(*frames, MissionState::landing, StateReason::frames_disagree);

    const auto stuck = std::make_unique<Desk>();
    stuck->steps(30);
    stuck->step(Order::start);
    stuck->vehicle.armed = stuck->vehicle.offboard = true;
    stuck->vehicle.landed = VehicleSample::Landed::in_air;
    stuck->steps(static_cast<int>(stuck->p.takeoff_time_s * 20.0F) + 5);
    expect(*stuck, MissionState::landing, StateReason::takeoff_timed_out);
}

void orders_are_obeyed() {
    const auto d = std::make_unique<Desk>();
    d->explore();
    d->step(Order::pause);
    expect(*d, MissionState::paused, StateReason::pause_ordered);
    d->steps(100);
    expect(*d, MissionState::paused, StateReason::pause_ordered);
    d->step(Order::resume);
    expect(*d, MissionState::exploring, StateReason::resume_ordered);
    d->step(Order::return_home);
    expect(*d, MissionState::returning_home, StateReason::return_ordered);
    d->step(Order::land);
    expect(*d, MissionState::landing, StateReason::land_ordered);

    const auto a = std::make_unique<Desk>();
    a->explore();
    a->step(Order::abort);
    expect(*a, MissionState::landing, StateReason::abort_ordered);

    const auto g = std::make_unique<Desk>();
    g->steps(30);
    g->step(Order::start);
    g->step(Order::abort);                           // before arming: back to waiting, nothing was flown
    expect(*g, MissionState::waiting, StateReason::abort_ordered);
}

void a_vehicle_that_is_held_back_gives_up_goal_by_goal_and_then_lands() {
    const auto d = std::make_unique<Desk>();
    d->p.progress_time_s = 3600.0F;                  // the mission's own patience does not end it first
    d->explore_hall();                               // half of a hall unknown, and the vehicle does not follow its setpoints
    d->steps(20 * 20);
    TEST_ASSERT_TRUE(d->mission.explorer().counters().policy.stuck > 0U);
    for (int k = 0; k < 20 * 400 && d->mission.state() == MissionState::exploring; ++k) { d->step(); }
    expect(*d, MissionState::returning_home, StateReason::nothing_left);
    d->estimate.planar.pose_map_body.x_m = 1.0F;     // and not home either
    d->last.x_m = 1.0F;
    for (int k = 0; k < 20 * 40 && d->mission.state() == MissionState::returning_home; ++k) { d->step(); }
    expect(*d, MissionState::landing, StateReason::home_unreachable);
}

void exploring_without_learning_anything_ends_and_says_so() {
    const auto d = std::make_unique<Desk>();
    d->p.progress_time_s = 10.0F;
    d->explore_hall();
    d->steps(20 * 9);
    TEST_ASSERT_EQUAL(MissionState::exploring, d->mission.state());
    d->look_hall();                                  // something new: cells at the walls firm up
    LevelScan scan;
    std::mt19937 rng(2);
    test::FlatWorld open;
    open.add_wall(-9.0, -30.0, -9.0, 30.0);
    Estimate e = d->estimate;
    e.planar.pose_map_body.yaw_rad = 3.14F;
    test::sweep(open, 0.0, 0.0, 3.14, 10.0, 0.0, rng, scan);
    for (int k = 0; k < 8; ++k) { d->grid.integrate(e, scan); }
    d->steps(20 * 9);                                // the clock began anew
    TEST_ASSERT_EQUAL(MissionState::exploring, d->mission.state());
    for (int k = 0; k < 20 * 4 && d->mission.state() == MissionState::exploring; ++k) { d->step(); }
    expect(*d, MissionState::returning_home, StateReason::no_progress);
}

void a_start_outside_the_fence_is_refused() {
    const auto d = std::make_unique<Desk>();
    d->p.fence_back_m = 0.5F;
    d->estimate.planar.pose_map_body.x_m = -0.6F;
    d->steps(40);
    d->step(Order::start);
    expect(*d, MissionState::waiting, StateReason::not_ready);
    d->p.fence_back_m = 2.0F;
    d->steps(40);
    d->step(Order::start);
    expect(*d, MissionState::taking_off, StateReason::start_ordered);
}

void the_height_keeps_clear_of_ceiling_and_furniture() {
    const auto d = std::make_unique<Desk>();
    d->explore();
    d->estimate.altitude.ground_z_m = 0.55F;         // a table: the height holds
    d->step();
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.0F, d->target_z_m);
    d->estimate.altitude.ground_z_m = 0.95F;         // a cupboard: over it
    d->step();
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 0.95F + 0.10F + d->p.vertical_clearance_m, d->target_z_m);
    d->estimate.altitude.ground_z_m = 0.0F;
    d->estimate.altitude.ceiling_z_m = 1.1F;         // a beam: under it
    d->step();
    TEST_ASSERT_FLOAT_WITHIN(1e-5F, 1.1F - 0.10F - d->p.vertical_clearance_m, d->target_z_m);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_start_is_refused_until_the_estimates_have_been_good_for_a_while);
    RUN_TEST(a_start_is_refused_while_the_frames_disagree);
    RUN_TEST(it_stands_until_armed_then_climbs_looks_round_and_explores);
    RUN_TEST(a_room_seen_whole_is_left_for_home_and_the_landing_ends_on_the_ground);
    RUN_TEST(lost_localisation_hovers_then_lands);
    RUN_TEST(short_losses_do_not_end_a_flight);
    RUN_TEST(each_bad_news_has_its_end);
    RUN_TEST(orders_are_obeyed);
    RUN_TEST(a_vehicle_that_is_held_back_gives_up_goal_by_goal_and_then_lands);
    RUN_TEST(exploring_without_learning_anything_ends_and_says_so);
    RUN_TEST(a_start_outside_the_fence_is_refused);
    RUN_TEST(the_height_keeps_clear_of_ceiling_and_furniture);
    return UNITY_END();
}
