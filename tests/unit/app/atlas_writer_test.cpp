// The atlas on disk: whole after a power cut at any moment and after kill -9, and never older than the last version written.
#include "app/atlas_writer.hpp"

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <memory>
#include <string>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include "core/random.hpp"
#include "map/atlas.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using namespace noctule;

namespace {

using Bytes = std::vector<std::uint8_t>;

/// A disk with a cache. What was not synced is lost or kept piece by piece, in any order, when the power goes: the content of a file, and the
/// names in the folder.
class FaultyDisk final : public AtlasDisk {
public:
    int calls_left = 1 << 30;   ///< the power goes after so many calls
    bool obeys_sync = true;     ///< false: a disk (or a writer) that does not sync

    bool create(const char* path) override {
        if (!step()) { return false; }
        open_ = std::make_shared<File>();
        names_.emplace_back(path, open_);
        return true;
    }
    bool append(const std::span<const std::uint8_t> bytes) override {
        if (!step()) { return false; }
        open_->pieces.emplace_back(bytes.begin(), bytes.end());
        return true;
    }
    bool sync_file() override {
        if (!step()) { return false; }
        if (obeys_sync) { open_->synced = open_->pieces.size(); }
        return true;
    }
    bool close() override { return step(); }
    bool rename(const char* from, const char* to) override {
        if (!step()) { return false; }
        const auto file = newest(from);
        names_.emplace_back(to, file);
        return true;
    }
    bool sync_folder(const char*) override {
        if (!step()) { return false; }
        for (auto& [name, file] : names_) { durable_[name] = file; }
        names_.clear();
        return true;
    }
    /// What stands under a name when the power is back: each change of the folder and each piece of a file made it or did not.
    [[nodiscard]] Bytes after_cut(const std::string& name, Random& random) const {
        std::shared_ptr<File> file = durable_.count(name) != 0U ? durable_.at(name) : nullptr;
        for (const auto& [changed, to] : names_) {
            if (changed == name && random.uniform() < 0.5F) { file = to; }
        }
        Bytes out;
        if (!file) { return out; }
        for (std::size_t i = 0; i < file->pieces.size(); ++i) {
            const Bytes& piece = file->pieces[i];
            if (i < file->synced || random.uniform() < 0.5F) {
                out.insert(out.end(), piece.begin(), piece.end());
            } else {
                out.insert(out.end(), piece.size(), 0U);
            }
        }
        return out;
    }

private:
    struct File {
        std::vector<Bytes> pieces;
        std::size_t synced = 0;
    };
    bool step() { return calls_left-- > 0; }
    [[nodiscard]] std::shared_ptr<File> newest(const std::string& name) const {
        for (auto it = names_.rbegin(); it != names_.rend(); ++it) {
            if (it->first == name) { return it->second; }
        }
        return durable_.at(name);
    }
    std::vector<std::pair<std::string, std::shared_ptr<File>>> names_;
    std::map<std::string, std::shared_ptr<File>> durable_;
    std::shared_ptr<File> open_;
};

OccupancyGrid& grid() {
    static Parameters p;
    static OccupancyGrid g(p);
    return g;
}

/// An encoded atlas with that number; longer than one piece of the writer's.
Bytes version(const std::uint64_t number) {
    static AtlasContents contents;
    contents.sequence = number;
    contents.floors.clear();
    for (std::int32_t i = 0; i < kMaxFloors; ++i) {
        static_cast<void>(contents.floors.push({i, i, 2.5F * static_cast<float>(i)}));
        auto& walls = contents.walls[static_cast<std::size_t>(i)];
        while (!walls.full()) { static_cast<void>(walls.push(WallSegment{})); }
    }
    Bytes out(kMaxAtlasBytes);
    out.resize(encode_atlas(contents, grid(), out));
    return out;
}

/// Number of the atlas in these bytes; -1: there is no whole one.
std::int64_t number_of(const Bytes& bytes) {
    if (bytes.size() < kAtlasHeaderBytes || std::memcmp(bytes.data(), "NOCTATLS", 8) != 0) { return -1; }
    std::uint64_t number = 0;
    std::uint64_t size = 0;
    std::uint32_t crc = 0;
    std::memcpy(&number, bytes.data() + 16, 8);
    std::memcpy(&size, bytes.data() + 32, 8);
    std::memcpy(&crc, bytes.data() + 40, 4);
    if (bytes.size() != kAtlasHeaderBytes + size) { return -1; }
    return crc32({bytes.data() + kAtlasHeaderBytes, static_cast<std::size_t>(size)}) == crc ? static_cast<std::int64_t>(number) : -1;
}

/// Writes five versions with the power going after `calls`; number found afterwards, and how many were reported as written.
std::int64_t cut_after(const int calls, const bool obeys, Random& random, std::int64_t& written) {
    static const std::vector<Bytes> versions = {version(0), version(1), version(2), version(3), version(4)};
    FaultyDisk disk;
    disk.calls_left = calls;
    disk.obeys_sync = obeys;
    written = -1;
    for (const Bytes& bytes : versions) {
        if (!write_atlas(disk, AtlasPaths("/a/atlas"), bytes)) { break; }
        ++written;
    }
    return number_of(disk.after_cut("/a/atlas", random));
}

void the_sum_is_the_usual_one() {
    const char* text = "123456789";
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926U, crc32({reinterpret_cast<const std::uint8_t*>(text), 9}));
}

void a_cut_after_any_call_leaves_a_whole_atlas_no_older_than_the_last_written() {
    Random random(7);
    int calls_of_all = 0;
    std::int64_t written = 0;
    for (; cut_after(calls_of_all, true, random, written), written < 4; ++calls_of_all) {}
    TEST_ASSERT_TRUE(calls_of_all > 30);   // several pieces a version
    for (int calls = 0; calls <= calls_of_all; ++calls) {
        for (int again = 0; again < 20; ++again) {
            const std::int64_t found = cut_after(calls, true, random, written);
            TEST_ASSERT_TRUE_MESSAGE(found >= written, "older than what was reported as written, or broken");
            TEST_ASSERT_TRUE(found <= written + 1);
        }
    }
}

void without_syncs_the_same_cuts_do_break_it() {
    Random random(8);
    std::int64_t written = 0;
    int broken = 0;
    for (int calls = 0; calls < 60; ++calls) {
        const std::int64_t found = cut_after(calls, false, random, written);
        broken += found < written ? 1 : 0;
    }
    TEST_ASSERT_TRUE(broken > 10);
}

void a_hundred_kills_leave_a_whole_atlas() {
    char folder[] = "/tmp/noctule-atlas-XXXXXX";
    TEST_ASSERT_NOT_NULL(mkdtemp(folder));
    const std::string path = std::string(folder) + "/atlas";
    Bytes bytes = version(0);
    Random random(9);
    PosixDisk disk;
    TEST_ASSERT_TRUE(write_atlas(disk, AtlasPaths(path), bytes));
    for (int kill_number = 0; kill_number < 100; ++kill_number) {
        const pid_t child = fork();
        if (child == 0) {
            const AtlasPaths paths(path);
            PosixDisk own;
            for (;;) { static_cast<void>(write_atlas(own, paths, bytes)); }
        }
        usleep(200U + random.below(8000U));
        kill(child, SIGKILL);
        waitpid(child, nullptr, 0);
        std::ifstream in(path, std::ios::binary);
        const Bytes found((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
        TEST_ASSERT_EQUAL_INT64(0, number_of(found));
    }
    std::remove(path.c_str());
    std::remove((path + ".new").c_str());
    rmdir(folder);
}

void the_writer_takes_one_version_a_second_and_the_last_before_it_ends() {
    FaultyDisk disk;
    Random random(10);
    {
        AtlasWriter writer(disk, "/a/atlas", kMaxAtlasBytes);
        for (std::uint64_t n = 0; n < 3; ++n) {
            const auto t_us = static_cast<std::int64_t>(n) * AtlasWriter::kPeriodUs + 1;
            while (!writer.wants(t_us)) { usleep(200); }
            const Bytes bytes = version(n);
            std::copy(bytes.begin(), bytes.end(), writer.buffer().begin());
            writer.give(bytes.size(), t_us);
            TEST_ASSERT_FALSE(writer.wants(t_us + AtlasWriter::kPeriodUs / 2));
        }
    }
    TEST_ASSERT_EQUAL_INT64(2, number_of(disk.after_cut("/a/atlas", random)));
}

void what_does_not_fit_is_not_begun() {
    static AtlasContents contents;
    Bytes small(1000);
    const Bytes whole = version(0);
    TEST_ASSERT_EQUAL_size_t(0, encode_atlas(contents, grid(), {small.data(), 60}));
    TEST_ASSERT_TRUE(whole.size() > 40000U && whole.size() < kMaxAtlasBytes);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(the_sum_is_the_usual_one);
    RUN_TEST(a_cut_after_any_call_leaves_a_whole_atlas_no_older_than_the_last_written);
    RUN_TEST(without_syncs_the_same_cuts_do_break_it);
    RUN_TEST(a_hundred_kills_leave_a_whole_atlas);
    RUN_TEST(the_writer_takes_one_version_a_second_and_the_last_before_it_ends);
    RUN_TEST(what_does_not_fit_is_not_begun);
    return UNITY_END();
}
