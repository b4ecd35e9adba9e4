// Where ceiling and ground were looked at: distances to the way flown against plain arithmetic, and what is left to pass.
#include <cmath>
#include <cstdio>
#include <memory>

#include "plan/soundings.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

struct Mapped {
    Parameters p;
    test::FlatWorld world = test::hall();
    std::unique_ptr<test::ClosedLoop> loop = std::make_unique<test::ClosedLoop>(p, world, 1U);
    Mapped() { static_cast<void>(test::fly(*loop, 400.0)); }
};

void distances_are_those_to_the_way_flown() {
    const auto mapped = std::make_unique<Mapped>();
    const OccupancyGrid& grid = mapped->loop->grid;
    const auto soundings = std::make_unique<Soundings>();
    std::mt19937 rng{5};
    std::uniform_real_distribution<float> place(-1.5F, 6.0F);
    std::vector<std::pair<float, float>> way;
    for (int k = 0; k < 40; ++k) {
        way.emplace_back(place(rng), place(rng));
        soundings->pass(grid, way.back().first, way.back().second);
    }
    int near = 0;
    for (std::int32_t slot = 0; slot < grid.tile_count(); ++slot) {
        for (std::int32_t k = 0; k < kTileArea; k += 7) {
            const Cell c = grid.cell(slot * kTileArea + k);
            float least = 1e9F;
            for (const auto& [x, y] : way) { least = std::min(least, std::hypot(grid.geometry().centre_x_m(c) - x, grid.geometry().centre_y_m(c) - y)); }
            const float told = soundings->distance_m(slot * kTileArea + k);
            if (least < Soundings::kReachM - 0.3F) {
                ++near;
                TEST_ASSERT_FLOAT_WITHIN(0.09F, least, told);   // a block is two cells wide, and kept in centimetres
            } else {
                TEST_ASSERT_TRUE(told > Soundings::kReachM - 0.5F);
            }
        }
    }
    TEST_ASSERT_TRUE(near > 100);
}

void what_is_left_lies_off_the_way_and_is_gone_once_passed() {
    const auto mapped = std::make_unique<Mapped>();
    const OccupancyGrid& grid = mapped->loop->grid;
    const Traversability& where = mapped->loop->mission.explorer().where();
    const auto open = std::make_unique<OpenCells>();
    const auto from = std::make_unique<CostField>();
    from->start(grid, grid.find(0.05F, 0.05F), 5, *open);
    while (!from->run(grid, where, *open, 10000, kNoCell, 0)) {}
    const TriedPlaces tried{mapped->p};
    const auto soundings = std::make_unique<Soundings>();
    const auto search = std::make_unique<SoundingSearch>(mapped->p);
    std::size_t first = 0;
    const auto sweep = [&](const bool thorough, const std::int32_t room_cm, const float most_m) {
        soundings->want(0.8F, thorough);
        for (int round = 0; round < 200; ++round) {
            search->start();
            while (!search->run(grid, where, *from, tried, *soundings, 0)) {}
            if (round == 0) { first = std::max(first, search->found().size()); }
            if (search->found().empty()) { break; }
            for (const Frontier& f : search->found()) {
                TEST_ASSERT_TRUE(f.sounding && where.passable(f.view) && !soundings->passed(f.view));
                TEST_ASSERT_TRUE(f.cost != CostField::kFar);
            }
            soundings->pass(grid, search->found()[0].x_m, search->found()[0].y_m);
        }
        TEST_ASSERT_TRUE(search->found().empty());
        // Nothing that the hull fits at lies much farther from the way than was wanted.
        float worst = 0.0F;
        for (std::int32_t id = 0; id < grid.tile_count() * kTileArea; ++id) {
            if (where.passable(id) && where.clearance_cm(id) >= room_cm && from->cost(id) != CostField::kFar) { worst = std::max(worst, soundings->distance_m(id)); }
        }
        std::printf("  %s: at most %.2f m from the way\n", thorough ? "thorough" : "else", static_cast<double>(worst));
        TEST_ASSERT_TRUE(worst < most_m);
    };
    sweep(false, 45, 1.5F);
    TEST_ASSERT_TRUE(first > 20);
    sweep(true, 60, 1.15F * 0.8F + 0.2F);   // the last small patches, too: but for two cells, the step in which places are sampled
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(distances_are_those_to_the_way_flown);
    RUN_TEST(what_is_left_lies_off_the_way_and_is_gone_once_passed);
    return UNITY_END();
}
