/// UDP endpoints as MAVLink tools name them: udpin:HOST:PORT listens and answers whoever spoke last, udpout:HOST:PORT speaks first.
#pragma once

#include <netinet/in.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

namespace noctule {

class UdpEndpoint {
public:
    UdpEndpoint() = default;
    UdpEndpoint(const UdpEndpoint&) = delete;
    UdpEndpoint& operator=(const UdpEndpoint&) = delete;
    ~UdpEndpoint();

    /// Opens the socket, non-blocking. An IPv4 address or "localhost". False: error() is one line that says why.
    [[nodiscard]] bool open(const std::string& url);

    [[nodiscard]] const std::string& error() const { return error_; }
    [[nodiscard]] const std::string& url() const { return url_; }
    [[nodiscard]] int fd() const { return fd_; }
    /// Speaks first (udpout).
    [[nodiscard]] bool is_client() const { return client_; }

    /// One waiting datagram into buffer. Empty: none waits. What fills the buffer was cut off by the system.
    [[nodiscard]] std::span<const std::uint8_t> receive(std::span<std::uint8_t> buffer);

    /// Sends a datagram to the peer. False: no peer yet, or nobody listens there (normal for a ground station that is not up).
    bool send(std::span<const std::uint8_t> bytes);

private:
    int fd_ = -1;
    bool client_ = false;
    bool has_peer_ = false;
    sockaddr_in peer_{};
    std::string url_;
    std::string error_;
};

}  // namespace noctule
