/// Pictures to H.264 by RTP: GStreamer's gst-launch-1.0 as a child that reads them from a pipe. Nothing of it is linked, so that where it is
/// not installed nothing but the video is missing, and what goes wrong in it ends the child alone.
///
/// Frames are blue green red, 8 bits, of one size. Not thread-safe; allocates at start.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace noctule {

class VideoEncoder {
public:
    struct Settings {
        std::string element;               ///< gst-launch's words for the encoder, "x264enc tune=zerolatency ..."
        std::vector<std::string> hosts;    ///< where it goes
        int port = 0;
        int width_px = 0;
        int height_px = 0;
    };

    explicit VideoEncoder(Settings settings) : settings_(std::move(settings)) {}
    VideoEncoder(const VideoEncoder&) = delete;
    VideoEncoder& operator=(const VideoEncoder&) = delete;
    ~VideoEncoder() { stop(); }

    /// What of GStreamer is not installed: a program's or an element's name; empty: nothing.
    [[nodiscard]] std::string missing() const;

    /// Starts the child. False: errno says why.
    [[nodiscard]] bool start();
    /// The child lives; one that has ended is cleared away.
    [[nodiscard]] bool running();
    /// Hands over a frame without waiting. False: the one before is not taken yet, or nobody takes it; this one is dropped.
    [[nodiscard]] bool put(std::span<const std::uint8_t> frame);
    /// Goes on with what is left of the last frame; call it a few times a frame.
    void tend();
    /// There is something left of the last frame.
    [[nodiscard]] bool busy() const { return sent_ < frame_.size(); }
    [[nodiscard]] int fd() const { return pipe_; }
    void stop();

private:
    [[nodiscard]] std::vector<std::string> words() const;

    Settings settings_;
    pid_t child_ = -1;
    int pipe_ = -1;
    std::vector<std::uint8_t> frame_;
    std::size_t sent_ = 0;
};

}  // namespace noctule
