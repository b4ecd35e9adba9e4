#include "recognise/plane_fit.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "core/random.hpp"

namespace noctule {
namespace {

using Vector8 = Eigen::Matrix<double, 8, 1>;
using Matrix8 = Eigen::Matrix<double, 8, 8>;

/// Shift and scale that bring coordinates to about -1 to 1, so that the squares below keep their digits.
struct Frame {
    double x = 0.0;
    double y = 0.0;
    double scale = 1.0;
};

struct Frames {
    Frame from;
    Frame to;
};

Frames frames_of(const std::span<const PointPair> pairs) {
    Frames f;
    double reach_from = 1.0;
    double reach_to = 1.0;
    for (const PointPair& p : pairs) {
        f.from.x += static_cast<double>(p.x_px);
        f.from.y += static_cast<double>(p.y_px);
        f.to.x += static_cast<double>(p.u_px);
        f.to.y += static_cast<double>(p.v_px);
    }
    const double n = static_cast<double>(pairs.size());
    f.from.x /= n;
    f.from.y /= n;
    f.to.x /= n;
    f.to.y /= n;
    for (const PointPair& p : pairs) {
        reach_from = std::max({reach_from, std::fabs(static_cast<double>(p.x_px) - f.from.x), std::fabs(static_cast<double>(p.y_px) - f.from.y)});
        reach_to = std::max({reach_to, std::fabs(static_cast<double>(p.u_px) - f.to.x), std::fabs(static_cast<double>(p.v_px) - f.to.y)});
    }
    f.from.scale = 1.0 / reach_from;
    f.to.scale = 1.0 / reach_to;
    return f;
}

/// The normalised h back in pixels, row-major with the last entry 1. False: it is not finite.
bool denormalise(const Vector8& h, const Frames& f, std::array<double, 9>& H) {
    Eigen::Matrix3d N;
    N << h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0;
    Eigen::Matrix3d from;
    from << f.from.scale, 0.0, -f.from.scale * f.from.x, 0.0, f.from.scale, -f.from.scale * f.from.y, 0.0, 0.0, 1.0;
    Eigen::Matrix3d to;
    to << 1.0 / f.to.scale, 0.0, f.to.x, 0.0, 1.0 / f.to.scale, f.to.y, 0.0, 0.0, 1.0;
    const Eigen::Matrix3d result = to * N * from;
    const double last = result(2, 2);
    if (!result.allFinite() || std::fabs(last) < 1.0e-12) { return false; }
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) { H[static_cast<std::size_t>(3 * r + c)] = result(r, c) / last; }
    }
    return true;
}

/// The two equations of one pair, equation (9): a . h = b for u, and for v.
void equations(const PointPair& p, const Frames& f, Vector8& a_u, double& b_u, Vector8& a_v, double& b_v) {
    const double x = (static_cast<double>(p.x_px) - f.from.x) * f.from.scale;
    const double y = (static_cast<double>(p.y_px) - f.from.y) * f.from.scale;
    const double u = (static_cast<double>(p.u_px) - f.to.x) * f.to.scale;
    const double v = (static_cast<double>(p.v_px) - f.to.y) * f.to.scale;
    a_u << x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y;
    b_u = u;
    a_v << 0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y;
    b_v = v;
}

/// Least squares over the pairs that agree (all if agrees is null); weights follow the depth, so that pixels count and not the algebra.
bool solve_homography(const std::span<const PointPair> pairs, const bool* const agrees, const Frames& f, std::array<double, 9>& H) {
    Vector8 h = Vector8::Zero();
    for (int round = 0; round < 3; ++round) {
        Matrix8 A = Matrix8::Zero();
        Vector8 b = Vector8::Zero();
        for (std::size_t k = 0; k < pairs.size(); ++k) {
            if (agrees != nullptr && !agrees[k]) { continue; }
            Vector8 a_u;
            Vector8 a_v;
            double b_u = 0.0;
            double b_v = 0.0;
            equations(pairs[k], f, a_u, b_u, a_v, b_v);
            const double x = (static_cast<double>(pairs[k].x_px) - f.from.x) * f.from.scale;
            const double y = (static_cast<double>(pairs[k].y_px) - f.from.y) * f.from.scale;
            const double depth = 1.0 + h[6] * x + h[7] * y;
            if (!(depth > 1.0e-3)) { return false; }
            const double weight = 1.0 / (depth * depth);
            A.noalias() += weight * a_u * a_u.transpose();
            A.noalias() += weight * a_v * a_v.transpose();
            b += weight * (b_u * a_u + b_v * a_v);
        }
        const Eigen::LDLT<Matrix8> factor(A);
        h = factor.solve(b);
        if (factor.info() != Eigen::Success || !h.allFinite()) { return false; }
    }
    return denormalise(h, f, H);
}

bool solve_four(const std::array<PointPair, 4>& four, const Frames& f, std::array<double, 9>& H) {
    Matrix8 A;
    Vector8 b;
    for (std::size_t k = 0; k < four.size(); ++k) {
        Vector8 a_u;
        Vector8 a_v;
        const Eigen::Index row = 2 * static_cast<Eigen::Index>(k);
        equations(four[k], f, a_u, b[row], a_v, b[row + 1]);
        A.row(row) = a_u.transpose();
        A.row(row + 1) = a_v.transpose();
    }
    const Eigen::PartialPivLU<Matrix8> factor(A);
    return denormalise(factor.solve(b), f, H);
}

/// Twice the signed area of three points of a pair's image.
double turn(const double ax, const double ay, const double bx, const double by, const double cx, const double cy) {
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
}

/// Each triple of the four turns the same way in both images and none is nearly on a line: no mirror, no fold.
bool sound(const std::array<PointPair, 4>& p) {
    for (std::size_t skip = 0; skip < 4; ++skip) {
        std::array<std::size_t, 3> t{};
        std::size_t n = 0;
        for (std::size_t k = 0; k < 4; ++k) {
            if (k != skip) { t[n++] = k; }
        }
        const auto d = [](const float v) { return static_cast<double>(v); };
        const double first = turn(d(p[t[0]].x_px), d(p[t[0]].y_px), d(p[t[1]].x_px), d(p[t[1]].y_px), d(p[t[2]].x_px), d(p[t[2]].y_px));
        const double second = turn(d(p[t[0]].u_px), d(p[t[0]].v_px), d(p[t[1]].u_px), d(p[t[1]].v_px), d(p[t[2]].u_px), d(p[t[2]].v_px));
        if (first * second <= 0.0 || std::fabs(first) < 4.0 || std::fabs(second) < 4.0) { return false; }
    }
    return true;
}

std::int32_t count(const std::span<const PointPair> pairs, const std::array<double, 9>& H, const double tolerance_px, bool* const agrees) {
    std::int32_t n = 0;
    for (std::size_t k = 0; k < pairs.size(); ++k) {
        double u = 0.0;
        double v = 0.0;
        const bool in = map_point(H, static_cast<double>(pairs[k].x_px), static_cast<double>(pairs[k].y_px), u, v) &&
                        std::hypot(u - static_cast<double>(pairs[k].u_px), v - static_cast<double>(pairs[k].v_px)) <= tolerance_px;
        if (agrees != nullptr) { agrees[k] = in; }
        n += in ? 1 : 0;
    }
    return n;
}

/// Trials after which a sample of `size` agreeing pairs was drawn with 99.9 %, equation (10).
std::int32_t enough(const std::int32_t inliers, const std::size_t pairs, const int size) {
    const double share = std::pow(static_cast<double>(inliers) / static_cast<double>(pairs), size);
    if (share >= 1.0 - 1.0e-9) { return 1; }
    return share > 1.0e-9 ? static_cast<std::int32_t>(std::min(1.0e6, std::log(1.0e-3) / std::log1p(-share) + 1.0)) : 1000000;
}

/// x' = a x - b y + c, y' = b x + a y + d over the pairs that agree.
bool solve_similarity(const std::span<const PointPair> pairs, const bool* const agrees, std::array<double, 9>& H) {
    double n = 0.0;
    double mx = 0.0;
    double my = 0.0;
    double mu = 0.0;
    double mv = 0.0;
    for (std::size_t k = 0; k < pairs.size(); ++k) {
        if (!agrees[k]) { continue; }
        n += 1.0;
        mx += static_cast<double>(pairs[k].x_px);
        my += static_cast<double>(pairs[k].y_px);
        mu += static_cast<double>(pairs[k].u_px);
        mv += static_cast<double>(pairs[k].v_px);
    }
    if (n < 2.0) { return false; }
    mx /= n;
    my /= n;
    mu /= n;
    mv /= n;
    double square = 0.0;
    double along = 0.0;
    double across = 0.0;
    for (std::size_t k = 0; k < pairs.size(); ++k) {
        if (!agrees[k]) { continue; }
        const double x = static_cast<double>(pairs[k].x_px) - mx;
        const double y = static_cast<double>(pairs[k].y_px) - my;
        const double u = static_cast<double>(pairs[k].u_px) - mu;
        const double v = static_cast<double>(pairs[k].v_px) - mv;
        square += x * x + y * y;
        along += x * u + y * v;
        across += x * v - y * u;
    }
    if (square < 1.0) { return false; }
    const double a = along / square;
    const double b = across / square;
    const double scale = std::hypot(a, b);
    if (!(scale > 0.125 && scale < 8.0)) { return false; }
    H = {a, -b, mu - a * mx + b * my, b, a, mv - b * mx - a * my, 0.0, 0.0, 1.0};
    return true;
}

}  // namespace

bool map_point(const std::array<double, 9>& H, const double x_px, const double y_px, double& u_px, double& v_px) {
    const double w = H[6] * x_px + H[7] * y_px + H[8];
    if (!(w > 1.0e-9)) { return false; }
    u_px = (H[0] * x_px + H[1] * y_px + H[2]) / w;
    v_px = (H[3] * x_px + H[4] * y_px + H[5]) / w;
    return true;
}

bool fit_similarity(const std::span<const PointPair> all, const PlaneFitSettings& settings, PlaneFit& out) {
    out = PlaneFit{};
    const std::span<const PointPair> pairs = all.first(std::min(all.size(), kMaxSurfFeatures));
    if (pairs.size() < 2) { return false; }
    Random random{settings.seed};
    const auto draw = [&] { return static_cast<std::size_t>(random.below(static_cast<std::uint32_t>(pairs.size()))); };
    const double tolerance_px = static_cast<double>(settings.tolerance_px);
    std::int32_t limit = settings.trials;
    for (std::int32_t trial = 0; trial < limit; ++trial) {
        const std::size_t i = draw();
        const std::size_t j = draw();
        const std::array<PointPair, 2> two{pairs[i], pairs[j]};
        const std::array<bool, 2> both{true, true};
        std::array<double, 9> H{};
        if (i == j || !solve_similarity(two, both.data(), H)) { continue; }
        const std::int32_t n = count(pairs, H, tolerance_px, nullptr);
        if (n > out.inliers) {
            out.inliers = n;
            out.H = H;
            limit = std::min(limit, enough(n, pairs.size(), 2));
        }
    }
    if (out.inliers < 2) { return false; }
    for (int round = 0; round < 3; ++round) {
        out.inliers = count(pairs, out.H, tolerance_px, out.agrees.data());
        std::array<double, 9> H{};
        if (!solve_similarity(pairs, out.agrees.data(), H) || count(pairs, H, tolerance_px, nullptr) < out.inliers) { break; }
        out.H = H;
    }
    out.inliers = count(pairs, out.H, tolerance_px, out.agrees.data());
    return true;
}

bool fit_homography(const std::span<const PointPair> all, const PlaneFitSettings& settings, PlaneFit& out) {
    out = PlaneFit{};
    const std::span<const PointPair> pairs = all.first(std::min(all.size(), kMaxSurfFeatures));
    if (pairs.size() < 4) { return false; }
    Random random{settings.seed};
    const auto draw = [&] { return static_cast<std::size_t>(random.below(static_cast<std::uint32_t>(pairs.size()))); };
    const Frames frames = frames_of(pairs);
    const double tolerance_px = static_cast<double>(settings.tolerance_px);
    std::int32_t limit = settings.trials;
    for (std::int32_t trial = 0; trial < limit; ++trial) {
        const std::array<PointPair, 4> four{pairs[draw()], pairs[draw()],
                                            pairs[draw()], pairs[draw()]};
        std::array<double, 9> H{};
        if (!sound(four) || !solve_four(four, frames, H)) { continue; }
        const std::int32_t n = count(pairs, H, tolerance_px, nullptr);
        if (n > out.inliers) {
            out.inliers = n;
            out.H = H;
            limit = std::min(limit, enough(n, pairs.size(), 4));
        }
    }
    if (out.inliers < 4) { return false; }
    for (int round = 0; round < 4; ++round) {
        out.inliers = count(pairs, out.H, tolerance_px, out.agrees.data());
        std::array<double, 9> H{};
        if (!solve_homography(pairs, out.agrees.data(), frames, H) || count(pairs, H, tolerance_px, nullptr) < out.inliers) { break; }
        out.H = H;
    }
    out.inliers = count(pairs, out.H, tolerance_px, out.agrees.data());
    return true;
}

}  // namespace noctule
