// The facets of OccupancyGrid: what the beams that end in one cell side by side show of a surface. docs/maths/grid.md, "hits finer than cells".
#include <algorithm>
#include <cmath>

#include "map/occupancy_grid.hpp"

namespace noctule {

namespace {

constexpr float kTellsWayCells = 0.3F;         ///< a facet shorter than this does not tell which way its surface runs
constexpr float kReachesCells = 0.15F;         ///< beyond its ends
constexpr float kBeyondM = 0.05F;              ///< beyond a facet: so far its surface is followed to tell whether it ends at a corner
constexpr float kJumpM = 0.06F;                ///< between two beams: another surface
constexpr float kCornerM = 0.02F;              ///< by which it stands out
constexpr float kProtrudesM = 0.008F;          ///< more than averaged noise

}  // namespace

// The point that a facet shows: the mean of its ends, but where the surface protrudes towards the vehicle (a corner, the end of a wall, a thin leg) its
// foremost point, and where it turns away beyond the last of them, that one; averaged back either would seem up to 3 cm farther than it is.
bool OccupancyGrid::Facet::protrudes(const float protrudes_cells, const float corner_cells, Point2<Map>& shown) const {
    Point2<Map> mean{};
    for (const Point2<Map>& e : ends) {
        mean.x_m += e.x_m;
        mean.y_m += e.y_m;
    }
    const auto n = static_cast<float>(ends.size());
    mean = {mean.x_m / n, mean.y_m / n};
    shown = mean;
    if (!dense) { return false; }
    // Of the chord between both ends: how far towards the vehicle.
    const Point2<Map>& first = ends[0];
    const float dx = ends.back().x_m - first.x_m;
    const float dy = ends.back().y_m - first.y_m;
    const auto across = [&](const Point2<Map>& p) { return dx * (p.y_m - first.y_m) - dy * (p.x_m - first.x_m); };
    const float toward = across(origin) < 0.0F ? -1.0F : 1.0F;
    float most = protrudes_cells * std::hypot(dx, dy);
    bool found = false;
    for (const Point2<Map>& e : ends) {
        const float out = toward * across(e);
        if (out <= most) { continue; }
        most = out;
        shown = e;
        found = true;
    }
    if (found) { return true; }
    // A corner where the surface leaves the cell: the last point stands out of the line from the first one to what is beyond.
    const auto corner = [&](const Point2<Map>& from, const Point2<Map>& tip, const Point2<Map>& to) {
        const float x = to.x_m - from.x_m;
        const float y = to.y_m - from.y_m;
        const auto beside = [&](const Point2<Map>& p) { return x * (p.y_m - from.y_m) - y * (p.x_m - from.x_m); };
        return (beside(origin) < 0.0F ? -1.0F : 1.0F) * beside(tip) > corner_cells * std::hypot(x, y);
    };
    const bool at_end = corner(ends[0], ends.back(), after);
    if (!at_end && !corner(ends.back(), ends[0], before)) { return false; }
    shown = at_end ? ends.back() : ends[0];
    return true;
}

// The beam up to kBeyondM farther on, as far as they are of one surface.
std::size_t OccupancyGrid::beyond(const LevelScan& scan, const std::size_t from, const bool after) {
    const auto& points = scan.points;
    auto beams = static_cast<std::size_t>(kBeyondM / std::max(scan.bearing_increment_rad * points[from].range_m, 1e-4F));
    std::size_t k = from;
    for (; beams > 0U && (after ? k + 1U < points.size() : k > 0U); --beams) {
        const std::size_t next = after ? k + 1U : k - 1U;
        if (!points[next].hit || std::fabs(points[next].range_m - points[k].range_m) > kJumpM) { break; }
        k = next;
    }
    return k;
}

void OccupancyGrid::enter(const Facet& facet) {
    if (facet.id == kNoCell || facet.ends.empty()) { return; }
    Point2<Map> p{};
    const GridTile& t = tiles_[static_cast<std::size_t>(facet.id >> 12)];
    const auto k = static_cast<std::size_t>(facet.id & 4095);
    const bool stands_out = facet.protrudes(geometry_.to_cells(kProtrudesM), geometry_.to_cells(kCornerM), p);
    if (t.log_odds[k] > 0 && t.hit_x[k] != kNeverHit) {
        const Cell c = cell(facet.id);
        const float x = static_cast<float>(c.ix) + 0.5F + static_cast<float>(t.hit_x[k]) / kOffsetUnits;
        const float y = static_cast<float>(c.iy) + 0.5F + static_cast<float>(t.hit_y[k]) / kOffsetUnits;
        const float dx = facet.ends.back().x_m - facet.ends[0].x_m;
        const float dy = facet.ends.back().y_m - facet.ends[0].y_m;
        const float length = std::hypot(dx, dy);
        if (facet.at_rim) {
            // The edge of a thing that the sector shows no more of: a hit that is drawn there is worn away by the beams that pass beside the thing.
            p = {x, y};
        } else if (!stands_out && length > kTellsWayCells) {
            // A point that the facet reaches is left where along it it is: else a corner, once found, would be drawn back by looks that show one side of it.
            const float along = ((x - facet.ends[0].x_m) * dx + (y - facet.ends[0].y_m) * dy) / length;
            if (along > -kReachesCells && along < length + kReachesCells) {
                const float from_mean = ((x - p.x_m) * dx + (y - p.y_m) * dy) / (length * length);
                p = {p.x_m + from_mean * dx, p.y_m + from_mean * dy};
            }
        }
    }
    hit(facet.id, p.x_m, p.y_m, facet.dense);
}

}  // namespace noctule
