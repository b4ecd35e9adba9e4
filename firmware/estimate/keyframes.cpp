#include "estimate/keyframes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace noctule {

namespace {

constexpr float kStep_m = 0.002F;
constexpr float kApart_m = 0.30F;
constexpr float kApart_rad = 0.30F;
constexpr float kNear_m = 12.0F;          // keyframes farther away do not enter the map
constexpr std::size_t kInMap = 60;

[[nodiscard]] float apart(const Pose2<Map, Body>& a, const Pose2<Map, Body>& b) {
    return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m) + std::abs(wrap_angle(a.yaw_rad - b.yaw_rad));
}

}  // namespace

bool Keyframes::due(const Pose2<Map, Body>& pose) const {
    if (size_ == 0) { return true; }
    const Pose2<Map, Body>& last = frames_[size_ - 1].pose;
    return std::hypot(pose.x_m - last.x_m, pose.y_m - last.y_m) > kApart_m || std::abs(wrap_angle(pose.yaw_rad - last.yaw_rad)) > kApart_rad;
}

void Keyframes::add(const ScanShape& shape, const Pose2<Map, Body>& pose, const FrameDoubt& doubt, const std::uint16_t epoch) {
    if (size_ == kMaxKeyframes) {
        std::size_t at = 1;
        float least = std::numeric_limits<float>::max();
        for (std::size_t i = 1; i + 1 < size_; ++i) {
            const float way = apart(frames_[i].pose, frames_[i - 1].pose) + apart(frames_[i].pose, frames_[i + 1].pose);
            if (way < least) {
                least = way;
                at = i;
            }
        }
        std::move(frames_.begin() + static_cast<std::ptrdiff_t>(at) + 1, frames_.end(), frames_.begin() + static_cast<std::ptrdiff_t>(at));
        --size_;
        ++evicted_;
    }
    Frame& frame = frames_[size_++];
    frame.pose = pose;
    frame.doubt = doubt;
    frame.epoch = epoch;
    frame.count = 0;
    for (const Point2<Body>& point : shape) {
        const float x = point.x_m / kStep_m;
        const float y = point.y_m / kStep_m;
        if (!(std::abs(x) < 32000.0F && std::abs(y) < 32000.0F)) { continue; }
        frame.points[frame.count++] = {static_cast<std::int16_t>(std::lround(x)), static_cast<std::int16_t>(std::lround(y))};
    }
}

void Keyframes::shape(const std::size_t i, ScanShape& out) const {
    out.clear();
    const Frame& frame = frames_[i];
    for (std::size_t k = 0; k < frame.count; ++k) {
        const auto& point = frame.points[k];
        static_cast<void>(out.push({kStep_m * static_cast<float>(point[0]), kStep_m * static_cast<float>(point[1])}));
    }
}

void Keyframes::move(const Relocation& relocation) {
    for (std::size_t i = 0; i < size_; ++i) {
        Frame& frame = frames_[i];
        frame.pose = relocation.part(relocation.share(frame.doubt)) * frame.pose;
        frame.doubt = relocation.left(frame.doubt);
    }
}

bool Keyframes::near_to(const std::size_t i, const Pose2<Map, Body>& pose) const {
    const float dx = frames_[i].pose.x_m - pose.x_m;
    const float dy = frames_[i].pose.y_m - pose.y_m;
    return dx * dx + dy * dy < kNear_m * kNear_m;
}

void Keyframes::fill_with(ScanMap& map, const Pose2<Map, Body>& pose, std::array<std::uint16_t, kMaxKeyframes>& near, std::size_t n) const {
    map.start(pose.x_m, pose.y_m);
    const auto square = [&](const std::uint16_t i) {
        const float dx = frames_[i].pose.x_m - pose.x_m;
        const float dy = frames_[i].pose.y_m - pose.y_m;
        return dx * dx + dy * dy;
    };
    if (n > kInMap) {
        std::nth_element(near.begin(), near.begin() + kInMap, near.begin() + static_cast<std::ptrdiff_t>(n), [&](const std::uint16_t a, const std::uint16_t b) {
            const float da = square(a);
            const float db = square(b);
            return da != db ? da < db : a > b;
        });
        n = kInMap;
        std::sort(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(n));
    }
    ScanShape points;
    for (std::size_t k = 0; k < n; ++k) {
        shape(near[k], points);
        map.add(points.begin(), points.size(), frames_[near[k]].pose);
    }
}

}  // namespace noctule
