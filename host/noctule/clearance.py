"""Where the centimetres to the nearest solid went: clearance of setpoint, estimate and truth, and what parts them."""

from __future__ import annotations

import numpy as np

from noctule.report import Run
from noctule.truth import distance_to_shape, slice_primitives

FLYING = (2, 3, 4, 9)       # mission states: looks around, explores, returns, looks for another floor
NEAR_M = 0.30              # setpoints whose hull is nearer than this to something are 'near'
PATH_S = 3.0               # the vehicle is compared with the setpoints of this much time before and after


def clearance_of(shapes, x_m, y_m, hull_radius_m: float) -> np.ndarray:
    """Hull to the nearest shape at points of World [m]; x_m, y_m (N,) float."""
    nearest = np.full(np.shape(x_m), np.inf)
    for shape in shapes:
        nearest = np.minimum(nearest, distance_to_shape(shape, np.asarray(x_m, float), np.asarray(y_m, float)))
    return nearest - hull_radius_m


def parts(run: Run, height_m: float = 1.0, hull_radius_m: float = 0.30) -> dict[str, float]:
    """Least clearance in flight of setpoint, estimate and truth, and the greatest errors near obstacles [m].

    Near: the setpoint's hull is within NEAR_M of something. estimate_error_m: distance of estimate and truth there.
    tracking_error_m: distance of the true place from the line that the setpoints draw there (across it; lag along it does no harm).
    mean_speed_m_s: of the true motion while the mission explores.
    """
    nav, truth = run.flight.nav, run.truth
    stamps = np.round(truth["t_s"] * 1e6).astype(np.int64)
    row = np.clip(np.searchsorted(stamps, nav["t_us"] - 500), 0, len(stamps) - 1)
    flying = np.isin(nav["state"], FLYING) & (nav["setpoint_valid"] > 0)
    shapes = slice_primitives(run.world.primitives(), run.start.z_m + height_m)
    sx, sy = run.start.to_world(nav["setpoint_x_m"], nav["setpoint_y_m"])
    ex, ey = run.start.to_world(nav["x_m"], nav["y_m"])
    tx, ty = truth["x_m"][row], truth["y_m"][row]
    index = np.nonzero(flying)[0]
    clear = {name: clearance_of(shapes, x[index], y[index], hull_radius_m) for name, x, y in (("setpoint", sx, sy), ("estimate", ex, ey), ("truth", tx, ty))}
    near = np.nonzero(clear["setpoint"] < NEAR_M)[0]
    reach = int(PATH_S / 0.05)
    tracking = 0.0
    for k in near:
        window = slice(max(0, index[k] - reach), index[k] + reach)
        ax, ay = sx[window][:-1], sy[window][:-1]
        dx, dy = np.diff(sx[window]), np.diff(sy[window])
        f = np.clip(((tx[index[k]] - ax) * dx + (ty[index[k]] - ay) * dy) / np.maximum(dx * dx + dy * dy, 1e-12), 0.0, 1.0)
        tracking = max(tracking, float(np.min(np.hypot(ax + f * dx - tx[index[k]], ay + f * dy - ty[index[k]]))))
    error = np.hypot(ex - tx, ey - ty)[index]
    exploring = np.nonzero(nav["state"] == 3)[0]
    speed = float(np.mean(np.hypot(truth["vx_m_s"][row[exploring]], truth["vy_m_s"][row[exploring]]))) if exploring.size else float("nan")
    least = {f"{name}_m": float(np.min(values)) if values.size else float("nan") for name, values in clear.items()}
    at = int(np.argmin(clear["truth"])) if index.size else 0
    return {**least, "estimate_error_m": float(np.max(error[near])) if near.size else 0.0, "tracking_error_m": tracking,
            "mean_speed_m_s": speed, "at_x_m": float(tx[index[at]]), "at_y_m": float(ty[index[at]]), "at_t_s": float(nav["t_us"][index[at]] * 1e-6)}
