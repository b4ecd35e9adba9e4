/// What a process may ask of the system to be on time: locked memory, a fixed priority, and a watchdog that starts it anew.
///
/// Each is a wish: where the system does not permit it, one line says so and what to change, and the process goes on without.
#pragma once

#include <cstdint>

namespace CLI {
class App;
}

namespace noctule {

struct RealtimeOptions {
    bool lock_memory = false;
    int fifo_priority = 0;  ///< 1 to 99: SCHED_FIFO; 0: as it is
};

/// --lock-memory and --fifo N.
void add_realtime_options(CLI::App& options, RealtimeOptions& realtime);

/// Applies them to this thread, and so to those it starts later: call before the bus is opened. False: not all was permitted.
bool apply_realtime(const char* process, const RealtimeOptions& realtime);

/// systemd's watchdog (sd_notify(3), the protocol, without its library). Without $NOTIFY_SOCKET everything here does nothing.
class Watchdog {
public:
    /// Reads $NOTIFY_SOCKET and $WATCHDOG_USEC. Start-up only.
    Watchdog();
    Watchdog(const Watchdog&) = delete;
    Watchdog& operator=(const Watchdog&) = delete;
    ~Watchdog();

    /// The process is up.
    void ready();
    /// The main loop runs. now_us: any monotonic clock; says so to systemd at most three times per watchdog time.
    void alive(std::int64_t now_us);
    /// It is going to end.
    void stopping();

private:
    void say(const char* text);

    int fd_ = -1;
    std::int64_t period_us_ = 0;  ///< 0: nobody watches
    std::int64_t next_us_ = 0;
};

}  // namespace noctule
