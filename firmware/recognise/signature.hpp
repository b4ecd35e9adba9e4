/// What an object without texture looks like: colours as ratios, and the moments of its outline.
///
/// Model: docs/maths/vision.md, "Signature", equations (19) to (21). Light multiplies the channels; against the ground's colour it drops out.
#pragma once

#include <array>
#include <cstddef>

#include <opencv2/core.hpp>

#include "recognise/segmentation.hpp"

namespace noctule {

inline constexpr std::size_t kColourBins = 25;   ///< 12 hues at two strengths, and grey

struct Signature {
    std::array<float, kColourBins> colour{};     ///< shares of the pixels, sum 1
    std::array<float, 7> moments{};              ///< Hu's moments of the outline, as sign times log10
};

/// Signature of a region. bgr: the frame; ground: as Segmentation::ground().
[[nodiscard]] Signature describe_region(const cv::Mat& bgr, const cv::Mat& labels, const Region& region, const std::array<float, 2>& ground);

/// 1 for the same colours, 0 for none in common (Bhattacharyya), equation (20).
[[nodiscard]] float colour_likeness(const Signature& a, const Signature& b);

}  // namespace noctule
