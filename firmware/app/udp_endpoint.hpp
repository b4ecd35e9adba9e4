/// UDP endpoints as MAVLink tools name them: udpin:HOST:PORT listens and answers whoever spoke last, udpout:HOST:PORT speaks first.
#pragma once

#include <netinet/in.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "app/endpoint.hpp"

namespace noctule {

class UdpEndpoint final : public Endpoint {
public:
    ~UdpEndpoint() override;

    /// Opens the socket, non-blocking. An IPv4 address or "localhost".
    [[nodiscard]] bool open(const std::string& url) override;

    [[nodiscard]] int fd() const override { return fd_; }
    [[nodiscard]] bool is_stream() const override { return false; }
    /// Speaks first (udpout).
    [[nodiscard]] bool is_client() const { return client_; }

    /// One waiting datagram. What fills the buffer was cut off by the system.
    [[nodiscard]] std::span<const std::uint8_t> receive(std::span<std::uint8_t> buffer) override;

    /// Sends a datagram to the peer. False: no peer yet, or nobody listens there (normal for a ground station that is not up).
    bool send(std::span<const std::uint8_t> bytes) override;

private:
    int fd_ = -1;
    bool client_ = false;
    bool has_peer_ = false;
    sockaddr_in peer_{};
};

}  // namespace noctule
