#include "app/atlas_contents.hpp"

namespace noctule {

void fill_atlas(const Navigator& navigator, const std::int64_t t_us, AtlasContents& contents) {
    const FloorPlanner& planner = navigator.mission().floors();
    ++contents.sequence;
    contents.t_us = t_us;
    contents.floors.clear();
    for (std::int32_t layer = 0; layer < static_cast<std::int32_t>(planner.floors().size()); ++layer) {
        const Floor& floor = planner.floors()[static_cast<std::size_t>(layer)];
        if (floor.confirmed) { static_cast<void>(contents.floors.push({layer, planner.name_of(layer), floor.elevation_m})); }
    }
    if (planner.layer() != FloorPlanner::kShaft) {
        auto& walls = contents.walls[static_cast<std::size_t>(planner.layer())];
        walls.clear();
        navigator.localiser().walls(walls);
    }
    contents.levels.clear();
    for (const Level& level : navigator.altitude().levels()) { static_cast<void>(contents.levels.push(level)); }
    contents.passages.clear();
    for (const Passage& p : planner.passages()) {
        const std::int32_t low = planner.name_of(p.low);
        const std::int32_t high = planner.name_of(p.high);
        if (low >= 0 && high >= 0) { static_cast<void>(contents.passages.push({low, high, p.x_m, p.y_m})); }
    }
    contents.refused.clear();
    for (const FloorPlanner::Judged& j : planner.judged()) {
        static_cast<void>(contents.refused.push({planner.name_of(j.floor), static_cast<std::int32_t>(j.why), j.x_m, j.y_m}));
    }
}

}  // namespace noctule
