// Orientation and descriptor of SURF: Haar wavelets on the integral image around a point.
#include <algorithm>
#include <cmath>

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

/// Gaussian weights, made once: equations (5) and (6).
struct Weights {
    std::array<std::array<float, 2 * kOrientRadius + 1>, 2 * kOrientRadius + 1> orient{};
    std::array<std::array<float, kCellSide>, kCellSide> sample{};
    std::array<std::array<float, kCells>, kCells> cell{};

    Weights() {
        const auto gauss = [](const float x, const float y, const float sigma) {
            return std::exp(-(x * x + y * y) / (2.0F * sigma * sigma));
        };
        for (int j = -kOrientRadius; j <= kOrientRadius; ++j) {
            for (int i = -kOrientRadius; i <= kOrientRadius; ++i) {
                const bool inside = i * i + j * j < kOrientRadius * kOrientRadius;
                orient[static_cast<std::size_t>(j + kOrientRadius)][static_cast<std::size_t>(i + kOrientRadius)] =
                    inside ? gauss(static_cast<float>(i), static_cast<float>(j), 2.5F) : 0.0F;
            }
        }
        for (int j = 0; j < kCellSide; ++j) {
            for (int i = 0; i < kCellSide; ++i) {
                sample[static_cast<std::size_t>(j)][static_cast<std::size_t>(i)] =
                    gauss(static_cast<float>(i) - 4.0F, static_cast<float>(j) - 4.0F, 2.5F);
            }
        }
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

/// Difference of the halves of a square of 2 half pixels around the corner (r, c), inside the image.
Haar haar(const IntegralImage& image, const int r, const int c, const int half) {
    const std::int32_t* const top = image.row(r - half);
    const std::int32_t* const middle = image.row(r);
    const std::int32_t* const bottom = image.row(r + half);
    const int left = c - half;
    const int right = c + half;
    const std::int32_t all_top = top[right] - top[left];
    const std::int32_t all_bottom = bottom[right] - bottom[left];
    const std::int32_t left_part = bottom[c] - top[c] - bottom[left] + top[left];
    const std::int32_t whole = all_bottom - all_top;
    const std::int32_t upper = middle[right] - middle[left] - all_top;
    return {static_cast<float>(whole - 2 * left_part), static_cast<float>(whole - 2 * upper)};
}

/// The same where the square may hang over the border.
Haar haar_clipped(const IntegralImage& image, const int r, const int c, const int half) {
    const std::int32_t left = image.sum_clipped(r - half, c - half, r + half, c);
    const std::int32_t right = image.sum_clipped(r - half, c, r + half, c + half);
    const std::int32_t upper = image.sum_clipped(r - half, c - half, r, c + half);
    const std::int32_t lower = image.sum_clipped(r, c - half, r + half, c + half);
    return {static_cast<float>(right - left), static_cast<float>(lower - upper)};
}

bool window_inside(const IntegralImage& image, const SurfPoint& p, const float radius_px) {
    return p.x_px - radius_px >= 0.0F && p.y_px - radius_px >= 0.0F &&
           p.x_px + radius_px < static_cast<float>(image.width()) && p.y_px + radius_px < static_cast<float>(image.height());
}

/// Corner of the integral image nearest to a pixel position; pixel (x, y) has its centre at corner (x + 0.5, y + 0.5).
int corner(const float position_px) { return static_cast<int>(std::floor(position_px + 1.0F)); }

}  // namespace

void Surf::orient(SurfPoint& point) const {
    // Sum of the wavelet responses by direction; the strongest sector of pi / 3 gives the orientation, equation (5).
    const float s = point.scale_px;
    const int half = std::max(static_cast<int>(std::lround(2.0F * s)), 1);
    const bool inside = window_inside(integral_, point, static_cast<float>(kOrientRadius) * s + static_cast<float>(half) + 2.0F);
    std::array<float, kSectors> sum_x{};
    std::array<float, kSectors> sum_y{};
    constexpr float kPerRadian = static_cast<float>(kSectors) / (2.0F * kPi);
    for (int j = -kOrientRadius; j <= kOrientRadius; ++j) {
        for (int i = -kOrientRadius; i <= kOrientRadius; ++i) {
            const float w = weights().orient[static_cast<std::size_t>(j + kOrientRadius)][static_cast<std::size_t>(i + kOrientRadius)];
            if (w <= 0.0F) { continue; }
            const int r = corner(point.y_px + static_cast<float>(j) * s);
            const int c = corner(point.x_px + static_cast<float>(i) * s);
            const Haar h = inside ? haar(integral_, r, c, half) : haar_clipped(integral_, r, c, half);
            const float x = w * h.dx;
            const float y = w * h.dy;
            const int sector = static_cast<int>((std::atan2(y, x) + kPi) * kPerRadian) % kSectors;
            sum_x[static_cast<std::size_t>(sector)] += x;
            sum_y[static_cast<std::size_t>(sector)] += y;
        }
    }
    float x = 0.0F;
    float y = 0.0F;
    for (std::size_t k = 0; k < kWindow; ++k) {
        x += sum_x[k];
        y += sum_y[k];
    }
    float best = -1.0F;
    for (std::size_t k = 0; k < kSectors; ++k) {
        const float length = x * x + y * y;
        if (length > best) {
            best = length;
            point.orientation_rad = std::atan2(y, x);
        }
        const std::size_t in = (k + kWindow) % kSectors;
        x += sum_x[in] - sum_x[k];
        y += sum_y[in] - sum_y[k];
    }
}

bool Surf::describe(const SurfPoint& point, SurfDescriptor& out) const {
    const float s = point.scale_px;
    const int half = std::max(static_cast<int>(std::lround(s)), 1);
    const float co = std::cos(point.orientation_rad);
    const float si = std::sin(point.orientation_rad);
    const bool inside = window_inside(integral_, point, 0.5F * static_cast<float>(kGrid) * 1.4143F * s + static_cast<float>(half) + 2.0F);

    // Wavelets on the turned grid, in the frame of the point.
    std::array<std::array<Haar, kGrid>, kGrid> grid;
    for (int j = 0; j < kGrid; ++j) {
        const float v = (static_cast<float>(j) - 0.5F * static_cast<float>(kGrid - 1)) * s;
        for (int i = 0; i < kGrid; ++i) {
            const float u = (static_cast<float>(i) - 0.5F * static_cast<float>(kGrid - 1)) * s;
            const int r = corner(point.y_px + si * u + co * v);
            const int c = corner(point.x_px + co * u - si * v);
            const Haar h = inside ? haar(integral_, r, c, half) : haar_clipped(integral_, r, c, half);
            grid[static_cast<std::size_t>(j)][static_cast<std::size_t>(i)] = {co * h.dx + si * h.dy, co * h.dy - si * h.dx};
        }
    }

    // Sixteen cells, in each the sums of dx, |dx|, dy, |dy| with a Gaussian about the cell, equation (6).
    std::size_t n = 0;
    float square = 0.0F;
    for (std::size_t b = 0; b < kCells; ++b) {
        for (std::size_t a = 0; a < kCells; ++a) {
            float sx = 0.0F;
            float ax = 0.0F;
            float sy = 0.0F;
            float ay = 0.0F;
            for (std::size_t j = 0; j < kCellSide; ++j) {
                for (std::size_t i = 0; i < kCellSide; ++i) {
                    const Haar& h = grid[b * kCellStep + j][a * kCellStep + i];
                    const float w = weights().sample[j][i];
                    sx += w * h.dx;
                    ax += w * std::fabs(h.dx);
                    sy += w * h.dy;
                    ay += w * std::fabs(h.dy);
                }
            }
            const float w = weights().cell[b][a];
            for (const float v : {w * sx, w * ax, w * sy, w * ay}) {
                out[n++] = v;
                square += v * v;
            }
        }
    }
    if (!(square > 0.0F)) { return false; }
    const float inverse = 1.0F / std::sqrt(square);
    for (float& v : out) { v *= inverse; }
    return true;
}

}  // namespace noctule
