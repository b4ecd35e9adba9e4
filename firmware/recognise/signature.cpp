#include "recognise/signature.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "recognise/log_levels.hpp"

namespace noctule {
namespace {

constexpr float kGrey = 0.25F;     // log ratio below which a pixel has no hue
constexpr float kStrong = 1.1F;    // and from which it is strongly coloured
constexpr int kHues = 12;
constexpr float kTurn = 6.2831853F;

/// Adds a weight to two neighbouring hues, so that a hue between them stays the same when the light shifts it a little.
void add(std::array<float, kColourBins>& colour, const float hue_rad, const float strength, const float weight) {
    const float place = (hue_rad / kTurn + 0.5F) * static_cast<float>(kHues);
    const int low = static_cast<int>(std::floor(place - 0.5F));
    const float high_share = place - 0.5F - static_cast<float>(low);
    const std::size_t ring = strength >= kStrong ? kHues : 0;
    const auto bin = [&](const int k) { return ring + static_cast<std::size_t>(((k % kHues) + kHues) % kHues); };
    colour[bin(low)] += weight * (1.0F - high_share);
    colour[bin(low + 1)] += weight * high_share;
}

}  // namespace

Signature describe_region(const cv::Mat& bgr, const cv::Mat& labels, const Region& region, const std::array<float, 2>& ground) {
    Signature out;
    const std::array<float, 256>& log_of = log_levels();
    float total = 0.0F;
    cv::Mat outline = cv::Mat::zeros(std::max(region.height_px, 1), std::max(region.width_px, 1), CV_8UC1);
    for (int y = 0; y < region.height_px; ++y) {
        const int* const label = labels.ptr<int>(region.top_px + y) + region.left_px;
        const std::uint8_t* p = bgr.ptr<std::uint8_t>(region.top_px + y) + 3 * static_cast<std::ptrdiff_t>(region.left_px);
        std::uint8_t* const mask = outline.ptr<std::uint8_t>(y);
        for (int x = 0; x < region.width_px; ++x, p += 3) {
            if (label[x] != region.label) { continue; }
            mask[x] = 255;
            const float green = log_of[p[1]];
            // Equation (19): two axes across the grey one.
            const float u = log_of[p[0]] - green - ground[0];
            const float v = log_of[p[2]] - green - ground[1];
            const float strength = std::hypot(u, v);
            total += 1.0F;
            if (strength < kGrey) {
                out.colour[kColourBins - 1] += 1.0F;
            } else {
                add(out.colour, std::atan2(v, u), strength, 1.0F);
            }
        }
    }
    if (total > 0.0F) {
        for (float& share : out.colour) { share /= total; }
        double hu[7] = {};
        cv::HuMoments(cv::moments(outline, true), hu);
        for (std::size_t i = 0; i < out.moments.size(); ++i) {
            const double size = std::fabs(hu[i]) + 1.0e-12;
            out.moments[i] = static_cast<float>(hu[i] < 0.0 ? -std::log10(size) : std::log10(size));
        }
    }
    return out;
}

float colour_likeness(const Signature& a, const Signature& b) {
    // The two rings of strength are taken together: how strong a colour looks depends on gloss and shade, its hue does not.
    float sum = std::sqrt(a.colour[kColourBins - 1] * b.colour[kColourBins - 1]);
    for (std::size_t k = 0; k < kHues; ++k) { sum += std::sqrt((a.colour[k] + a.colour[k + kHues]) * (b.colour[k] + b.colour[k + kHues])); }
    return std::min(sum, 1.0F);
}

}  // namespace noctule
