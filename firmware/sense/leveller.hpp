/// Raw sweep to level points: each beam from the pose at its own time, turned level, floor and ceiling hits discarded.
///
/// Model: docs/maths/walls.md#level-scan. Frame of the result: Body at the stamp, turned level (sense/level_scan.hpp).
/// One instance per laser; its only state is a table of beam directions. No heap. Cost: one pass over the beams.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "core/bounded.hpp"
#include "params.gen.hpp"
#include "sense/level_scan.hpp"
#include "sense/range_noise.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// Where Body was at one time. Position and yaw in any one level frame, roll and pitch against gravity.
struct MotionNode {
    std::int64_t t_us = 0;
    double x_m = 0.0;
    double y_m = 0.0;
    double yaw_rad = 0.0;  ///< not wrapped within one sweep
    float roll_rad = 0.0F;
    float pitch_rad = 0.0F;
};

/// Poses in rising time; the last one is the pose at the stamp. Times before the first use the first.
using SweepMotion = Bounded<MotionNode, kMaxMotionNodes>;

/// Heights over the Body origin at which beams end on floor or ceiling. Infinite: unknown.
struct HeightBounds {
    float floor_m = -std::numeric_limits<float>::infinity();
    float ceiling_m = std::numeric_limits<float>::infinity();
};

class Leveller {
public:
    struct Counters {
        std::uint32_t beams_refused = 0;   ///< NaN, negative or out of the sensor's own range
        std::uint32_t beams_floor = 0;     ///< ended on the floor
        std::uint32_t beams_ceiling = 0;   ///< ended on the ceiling
    };

    explicit Leveller(const Parameters& parameters) : parameters_(parameters), noise_(parameters) {}

    /// Fills out from a scan that passed SampleChecker. motion must hold at least one node.
    void level(const Scan& scan, const SweepMotion& motion, const HeightBounds& bounds, LevelScan& out);

    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    void prepare_directions(const Scan& scan);

    const Parameters& parameters_;
    RangeNoise noise_;
    std::array<float, kMaxBeams> cos_{};   ///< of the beam's direction in Body
    std::array<float, kMaxBeams> sin_{};
    std::int32_t count_ = 0;
    float bearing_first_rad_ = 0.0F;
    float bearing_increment_rad_ = 0.0F;
    float yaw_rad_ = 0.0F;
    Counters counters_;
};

}  // namespace noctule
