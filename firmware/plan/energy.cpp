#include "plan/energy.hpp"

#include <algorithm>

namespace noctule {

namespace {

constexpr float kMarkStep = 0.01F;       ///< autopilots report whole per cents
constexpr float kLearned = 0.02F;        ///< used this much: the mean of the flight counts
constexpr std::size_t kRecent = 4;       ///< marks from which the recent rate counts
constexpr float kSettleS = 25.0F;        ///< turning round, waiting over home, coming down
constexpr float kWaySlack = 1.25F;       ///< the way home is flown through doors and round what has come since
constexpr float kMovingM_S = 0.1F;
constexpr float kSpeedTimeS = 40.0F;     ///< over which the cruise speed is averaged
constexpr float kSlowestM_S = 0.2F;

}  // namespace

void Energy::begin() {
    count_ = 0;
    first_ = {-1.0F, 0};
    left_ = -1.0F;
    cruise_m_s_ = 0.4F * p_.speed_max_m_s;
    t_us_ = -1;
}

void Energy::step(const float left, const float speed_m_s, const std::int64_t t_us) {
    const float dt_s = t_us_ < 0 ? 0.0F : std::clamp(static_cast<float>(t_us - t_us_) * 1e-6F, 0.0F, 1.0F);
    t_us_ = t_us;
    if (speed_m_s > kMovingM_S) { cruise_m_s_ += dt_s / kSpeedTimeS * (speed_m_s - cruise_m_s_); }
    cruise_m_s_ = std::max(cruise_m_s_, kSlowestM_S);
    left_ = left;
    if (!(left >= 0.0F)) { return; }
    if (first_.left < 0.0F) { first_ = {left, t_us}; }
    if (count_ == 0U || left <= marks_[0].left - kMarkStep + 1e-4F) {
        for (std::size_t k = marks_.size() - 1U; k > 0U; --k) { marks_[k] = marks_[k - 1U]; }
        marks_[0] = {left, t_us};
        count_ = std::min(count_ + 1U, marks_.size());
    }
}

float Energy::rate_per_s() const {
    const float assumed = 1.0F / std::max(p_.battery_flight_time_s, 1.0F);
    if (first_.left < 0.0F || count_ == 0U) { return assumed; }
    const auto between = [](const Mark& from, const Mark& to) {
        return (from.left - to.left) / std::max(1e-6F * static_cast<float>(to.t_us - from.t_us), 0.1F);
    };
    const float mean = first_.left - marks_[0].left >= kLearned ? between(first_, marks_[0]) : assumed;
    // The oldest mark is where a reading began or a change was noticed; rates are between changes, so that steps of 1 % do not bias them.
    const float recent = count_ >= kRecent ? between(marks_[count_ - 1U], marks_[0]) : 0.0F;
    return std::max(mean, recent);
}

float Energy::needed(const float way_home_m) const { return rate_per_s() * (kWaySlack * way_home_m / std::max(cruise_m_s_, kSlowestM_S) + kSettleS); }

bool Energy::must_return(const float way_home_m) const { return left_ >= 0.0F && left_ <= p_.battery_return + needed(way_home_m); }

}  // namespace noctule
