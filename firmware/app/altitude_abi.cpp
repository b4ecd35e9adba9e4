/// The altitude filter as a shared library for Python: one call flies one recorded or simulated set of samples.
///
/// Built into libnoctule_sim_abi.so beside sim_abi.cpp. The samples are cut into frames at the scans' stamps, as NavNode does.
#include <chrono>
#include <cstddef>
#include <cstdint>

#include "estimate/altitude_filter.hpp"
#include "params.gen.hpp"

namespace {

using noctule::AltitudeFilter;
using noctule::Level;

std::int64_t monotonic_ns() {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

extern "C" {

/// What one flight brings: arrays of one time each, oldest first. Frames Body and Map, SI.
struct noctule_altitude_input {
    std::size_t imu_count;
    const std::int64_t* imu_t_us;
    const float* accel_m_s2;         // (imu_count, 3)
    std::size_t attitude_count;
    const std::int64_t* attitude_t_us;
    const float* roll_pitch_rad;     // (attitude_count, 2)
    std::size_t range_count;         // both directions are read at the same times
    const std::int64_t* range_t_us;
    const float* range_down_m;       // NaN: nothing
    const float* range_up_m;
    float range_min_m;
    float range_max_m;
    std::size_t scan_count;
    const std::int64_t* scan_t_us;
    const float* planar;             // (scan_count, 5): x, y, yaw, vx, vy
    const std::int8_t* landed;       // (scan_count): 0 unknown, 1 on the ground, 2 in the air
    const float* baro_m;             // (range_count), read with the ranges; null: there is no barometer
};

/// A level or a surface of the building, as Python reads it.
struct noctule_altitude_level {
    float z_m;
    float z_var_m2;
    float x_min_m;
    float y_min_m;
    float x_max_m;
    float y_max_m;
    std::int32_t facing;
    std::int32_t floor;
    std::int32_t seen;
};

struct noctule_altitude {
    noctule::Parameters parameters;
    AltitudeFilter* filter = nullptr;  // made by the first run, when the parameters are complete
    noctule::SensorFrame frame;
};

}

namespace {

template <class Levels>
std::size_t write_levels(const Levels& levels, noctule_altitude_level* const out, const std::size_t capacity) {
    std::size_t n = 0;
    for (const Level& l : levels) {
        if (n == capacity) { break; }
        out[n++] = {l.z_m, l.z_var_m2, l.x_min_m, l.y_min_m, l.x_max_m, l.y_max_m, l.facing, l.floor ? 1 : 0, l.seen};
    }
    return n;
}

}  // namespace

extern "C" {

noctule_altitude* noctule_altitude_create() { return new noctule_altitude; }

void noctule_altitude_destroy(noctule_altitude* self) {
    delete self->filter;
    delete self;
}

/// 0 stored; 1 no such name or id; 2 out of range or not whole; 3 too late, it has run.
int noctule_altitude_set_parameter(noctule_altitude* self, const char* name_or_id, const double value) {
    if (self->filter != nullptr) { return 3; }
    const noctule::ParameterRow* row = noctule::find_parameter(name_or_id);
    if (row == nullptr) { return 1; }
    return noctule::set_parameter(self->parameters, *row, static_cast<float>(value)) == noctule::ParameterSet::stored ? 0 : 2;
}

/// Runs one step a scan. out (scan_count, 8): z, vz, variance of z, variance of vz, ground, ceiling, floor, valid. step_ns: (scan_count).
void noctule_altitude_run(noctule_altitude* self, const noctule_altitude_input* in, float* out, std::int64_t* step_ns) {
    if (self->filter == nullptr) { self->filter = new AltitudeFilter(self->parameters); }
    noctule::SensorFrame& frame = self->frame;
    std::size_t imu = 0;
    std::size_t attitude = 0;
    std::size_t range = 0;
    for (std::size_t k = 0; k < in->scan_count; ++k) {
        const std::int64_t t_us = in->scan_t_us[k];
        frame.imu.clear();
        frame.attitude.clear();
        frame.range_up.clear();
        frame.range_down.clear();
        frame.baro.clear();
        frame.vehicle.clear();
        frame.command.clear();
        frame.scan.t_us = t_us;
        for (; imu < in->imu_count && in->imu_t_us[imu] <= t_us; ++imu) {
            const float* const a = in->accel_m_s2 + 3 * imu;
            (void)frame.imu.push(noctule::ImuSample{in->imu_t_us[imu], {a[0], a[1], a[2]}, {}});
        }
        for (; attitude < in->attitude_count && in->attitude_t_us[attitude] <= t_us; ++attitude) {
            const float* const a = in->roll_pitch_rad + 2 * attitude;
            (void)frame.attitude.push(noctule::AttitudeSample{in->attitude_t_us[attitude], a[0], a[1]});
        }
        for (; range < in->range_count && in->range_t_us[range] <= t_us; ++range) {
            const std::int64_t t_range_us = in->range_t_us[range];
            (void)frame.range_down.push(noctule::RangeSample{t_range_us, in->range_down_m[range], in->range_min_m, in->range_max_m});
            (void)frame.range_up.push(noctule::RangeSample{t_range_us, in->range_up_m[range], in->range_min_m, in->range_max_m});
            if (in->baro_m != nullptr) { (void)frame.baro.push(noctule::BaroSample{t_range_us, in->baro_m[range]}); }
        }
        noctule::VehicleSample vehicle;
        vehicle.t_us = t_us;
        vehicle.landed = static_cast<noctule::VehicleSample::Landed>(in->landed[k]);
        vehicle.armed = vehicle.landed == noctule::VehicleSample::Landed::in_air;
        (void)frame.vehicle.push(vehicle);
        const float* const p = in->planar + 5 * k;
        noctule::PlanarEstimate planar;
        planar.pose_map_body = {p[0], p[1], p[2]};
        planar.vx_m_s = p[3];
        planar.vy_m_s = p[4];
        planar.quality = 100;
        const std::int64_t begin_ns = monotonic_ns();
        const noctule::AltitudeEstimate& e = self->filter->update(frame, planar);
        step_ns[k] = monotonic_ns() - begin_ns;
        float* const o = out + 8 * k;
        o[0] = e.z_m;
        o[1] = e.vz_m_s;
        o[2] = e.z_var_m2;
        o[3] = e.vz_var_m2_s2;
        o[4] = e.ground_z_m;
        o[5] = e.ceiling_z_m;
        o[6] = e.floor_z_m;
        o[7] = e.valid ? 1.0F : 0.0F;
    }
}

/// Levels known after the last run; returns how many were written, at most `capacity`.
std::size_t noctule_altitude_levels(const noctule_altitude* self, noctule_altitude_level* out, const std::size_t capacity) {
    return self->filter == nullptr ? 0 : write_levels(self->filter->levels(), out, capacity);
}

/// Floors and ceilings of the building; returns how many were written, at most `capacity`.
std::size_t noctule_altitude_surfaces(const noctule_altitude* self, noctule_altitude_level* out, const std::size_t capacity) {
    if (self->filter == nullptr) { return 0; }
    noctule::Bounded<Level, noctule::kMaxSurfaces> surfaces;
    self->filter->surfaces(surfaces);
    return write_levels(surfaces, out, capacity);
}

/// Counters in the order of AltitudeCounters; returns how many.
std::size_t noctule_altitude_counters(const noctule_altitude* self, std::uint32_t* out, const std::size_t capacity) {
    if (self->filter == nullptr) { return 0; }
    const noctule::AltitudeCounters& c = self->filter->counters();
    const std::uint32_t all[] = {c.matched,         c.founded,          c.unmatched,        c.refused_empty,
                                 c.refused_input,   c.refused_range,    c.refused_tilt,     c.refused_time,
                                 c.inertial_refused, c.frames_refused,  c.levels_confirmed, c.levels_forgotten,
                                 c.levels_merged,   c.levels_evicted,   c.shifts,           c.drifts,
                                 c.baro_used,       c.baro_refused,     c.baro_restarts};
    std::size_t n = 0;
    for (const std::uint32_t value : all) {
        if (n == capacity) { break; }
        out[n++] = value;
    }
    return n;
}

std::size_t noctule_altitude_bytes() { return sizeof(AltitudeFilter); }
}
