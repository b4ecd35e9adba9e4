#include "drivers/camera_source.hpp"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include <opencv2/imgproc.hpp>

namespace noctule {

namespace {

constexpr std::int64_t kRetry_us = 1000000;
constexpr std::int64_t kStampTrust_us = 1000000;  // a driver's stamp farther off is on another clock

}  // namespace

CameraSource::CameraSource(std::string device, const int width, const int height)
    : device_(std::move(device)), width_(width), height_(height), camera_(device_.starts_with("/dev/")) {}

bool CameraSource::keep(const std::int64_t now_us) {
    if (is_open() || now_us < next_try_us_) { return false; }
    next_try_us_ = now_us + kRetry_us;
    if (!capture_.open(device_, camera_ ? cv::CAP_V4L2 : cv::CAP_ANY)) { return false; }
    if (camera_) {
        capture_.set(cv::CAP_PROP_FRAME_WIDTH, width_);
        capture_.set(cv::CAP_PROP_FRAME_HEIGHT, height_);
        capture_.set(cv::CAP_PROP_BUFFERSIZE, 2);  // an old picture is of no use
    }
    return true;
}

bool CameraSource::grab() {
    if (is_open() && capture_.grab()) { return true; }
    capture_.release();
    return false;
}

bool CameraSource::read(cv::Mat& image) {
    if (is_open() && capture_.retrieve(image) && image.type() == CV_8UC3 && !image.empty()) { return true; }
    capture_.release();
    return false;
}

std::int64_t CameraSource::taken_us(const std::int64_t now_us) const {
    if (!camera_) { return now_us; }
    const auto stamp_us = static_cast<std::int64_t>(capture_.get(cv::CAP_PROP_POS_MSEC) * 1e3);
    return std::abs(now_us - stamp_us) < kStampTrust_us ? stamp_us : now_us;
}

void fit(const cv::Mat& image, const int width, const int height, cv::Mat& small) {
    const double scale = std::min(static_cast<double>(image.cols) / width, static_cast<double>(image.rows) / height);
    const int cut_width = std::clamp(static_cast<int>(width * scale + 0.5), 1, image.cols);
    const int cut_height = std::clamp(static_cast<int>(height * scale + 0.5), 1, image.rows);
    const cv::Rect middle((image.cols - cut_width) / 2, (image.rows - cut_height) / 2, cut_width, cut_height);
    cv::resize(image(middle), small, cv::Size(width, height), 0.0, 0.0, cv::INTER_AREA);
}

}  // namespace noctule
