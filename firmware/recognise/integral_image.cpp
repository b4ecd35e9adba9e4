#include "recognise/integral_image.hpp"

namespace noctule {

static_assert(kMaxSurfPixels * 255 < 2147483647, "the sum over a whole white image fits 32 bits");

bool IntegralImage::build(const GreyImage& image) {
    const std::size_t w = static_cast<std::size_t>(std::max(image.width, 0));
    const std::size_t h = static_cast<std::size_t>(std::max(image.height, 0));
    if (image.pixels == nullptr || w == 0 || h == 0 || w > kMaxSurfSide || h > kMaxSurfSide || w * h > kMaxSurfPixels ||
        image.stride < image.width) {
        return false;
    }
    width_ = image.width;
    height_ = image.height;
    std::fill_n(sums_.begin(), w + 1, 0);
    std::int32_t* above = sums_.data();
    for (int y = 0; y < height_; ++y) {
        const std::uint8_t* const pixel = image.row(y);
        std::int32_t* const here = above + w + 1;
        std::int32_t line = 0;
        here[0] = 0;
        for (std::size_t x = 0; x < w; ++x) {
            line += pixel[x];
            here[x + 1] = above[x + 1] + line;
        }
        above = here;
    }
    return true;
}

}  // namespace noctule
