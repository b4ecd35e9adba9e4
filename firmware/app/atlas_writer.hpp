/// Writes the atlas down while flying: a thread of its own, from a preallocated copy, so that the step never waits for a disk.
///
/// Each version goes to a file beside the atlas, is synced, takes the atlas's name, and the folder is synced: after a power cut the atlas is
/// the last version or the one before, whole. docs/atlas.md. The disk is an interface, so that tests can cut its power.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <thread>
#include <vector>

namespace noctule {

/// What the writer asks of a file system; each call returns false if it failed.
class AtlasDisk {
public:
    virtual ~AtlasDisk() = default;
    [[nodiscard]] virtual bool create(const char* path) = 0;     ///< empty, open for writing
    [[nodiscard]] virtual bool append(std::span<const std::uint8_t> bytes) = 0;
    [[nodiscard]] virtual bool sync_file() = 0;
    [[nodiscard]] virtual bool close() = 0;
    [[nodiscard]] virtual bool rename(const char* from, const char* to) = 0;
    [[nodiscard]] virtual bool sync_folder(const char* folder) = 0;
};

/// The real one (POSIX).
class PosixDisk final : public AtlasDisk {
public:
    ~PosixDisk() override;
    [[nodiscard]] bool create(const char* path) override;
    [[nodiscard]] bool append(std::span<const std::uint8_t> bytes) override;
    [[nodiscard]] bool sync_file() override;
    [[nodiscard]] bool close() override;
    [[nodiscard]] bool rename(const char* from, const char* to) override;
    [[nodiscard]] bool sync_folder(const char* folder) override;

private:
    int file_ = -1;
};

/// Where one atlas goes; made once, so that writing allocates nothing.
struct AtlasPaths {
    explicit AtlasPaths(const std::string& path);
    std::string atlas;
    std::string beside;   ///< the version under way
    std::string folder;
};

/// One version: all of it or nothing of it is there afterwards. False: it was not written, the version before stands.
[[nodiscard]] bool write_atlas(AtlasDisk& disk, const AtlasPaths& paths, std::span<const std::uint8_t> bytes);

class AtlasWriter {
public:
    static constexpr std::int64_t kPeriodUs = 1000000;   ///< of data time between two versions

    /// Allocates all it needs and starts the thread. The disk must outlive it.
    AtlasWriter(AtlasDisk& disk, const std::string& path, std::size_t capacity);
    /// Writes what is still waiting, then ends the thread.
    ~AtlasWriter();
    AtlasWriter(const AtlasWriter&) = delete;
    AtlasWriter& operator=(const AtlasWriter&) = delete;

    /// True: a new version is due and the buffer is free. Never waits.
    [[nodiscard]] bool wants(std::int64_t t_us) const;
    /// The buffer to fill after wants() said so; then give(size). size 0: nothing to write.
    [[nodiscard]] std::span<std::uint8_t> buffer() { return buffer_; }
    void give(std::size_t size, std::int64_t t_us);

    [[nodiscard]] std::uint64_t written() const { return written_.load(); }
    [[nodiscard]] std::uint64_t failed() const { return failed_.load(); }

private:
    void run();

    AtlasDisk& disk_;
    AtlasPaths paths_;
    std::vector<std::uint8_t> buffer_;
    std::atomic<std::size_t> waiting_{0};    ///< bytes to write; 0: the buffer is free
    std::atomic<bool> ends_{false};
    std::atomic<std::uint32_t> signal_{0};   ///< rises when there is something to do
    std::atomic<std::uint64_t> written_{0};
    std::atomic<std::uint64_t> failed_{0};
    std::int64_t given_us_ = -kPeriodUs;
    std::thread thread_;
};

}  // namespace noctule
