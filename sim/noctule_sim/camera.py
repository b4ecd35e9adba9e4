"""The front camera: MuJoCo's renderer without a window (EGL, no multisampling)."""

from __future__ import annotations

import mujoco
import numpy as np

WIDTH_PX, HEIGHT_PX = 320, 240


class CameraUnavailable(RuntimeError):
    """There is no way to render here; the text is one line."""


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
