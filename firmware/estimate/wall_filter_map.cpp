// The map's side of the wall filter: how landmarks learn, are tied, found again, merged, and given up.
#include <algorithm>
#include <bit>
#include <cmath>

#include "core/length.hpp"
#include "estimate/wall_filter.hpp"

namespace noctule {

namespace {

constexpr std::int8_t kTrustStart = 2;   // algorithms E
constexpr std::int8_t kTrustGain = 2;
constexpr std::int8_t kTrustCap = 80;
constexpr float kSeeThrough_m = 0.25F;
constexpr float kOccluded_m = 0.15F;
constexpr float kMergeShare = 0.5F;         // of the floors that association forgives
constexpr float kMergeDirection = 0.998F;   // cosine of 3.6 degrees
constexpr float kMergeOverlap_m = 0.2F;
constexpr float kWholeWall_m = 1.0F;
constexpr float kSlip_m = 0.005F;           // along walls, in a metre, where no wall across is in view (docs/maths/localisation.md#drift)
constexpr std::int16_t kFleeting = 5;       // sweeps below which a wall is not kept over a loss

/// A bit for each landmark of a particle.
class WallSet {
public:
    void set(const std::int32_t i, const bool on) {
        std::uint64_t& word = words_[static_cast<std::size_t>(i >> 6)];
        word = on ? word | bit(i) : word & ~bit(i);
    }
    [[nodiscard]] bool has(const std::int32_t i) const { return (words_[static_cast<std::size_t>(i >> 6)] & bit(i)) != 0U; }
    /// The last one not after i; -1: none.
    [[nodiscard]] std::int32_t last_to(const std::int32_t i) const {
        std::uint64_t word = words_[static_cast<std::size_t>(i >> 6)] & (~std::uint64_t{0} >> static_cast<unsigned>(63 - (i & 63)));
        for (std::int32_t k = i >> 6;; word = words_[static_cast<std::size_t>(k)]) {
            if (word != 0U) { return k * 64 + 63 - std::countl_zero(word); }
            if (--k < 0) { return -1; }
        }
    }

private:
    static std::uint64_t bit(const std::int32_t i) { return std::uint64_t{1} << static_cast<unsigned>(i & 63); }
    std::array<std::uint64_t, (kMaxLandmarks + 63U) / 64U> words_{};
};

}  // namespace

void WallFilter::learn(Landmark& landmark, const WallObservation& wall, const Pose2<Map, Body>& pose, const float noise_scale) const {
    // Kalman update of (s, beta) at a pose taken as exact: H_F = [[1, -along], [0, 1]].
    const float lever_m = landmark.along(pose.x_m, pose.y_m);
    const LineMeasurement expected = landmark.predict(pose);
    // z - z^ in the landmark's own form: s = rho + along * beta keeps H the identity.
    const float d_beta = wrap_angle(wall.alpha_rad - expected.alpha_rad);
    const float d_s = wall.rho_m - expected.rho_m + lever_m * d_beta;
    const LineCovariance noise = wall.covariance.scaled(noise_scale).sheared(lever_m);
    fuse_line(landmark, d_s, d_beta, noise);
    landmark.changed = true;
    landmark.covariance.rho_rho = std::max(landmark.covariance.rho_rho, parameters_.landmark_floor_m * parameters_.landmark_floor_m);
    landmark.covariance.alpha_alpha = std::max(landmark.covariance.alpha_alpha, parameters_.landmark_floor_rad * parameters_.landmark_floor_rad);
    const Point2<Map> end0 = pose * wall.at(wall.from_m);
    const Point2<Map> end1 = pose * wall.at(wall.to_m);
    landmark.from_m = std::min(landmark.from_m, landmark.along(end0.x_m, end0.y_m));
    landmark.to_m = std::max(landmark.to_m, landmark.along(end1.x_m, end1.y_m));
    landmark.trust = static_cast<std::int8_t>(std::min<std::int32_t>(kTrustCap, landmark.trust + kTrustGain));
    landmark.seen = std::min<std::int16_t>(32000, static_cast<std::int16_t>(landmark.seen + 1));
}

Landmark& WallFilter::insert(Particle& particle, const WallObservation& wall, const Pose2<Map, Body>& pose) {
    const std::int32_t most = std::clamp<std::int32_t>(parameters_.landmarks_max, 1, static_cast<std::int32_t>(kMaxLandmarks));
    std::int32_t at = particle.count;
    if (at >= most) {
        at = 0;
        for (std::int32_t i = 1; i < particle.count; ++i) {
            if (particle.landmarks[static_cast<std::size_t>(i)].seen < particle.landmarks[static_cast<std::size_t>(at)].seen) { at = i; }
        }
        ++counters_.evicted;
    } else {
        ++particle.count;
    }
    Landmark& landmark = particle.landmarks[static_cast<std::size_t>(at)];
    landmark = make_landmark(wall, pose);
    landmark.trust = kTrustStart;
    landmark.seen = 1;
    return landmark;
}

Matrix<float, 3, 3> WallFilter::drift_of(const Particle& particle, const std::array<Assignment, kMaxWallsPerScan>& assigned,
                                         const std::size_t walls) const {
    // The errors of walls are common to them all, so they must not be averaged: in each of two directions the best tied wall counts.
    const Landmark* first = nullptr;
    float first_m2 = 0.0F;
    float yaw_rad2 = -1.0F;
    for (std::size_t j = 0; j < walls; ++j) {
        if (assigned[j].landmark < 0) { continue; }
        const Landmark& landmark = particle.landmarks[static_cast<std::size_t>(assigned[j].landmark)];
        const float d_m2 = landmark.drift_from(landmark.along(particle.pose.x_m, particle.pose.y_m));
        if (first == nullptr || d_m2 < first_m2) {
            first = &landmark;
            first_m2 = d_m2;
        }
        if (yaw_rad2 < 0.0F || landmark.drift_rad2 < yaw_rad2) { yaw_rad2 = landmark.drift_rad2; }
    }
    if (first == nullptr) { return map_drift_; }
    const float c = first->cos_beta;
    const float s = first->sin_beta;
    // Along the first wall: the wall that says most about that direction, or what was believed before and what points let slip since.
    float second_m2 = s * s * map_drift_(0, 0) - 2.0F * c * s * map_drift_(0, 1) + c * c * map_drift_(1, 1) + kSlip_m * kSlip_m * step_m_;
    float best_m2 = -1.0F;
    for (std::size_t j = 0; j < walls; ++j) {
        if (assigned[j].landmark < 0) { continue; }
        const Landmark& landmark = particle.landmarks[static_cast<std::size_t>(assigned[j].landmark)];
        const float across = -s * landmark.cos_beta + c * landmark.sin_beta;
        if (across * across < 0.03F) { continue; }
        const float d_m2 = landmark.drift_from(landmark.along(particle.pose.x_m, particle.pose.y_m)) / (across * across);
        if (best_m2 < 0.0F || d_m2 < best_m2) { best_m2 = d_m2; }
    }
    if (best_m2 >= 0.0F) { second_m2 = best_m2; }
    Matrix<float, 3, 3> drift;
    drift(0, 0) = c * c * first_m2 + s * s * second_m2;
    drift(0, 1) = c * s * (first_m2 - second_m2);
    drift(1, 0) = drift(0, 1);
    drift(1, 1) = s * s * first_m2 + c * c * second_m2;
    drift(2, 2) = yaw_rad2;
    return drift;
}

void WallFilter::tie(Landmark& landmark, const Pose2<Map, Body>& pose, const Matrix<float, 3, 3>& drift) const {
    const float c = landmark.cos_beta;
    const float s = landmark.sin_beta;
    // A short piece says less of itself than its points do: its ends are corners.
    const float short_of = std::max(1.0F, kWholeWall_m / std::max(0.1F, landmark.to_m - landmark.from_m));
    const float floor_m = rough_ * parameters_.tie_floor_m * short_of * short_of;
    landmark.drift_m2 = c * c * drift(0, 0) + 2.0F * c * s * drift(0, 1) + s * s * drift(1, 1) + floor_m * floor_m;
    landmark.drift_rad2 = drift(2, 2) + rough_ * rough_ * parameters_.tie_floor_rad * parameters_.tie_floor_rad;
    landmark.tied_along_m = landmark.along(pose.x_m, pose.y_m);
    landmark.doubt = {eigen_symmetric(drift(0, 0), drift(0, 1), drift(1, 1)).large, drift(2, 2)};
}

void WallFilter::merge_landmarks(Particle& particle) {
    // Two pieces of one wall, first seen with a gap between, that have grown over one another (docs/maths/localisation.md#merge).
    const float floor_m = kMergeShare * parameters_.association_floor_m;
    const float floor_rad = kMergeShare * parameters_.association_floor_rad;
    const LineCovariance floor{floor_m * floor_m, 0.0F, floor_rad * floor_rad};
    const float least_density = std::log(parameters_.new_wall_density);
    // Two that stayed as they were since they were compared last stay two walls.
    WallSet changed;
    for (std::int32_t i = 0; i < particle.count; ++i) {
        Landmark& landmark = particle.landmarks[static_cast<std::size_t>(i)];
        changed.set(i, landmark.changed);
        landmark.changed = false;
    }
    for (std::int32_t i = 0; i < particle.count; ++i) {
        Landmark& a = particle.landmarks[static_cast<std::size_t>(i)];
        for (std::int32_t j = particle.count - 1; j > i; --j) {
            if (!changed.has(i)) {
                j = changed.last_to(j);
                if (j <= i) { break; }
            }
            const Landmark& b = particle.landmarks[static_cast<std::size_t>(j)];
            if (a.cos_beta * b.cos_beta + a.sin_beta * b.sin_beta < kMergeDirection) { continue; }
            const Point2<Map> b0 = b.at(b.from_m);
            const Point2<Map> b1 = b.at(b.to_m);
            const float from_m = a.along(b0.x_m, b0.y_m);
            const float to_m = a.along(b1.x_m, b1.y_m);
            const float shared_from_m = std::max(a.from_m, from_m);
            const float shared_to_m = std::min(a.to_m, to_m);
            if (shared_to_m - shared_from_m < kMergeOverlap_m) { continue; }
            // Compared in the middle of what they share, where the lever of their directions is small.
            const Point2<Map> middle = a.at(0.5F * (shared_from_m + shared_to_m));
            Landmark here;
            here.anchor_x_m = middle.x_m;
            here.anchor_y_m = middle.y_m;
            LineCovariance a_covariance;
            LineCovariance b_covariance;
            const LineMeasurement a_line = line_from_anchor_of(a, here, a_covariance);
            const LineMeasurement b_line = line_from_anchor_of(b, here, b_covariance);
            const float d_beta = wrap_angle(b_line.alpha_rad - a_line.alpha_rad);
            if (log_density(b_line.rho_m - a_line.rho_m, d_beta, a_covariance + b_covariance + floor) < least_density) { continue; }
            LineCovariance covariance;
            const LineMeasurement line = line_from_anchor_of(b, a, covariance);
            fuse_line(a, line.rho_m - a.s_m, wrap_angle(line.alpha_rad - a.beta_rad), covariance);
            a.from_m = std::min(a.from_m, from_m);
            a.to_m = std::max(a.to_m, to_m);
            a.trust = std::max(a.trust, b.trust);
            a.seen = static_cast<std::int16_t>(std::min(32000, a.seen + b.seen));
            if (b.drift_m2 < a.drift_m2) {
                a.drift_m2 = b.drift_m2;
                a.drift_rad2 = b.drift_rad2;
                const Point2<Map> tied = b.at(b.tied_along_m);
                a.tied_along_m = a.along(tied.x_m, tied.y_m);
            }
            a.changed = true;   // those before it have yet to be compared with what it has become
            changed.set(i, true);
            particle.landmarks[static_cast<std::size_t>(j)] = particle.landmarks[static_cast<std::size_t>(particle.count - 1)];
            changed.set(j, changed.has(particle.count - 1));
            --particle.count;
            ++counters_.merged;
        }
    }
}

void WallFilter::prepare_bearings(const LevelScan& scan) {
    farthest_m_.fill(0.0F);
    range_max_m_ = scan.range_max_m;
    tilt_m2_ = scan.tilt_m2;
    tilt_rad2_ = scan.tilt_rad2;
    rough_ = scan.range_noise_m > 0.0F ? scan.range_noise_m / parameters_.laser_range_noise_m : 1.0F;
    constexpr float kScale = static_cast<float>(kBearingBins) / (2.0F * kPi);
    for (const ScanPoint& point : scan.points) {
        const float bearing_rad = std::atan2(point.y_m, point.x_m);
        const auto bin = static_cast<std::size_t>((bearing_rad + kPi) * kScale) % kBearingBins;
        farthest_m_[bin] = std::max(farthest_m_[bin], length_of(point.x_m, point.y_m));
    }
}

void WallFilter::look_for_landmarks(Particle& particle, const std::array<bool, kMaxLandmarks>& associated) {
    const bool through_only = parameters_.visibility_through != 0;
    constexpr float kScale = static_cast<float>(kBearingBins) / (2.0F * kPi);
    const float c = std::cos(particle.pose.yaw_rad);
    const float s = std::sin(particle.pose.yaw_rad);
    for (std::int32_t i = particle.count - 1; i >= 0; --i) {
        Landmark& landmark = particle.landmarks[static_cast<std::size_t>(i)];
        if (through_only && associated[static_cast<std::size_t>(i)]) { continue; }
        const float distance_m = landmark.before(particle.pose.x_m, particle.pose.y_m);
        if (distance_m < 0.0F || distance_m > range_max_m_) { continue; }
        std::int32_t in_view = 0;
        std::int32_t passed = 0;
        for (const float share : {0.25F, 0.5F, 0.75F}) {
            const Point2<Map> p = landmark.at(landmark.from_m + share * (landmark.to_m - landmark.from_m));
            const float dx = p.x_m - particle.pose.x_m;
            const float dy = p.y_m - particle.pose.y_m;
            const float range_m = length_of(dx, dy);
            if (range_m > 0.95F * range_max_m_ || range_m < 0.3F) { continue; }
            const float bearing_rad = std::atan2(c * dy - s * dx, c * dx + s * dy);
            const auto bin = static_cast<std::size_t>((bearing_rad + kPi) * kScale) % kBearingBins;
            if (farthest_m_[bin] <= 0.0F) { continue; }
            if (!through_only) {
                ++in_view;
                continue;
            }
            if (distance_m < 0.25F * range_m || farthest_m_[bin] < range_m - kOccluded_m) { continue; }
            ++in_view;
            if (farthest_m_[bin] > range_m + kSeeThrough_m) { ++passed; }
        }
        if (in_view == 0) { continue; }
        std::int8_t loss = 1;
        if (through_only && passed == in_view) { loss = static_cast<std::int8_t>(kLookPeriod); }
        landmark.trust = static_cast<std::int8_t>(landmark.trust - loss);
        if (landmark.trust < 0) {
            landmark = particle.landmarks[static_cast<std::size_t>(particle.count - 1)];
            --particle.count;
            ++counters_.removed;
        }
    }
}

void WallFilter::best_walls(Bounded<WallSegment, kMaxWalls>& out) const {
    out.clear();
    const Particle& particle = particles_[best_];
    for (std::int32_t i = 0; i < particle.count; ++i) {
        const Landmark& landmark = particle.landmarks[static_cast<std::size_t>(i)];
        const LineCovariance covariance = landmark.covariance_at_origin();
        static_cast<void>(out.push({landmark.hessian(), landmark.at(landmark.from_m), landmark.at(landmark.to_m), covariance.rho_rho,
                                    covariance.alpha_alpha, landmark.seen}));
    }
}

void WallFilter::change_layer(StoredWalls& from, StoredWalls& to) {
    const Particle& best = particles_[best_];
    for (std::int32_t i = 0; i < best.count; ++i) { static_cast<void>(keep_most(from, best.landmarks[static_cast<std::size_t>(i)])); }
    for (std::size_t i = 0; i < count(); ++i) {
        particles_[i].count = to.count;
        std::copy_n(to.landmarks.begin(), static_cast<std::size_t>(to.count), particles_[i].landmarks.begin());
    }
    fresh_ = to.count == 0;
    to.count = 0;
}

bool WallFilter::keep_most(StoredWalls& store, const Landmark& wall) {
    Landmark landmark = wall;
    landmark.changed = true;   // its new neighbours have yet to be compared with it
    if (store.count < static_cast<std::int32_t>(kMaxLandmarks)) {
        store.landmarks[static_cast<std::size_t>(store.count++)] = landmark;
        return true;
    }
    auto* const least = std::min_element(store.landmarks.begin(), store.landmarks.end(), [](const Landmark& a, const Landmark& b) { return a.seen < b.seen; });
    if (least->seen < landmark.seen) { *least = landmark; }
    return false;
}

void WallFilter::begin_epoch(StoredWalls& before, const FrameDoubt& more) {
    if (following_) { rejoin(); }
    const Particle& best = particles_[best_];
    for (std::int32_t i = 0; i < best.count; ++i) {
        const Landmark& landmark = best.landmarks[static_cast<std::size_t>(i)];
        if (landmark.seen < kFleeting) { continue; }
        if (!keep_most(before, landmark)) { ++counters_.evicted; }
    }
    for (Particle& particle : particles_) { particle.count = 0; }
    map_drift_(0, 0) += more.m2;
    map_drift_(1, 1) += more.m2;
    map_drift_(2, 2) += more.rad2;
}

void WallFilter::anchor(const Matrix<float, 3, 3>& local) {
    for (std::size_t k = 0; k < 9; ++k) { map_drift_.values[k] += local.values[k]; }
    map_drift_(0, 2) = map_drift_(1, 2) = map_drift_(2, 0) = map_drift_(2, 1) = 0.0F;
    result_.map_drift = map_drift_;
    spread_ = Matrix<float, 3, 3>{};
    for (std::size_t i = 0; i < count(); ++i) { particles_[i].pose = mean_; }
}

void WallFilter::relocate(const Relocation& relocation, StoredWalls& before, const float sigma_m, const float sigma_rad) {
    Particle& best = particles_[best_];
    StoredWalls all;
    for (std::int32_t i = 0; i < before.count; ++i) { static_cast<void>(keep_most(all, before.landmarks[static_cast<std::size_t>(i)])); }
    for (std::int32_t i = 0; i < best.count; ++i) {
        if (!keep_most(all, best.landmarks[static_cast<std::size_t>(i)])) { ++counters_.evicted; }
    }
    const std::int32_t most = std::clamp<std::int32_t>(parameters_.landmarks_max, 1, static_cast<std::int32_t>(kMaxLandmarks));
    best.count = std::min<std::int32_t>(all.count, most);
    for (std::int32_t i = 0; i < best.count; ++i) {
        Landmark& landmark = best.landmarks[static_cast<std::size_t>(i)];
        landmark = all.landmarks[static_cast<std::size_t>(i)];
        const Pose2<Map, Map> part = relocation.part(relocation.share(landmark.doubt));
        const Point2<Map> anchor = part * Point2<Map>{landmark.anchor_x_m, landmark.anchor_y_m};
        landmark.anchor_x_m = anchor.x_m;
        landmark.anchor_y_m = anchor.y_m;
        landmark.set_beta(landmark.beta_rad + part.yaw_rad);
        landmark.doubt = relocation.left(landmark.doubt);
        landmark.drift_m2 = std::min(landmark.drift_m2, landmark.doubt.m2 + sigma_m * sigma_m);
        landmark.drift_rad2 = std::min(landmark.drift_rad2, landmark.doubt.rad2 + sigma_rad * sigma_rad);
    }
    before.count = 0;
    mean_ = relocation.correction * mean_;
    spread_ = Matrix<float, 3, 3>{};
    spread_(0, 0) = spread_(1, 1) = sigma_m * sigma_m;
    spread_(2, 2) = sigma_rad * sigma_rad;
    map_drift_ = Matrix<float, 3, 3>{};
    map_drift_(0, 0) = map_drift_(1, 1) = relocation.before.m2;
    map_drift_(2, 2) = relocation.before.rad2;
    result_.pose = mean_;
    result_.spread = spread_;
    result_.map_drift = map_drift_;
    rejoin();
}

}  // namespace noctule
