/// Cuts a region where two things of different colours meet in the picture: one before the other, or side by side.
///
/// Model: docs/maths/vision.md, "Two things in one region", equation (1b). Frame: image [px]. Fixed memory, no heap. Not thread-safe.
#pragma once

#include <array>
#include <cstddef>

#include <opencv2/core.hpp>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "recognise/region.hpp"

namespace noctule {

class RegionSplitter {
public:
    /// Replaces each region that falls into parts by the parts and gives their pixels labels of their own, from next_label on. What finds no room
    /// in regions stays uncut. bgr: the frame; ground: ln(blue / green) and ln(red / green) of the background.
    void split(const cv::Mat& bgr, const std::array<float, 2>& ground, cv::Mat& labels, Regions& regions, int next_label);

private:
    static constexpr std::size_t kHues = 12;
    static constexpr std::size_t kBins = kHues + 1;   ///< and grey

    struct Cut {
        bool upright = false;   ///< between two columns, else between two rows
        int at_px = 0;          ///< first column or row of the right or lower part
        float likeness = 1.0F;
    };

    void count(const cv::Mat& bgr, const std::array<float, 2>& ground, const cv::Mat& labels, const Region& region);
    [[nodiscard]] Cut best(const Region& region) const;

    std::array<std::array<float, kBins>, kMaxSurfSide> column_{};
    std::array<std::array<float, kBins>, kMaxSurfSide> row_{};
};

/// Box, area and centroid of the pixels of a region inside a rectangle; area 0: none.
[[nodiscard]] Region region_within(const cv::Mat& labels, const Region& region, const cv::Rect& rectangle);

}  // namespace noctule
