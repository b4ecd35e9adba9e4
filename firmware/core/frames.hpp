/// Frames and the planar transforms between them.
///
/// A transform names both ends, so that a wrong composition does not compile:
/// pose_map_body * pose_body_lidar * point_lidar. See docs/frames.md.
/// SI units, angles in (-pi, pi]. No storage beyond the values.
#pragma once

#include <cmath>

#include "core/angle.hpp"

namespace noctule {

struct Map {};    ///< forward-left-up at the start pose, origin on the floor under the vehicle, z up
struct Body {};   ///< centre of the hull, x forward, y left, z up
struct Lidar {};  ///< optical centre of the scanner, x along bearing zero
struct Camera {}; ///< optical centre, z along the view, x right, y down

template <class Frame>
struct Point2 {
    float x_m = 0.0F;
    float y_m = 0.0F;
};

/// Maps coordinates in From to coordinates in To.
template <class To, class From>
struct Pose2 {
    float x_m = 0.0F;
    float y_m = 0.0F;
    float yaw_rad = 0.0F;

    [[nodiscard]] Point2<To> operator*(const Point2<From>& p) const {
        const float c = std::cos(yaw_rad);
        const float s = std::sin(yaw_rad);
        return {x_m + c * p.x_m - s * p.y_m, y_m + s * p.x_m + c * p.y_m};
    }

    template <class Inner>
    [[nodiscard]] Pose2<To, Inner> operator*(const Pose2<From, Inner>& q) const {
        const Point2<To> p = *this * Point2<From>{q.x_m, q.y_m};
        return {p.x_m, p.y_m, wrap_angle(yaw_rad + q.yaw_rad)};
    }

    [[nodiscard]] Pose2<From, To> inverse() const {
        const float c = std::cos(yaw_rad);
        const float s = std::sin(yaw_rad);
        return {-c * x_m - s * y_m, s * x_m - c * y_m, wrap_angle(-yaw_rad)};
    }
};

}  // namespace noctule
