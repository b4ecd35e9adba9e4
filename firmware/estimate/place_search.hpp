/// Finds a place from before among the keyframes: after a loss, and where the way has grown doubtful enough to close a loop.
///
/// A sweep is looked for in the maps that the keyframes of before make, a slice a step; what is found must be alone, and must
/// explain further sweeps from elsewhere. Page: docs/maths/scan_match.md#place. Frame Map. 0.6 MB, no heap, not thread-safe.
/// Cost of a step: one search of at most 1.3 million cell lookups and three refinements, about a millisecond; nothing when idle.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "core/frames.hpp"
#include "core/matrix.hpp"
#include "estimate/keyframes.hpp"
#include "estimate/relocation.hpp"
#include "estimate/scan_map.hpp"
#include "estimate/scan_shape.hpp"
#include "params.gen.hpp"

namespace noctule {

class PlaceSearch {
public:
    struct Counters {
        std::uint32_t rounds = 0;      ///< sweeps looked for
        std::uint32_t ambiguous = 0;   ///< found at several places
        std::uint32_t refuted = 0;     ///< found, but further sweeps did not agree
        std::uint32_t found = 0;
    };

    explicit PlaceSearch(const Parameters& parameters) : parameters_(parameters) {}

    /// Forgets what it was looking for.
    void clear() { phase_ = Phase::idle; }

    /// One slice. pose: of this sweep; covariance: of it against the start (x, y, yaw); anywhere: that says nothing, all places of
    /// epochs before this one and all headings are looked at. True: found, see relocation().
    [[nodiscard]] bool step(const Keyframes& frames, const ScanShape& shape, const Pose2<Map, Body>& pose, const Matrix<float, 3, 3>& covariance,
                            bool anywhere, std::uint16_t epoch);

    [[nodiscard]] const Relocation& relocation() const { return relocation_; }
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    enum class Phase : std::uint8_t { idle, searching, confirming };
    struct Hit {
        Pose2<Map, Body> pose;
        float share = 0.0F;
        std::size_t frame = 0;
    };

    [[nodiscard]] bool candidate(const Keyframes& frames, std::size_t i) const;
    [[nodiscard]] bool worth_it(const Keyframes& frames) const;
    void next_spot();
    [[nodiscard]] bool next_centre(const Keyframes& frames);
    void search_slice(const Keyframes& frames);
    void decide(const Keyframes& frames);
    [[nodiscard]] bool confirm(const Keyframes& frames, const ScanShape& shape, const Pose2<Map, Body>& pose);
    [[nodiscard]] ScanFit fit(const ScanShape& shape, const Pose2<Map, Body>& start, float sigma_m, float sigma_rad);
    void fill(const Keyframes& frames, const Pose2<Map, Body>& centre);
    void note(const Hit& hit);

    const Parameters& parameters_;
    Phase phase_ = Phase::idle;
    std::uint32_t wait_ = 0;           ///< steps until the next round
    bool anywhere_ = false;
    std::uint16_t epoch_ = 0;
    std::size_t last_frame_ = 0;       ///< keyframes from here on are too recent
    ScanShape shape_;                  ///< the sweep looked for
    Pose2<Map, Body> pose_;
    FrameDoubt doubt_;
    std::size_t cursor_ = 0;
    std::size_t spot_ = 0;             ///< at and beside that keyframe
    std::int32_t slice_ = 0;
    Pose2<Map, Body> centre_;
    float half_m_ = 0.0F;
    float half_rad_ = 0.0F;
    bool here_ = false;                ///< the prediction itself is narrow enough to be the only centre
    Bounded<Point2<Map>, kMaxPlaceCentres> centres_;
    Hit best_;
    Hit second_;
    Pose2<Map, Map> correction_;
    std::int32_t confirmed_ = 0;
    std::uint32_t since_ = 0;          ///< steps in this phase
    Pose2<Map, Body> confirmed_at_;
    ScanMap map_;
    Relocation relocation_;
    Counters counters_;
};

}  // namespace noctule
