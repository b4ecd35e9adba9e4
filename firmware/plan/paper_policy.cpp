#include "plan/paper_policy.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

constexpr double kBelowOne = 1.0 - 1e-15;      ///< of a free cell among walls
constexpr double kTolerance = 1e-4;            ///< relative change at which the relaxation ends
constexpr std::int32_t kMostSweeps = 500;      ///< of the window a step: 244 are enough in 99 of 100; cut off after ten the way is a fifth longer
constexpr std::int64_t kNowhereUs = 20000000;  ///< without a lower cell beside the vehicle, or without getting on
constexpr std::int64_t kCountUs = 1000000;
constexpr std::int32_t kStepsAhead = 12;       ///< cells of the way that are handed on

}  // namespace

void PaperPolicy::begin(const Pose2<Map, Body>& home) {
    phi_.fill(0.0);
    const auto middle = [this](const float metres) { return static_cast<std::int32_t>(std::floor(metres / p_.grid_cell_m)); };
    corner_ = {middle(home.x_m) - kSide / 2, middle(home.y_m) - kSide / 2};
    answer_ = PolicyAnswer{};
    lowered_us_ = counted_us_ = -1;
    unknown_share_ = least_share_ = 1.0F;
    led_nowhere_ = false;
    counters_ = {};
}

void PaperPolicy::relax(const MapView& map, const Cell centre, const std::int32_t half) {
    const std::int32_t x0 = std::max<std::int32_t>(centre.ix - half + 1, 1);
    const std::int32_t y0 = std::max<std::int32_t>(centre.iy - half + 1, 1);
    const std::int32_t x1 = std::min(centre.ix + half - 1, kSide - 2);
    const std::int32_t y1 = std::min(centre.iy + half - 1, kSide - 2);
    // Walls first; the free cells between keep what they have: warm start.
    for (std::int32_t y = y0; y <= y1; ++y) {
        for (std::int32_t x = x0; x <= x1; ++x) {
            const CellId id = map.grid.find(Cell{corner_.ix + x, corner_.iy + y});
            const bool wall = map.grid.cell_class(id) == CellClass::occupied || (map.where.clearance_cm(id) > 0 && !map.where.tight(id)) ||
                              static_cast<float>(map.where.clearance_cm(id)) * 0.01F < p_.hull_radius_m;
            const bool unseen = map.grid.cell_class(id) == CellClass::unknown;
            double& phi = at(x, y);
            if (wall && !unseen) {
                phi = 1.0;
            } else if (phi >= 1.0) {
                // What was a wall, or the vehicle's own cell, is free again: anything under its surroundings would draw the vehicle back.
                phi = std::min(0.25 * (at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1)), kBelowOne);
            }
        }
    }
    for (std::int32_t sweep = 0; sweep < kMostSweeps; ++sweep) {
        double change = 0.0;
        for (std::int32_t y = y0; y <= y1; ++y) {
            for (std::int32_t x = x0; x <= x1; ++x) {
                double& phi = at(x, y);
                if (phi >= 1.0) { continue; }
                if (x == centre.ix && y == centre.iy) {
                    phi = 1.0;
                    continue;
                }
                const double mean = 0.25 * (at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1));
                change = std::max(change, std::fabs(mean - phi) / std::max(mean, 1e-300));
                phi = std::min(mean, kBelowOne);
            }
        }
        if (change < kTolerance) { break; }
    }
}

// Down the steepest of eight neighbours; the vehicle's own cell is 1, so any free neighbour is lower than it.
void PaperPolicy::trace(const MapView& map, const Cell centre, const std::int32_t half) {
    path_.clear();
    static_cast<void>(path_.push({map.from.x_m, map.from.y_m, 0.8F}));
    Cell here = centre;
    double phi = 1.0;
    for (std::int32_t k = 0; k < kStepsAhead; ++k) {
        Cell next = here;
        double steepest = 0.0;
        for (std::int32_t d = 0; d < 8; ++d) {
            const Cell n{here.ix + kNeighbourX[d], here.iy + kNeighbourY[d]};
            if (n.ix < 1 || n.iy < 1 || n.ix > kSide - 2 || n.iy > kSide - 2) { continue; }
            const CellId id = map.grid.find(Cell{corner_.ix + n.ix, corner_.iy + n.iy});
            if (!map.where.passable(id) && !map.where.tight(id)) { continue; }
            const double slope = (phi - at(n.ix, n.iy)) * ((d & 1) != 0 ? 0.70710678 : 1.0);
            if (slope > steepest) {
                steepest = slope;
                next = n;
            }
        }
        if (next == here || std::abs(next.ix - centre.ix) > half || std::abs(next.iy - centre.iy) > half) { break; }
        here = next;
        phi = at(here.ix, here.iy);
        const Cell cell{corner_.ix + here.ix, corner_.iy + here.iy};
        const float x_m = map.grid.geometry().centre_x_m(cell);
        const float y_m = map.grid.geometry().centre_y_m(cell);
        static_cast<void>(path_.push({x_m, y_m, map.grid.clearance_m(x_m, y_m, 0.8F)}));
        if (!(phi > 0.0)) { break; }
    }
    path_[0].clearance_m = map.grid.clearance_m(map.from.x_m, map.from.y_m, 0.8F);
}

void PaperPolicy::count(const MapView& map) {
    std::int32_t known = 0;
    std::int32_t never = 0;
    for (std::int32_t y = 0; y < kSide; ++y) {
        for (std::int32_t x = 0; x < kSide; ++x) {
            const CellId id = map.grid.find(Cell{corner_.ix + x, corner_.iy + y});
            if (!map.where.passable(id)) { continue; }
            ++known;
            never += at(x, y) == 0.0 ? 1 : 0;
        }
    }
    unknown_share_ = known > 0 ? static_cast<float>(never) / static_cast<float>(known) : 1.0F;
}

const PolicyAnswer& PaperPolicy::step(const MapView& map, const Pose2<Map, Body>& /*pose*/, const std::int32_t /*budget_cells*/) {
    const Cell from = map.grid.geometry().cell(map.from.x_m, map.from.y_m);
    const Cell centre{from.ix - corner_.ix, from.iy - corner_.iy};
    const auto half = static_cast<std::int32_t>(map.grid.geometry().to_cells(p_.potential_window_m));
    if (centre.ix < 2 || centre.iy < 2 || centre.ix > kSide - 3 || centre.iy > kSide - 3) {  // out of the area given in advance
        answer_.valid = false;
        answer_.finished = led_nowhere_ = true;
        return answer_;
    }
    if (lowered_us_ < 0) { lowered_us_ = map.t_us; }
    relax(map, centre, half);
    trace(map, centre, half);
    if (counted_us_ < 0 || map.t_us - counted_us_ >= kCountUs) {
        counted_us_ = map.t_us;
        count(map);
        ++counters_.passes;
        // Against the least so far: to and fro over the same place the share goes up and down.
        if (unknown_share_ < least_share_ - 1e-4F) {
            least_share_ = unknown_share_;
            lowered_us_ = map.t_us;
        }
        if (unknown_share_ < p_.paper_unknown_share) { answer_.finished = true; }
    }
    if (map.t_us - lowered_us_ > 3 * kNowhereUs || (path_.size() < 2U && map.t_us - lowered_us_ > kNowhereUs)) {
        led_nowhere_ = answer_.finished = true;
    }
    answer_.valid = path_.size() > 1U;
    answer_.path = &path_;
    const PathPoint& end = path_.back();
    if (std::hypot(end.x_m - answer_.x_m, end.y_m - answer_.y_m) > 0.5F) { ++answer_.number; }
    answer_.x_m = answer_.look_x_m = end.x_m;
    answer_.y_m = answer_.look_y_m = end.y_m;
    answer_.cell = map.grid.find(end.x_m, end.y_m);
    return answer_;
}

}  // namespace noctule
