/// A Hokuyo laser behind a byte stream: start-up, scans, time-outs. The stream itself (TCP, USB) is byte_stream.hpp.
///
/// Usage: connected(now), then receive() what comes and tick() now and then; when failed() says so close the stream, open it anew
/// and begin with connected(). Commands leave through the sink, scans arrive there. Host times are monotonic microseconds, passed
/// in; no clock is read, no heap. Commands and statuses: SCIP 2.0, sections 8.1 (MD), 8.3 (BM), 8.4 (QT), 8.12 (PP).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "drivers/scip.hpp"

namespace noctule {

struct HokuyoSink {
    virtual ~HokuyoSink() = default;
    virtual void send(std::string_view command) = 0;
    /// A whole, checked measurement. sensor_us: time of its last beam on the sensor's clock, wraps undone.
    virtual void scan(const scip::Measurement& measurement, std::int64_t sensor_us, std::int64_t arrival_us) = 0;
};

/// What is asked of the sensor; set before connected().
struct HokuyoWish {
    float rate_hz = 20.0F;  ///< scans a second; a faster sensor leaves scans out
};

class Hokuyo {
public:
    struct Counters {
        std::uint32_t scans = 0;
        std::uint32_t bad_sum = 0;
        std::uint32_t bad_form = 0;   ///< other things wrong with a message: length, characters, no status
        std::uint32_t overlong = 0;
        std::uint32_t repeated = 0;   ///< same stamp as the scan before: not passed on
        std::uint32_t sensor_errors = 0;  ///< scans answered with a status that tells of trouble
    };

    explicit Hokuyo(HokuyoSink& sink, const HokuyoWish& wish = {}) : sink_(sink), wish_(wish) {}

    /// The stream is open: begins the start-up.
    void connected(std::int64_t now_us);
    void receive(std::span<const std::uint8_t> bytes, std::int64_t now_us);
    /// Time-outs. Call at least ten times a second.
    void tick(std::int64_t now_us);

    /// Nothing more is to be expected of this connection; why() says in a few words why.
    [[nodiscard]] bool failed() const { return stage_ == Stage::failed; }
    [[nodiscard]] const char* why() const { return why_; }
    [[nodiscard]] bool measuring() const { return stage_ == Stage::measuring; }

    /// Known once measuring.
    [[nodiscard]] const scip::SensorParameters& parameters() const { return parameters_; }
    [[nodiscard]] std::size_t beams() const { return static_cast<std::size_t>(last_step_ - parameters_.first_step + 1); }
    [[nodiscard]] float bearing_first_rad() const;
    [[nodiscard]] float bearing_increment_rad() const;
    [[nodiscard]] float time_increment_us() const;
    [[nodiscard]] float rate_hz() const;
    /// Beams that the sensor has beyond kMaxBeams; they are not asked for.
    [[nodiscard]] std::int32_t beams_left_out() const { return parameters_.last_step - last_step_; }
    [[nodiscard]] Counters counters() const;

private:
    enum class Stage : std::uint8_t { idle, quieting, switching, describing, lighting, starting, measuring, failed };

    void enter(Stage stage, std::int64_t now_us);
    void fail(const char* why);
    void count(scip::Fault fault);
    void on_message(std::string_view message, std::int64_t now_us);
    void on_measuring(std::string_view message, std::int64_t now_us);
    void on_scan(std::string_view rest, std::int64_t now_us);
    void begin_measuring(std::int64_t now_us);

    HokuyoSink& sink_;
    HokuyoWish wish_;
    Stage stage_ = Stage::idle;
    const char* why_ = "";
    std::int64_t stage_since_us_ = 0;
    int tries_ = 0;
    scip::MessageCutter cutter_;
    scip::SensorParameters parameters_;
    std::int32_t last_step_ = 0;
    std::int32_t scans_between_ = 0;         ///< left out between two
    std::array<char, 24> command_{};         ///< MD with its parameters
    std::size_t command_size_ = 0;
    scip::Measurement measurement_;
    bool stamped_ = false;
    std::uint32_t last_clock_ms_ = 0;
    std::int64_t clock_ms_ = 0;
    Counters counters_;
};

}  // namespace noctule
