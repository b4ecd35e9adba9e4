/// A TCP connection or a serial line that comes back by itself.
///
/// "tcp:ADDRESS:PORT" (IPv4 address or localhost) or "serial:PATH[:BAUD]" (raw, 8N1; 115200 unless given, of no meaning over USB).
/// Non-blocking. After a loss keep() tries again once a second. Host times: monotonic microseconds.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace noctule {

class ByteStream {
public:
    ByteStream() = default;
    ByteStream(const ByteStream&) = delete;
    ByteStream& operator=(const ByteStream&) = delete;
    ~ByteStream() { close(); }

    /// Remembers where to; opens nothing. False: error() says in one line what is wrong with it.
    [[nodiscard]] bool set_url(const std::string& url);

    /// Opens, or sees an opening through. True: it has opened just now.
    [[nodiscard]] bool keep(std::int64_t now_us);

    [[nodiscard]] bool is_open() const { return fd_ >= 0 && !connecting_; }
    /// For poll(): -1 while closed. Wait for POLLOUT too while is_opening().
    [[nodiscard]] int fd() const { return fd_; }
    [[nodiscard]] bool is_opening() const { return fd_ >= 0 && connecting_; }

    /// What has come, at most the buffer. Empty: nothing waits, or the line is gone (then is_open() is false).
    [[nodiscard]] std::span<const std::uint8_t> receive(std::span<std::uint8_t> buffer);
    /// False: not everything left; the line is then closed.
    bool send(std::string_view text);
    void close();

    /// The last reason why it is not open.
    [[nodiscard]] const std::string& error() const { return error_; }
    [[nodiscard]] const std::string& url() const { return url_; }

private:
    void lose(int code);
    void open_tcp();
    void open_serial();

    std::string url_;
    std::string host_;   ///< address, or path of the device
    int number_ = 0;     ///< port, or bits per second
    bool serial_ = false;
    bool connecting_ = false;
    int fd_ = -1;
    std::int64_t next_try_us_ = 0;
    std::string error_;
};

}  // namespace noctule
