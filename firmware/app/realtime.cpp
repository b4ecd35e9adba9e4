#include "app/realtime.hpp"

#include <sched.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include <CLI/CLI.hpp>

namespace noctule {

void add_realtime_options(CLI::App& options, RealtimeOptions& realtime) {
    options.add_flag("--lock-memory", realtime.lock_memory, "keep all memory in RAM (mlockall); goes on with a message where that is not permitted");
    options.add_option("--fifo", realtime.fifo_priority, "run with SCHED_FIFO at this priority, 1 to 99; as above")->check(CLI::Range(0, 99));
}

bool apply_realtime(const char* process, const RealtimeOptions& realtime) {
    bool all = true;
    if (realtime.lock_memory && ::mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
        all = false;
        std::fprintf(stderr, "%s: memory is not locked (%s): it needs LimitMEMLOCK=infinity or CAP_IPC_LOCK; going on without\n", process, std::strerror(errno));
    }
    if (realtime.fifo_priority > 0) {
        sched_param wanted{};
        wanted.sched_priority = realtime.fifo_priority;
        if (::sched_setscheduler(0, SCHED_FIFO, &wanted) != 0) {
            all = false;
            std::fprintf(stderr, "%s: no real-time priority (%s): it needs LimitRTPRIO=%d or CAP_SYS_NICE; going on without\n", process, std::strerror(errno),
                         realtime.fifo_priority);
        }
    }
    return all;
}

Watchdog::Watchdog() {
    const char* path = std::getenv("NOTIFY_SOCKET");
    if (path == nullptr || (path[0] != '/' && path[0] != '@')) { return; }
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::size_t length = std::strlen(path);
    if (length >= sizeof address.sun_path) { return; }
    std::memcpy(address.sun_path, path, length);
    if (address.sun_path[0] == '@') { address.sun_path[0] = '\0'; }  // abstract
    fd_ = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd_ < 0) { return; }
    const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + length);
    if (::connect(fd_, reinterpret_cast<const sockaddr*>(&address), size) != 0) {
        ::close(fd_);
        fd_ = -1;
        return;
    }
    if (const char* text = std::getenv("WATCHDOG_USEC"); text != nullptr) { period_us_ = std::strtoll(text, nullptr, 10) / 3; }
}

Watchdog::~Watchdog() {
    if (fd_ >= 0) { ::close(fd_); }
}

void Watchdog::say(const char* text) {
    if (fd_ >= 0) { static_cast<void>(::send(fd_, text, std::strlen(text), MSG_NOSIGNAL)); }
}

void Watchdog::ready() { say("READY=1"); }

void Watchdog::stopping() { say("STOPPING=1"); }

void Watchdog::alive(const std::int64_t now_us) {
    if (period_us_ <= 0 || now_us < next_us_) { return; }
    next_us_ = now_us + period_us_;
    say("WATCHDOG=1");
}

}  // namespace noctule
