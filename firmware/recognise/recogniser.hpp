/// One camera frame in, the regions in it with their SURF features out.
///
/// docs/maths/vision.md. The regions say what stands out, the features inside the box of a region what it looks like.
/// Frame: image, px. May allocate (OpenCV). One instance a process, not thread-safe.
#pragma once

#include <array>
#include <cstdint>

#include "params.gen.hpp"
#include "recognise/segmentation.hpp"
#include "recognise/surf.hpp"

namespace noctule {

struct Sighting {
    Region region;
    std::int32_t features = 0;    ///< SURF features inside the region's box
    std::int32_t object_id = 0;   ///< id in the database, 0: not known
};

struct RecogniserCounters {
    std::uint32_t frames = 0;
    std::uint32_t refused_frames = 0;   ///< sizes that do not fit the bytes or the capacities
};

class Recogniser {
public:
    using Sightings = Bounded<Sighting, kMaxRegions>;

    /// Keeps the reference; parameters may change between two frames.
    explicit Recogniser(const Parameters& parameters) : p_(parameters) {}

    /// bgr: height x width x 3 bytes, row-major, blue green red; bytes is what is there. The pixels are only read.
    const Sightings& process(const std::uint8_t* bgr, std::size_t bytes, int width, int height);

    /// Features of the last frame, strongest first.
    [[nodiscard]] const Surf::Features& features() const { return surf_.features(); }

    [[nodiscard]] const RecogniserCounters& counters() const { return counters_; }

private:
    const Parameters& p_;
    Segmentation segmentation_;
    Surf surf_;
    cv::Mat grey_;
    Sightings sightings_;
    RecogniserCounters counters_;
};

}  // namespace noctule
