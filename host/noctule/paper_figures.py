"""Drawing for `noctule paper`: one function a published figure, PNG bytes out. Lengths in metres, frame as the axes say."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np

from noctule.draw import SOLID_COLOUR, _figure, _outline
from noctule.truth import PLANE_HEIGHT_M, slice_primitives

TRUE, SLAM, ODOMETRY = "black", "#1d4ed8", "#c81e1e"
PAPER, DEFAULT = "#c2410c", "#1b7f3b"
DPI = 90


def png(figure) -> bytes:
    """The finished picture, with a palette: a third of the size."""
    from PIL import Image

    buffer, small = io.BytesIO(), io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    buffer.seek(0)
    Image.open(buffer).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(small, format="png", optimize=True)
    return small.getvalue()


def _plane(axes, frame: str) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel(f"x [m], {frame}")
    axes.set_ylabel(f"y [m], {frame}")


def _solids(axes, primitives, elevation_m: float) -> None:
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection([_outline(s) for s in slice_primitives(primitives, elevation_m + PLANE_HEIGHT_M)], facecolor="#e6ded2",
                                       edgecolor=SOLID_COLOUR, linewidth=0.8))


def trajectory(plan, truth, track, dead) -> bytes:
    """Figure 3: true, odometry and SLAM in Map, the walls of the plan behind them. truth, track, dead: (K, 3)."""
    from noctule import planar_profile

    # The plan lies in World; Map is at the first true pose of the way, turned by TURN_RAD against it.
    walls = planar_profile.primitives(plan)
    motion = planar_profile.Motion(plan, len(truth) * 0.05)
    start = motion.at(np.array([0.05]))
    x0, y0, yaw = float(start["place"][0, 0]), float(start["place"][0, 1]), float(start["yaw"][0])
    c, s = math.cos(yaw), math.sin(yaw)
    figure = _figure(7.4, 6.2)
    axes = figure.add_subplot()
    for solid in walls:
        cx, cy = solid.centre_m[0] - x0, solid.centre_m[1] - y0
        hx, hy = solid.half_extent_m[:2]
        if solid.kind == "cylinder":
            turn = np.linspace(0, 2 * math.pi, 30)
            corners = np.column_stack([cx + hx * np.cos(turn), cy + hx * np.sin(turn)])
        else:
            w = solid.yaw_rad
            box = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (hx, hy)
            corners = box @ np.array([[math.cos(w), math.sin(w)], [-math.sin(w), math.cos(w)]]) + (cx, cy)
        corners = corners @ np.array([[c, -s], [s, c]])
        axes.fill(corners[:, 0], corners[:, 1], color=SOLID_COLOUR, lw=0)
    low, high = axes.dataLim.min - 0.6, axes.dataLim.max + 0.6
    axes.plot(dead[:, 0], dead[:, 1], color=ODOMETRY, lw=1.2, label="odometry (inertial data alone)")
    axes.plot(truth[:, 0], truth[:, 1], color=TRUE, lw=1.6, label="true")
    axes.plot(track[::12, 0], track[::12, 1], "x", color=SLAM, ms=5, mew=1.1, label="SLAM (every 12th pose)")
    axes.plot(0, 0, "o", color="black", ms=5)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), title="Trajectory, 676 poses, paper preset, seed 1")
    _plane(axes, "Map")
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return png(figure)


def yaw(t_s, true_rad, estimated_rad) -> bytes:
    """Figure 4: true and estimated yaw, and their difference."""
    figure = _figure(7.4, 4.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    upper.plot(t_s, np.degrees(np.unwrap(true_rad)), color=TRUE, lw=2.2, label="true")
    upper.plot(t_s, np.degrees(np.unwrap(estimated_rad)), "--", color=SLAM, lw=1.2, label="estimated")
    upper.set(ylabel="yaw [deg]", title="Orientation, paper preset, seed 1")
    upper.legend(fontsize=8)
    lower.plot(t_s, np.degrees(np.remainder(estimated_rad - true_rad + math.pi, 2 * math.pi) - math.pi), color=SLAM, lw=0.9)
    lower.set(xlabel="time [s]", ylabel="error [deg]")
    lower.grid(alpha=0.3)
    return png(figure)


def height(t_s, true_m, estimated_m, levels_m) -> bytes:
    """Figure 6: true and estimated altitude, the levels as lines, and the error."""
    figure = _figure(7.4, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for z, what in levels_m:
        upper.axhline(z, color=SOLID_COLOUR, lw=0.9, ls=":")
        upper.text(t_s[-1], z, f" {what} {z:g} m", fontsize=7, va="bottom", ha="right", color="#6b5f4b")
    upper.plot(t_s, true_m, color=TRUE, lw=2.2, label="true")
    upper.plot(t_s, estimated_m, "--", color=SLAM, lw=1.2, label="estimated")
    upper.set(ylabel="z [m], Map", title="Altitude, paper preset, seed 1")
    upper.legend(fontsize=8, loc="upper left")
    lower.plot(t_s, 100 * (estimated_m - true_m), color=SLAM, lw=0.9)
    lower.set(xlabel="time [s]", ylabel="error [cm]")
    lower.grid(alpha=0.3)
    return png(figure)


def levels(flight, samples, told) -> bytes:
    """Figure 7: the levels found, over the solids that were flown over, in the x-z plane."""
    figure = _figure(7.4, 4.2)
    axes = figure.add_subplot()
    x0, x1 = float(samples.true_x_m.min()) - 1.0, float(samples.true_x_m.max()) + 1.0
    for solid in flight.solids:
        axes.fill_between([max(solid.x0, x0), min(solid.x1, x1)], solid.z0, solid.z1, color="#e6ded2", edgecolor=SOLID_COLOUR, lw=0.8)
    axes.plot(samples.true_x_m, samples.true_z_m, color=TRUE, lw=0.9, alpha=0.6, label="true path")
    for facing, colour, label in ((1, SLAM, "level found, seen from above"), (-1, ODOMETRY, "level found, seen from below")):
        first = True
        for level in (v for v in told.levels if v.facing == facing and -1.0 < v.z_m < 6.0):
            axes.plot([level.x_min_m, max(level.x_max_m, level.x_min_m + 0.05)], [level.z_m] * 2, color=colour, lw=2.2, label=label if first else None)
            first = False
    axes.set(xlabel="x [m], Map", ylabel="z [m], Map", xlim=(x0, x1), ylim=(-0.4, 5.2), title="Levels at the end of the flight, paper preset, seed 1")
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return png(figure)


def mazes(flown) -> bytes:
    """Figure 9: the paths in both mazes, published method and default side by side. flown: name -> (world, {policy: Exploration})."""
    figure = _figure(8.6, 8.8)
    grid = figure.subplots(2, 2)
    for line, (name, (world, runs)) in zip(grid, flown.items()):
        for axes, (label, run) in zip(line, runs.items()):
            _solids(axes, world.primitives(), 0.0)
            track = run.track
            axes.plot(track[:, 1], track[:, 2], color=PAPER if label == "paper" else DEFAULT, lw=1.0)
            axes.plot(world.start.x_m, world.start.y_m, "o", color="#c81e1e", ms=6)
            axes.set_title(f"{name}, {'as published' if label == 'paper' else 'default'}: {run.exploring_path_m:.0f} m, {run.exploring_s:.0f} s, "
                           f"explored {100 * run.explored_fraction:.0f} %", fontsize=9)
            axes.set(xlim=(-0.3, 15.3), ylim=(-0.3, 15.3))
            _plane(axes, "World")
    figure.suptitle("Paths from (6, 6, 0), red circle", fontsize=10)
    return png(figure)


def grids(paper, default) -> bytes:
    """Figure 8: the recorded grids of both floors, with the published values above and the defaults below. paper, default: report.Run."""
    from noctule import record

    figure = _figure(8.6, 8.9)
    axes = figure.subplots(2, 2)
    for line, (label, run) in zip(axes, (("obstacle thickness 0.5 m", paper), ("default", default))):
        for floor, panel in enumerate(line):
            panel.set_title(f"floor {floor}, {label}", fontsize=9)
            odds, x0, y0, cell = record.map_of(run.flight.tiles, floor) or (np.zeros((1, 1), np.int8), 0.0, 0.0, 0.1)
            picture = np.full(odds.shape, 0.72)
            picture[odds < 0], picture[odds > 0] = 1.0, 0.0
            panel.imshow(picture, cmap="gray", vmin=0, vmax=1, origin="lower", interpolation="nearest",
                         extent=(x0, x0 + odds.shape[1] * cell, y0, y0 + odds.shape[0] * cell))
            rows, columns = np.nonzero(odds)
            if len(rows):
                panel.set(xlim=(x0 + (columns.min() - 5) * cell, x0 + (columns.max() + 5) * cell), ylim=(y0 + (rows.min() - 5) * cell, y0 + (rows.max() + 5) * cell))
            else:
                panel.text(0.5, 0.5, "not reached", ha="center", transform=panel.transAxes)
            _plane(panel, "Map")
    figure.suptitle("Occupancy grids, cells 0.10 m: white free, black occupied, grey unknown", fontsize=10)
    return png(figure)


def modes(paper, default) -> bytes:
    """Figure 10: histograms of what the upward range saw over the first floor. paper, default: Overhead or None."""
    figure = _figure(7.4, 3.8)
    for panel, (label, seen) in zip(figure.subplots(1, 2, sharey=True), (("as published", paper), ("default", default))):
        panel.set(xlabel="elevation over the floor [m]", xlim=(1.5, 5.3))
        panel.set_title(label, fontsize=9)
        if seen is None:
            panel.text(0.5, 0.5, "nothing seen", ha="center", transform=panel.transAxes)
            continue
        bins = np.arange(1.5, 5.3, 0.05)
        panel.hist(seen.elevation_m[~seen.far], bins, color=SLAM, label=f"near mode {seen.near_m:.2f} m")
        panel.hist(seen.elevation_m[seen.far], bins, color=ODOMETRY, label=f"far mode {seen.far_m:.2f} m")
        for z in (seen.near_m, seen.far_m):
            panel.axvline(z, color="black", lw=0.8, ls="--")
        panel.set_yscale("log")
        panel.legend(fontsize=8)
    figure.axes[0].set_ylabel("places (cells of 0.10 m)")
    figure.suptitle("Upward range over the first floor of two_floor, k-means with k = 2, seed 1", fontsize=10)
    return png(figure)


def transition_points(world, label, seen) -> bytes:
    """Figure 11: far places with the distance to their nearest near place, in the plan of the first floor. seen: Overhead of the flight `label`, or None."""
    from noctule.paper import transitions

    figure = _figure(9.2, 4.3)
    opening = world.floors[1].openings[0]
    corners = np.array([(opening[0], opening[1]), (opening[2], opening[1]), (opening[2], opening[3]), (opening[0], opening[3]), (opening[0], opening[1])])
    whole, close = figure.subplots(1, 2)
    for panel in (whole, close):
        _solids(panel, world.primitives(), 0.0)
        panel.plot(*corners.T, color="#6b5f4b", lw=1.2, ls="--", label="true opening")
        _plane(panel, "World")
    whole.set(xlim=(-0.3, 16.3), ylim=(-0.3, 16.3))
    close.set(xlim=(opening[0] - 1, opening[2] + 1), ylim=(opening[1] - 1, opening[3] + 1))
    if seen is not None and len(r := transitions(seen)):
        near, far = seen.places[~seen.far], seen.places[seen.far]
        for panel, size in ((whole, 2), (close, 12)):
            panel.scatter(near[:, 0], near[:, 1], s=size, color=SLAM, label="near ceiling seen", lw=0)
            dots = panel.scatter(far[:, 0], far[:, 1], s=1.5 * size, c=r, cmap="autumn_r", vmin=0, vmax=2.0, lw=0, label="far ceiling seen")
        figure.colorbar(dots, ax=close, label="to the nearest near place [m]")
        for n, k in enumerate((int(np.argmax(r)), int(np.argmin(np.abs(r - 0.4 * r.max()))))):
            nearest = near[np.argmin(np.hypot(*(near - far[k]).T))]
            close.plot(*np.array([far[k], nearest]).T, color="black", lw=1.1)
            close.annotate(f"R{n + 1} = {r[k]:.2f} m", far[k], fontsize=8, xytext=(14, -14 - 14 * n), textcoords="offset points",
                           arrowprops={"arrowstyle": "-", "lw": 0.6}, bbox={"facecolor": "white", "lw": 0, "pad": 1, "alpha": 0.8})
    whole.legend(fontsize=7, loc="lower left")
    figure.suptitle(f"Transition candidates, places seen from the first floor by the flight '{label}', seed 1", fontsize=10)
    return png(figure)


def flight_3d(world, paper, default) -> bytes:
    """Figure 12: true trajectories in space, floors as outlines. paper, default: report.Run."""
    figure = _figure(9.0, 4.8)
    for n, (label, run) in enumerate((("as published", paper), ("default", default))):
        axes = figure.add_subplot(1, 2, n + 1, projection="3d")
        for floor in world.floors:
            for shape in slice_primitives(world.primitives(), floor.elevation_m + PLANE_HEIGHT_M):
                outline = _outline(shape)
                outline = np.vstack([outline, outline[:1]])
                axes.plot(outline[:, 0], outline[:, 1], floor.elevation_m, color=SOLID_COLOUR, lw=0.6)
        truth = run.truth
        flown = np.asarray(truth["armed"], bool)
        axes.plot(truth["x_m"][flown], truth["y_m"][flown], truth["z_m"][flown], color=SLAM, lw=0.9)
        x, y, z = (float(truth[k][0]) for k in ("x_m", "y_m", "z_m"))
        axes.plot([x], [y], [z], "o", color="#c81e1e", ms=5)
        seconds = float(truth["t_s"][flown][-1] - truth["t_s"][flown][0]) if flown.any() else 0.0
        axes.set(xlabel="x [m], World", ylabel="y [m]", zlabel="z [m]", zlim=(0, 4.8))
        axes.set_title(f"{label}: {seconds:.0f} s in the air", fontsize=9)
        axes.set_box_aspect((16, 16, 9))
        axes.view_init(elev=32, azim=-62)
        axes.tick_params(labelsize=7)
    figure.suptitle("True trajectory over two floors (two_floor, seed 1); the red dot is the start", fontsize=10)
    return png(figure)


def segmentation(run: Path, threshold: int) -> bytes:
    """Figure 13: a frame, its mask by one threshold for all channels, and what was detected in it, of the frame with the most sure objects."""
    from noctule import record
    from noctule.vision_abi import surf

    kind = record.message_type("objects_t")
    frames, told = {}, []
    for channel, _, data in record.events(run / "camera.lcm"):
        if channel == "OBJECTS":
            m = kind.decode(data)
            told.append((sum(v > 0 for v in m.object_id[:m.count]), m.count, sum(m.area_px[:m.count]), m))
    wanted = max(told, key=lambda t: t[:3])[3] if told else None
    for channel, _, data in record.events(run / "camera.lcm"):
        if channel == "IMAGE" and wanted is not None and int.from_bytes(data[8:16], "big") == wanted.t_us:
            width, height = int.from_bytes(data[20:24], "big"), int.from_bytes(data[24:28], "big")
            frames[wanted.t_us] = np.frombuffer(data, np.uint8, width * height * 3, 28).reshape(height, width, 3)
    figure = _figure(9.2, 3.3)
    panels = figure.subplots(1, 3)
    for panel, title in zip(panels, ("frame", f"any channel >= I0 = {threshold}", "regions and SURF key points")):
        panel.set_title(title, fontsize=9)
        panel.set(xlabel="column [px]")
    panels[0].set_ylabel("row [px]")
    if wanted is not None and frames:
        bgr = frames[wanted.t_us]
        panels[0].imshow(bgr[..., ::-1])
        panels[1].imshow((bgr >= threshold).any(axis=2), cmap="gray")
        panels[2].imshow(bgr[..., ::-1])
        grey = np.ascontiguousarray(np.round(bgr @ np.array([0.114, 0.587, 0.299])).astype(np.uint8))
        points = surf(grey, 60).points
        panels[2].plot(points[:, 0], points[:, 1], "+", color="yellow", ms=4, mew=0.8)
        for k in range(wanted.count):
            radius = math.sqrt(wanted.area_px[k] / math.pi)
            turn = np.linspace(0, 2 * math.pi, 40)
            sure = wanted.object_id[k] > 0
            panels[2].plot(wanted.u_px[k] + radius * np.cos(turn), wanted.v_px[k] + radius * np.sin(turn), color="#16a34a" if sure else "#c81e1e", lw=1.4)
            panels[2].text(wanted.u_px[k], wanted.v_px[k], f"object {wanted.object_id[k]}" if sure else "?", color="white", fontsize=7, ha="center",
                           bbox={"facecolor": "black", "alpha": 0.6, "pad": 1, "lw": 0})
        panels[2].set(xlim=(0, bgr.shape[1]), ylim=(bgr.shape[0], 0))
    figure.suptitle("Camera in the gallery: green ring, an object of the database; red ring, a region that is none (yet)", fontsize=9)
    return png(figure)
