/// Particle filter over pose and wall landmarks (FastSLAM with a measurement-informed proposal, algorithms E).
///
/// Each particle is one pose and up to kMaxLandmarks walls, independent given its path. Derivation, weights, and what the
/// default does beyond the paper: docs/maths/localisation.md#filter. Frame Map. Not thread-safe, no heap, about 1.5 MB.
/// Cost: particles x observations x landmarks in reach, under a millisecond at 100 x 15 x 100 on a desktop core.
#pragma once

#include <array>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "core/matrix.hpp"
#include "core/random.hpp"
#include "estimate/motion.hpp"
#include "estimate/point_map.hpp"
#include "estimate/scan_map.hpp"
#include "estimate/wall_landmark.hpp"
#include "params.gen.hpp"
#include "sense/level_scan.hpp"
#include "sense/walls.hpp"

namespace noctule {

/// A landmark as the world sees it (walls_t), frame Map.
struct WallSegment {
    HessianLine line;
    Point2<Map> end0;
    Point2<Map> end1;
    float r_var_m2 = 0.0F;
    float alpha_var_rad2 = 0.0F;
    std::int16_t seen = 0;
};

/// Walls of a layer that is not in use: those of the particle that was best when it was left. Frame Map.
struct StoredWalls {
    std::int32_t count = 0;
    std::array<Landmark, kMaxLandmarks> landmarks{};
};

class WallFilter {
public:
    struct Counters {
        std::uint32_t resampled = 0;
        std::uint32_t evicted = 0;   ///< landmarks that gave way to new ones, over all particles
        std::uint32_t removed = 0;   ///< landmarks removed because beams pass through them
        std::uint32_t merged = 0;    ///< landmarks found to be one wall
        std::uint32_t restarts = 0;  ///< weights that had become meaningless
    };

    /// Mean and spread of the particles, what this scan alone said, and how far the map itself may be off.
    struct Result {
        Pose2<Map, Body> pose;
        Matrix<float, 3, 3> spread;      ///< covariance of the particles
        Matrix<float, 3, 3> map_drift;   ///< covariance of the map's frame here against the frame of the start
        LaserInformation laser;
        float effective_particles = 0.0F;
        std::int32_t walls_matched = 0;  ///< in the best particle
    };

    explicit WallFilter(const Parameters& parameters) : parameters_(parameters) { start({}); }

    /// All particles at one pose, without landmarks.
    void start(const Pose2<Map, Body>& pose);

    /// Moves every particle. Afterwards mean() is the predicted pose.
    void predict(const MotionIncrement& motion);

    /// Associates, samples, weighs and resamples. match may be invalid. The scan serves the visibility counters.
    const Result& update(const WallObservations& walls, const PoseMatch& match, const LevelScan& scan);

    /// In place of update(): the match alone moves the pose; walls are learnt by one particle, whose copies the others become when
    /// update() is called again.
    const Result& follow(const WallObservations& walls, const ScanFit& fit, const LevelScan& scan);

    /// Puts the walls of the best particle away and gives every particle those of another layer, which leave their store. Poses and their spread stay,
    /// so that the doubt about the pose is carried over. docs/maths/floors.md.
    void change_layer(StoredWalls& from, StoredWalls& to);

    /// After a loss: the walls of the best particle are put to those in `before`, and what comes is learnt anew, its frame in doubt by
    /// the covariance of the pose and by this much more.
    void begin_epoch(StoredWalls& before, const FrameDoubt& more);
    /// The pose as it is becomes the frame of what comes: its covariance goes over to the frame's.
    void anchor(const Matrix<float, 3, 3>& local);
    /// A place was recognised: walls and pose move, those in `before` come back and it is emptied. sigma: of the pose now.
    void relocate(const Relocation& relocation, StoredWalls& before, float sigma_m, float sigma_rad);

    [[nodiscard]] Pose2<Map, Body> mean() const { return mean_; }
    /// Covariance of the predicted pose as the proposal uses it, spread of the particles included.
    [[nodiscard]] const Matrix<float, 3, 3>& predicted_covariance() const { return predicted_covariance_; }
    [[nodiscard]] std::int32_t best_landmarks() const { return particles_[best_].count; }
    /// Share of the walls seen lately that no landmark explains within its covariance; zero where walls are straight, firm and
    /// alone, a half in an office (docs/maths/scan_match.md#lead).
    [[nodiscard]] float doubtful_walls() const { return doubtful_; }
    /// Walls have yet to prove themselves: starts at this share.
    void doubt_walls(const float share) { doubtful_ = share; }
    /// Share of the hits that lie on walls, lately.
    [[nodiscard]] float hits_on_walls() const { return on_walls_; }
    void best_walls(Bounded<WallSegment, kMaxWalls>& out) const;
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    struct Particle {
        Pose2<Map, Body> pose;
        float log_weight = 0.0F;
        std::int32_t count = 0;
        std::array<Landmark, kMaxLandmarks> landmarks{};
    };
    /// Farthest measured range in each half degree of bearing, 0 where nothing was measured.
    static constexpr std::size_t kBearingBins = 720;

    /// Default: every particle looks for its landmarks each so many scans.
    static constexpr std::uint32_t kLookPeriod = 4;
    static constexpr std::uint32_t kMergesPerStep = 10;  ///< particles whose landmarks are compared with one another in one step

    static constexpr float kSound2 = 9.0F;   ///< a wall that is expected lies within this squared distance

    /// Doubt beyond this finds no wall again, and in float it would drown what is known.
    static constexpr float kSearchable_m2 = 1.0F;

    struct Assignment {
        std::int32_t landmark = -1;
        float noise_scale = 1.0F;  ///< the observation's covariance counts so many times
        float distance2 = 0.0F;    ///< squared distance of the observation from what was expected
    };
    struct Belief {
        Pose2<Map, Body> pose;
        Matrix<float, 3, 3> p;
        Matrix<float, 3, 3> lambda;
        Matrix<float, 3, 1> b;
    };

    void update_particle(Particle& particle, std::size_t index, const WallObservations& walls, const PoseMatch& match);
    [[nodiscard]] std::int32_t associate(const Particle& particle, const Belief& belief, const WallObservation& wall) const;
    [[nodiscard]] float fuse(const Landmark& landmark, const WallObservation& wall, const Pose2<Map, Body>& predicted, Belief& belief, Assignment& assignment) const;
    static void fuse_match(const PoseMatch& match, const Pose2<Map, Body>& predicted, Belief& belief);
    /// How far the map's frame may be off where this particle is, from the walls it is tied to (docs/maths/localisation.md#drift).
    [[nodiscard]] Matrix<float, 3, 3> drift_of(const Particle& particle, const std::array<Assignment, kMaxWallsPerScan>& assigned, std::size_t walls) const;
    /// The same, which takes doubt away by a small share a step only.
    [[nodiscard]] Matrix<float, 3, 3> slowly(const Matrix<float, 3, 3>& drift) const;
    void tie(Landmark& landmark, const Pose2<Map, Body>& pose, const Matrix<float, 3, 3>& drift) const;
    void learn(Landmark& landmark, const WallObservation& wall, const Pose2<Map, Body>& pose, float noise_scale) const;
    Landmark& insert(Particle& particle, const WallObservation& wall, const Pose2<Map, Body>& pose);
    void look_for_landmarks(Particle& particle, const std::array<bool, kMaxLandmarks>& associated);
    void merge_landmarks(Particle& particle);
    void prepare_bearings(const LevelScan& scan);
    void rejoin();
    [[nodiscard]] static bool keep_most(StoredWalls& store, const Landmark& landmark);
    void judge_walls(const WallObservations& walls, const LevelScan& scan);
    void summarise();
    void resample();
    [[nodiscard]] std::size_t count() const;

    const Parameters& parameters_;
    Random random_{1U};
    std::uint32_t step_ = 0;
    bool following_ = false;
    float doubtful_ = 0.0F;
    bool fresh_ = true;   ///< the layer has no walls yet
    float on_walls_ = 0.0F;
    std::int32_t sound_ = 0;   ///< walls of this sweep that a landmark of the best particle explains
    std::size_t best_ = 0;
    Pose2<Map, Body> mean_;
    Matrix<float, 3, 3> spread_;                ///< covariance of the particles after the last update
    Matrix<float, 3, 3> motion_covariance_;     ///< of the increment, frame Body
    Matrix<float, 3, 3> widening_;              ///< frame Map, see MotionIncrement::pose_covariance
    Matrix<float, 3, 3> predicted_covariance_;  ///< at most kSearchable_m2 wider than the particles show
    Matrix<float, 3, 3> whole_covariance_;      ///< the same without that limit
    float step_m_ = 0.0F;                       ///< length of the last predicted motion
    Matrix<float, 3, 3> map_drift_;             ///< of the best particle after the last update
    std::array<float, kBearingBins> farthest_m_{};
    float range_max_m_ = 0.0F;
    float tilt_m2_ = 0.0F;
    float tilt_rad2_ = 0.0F;
    float rough_ = 1.0F;   ///< laser noise found over the one told
    Result result_;
    std::array<Particle, kMaxParticles> particles_{};
    std::array<float, kMaxParticles> weight_{};
    std::array<std::int32_t, kMaxParticles> matched_{};
    std::array<Pose2<Map, Body>, kMaxParticles> predicted_{};
    std::array<Matrix<float, 3, 3>, kMaxParticles> lambda_{};
    std::array<Matrix<float, 3, 3>, kMaxParticles> drift_{};
    std::array<Matrix<float, 3, 1>, kMaxParticles> b_{};
    Counters counters_;
};

}  // namespace noctule
