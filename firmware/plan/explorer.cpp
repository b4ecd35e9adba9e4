#include "plan/explorer.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr std::int32_t kBudget = 16000;        ///< cells settled a step: about 1.5 ms
constexpr std::int32_t kSweeps = 2;            ///< of the potential's window a step
constexpr std::uint32_t kBeyond = 30 * CostField::kUnit * 3;   ///< field computed this much farther than the vehicle
constexpr std::int64_t kRefreshUs = 500000;    ///< age from which the field of a fixed place is computed anew
constexpr std::int64_t kStuckUs = 4000000;     ///< without coming nearer to the goal: it is given up
constexpr float kProgressM = 0.2F;
constexpr float kClosedFromM = 0.25F;          ///< part of the path ahead in which the place that holds the vehicle is looked for
constexpr float kClosedToM = 0.9F;
constexpr float kNarrowM = 0.15F;              ///< beside the hull: more room than this holds nobody
constexpr float kArrivedM = 0.15F;
constexpr float kSameGoalM = 0.5F;
constexpr float kNewsM2 = 1.0F;                ///< area that must become known for a change of mind to have a reason
constexpr float kYawSlackRad = 0.35F;          ///< heading is corrected only when off by more
constexpr float kFacingRad = 0.1F;
constexpr float kPassesM = 0.3F;               ///< of the path left: what is near is passed, not stood beside
constexpr float kBesideM = 0.12F;              ///< hull to what is near
constexpr float kHeadingM = 0.3F;              ///< of the path tells where it leads
constexpr float kSidesRad = 0.65F;             ///< off the path, at most: a laser of 270 degrees sees both sides, and a little behind them
constexpr float kLookAheadM = 1.0F;

}  // namespace

Explorer::Explorer(const Parameters& parameters)
    : p_(parameters), where_(parameters), potential_(parameters), survey_(parameters), tour_(parameters), frontier_(parameters), paper_(parameters), external_(parameters) {}

void Explorer::observe(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const std::int64_t t_us) {
    where_.reopen(t_us);
    where_.update(grid, pose.x_m, pose.y_m);
}

Policy& Explorer::chosen() {
    switch (kind_) {
        case PolicyKind::frontier:
            return frontier_;
        case PolicyKind::paper:
            return paper_;
        case PolicyKind::external:
            return external_;
        case PolicyKind::tour:
            break;
    }
    return tour_;
}

void Explorer::choose(const PolicyKind kind) {
    kind_ = kind == PolicyKind::external && external_.given_up() ? PolicyKind::tour : kind;
    survey_.begin();
    policy_ = &chosen();
    policy_->begin(home_);
    goal_ = Goal{};
    field_due_ = field_started_ = false;
}

void Explorer::begin(const Pose2<Map, Body>& home) {
    home_ = home;
    fate_ = GoalFate::under_way;
    fields_[0].clear();
    fields_[1].clear();
    potential_.restart();
    choose(static_cast<PolicyKind>(p_.policy));
    has_way_ = blocked_ = detour_ = false;
    where_.reopen_all();
    left_ = Past{};
    goals_ = back_and_forth_ = 0;
}

void Explorer::sweep() {
    if (policy_ == &tour_) {
        tour_.resume();
        goal_.answer.finished = false;
        return;
    }
    survey_.begin();
    policy_ = &tour_;
    tour_.begin(home_);
    tour_.resume();
}

void Explorer::begin_field(const OccupancyGrid& grid) {
    const CellId root = goal_.to_place ? root_near(grid, where_, goal_.x_m, goal_.y_m) : goal_.answer.cell;
    fields_[1 - flown_].start(grid, root, lead_on_cells(grid, where_, root), open_);
    field_started_ = true;
}

bool Explorer::run_field(const OccupancyGrid& grid, const Pose2<Map, Body>& from, const std::int64_t t_us) {
    if (!field_started_) { begin_field(grid); }
    const CellId here = root_near(grid, where_, from.x_m, from.y_m);
    if (!fields_[1 - flown_].run(grid, where_, open_, kBudget, here, kBeyond)) { return false; }
    flown_ = 1 - flown_;
    potential_.restart();
    field_us_ = t_us;
    field_due_ = field_started_ = false;
    has_way_ = fields_[flown_].cost(here) != CostField::kFar;
    return true;
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
    progress_us_ = -1;
    return true;
}

// Before the goal is blamed the place is: guard and planner may differ by a centimetre about a gap, and every goal beyond it would be given up in turn.
bool Explorer::close_ahead(const Target& target, const std::int64_t t_us) {
    const std::int64_t until_us = t_us + static_cast<std::int64_t>(1e6F * p_.blacklist_s);
    const PathPoint* const cut = potential_.cut();
    if (cut != nullptr && !target.path.empty() && std::hypot(cut->x_m - target.path[0].x_m, cut->y_m - target.path[0].y_m) < kClosedToM) {
        where_.close(cut->x_m, cut->y_m, until_us);   // the line ends before it: no point of it tells
        return true;
    }
    float gone_m = 0.0F;
    std::size_t tightest = 0;
    for (std::size_t k = 1; k < target.path.size() && gone_m < kClosedToM; ++k) {
        gone_m += std::hypot(target.path[k].x_m - target.path[k - 1U].x_m, target.path[k].y_m - target.path[k - 1U].y_m);
        if (gone_m < kClosedFromM) { continue; }
        if (tightest == 0U || target.path[k].clearance_m < target.path[tightest].clearance_m) { tightest = k; }
    }
    if (tightest == 0U || target.path[tightest].clearance_m > p_.hull_radius_m + kNarrowM) { return false; }
    where_.close(target.path[tightest].x_m, target.path[tightest].y_m, until_us);
    return true;
}

// A new answer: what was left behind is remembered, the way to the new goal is due.
void Explorer::take(const OccupancyGrid& grid, const PolicyAnswer& answer) {
    const bool moved = !goal_.valid || std::hypot(answer.look_x_m - goal_.answer.look_x_m, answer.look_y_m - goal_.answer.look_y_m) > kSameGoalM;
    if (goal_.valid && moved && answer.path == nullptr) {
        const float known_m2 = grid.known_area_m2();
        const Past& before = left_;
        // Seen, its cell may flicker back; looked at in vain, it is known that nothing shows from there: neither is a change of mind.
        const bool open = FrontierSearch::is_frontier(grid, grid.find(goal_.answer.look_x_m, goal_.answer.look_y_m)) && fate_ == GoalFate::under_way &&
                          !goal_.answer.seen && survey_.tried().tries(goal_.answer.look_x_m, goal_.answer.look_y_m) == goal_.tries;
        // Back to the goal left last, from one that is still open as well, with nothing learned in between.
        if (before.known_m2 >= 0.0F && before.open && open && known_m2 - before.known_m2 < kNewsM2 &&
            std::hypot(answer.look_x_m - before.x_m, answer.look_y_m - before.y_m) < kSameGoalM) {
            ++back_and_forth_;
        }
        left_ = {goal_.answer.look_x_m, goal_.answer.look_y_m, known_m2, open};
    }
    ++goals_;
    goal_.valid = true;
    goal_.to_place = false;
    goal_.tries = survey_.tried().tries(answer.look_x_m, answer.look_y_m);
    goal_.x_m = answer.x_m;
    goal_.y_m = answer.y_m;
    field_due_ = answer.path == nullptr;
    field_started_ = false;
    progress_us_ = -1;
    detour_ = false;
    fate_ = GoalFate::under_way;
}

void Explorer::explore(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, const std::int64_t t_us, Target& target,
                       const Soundings* const soundings) {
    if (goal_.to_place) { goal_ = Goal{}; }
    if (policy_ == nullptr) { begin(home_); }
    if (policy_ == &external_ && external_.given_up()) { choose(PolicyKind::tour); }
    const bool busy = field_due_;
    if (busy) { find_way(grid, from, t_us); }
    if (goal_.valid && !field_due_ && goal_.answer.path == nullptr && fate_ == GoalFate::under_way && stuck(grid, pose, t_us)) {
        detour_ = close_ahead(target, t_us);
        field_due_ = detour_;
        field_started_ = false;
        if (!detour_) { fate_ = GoalFate::stuck; }
    }
    const MapView view{grid, where_, home_, from, t_us, fate_, survey_, fields_[1 - flown_], soundings};
    const PolicyAnswer& answer = policy_->step(view, pose, busy ? 0 : kBudget);
    if (answer.valid && (!goal_.valid || answer.number != goal_.answer.number)) { take(grid, answer); }
    if (!answer.valid) { goal_.valid = false; }
    if (!answer.valid || fate_ != GoalFate::under_way) { fate_ = GoalFate::under_way; }
    goal_.answer = answer;
    if (!busy && field_due_) { find_way(grid, from, t_us); }
    follow(grid, pose, from, target);
}

// One slice of the field of the goal, and what came of it.
void Explorer::find_way(const OccupancyGrid& grid, const Pose2<Map, Body>& from, const std::int64_t t_us) {
    if (!run_field(grid, from, t_us)) { return; }
    progress_us_ = -1;   // what is left of the way is counted by the new field
    if (!has_way_) {
        fate_ = detour_ ? GoalFate::stuck : GoalFate::unreachable;
        if (detour_) { where_.reopen_last(); }   // the only way there is
    }
    detour_ = false;
}

void Explorer::go_to(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, const float x_m, const float y_m,
                     const std::int64_t t_us, Target& target) {
    if (!goal_.valid || !goal_.to_place || goal_.x_m != x_m || goal_.y_m != y_m) {
        goal_ = Goal{};
        goal_.valid = true;
        goal_.to_place = true;
        goal_.x_m = x_m;
        goal_.y_m = y_m;
        field_due_ = true;
        field_started_ = false;
        has_way_ = false;
        progress_us_ = -1;
        blocked_ = false;
        fields_[flown_].clear();
    }
    if (has_way_ && std::hypot(x_m - pose.x_m, y_m - pose.y_m) > kArrivedM && stuck(grid, pose, t_us)) {
        blocked_ = where_.at_last_resort();
        where_.last_resort();
    }
    if (field_started_ || !has_way_ || t_us - field_us_ > kRefreshUs) {
        if (run_field(grid, from, t_us) && !has_way_) { where_.last_resort(); }
    }
    follow(grid, pose, from, target);
}

void Explorer::follow(const OccupancyGrid& grid, const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, Target& target) {
    target.path.clear();
    const CostField& field = fields_[flown_];
    if (goal_.valid && goal_.answer.path != nullptr) {
        target.path = *goal_.answer.path;
    } else if (goal_.valid && field.valid()) {
        potential_.relax(grid, where_, field, from.x_m, from.y_m, kSweeps);
        // While the field of a new goal is computed the old one is flown on: both lead through known free space.
        float end_x_m = goal_.x_m;
        float end_y_m = goal_.y_m;
        const Cell root = grid.cell(field.root());
        if (std::hypot(grid.geometry().centre_x_m(root) - end_x_m, grid.geometry().centre_y_m(root) - end_y_m) > kSameGoalM) {
            end_x_m = grid.geometry().centre_x_m(root);
            end_y_m = grid.geometry().centre_y_m(root);
        }
        if (goal_.to_place) { where_.make_room(grid, end_x_m, end_y_m); }
        static_cast<void>(potential_.trace(grid, where_, field, from.x_m, from.y_m, end_x_m, end_y_m, target.path));
    }
    if (target.path.empty()) {
        static_cast<void>(target.path.push({from.x_m, from.y_m, grid.clearance_m(from.x_m, from.y_m, 0.8F)}));
    }
    look(pose, from, target);
}

// Yaw is free: near the goal towards what it is to show, on the way along the path, and turned only when off by more than a little.
void Explorer::look(const Pose2<Map, Body>& pose, const Pose2<Map, Body>& from, Target& target) const {
    float wanted = target.yaw_rad;
    const PathPoint& end = target.path.back();
    const float left_m = std::hypot(end.x_m - pose.x_m, end.y_m - pose.y_m);
    if (goal_.valid && !goal_.to_place && goal_.answer.path == nullptr && std::hypot(goal_.x_m - pose.x_m, goal_.y_m - pose.y_m) < kLookAheadM) {
        wanted = std::atan2(goal_.answer.look_y_m - pose.y_m, goal_.answer.look_x_m - pose.x_m);
        if (std::fabs(wrap_angle(wanted - target.yaw_rad)) > kFacingRad) { target.yaw_rad = wanted; }
    } else if (left_m > 0.3F) {
        float along_m = 0.0F;
        std::size_t k = 1;
        for (; k + 1U < target.path.size() && along_m < kLookAheadM; ++k) {
            along_m += std::hypot(target.path[k].x_m - target.path[k - 1U].x_m, target.path[k].y_m - target.path[k - 1U].y_m);
        }
        if (k < target.path.size()) { wanted = std::atan2(target.path[k].y_m - from.y_m, target.path[k].x_m - from.x_m); }
        if (std::fabs(wrap_angle(wanted - target.yaw_rad)) > kYawSlackRad) { target.yaw_rad = wanted; }
    }
    if (left_m > kPassesM) { see_sides(from, target); }
}

// Past what is near the laser must see both sides: what it saw from afar or from the other side only may reach centimetres farther.
void Explorer::see_sides(const Pose2<Map, Body>& from, Target& target) const {
    float gone_m = 0.0F;
    float least_m = target.path[0].clearance_m;
    float heading_rad = target.yaw_rad;
    for (std::size_t k = 1; k < target.path.size() && gone_m < kLookAheadM; ++k) {
        const PathPoint& p = target.path[k];
        if (gone_m < kHeadingM) { heading_rad = std::atan2(p.y_m - from.y_m, p.x_m - from.x_m); }
        gone_m += std::hypot(p.x_m - target.path[k - 1U].x_m, p.y_m - target.path[k - 1U].y_m);
        least_m = std::min(least_m, p.clearance_m);
    }
    if (least_m > p_.hull_radius_m + kBesideM) { return; }
    const float off_rad = wrap_angle(target.yaw_rad - heading_rad);
    if (std::fabs(off_rad) > kSidesRad) { target.yaw_rad = wrap_angle(heading_rad + std::copysign(kSidesRad, off_rad)); }
}

}  // namespace noctule
