/// What of the Navigator goes into the atlas.
#pragma once

#include <cstdint>

#include "map/atlas.hpp"
#include "navigator.hpp"

namespace noctule {

/// Refreshes the contents: floors, levels, passages and refusals anew, walls of the floor the vehicle is on (the others stay as they were
/// when it left them). Counts the sequence up. No heap.
void fill_atlas(const Navigator& navigator, std::int64_t t_us, AtlasContents& contents);

}  // namespace noctule
