/// SIGINT and SIGTERM as a flag: a process ends its loop, writes what it has to write, and returns from main.
#pragma once

namespace noctule {

/// From now on SIGINT and SIGTERM set the flag instead of ending the process; system calls that wait come back (EINTR).
/// SIGPIPE is ignored.
void install_stop_signals();

/// A stop was asked for.
[[nodiscard]] bool stop_requested();

}  // namespace noctule
