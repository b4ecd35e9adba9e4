/// The recognition fed with messages: NAV and SCAN of the flight bus, IMAGE of the camera bus, OBJECTS out.
///
/// A frame waits until a pose of its time or later has come; the newest frame alone waits, an older one gives way and is answered empty (counted).
/// No clock and no socket in here. One thread.
#pragma once

#include <cstdint>
#include <string>

#include "lcmtypes/noctule/image_t.hpp"
#include "lcmtypes/noctule/nav_t.hpp"
#include "lcmtypes/noctule/objects_t.hpp"
#include "lcmtypes/noctule/scan_t.hpp"
#include "recognise/recogniser.hpp"

namespace noctule {

class VisionNode {
public:
    explicit VisionNode(const Parameters& parameters) : recogniser_(parameters) {}

    void receive(const nav_t& nav);
    void receive(const scan_t& scan);

    /// Takes a frame. True: one that waited gave way, given_way is its answer.
    [[nodiscard]] bool receive(const image_t& image, objects_t& given_way);

    [[nodiscard]] bool waiting() const { return waiting_; }

    /// A pose of the waiting frame's time or later is there.
    [[nodiscard]] bool ready() const { return waiting_ && newest_pose_us_ >= image_.t_us; }

    /// Looks at the waiting frame, ready or not (without its pose nothing is entered); its answer.
    const objects_t& look();

    [[nodiscard]] Recogniser& recogniser() { return recogniser_; }
    [[nodiscard]] std::uint64_t dropped() const { return dropped_; }

private:
    void fill_head(objects_t& out);

    Recogniser recogniser_;
    image_t image_{};
    objects_t answer_{};
    LaserSweep sweep_{};
    std::int64_t newest_pose_us_ = -1;
    bool waiting_ = false;
    std::uint64_t dropped_ = 0;
    std::int32_t answers_ = 0;
};

}  // namespace noctule
