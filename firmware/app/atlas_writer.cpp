#include "app/atlas_writer.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <fcntl.h>
#include <unistd.h>
#include <utility>

namespace noctule {

namespace {

constexpr std::size_t kPieceBytes = 16384;

}  // namespace

PosixDisk::~PosixDisk() {
    if (file_ >= 0) { ::close(file_); }
}

bool PosixDisk::create(const char* path) {
    if (file_ >= 0) { ::close(file_); }
    file_ = ::open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    return file_ >= 0;
}

bool PosixDisk::append(std::span<const std::uint8_t> bytes) {
    while (!bytes.empty()) {
        const ssize_t n = ::write(file_, bytes.data(), bytes.size());
        if (n < 0 && errno == EINTR) { continue; }
        if (n <= 0) { return false; }
        bytes = bytes.subspan(static_cast<std::size_t>(n));
    }
    return true;
}

bool PosixDisk::sync_file() { return ::fsync(file_) == 0; }

bool PosixDisk::close() {
    const int file = std::exchange(file_, -1);
    return ::close(file) == 0;
}

bool PosixDisk::rename(const char* from, const char* to) { return std::rename(from, to) == 0; }

bool PosixDisk::sync_folder(const char* folder) {
    const int file = ::open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (file < 0) { return false; }
    const bool good = ::fsync(file) == 0;
    ::close(file);
    return good;
}

AtlasPaths::AtlasPaths(const std::string& path) : atlas(path), beside(path + ".new") {
    const std::size_t slash = path.rfind('/');
    folder = slash == std::string::npos ? "." : (slash == 0 ? "/" : path.substr(0, slash));
}

bool write_atlas(AtlasDisk& disk, const AtlasPaths& paths, std::span<const std::uint8_t> bytes) {
    if (!disk.create(paths.beside.c_str())) { return false; }
    bool good = true;
    for (; good && !bytes.empty(); bytes = bytes.subspan(std::min(kPieceBytes, bytes.size()))) {
        good = disk.append(bytes.first(std::min(kPieceBytes, bytes.size())));
    }
    good = good && disk.sync_file();      // the content before the name, or the name may outlive a cut without it
    good = disk.close() && good;
    return good && disk.rename(paths.beside.c_str(), paths.atlas.c_str()) && disk.sync_folder(paths.folder.c_str());
}

AtlasWriter::AtlasWriter(AtlasDisk& disk, const std::string& path, const std::size_t capacity)
    : disk_(disk), paths_(path), buffer_(capacity), thread_([this] { run(); }) {}

AtlasWriter::~AtlasWriter() {
    ends_ = true;
    ++signal_;
    signal_.notify_one();
    thread_.join();
}

bool AtlasWriter::wants(const std::int64_t t_us) const {
    return (t_us - given_us_ >= kPeriodUs || t_us < given_us_) && waiting_.load(std::memory_order_acquire) == 0U;
}

void AtlasWriter::give(const std::size_t size, const std::int64_t t_us) {
    given_us_ = t_us;
    if (size == 0U || size > buffer_.size()) { return; }
    waiting_.store(size, std::memory_order_release);
    ++signal_;
    signal_.notify_one();
}

void AtlasWriter::run() {
    for (std::uint32_t seen = 0;;) {
        signal_.wait(seen);
        seen = signal_.load();
        const std::size_t size = waiting_.load(std::memory_order_acquire);
        if (size > 0U) {
            ++(write_atlas(disk_, paths_, {buffer_.data(), size}) ? written_ : failed_);
            waiting_.store(0, std::memory_order_release);
        }
        if (ends_ && waiting_.load(std::memory_order_acquire) == 0U) { return; }
    }
}

}  // namespace noctule
