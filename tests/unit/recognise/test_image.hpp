/// Test-only images: a texture of random blobs that can be drawn under any similarity, so that truth is exact.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "recognise/grey_image.hpp"

namespace vision_test {

struct Picture {
    int width = 0;
    int height = 0;
    std::vector<std::uint8_t> pixels;

    [[nodiscard]] noctule::GreyImage view() const { return {pixels.data(), width, height, width}; }
};

struct Similarity {
    double scale = 1.0;
    double angle_rad = 0.0;
    double x_px = 0.0;   // where the origin of the texture comes to lie
    double y_px = 0.0;

    void map(const double u, const double v, double& x, double& y) const {
        x = x_px + scale * (std::cos(angle_rad) * u - std::sin(angle_rad) * v);
        y = y_px + scale * (std::sin(angle_rad) * u + std::cos(angle_rad) * v);
    }
};

/// Blobs of Gaussian profile on a grey ground; a world without pixels.
class Texture {
public:
    Texture(const std::uint32_t seed, const int blobs, const double extent) {
        std::mt19937 rng{seed};
        std::uniform_real_distribution<double> place{-extent, extent};
        std::uniform_real_distribution<double> size{2.0, 7.0};
        std::uniform_real_distribution<double> tall{-90.0, 90.0};
        for (int i = 0; i < blobs; ++i) { blobs_.push_back({place(rng), place(rng), size(rng), tall(rng)}); }
    }

    [[nodiscard]] Picture draw(const int width, const int height, const Similarity& s, const double noise = 0.0,
                               const std::uint32_t seed = 1, const double gain = 1.0) const {
        std::vector<double> sum(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), 128.0);
        for (const Blob& b : blobs_) {
            double cx = 0.0, cy = 0.0;
            s.map(b.u, b.v, cx, cy);
            const double sigma = b.size * s.scale;
            const int reach = static_cast<int>(std::ceil(4.0 * sigma));
            for (int y = std::max(0, static_cast<int>(cy) - reach); y <= std::min(height - 1, static_cast<int>(cy) + reach); ++y) {
                for (int x = std::max(0, static_cast<int>(cx) - reach); x <= std::min(width - 1, static_cast<int>(cx) + reach); ++x) {
                    const double d2 = (x - cx) * (x - cx) + (y - cy) * (y - cy);
                    sum[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] +=
                        b.tall * std::exp(-d2 / (2.0 * sigma * sigma));
                }
            }
        }
        std::mt19937 rng{seed};
        std::normal_distribution<double> grain{0.0, 1.0};
        Picture p{width, height, std::vector<std::uint8_t>(sum.size())};
        for (std::size_t i = 0; i < sum.size(); ++i) {
            p.pixels[i] = static_cast<std::uint8_t>(std::lround(std::clamp(gain * sum[i] + noise * grain(rng), 0.0, 255.0)));
        }
        return p;
    }

private:
    struct Blob {
        double u, v, size, tall;
    };
    std::vector<Blob> blobs_;
};

/// A binary PGM of 8 bit. False: not there or not that.
inline bool read_pgm(const std::string& path, Picture& out) {
    std::ifstream file{path, std::ios::binary};
    std::string magic;
    int most = 0;
    file >> magic;
    while (file >> std::ws && file.peek() == '#') { std::getline(file, magic); magic = "P5"; }
    file >> out.width >> out.height >> most;
    file.get();
    if (!file || magic != "P5" || most != 255) { return false; }
    out.pixels.resize(static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height));
    file.read(reinterpret_cast<char*>(out.pixels.data()), static_cast<std::streamsize>(out.pixels.size()));
    return static_cast<bool>(file);
}

}  // namespace vision_test
