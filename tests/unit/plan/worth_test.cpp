// What is left when hardly anything is: pockets must be worth their way; a change of mind is not undone for nothing.
#include <cmath>
#include <initializer_list>

#include "plan/worth.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

constexpr float kFloorM2 = 200.0F;   // 0.7 % of it are 1.4 m2

Frontier pocket(const std::int32_t cells, const std::int32_t behind, const float way_m) {
    Frontier f;
    f.cells = cells;
    f.behind = behind;
    f.sight_cost = static_cast<std::uint32_t>(way_m * 10.0F * static_cast<float>(CostField::kUnit));
    return f;
}

std::size_t kept(const Parameters& p, const std::initializer_list<Frontier> stops, Bounded<Frontier, 8>& out) {
    out.clear();
    for (const Frontier& f : stops) { TEST_ASSERT_TRUE(out.push(f)); }
    keep_worthwhile(p, kFloorM2, out);
    return out.size();
}

void a_pocket_reveals_what_is_behind_it_but_not_much_more_than_its_mouth_is_wide() {
    const Parameters p;
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.30F, reveals_m2(p, pocket(10, 30, 1.0F)));   // 30 cells
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.32F, reveals_m2(p, pocket(4, 500, 1.0F)));   // a slit of 0.4 m before 5 m2: 2 x 0.16
}

void what_is_set_aside_may_leave_more_than_its_mouth_shows() {
    const Parameters p;
    TEST_ASSERT_FLOAT_WITHIN(1e-4F, 0.30F, leaves_m2(p, pocket(10, 30, 1.0F)));                        // a closed pocket: what it reveals
    TEST_ASSERT_FLOAT_WITHIN(1e-3F, std::sqrt(0.32F * 5.0F), leaves_m2(p, pocket(4, 500, 1.0F)));      // a slit that may show a room
    TEST_ASSERT_FLOAT_WITHIN(1e-6F, 0.0F, leaves_m2(p, pocket(0, 0, 1.0F)));                           // a patch of floor: never set aside
}

void the_last_pockets_must_be_worth_their_way() {
    const Parameters p;
    Bounded<Frontier, 8> out;
    // 0.3 m2 each: worth a way of 6 m at 0.05 m2 a metre.
    TEST_ASSERT_EQUAL(1, kept(p, {pocket(10, 30, 5.9F), pocket(10, 30, 6.1F)}, out));
    TEST_ASSERT_FLOAT_WITHIN(0.05F, 5.9F, CostField::metres(out[0].sight_cost, 0.1F));
    TEST_ASSERT_EQUAL(0, kept(p, {pocket(10, 30, 20.0F)}, out));
    TEST_ASSERT_EQUAL(1, kept(p, {pocket(4, 500, 20.0F)}, out));   // a slit, but a room may lie behind it
    Parameters all = p;
    all.tour_worth_m = 0.0F;
    TEST_ASSERT_EQUAL(2, kept(all, {pocket(10, 30, 5.9F), pocket(10, 30, 600.0F)}, out));
}

void while_more_is_left_all_stay() {
    const Parameters p;
    Bounded<Frontier, 8> out;
    TEST_ASSERT_EQUAL(2, kept(p, {pocket(10, 30, 50.0F), pocket(20, 120, 1.0F)}, out));   // 1.5 m2 in all
    TEST_ASSERT_EQUAL(1, kept(p, {pocket(10, 30, 50.0F), pocket(20, 100, 1.0F)}, out));   // 1.3 m2
}

void patches_for_the_camera_and_places_to_pass_stay() {
    const Parameters p;
    Bounded<Frontier, 8> out;
    Frontier patch = pocket(0, 0, 40.0F);
    patch.camera = true;
    Frontier place = pocket(0, 0, 40.0F);
    place.sounding = true;
    TEST_ASSERT_EQUAL(2, kept(p, {pocket(10, 30, 40.0F), patch, place}, out));
    TEST_ASSERT_TRUE(out[0].camera && out[1].sounding);
}

void what_was_left_is_not_taken_again_before_something_is_learned() {
    LeftGoal left;
    TEST_ASSERT_FALSE(left.undone_by(3.0F, 4.0F, 50.0F));
    left.set(3.0F, 4.0F, 50.0F);
    TEST_ASSERT_TRUE(left.undone_by(3.0F, 4.0F, 50.9F));
    TEST_ASSERT_TRUE(left.undone_by(3.7F, 4.6F, 50.9F));     // the same piece of the unknown, seen a little elsewhere
    TEST_ASSERT_FALSE(left.undone_by(4.1F, 4.0F, 50.9F));    // another one
    TEST_ASSERT_FALSE(left.undone_by(3.0F, 4.0F, 51.1F));    // 1 m2 is news
    left.set(-1.0F, 0.0F, 51.0F);
    TEST_ASSERT_FALSE(left.undone_by(3.0F, 4.0F, 51.0F));
    left.clear();
    TEST_ASSERT_FALSE(left.undone_by(-1.0F, 0.0F, 51.0F));
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_pocket_reveals_what_is_behind_it_but_not_much_more_than_its_mouth_is_wide);
    RUN_TEST(what_is_set_aside_may_leave_more_than_its_mouth_shows);
    RUN_TEST(the_last_pockets_must_be_worth_their_way);
    RUN_TEST(while_more_is_left_all_stay);
    RUN_TEST(patches_for_the_camera_and_places_to_pass_stay);
    RUN_TEST(what_was_left_is_not_taken_again_before_something_is_learned);
    return UNITY_END();
}
