/// A correction of the newer part of the map, once a place from before has been recognised.
///
/// What was mapped with more doubt moves by more of it: a chain of poses is bent where its doubt grew
/// (docs/maths/localisation.md, equation 12). Frame Map before and after. No storage beyond the values.
#pragma once

#include <algorithm>

#include "core/frames.hpp"

namespace noctule {

/// Doubt about the map's frame at a place against the start: greatest variance of position, variance of yaw.
struct FrameDoubt {
    float m2 = 0.0F;
    float rad2 = 0.0F;
};

struct Relocation {
    Pose2<Map, Map> correction;   ///< of the present pose: it becomes correction * pose
    Point2<Map> centre;           ///< where the vehicle was thought to be
    FrameDoubt before;            ///< of the place that was recognised
    FrameDoubt now;               ///< of the present pose, before the correction

    /// How much of the correction a part of the map takes that was made with this doubt, 0 to 1.
    [[nodiscard]] float share(const FrameDoubt& doubt) const {
        const float grown_m2 = now.m2 - before.m2;
        return grown_m2 > 0.0F ? std::clamp((doubt.m2 - before.m2) / grown_m2, 0.0F, 1.0F) : 1.0F;
    }
    /// That part of the correction.
    [[nodiscard]] Pose2<Map, Map> part(const float share) const {
        const Point2<Map> moved = correction * centre;
        const Pose2<Map, Map> turn{0.0F, 0.0F, share * correction.yaw_rad};
        const Point2<Map> turned = turn * centre;
        return {centre.x_m + share * (moved.x_m - centre.x_m) - turned.x_m, centre.y_m + share * (moved.y_m - centre.y_m) - turned.y_m, turn.yaw_rad};
    }
    /// Doubt that is left to that part: both ends of the chain are tied now.
    [[nodiscard]] FrameDoubt left(const FrameDoubt& doubt) const {
        const float s = share(doubt);
        const float grown_rad2 = std::max(0.0F, now.rad2 - before.rad2);
        return {std::min(doubt.m2, before.m2 + s * (1.0F - s) * (now.m2 - before.m2)), std::min(doubt.rad2, before.rad2 + s * (1.0F - s) * grown_rad2)};
    }
};

}  // namespace noctule
