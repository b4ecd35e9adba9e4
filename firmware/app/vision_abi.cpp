// What Python loads of the recognition library (host/noctule/vision_abi.py): SURF and matching with thread CPU times.
#include <algorithm>
#include <cstdint>
#include <ctime>
#include <memory>
#include <span>

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
