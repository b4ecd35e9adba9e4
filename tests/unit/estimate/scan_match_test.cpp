// ScanMap, Keyframes, ScanTracker: a sweep finds its place again.
#include <cmath>
#include <memory>

#include "core/random.hpp"
#include "estimate/scan_tracker.hpp"
#include "unity.h"

namespace {

using namespace noctule;

Parameters parameters;

/// An L-shaped room with a round pillar, seen from a pose: every surface that has a point in that direction.
LevelScan sweep(const Pose2<Map, Body>& pose, Random& random, const float sigma_m) {
    LevelScan scan;
    scan.t_us = 1000000;
    scan.range_max_m = 30.0F;
    scan.range_noise_m = 0.01F;
    struct Segment {
        float x0, y0, x1, y1;
    };
    constexpr Segment kWalls[] = {{-3, -2, 5, -2}, {5, -2, 5, 1}, {5, 1, 1, 1}, {1, 1, 1, 4}, {1, 4, -3, 4}, {-3, 4, -3, -2}};
    for (int i = 0; i < 540; ++i) {
        const float bearing = -2.35F + 4.7F * static_cast<float>(i) / 540.0F;
        const float dx = std::cos(bearing + pose.yaw_rad);
        const float dy = std::sin(bearing + pose.yaw_rad);
        float best = 30.0F;
        for (const Segment& w : kWalls) {
            const float ex = w.x1 - w.x0;
            const float ey = w.y1 - w.y0;
            const float d = dx * ey - dy * ex;
            if (std::abs(d) < 1e-6F) { continue; }
            const float t = ((w.x0 - pose.x_m) * ey - (w.y0 - pose.y_m) * ex) / d;
            const float u = ((w.x0 - pose.x_m) * dy - (w.y0 - pose.y_m) * dx) / d;
            if (t > 0.0F && u >= 0.0F && u <= 1.0F) { best = std::min(best, t); }
        }
        const float range_m = best + sigma_m * random.normal();
        (void)scan.points.push({range_m * std::cos(bearing), range_m * std::sin(bearing), 0.0F, 0.0F, 0.0F, range_m, static_cast<std::int16_t>(i), true});
    }
    return scan;
}

Matrix<float, 3, 3> covariance(const float m, const float rad) {
    Matrix<float, 3, 3> p;
    p(0, 0) = p(1, 1) = m * m;
    p(2, 2) = rad * rad;
    return p;
}

/// A tracker with a few keyframes of the room.
std::unique_ptr<ScanTracker> taught(Random& random) {
    auto tracker = std::make_unique<ScanTracker>(parameters);
    for (int k = 0; k < 6; ++k) {
        const Pose2<Map, Body> pose{0.35F * static_cast<float>(k) - 1.0F, 0.0F, 0.0F};
        tracker->take(sweep(pose, random, 0.01F));
        tracker->keep(pose, {});
    }
    return tracker;
}

void test_a_prediction_a_little_off_is_put_right() {
    Random random(3);
    const auto tracker = taught(random);
    TEST_ASSERT_EQUAL(6, tracker->frames().size());
    const Pose2<Map, Body> truth{0.2F, 0.15F, 0.3F};
    tracker->take(sweep(truth, random, 0.01F));
    const ScanFit& fit = tracker->match({truth.x_m + 0.06F, truth.y_m - 0.05F, truth.yaw_rad + 0.03F}, covariance(0.05F, 0.03F));
    TEST_ASSERT_TRUE(fit.match.valid);
    TEST_ASSERT_TRUE(fit.share > 0.9F);
    TEST_ASSERT_FLOAT_WITHIN(0.012F, truth.x_m, fit.match.pose.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.012F, truth.y_m, fit.match.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(0.005F, truth.yaw_rad, fit.match.pose.yaw_rad);
    TEST_ASSERT_EQUAL(0, tracker->counters().searches);
}

void test_a_prediction_far_off_is_searched_round() {
    Random random(4);
    const auto tracker = taught(random);
    const Pose2<Map, Body> truth{0.2F, 0.15F, 0.3F};
    tracker->take(sweep(truth, random, 0.01F));
    const ScanFit& fit = tracker->match({truth.x_m + 0.6F, truth.y_m - 0.5F, truth.yaw_rad + 0.4F}, covariance(0.4F, 0.25F));
    TEST_ASSERT_EQUAL(1, tracker->counters().searches);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, truth.x_m, fit.match.pose.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, truth.y_m, fit.match.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, truth.yaw_rad, fit.match.pose.yaw_rad);
}

/// Sweeps from one place at a rate, with a prediction that is right or 15 cm off.
struct Refusal {
    Random random{8};
    std::unique_ptr<ScanTracker> tracker = taught(random);
    Pose2<Map, Body> truth{0.2F, 0.15F, 0.3F};
    Pose2<Map, Body> off{truth.x_m + 0.15F, truth.y_m, truth.yaw_rad};
    std::int64_t t_us = 1000000;
    std::int64_t period_us = 50000;

    bool matched(const bool sure_motion, const Pose2<Map, Body>& predicted) {
        LevelScan scan = sweep(truth, random, 0.01F);
        scan.t_us = t_us += period_us;
        tracker->take(scan);
        return tracker->match(predicted, covariance(0.008F, 0.002F), sure_motion).match.valid;
    }
    int refused_in_a_row() {
        int refused = 0;
        while (refused < 100 && !matched(true, off)) { ++refused; }
        return refused;
    }
};

void test_a_match_that_an_inertial_prediction_rules_out_is_believed_after_a_second_only() {
    Refusal r;
    TEST_ASSERT_TRUE(r.matched(false, r.off));          // a wheel may slip
    TEST_ASSERT_EQUAL(20, r.refused_in_a_row());
    TEST_ASSERT_FLOAT_WITHIN(0.03F, r.truth.x_m, r.tracker->fit().match.pose.x_m);
    TEST_ASSERT_TRUE(r.matched(true, r.truth));
    TEST_ASSERT_FALSE(r.matched(true, r.off));          // counted anew
    TEST_ASSERT_EQUAL_FLOAT(r.off.x_m, r.tracker->fit().pose.x_m);
    TEST_ASSERT_TRUE(r.matched(true, r.truth));
    r.period_us = 25000;                                // 40 Hz: a second all the same
    TEST_ASSERT_EQUAL(40, r.refused_in_a_row());
}

void test_what_was_refused_before_the_map_was_corrected_or_left_does_not_count() {
    const auto again = [](auto&& changed) {
        Refusal r;
        for (int k = 0; k < 15; ++k) { TEST_ASSERT_FALSE(r.matched(true, r.off)); }
        changed(r);
        TEST_ASSERT_EQUAL(20, r.refused_in_a_row());
    };
    again([](Refusal& r) { r.tracker->relocate({}); });
    again([](Refusal& r) {
        r.tracker->clear();
        LevelScan scan = sweep(r.truth, r.random, 0.01F);
        scan.t_us = r.t_us += r.period_us;
        r.tracker->take(scan);
        r.tracker->keep(r.truth, {});
    });
}

void test_between_two_parallel_walls_nothing_is_said_along_them() {
    Random random(5);
    ScanTracker tracker(parameters);
    const auto corridor = [&](const float y_m) {
        LevelScan scan;
        scan.t_us = 1000000;
        for (int i = 0; i < 200; ++i) {
            const float x = 0.1F * static_cast<float>(i - 100);
            for (const float wall : {-1.0F - y_m, 1.0F - y_m}) {
                const float y = wall + 0.01F * random.normal();
                (void)scan.points.push({x, y, 0.0F, 0.0F, 0.0F, std::hypot(x, y), static_cast<std::int16_t>(i), true});
            }
        }
        return scan;
    };
    tracker.take(corridor(0.0F));
    tracker.keep({}, {});
    tracker.take(corridor(0.1F));
    const ScanFit& fit = tracker.match({0.05F, 0.05F, 0.0F}, covariance(0.05F, 0.02F));
    TEST_ASSERT_TRUE(fit.match.valid);
    TEST_ASSERT_FLOAT_WITHIN(0.01F, 0.1F, fit.match.pose.y_m);
    TEST_ASSERT_FLOAT_WITHIN(0.025F, 0.05F, fit.match.pose.x_m);
    TEST_ASSERT_TRUE(fit.match.lambda(0, 0) < 0.1F * fit.match.lambda(1, 1));
}

void test_an_empty_map_and_an_empty_sweep_give_no_match() {
    Random random(6);
    ScanTracker tracker(parameters);
    tracker.take(sweep({}, random, 0.01F));
    TEST_ASSERT_FALSE(tracker.match({}, covariance(0.1F, 0.1F)).match.valid);
    tracker.keep({}, {});
    tracker.take(LevelScan{});
    TEST_ASSERT_FALSE(tracker.match({}, covariance(0.1F, 0.1F)).match.valid);
}

void test_a_full_pool_gives_up_the_most_crowded_keyframe() {
    auto frames = std::make_unique<Keyframes>();
    ScanShape shape;
    (void)shape.push({1.0F, 2.0F});
    constexpr std::size_t kClose = kMaxKeyframes / 3U;
    constexpr auto kCloseM = static_cast<float>(kClose);
    for (std::size_t k = 0; k < kMaxKeyframes; ++k) {
        // One of them stands close to the one before.
        const float x_m = static_cast<float>(k) - (k == kClose ? 0.9F : 0.0F);
        frames->add(shape, {x_m, 0.0F, 0.0F}, {}, 0);
    }
    frames->add(shape, {static_cast<float>(kMaxKeyframes), 0.0F, 0.0F}, {}, 0);
    TEST_ASSERT_EQUAL(kMaxKeyframes, frames->size());
    TEST_ASSERT_EQUAL(1, frames->evicted());
    TEST_ASSERT_EQUAL_FLOAT(kCloseM - 2.0F, frames->pose(kClose - 2U).x_m);
    TEST_ASSERT_EQUAL_FLOAT(kCloseM - 0.9F, frames->pose(kClose - 1U).x_m);
    TEST_ASSERT_EQUAL_FLOAT(kCloseM + 1.0F, frames->pose(kClose).x_m);
    ScanShape out;
    frames->shape(5, out);
    TEST_ASSERT_EQUAL(1, out.size());
    TEST_ASSERT_FLOAT_WITHIN(0.0011F, 2.0F, out[0].y_m);
}

void test_a_shape_is_even_and_fits() {
    Random random(8);
    ScanShape shape;
    shape_of(sweep({0.0F, -1.9F, 0.0F}, random, 0.0F), shape);
    TEST_ASSERT_TRUE(shape.size() > 60 && shape.size() <= kMaxShapePoints);
    // The wall 0.1 m beside has hundreds of beams and gets no more points than its length is worth.
    std::size_t near = 0;
    for (const Point2<Body>& p : shape) { near += std::hypot(p.x_m, p.y_m) < 0.5F ? 1U : 0U; }
    TEST_ASSERT_TRUE(near < 16);
}

void test_what_beams_pass_through_is_told() {
    const auto map = std::make_unique<ScanMap>();
    map->start(0.0F, 0.0F);
    ScanShape near_wall, far_wall;
    for (int k = -30; k <= 30; ++k) {
        static_cast<void>(near_wall.push({3.0F, 0.05F * static_cast<float>(k)}));
        static_cast<void>(far_wall.push({6.0F, 0.05F * static_cast<float>(k)}));
    }
    const Pose2<Map, Body> pose{};
    map->add(near_wall.begin(), near_wall.size(), pose);
    map->add(far_wall.begin(), far_wall.size(), pose);
    // A sweep that hits the near one hides the far one; one that hits the far one has come through the near one.
    TEST_ASSERT_EQUAL_FLOAT(0.0F, map->passed_through(near_wall, pose, 9.0F));
    TEST_ASSERT_FLOAT_WITHIN(0.15F, 0.35F, map->passed_through(far_wall, pose, 9.0F));
    TEST_ASSERT_EQUAL_FLOAT(1.0F, map->passed_through(far_wall, pose, 2.0F));   // nothing in view says nothing
}

}  // namespace

extern "C" void setUp() { parameters = Parameters{}; }
extern "C" void tearDown() {}

int main() {
    UNITY_BEGIN();
    RUN_TEST(test_a_prediction_a_little_off_is_put_right);
    RUN_TEST(test_a_prediction_far_off_is_searched_round);
    RUN_TEST(test_a_match_that_an_inertial_prediction_rules_out_is_believed_after_a_second_only);
    RUN_TEST(test_what_was_refused_before_the_map_was_corrected_or_left_does_not_count);
    RUN_TEST(test_between_two_parallel_walls_nothing_is_said_along_them);
    RUN_TEST(test_an_empty_map_and_an_empty_sweep_give_no_match);
    RUN_TEST(test_a_full_pool_gives_up_the_most_crowded_keyframe);
    RUN_TEST(test_a_shape_is_even_and_fits);
    RUN_TEST(test_what_beams_pass_through_is_told);
    return UNITY_END();
}
