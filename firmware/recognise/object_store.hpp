/// The object database on disk: SQLite with a write-ahead log, one transaction a frame.
///
/// Tables and columns: docs/objects.md. What commit() returned true for survives a kill and, with synchronous=FULL, a power cut.
/// May allocate (SQLite). Not thread-safe.
#pragma once

#include <cstdint>
#include <string>

#include <opencv2/core.hpp>

#include "recognise/object_memory.hpp"
#include "recognise/pose_history.hpp"

struct sqlite3;
struct sqlite3_stmt;

namespace noctule {

struct StoreCounters {
    std::uint32_t commits = 0;
    std::uint32_t failed = 0;        ///< transactions that did not reach the disk; what they held is tried again with the next
};

class ObjectStore {
public:
    static constexpr int kSchema = 2;              ///< PRAGMA user_version
    static constexpr int kApplication = 0x4E4F4354;  ///< PRAGMA application_id: "NOCT"

    ObjectStore() = default;
    ObjectStore(const ObjectStore&) = delete;
    ObjectStore& operator=(const ObjectStore&) = delete;
    ~ObjectStore() { close(); }

    /// Opens or makes the database, brings an older schema up to kSchema, begins a session. False: error() is one line.
    /// A file of a newer schema or of another application is refused and left as it is.
    [[nodiscard]] bool open(const std::string& path, const std::string& started);

    void close();

    [[nodiscard]] bool is_open() const { return db_ != nullptr; }

    /// Puts what the database holds into memory. resume: the objects' places hold (the same session goes on after a restart of the process).
    [[nodiscard]] bool load(ObjectMemory& memory, bool resume);

    /// One transaction: removals, changed objects, their changed views (pictures cut from bgr, the frame of t_us) and the sightings noted since the last.
    /// False: nothing of it is in the database, all of it stays marked for the next.
    bool commit(ObjectMemory& memory, const cv::Mat& bgr, std::int64_t t_us);

    /// Notes a sighting for the next commit(). At most kMaxRegions; more are left out.
    void note(std::int64_t object_id, const Observation& observation, const VehiclePose& pose);

    [[nodiscard]] std::int64_t session() const { return session_; }
    [[nodiscard]] const std::string& error() const { return error_; }
    [[nodiscard]] const StoreCounters& counters() const { return counters_; }

private:
    struct Note {
        std::int64_t object_id = 0;
        std::int64_t t_us = 0;
        std::int32_t floor = 0;
        Placement place;
        Region region;
        double camera[6] = {};
        std::int32_t features = 0;
    };

    [[nodiscard]] bool run(const char* sql);
    [[nodiscard]] bool migrate();
    [[nodiscard]] bool prepare(const char* sql, sqlite3_stmt*& statement);
    [[nodiscard]] bool step(sqlite3_stmt* statement);
    [[nodiscard]] bool write(ObjectMemory& memory, const cv::Mat& bgr, std::int64_t t_us);
    [[nodiscard]] bool write_object(const KnownObject& object);
    [[nodiscard]] bool write_view(const KnownObject& object, std::size_t slot, const cv::Mat& bgr);
    [[nodiscard]] bool fail(const char* what);

    sqlite3* db_ = nullptr;
    sqlite3_stmt* put_object_ = nullptr;
    sqlite3_stmt* put_view_ = nullptr;
    sqlite3_stmt* put_sighting_ = nullptr;
    sqlite3_stmt* trim_sightings_ = nullptr;
    std::int64_t session_ = 0;
    Bounded<Note, kMaxRegions> notes_;
    std::string error_;
    StoreCounters counters_;
};

}  // namespace noctule
