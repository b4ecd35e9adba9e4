/// What a second LCM bus allocates when it starts.
#pragma once

#include <cstdint>

#include "link/lcm_bus.hpp"

extern "C" std::int64_t noctule_heap_allocations() __attribute__((weak));  // from the preloaded counter

namespace noctule {

/// Runs the handlers of what waits, and returns the allocations of the call in which the bus brought its first message, else 0: LCM sets up a bus's lock
/// with it, which is start-up.
inline std::int64_t handle_and_count_start(LcmBus& bus) {
    if (bus.counters().received > 0 || noctule_heap_allocations == nullptr) {
        static_cast<void>(bus.handle(0));
        return 0;
    }
    const std::int64_t before = noctule_heap_allocations();
    static_cast<void>(bus.handle(0));
    return bus.counters().received > 0 ? noctule_heap_allocations() - before : 0;
}

}  // namespace noctule
