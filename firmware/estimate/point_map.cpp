#include "estimate/point_map.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "core/integer.hpp"

namespace noctule {

namespace {

constexpr std::size_t kProbe = 8;           // slots tried for one key
constexpr std::uint16_t kTrusted = 4;       // points of a cell before it takes part
constexpr float kElongated = 3.5F;          // ratio of variances from which a cell counts as a piece of a line
constexpr float kCountCap = 4000.0F;
constexpr int kRounds = 6;
constexpr std::int32_t kPointsMin = 8;
constexpr float kLean2 = 3.0e-3F;           // square of three degrees: how much cells lean
constexpr float kRobust2 = 6.0F;            // squared distance at which a point's weight has fallen to a quarter

constexpr std::int32_t kAxisBits = 14;      // of a cell's place; at 0.1 m that is +-819 m
constexpr std::uint32_t kAxisMask = (1U << kAxisBits) - 1U;

[[nodiscard]] std::int32_t signed_axis(const std::uint32_t bits) {
    constexpr std::int32_t kHalf = 1 << (kAxisBits - 1);
    return (static_cast<std::int32_t>(bits & kAxisMask) ^ kHalf) - kHalf;
}

[[nodiscard]] std::uint16_t to_u16(const float value) { return static_cast<std::uint16_t>(std::clamp(value + 0.5F, 0.0F, 65535.0F)); }

}  // namespace

void PointMap::clear(const std::size_t layer) {
    for (Stored& cell : cells_) {
        if (cell.key == kNone || cell.count == 0 || (cell.key >> (2 * kAxisBits)) != layer) { continue; }
        cell.count = 0;   // the key stays, so that what was put behind it is still found
        --size_;
    }
}

std::size_t PointMap::slot(const std::uint32_t key) {
    constexpr auto kBits = static_cast<unsigned>(std::countr_zero(kMaxPointCells));
    static_assert(std::has_single_bit(kMaxPointCells), "Fibonacci hashing to this many bits");
    return (key * 2654435769U) >> (32U - kBits);
}

std::uint32_t PointMap::key_of(const std::size_t layer, const float x_m, const float y_m) const {
    const float scale = 1.0F / parameters_.point_cell_m;
    const auto ix = static_cast<std::uint32_t>(floor_int(x_m * scale)) & kAxisMask;
    const auto iy = static_cast<std::uint32_t>(floor_int(y_m * scale)) & kAxisMask;
    return (static_cast<std::uint32_t>(layer) << (2 * kAxisBits)) | (ix << kAxisBits) | iy;
}

Point2<Map> PointMap::corner(const std::uint32_t key) const {
    return {static_cast<float>(signed_axis(key >> kAxisBits)) * parameters_.point_cell_m, static_cast<float>(signed_axis(key)) * parameters_.point_cell_m};
}

PointMap::Cell PointMap::unpack(const Stored& stored) const {
    const float edge_m = parameters_.point_cell_m;
    const float square_m2 = 0.25F * edge_m * edge_m / 65535.0F;   // no variance within the cell is greater than a quarter of its square
    const Point2<Map> at = corner(stored.key);
    return {static_cast<float>(stored.count), at.x_m + edge_m * static_cast<float>(stored.mean[0]) / 65536.0F,
            at.y_m + edge_m * static_cast<float>(stored.mean[1]) / 65536.0F, square_m2 * static_cast<float>(stored.xx),
            2.0F * square_m2 * static_cast<float>(stored.xy), square_m2 * static_cast<float>(stored.yy)};
}

void PointMap::pack(const Cell& cell, Stored& stored) const {
    const float edge_m = parameters_.point_cell_m;
    const float per_m2 = 65535.0F / (0.25F * edge_m * edge_m);
    const Point2<Map> at = corner(stored.key);
    stored.count = to_u16(cell.count);
    stored.mean = {to_u16((cell.mean_x_m - at.x_m) * 65536.0F / edge_m), to_u16((cell.mean_y_m - at.y_m) * 65536.0F / edge_m)};
    stored.xx = to_u16(cell.xx * per_m2);
    stored.xy = static_cast<std::int16_t>(std::lround(std::clamp(0.5F * cell.xy * per_m2, -32767.0F, 32767.0F)));
    stored.yy = to_u16(cell.yy * per_m2);
}

const PointMap::Stored* PointMap::find(const std::uint32_t key) const {
    const std::size_t first = slot(key);
    for (std::size_t i = 0; i < kProbe; ++i) {
        const Stored& cell = cells_[(first + i) % kMaxPointCells];
        if (cell.key == key) { return &cell; }
        if (cell.key == kNone) { return nullptr; }
    }
    return nullptr;
}

PointMap::Stored& PointMap::place_for(const std::uint32_t key) {
    const std::size_t first = slot(key);
    Stored* weakest = nullptr;
    for (std::size_t i = 0; i < kProbe; ++i) {
        Stored& cell = cells_[(first + i) % kMaxPointCells];
        if (cell.key == key && cell.count > 0) { return cell; }
        if (weakest == nullptr || cell.count < weakest->count) { weakest = &cell; }
        if (cell.key == key || cell.key == kNone) {
            if (cell.key == key) { weakest = &cell; }
            break;
        }
    }
    if (weakest->count > 0) {
        ++counters_.evicted;
    } else {
        ++size_;
    }
    *weakest = Stored{};
    weakest->key = key;
    return *weakest;
}

bool PointMap::nearest(const std::size_t layer, const float x_m, const float y_m, Cell& out) const {
    // The own cell and the three neighbours on the point's side; the nearest mean counts.
    const float half = 0.5F * parameters_.point_cell_m;
    bool found = false;
    float best_m2 = parameters_.point_cell_m * parameters_.point_cell_m;
    for (const float sx : {-half, half}) {
        for (const float sy : {-half, half}) {
            const Stored* stored = find(key_of(layer, x_m + sx, y_m + sy));
            if (stored == nullptr || stored->count < kTrusted) { continue; }
            const Cell cell = unpack(*stored);
            const float dx = x_m - cell.mean_x_m;
            const float dy = y_m - cell.mean_y_m;
            const float d2 = dx * dx + dy * dy;
            if (d2 < best_m2) {
                best_m2 = d2;
                out = cell;
                found = true;
            }
        }
    }
    return found;
}

PoseMatch PointMap::match(const std::size_t layer, const MatchPoints& points, const Pose2<Map, Body>& predicted, const Matrix<float, 3, 3>& covariance) {
    PoseMatch result;
    if (points.size() < static_cast<std::size_t>(kPointsMin) || size_ == 0) { return result; }
    Matrix<float, 3, 3> prior;
    Matrix<float, 3, 3> widened = covariance;
    // The prior only keeps the search near; it is widened so that it does not decide, and it is no part of the answer.
    for (std::size_t i = 0; i < 9; ++i) { widened.values[i] *= 4.0F; }
    widened(0, 0) += 1e-4F;
    widened(1, 1) += 1e-4F;
    widened(2, 2) += 1e-5F;
    if (!invert(widened, prior)) { return result; }
    const float noise_m = noise_m_ > 0.0F ? noise_m_ : parameters_.laser_range_noise_m;
    const float noise_m2 = noise_m * noise_m;

    Pose2<Map, Body> pose = predicted;
    Matrix<float, 3, 3> lambda;
    Matrix<float, 3, 1> b;
    Cell cell;
    for (int round = 0; round < kRounds; ++round) {
        lambda = Matrix<float, 3, 3>{};
        b = Matrix<float, 3, 1>{};
        result.points = 0;
        const float c = std::cos(pose.yaw_rad);
        const float s = std::sin(pose.yaw_rad);
        for (const Point2<Body>& point : points) {
            const float rx = c * point.x_m - s * point.y_m;
            const float ry = s * point.x_m + c * point.y_m;
            const float x_m = pose.x_m + rx;
            const float y_m = pose.y_m + ry;
            if (!nearest(layer, x_m, y_m, cell)) { continue; }
            // Information of the cell's Gaussian with the point's own noise; e = mean - point, d point / d yaw = (-ry, rx).
            const float a = cell.xx + noise_m2;
            const float d = cell.yy + noise_m2;
            const float o = cell.xy;
            const float determinant = a * d - o * o;
            if (!(determinant > 0.0F)) { continue; }
            const float middle = 0.5F * (a + d);
            const float radius = std::sqrt(0.25F * (a - d) * (a - d) + o * o);
            const float large = middle + radius;
            const float small = middle - radius;
            const float ex = cell.mean_x_m - x_m;
            const float ey = cell.mean_y_m - y_m;
            float ixx = d / determinant;
            float ixy = -o / determinant;
            float iyy = a / determinant;
            if (large > kElongated * small) {
                // A piece of a line: where along it the mean lies is the cell's doing, so only the distance across counts.
                const float scale = 1.0F / (small * 2.0F * radius);
                ixx = scale * (large - a);
                ixy = -scale * o;
                iyy = scale * (large - d);
            }
            const float d2 = ixx * ex * ex + 2.0F * ixy * ex * ey + iyy * ey * ey;
            const float softness = kRobust2 / (kRobust2 + d2);
            const float weight = softness * softness;
            ixx *= weight;
            ixy *= weight;
            iyy *= weight;
            const float gx = ixx * ex + ixy * ey;
            const float gy = ixy * ex + iyy * ey;
            const float hx = -ixx * ry + ixy * rx;  // information times d point / d yaw
            const float hy = -ixy * ry + iyy * rx;
            lambda(0, 0) += ixx;
            lambda(0, 1) += ixy;
            lambda(1, 1) += iyy;
            lambda(0, 2) += hx;
            lambda(1, 2) += hy;
            lambda(2, 2) += -ry * hx + rx * hy;
            b(0, 0) += gx;
            b(1, 0) += gy;
            b(2, 0) += -ry * gx + rx * gy;
            ++result.points;
        }
        lambda(1, 0) = lambda(0, 1);
        lambda(2, 0) = lambda(0, 2);
        lambda(2, 1) = lambda(1, 2);
        if (result.points < kPointsMin) {
            ++counters_.unmatched;
            return result;
        }
        Matrix<float, 3, 1> back;
        back.values = {predicted.x_m - pose.x_m, predicted.y_m - pose.y_m, wrap_angle(predicted.yaw_rad - pose.yaw_rad)};
        Matrix<float, 3, 3> inverse;
        if (!invert(lambda + prior, inverse)) { return result; }
        const Matrix<float, 3, 1> step = inverse * (b + prior * back);
        if (round + 1 == kRounds || (std::abs(step(0, 0)) + std::abs(step(1, 0)) < 1e-4F && std::abs(step(2, 0)) < 2e-5F)) { break; }
        pose = {pose.x_m + step(0, 0), pose.y_m + step(1, 0), wrap_angle(pose.yaw_rad + step(2, 0))};
    }
    // Cells of one straight surface lean a little this way and that; that is not where along it they were seen.
    const Eigen2<float> eigen = eigen_symmetric(lambda(0, 0), lambda(0, 1), lambda(1, 1));
    if (eigen.small < kLean2 * eigen.large) {
        const float c = std::cos(eigen.direction_rad);
        const float s = std::sin(eigen.direction_rad);
        Matrix<float, 3, 3> keep;
        keep.values = {c * c, c * s, 0.0F, c * s, s * s, 0.0F, 0.0F, 0.0F, 1.0F};
        lambda = keep * lambda * keep;
        b = keep * b;
    }
    // However many points agree, cells are no better than this: Lambda' = Lambda (I + F Lambda)^-1, and b alike.
    Matrix<float, 3, 3> floor;
    floor(0, 0) = parameters_.point_floor_m * parameters_.point_floor_m;
    floor(1, 1) = floor(0, 0);
    floor(2, 2) = parameters_.point_floor_rad * parameters_.point_floor_rad;
    Matrix<float, 3, 3> shrink;
    if (!invert(Matrix<float, 3, 3>::identity() + lambda * floor, shrink)) { return result; }
    result.lambda = shrink * lambda;
    symmetrise(result.lambda);
    result.b = shrink * b;
    result.pose = pose;
    result.valid = true;
    return result;
}

void PointMap::add(const std::size_t layer, const MatchPoints& points, const Pose2<Map, Body>& pose) {
    const float floor_m2 = 2.5e-5F;  // (5 mm)^2: a cell is never thinner
    for (const Point2<Body>& point : points) {
        const Point2<Map> p = pose * point;
        Stored& stored = place_for(key_of(layer, p.x_m, p.y_m));
        Cell cell = unpack(stored);
        cell.count = std::min(cell.count + 1.0F, kCountCap);
        const float gain = 1.0F / cell.count;
        const float dx = p.x_m - cell.mean_x_m;
        const float dy = p.y_m - cell.mean_y_m;
        cell.mean_x_m += gain * dx;
        cell.mean_y_m += gain * dy;
        if (cell.count <= 1.0F) {
            cell.xx = floor_m2;
            cell.yy = floor_m2;
            cell.xy = 0.0F;
        } else {
            cell.xx = std::max(floor_m2, (1.0F - gain) * (cell.xx + gain * dx * dx));
            cell.xy = (1.0F - gain) * (cell.xy + gain * dx * dy);
            cell.yy = std::max(floor_m2, (1.0F - gain) * (cell.yy + gain * dy * dy));
        }
        pack(cell, stored);
    }
}

}  // namespace noctule
