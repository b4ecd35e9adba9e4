#include "link/ftp_server.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>

namespace noctule {

namespace {

// Layout of the payload, https://mavlink.io/en/services/ftp.html
constexpr std::size_t kSequence = 0;
constexpr std::size_t kSession = 2;
constexpr std::size_t kOpcode = 3;
constexpr std::size_t kSize = 4;
constexpr std::size_t kRequested = 5;
constexpr std::size_t kBurstComplete = 6;
constexpr std::size_t kOffset = 8;
constexpr std::size_t kData = 12;
constexpr std::size_t kMostData = MAVLINK_MSG_FILE_TRANSFER_PROTOCOL_FIELD_PAYLOAD_LEN - kData;

enum Opcode : std::uint8_t { kNone = 0, kTerminate = 1, kReset = 2, kList = 3, kOpen = 4, kRead = 5, kCreate = 6, kLastWriting = 12, kCrc = 14, kBurst = 15, kAck = 128, kNak = 129 };
enum Error : std::uint8_t { kInvalidSize = 3, kInvalidSession = 4, kEndOfFile = 6, kUnknownCommand = 7, kProtected = 9, kNotFound = 10 };

template <class Number>
Number number(const std::uint8_t* at) {
    Number n{};
    std::memcpy(&n, at, sizeof n);
    return n;
}

template <class Number>
void put(std::uint8_t* at, const Number n) {
    std::memcpy(at, &n, sizeof n);
}

std::string_view path_of(const std::uint8_t* payload) {
    const auto* text = reinterpret_cast<const char*>(payload + kData);
    std::string_view path{text, strnlen(text, std::min<std::size_t>(payload[kSize], kMostData))};
    while (!path.empty() && (path.front() == '/' || path.front() == '.')) { path.remove_prefix(1); }
    while (!path.empty() && path.back() == '/') { path.remove_suffix(1); }
    return path;
}

void acknowledge(std::uint8_t* out, const std::size_t size) {
    out[kOpcode] = kAck;
    out[kSize] = static_cast<std::uint8_t>(size);
}

void refuse(std::uint8_t* out, const Error error) {
    out[kOpcode] = kNak;
    out[kSize] = 1;
    out[kData] = error;
}

/// Entries of a folder from the one with this index on, "F" name tab size zero, as many as fit.
void list(const std::span<const ServedFile> files, const std::string_view folder, const std::uint32_t from, std::uint8_t* out) {
    std::size_t used = 0;
    std::uint32_t index = 0;
    bool known = folder.empty();
    const auto add = [&](const char kind, const std::string_view name, const std::size_t bytes) {
        if (index++ < from) { return; }
        std::array<char, 64> entry{};
        const int length = kind == 'D' ? std::snprintf(entry.data(), entry.size(), "D%.*s", static_cast<int>(name.size()), name.data())
                                       : std::snprintf(entry.data(), entry.size(), "F%.*s\t%zu", static_cast<int>(name.size()), name.data(), bytes);
        const std::size_t needed = static_cast<std::size_t>(length) + 1;
        if (length < 0 || needed > entry.size() || used + needed > kMostData) { return; }
        std::memcpy(out + kData + used, entry.data(), needed);
        used += needed;
    };
    if (folder.empty()) { add('D', files.front().path.substr(0, files.front().path.find('/')), 0); }
    for (const ServedFile& file : files) {
        const std::size_t slash = file.path.find('/');
        if (file.path.substr(0, slash) != folder) { continue; }
        known = true;
        add('F', file.path.substr(slash + 1), file.bytes.size());
    }
    if (!known) { return refuse(out, kNotFound); }
    if (used == 0) { return refuse(out, kEndOfFile); }
    acknowledge(out, used);
}

}  // namespace

const ServedFile* FtpServer::find(const std::string_view path) const {
    const auto found = std::find_if(files_.begin(), files_.end(), [path](const ServedFile& file) { return file.path == path; });
    return found == files_.end() ? nullptr : &*found;
}

FtpServer::Session* FtpServer::session(const std::uint8_t number_, const MavlinkTarget client) {
    if (number_ >= sessions_.size()) { return nullptr; }
    Session& s = sessions_[number_];
    if (s.file == nullptr || s.client.system != client.system || s.client.component != client.component) { return nullptr; }
    s.last_use = ++uses_;
    return &s;
}

/// The client's own session on that file, else a free one, else the one that was not used for longest: clients vanish.
std::uint8_t FtpServer::open(const ServedFile* const file, const MavlinkTarget client) {
    std::size_t best = 0;
    for (std::size_t i = 0; i < sessions_.size(); ++i) {
        const Session& s = sessions_[i];
        if (s.file == file && s.client.system == client.system && s.client.component == client.component) {
            best = i;
            break;
        }
        if (sessions_[best].file != nullptr && (s.file == nullptr || s.last_use < sessions_[best].last_use)) { best = i; }
    }
    sessions_[best] = {file, client, ++uses_, false, 0, 0, 0};
    return static_cast<std::uint8_t>(best);
}

bool FtpServer::take(const mavlink_file_transfer_protocol_t& request, const MavlinkTarget client, mavlink_file_transfer_protocol_t& answer) {
    const std::uint8_t* const in = request.payload;
    const auto opcode = in[kOpcode];
    if (opcode >= kAck) { return false; }  // an answer, not a request
    answer = {};
    answer.target_network = request.target_network;
    answer.target_system = client.system;
    answer.target_component = client.component;
    std::uint8_t* const out = answer.payload;
    const auto sequence = static_cast<std::uint16_t>(number<std::uint16_t>(in + kSequence) + 1);
    const auto offset = number<std::uint32_t>(in + kOffset);
    put(out + kSequence, sequence);
    out[kSession] = in[kSession];
    out[kRequested] = opcode;
    put(out + kOffset, offset);
    switch (opcode) {
        case kNone: acknowledge(out, 0); return true;
        case kTerminate:
            if (Session* s = session(in[kSession], client); s != nullptr) { *s = {}; }
            acknowledge(out, 0);
            return true;
        case kReset:
            for (Session& s : sessions_) {
                if (s.client.system == client.system && s.client.component == client.component) { s = {}; }
            }
            acknowledge(out, 0);
            return true;
        case kList: list(files_, path_of(in), offset, out); return true;
        case kOpen:
        case kCrc: {
            const ServedFile* file = find(path_of(in));
            if (file == nullptr) { refuse(out, kNotFound); return true; }
            if (opcode == kOpen) { out[kSession] = open(file, client); }
            put(out + kData, opcode == kOpen ? static_cast<std::uint32_t>(file->bytes.size()) : file->crc);
            acknowledge(out, sizeof(std::uint32_t));
            return true;
        }
        case kRead:
        case kBurst: {
            Session* s = session(in[kSession], client);
            if (s == nullptr) { refuse(out, kInvalidSession); return true; }
            if (in[kSize] == 0 || in[kSize] > kMostData) { refuse(out, kInvalidSize); return true; }
            if (offset >= s->file->bytes.size()) { refuse(out, kEndOfFile); return true; }
            if (opcode == kBurst) {
                s->bursts = true;
                s->offset = offset;
                s->sequence = sequence;
                s->size = in[kSize];
                return false;  // next() sends it
            }
            const auto part = s->file->bytes.subspan(offset, std::min<std::size_t>(in[kSize], s->file->bytes.size() - offset));
            std::copy(part.begin(), part.end(), out + kData);
            acknowledge(out, part.size());
            return true;
        }
        default: refuse(out, opcode >= kCreate && opcode <= kLastWriting ? kProtected : kUnknownCommand); return true;
    }
}

bool FtpServer::next(mavlink_file_transfer_protocol_t& packet) {
    for (std::size_t i = 0; i < sessions_.size(); ++i) {
        Session& s = sessions_[i];
        if (s.file == nullptr || !s.bursts) { continue; }
        const std::size_t left = s.file->bytes.size() - s.offset;
        const auto part = s.file->bytes.subspan(s.offset, std::min<std::size_t>(s.size, left));
        packet = {};
        packet.target_system = s.client.system;
        packet.target_component = s.client.component;
        std::uint8_t* const out = packet.payload;
        put(out + kSequence, s.sequence++);
        out[kSession] = static_cast<std::uint8_t>(i);
        out[kRequested] = kBurst;
        out[kBurstComplete] = part.size() == left ? 1 : 0;
        put(out + kOffset, s.offset);
        std::copy(part.begin(), part.end(), out + kData);
        acknowledge(out, part.size());
        s.offset += static_cast<std::uint32_t>(part.size());
        s.bursts = part.size() < left;
        return true;
    }
    return false;
}

}  // namespace noctule
