/// Sums over rectangles of a grey image in four look-ups.
///
/// Entry (r, c) holds the sum over the pixels above row r and left of column c, so row 0 and column 0 are zero.
/// docs/maths/vision.md, equation (1). Units: grey levels 0 to 255. Fixed memory, no heap, not thread-safe.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "core/capacity.hpp"
#include "recognise/grey_image.hpp"

namespace noctule {

class IntegralImage {
public:
    /// False: empty, or larger than kMaxSurfPixels or kMaxSurfSide; the image held before stays. Cost: one pass.
    [[nodiscard]] bool build(const GreyImage& image);

    [[nodiscard]] int width() const { return width_; }
    [[nodiscard]] int height() const { return height_; }

    /// First entry of row r, 0 <= r <= height; width + 1 entries.
    [[nodiscard]] const std::int32_t* row(const int r) const {
        return sums_.data() + static_cast<std::ptrdiff_t>(r) * (width_ + 1);
    }

    /// Sum over rows [r0, r1) and columns [c0, c1). All inside the image, r0 <= r1, c0 <= c1.
    [[nodiscard]] std::int32_t sum(const int r0, const int c0, const int r1, const int c1) const {
        const std::int32_t* const top = row(r0);
        const std::int32_t* const bottom = row(r1);
        return bottom[c1] - bottom[c0] - top[c1] + top[c0];
    }

    /// The same, cut at the borders of the image.
    [[nodiscard]] std::int32_t sum_clipped(const int r0, const int c0, const int r1, const int c1) const {
        const int a = std::clamp(r0, 0, height_);
        const int b = std::clamp(c0, 0, width_);
        return sum(a, b, std::clamp(r1, a, height_), std::clamp(c1, b, width_));
    }

private:
    int width_ = 0;
    int height_ = 0;
    std::array<std::int32_t, kMaxSurfPixels + 2 * kMaxSurfSide + 1> sums_{};  ///< (height + 1) x (width + 1)
};

}  // namespace noctule
