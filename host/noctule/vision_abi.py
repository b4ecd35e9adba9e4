"""The recognition library inside this process, and dlib's SURF as its reference where the bench was built with it."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from noctule.processes import build_folder

CAPACITY = 2048


@dataclass(frozen=True)
class Features:
    """Key points and descriptors of one image, strongest first.

    points: (N, 6) float32: x, y, scale [px], response, orientation [rad], 1 for a bright blob (dlib: sign of the Laplacian).
    descriptors: (N, D). times_us: (repeats,) thread CPU time of each extraction.
    """

    points: np.ndarray
    descriptors: np.ndarray
    times_us: np.ndarray


@lru_cache(maxsize=None)
def library(name: str) -> ctypes.CDLL | None:
    """The shared library of that name from the release build, or None where it was not built."""
    path = Path(build_folder()) / "lib" / f"lib{name}.so"
    return ctypes.CDLL(str(path)) if path.is_file() else None


def _pointer(array: np.ndarray, kind):
    return array.ctypes.data_as(ctypes.POINTER(kind))


def _extract(call, grey: np.ndarray, arguments, repeats: int) -> Features:
    grey = np.ascontiguousarray(grey, np.uint8)
    points = np.zeros((CAPACITY, 6), np.float32)
    descriptors = np.zeros((CAPACITY, 64), np.float32)
    times = np.zeros(repeats)
    count = call(_pointer(grey, ctypes.c_uint8), grey.shape[1], grey.shape[0], *arguments, repeats, _pointer(points, ctypes.c_float),
                 _pointer(descriptors, ctypes.c_float), CAPACITY, _pointer(times, ctypes.c_double))
    return Features(points[:count].copy(), descriptors[:count].copy(), times)


def surf(grey: np.ndarray, most: int, threshold: float = 1e-5, octaves: int = 4, step_px: int = 2, repeats: int = 1) -> Features:
    """Our SURF. grey: (H, W) uint8.

    Raises:
        RuntimeError: the library was not built.
    """
    found = library("noctule_vision_abi")
    if found is None:
        raise RuntimeError("libnoctule_vision_abi.so is not there: run `make build`")
    return _extract(found.noctule_surf, grey, (ctypes.c_float(threshold), octaves, step_px, most), repeats)


def dlib_surf(grey: np.ndarray, most: int, threshold: float = 1.0, repeats: int = 1) -> Features | None:
    """dlib's SURF (get_surf_points), or None where the bench was built without it. grey: (H, W) uint8."""
    found = library("noctule_bench_dlib")
    return None if found is None else _extract(found.bench_dlib_surf, grey, (ctypes.c_float(threshold), most), repeats)


def plane_fit(pairs: np.ndarray, tolerance_px: float = 3.0, trials: int = 2000, similarity: bool = False) -> tuple[np.ndarray | None, int]:
    """Our homography (or similarity) over matches, and how many of them agree; None where there is none.

    Args:
        pairs: (N, 4) x, y in the first picture, u, v in the second [px].
    """
    found = library("noctule_vision_abi")
    if found is None:
        raise RuntimeError("libnoctule_vision_abi.so is not there: run `make build`")
    pairs = np.ascontiguousarray(pairs, np.float32)
    H = np.zeros(9)
    agree = found.noctule_plane_fit(_pointer(pairs, ctypes.c_float), len(pairs), ctypes.c_float(tolerance_px), trials, 2 if similarity else 4,
                                    _pointer(H, ctypes.c_double))
    return (H.reshape(3, 3), agree) if agree else (None, 0)


class Vision:
    """The recognition of noctule-vision, fed with encoded messages. Not thread-safe.

    Args:
        database: SQLite file, made if absent; None: in memory alone.
        calibration: OpenCV YAML; None: the simulator's camera.
        resume: the places in the database hold.
        parameters: name -> value; what is not named keeps its default.

    Raises:
        ValueError: no such parameter, or out of range.
        RuntimeError: the library was not built, or database or calibration cannot be used.
    """

    def __init__(self, database=None, calibration=None, resume: bool = False, parameters=None):
        self._library = library("noctule_vision_abi")
        if self._library is None:
            raise RuntimeError("libnoctule_vision_abi.so is not there: run `make build`")
        self._library.noctule_vision_create.restype = ctypes.c_void_p
        self._library.noctule_heap_bytes.restype = ctypes.c_long
        error = ctypes.create_string_buffer(512)
        encode = lambda path: None if path is None else str(path).encode()
        self._handle = self._library.noctule_vision_create(encode(calibration), encode(database), int(resume), error, len(error))
        if not self._handle:
            raise RuntimeError(error.value.decode())
        self._bytes = ctypes.c_void_p()
        for name, value in (parameters or {}).items():
            result = self._library.noctule_vision_set(ctypes.c_void_p(self._handle), name.encode(), ctypes.c_double(value))
            if result != 0:
                raise ValueError(f"parameter {name} = {value}: {'no such name' if result == 1 else 'out of range'}")

    def receive(self, channel: str, message: bytes) -> bool:
        """One encoded NAV, SCAN or IMAGE in."""
        return self._library.noctule_vision_receive(ctypes.c_void_p(self._handle), channel.encode(), message, len(message)) == 1

    def look(self) -> bytes | None:
        """Looks at the waiting frame; the encoded OBJECTS, or None where no frame waits."""
        size = self._library.noctule_vision_look(ctypes.c_void_p(self._handle), ctypes.byref(self._bytes))
        return ctypes.string_at(self._bytes, size) if size > 0 else None

    def heap_bytes(self) -> int:
        """Bytes of the C heap in use by this whole process."""
        return self._library.noctule_heap_bytes()

    def close(self) -> None:
        """Ends the session; the database is closed."""
        if self._handle:
            self._library.noctule_vision_destroy(ctypes.c_void_p(self._handle))
            self._handle = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
