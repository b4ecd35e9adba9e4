#include "plan/frontier_policy.hpp"

#include <cmath>

#include "core/angle.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kPeriodUs = 1000000;   ///< between two plans, as explore_lite's planner_frequency of 1 Hz
constexpr float kUpToM = 1.0F;                ///< a frontier is flown up to; from farther only where nothing nearer is free
constexpr std::int64_t kDwellUs = 300000;
constexpr float kArrivedM = 0.15F;
constexpr float kInSightRad = 2.0F;
constexpr float kSameGoalM = 0.5F;

}  // namespace

void FrontierPolicy::begin(const Pose2<Map, Body>& home) {
    static_cast<void>(home);
    answer_.valid = answer_.finished = answer_.seen = false;
    planned_us_ = dwell_since_us_ = -1;
    empty_passes_ = 0;
    running_ = false;
    counters_ = {};
}

void FrontierPolicy::set_goal(const Frontier& front) {
    goal_ = front;
    answer_.valid = true;
    answer_.seen = false;
    ++answer_.number;
    answer_.cell = front.view;
    answer_.x_m = front.view_x_m;
    answer_.y_m = front.view_y_m;
    answer_.look_x_m = front.x_m;
    answer_.look_y_m = front.y_m;
    dwell_since_us_ = -1;
}

void FrontierPolicy::drop(const MapView& map, const bool give_up) {
    const float distance_m = std::hypot(goal_.view_x_m - goal_.x_m, goal_.view_y_m - goal_.y_m);
    if (give_up) {
        map.survey.tried().give_up(goal_.x_m, goal_.y_m, distance_m, map.t_us);
    } else {
        map.survey.tried().add(goal_.x_m, goal_.y_m, distance_m, map.t_us);
    }
    answer_.valid = false;
}

void FrontierPolicy::choose(const MapView& map) {
    ++counters_.passes;
    planned_us_ = map.t_us;
    const Frontier* best = nullptr;
    for (const Frontier& f : map.survey.search().found()) {
        if (best == nullptr || f.cost < best->cost) { best = &f; }
    }
    if (best == nullptr) {
        answer_.valid = false;
        if (map.where.blocks_waiting() == 0U && ++empty_passes_ >= 2) { answer_.finished = true; }
        return;
    }
    empty_passes_ = 0;
    if (answer_.valid && !answer_.seen && best->view == answer_.cell) { return; }
    if (answer_.valid && !answer_.seen && std::hypot(best->x_m - goal_.x_m, best->y_m - goal_.y_m) > kSameGoalM) { ++counters_.switches; }
    set_goal(*best);
}

const PolicyAnswer& FrontierPolicy::step(const MapView& map, const Pose2<Map, Body>& pose, const std::int32_t budget_cells) {
    if (answer_.valid && map.fate != GoalFate::under_way) {
        if (map.fate == GoalFate::stuck) { ++counters_.stuck; }
        drop(map, map.fate == GoalFate::stuck);
    }
    if (answer_.valid && !answer_.seen && !FrontierSearch::is_frontier(map.grid, goal_.look)) {
        answer_.seen = true;
        map.survey.look_again();
    }
    const bool due = !answer_.valid || answer_.seen || planned_us_ < 0 || map.t_us - planned_us_ >= kPeriodUs;
    if (budget_cells > 0 && (running_ || due)) {
        ViewRule rule;
        rule.distance_cost = 0.0F;
        rule.tight_cost = 0.0F;
        rule.near_m = kUpToM;
        running_ = !map.survey.run(map, rule, budget_cells);
        if (!running_) { choose(map); }
    }
    if (answer_.valid && !answer_.seen) {
        const float bearing = std::atan2(goal_.y_m - pose.y_m, goal_.x_m - pose.x_m);
        const bool arrived = std::hypot(answer_.x_m - pose.x_m, answer_.y_m - pose.y_m) < kArrivedM && std::fabs(wrap_angle(bearing - pose.yaw_rad)) < kInSightRad;
        if (!arrived) {
            dwell_since_us_ = -1;
        } else if (dwell_since_us_ < 0) {
            dwell_since_us_ = map.t_us;
        } else if (map.t_us - dwell_since_us_ > kDwellUs) {
            ++counters_.in_vain;
            drop(map, false);
        }
    }
    return answer_;
}

}  // namespace noctule
