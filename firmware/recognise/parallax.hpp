/// Where the lines of sight to one thing meet: its place without any range.
///
/// Model: docs/maths/vision.md, "Parallax", equations (27) and (28). Frame Map. No heap, not thread-safe.
#pragma once

#include <array>
#include <cstdint>

#include "recognise/camera_model.hpp"

namespace noctule {

class Parallax {
public:
    /// One line of sight: from the camera along the bearing, slope up over ahead. distance_m: about how far it is, for the weight.
    /// A camera that has not moved since the last line says nothing new: false, nothing taken.
    bool add(const Vec3& eye_m, double bearing_rad, double slope, double distance_m);

    /// Adds the lines of another one.
    void add(const Parallax& other);

    struct Meeting {
        Vec3 point_m{};                     ///< nearest to all lines
        double sigma_m = 0.0;               ///< its greatest standard deviation
        double apart_rad = 0.0;             ///< root mean square angle by which the lines miss it
    };

    /// False: fewer than two lines, or they are parallel.
    [[nodiscard]] bool meet(Meeting& out) const;

    /// Places from which it was seen, a step apart.
    [[nodiscard]] std::int32_t places() const { return places_; }

private:
    std::array<double, 6> information_{};   ///< sum of weights times (I - d d'): xx, xy, xz, yy, yz, zz
    Vec3 moment_{};                         ///< and of that times the eye
    double square_ = 0.0;                   ///< and of that times the eye on both sides
    Vec3 last_m_{};
    std::int32_t places_ = 0;
};

}  // namespace noctule
