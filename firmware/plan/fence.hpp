/// The fence: where the vehicle may be. A circle and a box round the start, and, if one is given, a polygon; all must hold.
///
/// docs/safety.md, "fence". A pure function of the parameters, frame Map (origin at the start, x along the first heading), metres.
/// The planner does not fly and does not look for anything outside (plan/traversability, plan/frontier); the guard lets no setpoint out.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "core/length.hpp"
#include "params.gen.hpp"

namespace noctule {

inline constexpr float kFenceInsetM = 0.25F;   ///< what is planned keeps so far inside, so that the guard never has to cut it

/// The fence's numbers, copied: comparable, so that a change is noticed.
struct Fence {
    static constexpr std::size_t kMostCorners = 6;
    float radius_m = 0.0F;
    std::array<float, 4> box_m{};                 ///< front, back, left, right of the start
    std::array<std::array<float, 2>, kMostCorners> corner_m{};
    std::size_t corners = 0;                      ///< fewer than 3: no polygon

    explicit Fence(const Parameters& p)
        : radius_m(p.fence_radius_m),
          box_m{p.fence_front_m, p.fence_back_m, p.fence_left_m, p.fence_right_m},
          corner_m{{{p.fence_1_x_m, p.fence_1_y_m}, {p.fence_2_x_m, p.fence_2_y_m}, {p.fence_3_x_m, p.fence_3_y_m},
                    {p.fence_4_x_m, p.fence_4_y_m}, {p.fence_5_x_m, p.fence_5_y_m}, {p.fence_6_x_m, p.fence_6_y_m}}},
          corners(static_cast<std::size_t>(std::clamp(p.fence_corners, std::int32_t{0}, static_cast<std::int32_t>(kMostCorners)))) {}

    [[nodiscard]] bool operator==(const Fence&) const = default;

    /// How far inside a point is [m], negative outside: the distance to the nearest side, corners of the box counted as its sides.
    [[nodiscard]] float depth_m(const float x_m, const float y_m) const {
        float depth = radius_m - length_of(x_m, y_m);
        depth = std::min({depth, box_m[0] - x_m, box_m[1] + x_m, box_m[2] - y_m, box_m[3] + y_m});
        return corners < 3U ? depth : std::min(depth, polygon_depth_m(x_m, y_m));
    }

private:
    // Even-odd rule for the side, distance to the nearest edge for the size.
    [[nodiscard]] float polygon_depth_m(const float x_m, const float y_m) const {
        bool inside = false;
        float nearest2 = std::numeric_limits<float>::infinity();
        for (std::size_t k = 0; k < corners; ++k) {
            const auto& a = corner_m[k];
            const auto& b = corner_m[(k + 1U) % corners];
            const float dx = b[0] - a[0];
            const float dy = b[1] - a[1];
            if ((a[1] > y_m) != (b[1] > y_m) && x_m < a[0] + dx * (y_m - a[1]) / dy) { inside = !inside; }
            const float f = std::clamp(((x_m - a[0]) * dx + (y_m - a[1]) * dy) / std::max(dx * dx + dy * dy, 1e-9F), 0.0F, 1.0F);
            const float ex = a[0] + f * dx - x_m;
            const float ey = a[1] + f * dy - y_m;
            nearest2 = std::min(nearest2, ex * ex + ey * ey);
        }
        return inside ? std::sqrt(nearest2) : -std::sqrt(nearest2);
    }
};

}  // namespace noctule
