#include "app/vision_node.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace noctule {

static_assert(kMaxRegions == static_cast<std::size_t>(objects_t::MAX_REGIONS));

void VisionNode::receive(const nav_t& nav) {
    VehiclePose pose;
    pose.t_us = nav.t_us;
    pose.x_m = static_cast<double>(nav.x_m);
    pose.y_m = static_cast<double>(nav.y_m);
    pose.z_m = static_cast<double>(nav.z_m);
    pose.roll_rad = static_cast<double>(nav.roll_rad);
    pose.pitch_rad = static_cast<double>(nav.pitch_rad);
    pose.yaw_rad = static_cast<double>(nav.yaw_rad);
    pose.position_var_m2 = static_cast<double>(std::max(nav.covariance_xyyaw[0], nav.covariance_xyyaw[3]));
    pose.yaw_var_rad2 = static_cast<double>(std::max(0.0F, nav.covariance_xyyaw[5]));
    pose.ground_z_m = static_cast<double>(nav.ground_z_m);
    pose.ceiling_z_m = static_cast<double>(nav.ceiling_z_m);
    pose.floor = nav.floor;
    pose.reset_counter = nav.reset_counter;
    const double sum = pose.x_m + pose.y_m + pose.z_m + pose.roll_rad + pose.pitch_rad + pose.yaw_rad + pose.yaw_var_rad2;
    pose.usable = nav.quality >= 0 && std::isfinite(sum);
    recogniser_.history().add(pose);
    newest_pose_us_ = nav.t_us;
}

void VisionNode::receive(const scan_t& scan) {
    if (scan.count <= 0 || scan.count > static_cast<std::int32_t>(kMaxBeams)) { return; }
    sweep_.t_us = scan.t_us;
    sweep_.count = scan.count;
    sweep_.time_increment_us = scan.time_increment_us;
    sweep_.bearing_first_rad = scan.bearing_first_rad;
    sweep_.bearing_increment_rad = scan.bearing_increment_rad;
    std::copy_n(scan.range_m, scan.count, sweep_.range_m.begin());
    recogniser_.history().add(sweep_);
}

void VisionNode::fill_head(objects_t& out) {
    out = objects_t{};
    out.t_us = image_.t_us;
    out.seq = answers_++;
    out.image_seq = image_.seq;
    out.objects = recogniser_.memory().confirmed();
    out.dropped = static_cast<std::int32_t>(dropped_);
}

bool VisionNode::receive(const image_t& image, objects_t& given_way) {
    const bool gave_way = waiting_;
    if (gave_way) {
        ++dropped_;
        fill_head(given_way);
    }
    image_ = image;
    waiting_ = true;
    return gave_way;
}

const objects_t& VisionNode::look() {
    const auto& sightings = recogniser_.process(image_.bgr, sizeof image_.bgr, image_.width, image_.height, image_.t_us);
    waiting_ = false;
    fill_head(answer_);
    answer_.looked = 1;
    for (const Sighting& s : sightings) {
        const std::int32_t i = answer_.count++;
        answer_.u_px[i] = static_cast<std::int32_t>(s.region.x_px + 0.5F);
        answer_.v_px[i] = static_cast<std::int32_t>(s.region.y_px + 0.5F);
        answer_.area_px[i] = s.region.area_px;
        answer_.object_id[i] = static_cast<std::int32_t>(s.object_id);
        const bool placed = s.place.source != RangeSource::none;
        const auto told = [&](const double v) { return placed ? static_cast<float>(v) : std::numeric_limits<float>::quiet_NaN(); };
        answer_.x_m[i] = told(s.place.x_m);
        answer_.y_m[i] = told(s.place.y_m);
        answer_.z_m[i] = told(s.place.z_m);
        answer_.along_sigma_m[i] = told(s.place.along_sigma_m);
    }
    return answer_;
}

}  // namespace noctule
