#include "sense/walls.hpp"

#include <algorithm>
#include <cmath>

namespace noctule {

namespace {

/// Weighted moments of points about their mean.
struct Moments {
    double weight = 0.0;
    double mean_x = 0.0;
    double mean_y = 0.0;
    double xx = 0.0;
    double xy = 0.0;
    double yy = 0.0;
};

constexpr std::int32_t kRansacTrials = 60;
constexpr std::int32_t kRansacPairSpan = 60;   // the second point of a pair is at most so many hits away
constexpr std::int32_t kBridgedBeams = 6;      // beams that may be missing inside one cluster
constexpr float kJumpIncidence_rad = 0.12F;    // flattest incidence at which neighbours still count as one surface
constexpr float kRoundOff = 100.0F;            // wall_curvature_sigma that switches the search for round walls off
constexpr float kRoundTurnMin_rad = 0.03F;
constexpr float kRoundTurnMax_rad = 0.6F;      // 34 degrees; bay windows turn by 45
constexpr float kRoundTouch_m = 0.4F;
constexpr double kMergeChi2 = 14.0;            // chi-square of two degrees of freedom, one in a thousand
constexpr double kRoughness = 2.0;             // mean squared residual over variance
// Of what doubt about roll and pitch does to a wall: the part that fades from sweep to sweep. The rest is told with the pose.
constexpr float kTiltShare = 0.5F;

}  // namespace

void WallExtractor::collect_hits(const LevelScan& scan) {
    hit_count_ = 0;
    sums_[0] = {};
    for (std::size_t i = 0; i < scan.points.size(); ++i) {
        const ScanPoint& point = scan.points[i];
        if (!point.hit) { continue; }
        const auto n = static_cast<std::size_t>(hit_count_);
        hits_[n] = static_cast<std::int16_t>(i);
        x_m_[n] = point.x_m;
        y_m_[n] = point.y_m;
        const double x = static_cast<double>(point.x_m);
        const double y = static_cast<double>(point.y_m);
        sums_[n + 1] = {sums_[n][0] + x, sums_[n][1] + y, sums_[n][2] + x * x, sums_[n][3] + x * y, sums_[n][4] + y * y};
        ++hit_count_;
    }
}

const WallObservations& WallExtractor::extract(const LevelScan& scan) {
    noise_m_ = scan.range_noise_m > 0.0F ? scan.range_noise_m : parameters_.laser_range_noise_m;
    walls_.clear();
    wall_of_point_.fill(-1);
    collect_hits(scan);
    if (parameters_.wall_method == 0) {
        split_and_merge(scan);
    } else {
        ransac(scan);
    }
    sort_walls();
    return walls_;
}

WallExtractor::Line WallExtractor::line_through(const Piece piece) const {
    const auto& a = sums_[static_cast<std::size_t>(piece.first)];
    const auto& b = sums_[static_cast<std::size_t>(piece.last) + 1];
    const double n = static_cast<double>(piece.last - piece.first + 1);
    const double mx = (b[0] - a[0]) / n;
    const double my = (b[1] - a[1]) / n;
    const double xx = (b[2] - a[2]) - n * mx * mx;
    const double xy = (b[3] - a[3]) - n * mx * my;
    const double yy = (b[4] - a[4]) - n * my * my;
    const Eigen2<double> eigen = eigen_symmetric(xx, xy, yy);
    Line line;
    line.normal_x = -std::sin(eigen.direction_rad);
    line.normal_y = std::cos(eigen.direction_rad);
    line.offset_m = line.normal_x * mx + line.normal_y * my;
    line.squares_m2 = std::max(0.0, eigen.small);
    return line;
}

void WallExtractor::split_and_merge(const LevelScan& scan) {
    // Clusters: a jump between neighbours that no surface seen at a fair angle explains (docs/maths/walls.md, equation 4).
    pieces_.clear();
    std::int32_t first = 0;
    for (std::int32_t i = 1; i <= hit_count_; ++i) {
        bool cut = i == hit_count_;
        if (!cut) {
            const auto a = static_cast<std::size_t>(i - 1);
            const auto b = static_cast<std::size_t>(i);
            const ScanPoint& point_a = scan.points[static_cast<std::size_t>(hits_[a])];
            const ScanPoint& point_b = scan.points[static_cast<std::size_t>(hits_[b])];
            const std::int32_t beams = point_b.beam - point_a.beam;
            const float turn_rad = static_cast<float>(beams) * scan.bearing_increment_rad;
            const float near_m = std::min(point_a.range_m, point_b.range_m);
            const float reach_m = near_m * turn_rad / std::max(0.02F, kJumpIncidence_rad - turn_rad) + 4.0F * noise_m_;
            cut = beams > kBridgedBeams || std::hypot(x_m_[b] - x_m_[a], y_m_[b] - y_m_[a]) > reach_m;
        }
        if (cut) {
            if (i - first >= parameters_.wall_points_min) { split({first, i - 1}); }
            first = i;
        }
    }
    merge();
    mark_round_runs();
    for (std::size_t k = 0; k < pieces_.size(); ++k) {
        const Piece piece = pieces_[k];
        if (round_[k]) {
            if (piece.last - piece.first + 1 >= parameters_.wall_points_min) { ++counters_.round_refused; }
            continue;
        }
        member_count_ = 0;
        for (std::int32_t i = piece.first; i <= piece.last; ++i) {
            member_[static_cast<std::size_t>(member_count_++)] = static_cast<std::int16_t>(i);
        }
        fit_and_add(scan);
    }
}

void WallExtractor::split(const Piece cluster) {
    open_.clear();
    static_cast<void>(open_.push(cluster));
    // Each turn takes one piece and gives two smaller ones or a finished one: at most 2 n turns.
    const double limit_m = static_cast<double>((parameters_.wall_inlier_sigma + 1.0F) * noise_m_);
    while (!open_.empty()) {
        const Piece piece = open_.back();
        open_.remove_unordered(open_.size() - 1);
        if (piece.last - piece.first + 1 < std::max<std::int32_t>(3, parameters_.wall_points_min / 2)) { continue; }
        const Line line = line_through(piece);
        double worst_m = 0.0;
        for (std::int32_t i = piece.first; i <= piece.last; ++i) {
            const auto k = static_cast<std::size_t>(i);
            const double e = std::abs(line.normal_x * static_cast<double>(x_m_[k]) + line.normal_y * static_cast<double>(y_m_[k]) - line.offset_m);
            worst_m = std::max(worst_m, e);
        }
        if (worst_m <= limit_m) {
            static_cast<void>(pieces_.push(piece));
            continue;
        }
        // Split at the point farthest from the chord.
        const auto a = static_cast<std::size_t>(piece.first);
        const auto b = static_cast<std::size_t>(piece.last);
        const float chord_x = x_m_[b] - x_m_[a];
        const float chord_y = y_m_[b] - y_m_[a];
        float far = -1.0F;
        std::int32_t at = piece.first + 1;
        for (std::int32_t i = piece.first + 1; i < piece.last; ++i) {
            const auto k = static_cast<std::size_t>(i);
            const float e = std::abs(chord_x * (y_m_[k] - y_m_[a]) - chord_y * (x_m_[k] - x_m_[a]));
            if (e > far) {
                far = e;
                at = i;
            }
        }
        // The later half first on the stack, so that pieces come out in the order of the beams.
        static_cast<void>(open_.push({at, piece.last}));
        static_cast<void>(open_.push({piece.first, at - 1}));
    }
}

void WallExtractor::merge() {
    // Neighbours whose joint line is not worse than the two lines, by a chi-square test (docs/maths/walls.md, equation 5).
    const double noise_m = static_cast<double>(noise_m_);
    const double variance_m2 = noise_m * noise_m;
    std::size_t kept = 0;
    for (std::size_t i = 1; i < pieces_.size(); ++i) {
        Piece& last = pieces_[kept];
        const Piece next = pieces_[i];
        const auto a = static_cast<std::size_t>(last.last);
        const auto b = static_cast<std::size_t>(next.first);
        const bool touch = next.first - last.last <= 4 && std::hypot(x_m_[b] - x_m_[a], y_m_[b] - y_m_[a]) < 0.3F;
        const Piece joint{last.first, next.last};
        const double rise_m2 = line_through(joint).squares_m2 - line_through(last).squares_m2 - line_through(next).squares_m2;
        // Points left out between the two may be outliers: allow for them by not counting more than the gap holds.
        const double allowed_m2 = variance_m2 * (kMergeChi2 + 9.0 * static_cast<double>(next.first - last.last - 1));
        if (touch && rise_m2 <= allowed_m2) {
            last.last = next.last;
        } else {
            pieces_[++kept] = next;
        }
    }
    while (pieces_.size() > kept + 1) { pieces_.remove_unordered(pieces_.size() - 1); }
}

void WallExtractor::mark_round_runs() {
    // A curve falls into pieces that each turn a little the same way: no corner of a room does (docs/maths/walls.md#round).
    round_.fill(false);
    if (parameters_.wall_curvature_sigma >= kRoundOff) { return; }
    float turn_before = 0.0F;
    for (std::size_t k = 0; k + 1 < pieces_.size(); ++k) {
        const Piece a = pieces_[k];
        const Piece b = pieces_[k + 1];
        const auto end = static_cast<std::size_t>(a.last);
        const auto start = static_cast<std::size_t>(b.first);
        float turn = 0.0F;
        if (b.first - a.last <= parameters_.wall_points_min && std::hypot(x_m_[start] - x_m_[end], y_m_[start] - y_m_[end]) < kRoundTouch_m) {
            const auto middle_a = static_cast<std::size_t>((a.first + a.last) / 2);
            const auto middle_b = static_cast<std::size_t>((b.first + b.last) / 2);
            const Line line_a = line_through(a);
            const Line line_b = line_through(b);
            // Tangents in the order of the beams.
            double ax = -line_a.normal_y;
            double ay = line_a.normal_x;
            double bx = -line_b.normal_y;
            double by = line_b.normal_x;
            const double step_x = static_cast<double>(x_m_[middle_b] - x_m_[middle_a]);
            const double step_y = static_cast<double>(y_m_[middle_b] - y_m_[middle_a]);
            if (ax * step_x + ay * step_y < 0.0) { ax = -ax, ay = -ay; }
            if (bx * step_x + by * step_y < 0.0) { bx = -bx, by = -by; }
            turn = static_cast<float>(std::atan2(ax * by - ay * bx, ax * bx + ay * by));
        }
        const bool gentle = std::abs(turn) > kRoundTurnMin_rad && std::abs(turn) < kRoundTurnMax_rad;
        if (gentle && turn * turn_before > 0.0F) {
            round_[k - 1] = true;
            round_[k] = true;
            round_[k + 1] = true;
        }
        turn_before = gentle ? turn : 0.0F;
    }
}

void WallExtractor::fit_and_add(const LevelScan& scan) {
    const float sigma_range = noise_m_;
    const float sigma_bearing = parameters_.laser_bearing_noise_rad;
    const float inlier = parameters_.wall_inlier_sigma;
    std::int32_t used = member_count_;
    if (used < parameters_.wall_points_min) { return; }

    // First guess without weights, then twice with weights and without the points that do not fit.
    float normal_x = 0.0F;
    float normal_y = 0.0F;
    float offset_m = 0.0F;
    Moments m;
    double chi2 = 0.0;
    const auto variance_of = [&](const ScanPoint& point) {
        // Equation 2: the share of range and bearing noise that acts across the wall.
        const float dx = point.x_m - point.origin_x_m;
        const float dy = point.y_m - point.origin_y_m;
        const float across = (dx * normal_x + dy * normal_y) / std::max(1e-3F, point.range_m);
        const float along = (dy * normal_x - dx * normal_y);
        return std::max(sigma_range * sigma_range * across * across + sigma_bearing * sigma_bearing * along * along,
                        0.04F * sigma_range * sigma_range);
    };
    for (int round = 0; round < 3; ++round) {
        m = Moments{};
        used = 0;
        double x0 = static_cast<double>(x_m_[static_cast<std::size_t>(member_[0])]);
        double y0 = static_cast<double>(y_m_[static_cast<std::size_t>(member_[0])]);
        for (std::int32_t i = 0; i < member_count_; ++i) {
            const auto k = static_cast<std::size_t>(member_[static_cast<std::size_t>(i)]);
            double weight = 1.0;
            if (round > 0) {
                const float e = normal_x * x_m_[k] + normal_y * y_m_[k] - offset_m;
                const float variance = variance_of(scan.points[static_cast<std::size_t>(hits_[k])]);
                if (e * e > inlier * inlier * variance) { continue; }
                weight = 1.0 / static_cast<double>(variance);
            }
            const double x = static_cast<double>(x_m_[k]) - x0;
            const double y = static_cast<double>(y_m_[k]) - y0;
            m.weight += weight;
            m.mean_x += weight * x;
            m.mean_y += weight * y;
            m.xx += weight * x * x;
            m.xy += weight * x * y;
            m.yy += weight * y * y;
            ++used;
        }
        if (used < parameters_.wall_points_min) { return; }
        m.mean_x /= m.weight;
        m.mean_y /= m.weight;
        m.xx -= m.weight * m.mean_x * m.mean_x;
        m.xy -= m.weight * m.mean_x * m.mean_y;
        m.yy -= m.weight * m.mean_y * m.mean_y;
        m.mean_x += x0;
        m.mean_y += y0;
        const Eigen2<double> eigen = eigen_symmetric(m.xx, m.xy, m.yy);
        double nx = -std::sin(eigen.direction_rad);
        double ny = std::cos(eigen.direction_rad);
        double rho = nx * m.mean_x + ny * m.mean_y;
        if (rho < 0.0) {
            nx = -nx;
            ny = -ny;
            rho = -rho;
        }
        normal_x = static_cast<float>(nx);
        normal_y = static_cast<float>(ny);
        offset_m = static_cast<float>(rho);
        chi2 = eigen.small;
    }

    // Ends, bend and scatter of what is left.
    const double lever = -static_cast<double>(normal_y) * m.mean_x + static_cast<double>(normal_x) * m.mean_y;
    float from_m = 1e9F;
    float to_m = -1e9F;
    double u2 = 0.0;
    double u3 = 0.0;
    double u4 = 0.0;
    double eu2 = 0.0;
    for (std::int32_t i = 0; i < member_count_; ++i) {
        const auto k = static_cast<std::size_t>(member_[static_cast<std::size_t>(i)]);
        const float e = normal_x * x_m_[k] + normal_y * y_m_[k] - offset_m;
        const float variance = variance_of(scan.points[static_cast<std::size_t>(hits_[k])]);
        if (e * e > inlier * inlier * variance) {
            member_[static_cast<std::size_t>(i)] = static_cast<std::int16_t>(-1 - member_[static_cast<std::size_t>(i)]);
            continue;
        }
        const float along_m = -normal_y * x_m_[k] + normal_x * y_m_[k];
        from_m = std::min(from_m, along_m);
        to_m = std::max(to_m, along_m);
        const double w = 1.0 / static_cast<double>(variance);
        const double u = static_cast<double>(along_m) - lever;
        u2 += w * u * u;
        u3 += w * u * u * u;
        u4 += w * u * u * u * u;
        eu2 += w * static_cast<double>(e) * u * u;
    }
    if (!(to_m - from_m >= parameters_.wall_length_min_m)) { return; }
    if (chi2 > kRoughness * static_cast<double>(used)) {
        ++counters_.rough_refused;
        return;
    }
    // Equation 6: e = c (u^2 - mean - slope u) by least squares; its variance is 1 / information.
    const double mean_u2 = u2 / m.weight;
    const double slope = u3 / u2;
    const double information = u4 - m.weight * mean_u2 * mean_u2 - slope * u3;
    if (information > 0.0) {
        const double bend = eu2 / information;
        const double half_m = 0.5 * static_cast<double>(to_m - from_m);
        const bool certain = std::abs(bend) * std::sqrt(information) > static_cast<double>(parameters_.wall_curvature_sigma);
        if (certain && std::abs(bend) * half_m * half_m > static_cast<double>(sigma_range)) {
            ++counters_.round_refused;
            return;
        }
    }

    WallObservation wall;
    wall.rho_m = offset_m;
    wall.alpha_rad = std::atan2(normal_y, normal_x);
    wall.lever_m = static_cast<float>(lever);
    wall.from_m = from_m;
    wall.to_m = to_m;
    wall.points = used;
    // Equation 3: at the middle of the points offset and direction are independent; the shear brings them to the foot.
    // The floors are told for the told noise: what a fit leaves unsaid (points left out, ends) grows with it.
    const float rough = noise_m_ / parameters_.laser_range_noise_m;
    const float floor_m = rough * parameters_.wall_floor_m;
    const float floor_rad = rough * parameters_.wall_floor_rad;
    // Equation 9: what an error of roll and pitch does to a wall that a leaning sweep meets above or below the laser.
    const float middle_z_m = scan.rise_forward * static_cast<float>(m.mean_x) + scan.rise_left * static_cast<float>(m.mean_y);
    const float rise = scan.rise_left * normal_x - scan.rise_forward * normal_y;
    const float tilt_m = kTiltShare * parameters_.tilt_noise_rad * middle_z_m;
    const float tilt_rad = kTiltShare * parameters_.tilt_noise_rad * rise;
    const auto offset_var = static_cast<float>(1.0 / m.weight) + floor_m * floor_m + tilt_m * tilt_m;
    const auto direction_var = static_cast<float>(1.0 / u2) + floor_rad * floor_rad + tilt_rad * tilt_rad;
    wall.covariance = LineCovariance{offset_var, 0.0F, direction_var}.sheared(wall.lever_m);

    std::size_t index = walls_.size();
    if (walls_.full()) {
        ++counters_.too_many;
        index = 0;
        for (std::size_t i = 1; i < walls_.size(); ++i) {
            if (walls_[i].points < walls_[index].points) { index = i; }
        }
        if (walls_[index].points >= wall.points) { return; }
        for (std::int16_t& owner : wall_of_point_) {
            if (owner == static_cast<std::int16_t>(index)) { owner = -1; }
        }
        walls_[index] = wall;
    } else {
        static_cast<void>(walls_.push(wall));
    }
    for (std::int32_t i = 0; i < member_count_; ++i) {
        const std::int16_t k = member_[static_cast<std::size_t>(i)];
        if (k < 0) { continue; }
        wall_of_point_[static_cast<std::size_t>(hits_[static_cast<std::size_t>(k)])] = static_cast<std::int16_t>(index);
        taken_[static_cast<std::size_t>(k)] = true;
    }
}

void WallExtractor::ransac(const LevelScan& scan) {
    taken_.fill(false);
    const float reach_m = parameters_.wall_inlier_sigma * noise_m_;
    while (!walls_.full()) {
        std::int32_t best_count = 0;
        std::array<float, 3> best{};
        for (std::int32_t trial = 0; trial < kRansacTrials; ++trial) {
            if (hit_count_ < parameters_.wall_points_min) { return; }
            const auto a = static_cast<std::int32_t>(random_.below(static_cast<std::uint32_t>(hit_count_)));
            const std::int32_t b = a + 5 + static_cast<std::int32_t>(random_.below(kRansacPairSpan));
            if (b >= hit_count_ || taken_[static_cast<std::size_t>(a)] || taken_[static_cast<std::size_t>(b)]) { continue; }
            const float dx = x_m_[static_cast<std::size_t>(b)] - x_m_[static_cast<std::size_t>(a)];
            const float dy = y_m_[static_cast<std::size_t>(b)] - y_m_[static_cast<std::size_t>(a)];
            const float length_m = std::hypot(dx, dy);
            if (length_m < 5.0F * reach_m) { continue; }
            const float nx = -dy / length_m;
            const float ny = dx / length_m;
            const float offset_m = nx * x_m_[static_cast<std::size_t>(a)] + ny * y_m_[static_cast<std::size_t>(a)];
            std::int32_t count = 0;
            for (std::size_t k = 0; k < static_cast<std::size_t>(hit_count_); ++k) {
                if (!taken_[k] && std::abs(nx * x_m_[k] + ny * y_m_[k] - offset_m) < reach_m) { ++count; }
            }
            if (count > best_count) {
                best_count = count;
                best = {nx, ny, offset_m};
            }
        }
        if (best_count < parameters_.wall_points_min) { return; }
        member_count_ = 0;
        for (std::size_t k = 0; k < static_cast<std::size_t>(hit_count_); ++k) {
            if (!taken_[k] && std::abs(best[0] * x_m_[k] + best[1] * y_m_[k] - best[2]) < reach_m) {
                member_[static_cast<std::size_t>(member_count_++)] = static_cast<std::int16_t>(k);
            }
        }
        const std::size_t before = walls_.size();
        fit_and_add(scan);
        if (walls_.size() == before) {
            // The piece failed a test: it must not be proposed again.
            for (std::int32_t i = 0; i < member_count_; ++i) {
                const std::int16_t k = member_[static_cast<std::size_t>(i)];
                taken_[static_cast<std::size_t>(k < 0 ? -1 - k : k)] = true;
            }
        }
    }
}

void WallExtractor::sort_walls() {
    std::array<std::int16_t, kMaxWallsPerScan> order{};
    std::array<std::int16_t, kMaxWallsPerScan> rank{};
    for (std::size_t i = 0; i < walls_.size(); ++i) { order[i] = static_cast<std::int16_t>(i); }
    std::sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(walls_.size()), [this](const std::int16_t a, const std::int16_t b) {
        const std::int32_t na = walls_[static_cast<std::size_t>(a)].points;
        const std::int32_t nb = walls_[static_cast<std::size_t>(b)].points;
        return na != nb ? na > nb : a < b;
    });
    const WallObservations unsorted = walls_;
    for (std::size_t i = 0; i < walls_.size(); ++i) {
        walls_[i] = unsorted[static_cast<std::size_t>(order[i])];
        rank[static_cast<std::size_t>(order[i])] = static_cast<std::int16_t>(i);
    }
    for (std::int16_t& owner : wall_of_point_) {
        if (owner >= 0) { owner = rank[static_cast<std::size_t>(owner)]; }
    }
}

}  // namespace noctule
