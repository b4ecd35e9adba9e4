"""The simulator: worlds, vehicle, sensors, autopilots and the closed loop."""
