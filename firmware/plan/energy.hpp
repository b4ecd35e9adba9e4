/// When to turn home: what is left of the battery against what the way home needs, at the rate and speed measured in this flight.
///
/// docs/safety.md, "battery". SI; charges are shares of a full battery. No heap, constant cost.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "params.gen.hpp"

namespace noctule {

class Energy {
public:
    explicit Energy(const Parameters& parameters) : p_(parameters) {}

    /// A flight begins: consumption and speed are learned anew.
    void begin();
    /// One step in flight. `left` is the charge, negative: unknown.
    void step(float left, float speed_m_s, std::int64_t t_us);

    /// Share of the battery used per second: the greater of the mean of the flight and that of the last few per cent.
    [[nodiscard]] float rate_per_s() const;
    /// Mean speed while moving [m/s].
    [[nodiscard]] float cruise_m_s() const { return cruise_m_s_; }
    /// Charge that the way home and the landing need, without the reserve.
    [[nodiscard]] float needed(float way_home_m) const;
    /// True: home now, or the reserve is touched.
    [[nodiscard]] bool must_return(float way_home_m) const;

private:
    struct Mark { float left; std::int64_t t_us; };
    const Parameters& p_;
    std::array<Mark, 6> marks_{};   ///< the last changes of the reading, newest first
    std::size_t count_ = 0;
    Mark first_{-1.0F, 0};
    float left_ = -1.0F;
    float cruise_m_s_ = 0.0F;
    std::int64_t t_us_ = -1;
};

}  // namespace noctule
