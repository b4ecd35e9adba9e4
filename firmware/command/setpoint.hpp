/// The one thing that leaves the firmware for the flight controller.
#pragma once

namespace noctule {

/// Position, velocity feed-forward and yaw, frame Map. Not valid: nothing is to be sent.
/// The trim is added to the position when it is sent: what this vehicle stays short by (command/response.hpp), and what the guard
/// draws it off by.
struct Setpoint {
    bool valid = false;
    float x_m = 0.0F;
    float y_m = 0.0F;
    float z_m = 0.0F;
    float vx_m_s = 0.0F;
    float vy_m_s = 0.0F;
    float vz_m_s = 0.0F;
    float yaw_rad = 0.0F;
    float trim_x_m = 0.0F;
    float trim_y_m = 0.0F;

    /// As it is sent.
    [[nodiscard]] Setpoint trimmed() const {
        Setpoint s = *this;
        s.x_m += trim_x_m;
        s.y_m += trim_y_m;
        s.trim_x_m = s.trim_y_m = 0.0F;
        return s;
    }
};

}  // namespace noctule
