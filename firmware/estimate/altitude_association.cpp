// Which level a range belongs to, and what happens when it belongs to none. docs/maths/altitude.md, "Association".
#include <algorithm>
#include <cmath>

#include "estimate/altitude_filter.hpp"

namespace noctule {
namespace {

using J = AltitudeJoint;

constexpr double kTentativePenalty = 4.0;  // in units of a squared sigma: a confirmed level is preferred
constexpr double kSameAgainBonus = 2.0;    // the level matched by the reading before is preferred
constexpr double kWatchMemory = 0.8;       // running mean of normalised innovations
// Standard deviation of that mean when the innovations are white with variance 1: sqrt((1 - m) / (1 + m)).
constexpr double kWatchSigma = 1.0 / 3.0;
constexpr double kWatchGate = 4.5;         // in sigmas of the running mean
constexpr double kDriftMax_m = 1.0;        // a disagreement larger than this is not explained by drift
constexpr double kMergeKnown = 1.0 / 3.0;  // two levels merge once their difference is known to this share of alt_merge_m

double square(const double v) { return v * v; }
std::size_t index_of(const RangeSide side) { return static_cast<std::size_t>(side); }
/// Sign of z in the observation: a higher vehicle sees a longer range down and a shorter one up.
double sign_of(const RangeSide side) { return side == RangeSide::down ? 1.0 : -1.0; }

}  // namespace

// Equation (3): drop = +-(z - vz age + mount - L) + scale error x drop.
AltitudeJoint::Row AltitudeFilter::row_for(const AltitudeReading& r, const std::size_t slot) const {
    const double s = sign_of(r.side);
    J::Row row;
    row.add(J::kZ, s);
    row.add(J::kVz, -s * r.age_s);
    row.add(J::kFirstLevel + slot, -s);
    // The scale error multiplies the predicted drop: with the measured one the noise would meet itself in the gain and
    // pull the scale error in one direction.
    const double expected_m = std::fabs(joint_.expect(row) + s * r.mount_m);
    row.add(r.side == RangeSide::down ? J::kScaleDown : J::kScaleUp, expected_m);
    return row;
}

double AltitudeFilter::observation_of(const AltitudeReading& r) { return r.drop_m - sign_of(r.side) * r.mount_m; }

AltitudeFilter::Match AltitudeFilter::best_match(const AltitudeReading& r) const {
    Match best;
    double best_score = 0.0;
    const double gate = square(static_cast<double>(p_.alt_gate_sigma));
    for (std::size_t i = 0; i < slots_.size(); ++i) {
        const Slot& slot = slots_[i];
        if (slot.level.facing != facing_of(r.side)) { continue; }
        // A floor of the building goes on behind a table; furniture ends.
        const float reach_m = p_.alt_level_radius_m + (slot.level.floor ? slot.level.extent_m() : 0.0F);
        if (r.place_known && slot.level.distance_m(r.x_m, r.y_m) > reach_m) { continue; }
        const J::Row row = row_for(r, i);
        const double S = joint_.variance(row) + r.variance_m2;
        const double d2 = square(observation_of(r) - joint_.expect(row)) / S;
        if (d2 > gate) { continue; }
        double score = d2 + std::log(S);  // minus twice the log likelihood, up to a constant
        if (!slot.confirmed) { score += kTentativePenalty; }
        if (static_cast<std::int32_t>(i) == last_[index_of(r.side)]) { score -= kSameAgainBonus; }
        if (best.slot < 0 || score < best_score) {
            best.slot = static_cast<std::int32_t>(i);
            best.d2 = d2;
            best_score = score;
        }
    }
    return best;
}

void AltitudeFilter::fuse(const AltitudeReading* const down, const AltitudeReading* const up) {
    if (down == nullptr || up == nullptr) {
        const AltitudeReading* const only = down != nullptr ? down : up;
        if (only != nullptr) { settle(*only, best_match(*only)); }
        return;
    }
    Match match_down = best_match(*down);
    Match match_up = best_match(*up);
    if (match_down.slot < 0 && match_up.slot < 0) {
        double error_m = 0.0;
        drift_votes_ = ranges_agree_on_drift(*down, *up, error_m) ? drift_votes_ + 1 : 0;
        if (drift_votes_ == 1) {  // it may be two echoes: the next pair decides, and this one founds nothing
            counters_.unmatched += 2;
            return;
        }
        if (drift_votes_ >= 2) {
            // Floor and ceiling cannot both have moved by the same amount: z is wrong.
            joint_.loosen(square(error_m), square(error_m));
            ++counters_.drifts;
            drift_votes_ = 0;
            match_down = best_match(*down);
            match_up = best_match(*up);
        }
    } else {
        drift_votes_ = 0;
    }
    // The surer match first; it sharpens z for the other.
    const bool down_first = match_up.slot < 0 || (match_down.slot >= 0 && match_down.d2 <= match_up.d2);
    if (down_first) {
        settle(*down, match_down);
        settle(*up, best_match(*up));
    } else {
        settle(*up, match_up);
        settle(*down, best_match(*down));
    }
}

bool AltitudeFilter::ranges_agree_on_drift(const AltitudeReading& down, const AltitudeReading& up, double& error_m) {
    const std::int32_t ground = last_[index_of(RangeSide::down)];
    const std::int32_t ceiling = last_[index_of(RangeSide::up)];
    if (ground < 0 || ceiling < 0) { return false; }
    const J::Row row_down = row_for(down, static_cast<std::size_t>(ground));
    const J::Row row_up = row_for(up, static_cast<std::size_t>(ceiling));
    const double e_down = observation_of(down) - joint_.expect(row_down);  // how much higher the floor says we are
    const double e_up = -(observation_of(up) - joint_.expect(row_up));     // how much higher the ceiling says we are
    // z cancels in the difference; what is left is the noise of both readings and of the two levels' difference.
    J::Row gap;
    gap.add(J::kFirstLevel + static_cast<std::size_t>(ceiling), 1.0);
    gap.add(J::kFirstLevel + static_cast<std::size_t>(ground), -1.0);
    gap.add(J::kScaleDown, down.drop_m);
    gap.add(J::kScaleUp, up.drop_m);
    const double S = joint_.variance(gap) + down.variance_m2 + up.variance_m2;
    error_m = 0.5 * (e_down + e_up);
    return square(e_down - e_up) <= square(static_cast<double>(p_.alt_gate_sigma)) * S && std::fabs(error_m) < kDriftMax_m;
}

void AltitudeFilter::settle(const AltitudeReading& r, const Match& match) {
    if (match.slot >= 0) {
        apply(r, static_cast<std::size_t>(match.slot));
    } else {
        found(r);
    }
}

void AltitudeFilter::apply(const AltitudeReading& r, const std::size_t i) {
    const std::size_t side = index_of(r.side);
    const J::Row row = row_for(r, i);
    const double S = joint_.variance(row) + r.variance_m2;
    const double nu = (observation_of(r) - joint_.expect(row)) / std::sqrt(S);

    // A step smaller than the gate shows in the mean of the innovations, equation (6).
    Watch& watch = watch_[side];
    if (watch.slot != static_cast<std::int32_t>(i)) { watch = Watch{static_cast<std::int32_t>(i), 0.0}; }
    watch.mean = kWatchMemory * watch.mean + (1.0 - kWatchMemory) * nu * sign_of(r.side);
    if (std::fabs(watch.mean) > kWatchGate * kWatchSigma && slots_[i].confirmed) {
        const Watch& other = watch_[1 - side];
        const bool other_agrees = other.slot >= 0 && other.mean * watch.mean > 0.0 &&
                                  std::fabs(other.mean) > 0.5 * std::fabs(watch.mean);
        const double error_var_m2 = square(watch.mean) * S;
        watch.mean = 0.0;
        if (other_agrees) {
            joint_.loosen(error_var_m2, error_var_m2);
            ++counters_.drifts;
        } else if (r.tilt_rad <= p_.alt_tilt_new_rad && make_room()) {
            // Another surface, a small step from this one. The readings that were taken for this one have pulled z.
            joint_.loosen(error_var_m2, 0.0);
            found(r);
            const std::size_t n = slots_.size() - 1;
            slots_[n].confirmed = true;
            last_[side] = static_cast<std::int32_t>(n);
            shown_[side] = last_[side];
            ++counters_.shifts;
            ++counters_.levels_confirmed;
            return;
        }
    }

    joint_.correct(row, observation_of(r), r.variance_m2);
    last_match_t_us_ = t_us_;
    ++counters_.matched;
    Slot& slot = slots_[i];
    ++slot.level.seen;
    slot.level.last_t_us = r.t_us;
    if (r.place_known) { slot.level.extend(r.x_m, r.y_m); }
    last_[side] = static_cast<std::int32_t>(i);
    if (!slot.confirmed && slot.level.seen >= p_.alt_confirm_hits &&
        readings_[side] - slot.reading_at_birth < 2U * static_cast<std::uint32_t>(slot.level.seen)) {
        slot.confirmed = true;
        ++counters_.levels_confirmed;
    }
    // Two readings in a row are enough to say what is there now; one may be an echo.
    if (slot.confirmed || slot.level.seen >= 2) { shown_[side] = static_cast<std::int32_t>(i); }
    if (!slot.confirmed) { return; }
    if (r.side == RangeSide::down) { classify_floor(i); }
    merge_around(i);
}

void AltitudeFilter::found(const AltitudeReading& r) {
    if (r.tilt_rad > p_.alt_tilt_new_rad || !make_room()) {
        ++counters_.unmatched;
        return;
    }
    const double s = sign_of(r.side);
    J::Row row;  // equation (5): L = z - vz age + mount -+ (1 - scale error) drop
    row.add(J::kZ, 1.0);
    row.add(J::kVz, -r.age_s);
    row.add(r.side == RangeSide::down ? J::kScaleDown : J::kScaleUp, s * r.drop_m);
    if (!joint_.add_level(row, r.mount_m - s * r.drop_m, r.variance_m2)) {
        ++counters_.unmatched;
        return;
    }
    Slot slot;
    slot.level.facing = facing_of(r.side);
    slot.level.x_min_m = r.x_m;
    slot.level.x_max_m = r.x_m;
    slot.level.y_min_m = r.y_m;
    slot.level.y_max_m = r.y_m;
    slot.level.seen = 1;
    slot.level.first_t_us = r.t_us;
    slot.level.last_t_us = r.t_us;
    slot.reading_at_birth = readings_[index_of(r.side)];
    (void)slots_.push(slot);
    ++counters_.founded;
}

bool AltitudeFilter::make_room() {
    if (!slots_.full()) { return true; }
    // The floor of the start, floors, and what the vehicle sees now stay. Tentative before confirmed, then the least seen.
    std::int32_t victim = -1;
    for (std::size_t i = 1; i < slots_.size(); ++i) {
        const std::int32_t n = static_cast<std::int32_t>(i);
        if (slots_[i].level.floor || n == last_[0] || n == last_[1] || n == shown_[0] || n == shown_[1]) { continue; }
        if (victim >= 0) {
            const Slot& v = slots_[static_cast<std::size_t>(victim)];
            if (slots_[i].confirmed && !v.confirmed) { continue; }
            if (slots_[i].confirmed == v.confirmed && slots_[i].level.seen >= v.level.seen) { continue; }
        }
        victim = n;
    }
    if (victim < 0) { return false; }
    remove_slot(static_cast<std::size_t>(victim));
    ++counters_.levels_evicted;
    return true;
}

void AltitudeFilter::remove_slot(const std::size_t i) {
    const std::int32_t gone = static_cast<std::int32_t>(i);
    const std::int32_t moved = static_cast<std::int32_t>(slots_.size() - 1);
    const auto renumber = [&](std::int32_t& index) {
        if (index == gone) {
            index = -1;
        } else if (index == moved) {
            index = gone;
        }
    };
    for (std::int32_t& index : last_) { renumber(index); }
    for (std::int32_t& index : shown_) { renumber(index); }
    for (Watch& watch : watch_) { renumber(watch.slot); }
    renumber(floor_slot_);
    joint_.remove_level_unordered(i);
    slots_.remove_unordered(i);
}

void AltitudeFilter::forget_tentative(const std::int64_t t_us) {
    const std::int64_t patience_us = static_cast<std::int64_t>(p_.alt_tentative_s * 1.0e6F);
    for (std::size_t i = slots_.size(); i-- > 1;) {
        if (slots_[i].confirmed || t_us - slots_[i].level.last_t_us <= patience_us) { continue; }
        remove_slot(i);
        ++counters_.levels_forgotten;
    }
}

void AltitudeFilter::merge_around(const std::size_t matched) {
    const double widest = static_cast<double>(p_.alt_merge_m);
    std::size_t keep = matched;
    for (std::size_t i = 0; i < slots_.size();) {
        Slot& a = slots_[keep];
        const Slot& b = slots_[i];
        const bool candidate = i != keep && b.confirmed && b.level.facing == a.level.facing &&
                               std::fabs(elevation(i) - elevation(keep)) < widest &&
                               b.level.distance_m(a.level.x_min_m, a.level.y_min_m) <=
                                   p_.alt_level_radius_m + a.level.extent_m();
        if (!candidate) {
            ++i;
            continue;
        }
        J::Row difference;
        difference.add(J::kFirstLevel + i, 1.0);
        difference.add(J::kFirstLevel + keep, -1.0);
        const double variance = joint_.variance(difference);
        const double gap = joint_.expect(difference);
        if (variance > square(kMergeKnown * widest) ||
            square(gap) > square(static_cast<double>(p_.alt_merge_gate_sigma)) *
                              (variance + 2.0 * square(static_cast<double>(p_.alt_floor_sigma_m)))) {
            ++i;
            continue;
        }
        // Equation (7): the two are one surface, as flat as a floor is; the joint Gaussian weighs them.
        joint_.correct(difference, 0.0, 2.0 * square(static_cast<double>(p_.alt_floor_sigma_m)) + 1.0e-10);
        const std::size_t stay = std::min(keep, i);  // the start's floor is entry 0 and always stays
        const std::size_t go = std::max(keep, i);
        Slot& s = slots_[stay];
        const Slot& g = slots_[go];
        s.level.extend(g.level.x_min_m, g.level.y_min_m);
        s.level.extend(g.level.x_max_m, g.level.y_max_m);
        s.level.seen += g.level.seen;
        s.level.first_t_us = std::min(s.level.first_t_us, g.level.first_t_us);
        s.level.last_t_us = std::max(s.level.last_t_us, g.level.last_t_us);
        s.level.floor = s.level.floor || g.level.floor;
        for (std::int32_t* index : {&last_[0], &last_[1], &shown_[0], &shown_[1], &floor_slot_}) {
            if (*index == static_cast<std::int32_t>(go)) { *index = static_cast<std::int32_t>(stay); }
        }
        remove_slot(go);
        ++counters_.levels_merged;
        keep = stay;
        i = 0;
    }
}

void AltitudeFilter::classify_floor(const std::size_t i) {
    Level& level = slots_[i].level;
    if (!level.floor && level.extent_m() >= p_.floor_extent_min_m) {
        const double z = elevation(i);
        double nearest = 1.0e9;
        for (std::size_t k = 0; k < slots_.size(); ++k) {
            if (slots_[k].level.floor) { nearest = std::min(nearest, std::fabs(elevation(k) - z)); }
        }
        const std::int32_t ceiling = shown_[index_of(RangeSide::up)];
        const double headroom = ceiling < 0 ? 1.0e9 : elevation(static_cast<std::size_t>(ceiling)) - z;
        const double step = static_cast<double>(p_.floor_step_min_m);
        // A storey above or below every known floor with room to stand in, or the same floor in another place.
        level.floor = (nearest >= step && headroom >= step) || nearest <= static_cast<double>(p_.alt_merge_m);
    }
    if (level.floor) { floor_slot_ = static_cast<std::int32_t>(i); }
}

}  // namespace noctule
