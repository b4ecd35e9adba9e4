/// The method as published: a harmonic potential in a window round the vehicle, whose negative gradient is followed.
///
/// ../docs/maths/explore.md, "The paper's way" (paper, exploration section; Prestes et al. 2002). Obstacles and the vehicle's own
/// cell 1, a cell that was never in the window 0, the cells between the mean of their four neighbours (Gauss-Seidel until
/// the relative change is under 1e-4); the cells on the window's border stay as they are. It needs the size of the area in advance. Ends when
/// under paper_unknown_share of the known free cells were never in the window, or when no cell beside the vehicle is lower for kNowhereUs.
/// Where the hull does not fit counts as obstacle. Frame Map. No heap.
#pragma once

#include <array>
#include <cstdint>

#include "params.gen.hpp"
#include "plan/policy.hpp"

namespace noctule {

class PaperPolicy final : public Policy {
public:
    explicit PaperPolicy(const Parameters& parameters) : p_(parameters) {}
    void begin(const Pose2<Map, Body>& home) override;
    const PolicyAnswer& step(const MapView& map, const Pose2<Map, Body>& pose, std::int32_t budget_cells) override;

    /// Share of the known free cells that were never in the window; of the last count.
    [[nodiscard]] float unknown_share() const { return unknown_share_; }
    /// True: it ended because the gradient led nowhere, not because enough was known.
    [[nodiscard]] bool led_nowhere() const { return led_nowhere_; }

private:
    static constexpr auto kSide = static_cast<std::int32_t>(kMaxPaperSide);   ///< cells of the area, centred on the start
    [[nodiscard]] double& at(const std::int32_t x, const std::int32_t y) { return phi_[static_cast<std::size_t>(y * kSide + x)]; }
    void relax(const MapView& map, Cell centre, std::int32_t half);
    void trace(const MapView& map, Cell centre, std::int32_t half);
    void count(const MapView& map);

    const Parameters& p_;
    PolicyAnswer answer_;
    Bounded<PathPoint, kMaxPathPoints> path_;
    std::array<double, static_cast<std::size_t>(kSide) * kSide> phi_{};
    Cell corner_;                    ///< cell of the lattice that phi_ begins with
    std::int64_t lowered_us_ = -1;   ///< when the gradient last led on
    std::int64_t counted_us_ = -1;
    float unknown_share_ = 1.0F;
    float least_share_ = 1.0F;
    bool led_nowhere_ = false;
};

}  // namespace noctule
