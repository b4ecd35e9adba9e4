#include "app/udp_endpoint.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>

namespace noctule {

namespace {

constexpr int kReceiveBytes = 1 << 20;  // a burst of a tick at ten times real time fits many times over

/// HOST:PORT. False when it is not that.
bool parse_address(const std::string& text, sockaddr_in& address) {
    const std::size_t colon = text.rfind(':');
    if (colon == std::string::npos) { return false; }
    std::string host = text.substr(0, colon);
    if (host == "localhost") { host = "127.0.0.1"; }
    unsigned port = 0;
    const char* end = text.data() + text.size();
    const auto parsed = std::from_chars(text.data() + colon + 1, end, port);
    if (parsed.ec != std::errc{} || parsed.ptr != end || port == 0 || port > 65535) { return false; }
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    return inet_pton(AF_INET, host.c_str(), &address.sin_addr) == 1;
}

}  // namespace

UdpEndpoint::~UdpEndpoint() {
    if (fd_ >= 0) { ::close(fd_); }
}

bool UdpEndpoint::open(const std::string& url) {
    url_ = url;
    const bool server = url.rfind("udpin:", 0) == 0;
    client_ = url.rfind("udpout:", 0) == 0;
    sockaddr_in address{};
    if ((!server && !client_) || !parse_address(url.substr(url.find(':') + 1), address)) {
        error_ = "'" + url + "' is no endpoint: say udpin:ADDRESS:PORT, udpout:ADDRESS:PORT or serial:DEVICE:BAUD";
        return false;
    }
    fd_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd_ < 0) {
        error_ = std::string("cannot make a socket: ") + std::strerror(errno);
        return false;
    }
    ::setsockopt(fd_, SOL_SOCKET, SO_RCVBUF, &kReceiveBytes, sizeof kReceiveBytes);
    if (client_) {
        peer_ = address;
        has_peer_ = true;
        return true;
    }
    if (::bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
        error_ = "cannot listen on " + url + ": " + std::strerror(errno);
        return false;
    }
    return true;
}

std::span<const std::uint8_t> UdpEndpoint::receive(const std::span<std::uint8_t> buffer) {
    sockaddr_in from{};
    socklen_t length = sizeof from;
    const ssize_t got = ::recvfrom(fd_, buffer.data(), buffer.size(), 0, reinterpret_cast<sockaddr*>(&from), &length);
    if (got <= 0) { return {}; }
    if (!client_) {
        peer_ = from;
        has_peer_ = true;
    }
    return buffer.first(static_cast<std::size_t>(got));
}

bool UdpEndpoint::send(const std::span<const std::uint8_t> bytes) {
    if (!has_peer_) { return false; }
    return ::sendto(fd_, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&peer_), sizeof peer_) == static_cast<ssize_t>(bytes.size());
}

}  // namespace noctule
