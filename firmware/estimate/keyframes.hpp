/// Sweeps kept along the way, each with its pose: what the scan match makes its map of, and what a loop is closed with.
///
/// A fixed pool. When it is full the keyframe that lies closest to its neighbours on the way gives way (counted).
/// Frame Map; points in Body, 2 mm steps, up to 65 m. Page: docs/maths/scan_match.md#keyframes. About 1.1 MB, no heap.
#pragma once

#include <array>
#include <cstdint>

#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "estimate/relocation.hpp"
#include "estimate/scan_map.hpp"
#include "estimate/scan_shape.hpp"

namespace noctule {

class Keyframes {
public:
    void clear() { size_ = 0; }
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] const Pose2<Map, Body>& pose(const std::size_t i) const { return frames_[i].pose; }
    [[nodiscard]] const FrameDoubt& doubt(const std::size_t i) const { return frames_[i].doubt; }
    /// Number of the stretch of way without a loss that it belongs to.
    [[nodiscard]] std::uint16_t epoch(const std::size_t i) const { return frames_[i].epoch; }

    /// True if the vehicle is far enough from the last keyframe for another one.
    [[nodiscard]] bool due(const Pose2<Map, Body>& pose) const;
    /// Keeps a sweep as the newest keyframe.
    void add(const ScanShape& shape, const Pose2<Map, Body>& pose, const FrameDoubt& doubt, std::uint16_t epoch);
    /// Moves each by its part of a correction.
    void move(const Relocation& relocation);
    /// The sweep of a keyframe.
    void shape(std::size_t i, ScanShape& out) const;
    /// Fills the map with the keyframes nearest to a place among those that takes(index) lets in.
    template <class Takes>
    void fill(ScanMap& map, const Pose2<Map, Body>& pose, const Takes& takes) const {
        std::array<std::uint16_t, kMaxKeyframes> near{};
        std::size_t n = 0;
        for (std::size_t i = 0; i < size_; ++i) {
            if (near_to(i, pose) && takes(i)) { near[n++] = static_cast<std::uint16_t>(i); }
        }
        fill_with(map, pose, near, n);
    }
    [[nodiscard]] std::uint32_t evicted() const { return evicted_; }

private:
    [[nodiscard]] bool near_to(std::size_t i, const Pose2<Map, Body>& pose) const;
    void fill_with(ScanMap& map, const Pose2<Map, Body>& pose, std::array<std::uint16_t, kMaxKeyframes>& near, std::size_t n) const;

    struct Frame {
        Pose2<Map, Body> pose;
        FrameDoubt doubt;
        std::uint16_t epoch = 0;
        std::uint16_t count = 0;
        std::array<std::array<std::int16_t, 2>, kMaxShapePoints> points{};
    };
    std::array<Frame, kMaxKeyframes> frames_{};
    std::size_t size_ = 0;
    std::uint32_t evicted_ = 0;
};

}  // namespace noctule
