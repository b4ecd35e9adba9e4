/// Are these samples fit for use? Each refusal has a reason and is counted.
///
/// Time must rise within one stream. A clock that jumped back for good (a restarted autopilot) is accepted again after
/// kClockPatience refusals in a row. Storage: a few words; nothing is thrown, nothing is fatal.
#pragma once

#include <array>
#include <cstdint>

#include "sense/samples.hpp"

namespace noctule {

enum class SampleVerdict : std::uint8_t { accepted, rejected_time, rejected_value, rejected_frozen, rejected_layout };

class SampleChecker {
public:
    struct Counters {
        std::uint32_t imu_time = 0;        ///< inertial samples whose time did not rise
        std::uint32_t imu_value = 0;       ///< inertial samples not finite or beyond any sensor's range
        std::uint32_t imu_frozen = 0;      ///< inertial samples of a sensor that repeats itself to the last bit
        std::uint32_t attitude_time = 0;
        std::uint32_t attitude_value = 0;
        std::uint32_t scan_time = 0;       ///< sweeps whose time did not rise, duplicates included
        std::uint32_t scan_layout = 0;     ///< sweeps whose count, bearings or limits make no sense
        std::uint32_t clock_restarts = 0;  ///< streams taken up again after their clock went back
        [[nodiscard]] std::uint32_t refused() const {
            return imu_time + imu_value + imu_frozen + attitude_time + attitude_value + scan_time + scan_layout;
        }
    };

    /// Identical inertial samples in a row after which the sensor counts as frozen.
    static constexpr std::uint32_t kFrozenAfter = 25;
    /// Refusals in a row for time after which a stream's new clock is believed.
    static constexpr std::uint32_t kClockPatience = 20;

    [[nodiscard]] SampleVerdict check(const ImuSample& sample);
    [[nodiscard]] SampleVerdict check(const AttitudeSample& sample);
    [[nodiscard]] SampleVerdict check(const Scan& scan);
    /// True once after a stream's clock restarted: whatever was derived from its old times is void.
    [[nodiscard]] bool take_restart();

    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    struct Clock {
        std::int64_t last_us = 0;
        std::uint32_t refused_in_a_row = 0;
        bool started = false;
    };
    [[nodiscard]] bool rises(Clock& clock, std::int64_t t_us);

    Clock imu_clock_;
    Clock attitude_clock_;
    Clock scan_clock_;
    ImuSample last_imu_;
    std::uint32_t imu_repeats_ = 0;
    bool restarted_ = false;
    Counters counters_;
};

}  // namespace noctule
