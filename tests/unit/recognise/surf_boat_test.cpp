// SURF on real photographs with a published homography (Oxford "boat": turn and zoom). Skipped where the data is absent.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <span>
#include <string>

#include "recognise/surf_match.hpp"
#include "unit/recognise/test_image.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

namespace {

std::string data_folder() {
    const char* const given = std::getenv("NOCTULE_DATA");
    return (given != nullptr ? std::string{given} : std::string{"../shared/data"}) + "/obj_oxford_boat/";
}

struct Score {
    int matches = 0;
    int correct = 0;   // within 4 px of the homography
};

Score score(const noctule::Surf& first, const noctule::Surf& second, const double (&H)[9]) {
    const auto matches = std::make_unique<noctule::SurfMatches>();
    noctule::match_surf({first.features().begin(), first.features().size()}, {second.features().begin(), second.features().size()},
                        0.8F, false, *matches);
    Score s;
    for (const noctule::SurfMatch& m : *matches) {
        const noctule::SurfPoint& a = first.features()[static_cast<std::size_t>(m.first)].point;
        const noctule::SurfPoint& b = second.features()[static_cast<std::size_t>(m.second)].point;
        const double u = static_cast<double>(a.x_px);
        const double v = static_cast<double>(a.y_px);
        const double w = H[6] * u + H[7] * v + H[8];
        const double dx = (H[0] * u + H[1] * v + H[2]) / w - static_cast<double>(b.x_px);
        const double dy = (H[3] * u + H[4] * v + H[5]) / w - static_cast<double>(b.y_px);
        ++s.matches;
        s.correct += std::hypot(dx, dy) < 4.0 ? 1 : 0;
    }
    return s;
}

void boat_pairs_match_in_most() {
    vision_test::Picture first;
    if (!vision_test::read_pgm(data_folder() + "img1.pgm", first)) { TEST_IGNORE_MESSAGE("skipped: no data"); }
    const auto a = std::make_unique<noctule::Surf>();
    const auto b = std::make_unique<noctule::Surf>();
    a->extract(first.view(), noctule::SurfSettings{});
    for (const int n : {2, 3, 4}) {
        vision_test::Picture other;
        TEST_ASSERT_TRUE(vision_test::read_pgm(data_folder() + "img" + std::to_string(n) + ".pgm", other));
        std::ifstream file{data_folder() + "H1to" + std::to_string(n) + "p"};
        double H[9] = {};
        for (double& h : H) { file >> h; }
        TEST_ASSERT_TRUE(static_cast<bool>(file));
        b->extract(other.view(), noctule::SurfSettings{});
        const Score s = score(*a, *b, H);
        std::printf("boat 1-%d: %d matches, %d correct\n", n, s.matches, s.correct);
        TEST_ASSERT_TRUE(s.correct >= 200);
        TEST_ASSERT_TRUE(100 * s.correct >= 80 * s.matches);
    }
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(boat_pairs_match_in_most);
    return UNITY_END();
}
