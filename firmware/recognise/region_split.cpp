#include "recognise/region_split.hpp"

#include <algorithm>
#include <cmath>

#include "recognise/log_levels.hpp"

namespace noctule {
namespace {

constexpr float kGrey = 0.25F;        // log ratio below which a pixel has no hue
constexpr float kApart = 0.30F;       // parts with less colour in common are two things
constexpr float kShare = 0.20F;       // least share of the pixels on each side of a cut
constexpr int kLeast_px = 60;         // and least number
constexpr int kNarrow_px = 5;
constexpr float kThin = 0.3F;         // of the width: a thinner row at an end is a fringe
constexpr int kLevel_px = 3;          // lower sides this close together: neither stands before the other
constexpr float kTurn_deg = 360.0F;

/// The part of a region in a rectangle without the thin rows at its ends: the fringe of the other part.
Region trimmed(const cv::Mat& labels, const Region& region, const cv::Rect& rectangle) {
    const Region part = region_within(labels, region, rectangle);
    cv::Rect box(part.left_px, part.top_px, part.width_px, part.height_px);
    const auto thin = [&](const int y) {
        int n = 0;
        for (int x = box.x; x < box.x + box.width; ++x) { n += labels.at<int>(y, x) == region.label ? 1 : 0; }
        return static_cast<float>(n) < kThin * static_cast<float>(box.width);
    };
    while (box.height > kNarrow_px && thin(box.y + box.height - 1)) { --box.height; }
    while (box.height > kNarrow_px && thin(box.y)) {
        ++box.y;
        --box.height;
    }
    return region_within(labels, region, box);
}

}  // namespace

Region region_within(const cv::Mat& labels, const Region& region, const cv::Rect& rectangle) {
    Region part = region;
    part.area_px = 0;
    int left = labels.cols;
    int right = -1;
    int top = labels.rows;
    int bottom = -1;
    double sum_x = 0.0;
    double sum_y = 0.0;
    for (int y = rectangle.y; y < rectangle.y + rectangle.height; ++y) {
        const int* const line = labels.ptr<int>(y);
        for (int x = rectangle.x; x < rectangle.x + rectangle.width; ++x) {
            if (line[x] != region.label) { continue; }
            ++part.area_px;
            sum_x += x;
            sum_y += y;
            left = std::min(left, x);
            right = std::max(right, x);
            top = std::min(top, y);
            bottom = std::max(bottom, y);
        }
    }
    if (part.area_px == 0) { return part; }
    part.x_px = static_cast<float>(sum_x / part.area_px);
    part.y_px = static_cast<float>(sum_y / part.area_px);
    part.left_px = left;
    part.top_px = top;
    part.width_px = right - left + 1;
    part.height_px = bottom - top + 1;
    return part;
}

void RegionSplitter::count(const cv::Mat& bgr, const std::array<float, 2>& ground, const cv::Mat& labels, const Region& region) {
    const std::array<float, 256>& log_of = log_levels();
    for (int x = 0; x < region.width_px; ++x) { column_[static_cast<std::size_t>(x)].fill(0.0F); }
    for (int y = 0; y < region.height_px; ++y) {
        auto& row = row_[static_cast<std::size_t>(y)];
        row.fill(0.0F);
        const int* const label = labels.ptr<int>(region.top_px + y) + region.left_px;
        const std::uint8_t* p = bgr.ptr<std::uint8_t>(region.top_px + y) + 3 * static_cast<std::ptrdiff_t>(region.left_px);
        for (int x = 0; x < region.width_px; ++x, p += 3) {
            if (label[x] != region.label) { continue; }
            auto& column = column_[static_cast<std::size_t>(x)];
            const float u = log_of[p[0]] - log_of[p[1]] - ground[0];
            const float v = log_of[p[2]] - log_of[p[1]] - ground[1];
            if (u * u + v * v < kGrey * kGrey) {
                column[kHues] += 1.0F;
                row[kHues] += 1.0F;
                continue;
            }
            // Shared between two neighbouring hues, as in the signature.
            const float place = cv::fastAtan2(v, u) * static_cast<float>(kHues) / kTurn_deg;
            const float floor = std::floor(place);
            const std::size_t low = static_cast<std::size_t>(floor) % kHues;
            const std::size_t high = (low + 1) % kHues;
            const float share = place - floor;
            column[low] += 1.0F - share;
            column[high] += share;
            row[low] += 1.0F - share;
            row[high] += share;
        }
    }
}

RegionSplitter::Cut RegionSplitter::best(const Region& region) const {
    Cut found;
    const auto along = [&](const auto& lines, const int count, const bool upright) {
        std::array<float, kBins> all{};
        for (int k = 0; k < count; ++k) {
            for (std::size_t b = 0; b < kBins; ++b) { all[b] += lines[static_cast<std::size_t>(k)][b]; }
        }
        const float total = static_cast<float>(region.area_px);
        const float least = std::max(kShare * total, static_cast<float>(kLeast_px));
        std::array<float, kBins> first{};
        float sum = 0.0F;
        for (int k = 0; k + 1 < count; ++k) {
            for (std::size_t b = 0; b < kBins; ++b) {
                const float n = lines[static_cast<std::size_t>(k)][b];
                first[b] += n;
                sum += n;
            }
            if (k + 1 < kNarrow_px || count - k - 1 < kNarrow_px || sum < least || total - sum < least) { continue; }
            // Equation (1b): what the two sides have in common.
            float likeness = 0.0F;
            for (std::size_t b = 0; b < kBins; ++b) { likeness += std::sqrt(first[b] * std::max(all[b] - first[b], 0.0F)); }
            likeness /= std::sqrt(sum * (total - sum));
            if (likeness < found.likeness) { found = {upright, k + 1, likeness}; }
        }
    };
    along(column_, region.width_px, true);
    along(row_, region.height_px, false);
    return found;
}

void RegionSplitter::split(const cv::Mat& bgr, const std::array<float, 2>& ground, cv::Mat& labels, Regions& regions, int next_label) {
    // Parts are looked at again: they come after the regions that are there already.
    for (std::size_t i = 0; i < regions.size() && !regions.full();) {
        const Region region = regions[i];
        if (region.area_px < 2 * kLeast_px) {
            ++i;
            continue;
        }
        count(bgr, ground, labels, region);
        const Cut cut = best(region);
        if (cut.likeness >= kApart) {
            ++i;
            continue;
        }
        const cv::Rect box(region.left_px, region.top_px, region.width_px, region.height_px);
        cv::Rect one = box;
        cv::Rect other = box;
        if (cut.upright) {
            one.width = cut.at_px;
            other.x += cut.at_px;
            other.width -= cut.at_px;
        } else {
            one.height = cut.at_px;
            other.y += cut.at_px;
            other.height -= cut.at_px;
        }
        Region a = trimmed(labels, region, one);
        Region b = trimmed(labels, region, other);
        for (int y = other.y; y < other.y + other.height; ++y) {
            int* const line = labels.ptr<int>(y);
            for (int x = other.x; x < other.x + other.width; ++x) {
                if (line[x] == region.label) { line[x] = next_label; }
            }
        }
        b.label = next_label++;
        if (cut.upright) {
            // What reaches farther down stands nearer.
            const int lower = (a.top_px + a.height_px) - (b.top_px + b.height_px);
            a.hidden_beside = a.hidden_beside || lower < -kLevel_px;
            b.hidden_beside = b.hidden_beside || lower > kLevel_px;
        } else {
            a.hidden_below = true;
        }
        regions[i] = a;
        static_cast<void>(regions.push(b));
    }
}

}  // namespace noctule
