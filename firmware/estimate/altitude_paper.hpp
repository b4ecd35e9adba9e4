/// The multilevel filter as the paper has it: independent Kalman filters for (z, vz) and for each level entry.
///
/// Model: docs/maths/altitude.md, section "The paper's form" (Pepe, Satler, Tripicchio, section II.B, equations 5 and 6,
/// after Grzonka). The `paper` preset uses it; its variances are too small by design, see the page.
/// Frame Map. SI units. All storage inside, no heap, not thread-safe.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "estimate/altitude_reading.hpp"
#include "estimate/level.hpp"
#include "params.gen.hpp"

namespace noctule {

class AltitudePaper {
public:
    explicit AltitudePaper(const Parameters& parameters) : p_(parameters) { start(); }

    /// At rest on the floor; levels: ground 0.0 m and ceiling alt_paper_ceiling_m, both at the origin and of unknown extent.
    void start();

    /// z and vz over dt_s with the vertical acceleration. measured false: no inertial sample, the value is a guess.
    void predict(double accel_up_m_s2, double dt_s, bool measured);

    /// One reading: correct z from the merged levels near it, then each of those levels, insert, merge.
    /// False: no level was near; the reading made a new entry.
    bool fuse(const AltitudeReading& reading);

    /// At rest: climb is zero with this variance.
    void rest(double variance_m2_s2);

    /// At rest what the accelerometer shows is its bias. The paper has no bias state and does not say what it does
    /// about bias; here the mean at rest is taken off. accel_up as given to predict.
    void learn_bias(double accel_up_m_s2);

    [[nodiscard]] double z_m() const { return z_; }
    [[nodiscard]] double vz_m_s() const { return vz_; }
    [[nodiscard]] double z_var_m2() const { return p_zz_; }
    [[nodiscard]] double vz_var_m2_s2() const { return p_vv_; }
    [[nodiscard]] const Bounded<Level, kMaxPaperLevels>& levels() const { return levels_; }

    /// Entry nearest to what the side saw last, -1 none.
    [[nodiscard]] std::int32_t last(const RangeSide side) const { return last_[static_cast<std::size_t>(side)]; }

private:
    [[nodiscard]] bool near(const Level& level, const AltitudeReading& reading) const;
    void merge_near(const AltitudeReading& reading);
    void remove(std::size_t i);

    const Parameters& p_;
    double z_ = 0.0;
    double vz_ = 0.0;
    double p_zz_ = 1.0;
    double p_zv_ = 0.0;
    double p_vv_ = 1.0;
    double bias_ = 0.0;             ///< mean vertical acceleration at rest [m/s^2]
    std::int32_t bias_samples_ = 0;
    Bounded<Level, kMaxPaperLevels> levels_;   ///< one entry a place; the box is the place
    std::array<std::int32_t, 2> last_{-1, -1};
};

}  // namespace noctule
