/// An open tour: in which order to visit stops, from a fixed start, ending anywhere.
///
/// Cheapest insertion, then 2-opt and Or-opt until neither helps (Croes 1958, Or 1976); then the first stops once more with ways weighed by
/// what is still to be revealed. docs/maths/explore.md, "Order".
/// Distances in metres, symmetric but for those from the start. No heap. Cost: rounds x stops^2.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"

namespace noctule {

class Tour {
public:
    using Order = Bounded<std::uint8_t, kMaxStops>;   ///< stops, without the start
    static constexpr std::uint8_t kAny = 255;

    /// Forgets the distances; stops are numbered 1 to `stops`, the start is 0. stops < kMaxStops.
    void begin(std::size_t stops);
    void set(const std::size_t a, const std::size_t b, const float metres) { distance_[a][b] = metres; }
    /// What the stop will reveal, and what it leaves unknown while it is set aside [m^2].
    void set_gain(const std::size_t stop, const float m2, const float leaves_m2) {
        gain_[stop] = m2;
        leaves_[stop] = leaves_m2;
    }
    /// Takes those stops out of the order whose detours cost most for what they leave unknown, as long as together they leave no more than m2 and half
    /// of all; they are no longer part of the tour. Never the stop `kept`, nor one without gain.
    void set_aside(Order& order, float m2, std::uint8_t kept);
    [[nodiscard]] bool aside(const std::size_t stop) const { return aside_[stop]; }
    /// How a way counts by what is still to be revealed at its beginning: 1 + hurry x its share of all.
    void weigh(const float hurry) { hurry_ = hurry; }
    [[nodiscard]] std::size_t stops() const { return stops_; }

    /// Length of an order, its ways weighed [m].
    [[nodiscard]] float length_m(const Order& order) const;
    /// Completes `order` (what it holds is kept as the beginning of the search) and improves it. `first`: stop that must come
    /// first, or kAny. Returns its length.
    float improve(Order& order, std::uint8_t first) const;

private:
    static constexpr int kRounds = 60;
    void insert_missing(Order& order, std::size_t fixed) const;
    void polish(Order& order, std::size_t fixed) const;
    bool reverse_once(Order& order, std::size_t fixed) const;
    bool move_once(Order& order, std::size_t fixed) const;
    [[nodiscard]] float step(const Order& o, const std::size_t k) const { return distance_[k == 0 ? 0 : o[k - 1]][o[k]]; }

    std::array<std::array<float, kMaxStops>, kMaxStops> distance_{};
    std::array<float, kMaxStops> gain_{};
    std::array<float, kMaxStops> leaves_{};
    std::array<bool, kMaxStops> aside_{};
    float hurry_ = 0.0F;
    std::size_t stops_ = 0;
};

}  // namespace noctule
