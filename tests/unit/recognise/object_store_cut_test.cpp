// The object database under power cuts: after every single write to the disk in turn, with the unsynced writes lost, torn and reordered.
#include <sqlite3.h>

#include <cstdio>
#include <memory>
#include <string>

#include "recognise/object_store.hpp"
#include "unit/recognise/cut_vfs.hpp"
#include "unity.h"

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

using noctule::ObjectMemory;
using noctule::ObjectStore;
using noctule::Observation;

namespace {

constexpr int kFrames = 12;

/// One sighting of a box at (x, y), from two directions in turn.
Observation sighting(const double x_m, const double y_m, const int frame) {
    Observation o;
    o.t_us = 200000 * (frame + 1);
    o.direction_rad = frame % 2 == 0 ? 0.3 : 2.0;
    o.signature.colour[3] = 1.0F;
    o.part.region = {400, 50.0F, 60.0F, 40, 50, 20, 20, 1};
    noctule::Placement& p = o.part.place;
    p.source = noctule::RangeSource::laser;
    p.x_m = x_m;
    p.y_m = y_m;
    p.z_m = 0.6;
    p.bearing_rad = o.direction_rad + 3.14;
    p.distance_m = 2.0;
    p.along_sigma_m = 0.1;
    p.across_sigma_m = 0.05;
    p.width_m = 0.5;
    p.height_m = 1.0;
    p.whole = true;
    p.tall = true;
    return o;
}

struct Flight {
    bool opened = false;
    int told = 0;      // frames whose commit said that it is on the disk
};

/// Two objects, a frame each in turn, until the power goes.
Flight fly() {
    Flight flight;
    const auto memory = std::make_unique<ObjectMemory>();
    ObjectStore store;
    flight.opened = store.open("objects.db", "test") && store.load(*memory, true);
    if (!flight.opened) { return flight; }
    const cv::Mat picture(240, 320, CV_8UC3, cv::Scalar(40, 80, 160));
    for (int frame = 0; frame < kFrames; ++frame) {
        const Observation o = sighting(frame % 3 == 0 ? 4.0 : 1.0, 2.0, frame);
        const int index = memory->enter(o);
        TEST_ASSERT_TRUE(index >= 0);
        store.note(memory->objects()[static_cast<std::size_t>(index)].id, o, noctule::VehiclePose{});
        memory->tidy(o.t_us);
        if (!store.commit(*memory, picture, o.t_us)) { return flight; }
        ++flight.told;
    }
    return flight;
}

int number(sqlite3* const db, const char* const sql) {
    sqlite3_stmt* s = nullptr;
    if (sqlite3_prepare_v2(db, sql, -1, &s, nullptr) != SQLITE_OK) { return -1; }
    const int value = sqlite3_step(s) == SQLITE_ROW ? sqlite3_column_int(s, 0) : -1;
    sqlite3_finalize(s);
    return value;
}

bool sound(sqlite3* const db) {
    sqlite3_stmt* s = nullptr;
    if (sqlite3_prepare_v2(db, "PRAGMA integrity_check", -1, &s, nullptr) != SQLITE_OK) { return false; }
    const bool good = sqlite3_step(s) == SQLITE_ROW && std::string{reinterpret_cast<const char*>(sqlite3_column_text(s, 0))} == "ok";
    sqlite3_finalize(s);
    return good;
}

void nothing_that_was_told_is_lost_at_any_cut() {
    cut_vfs::install();
    cut_vfs::disk() = cut_vfs::Disk{};
    const Flight whole = fly();
    TEST_ASSERT_EQUAL_INT(kFrames, whole.told);
    const std::int64_t writes = cut_vfs::disk().writes;
    TEST_ASSERT_TRUE(writes > 50);
    int cuts = 0;
    for (std::int64_t at = 0; at < writes; ++at) {
        cut_vfs::disk() = cut_vfs::Disk{};
        cut_vfs::disk().cut_after = at;
        const Flight flight = fly();
        cut_vfs::disk().power_back(static_cast<unsigned>(at) + 1U);
        // The power is back: the database opens, holds all that was told and at most the one frame more, and goes on.
        const auto memory = std::make_unique<ObjectMemory>();
        ObjectStore store;
        const bool opened = store.open("objects.db", "again") && store.load(*memory, true);
        if (!opened) { std::printf("cut after write %lld: %s\n", static_cast<long long>(at), store.error().c_str()); }
        TEST_ASSERT_TRUE(opened);
        store.close();
        sqlite3* db = nullptr;
        TEST_ASSERT_EQUAL_INT(SQLITE_OK, sqlite3_open("objects.db", &db));
        TEST_ASSERT_TRUE(sound(db));
        TEST_ASSERT_EQUAL_INT(ObjectStore::kSchema, number(db, "PRAGMA user_version"));
        const int sightings = number(db, "SELECT count(*) FROM sighting");
        TEST_ASSERT_TRUE(sightings >= flight.told && sightings <= flight.told + 1);
        TEST_ASSERT_EQUAL_INT(sightings, number(db, "SELECT coalesce(sum(sightings), 0) FROM object"));
        TEST_ASSERT_EQUAL_INT(static_cast<int>(memory->objects().size()), number(db, "SELECT count(*) FROM object"));
        sqlite3_close(db);
        ++cuts;
    }
    std::printf("%d cuts, database opened after each, nothing told was lost\n", cuts);
}

}  // namespace

int main() {
    UNITY_BEGIN();
    RUN_TEST(nothing_that_was_told_is_lost_at_any_cut);
    return UNITY_END();
}
