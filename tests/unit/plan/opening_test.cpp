// Where to go through an opening: looked round first, in the middle of a small one, not at all through one too small.
#include "plan/opening.hpp"

#include <cmath>
#include <memory>

#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

constexpr float kPi2 = 6.2831853F;

/// An empty hall of 12 x 12 m about the origin, and a square opening in its ceiling.
struct Hall {
    Parameters p;
    std::unique_ptr<OccupancyGrid> grid;
    std::unique_ptr<Traversability> where;
    std::unique_ptr<VerticalMap> map = std::make_unique<VerticalMap>(0.1F);
    std::unique_ptr<OpeningJudge> judge;
    float x_m = 0.0F;        ///< centre of the opening
    float y_m = 0.0F;
    float half_m = 0.7F;
    BeyondBand beyond{3.5F, 1e9F};

    Hall(const float cx_m, const float cy_m, const float side_m, const float hull_m = 0.30F) : x_m(cx_m), y_m(cy_m), half_m(0.5F * side_m) {
        p.hull_radius_m = hull_m;
        grid = std::make_unique<OccupancyGrid>(p);
        where = std::make_unique<Traversability>(p);
        judge = std::make_unique<OpeningJudge>(p);
        Estimate estimate;
        estimate.planar.quality = 100;
        estimate.altitude.valid = true;
        estimate.altitude.z_m = p.cruise_height_m;
        LevelScan scan;
        scan.range_max_m = 10.0F;
        scan.bearing_increment_rad = kPi2 / 900.0F;
        for (int k = 0; k < 900; ++k) {
            const float a = kPi2 * static_cast<float>(k) / 900.0F - 0.5F * kPi2;
            const float r = 6.0F / std::max(std::fabs(std::cos(a)), std::fabs(std::sin(a)));
            static_cast<void>(scan.points.push({r * std::cos(a), r * std::sin(a), 0.0F, 0.0F, 0.0F, r, static_cast<std::int16_t>(k), true}));
        }
        for (int i = 0; i < 12; ++i) { grid->integrate(estimate, scan); }
        for (int i = 0; i < 60; ++i) { where->update(*grid, 0.0F, 0.0F); }
    }
    void look(const float x, const float y) {
        const bool open = std::fabs(x - x_m) < half_m && std::fabs(y - y_m) < half_m;
        map->add(0, VerticalSide::over, x, y, open ? 4.8F : 2.3F);
    }
    void fly(const float x0, const float y0, const float x1, const float y1) {
        const float length = std::hypot(x1 - x0, y1 - y0);
        for (float s = 0.0F; s <= length; s += 0.04F) { look(x0 + s / length * (x1 - x0), y0 + s / length * (y1 - y0)); }
    }
    OpeningVerdict ask(const float from_x, const float from_y, const float seed_x, const float seed_y) {
        return judge->judge(*map, *grid, *where, 0, VerticalSide::over, beyond, seed_x, seed_y, from_x, from_y);
    }
    /// Looks where it is told until there is a verdict; the last one.
    OpeningVerdict survey(float from_x, float from_y, const float seed_x, const float seed_y, int& looks) {
        OpeningVerdict v;
        for (looks = 0; looks < 60; ++looks) {
            v = ask(from_x, from_y, seed_x, seed_y);
            if (v.what != OpeningVerdict::What::survey) { return v; }
            fly(from_x, from_y, v.look_x_m, v.look_y_m);
            judge->skip(v.look_x_m, v.look_y_m);   // as the floor planner does once it stood there
            from_x = v.look_x_m;
            from_y = v.look_y_m;
        }
        return v;
    }
};

void an_opening_crossed_once_is_looked_round_and_taken_in_its_middle() {
    for (const float side_m : {1.4F, 1.8F, 2.4F, 3.0F}) {
        for (const float off_m : {0.0F, 0.4F}) {   // of the line flown, from the middle
            Hall hall(1.13F, 0.57F, side_m);
            const float y_m = hall.y_m + off_m;
            hall.fly(-2.0F, y_m, 4.0F, y_m);
            int looks = 0;
            const OpeningVerdict v = hall.survey(4.0F, y_m, hall.x_m, y_m, looks);
            TEST_ASSERT_EQUAL_INT(static_cast<int>(OpeningVerdict::What::ready), static_cast<int>(v.what));
            TEST_ASSERT_TRUE(looks > 0);
            // True distance to the nearest edge: the safety distance, less the half cell by which places are known.
            const float edge_m = hall.half_m - std::max(std::fabs(v.x_m - hall.x_m), std::fabs(v.y_m - hall.y_m));
            TEST_ASSERT_TRUE_MESSAGE(edge_m > hall.p.floor_safety_m - 0.15F, "too near to an edge");
        }
    }
}

// Looks three cells apart in both directions: round any place there is a spot whose nearest look was across a corner of its cell.
void a_spot_is_not_known_by_a_look_across_a_corner() {
    Hall hall(0.05F, 0.05F, 3.0F);
    for (int i = -7; i <= 7; ++i) {
        for (int j = -7; j <= 7; ++j) { hall.look(0.05F + 0.3F * static_cast<float>(i), 0.05F + 0.3F * static_cast<float>(j)); }
    }
    TEST_ASSERT_EQUAL_INT(static_cast<int>(OpeningVerdict::What::survey), static_cast<int>(hall.ask(0.05F, 0.05F, 0.05F, 0.05F).what));
}

// Beside a wall a look round goes as near as an edge over the hull would still be seen: here 0.34 m fits, and 0.37 m does not.
void an_opening_at_a_wall_is_looked_round_as_near_as_the_hull() {
    Hall hall(5.35F, 0.05F, 1.2F, 0.29F);
    TEST_ASSERT_TRUE(hall.where->passable(hall.grid->find(5.69F, 0.05F)));
    TEST_ASSERT_FALSE(hall.where->passable(hall.grid->find(5.72F, 0.05F)));
    hall.fly(3.0F, 0.05F, 5.65F, 0.05F);
    hall.fly(5.35F, -2.0F, 5.35F, 2.0F);
    int looks = 0;
    const OpeningVerdict v = hall.survey(5.35F, 2.0F, 5.35F, 0.05F, looks);
    TEST_ASSERT_EQUAL_INT(static_cast<int>(OpeningVerdict::What::ready), static_cast<int>(v.what));
    TEST_ASSERT_FLOAT_WITHIN(0.06F, 5.35F, v.x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.11F, 0.05F, v.y_m);   // edges are known to half a cell
}

void an_opening_of_80_centimetres_is_refused() {
    Hall hall(0.33F, -0.41F, 0.8F);
    hall.fly(-2.0F, hall.y_m, 3.0F, hall.y_m);
    int looks = 0;
    const OpeningVerdict v = hall.survey(3.0F, hall.y_m, hall.x_m, hall.y_m, looks);
    TEST_ASSERT_EQUAL_INT(static_cast<int>(OpeningVerdict::What::too_small), static_cast<int>(v.what));
}

void a_wide_one_needs_less_than_the_paper_asks_unless_told() {
    Hall hall(0.0F, 0.0F, 2.4F);
    hall.p.floor_safety_m = 1.5F;   // the paper's: half of 2.4 m is less
    hall.fly(-2.0F, 0.0F, 2.0F, 0.0F);
    int looks = 0;
    TEST_ASSERT_EQUAL_INT(static_cast<int>(OpeningVerdict::What::too_small), static_cast<int>(hall.survey(2.0F, 0.0F, 0.0F, 0.0F, looks).what));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(an_opening_crossed_once_is_looked_round_and_taken_in_its_middle);
    RUN_TEST(a_spot_is_not_known_by_a_look_across_a_corner);
    RUN_TEST(an_opening_at_a_wall_is_looked_round_as_near_as_the_hull);
    RUN_TEST(an_opening_of_80_centimetres_is_refused);
    RUN_TEST(a_wide_one_needs_less_than_the_paper_asks_unless_told);
    return UNITY_END();
}
