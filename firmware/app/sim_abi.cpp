/// The autonomy as a shared library for Python: the very NavNode of noctule-nav, without processes and sockets.
///
/// Messages go in and come out as encoded LCM, so that a flight in the process and a flight over the bus speak the same
/// language and write the same log. One thread a node; nodes share nothing.
#include <time.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "link/nav_node.hpp"
#include "params.gen.hpp"

namespace {

struct Message {
    std::string channel;
    std::vector<std::uint8_t> bytes;
};

std::int64_t monotonic_ns() {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

struct noctule_node {
    noctule::Parameters parameters;
    std::unique_ptr<noctule::NavNode> node;  // made with the first message, when the parameters are complete
    std::vector<Message> outbox;             // kept and reused; `used` of them hold
    std::size_t used = 0;
    std::size_t read = 0;

    static void publish(void* context, const char* channel, const std::uint8_t* bytes, std::size_t size) {
        noctule_node& self = *static_cast<noctule_node*>(context);
        if (self.used == self.outbox.size()) { self.outbox.emplace_back(); }
        Message& message = self.outbox[self.used++];
        message.channel = channel;
        message.bytes.assign(bytes, bytes + size);
    }

    noctule::NavNode& started() {
        if (!node) { node = std::make_unique<noctule::NavNode>(parameters, publish, this, monotonic_ns); }
        return *node;
    }
};

extern "C" {

noctule_node* noctule_create() { return new noctule_node; }

void noctule_destroy(noctule_node* node) { delete node; }

/// 0 stored; 1 no such name or id; 2 out of range or not whole; 3 too late, the first message has been received.
int noctule_set_parameter(noctule_node* self, const char* name_or_id, const double value) {
    if (self->node) { return 3; }
    const noctule::ParameterRow* row = noctule::find_parameter(name_or_id);
    if (row == nullptr) { return 1; }
    return noctule::set_parameter(self->parameters, *row, static_cast<float>(value)) == noctule::ParameterSet::stored ? 0 : 2;
}

/// One encoded message; runs the step when it is due. The value of noctule::Input. Drops what was not taken with noctule_next.
int noctule_receive(noctule_node* self, const char* channel, const std::uint8_t* bytes, const std::size_t size) {
    if (self->read == self->used) { self->read = self->used = 0; }
    noctule::NavNode& node = self->started();
    const noctule::Input result = node.receive(channel, bytes, size);
    if (node.step_due()) { node.step(); }
    return static_cast<int>(result);
}

/// As noctule_receive, but never runs a step by itself (replay).
int noctule_hold(noctule_node* self, const char* channel, const std::uint8_t* bytes, const std::size_t size) {
    if (self->read == self->used) { self->read = self->used = 0; }
    return static_cast<int>(self->started().receive(channel, bytes, size));
}

/// Runs the step of the waiting scan with so many samples. 0: too few are there, or no scan waits.
int noctule_step_with(noctule_node* self, const int imu, const int attitude, const int range_up, const int range_down, const int vehicle, const int command,
                      const int baro, const int parameters, const int policy) {
    const auto n = [](const int v) { return static_cast<std::size_t>(v < 0 ? 0 : v); };
    return self->started().step_with(noctule::Consumed{n(imu), n(attitude), n(range_up), n(range_down), n(vehicle), n(command), n(baro), n(parameters), n(policy)}) ? 1 : 0;
}

/// The next message that came out: its size, 0 when there is none. Channel and bytes hold until the next call of receive, hold or step.
std::size_t noctule_next(noctule_node* self, const char** channel, const std::uint8_t** bytes) {
    if (self->read == self->used) { return 0; }
    const Message& message = self->outbox[self->read++];
    *channel = message.channel.c_str();
    *bytes = message.bytes.data();
    return message.bytes.size();
}

/// The explorer's counters so far: goals, switches, back and forth, in vain, stuck, passes; zeros before the first message.
void noctule_explorer_counters(const noctule_node* self, std::uint32_t* out) {
    const noctule::Explorer::Counters c = self->node ? self->node->navigator().mission().explorer().counters() : noctule::Explorer::Counters{};
    const std::uint32_t all[6] = {c.goals, c.policy.switches, c.back_and_forth, c.policy.in_vain, c.policy.stuck, c.policy.passes};
    for (std::size_t k = 0; k < 6; ++k) { out[k] = all[k]; }
}

std::size_t noctule_navigator_bytes() { return sizeof(noctule::Navigator); }

/// Beams a second of thread CPU that the grid takes up: so many sweeps of 1080 beams in a hall of 14 x 9 m, from places on a circle.
double noctule_grid_beams_per_s(const int sweeps) {
    constexpr int kBeams = 1080;
    const auto parameters = std::make_unique<noctule::Parameters>();
    const auto grid = std::make_unique<noctule::OccupancyGrid>(*parameters);
    const auto scan = std::make_unique<noctule::LevelScan>();
    noctule::Estimate e;
    e.planar.quality = 100;
    e.altitude.valid = true;
    e.altitude.z_m = parameters->cruise_height_m;
    double cpu_s = 0.0;
    for (int k = 0; k < sweeps; ++k) {
        const float place = 0.02F * static_cast<float>(k);
        const float x_m = 2.0F * std::cos(place);
        const float y_m = 2.0F * std::sin(place);
        e.planar.pose_map_body = {x_m, y_m, noctule::wrap_angle(place)};
        scan->range_max_m = 10.0F;
        scan->bearing_increment_rad = 1.5F * noctule::kPi / static_cast<float>(kBeams - 1);
        scan->points.clear();
        for (int b = 0; b < kBeams; ++b) {
            const float bearing = scan->bearing_increment_rad * (static_cast<float>(b) - 0.5F * static_cast<float>(kBeams - 1));
            const float ux = std::cos(place + bearing);
            const float uy = std::sin(place + bearing);
            const float to_x = (ux > 0.0F ? 7.0F - x_m : 7.0F + x_m) / std::max(std::fabs(ux), 1e-4F);
            const float to_y = (uy > 0.0F ? 4.5F - y_m : 4.5F + y_m) / std::max(std::fabs(uy), 1e-4F);
            noctule::ScanPoint p;
            p.range_m = std::min({to_x, to_y, 10.0F});
            p.x_m = p.range_m * std::cos(bearing);
            p.y_m = p.range_m * std::sin(bearing);
            p.beam = static_cast<std::int16_t>(b);
            p.hit = p.range_m < 10.0F;
            static_cast<void>(scan->points.push(p));
        }
        timespec before{};
        timespec after{};
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &before);
        grid->integrate(e, *scan);
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &after);
        cpu_s += static_cast<double>(after.tv_sec - before.tv_sec) + 1e-9 * static_cast<double>(after.tv_nsec - before.tv_nsec);
    }
    return static_cast<double>(kBeams) * static_cast<double>(sweeps) / std::max(cpu_s, 1e-9);
}
}
