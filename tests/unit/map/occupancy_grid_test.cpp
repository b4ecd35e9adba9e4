// The occupancy grid: what a sweep does to cells, what it does not, and what happens at the edges of its memory.
#include <cmath>
#include <cstring>
#include <memory>
#include <random>
#include <set>
#include <utility>

#include "map/occupancy_grid.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::Cell;
using noctule::CellClass;
using noctule::CellId;
using noctule::Estimate;
using noctule::GridTile;
using noctule::kMaxTiles;
using noctule::LevelScan;
using noctule::OccupancyGrid;
using noctule::Parameters;
using noctule::ScanPoint;

namespace {

Estimate at(const float x_m, const float y_m, const float yaw_rad = 0.0F) {
    Estimate e;
    e.planar.pose_map_body = {x_m, y_m, yaw_rad};
    e.planar.quality = 100;
    e.altitude.valid = true;
    e.altitude.z_m = 1.0F;
    return e;
}

LevelScan empty_sweep() {
    LevelScan s;
    s.range_max_m = 10.0F;
    s.bearing_increment_rad = 0.0044F;
    return s;
}

void add(LevelScan& s, const float bearing_rad, const float range_m, const bool hit) {
    ScanPoint p;
    p.x_m = range_m * std::cos(bearing_rad);
    p.y_m = range_m * std::sin(bearing_rad);
    p.range_m = range_m;
    p.beam = static_cast<std::int16_t>(s.points.size());
    p.hit = hit;
    TEST_ASSERT_TRUE(s.points.push(p));
}

std::unique_ptr<OccupancyGrid> grid_with(const Parameters& p) { return std::make_unique<OccupancyGrid>(p); }

void a_beam_frees_the_cells_before_its_end_and_fills_the_last() {
    const Parameters p;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    add(s, 0.0F, 2.03F, true);                                    // GIVEN one beam along x, 2.03 m long, from (0.04, 0.05)
    grid->integrate(at(0.04F, 0.05F), s);                         // WHEN it is entered
    for (int i = 0; i < 20; ++i) {                                // THEN all cells before the end are free
        TEST_ASSERT_EQUAL(CellClass::free, grid->cell_class(Cell{i, 0}));
    }
    TEST_ASSERT_EQUAL(CellClass::occupied, grid->cell_class(Cell{20, 0}));
    TEST_ASSERT_EQUAL(CellClass::unknown, grid->cell_class(Cell{21, 0}));
    TEST_ASSERT_EQUAL(CellClass::unknown, grid->cell_class(Cell{5, 1}));
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.21F, grid->known_area_m2());
    float x_m = 0.0F;
    float y_m = 0.0F;
    grid->hit_point(grid->find(Cell{20, 0}), x_m, y_m);           // AND the hit is kept finer than the cell
    TEST_ASSERT_FLOAT_WITHIN(0.001F, 2.07F, x_m);
    TEST_ASSERT_FLOAT_WITHIN(0.001F, 0.05F, y_m);
}

void a_ray_visits_the_same_cells_from_both_ends() {
    // Law: what a beam from a to b frees, a beam from b to a frees, but for the ends.
    const Parameters p;
    for (int k = 0; k < 40; ++k) {
        const float angle = 0.157F * static_cast<float>(k);
        const auto one = grid_with(p);
        const auto two = grid_with(p);
        LevelScan s = empty_sweep();
        add(s, 0.0F, 4.0F, true);
        const float bx = 0.033F + 4.0F * std::cos(angle);
        const float by = -0.021F + 4.0F * std::sin(angle);
        one->integrate(at(0.033F, -0.021F, angle), s);
        two->integrate(at(bx, by, angle + noctule::kPi), s);
        for (float r = 0.3F; r < 3.7F; r += 0.01F) {
            const float x = 0.033F + r * std::cos(angle);
            const float y = -0.021F + r * std::sin(angle);
            // Points on the very edge of a cell may fall on either side of it.
            const float fx = x * 10.0F - std::floor(x * 10.0F);
            const float fy = y * 10.0F - std::floor(y * 10.0F);
            if (std::fmin(std::fmin(fx, 1.0F - fx), std::fmin(fy, 1.0F - fy)) < 0.01F) { continue; }
            TEST_ASSERT_EQUAL(CellClass::free, one->cell_class(one->find(x, y)));
            TEST_ASSERT_EQUAL(CellClass::free, two->cell_class(two->find(x, y)));
        }
    }
}

void cells_and_metres_are_inverse_across_tiles() {
    const noctule::GridGeometry g{0.10F};
    for (int i = -200; i < 200; ++i) {
        const Cell c{i * 3, -i * 7};
        TEST_ASSERT_TRUE(g.cell(g.centre_x_m(c), g.centre_y_m(c)) == c);
    }
    const Parameters p;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    for (int k = 0; k < 360; ++k) { add(s, 0.0174533F * static_cast<float>(k), 9.0F, true); }
    grid->integrate(at(0.0F, 0.0F), s);
    for (std::int32_t iy = -80; iy < 80; ++iy) {
        for (std::int32_t ix = -80; ix < 80; ++ix) {
            const CellId id = grid->find(Cell{ix, iy});
            if (id == noctule::kNoCell) { continue; }
            TEST_ASSERT_TRUE(grid->cell(id) == (Cell{ix, iy}));
            for (std::int32_t d = 0; d < 8; ++d) {  // links between tiles agree with the directory
                TEST_ASSERT_EQUAL_INT32(grid->find(Cell{ix + noctule::kNeighbourX[d], iy + noctule::kNeighbourY[d]}), grid->neighbour(id, d));
            }
        }
    }
}

void evidence_of_one_sweep_counts_once_and_is_bounded() {
    const Parameters p;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    for (int k = 0; k < 20; ++k) { add(s, 0.001F * static_cast<float>(k), 2.03F, true); }
    grid->integrate(at(0.04F, 0.02F), s);
    const GridTile& tile = grid->tile(0);
    const auto lo = [&](const int i) { return tile.log_odds[static_cast<std::size_t>(grid->find(Cell{i, 0}) & 4095)]; };
    TEST_ASSERT_EQUAL_INT8(14, lo(20));    // 0.875 nat in 1/16
    TEST_ASSERT_EQUAL_INT8(-6, lo(5));
    for (int k = 0; k < 100; ++k) { grid->integrate(at(0.04F, 0.02F), s); }
    TEST_ASSERT_EQUAL_INT8(79, lo(20));    // of 80: the last unit is for surfaces seen from near
    TEST_ASSERT_EQUAL_INT8(-48, lo(5));
}

void what_moved_away_fades_and_what_came_appears() {
    const Parameters p;
    const auto grid = grid_with(p);
    LevelScan person = empty_sweep();
    LevelScan gone = empty_sweep();
    for (int k = -10; k <= 10; ++k) {
        add(person, 0.004F * static_cast<float>(k), 2.03F, true);
        add(gone, 0.004F * static_cast<float>(k), 4.0F, true);
    }
    for (int k = 0; k < 200; ++k) { grid->integrate(at(0.04F, 0.05F), person); }
    TEST_ASSERT_EQUAL(CellClass::occupied, grid->cell_class(Cell{20, 0}));
    for (int k = 0; k < 20; ++k) { grid->integrate(at(0.04F, 0.05F), gone); }   // one second
    TEST_ASSERT_EQUAL(CellClass::free, grid->cell_class(Cell{20, 0}));
    grid->integrate(at(0.04F, 0.05F), person);
    for (int k = 0; k < 3; ++k) { grid->integrate(at(0.04F, 0.05F), person); }
    TEST_ASSERT_EQUAL(CellClass::occupied, grid->cell_class(Cell{20, 0}));
}

void beams_that_graze_a_wall_do_not_wear_it_away() {
    const Parameters p;
    const auto grid = grid_with(p);
    // GIVEN a wall along y = 0.55, seen from a place 5 degrees off its line, so that most beams cross cells of it
    for (int sweep = 0; sweep < 300; ++sweep) {
        LevelScan s = empty_sweep();
        for (int k = 0; k < 60; ++k) {
            const float bearing = 0.07F + 0.0044F * (static_cast<float>(k) + 0.05F * static_cast<float>(sweep % 20));
            add(s, bearing, 0.5F / std::sin(bearing), true);
        }
        grid->integrate(at(0.0F, 0.05F), s);
    }
    for (int i = 25; i < 60; ++i) {
        TEST_ASSERT_EQUAL(CellClass::occupied, grid->cell_class(Cell{i, 5}));
    }
}

void a_tilted_beam_that_passes_over_a_thing_does_not_clear_it() {
    for (const float z_m : {0.5F, -0.5F, 0.1F}) {
        const Parameters p;
        const auto grid = grid_with(p);
        LevelScan thing = empty_sweep();
        add(thing, 0.0F, 3.03F, true);
        for (int k = 0; k < 10; ++k) { grid->integrate(at(0.04F, 0.05F), thing); }
        LevelScan over = empty_sweep();
        add(over, 0.0F, 6.03F, true);
        over.points[0].z_m = z_m;                                  // at the thing half as much
        for (int k = 0; k < 40; ++k) { grid->integrate(at(0.04F, 0.05F), over); }
        TEST_ASSERT_EQUAL(std::fabs(z_m) > 0.4F ? CellClass::occupied : CellClass::free, grid->cell_class(Cell{30, 0}));
        TEST_ASSERT_EQUAL(CellClass::free, grid->cell_class(Cell{45, 0}));   // where nothing was ever hit, it still clears
    }
}

void a_lintel_met_by_a_tilted_beam_does_not_close_the_door() {
    for (const float z_m : {1.1F, 0.1F}) {
        const Parameters p;
        const auto grid = grid_with(p);
        LevelScan through = empty_sweep();
        add(through, 0.0F, 6.03F, true);
        for (int k = 0; k < 10; ++k) { grid->integrate(at(0.04F, 0.05F), through); }
        LevelScan lintel = empty_sweep();
        add(lintel, 0.0F, 3.03F, true);
        lintel.points[0].z_m = z_m;
        for (int k = 0; k < 20; ++k) { grid->integrate(at(0.04F, 0.05F), lintel); }
        TEST_ASSERT_EQUAL(z_m > 0.5F ? CellClass::free : CellClass::occupied, grid->cell_class(Cell{30, 0}));
        // Where nothing was known, it is a wall until a level beam says otherwise.
        LevelScan wall = empty_sweep();
        add(wall, 1.0F, 3.0F, true);
        wall.points[0].z_m = z_m;
        for (int k = 0; k < 10; ++k) { grid->integrate(at(0.04F, 0.05F), wall); }
        TEST_ASSERT_EQUAL(CellClass::occupied, grid->cell_class(Cell{16, 25}));
    }
}

void a_gap_without_return_is_free_only_where_both_sides_are_far() {
    const Parameters p;
    const auto near = grid_with(p);
    LevelScan s = empty_sweep();
    // GIVEN a pane of glass in a wall 3 m ahead: returns beside it, none through it
    for (int k = -100; k <= 100; ++k) {
        const float b = 0.0044F * static_cast<float>(k);
        add(s, b, std::abs(k) < 40 ? 10.0F : 3.0F / std::cos(b), std::abs(k) >= 40);
    }
    near->integrate(at(0.0F, 0.05F), s);
    TEST_ASSERT_EQUAL(CellClass::unknown, near->cell_class(Cell{10, 0}));   // THEN nothing is free in front of it
    const auto far = grid_with(p);
    s = empty_sweep();
    // GIVEN a corridor 2 m wide that goes on beyond the range: returns from its walls on both sides of the gap
    for (int k = -100; k <= 100; ++k) {
        const float b = 0.0044F * static_cast<float>(k);
        const float r = 1.0F / std::fmax(1e-4F, std::fabs(std::sin(b)));
        add(s, b, std::fmin(r, 10.0F), r < 10.0F);
    }
    far->integrate(at(0.0F, 0.05F), s);
    TEST_ASSERT_EQUAL(CellClass::free, far->cell_class(Cell{80, 0}));       // THEN it is free up to the chord
    TEST_ASSERT_EQUAL(CellClass::unknown, far->cell_class(Cell{99, 0}));
    for (const float wall_m : {9.2F, 9.8F}) {
        const auto dark = grid_with(p);
        s = empty_sweep();
        // GIVEN a dark thing 2 m wide, no return, before a wall that is near the end of the range
        for (int k = -100; k <= 100; ++k) {
            const float b = 0.0044F * static_cast<float>(k);
            add(s, b, std::abs(k) < 25 ? 10.0F : std::fmin(10.0F, wall_m / std::cos(b)), std::abs(k) >= 25 && wall_m / std::cos(b) < 10.0F);
        }
        dark->integrate(at(0.0F, 0.05F), s);
        TEST_ASSERT_EQUAL(CellClass::unknown, dark->cell_class(Cell{40, 0}));   // THEN where it stands is not free
    }
}

void thick_obstacles_of_the_paper_fill_their_depth() {
    Parameters p;
    p.obstacle_thickness_m = 0.5F;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    add(s, 0.0F, 2.0F, true);
    grid->integrate(at(0.0F, 0.05F), s);
    TEST_ASSERT_EQUAL(CellClass::free, grid->cell_class(Cell{16, 0}));
    for (int i = 18; i <= 21; ++i) { TEST_ASSERT_EQUAL(CellClass::occupied, grid->cell_class(Cell{i, 0})); }
    TEST_ASSERT_EQUAL(CellClass::unknown, grid->cell_class(Cell{24, 0}));
}

void bad_sweeps_are_refused_and_counted() {
    const Parameters p;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    add(s, 0.0F, 2.0F, true);
    Estimate lost = at(0.0F, 0.0F);
    lost.planar.quality = -1;
    grid->integrate(lost, s);
    Estimate low = at(0.0F, 0.0F);
    low.altitude.z_m = 0.1F;
    grid->integrate(low, s);
    grid->integrate(at(std::nanf(""), 0.0F), s);
    TEST_ASSERT_EQUAL_UINT32(3U, grid->counters().scans_refused);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, grid->known_area_m2());
    LevelScan odd = empty_sweep();
    add(odd, 0.0F, std::nanf(""), true);                          // a bad beam does no harm to a good sweep
    add(odd, 1.0F, 2.0F, true);
    grid->integrate(at(0.0F, 0.0F), odd);
    TEST_ASSERT_EQUAL_UINT32(1U, grid->counters().beams_used);
}

void a_full_pool_refuses_counts_and_keeps_what_it_has() {
    const Parameters p;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    add(s, 0.0F, 2.0F, true);
    const auto tiles = static_cast<int>(kMaxTiles);
    for (int k = 0; k < tiles + 20; ++k) { grid->integrate(at(0.5F + 6.4F * static_cast<float>(k % 100), 0.5F + 6.4F * static_cast<float>(k / 100)), s); }
    TEST_ASSERT_EQUAL_INT32(tiles, grid->tile_count());
    TEST_ASSERT_TRUE(grid->counters().tiles_refused > 0U);
    TEST_ASSERT_EQUAL(CellClass::free, grid->cell_class(grid->find(1.0F, 0.5F)));
    TEST_ASSERT_EQUAL(CellClass::unknown, grid->cell_class(grid->find(1.0F + 6.4F * static_cast<float>((tiles + 5) % 100), 0.5F + 6.4F * static_cast<float>((tiles + 5) / 100))));
}

void every_change_is_published_in_the_end() {
    const Parameters p;
    const auto grid = grid_with(p);
    std::set<std::pair<int, int>> seen;
    LevelScan s = empty_sweep();
    for (int k = 0; k < 720; ++k) { add(s, 0.0087266F * static_cast<float>(k), 9.5F, true); }
    grid->integrate(at(0.0F, 0.0F), s);
    grid->integrate(at(6.0F, 0.0F), s);
    std::int64_t t_us = 0;
    auto copies = std::make_unique<std::array<std::array<std::int8_t, noctule::kTileArea>, 64>>();
    for (int step = 0; step < 100; ++step) {
        t_us += 50000;
        int taken = 0;
        for (; taken < 4; ++taken) {
            const GridTile* tile = grid->take_changed_tile(t_us);
            if (tile == nullptr) { break; }
            seen.insert({tile->tile_x, tile->tile_y});
            (*copies)[static_cast<std::size_t>(grid->tile_slot(tile->tile_x, tile->tile_y))] = tile->log_odds;
        }
        if (step == 10) { grid->integrate(at(6.0F, 0.0F), s); }   // values change, classes do not
    }
    TEST_ASSERT_EQUAL_INT32(grid->tile_count(), static_cast<std::int32_t>(seen.size()));
    for (std::int32_t slot = 0; slot < grid->tile_count(); ++slot) {
        TEST_ASSERT_EQUAL_INT(0, std::memcmp((*copies)[static_cast<std::size_t>(slot)].data(), grid->tile(slot).log_odds.data(), noctule::kTileArea));
    }
    TEST_ASSERT_NULL(grid->take_changed_tile(t_us + 10000000));
}

void clearance_is_measured_to_hits_not_to_cells() {
    const Parameters p;
    const auto grid = grid_with(p);
    for (const float offset : {0.02F, 0.05F, 0.08F}) {
        grid->reset();
        LevelScan s = empty_sweep();
        add(s, 0.0F, 1.0F + offset, true);
        grid->integrate(at(0.0F, 0.05F), s);
        float hx = 0.0F;
        TEST_ASSERT_FLOAT_WITHIN(0.001F, 0.6F + offset, grid->clearance_m(0.4F, 0.05F, 0.8F, &hx));
        TEST_ASSERT_FLOAT_WITHIN(0.001F, 1.0F + offset, hx);
        TEST_ASSERT_FLOAT_WITHIN(0.001F, 0.5F, grid->clearance_m(0.0F, 0.05F, 0.5F));
    }
}

// The end of a wall of 0.10 m, seen from half a metre, wherever the grid's lines cross it and however it stands.
void a_corner_is_not_averaged_back() {
    const Parameters p;
    const auto grid = grid_with(p);
    std::mt19937 rng(11);
    LevelScan s;
    double sum_m = 0.0;
    int looks = 0;
    for (int turn = 0; turn < 8; ++turn) {
        for (int shift = 0; shift < 5; ++shift) {
            noctule::test::FlatWorld world;
            world.add_wall(0.0, 0.0, 2.0, 0.0);
            world.turn(0.2 * turn);
            world.shift(0.021 * shift, 0.013 * shift);
            // Before the corner, on the line that halves it.
            const double away = 0.2 * turn + 2.3562;
            const double x_m = 0.021 * shift - 0.05 * std::sin(0.2 * turn) + 0.5 * std::cos(away);
            const double y_m = 0.013 * shift + 0.05 * std::cos(0.2 * turn) + 0.5 * std::sin(away);
            grid->reset();
            for (int k = 0; k < 20; ++k) {
                noctule::test::sweep(world, x_m, y_m, away + 3.14159265, 10.0, 0.01, rng, s);
                s.range_noise_m = 0.01F;
                grid->integrate(at(static_cast<float>(x_m), static_cast<float>(y_m), static_cast<float>(away + 3.14159265)), s);
            }
            const double error_m = static_cast<double>(grid->clearance_m(static_cast<float>(x_m), static_cast<float>(y_m), 0.8F)) - world.clearance(x_m, y_m);
            TEST_ASSERT_TRUE_MESSAGE(error_m < 0.025, "it would be passed too near");
            TEST_ASSERT_TRUE_MESSAGE(error_m > -0.012, "a gap beside it would seem closed");
            sum_m += error_m;
            ++looks;
        }
    }
    TEST_ASSERT_TRUE(sum_m / looks < 0.007);
}

// A corner that was seen from before it, then for long from one side only, where it is no more than the end of what is seen.
void looks_at_one_side_do_not_draw_a_corner_back() {
    const Parameters p;
    const auto grid = grid_with(p);
    std::mt19937 rng(17);
    LevelScan s;
    double sum_m = 0.0;
    for (int turn = 0; turn < 12; ++turn) {
        noctule::test::FlatWorld world;
        world.add_segment(0.0, 0.0, 1.0, 0.0);
        world.add_segment(0.0, 0.0, 0.0, 1.0);
        world.turn(0.13 * turn);
        world.shift(0.03 * turn, 0.017 * turn);
        const auto place = [&](const double x_m, const double y_m) {
            const double a = 0.13 * turn;
            return std::pair{std::cos(a) * x_m - std::sin(a) * y_m + 0.03 * turn, std::sin(a) * x_m + std::cos(a) * y_m + 0.017 * turn};
        };
        const auto look = [&](const double x_m, const double y_m, const double yaw_rad) {
            const auto [at_x_m, at_y_m] = place(x_m, y_m);
            noctule::test::sweep(world, at_x_m, at_y_m, yaw_rad + 0.13 * turn, 10.0, 0.01, rng, s);
            s.range_noise_m = 0.01F;
            grid->integrate(at(static_cast<float>(at_x_m), static_cast<float>(at_y_m), static_cast<float>(yaw_rad + 0.13 * turn)), s);
        };
        grid->reset();
        for (int k = 0; k < 20; ++k) { look(-0.3, -0.3, 0.785); }
        for (int k = 0; k < 40; ++k) { look(0.12, -0.4, 1.5708); }
        const auto [x_m, y_m] = place(-0.26, -0.26);
        sum_m += static_cast<double>(grid->clearance_m(static_cast<float>(x_m), static_cast<float>(y_m), 0.8F)) - world.clearance(x_m, y_m);
    }
    TEST_ASSERT_TRUE(sum_m / 12.0 < 0.0095);
}

// A leg that was seen whole, then by the last beams of the sweep only, which show one edge of it, then not any more: beams pass beside that edge.
void the_rim_of_the_sector_does_not_wear_a_leg_away() {
    const Parameters p;
    const auto grid = grid_with(p);
    std::mt19937 rng(23);
    LevelScan s;
    noctule::test::FlatWorld world;
    for (const double side_m : {-0.03, 0.03}) {
        world.add_segment(0.55 + side_m, 0.02, 0.55 + side_m, 0.08);
        world.add_segment(0.52, 0.05 + side_m, 0.58, 0.05 + side_m);
    }
    world.add_segment(3.0, -3.0, 3.0, 3.0);
    const double edge_rad = std::atan2(0.03, 0.52);
    const auto look = [&](const double yaw_rad) {
        noctule::test::sweep(world, 0.0, 0.05, yaw_rad, 10.0, 0.01, rng, s);
        s.range_noise_m = 0.01F;
        grid->integrate(at(0.0F, 0.05F, static_cast<float>(yaw_rad)), s);
    };
    for (const double rim_rad : {2.35619449, -2.35619449}) {
        grid->reset();
        const double side = rim_rad > 0.0 ? 1.0 : -1.0;
        for (int k = 0; k < 20; ++k) { look(0.0); }
        const float before_m = grid->clearance_m(0.40F, 0.35F, 0.8F);
        for (int k = 0; k < 60; ++k) { look(-rim_rad - side * (edge_rad - 0.012)); }
        for (int k = 0; k < 60; ++k) { look(-rim_rad - side * (edge_rad + 0.006)); }
        TEST_ASSERT_FLOAT_WITHIN_MESSAGE(0.012F, before_m, grid->clearance_m(0.40F, 0.35F, 0.8F), "it stands where it stood");
    }
}

// On the edge between two cells the corner stands out of what is seen of neither.
void a_corner_between_two_cells_is_not_averaged_back() {
    const Parameters p;
    const auto grid = grid_with(p);
    std::mt19937 rng(19);
    LevelScan s;
    double sum_m = 0.0;
    for (int shift = 0; shift < 8; ++shift) {
        noctule::test::FlatWorld world;
        world.add_segment(0.0, 0.0, 0.7, 0.7);
        world.add_segment(0.0, 0.0, 0.7, -0.7);
        world.shift(0.32, 0.002 * (shift - 4));   // cells meet on y = 0
        grid->reset();
        for (int k = 0; k < 20; ++k) {
            noctule::test::sweep(world, -0.05, 0.0, 0.0, 10.0, 0.01, rng, s);
            s.range_noise_m = 0.01F;
            grid->integrate(at(-0.05F, 0.0F), s);
        }
        const double error_m = static_cast<double>(grid->clearance_m(-0.05F, 0.0F, 0.8F)) - world.clearance(-0.05, 0.0);
        TEST_ASSERT_TRUE(error_m < 0.025);
        sum_m += error_m;
    }
    TEST_ASSERT_TRUE(sum_m / 8.0 < 0.012);
}

// Looks from afar, which cannot tell a corner from the middle of what they see, leave it where looks from near put it.
void what_was_seen_from_near_is_not_moved_from_afar() {
    const Parameters p;
    const auto grid = grid_with(p);
    std::mt19937 rng(13);
    LevelScan s;
    noctule::test::FlatWorld world;
    world.add_wall(0.0, 0.0, 2.0, 0.0);
    world.turn(0.7854);
    const auto look = [&](const double x_m) {   // along the x axis at the corner on the left
        noctule::test::sweep(world, x_m, 0.0354, 0.0, 10.0, 0.01, rng, s);
        s.range_noise_m = 0.01F;
        grid->integrate(at(static_cast<float>(x_m), 0.0354F), s);
    };
    for (int k = 0; k < 20; ++k) { look(-0.5); }
    const float before_m = grid->clearance_m(-0.5F, 0.0354F, 0.8F);
    TEST_ASSERT_FLOAT_WITHIN(0.012F, static_cast<float>(world.clearance(-0.5, 0.0354)), before_m);
    for (int k = 0; k < 40; ++k) { look(-3.0); }
    TEST_ASSERT_FLOAT_WITHIN(0.001F, before_m, grid->clearance_m(-0.5F, 0.0354F, 0.8F));
}

// A wall 2.5 cm behind the edge of a row of cells: one beam in a hundred ends before it by as much.
void noise_puts_no_hits_before_a_wall() {
    const Parameters p;
    const auto grid = grid_with(p);
    noctule::test::FlatWorld world;
    world.add_segment(-2.0, 1.025, 2.0, 1.025);
    std::mt19937 rng(7);
    LevelScan s;
    for (int k = 0; k < 300; ++k) {
        noctule::test::sweep(world, 0.0, 0.0, 1.5707963, 10.0, 0.01, rng, s);
        s.range_noise_m = 0.01F;
        grid->integrate(at(0.0F, 0.0F, 1.5707963F), s);
    }
    for (float x_m = -0.45F; x_m < 0.5F; x_m += 0.1F) {
        TEST_ASSERT_TRUE(grid->cell_class(grid->find(x_m, 0.95F)) == CellClass::free);
        TEST_ASSERT_TRUE(grid->cell_class(grid->find(x_m, 1.05F)) == CellClass::occupied);
    }
}

void clearance_is_that_of_the_nearest_of_all_hits() {
    Parameters p;
    p.obstacle_thickness_m = 0.0F;
    const auto grid = grid_with(p);
    std::mt19937 rng{5};
    std::uniform_real_distribution<float> bearing{-3.1F, 3.1F};
    std::uniform_real_distribution<float> range{0.2F, 9.0F};
    LevelScan s = empty_sweep();
    for (int k = 0; k < 1000; ++k) { add(s, bearing(rng), range(rng), true); }   // GIVEN hits strewn over several tiles
    grid->integrate(at(0.04F, 0.05F), s);
    std::uniform_real_distribution<float> place{-7.0F, 7.0F};
    int without = 0;
    for (int k = 0; k < 400; ++k) {
        const float x_m = place(rng);
        const float y_m = place(rng);
        for (const float radius_m : {0.12F, 0.36F, 0.55F, 0.8F, 2.0F}) {
            float nearest_m2 = radius_m * radius_m;
            float want_x_m = -99.0F;
            for (CellId id = 0; id < grid->tile_count() * noctule::kTileArea; ++id) {
                if (grid->cell_class(id) != CellClass::occupied) { continue; }
                float hx = 0.0F;
                float hy = 0.0F;
                grid->hit_point(id, hx, hy);
                const float d2 = (hx - x_m) * (hx - x_m) + (hy - y_m) * (hy - y_m);
                if (d2 < nearest_m2) {
                    nearest_m2 = d2;
                    want_x_m = hx;
                }
            }
            float at_x_m = -99.0F;
            TEST_ASSERT_EQUAL_FLOAT(std::sqrt(nearest_m2), grid->clearance_m(x_m, y_m, radius_m, &at_x_m));   // THEN no nearer one is missed
            TEST_ASSERT_EQUAL_FLOAT(want_x_m, at_x_m);
            without += want_x_m < -90.0F ? 1 : 0;
        }
    }
    TEST_ASSERT_TRUE(without > 100 && without < 1800);   // both cases were met
}

void the_camera_sees_its_sector_of_free_cells_up_to_the_first_wall() {
    Parameters p;
    p.no_return_open = 0.0F;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    for (int k = 0; k < 1440; ++k) {                                       // GIVEN free floor all round, a wall at x = 3
        const float b = 0.0043633F * static_cast<float>(k) - noctule::kPi;
        const float to_wall = std::cos(b) > 0.31F ? 3.0F / std::cos(b) : 9.0F;
        if (k < 1199) { add(s, b, std::fmin(9.0F, to_wall), to_wall < 9.0F); }
    }
    Estimate e = at(0.0F, 0.0F);
    grid->integrate(e, s);
    grid->integrate(e, s);
    TEST_ASSERT_EQUAL_FLOAT(0.0F, grid->camera_seen_fraction());
    const float expected_m2 = grid->unseen_in_view_m2(0.0F, 0.0F, 0.0F);
    grid->look(e.planar.pose_map_body);                                    // WHEN it looks along x once
    const auto saw = [&](const float x_m, const float y_m) { return grid->camera_saw(grid->find(x_m, y_m)); };
    TEST_ASSERT_TRUE(saw(2.5F, 0.0F));
    TEST_ASSERT_TRUE(saw(2.5F, 1.5F));                                     // 0.54 rad aside
    TEST_ASSERT_FALSE(saw(1.0F, 1.0F));                                    // 0.79 rad aside
    TEST_ASSERT_FALSE(saw(-1.0F, 0.0F));                                   // behind
    TEST_ASSERT_FALSE(saw(3.25F, 0.1F));                                   // behind the wall
    grid->look({-8.0F, -3.0F, 0.0F});
    TEST_ASSERT_FALSE(saw(-3.0F, -3.0F));                                  // farther than 4 m
    TEST_ASSERT_TRUE(saw(-4.5F, -3.0F));
    TEST_ASSERT_FLOAT_WITHIN(0.05F, 0.0F, grid->unseen_in_view_m2(0.0F, 0.0F, 0.0F));   // THEN nothing is new there
    TEST_ASSERT_FLOAT_WITHIN(0.3F, 9.0F * std::tan(0.6F), expected_m2);    // a triangle: 3 m deep, 2 x 3 tan(0.6) wide
    const noctule::Cell c = grid->geometry().cell(2.0F, 0.0F);
    const std::int32_t slot = grid->tile_slot(c.ix >> 6, c.iy >> 6);
    TEST_ASSERT_EQUAL_INT32(0, grid->unseen_in_block(slot, ((c.iy >> 3) & 7) * 8 + ((c.ix >> 3) & 7)));
    TEST_ASSERT_EQUAL_INT32(64, grid->unseen_in_block(slot, 6 * 8 + 1));   // x 0.8 to 1.6, y 4.8 to 5.6
    const float before = grid->camera_seen_fraction();
    for (int k = 0; k < 4; ++k) { grid->integrate(at(0.0F, 0.0F, 1.6F), empty_sweep()); }   // sweeps bring looks of their own
    TEST_ASSERT_TRUE(grid->camera_seen_fraction() > before);
}

void floors_share_the_pool_and_nothing_else() {
    const Parameters p;
    const auto grid = grid_with(p);
    LevelScan s = empty_sweep();
    add(s, 0.0F, 2.0F, true);
    grid->integrate(at(0.04F, 0.05F), s);
    const CellId below = grid->find(2.04F, 0.05F);
    TEST_ASSERT_TRUE(grid->select_floor(1));                              // WHEN the vehicle is on the next floor
    TEST_ASSERT_EQUAL(CellClass::unknown, grid->cell_class(grid->find(2.04F, 0.05F)));   // THEN nothing is known there yet
    TEST_ASSERT_FALSE(grid->on_floor(0));
    LevelScan longer = empty_sweep();
    add(longer, 0.0F, 3.0F, true);
    grid->integrate(at(0.04F, 0.05F), longer);
    TEST_ASSERT_EQUAL(CellClass::free, grid->cell_class(grid->find(2.04F, 0.05F)));
    TEST_ASSERT_EQUAL(CellClass::occupied, grid->cell_class(below));      // AND a handle still names the cell below
    TEST_ASSERT_EQUAL_INT32(2, grid->tile_count());
    TEST_ASSERT_EQUAL_INT32(noctule::kNoCell, grid->neighbour(grid->find(0.05F, 0.05F), 5));   // no link leads down
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.21F, grid->known_area_m2(0));
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.31F, grid->known_area_m2(1));
    TEST_ASSERT_TRUE(grid->select_floor(0));                              // WHEN it comes back THEN all is as it was
    TEST_ASSERT_EQUAL_INT32(below, grid->find(2.04F, 0.05F));
    TEST_ASSERT_EQUAL(CellClass::unknown, grid->cell_class(grid->find(2.94F, 0.05F)));
    TEST_ASSERT_FALSE(grid->select_floor(noctule::kMaxFloors));
    TEST_ASSERT_FALSE(grid->select_floor(-1));
    TEST_ASSERT_EQUAL_INT32(0, grid->floor());
    std::set<std::int32_t> floors;
    for (const GridTile* t = grid->take_changed_tile(1); t != nullptr; t = grid->take_changed_tile(1)) { floors.insert(t->floor); }
    TEST_ASSERT_EQUAL(2U, floors.size());                                 // AND both are published, whichever is active
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_beam_frees_the_cells_before_its_end_and_fills_the_last);
    RUN_TEST(a_ray_visits_the_same_cells_from_both_ends);
    RUN_TEST(cells_and_metres_are_inverse_across_tiles);
    RUN_TEST(evidence_of_one_sweep_counts_once_and_is_bounded);
    RUN_TEST(what_moved_away_fades_and_what_came_appears);
    RUN_TEST(beams_that_graze_a_wall_do_not_wear_it_away);
    RUN_TEST(a_tilted_beam_that_passes_over_a_thing_does_not_clear_it);
    RUN_TEST(a_lintel_met_by_a_tilted_beam_does_not_close_the_door);
    RUN_TEST(a_gap_without_return_is_free_only_where_both_sides_are_far);
    RUN_TEST(thick_obstacles_of_the_paper_fill_their_depth);
    RUN_TEST(bad_sweeps_are_refused_and_counted);
    RUN_TEST(a_full_pool_refuses_counts_and_keeps_what_it_has);
    RUN_TEST(every_change_is_published_in_the_end);
    RUN_TEST(clearance_is_measured_to_hits_not_to_cells);
    RUN_TEST(a_corner_is_not_averaged_back);
    RUN_TEST(looks_at_one_side_do_not_draw_a_corner_back);
    RUN_TEST(the_rim_of_the_sector_does_not_wear_a_leg_away);
    RUN_TEST(a_corner_between_two_cells_is_not_averaged_back);
    RUN_TEST(what_was_seen_from_near_is_not_moved_from_afar);
    RUN_TEST(noise_puts_no_hits_before_a_wall);
    RUN_TEST(clearance_is_that_of_the_nearest_of_all_hits);
    RUN_TEST(the_camera_sees_its_sector_of_free_cells_up_to_the_first_wall);
    RUN_TEST(floors_share_the_pool_and_nothing_else);
    return UNITY_END();
}
