#include "estimate/scan_tracker.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr float kGoodShare = 0.6F;         // of the points explained: nothing more is looked for
constexpr float kSureStep_m = 0.12F;       // a prediction wider than this is searched round
constexpr float kSureStep_rad = 0.08F;
constexpr float kSearchMost_m = 1.0F;
constexpr float kSearchMost_rad = 0.6F;
constexpr float kCostShare = 0.25F;        // neighbouring points do not err independently
constexpr float kFallen = 0.1F;
constexpr float kShareGain = 0.05F;
constexpr float kPoorLeast_m = 0.3F;
constexpr float kPoorLeast_rad = 0.25F;
constexpr float kDoubted = 2.0F;           // the source of motion was off by more than its covariance allows
constexpr float kOtherModel = 2.0F;        // cost of not believing it
constexpr float kMatchFloor_m = 0.01F;
constexpr float kMatchFloor_rad = 0.002F;
constexpr float kImpossible = 8.0F;        // times the covariance in place that a match may lie outside of an inertial prediction: 5 sigma
constexpr std::int64_t kRefusedUs = 1000000;  // after so long of nothing else the match is believed

}  // namespace

void ScanTracker::take(const LevelScan& scan) {
    shape_of(scan, shape_);
    since_last_s_ = t_us_ > 0 ? 1e-6F * static_cast<float>(scan.t_us - t_us_) : 0.0F;
    t_us_ = scan.t_us;
}

Pose2<Map, Body> ScanTracker::as_before() const {
    const float share = last_step_s_ > 0.0F ? std::clamp(since_last_s_ / last_step_s_, 0.0F, 2.0F) : 0.0F;
    return last_pose_ * Pose2<Body, Body>{share * last_step_.x_m, share * last_step_.y_m, share * last_step_.yaw_rad};
}

const ScanFit& ScanTracker::match(const Pose2<Map, Body>& predicted, const Matrix<float, 3, 3>& covariance, const bool sure_motion) {
    fit_ = ScanFit{};
    fit_.pose = predicted;
    Prediction prior{predicted, covariance, {}};
    Matrix<float, 3, 3>& widened = prior.covariance;
    widened(0, 0) += 1e-5F;
    widened(1, 1) += 1e-5F;
    widened(2, 2) += 1e-6F;
    if (map_.empty() || !invert(widened, prior.information)) { return fit_; }
    fit_ = map_.refine(shape_, predicted, prior);
    // Two motion models: what the source of motion says, and going on as before where it was found wrong (docs/maths/scan_match.md#motion).
    float best = kCostShare * fit_.cost + prior.cost(fit_.pose);
    if (last_scale_ > kDoubted || fit_.prior_scale.place > kDoubted) {
        Prediction going_on = prior;
        going_on.pose = as_before();
        const ScanFit other = map_.refine(shape_, going_on.pose, going_on);
        const float cost = kOtherModel + kCostShare * other.cost + going_on.cost(other.pose);
        if (other.match.valid && cost < best) {
            best = cost;
            fit_ = other;
            fit_.prior_scale = prior.scale(fit_.pose);
        }
    }
    const float wide_m = std::sqrt(std::max(0.0F, eigen_symmetric(widened(0, 0), widened(0, 1), widened(1, 1)).large));
    const float wide_rad = std::sqrt(widened(2, 2));
    // A match poorer than usual here is doubted, too.
    const bool poor = fit_.share < std::max(kGoodShare, usual_share_ - kFallen);
    if (poor || wide_m > kSureStep_m || wide_rad > kSureStep_rad) {
        ++counters_.searches;
        std::array<ScanMap::Candidate, ScanMap::kCandidates> candidates;
        const std::size_t n = map_.search(shape_, predicted, std::clamp(2.5F * wide_m, poor ? kPoorLeast_m : 0.15F, kSearchMost_m),
                                          std::clamp(2.5F * wide_rad, poor ? kPoorLeast_rad : 0.06F, kSearchMost_rad), candidates);
        for (std::size_t i = 0; i < n; ++i) {
            const ScanFit other = map_.refine(shape_, candidates[i].pose, prior);
            const float cost = kCostShare * other.cost + prior.cost(other.pose);
            if (other.match.valid && cost < best) {
                best = cost;
                fit_ = other;
            }
        }
    }
    const bool impossible = sure_motion && fit_.match.valid && fit_.prior_scale.place > kImpossible;
    if (impossible && refused_from_us_ < 0) { refused_from_us_ = t_us_; }
    if (impossible && t_us_ - refused_from_us_ < kRefusedUs) {
        fit_.match.valid = false;
        fit_.pose = predicted;
        fit_.prior_scale = {};
        return fit_;
    }
    refused_from_us_ = -1;
    usual_share_ += kShareGain * (fit_.share - usual_share_);
    last_scale_ = fit_.prior_scale.place;
    if (fit_.share < kGoodShare) { ++counters_.poor; }
    if (!fit_.match.valid) { return fit_; }
    // However many points agree, the map is no better than this: Lambda' = Lambda (I + F Lambda)^-1, and b alike.
    Matrix<float, 3, 3> floor;
    floor(0, 0) = floor(1, 1) = kMatchFloor_m * kMatchFloor_m;
    floor(2, 2) = kMatchFloor_rad * kMatchFloor_rad;
    Matrix<float, 3, 3> shrink;
    if (!invert(Matrix<float, 3, 3>::identity() + fit_.match.lambda * floor, shrink)) {
        fit_.match.valid = false;
        return fit_;
    }
    fit_.match.lambda = shrink * fit_.match.lambda;
    symmetrise(fit_.match.lambda);
    fit_.match.b = shrink * fit_.match.b;
    return fit_;
}

void ScanTracker::clear() {
    frames_.clear();
    map_.start(0.0F, 0.0F);
    refused_from_us_ = -1;
}

void ScanTracker::begin_epoch() {
    first_epoch_ = ++epoch_;
    map_.start(last_pose_.x_m, last_pose_.y_m);
}

void ScanTracker::relocate(const Relocation& relocation) {
    frames_.move(relocation);
    first_epoch_ = 0;
    last_pose_ = relocation.correction * last_pose_;
    fill(last_pose_);
    refused_from_us_ = -1;
}

void ScanTracker::fill(const Pose2<Map, Body>& pose) {
    frames_.fill(map_, pose, [this](const std::size_t i) { return frames_.epoch(i) >= first_epoch_; });
}

void ScanTracker::keep(const Pose2<Map, Body>& pose, const FrameDoubt& doubt) {
    last_step_ = last_pose_.inverse() * pose;
    last_step_s_ = since_last_s_;
    last_pose_ = pose;
    if (!frames_.due(pose)) { return; }
    frames_.add(shape_, pose, doubt, epoch_);
    fill(pose);
}

}  // namespace noctule
