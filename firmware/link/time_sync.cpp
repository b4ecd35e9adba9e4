#include "link/time_sync.hpp"

#include <algorithm>
#include <cstdlib>

namespace noctule {

namespace {

constexpr std::int64_t kLongestTrip_us = 1000000;
constexpr std::int64_t kSlack_us = 2000;   // drift of the clocks over the window
constexpr std::size_t kEnough = 4;
constexpr int kContradictions = 3;

}  // namespace

const TimeSync::Trip& TimeSync::best() const {
    return *std::min_element(trips_.begin(), trips_.begin() + static_cast<std::ptrdiff_t>(count_), [](const Trip& a, const Trip& b) { return a.round_trip_us < b.round_trip_us; });
}

void TimeSync::add(const std::int64_t sent_us, const std::int64_t remote_us, const std::int64_t received_us) {
    const Trip trip{remote_us - (sent_us + (received_us - sent_us) / 2), received_us - sent_us};
    if (trip.round_trip_us < 0 || trip.round_trip_us > kLongestTrip_us) { return; }
    if (count_ > 0) {
        const Trip& known = best();
        const bool agrees = std::abs(trip.offset_us - known.offset_us) <= (trip.round_trip_us + known.round_trip_us) / 2 + kSlack_us;
        contradictions_ = agrees ? 0 : contradictions_ + 1;
        if (!agrees && contradictions_ < kContradictions) { return; }
        if (!agrees) { reset(); }
    }
    trips_[next_] = trip;
    next_ = (next_ + 1) % trips_.size();
    count_ = std::min(count_ + 1, trips_.size());
}

TimeSync::Estimate TimeSync::estimate() const {
    if (count_ < kEnough) { return {}; }
    return {true, best().offset_us, best().round_trip_us};
}

}  // namespace noctule
