// Interest points of SURF: box-filter Hessian in scale space, extrema, interpolation.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "recognise/surf.hpp"

namespace noctule {
namespace {

// Four lanes on any target: the compiler maps them on SSE2 or NEON.
using Int4 = std::int32_t __attribute__((vector_size(16)));
using Float4 = float __attribute__((vector_size(16)));

Int4 load(const std::int32_t* const p) {
    Int4 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}

constexpr float kWhite = 255.0F;
constexpr float kCrossWeight = 0.81F;  // (0.9)^2: box filters against Gaussians, the paper's equation (3)
constexpr float kScaleOfSide = 1.2F / 9.0F;

/// Side of the filter, equation (2): 9, 15, 21, 27; 15, 27, 39, 51; 27, 51, 75, 99; ...
int side_of(const int octave, const int layer) { return 3 * ((2 << octave) * (layer + 1) + 1); }

bool weaker_on_top(const SurfPoint& a, const SurfPoint& b) { return a.response > b.response; }

}  // namespace

const Surf::Features& Surf::extract(const GreyImage& image, const SurfSettings& settings) {
    points_.clear();
    features_.clear();
    if (!integral_.build(image)) {
        ++counters_.refused_images;
        return features_;
    }
    ++counters_.images;
    const int octaves = std::clamp(settings.octaves, 1, 5);
    const int first_step = std::clamp(settings.step_px, 1, 2);
    for (int octave = 0; octave < octaves; ++octave) {
        const int step = first_step << octave;
        if (side_of(octave, 2) > std::min(image.width, image.height)) { break; }
        build_octave(octave, step);
        find_extrema(octave, step, settings);
    }
    std::sort_heap(points_.begin(), points_.end(), weaker_on_top);  // strongest first
    for (SurfPoint& point : points_) {
        if (!settings.upright) { orient(point); }
        SurfFeature feature;
        feature.point = point;
        if (!describe(point, feature.descriptor)) {
            ++counters_.flat_dropped;
            continue;
        }
        static_cast<void>(features_.push(feature));
    }
    return features_;
}

void Surf::build_octave(const int octave, const int step) {
    const int w = integral_.width();
    const int h = integral_.height();
    rows_ = (h + step - 1) / step;
    columns_ = (w + step - 1) / step;
    row_stride_ = columns_ + kPad;
    phase_stride_ = (w + 1 + step - 1) / step;
    const std::ptrdiff_t line = static_cast<std::ptrdiff_t>(phase_stride_) * step;
    for (int r = 0; r <= h; ++r) {
        const std::int32_t* const from = integral_.row(r);
        std::int32_t* const to = phases_.data() + r * line;
        for (int phase = 0; phase < step; ++phase) {
            std::int32_t* const part = to + static_cast<std::ptrdiff_t>(phase) * phase_stride_;
            for (int k = 0, c = phase; c <= w; ++k, c += step) { part[k] = from[c]; }
        }
    }
    for (int layer = 0; layer < kLayers; ++layer) { build_layer(layer, octave, step); }
}

void Surf::build_layer(const int layer, const int octave, const int step) {
    const int side = side_of(octave, layer);
    const int lobe = side / 3;
    const int border = (side - 1) / 2;
    const int half = lobe / 2;
    const int w = integral_.width();
    const int h = integral_.height();
    // Samples whose whole filter lies in the image: border <= s k, s k + border < w.
    const int first = (border + step - 1) / step;
    const int row_end = h - 1 - border < 0 ? 0 : (h - 1 - border) / step + 1;
    const int column_end = w - 1 - border < 0 ? 0 : (w - 1 - border) / step + 1;
    const std::ptrdiff_t line = static_cast<std::ptrdiff_t>(phase_stride_) * step;
    const float scale = 1.0F / (kWhite * static_cast<float>(side) * static_cast<float>(side));

    // Entry of the integral image at column s k + d, as a pointer to be indexed with k.
    const auto column = [&](const std::int32_t* const row, const int d) {
        const int phase = ((d % step) + step) % step;
        return row + static_cast<std::ptrdiff_t>(phase) * phase_stride_ + (d - phase) / step;
    };
    const auto row = [&](const int r) { return phases_.data() + r * line; };

    for (int j = 0; j < rows_; ++j) {
        float* const out = layer_row(layer, j);
        if (j < first || j >= row_end || first >= column_end) {
            std::fill_n(out, row_stride_, 0.0F);
            continue;
        }
        const int r = j * step;
        // Along x: the whole side wide, 2 lobe - 1 high, the middle third three times off. Along y the same, turned.
        const std::int32_t* const xt = row(r - lobe + 1);
        const std::int32_t* const xb = row(r + lobe);
        const std::int32_t* const x_in[8] = {column(xt, -border), column(xt, border + 1), column(xb, -border), column(xb, border + 1),
                                             column(xt, -half),   column(xt, half + 1),   column(xb, -half),   column(xb, half + 1)};
        const std::int32_t* const yo0 = row(r - border);
        const std::int32_t* const yo1 = row(r + border + 1);
        const std::int32_t* const yi0 = row(r - half);
        const std::int32_t* const yi1 = row(r + half + 1);
        const std::int32_t* const y_in[8] = {column(yo0, 1 - lobe), column(yo0, lobe), column(yo1, 1 - lobe), column(yo1, lobe),
                                             column(yi0, 1 - lobe), column(yi0, lobe), column(yi1, 1 - lobe), column(yi1, lobe)};
        // Mixed: four squares around the centre's row and column.
        const std::int32_t* const m[4] = {row(r - lobe), row(r), row(r + 1), row(r + lobe + 1)};
        const int d[4] = {-lobe, 0, 1, lobe + 1};
        const std::int32_t* m_in[4][4];
        for (int a = 0; a < 4; ++a) {
            for (int b = 0; b < 4; ++b) { m_in[a][b] = column(m[a], d[b]); }
        }
        std::fill_n(out, first, 0.0F);
        for (int k = first; k < column_end; k += 4) {
            const auto at = [k](const std::int32_t* const p) { return load(p + k); };
            const Int4 x_all = at(x_in[3]) - at(x_in[2]) - at(x_in[1]) + at(x_in[0]);
            const Int4 x_mid = at(x_in[7]) - at(x_in[6]) - at(x_in[5]) + at(x_in[4]);
            const Int4 y_all = at(y_in[3]) - at(y_in[2]) - at(y_in[1]) + at(y_in[0]);
            const Int4 y_mid = at(y_in[7]) - at(y_in[6]) - at(y_in[5]) + at(y_in[4]);
            const Int4 top_left = at(m_in[1][1]) - at(m_in[1][0]) - at(m_in[0][1]) + at(m_in[0][0]);
            const Int4 top_right = at(m_in[1][3]) - at(m_in[1][2]) - at(m_in[0][3]) + at(m_in[0][2]);
            const Int4 bottom_left = at(m_in[3][1]) - at(m_in[3][0]) - at(m_in[2][1]) + at(m_in[2][0]);
            const Int4 bottom_right = at(m_in[3][3]) - at(m_in[3][2]) - at(m_in[2][3]) + at(m_in[2][2]);
            const Float4 dxx = __builtin_convertvector(x_all - x_mid - x_mid - x_mid, Float4) * scale;
            const Float4 dyy = __builtin_convertvector(y_all - y_mid - y_mid - y_mid, Float4) * scale;
            const Float4 dxy = __builtin_convertvector(top_left + bottom_right - top_right - bottom_left, Float4) * scale;
            const Float4 det = dxx * dyy - kCrossWeight * dxy * dxy;  // equation (3)
            std::memcpy(out + k, &det, sizeof det);
        }
        std::fill(out + column_end, out + row_stride_, 0.0F);
    }
}

void Surf::find_extrema(const int octave, const int step, const SurfSettings& settings) {
    const std::size_t most = static_cast<std::size_t>(std::clamp(settings.most, 1, static_cast<std::int32_t>(kMaxSurfFeatures)));
    for (int layer = 1; layer + 1 < kLayers; ++layer) {
        // The neighbours in the layer above must have been filtered too.
        const int margin = ((side_of(octave, layer + 1) - 1) / 2 + step - 1) / step + 1;
        for (int j = margin; j < rows_ - margin; ++j) {
            const float* const here = layer_row(layer, j);
            for (int k = margin; k < columns_ - margin; ++k) {
                const float v = here[k];
                if (!(v > settings.threshold) || v <= here[k - 1] || v < here[k + 1]) { continue; }
                bool greatest = true;
                for (int l = layer - 1; l <= layer + 1 && greatest; ++l) {
                    for (int n = -1; n <= 1 && greatest; ++n) {
                        const float* const other = layer_row(l, j + n) + k;
                        for (int o = -1; o <= 1; ++o) {
                            if ((l != layer || n != 0 || o != 0) && other[o] >= v) { greatest = false; }
                        }
                    }
                }
                SurfPoint point;
                if (greatest && refine(layer, j, k, octave, step, point)) { offer(point, most); }
            }
        }
    }
}

bool Surf::refine(const int layer, const int row, const int column, const int octave, const int step, SurfPoint& out) const {
    // Quadratic through the 27 samples; its top is where the gradient vanishes, equation (4).
    const auto at = [&](const int l, const int r, const int c) { return layer_row(layer + l, row + r)[column + c]; };
    const float v = at(0, 0, 0);
    const float gx = 0.5F * (at(0, 0, 1) - at(0, 0, -1));
    const float gy = 0.5F * (at(0, 1, 0) - at(0, -1, 0));
    const float gs = 0.5F * (at(1, 0, 0) - at(-1, 0, 0));
    const float xx = at(0, 0, 1) + at(0, 0, -1) - 2.0F * v;
    const float yy = at(0, 1, 0) + at(0, -1, 0) - 2.0F * v;
    const float ss = at(1, 0, 0) + at(-1, 0, 0) - 2.0F * v;
    const float xy = 0.25F * (at(0, 1, 1) - at(0, 1, -1) - at(0, -1, 1) + at(0, -1, -1));
    const float xs = 0.25F * (at(1, 0, 1) - at(1, 0, -1) - at(-1, 0, 1) + at(-1, 0, -1));
    const float ys = 0.25F * (at(1, 1, 0) - at(1, -1, 0) - at(-1, 1, 0) + at(-1, -1, 0));
    // Cramer's rule on the symmetric 3 x 3 system.
    const float c00 = yy * ss - ys * ys;
    const float c01 = xs * ys - xy * ss;
    const float c02 = xy * ys - xs * yy;
    const float det = xx * c00 + xy * c01 + xs * c02;
    if (!(std::fabs(det) > 1.0e-30F)) { return false; }
    const float c11 = xx * ss - xs * xs;
    const float c12 = xy * xs - xx * ys;
    const float c22 = xx * yy - xy * xy;
    const float ox = -(c00 * gx + c01 * gy + c02 * gs) / det;
    const float oy = -(c01 * gx + c11 * gy + c12 * gs) / det;
    const float os = -(c02 * gx + c12 * gy + c22 * gs) / det;
    // Beyond half a sample a neighbour is nearer to the top; a little slack keeps tops on the border between two.
    constexpr float kReach = 0.6F;
    if (!(std::fabs(ox) <= kReach && std::fabs(oy) <= kReach && std::fabs(os) <= kReach)) { return false; }

    const float step_f = static_cast<float>(step);
    const float side = static_cast<float>(side_of(octave, layer)) + os * static_cast<float>(6 << octave);
    out.x_px = (static_cast<float>(column) + ox) * step_f;
    out.y_px = (static_cast<float>(row) + oy) * step_f;
    out.scale_px = kScaleOfSide * side;
    out.response = v;
    out.orientation_rad = 0.0F;
    // The sign of the Laplacian tells bright blobs from dark ones.
    const int side_px = side_of(octave, layer);
    const int lobe = side_px / 3;
    const int border = (side_px - 1) / 2;
    const int r = row * step;
    const int c = column * step;
    const int x_all = integral_.sum(r - lobe + 1, c - border, r + lobe, c + border + 1);
    const int x_mid = integral_.sum(r - lobe + 1, c - lobe / 2, r + lobe, c + lobe / 2 + 1);
    const int y_all = integral_.sum(r - border, c - lobe + 1, r + border + 1, c + lobe);
    const int y_mid = integral_.sum(r - lobe / 2, c - lobe + 1, r + lobe / 2 + 1, c + lobe);
    out.bright = x_all - 3 * x_mid + y_all - 3 * y_mid < 0;
    return true;
}

void Surf::offer(const SurfPoint& point, const std::size_t most) {
    if (points_.size() >= most) {
        ++counters_.weak_dropped;
        if (point.response <= points_[0].response) { return; }
        std::pop_heap(points_.begin(), points_.end(), weaker_on_top);
        points_.remove_unordered(points_.size() - 1);
    }
    static_cast<void>(points_.push(point));
    std::push_heap(points_.begin(), points_.end(), weaker_on_top);
}

}  // namespace noctule
