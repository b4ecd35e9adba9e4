/// What a fuzz test is made of. Each file defines LLVMFuzzerTestOneInput, which libFuzzer (preset `fuzz`) or driver.cpp (all other presets) feeds
/// with bytes, and `seeds`, inputs that reach far into the code. A broken promise ends the process with the line that says it.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <span>
#include <vector>

#define HOLDS(condition)                                                                            \
    do {                                                                                            \
        if (!(condition)) {                                                                         \
            std::fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition);     \
            std::abort();                                                                           \
        }                                                                                           \
    } while (false)

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace noctule::fuzz {

using Bytes = std::vector<std::uint8_t>;

/// Inputs to begin from.
[[nodiscard]] std::vector<Bytes> seeds();

/// Reads an input from its front; zeros follow its end.
class Source {
public:
    Source(const std::uint8_t* data, const std::size_t size) : rest_(data, size) {}

    [[nodiscard]] bool empty() const { return rest_.empty(); }

    [[nodiscard]] std::uint8_t byte() {
        if (rest_.empty()) { return 0; }
        const std::uint8_t value = rest_.front();
        rest_ = rest_.subspan(1);
        return value;
    }
    /// Below `limit`, which is 1 to 65536.
    [[nodiscard]] std::size_t below(const std::size_t limit) {
        const std::size_t high = limit > 256 ? byte() : 0;
        return (high * 256 + byte()) % limit;
    }
    /// At most `size` bytes.
    [[nodiscard]] std::span<const std::uint8_t> bytes(const std::size_t size) {
        const auto taken = rest_.first(std::min(size, rest_.size()));
        rest_ = rest_.subspan(taken.size());
        return taken;
    }
    /// Writes over a few places of `target`: a count up to 7, then for each an offset and up to four bytes.
    void patch(const std::span<std::uint8_t> target) {
        for (std::size_t n = byte() % 8; n > 0; --n) {
            const std::size_t at = below(std::min<std::size_t>(target.size(), 65536));
            const auto from = bytes(4);
            std::copy_n(from.begin(), std::min(from.size(), target.size() - at), target.begin() + static_cast<std::ptrdiff_t>(at));
        }
    }

private:
    std::span<const std::uint8_t> rest_;
};

}  // namespace noctule::fuzz
