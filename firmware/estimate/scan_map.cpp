#include "estimate/scan_map.hpp"

#include <algorithm>
#include <cmath>

#include "core/integer.hpp"

namespace noctule {

namespace {

constexpr float kHalf_m = 0.5F * ScanMap::kCell_m * static_cast<float>(ScanMap::kSide);
constexpr float kReach_m = 0.30F;           // a cell's mean farther away than this is another surface
constexpr float kFlat = 0.15F;              // ratio of variances below which the surroundings count as a line
constexpr float kFlatCount = 4.0F;
constexpr float kPointSigma_m = 0.02F;      // of a point against a surface of the map: noise, roughness, pose of the keyframe
constexpr float kSpotSigma_m = 0.05F;
constexpr float kLooseSigma_m = 0.15F;
constexpr int kRounds = 12;
constexpr float kAgree2 = 9.0F;
constexpr float kPlaceSoft = 4.0F;           // squared distance from the prediction at which it counts half
constexpr float kYawSoft = 4.0F;
constexpr std::int32_t kPointsMin = 10;
constexpr std::size_t kSearchPoints = 90;

}  // namespace

void ScanMap::start(const float centre_x_m, const float centre_y_m) {
    // Whole cells, so that the lattice stays where it is.
    x0_m_ = kCell_m * std::floor((centre_x_m - kHalf_m) / kCell_m);
    y0_m_ = kCell_m * std::floor((centre_y_m - kHalf_m) / kCell_m);
    slot_.fill(0);
    near_.fill(0);
    used_ = 1;
}

std::int32_t ScanMap::index_of(const float x_m, const float y_m) const {
    const float fx = (x_m - x0_m_) * (1.0F / kCell_m);
    const float fy = (y_m - y0_m_) * (1.0F / kCell_m);
    if (!(fx >= 1.0F && fy >= 1.0F && fx < static_cast<float>(kSide - 1) && fy < static_cast<float>(kSide - 1))) { return -1; }
    return static_cast<std::int32_t>(fy) * kSide + static_cast<std::int32_t>(fx);
}

void ScanMap::add(const Point2<Body>* points, const std::size_t count, const Pose2<Map, Body>& pose) {
    const float c = std::cos(pose.yaw_rad);
    const float s = std::sin(pose.yaw_rad);
    for (std::size_t i = 0; i < count; ++i) {
        const float x_m = pose.x_m + c * points[i].x_m - s * points[i].y_m;
        const float y_m = pose.y_m + s * points[i].x_m + c * points[i].y_m;
        const std::int32_t index = index_of(x_m, y_m);
        if (index < 0) { continue; }
        std::uint16_t& slot = slot_[static_cast<std::size_t>(index)];
        if (slot == 0) {
            if (used_ == kMaxScanCells) {
                ++refused_;
                continue;
            }
            slot = static_cast<std::uint16_t>(used_++);
            Cell& made = cells_[slot];
            made = Cell{};
            made.column = static_cast<std::int16_t>(index % kSide);
            made.row = static_cast<std::int16_t>(index / kSide);
            for (std::int32_t dy = -1; dy <= 1; ++dy) {
                for (std::int32_t dx = -1; dx <= 1; ++dx) {
                    std::uint8_t& near = near_[static_cast<std::size_t>(index + dy * kSide + dx)];
                    near = std::max<std::uint8_t>(near, dx == 0 && dy == 0 ? 2 : 1);
                }
            }
        }
        Cell& cell = cells_[slot];
        const float dx = x_m - (x0_m_ + (static_cast<float>(cell.column) + 0.5F) * kCell_m);
        const float dy = y_m - (y0_m_ + (static_cast<float>(cell.row) + 0.5F) * kCell_m);
        cell.count += 1.0F;
        cell.x_m += dx;
        cell.y_m += dy;
        cell.xx += dx * dx;
        cell.xy += dx * dy;
        cell.yy += dy * dy;
        cell.kind = 0;
    }
}

void ScanMap::prepare(Cell& cell) {
    // Moments of the cell and its neighbours, from this cell's centre (docs/maths/scan_match.md, equation 1).
    float n = 0.0F;
    float sx = 0.0F;
    float sy = 0.0F;
    float xx = 0.0F;
    float xy = 0.0F;
    float yy = 0.0F;
    for (std::int32_t r = -1; r <= 1; ++r) {
        for (std::int32_t q = -1; q <= 1; ++q) {
            const std::int32_t column = cell.column + q;
            const std::int32_t row = cell.row + r;
            if (column < 0 || row < 0 || column >= kSide || row >= kSide) { continue; }
            const std::uint16_t slot = slot_[static_cast<std::size_t>(row * kSide + column)];
            if (slot == 0) { continue; }
            const Cell& other = cells_[slot];
            const float ox = static_cast<float>(q) * kCell_m;
            const float oy = static_cast<float>(r) * kCell_m;
            n += other.count;
            sx += other.x_m + other.count * ox;
            sy += other.y_m + other.count * oy;
            xx += other.xx + 2.0F * ox * other.x_m + other.count * ox * ox;
            xy += other.xy + ox * other.y_m + oy * other.x_m + other.count * ox * oy;
            yy += other.yy + 2.0F * oy * other.y_m + other.count * oy * oy;
        }
    }
    const float centre_x_m = x0_m_ + (static_cast<float>(cell.column) + 0.5F) * kCell_m;
    const float centre_y_m = y0_m_ + (static_cast<float>(cell.row) + 0.5F) * kCell_m;
    cell.mean_x_m = centre_x_m + cell.x_m / cell.count;
    cell.mean_y_m = centre_y_m + cell.y_m / cell.count;
    cell.kind = 2;
    // Few points: most likely the end of what was seen of a surface, which moves with the vehicle.
    cell.variance_m2 = n < kFlatCount ? kLooseSigma_m * kLooseSigma_m : kSpotSigma_m * kSpotSigma_m;
    if (n < kFlatCount) { return; }
    const float mx = sx / n;
    const float my = sy / n;
    const Eigen2<float> eigen = eigen_symmetric(xx / n - mx * mx, xy / n - mx * my, yy / n - my * my);
    const float small = std::max(0.0F, eigen.small);
    if (small > kFlat * eigen.large) { return; }
    cell.kind = 1;
    cell.normal_x = -std::sin(eigen.direction_rad);
    cell.normal_y = std::cos(eigen.direction_rad);
    cell.variance_m2 = small;
    // The line through the mean of them all, at the place of this cell's own mean.
    const float off = cell.normal_x * (mx - cell.x_m / cell.count) + cell.normal_y * (my - cell.y_m / cell.count);
    cell.mean_x_m += off * cell.normal_x;
    cell.mean_y_m += off * cell.normal_y;
}

std::int32_t ScanMap::nearest(const float x_m, const float y_m) {
    const std::int32_t index = index_of(x_m, y_m);
    if (index < 0 || near_[static_cast<std::size_t>(index)] == 0) { return -1; }
    std::int32_t best = -1;
    float best_m2 = kReach_m * kReach_m;
    for (std::int32_t r = -1; r <= 1; ++r) {
        for (std::int32_t q = -1; q <= 1; ++q) {
            const std::uint16_t slot = slot_[static_cast<std::size_t>(index + r * kSide + q)];
            if (slot == 0) { continue; }
            Cell& cell = cells_[slot];
            if (cell.kind == 0) { prepare(cell); }
            const float dx = x_m - cell.mean_x_m;
            const float dy = y_m - cell.mean_y_m;
            const float d2 = dx * dx + dy * dy;
            if (d2 < best_m2) {
                best_m2 = d2;
                best = slot;
            }
        }
    }
    return best;
}

PriorScale Prediction::scale(const Pose2<Map, Body>& at) const {
    const float x = at.x_m - pose.x_m;
    const float y = at.y_m - pose.y_m;
    const float yaw = wrap_angle(at.yaw_rad - pose.yaw_rad);
    const float determinant = std::max(1e-12F, covariance(0, 0) * covariance(1, 1) - covariance(0, 1) * covariance(0, 1));
    const float place2 = (covariance(1, 1) * x * x - 2.0F * covariance(0, 1) * x * y + covariance(0, 0) * y * y) / determinant;
    return {1.0F + place2 / kPlaceSoft, 1.0F + yaw * yaw / covariance(2, 2) / kYawSoft};
}

float Prediction::cost(const Pose2<Map, Body>& at) const {
    const PriorScale far = scale(at);
    return kPlaceSoft * std::log(far.place) + kYawSoft * std::log(far.yaw);
}

ScanFit ScanMap::refine(const ScanShape& shape, const Pose2<Map, Body>& start, const Prediction& predicted) {
    ScanFit fit;
    fit.pose = start;
    if (shape.size() < static_cast<std::size_t>(kPointsMin) || empty()) { return fit; }
    Matrix<float, 3, 3> lambda;
    Matrix<float, 3, 1> b;
    Pose2<Map, Body> pose = start;
    for (int round = 0; round < kRounds; ++round) {
        // The weight starts wide, so that a start some decimetres off is drawn in, and narrows.
        const float wide = round < 3 ? 9.0F : round < 5 ? 3.0F : 1.0F;
        lambda = Matrix<float, 3, 3>{};
        b = Matrix<float, 3, 1>{};
        const float c = std::cos(pose.yaw_rad);
        const float s = std::sin(pose.yaw_rad);
        std::int32_t in_reach = 0;
        std::int32_t agree = 0;
        float squares_m2 = 0.0F;
        float cost = 0.0F;
        for (const Point2<Body>& point : shape) {
            const float rx = c * point.x_m - s * point.y_m;
            const float ry = s * point.x_m + c * point.y_m;
            const std::int32_t slot = nearest(pose.x_m + rx, pose.y_m + ry);
            if (slot < 0) {
                cost += 2.0F;
                continue;
            }
            ++in_reach;
            const Cell& cell = cells_[static_cast<std::size_t>(slot)];
            const float ex = cell.mean_x_m - pose.x_m - rx;
            const float ey = cell.mean_y_m - pose.y_m - ry;
            if (cell.kind == 1) {
                const float e = cell.normal_x * ex + cell.normal_y * ey;
                const float variance = kPointSigma_m * kPointSigma_m + cell.variance_m2;
                const float d2 = e * e / variance;
                const float soft = 1.0F / (1.0F + d2 / (2.0F * wide));
                cost += d2 / (1.0F + 0.5F * d2);
                const float weight = soft * soft / variance;
                const float turn = -ry * cell.normal_x + rx * cell.normal_y;
                lambda(0, 0) += weight * cell.normal_x * cell.normal_x;
                lambda(0, 1) += weight * cell.normal_x * cell.normal_y;
                lambda(1, 1) += weight * cell.normal_y * cell.normal_y;
                lambda(0, 2) += weight * cell.normal_x * turn;
                lambda(1, 2) += weight * cell.normal_y * turn;
                lambda(2, 2) += weight * turn * turn;
                b(0, 0) += weight * e * cell.normal_x;
                b(1, 0) += weight * e * cell.normal_y;
                b(2, 0) += weight * e * turn;
                if (d2 < kAgree2) {
                    ++agree;
                    squares_m2 += e * e;
                }
            } else {
                const float variance = cell.variance_m2;
                const float d2 = (ex * ex + ey * ey) / variance;
                const float soft = 1.0F / (1.0F + d2 / (2.0F * wide));
                cost += d2 / (1.0F + 0.5F * d2);
                const float weight = soft * soft / variance;
                lambda(0, 0) += weight;
                lambda(1, 1) += weight;
                lambda(0, 2) += -weight * ry;
                lambda(1, 2) += weight * rx;
                lambda(2, 2) += weight * (rx * rx + ry * ry);
                b(0, 0) += weight * ex;
                b(1, 0) += weight * ey;
                b(2, 0) += weight * (-ry * ex + rx * ey);
                if (d2 < kAgree2) {
                    ++agree;
                    squares_m2 += ex * ex + ey * ey;
                }
            }
        }
        fit.cost = cost;
        fit.in_reach = in_reach;
        fit.match.points = agree;
        fit.share = static_cast<float>(agree) / static_cast<float>(shape.size());
        fit.residual_m = agree > 0 ? std::sqrt(squares_m2 / static_cast<float>(agree)) : 0.0F;
        lambda(1, 0) = lambda(0, 1);
        lambda(2, 0) = lambda(0, 2);
        lambda(2, 1) = lambda(1, 2);
        if (in_reach < kPointsMin) { return fit; }
        Matrix<float, 3, 1> back;
        back.values = {predicted.pose.x_m - pose.x_m, predicted.pose.y_m - pose.y_m, wrap_angle(predicted.pose.yaw_rad - pose.yaw_rad)};
        fit.prior_scale = predicted.scale(pose);
        const Matrix<float, 3, 3> hold = fit.prior_scale.weaken(predicted.information);
        Matrix<float, 3, 3> inverse;
        if (!invert(lambda + hold, inverse)) { return fit; }
        const Matrix<float, 3, 1> step = inverse * (b + hold * back);
        const bool settled = std::abs(step(0, 0)) + std::abs(step(1, 0)) < 2e-4F && std::abs(step(2, 0)) < 5e-5F;
        if (round + 1 == kRounds || (round >= 5 && settled)) { break; }
        pose = {pose.x_m + step(0, 0), pose.y_m + step(1, 0), wrap_angle(pose.yaw_rad + step(2, 0))};
    }
    fit.pose = pose;
    fit.match.pose = pose;
    fit.match.lambda = lambda;
    fit.match.b = b;
    fit.match.valid = fit.match.points >= kPointsMin;
    return fit;
}

float ScanMap::explained(const ScanShape& shape, const Pose2<Map, Body>& pose) const {
    std::size_t hits = 0;
    for (const Point2<Body>& point : shape) {
        const Point2<Map> at = pose * point;
        const std::int32_t index = index_of(at.x_m, at.y_m);
        if (index >= 0 && near_[static_cast<std::size_t>(index)] > 0) { ++hits; }
    }
    return shape.empty() ? 1.0F : static_cast<float>(hits) / static_cast<float>(shape.size());
}

float ScanMap::passed_through(const ScanShape& shape, const Pose2<Map, Body>& pose, const float reach_m) const {
    // Nearest hit in each 2 degrees of bearing; a bin without one says nothing.
    constexpr std::size_t kBins = 180;
    constexpr float kScale = static_cast<float>(kBins) / (2.0F * kPi);
    std::array<float, kBins> hit_m{};
    const auto bin_of = [](const float x_m, const float y_m) { return static_cast<std::size_t>((std::atan2(y_m, x_m) + kPi) * kScale) % kBins; };
    for (const Point2<Body>& point : shape) {
        float& nearest_m = hit_m[bin_of(point.x_m, point.y_m)];
        const float range_m = std::hypot(point.x_m, point.y_m);
        nearest_m = nearest_m > 0.0F ? std::min(nearest_m, range_m) : range_m;
    }
    const Pose2<Body, Map> to_body = pose.inverse();
    std::size_t seen = 0;
    std::size_t passed = 0;
    for (std::size_t i = 1; i < used_; ++i) {
        const Cell& cell = cells_[i];
        if (cell.count < 2.0F) { continue; }
        const Point2<Body> at = to_body * Point2<Map>{x0_m_ + (static_cast<float>(cell.column) + 0.5F) * kCell_m + cell.x_m / cell.count,
                                                      y0_m_ + (static_cast<float>(cell.row) + 0.5F) * kCell_m + cell.y_m / cell.count};
        const float range_m = std::hypot(at.x_m, at.y_m);
        if (range_m < 0.5F || range_m > reach_m) { continue; }
        const std::size_t bin = bin_of(at.x_m, at.y_m);
        float hit = hit_m[bin];
        for (const std::size_t beside : {(bin + 1) % kBins, (bin + kBins - 1) % kBins}) {
            if (hit_m[beside] > 0.0F) { hit = std::min(hit, hit_m[beside]); }
        }
        // Behind what was hit nothing can be said of it.
        if (hit <= 0.0F || range_m > hit + kReach_m) { continue; }
        ++seen;
        if (hit > range_m + kReach_m) { ++passed; }
    }
    return seen == 0 ? 1.0F : static_cast<float>(passed) / static_cast<float>(seen);
}

std::size_t ScanMap::search(const ScanShape& shape, const Pose2<Map, Body>& predicted, const float half_m, const float half_rad,
                            std::array<Candidate, kCandidates>& out, const std::int32_t step_cells) const {
    // Every heading of a comb, every place of the lattice (docs/maths/scan_match.md#search); a point counts by what lies where it falls.
    const std::size_t stride = (shape.size() + kSearchPoints - 1) / kSearchPoints;
    if (stride == 0 || empty()) { return 0; }
    constexpr std::size_t kMost = kSearchPoints + 1;
    std::array<std::int32_t, kMost> column{};
    std::array<std::int32_t, kMost> row{};
    const std::int32_t half_cells = std::max<std::int32_t>(1, static_cast<std::int32_t>(std::ceil(half_m / kCell_m)));
    constexpr float kComb_rad = 0.03F;
    const std::int32_t half_turns = static_cast<std::int32_t>(std::ceil(half_rad / kComb_rad));
    std::size_t found = 0;
    for (std::int32_t turn = -half_turns; turn <= half_turns; ++turn) {
        const float yaw_rad = predicted.yaw_rad + static_cast<float>(turn) * kComb_rad;
        const float c = std::cos(yaw_rad);
        const float s = std::sin(yaw_rad);
        std::size_t n = 0;
        for (std::size_t i = 0; i < shape.size() && n < kMost; i += stride) {
            const Point2<Body>& p = shape[i];
            column[n] = floor_int((predicted.x_m + c * p.x_m - s * p.y_m - x0_m_) * (1.0F / kCell_m));
            row[n] = floor_int((predicted.y_m + s * p.x_m + c * p.y_m - y0_m_) * (1.0F / kCell_m));
            ++n;
        }
        for (std::int32_t dy = -half_cells; dy <= half_cells; dy += step_cells) {
            for (std::int32_t dx = -half_cells; dx <= half_cells; dx += step_cells) {
                std::int32_t sum = 0;
                for (std::size_t i = 0; i < n; ++i) {
                    const std::int32_t q = column[i] + dx;
                    const std::int32_t r = row[i] + dy;
                    if (static_cast<std::uint32_t>(q) >= static_cast<std::uint32_t>(kSide) || static_cast<std::uint32_t>(r) >= static_cast<std::uint32_t>(kSide)) { continue; }
                    sum += near_[static_cast<std::size_t>(r * kSide + q)];
                }
                const float score = static_cast<float>(sum) / static_cast<float>(2 * n);
                if (found == kCandidates && score <= out[found - 1].score) { continue; }
                const Candidate made{{predicted.x_m + static_cast<float>(dx) * kCell_m, predicted.y_m + static_cast<float>(dy) * kCell_m, wrap_angle(yaw_rad)}, score};
                // One entry for each hill: neighbours of a better one are left out, worse neighbours give way.
                bool worse = false;
                std::size_t kept = 0;
                for (std::size_t k = 0; k < found; ++k) {
                    const bool same = std::abs(out[k].pose.x_m - made.pose.x_m) < 2.5F * kCell_m && std::abs(out[k].pose.y_m - made.pose.y_m) < 2.5F * kCell_m &&
                                      std::abs(wrap_angle(out[k].pose.yaw_rad - made.pose.yaw_rad)) < 3.5F * kComb_rad;
                    if (same && out[k].score >= made.score) { worse = true; }
                    if (same && out[k].score < made.score) { continue; }
                    out[kept++] = out[k];
                }
                found = kept;
                if (worse) { continue; }
                if (found == kCandidates) { --found; }
                std::size_t at = found++;
                while (at > 0 && out[at - 1].score < made.score) {
                    out[at] = out[at - 1];
                    --at;
                }
                out[at] = made;
            }
        }
    }
    return found;
}

}  // namespace noctule
