// The floors and ceilings of the building, out of the levels. docs/maths/altitude.md, "Floors and ceilings".
#include <algorithm>
#include <array>
#include <cmath>

#include "estimate/altitude_filter.hpp"

namespace noctule {
namespace {

constexpr double kSameSigma = 3.0;  // levels this close, in sigmas of their difference, may be one surface

double square(const double v) { return v * v; }

}  // namespace

void AltitudeFilter::surfaces(Bounded<Level, kMaxSurfaces>& out) const {
    using J = AltitudeJoint;
    out.clear();
    if (!use_joint_) { return; }
    const auto of_building = [this](const std::size_t i) {
        const Slot& s = slots_[i];
        if (!s.confirmed) { return false; }
        if (s.level.facing > 0) { return s.level.floor; }
        // Seen from below: wide, and a storey above the highest floor that lies under it. A lintel and a table are not.
        double under = -1.0e9;
        for (const Slot& f : slots_) {
            const double z = elevation(static_cast<std::size_t>(&f - slots_.begin()));
            if (f.level.floor && z < elevation(i)) { under = std::max(under, z); }
        }
        return s.level.extent_m() >= p_.floor_extent_min_m && elevation(i) - under >= static_cast<double>(p_.floor_step_min_m);
    };
    std::array<bool, kMaxLevels> taken{};
    for (std::size_t seed = 0; seed < slots_.size(); ++seed) {
        if (taken[seed] || !of_building(seed)) { continue; }
        std::array<double, kMaxLevels> weight{};
        double weights = 0.0;
        Level surface = slots_[seed].level;
        surface.floor = surface.facing > 0;
        surface.seen = 0;
        for (std::size_t i = seed; i < slots_.size(); ++i) {
            const Level& level = slots_[i].level;
            if (taken[i] || level.facing != surface.facing || !of_building(i)) { continue; }
            J::Row difference;
            difference.add(J::kFirstLevel + i, 1.0);
            difference.add(J::kFirstLevel + seed, -1.0);
            const double sigma = i == seed ? 0.0 : std::sqrt(std::max(joint_.variance(difference), 0.0));
            if (std::fabs(elevation(i) - elevation(seed)) > static_cast<double>(p_.alt_merge_m) + kSameSigma * sigma) { continue; }
            taken[i] = true;
            weight[i] = static_cast<double>(std::max<std::int32_t>(level.seen, 1));
            weights += weight[i];
            surface.seen += level.seen;
            surface.extend(level.x_min_m, level.y_min_m);
            surface.extend(level.x_max_m, level.y_max_m);
            surface.first_t_us = std::min(surface.first_t_us, level.first_t_us);
            surface.last_t_us = std::max(surface.last_t_us, level.last_t_us);
        }
        double z = 0.0;
        for (std::size_t i = 0; i < slots_.size(); ++i) { z += weight[i] / weights * elevation(i); }
        double variance = 0.0;  // of the weighted mean, and how far its parts lie from it
        for (std::size_t i = 0; i < slots_.size(); ++i) {
            if (weight[i] == 0.0) { continue; }
            variance += weight[i] / weights * square(elevation(i) - z);
            for (std::size_t k = 0; k < slots_.size(); ++k) {
                variance += weight[i] * weight[k] / square(weights) * joint_.covariance(J::kFirstLevel + i, J::kFirstLevel + k);
            }
        }
        surface.z_m = static_cast<float>(z);
        surface.z_var_m2 = static_cast<float>(variance);
        if (out.full() || !out.push(surface)) { break; }
    }
    std::sort(out.begin(), out.end(), [](const Level& a, const Level& b) { return a.z_m < b.z_m; });
}

}  // namespace noctule
