#include "recognise/recogniser.hpp"

#include <opencv2/imgproc.hpp>

namespace noctule {

const Recogniser::Sightings& Recogniser::process(const std::uint8_t* const bgr, const std::size_t bytes, const int width,
                                                 const int height) {
    sightings_.clear();
    const bool fits = bgr != nullptr && width > 0 && height > 0 && static_cast<std::size_t>(width) <= kMaxSurfSide &&
                      static_cast<std::size_t>(height) <= kMaxSurfSide &&
                      3U * static_cast<std::size_t>(width) * static_cast<std::size_t>(height) <= bytes;
    if (!fits) {
        ++counters_.refused_frames;
        return sightings_;
    }
    ++counters_.frames;
    // OpenCV has no header for read-only pixels; nothing below writes to them.
    const cv::Mat image(height, width, CV_8UC3, const_cast<std::uint8_t*>(bgr));

    SegmentationSettings segmentation;
    segmentation.mode = p_.seg_contrast != 0 ? SegmentationMode::contrast : SegmentationMode::threshold;
    segmentation.intensity = p_.seg_intensity;
    segmentation.chroma = p_.seg_chroma;
    segmentation.texture = p_.seg_texture;
    segmentation.open_px = p_.seg_open_px;
    segmentation.close_px = p_.seg_close_px;
    segmentation.area_min_px = p_.seg_area_min_px;
    segmentation.area_max = p_.seg_area_max;
    const Regions& regions = segmentation_.find(image, segmentation);

    cv::cvtColor(image, grey_, cv::COLOR_BGR2GRAY);
    SurfSettings surf;
    surf.threshold = p_.surf_threshold;
    surf.octaves = p_.surf_octaves;
    surf.step_px = p_.surf_step_px;
    surf.most = p_.surf_most;
    const Surf::Features& features = surf_.extract({grey_.data, width, height, static_cast<int>(grey_.step)}, surf);

    for (const Region& region : regions) {
        Sighting sighting;
        sighting.region = region;
        for (const SurfFeature& feature : features) {
            const float x = feature.point.x_px - static_cast<float>(region.left_px);
            const float y = feature.point.y_px - static_cast<float>(region.top_px);
            if (x >= 0.0F && y >= 0.0F && x < static_cast<float>(region.width_px) && y < static_cast<float>(region.height_px)) {
                ++sighting.features;
            }
        }
        static_cast<void>(sightings_.push(sighting));
    }
    return sightings_;
}

}  // namespace noctule
