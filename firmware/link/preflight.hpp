/// Are the autopilot's parameters such that it can be flown indoors by our estimate? Reads them over the PARAM protocol before a start.
///
/// The wanted values stand in the flavour (px4.cpp, ardupilot.cpp). Each is asked for by name, again every half second, and a change on the
/// autopilot's side (it broadcasts PARAM_VALUE) is taken over. No heap, no clock.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "link/flavour.hpp"
#include "link/mavlink.hpp"

namespace noctule {

class Preflight {
public:
    enum class State : std::uint8_t { unknown, good, wrong, silent };  ///< silent: asked often enough, never answered

    /// Forgets everything and takes the wishes of a flavour; at most kMaxPreflightRows are looked at.
    void begin(std::span<const PreflightRow> rows, bool cast_integers);

    /// A PARAM_VALUE of the autopilot.
    void take(const mavlink_param_value_t& in);

    /// The next parameter to ask for at now_us; null: nothing to ask at present. Call it until null.
    [[nodiscard]] const PreflightRow* ask(std::int64_t now_us);

    /// Every row is answered, or given up.
    [[nodiscard]] bool complete() const;
    [[nodiscard]] std::size_t size() const { return rows_.size(); }
    [[nodiscard]] State state(std::size_t row) const { return entries_[row].state; }
    [[nodiscard]] const PreflightRow& row(std::size_t i) const { return rows_[i]; }
    [[nodiscard]] float value(std::size_t row) const { return entries_[row].value; }
    /// Rows that are wrong or silent.
    [[nodiscard]] std::size_t wrong() const;
    /// Rows that were given up are asked for again.
    void ask_silent_again();

private:
    struct Entry {
        State state = State::unknown;
        float value = 0.0F;
        int asked = 0;
        std::int64_t next_us = 0;
    };

    std::span<const PreflightRow> rows_;
    std::array<Entry, kMaxPreflightRows> entries_{};
    bool cast_ = false;
};

}  // namespace noctule
