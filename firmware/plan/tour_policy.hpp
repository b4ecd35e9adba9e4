/// The default policy: all that is left is put into an open tour, and its first stop is the goal.
///
/// docs/maths/explore.md. A pass: survey (costs from the vehicle, edge of the unknown with viewpoints), ways between the
/// viewpoints, tour, decision. Frame Map. No heap.
#pragma once

#include <cstdint>

#include "params.gen.hpp"
#include "plan/policy.hpp"
#include "plan/survey.hpp"
#include "plan/tour.hpp"
#include "plan/worth.hpp"

namespace noctule {

class TourPolicy final : public Policy {
public:
    explicit TourPolicy(const Parameters& parameters) : p_(parameters) {}
    void begin(const Pose2<Map, Body>& home) override;
    const PolicyAnswer& step(const MapView& map, const Pose2<Map, Body>& pose, std::int32_t budget_cells) override;
    /// The floor is explored: goes on with the places still to be passed in search of openings (plan/soundings).
    void resume();
    [[nodiscard]] std::size_t stops() const { return stops_.size(); }

private:
    enum class Phase : std::uint8_t { survey, ways };
    [[nodiscard]] MapView soon(const MapView& map) const;
    void think(const MapView& map, std::int32_t budget_cells);
    void gather_stops(const MapView& map);
    void decide(const MapView& map);
    void look(const MapView& map, const Pose2<Map, Body>& pose);
    void drop(const MapView& map, bool give_up);
    void set_goal(const Frontier& front);
    [[nodiscard]] ViewRule rule() const;
    [[nodiscard]] bool settled(const MapView& map) const;

    const Parameters& p_;
    PolicyAnswer answer_;
    Frontier goal_;                               ///< while answer_.valid
    Bounded<Frontier, kMaxStops - 1U> stops_;     ///< of the last complete pass; of groups with nearly one viewpoint the nearest
    Bounded<Frontier, kMaxStops - 1U> last_tour_; ///< the same in the order of the tour
    RootGraph graph_;
    Tour tour_;
    Phase phase_ = Phase::survey;
    bool passing_ = false;                        ///< explored: places to pass come before what is still unknown
    std::int64_t dwell_since_us_ = -1;
    std::int64_t passed_us_ = 0;                  ///< end of the last pass
    std::int32_t empty_passes_ = 0;               ///< in a row, without any goal
    std::int64_t empty_since_us_ = 0;
    Pose2<Map, Body> from_;                       ///< setpoint of the last step
    std::int64_t from_us_ = -1;
    float vx_m_s_ = 0.0F;                         ///< of the setpoint
    float vy_m_s_ = 0.0F;
    LeftGoal left_;                               ///< for a better one
    LeftGoal seen_;                               ///< because it had been seen
};

}  // namespace noctule
