/// Gaussians of two dimensions, as the wall filter needs them.
#pragma once

#include <cmath>

#include "core/matrix.hpp"

namespace noctule {

/// Symmetric 2x2 covariance of a line (rho, alpha), units m^2, m rad, rad^2.
struct LineCovariance {
    float rho_rho = 0.0F;
    float rho_alpha = 0.0F;
    float alpha_alpha = 0.0F;

    [[nodiscard]] float determinant() const { return rho_rho * alpha_alpha - rho_alpha * rho_alpha; }

    [[nodiscard]] LineCovariance operator+(const LineCovariance& other) const {
        return {rho_rho + other.rho_rho, rho_alpha + other.rho_alpha, alpha_alpha + other.alpha_alpha};
    }
    [[nodiscard]] LineCovariance scaled(const float factor) const {
        return {factor * rho_rho, factor * rho_alpha, factor * alpha_alpha};
    }
    /// Covariance of (rho + lever * alpha, alpha).
    [[nodiscard]] LineCovariance sheared(const float lever_m) const {
        return {rho_rho + 2.0F * lever_m * rho_alpha + lever_m * lever_m * alpha_alpha, rho_alpha + lever_m * alpha_alpha, alpha_alpha};
    }
    /// v^T C^-1 v. The determinant must be positive.
    [[nodiscard]] float distance_squared(const float d_rho, const float d_alpha) const {
        return (alpha_alpha * d_rho * d_rho - 2.0F * rho_alpha * d_rho * d_alpha + rho_rho * d_alpha * d_alpha) / determinant();
    }
};

/// log N(v; 0, c), in 1/(m rad). The determinant must be positive.
[[nodiscard]] inline float log_density(const float d_rho, const float d_alpha, const LineCovariance& c) {
    constexpr float kLogTwoPi = 1.83787706640935F;
    return -0.5F * c.distance_squared(d_rho, d_alpha) - kLogTwoPi - 0.5F * std::log(c.determinant());
}

}  // namespace noctule
