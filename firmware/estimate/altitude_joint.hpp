/// Joint Gaussian of height, climb, accelerometer biases, range scale errors, barometer offset and the elevations of all levels.
///
/// Model: docs/maths/altitude.md, equations (1) to (5). The levels are correlated with z through the readings that
/// made them; keeping the whole covariance is what makes the variance honest.
/// Frame Map (z up). SI units. All storage inside, no heap, not thread-safe.
/// double: the difference of two strongly correlated heights is known far better than either, which float would lose.
#pragma once

#include <array>
#include <cstddef>

#include "core/capacity.hpp"

namespace noctule {

class AltitudeJoint {
public:
    static constexpr std::size_t kZ = 0;          ///< height of the Body origin [m]
    static constexpr std::size_t kVz = 1;         ///< climb [m/s]
    static constexpr std::size_t kBias = 2;       ///< first of three: bias of the accelerometer along Body x, y, z [m/s^2]
    static constexpr std::size_t kScaleDown = 5;  ///< relative error of the downward range [-]
    static constexpr std::size_t kScaleUp = 6;    ///< relative error of the upward range [-]
    static constexpr std::size_t kBaro = 7;       ///< what the barometer reads at z = 0 [m]
    static constexpr std::size_t kFirstLevel = 8;
    static constexpr std::size_t kMaxStates = kFirstLevel + kMaxLevels;

    /// One linear reading: observation = sum of coefficient x state, at most five states take part.
    struct Row {
        std::array<std::size_t, 5> state{};
        std::array<double, 5> coefficient{};
        std::size_t count = 0;
        void add(const std::size_t s, const double c) {
            state[count] = s;
            coefficient[count] = c;
            ++count;
        }
    };

    /// Drops everything; the states before the levels get these means and variances, without correlation.
    void start(const std::array<double, kFirstLevel>& mean, const std::array<double, kFirstLevel>& variance);

    /// Third row of R_WB: how much of each Body axis points up.
    using Up = std::array<double, 3>;

    /// Mean over dt_s with the measured vertical acceleration (gravity removed, bias not). Equation (1).
    /// up zero: accel_up_m_s2 is free of bias.
    void predict_mean(double accel_up_m_s2, const Up& up, double dt_s);

    /// Covariance over dt_s with the mean of up over that time. accel_density in m/s^2/sqrt(Hz), bias_walk in
    /// m/s^2/sqrt(s), baro_walk in m/sqrt(s). Equation (2). Cost: states.
    void predict_covariance(double dt_s, const Up& up, double accel_density, double bias_walk, double baro_walk);

    /// Value that the row predicts, and its variance without the reading's own noise.
    [[nodiscard]] double expect(const Row& row) const;
    [[nodiscard]] double variance(const Row& row) const;

    /// Kalman step with one scalar reading. variance > 0. Cost: states squared. Equation (4).
    void correct(const Row& row, double observation, double variance);

    /// As correct, but only this state learns; the others keep mean and variance. The covariance stays a true one,
    /// equation (11). Cost: states.
    void correct_only(std::size_t state, const Row& row, double observation, double variance);

    /// Forgets the state and founds it anew as sum of coefficient x state + offset + noise; the row must not name it.
    void restart_state(std::size_t state, const Row& row, double offset, double variance);

    /// Appends the level L = sum of coefficient x state + offset + noise. False: full, nothing changed. Equation (5).
    [[nodiscard]] bool add_level(const Row& row, double offset, double variance);

    /// Forgets level i (marginalises it); the last level takes its index. i < levels().
    void remove_level_unordered(std::size_t i);

    /// Adds to the variance of z and of the climb alone: something pushed the vehicle that the model does not know.
    void loosen(double z_var_m2, double vz_var_m2_s2);

    [[nodiscard]] std::size_t levels() const { return states_ - kFirstLevel; }
    [[nodiscard]] double mean(const std::size_t i) const { return mean_[i]; }
    [[nodiscard]] double covariance(const std::size_t i, const std::size_t j) const { return P_[i][j]; }

private:
    std::size_t states_ = kFirstLevel;
    std::array<double, kMaxStates> mean_{};
    std::array<std::array<double, kMaxStates>, kMaxStates> P_{};  ///< symmetric, both halves kept
};

}  // namespace noctule
