/// One MAVLink link of the bridge: its endpoint, the framing of a byte stream, and signing where a key is given.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "app/endpoint.hpp"
#include "link/mavlink.hpp"
#include "link/signing.hpp"

namespace noctule {

/// A key for signing: 32 bytes, or their 64 hexadecimal digits, in a file that nobody else may read. False: `error` is one line that says why.
[[nodiscard]] bool load_signing_key(const std::string& path, std::array<std::uint8_t, 32>& key, std::string& error);

class Port {
public:
    /// signing null: this link neither signs nor checks. `number` tells links of one key apart. Both outlive the port.
    Port(std::unique_ptr<Endpoint> endpoint, Signing* signing, const std::uint8_t number) : endpoint_(std::move(endpoint)), signing_(signing), number_(number) {}

    [[nodiscard]] Endpoint& endpoint() { return *endpoint_; }
    [[nodiscard]] const MavlinkReader::Counters& bytes() const { return reader_.counters(); }

    void send(const std::span<const std::uint8_t> frame) {
        if (signing_ == nullptr) {
            endpoint_->send(frame);
            return;
        }
        const std::span<const std::uint8_t> out = signing_->sign(frame, number_);
        if (!out.empty()) { endpoint_->send(out); }
    }

    /// Takes what waits, at most so many pieces; take(bytes) gets datagrams as they came or, on a stream or a signed link, whole frames.
    /// True: something came.
    template <class Take>
    bool drain(const std::span<std::uint8_t> buffer, const int pieces, Take&& take) {
        bool heard = false;
        for (int i = 0; i < pieces; ++i) {
            const std::span<const std::uint8_t> bytes = endpoint_->receive(buffer);
            if (bytes.empty()) { break; }
            heard = true;
            const auto on_frame = [&](const MavlinkFrame& frame) {
                if (signing_ == nullptr) { return take(frame.bytes); }
                if (signing_->check(frame.bytes) == Signing::Verdict::good) { take(signing_->unsign(frame.bytes)); }
            };
            if (endpoint_->is_stream()) {
                reader_.push(bytes, on_frame);
            } else if (signing_ != nullptr) {
                reader_.push_datagram(bytes, on_frame);
            } else {
                take(bytes);
            }
        }
        return heard;
    }

private:
    std::unique_ptr<Endpoint> endpoint_;
    Signing* signing_;
    std::uint8_t number_;
    MavlinkReader reader_;
};

}  // namespace noctule
