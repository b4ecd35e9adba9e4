#include "recognise/parallax.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {
namespace {

constexpr double kStep_m = 0.15;         // lines of sight from places nearer to each other err alike
constexpr double kSigma_rad = 0.010;     // tilt, heading, and what is the middle of a thing from another side

}  // namespace

bool Parallax::add(const Vec3& eye_m, const double bearing_rad, const double slope, const double distance_m) {
    const double moved_m = std::hypot(eye_m[0] - last_m_[0], eye_m[1] - last_m_[1], eye_m[2] - last_m_[2]);
    if (places_ > 0 && moved_m < kStep_m) { return false; }
    const double length = std::hypot(1.0, slope);
    const Vec3 d{std::cos(bearing_rad) / length, std::sin(bearing_rad) / length, slope / length};
    const double w = 1.0 / std::max(distance_m * distance_m, 0.25);
    const std::array<double, 6> m{w * (1.0 - d[0] * d[0]), -w * d[0] * d[1],        -w * d[0] * d[2],
                                  w * (1.0 - d[1] * d[1]), -w * d[1] * d[2], w * (1.0 - d[2] * d[2])};
    for (std::size_t i = 0; i < m.size(); ++i) { information_[i] += m[i]; }
    const Vec3 moment{m[0] * eye_m[0] + m[1] * eye_m[1] + m[2] * eye_m[2], m[1] * eye_m[0] + m[3] * eye_m[1] + m[4] * eye_m[2],
                      m[2] * eye_m[0] + m[4] * eye_m[1] + m[5] * eye_m[2]};
    for (std::size_t i = 0; i < moment.size(); ++i) {
        moment_[i] += moment[i];
        square_ += moment[i] * eye_m[i];
    }
    last_m_ = eye_m;
    ++places_;
    return true;
}

void Parallax::add(const Parallax& other) {
    for (std::size_t i = 0; i < information_.size(); ++i) { information_[i] += other.information_[i]; }
    for (std::size_t i = 0; i < moment_.size(); ++i) { moment_[i] += other.moment_[i]; }
    square_ += other.square_;
    if (places_ == 0) { last_m_ = other.last_m_; }
    places_ += other.places_;
}

bool Parallax::meet(Meeting& out) const {
    if (places_ < 2) { return false; }
    const auto& m = information_;
    // Inverse of the symmetric 3 x 3 by cofactors.
    const double c00 = m[3] * m[5] - m[4] * m[4];
    const double c01 = m[2] * m[4] - m[1] * m[5];
    const double c02 = m[1] * m[4] - m[2] * m[3];
    const double det = m[0] * c00 + m[1] * c01 + m[2] * c02;
    const double trace = m[0] + m[3] + m[5];
    if (!(det > 1.0e-9 * trace * trace * trace)) { return false; }
    const double c11 = m[0] * m[5] - m[2] * m[2];
    const double c12 = m[1] * m[2] - m[0] * m[4];
    const double c22 = m[0] * m[3] - m[1] * m[1];
    out.point_m = {(c00 * moment_[0] + c01 * moment_[1] + c02 * moment_[2]) / det, (c01 * moment_[0] + c11 * moment_[1] + c12 * moment_[2]) / det,
               (c02 * moment_[0] + c12 * moment_[1] + c22 * moment_[2]) / det};
    // The trace of the covariance is at most three times, and at least once, its greatest value: one direction is the poor one here.
    out.sigma_m = kSigma_rad * std::sqrt((c00 + c11 + c22) / det);
    const double left = square_ - out.point_m[0] * moment_[0] - out.point_m[1] * moment_[1] - out.point_m[2] * moment_[2];
    out.apart_rad = std::sqrt(std::max(left, 0.0) / places_);
    return true;
}

}  // namespace noctule
