// The map of what is over and under: the vote of a cell, floors and sides apart, what happens when it is full.
#include "map/vertical_map.hpp"

#include <cmath>
#include <limits>
#include <memory>

#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

void most_readings_of_a_cell_win() {
    const auto map = std::make_unique<VerticalMap>(0.1F);
    map->add(0, VerticalSide::over, 1.05F, -2.05F, 4.8F);   // one echo first
    for (int i = 0; i < 3; ++i) { map->add(0, VerticalSide::over, 1.05F, -2.05F, 2.3F + 0.01F * static_cast<float>(i)); }
    const VerticalCell* cell = map->find(0, VerticalSide::over, {10, -21});
    TEST_ASSERT_NOT_NULL(cell);
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 2.31F, cell->z_m);
    map->add(0, VerticalSide::over, 1.05F, -2.05F, 4.8F);   // one echo later
    TEST_ASSERT_FLOAT_WITHIN(0.02F, 2.31F, map->find(0, VerticalSide::over, {10, -21})->z_m);
    TEST_ASSERT_EQUAL_size_t(1, map->size());
}

void floors_and_sides_are_apart() {
    const auto map = std::make_unique<VerticalMap>(0.1F);
    map->add(0, VerticalSide::over, 0.0F, 0.0F, 2.3F);
    map->add(0, VerticalSide::under, 0.0F, 0.0F, 0.0F);
    map->add(1, VerticalSide::under, 0.0F, 0.0F, 2.5F);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.0F, map->find(0, VerticalSide::under, {0, 0})->z_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 2.5F, map->find(1, VerticalSide::under, {0, 0})->z_m);
    TEST_ASSERT_NULL(map->find(1, VerticalSide::over, {0, 0}));
    map->forget(0);
    TEST_ASSERT_NULL(map->find(0, VerticalSide::over, {0, 0}));
    TEST_ASSERT_NOT_NULL(map->find(1, VerticalSide::under, {0, 0}));
}

void a_full_map_refuses_new_places_and_keeps_the_old_ones() {
    const auto map = std::make_unique<VerticalMap>(0.1F);
    for (int i = 0; i < 40000; ++i) { map->add(0, VerticalSide::over, 0.1F * static_cast<float>(i % 200) + 0.05F, 0.1F * static_cast<float>(i / 200) + 0.05F, 2.5F); }
    TEST_ASSERT_EQUAL_size_t(kMaxVerticalCells / 8U * 7U, map->size());
    TEST_ASSERT_EQUAL_UINT32(40000U - kMaxVerticalCells / 8U * 7U, map->refused());
    map->add(0, VerticalSide::over, 0.05F, 0.05F, 2.5F);
    TEST_ASSERT_EQUAL_UINT32(40000U - kMaxVerticalCells / 8U * 7U, map->refused());
    TEST_ASSERT_NOT_NULL(map->find(0, VerticalSide::over, {0, 0}));
}

void bad_readings_are_refused() {
    const auto map = std::make_unique<VerticalMap>(0.1F);
    map->add(0, VerticalSide::over, std::nanf(""), 0.0F, 2.5F);
    map->add(0, VerticalSide::over, 0.0F, 0.0F, std::numeric_limits<float>::infinity());
    map->add(-1, VerticalSide::over, 0.0F, 0.0F, 2.5F);
    TEST_ASSERT_EQUAL_UINT32(3, map->refused());
    TEST_ASSERT_EQUAL_size_t(0, map->size());
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(most_readings_of_a_cell_win);
    RUN_TEST(floors_and_sides_are_apart);
    RUN_TEST(a_full_map_refuses_new_places_and_keeps_the_old_ones);
    RUN_TEST(bad_readings_are_refused);
    return UNITY_END();
}
