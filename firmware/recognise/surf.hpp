/// SURF: interest points from the determinant of the Hessian over octaves, and their 64-value descriptors.
///
/// Model: H. Bay, A. Ess, T. Tuytelaars, L. Van Gool, Speeded-Up Robust Features (2008); descriptor windows overlap as in
/// M-SURF (Agrawal, Konolige, Blas 2008). docs/maths/vision.md, equations (1) to (6).
/// Frame: image, x right, y down, pixel centres at whole numbers, unit px. Angles anticlockwise as seen with y up would be
/// clockwise here: orientation_rad turns x towards y. All storage inside (about 24 MB), no heap, not thread-safe.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/bounded.hpp"
#include "core/capacity.hpp"
#include "recognise/grey_image.hpp"
#include "recognise/integral_image.hpp"

namespace noctule {

struct SurfSettings {
    float threshold = 4.0e-4F;   ///< least determinant of the Hessian, grey levels taken as 0 to 1 (parameter surf_threshold)
    std::int32_t octaves = 3;    ///< 1 to 5 (surf_octaves)
    std::int32_t step_px = 2;    ///< sampling of the first octave, 1 or 2 (surf_step_px)
    std::int32_t most = static_cast<std::int32_t>(kMaxSurfFeatures);  ///< strongest points kept (surf_most)
    bool upright = false;        ///< true: orientation is taken as zero, no invariance to rotation
};

struct SurfPoint {
    float x_px = 0.0F;
    float y_px = 0.0F;
    float scale_px = 0.0F;         ///< standard deviation of the Gaussian that the filter stands for
    float response = 0.0F;         ///< determinant of the Hessian
    float orientation_rad = 0.0F;  ///< in (-pi, pi]
    bool bright = false;           ///< the Laplacian is negative: a bright blob on a dark ground
};

using SurfDescriptor = std::array<float, 64>;  ///< unit length

struct SurfFeature {
    SurfPoint point;
    SurfDescriptor descriptor{};
};

struct SurfCounters {
    std::uint32_t images = 0;
    std::uint32_t refused_images = 0;   ///< wrong size
    std::uint32_t weak_dropped = 0;     ///< points that gave way to stronger ones
    std::uint32_t flat_dropped = 0;     ///< points whose descriptor is zero
};

class Surf {
public:
    using Features = Bounded<SurfFeature, kMaxSurfFeatures>;

    /// Points and descriptors of the image, strongest first. Bad images give none (counted).
    const Features& extract(const GreyImage& image, const SurfSettings& settings);

    /// The features of the last extract().
    [[nodiscard]] const Features& features() const { return features_; }

    [[nodiscard]] const SurfCounters& counters() const { return counters_; }

private:
    static constexpr int kLayers = 5;     ///< filter sizes an octave
    static constexpr int kPad = 4;        ///< entries that a vector may run over the end of a row

    void build_octave(int octave, int step);
    void build_layer(int layer, int octave, int step);
    void find_extrema(int octave, int step, const SurfSettings& settings);
    [[nodiscard]] bool refine(int layer, int row, int column, int octave, int step, SurfPoint& out) const;
    void offer(const SurfPoint& point, std::size_t most);
    void orient(SurfPoint& point) const;
    [[nodiscard]] bool describe(const SurfPoint& point, SurfDescriptor& out) const;

    [[nodiscard]] float* layer_row(const int layer, const int r) {
        return responses_[static_cast<std::size_t>(layer)].data() + static_cast<std::ptrdiff_t>(r) * row_stride_;
    }
    [[nodiscard]] const float* layer_row(const int layer, const int r) const {
        return responses_[static_cast<std::size_t>(layer)].data() + static_cast<std::ptrdiff_t>(r) * row_stride_;
    }

    IntegralImage integral_;
    int rows_ = 0;         ///< samples of the octave in hand
    int columns_ = 0;
    int row_stride_ = 0;
    int phase_stride_ = 0; ///< entries of one phase of one row of phases_
    /// The integral image with the columns of equal remainder by the step side by side, so that a strided read is a plain one.
    std::array<std::int32_t, kMaxSurfPixels + 40 * kMaxSurfSide> phases_{};
    std::array<std::array<float, kMaxSurfPixels + (kPad + 2) * kMaxSurfSide>, kLayers> responses_{};
    Bounded<SurfPoint, kMaxSurfFeatures> points_;  ///< heap on response, weakest on top
    Features features_;
    SurfCounters counters_;
};

}  // namespace noctule
