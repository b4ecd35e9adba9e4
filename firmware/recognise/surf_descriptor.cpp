// Orientation and descriptor of SURF: Haar wavelets on the integral image around a point.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/angle.hpp"
#include "recognise/surf.hpp"

namespace noctule {
namespace {

constexpr int kOrientRadius = 6;      // in scales
constexpr int kSectors = 72;          // of the circle; the window of pi / 3 is twelve of them
constexpr int kWindow = kSectors / 6;
constexpr int kGrid = 24;             // samples of the descriptor a side, one scale apart
constexpr int kCells = 4;
constexpr int kCellSide = 9;          // samples of one cell a side; neighbours overlap by four
constexpr int kCellStep = 5;

using Float4 = float __attribute__((vector_size(16)));

/// One place of the orientation: offset in scales and weight.
struct Place {
    float i = 0.0F;
    float j = 0.0F;
    float weight = 0.0F;
};
constexpr std::size_t kPlaces = 109;  // whole offsets inside a circle of six

/// Gaussian weights, made once: equations (5) and (6).
struct Weights {
    std::array<Place, kPlaces> orient{};
    std::array<float, kCellSide> sample{};  // of one axis; a sample's weight is the product of both
    std::array<std::array<float, kCells>, kCells> cell{};

    Weights() {
        const auto gauss = [](const float x, const float y, const float sigma) {
            return std::exp(-(x * x + y * y) / (2.0F * sigma * sigma));
        };
        std::size_t n = 0;
        for (int j = -kOrientRadius; j <= kOrientRadius; ++j) {
            for (int i = -kOrientRadius; i <= kOrientRadius; ++i) {
                if (i * i + j * j >= kOrientRadius * kOrientRadius || n == kPlaces) { continue; }
                const float x = static_cast<float>(i);
                const float y = static_cast<float>(j);
                orient[n++] = {x, y, gauss(x, y, 2.5F)};
            }
        }
        for (int i = 0; i < kCellSide; ++i) { sample[static_cast<std::size_t>(i)] = gauss(static_cast<float>(i) - 4.0F, 0.0F, 2.5F); }
        for (int j = 0; j < kCells; ++j) {
            for (int i = 0; i < kCells; ++i) {
                cell[static_cast<std::size_t>(j)][static_cast<std::size_t>(i)] =
                    gauss(static_cast<float>(i) - 1.5F, static_cast<float>(j) - 1.5F, 1.5F);
            }
        }
    }
};

const Weights& weights() {
    static const Weights w;
    return w;
}

struct Haar {
    float dx = 0.0F;
    float dy = 0.0F;
};

/// Differences of the halves of a square of 2 half pixels around a corner of the integral image. Clipped: the square may hang over
/// the border, and what hangs over counts nothing.
template <bool kClipped>
class HaarAt {
public:
    HaarAt(const IntegralImage& image, const int half)
        : sums_(image.row(0)), stride_(image.width() + 1), width_(image.width()), height_(image.height()), half_(half) {}

    Haar operator()(const int r, const int c) const {
        int r0 = r - half_;
        int r1 = r;
        int r2 = r + half_;
        int c0 = c - half_;
        int c1 = c;
        int c2 = c + half_;
        if constexpr (kClipped) {
            const auto cut = [](int& v, const int most) { v = v < 0 ? 0 : (v > most ? most : v); };
            cut(r0, height_);
            cut(r1, height_);
            cut(r2, height_);
            cut(c0, width_);
            cut(c1, width_);
            cut(c2, width_);
        }
        const std::int32_t* const top = sums_ + static_cast<std::ptrdiff_t>(r0) * stride_;
        const std::int32_t* const middle = sums_ + static_cast<std::ptrdiff_t>(r1) * stride_;
        const std::int32_t* const bottom = sums_ + static_cast<std::ptrdiff_t>(r2) * stride_;
        const std::int32_t all_top = top[c2] - top[c0];
        const std::int32_t whole = bottom[c2] - bottom[c0] - all_top;
        const std::int32_t left = bottom[c1] - top[c1] - bottom[c0] + top[c0];
        const std::int32_t upper = middle[c2] - middle[c0] - all_top;
        return {static_cast<float>(whole - 2 * left), static_cast<float>(whole - 2 * upper)};
    }

private:
    const std::int32_t* sums_;
    int stride_;
    int width_;
    int height_;
    int half_;
};

bool window_inside(const IntegralImage& image, const SurfPoint& p, const float radius_px) {
    return p.x_px - radius_px >= 0.0F && p.y_px - radius_px >= 0.0F &&
           p.x_px + radius_px < static_cast<float>(image.width()) && p.y_px + radius_px < static_cast<float>(image.height());
}

// Positions run in whole 65536ths of a pixel: no rounding call a sample, and the same bits on every machine.
constexpr float kFine = 65536.0F;
constexpr int kFineBits = 16;

/// Corner of the integral image nearest to a pixel position; pixel (x, y) has its centre at corner (x + 0.5, y + 0.5).
std::int32_t fine_corner(const float position_px) { return static_cast<std::int32_t>(std::lrint((position_px + 1.0F) * kFine)); }

/// Sector of a direction, 0 to kSectors - 1, from -pi on. The angle by a polynomial, within 0.3 degrees.
int sector_of(const float y, const float x) {
    const float ax = std::fabs(x);
    const float ay = std::fabs(y);
    const float most = ax > ay ? ax : ay;
    const float least = ax > ay ? ay : ax;
    const float q = least / (most + 1.0e-20F);
    const float q2 = q * q;
    float a = q * (0.9998660F + q2 * (-0.3302995F + q2 * (0.1801410F + q2 * (-0.0851330F + q2 * 0.0208351F))));
    a = ay > ax ? 0.5F * kPi - a : a;
    a = x < 0.0F ? kPi - a : a;
    a = y < 0.0F ? -a : a;
    const int sector = static_cast<int>((a + kPi) * (static_cast<float>(kSectors) / (2.0F * kPi)));
    return sector >= kSectors ? sector - kSectors : sector;
}

/// Wavelets on the grid turned by (co, si), in the frame of the point: dx, |dx|, dy, |dy| a place.
template <bool kClipped>
void fill_grid(const IntegralImage& image, const SurfPoint& point, const float co, const float si,
               std::array<std::array<Float4, kGrid>, kGrid>& grid) {
    const float s = point.scale_px;
    const HaarAt<kClipped> haar{image, std::max(static_cast<int>(std::lround(s)), 1)};
    constexpr float kMiddle = 0.5F * static_cast<float>(kGrid - 1);
    const std::int32_t step_x = static_cast<std::int32_t>(std::lrint(co * s * kFine));
    const std::int32_t step_y = static_cast<std::int32_t>(std::lrint(si * s * kFine));
    for (std::size_t j = 0; j < kGrid; ++j) {
        const float v = (static_cast<float>(j) - kMiddle) * s;
        std::int32_t x = fine_corner(point.x_px - co * kMiddle * s - si * v);
        std::int32_t y = fine_corner(point.y_px - si * kMiddle * s + co * v);
        for (std::size_t i = 0; i < kGrid; ++i) {
            const Haar h = haar(y >> kFineBits, x >> kFineBits);
            const float dx = co * h.dx + si * h.dy;
            const float dy = co * h.dy - si * h.dx;
            grid[j][i] = Float4{dx, std::fabs(dx), dy, std::fabs(dy)};
            x += step_x;
            y += step_y;
        }
    }
}

}  // namespace

void Surf::orient(SurfPoint& point) const {
    // Sum of the wavelet responses by direction; the strongest sector of pi / 3 gives the orientation, equation (5).
    const float s = point.scale_px;
    const int half = std::max(static_cast<int>(std::lround(2.0F * s)), 1);
    const bool inside = window_inside(integral_, point, static_cast<float>(kOrientRadius) * s + static_cast<float>(half) + 2.0F);
    std::array<float, kSectors> sum_x{};
    std::array<float, kSectors> sum_y{};
    const auto gather = [&](const auto& haar) {
        for (const Place& place : weights().orient) {
            const Haar h = haar(fine_corner(point.y_px + place.j * s) >> kFineBits, fine_corner(point.x_px + place.i * s) >> kFineBits);
            const float x = place.weight * h.dx;
            const float y = place.weight * h.dy;
            const std::size_t sector = static_cast<std::size_t>(sector_of(y, x));
            sum_x[sector] += x;
            sum_y[sector] += y;
        }
    };
    if (inside) {
        gather(HaarAt<false>{integral_, half});
    } else {
        gather(HaarAt<true>{integral_, half});
    }
    float x = 0.0F;
    float y = 0.0F;
    for (std::size_t k = 0; k < kWindow; ++k) {
        x += sum_x[k];
        y += sum_y[k];
    }
    float best = -1.0F;
    float best_x = 1.0F;
    float best_y = 0.0F;
    for (std::size_t k = 0; k < kSectors; ++k) {
        const float length = x * x + y * y;
        if (length > best) {
            best = length;
            best_x = x;
            best_y = y;
        }
        const std::size_t in = k + kWindow < kSectors ? k + kWindow : k + kWindow - kSectors;
        x += sum_x[in] - sum_x[k];
        y += sum_y[in] - sum_y[k];
    }
    point.orientation_rad = std::atan2(best_y, best_x);
}

bool Surf::describe(const SurfPoint& point, SurfDescriptor& out) const {
    const float s = point.scale_px;
    const float co = std::cos(point.orientation_rad);
    const float si = std::sin(point.orientation_rad);
    std::array<std::array<Float4, kGrid>, kGrid> grid;
    if (window_inside(integral_, point, 0.5F * static_cast<float>(kGrid) * 1.4143F * s + std::max(s, 1.0F) + 3.0F)) {
        fill_grid<false>(integral_, point, co, si, grid);
    } else {
        fill_grid<true>(integral_, point, co, si, grid);
    }

    // Sixteen cells, in each the sums of dx, |dx|, dy, |dy| with a Gaussian about the cell, equation (6): first along the rows, then down.
    const std::array<float, kCellSide>& g = weights().sample;
    std::array<std::array<Float4, kCells>, kGrid> rows;
    for (std::size_t j = 0; j < kGrid; ++j) {
        for (std::size_t a = 0; a < kCells; ++a) {
            Float4 sum{};
            for (std::size_t i = 0; i < kCellSide; ++i) { sum += g[i] * grid[j][a * kCellStep + i]; }
            rows[j][a] = sum;
        }
    }
    Float4 squares{};
    for (std::size_t b = 0; b < kCells; ++b) {
        for (std::size_t a = 0; a < kCells; ++a) {
            Float4 sum{};
            for (std::size_t j = 0; j < kCellSide; ++j) { sum += g[j] * rows[b * kCellStep + j][a]; }
            sum *= weights().cell[b][a];
            std::memcpy(&out[4 * (kCells * b + a)], &sum, sizeof sum);
            squares += sum * sum;
        }
    }
    const float square = (squares[0] + squares[1]) + (squares[2] + squares[3]);
    if (!(square > 0.0F)) { return false; }
    const float inverse = 1.0F / std::sqrt(square);
    for (float& v : out) { v *= inverse; }
    return true;
}

}  // namespace noctule
