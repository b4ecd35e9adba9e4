/// Signs of stairs: where the ground under the way rises by a step at a time.
///
/// docs/maths/floors.md, "Treads". The laser sees its own plane only: a tread whose top is a little below it is not seen and lies in the hull's way. What
/// tells of it is the ground under the vehicle on the way there. Frame Map. One instance, no heap, not thread-safe; constant cost.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/bounded.hpp"

namespace noctule {

/// A tread that was under the vehicle.
struct StairPlace {
    float x_m = 0.0F;
    float y_m = 0.0F;
    std::int32_t floor = 0;
};

constexpr std::size_t kMaxStairPlaces = 48;
using StairPlaces = Bounded<StairPlace, kMaxStairPlaces>;

constexpr float kTreadM = 0.30F;         ///< depth of a tread, at most
constexpr float kStairsReachM = 0.9F;    ///< from a tread that was under the vehicle to what is hit of the same stairs

/// The nearest stairs of a floor within reach of a place; null: none.
[[nodiscard]] inline const StairPlace* stairs_near(const StairPlaces& places, const std::int32_t floor, const float x_m, const float y_m, const float reach_m) {
    const StairPlace* nearest = nullptr;
    float best_m = reach_m;
    for (const StairPlace& s : places) {
        const float away_m = std::hypot(s.x_m - x_m, s.y_m - y_m);
        if (s.floor != floor || away_m >= best_m) { continue; }
        best_m = away_m;
        nearest = &s;
    }
    return nearest;
}

class StairSigns {
public:

    /// The ground under a place of a floor, over that floor. True: it lies a step higher or lower than the ground close by.
    bool note(const std::int32_t floor, const float x_m, const float y_m, const float ground_m) {
        bool step = false;
        bool known = false;
        for (const Seen& s : seen_) {
            const float away_m = std::hypot(s.at.x_m - x_m, s.at.y_m - y_m);
            if (s.at.floor != floor || away_m > kReachM) { continue; }
            const float rise_m = std::fabs(s.ground_m - ground_m);
            step = step || (rise_m > kRiserLeastM && rise_m < kRiserMostM);
            known = known || (away_m < kApartM && rise_m < kSameM);
        }
        if (!known) {
            if (seen_.full()) { seen_.drop_front(1); }
            static_cast<void>(seen_.push({{x_m, y_m, floor}, ground_m}));
        }
        return step;
    }

private:
    static constexpr float kReachM = 0.45F;       ///< to the ground that it is compared with
    static constexpr float kApartM = 0.08F;
    static constexpr float kSameM = 0.04F;
    static constexpr float kRiserLeastM = 0.10F;  ///< a riser measures 0.12 to 0.22 m
    static constexpr float kRiserMostM = 0.25F;
    struct Seen {
        StairPlace at;
        float ground_m = 0.0F;
    };
    Bounded<Seen, 32> seen_;   ///< the last ones
};

}  // namespace noctule
