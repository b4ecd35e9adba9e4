/// A level: one horizontal surface that the range sensors saw, with the extent in which it was seen.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace noctule {

/// Frame Map, SI units. Plain data.
struct Level {
    float z_m = 0.0F;            ///< elevation
    float z_var_m2 = 0.0F;       ///< variance of z_m
    std::int8_t facing = 1;      ///< +1: seen from above (floor, table, tread), -1: seen from below (ceiling)
    bool floor = false;          ///< a floor of the building, not furniture (only with facing +1)
    float x_min_m = 0.0F;        ///< box around the places where it was seen
    float y_min_m = 0.0F;
    float x_max_m = 0.0F;
    float y_max_m = 0.0F;
    std::int32_t seen = 0;       ///< readings that matched it
    std::int64_t first_t_us = 0; ///< first and last reading
    std::int64_t last_t_us = 0;

    /// Horizontal distance from the box; zero inside it.
    [[nodiscard]] float distance_m(const float x_m, const float y_m) const {
        const float dx = std::max({x_min_m - x_m, x_m - x_max_m, 0.0F});
        const float dy = std::max({y_min_m - y_m, y_m - y_max_m, 0.0F});
        return std::hypot(dx, dy);
    }

    /// Grows the box to hold the point.
    void extend(const float x_m, const float y_m) {
        x_min_m = std::min(x_min_m, x_m);
        x_max_m = std::max(x_max_m, x_m);
        y_min_m = std::min(y_min_m, y_m);
        y_max_m = std::max(y_max_m, y_m);
    }

    /// Diagonal of the box.
    [[nodiscard]] float extent_m() const { return std::hypot(x_max_m - x_min_m, y_max_m - y_min_m); }
};

}  // namespace noctule
