"""Pictures of a flight: the map with its paths, and errors and altitude over time."""

from __future__ import annotations

import io
import math

import numpy as np

from noctule.score import PoseErrors, StartPose
from noctule.truth import PLANE_HEIGHT_M, Shape, slice_primitives

TRUE_COLOUR, ESTIMATE_COLOUR, WALL_COLOUR, SOLID_COLOUR = "#1b7f3b", "#c2410c", "#1d4ed8", "#b8a98f"


def _figure(width, height):
    # Matplotlib is heavy; only a report pays for it. The object interface needs no display and no global state.
    import logging

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _outline(shape: Shape) -> np.ndarray:
    """Corners of a shape's outline, (N, 2) [m], frame World."""
    if shape.disc:
        turn = np.linspace(0.0, 2.0 * math.pi, 25)
        return np.stack([shape.x_m + shape.half_x_m * np.cos(turn), shape.y_m + shape.half_x_m * np.sin(turn)], axis=1)
    c, s = math.cos(shape.yaw_rad), math.sin(shape.yaw_rad)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (shape.half_x_m, shape.half_y_m)
    return corners @ np.array([[c, s], [-s, c]]) + (shape.x_m, shape.y_m)


def map_png(primitives, floor_elevation_m: float, start: StartPose, grid, nav: dict, truth: dict, walls,
            title: str) -> bytes:
    """The map in World: recorded cells, true solids, estimated walls, true and estimated path. PNG bytes.

    Args:
        primitives: the world's solids.
        floor_elevation_m: the floor drawn, frame World.
        start: World * Map.
        grid: as record.map_of gives it, or None.
        nav, truth: arrays of record.read_flight and record.read_truth.
        walls: the last walls_t, or None.
        title: one line over the picture.
    """
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.transforms import Affine2D

    shapes = slice_primitives(primitives, floor_elevation_m + PLANE_HEIGHT_M)
    outlines = [_outline(s) for s in shapes]
    points = np.concatenate(outlines + [np.stack([truth["x_m"], truth["y_m"]], axis=1)]) if outlines else \
        np.stack([truth["x_m"], truth["y_m"]], axis=1)
    if points.size == 0:
        points = np.array([[start.x_m, start.y_m]])
    low, high = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    width, height = high - low
    scale = 9.0 / max(width, height)
    figure = _figure(max(4.0, width * scale) + 0.8, max(3.0, height * scale) + 0.9)
    axes = figure.add_subplot()
    axes.set_facecolor("#cbc7bf")
    if grid is not None:
        odds, x0, y0, cell = grid
        picture = np.zeros(odds.shape + (4,), np.uint8)
        strength = np.minimum(np.abs(odds.astype(np.int16)) * 9, 255).astype(np.uint8)
        picture[odds < 0] = (255, 255, 255, 255)
        picture[odds > 0] = (40, 40, 44, 255)
        picture[..., 3] = np.maximum(strength, np.where(odds != 0, 150, 0))
        place = Affine2D().rotate(start.yaw_rad).translate(start.x_m, start.y_m)
        axes.imshow(picture, origin="lower", interpolation="nearest", zorder=1,
                    extent=(x0, x0 + odds.shape[1] * cell, y0, y0 + odds.shape[0] * cell),
                    transform=place + axes.transData)
    if outlines:
        axes.add_collection(PolyCollection(outlines, facecolor="none", edgecolor=SOLID_COLOUR, linewidth=0.7, zorder=2,
                                           label="true walls"))
    if walls is not None and walls.count > 0:
        n = walls.count
        a = start.to_world(np.array(walls.x0_m[:n]), np.array(walls.y0_m[:n]))
        b = start.to_world(np.array(walls.x1_m[:n]), np.array(walls.y1_m[:n]))
        axes.add_collection(LineCollection(np.stack([np.stack(a, 1), np.stack(b, 1)], axis=1), color=WALL_COLOUR,
                                           linewidth=1.1, zorder=3, label="estimated walls"))
    axes.plot(truth["x_m"], truth["y_m"], color=TRUE_COLOUR, linewidth=1.8, zorder=4, label="true path")
    if len(nav["t_us"]):
        x, y = start.to_world(nav["x_m"], nav["y_m"])
        axes.plot(x, y, color=ESTIMATE_COLOUR, linewidth=0.9, zorder=5, label="estimated path")
    axes.plot([start.x_m], [start.y_m], "o", color="black", markersize=6, zorder=6, label="start")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel("x [m], World")
    axes.set_ylabel("y [m], World")
    axes.set_title(title, fontsize=10)
    figure.legend(loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def paths_png(primitives, floor_elevation_m: float, paths: dict[str, tuple[np.ndarray, np.ndarray]], title: str) -> bytes:
    """Several paths over one floor's solids, frame World, each in a panel of its own. PNG bytes.

    Args:
        primitives: the world's solids.
        floor_elevation_m: the floor drawn.
        paths: name -> x and y, (N,) [m] each.
        title: one line over the picture.
    """
    from matplotlib.collections import PolyCollection

    outlines = [_outline(s) for s in slice_primitives(primitives, floor_elevation_m + PLANE_HEIGHT_M)]
    points = np.concatenate(outlines + [np.stack(path, axis=1) for path in paths.values()])
    low, high = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    width, height = high - low
    scale = 5.0 / max(width, height)
    figure = _figure(len(paths) * max(2.5, width * scale) + 0.4, max(2.0, height * scale) + 0.8)
    for n, (name, (x, y)) in enumerate(paths.items()):
        axes = figure.add_subplot(1, len(paths), n + 1)
        if outlines:
            axes.add_collection(PolyCollection(outlines, facecolor="none", edgecolor=SOLID_COLOUR, linewidth=0.7))
        axes.plot(x, y, color=TRUE_COLOUR, linewidth=1.2)
        axes.plot(x[:1], y[:1], "o", color="black", markersize=4)
        length = float(np.hypot(np.diff(x), np.diff(y)).sum())
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_title(f"{name}: {length:.0f} m", fontsize=9)
        axes.tick_params(labelsize=7)
    figure.suptitle(title, fontsize=10)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def series_svg(errors: PoseErrors, nav: dict, truth: dict, start: StartPose, levels_m: list[float],
               explored: list[tuple[float, float]]) -> str:
    """Errors, altitude with the levels found, and explored share over time, as one SVG element.

    Args:
        errors: score.pose_errors of the flight.
        levels_m: elevations of the levels found, frame Map.
        explored: (time [s], share) pairs in order of time.
    """
    figure = _figure(9.5, 9.0)
    position, yaw, altitude, share = figure.subplots(4, 1, sharex=True)
    if errors.t_s.size:
        position.plot(errors.t_s, 100.0 * errors.position_series_m, color=ESTIMATE_COLOUR, linewidth=0.8)
        yaw.plot(errors.t_s, np.degrees(errors.yaw_series_rad), color=ESTIMATE_COLOUR, linewidth=0.8)
    position.set_ylabel("position error [cm]")
    yaw.set_ylabel("yaw error [deg]")
    if len(truth["t_s"]):
        altitude.plot(truth["t_s"], truth["z_m"] - start.z_m, color=TRUE_COLOUR, linewidth=1.6, label="true")
    if len(nav["t_us"]):
        t_s = nav["t_us"] * 1e-6
        altitude.plot(t_s, nav["z_m"], color=ESTIMATE_COLOUR, linewidth=0.8, label="estimate")
        for field, label in (("ground_z_m", "surface under the vehicle"), ("ceiling_z_m", "surface over it")):
            altitude.plot(t_s, nav[field], ".", color=SOLID_COLOUR if field == "ground_z_m" else WALL_COLOUR, markersize=1.5, label=label)
    for n, z in enumerate(levels_m):
        altitude.axhline(z, color=WALL_COLOUR, linewidth=0.5, linestyle="--", label="levels found" if n == 0 else None)
    altitude.set_ylabel("altitude [m], Map")
    if altitude.get_legend_handles_labels()[0]:
        altitude.legend(fontsize=7, ncols=5, frameon=False, loc="upper left", bbox_to_anchor=(0.0, 1.18))
    if explored:
        t, v = zip(*explored)
        share.plot(t, 100.0 * np.array(v), color=TRUE_COLOUR, linewidth=1.2)
    share.set_ylim(0, 102)
    share.set_ylabel("explored [%]")
    share.set_xlabel("simulated time [s]")
    for axes in (position, yaw, altitude, share):
        axes.grid(alpha=0.3, linewidth=0.5)
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg"):]
