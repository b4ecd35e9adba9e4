/// Localiser and occupancy grid as a shared library for Python: sweeps in, poses and a map out.
///
/// Built into libnoctule_sim_abi.so beside sim_abi.cpp. Motion between two sweeps is either a wheel odometry's increment with its
/// covariance or inertial samples. The two stages are called as Navigator calls them, without height, mission and guard: the
/// laser is taken to be level, at the height of the map's plane. Frames Map, Body and Lidar, SI. One thread a handle.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <ctime>

#include "estimate/localiser.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"

namespace {

/// Processor time of this thread: other programs on the machine do not count.
std::int64_t thread_ns() {
    std::timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<std::int64_t>(now.tv_sec) * 1000000000 + now.tv_nsec;
}

}  // namespace

extern "C" {

/// One sweep and what came before it. Samples oldest first.
struct noctule_replay_sweep {
    std::int64_t t_us;                // stamp: time of the last beam
    std::int32_t count;
    float time_increment_us;
    float bearing_first_rad;
    float bearing_increment_rad;
    float range_min_m;
    float range_max_m;
    const float* range_m;             // (count); infinity: nothing hit, NaN: nothing known
    std::int32_t has_motion;          // 1: the increment below counts and inertial samples are not looked at
    float motion[4];                  // dx, dy [m], dyaw [rad] in Body at the sweep before; dt [s]
    float motion_covariance[6];       // upper triangle of the covariance of dx, dy, dyaw
    std::size_t imu_count;
    const std::int64_t* imu_t_us;
    const float* imu;                 // (imu_count, 6): specific force [m/s^2], rates [rad/s]
    std::size_t attitude_count;
    const std::int64_t* attitude_t_us;
    const float* roll_pitch_rad;      // (attitude_count, 2)
};

/// What the step said.
struct noctule_replay_pose {
    double x_m;
    double y_m;
    double yaw_rad;
    float covariance[6];
    std::int32_t quality;
    std::int32_t reset_counter;
    std::int32_t walls_seen;
    std::int32_t walls_matched;
    std::int32_t landmarks;
    float effective_particles;
    std::int64_t localise_ns;         // processor time
    std::int64_t map_ns;
};

struct noctule_replay_tile {
    std::int32_t tile_x;
    std::int32_t tile_y;
    std::int8_t log_odds[noctule::kTileArea];  // row-major, 0 unknown, positive occupied
};

struct noctule_replay {
    noctule::Parameters parameters;
    noctule::Localiser* localiser = nullptr;  // both made by the first sweep, when the parameters are complete
    noctule::OccupancyGrid* grid = nullptr;
    noctule::SensorFrame frame;
    noctule::Estimate estimate;
    bool mapping = true;
};

noctule_replay* noctule_replay_create() { return new noctule_replay; }

void noctule_replay_destroy(noctule_replay* self) {
    delete self->localiser;
    delete self->grid;
    delete self;
}

/// 0 stored; 1 no such name or id; 2 out of range or not whole; 3 too late, it has run.
int noctule_replay_set_parameter(noctule_replay* self, const char* name_or_id, const double value) {
    if (self->localiser != nullptr) { return 3; }
    const noctule::ParameterRow* row = noctule::find_parameter(name_or_id);
    if (row == nullptr) { return 1; }
    return noctule::set_parameter(self->parameters, *row, static_cast<float>(value)) == noctule::ParameterSet::stored ? 0 : 2;
}

/// 0: sweeps are not entered into the grid.
void noctule_replay_set_mapping(noctule_replay* self, const int on) { self->mapping = on != 0; }

/// One step. A refused sweep gives the last pose again; the counters tell.
void noctule_replay_step(noctule_replay* self, const noctule_replay_sweep* in, noctule_replay_pose* out) {
    if (self->localiser == nullptr) {
        self->localiser = new noctule::Localiser(self->parameters);
        self->grid = new noctule::OccupancyGrid(self->parameters);
    }
    noctule::SensorFrame& frame = self->frame;
    frame.imu.clear();
    frame.attitude.clear();
    for (std::size_t i = 0; i < in->imu_count; ++i) {
        const float* const v = in->imu + 6 * i;
        (void)frame.imu.push(noctule::ImuSample{in->imu_t_us[i], {v[0], v[1], v[2]}, {v[3], v[4], v[5]}});
    }
    for (std::size_t i = 0; i < in->attitude_count; ++i) {
        (void)frame.attitude.push(noctule::AttitudeSample{in->attitude_t_us[i], in->roll_pitch_rad[2 * i], in->roll_pitch_rad[2 * i + 1]});
    }
    noctule::Scan& scan = frame.scan;
    scan.t_us = in->t_us;
    ++scan.seq;
    scan.count = in->count;
    scan.time_increment_us = in->time_increment_us;
    scan.bearing_first_rad = in->bearing_first_rad;
    scan.bearing_increment_rad = in->bearing_increment_rad;
    scan.range_min_m = in->range_min_m;
    scan.range_max_m = in->range_max_m;
    const std::int32_t stored = std::clamp(in->count, 0, static_cast<std::int32_t>(noctule::kMaxBeams));
    std::copy_n(in->range_m, stored, scan.range_m.begin());

    noctule::MotionIncrement motion;
    motion.dx_m = in->motion[0];
    motion.dy_m = in->motion[1];
    motion.dyaw_rad = in->motion[2];
    motion.dt_s = in->motion[3];
    for (std::size_t i = 0, k = 0; i < 3; ++i) {
        for (std::size_t j = i; j < 3; ++j, ++k) { motion.covariance(i, j) = motion.covariance(j, i) = in->motion_covariance[k]; }
    }
    const noctule::AltitudeEstimate no_height;
    const std::int64_t begin_ns = thread_ns();
    const noctule::PlanarEstimate& planar =
        in->has_motion != 0 ? self->localiser->update(frame, no_height, motion) : self->localiser->update(frame, no_height);
    const std::int64_t middle_ns = thread_ns();
    noctule::Estimate& estimate = self->estimate;
    estimate.t_us = in->t_us;
    estimate.planar = planar;
    estimate.altitude.valid = true;  // the map's plane is wherever this laser is
    estimate.altitude.z_m = self->parameters.cruise_height_m;
    // A sweep that was refused has not been levelled: the one before is not entered twice.
    if (self->mapping && self->localiser->level_scan().t_us == in->t_us) { self->grid->integrate(estimate, self->localiser->level_scan()); }
    out->map_ns = thread_ns() - middle_ns;
    out->localise_ns = middle_ns - begin_ns;
    out->x_m = static_cast<double>(planar.pose_map_body.x_m);
    out->y_m = static_cast<double>(planar.pose_map_body.y_m);
    out->yaw_rad = static_cast<double>(planar.pose_map_body.yaw_rad);
    std::copy(planar.covariance.begin(), planar.covariance.end(), out->covariance);
    out->quality = planar.quality;
    out->reset_counter = planar.reset_counter;
    out->walls_seen = planar.walls_seen;
    out->walls_matched = planar.walls_matched;
    out->landmarks = planar.landmarks;
    out->effective_particles = planar.effective_particles;
}

std::int32_t noctule_replay_tile_count(const noctule_replay* self) { return self->grid == nullptr ? 0 : self->grid->tile_count(); }

/// Tile of a slot below noctule_replay_tile_count.
void noctule_replay_read_tile(const noctule_replay* self, const std::int32_t slot, noctule_replay_tile* out) {
    const noctule::GridTile& tile = self->grid->tile(slot);
    out->tile_x = tile.tile_x;
    out->tile_y = tile.tile_y;
    std::copy(tile.log_odds.begin(), tile.log_odds.end(), out->log_odds);
}

/// Edge of a cell [m] and cells along a tile.
void noctule_replay_grid_format(const noctule_replay* self, float* cell_m, std::int32_t* cells_per_tile) {
    *cell_m = self->grid == nullptr ? 0.0F : self->grid->geometry().cell_m();
    *cells_per_tile = noctule::kTileCells;
}

/// Refused samples, refused beams, coasted, blind scans, lost, landmarks evicted, cells evicted, scans not mapped, tiles refused, carried, recognised.
std::size_t noctule_replay_counters(const noctule_replay* self, std::uint32_t* out, const std::size_t capacity) {
    if (self->localiser == nullptr) { return 0; }
    const noctule::Localiser::Counters c = self->localiser->counters();
    const noctule::OccupancyGrid::Counters& g = self->grid->counters();
    const std::uint32_t all[] = {c.refused_samples, c.refused_beams,     c.coasted,       c.blind_scans,  c.lost,
                                 c.landmarks_evicted, c.cells_evicted, g.scans_refused, g.tiles_refused, c.carried, c.recognised};
    std::size_t n = 0;
    for (const std::uint32_t value : all) {
        if (n == capacity) { break; }
        out[n++] = value;
    }
    return n;
}

std::size_t noctule_replay_localiser_bytes() { return sizeof(noctule::Localiser); }
std::size_t noctule_replay_grid_bytes() { return sizeof(noctule::OccupancyGrid); }
}
