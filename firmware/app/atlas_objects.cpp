#include "app/atlas_objects.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr float kLeastSigmaM = 0.05F;   // one frame is not believed better than that

}  // namespace

void AtlasObjects::note(const objects_t& seen, const std::int32_t floor) {
    if (floor < 0 || seen.looked == 0) { return; }
    const std::int32_t count = std::clamp<std::int32_t>(seen.count, 0, objects_t::MAX_REGIONS);
    for (std::int32_t i = 0; i < count; ++i) {
        const float sigma_m = std::max(seen.along_sigma_m[i], kLeastSigmaM);
        if (seen.object_id[i] <= 0 || !std::isfinite(seen.x_m[i]) || !std::isfinite(seen.y_m[i]) || !std::isfinite(seen.z_m[i]) || !std::isfinite(sigma_m)) { continue; }
        auto* at = std::find_if(kept_.begin(), kept_.end(), [&](const Kept& k) { return k.object.id == seen.object_id[i]; });
        if (at == kept_.end()) {
            if (!kept_.push({{seen.object_id[i], floor, seen.x_m[i], seen.y_m[i], seen.z_m[i]}, 0.0F, 0})) { continue; }
            at = kept_.end() - 1;
        }
        const float weight = 1.0F / (sigma_m * sigma_m);
        at->weight += weight;
        ++at->frames;
        const float share = weight / at->weight;
        at->object.x_m += share * (seen.x_m[i] - at->object.x_m);
        at->object.y_m += share * (seen.y_m[i] - at->object.y_m);
        at->object.z_m += share * (seen.z_m[i] - at->object.z_m);
    }
}

void AtlasObjects::list(Bounded<AtlasObject, kMaxAtlasObjects>& out) const {
    out.clear();
    for (const Kept& k : kept_) {
        if (k.frames >= kLeastFrames) { static_cast<void>(out.push(k.object)); }
    }
}

}  // namespace noctule
