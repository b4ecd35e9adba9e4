/// The part of NavNode that turns what a step returned into NAV, GRID_TILE, WALLS and LEVELS.
#include <algorithm>

#include "link/nav_node.hpp"
#include "streams.gen.hpp"

namespace noctule {

namespace {

constexpr std::int64_t kWallsPeriod_us = 500000;     // streams.toml, WALLS
constexpr std::int64_t kLevelsPeriod_us = 1000000;   // streams.toml, LEVELS
constexpr int kTilesPerStep = 4;                     // streams.toml, GRID_TILE

static_assert(grid_tile_t::TILE_CELLS == kTileCells, "grid_tile_t.lcm and map/occupancy_grid.hpp disagree");
static_assert(levels_t::MAX_LEVELS >= static_cast<std::int32_t>(kMaxLevels), "levels_t.lcm is too small");
static_assert(walls_t::MAX_WALLS >= static_cast<std::int32_t>(kMaxWalls), "walls_t.lcm is too small");

}  // namespace

void NavNode::publish_maps(const NavOutput& output) {
    for (int i = 0; i < kTilesPerStep; ++i) {
        const GridTile* tile = navigator_.grid().take_changed_tile(output.t_us);
        if (tile == nullptr) { break; }
        tile_message_.t_us = output.t_us;
        tile_message_.seq = tile_seq_++;
        tile_message_.floor = output.floor_names[static_cast<std::size_t>(tile->floor)];
        tile_message_.tile_x = tile->tile_x;
        tile_message_.tile_y = tile->tile_y;
        tile_message_.cell_m = navigator_.grid().geometry().cell_m();
        std::copy(tile->log_odds.begin(), tile->log_odds.end(), std::begin(tile_message_.log_odds));
        publish(kChannelGridTile, tile_message_);
    }
    if (output.t_us - last_walls_us_ >= kWallsPeriod_us) {
        last_walls_us_ = output.t_us;
        publish_walls(output);
    }
    if (output.t_us - last_levels_us_ >= kLevelsPeriod_us) {
        last_levels_us_ = output.t_us;
        publish_levels(output);
    }
}

void NavNode::publish_walls(const NavOutput& output) {
    navigator_.localiser().walls(walls_);
    walls_message_ = walls_t{};
    walls_message_.t_us = output.t_us;
    walls_message_.seq = walls_seq_++;
    walls_message_.floor = output.floor;
    walls_message_.count = static_cast<std::int32_t>(walls_.size());
    for (std::size_t i = 0; i < walls_.size(); ++i) {
        const WallSegment& wall = walls_[i];
        walls_message_.r_m[i] = wall.line.r_m;
        walls_message_.alpha_rad[i] = wall.line.alpha_rad;
        walls_message_.v[i] = wall.line.v;
        walls_message_.x0_m[i] = wall.end0.x_m;
        walls_message_.y0_m[i] = wall.end0.y_m;
        walls_message_.x1_m[i] = wall.end1.x_m;
        walls_message_.y1_m[i] = wall.end1.y_m;
        walls_message_.r_var_m2[i] = wall.r_var_m2;
        walls_message_.alpha_var_rad2[i] = wall.alpha_var_rad2;
        walls_message_.seen[i] = wall.seen;
    }
    publish(kChannelWalls, walls_message_);
}

void NavNode::publish_levels(const NavOutput& output) {
    const auto& levels = navigator_.altitude().levels();
    levels_message_ = levels_t{};
    levels_message_.t_us = output.t_us;
    levels_message_.seq = levels_seq_++;
    levels_message_.count = static_cast<std::int32_t>(levels.size());
    for (std::size_t i = 0; i < levels.size(); ++i) {
        const Level& level = levels[i];
        levels_message_.z_m[i] = level.z_m;
        levels_message_.z_var_m2[i] = level.z_var_m2;
        levels_message_.facing[i] = level.facing;
        levels_message_.x_min_m[i] = level.x_min_m;
        levels_message_.y_min_m[i] = level.y_min_m;
        levels_message_.x_max_m[i] = level.x_max_m;
        levels_message_.y_max_m[i] = level.y_max_m;
        levels_message_.seen[i] = level.seen;
    }
    publish(kChannelLevels, levels_message_);
}

void NavNode::publish_ask(const NavOutput& output) {
    const PolicyAsk& ask = output.ask;
    policy_ask_t message{};
    message.t_us = output.t_us;
    message.seq = asked_ = ask.number;
    message.exploration = ask.exploration;
    message.floor = output.floor;
    message.x_m = ask.pose.x_m;
    message.y_m = ask.pose.y_m;
    message.yaw_rad = ask.pose.yaw_rad;
    message.from_x_m = ask.from.x_m;
    message.from_y_m = ask.from.y_m;
    message.home_x_m = ask.home.x_m;
    message.home_y_m = ask.home.y_m;
    message.budget_cells = ask.budget_cells;
    message.fate = ask.refused_now ? policy_ask_t::REFUSED : static_cast<std::int32_t>(ask.fate);
    message.goal_valid = ask.goal_valid ? 1 : 0;
    message.goal_x_m = ask.goal_x_m;
    message.goal_y_m = ask.goal_y_m;
    message.known_area_m2 = output.known_area_m2;
    message.refused = static_cast<std::int32_t>(ask.refused);
    message.verdict = static_cast<std::int32_t>(ask.verdict);
    message.timeouts = static_cast<std::int32_t>(ask.timeouts);
    publish(kChannelPolicyAsk, message);
}

void NavNode::publish_nav(const NavOutput& output, const Consumed& consumed, const float step_us) {
    nav_t& nav = nav_message_;
    const PlanarEstimate& planar = output.estimate.planar;
    const AltitudeEstimate& altitude = output.estimate.altitude;
    nav.t_us = output.t_us;
    nav.seq = nav_seq_++;
    nav.scan_seq = output.scan_seq;
    nav.parameters_crc = static_cast<std::int32_t>(kParametersCrc);
    nav.x_m = planar.pose_map_body.x_m;
    nav.y_m = planar.pose_map_body.y_m;
    nav.z_m = altitude.z_m;
    nav.roll_rad = output.estimate.roll_rad;
    nav.pitch_rad = output.estimate.pitch_rad;
    nav.yaw_rad = planar.pose_map_body.yaw_rad;
    nav.vx_m_s = planar.vx_m_s;
    nav.vy_m_s = planar.vy_m_s;
    nav.vz_m_s = altitude.vz_m_s;
    std::copy(planar.covariance.begin(), planar.covariance.end(), std::begin(nav.covariance_xyyaw));
    nav.z_var_m2 = altitude.z_var_m2;
    nav.ground_z_m = altitude.ground_z_m;
    nav.ceiling_z_m = altitude.ceiling_z_m;
    nav.quality = altitude.valid ? planar.quality : -1;
    nav.reset_counter = planar.reset_counter;
    nav.state = static_cast<std::int32_t>(output.state);
    nav.reason = static_cast<std::int32_t>(output.reason);
    nav.floor = output.floor;
    nav.ready = output.ready ? 1 : 0;
    nav.want_disarm = output.want_disarm ? 1 : 0;
    nav.setpoint_valid = output.setpoint.valid ? 1 : 0;
    nav.setpoint_x_m = output.setpoint.x_m;
    nav.setpoint_y_m = output.setpoint.y_m;
    nav.setpoint_z_m = output.setpoint.z_m;
    nav.setpoint_yaw_rad = output.setpoint.yaw_rad;
    nav.setpoint_vx_m_s = output.setpoint.vx_m_s;
    nav.setpoint_vy_m_s = output.setpoint.vy_m_s;
    nav.setpoint_vz_m_s = output.setpoint.vz_m_s;
    nav.goal_valid = output.goal_valid ? 1 : 0;
    nav.goal_x_m = output.goal_x_m;
    nav.goal_y_m = output.goal_y_m;
    nav.known_area_m2 = output.known_area_m2;
    nav.explored_share = output.explored_share;
    nav.clearance_m = output.clearance_m;
    nav.guard_interventions = output.guard_interventions;
    nav.guard_rule = static_cast<std::int32_t>(output.guard_rule);
    nav.refused_samples = static_cast<std::int32_t>(refused_);
    nav.walls_seen = planar.walls_seen;
    nav.walls_matched = planar.walls_matched;
    nav.landmarks = planar.landmarks;
    nav.effective_particles = planar.effective_particles;
    nav.imu_used = static_cast<std::int32_t>(consumed.imu);
    nav.attitude_used = static_cast<std::int32_t>(consumed.attitude);
    nav.range_up_used = static_cast<std::int32_t>(consumed.range_up);
    nav.range_down_used = static_cast<std::int32_t>(consumed.range_down);
    nav.vehicle_used = static_cast<std::int32_t>(consumed.vehicle);
    nav.command_used = static_cast<std::int32_t>(consumed.command);
    nav.baro_used = static_cast<std::int32_t>(consumed.baro);
    nav.parameters_used = static_cast<std::int32_t>(consumed.parameters);
    nav.policy_used = static_cast<std::int32_t>(consumed.policy);
    nav.policy = static_cast<std::int32_t>(output.policy);
    nav.policy_refused = static_cast<std::int32_t>(output.ask.refused);
    nav.policy_timeouts = static_cast<std::int32_t>(output.ask.timeouts);
    nav.values_crc = values_crc_;
    nav.step_us = step_us;
    publish(kChannelNav, nav);
}

}  // namespace noctule
