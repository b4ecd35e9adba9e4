/// How far the vehicle moved between two scans: the motion input of the wall filter.
///
/// It comes from the inertial filter on a vehicle, or from wheel odometry in a log. Frame: Body (level) at the earlier scan.
#pragma once

#include <array>

#include "core/matrix.hpp"

namespace noctule {

struct MotionIncrement {
    float dx_m = 0.0F;
    float dy_m = 0.0F;
    float dyaw_rad = 0.0F;
    float dt_s = 0.0F;
    Matrix<float, 3, 3> covariance;  ///< of (dx, dy, dyaw), m and rad
    /// Covariance of the whole predicted pose, frame Map, as far as the source knows it; zero if it keeps none. Where the laser
    /// has said nothing for a while (a corridor) it exceeds the spread of the particles, and the filter widens them to it.
    Matrix<float, 3, 3> pose_covariance;
};

/// What one scan says of the pose, without the prediction: Lambda dx = b about the predicted pose, frame Map.
struct LaserInformation {
    Matrix<double, 3, 3> lambda;
    Matrix<double, 3, 1> b;
    bool blind = false;       ///< there is a direction of which the scan says nothing; it is taken out of lambda and b
    double blind_rad = 0.0;   ///< that direction
};

}  // namespace noctule
