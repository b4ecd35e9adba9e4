// The wall filter while the scan match leads (docs/maths/scan_match.md#lead): one particle learns, the others wait.
#include <algorithm>
#include <cmath>
#include <utility>

#include "estimate/wall_filter.hpp"

namespace noctule {

namespace {

constexpr float kWallMemory = 40.0F;   // walls
constexpr float kScanMemory = 0.05F;   // one over sweeps

}  // namespace

const WallFilter::Result& WallFilter::follow(const WallObservations& walls, const ScanFit& fit, const LevelScan& scan) {
    ++step_;
    following_ = true;
    sound_ = 0;
    prepare_bearings(scan);
    Belief belief;
    belief.pose = mean_;
    belief.p = fit.prior_scale.widen(predicted_covariance_);
    if (fit.match.valid) { fuse_match(fit.match, mean_, belief); }
    belief.lambda(1, 0) = belief.lambda(0, 1);
    belief.lambda(2, 0) = belief.lambda(0, 2);
    belief.lambda(2, 1) = belief.lambda(1, 2);
    mean_ = belief.pose;
    spread_ = belief.p;
    for (std::size_t i = 0; i < count(); ++i) { particles_[i].pose = mean_; }

    Particle& particle = particles_[best_];
    std::array<Assignment, kMaxWallsPerScan> assigned{};
    std::array<bool, kMaxLandmarks> associated{};
    std::int32_t matched = 0;
    for (std::size_t j = 0; j < walls.size(); ++j) {
        assigned[j].landmark = associate(particle, belief, walls[j]);
        if (assigned[j].landmark < 0) { continue; }
        ++matched;
        Belief probe = belief;
        static_cast<void>(fuse(particle.landmarks[static_cast<std::size_t>(assigned[j].landmark)], walls[j], belief.pose, probe, assigned[j]));
        if (assigned[j].distance2 < kSound2) { ++sound_; }
        associated[static_cast<std::size_t>(assigned[j].landmark)] = true;
    }
    judge_walls(walls, scan);
    map_drift_ = slowly(drift_of(particle, assigned, walls.size()));
    for (std::size_t j = 0; j < walls.size(); ++j) {
        if (assigned[j].landmark >= 0) { learn(particle.landmarks[static_cast<std::size_t>(assigned[j].landmark)], walls[j], mean_, 1.0F); }
    }
    if (parameters_.visibility_through == 0 || step_ % kLookPeriod == 0) { look_for_landmarks(particle, associated); }
    for (std::size_t j = 0; j < walls.size(); ++j) {
        if (assigned[j].landmark >= 0) { continue; }
        const std::int32_t l = associate(particle, belief, walls[j]);
        if (l >= 0) {
            learn(particle.landmarks[static_cast<std::size_t>(l)], walls[j], mean_, 1.0F);
        } else {
            tie(insert(particle, walls[j], mean_), mean_, map_drift_ + belief.p);
        }
    }
    if (parameters_.visibility_through != 0 && step_ % kMergesPerStep == 0) { merge_landmarks(particle); }

    result_.pose = mean_;
    result_.spread = spread_;
    result_.map_drift = map_drift_;
    result_.laser = {};
    for (std::size_t k = 0; k < 9; ++k) { result_.laser.lambda.values[k] = static_cast<double>(belief.lambda.values[k]); }
    for (std::size_t k = 0; k < 3; ++k) { result_.laser.b.values[k] = static_cast<double>(belief.b.values[k]); }
    result_.effective_particles = 1.0F;
    result_.walls_matched = matched;
    return result_;
}

void WallFilter::judge_walls(const WallObservations& walls, const LevelScan& scan) {
    std::int32_t hits = 0;
    std::int32_t on_walls = 0;
    for (const ScanPoint& point : scan.points) { hits += point.hit ? 1 : 0; }
    for (const WallObservation& wall : walls) { on_walls += wall.points; }
    if (hits > 0) { on_walls_ += (step_ == 1 ? 1.0F : kScanMemory) * (static_cast<float>(on_walls) / static_cast<float>(hits) - on_walls_); }
    // Where there were no walls before, those of the first sweep are new, not doubtful.
    if (walls.empty() || std::exchange(fresh_, false)) { return; }
    const auto n = static_cast<float>(walls.size());
    doubtful_ += std::min(1.0F, n / kWallMemory) * (1.0F - static_cast<float>(sound_) / n - doubtful_);
}

void WallFilter::rejoin() {
    following_ = false;
    const Particle& from = particles_[best_];
    const Matrix<float, 3, 3> root = cholesky(spread_);
    for (std::size_t i = 0; i < count(); ++i) {
        Particle& to = particles_[i];
        to.log_weight = 0.0F;
        if (i != best_) {
            to.count = from.count;
            std::copy_n(from.landmarks.begin(), from.count, to.landmarks.begin());
        }
        Matrix<float, 3, 1> draw;
        draw.values = {random_.normal(), random_.normal(), random_.normal()};
        const Matrix<float, 3, 1> offset = root * draw;
        to.pose = {mean_.x_m + offset(0, 0), mean_.y_m + offset(1, 0), wrap_angle(mean_.yaw_rad + offset(2, 0))};
    }
}

}  // namespace noctule
