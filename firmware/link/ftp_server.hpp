/// MAVLink FTP, read-only: serves the component's metadata (generated from parameters.toml) to ground stations.
///
/// Every request can be repeated without harm, so a lost answer needs no memory of it. Anything that would write is answered
/// FileProtected or UnknownCommand. No heap, no clock.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "link/mavlink.hpp"

namespace noctule {

struct ServedFile {
    std::string_view path;                 ///< without a leading slash
    std::span<const std::uint8_t> bytes;
    std::uint32_t crc;                     ///< as CalcFileCRC32 counts it
};

class FtpServer {
public:
    explicit FtpServer(std::span<const ServedFile> files) : files_(files) {}

    /// A request. True: `answer` is to be sent.
    [[nodiscard]] bool take(const mavlink_file_transfer_protocol_t& request, MavlinkTarget client, mavlink_file_transfer_protocol_t& answer);

    /// The next packet of a burst under way. False: none is.
    [[nodiscard]] bool next(mavlink_file_transfer_protocol_t& packet);

private:
    struct Session {
        const ServedFile* file = nullptr;   ///< null: free
        MavlinkTarget client;
        std::uint32_t last_use = 0;
        bool bursts = false;
        std::uint32_t offset = 0;           ///< of the burst's next packet
        std::uint16_t sequence = 0;
        std::uint8_t size = 0;              ///< of a packet
    };

    [[nodiscard]] const ServedFile* find(std::string_view path) const;
    [[nodiscard]] std::uint8_t open(const ServedFile* file, MavlinkTarget client);
    [[nodiscard]] Session* session(std::uint8_t number, MavlinkTarget client);

    std::span<const ServedFile> files_;
    std::array<Session, 8> sessions_{};
    std::uint32_t uses_ = 0;
};

}  // namespace noctule
