/// Height, climb and the levels under and over the vehicle from vertical acceleration and two range finders.
///
/// Model: x = (z, vz, accelerometer biases, two range scale errors, barometer offset, elevation of every level), one joint Gaussian
/// (AltitudeJoint). A range is the difference of z and one level, so a step in a range with no counterpart in z is a
/// new level, not a climb. Derivation, association and tuning: docs/maths/altitude.md. The paper's own form, which
/// takes z and the levels as independent, is AltitudePaper; the parameter alt_joint chooses at construction.
/// Frame Map (z up, zero at the floor of the start). SI units. One instance a vehicle, no heap, not thread-safe.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "estimate/altitude_joint.hpp"
#include "estimate/altitude_paper.hpp"
#include "estimate/altitude_reading.hpp"
#include "estimate/estimate.hpp"
#include "estimate/level.hpp"
#include "params.gen.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// Never decrease. Every range sample ends in exactly one of the first eight.
struct AltitudeCounters {
    std::uint32_t matched = 0;            ///< updated z and a level
    std::uint32_t founded = 0;            ///< became a tentative level
    std::uint32_t unmatched = 0;          ///< fitted no level and could not found one (tilt, or no room)
    std::uint32_t refused_empty = 0;      ///< NaN: the sensor had nothing to say
    std::uint32_t refused_input = 0;      ///< infinite, negative, or limits that make no sense
    std::uint32_t refused_range = 0;      ///< in the blind zone or at the maximum range
    std::uint32_t refused_tilt = 0;       ///< tilt beyond alt_tilt_max_rad
    std::uint32_t refused_time = 0;       ///< too late, from the future, or not newer than the one before
    std::uint32_t inertial_refused = 0;   ///< bad or untimely inertial and attitude samples
    std::uint32_t frames_refused = 0;     ///< frames whose scan is not newer than the one before
    std::uint32_t levels_confirmed = 0;
    std::uint32_t levels_forgotten = 0;   ///< tentative, not seen again
    std::uint32_t levels_merged = 0;
    std::uint32_t levels_evicted = 0;     ///< gave way because the pool was full
    std::uint32_t shifts = 0;             ///< a small step of a surface found in the mean of the innovations
    std::uint32_t drifts = 0;             ///< both ranges agreed that z was wrong
    std::uint32_t baro_used = 0;          ///< barometer samples that were taken; all three stay 0 while it is off
    std::uint32_t baro_refused = 0;       ///< not finite, absurd, untimely or beyond the gate
    std::uint32_t baro_restarts = 0;      ///< its offset had jumped and was founded anew
};

class AltitudeFilter {
public:
    /// Keeps the reference. Starts at rest on the floor: z = ground_clearance_m, level 0 at elevation zero.
    explicit AltitudeFilter(const Parameters& parameters);

    /// One frame. The estimate holds at the stamp of the scan. Bad samples are refused and counted.
    /// Cost: (levels + 8)^2 a range sample, whatever the length of the flight.
    const AltitudeEstimate& update(const SensorFrame& frame, const PlanarEstimate& planar);

    [[nodiscard]] const AltitudeEstimate& estimate() const { return estimate_; }

    /// Confirmed levels; entry 0 is the floor of the start.
    [[nodiscard]] const Bounded<Level, kMaxLevels>& levels() const { return published_; }

    /// Floors (facing +1) and ceilings (facing -1) of the building, lowest first, each with the variance of its elevation
    /// and the box in which it was seen. Levels that are one surface come as one. Empty in the paper's form.
    /// Cost: levels squared; for the moments when somebody asks.
    void surfaces(Bounded<Level, kMaxSurfaces>& out) const;

    [[nodiscard]] const AltitudeCounters& counters() const { return counters_; }

    /// Bias of the accelerometer along Body z (joint form).
    [[nodiscard]] float accel_bias_z_m_s2() const { return static_cast<float>(joint_.mean(AltitudeJoint::kBias + 2)); }

private:
    struct Slot {
        Level level;             ///< z_m and z_var_m2 are filled when published; the joint Gaussian owns them
        bool confirmed = false;
        std::uint32_t reading_at_birth = 0;
    };
    struct Match {
        std::int32_t slot = -1;  ///< -1: none
        double d2 = 0.0;         ///< squared normalised innovation
    };
    /// Running mean of the normalised innovations of one sensor against one level, in the sense of z.
    struct Watch {
        std::int32_t slot = -1;
        double mean = 0.0;
    };

    void start();
    void read_vehicle(const SensorFrame& frame);
    [[nodiscard]] bool read_range(const RangeSample& sample, RangeSide side, std::int64_t t_scan_us,
                                  const PlanarEstimate& planar, AltitudeReading& out);
    void set_attitude(const SensorFrame& frame, std::int64_t t_us);
    void propagate(const SensorFrame& frame, std::int64_t t_us);
    void advance(std::int64_t t_us, bool blind);
    void flush_covariance();
    void rest();
    void take_baro(const SensorFrame& frame);
    void fuse_baro(double height_m, double age_s);

    void fuse(const AltitudeReading* down, const AltitudeReading* up);
    [[nodiscard]] AltitudeJoint::Row row_for(const AltitudeReading& reading, std::size_t slot) const;
    [[nodiscard]] static double observation_of(const AltitudeReading& reading);
    [[nodiscard]] Match best_match(const AltitudeReading& reading) const;
    void apply(const AltitudeReading& reading, std::size_t slot);
    void found(const AltitudeReading& reading);
    void settle(const AltitudeReading& reading, const Match& match);
    [[nodiscard]] bool ranges_agree_on_drift(const AltitudeReading& down, const AltitudeReading& up, double& error_m);
    [[nodiscard]] bool make_room();
    void remove_slot(std::size_t slot);
    void forget_tentative(std::int64_t t_us);
    void merge_around(std::size_t slot);
    void classify_floor(std::size_t slot);
    void publish(std::int64_t t_us);
    void count_treads();
    [[nodiscard]] double floor_under(double z_m) const;
    [[nodiscard]] double elevation(std::size_t slot) const { return joint_.mean(AltitudeJoint::kFirstLevel + slot); }

    const Parameters& p_;
    AltitudeJoint joint_;
    AltitudePaper paper_;
    bool use_joint_ = true;
    Bounded<Slot, kMaxLevels> slots_;        ///< slot i is level i of joint_
    std::array<std::int32_t, 2> last_{-1, -1};   ///< slot that each sensor matched last, -1 none
    std::array<std::int32_t, 2> shown_{0, -1};   ///< slot that stands for ground and ceiling, -1 none
    std::array<std::int64_t, 2> last_range_t_us_{};
    std::array<std::uint32_t, 2> readings_{};
    std::array<bool, 2> blind_{};            ///< the newest sample lay in the sensor's blind zone
    std::array<Watch, 2> watch_{};
    std::int64_t last_match_t_us_ = 0;       ///< when a range last corrected z
    std::int64_t last_baro_t_us_ = 0;
    bool baro_known_ = false;                ///< the offset was founded
    std::int32_t baro_misses_ = 0;           ///< samples beyond the gate, in a row
    std::int32_t floor_slot_ = 0;
    std::int32_t drift_votes_ = 0;
    double walked_z_m_ = 0.0;                ///< elevation of the surface last flown over
    std::int32_t treads_ = 0;                ///< risers in a row, positive upwards, negative downwards

    bool started_ = false;
    bool at_rest_ = true;                    ///< on the ground, not armed (assumed until the vehicle says otherwise)
    bool vehicle_heard_ = false;
    std::int64_t t_us_ = 0;                  ///< time of the state
    std::int64_t scan_t_us_ = 0;
    std::int64_t imu_t_us_ = 0;              ///< newest inertial sample used
    std::size_t imu_next_ = 0;               ///< cursors into the frame
    std::size_t attitude_next_ = 0;
    double accel_up_m_s2_ = 0.0;
    AltitudeJoint::Up up_{0.0, 0.0, 1.0};    ///< third row of R_WB at the newest inertial sample
    double pending_s_ = 0.0;                 ///< time not yet in the covariance
    AltitudeJoint::Up pending_up_{};         ///< integral of up_ over that time
    double pending_noise_s_ = 0.0;           ///< the same, each part times its noise_share_
    double noise_share_ = 1.0;               ///< how much noisier than alt_accel_noise_m_s2 the present rate is, in variance
    bool pending_blind_ = false;
    AttitudeSample attitude_before_{};       ///< newest attitude at or before the time asked for
    float roll_rad_ = 0.0F;
    float pitch_rad_ = 0.0F;
    bool attitude_heard_ = false;

    AltitudeEstimate estimate_;
    AltitudeCounters counters_;
    Bounded<Level, kMaxLevels> published_;
};

}  // namespace noctule
