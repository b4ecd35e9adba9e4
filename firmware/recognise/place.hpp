/// Where a region of a frame stands in the building: bearing from the camera, range from the laser, the floor or the wall behind.
///
/// Model: docs/maths/vision.md, "Place", equations (14) to (18). Frame Map. No heap, not thread-safe.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include <opencv2/core.hpp>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "recognise/camera_model.hpp"
#include "recognise/pose_history.hpp"
#include "recognise/segmentation.hpp"

namespace noctule {

enum class RangeSource : std::int32_t { none = 0, laser = 1, floor = 2, wall = 3 };

struct Placement {
    RangeSource source = RangeSource::none;  ///< none: no place, the fields below do not hold
    double x_m = 0.0;                 ///< centre of the footprint, and height of the middle
    double y_m = 0.0;
    double z_m = 0.0;
    Vec3 eye_m{};                     ///< where the camera was
    double slope = 0.0;               ///< of the ray to the middle: up over ahead
    double bearing_rad = 0.0;         ///< from the camera to the centre
    double distance_m = 0.0;          ///< horizontal, camera to centre
    double along_sigma_m = 0.0;       ///< standard deviation along the bearing
    double across_sigma_m = 0.0;      ///< and across
    double width_m = 0.0;             ///< seen width
    double height_m = 0.0;            ///< seen height
    bool whole = false;               ///< both sides in the picture and not hidden: the width holds, the bearing is the centre's
    bool tall = false;                ///< top and bottom in the picture: the height holds
};

/// A part of a region that the laser saw as one thing.
struct Part {
    Region region;                    ///< of the part's own pixels
    Placement place;
};

using Parts = Bounded<Part, kMaxRegions>;

class Placer {
public:
    /// Takes in what belongs to the frame: its pose and the laser's points then (in the order of the beams).
    void start(const CameraModel& camera, const VehiclePose& pose, std::span<const Vec3> points_map_m);

    /// Parts of a region; usually one, more where the laser sees a step in depth inside it. labels as Segmentation::labels().
    /// A part without a place has RangeSource::none.
    void find(const cv::Mat& labels, const Region& region, Parts& out) const;

    /// Whether a point of the map should be in the picture: well inside the frame, near enough, nothing that the laser sees before it. Its pixel.
    [[nodiscard]] bool should_show(const Vec3& point_map_m, double& u_px, double& v_px) const;

    /// Where the camera is.
    [[nodiscard]] const Vec3& eye_m() const { return eye_; }

private:
    struct Hit {
        double u_px = 0.0;
        double v_px = 0.0;
        double distance_m = 0.0;      ///< horizontal, from the camera
        Vec3 map{};
    };

    [[nodiscard]] Placement place(const cv::Mat& labels, const Region& region) const;
    [[nodiscard]] double bearing_of(double u_px, double v_px, double& slope) const;
    [[nodiscard]] double outside_depth(double u_px, double toward) const;

    /// Straight line through the hits of a region, seen from above.
    struct Face {
        double x_m = 0.0;             ///< middle of the hits
        double y_m = 0.0;
        double nx = 0.0;              ///< normal, length 1
        double ny = 0.0;
        double spread_m = 0.0;        ///< of the hits about the line
    };
    [[nodiscard]] bool flush_with(const Face& face, double left_px, double right_px) const;

    const CameraModel* camera_ = nullptr;
    VehiclePose pose_{};
    Vec3 eye_{};
    Bounded<Hit, kMaxBeams> hits_;    ///< those in the picture, from right to left
};

}  // namespace noctule
