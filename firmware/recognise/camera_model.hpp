/// The camera: pinhole with lens distortion and its place on the vehicle, from a calibration file in OpenCV's form.
///
/// Model: docs/maths/vision.md, "Camera", equations (11) to (13). Frames: image (x right, y down, px), Body (x forward, y left, z up).
/// Reading the file allocates; the rest does not.
#pragma once

#include <array>
#include <string>

namespace noctule {

using Vec3 = std::array<double, 3>;

struct CameraModel {
    int width = 320;                                ///< columns of the calibrated picture
    int height = 240;
    double fx_px = 235.5133;                        ///< focal lengths; the default is the simulator's camera, 54 degrees high
    double fy_px = 235.5133;
    double cx_px = 159.5;                           ///< principal point
    double cy_px = 119.5;
    std::array<double, 5> distortion{};             ///< k1 k2 p1 p2 k3
    Vec3 position_body_m{0.12, 0.0, 0.03};          ///< optical centre in Body
    double yaw_rad = 0.0;                           ///< optical axis in Body: turned left
    double pitch_rad = 0.0;                         ///< and down
    double row_time_s = 0.0;                        ///< from the exposure of one row to the next; the stamp is the middle row's

    /// Direction in Body of a pixel, length 1.
    [[nodiscard]] Vec3 ray_body(double u_px, double v_px) const;

    /// Pixel of a point in Body. False: behind the camera or far outside the picture.
    [[nodiscard]] bool pixel(const Vec3& point_body_m, double& u_px, double& v_px) const;
};

/// Reads image_width, image_height, camera_matrix, distortion_coefficients (OpenCV's calibration program writes these) and, where
/// present, position_body_m (3 numbers), yaw_rad, pitch_rad, row_time_s. False: error is one line, camera unchanged.
[[nodiscard]] bool load_camera(const std::string& path, CameraModel& camera, std::string& error);

}  // namespace noctule
