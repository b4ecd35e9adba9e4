"""Noctule's simulator: worlds, vehicle, sensors, autopilot and the closed loop around the companion."""
