// The planar estimator tells the truth about its error: normalised error squared over seeds, and what it says when it knows less.
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "core/matrix.hpp"
#include "estimate/localiser.hpp"
#include "unit/support/planar_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace noctule {
namespace {

constexpr int kSeeds = 12;

/// Mean over a flight of e^T P^-1 e, e = (x, y, yaw) against truth. Expected 3 for an exact covariance, less for a cautious one.
double normalised_error_squared(const std::uint32_t seed) {
    test::PlanarWorld world;
    world.box(0, 0, 12, 7);
    world.wall(6, 0, 6, 2.5);
    world.wall(6, 3.6, 6, 7);
    world.box(2.5, 4.2, 3.2, 5.0);
    world.move(0.2967, 0.4, -0.7);
    std::vector<std::array<double, 2>> way{{1.5, 1.5}, {5.0, 3.0}, {7.2, 3.1}, {10.5, 5.5}, {7.2, 3.0}, {4.8, 3.0}, {2.0, 1.5}};
    for (auto& p : way) {
        const double c = std::cos(0.2967), s = std::sin(0.2967);
        p = {c * p[0] - s * p[1] + 0.4, s * p[0] + c * p[1] - 0.7};
    }
    const test::Flight flight(way, 1.0, 0.5);
    test::Sensors sensors(world, flight, test::Noise{}, seed);
    const Parameters parameters;
    sensors.laser_height_m = static_cast<double>(parameters.lidar_z_m);
    sensors.beams = 720;
    auto localiser = std::make_unique<Localiser>(parameters);
    auto frame = std::make_unique<SensorFrame>();
    const test::Truth start = flight.at(0.0);
    double sum = 0.0;
    int n = 0;
    for (double t_s = 0.0; t_s <= flight.duration_s(); t_s += 0.05) {
        sensors.frame(t_s, *frame);
        const PlanarEstimate& estimate = localiser->update(*frame, AltitudeEstimate{});
        std::array<double, 3> e{};
        test::in_map(start, flight.at(t_s), e[0], e[1], e[2]);
        e[0] -= static_cast<double>(estimate.pose_map_body.x_m);
        e[1] -= static_cast<double>(estimate.pose_map_body.y_m);
        e[2] = std::remainder(e[2] - static_cast<double>(estimate.pose_map_body.yaw_rad), 2.0 * M_PI);
        const auto& c = estimate.covariance;
        Matrix<double, 3, 3> p;
        const std::array<std::size_t, 9> upper{0, 1, 2, 1, 3, 4, 2, 4, 5};
        for (std::size_t i = 0; i < 9; ++i) { p.values[i] = static_cast<double>(c[upper[i]]); }
        Matrix<double, 3, 3> inverse;
        TEST_ASSERT_TRUE(invert(p, inverse));
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j = 0; j < 3; ++j) { sum += e[i] * inverse(i, j) * e[j]; }
        }
        ++n;
    }
    return sum / n;
}

void normalised_error_of_the_pose_stays_in_its_band() {
    // Band: the mean over seeds of a consistent filter is 3. Within one flight errors are correlated (the map's errors are lasting), so
    // the mean of twelve flights scatters about as chi-square with 36 degrees of freedom over twelve: 95 % in [1.8, 4.5]. The filter is
    // meant to be cautious, not bold: the lower edge is 0.3, the upper edge stands.
    double sum = 0.0, worst = 0.0;
    for (std::uint32_t seed = 1; seed <= kSeeds; ++seed) {
        const double nees = normalised_error_squared(seed);
        sum += nees;
        worst = std::max(worst, nees);
    }
    std::printf("mean normalised error squared over seeds 1 to %d: %.2f, worst flight %.2f\n", kSeeds, sum / kSeeds, worst);
    TEST_ASSERT_TRUE(sum / kSeeds > 0.3);
    TEST_ASSERT_TRUE(sum / kSeeds < 4.5);
    TEST_ASSERT_TRUE(worst < 12.0);
}

}  // namespace
}  // namespace noctule

int main() {
    using namespace noctule;
    UNITY_BEGIN();
    RUN_TEST(normalised_error_of_the_pose_stays_in_its_band);
    return UNITY_END();
}
