/// One camera frame in, the objects in it out: known again, placed on the map, kept in the database.
///
/// docs/maths/vision.md. The regions say what stands out, laser, floor and pose where it is, SURF, colour and place together which one it is.
/// Frames: image [px], Map. May allocate (OpenCV, SQLite). One instance a process, not thread-safe.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>

#include "core/capacity.hpp"
#include "params.gen.hpp"
#include "recognise/camera_model.hpp"
#include "recognise/object_memory.hpp"
#include "recognise/object_store.hpp"
#include "recognise/place.hpp"
#include "recognise/pose_history.hpp"
#include "recognise/segmentation.hpp"
#include "recognise/surf.hpp"

namespace noctule {

struct Sighting {
    Region region;
    std::int32_t features = 0;    ///< SURF features inside the region's box
    std::int64_t object_id = 0;   ///< id in the database, 0: not known, or not yet sure
    Placement place;
};

struct RecogniserCounters {
    std::uint32_t frames = 0;
    std::uint32_t refused_frames = 0;   ///< sizes that do not fit the bytes or the capacities
    std::uint32_t without_pose = 0;     ///< frames whose pose was not known: nothing was entered
};

class Recogniser {
public:
    using Sightings = Bounded<Sighting, kMaxRegions>;

    /// Keeps the reference; parameters may change between two frames.
    explicit Recogniser(const Parameters& parameters) : p_(parameters) { lowest_ceiling_m_.fill(std::numeric_limits<double>::infinity()); }

    /// Regions and features alone. bgr: height x width x 3 bytes, row-major, blue green red; bytes is what is there. The pixels are only read.
    const Sightings& process(const std::uint8_t* bgr, std::size_t bytes, int width, int height);

    /// With the time of the frame: places the regions with history(), enters them into the memory and writes the store, if it is open.
    const Sightings& process(const std::uint8_t* bgr, std::size_t bytes, int width, int height, std::int64_t t_us);

    /// Features of the last frame, strongest first.
    [[nodiscard]] const Surf::Features& features() const { return surf_.features(); }

    [[nodiscard]] PoseHistory& history() { return history_; }
    [[nodiscard]] ObjectMemory& memory() { return memory_; }
    [[nodiscard]] ObjectStore& store() { return store_; }
    [[nodiscard]] CameraModel& camera() { return camera_; }
    [[nodiscard]] const RecogniserCounters& counters() const { return counters_; }

private:
    [[nodiscard]] std::span<const SurfFeature> features_in(const Region& region);
    void enter(const cv::Mat& image, std::int64_t t_us);
    void look_for_absent(std::int32_t floor);

    const Parameters& p_;
    CameraModel camera_;
    Segmentation segmentation_;
    Surf surf_;
    cv::Mat grey_;
    PoseHistory history_;
    Placer placer_;
    Parts parts_;
    Bounded<SurfFeature, kMaxSurfFeatures> inside_;
    void watch_openings(const VehiclePose& pose);
    VehiclePose last_pose_;            ///< of the frame before; t_us 0: none
    std::array<double, kFloorSlots> lowest_ceiling_m_{};   ///< over the vehicle, of each floor; infinite: none seen yet
    ObjectMemory memory_;
    ObjectStore store_;
    Sightings sightings_;
    RecogniserCounters counters_;
};

}  // namespace noctule
