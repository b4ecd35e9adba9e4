// dlib's SURF behind a C interface: the reference that `noctule bench vision` measures ours against. Not part of the firmware.
#include <dlib/array2d.h>
#include <dlib/image_keypoint.h>

#include <algorithm>
#include <cstdint>
#include <ctime>
#include <vector>

// Debian's dlib is set up for a BLAS library; this is all that its SURF asks of one.
extern "C" void cblas_dscal(const int n, const double a, double* const x, const int step) {
    for (int i = 0; i < n; ++i) { x[i * step] *= a; }
}

namespace {

double thread_us() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e6 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_nsec);
}

}  // namespace

/// The strongest `most` points of a grey image, `repeats` times over. points: capacity x 6 (x, y, scale, score, angle, sign of the Laplacian),
/// descriptors: capacity x 64, times_us: repeats thread CPU times. Returns the number of points.
extern "C" int bench_dlib_surf(const std::uint8_t* const grey, const int width, const int height, const float threshold, const int most,
                               const int repeats, float* const points, float* const descriptors, const int capacity, double* const times_us) {
    dlib::array2d<unsigned char> image(height, width);
    for (int y = 0; y < height; ++y) { std::copy_n(grey + static_cast<long>(y) * width, width, &image[y][0]); }
    std::vector<dlib::surf_point> found;
    for (int k = 0; k < repeats; ++k) {
        const double start_us = thread_us();
        found = dlib::get_surf_points(image, most, static_cast<double>(threshold));
        times_us[k] = thread_us() - start_us;
    }
    const int count = std::min(static_cast<int>(found.size()), capacity);
    for (int i = 0; i < count; ++i) {
        const dlib::surf_point& f = found[static_cast<std::size_t>(i)];
        const double row[6] = {f.p.center(0), f.p.center(1), f.p.scale, f.p.score, f.angle, f.p.laplacian};
        for (int c = 0; c < 6; ++c) { points[6 * i + c] = static_cast<float>(row[c]); }
        for (int c = 0; c < 64; ++c) { descriptors[64 * i + c] = static_cast<float>(f.des(c)); }
    }
    return count;
}
