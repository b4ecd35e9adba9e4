/// The estimate of the last scan, carried to any later time with the inertial data that came since.
///
/// Model: algorithms B over the few samples between; docs/maths/localisation.md#output. Frame Map. The autopilot gets this 60 times
/// a second. Storage: a ring of kMaxPredictorSamples samples (the oldest give way). No heap. Cost of odometry: one pass over the ring.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/capacity.hpp"
#include "estimate/estimate.hpp"
#include "params.gen.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// Pose and velocity for the autopilot's estimator, fields as odom_t.
struct Odometry {
    std::int64_t t_us = 0;
    bool at_scan = false;           ///< t_us is a scan's stamp and this is the estimate itself
    float x_m = 0.0F;               ///< frame Map
    float y_m = 0.0F;
    float z_m = 0.0F;
    float roll_rad = 0.0F;
    float pitch_rad = 0.0F;
    float yaw_rad = 0.0F;
    float vx_m_s = 0.0F;            ///< frame Map
    float vy_m_s = 0.0F;
    float vz_m_s = 0.0F;
    float yaw_rate_rad_s = 0.0F;
    std::array<float, 3> position_var_m2{};
    float yaw_var_rad2 = 0.0F;
    std::array<float, 3> velocity_var_m2_s2{};
    std::int32_t quality = -1;      ///< -1: lost, or no fresh scan (parameter stale_scan_s)
    std::int32_t reset_counter = 0;
};

class OutputPredictor {
public:
    explicit OutputPredictor(const Parameters& parameters) : parameters_(parameters) {}

    /// A new estimate. Its time must not lie before the one given last; an older one is ignored.
    void correct(const Estimate& estimate);

    /// Samples in rising time; one that is not finite or not newer than the last is ignored and counted.
    void add(const ImuSample& sample);
    void add(const AttitudeSample& sample);

    /// Pose at t_us. False: no estimate yet, or t_us lies before the last one; out is then unchanged.
    [[nodiscard]] bool odometry(std::int64_t t_us, Odometry& out) const;

    [[nodiscard]] std::uint32_t refused() const { return refused_; }

private:
    const Parameters& parameters_;
    bool started_ = false;
    Estimate estimate_;
    std::array<ImuSample, kMaxPredictorSamples> imu_{};  ///< ring, newest at newest_
    std::size_t count_ = 0;
    std::size_t newest_ = 0;
    AttitudeSample attitude_;
    bool have_attitude_ = false;
    std::uint32_t refused_ = 0;
};

}  // namespace noctule
