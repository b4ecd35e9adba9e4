#include "estimate/scan_shape.hpp"

#include "core/length.hpp"

namespace noctule {

namespace {

constexpr float kSpacing_m = 0.10F;   // hits nearer to each other than this become one point
constexpr float kWider = 1.3F;        // factor on it when too many points are left
constexpr int kTries = 10;
constexpr float kNear_m = 0.15F;      // hits on the vehicle itself

/// False: more points than fit.
[[nodiscard]] bool shape_at(const LevelScan& scan, const float spacing_m, ScanShape& out) {
    out.clear();
    float sum_x = 0.0F;
    float sum_y = 0.0F;
    float first_x = 0.0F;
    float first_y = 0.0F;
    float last_x = 0.0F;
    float last_y = 0.0F;
    float count = 0.0F;
    const auto finish = [&] { return count <= 0.0F || out.push({sum_x / count, sum_y / count}); };
    for (const ScanPoint& point : scan.points) {
        if (!point.hit || point.range_m < kNear_m) { continue; }
        const bool same = count > 0.0F && length_of(point.x_m - first_x, point.y_m - first_y) < spacing_m &&
                          length_of(point.x_m - last_x, point.y_m - last_y) < 0.5F * spacing_m;
        if (!same) {
            if (out.full() || !finish()) { return false; }
            sum_x = sum_y = count = 0.0F;
            first_x = point.x_m;
            first_y = point.y_m;
        }
        sum_x += point.x_m;
        sum_y += point.y_m;
        count += 1.0F;
        last_x = point.x_m;
        last_y = point.y_m;
    }
    return !out.full() && finish();
}

}  // namespace

void shape_of(const LevelScan& scan, ScanShape& out) {
    float spacing_m = kSpacing_m;
    for (int i = 0; i < kTries; ++i) {
        if (shape_at(scan, spacing_m, out)) { return; }
        spacing_m *= kWider;
    }
}

}  // namespace noctule
