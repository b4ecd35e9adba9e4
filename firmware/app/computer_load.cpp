#include "app/computer_load.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cinttypes>
#include <cstdio>
#include <cstring>

namespace noctule {

namespace {

std::array<char, 2048> text;

/// The head of a small file, or null.
const char* head_of(const char* path) {
    const int file = ::open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0) { return nullptr; }
    const ssize_t got = ::read(file, text.data(), text.size() - 1);
    ::close(file);
    if (got <= 0) { return nullptr; }
    text[static_cast<std::size_t>(got)] = '\0';
    return text.data();
}

/// A number of KiB behind a name of /proc/meminfo, in MiB.
std::uint32_t mebibytes(const char* all, const char* name) {
    const char* at = std::strstr(all, name);
    std::uint64_t kib = 0;
    if (at == nullptr || std::sscanf(at + std::strlen(name), " %" SCNu64, &kib) != 1) { return UINT32_MAX; }
    return static_cast<std::uint32_t>(kib / 1024);
}

}  // namespace

ComputerLoad ComputerWatch::read(const std::int64_t monotonic_us) {
    ComputerLoad load;
    load.uptime_ms = static_cast<std::uint32_t>(monotonic_us / 1000);
    if (const char* stat = head_of("/proc/stat"); stat != nullptr) {
        std::array<std::uint64_t, 8> t{};  // user nice system idle iowait irq softirq steal
        if (std::sscanf(stat, "cpu %" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64, &t[0], &t[1], &t[2], &t[3], &t[4], &t[5],
                        &t[6], &t[7]) == 8) {
            std::uint64_t total = 0;
            for (const std::uint64_t part : t) { total += part; }
            const std::uint64_t busy = total - t[3] - t[4];
            if (total_ > 0 && total > total_) { load.cpu_percent = static_cast<std::uint8_t>(std::min<std::uint64_t>(100, 100 * (busy - std::min(busy, busy_)) / (total - total_))); }
            busy_ = busy;
            total_ = total;
        }
    }
    if (const char* memory = head_of("/proc/meminfo"); memory != nullptr) {
        load.ram_total_mib = mebibytes(memory, "MemTotal:");
        const std::uint32_t available = mebibytes(memory, "MemAvailable:");
        if (load.ram_total_mib != UINT32_MAX && available <= load.ram_total_mib) { load.ram_used_mib = load.ram_total_mib - available; }
    }
    if (const char* zone = head_of("/sys/class/thermal/thermal_zone0/temp"); zone != nullptr) {
        int millidegrees = 0;
        if (std::sscanf(zone, "%d", &millidegrees) == 1) { load.temperature_c = static_cast<std::int8_t>(std::clamp(millidegrees / 1000, -100, 126)); }
    }
    return load;
}

}  // namespace noctule
