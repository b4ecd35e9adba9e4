"""The closed loop without sockets: one tick of 50 ms at a time, truth inside, measurements out, answers in.

A tick ends at T = k * 50 ms with a laser sweep stamped T. What the companion answers to it is handed to `apply` (or
`post`) and takes effect the profile's latency after T, whatever the wall clock did. The same world, seed and answers
give the same bits. Frames: truth in World, the autopilot and its setpoints in Map.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Callable, NamedTuple

import numpy as np

from .autopilot import Autopilot, Landed, Mode
from .autopilot_control import SLUGGISH
from .geometry import Geometry
from .sensors import PROFILES, Barometer, Imu, Laser, Magnetometer, RangeSensor
from .vehicle import PHYSICS_STEP_S, Airframe, Vehicle, quaternion_to_euler
from .world import World

TICK_US = 50_000
FAULTS = ("odometry-cut", "setpoint-cut", "lidar-cut", "imu-50hz", "battery-drain", "sluggish")
DRAIN_PER_S = 1.0 / 150.0  # share of the battery that a drain takes beside what flying takes
SETTLE_S = 1.0            # the simulation goes on for this long after landing and disarming
CONTACT_GAP_S = 0.5       # contacts closer than this are one collision
LOW_M = 0.5               # nearer to the floor than this, take-off and landing are told from a low pass
CRASH_TILT_RAD = 1.0
CRASH_S = 2.0

# Inertial samples of a tick: physics steps in each. 250 Hz is 12.5 a tick: 13 and 12 in turn, always one at the end.
_SPLIT = ((1,) + (2,) * 12, (3,) + (2,) * 11)
# Which of them also carry an attitude (50 Hz: 2 and 3 in turn, always the last).
_ATTITUDE = (frozenset((6, 12)), frozenset((3, 7, 11)))
_CAMERA_EVERY = 4
EXTERNAL_POSE_US = 5_000  # poses kept for the laser's sweep when a real autopilot flies


class SetpointIn(NamedTuple):
    """A position setpoint, frame Map: metres, metres per second (0: none), radians."""

    x_m: float
    y_m: float
    z_m: float
    vx_m_s: float
    vy_m_s: float
    vz_m_s: float
    yaw_rad: float


class OdometryIn(NamedTuple):
    """A pose from the companion, measured at t_us, frame Map."""

    t_us: int
    x_m: float
    y_m: float
    z_m: float
    vx_m_s: float
    vy_m_s: float
    vz_m_s: float
    yaw_rad: float
    quality: int
    reset_counter: int


class Inertial(NamedTuple):
    """One inertial sample, mean since the one before, frame Body."""

    t_us: int
    ax: float
    ay: float
    az: float
    gx: float
    gy: float
    gz: float


class AttitudeOut(NamedTuple):
    """The autopilot's attitude: quaternion Body to Map, rates in Body."""

    t_us: int
    qw: float
    qx: float
    qy: float
    qz: float
    wx: float
    wy: float
    wz: float

    @property
    def euler_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw, Z-Y-X."""
        return quaternion_to_euler(self.qw, self.qx, self.qy, self.qz)


class Truth(NamedTuple):
    """The true state at the end of a tick, frame World. Never leaves the simulator but into truth.csv."""

    t_s: float
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    roll_rad: float
    pitch_rad: float
    vx_m_s: float
    vy_m_s: float
    vz_m_s: float
    clearance_m: float          # hull to the nearest solid but slabs, cut at 3 m
    floor_clearance_m: float    # hull to the slab below, cut at 3 m
    ceiling_clearance_m: float  # hull to the slab above, cut at 3 m
    contacts_total: int


@dataclass
class TickData:
    """Everything that left the sensors and the autopilot in one tick."""

    t_us: int
    imu: list[Inertial]
    attitude: list[AttitudeOut]
    magnet_gauss: tuple[float, float, float]
    range_up_m: float                  # NaN: no reading
    range_down_m: float                # NaN: no reading
    scan_m: np.ndarray | None          # (B,) float32, or None when the laser is cut
    local: tuple[float, ...]           # the autopilot's x, y, z [m], vx, vy, vz [m/s], yaw [rad], frame Map
    messages: list[tuple[int, str]]    # severity and text that the autopilot said
    truth: Truth
    image: tuple[int, np.ndarray] | None = None  # time of exposure [us], (240, 320, 3) BGR
    baro_m: float = math.nan           # height by air pressure, origin arbitrary


@dataclass
class Outcome:
    """How a simulation ended."""

    name: str        # landed | max_time | crashed | interrupted | running
    text: str
    reasons: list[str] = field(default_factory=list)


class Simulation:
    """One vehicle in one world.

    Args:
        world: the building.
        seed: of all noise, biases and scale errors.
        profile: 'ideal', 'default' or 'harsh'.
        parameters: name -> value of the vehicle's rows of the parameter table; what is not named keeps its default.
        camera: render images; raises camera.CameraUnavailable where that is not possible.
        flavour: 'px4' or 'ardupilot'.
        faults: name (one of FAULTS) -> time from which it acts [s].
        max_time_s: the simulation ends then.
        external: a real autopilot in the place of the simulated one (external.External); None: none.
    """

    def __init__(self, world: World, seed: int = 0, profile: str = "default", parameters=None, camera: bool = False,
                 flavour: str = "px4", faults=None, max_time_s: float = math.inf, external=None):
        if profile not in PROFILES:
            raise ValueError(f"profile '{profile}' is not one of {', '.join(PROFILES)}")
        for name in faults or {}:
            if name not in FAULTS:
                raise ValueError(f"fault '{name}' is not one of {', '.join(FAULTS)}")
        self.world, self.seed, self.profile = world, seed, PROFILES[profile]
        self.faults = {name: int(round(t * 1e6)) for name, t in (faults or {}).items()}
        self.max_time_s = max_time_s
        p = vehicle_parameters(parameters)
        self.airframe = Airframe(hull_radius_m=p["hull_radius_m"], hull_height_m=p["hull_height_m"], rest_height_m=max(
            p["ground_clearance_m"], p["hull_height_m"] / 2 + 0.01))
        self.external = external
        self.vehicle = Vehicle(world, self.airframe, external.physics_step_s if external else PHYSICS_STEP_S)
        self.autopilot = external or Autopilot(self.airframe, flavour)
        self.geometry = Geometry(world)
        streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(7)]
        self.laser = Laser(self.profile, streams[0])
        self.range_up = RangeSensor(self.profile, streams[1])
        self.range_down = RangeSensor(self.profile, streams[2])
        self.imu = Imu(self.profile, streams[3])
        self.magnetometer = Magnetometer(self.profile, streams[4])
        self.barometer = Barometer(self.profile, streams[5])
        self._mount = np.array([p["lidar_x_m"], p["lidar_y_m"], p["lidar_z_m"], p["lidar_yaw_rad"]])
        self._up_z, self._down_z = p["range_up_z_m"], p["range_down_z_m"]
        self.camera = None
        if camera:
            from .camera import Camera, Optics

            self.camera = Camera(self.vehicle.model)
            self.optics = Optics(streams[6], perfect=profile == "ideal")
        self.ticks = 0
        self.outcome: Outcome | None = None
        self.collisions = 0
        self.touched: list[str] = []
        self.min_clearance_m = math.inf
        self.flew = False
        self._low_m, self._was_high = math.inf, False
        self._last_contact_us = -10**9
        self._done_since_us: int | None = None
        self._tilted_since_us: int | None = None
        self._pending: deque[tuple[int, Callable[[], object]]] = deque()
        self._split = external.split if external else _SPLIT
        self._spans = tuple(np.array(s) * self.vehicle.step_s for s in self._split)
        self._poses = deque([self._pose_row(0.0)], maxlen=12)
        self._camera_lag = int(round(self.profile.camera_latency_s * 1e6))
        self.odometry_received = self.odometry_used = self.setpoints_received = 0

    # ------------------------------------------------------------ answers

    @property
    def t_us(self) -> int:
        """End of the last tick, autopilot clock."""
        return self.ticks * TICK_US

    def post(self, action: Callable[[], object]) -> None:
        """Let an action act on the autopilot when an answer to the last tick takes effect."""
        self._pending.append((self.t_us + int(round(self.profile.answer_latency_s * 1e6)), action))

    def apply(self, setpoint: SetpointIn | None, odometries=()) -> None:
        """Hand in what the companion answered to the last tick: a setpoint, if it has one, and OdometryIn in order."""
        for odometry in odometries:
            self.post_odometry(odometry)
        if setpoint is not None:
            self.post_setpoint(setpoint)

    def post_odometry(self, odometry: OdometryIn) -> None:
        """One ODOMETRY of the answer."""
        self.odometry_received += 1
        self.post(lambda: self._take_odometry(odometry))

    def post_setpoint(self, setpoint: SetpointIn) -> None:
        """One setpoint of the answer."""
        self.setpoints_received += 1
        self.post(lambda: self._take_setpoint(setpoint))

    def _take_odometry(self, o: OdometryIn) -> None:
        if not self.fault("odometry-cut"):
            self.odometry_used += self.autopilot.odometry(
                o.t_us, o.x_m, o.y_m, o.z_m, o.vx_m_s, o.vy_m_s, o.vz_m_s, o.yaw_rad, o.quality, o.reset_counter)

    def _take_setpoint(self, s: SetpointIn) -> None:
        if not self.fault("setpoint-cut"):
            self.autopilot.setpoint(*s)

    def fault(self, name: str) -> bool:
        """Whether a fault acts now."""
        since = self.faults.get(name)
        return since is not None and self.autopilot.estimator.t_us >= since

    # ------------------------------------------------------------ one tick

    def tick(self) -> TickData:
        """Advance by 50 ms."""
        odd = self.ticks % 2
        t_us = self.ticks * TICK_US
        end_us = t_us + TICK_US
        vehicle, autopilot = self.vehicle, self.autopilot
        if t_us >= self.faults.get("battery-drain", math.inf):
            autopilot.battery = max(0.0, autopilot.battery - DRAIN_PER_S * TICK_US * 1e-6)
        if self.external is None and t_us >= self.faults.get("sluggish", math.inf):
            autopilot.controller.gains = SLUGGISH
        errors = self.imu.errors(self._spans[odd])
        demand = autopilot.rotors
        samples: list[Inertial] = []
        attitudes: list[AttitudeOut] = []
        image = None
        exposure_us = end_us - self._camera_lag if self.camera is not None and (self.ticks + 1) % _CAMERA_EVERY == 0 else -1
        step_us = int(round(vehicle.step_s * 1e6))
        slow = self.profile.imu_stream_hz == 50 or self.fault("imu-50hz")
        for i, steps in enumerate(self._split[odd]):
            ax, ay, az, gx, gy, gz = vehicle.advance(steps, demand)
            t_us += steps * step_us
            e = errors[i]
            sample = Inertial(t_us, ax + e[0], ay + e[1], az + e[2], gx + e[3], gy + e[4], gz + e[5])
            while self._pending and self._pending[0][0] <= t_us:
                self._pending.popleft()[1]()
            demand = autopilot.imu(t_us, steps * vehicle.step_s, *sample[1:])
            if self.external is not None:
                if t_us % EXTERNAL_POSE_US == 0:
                    self._poses.append(self._pose_row(t_us * 1e-6))
            elif i in _ATTITUDE[odd]:
                a = autopilot.estimator
                attitudes.append(AttitudeOut(t_us, a.qw, a.qx, a.qy, a.qz, a.wx, a.wy, a.wz))
                samples.append(sample)
            elif not slow:
                samples.append(sample)
            if self.external is None:
                self._poses.append(self._pose_row(t_us * 1e-6))
            if vehicle.data.ncon:
                self._contacts(t_us)
            if t_us == exposure_us:
                # Rates of the exposure: about Body up and left, as the IMU felt them, without its errors.
                image = (t_us, self.optics.apply(self.camera.capture(vehicle.data), t_us * 1e-6, gz, gy))
        self.ticks += 1
        local = (autopilot.estimator.x, autopilot.estimator.y, autopilot.estimator.z,
                 autopilot.estimator.vx, autopilot.estimator.vy, autopilot.estimator.vz, autopilot.estimator.yaw_rad)
        messages = [(int(s), text) for s, text in autopilot.messages]
        autopilot.messages.clear()
        up, down = self._ranges()
        scan = None if self.fault("lidar-cut") else self._scan(end_us * 1e-6)
        data = TickData(end_us, samples, attitudes, self.magnetometer.measure(vehicle.position_m, vehicle.attitude), up, down, scan,
                        local, messages, self._truth(end_us * 1e-6), image, self.barometer.measure(end_us * 1e-6, vehicle.position_m[2]))
        self._judge(data.truth, end_us)
        return data

    def _pose_row(self, t_s: float) -> tuple:
        return (t_s, *self.vehicle.position_m, *self.vehicle.attitude)

    def _scan(self, t_s: float) -> np.ndarray:
        # The last samples of a tick are 4 ms apart; the sweep reaches back 37.5 ms, ten of them.
        rows = list(self._poses)[-11:]
        poses = np.array(rows)
        out = np.empty(self.profile.beams)
        out[0] = t_s - self.laser.sweep_s
        self.geometry.sweep(poses, self._mount, self.laser.bearings_rad, self.profile.laser_max_m, out)
        return self.laser.measure(out)

    def _ranges(self) -> tuple[float, float]:
        x, y, z = self.vehicle.position_m
        w, i, j, k = self.vehicle.attitude
        ux, uy, uz = 2.0 * (i * k + w * j), 2.0 * (j * k - w * i), 1.0 - 2.0 * (i * i + j * j)
        far = self.profile.range_max_m + 1.0
        up = self.geometry.cast((x + self._up_z * ux, y + self._up_z * uy, z + self._up_z * uz), (ux, uy, uz), far)
        down = self.geometry.cast((x + self._down_z * ux, y + self._down_z * uy, z + self._down_z * uz), (-ux, -uy, -uz), far)
        return self.range_up.measure(up), self.range_down.measure(down)

    def _truth(self, t_s: float) -> Truth:
        v = self.vehicle
        roll, pitch, yaw = v.euler_rad()
        w, i, j, k = v.attitude
        # A tilted cylinder, held in an upright one: never more clearance than there is.
        cosine = abs(1.0 - 2.0 * (i * i + j * j))
        sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
        r, h = self.airframe.hull_radius_m, self.airframe.hull_height_m / 2
        solid, below, above = self.geometry.clearance(*v.position_m, r * cosine + h * sine, h * cosine + r * sine)
        return Truth(t_s, *v.position_m, yaw, roll, pitch, *v.velocity_m_s, solid, below, above, self.collisions)

    def _contacts(self, t_us: int) -> None:
        touching = self.vehicle.touching()
        if not touching:
            return
        if t_us - self._last_contact_us > CONTACT_GAP_S * 1e6:
            self.collisions += 1
            names = sorted(self.geometry.primitives[g].label or self.geometry.primitives[g].tag for g in touching)
            self.touched.append(f"{t_us * 1e-6:.2f} s: touched {', '.join(names)}")
        self._last_contact_us = t_us

    def _judge(self, truth: Truth, t_us: int) -> None:
        autopilot = self.autopilot
        if autopilot.armed and autopilot.landed is not Landed.on_ground:
            self.flew = True
            self.min_clearance_m = min(self.min_clearance_m, truth.clearance_m, truth.ceiling_clearance_m)
            # The floor counts where the vehicle came down to it and rose again; not in take-off, not in the landing.
            if truth.floor_clearance_m < LOW_M:
                self._low_m = min(self._low_m, truth.floor_clearance_m)
            elif self._low_m < math.inf:
                if self._was_high:
                    self.min_clearance_m = min(self.min_clearance_m, self._low_m)
                self._low_m = math.inf
            self._was_high = self._was_high or truth.floor_clearance_m >= LOW_M
        else:
            self._low_m, self._was_high = math.inf, False
        tilt = math.acos(max(-1.0, min(1.0, math.cos(truth.roll_rad) * math.cos(truth.pitch_rad))))
        self._tilted_since_us = (self._tilted_since_us or t_us) if tilt > CRASH_TILT_RAD else None
        if self.flew and not autopilot.armed:
            self._done_since_us = self._done_since_us or t_us
        else:
            self._done_since_us = None
        if self.outcome is not None:
            return
        if self._tilted_since_us and t_us - self._tilted_since_us >= CRASH_S * 1e6:
            self.outcome = Outcome("crashed", "the vehicle lies on its side")
        elif self._done_since_us and t_us - self._done_since_us >= SETTLE_S * 1e6:
            self.outcome = Outcome("landed", "landed and disarmed")
        elif t_us * 1e-6 >= self.max_time_s:
            self.outcome = Outcome("max_time", f"ended at {t_us * 1e-6:.0f} s, the greatest time allowed")

    def close(self) -> None:
        """Free the renderer."""
        if self.camera is not None:
            self.camera.close()
            self.camera = None


def vehicle_parameters(parameters=None) -> dict[str, float]:
    """Defaults of the parameter table, then what is given (a row's name or its MAVLink id).

    Raises:
        ValueError: no such parameter.
    """
    from noctule.params_gen import BY_PARAM, DEFAULTS

    values = dict(DEFAULTS)
    for name, value in (parameters or {}).items():
        key = name if name in values else BY_PARAM[name].name if name in BY_PARAM else None
        if key is None:
            raise ValueError(f"no parameter '{name}'")
        values[key] = float(value)
    return values
