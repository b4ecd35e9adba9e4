/// Sweeps kept along the way, each with its pose: what the scan match makes its map of, and what a loop is closed with.
///
/// A fixed pool. When it is full the keyframe that lies closest to its neighbours on the way gives way (counted).
/// Frame Map; points in Body, 2 mm steps, up to 65 m. Page: docs/maths/scan_match.md#keyframes. About 1.6 MB, no heap.
#pragma once

#include <array>
#include <cstdint>

#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "estimate/scan_map.hpp"
#include "estimate/scan_shape.hpp"

namespace noctule {

class Keyframes {
public:
    void clear() { size_ = 0; }
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] const Pose2<Map, Body>& pose(const std::size_t i) const { return frames_[i].pose; }
    void set_pose(const std::size_t i, const Pose2<Map, Body>& pose) { frames_[i].pose = pose; }

    /// True if the vehicle is far enough from the last keyframe for another one.
    [[nodiscard]] bool due(const Pose2<Map, Body>& pose) const;
    /// Keeps a sweep as the newest keyframe.
    void add(const ScanShape& shape, const Pose2<Map, Body>& pose);
    /// The sweep of a keyframe.
    void shape(std::size_t i, ScanShape& out) const;
    /// Fills the map with the keyframes nearest to a place among [first, end).
    void fill(ScanMap& map, const Pose2<Map, Body>& pose, std::size_t first, std::size_t end) const;
    [[nodiscard]] std::uint32_t evicted() const { return evicted_; }

private:
    struct Frame {
        Pose2<Map, Body> pose;
        std::int32_t count = 0;
        std::array<std::array<std::int16_t, 2>, kMaxShapePoints> points{};
    };
    std::array<Frame, kMaxKeyframes> frames_{};
    std::size_t size_ = 0;
    std::uint32_t evicted_ = 0;
};

}  // namespace noctule
