/// Where am I: one scan and the samples before it in, planar pose, velocity and their covariance out.
///
/// Order: refuse bad samples; predict with the inertial data; level the sweep along the predicted motion; extract walls; match
/// what no wall explains with the point map; particle filter; correct the inertial filter with the laser's own information.
/// Page: docs/maths/localisation.md. Frame Map; the first accepted scan is at (0, 0, 0). One instance per vehicle, about 4 MB
/// inside the object, no heap, not thread-safe.
#pragma once

#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "estimate/estimate.hpp"
#include "estimate/inertial_filter.hpp"
#include "estimate/motion.hpp"
#include "estimate/place_search.hpp"
#include "estimate/point_map.hpp"
#include "estimate/scan_tracker.hpp"
#include "estimate/wall_filter.hpp"
#include "params.gen.hpp"
#include "sense/leveller.hpp"
#include "sense/plausibility.hpp"
#include "sense/samples.hpp"
#include "sense/walls.hpp"

namespace noctule {

class Localiser {
public:
    struct Counters {
        std::uint32_t refused_samples = 0;   ///< inertial, attitude and scan messages refused, all reasons
        std::uint32_t refused_beams = 0;     ///< beams refused, floor and ceiling hits not counted
        std::uint32_t coasted = 0;           ///< intervals bridged without inertial data
        std::uint32_t blind_scans = 0;       ///< scans that gave no information on the pose
        std::uint32_t lost = 0;              ///< times that the pose became lost
        std::uint32_t landmarks_evicted = 0;
        std::uint32_t cells_evicted = 0;
        std::uint32_t carried = 0;           ///< times that the surroundings were suddenly others
        std::uint32_t recognised = 0;        ///< places from before that the pose was corrected by
    };

    explicit Localiser(const Parameters& parameters);

    /// One step. A frame whose scan is refused changes nothing but the counters and gives the last estimate again with the age
    /// that it has. last_altitude: of the step before; without a valid one no beam is taken for a floor or ceiling hit.
    const PlanarEstimate& update(const SensorFrame& frame, const AltitudeEstimate& last_altitude);

    /// The same with motion from elsewhere (wheel odometry): frame.imu is ignored, the increment leads to the scan's stamp.
    const PlanarEstimate& update(const SensorFrame& frame, const AltitudeEstimate& last_altitude, const MotionIncrement& motion);

    /// Another floor (0 to kMaxFloors - 1) or a shaft between two (kShaftLayer, begun anew each time): its walls and points are taken
    /// up, those of the layer before are kept for its return. The pose and the doubt about it are carried over.
    void enter_layer(std::int32_t layer);
    static constexpr std::int32_t kShaftLayer = kMaxFloors;

    [[nodiscard]] const LevelScan& level_scan() const { return level_scan_; }
    [[nodiscard]] const PlanarEstimate& estimate() const { return estimate_; }
    /// Walls of the best particle. What does not fit is refused and counted by the container.
    void walls(Bounded<WallSegment, kMaxWalls>& out) const { filter_.best_walls(out); }
    [[nodiscard]] Counters counters() const;
    [[nodiscard]] const SampleChecker::Counters& sample_counters() const { return checker_.counters(); }
    [[nodiscard]] const WallExtractor& extractor() const { return extractor_; }
    [[nodiscard]] const WallFilter& filter() const { return filter_; }
    [[nodiscard]] const ScanTracker& tracker() const { return tracker_; }
    [[nodiscard]] const PointMap& points() const { return points_; }

private:
    void take_attitude(const SensorFrame& frame);
    [[nodiscard]] AttitudeSample attitude_at(std::int64_t t_us) const;
    void predict_to(const SensorFrame& frame, std::int64_t t_us);
    void advance(const ImuSample& from, const ImuSample& to, std::int64_t until_us);
    void push_node();
    const PlanarEstimate& finish(const SensorFrame& frame, const AltitudeEstimate& last_altitude, const MotionIncrement& motion);
    void collect_match_points();
    [[nodiscard]] bool match_leads();
    void keep_sweep(const Pose2<Map, Body>& pose);
    void watch_surroundings(const Pose2<Map, Body>& pose, bool climbs);
    void lose(const FrameDoubt& more);
    void anchor();
    void recognise();
    void rebuild_points(std::size_t most);
    [[nodiscard]] Matrix<float, 3, 3> published_covariance() const;
    void publish(const Pose2<Map, Body>& predicted, const WallFilter::Result& result, bool informed);

    const Parameters& parameters_;
    SampleChecker checker_;
    Leveller leveller_;
    WallExtractor extractor_;
    InertialFilter inertial_;
    WallFilter filter_;
    PointMap points_;
    std::array<StoredWalls, kFloorSlots + 1> stored_{};
    std::size_t layer_ = 0;
    ScanTracker tracker_;
    PlaceSearch search_;
    bool carried_ = false;             ///< the surroundings were suddenly others; where it is now is looked for
    std::int32_t familiar_ = 0;        ///< sweeps in a row that the map explained
    std::int32_t strange_ = 0;         ///< sweeps since it suddenly did not
    std::size_t rebuilt_ = kMaxKeyframes;   ///< keyframes whose points are back in the point map; kMaxKeyframes: nothing to do

    bool started_ = false;
    std::int64_t now_us_ = 0;          ///< time that the inertial filter stands at
    std::int64_t informed_us_ = 0;     ///< last time that the laser said something
    bool have_imu_ = false;
    ImuSample last_imu_;
    Bounded<AttitudeSample, kMaxAttitudePerStep + 1> attitude_;  ///< the last one of the step before, then this step's
    SweepMotion motion_;
    LevelScan level_scan_;
    MatchPoints match_points_;
    MatchPoints rebuild_;
    bool parted_ = false;              ///< lost, and the walls of before are put away
    std::array<double, 3> odometry_pose_{};  ///< sum of the increments of the second form of update: x, y, yaw
    bool external_motion_ = false;
    bool match_leads_ = false;
    PlanarEstimate estimate_;
    std::uint32_t coasted_ = 0;
    std::uint32_t blind_scans_ = 0;
    std::uint32_t lost_ = 0;
    std::uint32_t carried_count_ = 0;
};

}  // namespace noctule
