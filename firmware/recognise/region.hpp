/// A connected part of a picture. Frame: image, x right, y down, px.
#pragma once

#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"

namespace noctule {

struct Region {
    std::int32_t area_px = 0;        ///< pixels
    float x_px = 0.0F;               ///< centroid
    float y_px = 0.0F;
    std::int32_t left_px = 0;        ///< box
    std::int32_t top_px = 0;
    std::int32_t width_px = 0;
    std::int32_t height_px = 0;
    std::int32_t label = 0;          ///< value of its pixels in Segmentation::labels()
    bool hidden_beside = false;      ///< another region stands before it at its left or right side
    bool hidden_below = false;       ///< and at its lower side
};

using Regions = Bounded<Region, kMaxRegions>;

}  // namespace noctule
