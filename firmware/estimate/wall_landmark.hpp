/// One wall in the map, and the measurement model of algorithms D.
///
/// The published form is (r >= 0, alpha, v). Kept inside is the same line without its singular cases: beta, the direction in which
/// the observer looks at the wall, and s, the signed distance of the line from an anchor on the wall itself:
///     n(beta) . (p - anchor) = s,   v = +1: alpha = beta, r = s + n . anchor;   v = -1: alpha = beta + pi, r = -(s + n . anchor).
/// So a wall through the Map origin is no special case, and r and alpha do not become correlated far from the origin.
/// Derivation: docs/maths/localisation.md#landmark. Frame Map. 72 bytes, no heap.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/angle.hpp"
#include "core/frames.hpp"
#include "core/gaussian.hpp"
#include "core/matrix.hpp"
#include "estimate/relocation.hpp"
#include "sense/walls.hpp"

namespace noctule {

/// A line as algorithms C publishes it.
struct HessianLine {
    float r_m = 0.0F;
    float alpha_rad = 0.0F;
    std::int8_t v = 1;
};

/// (rho, alpha) of a wall in Body, as algorithms D predicts them.
struct LineMeasurement {
    float rho_m = 0.0F;
    float alpha_rad = 0.0F;
};

/// Algorithms D: z^ of landmark (r, alpha, v) seen from a pose.
[[nodiscard]] inline LineMeasurement predict_measurement(const HessianLine& line, const Pose2<Map, Body>& pose) {
    const auto v = static_cast<float>(line.v);
    return {v * (line.r_m - pose.x_m * std::cos(line.alpha_rad) - pose.y_m * std::sin(line.alpha_rad)),
            wrap_angle(line.alpha_rad - pose.yaw_rad + (1.0F - v) * 0.5F * kPi)};
}

/// Algorithms D: Jacobian of z^ with respect to (r, alpha).
[[nodiscard]] inline Matrix<float, 2, 2> J_measurement_line(const HessianLine& line, const Pose2<Map, Body>& pose) {
    const auto v = static_cast<float>(line.v);
    Matrix<float, 2, 2> J;
    J.values = {v, v * (pose.x_m * std::sin(line.alpha_rad) - pose.y_m * std::cos(line.alpha_rad)), 0.0F, 1.0F};
    return J;
}

/// Algorithms D: Jacobian of z^ with respect to (x, y, yaw).
[[nodiscard]] inline Matrix<float, 2, 3> J_measurement_pose(const HessianLine& line) {
    const auto v = static_cast<float>(line.v);
    Matrix<float, 2, 3> J;
    J.values = {-v * std::cos(line.alpha_rad), -v * std::sin(line.alpha_rad), 0.0F, 0.0F, 0.0F, -1.0F};
    return J;
}

/// Algorithms D: the landmark that explains measurement z from a pose.
[[nodiscard]] inline HessianLine line_from_measurement(const LineMeasurement& z, const Pose2<Map, Body>& pose) {
    const float beta_rad = wrap_angle(z.alpha_rad + pose.yaw_rad);
    const float s_m = z.rho_m + pose.x_m * std::cos(beta_rad) + pose.y_m * std::sin(beta_rad);
    if (s_m >= 0.0F) { return {s_m, beta_rad, 1}; }
    return {-s_m, wrap_angle(beta_rad + kPi), -1};
}

struct Landmark {
    float beta_rad = 0.0F;    ///< from the observed face into the wall
    float cos_beta = 1.0F;
    float sin_beta = 0.0F;
    float s_m = 0.0F;         ///< of the line, from the anchor along beta
    float anchor_x_m = 0.0F;
    float anchor_y_m = 0.0F;
    LineCovariance covariance;  ///< of (s, beta)
    float from_m = 0.0F;      ///< ends along (-sin, cos)(beta) from the anchor, from_m < to_m
    float to_m = 0.0F;
    // Doubt about the map's own frame where this wall was tied to it (docs/maths/localisation.md#drift).
    float drift_m2 = 0.0F;      ///< across the wall, of the pose from which it was tied
    float drift_rad2 = 0.0F;
    float tied_along_m = 0.0F;  ///< coordinate along the wall of that pose
    FrameDoubt doubt;           ///< of that pose, in all directions
    std::int8_t trust = 0;    ///< visibility counter
    bool changed = true;      ///< since it was last compared with the other walls of its particle
    std::int16_t seen = 0;    ///< sweeps that matched it

    /// Coordinate along the wall of a point, from the anchor.
    [[nodiscard]] float along(const float x_m, const float y_m) const {
        return -sin_beta * (x_m - anchor_x_m) + cos_beta * (y_m - anchor_y_m);
    }
    /// Distance of a point before the wall's observed face.
    [[nodiscard]] float before(const float x_m, const float y_m) const {
        return s_m - cos_beta * (x_m - anchor_x_m) - sin_beta * (y_m - anchor_y_m);
    }
    /// Variance, across the wall, of the map's frame as seen from a pose at this coordinate along the wall.
    [[nodiscard]] float drift_from(const float along_m) const {
        const float moved_m = along_m - tied_along_m;
        return drift_m2 + moved_m * moved_m * drift_rad2;
    }
    [[nodiscard]] Point2<Map> at(const float along_m) const {
        return {anchor_x_m + s_m * cos_beta - along_m * sin_beta, anchor_y_m + s_m * sin_beta + along_m * cos_beta};
    }
    [[nodiscard]] LineMeasurement predict(const Pose2<Map, Body>& pose) const {
        return {before(pose.x_m, pose.y_m), wrap_angle(beta_rad - pose.yaw_rad)};
    }
    void set_beta(const float angle_rad) {
        beta_rad = wrap_angle(angle_rad);
        cos_beta = std::cos(beta_rad);
        sin_beta = std::sin(beta_rad);
    }
    [[nodiscard]] HessianLine hessian() const {
        const float s0_m = s_m + cos_beta * anchor_x_m + sin_beta * anchor_y_m;
        if (s0_m >= 0.0F) { return {s0_m, beta_rad, 1}; }
        return {-s0_m, wrap_angle(beta_rad + kPi), -1};
    }
    /// Covariance of (s, beta) with s counted from the Map origin: variances of (r, alpha) are its diagonal.
    [[nodiscard]] LineCovariance covariance_at_origin() const {
        // d n(beta) / d beta . anchor is the shift of s per angle.
        return covariance.sheared(-sin_beta * anchor_x_m + cos_beta * anchor_y_m);
    }
};

/// (s, beta) of one landmark and its covariance, with s counted from another landmark's anchor.
[[nodiscard]] inline LineMeasurement line_from_anchor_of(const Landmark& landmark, const Landmark& other, LineCovariance& covariance) {
    const float dx_m = landmark.anchor_x_m - other.anchor_x_m;
    const float dy_m = landmark.anchor_y_m - other.anchor_y_m;
    covariance = landmark.covariance.sheared(-landmark.sin_beta * dx_m + landmark.cos_beta * dy_m);
    return {landmark.s_m + landmark.cos_beta * dx_m + landmark.sin_beta * dy_m, landmark.beta_rad};
}

/// Product of two Gaussians: the landmark takes in (s, beta) with a covariance, both from its own anchor.
inline void fuse_line(Landmark& landmark, const float d_s, const float d_beta, const LineCovariance& noise) {
    const LineCovariance f = landmark.covariance;
    const LineCovariance total = f + noise;
    const float determinant = total.determinant();
    const float i_ss = total.alpha_alpha / determinant;
    const float i_sb = -total.rho_alpha / determinant;
    const float i_bb = total.rho_rho / determinant;
    const float k_ss = f.rho_rho * i_ss + f.rho_alpha * i_sb;
    const float k_sb = f.rho_rho * i_sb + f.rho_alpha * i_bb;
    const float k_bs = f.rho_alpha * i_ss + f.alpha_alpha * i_sb;
    const float k_bb = f.rho_alpha * i_sb + f.alpha_alpha * i_bb;
    landmark.s_m += k_ss * d_s + k_sb * d_beta;
    landmark.set_beta(landmark.beta_rad + k_bs * d_s + k_bb * d_beta);
    // F (F + N)^-1 N: symmetric, positive, and nothing is subtracted.
    landmark.covariance = {k_ss * noise.rho_rho + k_sb * noise.rho_alpha, k_ss * noise.rho_alpha + k_sb * noise.alpha_alpha,
                           k_bs * noise.rho_alpha + k_bb * noise.alpha_alpha};
}

/// A new landmark from an observation made at a pose taken as exact. Its anchor is the middle of what was seen.
[[nodiscard]] inline Landmark make_landmark(const WallObservation& wall, const Pose2<Map, Body>& pose) {
    Landmark landmark;
    const Point2<Body> middle = wall.at(wall.lever_m);
    const Point2<Map> anchor = pose * middle;
    landmark.anchor_x_m = anchor.x_m;
    landmark.anchor_y_m = anchor.y_m;
    landmark.set_beta(wall.alpha_rad + pose.yaw_rad);
    landmark.covariance = wall.covariance.sheared(-wall.lever_m);
    landmark.from_m = wall.from_m - wall.lever_m;
    landmark.to_m = wall.to_m - wall.lever_m;
    return landmark;
}

}  // namespace noctule
