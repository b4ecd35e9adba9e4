/// The one thing that leaves the firmware for the flight controller.
#pragma once

namespace noctule {

/// Position, velocity feed-forward and yaw, frame Map. Not valid: nothing is to be sent.
struct Setpoint {
    bool valid = false;
    float x_m = 0.0F;
    float y_m = 0.0F;
    float z_m = 0.0F;
    float vx_m_s = 0.0F;
    float vy_m_s = 0.0F;
    float vz_m_s = 0.0F;
    float yaw_rad = 0.0F;
};

}  // namespace noctule
