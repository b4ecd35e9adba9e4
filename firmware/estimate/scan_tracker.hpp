/// The scan match beside the walls: keeps keyframes, matches each sweep with the map that they make around the vehicle.
///
/// Page: docs/maths/scan_match.md. Frame Map. No heap, not thread-safe.
#pragma once

#include "core/frames.hpp"
#include "core/matrix.hpp"
#include "estimate/keyframes.hpp"
#include "estimate/scan_map.hpp"
#include "estimate/scan_shape.hpp"
#include "params.gen.hpp"
#include "sense/level_scan.hpp"

namespace noctule {

class ScanTracker {
public:
    struct Counters {
        std::uint32_t searches = 0;   ///< matches that needed the search over places and headings
        std::uint32_t poor = 0;       ///< matches that explain too little of the sweep
    };

    explicit ScanTracker(const Parameters& parameters) : parameters_(parameters) {}

    void clear();
    /// What comes is not known against what was: keyframes of before are left out of the map until relocate().
    void begin_epoch();
    /// Moves keyframes and pose; those of before count again.
    void relocate(const Relocation& relocation);
    /// Takes a sweep in, for match() and keep().
    void take(const LevelScan& scan);
    /// Where the sweep lies in the map, near a prediction with its covariance (x, y, yaw). `sure_motion`: the prediction is inertial, so a match far
    /// outside of it is refused at first (docs/maths/scan_match.md#motion); a wheel may slip.
    const ScanFit& match(const Pose2<Map, Body>& predicted, const Matrix<float, 3, 3>& covariance, bool sure_motion = false);
    /// The pose that the sweep was given in the end, and the doubt about it: becomes a keyframe when one is due.
    void keep(const Pose2<Map, Body>& pose, const FrameDoubt& doubt);
    /// Share of this sweep's points that fall where the map has something; 1 without a map.
    [[nodiscard]] float explained(const Pose2<Map, Body>& pose) const { return map_.empty() ? 1.0F : map_.explained(shape_, pose); }

    /// Share of the map's cells in view, up to reach_m, that this sweep passes through.
    [[nodiscard]] float passed_through(const Pose2<Map, Body>& pose, const float reach_m) const { return map_.passed_through(shape_, pose, reach_m); }

    [[nodiscard]] const ScanFit& fit() const { return fit_; }
    [[nodiscard]] const Counters& counters() const { return counters_; }
    [[nodiscard]] const Keyframes& frames() const { return frames_; }
    [[nodiscard]] const ScanMap& map() const { return map_; }
    [[nodiscard]] const ScanShape& shape() const { return shape_; }
    [[nodiscard]] std::uint16_t epoch() const { return epoch_; }

private:
    const Parameters& parameters_;
    ScanShape shape_;
    ScanFit fit_;
    Pose2<Map, Body> last_pose_;          ///< of the sweep before
    Pose2<Body, Body> last_step_;         ///< of the sweep before against the one before it
    float last_step_s_ = 0.0F;
    float since_last_s_ = 0.0F;
    std::int64_t t_us_ = 0;
    float last_scale_ = 1.0F;
    float usual_share_ = 0.6F;
    std::int64_t refused_from_us_ = -1;   ///< since then every match was refused; -1: the last one was not
    std::uint16_t epoch_ = 0;
    std::uint16_t first_epoch_ = 0;       ///< keyframes of earlier ones are left out
    [[nodiscard]] Pose2<Map, Body> as_before() const;
    void fill(const Pose2<Map, Body>& pose);
    ScanMap map_;
    Keyframes frames_;
    Counters counters_;
};

}  // namespace noctule
