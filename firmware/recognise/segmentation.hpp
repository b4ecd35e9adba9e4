/// Regions of a colour image that stand out: connected, cleaned, with centroid and size.
///
/// Two ways (docs/maths/vision.md, "Segmentation"): `threshold` is the paper's, the union of the channels at or above one
/// intensity; `contrast` compares each pixel with the median colour of the frame and looks for texture, both as ratios,
/// so that brighter, darker or tinted light changes nothing.
/// Frame: image, x right, y down, px. May allocate (OpenCV) at the first frame of a size. Not thread-safe.
#pragma once

#include <array>
#include <cstdint>

#include <opencv2/core.hpp>

#include "core/capacity.hpp"
#include "recognise/region.hpp"
#include "recognise/region_split.hpp"

namespace noctule {

enum class SegmentationMode : std::int32_t { threshold = 0, contrast = 1 };

struct SegmentationSettings {
    SegmentationMode mode = SegmentationMode::contrast;
    std::int32_t intensity = 200;    ///< I0 of the paper, 0 to 255 (seg_intensity)
    float chroma = 0.80F;            ///< least distance of log colour ratios from the frame's median (seg_chroma)
    float texture = 0.15F;           ///< least eigenvalue of the gradients' spread over the mean grey squared (seg_texture)
    std::int32_t open_px = 3;        ///< side of the opening that removes specks, 1: none (seg_open_px)
    std::int32_t close_px = 7;       ///< side of the closing that joins parts, 1: none (seg_close_px)
    std::int32_t area_min_px = 60;   ///< smaller regions are dropped (seg_area_min_px), pixels
    float area_max = 0.5F;           ///< regions over more than this share of the frame are background (seg_area_max)
};

class Segmentation {
public:
    /// Regions of a BGR image (8 bit, three channels), largest first. An image of another type or without pixels has none.
    /// More than kMaxRegions: the largest stay, dropped() counts the others.
    const Regions& find(const cv::Mat& bgr, const SegmentationSettings& settings);

    /// Regions that found no room since the start.
    [[nodiscard]] std::uint32_t dropped() const { return dropped_; }

    /// Colour of the ground that objects stand out from in the last frame that find() took by contrast: ln(blue / green), ln(red / green).
    [[nodiscard]] const std::array<float, 2>& ground() const { return ground_; }

    /// Mask of the last find() after morphology: 255 where a region may be.
    [[nodiscard]] const cv::Mat& mask() const { return mask_; }

    /// Label of each pixel of the last find(), 32 bit; regions name theirs.
    [[nodiscard]] const cv::Mat& labels() const { return labels_; }

private:
    void by_threshold(const cv::Mat& bgr, const SegmentationSettings& settings);
    void by_contrast(const cv::Mat& bgr, const SegmentationSettings& settings);

    Regions regions_;
    RegionSplitter splitter_;
    std::uint32_t dropped_ = 0;
    std::array<float, 2> ground_{};
    std::array<float, 2> followed_{};   ///< the ground's colour over the last seconds
    cv::Mat mask_;
    cv::Mat calm_;
    cv::Mat grey_;
    cv::Mat smooth_;
    cv::Mat eigen_;
    cv::Mat mean_;
    cv::Mat labels_;
    cv::Mat stats_;
    cv::Mat centroids_;
};

}  // namespace noctule
