// A policy outside: a goal it answers is flown to, nonsense and silence are refused, counted, and do not end the flight.
#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "plan/external_policy.hpp"
#include "unit/plan/closed_world.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;
using test::ClosedLoop;
using test::FlatWorld;

namespace {

/// A room of 8 x 6 m with a slot of 0.5 m, in which the hull fits nowhere.
FlatWorld room() {
    constexpr double kCorners[][2] = {{-3.0, -3.0}, {5.0, -3.0}, {5.0, 0.0}, {7.5, 0.0}, {7.5, 0.5}, {5.0, 0.5}, {5.0, 3.0}, {-3.0, 3.0}, {-3.0, -3.0}};
    FlatWorld world;
    for (std::size_t k = 1; k < std::size(kCorners); ++k) { world.add_segment(kCorners[k - 1][0], kCorners[k - 1][1], kCorners[k][0], kCorners[k][1]); }
    return world;
}

struct Outside {
    Parameters p;
    FlatWorld world = room();
    std::unique_ptr<ClosedLoop> loop;

    explicit Outside(const bool pillars = false) {
        if (pillars) {
            world.add_pillar(-1.5, 1.5, 0.4);
            world.add_pillar(2.0, -1.2, 0.4);
        }
        p.policy = static_cast<std::int32_t>(PolicyKind::external);
        p.floors_max = 1;
        loop = std::make_unique<ClosedLoop>(p, world, 3U);
        for (int k = 0; k < 60 && !loop->mission.ready(); ++k) { loop->step(); }
        loop->step(Order::start);
        for (int k = 0; k < 1200 && !asked(); ++k) { loop->step(); }
    }
    [[nodiscard]] const PolicyAsk& ask() const { return loop->mission.explorer().external().ask(); }
    [[nodiscard]] bool asked() const { return loop->mission.state() == MissionState::exploring && ask().number > 0; }
    [[nodiscard]] PolicyKind who() const { return loop->mission.explorer().kind(); }
    /// An answer to the newest request, and the step that takes it up.
    void answer(GoalSample told) {
        told.ask += ask().number;
        Bounded<GoalSample, kMaxGoalPerStep> answers;
        static_cast<void>(answers.push(told));
        loop->mission.hear(answers);
        loop->step();
    }
    void goal(const float x_m, const float y_m, const float look_x_m = 4.0F, const float look_y_m = 2.0F) {
        answer({0, 0, GoalSample::Kind::goal, x_m, y_m, look_x_m, look_y_m});
    }
};

void a_goal_is_flown_to_and_looked_from() {
    Outside o;
    TEST_ASSERT_TRUE(o.asked());
    TEST_ASSERT_EQUAL(PolicyKind::external, o.who());
    for (int k = 0; k < 200; ++k) {
        o.goal(2.0F, -1.5F, 2.0F, 2.0F);
        if (k == 50) { TEST_ASSERT_EQUAL_UINT32(0U, o.ask().timeouts); }   // under way and answering
    }
    TEST_ASSERT_DOUBLE_WITHIN(0.1, 2.0, o.loop->x);
    TEST_ASSERT_DOUBLE_WITHIN(0.1, -1.5, o.loop->y);
    TEST_ASSERT_FLOAT_WITHIN(0.15F, 0.5F * kPi, wrap_angle(static_cast<float>(o.loop->yaw)));
    TEST_ASSERT_TRUE(o.ask().goal_valid);
    TEST_ASSERT_EQUAL_FLOAT(2.0F, o.ask().goal_x_m);
    TEST_ASSERT_EQUAL_UINT32(0U, o.ask().refused);
    TEST_ASSERT_EQUAL_UINT32(1U, o.loop->mission.explorer().counters().goals);   // told again it is no new goal
}

void every_kind_of_nonsense_is_refused_by_its_name() {
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
    struct Case {
        GoalSample told;
        Verdict verdict;
    };
    const auto at = [](const float x_m, const float y_m, const float look_x_m = 0.0F) {
        return GoalSample{0, 0, GoalSample::Kind::goal, x_m, y_m, look_x_m, 0.0F};
    };
    const Case cases[] = {
        {{0, 0, GoalSample::Kind::failed, 0.0F, 0.0F, 0.0F, 0.0F}, Verdict::failed},
        {at(kNan, 0.0F), Verdict::no_number},
        {at(0.0F, std::numeric_limits<float>::infinity()), Verdict::no_number},
        {at(3e38F, 0.0F), Verdict::no_number},
        {at(1.0F, 1.0F, kNan), Verdict::no_number},
        {{0, 0, static_cast<GoalSample::Kind>(77), 0.0F, 0.0F, 0.0F, 0.0F}, Verdict::no_number},
        {at(300.0F, 0.0F), Verdict::nothing_known},
        {at(-3.0F, 0.03F), Verdict::in_wall},
        {at(6.5F, 0.25F), Verdict::no_room},
        {{0, 1, GoalSample::Kind::goal, 1.0F, 1.0F, 0.0F, 0.0F}, Verdict::wrong_ask},
    };
    Outside o;
    o.p.policy_patience = 1000;
    for (const Case& c : cases) {
        const std::uint32_t before = o.ask().refused;
        o.answer(c.told);
        TEST_ASSERT_EQUAL(before + 1U, o.ask().refused);
        TEST_ASSERT_EQUAL(c.verdict, o.ask().verdict);
        TEST_ASSERT_TRUE(o.ask().refused_now);
        TEST_ASSERT_FALSE(o.ask().goal_valid);
    }
    o.goal(1.0F, 1.0F);
    TEST_ASSERT_TRUE(o.ask().goal_valid && !o.ask().refused_now);
    TEST_ASSERT_EQUAL(MissionState::exploring, o.loop->mission.state());
}

void a_goal_too_near_a_wall_is_moved_to_where_the_hull_fits() {
    Outside o;
    o.goal(4.85F, -1.0F);
    TEST_ASSERT_TRUE(o.ask().goal_valid);
    TEST_ASSERT_TRUE(o.ask().goal_x_m < 4.72F);
    TEST_ASSERT_TRUE(std::hypot(o.ask().goal_x_m - 4.85F, o.ask().goal_y_m + 1.0F) < ExternalPolicy::kSnapM + 0.1F);
}

// Flies on with that policy until the tour has taken over; then the flight must end well.
void ends_well_after_the_tour_took_over(Outside& o, const std::function<void()>& step) {
    for (int k = 0; k < 2000 && o.who() == PolicyKind::external; ++k) { step(); }
    TEST_ASSERT_EQUAL(PolicyKind::tour, o.who());
    for (int k = 0; k < 4000 && o.loop->mission.state() != MissionState::landed; ++k) { o.loop->step(); }
    TEST_ASSERT_EQUAL(MissionState::landed, o.loop->mission.state());
    TEST_ASSERT_TRUE(o.loop->least_clearance > 0.3);
}

void one_that_throws_in_every_step_is_given_up() {
    Outside o;
    ends_well_after_the_tour_took_over(o, [&o] { o.answer({0, 0, GoalSample::Kind::failed, 0.0F, 0.0F, 0.0F, 0.0F}); });
    TEST_ASSERT_EQUAL_UINT32(static_cast<std::uint32_t>(o.p.policy_patience), o.ask().refused);
    TEST_ASSERT_EQUAL_UINT32(0U, o.ask().timeouts);
}

void one_that_says_nothing_is_given_up() {
    Outside o;
    const double began_s = o.loop->time_s();
    double ended_s = 0.0;
    ends_well_after_the_tour_took_over(o, [&] {
        o.loop->step();
        ended_s = o.loop->time_s();
    });
    TEST_ASSERT_EQUAL_UINT32(static_cast<std::uint32_t>(o.p.policy_patience), o.ask().timeouts);
    TEST_ASSERT_DOUBLE_WITHIN(1.5, static_cast<double>(o.p.policy_timeout_s) * o.p.policy_patience, ended_s - began_s);
}

void one_that_never_leaves_its_place_is_given_up() {
    Outside o;
    ends_well_after_the_tour_took_over(o, [&o] { o.goal(static_cast<float>(o.loop->x), static_cast<float>(o.loop->y)); });
    TEST_ASSERT_EQUAL_UINT32(static_cast<std::uint32_t>(o.p.policy_patience), o.ask().timeouts);
}

void one_that_breaks_now_and_then_is_kept() {
    Outside o;
    int n = 0;
    for (int k = 0; k < 600; ++k) {
        if (++n % 3 == 0) {
            o.answer({0, 0, GoalSample::Kind::failed, 0.0F, 0.0F, 0.0F, 0.0F});
        } else {
            const bool away = (k / 150) % 2 == 0;
            o.goal(away ? 3.0F : -1.5F, away ? 1.0F : -1.0F);
        }
    }
    TEST_ASSERT_EQUAL(PolicyKind::external, o.who());
    TEST_ASSERT_EQUAL_UINT32(200U, o.ask().refused);
    TEST_ASSERT_TRUE(o.loop->length > 8.0);
}

/// Places at the edge of the unknown.
std::vector<std::pair<float, float>> edge(const OccupancyGrid& grid) {
    std::vector<std::pair<float, float>> out;
    for (CellId id = 0; id < grid.tile_count() * kTileArea; ++id) {
        if (!FrontierSearch::is_frontier(grid, id)) { continue; }
        const Cell c = grid.cell(id);
        out.emplace_back(grid.geometry().centre_x_m(c), grid.geometry().centre_y_m(c));
    }
    return out;
}

// A goal, another one, the first again, all with the same map: that is the oscillation that the count `back_and_forth` is for. With a square
// metre learned in between it is not.
void a_change_of_mind_and_back_is_counted_unless_something_was_learned() {
    const auto move_over = [](Outside& o, const float look_x_m, const float look_y_m) {
        for (int k = 0; k < 80; ++k) { o.goal(0.0F, 2.0F, look_x_m, look_y_m); }
    };
    // Two places at the edge, one behind each pillar, that stay there when the vehicle moves over and sees more of both shadows.
    Outside first{true};
    const auto before = edge(first.loop->grid);
    move_over(first, 2.0F, -3.0F);
    const auto after = edge(first.loop->grid);
    std::vector<std::pair<float, float>> stay;
    for (const auto& at : before) {
        if (std::find(after.begin(), after.end(), at) != after.end()) { stay.push_back(at); }
    }
    TEST_ASSERT_TRUE(stay.size() >= 2U);
    const auto far = *std::max_element(stay.begin(), stay.end(), [&](const auto& a, const auto& b) {
        return std::hypot(a.first - stay[0].first, a.second - stay[0].second) < std::hypot(b.first - stay[0].first, b.second - stay[0].second);
    });
    const std::pair<float, float> at[2] = {stay[0], far};
    TEST_ASSERT_TRUE(std::hypot(at[0].first - at[1].first, at[0].second - at[1].second) > 0.6F);

    Outside o{true};
    const OccupancyGrid& grid = o.loop->grid;
    const auto look_at = [&](const int k) { o.goal(0.0F, 0.0F, at[k].first, at[k].second); };
    const auto counted = [&] { return o.loop->mission.explorer().counters().back_and_forth; };
    const float known_m2 = grid.known_area_m2();
    look_at(0);
    look_at(1);
    TEST_ASSERT_EQUAL_UINT32(0U, counted());
    look_at(0);
    TEST_ASSERT_EQUAL_UINT32(1U, counted());
    look_at(0);
    TEST_ASSERT_EQUAL_UINT32(1U, counted());
    TEST_ASSERT_TRUE(grid.known_area_m2() - known_m2 < 1.0F);
    move_over(o, at[0].first, at[0].second);
    TEST_ASSERT_TRUE(grid.known_area_m2() - known_m2 > 1.0F);
    TEST_ASSERT_TRUE(FrontierSearch::is_frontier(grid, grid.find(at[0].first, at[0].second)));
    look_at(1);
    TEST_ASSERT_EQUAL_UINT32(1U, counted());
}

void the_end_of_the_exploration_is_its_to_say() {
    Outside o;
    o.answer({0, 0, GoalSample::Kind::finished, 0.0F, 0.0F, 0.0F, 0.0F});
    o.loop->step();
    TEST_ASSERT_EQUAL(MissionState::returning_home, o.loop->mission.state());
    TEST_ASSERT_EQUAL(StateReason::nothing_left, o.loop->mission.reason());
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(a_goal_is_flown_to_and_looked_from);
    RUN_TEST(every_kind_of_nonsense_is_refused_by_its_name);
    RUN_TEST(a_goal_too_near_a_wall_is_moved_to_where_the_hull_fits);
    RUN_TEST(one_that_throws_in_every_step_is_given_up);
    RUN_TEST(one_that_says_nothing_is_given_up);
    RUN_TEST(one_that_never_leaves_its_place_is_given_up);
    RUN_TEST(one_that_breaks_now_and_then_is_kept);
    RUN_TEST(a_change_of_mind_and_back_is_counted_unless_something_was_learned);
    RUN_TEST(the_end_of_the_exploration_is_its_to_say);
    return UNITY_END();
}
