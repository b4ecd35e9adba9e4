/// Grid, mission, reference and guard as a shared library for Python, with the pose given: exploring without estimators.
///
/// Built into libnoctule_sim_abi.so beside sim_abi.cpp. The stages are called as Navigator calls them; pose and velocity are
/// the caller's, the sweep is taken to be level and still. For benches that need hundreds of explorations in minutes.
/// Frames Map and Body, SI. One thread a handle.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <ctime>
#include <memory>

#include "command/guard.hpp"
#include "command/reference.hpp"
#include "map/occupancy_grid.hpp"
#include "params.gen.hpp"
#include "plan/mission.hpp"

namespace {

/// Processor time of this thread: other programs on the machine do not count.
std::int64_t thread_ns() {
    std::timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<std::int64_t>(now.tv_sec) * 1000000000 + now.tv_nsec;
}

}  // namespace

extern "C" {

/// What one step gets.
struct noctule_explore_in {
    std::int64_t t_us;
    double x_m;
    double y_m;
    double z_m;
    double yaw_rad;
    double vx_m_s;
    double vy_m_s;
    double ceiling_z_m;
    const double* range_m;            // (count); infinity: nothing hit
    std::int32_t count;
    float bearing_first_rad;
    float bearing_increment_rad;
    float range_max_m;
    std::int32_t armed;               // 1: armed and in our mode
    std::int32_t on_ground;
    std::int32_t order;               // value of noctule::Order
};

/// What the step said.
struct noctule_explore_out {
    double x_m;
    double y_m;
    double z_m;
    double yaw_rad;
    double vx_m_s;
    double vy_m_s;
    double vz_m_s;
    double goal_x_m;
    double goal_y_m;
    std::int64_t map_ns;              // processor time
    std::int64_t plan_ns;
    std::int32_t setpoint_valid;
    std::int32_t state;               // value of noctule::MissionState
    std::int32_t reason;
    std::int32_t ready;
    std::int32_t goal_valid;
    std::int32_t guard_rule;
    float known_area_m2;
    float unknown_share;              // of the paper's policy
    std::int32_t goals;               // the explorer's counters
    std::int32_t switches;
    std::int32_t stuck;
    std::int32_t in_vain;
    std::int32_t back_and_forth;
    std::int32_t stops;               // of the tour
    std::int32_t path_points;
};

struct noctule_explore_tile {
    std::int32_t tile_x;
    std::int32_t tile_y;
    std::int8_t log_odds[noctule::kTileArea];  // row-major, 0 unknown, positive occupied
};

struct noctule_explore {
    struct Stages {
        explicit Stages(const noctule::Parameters& p) : grid(p), mission(p), reference(p), guard(p) {}
        noctule::OccupancyGrid grid;
        noctule::Mission mission;
        noctule::Reference reference;
        noctule::Guard guard;
    };
    noctule::Parameters parameters;
    std::unique_ptr<Stages> stages;   // made by the first step, when the parameters are complete
    noctule::Estimate estimate;
    noctule::LevelScan scan;
    noctule::VehicleSample vehicle;
    noctule::Bounded<noctule::CommandSample, noctule::kMaxCommandPerStep> commands;
};

noctule_explore* noctule_explore_create() { return new noctule_explore; }

void noctule_explore_destroy(noctule_explore* self) { delete self; }

/// 0 stored; 1 no such name or id; 2 out of range or not whole; 3 too late, the first step has been made.
int noctule_explore_set_parameter(noctule_explore* self, const char* name_or_id, const double value) {
    if (self->stages) { return 3; }
    const noctule::ParameterRow* row = noctule::find_parameter(name_or_id);
    if (row == nullptr) { return 1; }
    return noctule::set_parameter(self->parameters, *row, static_cast<float>(value)) == noctule::ParameterSet::stored ? 0 : 2;
}

void noctule_explore_step(noctule_explore* self, const noctule_explore_in* in, noctule_explore_out* out) {
    using namespace noctule;
    if (!self->stages) { self->stages = std::make_unique<noctule_explore::Stages>(self->parameters); }
    noctule_explore::Stages& s = *self->stages;
    LevelScan& scan = self->scan;
    scan.t_us = in->t_us;
    scan.range_max_m = in->range_max_m;
    scan.bearing_increment_rad = in->bearing_increment_rad;
    scan.range_noise_m = self->parameters.laser_range_noise_m;
    scan.points.clear();
    for (std::int32_t k = 0; k < in->count; ++k) {
        const bool hit = in->range_m[k] < static_cast<double>(in->range_max_m);
        const float range_m = hit ? static_cast<float>(in->range_m[k]) : in->range_max_m;
        const float bearing_rad = in->bearing_first_rad + static_cast<float>(k) * in->bearing_increment_rad;
        ScanPoint point;
        point.x_m = range_m * std::cos(bearing_rad);
        point.y_m = range_m * std::sin(bearing_rad);
        point.range_m = range_m;
        point.beam = static_cast<std::int16_t>(k);
        point.hit = hit;
        if (!scan.points.push(point)) { break; }
    }
    Estimate& e = self->estimate;
    e.t_us = in->t_us;
    e.planar.pose_map_body = {static_cast<float>(in->x_m), static_cast<float>(in->y_m), wrap_angle(static_cast<float>(in->yaw_rad))};
    e.planar.vx_m_s = static_cast<float>(in->vx_m_s);
    e.planar.vy_m_s = static_cast<float>(in->vy_m_s);
    e.planar.quality = 100;
    e.altitude.z_m = static_cast<float>(in->z_m);
    e.altitude.ground_z_m = 0.0F;
    e.altitude.ceiling_z_m = static_cast<float>(in->ceiling_z_m);
    e.altitude.floor_z_m = 0.0F;
    e.altitude.valid = true;
    self->vehicle.t_us = in->t_us;
    self->vehicle.armed = self->vehicle.offboard = in->armed != 0;
    self->vehicle.landed = in->on_ground != 0 ? VehicleSample::Landed::on_ground : VehicleSample::Landed::in_air;
    self->vehicle.battery_remaining = 1.0F;
    self->commands.clear();
    if (in->order != 0) { static_cast<void>(self->commands.push({in->t_us, static_cast<Order>(in->order)})); }

    const std::int64_t began_ns = thread_ns();
    s.grid.integrate(e, scan);
    const std::int64_t mapped_ns = thread_ns();
    const Target& target = s.mission.step(e, s.grid, self->vehicle, self->commands, s.reference.pose(), in->t_us);
    const std::int64_t planned_ns = thread_ns();
    const Setpoint& wanted = s.reference.step(e, target, in->t_us);
    const bool vertical_free = s.mission.state() == MissionState::taking_off || s.mission.state() == MissionState::landing;
    const Setpoint& passed = s.guard.decide(e, scan, s.grid, wanted, vertical_free, in->t_us);
    s.reference.settle(passed);
    const Setpoint sent = passed.trimmed();

    out->x_m = static_cast<double>(sent.x_m);
    out->y_m = static_cast<double>(sent.y_m);
    out->z_m = static_cast<double>(sent.z_m);
    out->yaw_rad = static_cast<double>(sent.yaw_rad);
    out->vx_m_s = static_cast<double>(sent.vx_m_s);
    out->vy_m_s = static_cast<double>(sent.vy_m_s);
    out->vz_m_s = static_cast<double>(sent.vz_m_s);
    float goal_x_m = 0.0F;
    float goal_y_m = 0.0F;
    out->goal_valid = s.mission.goal(goal_x_m, goal_y_m) ? 1 : 0;
    out->goal_x_m = static_cast<double>(goal_x_m);
    out->goal_y_m = static_cast<double>(goal_y_m);
    out->map_ns = mapped_ns - began_ns;
    out->plan_ns = planned_ns - mapped_ns;
    out->setpoint_valid = sent.valid ? 1 : 0;
    out->state = static_cast<std::int32_t>(s.mission.state());
    out->reason = static_cast<std::int32_t>(s.mission.reason());
    out->ready = s.mission.ready() ? 1 : 0;
    out->guard_rule = static_cast<std::int32_t>(s.guard.rule());
    out->unknown_share = s.mission.explorer().paper().unknown_share();
    out->known_area_m2 = s.grid.known_area_m2();
    const Explorer::Counters c = s.mission.explorer().counters();
    out->goals = static_cast<std::int32_t>(c.goals);
    out->switches = static_cast<std::int32_t>(c.policy.switches);
    out->stuck = static_cast<std::int32_t>(c.policy.stuck);
    out->in_vain = static_cast<std::int32_t>(c.policy.in_vain);
    out->back_and_forth = static_cast<std::int32_t>(c.back_and_forth);
    out->stops = static_cast<std::int32_t>(s.mission.explorer().tour().stops());
    out->path_points = static_cast<std::int32_t>(target.path.size());
}

/// Processor time [ms] of one whole plan over the map at hand: field from the known place that is dearest to reach back to the map's origin, the
/// potential's window relaxed once, and the path. cells: settled. Negative: nothing has been mapped.
double noctule_explore_plan_ms(const noctule_explore* self, std::int32_t* cells) {
    using namespace noctule;
    if (!self->stages) { return -1.0; }
    const OccupancyGrid& grid = self->stages->grid;
    const Traversability& where = self->stages->mission.explorer().where();
    const auto open = std::make_unique<OpenCells>();
    const auto field = std::make_unique<CostField>();
    const auto potential = std::make_unique<Potential>(self->parameters);
    const auto path = std::make_unique<Bounded<PathPoint, kMaxPathPoints>>();
    constexpr std::int32_t kAll = 1 << 30;
    const CellId here = root_near(grid, where, 0.0F, 0.0F);
    field->start(grid, here, 0, *open);
    static_cast<void>(field->run(grid, where, *open, kAll, kNoCell, 0));
    CellId goal = kNoCell;
    for (CellId id = 0; id < grid.tile_count() * kTileArea; ++id) {
        if (where.passable(id) && field->cost(id) != CostField::kFar && (goal == kNoCell || field->cost(id) > field->cost(goal))) { goal = id; }
    }
    if (goal == kNoCell) { return -1.0; }
    const Cell c = grid.cell(goal);
    const std::int64_t began_ns = thread_ns();
    field->start(grid, goal, 0, *open);
    static_cast<void>(field->run(grid, where, *open, kAll, kNoCell, 0));
    potential->relax(grid, where, *field, 0.0F, 0.0F, 2);
    static_cast<void>(potential->trace(grid, where, *field, 0.0F, 0.0F, grid.geometry().centre_x_m(c), grid.geometry().centre_y_m(c), *path));
    *cells = field->settled();
    return path->size() > 1U ? 1e-6 * static_cast<double>(thread_ns() - began_ns) : -1.0;
}

int noctule_explore_tile_count(const noctule_explore* self) { return self->stages ? self->stages->grid.tile_count() : 0; }

void noctule_explore_tile_at(const noctule_explore* self, const int slot, noctule_explore_tile* out) {
    const noctule::GridTile& tile = self->stages->grid.tile(slot);
    out->tile_x = tile.tile_x;
    out->tile_y = tile.tile_y;
    for (std::size_t k = 0; k < tile.log_odds.size(); ++k) { out->log_odds[k] = tile.log_odds[k]; }
}
}
