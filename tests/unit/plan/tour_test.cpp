// The tour against brute force, distances between several roots against one field each, and the policies in a small building.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numeric>
#include <random>
#include <vector>

#include "plan/tour.hpp"
#include "unit/plan/closed_world.hpp"
#include "unit/plan/closed_world_score.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;
using test::ClosedLoop;
using test::FlatWorld;

namespace {

/// Random places in a square of 20 m; node 0 is the start.
std::vector<std::pair<float, float>> places(const std::size_t stops, std::mt19937& rng, Tour& tour) {
    std::uniform_real_distribution<float> side(0.0F, 20.0F);
    std::vector<std::pair<float, float>> at;
    for (std::size_t k = 0; k <= stops; ++k) { at.emplace_back(side(rng), side(rng)); }
    tour.begin(stops);
    for (std::size_t a = 0; a <= stops; ++a) {
        for (std::size_t b = 0; b <= stops; ++b) { tour.set(a, b, std::hypot(at[a].first - at[b].first, at[a].second - at[b].second)); }
    }
    return at;
}

/// Length of the best order of all, the first stop given or any.
float best_of_all(const Tour& tour, const std::uint8_t first) {
    std::vector<std::uint8_t> perm(tour.stops());
    std::iota(perm.begin(), perm.end(), std::uint8_t{1});
    float best = 1e9F;
    do {
        if (first != Tour::kAny && perm[0] != first) { continue; }
        Tour::Order order;
        for (const std::uint8_t s : perm) { static_cast<void>(order.push(s)); }
        best = std::min(best, tour.length_m(order));
    } while (std::next_permutation(perm.begin(), perm.end()));
    return best;
}

void holds_each_stop_once(const Tour::Order& order, const std::size_t stops) {
    std::vector<int> seen(stops + 1, 0);
    for (const std::uint8_t s : order) { ++seen[s]; }
    TEST_ASSERT_EQUAL(stops, order.size());
    for (std::size_t s = 1; s <= stops; ++s) { TEST_ASSERT_EQUAL(1, seen[s]); }
}

void a_tour_is_near_the_best_of_all_orders() {
    std::mt19937 rng(3);
    const auto tour = std::make_unique<Tour>();
    float worst = 1.0F;
    float sum = 0.0F;
    for (int k = 0; k < 40; ++k) {
        static_cast<void>(places(7, rng, *tour));
        if (k % 2 == 1) {   // ways weighed by what is still to be revealed
            for (std::size_t stop = 1; stop <= 7; ++stop) { tour->set_gain(stop, static_cast<float>(1U + (stop * 5U + static_cast<std::size_t>(k)) % 7U), 0.0F); }
            tour->weigh(1.5F);
        }
        Tour::Order order;
        const std::uint8_t first = k % 4 == 3 ? std::uint8_t{2} : Tour::kAny;
        const float length = tour->improve(order, first);
        holds_each_stop_once(order, 7);
        if (first != Tour::kAny) { TEST_ASSERT_EQUAL(first, order[0]); }
        TEST_ASSERT_FLOAT_WITHIN(1e-3F, tour->length_m(order), length);
        const float ratio = length / best_of_all(*tour, first);
        TEST_ASSERT_TRUE(ratio > 0.999F);
        worst = std::max(worst, ratio);
        sum += ratio / 40.0F;
    }
    std::printf("  tours of 7 stops: %.3f of the best on average, at most %.3f\n", static_cast<double>(sum), static_cast<double>(worst));
    TEST_ASSERT_TRUE(sum < 1.03F);
    TEST_ASSERT_TRUE(worst < 1.25F);
}

// On a line: pockets at -4 and 3, a hall at 5. By length the left pocket comes first; set aside it is no longer on the way, while the one that
// lies on the way costs nothing and stays.
void what_costs_a_detour_and_leaves_little_is_set_aside() {
    const auto tour = std::make_unique<Tour>();
    constexpr float kAt[4] = {0.0F, -4.0F, 5.0F, 3.0F};
    const auto lay_out = [&](const float left_m2) {
        tour->begin(3);
        for (std::size_t a = 0; a < 4; ++a) {
            for (std::size_t b = 0; b < 4; ++b) { tour->set(a, b, std::fabs(kAt[a] - kAt[b])); }
        }
        tour->set_gain(1, 9.0F, left_m2);
        tour->set_gain(2, 1.0F, 20.0F);
        tour->set_gain(3, 9.0F, 0.3F);
    };
    const auto set_aside = [&](const float m2, const std::uint8_t kept) {
        Tour::Order order;
        static_cast<void>(tour->improve(order, Tour::kAny));
        TEST_ASSERT_EQUAL(1, order[0]);
        tour->set_aside(order, m2, kept);
        static_cast<void>(tour->improve(order, Tour::kAny));
        return order;
    };
    lay_out(0.3F);
    const Tour::Order less = set_aside(0.5F, Tour::kAny);
    TEST_ASSERT_EQUAL(2, less.size());
    TEST_ASSERT_EQUAL(3, less[0]);
    TEST_ASSERT_EQUAL(2, less[1]);
    TEST_ASSERT_TRUE(tour->aside(1) && !tour->aside(2) && !tour->aside(3));
    lay_out(0.3F);
    TEST_ASSERT_EQUAL(3, set_aside(0.2F, Tour::kAny).size());   // it may leave more than that
    lay_out(0.3F);
    TEST_ASSERT_EQUAL(3, set_aside(0.5F, 1).size());            // the vehicle is on its way there
    lay_out(0.0F);
    TEST_ASSERT_EQUAL(3, set_aside(0.5F, Tour::kAny).size());   // to be passed, not to reveal something
    lay_out(0.3F);
    tour->set_gain(2, 1.0F, 0.1F);
    TEST_ASSERT_EQUAL(2, set_aside(9.0F, Tour::kAny).size());   // of 0.7 m2 left no more than half
}

void a_large_tour_has_no_crossing_left_and_a_warm_start_keeps_it() {
    std::mt19937 rng(5);
    const auto tour = std::make_unique<Tour>();
    static_cast<void>(places(kMaxStops - 1U, rng, *tour));
    Tour::Order order;
    const float length = tour->improve(order, Tour::kAny);
    holds_each_stop_once(order, kMaxStops - 1U);
    Tour::Order again = order;
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, length, tour->improve(again, Tour::kAny) > length ? 0.0F : length);
    TEST_ASSERT_TRUE(length < 0.85F * std::sqrt(400.0F * static_cast<float>(kMaxStops)) + 20.0F);   // random points: about 0.71 sqrt(n A)
}

FlatWorld rooms() {
    FlatWorld w;
    w.add_wall(-2.0, -2.5, 8.0, -2.5);
    w.add_wall(-2.0, 2.0, 8.0, 2.0);
    w.add_wall(-2.0, -2.5, -2.0, 2.0);
    w.add_wall(8.0, -2.5, 8.0, 2.0);
    w.add_wall(1.5, -2.5, 1.5, -1.0);
    w.add_wall(1.5, -0.1, 1.5, 2.0);
    w.add_wall(4.8, -2.5, 4.8, 0.3);
    w.add_wall(4.8, 1.2, 4.8, 2.0);
    w.turn(0.297);
    return w;
}

// Several roots at once: exact where regions touch on the way, never less than the truth, and the nearest root's distance is exact.
void distances_between_roots_are_those_of_one_field_each() {
    const Parameters p;
    const FlatWorld world = rooms();
    const auto loop = std::make_unique<ClosedLoop>(p, world, 1U);
    static_cast<void>(test::fly(*loop, 200.0));
    const OccupancyGrid& grid = loop->grid;
    const Traversability& where = loop->mission.explorer().where();
    std::vector<CellId> free;
    for (std::int32_t slot = 0; slot < grid.tile_count(); ++slot) {
        for (CellId id = slot * kTileArea; id < (slot + 1) * kTileArea; ++id) {
            if (where.passable(id) && where.slowness(id) < 1.3F) { free.push_back(id); }
        }
    }
    std::mt19937 rng(2);
    std::shuffle(free.begin(), free.end(), rng);
    constexpr std::size_t kRoots = 8;
    const auto open = std::make_unique<OpenCells>();
    const auto field = std::make_unique<CostField>();
    const auto graph = std::make_unique<RootGraph>();
    graph->clear(kRoots);
    field->start(grid, free[0], 0, *open);
    for (std::size_t k = 0; k < kRoots; ++k) { TEST_ASSERT_TRUE(field->add_root(free[k], static_cast<std::uint8_t>(k), *graph, *open)); }
    while (!field->run(grid, where, *open, 1000, kNoCell, 0, graph.get())) {}
    graph->close();
    double sum = 0.0;
    for (std::size_t a = 0; a < kRoots; ++a) {
        field->start(grid, free[a], 0, *open);
        while (!field->run(grid, where, *open, 1 << 20, kNoCell, 0)) {}
        double nearest = 1e9;
        double nearest_found = 1e9;
        for (std::size_t b = 0; b < kRoots; ++b) {
            if (a == b) { continue; }
            const double exact = field->cost(free[b]);
            const double found = graph->between(a, b);
            TEST_ASSERT_TRUE_MESSAGE(found + 200.0 > 0.95 * exact, "shorter than the shortest way");   // a way and its reverse differ by an end cell
            sum += found / exact / static_cast<double>(kRoots * (kRoots - 1));
            nearest = std::min(nearest, exact);
            nearest_found = std::min(nearest_found, found);
        }
        TEST_ASSERT_TRUE_MESSAGE(nearest_found < 1.1 * nearest + 64.0, "the nearest root is farther than it is");
    }
    std::printf("  between roots: %.3f of the exact distance on average\n", sum);
    TEST_ASSERT_TRUE(sum < 1.2);   // 1.05 to 1.15 with the place
}

test::Result flown(const PolicyKind policy, const double most_s, Explorer::Counters& counters, double& share, float& never) {
    Parameters p;
    p.policy = static_cast<std::int32_t>(policy);
    const FlatWorld world = rooms();
    const auto loop = std::make_unique<ClosedLoop>(p, world, 4U);
    loop->pose_noise_m = 0.005;
    const test::Result r = test::fly(*loop, most_s);
    counters = loop->mission.explorer().counters();
    share = test::explored_share(world, loop->grid, loop->range_max_m);
    never = loop->mission.explorer().paper().unknown_share();
    std::printf("  policy %d: %.0f s, %.0f m, seen %.4f, goals %u, A-B-A %u, stuck %u, never in the window %.3f\n", static_cast<int>(policy), r.time_s,
                r.length_m, share, counters.goals, counters.back_and_forth, counters.policy.stuck, static_cast<double>(never));
    return r;
}

void every_policy_flies_behind_the_one_interface() {
    Explorer::Counters counters;
    double share = 0.0;
    float never = 0.0F;
    TEST_ASSERT_TRUE(flown(PolicyKind::tour, 240.0, counters, share, never).completed);
    TEST_ASSERT_TRUE(share > 0.98);
    TEST_ASSERT_EQUAL(0, counters.back_and_forth);
    TEST_ASSERT_TRUE(flown(PolicyKind::frontier, 300.0, counters, share, never).completed);
    TEST_ASSERT_TRUE(share > 0.98);
    if (kMaxPaperSide < 128U) { return; }   // the area that it is told does not hold these rooms
    const test::Result paper = flown(PolicyKind::paper, 300.0, counters, share, never);
    TEST_ASSERT_TRUE_MESSAGE(paper.completed, "the paper's potential leads nowhere");
    TEST_ASSERT_TRUE_MESSAGE(never < 0.05F && share > 0.98, "its window was not everywhere");
    TEST_ASSERT_TRUE_MESSAGE(paper.least_clearance_m > 0.3, "touched something");
    TEST_ASSERT_TRUE_MESSAGE(paper.length_m < 20.0, "to and fro: its relaxation was cut off");   // 17 m; 23 m with ten sweeps a step
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_tour_is_near_the_best_of_all_orders);
    RUN_TEST(what_costs_a_detour_and_leaves_little_is_set_aside);
    RUN_TEST(a_large_tour_has_no_crossing_left_and_a_warm_start_keeps_it);
    RUN_TEST(distances_between_roots_are_those_of_one_field_each);
    RUN_TEST(every_policy_flies_behind_the_one_interface);
    return UNITY_END();
}
