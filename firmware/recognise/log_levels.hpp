/// Natural logarithms of grey levels, so that no pixel costs one.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace noctule {

/// ln(level + 1) of the levels 0 to 255.
inline const std::array<float, 256>& log_levels() {
    static const std::array<float, 256> table = [] {
        std::array<float, 256> t{};
        for (std::size_t i = 0; i < t.size(); ++i) { t[i] = std::log(static_cast<float>(i) + 1.0F); }
        return t;
    }();
    return table;
}

}  // namespace noctule
