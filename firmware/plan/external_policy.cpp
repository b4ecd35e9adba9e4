#include "plan/external_policy.hpp"

#include <cmath>

namespace noctule {

namespace {

constexpr float kArrivedM = 0.15F;
constexpr float kSameM = 0.02F;
constexpr float kFarthestM = 10000.0F;   ///< from the origin of Map

// The cell itself where the hull fits, else the nearest such cell.
CellId fitting_near(const MapView& map, const Cell wanted) {
    const auto reach = static_cast<std::int32_t>(map.grid.geometry().to_cells(ExternalPolicy::kSnapM));
    CellId best = kNoCell;
    std::int32_t nearest = reach * reach + 1;
    for (std::int32_t dy = -reach; dy <= reach; ++dy) {
        for (std::int32_t dx = -reach; dx <= reach; ++dx) {
            const std::int32_t d2 = dx * dx + dy * dy;
            const CellId id = d2 < nearest ? map.grid.find(Cell{wanted.ix + dx, wanted.iy + dy}) : kNoCell;
            if (map.where.passable(id)) {
                nearest = d2;
                best = id;
            }
        }
    }
    return best;
}

}  // namespace

void ExternalPolicy::begin(const Pose2<Map, Body>& home) {
    ask_.home = home;
    ++ask_.exploration;
    answer_.valid = answer_.finished = answer_.seen = false;
    known_from_ = ask_.number + 1;
    useful_us_ = heard_us_ = -1;
    refused_in_a_row_ = idle_in_a_row_ = vain_in_a_row_ = 0;
    counters_ = {};
}

Verdict ExternalPolicy::take_goal(const MapView& map) {
    const GoalSample& told = box_;
    for (const float v : {told.x_m, told.y_m, told.look_x_m, told.look_y_m}) {
        if (!(std::fabs(v) < kFarthestM)) { return Verdict::no_number; }
    }
    const Cell wanted = map.grid.geometry().cell(told.x_m, told.y_m);
    switch (map.grid.cell_class(wanted)) {
        case CellClass::unknown:
            return Verdict::nothing_known;
        case CellClass::occupied:
            return Verdict::in_wall;
        case CellClass::free:
            break;
    }
    const CellId cell = fitting_near(map, wanted);
    if (cell == kNoCell) { return Verdict::no_room; }
    float x_m = told.x_m;
    float y_m = told.y_m;
    if (cell != map.grid.find(wanted)) {
        x_m = map.grid.geometry().centre_x_m(map.grid.cell(cell));
        y_m = map.grid.geometry().centre_y_m(map.grid.cell(cell));
    }
    const auto off = [](const float ax, const float ay, const float bx, const float by) { return std::hypot(ax - bx, ay - by) > kSameM; };
    if (!answer_.valid || off(x_m, y_m, answer_.x_m, answer_.y_m) || off(told.look_x_m, told.look_y_m, answer_.look_x_m, answer_.look_y_m)) {
        if (answer_.valid) { ++counters_.switches; }
        answer_.valid = true;
        ++answer_.number;
        answer_.cell = cell;
        answer_.x_m = x_m;
        answer_.y_m = y_m;
        answer_.look_x_m = told.look_x_m;
        answer_.look_y_m = told.look_y_m;
    }
    return Verdict::good;
}

Verdict ExternalPolicy::judge(const MapView& map) {
    if (box_.ask <= answered_ || box_.ask > ask_.number) { return Verdict::wrong_ask; }
    answered_ = box_.ask;
    if (box_.ask < known_from_ && box_.kind != GoalSample::Kind::failed) { return Verdict::good; }   // overtaken: of no use, and no fault
    switch (box_.kind) {
        case GoalSample::Kind::nothing:
            return Verdict::good;
        case GoalSample::Kind::goal:
            return take_goal(map);
        case GoalSample::Kind::finished:
            answer_.finished = true;
            return Verdict::good;
        case GoalSample::Kind::failed:
            return Verdict::failed;
    }
    return Verdict::no_number;
}

const PolicyAnswer& ExternalPolicy::step(const MapView& map, const Pose2<Map, Body>& pose, const std::int32_t budget_cells) {
    if (heard_us_ < 0) { heard_us_ = useful_us_ = map.t_us; }
    const bool arrived = answer_.valid && std::hypot(answer_.x_m - pose.x_m, answer_.y_m - pose.y_m) < kArrivedM;
    if (answer_.valid && map.fate != GoalFate::under_way && !arrived) {   // at the goal it comes no nearer, and that is no fault
        if (map.fate == GoalFate::stuck) { ++counters_.stuck; }
        answer_.valid = false;
        known_from_ = ask_.number + 1;
        ++vain_in_a_row_;
    }
    ask_.refused_now = false;
    if (full_) {
        full_ = false;
        ++counters_.passes;
        const Verdict verdict = judge(map);
        if (verdict == Verdict::good) {
            heard_us_ = map.t_us;
            refused_in_a_row_ = 0;
        } else {
            ask_.refused_now = true;
            ask_.verdict = verdict;
            ++ask_.refused;
            ++refused_in_a_row_;
        }
    }
    if (answer_.valid) {
        if (std::hypot(answer_.x_m - pose.x_m, answer_.y_m - pose.y_m) > kArrivedM) {
            useful_us_ = map.t_us;
            idle_in_a_row_ = 0;
        } else {
            vain_in_a_row_ = 0;
        }
    }
    const std::int64_t since_us = heard_us_ < useful_us_ ? heard_us_ : useful_us_;
    if (static_cast<float>(map.t_us - since_us) > 1e6F * p_.policy_timeout_s) {
        heard_us_ = useful_us_ = map.t_us;
        ++ask_.timeouts;
        ++idle_in_a_row_;
    }
    given_up_ = given_up_ || refused_in_a_row_ >= p_.policy_patience || idle_in_a_row_ >= p_.policy_patience || vain_in_a_row_ >= p_.policy_patience;

    ask_.t_us = map.t_us;
    ++ask_.number;
    ask_.pose = pose;
    ask_.from = map.from;
    ask_.budget_cells = budget_cells;
    ask_.fate = map.fate;
    ask_.goal_valid = answer_.valid;
    ask_.goal_x_m = answer_.x_m;
    ask_.goal_y_m = answer_.y_m;
    return answer_;
}

}  // namespace noctule
