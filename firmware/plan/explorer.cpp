#include "plan/explorer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace noctule {

namespace {

constexpr std::int32_t kCostBudget = 16000;    ///< cells settled a step: about 1.5 ms
constexpr std::int32_t kFieldBudget = 16000;
constexpr std::int32_t kSweeps = 2;            ///< of the potential's window a step
constexpr std::int32_t kRootRadius = 5;        ///< cells round start and goal where tight cells lead on
constexpr std::uint32_t kBeyond = 30 * CostField::kUnit * 3;   ///< field computed this much farther than the vehicle
constexpr std::int64_t kRefreshUs = 500000;    ///< age from which the field of a fixed place is computed anew
constexpr std::int64_t kDwellUs = 300000;      ///< looking this long without news is in vain
constexpr std::int64_t kStuckUs = 8000000;     ///< without coming nearer to the goal: it is given up
constexpr float kProgressM = 0.2F;
constexpr float kArrivedM = 0.15F;
constexpr float kInSightRad = 2.0F;            ///< off the heading, what the laser is sure to see (270 degrees)
constexpr float kFacingRad = 0.2F;
constexpr float kSameGoalM = 0.5F;
constexpr float kYawSlackRad = 0.35F;          ///< heading is corrected only when off by more
constexpr float kLookAheadM = 1.0F;
constexpr float kSmallBonusM = 0.05F;          ///< way that one cell of edge is worth, up to kBonusCells
constexpr std::int32_t kBonusCells = 15;

/// The cell of a point, or the nearest free one within half a metre.
CellId root_near(const OccupancyGrid& grid, const Traversability& where, const float x_m, const float y_m) {
    const Cell here = grid.geometry().cell(x_m, y_m);
    const auto reach = static_cast<std::int32_t>(grid.geometry().to_cells(0.5F));
    CellId best = kNoCell;
    float nearest = std::numeric_limits<float>::infinity();
    for (std::int32_t dy = -reach; dy <= reach; ++dy) {
        for (std::int32_t dx = -reach; dx <= reach; ++dx) {
            const CellId id = grid.find(Cell{here.ix + dx, here.iy + dy});
            const auto d2 = static_cast<float>(dx * dx + dy * dy);
            if (d2 < nearest && where.clearance_cm(id) > 0) {
                nearest = d2;
                best = id;
            }
        }
    }
    return best;
}

}  // namespace

Explorer::Explorer(const Parameters& parameters)
    : p_(parameters), where_(parameters), potential_(parameters), search_(parameters), tried_(parameters) {}

void Explorer::observe(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const std::int64_t t_us) {
    static_cast<void>(t_us);
    where_.update(grid, pose.x_m, pose.y_m);
}

void Explorer::begin(const Pose2<Map, Body>& home) {
    home_ = home;
    goal_ = Goal{};
    tried_.clear();
    known_.clear();
    fields_[0].clear();
    fields_[1].clear();
    from_vehicle_.clear();
    potential_.restart();
    phase_ = Phase::costs;
    phase_started_ = false;
    has_way_ = false;
    empty_passes_ = 0;
    dwell_since_us_ = -1;
}

float Explorer::value_of(const Frontier& f) const {
    const float way_m = static_cast<float>(f.cost) / static_cast<float>(CostField::kUnit) * p_.grid_cell_m;
    return way_m - kSmallBonusM * static_cast<float>(std::min(f.cells, kBonusCells));
}

bool Explorer::resolved(const OccupancyGrid& grid) const {
    return !goal_.to_place && !FrontierSearch::is_frontier(grid, goal_.frontier.look);
}

void Explorer::set_goal(const Frontier& frontier) {
    goal_.valid = true;
    goal_.to_place = false;
    goal_.seen = false;
    goal_.frontier = frontier;
    goal_.x_m = frontier.view_x_m;
    goal_.y_m = frontier.view_y_m;
    goal_.cost = frontier.cost;
    phase_ = Phase::field;   // the way there first; the pass under way starts again after it
    phase_started_ = false;
    dwell_since_us_ = -1;
    progress_us_ = -1;
    ++counters_.goals;
}

// The best of the last pass that is still unknown.
bool Explorer::take_next(const OccupancyGrid& grid, const std::int64_t t_us) {
    const Frontier* best = nullptr;
    for (const Frontier& f : known_) {
        if (!FrontierSearch::is_frontier(grid, f.look) || !where_.passable(f.view)) { continue; }
        const float distance_m = std::hypot(f.x_m - f.view_x_m, f.y_m - f.view_y_m);
        if (tried_.distance_allowed_m(f.x_m, f.y_m, t_us) < distance_m - 1e-3F) { continue; }
        if (best == nullptr || value_of(f) < value_of(*best)) { best = &f; }
    }
    if (best == nullptr) { return false; }
    set_goal(*best);
    return true;
}

void Explorer::choose(const OccupancyGrid& grid, const std::int64_t t_us) {
    ++counters_.passes;
    known_ = search_.found();
    const Frontier* best = nullptr;
    const Frontier* same = nullptr;
    for (const Frontier& f : known_) {
        if (best == nullptr || value_of(f) < value_of(*best)) { best = &f; }
        if (goal_.valid && std::hypot(f.x_m - goal_.frontier.x_m, f.y_m - goal_.frontier.y_m) < kSameGoalM &&
            (same == nullptr || value_of(f) < value_of(*same))) {
            same = &f;
        }
    }
    if (goal_.valid) {
        if (goal_.seen || resolved(grid)) {
            goal_.valid = false;
        } else if (same != nullptr) {
            // The same piece of the unknown, seen anew: take a better viewpoint only if that saves some way.
            const std::uint32_t now = from_vehicle_.cost(goal_.frontier.view);
            const float saved_m = now == CostField::kFar ? 1e3F
                                                         : (static_cast<float>(now) - static_cast<float>(same->cost)) /
                                                               static_cast<float>(CostField::kUnit) * p_.grid_cell_m;
            if (best != same && value_of(*best) + p_.goal_switch_m < value_of(*same)) {
                ++counters_.switches;
                set_goal(*best);
                empty_passes_ = 0;
                return;
            }
            if (saved_m > 0.3F && same->look != goal_.frontier.look) {
                set_goal(*same);
                empty_passes_ = 0;
                return;
            }
            goal_.cost = now;
        } else if (from_vehicle_.cost(goal_.frontier.view) == CostField::kFar) {
            goal_.valid = false;   // no longer reachable
        }
    }
    if (goal_.valid || take_next(grid, t_us)) {
        empty_passes_ = 0;
    } else if (where_.blocks_waiting() == 0U) {
        ++empty_passes_;
    }
}

void Explorer::begin_costs(const OccupancyGrid& grid, const Pose2<Map, Body>& from) {
    from_vehicle_.start(grid, root_near(grid, where_, from.x_m, from.y_m), kRootRadius, open_);
    phase_started_ = true;
}

void Explorer::begin_field(const OccupancyGrid& grid) {
    const CellId root = goal_.to_place ? root_near(grid, where_, goal_.x_m, goal_.y_m) : goal_.frontier.view;
    fields_[1 - flown_].start(grid, root, kRootRadius, open_);
    phase_started_ = true;
}

void Explorer::work(const OccupancyGrid& grid, const Pose2<Map, Body>& from, const std::int64_t t_us, const bool exploring) {
    switch (phase_) {
        case Phase::costs:
            if (!phase_started_) { begin_costs(grid, from); }
            if (from_vehicle_.run(grid, where_, open_, kCostBudget, kNoCell, 0)) {
                phase_ = Phase::frontiers;
                search_.start();
            }
            break;
        case Phase::frontiers:
            if (search_.run(grid, where_, from_vehicle_, tried_, home_.x_m, home_.y_m, t_us)) {
                phase_ = goal_.valid ? Phase::field : Phase::costs;
                phase_started_ = false;
                choose(grid, t_us);
            }
            break;
        case Phase::field:
            if (!goal_.valid) {
                phase_ = Phase::costs;
                phase_started_ = false;
                break;
            }
            if (!phase_started_) { begin_field(grid); }
            if (fields_[1 - flown_].run(grid, where_, open_, kFieldBudget, root_near(grid, where_, from.x_m, from.y_m), kBeyond)) {
                flown_ = 1 - flown_;
                potential_.restart();
                pass_us_ = t_us;
                phase_started_ = false;
                phase_ = exploring ? Phase::costs : Phase::field;
                has_way_ = fields_[flown_].cost(root_near(grid, where_, from.x_m, from.y_m)) != CostField::kFar;
                if (!has_way_ && exploring) {
                    tried_.add(goal_.frontier.x_m, goal_.frontier.y_m, std::hypot(goal_.x_m - goal_.frontier.x_m, goal_.y_m - goal_.frontier.y_m), t_us);
                    goal_.valid = false;
                }
            }
            break;
    }
}

// Whatever holds the vehicle back (a path cut short, the guard, a vehicle that does not follow), it does not hang on for ever.
bool Explorer::stuck(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const std::int64_t t_us) {
    const std::uint32_t cost = fields_[flown_].cost(root_near(grid, where_, pose.x_m, pose.y_m));
    const auto step = static_cast<std::uint32_t>(kProgressM / p_.grid_cell_m) * CostField::kUnit;
    if (progress_us_ < 0) {
        progress_us_ = t_us;
        least_cost_ = cost;
    } else if (cost != CostField::kFar && cost + step < least_cost_) {
        progress_us_ = t_us;
        least_cost_ = cost;
        blocked_ = false;
    }
    if (t_us - progress_us_ < kStuckUs) { return false; }
    ++counters_.stuck;
    progress_us_ = -1;
    return true;
}

void Explorer::explore(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, const std::int64_t t_us, Target& target) {
    if (goal_.valid && goal_.to_place) { goal_.valid = false; }
    if (goal_.valid && !goal_.seen && resolved(grid)) {
        // What was to be seen is seen. The way on is flown while the edge of the unknown is looked for anew: what the last pass
        // found does not know what has just come into view, and choosing from it would send the vehicle away and back.
        goal_.seen = true;
        if (phase_ == Phase::frontiers) { search_.start(); }
        if (phase_ == Phase::field) {
            phase_ = Phase::costs;
            phase_started_ = false;
        }
    }
    work(grid, from, t_us, true);
    if (goal_.valid && !goal_.seen) {
        const float bearing = std::atan2(goal_.frontier.y_m - pose.y_m, goal_.frontier.x_m - pose.x_m);
        const bool arrived = std::hypot(goal_.x_m - pose.x_m, goal_.y_m - pose.y_m) < kArrivedM && std::fabs(wrap_angle(bearing - pose.yaw_rad)) < kInSightRad;
        if (!arrived) {
            dwell_since_us_ = -1;
        } else if (dwell_since_us_ < 0) {
            dwell_since_us_ = t_us;
        } else if (t_us - dwell_since_us_ > kDwellUs) {
            ++counters_.in_vain;
            tried_.add(goal_.frontier.x_m, goal_.frontier.y_m, std::hypot(goal_.x_m - goal_.frontier.x_m, goal_.y_m - goal_.frontier.y_m), t_us);
            goal_.valid = false;
            static_cast<void>(take_next(grid, t_us));
        }
    }
    if (goal_.valid && stuck(grid, pose, t_us)) {
        tried_.give_up(goal_.frontier.x_m, goal_.frontier.y_m, std::hypot(goal_.x_m - goal_.frontier.x_m, goal_.y_m - goal_.frontier.y_m), t_us);
        goal_.valid = false;
        static_cast<void>(take_next(grid, t_us));
    }
    follow(grid, pose, from, target);
}

void Explorer::go_to(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, const float x_m, const float y_m,
                     const std::int64_t t_us, Target& target) {
    if (!goal_.valid || !goal_.to_place || goal_.x_m != x_m || goal_.y_m != y_m) {
        goal_ = Goal{};
        goal_.valid = true;
        goal_.to_place = true;
        goal_.x_m = x_m;
        goal_.y_m = y_m;
        phase_ = Phase::field;
        phase_started_ = false;
        has_way_ = false;
        progress_us_ = -1;
        blocked_ = false;
        fields_[flown_].clear();
    }
    if (has_way_ && std::hypot(x_m - pose.x_m, y_m - pose.y_m) > kArrivedM && stuck(grid, pose, t_us)) { blocked_ = true; }
    if (phase_started_ || !has_way_ || t_us - pass_us_ > kRefreshUs) { work(grid, from, t_us, false); }
    follow(grid, pose, from, target);
}

void Explorer::follow(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, Target& target) {
    target.path.clear();
    const CostField& field = fields_[flown_];
    if (goal_.valid && field.valid()) {
        potential_.relax(grid, where_, field, from.x_m, from.y_m, kSweeps);
        // While the field of a new goal is computed the old one is flown on: both lead through known free space.
        float end_x_m = goal_.x_m;
        float end_y_m = goal_.y_m;
        const Cell root = grid.cell(field.root());
        if (std::hypot(grid.geometry().centre_x_m(root) - end_x_m, grid.geometry().centre_y_m(root) - end_y_m) > kSameGoalM) {
            end_x_m = grid.geometry().centre_x_m(root);
            end_y_m = grid.geometry().centre_y_m(root);
        }
        static_cast<void>(potential_.trace(grid, where_, field, from.x_m, from.y_m, end_x_m, end_y_m, target.path));
    }
    if (target.path.empty()) {
        static_cast<void>(target.path.push({from.x_m, from.y_m, grid.clearance_m(from.x_m, from.y_m, 0.8F)}));
    }
    float wanted = target.yaw_rad;
    const PathPoint& end = target.path.back();
    const float left_m = std::hypot(end.x_m - pose.x_m, end.y_m - pose.y_m);
    if (goal_.valid && !goal_.to_place && std::hypot(goal_.x_m - pose.x_m, goal_.y_m - pose.y_m) < kLookAheadM) {
        wanted = std::atan2(goal_.frontier.y_m - pose.y_m, goal_.frontier.x_m - pose.x_m);
        if (std::fabs(wrap_angle(wanted - target.yaw_rad)) > 0.5F * kFacingRad) { target.yaw_rad = wanted; }
    } else if (left_m > 0.3F) {
        float along_m = 0.0F;
        std::size_t k = 1;
        for (; k + 1U < target.path.size() && along_m < kLookAheadM; ++k) {
            along_m += std::hypot(target.path[k].x_m - target.path[k - 1U].x_m, target.path[k].y_m - target.path[k - 1U].y_m);
        }
        if (k < target.path.size()) { wanted = std::atan2(target.path[k].y_m - from.y_m, target.path[k].x_m - from.x_m); }
        if (std::fabs(wrap_angle(wanted - target.yaw_rad)) > kYawSlackRad) { target.yaw_rad = wanted; }
    }
}

}  // namespace noctule
