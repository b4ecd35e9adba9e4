/// Publish and subscribe the generated LCM types without heap after start-up.
///
/// Usage:
///     LcmBus bus;
///     if (!bus.open("udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2097152")) { say bus.error(); exit 2; }
///     auto on_scan = [&](const scan_t& scan) { ... };            // any callable; the bus keeps a reference to it
///     bus.subscribe<scan_t>("SCAN", on_scan);                    // false: table full or channel name too long
///     bus.publish("NAV", nav);                                   // false: not sent (counted)
///     while (running) { bus.handle(100); }                       // handlers run here; or poll() bus.fd() and handle(0)
///
/// Messages are handled in the order in which they arrived on the bus, over all channels together.
/// Publishing encodes into a buffer inside the bus and hands raw bytes to LCM; receiving decodes into one fixed message a type.
/// LCM itself allocates nothing for messages up to 60 kB and channel names up to 15 characters, so both are enforced here.
/// Start-up (open, subscribe, the first handle) allocates. One thread; LCM's own reader thread only fills its queue.
#pragma once

#include <lcm/lcm.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "core/capacity.hpp"

namespace noctule {

class LcmBus {
public:
    struct Counters {
        std::uint64_t published = 0;
        std::uint64_t publish_failed = 0;  ///< refused by the socket, or larger than kMaxLcmBytes
        std::uint64_t received = 0;
        std::uint64_t undecodable = 0;     ///< bytes that are not the type subscribed to (truncated, other fingerprint)
    };

    LcmBus() = default;
    LcmBus(const LcmBus&) = delete;
    LcmBus& operator=(const LcmBus&) = delete;
    ~LcmBus() { close(); }

    /// Joins the bus. url as LCM takes it (udpm://ADDRESS:PORT?ttl=0&recv_buf_size=N). False: error() says why, in one line.
    [[nodiscard]] bool open(const char* url);

    void close();

    [[nodiscard]] bool is_open() const { return lcm_ != nullptr; }

    /// Why open() failed; empty otherwise.
    [[nodiscard]] const char* error() const { return error_.data(); }

    /// Readable when a message waits; -1 when closed.
    [[nodiscard]] int fd() const { return lcm_ != nullptr ? lcm_get_fileno(lcm_) : -1; }

    /// Calls handler(const Message&) for every message of this exact channel. The handler must outlive the bus.
    /// False: not open, the table is full, or the name is over 15 characters.
    template <class Message, class Handler>
    [[nodiscard]] bool subscribe(const char* channel, Handler& handler) {
        return add(channel, &handler, &LcmBus::dispatch<Message, Handler>);
    }

    /// The same for a handler that decodes by itself: handler(const char* channel, const std::uint8_t* bytes, std::size_t size).
    /// The bytes hold until the handler returns.
    template <class Handler>
    [[nodiscard]] bool subscribe_raw(const char* channel, Handler& handler) {
        return add(channel, &handler, &LcmBus::dispatch_raw<Handler>);
    }

    /// Sends one message. False: closed, too large, or refused by the socket (counted).
    template <class Message>
    bool publish(const char* channel, const Message& message) {
        const int size = message.getEncodedSize();
        if (size < 0 || size > static_cast<int>(buffer_.size()) || message.encode(buffer_.data(), 0, size) != size) {
            ++counters_.publish_failed;
            return false;
        }
        return publish_raw(channel, buffer_.data(), static_cast<std::size_t>(size));
    }

    /// Sends bytes that are an encoded message already. False as above.
    bool publish_raw(const char* channel, const std::uint8_t* bytes, std::size_t size);

    /// Waits up to timeout_ms (0: not at all) for a message, then runs the handlers of everything that waits, at most
    /// kMaxLcmQueue messages. Returns the number handled; -1 on error.
    int handle(int timeout_ms);

    [[nodiscard]] const Counters& counters() const { return counters_; }

private:
    static constexpr std::size_t kMaxChannelName = 15;

    struct Entry {
        LcmBus* bus = nullptr;
        void* handler = nullptr;
    };

    [[nodiscard]] bool add(const char* channel, void* handler, lcm_msg_handler_t dispatcher);

    template <class Message, class Handler>
    static void dispatch(const lcm_recv_buf_t* received, const char* /*channel*/, void* user) {
        static Message message{};
        const Entry& entry = *static_cast<const Entry*>(user);
        const int size = static_cast<int>(received->data_size);
        if (message.decode(received->data, 0, size) != size) {
            ++entry.bus->counters_.undecodable;
            return;
        }
        ++entry.bus->counters_.received;
        (*static_cast<Handler*>(entry.handler))(static_cast<const Message&>(message));
    }

    template <class Handler>
    static void dispatch_raw(const lcm_recv_buf_t* received, const char* channel, void* user) {
        const Entry& entry = *static_cast<const Entry*>(user);
        ++entry.bus->counters_.received;
        (*static_cast<Handler*>(entry.handler))(channel, static_cast<const std::uint8_t*>(received->data),
                                               static_cast<std::size_t>(received->data_size));
    }

    lcm_t* lcm_ = nullptr;
    std::size_t used_ = 0;
    bool warm_ = false;
    std::array<Entry, kMaxLcmSubscriptions> entries_{};
    std::array<std::uint8_t, kMaxLcmBytes> buffer_{};
    std::array<char, 256> error_{};
    Counters counters_{};
};

}  // namespace noctule
