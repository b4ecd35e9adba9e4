#include "drivers/byte_stream.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>
#include <utility>

namespace noctule {

namespace {

constexpr std::int64_t kRetry_us = 1000000;

/// termios' constant of a speed; B0: there is none.
speed_t speed_of(const int baud) {
    constexpr std::array<std::pair<int, speed_t>, 8> kSpeeds{{{9600, B9600}, {19200, B19200}, {38400, B38400}, {57600, B57600},
                                                             {115200, B115200}, {230400, B230400}, {460800, B460800}, {921600, B921600}}};
    for (const auto& [rate, constant] : kSpeeds) {
        if (rate == baud) { return constant; }
    }
    return B0;
}

bool number(const std::string_view text, int& value) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    return error == std::errc{} && end == text.data() + text.size();
}

}  // namespace

bool ByteStream::set_url(const std::string& url) {
    close();
    url_ = url;
    error_ = url + ": not like tcp:192.168.0.10:10940 or serial:/dev/ttyACM0:115200";
    serial_ = url.starts_with("serial:");
    if (!serial_ && !url.starts_with("tcp:")) { return false; }
    const std::string rest = url.substr(url.find(':') + 1);
    const std::size_t colon = rest.rfind(':');
    number_ = 115200;
    if (colon != std::string::npos && !number(std::string_view(rest).substr(colon + 1), number_)) { return false; }
    host_ = rest.substr(0, colon);
    if (host_.empty()) { return false; }
    if (serial_) {
        if (speed_of(number_) == B0) {
            error_ = url + ": " + std::to_string(number_) + " is no usual speed";
            return false;
        }
    } else {
        if (host_ == "localhost") { host_ = "127.0.0.1"; }
        in_addr address{};
        if (colon == std::string::npos || number_ < 1 || number_ > 65535 || inet_pton(AF_INET, host_.c_str(), &address) != 1) { return false; }
    }
    error_.clear();
    return true;
}

void ByteStream::lose(const int code) {
    close();
    error_ = code == 0 ? "closed by the other side" : std::strerror(code);
}

void ByteStream::close() {
    if (fd_ >= 0) { ::close(fd_); }
    fd_ = -1;
    connecting_ = false;
}

void ByteStream::open_tcp() {
    fd_ = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd_ < 0) { return lose(errno); }
    const int on = 1;
    static_cast<void>(::setsockopt(fd_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on));
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(number_));
    inet_pton(AF_INET, host_.c_str(), &address.sin_addr);
    if (::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) { return; }
    if (errno != EINPROGRESS) { return lose(errno); }
    connecting_ = true;
}

void ByteStream::open_serial() {
    fd_ = ::open(host_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd_ < 0) { return lose(errno); }
    termios settings{};
    if (::tcgetattr(fd_, &settings) != 0) { return lose(errno); }
    ::cfmakeraw(&settings);
    settings.c_cflag = (settings.c_cflag & ~static_cast<tcflag_t>(CRTSCTS | CSTOPB)) | CLOCAL | CREAD;
    ::cfsetispeed(&settings, speed_of(number_));
    ::cfsetospeed(&settings, speed_of(number_));
    if (::tcsetattr(fd_, TCSANOW, &settings) != 0) { return lose(errno); }
    ::tcflush(fd_, TCIOFLUSH);
}

bool ByteStream::keep(const std::int64_t now_us) {
    if (is_open()) { return false; }
    if (fd_ < 0) {
        if (now_us < next_try_us_) { return false; }
        next_try_us_ = now_us + kRetry_us;
        if (serial_) { open_serial(); } else { open_tcp(); }
        return is_open();
    }
    pollfd wait{fd_, POLLOUT, 0};
    if (::poll(&wait, 1, 0) <= 0) {
        if (now_us >= next_try_us_ + kRetry_us) { lose(ETIMEDOUT); }
        return false;
    }
    int code = 0;
    socklen_t size = sizeof code;
    if (::getsockopt(fd_, SOL_SOCKET, SO_ERROR, &code, &size) != 0 || code != 0) {
        lose(code != 0 ? code : errno);
        return false;
    }
    connecting_ = false;
    return true;
}

std::span<const std::uint8_t> ByteStream::receive(const std::span<std::uint8_t> buffer) {
    if (!is_open()) { return {}; }
    const ssize_t size = ::read(fd_, buffer.data(), buffer.size());
    if (size > 0) { return buffer.first(static_cast<std::size_t>(size)); }
    if (size == 0) {
        lose(0);
    } else if (errno != EAGAIN && errno != EINTR) {
        lose(errno);
    }
    return {};
}

bool ByteStream::send(const std::string_view text) {
    if (!is_open()) { return false; }
    const ssize_t size = ::write(fd_, text.data(), text.size());  // commands are short: what does not fit now never will
    if (size == static_cast<ssize_t>(text.size())) { return true; }
    lose(size < 0 ? errno : EIO);
    return false;
}

}  // namespace noctule
