/// What walls cannot say: points that no wall explains, kept as small Gaussians in cells, and a match against them.
///
/// Model: normal distributions transform (Biber and Strasser 2003), Gauss-Newton with a robust weight; docs/maths/localisation.md#points.
/// Frame Map. A table of kMaxPointCells cells, addressed by hash; when its neighbourhood is full the cell with the fewest
/// points gives way. No heap, not thread-safe.
#pragma once

#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "core/matrix.hpp"
#include "params.gen.hpp"

namespace noctule {

using MatchPoints = Bounded<Point2<Body>, kMaxMatchPoints>;

/// A pose measurement in information form: Lambda (x - pose) = b about `pose`.
struct PoseMatch {
    bool valid = false;
    Pose2<Map, Body> pose;
    Matrix<float, 3, 3> lambda;
    Matrix<float, 3, 1> b;
    std::int32_t points = 0;  ///< that found a cell
};

class PointMap {
public:
    struct Counters {
        std::uint32_t evicted = 0;     ///< cells that gave way
        std::uint32_t unmatched = 0;   ///< matches refused for want of points
    };

    explicit PointMap(const Parameters& parameters) : parameters_(parameters) {}

    void clear();

    /// Match from a predicted pose with its covariance (x, y, yaw). Not valid when too few points find a cell.
    [[nodiscard]] PoseMatch match(const MatchPoints& points, const Pose2<Map, Body>& predicted, const Matrix<float, 3, 3>& covariance);

    /// Standard deviation of the points to reckon with.
    void set_noise(const float noise_m) { noise_m_ = noise_m; }

    /// Adds points seen from a pose.
    void add(const MatchPoints& points, const Pose2<Map, Body>& pose);

    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    struct Cell {
        std::int32_t key = 0;
        float count = 0.0F;   ///< points, capped so that the cell keeps adapting; 0: empty
        float mean_x_m = 0.0F;
        float mean_y_m = 0.0F;
        float xx = 0.0F;      ///< mean squares about the mean
        float xy = 0.0F;
        float yy = 0.0F;
    };
    [[nodiscard]] static std::size_t slot(std::int32_t key);
    [[nodiscard]] std::int32_t key_of(float x_m, float y_m) const;
    [[nodiscard]] const Cell* find(std::int32_t key) const;
    [[nodiscard]] const Cell* nearest(float x_m, float y_m) const;
    [[nodiscard]] Cell& place_for(std::int32_t key);

    const Parameters& parameters_;
    std::array<Cell, kMaxPointCells> cells_{};
    std::size_t size_ = 0;
    float noise_m_ = 0.0F;   ///< 0: as the parameter says
    Counters counters_;
};

}  // namespace noctule
