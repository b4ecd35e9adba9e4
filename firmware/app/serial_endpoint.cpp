#include "app/serial_endpoint.hpp"

#include <fcntl.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <utility>

namespace noctule {

namespace {

constexpr std::int64_t kTryAgain_us = 1000000;

constexpr std::pair<const char*, unsigned> kSpeeds[] = {{"9600", B9600},       {"19200", B19200},     {"38400", B38400},     {"57600", B57600},
                                                        {"115200", B115200},   {"230400", B230400},   {"460800", B460800},   {"500000", B500000},
                                                        {"921600", B921600},   {"1000000", B1000000}, {"1500000", B1500000}, {"2000000", B2000000},
                                                        {"3000000", B3000000}};

}  // namespace

SerialEndpoint::~SerialEndpoint() {
    if (fd_ >= 0) { ::close(fd_); }
}

bool SerialEndpoint::open(const std::string& url) {
    url_ = url;
    std::string rest = url.substr(url.find(':') + 1);
    if (rest.size() > 7 && rest.compare(rest.size() - 7, 7, ":rtscts") == 0) {
        flow_control_ = true;
        rest.resize(rest.size() - 7);
    }
    const std::size_t colon = rest.rfind(':');
    const std::string baud = colon == std::string::npos ? "" : rest.substr(colon + 1);
    const auto* speed = std::find_if(std::begin(kSpeeds), std::end(kSpeeds), [&](const auto& s) { return baud == s.first; });
    if (colon == 0 || speed == std::end(kSpeeds)) {
        error_ = "'" + url + "' is no serial endpoint: say serial:DEVICE:BAUD[:rtscts], BAUD 9600 to 3000000";
        return false;
    }
    device_ = rest.substr(0, colon);
    speed_ = speed->second;
    connect();
    if (fd_ < 0) { std::fprintf(stderr, "noctule: %s: %s, waiting for it\n", device_.c_str(), std::strerror(errno)); }
    return true;
}

void SerialEndpoint::connect() {
    fd_ = ::open(device_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd_ < 0) { return; }
    termios line{};
    if (::tcgetattr(fd_, &line) != 0) {
        ::close(std::exchange(fd_, -1));
        return;
    }
    ::cfmakeraw(&line);
    line.c_cflag |= CLOCAL | CREAD;
    line.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | CRTSCTS);
    if (flow_control_) { line.c_cflag |= CRTSCTS; }
    line.c_cc[VMIN] = 0;
    line.c_cc[VTIME] = 0;
    ::cfsetispeed(&line, speed_);
    ::cfsetospeed(&line, speed_);
    if (::tcsetattr(fd_, TCSANOW, &line) != 0) {
        ::close(std::exchange(fd_, -1));
        return;
    }
    ::tcflush(fd_, TCIOFLUSH);
    if (was_open_) {
        ++counters_.reconnects;
        std::fprintf(stderr, "noctule: %s is back\n", device_.c_str());
    }
    was_open_ = true;
}

void SerialEndpoint::disconnect() {
    ::close(std::exchange(fd_, -1));
    waiting_ = 0;
    std::fprintf(stderr, "noctule: %s is gone, waiting for it\n", device_.c_str());
}

std::span<const std::uint8_t> SerialEndpoint::receive(const std::span<std::uint8_t> buffer) {
    if (fd_ < 0) { return {}; }
    const ssize_t got = ::read(fd_, buffer.data(), buffer.size());
    if (got > 0) { return buffer.first(static_cast<std::size_t>(got)); }
    if (got < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR) { disconnect(); }
    return {};
}

bool SerialEndpoint::send(const std::span<const std::uint8_t> frame) {
    if (fd_ < 0) { return false; }
    if (waiting_ + frame.size() > buffer_.size()) {
        ++counters_.dropped_frames;
        return false;
    }
    std::copy(frame.begin(), frame.end(), buffer_.begin() + static_cast<std::ptrdiff_t>(waiting_));
    waiting_ += frame.size();
    flush();
    return true;
}

void SerialEndpoint::flush() {
    if (fd_ < 0 || waiting_ == 0) { return; }
    const ssize_t sent = ::write(fd_, buffer_.data(), waiting_);
    if (sent > 0) {
        std::memmove(buffer_.data(), buffer_.data() + sent, waiting_ - static_cast<std::size_t>(sent));
        waiting_ -= static_cast<std::size_t>(sent);
    } else if (sent < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR) {
        disconnect();
    }
}

void SerialEndpoint::tend(const std::int64_t monotonic_us) {
    if (fd_ >= 0) { return flush(); }
    if (monotonic_us < next_try_us_) { return; }
    next_try_us_ = monotonic_us + kTryAgain_us;
    connect();
}

}  // namespace noctule
