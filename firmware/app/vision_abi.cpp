// What Python loads of the recognition library (host/noctule/vision_abi.py): SURF and matching with thread CPU times.
#include <malloc.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <memory>
#include <span>
#include <string>

#include "app/vision_node.hpp"
#include "recognise/plane_fit.hpp"
#include "recognise/surf.hpp"
#include "recognise/surf_match.hpp"

namespace {

double thread_us() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e6 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_nsec);
}

}  // namespace

/// The strongest `most` points of a grey image, `repeats` times over. points: capacity x 6 (x, y, scale, response, orientation, bright),
/// descriptors: capacity x 64, times_us: repeats thread CPU times. Returns the number of points.
extern "C" int noctule_surf(const std::uint8_t* const grey, const int width, const int height, const float threshold, const int octaves,
                            const int step_px, const int most, const int repeats, float* const points, float* const descriptors,
                            const int capacity, double* const times_us) {
    static const auto surf = std::make_unique<noctule::Surf>();
    noctule::SurfSettings settings;
    settings.threshold = threshold;
    settings.octaves = octaves;
    settings.step_px = step_px;
    settings.most = most;
    for (int k = 0; k < repeats; ++k) {
        const double start_us = thread_us();
        surf->extract({grey, width, height, width}, settings);
        times_us[k] = thread_us() - start_us;
    }
    const auto& found = surf->features();
    const int count = std::min(static_cast<int>(found.size()), capacity);
    for (int i = 0; i < count; ++i) {
        const noctule::SurfFeature& f = found[static_cast<std::size_t>(i)];
        float* const row = points + 6 * i;
        row[0] = f.point.x_px;
        row[1] = f.point.y_px;
        row[2] = f.point.scale_px;
        row[3] = f.point.response;
        row[4] = f.point.orientation_rad;
        row[5] = f.point.bright ? 1.0F : 0.0F;
        std::copy(f.descriptor.begin(), f.descriptor.end(), descriptors + 64 * i);
    }
    return count;
}

/// Homography (kind 4) or similarity (kind 2) of count pairs (x, y, u, v). H: 9, row-major. Returns the pairs that agree, 0 where there is none.
extern "C" int noctule_plane_fit(const float* const pairs, const int count, const float tolerance_px, const int trials, const int kind,
                                 double* const H) {
    static_assert(sizeof(noctule::PointPair) == 4 * sizeof(float));
    const auto fit = std::make_unique<noctule::PlaneFit>();
    const std::span<const noctule::PointPair> all{reinterpret_cast<const noctule::PointPair*>(pairs), static_cast<std::size_t>(count)};
    const noctule::PlaneFitSettings settings{tolerance_px, trials, 1};
    const bool found = kind == 4 ? noctule::fit_homography(all, settings, *fit) : noctule::fit_similarity(all, settings, *fit);
    std::copy(fit->H.begin(), fit->H.end(), H);
    return found ? fit->inliers : 0;
}

namespace {

/// The recognition and its parameters, for Python.
struct Vision {
    noctule::Parameters parameters{};
    noctule::VisionNode node{parameters};
    std::string error;
    std::array<std::uint8_t, 8192> encoded{};
};

template <class Message>
bool decode(const std::uint8_t* const bytes, const int size, Message& message) {
    return message.decode(bytes, 0, size) == size;
}

}  // namespace

/// A recognition with a database (null: none) and a calibration (null: the simulator's). Null on failure; noctule_vision_error() says why.
extern "C" Vision* noctule_vision_create(const char* const calibration, const char* const database, const int resume, char* const error, const int room) {
    auto vision = std::make_unique<Vision>();
    noctule::Recogniser& r = vision->node.recogniser();
    const bool good = (calibration == nullptr || noctule::load_camera(calibration, r.camera(), vision->error)) &&
                      (database == nullptr || (r.store().open(database, "in process") && r.store().load(r.memory(), resume != 0)));
    if (good) { return vision.release(); }
    std::snprintf(error, static_cast<std::size_t>(room), "%s", vision->error.empty() ? r.store().error().c_str() : vision->error.c_str());
    return nullptr;
}

/// Sets a parameter by name or MAVLink id. 0: done, 1: no such name, 2: out of range.
extern "C" int noctule_vision_set(Vision* const vision, const char* const name, const double value) {
    const noctule::ParameterRow* const row = noctule::find_parameter(name);
    if (row == nullptr) { return 1; }
    return noctule::set_parameter(vision->parameters, *row, static_cast<float>(value)) == noctule::ParameterSet::stored ? 0 : 2;
}

extern "C" void noctule_vision_destroy(Vision* const vision) { delete vision; }

/// One encoded NAV, SCAN or IMAGE. 1: taken; 0: another channel or not decodable.
extern "C" int noctule_vision_receive(Vision* const vision, const char* const channel, const std::uint8_t* const bytes, const int size) {
    static noctule::image_t image;
    static noctule::scan_t scan;
    if (std::strcmp(channel, "NAV") == 0) {
        noctule::nav_t nav;
        if (!decode(bytes, size, nav)) { return 0; }
        vision->node.receive(nav);
        return 1;
    }
    if (std::strcmp(channel, "SCAN") == 0) {
        if (!decode(bytes, size, scan)) { return 0; }
        vision->node.receive(scan);
        return 1;
    }
    if (std::strcmp(channel, "IMAGE") == 0) {
        if (!decode(bytes, size, image)) { return 0; }
        noctule::objects_t given_way{};
        static_cast<void>(vision->node.receive(image, given_way));
        return 1;
    }
    return 0;
}

/// Looks at the waiting frame: the size of the encoded OBJECTS, whose bytes are put into *bytes and hold until the next call; 0: no frame waits.
extern "C" int noctule_vision_look(Vision* const vision, const std::uint8_t** const bytes) {
    if (!vision->node.waiting()) { return 0; }
    const noctule::objects_t& answer = vision->node.look();
    *bytes = vision->encoded.data();
    return answer.encode(vision->encoded.data(), 0, static_cast<int>(vision->encoded.size()));
}

/// Heap bytes in use by this process.
extern "C" long noctule_heap_bytes() { return static_cast<long>(mallinfo2().uordblks); }
