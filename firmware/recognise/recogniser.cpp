#include "recognise/recogniser.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

namespace noctule {
namespace {

constexpr double kLevel_m = 0.04;  // change of height between two frames
constexpr double kStorey_m = 1.0;  // under the floor, at least
constexpr double kAbove_m = 1.8;   // over the lowest ceiling of the floor, at least: a slab and the room over it
constexpr double kNear_px = 8.0;   // a region this close to where an object should show may be it

}  // namespace

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
    surf_.extract({grey_.data, width, height, static_cast<int>(grey_.step)}, surf);

    for (const Region& region : regions) {
        Sighting sighting;
        sighting.region = region;
        sighting.features = static_cast<std::int32_t>(features_in(region).size());
        static_cast<void>(sightings_.push(sighting));
    }
    return sightings_;
}

std::span<const SurfFeature> Recogniser::features_in(const Region& region) {
    inside_.clear();
    for (const SurfFeature& feature : surf_.features()) {
        const float x = feature.point.x_px - static_cast<float>(region.left_px);
        const float y = feature.point.y_px - static_cast<float>(region.top_px);
        if (x >= 0.0F && y >= 0.0F && x < static_cast<float>(region.width_px) && y < static_cast<float>(region.height_px)) {
            static_cast<void>(inside_.push(feature));
        }
    }
    return {inside_.begin(), inside_.size()};
}

const Recogniser::Sightings& Recogniser::process(const std::uint8_t* const bgr, const std::size_t bytes, const int width, const int height,
                                                 const std::int64_t t_us) {
    const std::uint32_t before = counters_.frames;
    process(bgr, bytes, width, height);
    if (counters_.frames != before) { enter(cv::Mat(height, width, CV_8UC3, const_cast<std::uint8_t*>(bgr)), t_us); }
    return sightings_;
}

void Recogniser::enter(const cv::Mat& image, const std::int64_t t_us) {
    VehiclePose pose;
    if (!history_.at(t_us, pose) || image.cols != camera_.width || image.rows != camera_.height) {
        ++counters_.without_pose;
        return;
    }
    placer_.start(camera_, pose, history_.points(t_us, {static_cast<double>(p_.lidar_x_m), static_cast<double>(p_.lidar_y_m),
                                                        static_cast<double>(p_.lidar_z_m), static_cast<double>(p_.lidar_yaw_rad)}));
    parts_.clear();
    for (const Sighting& sighting : sightings_) { placer_.find(segmentation_.labels(), sighting.region, parts_); }
    sightings_.clear();
    std::array<std::int64_t, kMaxRegions> ids{};
    std::size_t n = 0;
    for (const Part& part : parts_) {
        Observation seen;
        seen.part = part;
        seen.signature = describe_region(image, segmentation_.labels(), part.region, segmentation_.ground());
        seen.features = features_in(part.region);
        seen.t_us = t_us;
        seen.floor = pose.floor;
        seen.direction_rad = std::remainder(part.place.bearing_rad + 3.141592653589793, 6.283185307179586);
        seen.sharpness = std::min(1.0, static_cast<double>(seen.features.size()) / 20.0);
        const int index = memory_.enter(seen);
        if (index >= 0) {
            ids[n] = memory_.objects()[static_cast<std::size_t>(index)].id;
            store_.note(ids[n], seen, pose);
        }
        static_cast<void>(sightings_.push({part.region, static_cast<std::int32_t>(seen.features.size()), ids[n], part.place}));
        ++n;
    }
    watch_openings(pose);
    look_for_absent(pose.floor);
    memory_.tidy(t_us);
    if (store_.is_open()) { static_cast<void>(store_.commit(memory_, image, t_us)); }
    // What is told to others is sure: a candidate has no id yet.
    for (Sighting& sighting : sightings_) {
        const bool sure = std::any_of(memory_.objects().begin(), memory_.objects().end(),
                                      [&](const KnownObject& o) { return o.confirmed && o.id == sighting.object_id; });
        if (!sure) { sighting.object_id = 0; }
    }
}

// In level flight only: in a shaft the height over the ground grows, too.
void Recogniser::watch_openings(const VehiclePose& pose) {
    if (last_pose_.t_us > 0 && pose.floor == last_pose_.floor && pose.floor >= 0 && std::fabs(pose.z_m - last_pose_.z_m) < kLevel_m) {
        if (std::isfinite(pose.ground_z_m)) {
            memory_.note_ground(pose.floor, pose.x_m, pose.y_m, pose.z_m - pose.ground_z_m > static_cast<double>(p_.cruise_height_m) + kStorey_m);
        }
        if (std::isfinite(pose.ceiling_z_m) && pose.floor < static_cast<std::int32_t>(kMaxFloors)) {
            double& lowest_m = lowest_ceiling_m_[static_cast<std::size_t>(pose.floor)];
            lowest_m = std::min(lowest_m, pose.ceiling_z_m);
            memory_.note_ceiling(pose.floor, pose.x_m, pose.y_m, pose.z_m, pose.ceiling_z_m > lowest_m + kAbove_m);
        }
    }
    last_pose_ = pose;
}

void Recogniser::look_for_absent(const std::int32_t floor) {
    const auto& objects = memory_.objects();
    for (std::size_t i = 0; i < objects.size(); ++i) {
        const KnownObject& o = objects[i];
        double u_px = 0.0;
        double v_px = 0.0;
        if (!o.placed || o.floor != floor || !placer_.should_show({o.x_m, o.y_m, o.z_m}, u_px, v_px)) { continue; }
        // Any region there may be it, whatever it was taken for.
        const bool something = std::any_of(parts_.begin(), parts_.end(), [&](const Part& part) {
            const Region& r = part.region;
            return u_px > r.left_px - kNear_px && u_px < r.left_px + r.width_px + kNear_px && v_px > r.top_px - kNear_px &&
                   v_px < r.top_px + r.height_px + kNear_px;
        });
        if (!something) { memory_.note_absent(i, placer_.eye_m()); }
    }
}

}  // namespace noctule
