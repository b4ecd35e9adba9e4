/// The baseline: the nearest frontier by shortest path, looked for anew each second and whenever the goal is done.
///
/// As explore_lite and its kin do (Yamauchi 1997): fly up to the nearest frontier, plan again at a fixed rate whatever the goal was,
/// leave alone what could not be reached. It has the same grid, sensors, limits, and tried places as the default policy.
/// Frame Map. No heap.
#pragma once

#include <cstdint>

#include "params.gen.hpp"
#include "plan/policy.hpp"
#include "plan/survey.hpp"

namespace noctule {

class FrontierPolicy final : public Policy {
public:
    explicit FrontierPolicy(const Parameters& parameters) : p_(parameters) {}
    void begin(const Pose2<Map, Body>& home) override;
    const PolicyAnswer& step(const MapView& map, const Pose2<Map, Body>& pose, std::int32_t budget_cells) override;

private:
    void choose(const MapView& map);
    void set_goal(const Frontier& front);
    void drop(const MapView& map, bool give_up);

    const Parameters& p_;
    PolicyAnswer answer_;
    Frontier goal_;
    std::int64_t planned_us_ = -1;
    std::int64_t dwell_since_us_ = -1;
    std::int32_t empty_passes_ = 0;
    bool running_ = false;     ///< a pass is under way
};

}  // namespace noctule
