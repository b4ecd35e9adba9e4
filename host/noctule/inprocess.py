"""The firmware's autonomy inside this process: the very NavNode of noctule-nav, fed and read with encoded LCM messages."""

import ctypes
import os
from pathlib import Path

INPUT = ("accepted", "other_channel", "rejected_malformed", "rejected_repeat", "refused_full")


class LibraryMissing(RuntimeError):
    """The shared library was not built."""


def library_path():
    """Path of libnoctule_sim_abi.so: NOCTULE_SIM_ABI if set, else the release build of this checkout.

    Raises:
        LibraryMissing: there is no such file; the text says how to build it.
    """
    chosen = os.environ.get("NOCTULE_SIM_ABI")
    path = Path(chosen) if chosen else Path(__file__).resolve().parents[2] / "build" / "release" / "lib" / "libnoctule_sim_abi.so"
    if not path.is_file():
        raise LibraryMissing(f"{path} is not there: run `make build`")
    return path


def library():
    """The shared library, loaded.

    Raises:
        LibraryMissing: it was not built.
    """
    return ctypes.CDLL(str(library_path()))


def _load():
    library = ctypes.CDLL(str(library_path()))
    library.noctule_create.restype = ctypes.c_void_p
    library.noctule_destroy.argtypes = [ctypes.c_void_p]
    library.noctule_set_parameter.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_double]
    for name in ("noctule_receive", "noctule_hold"):
        getattr(library, name).argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_size_t]
    library.noctule_step_with.argtypes = [ctypes.c_void_p] + [ctypes.c_int] * 9
    library.noctule_next.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_char_p), ctypes.POINTER(ctypes.c_void_p)]
    library.noctule_next.restype = ctypes.c_size_t
    library.noctule_explorer_counters.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint32)]
    library.noctule_navigator_bytes.restype = ctypes.c_size_t
    library.noctule_grid_beams_per_s.argtypes = [ctypes.c_int]
    library.noctule_grid_beams_per_s.restype = ctypes.c_double
    return library


class Node:
    """One autonomy. Not thread-safe; nodes share nothing.

    Args:
        parameters: name or MAVLink id -> value; what is not named keeps its default.

    Raises:
        LibraryMissing: the shared library was not built.
        ValueError: no such parameter, or a value out of its range.
    """

    _library = None

    def __init__(self, parameters=None):
        if Node._library is None:
            Node._library = _load()
        self._handle = Node._library.noctule_create()
        self._channel = ctypes.c_char_p()
        self._bytes = ctypes.c_void_p()
        for name, value in (parameters or {}).items():
            result = Node._library.noctule_set_parameter(self._handle, name.encode(), float(value))
            if result != 0:
                raise ValueError(f"parameter {name} = {value}: " + {1: "no such name", 2: "out of range or not whole", 3: "too late"}[result])

    def close(self):
        """Frees the node. A closed node must not be used."""
        if self._handle:
            Node._library.noctule_destroy(self._handle)
            self._handle = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def receive(self, channel, message):
        """One encoded message (bytes) of a channel (str) in; a step that is due runs. Returns the name in INPUT."""
        return INPUT[Node._library.noctule_receive(self._handle, channel.encode(), message, len(message))]

    def hold(self, channel, message):
        """As receive, but a step runs only through step_with (replay)."""
        return INPUT[Node._library.noctule_hold(self._handle, channel.encode(), message, len(message))]

    def step_with(self, imu, attitude, range_up, range_down, vehicle, command, baro=0, parameters=0, policy=0):
        """Runs the step of the waiting scan with so many samples. False: fewer are there, nothing was done."""
        return Node._library.noctule_step_with(self._handle, imu, attitude, range_up, range_down, vehicle, command, baro, parameters, policy) == 1

    def explorer(self):
        """Counters of the exploration so far: dict of report.EXPLORER_COUNTERS."""
        from noctule.report import EXPLORER_COUNTERS

        out = (ctypes.c_uint32 * len(EXPLORER_COUNTERS))()
        Node._library.noctule_explorer_counters(self._handle, out)
        return dict(zip(EXPLORER_COUNTERS, map(int, out)))

    def outputs(self):
        """What came out since the last call: list of (channel, bytes) in the order of publishing."""
        out = []
        while size := Node._library.noctule_next(self._handle, ctypes.byref(self._channel), ctypes.byref(self._bytes)):
            out.append((self._channel.value.decode(), ctypes.string_at(self._bytes, size)))
        return out


def navigator_bytes():
    """Static memory of one Navigator [bytes]."""
    if Node._library is None:
        Node._library = _load()
    return Node._library.noctule_navigator_bytes()


def grid_beams_per_s(sweeps=400):
    """Beams that the occupancy grid takes up in a second of thread CPU, sweeps of 1080 beams in a hall of 14 x 9 m."""
    if Node._library is None:
        Node._library = _load()
    return Node._library.noctule_grid_beams_per_s(sweeps)
