/// A view of a grey image: 8 bit, row-major, owned by someone else.
#pragma once

#include <cstddef>
#include <cstdint>

namespace noctule {

struct GreyImage {
    const std::uint8_t* pixels = nullptr;
    int width = 0;      ///< columns [px]
    int height = 0;     ///< rows [px]
    int stride = 0;     ///< bytes from one row to the next, >= width

    [[nodiscard]] const std::uint8_t* row(const int y) const {
        return pixels + static_cast<std::ptrdiff_t>(y) * stride;
    }
};

}  // namespace noctule
