#include "app/signals.hpp"

#include <csignal>

namespace noctule {

namespace {
volatile std::sig_atomic_t stop = 0;
void on_signal(int /*signal*/) { stop = 1; }
}  // namespace

void install_stop_signals() {
    struct sigaction action{};
    action.sa_handler = &on_signal;
    sigemptyset(&action.sa_mask);
    action.sa_flags = 0;  // no SA_RESTART: a poll that waits must return
    sigaction(SIGINT, &action, nullptr);
    sigaction(SIGTERM, &action, nullptr);
    action.sa_handler = SIG_IGN;
    sigaction(SIGPIPE, &action, nullptr);
}

bool stop_requested() { return stop != 0; }

}  // namespace noctule
