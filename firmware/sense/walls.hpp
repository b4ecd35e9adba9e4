/// Walls of one sweep: lines in Hessian form with covariance and end points.
///
/// Model: x cos(alpha) + y sin(alpha) = rho, rho >= 0, alpha from the vehicle to the wall (algorithms C); docs/maths/walls.md.
/// Default: clusters split at jumps, split and merge inside them, weighted total least squares, round pieces refused.
/// Parameter wall_method = 1: RANSAC over all points, as the paper does. Frame: Body at the stamp, level. No heap.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/frames.hpp"
#include "core/gaussian.hpp"
#include "core/random.hpp"
#include "params.gen.hpp"
#include "sense/level_scan.hpp"

namespace noctule {

/// One wall as one sweep saw it.
struct WallObservation {
    float rho_m = 0.0F;
    float alpha_rad = 0.0F;
    LineCovariance covariance;
    float lever_m = 0.0F;   ///< coordinate along the wall, (-sin, cos)(alpha), of the middle of its points
    float from_m = 0.0F;    ///< coordinates along the wall of its ends, from_m < to_m
    float to_m = 0.0F;
    std::int32_t points = 0;

    [[nodiscard]] Point2<Body> at(const float along_m) const {
        const float c = std::cos(alpha_rad);
        const float s = std::sin(alpha_rad);
        return {rho_m * c - along_m * s, rho_m * s + along_m * c};
    }
};

using WallObservations = Bounded<WallObservation, kMaxWallsPerScan>;

class WallExtractor {
public:
    struct Counters {
        std::uint32_t round_refused = 0;  ///< pieces that bend
        std::uint32_t rough_refused = 0;  ///< pieces whose points scatter more than the laser's noise allows
        std::uint32_t too_many = 0;       ///< walls that found no room in the result
    };

    explicit WallExtractor(const Parameters& parameters) : parameters_(parameters) {}

    /// Walls of the scan, longest first (by points).
    const WallObservations& extract(const LevelScan& scan);

    /// For each point of the scan last given: index into walls(), or -1.
    [[nodiscard]] const std::array<std::int16_t, kMaxBeams>& wall_of_point() const { return wall_of_point_; }
    [[nodiscard]] const WallObservations& walls() const { return walls_; }
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    struct Piece {
        std::int32_t first = 0;  ///< index into hits_
        std::int32_t last = 0;   ///< inclusive
    };
    /// Unweighted line through hits [first, last] from the running sums.
    struct Line {
        double normal_x = 1.0;
        double normal_y = 0.0;
        double offset_m = 0.0;
        double squares_m2 = 0.0;  ///< sum of squared distances
    };

    void collect_hits(const LevelScan& scan);
    void split_and_merge(const LevelScan& scan);
    void split(Piece cluster);
    void merge();
    void mark_round_runs();
    void ransac(const LevelScan& scan);
    [[nodiscard]] Line line_through(Piece piece) const;
    /// Weighted fit of the members listed in member_; adds a wall if it passes every test.
    void fit_and_add(const LevelScan& scan);
    void sort_walls();

    const Parameters& parameters_;
    Random random_{20U};
    float noise_m_ = 0.01F;                          ///< of the ranges of this sweep
    std::int32_t hit_count_ = 0;
    std::array<std::int16_t, kMaxBeams> hits_{};     ///< indices of points that hit something
    std::array<float, kMaxBeams> x_m_{};             ///< of the hits
    std::array<float, kMaxBeams> y_m_{};
    std::array<std::array<double, 5>, kMaxBeams + 1> sums_{};  ///< running sums of x, y, xx, xy, yy
    Bounded<Piece, kMaxBeams> pieces_;
    Bounded<Piece, kMaxBeams> open_;
    std::array<bool, kMaxBeams> round_{};            ///< the piece belongs to a run that bends
    std::int32_t member_count_ = 0;
    std::array<std::int16_t, kMaxBeams> member_{};   ///< indices into hits_ of the piece being fitted
    std::array<bool, kMaxBeams> taken_{};            ///< RANSAC: the hit belongs to a wall found before
    std::array<std::int16_t, kMaxBeams> wall_of_point_{};
    WallObservations walls_;
    Counters counters_;
};

}  // namespace noctule
