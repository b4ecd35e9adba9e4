/// Times of one clock in another, from messages that took an unknown but never negative while to arrive.
///
/// The difference (arrival on the host - stamp by the source) is the clocks' offset plus the message's delay. The least
/// difference of the last seconds is the one with the least delay: it is taken for the offset. Two windows in turn forget the
/// old, so that clocks may drift apart (50 ppm give 0.5 ms in 10 s). Source: D. Mills, RFC 5905 section 10 (minimum filter).
/// Microseconds. No heap.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

namespace noctule {

class SensorClock {
public:
    static constexpr std::int64_t kWindow_us = 5000000;
    static constexpr std::int64_t kJump_us = 1000000;   ///< a stamp so far off belongs to a clock that was set anew
    static constexpr std::int64_t kSilence_us = 2000000;

    /// A message stamped source_us arrived at host_us.
    void add(const std::int64_t source_us, const std::int64_t host_us) {
        const std::int64_t difference = host_us - source_us;
        const bool jumped = started_ && (difference < offset_us() - kJump_us || difference > offset_us() + kJump_us);
        if (jumped && ++jumps_in_a_row_ < kJumpPatience) { return; }  // one late or wrong message is no new clock
        if (jumped) { ++restarts_; }
        if (!started_ || jumped) {
            started_ = true;
            least_us_ = before_us_ = std::numeric_limits<std::int64_t>::max();
            window_begin_us_ = host_us;
        }
        jumps_in_a_row_ = 0;
        if (host_us - window_begin_us_ >= kWindow_us) {
            before_us_ = least_us_;
            least_us_ = std::numeric_limits<std::int64_t>::max();
            window_begin_us_ = host_us;
        }
        least_us_ = std::min(least_us_, difference);
        last_us_ = host_us;
    }

    void forget() { started_ = false; }

    /// Something was heard lately.
    [[nodiscard]] bool valid(const std::int64_t host_us) const { return started_ && host_us - last_us_ < kSilence_us; }

    [[nodiscard]] std::int64_t to_host_us(const std::int64_t source_us) const { return source_us + offset_us(); }
    [[nodiscard]] std::int64_t from_host_us(const std::int64_t host_us) const { return host_us - offset_us(); }
    /// Times that the source's clock was set anew.
    [[nodiscard]] std::uint32_t restarts() const { return restarts_; }

private:
    static constexpr int kJumpPatience = 5;

    [[nodiscard]] std::int64_t offset_us() const { return std::min(least_us_, before_us_); }

    bool started_ = false;
    std::int64_t least_us_ = 0;
    std::int64_t before_us_ = 0;
    std::int64_t window_begin_us_ = 0;
    std::int64_t last_us_ = 0;
    int jumps_in_a_row_ = 0;
    std::uint32_t restarts_ = 0;
};

}  // namespace noctule
