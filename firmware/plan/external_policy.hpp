/// A policy outside: its answers come in through a mailbox, are judged, and are flown like any other goal.
///
/// docs/extending.md, "A policy". What is asked is a value (ask()) that the caller publishes; what was answered is a value
/// (post()). An answer that is no number, lies where nothing is known, in a wall, or where the hull does not fit is refused
/// and counted; so is silence. Too much of it in a row, and the policy is given up: the explorer goes on with its own.
/// Frame Map, SI. No heap, no clock: times are those of the steps.
#pragma once

#include <cstdint>

#include "params.gen.hpp"
#include "plan/policy.hpp"
#include "sense/samples.hpp"

namespace noctule {

/// What was made of an answer. Values travel in policy_ask_t.verdict.
enum class Verdict : std::int32_t {
    good = 0,
    failed = 1,        ///< the policy said itself that it broke
    no_number = 2,     ///< not finite, or a kind that does not exist
    nothing_known = 3, ///< nothing is known about that place
    in_wall = 4,
    no_room = 5,       ///< free, but the hull fits nowhere within kSnapM
    wrong_ask = 6,     ///< answers a request that was not made
};

/// What the policy outside is asked in a step.
struct PolicyAsk {
    std::int64_t t_us = -1;        ///< of the step; -1: nothing was ever asked
    std::int32_t number = 0;
    std::int32_t exploration = 0;
    Pose2<Map, Body> pose;
    Pose2<Map, Body> from;
    Pose2<Map, Body> home;
    std::int32_t budget_cells = 0;
    GoalFate fate = GoalFate::under_way;
    bool refused_now = false;      ///< the newest answer was refused
    bool goal_valid = false;
    float goal_x_m = 0.0F;
    float goal_y_m = 0.0F;
    std::uint32_t refused = 0;
    Verdict verdict = Verdict::good;   ///< of the newest refused one
    std::uint32_t timeouts = 0;
};

class ExternalPolicy final : public Policy {
public:
    static constexpr float kSnapM = 0.5F;   ///< a goal is moved so far to where the hull fits

    explicit ExternalPolicy(const Parameters& parameters) : p_(parameters) {}

    /// An answer arrived; of several before a step the newest counts.
    void post(const GoalSample& answer) {
        box_ = answer;
        full_ = true;
    }
    void begin(const Pose2<Map, Body>& home) override;
    const PolicyAnswer& step(const MapView& map, const Pose2<Map, Body>& pose, std::int32_t budget_cells) override;

    /// The request of the newest step that asked.
    [[nodiscard]] const PolicyAsk& ask() const { return ask_; }
    /// True: it was refused, silent or led nowhere policy_patience times in a row, and is not asked any more.
    [[nodiscard]] bool given_up() const { return given_up_; }

private:
    [[nodiscard]] Verdict judge(const MapView& map);
    [[nodiscard]] Verdict take_goal(const MapView& map);

    const Parameters& p_;
    GoalSample box_;
    bool full_ = false;
    PolicyAnswer answer_;
    PolicyAsk ask_;
    std::int32_t answered_ = 0;       ///< newest request that has an answer
    std::int32_t known_from_ = 1;     ///< answers to earlier requests know nothing of what happened since
    std::int64_t useful_us_ = -1;     ///< when it last had the vehicle under way
    std::int64_t heard_us_ = -1;      ///< when it last answered
    std::int32_t refused_in_a_row_ = 0;
    std::int32_t idle_in_a_row_ = 0;  ///< timeouts since a goal led away from the vehicle
    std::int32_t vain_in_a_row_ = 0;  ///< goals not reached since one was
    bool given_up_ = false;
};

}  // namespace noctule
