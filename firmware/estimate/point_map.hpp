/// What walls cannot say: points that no wall explains, kept as small Gaussians in cells, and a match against them.
///
/// Model: normal distributions transform (Biber and Strasser 2003), Gauss-Newton with a robust weight; docs/maths/localisation.md#points.
/// Frame Map. One table of kMaxPointCells cells for all layers (floors), addressed by hash; when its neighbourhood is full the cell
/// with the fewest points gives way, of whatever layer (counted). 16 bytes a cell, 0.5 MB. No heap, not thread-safe.
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

    /// Forgets a layer, below kLayers.
    void clear(std::size_t layer);
    static constexpr std::size_t kLayers = 16;

    /// Match from a predicted pose with its covariance (x, y, yaw). Not valid when too few points find a cell.
    [[nodiscard]] PoseMatch match(std::size_t layer, const MatchPoints& points, const Pose2<Map, Body>& predicted, const Matrix<float, 3, 3>& covariance);

    /// Standard deviation of the points to reckon with.
    void set_noise(const float noise_m) { noise_m_ = noise_m; }

    /// Adds points seen from a pose.
    void add(std::size_t layer, const MatchPoints& points, const Pose2<Map, Body>& pose);

    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    /// As it is kept: the mean from the cell's lower corner in 1/65536 of its edge, mean squares in 1/65535 of the greatest possible.
    struct Stored {
        std::uint32_t key = kNone;
        std::uint16_t count = 0;      ///< points, capped so that the cell keeps adapting; 0: forgotten, its place is free
        std::array<std::uint16_t, 2> mean{};
        std::uint16_t xx = 0;
        std::int16_t xy = 0;
        std::uint16_t yy = 0;
    };
    /// As it is reckoned with.
    struct Cell {
        float count = 0.0F;
        float mean_x_m = 0.0F;
        float mean_y_m = 0.0F;
        float xx = 0.0F;      ///< mean squares about the mean
        float xy = 0.0F;
        float yy = 0.0F;
    };
    static constexpr std::uint32_t kNone = 0xFFFFFFFFU;   ///< no cell was ever there
    [[nodiscard]] static std::size_t slot(std::uint32_t key);
    [[nodiscard]] std::uint32_t key_of(std::size_t layer, float x_m, float y_m) const;
    [[nodiscard]] const Stored* find(std::uint32_t key) const;
    [[nodiscard]] bool nearest(std::size_t layer, float x_m, float y_m, Cell& out) const;
    [[nodiscard]] Stored& place_for(std::uint32_t key);
    [[nodiscard]] Point2<Map> corner(std::uint32_t key) const;
    [[nodiscard]] Cell unpack(const Stored& stored) const;
    void pack(const Cell& cell, Stored& stored) const;

    const Parameters& parameters_;
    std::array<Stored, kMaxPointCells> cells_{};
    std::size_t size_ = 0;
    float noise_m_ = 0.0F;   ///< 0: as the parameter says
    Counters counters_;
};

}  // namespace noctule
