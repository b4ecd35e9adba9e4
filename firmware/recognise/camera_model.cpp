#include "recognise/camera_model.hpp"

#include <cmath>

#include <opencv2/core.hpp>

namespace noctule {
namespace {

constexpr int kUndistortRounds = 8;

/// Equation (12): where a point of the ideal picture (x right, y down, focal length 1) falls through the lens.
void distort(const std::array<double, 5>& k, const double x, const double y, double& xd, double& yd) {
    const double r2 = x * x + y * y;
    const double radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    xd = x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x);
    yd = y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y;
}

}  // namespace

Vec3 CameraModel::ray_body(const double u_px, const double v_px) const {
    const double xd = (u_px - cx_px) / fx_px;
    const double yd = (v_px - cy_px) / fy_px;
    double x = xd;
    double y = yd;
    for (int round = 0; round < kUndistortRounds; ++round) {
        double xt = 0.0;
        double yt = 0.0;
        distort(distortion, x, y, xt, yt);
        x += xd - xt;
        y += yd - yt;
    }
    // Camera: x right, y down, z ahead; Body: x ahead, y left, z up; then the mount, equation (11).
    const double length = std::sqrt(1.0 + x * x + y * y);
    const Vec3 f{1.0 / length, -x / length, -y / length};
    const double cp = std::cos(pitch_rad);
    const double sp = std::sin(pitch_rad);
    const double cw = std::cos(yaw_rad);
    const double sw = std::sin(yaw_rad);
    const Vec3 p{cp * f[0] + sp * f[2], f[1], -sp * f[0] + cp * f[2]};
    return {cw * p[0] - sw * p[1], sw * p[0] + cw * p[1], p[2]};
}

bool CameraModel::pixel(const Vec3& point_body_m, double& u_px, double& v_px) const {
    const double cp = std::cos(pitch_rad);
    const double sp = std::sin(pitch_rad);
    const double cw = std::cos(yaw_rad);
    const double sw = std::sin(yaw_rad);
    const Vec3 d{point_body_m[0] - position_body_m[0], point_body_m[1] - position_body_m[1], point_body_m[2] - position_body_m[2]};
    const Vec3 p{cw * d[0] + sw * d[1], -sw * d[0] + cw * d[1], d[2]};
    const double ahead = cp * p[0] - sp * p[2];
    const double up = sp * p[0] + cp * p[2];
    if (!(ahead > 0.05)) { return false; }
    const double x = -p[1] / ahead;
    const double y = -up / ahead;
    if (std::fabs(x) > 3.0 || std::fabs(y) > 3.0) { return false; }
    double xd = 0.0;
    double yd = 0.0;
    distort(distortion, x, y, xd, yd);
    u_px = cx_px + fx_px * xd;
    v_px = cy_px + fy_px * yd;
    return true;
}

bool load_camera(const std::string& path, CameraModel& camera, std::string& error) {
    try {
        const cv::FileStorage file(path, cv::FileStorage::READ);
        if (!file.isOpened()) {
            error = path + ": cannot be read";
            return false;
        }
        CameraModel c;
        cv::Mat matrix;
        cv::Mat lens;
        file["camera_matrix"] >> matrix;
        file["distortion_coefficients"] >> lens;
        c.width = static_cast<int>(file["image_width"]);
        c.height = static_cast<int>(file["image_height"]);
        if (matrix.rows != 3 || matrix.cols != 3 || c.width <= 0 || c.height <= 0) {
            error = path + ": image_width, image_height and a 3 x 3 camera_matrix are wanted";
            return false;
        }
        matrix.convertTo(matrix, CV_64F);
        c.fx_px = matrix.at<double>(0, 0);
        c.fy_px = matrix.at<double>(1, 1);
        c.cx_px = matrix.at<double>(0, 2);
        c.cy_px = matrix.at<double>(1, 2);
        if (!(c.fx_px > 1.0 && c.fy_px > 1.0) || !std::isfinite(c.cx_px + c.cy_px + c.fx_px + c.fy_px)) {
            error = path + ": focal lengths must be over 1 px";
            return false;
        }
        if (!lens.empty()) {
            lens.convertTo(lens, CV_64F);
            if (!(lens.total() == 4 || lens.total() == 5)) {
                error = path + ": 4 or 5 distortion_coefficients are wanted (k1 k2 p1 p2 k3)";
                return false;
            }
            for (std::size_t i = 0; i < lens.total(); ++i) { c.distortion[i] = lens.ptr<double>()[i]; }
        }
        const cv::FileNode place = file["position_body_m"];
        if (!place.empty()) {
            if (!place.isSeq() || place.size() != 3) {
                error = path + ": position_body_m must be three numbers";
                return false;
            }
            for (int i = 0; i < 3; ++i) { c.position_body_m[static_cast<std::size_t>(i)] = static_cast<double>(place[i]); }
        }
        const auto number = [&](const char* const name, double& value) {
            const cv::FileNode node = file[name];
            if (!node.empty()) { value = static_cast<double>(node); }
        };
        number("yaw_rad", c.yaw_rad);
        number("pitch_rad", c.pitch_rad);
        number("row_time_s", c.row_time_s);
        camera = c;
        return true;
    } catch (const cv::Exception& problem) {
        error = path + ": is not a calibration file: " + problem.err;
        return false;
    }
}

}  // namespace noctule
