/// Position, velocity and yaw from the inertial sensor, corrected by what the laser says.
///
/// State: x, y [m], yaw [rad], vx, vy [m/s] in Map; accelerometer bias x, y [m/s^2] in Body; gyro bias z [rad/s]; what the error of
/// roll and pitch adds to the accelerations x, y [m/s^2] in Body, which fades.
/// Prediction: algorithms B with Z-Y-X rotation, roll and pitch given. Model and tuning: docs/maths/localisation.md#motion.
/// Not thread-safe, no heap; 1.8 kB. Cost of predict: four products of 10x10 matrices.
#pragma once

#include <array>
#include <cstddef>

#include "core/matrix.hpp"
#include "estimate/motion.hpp"
#include "params.gen.hpp"

namespace noctule {

class InertialFilter {
public:
    static constexpr std::size_t kX = 0, kY = 1, kYaw = 2, kVx = 3, kVy = 4, kBiasX = 5, kBiasY = 6, kBiasYaw = 7, kTiltX = 8, kTiltY = 9, kStates = 10;
    using Vector = Matrix<double, kStates, 1>;
    using Square = Matrix<double, kStates, kStates>;

    /// One inertial reading with the attitude at its time.
    struct Input {
        std::array<double, 3> accel_m_s2{};
        std::array<double, 3> gyro_rad_s{};
        double roll_rad = 0.0;
        double pitch_rad = 0.0;
    };

    explicit InertialFilter(const Parameters& parameters) : parameters_(parameters) { start(); }

    /// At rest at the Map origin, biases unknown.
    void start();

    /// Opens a new increment at the present pose.
    void mark();

    /// Advance by dt_s in (0, 1] with an input that held for that time.
    void predict(const Input& input, double dt_s);

    /// Advance by dt_s > 0 without inertial data: straight on, with the doubt that goes with it.
    void coast(double dt_s);

    /// Motion since mark(), with its covariance.
    [[nodiscard]] MotionIncrement increment() const;

    /// Kalman update in information form. Directions in which lambda is zero change nothing.
    void correct(const LaserInformation& laser);

    /// The pose as the wall filter has it (their frames may drift apart by sampling); covariances stay.
    void place(double x_m, double y_m, double yaw_rad);

    /// A place was recognised: the pose jumps and is known this well, independently of all else; velocity turns along.
    void relocate(double x_m, double y_m, double yaw_rad, double sigma_m, double sigma_rad);

    /// Adds independent doubt to velocity, as after a gap. Standard deviation, >= 0.
    void widen_velocity(double sigma_m_s);

    /// No vehicle is faster than it may fly: once velocity is in greater doubt than that, it is drawn to within it.
    void bound_speed(double most_m_s);

    [[nodiscard]] const Vector& state() const { return x_; }
    [[nodiscard]] const Square& covariance() const { return p_; }
    [[nodiscard]] double yaw_rate_rad_s() const { return yaw_rate_rad_s_; }

    /// State transition of one prediction and its Jacobian, the fading left out; static so that a law can check it.
    static Vector propagate(const Vector& x, const Input& input, double dt_s, Square& J_next_now);

private:
    /// Takes the blind direction out of what a gain does to place, velocity and the errors of acceleration.
    void keep_along(Matrix<double, kStates, 3>& k, double blind_rad) const;
    void advance(const Square& J_next_now, const Square& noise);

    const Parameters& parameters_;
    Vector x_;
    Square p_;
    Square p_increment_;   ///< covariance as if the pose had been known exactly at mark()
    double mark_x_m_ = 0.0;
    double mark_y_m_ = 0.0;
    double mark_yaw_rad_ = 0.0;
    double mark_dt_s_ = 0.0;
    double yaw_rate_rad_s_ = 0.0;
};

}  // namespace noctule
