/// The autonomy as a shared library for Python: the very NavNode of noctule-nav, without processes and sockets.
///
/// Messages go in and come out as encoded LCM, so that a flight in the process and a flight over the bus speak the same
/// language and write the same log. One thread a node; nodes share nothing.
#include <chrono>
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
                      const int baro, const int parameters) {
    const auto n = [](const int v) { return static_cast<std::size_t>(v < 0 ? 0 : v); };
    return self->started().step_with(noctule::Consumed{n(imu), n(attitude), n(range_up), n(range_down), n(vehicle), n(command), n(baro), n(parameters)}) ? 1 : 0;
}

/// The next message that came out: its size, 0 when there is none. Channel and bytes hold until the next call of receive, hold or step.
std::size_t noctule_next(noctule_node* self, const char** channel, const std::uint8_t** bytes) {
    if (self->read == self->used) { return 0; }
    const Message& message = self->outbox[self->read++];
    *channel = message.channel.c_str();
    *bytes = message.bytes.data();
    return message.bytes.size();
}

std::size_t noctule_navigator_bytes() { return sizeof(noctule::Navigator); }
}
