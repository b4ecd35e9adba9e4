#include "recognise/segmentation.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <opencv2/imgproc.hpp>

#include "recognise/log_levels.hpp"

namespace noctule {
namespace {

constexpr int kTextureBlock = 7;   // px, side of the patch over which gradients are compared
constexpr int kDark = 12;          // grey levels: below this a colour ratio is noise
constexpr float kTint = 0.35F;     // log ratio by which the ground's colour may change from one moment to the next: light, and what is in view
constexpr float kFollow = 0.02F;   // share of that by which the ground is followed at each frame

/// Median of one channel by its histogram.
int median_of(const cv::Mat& bgr, const int channel) {
    std::array<int, 256> count{};
    for (int y = 0; y < bgr.rows; ++y) {
        const std::uint8_t* p = bgr.ptr<std::uint8_t>(y) + channel;
        for (int x = 0; x < bgr.cols; ++x, p += 3) { ++count[*p]; }
    }
    const int half = bgr.rows * bgr.cols / 2;
    int sum = 0;
    for (std::size_t level = 0; level < count.size(); ++level) {
        sum += count[level];
        if (sum > half) { return static_cast<int>(level); }
    }
    return 255;
}

}  // namespace

const Regions& Segmentation::find(const cv::Mat& bgr, const SegmentationSettings& settings) {
    regions_.clear();
    if (bgr.empty() || bgr.type() != CV_8UC3) { return regions_; }
    mask_.create(bgr.size(), CV_8UC1);
    if (settings.mode == SegmentationMode::threshold) {
        by_threshold(bgr, settings);
    } else {
        by_contrast(bgr, settings);
    }
    const auto morph = [&](const int operation, const int side) {
        if (side <= 1) { return; }
        const cv::Mat kernel = cv::getStructuringElement(cv::MORPH_ELLIPSE, {side, side});
        cv::morphologyEx(mask_, mask_, operation, kernel);
    };
    morph(cv::MORPH_OPEN, settings.open_px);
    morph(cv::MORPH_CLOSE, settings.close_px);

    const int count = cv::connectedComponentsWithStats(mask_, labels_, stats_, centroids_, 8, CV_32S);
    std::array<int, kMaxRegions> largest{};  // labels, largest area first
    std::size_t kept = 0;
    const double area_max = static_cast<double>(settings.area_max) * bgr.rows * bgr.cols;
    const auto area = [&](const int label) { return stats_.at<int>(label, cv::CC_STAT_AREA); };
    for (int label = 1; label < count; ++label) {
        if (area(label) < settings.area_min_px || area(label) > area_max) { continue; }
        std::size_t place = kept;
        while (place > 0 && area(largest[place - 1]) < area(label)) { --place; }
        dropped_ += kept == kMaxRegions ? 1U : 0U;
        if (place == kMaxRegions) { continue; }
        const std::size_t end = std::min(kept, kMaxRegions - 1);
        for (std::size_t i = end; i > place; --i) { largest[i] = largest[i - 1]; }
        largest[place] = label;
        kept = std::min(kept + 1, kMaxRegions);
    }
    for (std::size_t i = 0; i < kept; ++i) {
        const int label = largest[i];
        const Region region{area(label),
                            static_cast<float>(centroids_.at<double>(label, 0)),
                            static_cast<float>(centroids_.at<double>(label, 1)),
                            stats_.at<int>(label, cv::CC_STAT_LEFT),
                            stats_.at<int>(label, cv::CC_STAT_TOP),
                            stats_.at<int>(label, cv::CC_STAT_WIDTH),
                            stats_.at<int>(label, cv::CC_STAT_HEIGHT),
                            label};
        static_cast<void>(regions_.push(region));
    }
    // The paper's form takes regions as they are.
    if (settings.mode == SegmentationMode::contrast) { splitter_.split(calm_, ground_, labels_, regions_, count); }
    return regions_;
}

void Segmentation::by_threshold(const cv::Mat& bgr, const SegmentationSettings& settings) {
    // The paper's: each channel at I0, then the union.
    const int least = std::clamp(settings.intensity, 0, 255);
    for (int y = 0; y < bgr.rows; ++y) {
        const std::uint8_t* p = bgr.ptr<std::uint8_t>(y);
        std::uint8_t* const out = mask_.ptr<std::uint8_t>(y);
        for (int x = 0; x < bgr.cols; ++x, p += 3) {
            out[x] = p[0] >= least || p[1] >= least || p[2] >= least ? 255 : 0;
        }
    }
}

void Segmentation::by_contrast(const cv::Mat& bgr, const SegmentationSettings& settings) {
    // Texture: both eigenvalues of the gradients' spread are large where a patch varies in two directions; along the straight
    // edge between wall and floor the smaller one vanishes. Over the mean squared it does not know how bright the light is.
    cv::cvtColor(bgr, grey_, cv::COLOR_BGR2GRAY);
    cv::GaussianBlur(grey_, smooth_, {3, 3}, 0.0);
    cv::cornerMinEigenVal(smooth_, eigen_, kTextureBlock, 3);
    cv::boxFilter(smooth_, mean_, CV_32F, {kTextureBlock, kTextureBlock});
    // Colour: the light multiplies each channel, so it drops out of the log ratios against the ground's. A ground that changes by more than light
    // does is an object that fills the frame.
    const std::array<float, 256>& log_of = log_levels();
    std::array<float, 3> median{};
    for (int c = 0; c < 3; ++c) { median[static_cast<std::size_t>(c)] = log_of[static_cast<std::size_t>(median_of(bgr, c))]; }
    const float db = median[0] - median[1] - followed_[0];
    const float dr = median[2] - median[1] - followed_[1];
    const float off = std::hypot(db, dr);
    const float share = off > kTint ? kTint / off : 1.0F;
    ground_ = {followed_[0] + share * db, followed_[1] + share * dr};
    followed_ = {followed_[0] + kFollow * share * db, followed_[1] + kFollow * share * dr};
    // Walls may have a colour of their own under white light: what lies between white and the ground is no object either, equation (1a).
    const float length2 = std::max(ground_[0] * ground_[0] + ground_[1] * ground_[1], 1.0e-12F);
    const float chroma2 = settings.chroma * settings.chroma;
    cv::GaussianBlur(bgr, calm_, {3, 3}, 0.0);
    for (int y = 0; y < bgr.rows; ++y) {
        const std::uint8_t* p = calm_.ptr<std::uint8_t>(y);
        const float* const eigen = eigen_.ptr<float>(y);
        const float* const mean = mean_.ptr<float>(y);
        std::uint8_t* const out = mask_.ptr<std::uint8_t>(y);
        for (int x = 0; x < bgr.cols; ++x, p += 3) {
            const float u = log_of[p[0]] - log_of[p[1]];
            const float v = log_of[p[2]] - log_of[p[1]];
            const float t = std::clamp((u * ground_[0] + v * ground_[1]) / length2, 0.0F, 1.0F);
            const float du = u - t * ground_[0];
            const float dv = v - t * ground_[1];
            const bool lit = std::max({p[0], p[1], p[2]}) >= kDark;
            const bool coloured = lit && du * du + dv * dv > chroma2;
            // OpenCV takes 8-bit images as 0 to 1 here.
            const float level = mean[x] / 255.0F;
            const bool textured = mean[x] >= static_cast<float>(kDark) && eigen[x] > settings.texture * level * level;
            out[x] = coloured || textured ? 255 : 0;
        }
    }
}

}  // namespace noctule
