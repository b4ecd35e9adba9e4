#include "recognise/place.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "recognise/region_split.hpp"

namespace noctule {
namespace {

constexpr double kStep_m = 0.45;          // neighbouring beams this far apart in depth lie on two things
constexpr double kHidden_m = 0.15;        // something this much nearer beside the region hides a part of it
constexpr double kFlush_m = 0.10;         // what lies beside the region this close to its own line: it hangs on the wall
constexpr double kFlat_m = 0.03;          // spread of the hits on a flat face
constexpr double kWallSigma_m = 0.60;     // of the wall behind as a range: the thing may stand off it
constexpr double kPitchSigma_rad = 0.009; // half a degree
constexpr double kPixelSigma_px = 1.5;    // of the side of a region
constexpr int kBorder_px = 2;             // a region that comes this close to the border may go on beyond it
constexpr int kBeside_px = 14;            // where to look for the depth beside a region
constexpr int kInside_px = 2;              // a hit nearer to the side of a region may have gone past it
constexpr int kTilt_px = 4;                // two sigmas of the tilt: a hit nearer to the top of a region may have gone over it
constexpr double kCutShare = 0.7;          // of the way to where the ray of the frame's lowest row meets the floor, for what is cut by it
constexpr double kCutSigma = 0.25;
constexpr double kUnder_m = 0.15;
constexpr std::size_t kLeastHits = 2;
constexpr double kParallax_px = 12.0;      // how far camera and laser may differ about the side of a thing
constexpr double kNearest_m = 0.25;
constexpr double kShowNear_m = 0.8;        // what stands between these distances and so far inside the frame is seen, if it is there
constexpr double kShowFar_m = 3.5;
constexpr double kShowBorder_px = 20.0;
constexpr double kFarthest_m = 12.0;

double wrap(const double a) { return std::remainder(a, 6.283185307179586); }

bool in_region(const cv::Mat& labels, const Region& region, const double u_px, const double v_px) {
    const int x = static_cast<int>(std::lround(u_px));
    const int y = static_cast<int>(std::lround(v_px));
    return x >= region.left_px && y >= region.top_px && x < region.left_px + region.width_px && y < region.top_px + region.height_px &&
           labels.at<int>(y, x) == region.label && labels.at<int>(y, std::max(x - kInside_px, 0)) == region.label &&
           labels.at<int>(y, std::min(x + kInside_px, labels.cols - 1)) == region.label && labels.at<int>(std::max(y - kTilt_px, 0), x) == region.label &&
           labels.at<int>(std::min(y + kTilt_px, labels.rows - 1), x) == region.label;
}

}  // namespace

void Placer::start(const CameraModel& camera, const VehiclePose& pose, const std::span<const Vec3> points_map_m) {
    camera_ = &camera;
    pose_ = pose;
    eye_ = pose.to_map(camera.position_body_m);
    hits_.clear();
    for (const Vec3& p : points_map_m) {
        Hit hit;
        if (!camera.pixel(pose.to_body(p), hit.u_px, hit.v_px)) { continue; }
        if (hit.u_px < -40.0 || hit.u_px > camera.width + 40.0 || hit.v_px < -40.0 || hit.v_px > camera.height + 40.0) { continue; }
        hit.distance_m = std::hypot(p[0] - eye_[0], p[1] - eye_[1]);
        hit.map = p;
        static_cast<void>(hits_.push(hit));
    }
    std::sort(hits_.begin(), hits_.end(), [](const Hit& a, const Hit& b) { return a.u_px > b.u_px; });
    // The camera stands elsewhere than the laser: what the laser sees past the side of a near thing, the thing may hide from the camera.
    // Such a hit has nearer ones close by on both sides.
    const auto hidden = [&](const std::size_t i) {
        const auto nearer = [&](const std::size_t j) { return hits_[j].distance_m < hits_[i].distance_m - kStep_m; };
        bool left = false;
        bool right = false;
        for (std::size_t j = i; j-- > 0 && hits_[j].u_px - hits_[i].u_px < kParallax_px && !right;) { right = nearer(j); }
        for (std::size_t j = i + 1; j < hits_.size() && hits_[i].u_px - hits_[j].u_px < kParallax_px && !left; ++j) { left = nearer(j); }
        return left && right;
    };
    std::array<bool, kMaxBeams> gone{};
    for (std::size_t i = 0; i < hits_.size(); ++i) { gone[i] = hidden(i); }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < hits_.size(); ++i) {
        if (!gone[i]) { hits_[kept++] = hits_[i]; }
    }
    while (hits_.size() > kept) { hits_.remove_unordered(hits_.size() - 1); }
}

bool Placer::should_show(const Vec3& point_map_m, double& u_px, double& v_px) const {
    const double distance_m = std::hypot(point_map_m[0] - eye_[0], point_map_m[1] - eye_[1]);
    if (distance_m < kShowNear_m || distance_m > kShowFar_m || !camera_->pixel(pose_.to_body(point_map_m), u_px, v_px)) { return false; }
    if (u_px < kShowBorder_px || v_px < kShowBorder_px || u_px > camera_->width - kShowBorder_px || v_px > camera_->height - kShowBorder_px) { return false; }
    std::size_t beyond = 0;
    for (const Hit& hit : hits_) {
        if (std::fabs(hit.u_px - u_px) > kBeside_px) { continue; }
        if (hit.distance_m < distance_m - kHidden_m) { return false; }
        ++beyond;
    }
    return beyond >= kLeastHits;
}

double Placer::bearing_of(const double u_px, const double v_px, double& slope) const {
    const Vec3 d = pose_.turn_to_map(camera_->ray_body(u_px, v_px));
    const double flat = std::hypot(d[0], d[1]);
    slope = d[2] / std::max(flat, 1.0e-6);
    // The rows are exposed one after the other, equation (13): the camera has turned between the middle row and this one.
    return std::atan2(d[1], d[0]) + pose_.yaw_rate_rad_s * camera_->row_time_s * (v_px - 0.5 * camera_->height);
}

double Placer::outside_depth(const double u_px, const double toward) const {
    // Median of up to five hits just beside the region; NaN: the laser says nothing there.
    std::array<double, 5> found{};
    std::size_t n = 0;
    for (const Hit& hit : hits_) {
        const double off = (hit.u_px - u_px) * toward;
        if (off < 3.0 || off > kBeside_px) { continue; }
        found[n++] = hit.distance_m;
        if (n == found.size()) { break; }
    }
    if (n == 0) { return std::numeric_limits<double>::quiet_NaN(); }
    std::sort(found.begin(), found.begin() + static_cast<std::ptrdiff_t>(n));
    return found[n / 2];
}

bool Placer::flush_with(const Face& face, const double left_px, const double right_px) const {
    // What the laser sees beside the region goes on in its line on each side where it sees anything.
    if (face.spread_m > kFlat_m) { return false; }
    std::size_t on = 0;
    std::size_t off = 0;
    for (const Hit& hit : hits_) {
        const double left = left_px - hit.u_px;
        const double right = hit.u_px - right_px;
        const double beside = std::max(left, right);
        if (beside < 3.0 || beside > kBeside_px) { continue; }
        const double away_m = std::fabs(face.nx * (hit.map[0] - face.x_m) + face.ny * (hit.map[1] - face.y_m));
        (away_m < kFlush_m ? on : off) += 1;
    }
    return on >= 2 && off <= on / 4;
}

void Placer::find(const cv::Mat& labels, const Region& region, Parts& out) const {
    // Columns at which the depth steps: the region is cut there.
    int from = region.left_px;
    const int end = region.left_px + region.width_px - 1;
    std::array<int, 8> cuts{};
    std::size_t count = 0;
    const Hit* last = nullptr;
    for (std::size_t i = hits_.size(); i-- > 0;) {  // from left to right
        const Hit& hit = hits_[i];
        if (!in_region(labels, region, hit.u_px, hit.v_px)) { continue; }
        if (last != nullptr && std::fabs(hit.distance_m - last->distance_m) > kStep_m && count < cuts.size()) {
            cuts[count++] = static_cast<int>(std::lround(0.5 * (hit.u_px + last->u_px)));
        }
        last = &hit;
    }
    for (std::size_t k = 0; k <= count; ++k) {
        const int to = k < count ? std::clamp(cuts[k], from, end) : end;
        const Region part = count == 0 ? region : region_within(labels, region, {from, region.top_px, to - from + 1, region.height_px});
        from = to + 1;
        if (part.area_px < 30 || part.width_px < 4) { continue; }
        static_cast<void>(out.push({part, place(labels, part)}));
        if (from > end) { break; }
    }
}

Placement Placer::place(const cv::Mat& labels, const Region& region) const {
    Placement out;
    const double left_px = region.left_px - 0.5;
    const double right_px = region.left_px + region.width_px - 0.5;
    const double top_px = region.top_px - 0.5;
    const double bottom_px = region.top_px + region.height_px - 0.5;
    const double v_px = static_cast<double>(region.y_px);
    double slope_l = 0.0;
    double slope_r = 0.0;
    const double left_rad = bearing_of(left_px, v_px, slope_l);
    const double right_rad = bearing_of(right_px, v_px, slope_r);
    const double half_rad = 0.5 * wrap(left_rad - right_rad);
    double middle_rad = wrap(right_rad + half_rad);
    const bool sides = region.left_px > kBorder_px && region.left_px + region.width_px < camera_->width - kBorder_px;
    const bool cut_below = region.top_px + region.height_px >= camera_->height - kBorder_px;
    const bool bottom_seen = !cut_below && !region.hidden_below;
    out.tall = bottom_seen && region.top_px > kBorder_px;
    out.whole = sides && !region.hidden_beside;
    if (!(half_rad > 1.0e-3 && half_rad < 1.2)) { return out; }

    // Depth of the region's own surface, and of what lies behind its columns.
    Bounded<double, kMaxBeams> own;
    Bounded<double, kMaxBeams> behind;
    Face face;
    double sxx = 0.0;
    double sxy = 0.0;
    double syy = 0.0;
    double leftmost_m = 0.0;
    double rightmost_m = 0.0;
    for (const Hit& hit : hits_) {  // from right to left
        if (hit.u_px < left_px || hit.u_px > right_px) { continue; }
        static_cast<void>(behind.push(hit.distance_m));
        if (!in_region(labels, region, hit.u_px, hit.v_px)) { continue; }
        if (own.empty()) { rightmost_m = hit.distance_m; }
        leftmost_m = hit.distance_m;
        static_cast<void>(own.push(hit.distance_m));
        const double n = static_cast<double>(own.size());
        const double dx = hit.map[0] - face.x_m;
        const double dy = hit.map[1] - face.y_m;
        face.x_m += dx / n;
        face.y_m += dy / n;
        sxx += dx * (hit.map[0] - face.x_m);
        sxy += dx * (hit.map[1] - face.y_m);
        syy += dy * (hit.map[1] - face.y_m);
    }
    const double beside_left_m = outside_depth(left_px, -1.0);
    const double beside_right_m = outside_depth(right_px, 1.0);
    const double s = std::sin(half_rad);
    const double ground_m = std::isfinite(pose_.ground_z_m) ? pose_.ground_z_m : 0.0;
    double near_m = 0.0;
    bool flush = false;
    // Where the ray of the lower side meets the floor, equation (15).
    const double height_m = std::max(eye_[2] - ground_m, 0.1);
    double slope_foot = 0.0;
    static_cast<void>(bearing_of(static_cast<double>(region.x_px), bottom_px, slope_foot));
    const double foot_m = slope_foot < -0.02 ? height_m / -slope_foot : std::numeric_limits<double>::infinity();
    const double foot_sigma_m = 0.05 + (foot_m * foot_m + height_m * height_m) / height_m * 1.5 * kPitchSigma_rad;

    if (own.size() >= kLeastHits) {
        out.source = RangeSource::laser;
        std::sort(own.begin(), own.end());
        near_m = own[std::min<std::size_t>(own.size() / 10 + 1, own.size() - 1)];
        if (beside_left_m < leftmost_m - kHidden_m || beside_right_m < rightmost_m - kHidden_m) { out.whole = false; }
        out.along_sigma_m = 0.03;
        // Its lower side would lie under the floor: what the laser sees is another thing, behind what stands lower in the picture.
        if (near_m > foot_m + kUnder_m + 2.0 * foot_sigma_m) {
            out.source = RangeSource::none;
            return out;
        }
        const double angle_rad = 0.5 * std::atan2(2.0 * sxy, sxx - syy);
        face.nx = -std::sin(angle_rad);
        face.ny = std::cos(angle_rad);
        face.spread_m = std::sqrt(std::max(0.0, face.nx * face.nx * sxx + 2.0 * face.nx * face.ny * sxy + face.ny * face.ny * syy) /
                                  static_cast<double>(own.size()));
        flush = own.size() >= 4 && flush_with(face, left_px, right_px);
        if (flush) {
            // A picture on a wall: the middle between where the rays of its sides meet the line of its face, equation (16).
            const double to_face_m = face.nx * (face.x_m - eye_[0]) + face.ny * (face.y_m - eye_[1]);
            const double l = to_face_m / (face.nx * std::cos(left_rad) + face.ny * std::sin(left_rad));
            const double r = to_face_m / (face.nx * std::cos(right_rad) + face.ny * std::sin(right_rad));
            if (l > kNearest_m && r > kNearest_m && l < kFarthest_m && r < kFarthest_m) {
                const double xl = l * std::cos(left_rad);
                const double yl = l * std::sin(left_rad);
                const double xr = r * std::cos(right_rad);
                const double yr = r * std::sin(right_rad);
                near_m = std::hypot(0.5 * (xl + xr), 0.5 * (yl + yr));
                middle_rad = std::atan2(yl + yr, xl + xr);
                out.width_m = std::hypot(xl - xr, yl - yr);
            }
        }
    } else {
        double far_m = std::numeric_limits<double>::infinity();
        if (!behind.empty()) {
            std::sort(behind.begin(), behind.end());
            far_m = behind[behind.size() / 2];
        }
        const double floor_m = bottom_seen ? foot_m : std::numeric_limits<double>::infinity();
        if (cut_below && foot_m < far_m) {
            // Cut by the lower border, and the laser goes over it: it stands somewhere before the place where the lowest row meets the floor.
            out.source = RangeSource::floor;
            near_m = kCutShare * foot_m;
            out.along_sigma_m = kCutSigma * foot_m;
            out.whole = false;
        } else if (floor_m < far_m + kHidden_m && floor_m < kFarthest_m) {
            out.source = RangeSource::floor;
            near_m = floor_m;
            out.along_sigma_m = foot_sigma_m;
            flush = floor_m > far_m - kHidden_m;
        } else if (std::isfinite(far_m) && behind.size() >= kLeastHits) {
            out.source = RangeSource::wall;
            near_m = far_m;
            out.along_sigma_m = kWallSigma_m;
            flush = true;
            if (beside_left_m < far_m - 2.0 * kHidden_m || beside_right_m < far_m - 2.0 * kHidden_m) { out.whole = false; }
        } else {
            return out;
        }
    }
    if (!(near_m > kNearest_m && near_m < kFarthest_m)) {
        out.source = RangeSource::none;
        return out;
    }
    // A thing that stands free is about as deep as it is wide, equation (14); one that is flush with the wall is flat.
    const double centre_m = flush ? near_m + 0.015 : near_m / (1.0 - std::min(s, 0.8));
    if (!(flush && out.width_m > 0.0)) { out.width_m = 2.0 * centre_m * (flush ? std::tan(half_rad) : s); }
    double slope_top = 0.0;
    double slope_bottom = 0.0;
    double slope_middle = 0.0;
    static_cast<void>(bearing_of(static_cast<double>(region.x_px), top_px, slope_top));
    static_cast<void>(bearing_of(static_cast<double>(region.x_px), bottom_px, slope_bottom));
    static_cast<void>(bearing_of(static_cast<double>(region.x_px), v_px, slope_middle));
    out.height_m = near_m * (slope_top - slope_bottom);
    out.eye_m = eye_;
    out.slope = slope_middle;
    out.bearing_rad = middle_rad;
    out.distance_m = centre_m;
    out.x_m = eye_[0] + centre_m * std::cos(middle_rad);
    out.y_m = eye_[1] + centre_m * std::sin(middle_rad);
    out.z_m = eye_[2] + near_m * slope_middle;
    // Through an opening in the floor or the ceiling another storey shows: what would float there stands elsewhere.
    const double ceiling_m = std::isfinite(pose_.ceiling_z_m) ? pose_.ceiling_z_m : ground_m + 6.0;
    if (out.z_m < ground_m - 0.15 || out.z_m > ceiling_m + 0.10) {
        out.source = RangeSource::none;
        return out;
    }
    const double pixels_m = kPixelSigma_px / camera_->fx_px * centre_m;
    out.across_sigma_m = std::hypot(std::hypot(pixels_m, 0.02), 0.05 * out.width_m + centre_m * std::sqrt(pose_.yaw_var_rad2));
    if (!out.whole) { out.across_sigma_m = std::hypot(out.across_sigma_m, 0.3); }
    out.along_sigma_m = std::hypot(out.along_sigma_m, flush ? 0.03 : 0.03 + 0.10 * out.width_m);
    if (!out.whole) { out.along_sigma_m = std::hypot(out.along_sigma_m, 0.25); }
    return out;
}

}  // namespace noctule
