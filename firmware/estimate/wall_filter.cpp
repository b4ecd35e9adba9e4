#include "estimate/wall_filter.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace noctule {

namespace {

constexpr float kDirectionGate = 0.96F;   // cosine of 16 degrees
constexpr float kOffsetGate_m = 0.6F;     // across the wall; the statistical gate is far inside
// Walls that differ in direction by less than its root (1 degree) count as parallel.
constexpr float kParallel_rad2 = 3.0e-4F;
// Doubt about a wall's direction in the product with the place along it (4.5 mrad).
constexpr float kSlide_rad2 = 2.0e-5F;
constexpr double kRounding = 1.0e-6;        // of what float loses of a sum of squares
// What is left in the next step of doubt about the frame once a wall is met that was tied better: it must be met for a while.
constexpr float kDriftLeft = 0.98F;

[[nodiscard]] Matrix<float, 3, 3> turned(const Matrix<float, 3, 3>& p, const float yaw_rad) {
    Matrix<float, 3, 3> turn = Matrix<float, 3, 3>::identity();
    const float c = std::cos(yaw_rad);
    const float s = std::sin(yaw_rad);
    turn(0, 0) = c;
    turn(0, 1) = -s;
    turn(1, 0) = s;
    turn(1, 1) = c;
    return turn * p * transpose(turn);
}

/// H_x P H_x^T for a wall in direction beta (algorithms D).
[[nodiscard]] LineCovariance seen_from(const Matrix<float, 3, 3>& p, const float c, const float s) {
    return {c * c * p(0, 0) + 2.0F * c * s * p(0, 1) + s * s * p(1, 1), c * p(0, 2) + s * p(1, 2), p(2, 2)};
}

/// What a landmark's doubtful direction adds across the wall, in rho^2: the product of two errors, direction and place along the wall
/// (docs/maths/localisation.md, equation 7). Without it two nearly parallel walls seem to say where along them the vehicle is.
[[nodiscard]] float slide_variance(const Matrix<float, 3, 3>& p, const float c, const float s) {
    const float along_m2 = s * s * p(0, 0) - 2.0F * c * s * p(0, 1) + c * c * p(1, 1);
    return kSlide_rad2 * along_m2;
}

[[nodiscard]] bool drop_phantom_direction(Matrix<double, 3, 3>& lambda, Matrix<double, 3, 1>& b, double& direction_rad);

/// P (I + Lambda P)^-1 without phantom directions. In double: metres along a corridor beside tenths of millimetres across.
[[nodiscard]] Matrix<float, 3, 3> left_after(const Matrix<float, 3, 3>& p, const Matrix<float, 3, 3>& lambda) {
    Matrix<double, 3, 3> wide_p;
    Matrix<double, 3, 3> wide_lambda;
    for (std::size_t k = 0; k < 9; ++k) {
        wide_p.values[k] = static_cast<double>(p.values[k]);
        wide_lambda.values[k] = static_cast<double>(lambda.values[k]);
    }
    // In float a covariance of tens of metres by millimetres, turned, need not be positive.
    const double rounding_m2 = kRounding * (wide_p(0, 0) + wide_p(1, 1));
    wide_p(0, 0) += rounding_m2;
    wide_p(1, 1) += rounding_m2;
    Matrix<double, 3, 1> none;
    double direction_rad = 0.0;
    static_cast<void>(drop_phantom_direction(wide_lambda, none, direction_rad));
    Matrix<double, 3, 3> gain;
    if (!invert(Matrix<double, 3, 3>::identity() + wide_lambda * wide_p, gain)) { return p; }
    const Matrix<double, 3, 3> left = wide_p * gain;
    Matrix<float, 3, 3> out;
    for (std::size_t k = 0; k < 9; ++k) { out.values[k] = static_cast<float>(left.values[k]); }
    symmetrise(out);
    return out;
}

/// Positive part of a symmetric matrix, position and yaw taken apart, no variance of position above most_m2.
[[nodiscard]] Matrix<float, 3, 3> positive_part(const Matrix<float, 3, 3>& a, const float most_m2) {
    Matrix<float, 3, 3> out;
    const Eigen2<float> eigen = eigen_symmetric(a(0, 0), a(0, 1), a(1, 1));
    const float c = std::cos(eigen.direction_rad);
    const float s = std::sin(eigen.direction_rad);
    const float large = std::clamp(eigen.large, 0.0F, most_m2);
    const float small = std::clamp(eigen.small, 0.0F, most_m2);
    out(0, 0) = large * c * c + small * s * s;
    out(0, 1) = (large - small) * c * s;
    out(1, 0) = out(0, 1);
    out(1, 1) = large * s * s + small * c * c;
    out(2, 2) = std::max(0.0F, a(2, 2));
    return out;
}

/// Removes the direction in which only the doubtful directions of parallel walls seem to say something (as slide_variance).
/// True if there was one; it is then in direction_rad.
[[nodiscard]] bool drop_phantom_direction(Matrix<double, 3, 3>& lambda, Matrix<double, 3, 1>& b, double& direction_rad) {
    const Eigen2<double> eigen = eigen_symmetric(lambda(0, 0), lambda(0, 1), lambda(1, 1));
    if (eigen.small > static_cast<double>(kParallel_rad2) * eigen.large || !(eigen.large > 0.0)) { return false; }
    direction_rad = eigen.direction_rad + 0.5 * static_cast<double>(kPi);
    const double c = std::cos(eigen.direction_rad);
    const double s = std::sin(eigen.direction_rad);
    Matrix<double, 3, 3> keep;
    keep.values = {c * c, c * s, 0.0, c * s, s * s, 0.0, 0.0, 0.0, 1.0};
    lambda = keep * lambda * keep;
    b = keep * b;
    return true;
}

}  // namespace

std::size_t WallFilter::count() const {
    return static_cast<std::size_t>(std::clamp<std::int32_t>(parameters_.particles, 1, static_cast<std::int32_t>(kMaxParticles)));
}

void WallFilter::start(const Pose2<Map, Body>& pose) {
    for (Particle& particle : particles_) {
        particle.pose = pose;
        particle.log_weight = 0.0F;
        particle.count = 0;
    }
    mean_ = pose;
    spread_ = Matrix<float, 3, 3>{};
    predicted_covariance_ = spread_;
    whole_covariance_ = spread_;
    map_drift_ = spread_;
    best_ = 0;
}

Matrix<float, 3, 3> WallFilter::slowly(const Matrix<float, 3, 3>& drift) const {
    return drift + positive_part(kDriftLeft * map_drift_ - drift, std::numeric_limits<float>::infinity());
}

void WallFilter::predict(const MotionIncrement& motion) {
    motion_covariance_ = motion.covariance;
    step_m_ = std::hypot(motion.dx_m, motion.dy_m);
    motion_covariance_(0, 0) += parameters_.motion_floor_m * parameters_.motion_floor_m;
    motion_covariance_(1, 1) += parameters_.motion_floor_m * parameters_.motion_floor_m;
    motion_covariance_(2, 2) += parameters_.motion_floor_rad * parameters_.motion_floor_rad;
    const Pose2<Body, Body> step{motion.dx_m, motion.dy_m, motion.dyaw_rad};
    for (std::size_t i = 0; i < count(); ++i) {
        Pose2<Map, Body>& pose = particles_[i].pose;
        pose = pose * step;
        predicted_[i] = pose;
    }
    mean_ = mean_ * step;
    // What the source of motion knows to be uncertain and the particles do not yet show (docs/maths/localisation.md, equation 9).
    const Matrix<float, 3, 3> shown = spread_ + turned(motion_covariance_, mean_.yaw_rad);
    const float unlimited = std::numeric_limits<float>::infinity();
    whole_covariance_ = shown + positive_part(motion.pose_covariance - shown, unlimited);
    predicted_covariance_ = shown + positive_part(motion.pose_covariance - shown, kSearchable_m2);
    // A cloud wider than what counts as lost would not be searched by a hundred particles, only scattered: it grows no further.
    const float room_m2 = parameters_.lost_sigma_m * parameters_.lost_sigma_m - eigen_symmetric(shown(0, 0), shown(0, 1), shown(1, 1)).large;
    widening_ = positive_part(motion.pose_covariance - shown, std::max(0.0F, room_m2));
}

std::int32_t WallFilter::associate(const Particle& particle, const Belief& belief, const WallObservation& wall) const {
    const float gamma_rad = wall.alpha_rad + belief.pose.yaw_rad;
    const float c = std::cos(gamma_rad);
    const float s = std::sin(gamma_rad);
    const float rx = wall.rho_m * c;
    const float ry = wall.rho_m * s;
    const Point2<Map> middle{belief.pose.x_m + rx - wall.lever_m * s, belief.pose.y_m + ry + wall.lever_m * c};
    const float half_from_m = wall.from_m - wall.lever_m;
    const float half_to_m = wall.to_m - wall.lever_m;
    const float gap_m = parameters_.association_gap_m;
    const LineCovariance floor{parameters_.association_floor_m * parameters_.association_floor_m, 0.0F,
                               parameters_.association_floor_rad * parameters_.association_floor_rad};
    const LineCovariance gate_noise = wall.covariance + floor.sheared(wall.lever_m);
    std::int32_t best = -1;
    float best_density = std::log(parameters_.new_wall_density);
    for (std::int32_t i = 0; i < particle.count; ++i) {
        const Landmark& landmark = particle.landmarks[static_cast<std::size_t>(i)];
        if (landmark.cos_beta * c + landmark.sin_beta * s < kDirectionGate) { continue; }
        if (std::abs(landmark.before(middle.x_m, middle.y_m)) > kOffsetGate_m) { continue; }
        const float along_m = landmark.along(middle.x_m, middle.y_m);
        if (along_m + half_from_m > landmark.to_m + gap_m || along_m + half_to_m < landmark.from_m - gap_m) { continue; }
        const LineMeasurement expected = landmark.predict(belief.pose);
        const float lever_m = landmark.along(belief.pose.x_m, belief.pose.y_m);
        const LineCovariance total = seen_from(belief.p, landmark.cos_beta, landmark.sin_beta) + landmark.covariance.sheared(-lever_m) + gate_noise +
                                     LineCovariance{slide_variance(predicted_covariance_, landmark.cos_beta, landmark.sin_beta), 0.0F, 0.0F};
        const float density = log_density(wall.rho_m - expected.rho_m, wrap_angle(wall.alpha_rad - expected.alpha_rad), total);
        if (density > best_density) {
            best_density = density;
            best = i;
        }
    }
    return best;
}

float WallFilter::fuse(const Landmark& landmark, const WallObservation& wall, const Pose2<Map, Body>& predicted, Belief& belief,
                       Assignment& assignment) const {
    const LineMeasurement expected = landmark.predict(belief.pose);
    const float d_rho = wall.rho_m - expected.rho_m;
    const float d_alpha = wrap_angle(wall.alpha_rad - expected.alpha_rad);
    const float c = landmark.cos_beta;
    const float s = landmark.sin_beta;
    // R = H_F F H_F^T + Q, S = H_x P H_x^T + R
    LineCovariance noise = landmark.covariance.sheared(-landmark.along(belief.pose.x_m, belief.pose.y_m)) + wall.covariance +
                           LineCovariance{slide_variance(predicted_covariance_, c, s), 0.0F, 0.0F};
    const LineCovariance prior = seen_from(belief.p, c, s);
    LineCovariance total = prior + noise;
    const float limit2 = parameters_.outlier_sigma * parameters_.outlier_sigma;
    const float d2 = total.distance_squared(d_rho, d_alpha);
    assignment.distance2 = d2;
    assignment.noise_scale = 1.0F;
    if (d2 > limit2) {
        assignment.noise_scale = d2 / limit2;
        noise = noise.scaled(assignment.noise_scale);
        total = prior + noise;
    }
    const float density = log_density(d_rho, d_alpha, total);

    // K = P H_x^T S^-1 with H_x = [[-c, -s, 0], [0, 0, -1]]
    const float determinant = total.determinant();
    const float i_rr = total.alpha_alpha / determinant;
    const float i_ra = -total.rho_alpha / determinant;
    const float i_aa = total.rho_rho / determinant;
    std::array<float, 3> g_rho{};    // P H_x^T, first column
    std::array<float, 3> g_alpha{};  // second column
    for (std::size_t i = 0; i < 3; ++i) {
        g_rho[i] = -c * belief.p(i, 0) - s * belief.p(i, 1);
        g_alpha[i] = -belief.p(i, 2);
    }
    // What the laser alone says, about the predicted pose: Lambda += H^T R^-1 H, b += H^T R^-1 (z - h(predicted)).
    const float n_det = noise.determinant();
    const float n_rr = noise.alpha_alpha / n_det;
    const float n_ra = -noise.rho_alpha / n_det;
    const float n_aa = noise.rho_rho / n_det;
    const float moved_rho = d_rho - c * (belief.pose.x_m - predicted.x_m) - s * (belief.pose.y_m - predicted.y_m);
    const float moved_alpha = d_alpha - wrap_angle(belief.pose.yaw_rad - predicted.yaw_rad);
    const float w_rho = n_rr * moved_rho + n_ra * moved_alpha;
    const float w_alpha = n_ra * moved_rho + n_aa * moved_alpha;
    belief.lambda(0, 0) += c * c * n_rr;
    belief.lambda(0, 1) += c * s * n_rr;
    belief.lambda(1, 1) += s * s * n_rr;
    belief.lambda(0, 2) += c * n_ra;
    belief.lambda(1, 2) += s * n_ra;
    belief.lambda(2, 2) += n_aa;
    belief.b(0, 0) += -c * w_rho;
    belief.b(1, 0) += -s * w_rho;
    belief.b(2, 0) += -w_alpha;

    const float y_rho = i_rr * d_rho + i_ra * d_alpha;
    const float y_alpha = i_ra * d_rho + i_aa * d_alpha;
    belief.pose.x_m += g_rho[0] * y_rho + g_alpha[0] * y_alpha;
    belief.pose.y_m += g_rho[1] * y_rho + g_alpha[1] * y_alpha;
    belief.pose.yaw_rad = wrap_angle(belief.pose.yaw_rad + g_rho[2] * y_rho + g_alpha[2] * y_alpha);
    for (std::size_t i = 0; i < 3; ++i) {
        const float k_rho = g_rho[i] * i_rr + g_alpha[i] * i_ra;
        const float k_alpha = g_rho[i] * i_ra + g_alpha[i] * i_aa;
        for (std::size_t j = 0; j < 3; ++j) { belief.p(i, j) -= k_rho * g_rho[j] + k_alpha * g_alpha[j]; }
    }
    symmetrise(belief.p);
    return density;
}

void WallFilter::fuse_match(const PoseMatch& match, const Pose2<Map, Body>& predicted, Belief& belief) {
    Matrix<float, 3, 3> gain;
    if (!invert(Matrix<float, 3, 3>::identity() + match.lambda * belief.p, gain)) { return; }
    Matrix<float, 3, 1> off;
    off.values = {match.pose.x_m - belief.pose.x_m, match.pose.y_m - belief.pose.y_m, wrap_angle(match.pose.yaw_rad - belief.pose.yaw_rad)};
    const Matrix<float, 3, 1> step = belief.p * (gain * (match.b + match.lambda * off));
    Matrix<float, 3, 1> from_predicted;
    from_predicted.values = {match.pose.x_m - predicted.x_m, match.pose.y_m - predicted.y_m, wrap_angle(match.pose.yaw_rad - predicted.yaw_rad)};
    belief.b += match.b + match.lambda * from_predicted;
    // The upper triangle alone is kept during the update.
    for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = i; j < 3; ++j) { belief.lambda(i, j) += match.lambda(i, j); }
    }
    belief.p = belief.p * gain;  // P (I + Lambda P)^-1
    symmetrise(belief.p);
    belief.pose = {belief.pose.x_m + step(0, 0), belief.pose.y_m + step(1, 0), wrap_angle(belief.pose.yaw_rad + step(2, 0))};
}

void WallFilter::update_particle(Particle& particle, const std::size_t index, const WallObservations& walls, const PoseMatch& match) {
    Belief belief;
    belief.pose = particle.pose;
    belief.p = turned(motion_covariance_, particle.pose.yaw_rad) + widening_;
    const Pose2<Map, Body> predicted = particle.pose;
    std::array<Assignment, kMaxWallsPerScan> assigned{};
    std::array<bool, kMaxLandmarks> associated{};
    const float log_new = std::log(parameters_.new_wall_density);
    std::int32_t matched = 0;
    // Longest walls first: what they say narrows the gates of the others.
    for (std::size_t j = 0; j < walls.size(); ++j) {
        const std::int32_t l = associate(particle, belief, walls[j]);
        assigned[j].landmark = l;
        if (l < 0) {
            particle.log_weight += log_new;
            continue;
        }
        ++matched;
        associated[static_cast<std::size_t>(l)] = true;
        const float density = fuse(particle.landmarks[static_cast<std::size_t>(l)], walls[j], predicted, belief, assigned[j]);
        if (index == best_ && assigned[j].distance2 < kSound2) { ++sound_; }
        particle.log_weight += std::max(log_new, density);
    }
    if (match.valid) { fuse_match(match, predicted, belief); }
    belief.lambda(1, 0) = belief.lambda(0, 1);
    belief.lambda(2, 0) = belief.lambda(0, 2);
    belief.lambda(2, 1) = belief.lambda(1, 2);
    lambda_[index] = belief.lambda;
    b_[index] = belief.b;
    matched_[index] = matched;

    const Matrix<float, 3, 3> root = cholesky(belief.p);
    Matrix<float, 3, 1> draw;
    draw.values = {random_.normal(), random_.normal(), random_.normal()};
    const Matrix<float, 3, 1> offset = root * draw;
    particle.pose = {belief.pose.x_m + offset(0, 0), belief.pose.y_m + offset(1, 0), wrap_angle(belief.pose.yaw_rad + offset(2, 0))};

    // Pose against Map's start: how well the scan ties it to the walls, and how well those are tied.
    drift_[index] = slowly(drift_of(particle, assigned, walls.size()));
    Matrix<float, 3, 3> absolute = drift_[index] + left_after(whole_covariance_, belief.lambda);
    absolute(0, 0) += tilt_m2_;
    absolute(1, 1) += tilt_m2_;
    absolute(2, 2) += tilt_rad2_;
    for (std::size_t j = 0; j < walls.size(); ++j) {
        if (assigned[j].landmark >= 0) {
            learn(particle.landmarks[static_cast<std::size_t>(assigned[j].landmark)], walls[j], particle.pose, assigned[j].noise_scale);
        }
    }
    if (parameters_.visibility_through == 0 || (step_ + index) % kLookPeriod == 0) { look_for_landmarks(particle, associated); }
    for (std::size_t j = 0; j < walls.size(); ++j) {
        if (assigned[j].landmark >= 0) { continue; }
        // Two pieces of one wall, a door between, may both be new in this sweep: the second goes to the landmark of the first.
        belief.pose = particle.pose;
        const std::int32_t l = associate(particle, belief, walls[j]);
        if (l >= 0) {
            learn(particle.landmarks[static_cast<std::size_t>(l)], walls[j], particle.pose, 1.0F);
        } else {
            tie(insert(particle, walls[j], particle.pose), particle.pose, absolute);
        }
    }
}

const WallFilter::Result& WallFilter::update(const WallObservations& walls, const PoseMatch& match, const LevelScan& scan) {
    if (following_) { rejoin(); }
    sound_ = 0;
    ++step_;
    prepare_bearings(scan);
    for (std::size_t i = 0; i < count(); ++i) { update_particle(particles_[i], i, walls, match); }
    judge_walls(walls, scan);
    if (parameters_.visibility_through != 0) {
        for (std::uint32_t k = 0; k < kMergesPerStep; ++k) { merge_landmarks(particles_[(step_ * kMergesPerStep + k) % count()]); }
    }
    summarise();
    const float limit = parameters_.resample_share * static_cast<float>(count());
    if (result_.effective_particles < limit || parameters_.resample_share >= 1.0F) { resample(); }
    return result_;
}

void WallFilter::summarise() {
    const std::size_t n = count();
    best_ = 0;
    for (std::size_t i = 1; i < n; ++i) {
        if (particles_[i].log_weight > particles_[best_].log_weight) { best_ = i; }
    }
    const float top = particles_[best_].log_weight;
    float sum = 0.0F;
    for (std::size_t i = 0; i < n; ++i) {
        particles_[i].log_weight -= top;
        weight_[i] = std::exp(particles_[i].log_weight);
        sum += weight_[i];
    }
    if (!std::isfinite(sum) || !(sum > 0.0F)) {
        ++counters_.restarts;
        for (std::size_t i = 0; i < n; ++i) {
            particles_[i].log_weight = 0.0F;
            weight_[i] = 1.0F;
        }
        sum = static_cast<float>(n);
    }
    float squares = 0.0F;
    double mx = 0.0;
    double my = 0.0;
    double myaw = 0.0;
    double px = 0.0;
    double py = 0.0;
    const float yaw_best = particles_[best_].pose.yaw_rad;
    for (std::size_t i = 0; i < n; ++i) {
        weight_[i] /= sum;
        squares += weight_[i] * weight_[i];
        const auto w = static_cast<double>(weight_[i]);
        mx += w * static_cast<double>(particles_[i].pose.x_m);
        my += w * static_cast<double>(particles_[i].pose.y_m);
        myaw += w * static_cast<double>(wrap_angle(particles_[i].pose.yaw_rad - yaw_best));
        px += w * static_cast<double>(predicted_[i].x_m);
        py += w * static_cast<double>(predicted_[i].y_m);
    }
    const Pose2<Map, Body> predicted_mean = mean_;
    mean_ = {static_cast<float>(mx), static_cast<float>(my), wrap_angle(yaw_best + static_cast<float>(myaw))};
    Matrix<float, 3, 3> spread;
    Matrix<double, 3, 3> lambda;
    Matrix<double, 3, 1> b;
    for (std::size_t i = 0; i < n; ++i) {
        Matrix<float, 3, 1> off;
        off.values = {particles_[i].pose.x_m - mean_.x_m, particles_[i].pose.y_m - mean_.y_m, wrap_angle(particles_[i].pose.yaw_rad - mean_.yaw_rad)};
        spread += weight_[i] * (off * transpose(off));
        const auto w = static_cast<double>(weight_[i]);
        for (std::size_t k = 0; k < 9; ++k) { lambda.values[k] += w * static_cast<double>(lambda_[i].values[k]); }
        for (std::size_t k = 0; k < 3; ++k) { b.values[k] += w * static_cast<double>(b_[i].values[k]); }
    }
    // Where the particles had been widened, choosing among them is what the laser said, too: it moves the predicted mean.
    const Eigen2<float> widest = eigen_symmetric(widening_(0, 0), widening_(0, 1), widening_(1, 1));
    if (widest.large > 0.0F) {
        const double c = std::cos(static_cast<double>(widest.direction_rad));
        const double s = std::sin(static_cast<double>(widest.direction_rad));
        const double shown = c * c * static_cast<double>(spread_(0, 0)) + 2.0 * c * s * static_cast<double>(spread_(0, 1)) + s * s * static_cast<double>(spread_(1, 1));
        const double share = static_cast<double>(widest.large) / (static_cast<double>(widest.large) + shown);
        const double moved = share * (c * (px - static_cast<double>(predicted_mean.x_m)) + s * (py - static_cast<double>(predicted_mean.y_m)));
        for (std::size_t k = 0; k < 3; ++k) { b(k, 0) += (lambda(k, 0) * c + lambda(k, 1) * s) * moved; }
    }
    double blind_rad = 0.0;
    const bool blind = drop_phantom_direction(lambda, b, blind_rad);
    if (blind) {
        // Choosing among particles must not move them where the scan says nothing: there the prediction stands.
        const float c = static_cast<float>(std::cos(blind_rad));
        const float s = static_cast<float>(std::sin(blind_rad));
        const float back_m = c * (predicted_mean.x_m - mean_.x_m) + s * (predicted_mean.y_m - mean_.y_m);
        for (std::size_t i = 0; i < n; ++i) {
            particles_[i].pose.x_m += back_m * c;
            particles_[i].pose.y_m += back_m * s;
        }
        mean_.x_m += back_m * c;
        mean_.y_m += back_m * s;
    }
    spread_ = spread;
    result_.pose = mean_;
    result_.spread = spread;
    map_drift_ = drift_[best_];
    result_.map_drift = map_drift_;
    result_.laser = {lambda, b, blind, blind_rad};
    result_.effective_particles = 1.0F / squares;
    result_.walls_matched = matched_[best_];
}

void WallFilter::resample() {
    // Low-variance sampler; survivors stay where they are and the others are overwritten, so that little is copied.
    const std::size_t n = count();
    std::array<std::uint16_t, kMaxParticles> copies{};
    const float step = 1.0F / static_cast<float>(n);
    float pointer = random_.uniform() * step;
    float cumulative = weight_[0];
    std::size_t i = 0;
    for (std::size_t k = 0; k < n; ++k) {
        while (pointer > cumulative && i + 1 < n) { cumulative += weight_[++i]; }
        ++copies[i];
        pointer += step;
    }
    std::size_t source = 0;
    for (std::size_t target = 0; target < n; ++target) {
        if (copies[target] > 0) { continue; }
        while (copies[source] < 2) { ++source; }
        --copies[source];
        copies[target] = 1;
        const Particle& from = particles_[source];
        Particle& to = particles_[target];
        to.pose = from.pose;
        to.count = from.count;
        std::copy_n(from.landmarks.begin(), from.count, to.landmarks.begin());
    }
    for (std::size_t k = 0; k < n; ++k) { particles_[k].log_weight = 0.0F; }
    ++counters_.resampled;
}

}  // namespace noctule
