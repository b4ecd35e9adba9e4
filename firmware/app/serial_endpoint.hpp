/// A serial line: serial:DEVICE:BAUD or serial:DEVICE:BAUD:rtscts (hardware flow control). 8 bits, no parity, one stop bit.
///
/// The device may be missing at start or vanish (USB): it is tried again once a second. Bytes that the line cannot take at once wait in a
/// buffer; a frame that does not fit there whole is dropped and counted, so that a slow line never holds up the flight.
#pragma once

#include <array>
#include <cstddef>

#include "app/endpoint.hpp"

namespace noctule {

class SerialEndpoint final : public Endpoint {
public:
    struct Counters {
        std::uint32_t dropped_frames = 0;
        std::uint32_t reconnects = 0;
    };

    ~SerialEndpoint() override;

    /// False for a URL that makes no sense only; a device that is not there is waited for.
    [[nodiscard]] bool open(const std::string& url) override;
    [[nodiscard]] int fd() const override { return fd_; }
    [[nodiscard]] bool wants_to_send() const override { return waiting_ > 0; }
    [[nodiscard]] bool is_stream() const override { return true; }
    [[nodiscard]] std::span<const std::uint8_t> receive(std::span<std::uint8_t> buffer) override;
    bool send(std::span<const std::uint8_t> frame) override;
    void tend(std::int64_t monotonic_us) override;
    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    void connect();
    void disconnect();
    void flush();

    std::string device_;
    unsigned speed_ = 0;        ///< termios code
    bool flow_control_ = false;
    bool was_open_ = false;
    int fd_ = -1;
    std::int64_t next_try_us_ = 0;
    std::array<std::uint8_t, 8192> buffer_{};
    std::size_t waiting_ = 0;
    Counters counters_;
};

}  // namespace noctule
