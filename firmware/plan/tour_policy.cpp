#include "plan/tour_policy.hpp"

#include <algorithm>
#include <cmath>

#include "core/angle.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kPeriodUs = 400000;    ///< between two passes while the goal is good
constexpr float kSameGoalM = 0.5F;
constexpr float kOneStopM = 1.0F;             ///< viewpoints within this that see each other are one stop
constexpr std::int64_t kDwellUs = 300000;     ///< looking this long without news is in vain
constexpr std::int64_t kEmptyUs = 1000000;    ///< passes that long without any goal end the exploration: the vehicle stands and has looked
constexpr float kArrivedM = 0.15F;
constexpr float kThereM = 0.08F;              ///< the same after a look in vain
constexpr float kInSightRad = 2.0F;           ///< off the heading, what the laser is sure to see (270 degrees)
constexpr float kCameraShare = 0.4F;          ///< of its field of view, to either side, what the camera is sure to see
constexpr float kPassedM = 0.45F;             ///< from the middle of a patch to be passed
constexpr float kBetterViewM = 0.3F;

float metres(const MapView& map, const std::uint32_t cost) { return CostField::metres(cost, map.grid.geometry().cell_m()); }

float apart(const Frontier& a, const Frontier& b) { return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m); }

float viewing_distance(const Frontier& f) { return std::hypot(f.view_x_m - f.x_m, f.view_y_m - f.y_m); }

}  // namespace

void TourPolicy::begin(const Pose2<Map, Body>& home) {
    static_cast<void>(home);
    answer_.valid = answer_.finished = answer_.seen = passing_ = false;
    stops_.clear();
    last_tour_.clear();
    phase_ = Phase::survey;
    dwell_since_us_ = -1;
    empty_passes_ = 0;
    left_.clear();
    seen_.clear();
    from_us_ = -1;
    vx_m_s_ = vy_m_s_ = 0.0F;
    counters_ = {};
}

ViewRule TourPolicy::rule() const {
    ViewRule rule;
    rule.distance_cost = p_.view_distance_cost;
    rule.tight_cost = p_.view_tight_m;
    rule.near_m = p_.view_near_m;
    rule.near_small_m = p_.view_near_small_m;
    rule.small_m2 = p_.view_small_m2;
    rule.sight_m = p_.view_sight_m;
    rule.behind_min = p_.reveal_min_cells;
    rule.camera = p_.camera_weight > 0.0F;
    rule.soundings = true;
    rule.fine = empty_passes_ > 0;   // before the end is believed it is looked for closely
    return rule;
}

// True: what the goal was to show has been seen, by the laser, by the camera or by the ranges.
bool TourPolicy::settled(const MapView& map) const {
    if (goal_.sounding) { return map.soundings == nullptr || map.soundings->distance_m(goal_.look) < kPassedM || map.soundings->passed_round(map.grid, goal_.look); }
    return goal_.camera ? map.grid.camera_saw(goal_.look) : !FrontierSearch::is_frontier(map.grid, goal_.look);
}

void TourPolicy::set_goal(const Frontier& front) {
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
    if (phase_ == Phase::ways) { phase_ = Phase::survey; }  // the scratch field goes to the new goal
}

void TourPolicy::resume() {
    answer_.finished = false;
    empty_passes_ = 0;
    passing_ = true;
}

void TourPolicy::drop(const MapView& map, const bool give_up) {
    const float distance_m = viewing_distance(goal_);
    if (give_up) {
        map.survey.tried().give_up(goal_.x_m, goal_.y_m, distance_m, map.t_us);
    } else {
        map.survey.tried().add(goal_.x_m, goal_.y_m, distance_m, map.t_us);
    }
    answer_.valid = false;   // the next pass knows better than the last: it is waited for
}

const PolicyAnswer& TourPolicy::step(const MapView& map, const Pose2<Map, Body>& pose, const std::int32_t budget_cells) {
    if (const auto dt_s = 1e-6F * static_cast<float>(map.t_us - from_us_); from_us_ >= 0 && dt_s > 0.0F) {
        vx_m_s_ += 0.4F * ((map.from.x_m - from_.x_m) / dt_s - vx_m_s_);
        vy_m_s_ += 0.4F * ((map.from.y_m - from_.y_m) / dt_s - vy_m_s_);
    }
    from_ = map.from;
    from_us_ = map.t_us;
    if (answer_.valid && map.fate != GoalFate::under_way) {
        if (map.fate == GoalFate::stuck) { ++counters_.stuck; }
        drop(map, map.fate == GoalFate::stuck);
    }
    if (answer_.valid && !answer_.seen && settled(map)) {
        // What was to be seen is seen. The way on is flown while the map is looked at anew: the last pass does not know what
        // has just come into view, and choosing from it would send the vehicle away and back.
        answer_.seen = true;
        if (phase_ != Phase::survey) { phase_ = Phase::survey; }
        map.survey.look_again();
    }
    if (budget_cells > 0) { think(map, budget_cells); }
    look(map, pose);
    return answer_;
}

void TourPolicy::look(const MapView& map, const Pose2<Map, Body>& pose) {
    if (!answer_.valid || answer_.seen) { return; }
    const float bearing = std::atan2(goal_.y_m - pose.y_m, goal_.x_m - pose.x_m);
    const float near_m = map.survey.tried().tries(goal_.x_m, goal_.y_m) > 0 ? kThereM : kArrivedM;
    const bool arrived = std::hypot(answer_.x_m - pose.x_m, answer_.y_m - pose.y_m) < near_m && std::fabs(wrap_angle(bearing - pose.yaw_rad)) < (goal_.camera ? kCameraShare * p_.camera_fov_rad : kInSightRad);
    if (!arrived) {
        dwell_since_us_ = -1;
    } else if (dwell_since_us_ < 0) {
        dwell_since_us_ = map.t_us;
    } else if (map.t_us - dwell_since_us_ > kDwellUs) {
        ++counters_.in_vain;
        drop(map, false);
    }
}

void TourPolicy::think(const MapView& map, const std::int32_t budget_cells) {
    if (phase_ == Phase::survey) {
        if (answer_.valid && !answer_.seen && map.t_us - passed_us_ < kPeriodUs) { return; }
        if (!map.survey.run(soon(map), rule(), budget_cells)) { return; }
        ++counters_.passes;
        gather_stops(map);
        if (stops_.size() > 2U) {
            graph_.clear(stops_.size());
            map.scratch.start(map.grid, stops_[0].sight, 0, map.survey.open());
            for (std::size_t k = 0; k < stops_.size(); ++k) {
                static_cast<void>(map.scratch.add_root(stops_[k].sight, static_cast<std::uint8_t>(k), graph_, map.survey.open()));
            }
            phase_ = Phase::ways;
        }
    }
    // Each part begins in the step in which the one before it ended: what has just come into view is not waited for.
    if (phase_ == Phase::ways) {
        if (!map.scratch.run(map.grid, map.where, map.survey.open(), budget_cells, kNoCell, 0, &graph_)) { return; }
        graph_.close();
    }
    decide(map);
    passed_us_ = map.t_us;
    phase_ = Phase::survey;
}

// Where the vehicle will be when the answer counts: what lies ahead is nearer than it seems, what lies behind is farther.
MapView TourPolicy::soon(const MapView& map) const {
    Pose2<Map, Body> at = map.from;
    for (float s = p_.plan_ahead_s; s > 0.05F; s *= 0.7F) {
        const float x_m = map.from.x_m + s * vx_m_s_;
        const float y_m = map.from.y_m + s * vy_m_s_;
        if (map.where.passable(map.grid.find(x_m, y_m)) && map.grid.line_is_free(map.from.x_m, map.from.y_m, x_m, y_m)) {
            at.x_m = x_m;
            at.y_m = y_m;
            break;
        }
    }
    return {map.grid, map.where, map.home, at, map.t_us, map.fate, map.survey, map.scratch, map.soundings};
}

// Nearest first; a group whose viewpoint another stop nearly has belongs to that stop.
void TourPolicy::gather_stops(const MapView& map) {
    stops_.clear();
    Bounded<Frontier, kMaxFrontiers> found = map.survey.search().found();
    const bool only_passes = passing_ && std::any_of(found.begin(), found.end(), [](const Frontier& f) { return f.sounding; });
    std::sort(found.begin(), found.end(), [](const Frontier& a, const Frontier& b) { return a.sight_cost != b.sight_cost ? a.sight_cost < b.sight_cost : a.look < b.look; });
    for (const Frontier& f : found) {
        if (only_passes && !f.sounding) { continue; }   // a pocket that flickers must not draw the vehicle across the floor
        const auto same = std::find_if(stops_.begin(), stops_.end(), [&](const Frontier& s) {
            const bool near = !f.sounding && !s.sounding && std::hypot(s.view_x_m - f.view_x_m, s.view_y_m - f.view_y_m) < kOneStopM;
            return s.view == f.view || (near && map.grid.line_is_free(s.view_x_m, s.view_y_m, f.view_x_m, f.view_y_m));
        });
        if (same != stops_.end()) {
            same->cells += f.cells;
            same->behind += f.behind;
        } else if (!stops_.full()) {
            static_cast<void>(stops_.push(f));
        }
    }
    keep_worthwhile(p_, map.grid.known_area_m2(), stops_);
}

void TourPolicy::decide(const MapView& map) {
    const std::size_t n = stops_.size();
    if (answer_.valid && answer_.seen) {
        answer_.valid = false;
        seen_.set(goal_.x_m, goal_.y_m, map.grid.known_area_m2());   // an edge that flickers back into view is no reason to turn round
    }
    if (n == 0U) {
        last_tour_.clear();
        if (answer_.valid && map.survey.costs().cost(answer_.cell) == CostField::kFar) { answer_.valid = false; }
        if (answer_.valid) {
            empty_passes_ = 0;
        } else if (map.where.blocks_waiting() == 0U) {
            if (empty_passes_++ == 0) { empty_since_us_ = map.t_us; }
            answer_.finished = map.t_us - empty_since_us_ >= kEmptyUs;
        }
        return;
    }
    empty_passes_ = 0;
    tour_.begin(n);
    std::uint8_t same = Tour::kAny;   // the stop that the present goal belongs to
    float same_m = kSameGoalM;
    for (std::size_t a = 0; a < n; ++a) {
        tour_.set(0, a + 1U, p_.tour_first_weight * metres(map, stops_[a].sight_cost));
        for (std::size_t b = 0; b < n; ++b) {
            float way_m = 0.0F;
            if (n > 2U) {
                way_m = metres(map, graph_.between(a, b));
            } else if (a != b) {
                way_m = std::hypot(stops_[a].sight_x_m - stops_[b].sight_x_m, stops_[a].sight_y_m - stops_[b].sight_y_m);
            }
            tour_.set(a + 1U, b + 1U, way_m);
        }
        tour_.set_gain(a + 1U, reveals_m2(p_, stops_[a]), leaves_m2(p_, stops_[a]));
        if (answer_.valid && apart(stops_[a], goal_) < same_m) {
            same_m = apart(stops_[a], goal_);
            same = static_cast<std::uint8_t>(a + 1U);
        }
    }
    tour_.weigh(p_.tour_hurry);
    // Warm start: the order of the last tour.
    Tour::Order order;
    std::array<bool, kMaxStops> in{};
    for (const Frontier& f : last_tour_) {
        for (std::size_t a = 0; a < n; ++a) {
            if (in[a + 1U] || apart(stops_[a], f) >= kSameGoalM) { continue; }
            in[a + 1U] = true;
            static_cast<void>(order.push(static_cast<std::uint8_t>(a + 1U)));
            break;
        }
    }
    Tour::Order cold;
    const float warm_m = tour_.improve(order, Tour::kAny);
    if (tour_.improve(cold, Tour::kAny) + 0.05F < warm_m) { order = cold; }
    tour_.set_aside(order, p_.tour_aside_share * map.grid.known_area_m2(), same);
    const float best_m = tour_.improve(order, Tour::kAny);
    if (answer_.valid) {
        if (same == Tour::kAny) {
            if (map.survey.costs().cost(answer_.cell) == CostField::kFar) { answer_.valid = false; }
        } else if (order[0] != same) {
            Tour::Order kept = order;
            const float kept_m = tour_.improve(kept, same);
            const Frontier& other = stops_[order[0] - 1U];
            const float known_m2 = map.grid.known_area_m2();
            if (best_m + p_.goal_switch_m >= kept_m || left_.undone_by(other.x_m, other.y_m, known_m2) || seen_.undone_by(other.x_m, other.y_m, known_m2)) {
                order = kept;
            }
        }
    }
    last_tour_.clear();
    for (const std::uint8_t stop : order) { static_cast<void>(last_tour_.push(stops_[stop - 1U])); }
    for (std::size_t a = 0; a < n; ++a) {
        if (tour_.aside(a + 1U)) { static_cast<void>(last_tour_.push(stops_[a])); }
    }
    if (!answer_.valid) {
        set_goal(last_tour_[0]);
        return;
    }
    if (same == Tour::kAny) { return; }   // not found again in this pass: flown to as it is
    if (order[0] != same) {
        ++counters_.switches;
        left_.set(goal_.x_m, goal_.y_m, map.grid.known_area_m2());
        set_goal(last_tour_[0]);
        return;
    }
    // The same piece of the unknown, seen anew: a better viewpoint is taken only if that saves some way.
    const Frontier& now = stops_[same - 1U];
    const float saved_m = metres(map, map.survey.costs().cost(answer_.cell)) - metres(map, now.cost);
    if (saved_m > kBetterViewM && now.look != goal_.look) { set_goal(now); }
}

}  // namespace noctule
