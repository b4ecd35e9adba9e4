/// One end of a MAVLink link, named by a URL: UDP (udp_endpoint.hpp) or serial (serial_endpoint.hpp).
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

namespace noctule {

class Endpoint {
public:
    Endpoint() = default;
    Endpoint(const Endpoint&) = delete;
    Endpoint& operator=(const Endpoint&) = delete;
    virtual ~Endpoint() = default;

    /// False: error() is one line that says why.
    [[nodiscard]] virtual bool open(const std::string& url) = 0;

    /// To wait on; -1 while there is none (a serial device that is unplugged).
    [[nodiscard]] virtual int fd() const = 0;
    /// Bytes wait to be sent until the descriptor takes them: wait for that, too.
    [[nodiscard]] virtual bool wants_to_send() const { return false; }
    /// Bytes come without borders: a message may be cut anywhere.
    [[nodiscard]] virtual bool is_stream() const = 0;

    /// What has arrived, into buffer. Empty: nothing waits.
    [[nodiscard]] virtual std::span<const std::uint8_t> receive(std::span<std::uint8_t> buffer) = 0;
    /// Sends one frame, whole or not at all. False: it is lost.
    virtual bool send(std::span<const std::uint8_t> frame) = 0;
    /// Regularly, a few times a second or more: lost devices are opened again, waiting bytes sent.
    virtual void tend(std::int64_t /*monotonic_us*/) {}

    [[nodiscard]] const std::string& error() const { return error_; }
    [[nodiscard]] const std::string& url() const { return url_; }

protected:
    std::string url_;
    std::string error_;
};

/// Opens what the URL names. Null: `error` is one line that says why.
[[nodiscard]] std::unique_ptr<Endpoint> open_endpoint(const std::string& url, std::string& error);

}  // namespace noctule
