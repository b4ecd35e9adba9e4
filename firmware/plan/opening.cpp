#include "plan/opening.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/angle.hpp"

namespace noctule {

namespace {

constexpr float kSlackM = 0.05F;          ///< places are known to half a cell
constexpr float kRingShare = 0.95F;       ///< of the safety distance: there the look round goes
constexpr float kRingMostM = 0.6F;        ///< a wide safety distance is not looked at all round
constexpr float kBesideM = 0.35F;         ///< a place is tried if something beyond was seen this near
constexpr float kWideM = 1.0F;            ///< more room than this counts no more
constexpr float kUnknownCostM = 0.10F;    ///< room that a spot not yet looked at is worth
constexpr float kWayCost = 0.05F;
constexpr float kSkippedM = 0.15F;
constexpr std::int32_t kMostFarther = 16; ///< looks at what is beside the part that was seen, before an opening is too small
constexpr float kTellsM = 0.2F;           ///< nearer than this to a known edge a look tells nothing new
constexpr float kDrawnM = 0.1F;           ///< a spot where the hull does not fit is tried this much nearer to the middle
constexpr int kRing = 8;

}  // namespace

OpeningJudge::Seen OpeningJudge::seen(const std::int32_t i, const std::int32_t j) const {
    if (i < 0 || j < 0 || i >= kSide || j >= kSide) { return Seen::nothing; }
    return seen_[static_cast<std::size_t>(j * kSide + i)];
}

bool OpeningJudge::skipped(const float x_m, const float y_m) const {
    return std::any_of(skipped_.begin(), skipped_.end(), [&](const Spot& s) { return std::hypot(s.x_m - x_m, s.y_m - y_m) < kSkippedM; });
}

void OpeningJudge::draw(const VerticalMap& map, const std::int8_t floor, const VerticalSide side, const BeyondBand& beyond, const Cell centre) {
    centre_ = centre;
    cell_m_ = map.geometry().cell_m();
    seen_.fill(Seen::nothing);
    edges_.clear();
    for (const VerticalCell& v : map.cells()) {
        if (v.floor != floor || v.side != side) { continue; }
        const std::int32_t i = v.cell.ix - centre.ix + kReach;
        const std::int32_t j = v.cell.iy - centre.iy + kReach;
        if (i < 0 || j < 0 || i >= kSide || j >= kSide) { continue; }
        const bool inside = beyond.holds(v.z_m);
        seen_[static_cast<std::size_t>(j * kSide + i)] = inside ? Seen::beyond : Seen::edge;
        if (!inside) { static_cast<void>(edges_.push({map.geometry().centre_x_m(v.cell), map.geometry().centre_y_m(v.cell)})); }
    }
}

// Spots round a place that were not looked at yet; `next` is the nearest of them. A spot where the hull does not fit is drawn
// towards the middle until it does, as far as the hull's own rim.
std::int32_t OpeningJudge::unknown_round(const OccupancyGrid& grid, const Traversability& where, const float x_m, const float y_m, const float from_x_m,
                                         const float from_y_m, Spot& next) const {
    const float least_m = p_.hull_radius_m + kSlackM;
    const float radius_m = std::max(std::min(kRingShare * p_.floor_safety_m, kRingMostM), least_m);
    std::int32_t unknown = 0;
    float nearest = std::numeric_limits<float>::infinity();
    for (int k = 0; k < kRing; ++k) {
        const float a = kPi * 2.0F * static_cast<float>(k) / static_cast<float>(kRing);
        Spot spot;
        bool fits = false;
        for (float r = radius_m; !fits; r = std::max(r - kDrawnM, least_m)) {
            spot = {x_m + r * std::cos(a), y_m + r * std::sin(a)};
            fits = where.passable(grid.find(spot.x_m, spot.y_m));
            if (!fits && r <= least_m) { return -1; }
        }
        bool known = false;
        const auto i = static_cast<std::int32_t>(std::floor(spot.x_m / cell_m_)) - centre_.ix + kReach;
        const auto j = static_cast<std::int32_t>(std::floor(spot.y_m / cell_m_)) - centre_.iy + kReach;
        // Its cell or one across an edge, not across a corner: what lies between two looks is known to 0.1 m only.
        for (std::int32_t dj = -1; dj <= 1 && !known; ++dj) {
            for (std::int32_t di = -1; di <= 1; ++di) { known = known || (di * dj == 0 && seen(i + di, j + dj) == Seen::beyond); }
        }
        if (known || skipped(spot.x_m, spot.y_m)) { continue; }
        ++unknown;
        const float way = std::hypot(spot.x_m - from_x_m, spot.y_m - from_y_m);
        if (way < nearest) {
            nearest = way;
            next = spot;
        }
    }
    return unknown;
}

OpeningVerdict OpeningJudge::judge(const VerticalMap& map, const OccupancyGrid& grid, const Traversability& where, const std::int8_t floor,
                                   const VerticalSide side, const BeyondBand& beyond, const float seed_x_m, const float seed_y_m, const float from_x_m,
                                   const float from_y_m) {
    draw(map, floor, side, beyond, map.geometry().cell(seed_x_m, seed_y_m));
    const auto need_cm = static_cast<std::int32_t>(100.0F * (p_.hull_radius_m + p_.floor_side_m));
    const auto beside = static_cast<std::int32_t>(kBesideM / cell_m_);
    OpeningVerdict out;
    OpeningVerdict farther;   // where no place is clear: what is beside the part of the opening that was seen
    float best = -std::numeric_limits<float>::infinity();
    float best_farther = best;
    for (std::int32_t j = 0; j < kSide; ++j) {
        for (std::int32_t i = 0; i < kSide; ++i) {
            if (seen(i, j) == Seen::edge) { continue; }
            bool near_beyond = false;
            for (std::int32_t dj = -beside; dj <= beside && !near_beyond; ++dj) {
                for (std::int32_t di = -beside; di <= beside && !near_beyond; ++di) { near_beyond = seen(i + di, j + dj) == Seen::beyond; }
            }
            if (!near_beyond) { continue; }
            const Cell cell{centre_.ix + i - kReach, centre_.iy + j - kReach};
            const float x_m = map.geometry().centre_x_m(cell);
            const float y_m = map.geometry().centre_y_m(cell);
            const CellId id = grid.find(x_m, y_m);
            if (!where.passable(id)) { continue; }
            float edge2 = 9.0F;
            for (const Spot& e : edges_) { edge2 = std::min(edge2, (e.x_m - x_m) * (e.x_m - x_m) + (e.y_m - y_m) * (e.y_m - y_m)); }
            const float edge_m = std::sqrt(edge2);
            const float tells = edge_m - kWayCost * std::hypot(x_m - from_x_m, y_m - from_y_m);
            if (edge_m > kTellsM && tells > best_farther && seen(i, j) == Seen::nothing && !skipped(x_m, y_m)) {
                best_farther = tells;
                farther = {OpeningVerdict::What::survey, x_m, y_m, edge_m, x_m, y_m};
            }
            if (where.clearance_cm(id) < need_cm || edge_m < p_.floor_safety_m - kSlackM) { continue; }
            const float side_m = 0.01F * static_cast<float>(where.clearance_cm(id));
            const float room = std::min({edge_m, side_m + 0.5F * p_.floor_safety_m, std::max(kWideM, p_.floor_safety_m)}) -
                               kWayCost * std::hypot(x_m - from_x_m, y_m - from_y_m);
            if (room <= best) { continue; }
            Spot next;
            const std::int32_t unknown = unknown_round(grid, where, x_m, y_m, from_x_m, from_y_m, next);
            if (unknown < 0) { continue; }
            const float value = room - kUnknownCostM * static_cast<float>(unknown);
            if (value <= best) { continue; }
            best = value;
            out = {unknown == 0 ? OpeningVerdict::What::ready : OpeningVerdict::What::survey, x_m, y_m, edge_m, next.x_m, next.y_m};
        }
    }
    if (out.what != OpeningVerdict::What::too_small || farther.what != OpeningVerdict::What::survey) { return out; }
    if (std::hypot(farther.x_m - farther_.x_m, farther.y_m - farther_.y_m) > kSkippedM) { ++looks_farther_; }
    farther_ = {farther.x_m, farther.y_m};
    return looks_farther_ > kMostFarther ? out : farther;
}

}  // namespace noctule
