/// The way home over space that has been flown: an upper bound of its length at any time, on any floor, whatever plans the rest.
///
/// A node every kTrailStepM of new ground, each with the shortest known way home over the nodes; two nodes are joined when the straight
/// line between them is known to be free, so that a loop that closes shortens the way of all that lies behind it. A few nodes are
/// looked at again in every step. docs/safety.md, "battery". Frame Map, metres. No heap, cost per step proportional to the nodes.
/// Full: no node is added; where the vehicle is far from all, the line to the nearest counts one and a half times.
#pragma once

#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "map/occupancy_grid.hpp"

namespace noctule {

inline constexpr float kTrailStepM = 0.7F;

class Trail {
public:
    /// Home is here; the trail begins anew.
    void begin(const OccupancyGrid& grid, float x_m, float y_m);
    /// The vehicle is here, on the grid's active floor.
    void step(const OccupancyGrid& grid, float x_m, float y_m);

    [[nodiscard]] float way_home_m() const { return way_home_m_; }
    /// The longest way home from any node.
    [[nodiscard]] float longest_m() const { return longest_m_; }
    [[nodiscard]] std::size_t size() const { return nodes_.size(); }

private:
    struct Node { float x_m; float y_m; float way_m; std::int32_t floor; };
    void relax(const OccupancyGrid& grid, Node& node);

    Bounded<Node, kMaxTrailNodes> nodes_;
    std::size_t next_ = 0;
    float way_home_m_ = 0.0F;
    float longest_m_ = 0.0F;
};

}  // namespace noctule
