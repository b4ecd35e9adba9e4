/// What a stop of the tour is worth, and when a change of mind is one.
///
/// docs/maths/explore.md, "Order" and "Commitment". Frame Map, SI. Pure, no heap.
#pragma once

#include <algorithm>
#include <cmath>

#include "core/bounded.hpp"
#include "params.gen.hpp"
#include "plan/cost_field.hpp"
#include "plan/frontier.hpp"

namespace noctule {

/// When hardly anything is left (less than tour_tail_share of the known area), a pocket must be worth its way: those behind which less than
/// tour_worth_m times the way to them is unknown are taken out. All that is unknown behind counts, whatever the mouth: a whole room may show
/// through a slit. Patches for the camera and places to pass stay.
template <std::size_t Capacity>
void keep_worthwhile(const Parameters& p, const float known_m2, Bounded<Frontier, Capacity>& stops) {
    float left_m2 = 0.0F;
    for (const Frontier& f : stops) { left_m2 += reveals_m2(p, f); }
    if (left_m2 > p.tour_tail_share * known_m2) { return; }
    const auto kept = std::remove_if(stops.begin(), stops.end(), [&p](const Frontier& f) {
        return !f.sounding && !f.camera && behind_m2(p, f) < p.tour_worth_m * CostField::metres(f.sight_cost, p.grid_cell_m);
    });
    stops.keep_front(static_cast<std::size_t>(kept - stops.begin()));
}

/// A goal that was given up for another one, or had been seen: it is not taken again before something has been learned.
class LeftGoal {
public:
    static constexpr float kNewsM2 = 1.0F;        ///< area that must have become known since
    static constexpr float kSamePlaceM = 1.0F;

    void clear() { known_m2_ = -1.0F; }
    void set(const float x_m, const float y_m, const float known_m2) {
        x_m_ = x_m;
        y_m_ = y_m;
        known_m2_ = known_m2;
    }
    /// True: going to (x, y) now would undo the change of mind although nothing has been learned.
    [[nodiscard]] bool undone_by(const float x_m, const float y_m, const float known_m2) const {
        return known_m2_ >= 0.0F && std::hypot(x_m - x_m_, y_m - y_m_) < kSamePlaceM && known_m2 - known_m2_ < kNewsM2;
    }

private:
    float x_m_ = 0.0F;
    float y_m_ = 0.0F;
    float known_m2_ = -1.0F;   ///< when it was left; below 0: there is none
};

}  // namespace noctule
