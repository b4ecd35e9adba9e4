// A file layer for SQLite that loses power: writes reach the disk at a sync; at a cut, of those since the last sync some are there, some are
// not, some are half there, in any order. Everything lies in memory.
#pragma once

#include <sqlite3.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <map>
#include <random>
#include <string>
#include <vector>

namespace cut_vfs {

struct Write {
    std::int64_t offset = 0;
    std::vector<std::uint8_t> data;
    bool truncate = false;     ///< to offset bytes
};

struct File {
    std::vector<std::uint8_t> seen;      ///< what the process reads
    std::vector<std::uint8_t> durable;   ///< what is on the disk for certain
    std::vector<Write> pending;          ///< written, not synced
    bool deleted = false;
};

/// The disk, and the moment at which the power goes.
struct Disk {
    std::map<std::string, File> files;
    std::int64_t writes = 0;             ///< so far, truncations and deletions included
    std::int64_t cut_after = -1;         ///< the power goes after so many; -1: never
    std::map<std::string, std::map<int, std::vector<std::uint8_t>>> shared;  ///< the index of the write-ahead log, not on the disk

    [[nodiscard]] bool dead() const { return cut_after >= 0 && writes > cut_after; }

    /// Counts one change of the disk; false: the power is gone.
    bool change() {
        ++writes;
        return !dead();
    }

    static void apply(std::vector<std::uint8_t>& bytes, const Write& w, const std::size_t most) {
        if (w.truncate) {
            bytes.resize(static_cast<std::size_t>(w.offset));
            return;
        }
        const std::size_t size = std::min(most, w.data.size());
        const std::size_t at = static_cast<std::size_t>(w.offset);
        if (bytes.size() < at + size) { bytes.resize(at + size); }
        std::copy_n(w.data.begin(), size, bytes.begin() + static_cast<std::ptrdiff_t>(at));
    }

    /// The disk as it is found when the power is back.
    void power_back(const unsigned seed) {
        std::mt19937 rng{seed};
        for (auto& [name, file] : files) {
            std::shuffle(file.pending.begin(), file.pending.end(), rng);
            for (const Write& w : file.pending) {
                const unsigned fate = rng() % 4U;
                if (fate == 0) { continue; }                                             // lost
                apply(file.durable, w, fate == 1 ? (rng() % 9U) * 512U : w.data.size());  // torn at a sector, or whole
            }
            file.pending.clear();
            file.seen = file.durable;
        }
        shared.clear();
        writes = 0;
        cut_after = -1;
    }
};

inline Disk& disk() {
    static Disk d;
    return d;
}

struct Handle {
    sqlite3_file base;
    File* file;
    std::string* name;
};

inline Handle* of(sqlite3_file* f) { return reinterpret_cast<Handle*>(f); }

inline int close(sqlite3_file* f) {
    delete of(f)->name;
    return SQLITE_OK;
}
inline int read(sqlite3_file* f, void* to, int size, sqlite3_int64 offset) {
    const std::vector<std::uint8_t>& bytes = of(f)->file->seen;
    const std::size_t at = static_cast<std::size_t>(offset);
    const std::size_t there = at < bytes.size() ? std::min(static_cast<std::size_t>(size), bytes.size() - at) : 0U;
    if (there > 0) { std::memcpy(to, &bytes[at], there); }
    if (there == static_cast<std::size_t>(size)) { return SQLITE_OK; }
    std::memset(static_cast<std::uint8_t*>(to) + there, 0, static_cast<std::size_t>(size) - there);
    return SQLITE_IOERR_SHORT_READ;
}
inline int write(sqlite3_file* f, const void* from, int size, sqlite3_int64 offset) {
    if (!disk().change()) { return SQLITE_IOERR_WRITE; }
    const auto* const p = static_cast<const std::uint8_t*>(from);
    Write w{offset, {p, p + size}, false};
    Disk::apply(of(f)->file->seen, w, w.data.size());
    of(f)->file->pending.push_back(std::move(w));
    return SQLITE_OK;
}
inline int truncate(sqlite3_file* f, sqlite3_int64 size) {
    if (!disk().change()) { return SQLITE_IOERR_TRUNCATE; }
    Write w{size, {}, true};
    Disk::apply(of(f)->file->seen, w, 0);
    of(f)->file->pending.push_back(std::move(w));
    return SQLITE_OK;
}
inline int sync(sqlite3_file* f, int) {
    if (disk().dead()) { return SQLITE_IOERR_FSYNC; }
    of(f)->file->durable = of(f)->file->seen;
    of(f)->file->pending.clear();
    return SQLITE_OK;
}
inline int file_size(sqlite3_file* f, sqlite3_int64* size) {
    *size = static_cast<sqlite3_int64>(of(f)->file->seen.size());
    return SQLITE_OK;
}
inline int lock(sqlite3_file*, int) { return SQLITE_OK; }
inline int reserved(sqlite3_file*, int* out) {
    *out = 0;
    return SQLITE_OK;
}
inline int control(sqlite3_file*, int, void*) { return SQLITE_NOTFOUND; }
inline int sector(sqlite3_file*) { return 512; }
inline int traits(sqlite3_file*) { return 0; }
inline int shm_map(sqlite3_file* f, int page, int size, int extend, void volatile** out) {
    auto& pages = disk().shared[*of(f)->name];
    *out = nullptr;
    if (pages.find(page) == pages.end()) {
        if (extend == 0) { return SQLITE_OK; }
        pages[page].assign(static_cast<std::size_t>(size), 0);
    }
    *out = pages[page].data();
    return SQLITE_OK;
}
inline int shm_lock(sqlite3_file*, int, int, int) { return SQLITE_OK; }
inline void shm_barrier(sqlite3_file*) {}
inline int shm_unmap(sqlite3_file* f, int gone) {
    if (gone != 0) { disk().shared.erase(*of(f)->name); }
    return SQLITE_OK;
}

inline const sqlite3_io_methods& methods() {
    static const sqlite3_io_methods m{2,       close,    read,    write,  truncate, sync,    file_size, lock,        lock,      reserved,
                                      control, sector,   traits,  shm_map, shm_lock, shm_barrier, shm_unmap, nullptr, nullptr};
    return m;
}

inline int open(sqlite3_vfs*, const char* path, sqlite3_file* f, int flags, int* out_flags) {
    const std::string name = path != nullptr ? path : "temporary";
    f->pMethods = nullptr;
    const bool there = disk().files.find(name) != disk().files.end() && !disk().files[name].deleted;
    if (!there && (flags & SQLITE_OPEN_CREATE) == 0) { return SQLITE_CANTOPEN; }
    if (!there) { disk().files[name] = File{}; }
    Handle* const h = of(f);
    h->file = &disk().files[name];
    h->name = new std::string{name};
    h->base.pMethods = &methods();
    if (out_flags != nullptr) { *out_flags = flags; }
    return SQLITE_OK;
}
inline int remove(sqlite3_vfs*, const char* path, int) {
    if (!disk().change()) { return SQLITE_IOERR_DELETE; }
    disk().files.erase(path);
    return SQLITE_OK;
}
inline int access(sqlite3_vfs*, const char* path, int, int* out) {
    *out = disk().files.find(path) != disk().files.end() ? 1 : 0;
    return SQLITE_OK;
}
inline int full_path(sqlite3_vfs*, const char* path, int room, char* out) {
    sqlite3_snprintf(room, out, "%s", path);
    return SQLITE_OK;
}

/// Makes this layer SQLite's default.
inline void install() {
    static sqlite3_vfs vfs = *sqlite3_vfs_find(nullptr);
    vfs.zName = "cut";
    vfs.szOsFile = static_cast<int>(sizeof(Handle));
    vfs.xOpen = open;
    vfs.xDelete = remove;
    vfs.xAccess = access;
    vfs.xFullPathname = full_path;
    sqlite3_vfs_register(&vfs, 1);
}

}  // namespace cut_vfs
