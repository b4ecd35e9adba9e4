#include "link/lcm_bus.hpp"

#include <arpa/inet.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdio>

#include "streams.gen.hpp"

/// LCM's own lookup of a channel's handlers (liblcm 1.3 to 1.5 export it). Null elsewhere.
extern "C" int lcm_has_handlers(lcm_t* lcm, const char* channel) __attribute__((weak));

namespace noctule {

namespace {

/// LCM prints eight lines and hangs on where the kernel has no route for multicast: ask the kernel first.
/// True for a url that is not udpm, or whose address cannot be read: LCM itself then says what is wrong.
bool multicast_route_exists(const char* url) {
    constexpr const char* kScheme = "udpm://";
    if (std::strncmp(url, kScheme, std::strlen(kScheme)) != 0) { return true; }
    std::array<char, 64> host{};
    const char* begin = url + std::strlen(kScheme);
    const std::size_t length = std::strcspn(begin, ":?/");
    if (length == 0 || length >= host.size()) { return true; }
    std::memcpy(host.data(), begin, length);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(9);
    if (inet_pton(AF_INET, host.data(), &address.sin_addr) != 1) { return true; }
    const int probe = ::socket(AF_INET, SOCK_DGRAM, 0);
    if (probe < 0) { return true; }
    const bool reachable = ::connect(probe, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
    ::close(probe);
    return reachable;
}

}  // namespace

bool LcmBus::open(const char* url) {
    close();
    error_.fill('\0');
    if (!multicast_route_exists(url)) {
        std::snprintf(error_.data(), error_.size(), "no route for multicast, so no LCM bus: run `sudo ip route add 224.0.0.0/4 dev lo`");
        return false;
    }
    lcm_ = lcm_create(url);
    if (lcm_ == nullptr) {
        std::snprintf(error_.data(), error_.size(), "cannot open the LCM bus %.180s", url);
        return false;
    }
    return true;
}

void LcmBus::close() {
    if (lcm_ == nullptr) { return; }
    lcm_destroy(lcm_);
    lcm_ = nullptr;
    used_ = 0;
    warm_ = false;
}

bool LcmBus::add(const char* channel, void* handler, const lcm_msg_handler_t dispatcher) {
    if (lcm_ == nullptr || used_ == entries_.size() || std::strlen(channel) > kMaxChannelName) { return false; }
    Entry& entry = entries_[used_];
    entry = {this, handler};
    lcm_subscription_t* subscription = lcm_subscribe(lcm_, channel, dispatcher, &entry);
    if (subscription == nullptr) { return false; }
    lcm_subscription_set_queue_capacity(subscription, kMaxLcmQueue);
    ++used_;
    return true;
}

bool LcmBus::publish_raw(const char* channel, const std::uint8_t* bytes, const std::size_t size) {
    if (lcm_ == nullptr || size > buffer_.size() || std::strlen(channel) > kMaxChannelName ||
        lcm_publish(lcm_, channel, bytes, static_cast<unsigned int>(size)) != 0) {
        ++counters_.publish_failed;
        return false;
    }
    ++counters_.published;
    return true;
}

int LcmBus::handle(const int timeout_ms) {
    if (lcm_ == nullptr) { return -1; }
    if (!warm_) {
        // LCM allocates when it meets a channel name for the first time: let it meet all of them now.
        for (const char* channel : kAllChannels) {
            if (lcm_has_handlers != nullptr) { static_cast<void>(lcm_has_handlers(lcm_, channel)); }
        }
        warm_ = true;
    }
    int handled = 0;
    int wait_ms = timeout_ms;
    while (handled < kMaxLcmQueue) {
        const int result = lcm_handle_timeout(lcm_, wait_ms);
        if (result < 0) { return -1; }
        if (result == 0) { break; }
        ++handled;
        wait_ms = 0;
    }
    return handled;
}

}  // namespace noctule
