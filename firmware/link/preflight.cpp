#include "link/preflight.hpp"

#include <algorithm>
#include <cmath>

#include "link/parameter_server.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kAskAgain_us = 500000;
constexpr int kAskAtMost = 8;

bool fits(const PreflightRow& row, const float value) {
    if (row.bits != 0) { return std::isfinite(value) && value >= 0.0F && (static_cast<std::uint32_t>(value) & row.bits) == row.bits; }
    return value >= row.low && value <= row.high;
}

}  // namespace

void Preflight::begin(const std::span<const PreflightRow> rows, const bool cast_integers) {
    rows_ = rows.first(std::min(rows.size(), entries_.size()));
    cast_ = cast_integers;
    entries_ = {};
}

void Preflight::take(const mavlink_param_value_t& in) {
    for (std::size_t i = 0; i < rows_.size(); ++i) {
        if (parameter_id(in.param_id) != rows_[i].id) { continue; }
        Entry& entry = entries_[i];
        if (!value_from_wire(in.param_value, in.param_type, cast_, entry.value)) { continue; }
        entry.state = fits(rows_[i], entry.value) ? State::good : State::wrong;
    }
}

const PreflightRow* Preflight::ask(const std::int64_t now_us) {
    for (std::size_t i = 0; i < rows_.size(); ++i) {
        Entry& entry = entries_[i];
        if (entry.state != State::unknown || (entry.asked > 0 && now_us < entry.next_us)) { continue; }
        if (entry.asked == kAskAtMost) {
            entry.state = State::silent;
            continue;
        }
        ++entry.asked;
        entry.next_us = now_us + kAskAgain_us;
        return &rows_[i];
    }
    return nullptr;
}

bool Preflight::complete() const {
    return std::none_of(entries_.begin(), entries_.begin() + static_cast<std::ptrdiff_t>(rows_.size()), [](const Entry& e) { return e.state == State::unknown; });
}

std::size_t Preflight::wrong() const {
    return static_cast<std::size_t>(std::count_if(entries_.begin(), entries_.begin() + static_cast<std::ptrdiff_t>(rows_.size()),
                                                  [](const Entry& e) { return e.state == State::wrong || e.state == State::silent; }));
}

void Preflight::ask_silent_again() {
    for (Entry& entry : entries_) {
        if (entry.state == State::silent) { entry = {}; }
    }
}

}  // namespace noctule
