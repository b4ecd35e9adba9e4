#include "estimate/place_search.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr std::size_t kRecent = 40;         // newest keyframes that are not looked at: they are the way just flown
constexpr std::size_t kPointsLeast = 40;    // a sweep of fewer says too little
constexpr float kReach_m = 5.0F;            // from a keyframe within which its map is looked at
constexpr float kSigmas = 3.0F;
constexpr float kHalfMost_m = 2.4F;         // of one window
constexpr std::int32_t kStep = 2;           // cells: a point beside a cell counts half, so that none is stepped over
constexpr float kHalfLeast_m = 0.30F;
constexpr float kNarrow_m = 0.75F;          // windows below this need one centre, the prediction
constexpr float kApart_m = 2.0F;            // between centres
constexpr float kBeside_m = 3.5F;         // of the way: where it is looked for as well, not after having been carried
constexpr std::array<std::array<float, 2>, 5> kSpots{{{0.0F, 0.0F}, {1.0F, 0.0F}, {-1.0F, 0.0F}, {0.0F, 1.0F}, {0.0F, -1.0F}}};
constexpr float kYawLeast_rad = 0.06F;
constexpr float kSlice_rad = 0.33F;         // half of the headings of one slice
constexpr std::int32_t kSlices = 10;        // that make a full turn
constexpr std::size_t kRefined = 3;         // hills of a window that are refined
constexpr float kScoreLeast = 0.5F;         // of a hill before it is
constexpr float kFarCost = 0.01F;           // for each squared standard deviation from the prediction
constexpr float kOther_m = 0.35F;           // another place
constexpr float kOther_rad = 0.25F;
constexpr float kKnown_m = 0.02F;           // from the sweep alone, all directions free
constexpr float kKnownHere_m = 0.03F;       // in a window of its own round the prediction
constexpr float kKnown_rad = 0.004F;
constexpr float kView_m = 9.0F;             // within which the old map is held against the sweep
constexpr std::int32_t kConfirmations = 3;  // of a place near the prediction
constexpr float kFurther_m = 0.25F;         // between sweeps that confirm
constexpr float kFurther_rad = 0.25F;
constexpr std::uint32_t kFurtherSteps = 20;
constexpr std::uint32_t kConfirmSteps = 200;
constexpr float kAgree_m = 0.15F;           // of confirming sweeps
constexpr float kAgree_rad = 0.06F;
constexpr std::uint32_t kPause = 20;        // steps between rounds
constexpr std::uint32_t kLook = 10;         // steps between looks whether a round is worth it

[[nodiscard]] float distance_m(const Pose2<Map, Body>& a, const Pose2<Map, Body>& b) { return std::hypot(a.x_m - b.x_m, a.y_m - b.y_m); }

}  // namespace

bool PlaceSearch::candidate(const Keyframes& frames, const std::size_t i) const {
    if (anywhere_) { return frames.epoch(i) < epoch_; }
    const float grown_m2 = doubt_.m2 - frames.doubt(i).m2;
    if (i >= last_frame_ || grown_m2 < parameters_.close_sigma_m * parameters_.close_sigma_m) { return false; }
    return distance_m(frames.pose(i), pose_) < kReach_m + kSigmas * std::sqrt(grown_m2);
}

bool PlaceSearch::worth_it(const Keyframes& frames) const {
    for (std::size_t i = 0; i < frames.size(); ++i) {
        if (candidate(frames, i)) { return true; }
    }
    return false;
}

void PlaceSearch::next_spot() {
    spot_ = anywhere_ ? kSpots.size() : spot_ + 1;
    if (spot_ < kSpots.size()) { return; }
    spot_ = 0;
    ++cursor_;
}

bool PlaceSearch::next_centre(const Keyframes& frames) {
    for (; cursor_ < frames.size(); next_spot()) {
        if (!candidate(frames, cursor_)) {
            spot_ = kSpots.size() - 1;
            continue;
        }
        const float grown_m = std::sqrt(std::max(0.0F, doubt_.m2 - frames.doubt(cursor_).m2));
        const float grown_rad = std::sqrt(std::max(0.0F, doubt_.rad2 - frames.doubt(cursor_).rad2));
        half_rad_ = anywhere_ ? kSlice_rad : std::clamp(kSigmas * grown_rad, kYawLeast_rad, kSlice_rad);
        here_ = !anywhere_ && kSigmas * grown_m < kNarrow_m;
        // Beside the way, too: where the true place is not looked for, another one is alone.
        Pose2<Map, Body> at = here_ ? pose_ : frames.pose(cursor_);
        at.x_m += kBeside_m * kSpots[spot_][0];
        at.y_m += kBeside_m * kSpots[spot_][1];
        bool done = centres_.full();
        for (const Point2<Map>& centre : centres_) { done = done || std::hypot(centre.x_m - at.x_m, centre.y_m - at.y_m) < kApart_m; }
        if (done) { continue; }
        static_cast<void>(centres_.push({at.x_m, at.y_m}));
        centre_ = {at.x_m, at.y_m, pose_.yaw_rad};
        half_m_ = here_ ? std::max(kHalfLeast_m, kSigmas * grown_m) : kHalfMost_m;
        slice_ = 0;
        fill(frames, centre_);
        return true;
    }
    return false;
}

void PlaceSearch::fill(const Keyframes& frames, const Pose2<Map, Body>& centre) {
    frames.fill(map_, centre, [&](const std::size_t i) { return candidate(frames, i); });
}

ScanFit PlaceSearch::fit(const ScanShape& shape, const Pose2<Map, Body>& start, const float sigma_m, const float sigma_rad) {
    Prediction prior{start, {}, {}};
    prior.covariance(0, 0) = prior.covariance(1, 1) = sigma_m * sigma_m;
    prior.covariance(2, 2) = sigma_rad * sigma_rad;
    for (std::size_t i = 0; i < 3; ++i) { prior.information(i, i) = 1.0F / prior.covariance(i, i); }
    return map_.refine(shape, start, prior);
}

void PlaceSearch::note(const Hit& hit) {
    const auto same = [&](const Hit& other) {
        return distance_m(hit.pose, other.pose) < kOther_m && std::abs(wrap_angle(hit.pose.yaw_rad - other.pose.yaw_rad)) < kOther_rad;
    };
    if (hit.share > best_.share) {
        if (!same(best_)) { second_ = best_; }
        best_ = hit;
    } else if (!same(best_) && hit.share > second_.share) {
        second_ = hit;
    }
}

void PlaceSearch::search_slice(const Keyframes& frames) {
    Pose2<Map, Body> at = centre_;
    if (anywhere_) { at.yaw_rad = wrap_angle(at.yaw_rad + 2.0F * kPi * static_cast<float>(slice_) / static_cast<float>(kSlices)); }
    std::array<ScanMap::Candidate, ScanMap::kCandidates> hills;
    const std::size_t n = map_.search(shape_, at, half_m_, half_rad_, hills, here_ ? 1 : kStep);
    for (std::size_t i = 0; i < std::min(n, kRefined); ++i) {
        if (hills[i].score < kScoreLeast) { break; }
        const ScanFit found = fit(shape_, hills[i].pose, 0.5F, 0.1F);
        if (!found.match.valid) { continue; }
        // In a corridor, or a round room, a sweep agrees wherever it is pushed, or turned.
        Matrix<float, 3, 3> left;
        const float known_m = here_ ? kKnownHere_m : kKnown_m;
        if (!invert(found.match.lambda, left) || !(left(0, 0) + left(1, 1) < known_m * known_m) || !(left(2, 2) < kKnown_rad * kKnown_rad)) { continue; }
        // Near the prediction is likelier.
        const float far2 = anywhere_ ? 0.0F : std::pow(distance_m(found.pose, pose_), 2.0F) / std::max(1e-4F, doubt_.m2 - frames.doubt(cursor_).m2);
        note({found.pose, found.share - map_.passed_through(shape_, found.pose, kView_m) - kFarCost * far2, cursor_});
    }
    if (++slice_ >= (anywhere_ ? kSlices : 1)) {
        slice_ = -1;
        next_spot();
        if (here_) { cursor_ = frames.size(); }
    }
}

void PlaceSearch::decide(const Keyframes& frames) {
    phase_ = Phase::idle;
    wait_ = kPause;
    if (best_.share < parameters_.close_share || best_.frame >= frames.size()) { return; }
    if (second_.share > best_.share - parameters_.close_margin) {
        ++counters_.ambiguous;
        return;
    }
    phase_ = Phase::confirming;
    since_ = 0;
    confirmed_ = 0;
    confirmed_at_ = pose_;
    correction_ = best_.pose * pose_.inverse();
    relocation_.before = frames.doubt(best_.frame);
}

bool PlaceSearch::confirm(const Keyframes& frames, const ScanShape& shape, const Pose2<Map, Body>& pose) {
    if (++since_ > kConfirmSteps) {
        phase_ = Phase::idle;
        wait_ = kPause;
        return false;
    }
    const bool further = distance_m(pose, confirmed_at_) > kFurther_m || std::abs(wrap_angle(pose.yaw_rad - confirmed_at_.yaw_rad)) > kFurther_rad ||
                         since_ % kFurtherSteps == 0;
    if (!further || shape.size() < kPointsLeast) { return false; }
    const Pose2<Map, Body> start = correction_ * pose;
    fill(frames, start);
    const ScanFit found = fit(shape, start, 0.1F, 0.05F);
    const bool agrees = found.match.valid && found.share - map_.passed_through(shape, found.pose, kView_m) >= parameters_.close_share && distance_m(found.pose, start) < kAgree_m &&
                        std::abs(wrap_angle(found.pose.yaw_rad - start.yaw_rad)) < kAgree_rad;
    if (!agrees) {
        ++counters_.refuted;
        phase_ = Phase::idle;
        wait_ = kPause;
        return false;
    }
    correction_ = found.pose * pose.inverse();
    confirmed_at_ = pose;
    if (++confirmed_ < (here_ ? kConfirmations : parameters_.close_confirm)) { return false; }
    ++counters_.found;
    phase_ = Phase::idle;
    wait_ = kPause;
    relocation_.correction = correction_;
    relocation_.centre = {pose.x_m, pose.y_m};
    relocation_.now = doubt_;
    return true;
}

bool PlaceSearch::step(const Keyframes& frames, const ScanShape& shape, const Pose2<Map, Body>& pose, const Matrix<float, 3, 3>& covariance,
                       const bool anywhere, const std::uint16_t epoch) {
    if (phase_ == Phase::searching) {
        if (slice_ < 0 && !next_centre(frames)) {
            decide(frames);
        } else {
            search_slice(frames);
        }
        return false;
    }
    if (phase_ == Phase::confirming) { return confirm(frames, shape, pose); }
    if (wait_ > 0) {
        --wait_;
        return false;
    }
    anywhere_ = anywhere;
    epoch_ = epoch;
    pose_ = pose;
    doubt_ = {eigen_symmetric(covariance(0, 0), covariance(0, 1), covariance(1, 1)).large, covariance(2, 2)};
    last_frame_ = frames.size() > kRecent ? frames.size() - kRecent : 0;
    if (shape.size() < kPointsLeast || !worth_it(frames)) {
        wait_ = kLook;
        return false;
    }
    ++counters_.rounds;
    phase_ = Phase::searching;
    shape_ = shape;
    cursor_ = 0;
    spot_ = 0;
    slice_ = -1;
    centres_.clear();
    best_ = Hit{};
    second_ = Hit{};
    return false;
}

}  // namespace noctule
