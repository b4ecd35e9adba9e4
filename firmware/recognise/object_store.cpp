#include "recognise/object_store.hpp"

#include <sqlite3.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

#include <opencv2/imgproc.hpp>

namespace noctule {
namespace {

// Each entry takes a database from the version before it to its own place in the list; once released an entry never changes.
constexpr std::array<const char*, ObjectStore::kSchema> kMigrations{
    R"sql(
CREATE TABLE session(id INTEGER PRIMARY KEY, started TEXT NOT NULL);
CREATE TABLE object(
  id INTEGER PRIMARY KEY, session INTEGER NOT NULL REFERENCES session(id), confirmed INTEGER NOT NULL, floor INTEGER NOT NULL,
  x_m REAL NOT NULL, y_m REAL NOT NULL, z_m REAL NOT NULL, xx_m2 REAL NOT NULL, xy_m2 REAL NOT NULL, yy_m2 REAL NOT NULL,
  width_m REAL NOT NULL, height_m REAL NOT NULL, first_seen_us INTEGER NOT NULL, last_seen_us INTEGER NOT NULL,
  sightings INTEGER NOT NULL, state BLOB NOT NULL);
CREATE TABLE sighting(
  id INTEGER PRIMARY KEY, object INTEGER NOT NULL REFERENCES object(id), session INTEGER NOT NULL REFERENCES session(id), t_us INTEGER NOT NULL,
  floor INTEGER NOT NULL, x_m REAL NOT NULL, y_m REAL NOT NULL, z_m REAL NOT NULL, along_sigma_m REAL NOT NULL, across_sigma_m REAL NOT NULL,
  range_source INTEGER NOT NULL, whole INTEGER NOT NULL, left_px INTEGER NOT NULL, top_px INTEGER NOT NULL, width_px INTEGER NOT NULL,
  height_px INTEGER NOT NULL, features INTEGER NOT NULL, body_x_m REAL NOT NULL, body_y_m REAL NOT NULL, body_z_m REAL NOT NULL,
  body_roll_rad REAL NOT NULL, body_pitch_rad REAL NOT NULL, body_yaw_rad REAL NOT NULL);
CREATE INDEX sighting_of ON sighting(object, id);
CREATE TABLE view(
  object INTEGER NOT NULL REFERENCES object(id), slot INTEGER NOT NULL, t_us INTEGER NOT NULL, direction_rad REAL NOT NULL,
  distance_m REAL NOT NULL, quality REAL NOT NULL, left_px INTEGER NOT NULL, top_px INTEGER NOT NULL, width_px INTEGER NOT NULL,
  height_px INTEGER NOT NULL, features BLOB NOT NULL, picture BLOB NOT NULL, PRIMARY KEY(object, slot));
)sql",
    R"sql(
ALTER TABLE object ADD COLUMN textured INTEGER NOT NULL DEFAULT 0;
ALTER TABLE object ADD COLUMN colour BLOB NOT NULL DEFAULT x'';
ALTER TABLE object ADD COLUMN moments BLOB NOT NULL DEFAULT x'';
)sql"};

constexpr int kMargin_px = 8;            // around an object in its picture
constexpr int kPictureSide_px = 160;     // a larger picture is halved

/// Numbers of an object that only the fusion needs, as they lie in the column `state`.
struct State {
    double weights[6] = {};              // z, width, height, signature, features, strong
    SectorInformation sectors[kSectors];
    std::int32_t whole = 0;
    std::int32_t ranged = 0;             // by the laser
};
static_assert(sizeof(State) == 6 * 8 + kSectors * 48 + 8);

/// One feature as it lies in the column `features`: x, y, scale [px], orientation [rad], 1 for bright, 64 values.
struct PackedFeature {
    float point[5] = {};
    float descriptor[64] = {};
};
static_assert(sizeof(PackedFeature) == 69 * 4);

/// A Windows bitmap, 24 bit, rows from below: every program opens it and no library is needed.
void bitmap(const cv::Mat& bgr, std::vector<std::uint8_t>& out) {
    const std::size_t line = (static_cast<std::size_t>(bgr.cols) * 3U + 3U) & ~std::size_t{3};
    const std::size_t size = 54U + line * static_cast<std::size_t>(bgr.rows);
    out.assign(size, 0);
    const auto put = [&](const std::size_t at, const std::uint32_t value, const std::size_t bytes) {
        for (std::size_t i = 0; i < bytes; ++i) { out[at + i] = static_cast<std::uint8_t>(value >> (8U * i)); }
    };
    out[0] = 'B';
    out[1] = 'M';
    put(2, static_cast<std::uint32_t>(size), 4);
    put(10, 54, 4);
    put(14, 40, 4);
    put(18, static_cast<std::uint32_t>(bgr.cols), 4);
    put(22, static_cast<std::uint32_t>(bgr.rows), 4);
    put(26, 1, 2);
    put(28, 24, 2);
    for (int y = 0; y < bgr.rows; ++y) {
        std::memcpy(&out[54U + line * static_cast<std::size_t>(bgr.rows - 1 - y)], bgr.ptr<std::uint8_t>(y), static_cast<std::size_t>(bgr.cols) * 3U);
    }
}

/// The picture of an object: its box with a margin, cut from the frame.
cv::Mat cut(const cv::Mat& bgr, const Region& r) {
    const cv::Rect box(r.left_px - kMargin_px, r.top_px - kMargin_px, r.width_px + 2 * kMargin_px, r.height_px + 2 * kMargin_px);
    cv::Mat picture = bgr(box & cv::Rect(0, 0, bgr.cols, bgr.rows));
    if (std::max(picture.cols, picture.rows) > kPictureSide_px) {
        cv::Mat half;
        cv::resize(picture, half, {}, 0.5, 0.5, cv::INTER_AREA);
        return half;
    }
    return picture;
}

void bind_blob(sqlite3_stmt* const s, const int column, const void* const data, const std::size_t bytes) {
    sqlite3_bind_blob(s, column, bytes > 0 ? data : "", static_cast<int>(bytes), SQLITE_TRANSIENT);
}

template <class T, std::size_t N>
void read_floats(sqlite3_stmt* const s, const int column, std::array<T, N>& out) {
    if (sqlite3_column_bytes(s, column) == static_cast<int>(sizeof out)) { std::memcpy(out.data(), sqlite3_column_blob(s, column), sizeof out); }
}

}  // namespace

bool ObjectStore::fail(const char* const what) {
    error_ = std::string{what} + ": " + (db_ != nullptr ? sqlite3_errmsg(db_) : "no database");
    return false;
}

bool ObjectStore::run(const char* const sql) { return sqlite3_exec(db_, sql, nullptr, nullptr, nullptr) == SQLITE_OK || fail(sql); }

bool ObjectStore::prepare(const char* const sql, sqlite3_stmt*& statement) {
    return sqlite3_prepare_v3(db_, sql, -1, SQLITE_PREPARE_PERSISTENT, &statement, nullptr) == SQLITE_OK || fail("prepare");
}

bool ObjectStore::step(sqlite3_stmt* const statement) {
    const int result = sqlite3_step(statement);
    const bool done = result == SQLITE_DONE || fail("write");
    sqlite3_reset(statement);
    return done;
}

bool ObjectStore::open(const std::string& path, const std::string& started) {
    close();
    if (sqlite3_open_v2(path.c_str(), &db_, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, nullptr) != SQLITE_OK) {
        static_cast<void>(fail(path.c_str()));
        close();
        return false;
    }
    sqlite3_busy_timeout(db_, 2000);
    bool ready = run("PRAGMA journal_mode=WAL") && run("PRAGMA synchronous=FULL") && run("PRAGMA cache_size=-512") && run("PRAGMA wal_autocheckpoint=400") &&
                 run("PRAGMA journal_size_limit=4194304") && migrate();
    sqlite3_stmt* insert = nullptr;
    ready = ready && prepare("INSERT INTO session(started) VALUES(?)", insert);
    if (ready) {
        sqlite3_bind_text(insert, 1, started.c_str(), -1, SQLITE_TRANSIENT);
        ready = step(insert);
        session_ = sqlite3_last_insert_rowid(db_);
    }
    sqlite3_finalize(insert);
    ready = ready &&
            prepare("INSERT OR REPLACE INTO object(id,session,confirmed,floor,x_m,y_m,z_m,xx_m2,xy_m2,yy_m2,width_m,height_m,first_seen_us,last_seen_us,"
                    "sightings,state,textured,colour,moments) VALUES(?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)", put_object_) &&
            prepare("INSERT OR REPLACE INTO view VALUES(?,?,?,?,?,?,?,?,?,?,?,?)", put_view_) &&
            prepare("INSERT INTO sighting(object,session,t_us,floor,x_m,y_m,z_m,along_sigma_m,across_sigma_m,range_source,whole,left_px,top_px,width_px,"
                    "height_px,features,body_x_m,body_y_m,body_z_m,body_roll_rad,body_pitch_rad,body_yaw_rad) "
                    "VALUES(?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)", put_sighting_) &&
            prepare("DELETE FROM sighting WHERE object=?1 AND id<=(SELECT id FROM sighting WHERE object=?1 ORDER BY id DESC LIMIT 1 OFFSET ?2)", trim_sightings_);
    if (!ready) {
        error_ = path + ": " + error_;
        close();
    }
    return ready;
}

void ObjectStore::close() {
    for (sqlite3_stmt** s : {&put_object_, &put_view_, &put_sighting_, &trim_sightings_}) {
        sqlite3_finalize(*s);
        *s = nullptr;
    }
    if (db_ != nullptr) { sqlite3_close(db_); }
    db_ = nullptr;
}

bool ObjectStore::migrate() {
    sqlite3_stmt* ask = nullptr;
    const auto number = [&](const char* const sql, int& value) {
        if (!prepare(sql, ask)) { return false; }
        const bool got = sqlite3_step(ask) == SQLITE_ROW;
        value = got ? sqlite3_column_int(ask, 0) : 0;
        sqlite3_finalize(ask);
        return got || fail(sql);
    };
    int version = 0;
    int application = 0;
    int tables = 0;
    if (!number("PRAGMA user_version", version) || !number("PRAGMA application_id", application) || !number("SELECT count(*) FROM sqlite_master", tables)) {
        return false;
    }
    if ((tables > 0 || application != 0) && application != kApplication) {
        error_ = "is a database of another program";
        return false;
    }
    if (version > kSchema) {
        error_ = "has schema " + std::to_string(version) + ", this program knows up to " + std::to_string(kSchema);
        return false;
    }
    for (int next = version; next < kSchema; ++next) {
        // The version is set inside the transaction: a cut leaves the old schema or the new one, never half of it.
        const std::string sql = std::string{"BEGIN IMMEDIATE;"} + kMigrations[static_cast<std::size_t>(next)] + "PRAGMA application_id=" +
                                std::to_string(kApplication) + ";PRAGMA user_version=" + std::to_string(next + 1) + ";COMMIT;";
        if (!run(sql.c_str())) {
            sqlite3_exec(db_, "ROLLBACK", nullptr, nullptr, nullptr);
            error_ = "schema " + std::to_string(next + 1) + ": " + sqlite3_errmsg(db_);
            return false;
        }
    }
    return true;
}

bool ObjectStore::load(ObjectMemory& memory, const bool resume) {
    sqlite3_stmt* s = nullptr;
    if (!prepare("SELECT id,confirmed,floor,x_m,y_m,z_m,xx_m2,xy_m2,yy_m2,width_m,height_m,first_seen_us,last_seen_us,sightings,state,textured,colour,moments "
                 "FROM object ORDER BY id", s)) {
        return false;
    }
    int result = SQLITE_ROW;
    while ((result = sqlite3_step(s)) == SQLITE_ROW) {
        memory.next_id = std::max<std::int64_t>(memory.next_id, sqlite3_column_int64(s, 0) + 1);
        static const KnownObject fresh{};
        if (!memory.objects().push(fresh)) { continue; }
        KnownObject& o = memory.objects().back();
        o.id = sqlite3_column_int64(s, 0);
        o.confirmed = sqlite3_column_int(s, 1) != 0;
        o.placed = resume;
        o.floor = sqlite3_column_int(s, 2);
        double* const numbers[8] = {&o.x_m, &o.y_m, &o.z_m, &o.xx_m2, &o.xy_m2, &o.yy_m2, &o.width_m, &o.height_m};
        for (int i = 0; i < 8; ++i) { *numbers[i] = sqlite3_column_double(s, 3 + i); }
        o.first_seen_us = sqlite3_column_int64(s, 11);
        o.last_seen_us = sqlite3_column_int64(s, 12);
        o.sightings = sqlite3_column_int(s, 13);
        State state;
        if (sqlite3_column_bytes(s, 14) == static_cast<int>(sizeof state)) { std::memcpy(&state, sqlite3_column_blob(s, 14), sizeof state); }
        o.z_weight = state.weights[0];
        o.width_weight = state.weights[1];
        o.height_weight = state.weights[2];
        o.signature_weight = state.weights[3];
        o.features_mean = state.weights[4];
        o.strong = state.weights[5];
        o.whole = state.whole;
        o.ranged = state.ranged;
        std::copy(std::begin(state.sectors), std::end(state.sectors), o.sectors.begin());
        read_floats(s, 16, o.signature.colour);
        read_floats(s, 17, o.signature.moments);
    }
    sqlite3_finalize(s);
    if (result != SQLITE_DONE) { return fail("load"); }
    if (!prepare("SELECT object,slot,t_us,direction_rad,distance_m,quality,left_px,top_px,width_px,height_px,features FROM view", s)) { return false; }
    while ((result = sqlite3_step(s)) == SQLITE_ROW) {
        const std::int64_t id = sqlite3_column_int64(s, 0);
        const int slot = sqlite3_column_int(s, 1);
        KnownObject* const o = std::find_if(memory.objects().begin(), memory.objects().end(), [&](const KnownObject& k) { return k.id == id; });
        if (o == memory.objects().end() || slot < 0 || slot >= static_cast<int>(kMaxObjectViews)) { continue; }
        ObjectView& view = o->views[static_cast<std::size_t>(slot)];
        view.used = true;
        view.t_us = sqlite3_column_int64(s, 2);
        view.direction_rad = sqlite3_column_double(s, 3);
        view.distance_m = sqlite3_column_double(s, 4);
        view.quality = sqlite3_column_double(s, 5);
        view.region.left_px = sqlite3_column_int(s, 6);
        view.region.top_px = sqlite3_column_int(s, 7);
        view.region.width_px = sqlite3_column_int(s, 8);
        view.region.height_px = sqlite3_column_int(s, 9);
        const std::uint8_t* const bytes = static_cast<const std::uint8_t*>(sqlite3_column_blob(s, 10));
        const std::size_t count = static_cast<std::size_t>(sqlite3_column_bytes(s, 10)) / sizeof(PackedFeature);
        for (std::size_t i = 0; i < count; ++i) {
            PackedFeature packed;
            std::memcpy(&packed, bytes + i * sizeof packed, sizeof packed);
            SurfFeature feature;
            feature.point.x_px = packed.point[0];
            feature.point.y_px = packed.point[1];
            feature.point.scale_px = packed.point[2];
            feature.point.orientation_rad = packed.point[3];
            feature.point.bright = packed.point[4] > 0.5F;
            std::copy(std::begin(packed.descriptor), std::end(packed.descriptor), feature.descriptor.begin());
            if (!view.features.push(feature)) { break; }
        }
    }
    sqlite3_finalize(s);
    return result == SQLITE_DONE || fail("load");
}

void ObjectStore::note(const std::int64_t object_id, const Observation& observation, const VehiclePose& pose) {
    Note n;
    n.object_id = object_id;
    n.t_us = observation.t_us;
    n.floor = observation.floor;
    n.place = observation.part.place;
    n.region = observation.part.region;
    const double camera[6] = {pose.x_m, pose.y_m, pose.z_m, pose.roll_rad, pose.pitch_rad, pose.yaw_rad};
    std::copy(std::begin(camera), std::end(camera), std::begin(n.camera));
    n.features = static_cast<std::int32_t>(observation.features.size());
    static_cast<void>(notes_.push(n));
}

bool ObjectStore::commit(ObjectMemory& memory, const cv::Mat& bgr, const std::int64_t t_us) {
    if (db_ == nullptr) { return false; }
    bool work = !memory.removals().empty() || !notes_.empty();
    for (const KnownObject& o : memory.objects()) { work = work || o.changed; }
    if (!work) { return true; }
    if (!(run("BEGIN IMMEDIATE") && write(memory, bgr, t_us) && run("COMMIT"))) {
        sqlite3_exec(db_, "ROLLBACK", nullptr, nullptr, nullptr);
        ++counters_.failed;
        return false;
    }
    ++counters_.commits;
    for (KnownObject& o : memory.objects()) {
        o.changed = false;
        for (ObjectView& view : o.views) { view.changed = false; }
    }
    memory.clear_removals();
    notes_.clear();
    return true;
}

bool ObjectStore::write(ObjectMemory& memory, const cv::Mat& bgr, const std::int64_t t_us) {
    for (const KnownObject& o : memory.objects()) {
        if (o.changed && !write_object(o)) { return false; }
    }
    for (const Note& n : notes_) {
        sqlite3_stmt* const s = put_sighting_;
        sqlite3_bind_int64(s, 1, n.object_id);
        sqlite3_bind_int64(s, 2, session_);
        sqlite3_bind_int64(s, 3, n.t_us);
        sqlite3_bind_int(s, 4, n.floor);
        const double numbers[5] = {n.place.x_m, n.place.y_m, n.place.z_m, n.place.along_sigma_m, n.place.across_sigma_m};
        for (int i = 0; i < 5; ++i) { sqlite3_bind_double(s, 5 + i, numbers[i]); }
        const int whole[7] = {static_cast<int>(n.place.source), n.place.whole ? 1 : 0, n.region.left_px, n.region.top_px,
                              n.region.width_px, n.region.height_px, n.features};
        for (int i = 0; i < 7; ++i) { sqlite3_bind_int(s, 10 + i, whole[i]); }
        for (int i = 0; i < 6; ++i) { sqlite3_bind_double(s, 17 + i, n.camera[i]); }
        if (!step(s)) { return false; }
        sqlite3_bind_int64(trim_sightings_, 1, n.object_id);
        sqlite3_bind_int(trim_sightings_, 2, static_cast<int>(kMaxObjectSightings));
        if (!step(trim_sightings_)) { return false; }
    }
    for (const Removal& r : memory.removals()) {
        const std::string id = std::to_string(r.id);
        const std::string into = std::to_string(r.into);
        std::string sql;
        if (r.into != 0) {
            sql = "UPDATE sighting SET object=" + into + " WHERE object=" + id + ";";
            sql += "DELETE FROM view WHERE object=" + into + " AND slot IN (SELECT n.slot FROM view n JOIN view o ON o.slot=n.slot WHERE n.object=" + id +
                   " AND o.object=" + into + " AND n.quality>o.quality);";
            sql += "UPDATE OR IGNORE view SET object=" + into + " WHERE object=" + id + ";";
        }
        sql += "DELETE FROM view WHERE object=" + id + ";DELETE FROM sighting WHERE object=" + id + ";DELETE FROM object WHERE id=" + id + ";";
        if (!run(sql.c_str())) { return false; }
    }
    for (const KnownObject& o : memory.objects()) {
        for (std::size_t slot = 0; slot < kMaxObjectViews; ++slot) {
            const ObjectView& view = o.views[slot];
            // A picture of an earlier frame, whose transaction failed, cannot be cut any more.
            if (view.used && view.changed && view.t_us == t_us && !write_view(o, slot, bgr)) { return false; }
        }
    }
    return true;
}

bool ObjectStore::write_object(const KnownObject& o) {
    sqlite3_stmt* const s = put_object_;
    sqlite3_bind_int64(s, 1, o.id);
    sqlite3_bind_int64(s, 2, session_);
    sqlite3_bind_int(s, 3, o.confirmed ? 1 : 0);
    sqlite3_bind_int(s, 4, o.floor);
    const double numbers[8] = {o.x_m, o.y_m, o.z_m, o.xx_m2, o.xy_m2, o.yy_m2, o.width_m, o.height_m};
    for (int i = 0; i < 8; ++i) { sqlite3_bind_double(s, 5 + i, numbers[i]); }
    sqlite3_bind_int64(s, 13, o.first_seen_us);
    sqlite3_bind_int64(s, 14, o.last_seen_us);
    sqlite3_bind_int(s, 15, o.sightings);
    State state;
    const double weights[6] = {o.z_weight, o.width_weight, o.height_weight, o.signature_weight, o.features_mean, o.strong};
    std::copy(std::begin(weights), std::end(weights), std::begin(state.weights));
    std::copy(o.sectors.begin(), o.sectors.end(), std::begin(state.sectors));
    state.whole = o.whole;
    state.ranged = o.ranged;
    bind_blob(s, 16, &state, sizeof state);
    sqlite3_bind_int(s, 17, o.textured() ? 1 : 0);
    bind_blob(s, 18, o.signature.colour.data(), sizeof o.signature.colour);
    bind_blob(s, 19, o.signature.moments.data(), sizeof o.signature.moments);
    return step(s);
}

bool ObjectStore::write_view(const KnownObject& o, const std::size_t slot, const cv::Mat& bgr) {
    const ObjectView& view = o.views[slot];
    std::vector<PackedFeature> features(view.features.size());
    for (std::size_t i = 0; i < features.size(); ++i) {
        const SurfFeature& f = view.features[i];
        const float point[5] = {f.point.x_px, f.point.y_px, f.point.scale_px, f.point.orientation_rad, f.point.bright ? 1.0F : 0.0F};
        std::copy(std::begin(point), std::end(point), std::begin(features[i].point));
        std::copy(f.descriptor.begin(), f.descriptor.end(), std::begin(features[i].descriptor));
    }
    std::vector<std::uint8_t> picture;
    if (!bgr.empty()) { bitmap(cut(bgr, view.region), picture); }
    sqlite3_stmt* const s = put_view_;
    sqlite3_bind_int64(s, 1, o.id);
    sqlite3_bind_int(s, 2, static_cast<int>(slot));
    sqlite3_bind_int64(s, 3, view.t_us);
    sqlite3_bind_double(s, 4, view.direction_rad);
    sqlite3_bind_double(s, 5, view.distance_m);
    sqlite3_bind_double(s, 6, view.quality);
    const int box[4] = {view.region.left_px, view.region.top_px, view.region.width_px, view.region.height_px};
    for (int i = 0; i < 4; ++i) { sqlite3_bind_int(s, 7 + i, box[i]); }
    bind_blob(s, 11, features.data(), features.size() * sizeof(PackedFeature));
    bind_blob(s, 12, picture.data(), picture.size());
    return step(s);
}

}  // namespace noctule
