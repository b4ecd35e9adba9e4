// Statements about clearances, costs and the potential that hold on every map. Independent routes: brute force over hit points,
// relaxation to a fixed point (Bellman and Ford), the definition of a harmonic function.
#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "plan/cost_field.hpp"
#include "plan/potential.hpp"
#include "plan/traversability.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

/// Two rooms with a door of 0.90 m and a corner, turned by 17 degrees, seen from a few places.
struct Scene {
    Parameters p;
    test::FlatWorld world;
    OccupancyGrid grid{p};
    Traversability where{p};
    OpenCells open;
    CostField field;
    Potential potential{p};

    explicit Scene(const double door_m = 0.90, const double shift_m = 0.0) {
        world.add_wall(-2.0, -2.0, 6.0, -2.0);
        world.add_wall(-2.0, 3.0, 6.0, 3.0);
        world.add_wall(-2.0, -2.0, -2.0, 3.0);
        world.add_wall(6.0, -2.0, 6.0, 3.0);
        world.add_wall(2.0, -2.0, 2.0, 0.4 + shift_m);
        world.add_wall(2.0, 0.4 + shift_m + door_m, 2.0, 3.0);
        world.add_pillar(4.0, 0.2, 0.3);
        world.turn(0.297);
        std::mt19937 rng(3);
        LevelScan scan;
        for (const auto& [x, y] : {std::pair{0.0, 0.0}, {1.0, 1.0}, {3.0, 1.9}, {3.5, 2.8}, {4.7, 2.2}, {4.6, 0.3}, {3.0, -0.2}}) {
            for (const double yaw : {0.0, 3.1}) {
                test::sweep(world, x, y, yaw, 10.0, 0.01, rng, scan);
                Estimate e;
                e.planar.pose_map_body = {static_cast<float>(x), static_cast<float>(y), static_cast<float>(yaw)};
                e.planar.quality = 100;
                e.altitude.valid = true;
                e.altitude.z_m = 1.0F;
                grid.integrate(e, scan);
                grid.integrate(e, scan);
                where.update(grid, static_cast<float>(x), static_cast<float>(y));
            }
        }
        settle();
    }
    void settle() {
        for (int k = 0; k < 200; ++k) { where.update(grid, 0.0F, 0.0F); }
        TEST_ASSERT_EQUAL(0U, where.blocks_waiting());
    }
    void solve(const float x_m, const float y_m) {
        field.start(grid, grid.find(x_m, y_m), 5, open);
        while (!field.run(grid, where, open, 1000, kNoCell, 0)) {}
        potential.restart();
    }
    template <class F> void each_passable(F&& f) {
        for (std::int32_t id = 0; id < grid.tile_count() * kTileArea; ++id) {
            if (where.passable(id)) { f(id); }
        }
    }
};

void clearances_updated_block_by_block_equal_brute_force() {
    const auto s = std::make_unique<Scene>();
    int checked = 0;
    int hardly = 0;
    s->each_passable([&](const CellId id) {
        if ((id % 7) != 0) { return; }
        const Cell c = s->grid.cell(id);
        float truth_m = s->grid.clearance_m(s->grid.geometry().centre_x_m(c), s->grid.geometry().centre_y_m(c), 0.80F);
        if (truth_m < s->p.hull_radius_m + s->p.plan_margin_m) {   // the hull hardly fits: the roomiest point of the cell counts
            for (int k = 0; k < 81; ++k) {
                const float dx_m = 0.0125F * static_cast<float>(k % 9 - 4);
                const float dy_m = 0.0125F * static_cast<float>(k / 9 - 4);
                truth_m = std::max(truth_m, s->grid.clearance_m(s->grid.geometry().centre_x_m(c) + dx_m, s->grid.geometry().centre_y_m(c) + dy_m, 0.80F));
            }
            truth_m = std::min(truth_m, 0.01F * static_cast<float>(s->where.clearance_cm(id)) + 0.02F);   // it looks no farther than needed
            ++hardly;
        }
        // Rounded to 1 cm; means of hits may have moved by less than a step that makes them stale.
        TEST_ASSERT_FLOAT_WITHIN(0.03F, truth_m, 0.01F * static_cast<float>(s->where.clearance_cm(id)));
        ++checked;
    });
    TEST_ASSERT_TRUE(checked > 100);
    TEST_ASSERT_TRUE(hardly > 3);
}

void what_is_unknown_under_the_hull_equals_brute_force() {
    const auto s = std::make_unique<Scene>();
    int over = 0;
    int only_unseen = 0;
    for (std::int32_t id = 0; id < s->grid.tile_count() * kTileArea; ++id) {
        if (s->where.clearance_cm(id) == 0) { continue; }   // not free
        const Cell c = s->grid.cell(id);
        const auto kind = [&](const std::int32_t x, const std::int32_t y) { return s->grid.cell_class(Cell{c.ix + x, c.iy + y}); };
        bool near_unknown = false;
        bool near_unseen = false;
        for (std::int32_t y = -4; y <= 4; ++y) {
            for (std::int32_t x = -4; x <= 4; ++x) {
                if (kind(x, y) != CellClass::unknown || x * x + y * y > 16) { continue; }
                near_unknown = near_unknown || x * x + y * y <= 6;   // 2.5 cells
                bool hit_beside = false;
                for (std::int32_t d = 0; d < 8; ++d) { hit_beside = hit_beside || kind(x + kNeighbourX[d], y + kNeighbourY[d]) == CellClass::occupied; }
                near_unseen = near_unseen || !hit_beside;
            }
        }
        TEST_ASSERT_EQUAL_INT(static_cast<int>(near_unknown || near_unseen), static_cast<int>(s->where.over_unknown(id)));
        over += near_unknown ? 1 : 0;
        only_unseen += near_unseen && !near_unknown ? 1 : 0;
    }
    TEST_ASSERT_TRUE(over > 100);
    TEST_ASSERT_TRUE(only_unseen > 20);
}

// A corridor of 0.90 m, 1.2 m of whose one wall give no return.
void the_line_keeps_off_a_wall_that_nobody_has_seen() {
    const Parameters p;
    test::FlatWorld world;
    world.add_wall(-4.0, -0.45, 4.0, -0.45);
    world.add_wall(-4.0, 0.45, 4.0, 0.45);
    world.add_wall(-4.0, -0.45, -4.0, 0.45);
    world.add_wall(4.0, -0.45, 4.0, 0.45);
    const auto grid = std::make_unique<OccupancyGrid>(p);
    const auto where = std::make_unique<Traversability>(p);
    const auto open = std::make_unique<OpenCells>();
    const auto field = std::make_unique<CostField>();
    const auto potential = std::make_unique<Potential>(p);
    std::mt19937 rng(5);
    LevelScan scan;
    Estimate e;
    e.planar.quality = 100;
    e.altitude.valid = true;
    e.altitude.z_m = 1.0F;
    for (int k = 0; k < 16; ++k) {
        const bool back = (k & 1) != 0;
        const double x_m = back ? 1.5 : -1.5;
        const double yaw_rad = back ? 3.1415926 : 0.0;
        test::sweep(world, x_m, 0.0, yaw_rad, 10.0, 0.01, rng, scan);
        e.planar.pose_map_body = {static_cast<float>(x_m), 0.0F, static_cast<float>(yaw_rad)};
        for (ScanPoint& q : scan.points) {
            const Point2<Map> at = e.planar.pose_map_body * Point2<Body>{q.x_m, q.y_m};
            if (std::fabs(at.x_m) > 0.6F || at.y_m < 0.38F) { continue; }
            q.hit = false;
            q.x_m *= scan.range_max_m / q.range_m;
            q.y_m *= scan.range_max_m / q.range_m;
            q.range_m = scan.range_max_m;
        }
        grid->integrate(e, scan);
    }
    for (int k = 0; k < 200; ++k) { where->update(*grid, 0.0F, 0.0F); }
    TEST_ASSERT_TRUE_MESSAGE(grid->cell_class(grid->find(0.05F, 0.45F)) == CellClass::unknown, "nothing told of it");
    field->start(*grid, grid->find(2.05F, -0.05F), 5, *open);
    while (!field->run(*grid, *where, *open, 1000, kNoCell, 0)) {}
    Bounded<PathPoint, kMaxPathPoints> path;
    for (float x_m = -1.05F; x_m < 0.0F; x_m += 0.1F) {
        potential->restart();
        potential->relax(*grid, *where, *field, x_m, -0.05F, 2);
        TEST_ASSERT_TRUE(potential->trace(*grid, *where, *field, x_m, -0.05F, 2.05F, -0.05F, path));
        TEST_ASSERT_TRUE(path.back().x_m > 0.5F);
        for (const PathPoint& q : path) { TEST_ASSERT_FALSE(where->over_unknown(grid->find(q.x_m, q.y_m))); }
    }
}

/// A wall of 4 cm along x = 0.6, where cells meet, with a gap in it, seen from both sides.
struct Gap {
    Parameters p;
    test::FlatWorld world;
    OccupancyGrid grid{p};
    Traversability where{p};
    OpenCells open;
    CostField field;
    Potential potential{p};

    explicit Gap(const double half_m) {
        for (const double side : {-1.0, 1.0}) { world.add_wall(0.6, 0.05 + side * half_m, 0.6, 0.05 + side * 2.0, 0.04); }
        world.add_segment(-2.0, -1.95, 3.0, -1.95);
        world.add_segment(-2.0, 2.05, 3.0, 2.05);
        world.add_segment(-2.0, -1.95, -2.0, 2.05);
        world.add_segment(3.0, -1.95, 3.0, 2.05);
        std::mt19937 rng(23);
        LevelScan scan;
        Estimate e;
        e.planar.quality = 100;
        e.altitude.valid = true;
        e.altitude.z_m = 1.0F;
        for (int k = 0; k < 60; ++k) {
            const double x_m = k % 3 == 0 ? -0.8 : k % 3 == 1 ? 0.2 : 1.0;
            const double yaw_rad = k % 3 == 2 ? 3.1415926 : 0.0;
            test::sweep(world, x_m, 0.05, yaw_rad, 10.0, 0.003, rng, scan);
            scan.range_noise_m = 0.003F;
            e.planar.pose_map_body = {static_cast<float>(x_m), 0.05F, static_cast<float>(yaw_rad)};
            grid.integrate(e, scan);
        }
        for (int k = 0; k < 200; ++k) { where.update(grid, 0.0F, 0.0F); }
        field.start(grid, grid.find(1.65F, 0.05F), 5, open);
        while (!field.run(grid, where, open, 1000, kNoCell, 0)) {}
    }
    /// How far along x the line leads from there.
    float leads_to_m(const float x_m) {
        Bounded<PathPoint, kMaxPathPoints> path;
        potential.restart();
        potential.relax(grid, where, field, x_m, 0.05F, 2);
        TEST_ASSERT_TRUE(potential.trace(grid, where, field, x_m, 0.05F, 1.65F, 0.05F, path));
        return path.back().x_m;
    }
};

// Hull and margin are 0.36 m: beside the throat there is room for them, in it there is not.
void a_throat_between_two_cells_is_not_entered_but_left() {
    const auto wide = std::make_unique<Gap>(0.370);
    TEST_ASSERT_TRUE(wide->leads_to_m(-0.5F) > 1.2F);
    TEST_ASSERT_NULL(wide->potential.cut());
    const auto narrow = std::make_unique<Gap>(0.355);
    TEST_ASSERT_TRUE(narrow->where.passable(narrow->grid.find(0.55F, 0.05F)) && narrow->where.passable(narrow->grid.find(0.65F, 0.05F)));
    const float end_m = narrow->leads_to_m(-0.5F);
    TEST_ASSERT_TRUE(end_m > 0.0F && end_m < 0.55F);
    TEST_ASSERT_NOT_NULL(narrow->potential.cut());
    TEST_ASSERT_FLOAT_WITHIN_MESSAGE(0.06F, 0.6F, narrow->potential.cut()->x_m, "what holds the vehicle, to be closed");
    TEST_ASSERT_TRUE_MESSAGE(std::hypot(0.6F - end_m, 0.355F) > 0.375F, "it does not stand in it");
    TEST_ASSERT_TRUE_MESSAGE(narrow->leads_to_m(0.57F) > 1.2F, "out of it with a little less");
}

void costs_equal_those_of_relaxation_to_a_fixed_point() {
    const auto s = std::make_unique<Scene>();
    s->solve(0.0F, 0.0F);
    // Bellman and Ford: no edge between passable cells can lower a cost any more, and each cost is met by some edge.
    int reached = 0;
    s->each_passable([&](const CellId id) {
        const std::uint32_t mine = s->field.cost(id);
        std::uint32_t best = CostField::kFar;
        for (std::int32_t d = 0; d < 8; ++d) {
            const CellId n = s->grid.neighbour(id, d);
            if (!s->where.passable(n) || s->field.cost(n) == CostField::kFar) { continue; }
            const float length = (d & 1) != 0 ? 90.50967F : 64.0F;
            best = std::min(best, s->field.cost(n) + static_cast<std::uint32_t>(length * s->where.slowness(id)));
        }
        if (id == s->field.root()) {
            TEST_ASSERT_EQUAL_UINT32(0U, mine);
        } else {
            TEST_ASSERT_EQUAL_UINT32(best, mine);
            reached += best != CostField::kFar ? 1 : 0;
        }
    });
    TEST_ASSERT_TRUE(reached > 1500);
}

void a_packed_cost_is_never_less_and_keeps_its_order() {
    // Independent route: in 14 significant bits rounded up, c <= u < c (1 + 2^-13) and u is the smallest such number.
    std::uint32_t last = 0;
    for (std::uint32_t c = 0; c <= CostField::kDearest; c += c < 70000U ? 1U : 37U) {
        const std::uint32_t u = CostField::unpack(CostField::pack(c));
        TEST_ASSERT_TRUE(u >= c);
        TEST_ASSERT_TRUE(static_cast<double>(u) <= static_cast<double>(c) * (1.0 + 1.0 / 8192.0));
        TEST_ASSERT_TRUE(u >= last);
        TEST_ASSERT_EQUAL_UINT32(u, CostField::unpack(CostField::pack(u)));
        if (c < 16384U) { TEST_ASSERT_EQUAL_UINT32(c, u); }
        last = u;
    }
    TEST_ASSERT_TRUE(CostField::kDearest - CostField::unpack(CostField::pack(CostField::kDearest - 63U)) <= 63U);
    TEST_ASSERT_EQUAL_UINT32(CostField::kFar, CostField::unpack(CostField::pack(CostField::kDearest + 1U)));
    TEST_ASSERT_EQUAL_UINT32(CostField::kFar, CostField::unpack(CostField::pack(CostField::kFar)));
}

void a_sum_is_packed_as_if_by_itself() {
    for (std::uint32_t c = 0; c <= CostField::kDearest; c += c < 70000U ? 7U : 331U) {
        const std::uint16_t from = CostField::pack(c);
        for (const std::uint32_t edge : {1U, 64U, 90U, 271U, 1809U}) {
            const std::uint32_t sum = CostField::unpack(from) + edge;
            TEST_ASSERT_EQUAL_UINT16(CostField::pack(sum), CostField::packed_sum(from, sum));
        }
    }
}

void a_floor_larger_than_the_pages_is_served_round_the_root() {
    constexpr std::size_t kMore = 20;   // tiles of the floor beyond the pages
    if constexpr (kMaxTiles < kMaxFieldTiles + kMore) { TEST_IGNORE_MESSAGE("the micro profile has hardly more tiles than pages"); }
    const auto p = std::make_unique<Parameters>();
    p->no_return_open = 0.0F;   // beams down the lane clear it
    p->fence_radius_m = p->fence_front_m = p->fence_back_m = 1e5F;
    const auto grid = std::make_unique<OccupancyGrid>(*p);
    const auto where = std::make_unique<Traversability>(*p);
    const auto open = std::make_unique<OpenCells>();
    const auto field = std::make_unique<CostField>();
    // GIVEN a straight free lane over more tiles than a field has pages for (a fan of beams from places 4 m apart)
    LevelScan fan;
    fan.range_max_m = 10.0F;
    fan.bearing_increment_rad = 0.01F;
    for (int k = -60; k <= 60; ++k) {
        const float b = 0.01F * static_cast<float>(k);
        const float r = std::min(9.0F, std::fabs(1.0F / std::max(1e-3F, std::fabs(std::sin(b)))));
        ScanPoint q;
        q.x_m = r * std::cos(b);
        q.y_m = r * std::sin(b);
        q.range_m = r;
        q.hit = r < 9.0F;
        static_cast<void>(fan.points.push(q));
    }
    const auto tiles = static_cast<std::int32_t>(kMaxFieldTiles);
    Estimate e;
    e.planar.quality = 100;
    e.altitude.valid = true;
    e.altitude.z_m = 1.0F;
    const float end_m = 6.4F * static_cast<float>(tiles + static_cast<std::int32_t>(kMore));
    for (float x_m = 3.2F; x_m < end_m; x_m += 4.0F) {
        e.planar.pose_map_body = {x_m, 3.2F, 0.0F};
        for (int k = 0; k < 4; ++k) { grid->integrate(e, fan); }
    }
    for (int k = 0; k < 3000; ++k) { where->update(*grid, 5.0F, 3.2F); }
    TEST_ASSERT_EQUAL(0U, where->blocks_waiting());
    // WHEN a field is computed from its middle, twice
    for (int run = 0; run < 2; ++run) {
        field->start(*grid, grid->find(0.5F * end_m, 3.2F), 5, *open);
        while (!field->run(*grid, *where, *open, 10000, kNoCell, 0)) {}
        // THEN what lies within the pages is reached, what lies beyond is not, and that is counted
        const float within_m = 6.4F * (0.5F * static_cast<float>(tiles) - 3.0F);
        TEST_ASSERT_TRUE(field->cost(grid->find(0.5F * end_m + within_m, 3.2F)) < CostField::kFar);
        TEST_ASSERT_TRUE(field->cost(grid->find(0.5F * end_m - within_m, 3.2F)) < CostField::kFar);
        TEST_ASSERT_EQUAL_UINT32(CostField::kFar, field->cost(grid->find(end_m - 2.0F, 3.2F)));
        TEST_ASSERT_EQUAL_UINT32(CostField::kFar, field->cost(grid->find(2.0F, 3.2F)));
        TEST_ASSERT_TRUE(field->refused() > 0U);
    }
}

void every_reachable_cell_has_a_way_up_after_any_number_of_sweeps() {
    const auto s = std::make_unique<Scene>();
    s->solve(4.9F, 2.4F);
    for (int sweeps = 0; sweeps < 40; ++sweeps) {
        int cells = 0;
        s->each_passable([&](const CellId id) {
            const float v = s->potential.value(s->grid, s->field, id);
            if (v == kInfinity || id == s->field.root()) { return; }
            float best = kInfinity;
            for (std::int32_t d = 0; d < 8; ++d) { best = std::min(best, s->potential.value(s->grid, s->field, s->grid.neighbour(id, d))); }
            TEST_ASSERT_TRUE_MESSAGE(best < v, "a cell without a way up");
            ++cells;
        });
        TEST_ASSERT_TRUE(cells > 1500);
        s->potential.relax(s->grid, s->where, s->field, 1.0F, 1.0F, 1);
    }
}

void relaxed_values_are_the_weighted_mean_of_their_neighbours() {
    const auto s = std::make_unique<Scene>();
    s->solve(4.9F, 2.4F);
    s->potential.relax(s->grid, s->where, s->field, 1.0F, 1.0F, 600);
    TEST_ASSERT_TRUE(s->potential.residual() < 1e-3F);
    const Cell centre = s->grid.geometry().cell(1.0F, 1.0F);
    // The weights are recomputed here from their two defining statements: they sum to one, and ln(diagonal) = sqrt(2) ln(straight).
    double low = 0.1;
    double high = 0.25;
    for (int k = 0; k < 60; ++k) {
        const double w = 0.5 * (low + high);
        (4.0 * w + 4.0 * std::pow(w, std::sqrt(2.0)) > 1.0 ? high : low) = w;
    }
    int checked = 0;
    constexpr std::int32_t kReach = std::min<std::int32_t>(15, static_cast<std::int32_t>(kPotentialWindow / 2U) - 4);   // well inside the window
    for (std::int32_t dy = -kReach; dy <= kReach; ++dy) {
        for (std::int32_t dx = -kReach; dx <= kReach; ++dx) {
            const CellId id = s->grid.find(Cell{centre.ix + dx, centre.iy + dy});
            const float v = s->potential.value(s->grid, s->field, id);
            if (!s->where.passable(id) || v == kInfinity) { continue; }
            double mean = 0.0;
            for (std::int32_t d = 0; d < 8; ++d) {
                const CellId n = s->grid.neighbour(id, d);
                if (!s->where.passable(n)) { continue; }
                const double weight = std::pow(std::pow(low, (d & 1) != 0 ? std::sqrt(2.0) : 1.0), static_cast<double>(s->where.slowness(id)));
                mean += weight * std::exp(static_cast<double>(v - s->potential.value(s->grid, s->field, n)));
            }
            TEST_ASSERT_DOUBLE_WITHIN(0.01, 1.0, mean);   // phi(c) = sum of w phi(n), divided by phi(c)
            ++checked;
        }
    }
    TEST_ASSERT_TRUE(checked > 200);
}

void the_path_ends_at_the_goal_and_stays_clear() {
    for (const double door_m : {0.90, 0.80}) {
        const auto s = std::make_unique<Scene>(door_m);
        s->solve(4.9F, 2.4F);
        const auto path = std::make_unique<Bounded<PathPoint, kMaxPathPoints>>();
        float x_m = 0.0F;
        float y_m = 0.0F;
        double least = 1e9;
        bool there = false;
        for (int leg = 0; leg < 40 && !there; ++leg) {
            s->potential.relax(s->grid, s->where, s->field, x_m, y_m, 20);
            TEST_ASSERT_TRUE(s->potential.trace(s->grid, s->where, s->field, x_m, y_m, 4.9F, 2.4F, *path));
            for (const PathPoint& q : *path) { least = std::min(least, s->world.clearance(static_cast<double>(q.x_m), static_cast<double>(q.y_m))); }
            const std::size_t next = std::min<std::size_t>(5U, path->size() - 1U);
            x_m = (*path)[next].x_m;
            y_m = (*path)[next].y_m;
            there = std::hypot(x_m - 4.9F, y_m - 2.4F) < 0.02F;
        }
        TEST_ASSERT_TRUE(there);
        TEST_ASSERT_TRUE_MESSAGE(least > 0.5 * door_m - 0.025, "the path does not keep to the middle of the door");
    }
}

void the_path_knows_how_far_it_is_free_straight_on() {
    const auto s = std::make_unique<Scene>(0.80);
    s->solve(4.9F, 2.4F);
    const auto path = std::make_unique<Bounded<PathPoint, kMaxPathPoints>>();
    // Independent route: the true world, small steps, several directions.
    const auto hull_m = static_cast<double>(s->p.hull_radius_m + s->p.guard_least_m);
    const auto free_m = [&](const PathPoint& q, const double angle_rad) {
        double way_m = 0.0;
        while (way_m < 2.0 && s->world.clearance(static_cast<double>(q.x_m) + way_m * std::cos(angle_rad), static_cast<double>(q.y_m) + way_m * std::sin(angle_rad)) > hull_m) { way_m += 0.01; }
        return way_m;
    };
    int bounded = 0;
    int free = 0;
    for (const float x_m : {0.0F, 1.25F}) {
        s->potential.relax(s->grid, s->where, s->field, x_m, 0.0F, 20);
        TEST_ASSERT_TRUE(s->potential.trace(s->grid, s->where, s->field, x_m, 0.0F, 4.9F, 2.4F, *path));
        float gone_m = 0.0F;
        const auto braked_m = [&](const PathPoint& q) { return std::pow(speed_at_clearance_m_s(s->p, q.clearance_m), 2.0F) / (2.0F * 0.35F * s->p.accel_max_m_s2); };
        float felt_m = braked_m((*path)[0]);   // as far as the speed allowed somewhere before can be braked: so far it must be known
        for (std::size_t k = 1; k + 1U < path->size(); ++k) {
            const PathPoint& q = (*path)[k];
            gone_m += std::hypot(q.x_m - (*path)[k - 1U].x_m, q.y_m - (*path)[k - 1U].y_m);
            if (gone_m > felt_m) { break; }
            felt_m = std::min(felt_m, gone_m + braked_m(q));
            const auto angle_rad = static_cast<double>(std::atan2((*path)[k + 1U].y_m - (*path)[k - 1U].y_m, (*path)[k + 1U].x_m - (*path)[k - 1U].x_m));
            if (q.way_m > 9.0F) {
                ++free;
                TEST_ASSERT_TRUE(free_m(q, angle_rad) > static_cast<double>(stopping_m(s->p, speed_at_clearance_m_s(s->p, q.clearance_m))));
                continue;
            }
            ++bounded;
            double least_m = 2.0;
            for (int side = -3; side <= 3; ++side) { least_m = std::min(least_m, free_m(q, angle_rad + 0.1 * side)); }
            for (const double astray_rad : {-0.15, 0.0, 0.15}) {
                TEST_ASSERT_TRUE_MESSAGE(free_m(q, angle_rad + astray_rad) > static_cast<double>(q.way_m) - 0.05, "it is not free that far");
            }
            TEST_ASSERT_TRUE_MESSAGE(least_m < static_cast<double>(q.way_m) + 0.15, "it is free farther");
        }
    }
    TEST_ASSERT_TRUE(bounded > 3);
    TEST_ASSERT_TRUE(free > 3);
}

void a_gap_is_entered_by_its_width_wherever_its_middle_lies() {
    // Hull and margin need 0.72 m. The door's middle lies at any place between the centres of two cells.
    for (const double door_m : {0.60, 0.68, 0.75}) {
        for (const double shift_m : {0.0, 0.03, 0.06}) {
            const auto s = std::make_unique<Scene>(door_m, shift_m);
            s->solve(0.0F, 0.0F);
            TEST_ASSERT_EQUAL(door_m > 0.72, s->field.cost(s->grid.find(4.9F, 2.4F)) != CostField::kFar);
        }
    }
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(clearances_updated_block_by_block_equal_brute_force);
    RUN_TEST(what_is_unknown_under_the_hull_equals_brute_force);
    RUN_TEST(the_line_keeps_off_a_wall_that_nobody_has_seen);
    RUN_TEST(a_throat_between_two_cells_is_not_entered_but_left);
    RUN_TEST(costs_equal_those_of_relaxation_to_a_fixed_point);
    RUN_TEST(a_packed_cost_is_never_less_and_keeps_its_order);
    RUN_TEST(a_sum_is_packed_as_if_by_itself);
    RUN_TEST(a_floor_larger_than_the_pages_is_served_round_the_root);
    RUN_TEST(every_reachable_cell_has_a_way_up_after_any_number_of_sweeps);
    RUN_TEST(relaxed_values_are_the_weighted_mean_of_their_neighbours);
    RUN_TEST(the_path_ends_at_the_goal_and_stays_clear);
    RUN_TEST(the_path_knows_how_far_it_is_free_straight_on);
    RUN_TEST(a_gap_is_entered_by_its_width_wherever_its_middle_lies);
    return UNITY_END();
}
