/// The map around the vehicle as the scan match sees it, and the match.
///
/// A square of cells with the moments of the points in them. A point is compared with the nearest cell mean: across it where
/// the surroundings are a line, all round where they are not. Gauss-Newton with a robust weight and the prediction as a prior;
/// a search over places and headings where the prediction is too wide or the match too poor (Olson 2009).
/// Frame Map; page: docs/maths/scan_match.md. No heap, not thread-safe.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "core/matrix.hpp"
#include "estimate/point_map.hpp"
#include "estimate/scan_shape.hpp"

namespace noctule {

/// The prediction's covariance counts so many times, in place and in yaw: how far the match lies outside of it
/// (docs/maths/scan_match.md, equation 4).
struct PriorScale {
    float place = 1.0F;
    float yaw = 1.0F;

    /// Covariance widened by the scales.
    [[nodiscard]] Matrix<float, 3, 3> widen(Matrix<float, 3, 3> p) const { return scaled(p, std::sqrt(place), std::sqrt(yaw)); }
    /// Information weakened by them.
    [[nodiscard]] Matrix<float, 3, 3> weaken(Matrix<float, 3, 3> p) const { return scaled(p, 1.0F / std::sqrt(place), 1.0F / std::sqrt(yaw)); }

private:
    [[nodiscard]] static Matrix<float, 3, 3> scaled(Matrix<float, 3, 3> p, const float a, const float b) {
        const std::array<float, 3> root{a, a, b};
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j = 0; j < 3; ++j) { p(i, j) *= root[i] * root[j]; }
        }
        return p;
    }
};

/// What is known of a pose before the match.
struct Prediction {
    Pose2<Map, Body> pose;
    Matrix<float, 3, 3> covariance;
    Matrix<float, 3, 3> information;

    [[nodiscard]] PriorScale scale(const Pose2<Map, Body>& at) const;
    /// Twice the negative logarithm of its robust density.
    [[nodiscard]] float cost(const Pose2<Map, Body>& at) const;
};

/// How a sweep lies in the map.
struct ScanFit {
    PoseMatch match;                  ///< pose and information, the prediction left out
    Pose2<Map, Body> pose;            ///< the best pose, the prediction counted in
    float share = 0.0F;               ///< of the points in reach that agree with the map
    float residual_m = 0.0F;          ///< root mean square distance of those
    PriorScale prior_scale;
    float cost = 0.0F;                ///< robust: two for each point that nothing explains, less for the others
    std::int32_t in_reach = 0;        ///< points where the map has something near
};

class ScanMap {
public:
    static constexpr float kCell_m = 0.15F;
    static constexpr auto kSide = static_cast<std::int32_t>(kMaxScanSide);

    /// Empties the map and places it.
    void start(float centre_x_m, float centre_y_m);
    /// Points seen from a pose; what lies outside is left out.
    void add(const Point2<Body>* points, std::size_t count, const Pose2<Map, Body>& pose);
    [[nodiscard]] bool empty() const { return used_ <= 1; }

    /// Refines from a start, held by the prediction.
    [[nodiscard]] ScanFit refine(const ScanShape& shape, const Pose2<Map, Body>& start, const Prediction& predicted);
    /// Best places in a box round the prediction, half width and half angle, every step_cells-th of the lattice; the best first. Number found.
    struct Candidate {
        Pose2<Map, Body> pose;
        float score = 0.0F;           ///< 0 to 1
    };
    static constexpr std::size_t kCandidates = 4;
    std::size_t search(const ScanShape& shape, const Pose2<Map, Body>& predicted, float half_m, float half_rad,
                       std::array<Candidate, kCandidates>& out, std::int32_t step_cells = 1) const;
    /// Share of the points that fall on a cell with points or beside one; 1 for no points.
    [[nodiscard]] float explained(const ScanShape& shape, const Pose2<Map, Body>& pose) const;
    /// Share of the map's cells in view of a sweep, up to `reach_m`, that its beams pass through; 1 if none is in view.
    [[nodiscard]] float passed_through(const ScanShape& shape, const Pose2<Map, Body>& pose, float reach_m) const;
    [[nodiscard]] std::uint32_t refused() const { return refused_; }
    [[nodiscard]] std::size_t cells() const { return used_ - 1U; }

private:
    struct Cell {
        float count = 0.0F;
        float x_m = 0.0F;   ///< sums of coordinates from the cell's centre, then of their products
        float y_m = 0.0F;
        float xx = 0.0F;
        float xy = 0.0F;
        float yy = 0.0F;
        float mean_x_m = 0.0F;   ///< frame of the square, once ready
        float mean_y_m = 0.0F;
        float normal_x = 0.0F;
        float normal_y = 0.0F;
        float variance_m2 = 0.0F;  ///< across
        std::int16_t column = 0;
        std::int16_t row = 0;
        std::uint8_t kind = 0;     ///< 0 not looked at, 1 line, 2 spot
    };
    [[nodiscard]] std::int32_t index_of(float x_m, float y_m) const;
    void prepare(Cell& cell);
    [[nodiscard]] std::int32_t nearest(float x_m, float y_m);

    float x0_m_ = 0.0F;
    float y0_m_ = 0.0F;
    std::size_t used_ = 1;
    std::uint32_t refused_ = 0;
    std::array<std::uint16_t, kSide * kSide> slot_{};   ///< 0: nothing there
    std::array<std::uint8_t, kSide * kSide> near_{};    ///< 2: a cell with points, 1: beside one
    std::array<Cell, kMaxScanCells> cells_{};
};

}  // namespace noctule
