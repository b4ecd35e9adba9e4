/// Objects for the atlas, from what noctule-vision says of each frame. Frame Map, metres.
#pragma once

#include <cstdint>

#include "core/bounded.hpp"
#include "lcmtypes/noctule/objects_t.hpp"
#include "map/atlas.hpp"

namespace noctule {

/// Keeps the objects that are sure, each with the mean of its places by frame, weighted by how well each frame knew it. The database (docs/objects.md) knows
/// more and places better; the atlas holds enough to find the object again. More than kMaxAtlasObjects: the later ones are left out. No heap.
class AtlasObjects {
public:
    /// One frame's objects, seen on a floor (its number; -1, between two: nothing is taken).
    void note(const objects_t& seen, std::int32_t floor);

    /// Those seen in kLeastFrames frames or more.
    void list(Bounded<AtlasObject, kMaxAtlasObjects>& out) const;

    static constexpr std::int32_t kLeastFrames = 3;

private:
    struct Kept {
        AtlasObject object;
        float weight = 0.0F;
        std::int32_t frames = 0;
    };
    Bounded<Kept, kMaxAtlasObjects> kept_;
};

}  // namespace noctule
