/// Geometric verification of matches: the similarity or homography that most of them agree on.
///
/// Model: docs/maths/vision.md, "Verification", equations (8) to (10): random samples of two (similarity) or four (homography) pairs,
/// the transform with most pairs within the tolerance, then least squares over those. The draw is our own generator from a fixed
/// seed: the same matches give the same answer. Unit px. No heap.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/bounded.hpp"
#include "core/capacity.hpp"

namespace noctule {

/// One match: (x, y) in the first image, (u, v) in the second.
struct PointPair {
    float x_px = 0.0F;
    float y_px = 0.0F;
    float u_px = 0.0F;
    float v_px = 0.0F;
};

struct PlaneFitSettings {
    float tolerance_px = 3.0F;       ///< a pair agrees within this distance in the second image
    std::int32_t trials = 500;       ///< samples drawn at most; fewer once a good share agrees
    std::uint32_t seed = 1;          ///< of the draw
};

struct PlaneFit {
    std::array<double, 9> H{};       ///< row-major, first image to second, H[8] = 1
    std::int32_t inliers = 0;        ///< pairs that agree
    std::array<bool, kMaxSurfFeatures> agrees{};  ///< of each pair
};

/// Similarity (turn, scale, shift) by RANSAC. False: fewer than two pairs, or no sample with a scale of 1/8 to 8.
[[nodiscard]] bool fit_similarity(std::span<const PointPair> pairs, const PlaneFitSettings& settings, PlaneFit& out);

/// Homography by RANSAC. False: fewer than four pairs, or no sample that keeps the order of the corners (no mirror, no fold).
/// At most kMaxSurfFeatures pairs are looked at.
[[nodiscard]] bool fit_homography(std::span<const PointPair> pairs, const PlaneFitSettings& settings, PlaneFit& out);

/// H applied to (x, y); false: the point lies at infinity or behind.
[[nodiscard]] bool map_point(const std::array<double, 9>& H, double x_px, double y_px, double& u_px, double& v_px);

}  // namespace noctule
