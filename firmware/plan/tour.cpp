#include "plan/tour.hpp"

#include <algorithm>

namespace noctule {

namespace {

constexpr float kLeastGainM = 0.01F;
constexpr std::size_t kPolished = 10;    ///< stops from the beginning on that are ordered by the weighted length
constexpr float kMostAside = 0.5F;       ///< of all that is left: what comes last is toured as well
constexpr std::size_t kLongestRun = 3;   ///< stops that Or-opt moves at once

}  // namespace

void Tour::begin(const std::size_t stops) {
    stops_ = std::min(stops, kMaxStops - 1U);
    gain_.fill(0.0F);
    leaves_.fill(0.0F);
    aside_.fill(false);
    hurry_ = 0.0F;
    for (auto& row : distance_) { row.fill(0.0F); }
}

float Tour::length_m(const Order& order) const {
    float all_m2 = 0.0F;
    for (const std::uint8_t s : order) { all_m2 += gain_[s]; }
    float left_m2 = all_m2;
    float sum = 0.0F;
    for (std::size_t k = 0; k < order.size(); ++k) {
        sum += step(order, k) * (1.0F + hurry_ * left_m2 / std::max(all_m2, 1e-3F));
        left_m2 -= gain_[order[k]];
    }
    return sum;
}

void Tour::set_aside(Order& order, float m2, const std::uint8_t kept) {
    float all_m2 = 0.0F;
    for (const std::uint8_t s : order) { all_m2 += leaves_[s]; }
    m2 = std::min(m2, kMostAside * all_m2);
    for (;;) {
        std::size_t worst = order.size();
        float worst_m_m2 = 0.0F;
        for (std::size_t k = 0; k < order.size(); ++k) {
            const std::uint8_t s = order[k];
            if (s == kept || leaves_[s] <= 0.0F || leaves_[s] > m2) { continue; }
            float saved_m = step(order, k);
            if (k + 1U < order.size()) { saved_m += step(order, k + 1U) - distance_[k == 0 ? 0 : order[k - 1U]][order[k + 1U]]; }
            if (saved_m > worst_m_m2 * leaves_[s]) {
                worst_m_m2 = saved_m / leaves_[s];
                worst = k;
            }
        }
        if (worst == order.size()) { return; }
        m2 -= leaves_[order[worst]];
        aside_[order[worst]] = true;
        std::rotate(order.begin() + worst, order.begin() + worst + 1U, order.end());
        order.keep_front(order.size() - 1U);
    }
}

void Tour::insert_missing(Order& order, const std::size_t fixed) const {
    std::array<bool, kMaxStops> in = aside_;
    for (const std::uint8_t stop : order) { in[stop] = true; }
    for (;;) {
        float best = 1e30F;
        std::size_t best_at = 0;
        std::uint8_t best_stop = 0;
        for (std::size_t s = 1; s <= stops_; ++s) {
            if (in[s]) { continue; }
            for (std::size_t at = fixed; at <= order.size(); ++at) {
                const std::size_t before = at == 0 ? 0 : order[at - 1U];
                float more = distance_[before][s];
                if (at < order.size()) { more += distance_[s][order[at]] - distance_[before][order[at]]; }
                if (more < best) {
                    best = more;
                    best_at = at;
                    best_stop = static_cast<std::uint8_t>(s);
                }
            }
        }
        if (best_stop == 0 || !order.push(best_stop)) { return; }
        in[best_stop] = true;
        std::rotate(order.begin() + best_at, order.end() - 1, order.end());
    }
}

bool Tour::reverse_once(Order& order, const std::size_t fixed) const {
    const std::size_t n = order.size();
    for (std::size_t i = fixed; i + 1U < n; ++i) {
        const std::size_t before = i == 0 ? 0 : order[i - 1U];
        for (std::size_t j = i + 1U; j < n; ++j) {
            float gain = distance_[before][order[i]] - distance_[before][order[j]];
            if (j + 1U < n) { gain += distance_[order[j]][order[j + 1U]] - distance_[order[i]][order[j + 1U]]; }
            if (gain > kLeastGainM) {
                std::reverse(order.begin() + i, order.begin() + j + 1U);
                return true;
            }
        }
    }
    return false;
}

bool Tour::move_once(Order& order, const std::size_t fixed) const {
    const std::size_t n = order.size();
    const auto at = [&order](const std::size_t k) { return k == 0 ? std::size_t{0} : std::size_t{order[k - 1U]}; };  // 1-based, 0 is the start
    for (std::size_t run = 1; run <= kLongestRun; ++run) {
        for (std::size_t i = fixed + 1U; i + run <= n + 1U; ++i) {     // stops i to j of the tour
            const std::size_t j = i + run - 1U;
            const std::size_t a = at(i);
            const std::size_t b = at(j);
            float out = distance_[at(i - 1U)][a];
            if (j < n) { out += distance_[b][at(j + 1U)] - distance_[at(i - 1U)][at(j + 1U)]; }
            if (j == n && i == 1U) { continue; }
            for (std::size_t k = fixed; k <= n; ++k) {                 // put in after stop k
                if (k + 1U >= i && k <= j) { continue; }
                for (int turned = 0; turned < (run > 1U ? 2 : 1); ++turned) {
                    const std::size_t head = turned != 0 ? b : a;
                    const std::size_t tail = turned != 0 ? a : b;
                    float in = distance_[at(k)][head];
                    if (k < n) { in += distance_[tail][at(k + 1U)] - distance_[at(k)][at(k + 1U)]; }
                    if (out - in <= kLeastGainM) { continue; }
                    if (turned != 0) { std::reverse(order.begin() + (i - 1U), order.begin() + j); }
                    if (k < i) {
                        std::rotate(order.begin() + k, order.begin() + (i - 1U), order.begin() + j);
                    } else {
                        std::rotate(order.begin() + (i - 1U), order.begin() + j, order.begin() + k);
                    }
                    return true;
                }
            }
        }
    }
    return false;
}

float Tour::improve(Order& order, const std::uint8_t first) const {
    std::size_t fixed = 0;
    if (first != kAny) {
        for (std::size_t k = 0; k < order.size(); ++k) {
            if (order[k] == first) {
                std::rotate(order.begin(), order.begin() + k, order.begin() + k + 1U);
                fixed = 1;
                break;
            }
        }
        if (fixed == 0) {
            static_cast<void>(order.push(first));
            std::rotate(order.begin(), order.end() - 1, order.end());
            fixed = 1;
        }
    }
    insert_missing(order, fixed);
    for (int round = 0; round < kRounds; ++round) {
        if (reverse_once(order, fixed)) { continue; }
        if (!move_once(order, fixed)) { break; }
    }
    polish(order, fixed);
    return length_m(order);
}

// The first stops once more, by the weighted length: turned round or moved as long as that helps.
void Tour::polish(Order& order, const std::size_t fixed) const {
    if (hurry_ == 0.0F) { return; }
    const std::size_t n = std::min(order.size(), kPolished);
    float best = length_m(order);
    const auto better = [&](const Order& tried) {
        const float length = length_m(tried);
        if (length > best - kLeastGainM) { return false; }
        best = length;
        order = tried;
        return true;
    };
    const auto pass = [&] {
        for (std::size_t i = fixed; i < n; ++i) {
            for (std::size_t j = i + 1U; j < n; ++j) {
                Order tried = order;
                std::reverse(tried.begin() + i, tried.begin() + j + 1U);
                if (better(tried)) { return true; }
            }
        }
        for (std::size_t run = 1; run <= kLongestRun; ++run) {
            for (std::size_t i = fixed; i + run <= n; ++i) {
                for (std::size_t k = fixed; k + run <= n; ++k) {
                    if (k == i) { continue; }
                    for (int turned = 0; turned < (run > 1U ? 2 : 1); ++turned) {
                        Order tried = order;
                        if (turned != 0) { std::reverse(tried.begin() + i, tried.begin() + i + run); }
                        if (k < i) {
                            std::rotate(tried.begin() + k, tried.begin() + i, tried.begin() + i + run);
                        } else {
                            std::rotate(tried.begin() + i, tried.begin() + i + run, tried.begin() + k + run);
                        }
                        if (better(tried)) { return true; }
                    }
                }
            }
        }
        return false;
    };
    for (int round = 0; round < kRounds && pass(); ++round) {}
}

}  // namespace noctule
