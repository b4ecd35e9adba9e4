// From a region to a place on the map: camera, pose at the frame's time, laser, floor; and which object it is.
#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "recognise/object_memory.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::CameraModel;
using noctule::ObjectMemory;
using noctule::Observation;
using noctule::Placement;
using noctule::PoseHistory;
using noctule::RangeSource;
using noctule::Vec3;
using noctule::VehiclePose;

namespace {

VehiclePose standing(const double x_m, const double y_m, const double yaw_rad, const std::int64_t t_us) {
    VehiclePose p;
    p.t_us = t_us;
    p.x_m = x_m;
    p.y_m = y_m;
    p.z_m = 1.0;
    p.yaw_rad = yaw_rad;
    p.ceiling_z_m = 2.5;
    p.usable = true;
    return p;
}

void pixel_and_ray_are_inverse_with_lens_and_mount() {
    CameraModel c;
    c.distortion = {-0.21, 0.06, 0.001, -0.0008, 0.0};
    c.yaw_rad = 0.2;
    c.pitch_rad = 0.3;
    for (const double u : {20.0, 160.0, 300.0}) {
        for (const double v : {15.0, 120.0, 225.0}) {
            const Vec3 d = c.ray_body(u, v);
            const Vec3 p{c.position_body_m[0] + 3.0 * d[0], c.position_body_m[1] + 3.0 * d[1], c.position_body_m[2] + 3.0 * d[2]};
            double u2 = 0.0;
            double v2 = 0.0;
            TEST_ASSERT_TRUE(c.pixel(p, u2, v2));
            TEST_ASSERT_DOUBLE_WITHIN(0.05, u, u2);
            TEST_ASSERT_DOUBLE_WITHIN(0.05, v, v2);
        }
    }
    // Pitched down by 0.3: the middle looks at a floor 1 m below at 1 / tan(0.3) ahead.
    CameraModel down;
    down.pitch_rad = 0.3;
    const Vec3 d = down.ray_body(down.cx_px, down.cy_px);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -std::tan(0.3), d[2] / d[0]);
}

void calibration_file_of_opencv_is_read_and_a_bad_one_refused() {
    const std::string path = "place_test_camera.yaml";
    std::ofstream{path} << "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
                           "   data: [ 520., 0., 310., 0., 525., 250., 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n"
                           "   dt: d\n   data: [ -0.2, 0.05, 0.001, 0.002, 0.01 ]\nposition_body_m: [ 0.1, 0.02, -0.03 ]\npitch_rad: 0.25\n";
    CameraModel c;
    std::string error;
    TEST_ASSERT_TRUE(noctule::load_camera(path, c, error));
    TEST_ASSERT_EQUAL_INT(640, c.width);
    TEST_ASSERT_EQUAL_DOUBLE(525.0, c.fy_px);
    TEST_ASSERT_EQUAL_DOUBLE(0.002, c.distortion[3]);
    TEST_ASSERT_EQUAL_DOUBLE(-0.03, c.position_body_m[2]);
    TEST_ASSERT_EQUAL_DOUBLE(0.25, c.pitch_rad);
    std::ofstream{path} << "%YAML:1.0\n---\nimage_width: 640\n";
    TEST_ASSERT_FALSE(noctule::load_camera(path, c, error));
    TEST_ASSERT_EQUAL_INT(640, c.width);
    TEST_ASSERT_TRUE(error.find("camera_matrix") != std::string::npos);
    TEST_ASSERT_FALSE(noctule::load_camera("no_such_camera.yaml", c, error));
    std::remove(path.c_str());
}

void pose_is_that_of_the_frames_time() {
    PoseHistory h;
    VehiclePose out;
    TEST_ASSERT_FALSE(h.at(0, out));
    h.add(standing(1.0, 0.0, 3.1, 100000));
    h.add(standing(1.1, 0.0, -3.1, 150000));
    TEST_ASSERT_TRUE(h.at(110000, out));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 1.02, out.x_m);
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, 3.1 + 0.2 * (2.0 * 3.14159265358979 - 6.2), out.yaw_rad);  // the short way round
    TEST_ASSERT_FALSE(h.at(160000, out));
    TEST_ASSERT_FALSE(h.at(90000, out));
    VehiclePose jumped = standing(4.0, 0.0, 0.0, 200000);
    jumped.reset_counter = 1;
    h.add(jumped);
    TEST_ASSERT_FALSE(h.at(170000, out));
    h.add(standing(4.0, 0.0, 0.0, 900000));
    TEST_ASSERT_FALSE(h.at(500000, out));  // too long without a pose
}

/// A cylinder of radius 0.3 m and height 1.3 m at (x, y), seen from a pose: what camera and laser see of it before a wall at x = 8 m.
struct Scene {
    cv::Mat labels = cv::Mat::zeros(240, 320, CV_32S);
    noctule::Region region;
    std::vector<Vec3> hits;
};

Scene look_at(const CameraModel& camera, const VehiclePose& pose, const double x_m, const double y_m) {
    Scene s;
    const Vec3 eye = pose.to_map(camera.position_body_m);
    int left = 320, right = -1, top = 240, bottom = -1;
    double sx = 0.0, sy = 0.0;
    for (int v = 0; v < 240; ++v) {
        for (int u = 0; u < 320; ++u) {
            const Vec3 d = pose.turn_to_map(camera.ray_body(u, v));
            const double a = d[0] * d[0] + d[1] * d[1];
            const double b = d[0] * (eye[0] - x_m) + d[1] * (eye[1] - y_m);
            const double q = b * b - a * (std::pow(eye[0] - x_m, 2) + std::pow(eye[1] - y_m, 2) - 0.09);
            if (q < 0.0) { continue; }
            const double t = (-b - std::sqrt(q)) / a;
            const double z = eye[2] + t * d[2];
            if (t <= 0.0 || z < 0.0 || z > 1.3) { continue; }
            s.labels.at<int>(v, u) = 1;
            ++s.region.area_px;
            sx += u;
            sy += v;
            left = std::min(left, u);
            right = std::max(right, u);
            top = std::min(top, v);
            bottom = std::max(bottom, v);
        }
    }
    s.region.label = 1;
    s.region.x_px = static_cast<float>(sx / s.region.area_px);
    s.region.y_px = static_cast<float>(sy / s.region.area_px);
    s.region.left_px = left;
    s.region.top_px = top;
    s.region.width_px = right - left + 1;
    s.region.height_px = bottom - top + 1;
    for (int i = -400; i <= 400; ++i) {
        const double bearing = pose.yaw_rad + 0.004363 * i;
        const double c = std::cos(bearing), n = std::sin(bearing);
        const double b = c * (pose.x_m - x_m) + n * (pose.y_m - y_m);
        const double q = b * b - (std::pow(pose.x_m - x_m, 2) + std::pow(pose.y_m - y_m, 2) - 0.09);
        double range = c > 0.05 ? (8.0 - pose.x_m) / c : 30.0;
        if (q >= 0.0 && -b - std::sqrt(q) > 0.0) { range = -b - std::sqrt(q); }
        s.hits.push_back({pose.x_m + range * c, pose.y_m + range * n, pose.z_m});
    }
    return s;
}

void cylinder_is_placed_at_its_centre_from_any_side() {
    const CameraModel camera;
    const auto placer = std::make_unique<noctule::Placer>();
    const auto parts = std::make_unique<noctule::Parts>();
    for (const double yaw : {-0.3, 0.0, 0.25}) {
        VehiclePose pose = standing(0.0, 0.0, yaw, 0);
        pose.pitch_rad = 0.03;
        const Scene s = look_at(camera, pose, 3.0, 0.2);
        placer->start(camera, pose, s.hits);
        parts->clear();
        placer->find(s.labels, s.region, *parts);
        TEST_ASSERT_EQUAL_size_t(1, parts->size());
        const Placement p = (*parts)[0].place;
        TEST_ASSERT_TRUE(p.source == RangeSource::laser);
        TEST_ASSERT_TRUE(p.whole);
        TEST_ASSERT_DOUBLE_WITHIN(0.04, 3.0, p.x_m);
        TEST_ASSERT_DOUBLE_WITHIN(0.03, 0.2, p.y_m);
        TEST_ASSERT_DOUBLE_WITHIN(0.06, 0.6, p.width_m);
        TEST_ASSERT_DOUBLE_WITHIN(0.12, 1.3, p.height_m);
        // Without the laser the floor tells, less well and knowing it.
        placer->start(camera, pose, {});
        parts->clear();
        placer->find(s.labels, s.region, *parts);
        const Placement& f = (*parts)[0].place;
        TEST_ASSERT_TRUE(f.source == RangeSource::floor);
        TEST_ASSERT_DOUBLE_WITHIN(0.25, 3.0, f.x_m);
        TEST_ASSERT_TRUE(f.along_sigma_m > p.along_sigma_m);
    }
}

void laser_that_just_passes_over_the_top_is_no_range() {
    // The laser sees the wall 8 m away; a tilt that is told 1 px wrong puts its points inside the upper side of the region.
    const CameraModel camera;
    const auto placer = std::make_unique<noctule::Placer>();
    const auto parts = std::make_unique<noctule::Parts>();
    const VehiclePose pose = standing(0.0, 0.0, 0.0, 0);
    Scene s = look_at(camera, pose, 3.0, 0.2);
    s.hits.clear();
    for (int u = 0; u < 320; ++u) {
        const Vec3 eye = pose.to_map(camera.position_body_m);
        const Vec3 d = pose.turn_to_map(camera.ray_body(u, s.region.top_px + 1));
        s.hits.push_back({eye[0] + 7.88 * d[0] / d[0], eye[1] + 7.88 * d[1] / d[0], eye[2] + 7.88 * d[2] / d[0]});
    }
    placer->start(camera, pose, s.hits);
    placer->find(s.labels, s.region, *parts);
    TEST_ASSERT_EQUAL_size_t(1, parts->size());
    TEST_ASSERT_TRUE((*parts)[0].place.source == RangeSource::floor);
    TEST_ASSERT_DOUBLE_WITHIN(0.3, 3.0, (*parts)[0].place.x_m);
}

void range_of_what_stands_behind_is_not_taken() {
    // A region whose lower side meets the floor 2 m away, with laser points 5 m away inside it: two things in one region.
    const CameraModel camera;
    const auto placer = std::make_unique<noctule::Placer>();
    const auto parts = std::make_unique<noctule::Parts>();
    const VehiclePose pose = standing(0.0, 0.0, 0.0, 0);
    const Scene s = look_at(camera, pose, 2.3, 0.0);
    std::vector<Vec3> behind;
    for (int i = -200; i <= 200; ++i) { behind.push_back({5.0, 5.0 * std::tan(0.004363 * i), 1.0}); }
    placer->start(camera, pose, behind);
    placer->find(s.labels, s.region, *parts);
    TEST_ASSERT_EQUAL_size_t(1, parts->size());
    TEST_ASSERT_TRUE((*parts)[0].place.source == RangeSource::none);
}

void what_the_lower_border_cuts_stands_before_where_its_ray_meets_the_floor() {
    const CameraModel camera;
    const auto placer = std::make_unique<noctule::Placer>();
    const auto parts = std::make_unique<noctule::Parts>();
    VehiclePose pose = standing(0.0, 0.0, 0.0, 0);
    pose.z_m = 1.6;                       // over the top of it, 1.2 m away: the laser sees only the wall
    Scene s = look_at(camera, pose, 1.5, 0.0);
    TEST_ASSERT_EQUAL_INT(240, s.region.top_px + s.region.height_px);
    s.hits.clear();
    for (int i = -400; i <= 400; ++i) { s.hits.push_back({8.0, 8.0 * std::tan(0.002 * i), 1.6}); }
    placer->start(camera, pose, s.hits);
    placer->find(s.labels, s.region, *parts);
    const Placement& p = (*parts)[0].place;
    TEST_ASSERT_FALSE(p.whole);
    TEST_ASSERT_TRUE(std::fabs(p.x_m - 1.5) < 2.0 * p.along_sigma_m + 0.3);
    TEST_ASSERT_TRUE(p.x_m < 3.5);
}

Observation seen(const double x_m, const double y_m, const double from_rad, const int frame, const std::size_t hue, std::mt19937& rng) {
    std::normal_distribution<double> along{0.0, 0.10};
    std::normal_distribution<double> across{0.0, 0.03};
    Observation o;
    o.t_us = 200000 * frame;
    o.direction_rad = from_rad;
    o.signature.colour[hue] = 1.0F;
    Placement& p = o.part.place;
    p.source = RangeSource::laser;
    p.bearing_rad = std::remainder(from_rad + 3.14159265, 6.2831853);
    const double a = along(rng), c = across(rng);
    p.x_m = x_m + a * std::cos(p.bearing_rad) - c * std::sin(p.bearing_rad);
    p.y_m = y_m + a * std::sin(p.bearing_rad) + c * std::cos(p.bearing_rad);
    p.z_m = 0.6;
    p.distance_m = 3.0;
    p.eye_m = {x_m + 3.0 * std::cos(from_rad), y_m + 3.0 * std::sin(from_rad), 1.0};
    p.slope = (0.6 - 1.0) / 3.0;
    p.along_sigma_m = 0.10;
    p.across_sigma_m = 0.03;
    p.width_m = 0.5;
    p.height_m = 1.2;
    p.whole = p.tall = true;
    return o;
}

void identical_objects_at_two_places_stay_two_and_one_stays_one() {
    const auto memory = std::make_unique<ObjectMemory>();
    std::mt19937 rng{5};
    for (int k = 0; k < 60; ++k) {
        const double from = 0.1 * k;
        static_cast<void>(memory->enter(seen(2.0, 1.0, from, k, 3, rng)));
        static_cast<void>(memory->enter(seen(3.6, 1.0, from + 1.0, k, 3, rng)));   // alike, 1.6 m away
        memory->tidy(200000 * k);
    }
    TEST_ASSERT_EQUAL_INT(2, memory->confirmed());
    TEST_ASSERT_EQUAL_size_t(2, memory->objects().size());
    for (const noctule::KnownObject& o : memory->objects()) {
        const double x = o.x_m < 2.8 ? 2.0 : 3.6;
        const double error = std::hypot(o.x_m - x, o.y_m - 1.0);
        TEST_ASSERT_TRUE(error < 0.04);
        TEST_ASSERT_TRUE(o.sigma_m() < 0.05);
        TEST_ASSERT_EQUAL_INT(60, o.sightings);
    }
}

void spot_on_an_object_is_not_an_object() {
    // A box of 0.5 x 1.2 m, and a spot of another colour on its front that the camera sees alone from close by; and a small thing beside it.
    const auto memory = std::make_unique<ObjectMemory>();
    std::mt19937 rng{6};
    for (int k = 0; k < 40; ++k) {
        static_cast<void>(memory->enter(seen(2.0, 1.0, 0.1 * k, k, 3, rng)));
        for (const double y_m : {1.27, 1.8}) {
            Observation small = seen(2.0, y_m, 0.02 * k, k, 9, rng);
            small.part.place.width_m = 0.15;
            small.part.place.height_m = 0.2;
            static_cast<void>(memory->enter(small));
        }
        memory->tidy(200000 * k);
    }
    TEST_ASSERT_EQUAL_INT(2, memory->confirmed());
    for (const noctule::KnownObject& o : memory->objects()) {
        const bool large = o.y_m < 1.4;
        TEST_ASSERT_DOUBLE_WITHIN(0.1, large ? 1.0 : 1.8, o.y_m);
        TEST_ASSERT_DOUBLE_WITHIN(0.05, large ? 0.5 : 0.15, o.width_m);
    }
}

void covariance_tells_the_spread_of_the_estimate() {
    // Independent route: 300 memories that saw the same thing from four sides; their estimates scatter as the covariance says.
    double square = 0.0, told = 0.0;
    const auto memory = std::make_unique<ObjectMemory>();
    for (unsigned run = 1; run <= 300; ++run) {
        memory->objects().clear();
        std::mt19937 rng{run};
        for (int k = 0; k < 8; ++k) { static_cast<void>(memory->enter(seen(2.0, 1.0, 0.2 + 1.5 * (k % 4), k, 3, rng))); }
        TEST_ASSERT_EQUAL_size_t(1, memory->objects().size());
        const noctule::KnownObject& o = memory->objects()[0];
        square += (o.x_m - 2.0) * (o.x_m - 2.0);
        told += o.xx_m2;
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.25, 1.0, std::sqrt(square / told));
}

void candidate_that_was_seen_once_is_not_told_and_goes() {
    const auto memory = std::make_unique<ObjectMemory>();
    std::mt19937 rng{2};
    static_cast<void>(memory->enter(seen(1.0, 1.0, 0.0, 1, 3, rng)));
    TEST_ASSERT_EQUAL_INT(0, memory->confirmed());
    TEST_ASSERT_EQUAL_size_t(1, memory->objects().size());
    memory->tidy(60000000);
    TEST_ASSERT_EQUAL_size_t(0, memory->objects().size());
    TEST_ASSERT_EQUAL_UINT32(1U, memory->counters().dropped);
}

/// A thing whose middle is at (x, y, z), seen from an eye at 1 m: placed where its lower side's ray meets the floor at 0.
Observation taken_for_standing(const Vec3& thing, const double eye_x_m, const double eye_y_m, const int frame) {
    Observation o;
    o.t_us = 200000 * frame;
    o.signature.colour[3] = 1.0F;
    Placement& p = o.part.place;
    p.source = RangeSource::floor;
    p.eye_m = {eye_x_m, eye_y_m, 1.0};
    const double far_m = std::hypot(thing[0] - eye_x_m, thing[1] - eye_y_m);
    p.bearing_rad = std::atan2(thing[1] - eye_y_m, thing[0] - eye_x_m);
    p.slope = (thing[2] - 1.0) / far_m;
    p.distance_m = far_m / (1.0 - (thing[2] - 0.3));          // its lower side is 0.3 m under its middle
    p.x_m = eye_x_m + p.distance_m * std::cos(p.bearing_rad);
    p.y_m = eye_y_m + p.distance_m * std::sin(p.bearing_rad);
    p.z_m = 1.0 + p.distance_m * p.slope;
    p.along_sigma_m = 0.2;
    p.across_sigma_m = 0.05;
    p.width_m = 0.6 * p.distance_m / far_m;
    p.height_m = 0.6 * p.distance_m / far_m;
    p.whole = p.tall = true;
    o.direction_rad = std::remainder(p.bearing_rad + 3.14159265358979, 6.283185307179586);
    return o;
}

void what_shows_through_an_opening_in_the_floor_is_not_believed() {
    // On this floor: confirmed. The same thing one storey down: the places that the floor gives it follow the camera.
    for (const bool below : {false, true}) {
        const auto memory = std::make_unique<ObjectMemory>();
        for (int k = 0; k < 40; ++k) {
            static_cast<void>(memory->enter(taken_for_standing({4.0, 0.5, below ? -2.3 : 0.3}, 0.06 * k, -0.3 + 0.02 * k, k)));
            memory->tidy(200000 * k);
        }
        TEST_ASSERT_EQUAL_INT(below ? 0 : 1, memory->confirmed());
    }
}

void what_seems_to_stand_in_an_opening_is_taken_back() {
    struct Case { std::int32_t floor; double open_x_m; double solid_x_m; bool laser; bool believed; };
    // Over the opening, over one of another floor, nearer to the floor than to the opening, far from it, and ranged by the laser.
    for (const Case& c : {Case{0, 4.5, 6.0, false, false}, {1, 4.5, 6.0, false, true}, {0, 4.6, 3.6, false, true}, {0, 6.0, 8.0, false, true}, {0, 4.5, 6.0, true, true}}) {
        const auto memory = std::make_unique<ObjectMemory>();
        std::mt19937 rng{3};
        for (int k = 0; k < 46; ++k) {
            if (k == 20) {   // known only when the vehicle comes there
                memory->note_ground(c.floor, c.open_x_m, 0.5, true);
                memory->note_ground(0, c.solid_x_m, 0.5, false);
            }
            static_cast<void>(memory->enter(c.laser ? seen(4.0, 0.5, 0.1 * k, k, 3, rng) : taken_for_standing({4.0, 0.5, 0.3}, 0.06 * k, -0.3 + 0.02 * k, k)));
            memory->tidy(200000 * k);
        }
        TEST_ASSERT_EQUAL_INT(c.believed ? 1 : 0, memory->confirmed());
    }
}

void what_shows_through_an_opening_in_the_ceiling_is_taken_back() {
    struct Case { std::int32_t floor; double open_x_m; double solid_x_m; double z_m; bool believed; };
    // Over the vehicle beside the opening, the same beside one of another floor, nearer to where there is a ceiling, and as low as the vehicle.
    for (const Case& c : {Case{0, 4.5, 6.0, 2.1, false}, {1, 4.5, 6.0, 2.1, true}, {0, 4.6, 3.6, 2.1, true}, {0, 4.5, 6.0, 1.4, true}}) {
        const auto memory = std::make_unique<ObjectMemory>();
        for (int k = 0; k < 46; ++k) {
            if (k == 40) {
                TEST_ASSERT_EQUAL_INT(1, memory->confirmed());
                memory->note_ceiling(c.floor, c.open_x_m, 0.5, 1.0, true);
                memory->note_ceiling(0, c.solid_x_m, 0.5, 1.0, false);
            }
            Observation o = taken_for_standing({4.0, 0.5, 0.3}, 0.06 * k, -0.3 + 0.02 * k, k);   // the lower side hidden: its range is that of the wall it hangs on
            Placement& p = o.part.place;
            p.source = RangeSource::wall;
            p.z_m = c.z_m;
            p.slope = (p.z_m - p.eye_m[2]) / p.distance_m;
            static_cast<void>(memory->enter(o));
            memory->tidy(200000 * k);
        }
        TEST_ASSERT_EQUAL_INT(c.believed ? 1 : 0, memory->confirmed());
    }
}

void object_that_was_seen_from_one_place_alone_is_not_sure() {
    const auto memory = std::make_unique<ObjectMemory>();
    for (int k = 0; k < 40; ++k) { static_cast<void>(memory->enter(taken_for_standing({3.0, 0.5, 0.3}, 0.001 * k, 0.0, k))); }
    TEST_ASSERT_EQUAL_INT(0, memory->confirmed());
}

void lines_of_sight_meet_where_the_thing_is() {
    noctule::Parallax lines;
    noctule::Parallax::Meeting m;
    std::mt19937 rng{8};
    std::normal_distribution<double> error{0.0, 0.01};
    for (int k = 0; k < 12; ++k) {
        const Vec3 eye{0.2 * k, 0.1 * k, 1.0};
        TEST_ASSERT_TRUE(k < 2 || lines.meet(m));
        const double far_m = std::hypot(3.0 - eye[0], 2.0 - eye[1]);
        TEST_ASSERT_TRUE(lines.add(eye, std::atan2(2.0 - eye[1], 3.0 - eye[0]) + error(rng), (0.4 - 1.0) / far_m + error(rng), far_m));
        TEST_ASSERT_FALSE(lines.add({eye[0] + 0.05, eye[1], eye[2]}, 0.0, 0.0, 1.0));   // has not moved on
    }
    TEST_ASSERT_TRUE(lines.meet(m));
    TEST_ASSERT_EQUAL_INT(12, lines.places());
    TEST_ASSERT_DOUBLE_WITHIN(3.0 * m.sigma_m, 3.0, m.point_m[0]);
    TEST_ASSERT_DOUBLE_WITHIN(3.0 * m.sigma_m, 2.0, m.point_m[1]);
    TEST_ASSERT_DOUBLE_WITHIN(3.0 * m.sigma_m, 0.4, m.point_m[2]);
    TEST_ASSERT_TRUE(m.sigma_m < 0.1);
    TEST_ASSERT_DOUBLE_WITHIN(0.008, 0.013, m.apart_rad);      // the errors that were put in, two of 0.01 a line
}

void pictures_are_bounded_and_from_all_sides() {
    const auto memory = std::make_unique<ObjectMemory>();
    std::mt19937 rng{4};
    for (int k = 0; k < 200; ++k) {
        Observation o = seen(1.0, 1.0, 0.0314 * k, k, 3, rng);
        o.part.region.area_px = 500 + k;
        static_cast<void>(memory->enter(o));
    }
    int used = 0;
    for (const noctule::ObjectView& v : memory->objects()[0].views) { used += v.used ? 1 : 0; }
    TEST_ASSERT_EQUAL_INT(8, used);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(pixel_and_ray_are_inverse_with_lens_and_mount);
    RUN_TEST(calibration_file_of_opencv_is_read_and_a_bad_one_refused);
    RUN_TEST(pose_is_that_of_the_frames_time);
    RUN_TEST(cylinder_is_placed_at_its_centre_from_any_side);
    RUN_TEST(laser_that_just_passes_over_the_top_is_no_range);
    RUN_TEST(range_of_what_stands_behind_is_not_taken);
    RUN_TEST(what_the_lower_border_cuts_stands_before_where_its_ray_meets_the_floor);
    RUN_TEST(what_shows_through_an_opening_in_the_floor_is_not_believed);
    RUN_TEST(what_seems_to_stand_in_an_opening_is_taken_back);
    RUN_TEST(what_shows_through_an_opening_in_the_ceiling_is_taken_back);
    RUN_TEST(object_that_was_seen_from_one_place_alone_is_not_sure);
    RUN_TEST(lines_of_sight_meet_where_the_thing_is);
    RUN_TEST(identical_objects_at_two_places_stay_two_and_one_stays_one);
    RUN_TEST(spot_on_an_object_is_not_an_object);
    RUN_TEST(covariance_tells_the_spread_of_the_estimate);
    RUN_TEST(candidate_that_was_seen_once_is_not_told_and_goes);
    RUN_TEST(pictures_are_bounded_and_from_all_sides);
    return UNITY_END();
}
