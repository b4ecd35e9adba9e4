/// Offset between the autopilot's clock and this computer's, from TIMESYNC round trips.
///
/// Of the last sixteen round trips the shortest tells: its offset is off by half of its duration at most, whichever way the delay lay.
/// When three in a row contradict it (a clock was set, the simulation runs faster than time) all is forgotten. No heap, no clock.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace noctule {

class TimeSync {
public:
    struct Estimate {
        bool valid = false;            ///< four round trips or more that agree
        std::int64_t offset_us = 0;    ///< autopilot's clock minus ours
        std::int64_t round_trip_us = 0;
    };

    /// One round trip: our clock when the question left and when the answer came, the autopilot's clock in the answer. One that took
    /// over a second or less than no time is refused.
    void add(std::int64_t sent_us, std::int64_t remote_us, std::int64_t received_us);
    void reset() { *this = {}; }
    [[nodiscard]] Estimate estimate() const;

private:
    struct Trip {
        std::int64_t offset_us = 0;
        std::int64_t round_trip_us = 0;
    };

    [[nodiscard]] const Trip& best() const;

    std::array<Trip, 16> trips_{};
    std::size_t count_ = 0;
    std::size_t next_ = 0;
    int contradictions_ = 0;
};

}  // namespace noctule
