// The particle filter alone, fed with observations made by hand: association, doors, full pools, trust, parallel walls.
#include <cmath>
#include <memory>

#include "estimate/wall_filter.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

/// What a vehicle at a pose sees of the wall from (x0, y0) to (x1, y1), seen face on its side.
WallObservation seen(const Pose2<Map, Body>& pose, const float x0_m, const float y0_m, const float x1_m, const float y1_m) {
    const Pose2<Body, Map> inverse = pose.inverse();
    const Point2<Body> a = inverse * Point2<Map>{x0_m, y0_m};
    const Point2<Body> b = inverse * Point2<Map>{x1_m, y1_m};
    WallObservation wall;
    float alpha_rad = std::atan2(b.y_m - a.y_m, b.x_m - a.x_m) - 0.5F * kPi;
    float rho_m = a.x_m * std::cos(alpha_rad) + a.y_m * std::sin(alpha_rad);
    if (rho_m < 0.0F) {
        alpha_rad += kPi;
        rho_m = -rho_m;
    }
    wall.rho_m = rho_m;
    wall.alpha_rad = wrap_angle(alpha_rad);
    const float ta = -a.x_m * std::sin(alpha_rad) + a.y_m * std::cos(alpha_rad);
    const float tb = -b.x_m * std::sin(alpha_rad) + b.y_m * std::cos(alpha_rad);
    wall.from_m = std::min(ta, tb);
    wall.to_m = std::max(ta, tb);
    wall.lever_m = 0.5F * (ta + tb);
    wall.points = 100;
    wall.covariance = LineCovariance{4e-6F, 0.0F, 4e-6F}.sheared(wall.lever_m);
    return wall;
}

LevelScan empty_scan() {
    LevelScan scan;
    scan.range_max_m = 10.0F;
    return scan;
}

MotionIncrement still() {
    MotionIncrement motion;
    motion.dt_s = 0.05F;
    motion.covariance(0, 0) = motion.covariance(1, 1) = 1e-6F;
    motion.covariance(2, 2) = 1e-7F;
    return motion;
}

struct Scene {
    explicit Scene(const Parameters& parameters) : filter(std::make_unique<WallFilter>(parameters)) {}
    const WallFilter::Result& step(const MotionIncrement& motion, const std::initializer_list<WallObservation> list) {
        WallObservations walls;
        for (const WallObservation& wall : list) { static_cast<void>(walls.push(wall)); }
        filter->predict(motion);
        return filter->update(walls, PoseMatch{}, empty_scan());
    }
    std::unique_ptr<WallFilter> filter;
};

void corrects_a_wrong_prediction_from_two_walls() {
    const Parameters parameters;
    Scene scene(parameters);
    const Pose2<Map, Body> origin{};
    const auto ahead = [](const Pose2<Map, Body>& p) { return seen(p, 3.0F, -2.0F, 3.0F, 2.0F); };
    const auto left = [](const Pose2<Map, Body>& p) { return seen(p, -2.0F, 2.0F, 3.0F, 2.0F); };
    for (int i = 0; i < 10; ++i) { scene.step(still(), {ahead(origin), left(origin)}); }
    // The prediction says 3 cm ahead and 0.01 rad left, the walls say that nothing moved.
    MotionIncrement wrong = still();
    wrong.dx_m = 0.03F;
    wrong.dyaw_rad = 0.01F;
    wrong.covariance(0, 0) = 4e-4F;
    wrong.covariance(2, 2) = 1e-4F;
    const WallFilter::Result& result = scene.step(wrong, {ahead(origin), left(origin)});
    TEST_ASSERT_EQUAL_INT32(2, result.walls_matched);
    TEST_ASSERT_EQUAL_INT32(2, scene.filter->best_landmarks());
    TEST_ASSERT_FLOAT_WITHIN(0.004F, 0.0F, result.pose.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.002F, 0.0F, result.pose.yaw_rad);
    // The laser's own information points back by the whole error, not by the share that the prediction let pass.
    Matrix<double, 3, 3> inverse;
    TEST_ASSERT_TRUE(invert(result.laser.lambda, inverse));
    const Matrix<double, 3, 1> step = inverse * result.laser.b;
    TEST_ASSERT_DOUBLE_WITHIN(0.004, -0.03, step(0, 0));
    TEST_ASSERT_DOUBLE_WITHIN(0.002, -0.01, step(2, 0));
}

void a_door_splits_no_wall_and_two_rooms_share_none() {
    const Parameters parameters;
    Scene scene(parameters);
    const Pose2<Map, Body> pose{};
    scene.step(still(), {seen(pose, -3.0F, 2.0F, -0.5F, 2.0F)});
    scene.step(still(), {seen(pose, -3.0F, 2.0F, -0.5F, 2.0F), seen(pose, 0.5F, 2.0F, 3.0F, 2.0F)});  // beyond a door of 1 m
    TEST_ASSERT_EQUAL_INT32(1, scene.filter->best_landmarks());
    scene.step(still(), {seen(pose, 6.0F, 2.0F, 8.0F, 2.0F)});  // collinear, 3 m of nothing between: another wall
    TEST_ASSERT_EQUAL_INT32(2, scene.filter->best_landmarks());
    scene.step(still(), {seen(pose, 0.5F, 2.3F, 3.0F, 2.3F)});  // parallel, 0.3 m behind
    TEST_ASSERT_EQUAL_INT32(3, scene.filter->best_landmarks());
}

void two_pieces_that_grow_over_one_another_become_one_wall() {
    const Parameters parameters;
    Scene scene(parameters);
    const Pose2<Map, Body> pose{};
    // Long enough for every particle to have found them two walls.
    for (int i = 0; i < 25; ++i) { scene.step(still(), {seen(pose, -6.0F, 2.0F, -3.0F, 2.0F), seen(pose, 1.0F, 2.0F, 4.0F, 2.0F)}); }
    TEST_ASSERT_EQUAL_INT32(2, scene.filter->best_landmarks());
    TEST_ASSERT_EQUAL_UINT32(0U, scene.filter->counters().merged);
    for (int i = 0; i < 25; ++i) { scene.step(still(), {seen(pose, -6.0F, 2.0F, 1.5F, 2.0F)}); }   // the gap was no gap
    TEST_ASSERT_EQUAL_INT32(1, scene.filter->best_landmarks());
    Bounded<WallSegment, kMaxWalls> walls;
    scene.filter->best_walls(walls);
    const float x0_m = std::min(walls[0].end0.x_m, walls[0].end1.x_m);
    const float x1_m = std::max(walls[0].end0.x_m, walls[0].end1.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.05F, -6.0F, x0_m);
    TEST_ASSERT_FLOAT_WITHIN(0.05F, 4.0F, x1_m);
}

void the_two_faces_of_a_wall_are_two_landmarks() {
    const Parameters parameters;
    Scene scene(parameters);
    const Pose2<Map, Body> pose{};
    WallObservation face = seen(pose, -1.0F, 2.0F, 1.0F, 2.0F);
    scene.step(still(), {face});
    MotionIncrement across = still();
    across.dy_m = 4.0F;  // now on the other side of the wall
    scene.step(across, {seen(Pose2<Map, Body>{0.0F, 4.0F, 0.0F}, -1.0F, 2.1F, 1.0F, 2.1F)});
    Bounded<WallSegment, kMaxWalls> walls;
    scene.filter->best_walls(walls);
    TEST_ASSERT_EQUAL_size_t(2, walls.size());
    TEST_ASSERT_EQUAL_INT8(1, walls[0].line.v);
    TEST_ASSERT_EQUAL_INT8(-1, walls[1].line.v);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 2.0F, walls[0].line.r_m);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 2.1F, walls[1].line.r_m);
}

void full_pool_lets_the_least_seen_go() {
    Parameters parameters;
    parameters.landmarks_max = 4;
    parameters.particles = 5;
    Scene scene(parameters);
    const Pose2<Map, Body> pose{};
    const WallObservation kept = seen(pose, -1.0F, 2.0F, 1.0F, 2.0F);
    for (int i = 0; i < 5; ++i) { scene.step(still(), {kept}); }
    for (int i = 0; i < 6; ++i) {
        const float x_m = 2.0F + 0.8F * static_cast<float>(i);
        scene.step(still(), {kept, seen(pose, x_m, -1.0F, x_m, 1.0F)});
    }
    TEST_ASSERT_EQUAL_INT32(4, scene.filter->best_landmarks());
    TEST_ASSERT_TRUE(scene.filter->counters().evicted >= 5U);
    Bounded<WallSegment, kMaxWalls> walls;
    scene.filter->best_walls(walls);
    bool there = false;
    for (const WallSegment& wall : walls) { there = there || (std::abs(wall.line.r_m - 2.0F) < 0.05F && std::abs(wall.line.alpha_rad - 0.5F * kPi) < 0.05F); }
    TEST_ASSERT_TRUE(there);
}

void a_wall_that_beams_pass_through_is_removed() {
    const Parameters parameters;
    Scene scene(parameters);
    const Pose2<Map, Body> pose{};
    scene.step(still(), {seen(pose, 2.0F, -1.0F, 2.0F, 1.0F)});
    TEST_ASSERT_EQUAL_INT32(1, scene.filter->best_landmarks());
    LevelScan far = empty_scan();  // everything now is 6 m away
    for (int i = -400; i <= 400; ++i) {
        ScanPoint p;
        const float bearing_rad = 0.005F * static_cast<float>(i);
        p.x_m = 6.0F * std::cos(bearing_rad);
        p.y_m = 6.0F * std::sin(bearing_rad);
        p.range_m = 6.0F;
        p.hit = true;
        static_cast<void>(far.points.push(p));
    }
    for (int i = 0; i < 12; ++i) {
        scene.filter->predict(still());
        static_cast<void>(scene.filter->update(WallObservations{}, PoseMatch{}, far));
    }
    TEST_ASSERT_EQUAL_INT32(0, scene.filter->best_landmarks());
    TEST_ASSERT_TRUE(scene.filter->counters().removed > 0U);
}

void parallel_walls_say_nothing_along_themselves() {
    const Parameters parameters;
    Scene scene(parameters);
    const Pose2<Map, Body> pose{};
    const WallObservation left = seen(pose, -5.0F, 1.0F, 5.0F, 1.0F);
    const WallObservation right = seen(pose, -5.0F, -1.0F, 5.0F, -0.99F);  // a milliradian off
    WallFilter::Result result{};
    for (int i = 0; i < 40; ++i) { result = scene.step(still(), {left, right}); }
    const Eigen2<double> information = eigen_symmetric(result.laser.lambda(0, 0), result.laser.lambda(0, 1), result.laser.lambda(1, 1));
    TEST_ASSERT_TRUE(std::abs(information.small) < 1e-9 * information.large);
    // A source that doubts its pose along the corridor widens the particles to that doubt, and the walls do not shrink it.
    MotionIncrement doubtful = still();
    doubtful.pose_covariance(0, 0) = 0.01F;
    for (int i = 0; i < 20; ++i) { result = scene.step(doubtful, {left, right}); }
    TEST_ASSERT_TRUE(std::sqrt(result.spread(0, 0)) > 0.05F && std::sqrt(result.spread(0, 0)) < 0.2F);
    TEST_ASSERT_TRUE(std::sqrt(result.spread(1, 1)) < 0.01F);
}

void walls_a_little_askew_pull_no_particle_along() {
    // A doubt of 1 m along a corridor, once: no particle may be moved along by the small difference in direction of the walls.
    Parameters parameters;
    parameters.lost_sigma_m = 2.0F;
    Scene scene(parameters);
    const Pose2<Map, Body> pose{};
    const WallObservation left = seen(pose, -5.0F, 1.0F, 5.0F, 1.0F);
    for (int i = 0; i < 5; ++i) { scene.step(still(), {left, seen(pose, -5.0F, -1.0F, 5.0F, -0.94F)}); }
    MotionIncrement doubtful = still();
    doubtful.pose_covariance(0, 0) = 1.0F;
    // The right wall now seems 4 mm nearer: without equation 7 that is worth most of a metre along the corridor.
    const WallFilter::Result& result = scene.step(doubtful, {left, seen(pose, -5.0F, -0.996F, 5.0F, -0.936F)});
    TEST_ASSERT_TRUE(std::sqrt(result.spread(0, 0)) > 0.6F);
}

void covariance_of_the_map_grows_with_each_place() {
    // A walk along a chain of rooms, each seen only together with the next: the frame's doubt rises and falls on the way home.
    const Parameters parameters;
    Scene scene(parameters);
    Pose2<Map, Body> pose{};
    const auto walls_at = [&pose](Scene& s, const MotionIncrement& motion) {
        const float x0 = 6.0F * std::floor((pose.x_m + 3.0F) / 6.0F);
        return s.step(motion, {seen(pose, x0 - 2.0F, 2.0F + 0.2F * std::fmod(x0 / 6.0F, 2.0F), x0 + 2.0F, 2.0F + 0.2F * std::fmod(x0 / 6.0F, 2.0F)),
                               seen(pose, x0 + 4.0F, -1.0F, x0 + 4.0F, 1.0F)});
    };
    float doubt_near = 0.0F, doubt_far = 0.0F, turn_near = 0.0F, turn_far = 0.0F;
    for (int i = 0; i <= 240; ++i) {
        const WallFilter::Result& result = walls_at(scene, still());
        if (i == 20 || i == 240) {
            (i == 20 ? doubt_near : doubt_far) = result.map_drift(0, 0) + result.map_drift(1, 1);
            (i == 20 ? turn_near : turn_far) = result.map_drift(2, 2);
        }
        MotionIncrement step = still();
        step.dx_m = 0.1F;
        scene.filter->predict(step);
        pose.x_m += 0.1F;
    }
    TEST_ASSERT_TRUE(doubt_far > 3.0F * doubt_near);
    TEST_ASSERT_TRUE(turn_far > 2.0F * turn_near);
}

/// Along a wall without an end, then the wall across that was seen at the start: doubt about the frame along the way.
void along_a_wall_doubt_grows_and_falls_slowly_again(const bool match_leads) {
    const Parameters parameters;
    Scene scene(parameters);
    Pose2<Map, Body> pose{};
    const auto step = [&](const float dx_m, const bool across) {
        MotionIncrement motion = still();
        motion.dx_m = dx_m;
        pose.x_m += dx_m;
        WallObservations walls;
        static_cast<void>(walls.push(seen(pose, -5.0F, 2.0F, 45.0F, 2.0F)));
        if (across) { static_cast<void>(walls.push(seen(pose, 30.0F, -1.0F, 30.0F, 1.5F))); }
        scene.filter->predict(motion);
        if (!match_leads) { return scene.filter->update(walls, PoseMatch{}, empty_scan()).map_drift(0, 0); }
        ScanFit fit;
        fit.pose = pose;
        fit.match.valid = true;
        fit.match.pose = pose;
        fit.match.lambda(0, 0) = fit.match.lambda(1, 1) = 1e6F;
        fit.match.lambda(2, 2) = 1e8F;
        return scene.filter->follow(walls, fit, empty_scan()).map_drift(0, 0);
    };
    float known = 0.0F;
    for (int i = 0; i < 20; ++i) { known = step(0.0F, true); }
    float grown = 0.0F;
    for (int i = 0; i < 200; ++i) { grown = step(0.1F, false); }
    TEST_ASSERT_FLOAT_WITHIN(0.2F * 5e-4F, 20.0F * 0.005F * 0.005F, grown - known);
    TEST_ASSERT_TRUE(step(0.0F, true) > 0.97F * grown);   // meeting it once is no proof
    float after = 0.0F;
    for (int i = 0; i < 300; ++i) { after = step(0.0F, true); }
    TEST_ASSERT_TRUE(after < 0.2F * grown);
}

void along_a_wall_doubt_grows_and_falls_slowly_where_walls_lead() { along_a_wall_doubt_grows_and_falls_slowly_again(false); }
void along_a_wall_doubt_grows_and_falls_slowly_where_the_match_leads() { along_a_wall_doubt_grows_and_falls_slowly_again(true); }

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(corrects_a_wrong_prediction_from_two_walls);
    RUN_TEST(a_door_splits_no_wall_and_two_rooms_share_none);
    RUN_TEST(two_pieces_that_grow_over_one_another_become_one_wall);
    RUN_TEST(the_two_faces_of_a_wall_are_two_landmarks);
    RUN_TEST(full_pool_lets_the_least_seen_go);
    RUN_TEST(a_wall_that_beams_pass_through_is_removed);
    RUN_TEST(parallel_walls_say_nothing_along_themselves);
    RUN_TEST(walls_a_little_askew_pull_no_particle_along);
    RUN_TEST(covariance_of_the_map_grows_with_each_place);
    RUN_TEST(along_a_wall_doubt_grows_and_falls_slowly_where_walls_lead);
    RUN_TEST(along_a_wall_doubt_grows_and_falls_slowly_where_the_match_leads);
    return UNITY_END();
}
