"""The front camera: MuJoCo's renderer without a window (EGL, no multisampling), and what a real camera adds to the picture.

Light that changes in strength and tint, rows exposed one after the other, motion blur, noise. All of it follows from the seed and the time of
the frame. The picture is stamped with the middle of the exposure of its middle row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

WIDTH_PX, HEIGHT_PX = 320, 240
FOVY_DEG = 54.0                        # as in the model of the vehicle
POSITION_BODY_M = (0.12, 0.0, 0.03)    # as in the model of the vehicle
FOCAL_PX = HEIGHT_PX / 2 / math.tan(math.radians(FOVY_DEG / 2))
ROW_TIME_S = 6.0e-5                    # from one row to the next: 14 ms a frame
EXPOSURE_S = 0.010
NOISE_LEVELS = 2.5                     # standard deviation, of 255
_NOISE_BANK = 3


class CameraUnavailable(RuntimeError):
    """There is no way to render here; the text is one line."""


def calibration() -> str:
    """The camera's calibration in OpenCV's YAML form, with its place on the vehicle (docs/objects.md)."""
    matrix = (FOCAL_PX, 0.0, (WIDTH_PX - 1) / 2, 0.0, FOCAL_PX, (HEIGHT_PX - 1) / 2, 0.0, 0.0, 1.0)

    def block(name: str, rows: int, columns: int, values) -> str:
        return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {', '.join(repr(float(v)) for v in values)} ]\n"

    return ("%YAML:1.0\n---\n"
            f"image_width: {WIDTH_PX}\nimage_height: {HEIGHT_PX}\n" + block("camera_matrix", 3, 3, matrix)
            + block("distortion_coefficients", 1, 5, (0.0,) * 5)
            + f"position_body_m: [ {', '.join(repr(v) for v in POSITION_BODY_M)} ]\nyaw_rad: 0.0\npitch_rad: 0.0\nrow_time_s: {ROW_TIME_S!r}\n")


def write_calibration(path) -> None:
    """calibration() as a file."""
    Path(path).write_text(calibration(), encoding="ascii")


@dataclass(frozen=True)
class Light:
    """Strength and tint (blue, green, red) of the light at a moment, both 1 on average."""

    gain: float
    tint: tuple[float, float, float]


class Optics:
    """What lies between a perfect picture and the camera's.

    Args:
        rng: of noise and light.
        perfect: nothing is added (profile `ideal`).
    """

    def __init__(self, rng: np.random.Generator, perfect: bool = False):
        self._perfect = perfect
        self._rng = rng
        self._phase = rng.uniform(0.0, 2.0 * math.pi, 5)
        self._bank = rng.normal(0.0, NOISE_LEVELS, (_NOISE_BANK, HEIGHT_PX, WIDTH_PX, 3)).astype(np.float32)

    def light(self, t_s: float) -> Light:
        """Two slow waves in strength, one in tint: clouds, and lamps of different colour."""
        if self._perfect:
            return Light(1.0, (1.0, 1.0, 1.0))
        p = self._phase
        gain = 0.85 + 0.20 * math.sin(2 * math.pi * t_s / 23.0 + p[0]) + 0.10 * math.sin(2 * math.pi * t_s / 7.3 + p[1])
        warm = 0.08 * math.sin(2 * math.pi * t_s / 41.0 + p[2])
        return Light(gain, (1.0 - warm, 1.0 + 0.02 * math.sin(2 * math.pi * t_s / 31.0 + p[3]), 1.0 + warm))

    def apply(self, bgr: np.ndarray, t_s: float, yaw_rate_rad_s: float, pitch_rate_rad_s: float) -> np.ndarray:
        """The camera's picture.

        Args:
            bgr: (240, 320, 3) uint8, rendered at the stamp.
            t_s: stamp.
            yaw_rate_rad_s, pitch_rate_rad_s: rates of the camera about its axes up and left; the shift they cause is that of far points.
        """
        import cv2

        if self._perfect:
            return bgr
        # What lies right of the axis moves left as the camera turns left: content moves to the right by focal length times angle.
        u_px_s, v_px_s = FOCAL_PX * yaw_rate_rad_s, -FOCAL_PX * pitch_rate_rad_s
        if abs(u_px_s) * ROW_TIME_S * HEIGHT_PX > 0.5 or abs(v_px_s) * ROW_TIME_S * HEIGHT_PX > 0.5:
            late_s = (np.arange(HEIGHT_PX, dtype=np.float32) - HEIGHT_PX / 2) * np.float32(ROW_TIME_S)
            x, y = np.meshgrid(np.arange(WIDTH_PX, dtype=np.float32), np.arange(HEIGHT_PX, dtype=np.float32))
            bgr = cv2.remap(bgr, x - (u_px_s * late_s)[:, None], y - (v_px_s * late_s)[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        length = math.hypot(u_px_s, v_px_s) * EXPOSURE_S
        if length > 0.7:
            size = 2 * int(math.ceil(length / 2)) + 1
            kernel = np.zeros((size, size), np.float32)
            for s in np.linspace(-0.5, 0.5, 4 * size):
                kernel[int(round(size // 2 + s * length * v_px_s / math.hypot(u_px_s, v_px_s))),
                       int(round(size // 2 + s * length * u_px_s / math.hypot(u_px_s, v_px_s)))] += 1.0
            bgr = cv2.filter2D(bgr, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
        light = self.light(t_s)
        picture = bgr * (light.gain * np.array(light.tint, np.float32))
        noise = self._bank[self._rng.integers(_NOISE_BANK)]
        picture += np.roll(noise, (int(self._rng.integers(HEIGHT_PX)), int(self._rng.integers(WIDTH_PX))), (0, 1))
        return np.clip(picture, 0.0, 255.0).astype(np.uint8)


class Camera:
    """Renders what the camera "front" of a model sees.

    Raises:
        CameraUnavailable: no EGL.
    """

    def __init__(self, model: mujoco.MjModel):
        try:
            from mujoco.egl import GLContext

            self._context = GLContext(WIDTH_PX, HEIGHT_PX)
            self._context.make_current()
            self._render = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._render)
            if self._render.currentBuffer != mujoco.mjtFramebuffer.mjFB_OFFSCREEN:
                raise RuntimeError("no off-screen buffer")
        except Exception as error:  # every library on the way has errors of its own
            raise CameraUnavailable(f"no camera: EGL rendering is not available here ({' '.join(str(error).split()) or type(error).__name__})") from None
        self._model = model
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 20)
        self._option = mujoco.MjvOption()
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, "front")
        self._rectangle = mujoco.MjrRect(0, 0, WIDTH_PX, HEIGHT_PX)
        self._rgb = np.empty((HEIGHT_PX, WIDTH_PX, 3), np.uint8)

    def capture(self, data: mujoco.MjData) -> np.ndarray:
        """(240, 320, 3) uint8, blue green red, first row on top."""
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._view, mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        mujoco.mjr_render(self._rectangle, self._scene, self._render)
        mujoco.mjr_readPixels(self._rgb, None, self._rectangle, self._render)
        return np.ascontiguousarray(self._rgb[::-1, :, ::-1])

    def close(self) -> None:
        self._render.free()
        self._context.free()
