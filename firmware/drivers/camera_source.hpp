/// A camera, a video file or numbered pictures, through OpenCV; comes back by itself after it was unplugged.
///
/// "/dev/video0" is opened with V4L2. Anything else is taken for a file ("pictures/%03d.png", "flight.avi"): at its end it is
/// closed and begun anew like a camera that was plugged in again. OpenCV allocates: a process of its own, not for flight.
#pragma once

#include <cstdint>
#include <string>

#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>

namespace noctule {

class CameraSource {
public:
    /// width, height: what is asked of a camera; it may give another size.
    CameraSource(std::string device, int width, int height);

    /// Opens it when it is closed and a second has passed since the last try. True: it has opened just now.
    [[nodiscard]] bool keep(std::int64_t now_us);
    [[nodiscard]] bool is_open() const { return capture_.isOpened(); }
    /// Takes the next picture; waits for it, at most what the driver waits. False: none came, and it is closed.
    [[nodiscard]] bool grab();
    /// The picture just taken: blue green red, 8 bits. False as above.
    [[nodiscard]] bool read(cv::Mat& image);
    /// When it was taken, on this machine's monotonic clock [us]: the driver's own stamp where it gives one (V4L2), else now_us.
    [[nodiscard]] std::int64_t taken_us(std::int64_t now_us) const;

    [[nodiscard]] bool is_camera() const { return camera_; }

private:
    std::string device_;
    int width_;
    int height_;
    bool camera_;
    cv::VideoCapture capture_;
    std::int64_t next_try_us_ = 0;
};

/// Fills `small` with the image cut to the shape wanted and scaled to it (area average): what a camera of that size would see.
void fit(const cv::Mat& image, int width, int height, cv::Mat& small);

}  // namespace noctule
