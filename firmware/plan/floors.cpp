#include "plan/floors.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr float kVerticalCellM = 0.10F;
constexpr float kTiltMostRad = 0.15F;         ///< a range taken at more tilt says nothing of a place
constexpr float kCeilingOverM = 1.5F;          ///< a ceiling beside an opening lies about this far over the vehicle
constexpr float kStallS = 3.0F;               ///< without coming nearer to the height wanted: back
constexpr float kStallM = 0.05F;
constexpr float kBelowSlabM = 0.12F;          ///< the laser is in the shaft from here under the slab
constexpr float kAboveSlabM = 0.15F;          ///< to here over it
constexpr float kSlabM = 0.25F;               ///< thickness of a slab of which one side is known
constexpr float kFloorOverEdgeM = 1.0F;       ///< a floor lies at most this much over the underside that was seen beside the opening
constexpr float kStairwellM = 3.5F;           ///< from the middle of an opening to the ends of its stairs
constexpr float kSameFloorM = 0.5F;
constexpr float kStepsM = 1.2F;               ///< steps within a storey stay under this
constexpr float kArrivedM = 0.10F;
constexpr float kSlowM_S = 0.15F;
constexpr float kStoodS = 0.4F;
constexpr float kShiftTimeS = 30.0F;
constexpr float kNoWayS = 5.0F;
constexpr float kLookTimeS = 12.0F;           ///< for one look
constexpr float kLookedS = 0.75F;             ///< over there so long: what can be seen from there was seen
constexpr float kLookAgainS = 0.25F;
constexpr float kFindAgainS = 0.5F;
constexpr std::int32_t kConfirmVotes = 20;

}  // namespace

FloorPlanner::FloorPlanner(const Parameters& parameters) : p_(parameters), vertical_(kVerticalCellM), judge_(parameters) {
    Floor start_floor;
    start_floor.confirmed = true;
    static_cast<void>(floors_.push(start_floor));
}

float FloorPlanner::floor_z_m(const AltitudeEstimate& altitude) const {
    const Floor& floor = floors_[static_cast<std::size_t>(current_)];
    const float most_m = current_ == 0 ? kStepsM : kSameFloorM;
    return floor.confirmed && std::fabs(altitude.floor_z_m - floor.elevation_m) < most_m ? altitude.floor_z_m : floor.elevation_m;
}

bool FloorPlanner::by_passage(const float x_m, const float y_m) const {
    return std::any_of(passages_.begin(), passages_.end(), [&](const Passage& p) {
        return (p.low == current_ || p.high == current_) && std::hypot(p.x_m - x_m, p.y_m - y_m) < kStairwellM;
    });
}

std::int32_t FloorPlanner::name_of(const std::int32_t layer) const {
    if (layer < 0 || layer >= static_cast<std::int32_t>(floors_.size()) || floors_[static_cast<std::size_t>(layer)].empty) { return -1; }
    std::int32_t name = 0;
    for (std::int32_t i = 0; i < layer; ++i) { name += floors_[static_cast<std::size_t>(i)].empty ? 0 : 1; }
    return name;
}

std::uint32_t FloorPlanner::confirmed_bits() const {
    std::uint32_t bits = 0;
    for (std::size_t i = 0; i < floors_.size(); ++i) { bits |= floors_[i].confirmed ? 1U << i : 0U; }
    return bits;
}

// ---------------------------------------------------------------- what the ranges see

void FloorPlanner::see(const RangeSample& sample, const VerticalSide side, const Estimate& estimate) {
    if (!(sample.range_m > sample.range_min_m && sample.range_m < sample.range_max_m)) { return; }
    const float sign = side == VerticalSide::over ? 1.0F : -1.0F;
    const float along_m = sign * sample.range_m + (side == VerticalSide::over ? p_.range_up_z_m : p_.range_down_z_m);
    const float cr = std::cos(estimate.roll_rad);
    const float sr = std::sin(estimate.roll_rad);
    const float cp = std::cos(estimate.pitch_rad);
    const float sp = std::sin(estimate.pitch_rad);
    if (!(std::acos(std::clamp(cr * cp, -1.0F, 1.0F)) < kTiltMostRad)) { return; }
    // What lies beyond an opening is noted where the beam went through the opening, not where it ended: at 6 degrees of tilt a ceiling
    // 4 m up is met 0.4 m aside.
    const float place_m = sign * std::min(std::fabs(along_m), side == VerticalSide::over ? kCeilingOverM : p_.cruise_height_m);
    const Point2<Map> place = estimate.planar.pose_map_body * Point2<Body>{place_m * cr * sp, -place_m * sr};
    vertical_.add(static_cast<std::int8_t>(current_), side, place.x_m, place.y_m, estimate.altitude.z_m + along_m * cr * cp);
}

// In a shaft the height tells the layer: below the slab, in it, above it.
void FloorPlanner::follow_layer(const float z_m) {
    if (doing_ != Doing::shifting) {
        layer_ = current_;
        return;
    }
    const Passage& passage = passages_[static_cast<std::size_t>(passage_)];
    if (z_m < passage.slab_low_m - kBelowSlabM) {
        layer_ = current_ = passage.low;
    } else if (z_m > passage.slab_high_m + kAboveSlabM) {
        layer_ = current_ = passage.high;
    } else {
        layer_ = kShaft;
    }
}

// A floor is one when its ground has been seen: from below, over the underside beside the opening; from above, where it was expected.
void FloorPlanner::confirm(const AltitudeEstimate& altitude) {
    Floor& floor = floors_[static_cast<std::size_t>(current_)];
    if (floor.confirmed) {
        if (current_ != 0 && std::fabs(altitude.floor_z_m - floor.elevation_m) < kSameFloorM) { floor.elevation_m = altitude.floor_z_m; }
        return;
    }
    const Passage& entry = passages_[static_cast<std::size_t>(floor.entry)];
    const bool from_below = entry.high == current_;
    const auto fits = [&](const float z_m) {
        return from_below ? z_m > entry.slab_low_m + 0.02F && z_m < entry.slab_low_m + kFloorOverEdgeM : std::fabs(z_m - floor.elevation_m) < kSameFloorM;
    };
    if (!std::isfinite(altitude.ground_z_m) || !fits(altitude.ground_z_m)) { return; }
    const float mean_m = ground_votes_ > 0 ? ground_sum_m_ / static_cast<float>(ground_votes_) : altitude.ground_z_m;
    if (std::fabs(mean_m - altitude.ground_z_m) > 0.1F) { ground_votes_ = 0; }
    if (ground_votes_ == 0) { ground_sum_m_ = 0.0F; }
    ++ground_votes_;
    ground_sum_m_ += altitude.ground_z_m;
    if (ground_votes_ < kConfirmVotes && !fits(altitude.floor_z_m)) { return; }
    floor.confirmed = true;
    floor.elevation_m = fits(altitude.floor_z_m) ? altitude.floor_z_m : ground_sum_m_ / static_cast<float>(ground_votes_);
}

void FloorPlanner::observe(const Estimate& estimate, const SensorFrame& frame, const LevelScan& scan, const OccupancyGrid& grid) {
    over_stairs_ = false;
    nearest_side_m_ = 1e9F;
    for (const ScanPoint& p : scan.points) {
        if (p.hit) { nearest_side_m_ = std::min(nearest_side_m_, std::hypot(p.x_m, p.y_m)); }
    }
    if (!estimate.altitude.valid) { return; }
    follow_layer(estimate.altitude.z_m);
    const bool flying = estimate.altitude.z_m - floor_z_m(estimate.altitude) > 0.5F * p_.cruise_height_m;
    if (estimate.planar.quality < 0 || doing_ == Doing::shifting || !flying) { return; }
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    if (std::isfinite(estimate.altitude.ground_z_m)) {
        over_stairs_ = stairs_.note(current_, pose.x_m, pose.y_m, estimate.altitude.ground_z_m - floor_z_m(estimate.altitude));
    }
    if (p_.floors_max <= 1) { return; }   // stairs are in the way of a vehicle that stays on its floor, too
    for (const RangeSample& sample : frame.range_up) { see(sample, VerticalSide::over, estimate); }
    for (const RangeSample& sample : frame.range_down) { see(sample, VerticalSide::under, estimate); }
    soundings_.pass(grid, pose.x_m, pose.y_m);
    confirm(estimate.altitude);
}

// ---------------------------------------------------------------- decisions

void FloorPlanner::start(const Doing doing) {
    doing_ = doing;
    since_us_ = t_us_;
    stood_us_ = looked_us_ = way_us_ = there_us_ = -1;
}

void FloorPlanner::leave_by(const std::int8_t passage) {
    passage_ = passage;
    const Passage& p = passages_[static_cast<std::size_t>(passage)];
    to_ = p.low == current_ ? p.high : p.low;
    goal_x_m_ = p.x_m;
    goal_y_m_ = p.y_m;
    start(Doing::centring);
}

void FloorPlanner::refuse(const Refusal why) {
    if (judged_.full()) { judged_.drop_front(1); }
    static_cast<void>(judged_.push({static_cast<std::int8_t>(current_), seed_.x_m, seed_.y_m, seed_.up, why, seed_.seen_x_m, seed_.seen_y_m}));
    doing_ = Doing::idle;
}

void FloorPlanner::decide(const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& pose) {
    Floor& floor = floors_[static_cast<std::size_t>(current_)];
    if (!floor.confirmed) {   // all was looked at, and there is nothing to stand over: the opening leads to no floor
        floor.empty = true;
        const Passage& entry = passages_[static_cast<std::size_t>(floor.entry)];
        if (judged_.full()) { judged_.drop_front(1); }
        static_cast<void>(judged_.push({floor.parent, entry.x_m, entry.y_m, entry.high == current_, Refusal::no_floor_behind, floor.seen_x_m, floor.seen_y_m}));
        leave_by(floor.entry);
        return;
    }
    seed_ = find_opening(grid, pose);
    if (seed_.valid) {
        judge_.clear();
        start(Doing::surveying);
        goal_x_m_ = seed_.x_m;
        goal_y_m_ = seed_.y_m;
    } else if (wants_search()) {
        explorer.sweep();
        start(Doing::searching);
    } else if (current_ != 0) {
        leave_by(floor.entry);
    }
}

FloorPlanner::Result FloorPlanner::step(const Estimate& estimate, const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& from,
                                        const std::int64_t t_us, Target& target) {
    const float dt_s = std::clamp(1e-6F * static_cast<float>(t_us - t_us_), 0.0F, 0.2F);
    t_us_ = t_us;
    if (p_.floors_max <= 1) { return Result::nothing; }
    if (doing_ == Doing::idle) { decide(grid, explorer, estimate.planar.pose_map_body); }
    if (doing_ == Doing::idle) { return Result::nothing; }
    return work(estimate, grid, explorer, from, dt_s, target);
}

FloorPlanner::Result FloorPlanner::go_home(const Estimate& estimate, const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& from,
                                           const std::int64_t t_us, Target& target) {
    t_us_ = t_us;
    if (doing_ != Doing::shifting) {
        if (current_ == 0) { return Result::nothing; }
        const std::int8_t entry = floors_[static_cast<std::size_t>(current_)].entry;
        if (doing_ != Doing::centring || passage_ != entry) { leave_by(entry); }
    }
    static_cast<void>(work(estimate, grid, explorer, from, 0.0F, target));
    return Result::busy;
}

FloorPlanner::Result FloorPlanner::work(const Estimate& estimate, const OccupancyGrid& grid, Explorer& explorer, const Pose2<Map, Body>& from,
                                        const float dt_s, Target& target) {
    switch (doing_) {
        case Doing::idle: break;
        case Doing::searching: search(grid, explorer, estimate, from, dt_s, target); break;
        case Doing::surveying: survey(grid, explorer, estimate, from, target); break;
        case Doing::centring: centre(grid, explorer, estimate, from, target); break;
        case Doing::shifting:
            if (shift(estimate, target)) {
                const bool wants_exploring = new_floor_ && !turned_back_;
                doing_ = Doing::idle;
                soundings_.restart();
                if (wants_exploring) { return Result::arrived; }
            }
            break;
    }
    return Result::busy;
}

// ---------------------------------------------------------------- flights

void FloorPlanner::fly(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, const float x_m,
                       const float y_m, Target& target) {
    explorer.go_to(grid, estimate.planar.pose_map_body, from, x_m, y_m, t_us_, target);
    if (explorer.has_way()) {
        way_us_ = -1;
    } else if (way_us_ < 0) {
        way_us_ = t_us_;
    }
}

// The floor is explored; what is left is to pass under and over more of it.
void FloorPlanner::search(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, const float dt_s,
                          Target& target) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    Floor& floor = floors_[static_cast<std::size_t>(current_)];
    floor.searched_s += dt_s;
    soundings_.want(0.5F * width_m(floor.pass), !linked(true) && !linked(false));
    explorer.explore(grid, pose, from, t_us_, target, &soundings_);
    if (looked_us_ < 0 || lasted(looked_us_, kFindAgainS)) {
        looked_us_ = t_us_;
        const Seed found = find_opening(grid, pose);
        if (found.valid) {
            seed_ = found;
            goal_x_m_ = seed_.x_m;
            goal_y_m_ = seed_.y_m;
            judge_.clear();
            start(Doing::surveying);
            return;
        }
    }
    if (explorer.finished()) {
        floor.searched = width_m(floor.pass) <= p_.floor_search_fine_m;
        ++floor.pass;
        explorer.sweep();
    }
    if (!wants_search()) { doing_ = Doing::idle; }
}

void FloorPlanner::survey(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, Target& target) {
    const Pose2<Map, Body>& pose = estimate.planar.pose_map_body;
    if (looked_us_ < 0 || lasted(looked_us_, kLookAgainS)) {
        looked_us_ = t_us_;
        const OpeningVerdict verdict =
            judge_.judge(vertical_, grid, explorer.where(), static_cast<std::int8_t>(current_), seed_.up ? VerticalSide::over : VerticalSide::under,
                         seed_.beyond, seed_.x_m, seed_.y_m, pose.x_m, pose.y_m);
        if (verdict.what == OpeningVerdict::What::too_small) {
            refuse(Refusal::too_small);
            return;
        }
        if (verdict.what == OpeningVerdict::What::ready) {
            seed_.x_m = goal_x_m_ = verdict.x_m;
            seed_.y_m = goal_y_m_ = verdict.y_m;
            passage_ = -1;
            start(Doing::centring);
            return;
        }
        if (std::hypot(verdict.look_x_m - goal_x_m_, verdict.look_y_m - goal_y_m_) > kArrivedM) {
            goal_x_m_ = verdict.look_x_m;
            goal_y_m_ = verdict.look_y_m;
            stood_us_ = t_us_;
            way_us_ = -1;
        }
    }
    fly(grid, explorer, estimate, from, goal_x_m_, goal_y_m_, target);
    if (std::hypot(goal_x_m_ - pose.x_m, goal_y_m_ - pose.y_m) > kArrivedM) {
        there_us_ = -1;
    } else if (there_us_ < 0) {
        there_us_ = t_us_;
    }
    if (lasted(there_us_, kLookedS) || lasted(stood_us_, kLookTimeS) || lasted(way_us_, kNoWayS)) {
        judge_.skip(goal_x_m_, goal_y_m_);
        stood_us_ = t_us_;
        there_us_ = way_us_ = -1;
    }
    if (lasted(since_us_, p_.floor_look_s)) { refuse(Refusal::not_seen_round); }
}

void FloorPlanner::centre(const OccupancyGrid& grid, Explorer& explorer, const Estimate& estimate, const Pose2<Map, Body>& from, Target& target) {
    const PlanarEstimate& planar = estimate.planar;
    fly(grid, explorer, estimate, from, goal_x_m_, goal_y_m_, target);
    const bool there = std::hypot(goal_x_m_ - planar.pose_map_body.x_m, goal_y_m_ - planar.pose_map_body.y_m) < kArrivedM &&
                       std::hypot(planar.vx_m_s, planar.vy_m_s) < kSlowM_S;
    if (!there) {
        stood_us_ = -1;
        if (passage_ < 0 && (lasted(way_us_, kNoWayS) || lasted(since_us_, p_.floor_look_s))) { refuse(Refusal::no_way); }
        return;
    }
    if (stood_us_ < 0) { stood_us_ = t_us_; }
    if (lasted(stood_us_, kStoodS) && begin_shift(estimate)) { start(Doing::shifting); }
}

// Notes the passage and the floor at its far end if they are new, and the height to reach.
bool FloorPlanner::begin_shift(const Estimate& estimate) {
    const float half_m = 0.5F * p_.hull_height_m + p_.vertical_clearance_m;
    new_floor_ = false;
    if (passage_ < 0) {
        if (floors_.size() >= std::min(kFloorSlots, static_cast<std::size_t>(p_.floors_max)) || passages_.full()) {
            refuse(Refusal::too_many_floors);
            return false;
        }
        const float elevation_m = seed_.up ? seed_.slab_m + kSlabM : seed_.far_m;
        float z_m = elevation_m + p_.cruise_height_m;
        if (seed_.up) { z_m = std::min(z_m, seed_.far_m - half_m - 0.1F); }
        if (seed_.up && z_m < elevation_m + half_m) {
            refuse(Refusal::no_room);
            return false;
        }
        const auto here = static_cast<std::int8_t>(current_);
        to_ = static_cast<std::int8_t>(floors_.size());
        passage_ = static_cast<std::int8_t>(passages_.size());
        Floor floor;
        floor.elevation_m = elevation_m;
        floor.entry = passage_;
        floor.parent = here;
        floor.seen_x_m = seed_.seen_x_m;
        floor.seen_y_m = seed_.seen_y_m;
        static_cast<void>(floors_.push(floor));
        static_cast<void>(passages_.push(seed_.up ? Passage{here, to_, seed_.x_m, seed_.y_m, seed_.slab_m, seed_.slab_m + kSlabM}
                                                  : Passage{to_, here, seed_.x_m, seed_.y_m, seed_.slab_m - kSlabM, seed_.slab_m}));
        shift_z_m_ = z_m;
        new_floor_ = true;
        ground_votes_ = 0;
    } else {
        const Floor& floor = floors_[static_cast<std::size_t>(to_)];
        shift_z_m_ = floor.elevation_m + p_.cruise_height_m;
    }
    start_z_m_ = estimate.altitude.z_m;
    turned_back_ = false;
    least_left_m_ = 1e9F;
    return true;
}

void FloorPlanner::turn_back() {
    turned_back_ = true;
    shift_z_m_ = start_z_m_;
    since_us_ = looked_us_ = t_us_;
    least_left_m_ = 1e9F;
    stood_us_ = -1;
    if (new_floor_) {
        floors_[static_cast<std::size_t>(to_)].empty = true;
        if (judged_.full()) { judged_.drop_front(1); }
        const std::int8_t parent = floors_[static_cast<std::size_t>(to_)].parent;
        static_cast<void>(judged_.push({parent, seed_.x_m, seed_.y_m, seed_.up, Refusal::clearance_gone, seed_.seen_x_m, seed_.seen_y_m}));
    }
}

// One step up or down. True: at the height wanted.
bool FloorPlanner::shift(const Estimate& estimate, Target& target) {
    const AltitudeEstimate& a = estimate.altitude;
    const Passage& passage = passages_[static_cast<std::size_t>(passage_)];
    const float left_m = shift_z_m_ - a.z_m;
    const float half_m = 0.5F * p_.hull_height_m + p_.vertical_clearance_m;
    if (std::fabs(left_m) < least_left_m_ - kStallM || std::fabs(left_m) < kArrivedM) {
        least_left_m_ = std::fabs(left_m);
        looked_us_ = t_us_;
    }
    if (!turned_back_) {
        const bool sides = nearest_side_m_ < p_.hull_radius_m + p_.floor_turn_back_m;
        const bool over = left_m > 0.2F && std::isfinite(a.ceiling_z_m) && a.ceiling_z_m < std::min(shift_z_m_, a.z_m + 0.5F) + half_m;
        const bool under = left_m < -0.2F && std::isfinite(a.ground_z_m) && a.ground_z_m > std::max(shift_z_m_, a.z_m - 0.5F) - half_m;
        if (sides || over || under || lasted(since_us_, kShiftTimeS) || lasted(looked_us_, kStallS)) { turn_back(); }
    }
    target.path.clear();
    static_cast<void>(target.path.push({passage.x_m, passage.y_m, 0.8F}));
    target.z_m = shift_z_m_;
    target.climb_rate_m_s = std::min(p_.floor_climb_m_s, p_.climb_rate_m_s);
    if (std::fabs(left_m) > kArrivedM) {
        stood_us_ = -1;
    } else if (stood_us_ < 0) {
        stood_us_ = t_us_;
    }
    if (!lasted(stood_us_, kStoodS)) { return false; }
    current_ = layer_ = turned_back_ ? (to_ == passage.low ? passage.high : passage.low) : to_;
    return true;
}

}  // namespace noctule
