"""A flight controller that behaves like PX4 in offboard or ArduPilot in guided mode, without sockets and without truth.

It gets its IMU, the companion's ODOMETRY and setpoints, and commands; it gives rotor demands and says what it does. Arming
checks, modes, setpoint time-outs, failsafes, the land detector and auto-disarm follow the documents of the two
projects (docs/maths/vehicle.md, section 3, says where it is simpler). Time is that of its inertial samples.
Frame Map (forward-left-up), SI; link code turns that into NED.
"""

from __future__ import annotations

import enum
import math

from .autopilot_control import CARRY_S, Controller, Setpoint
from .autopilot_estimator import Estimator
from .vehicle import GRAVITY_M_S2, Airframe

STREAM_GAP_S = 0.5            # setpoints must come at 2 Hz or more
STREAM_WANTED_S = 1.5         # for so long before OFFBOARD is accepted
OFFBOARD_LOSS_S = 1.0         # PX4: COM_OF_LOSS_T; then it holds
RUN_OFF_M_S = 4.0             # PX4: of AUTO.LAND where a global origin was given but the heading is vision's
OFFBOARD_LAND_S = 3.0         # PX4: and lands so long after the last setpoint
GUIDED_TIMEOUT_S = 3.0        # ArduPilot: GUID_TIMEOUT
ODOMETRY_ARM_S = 0.5          # arming wants ODOMETRY younger than this
ODOMETRY_STEADY_S = 1.0       # and unbroken for this long
# Position counts as lost this long after the last ODOMETRY; until then it is flown on inertial dead reckoning and all looks healthy.
ODOMETRY_LOSS_S = {"px4": 5.0, "ardupilot": 8.0}
# ArduPilot compares its inertial sensors before it arms and refuses for this long ("Accels inconsistent").
ARM_SETTLE_S = {"px4": 0.0, "ardupilot": 25.0}
DISARM_LANDED_S = 2.0         # PX4: COM_DISARM_LAND
DISARM_IDLE_S = 10.0          # PX4: COM_DISARM_PRFLT
SPOOL_UP_S = 0.8              # rotors come up from idle over this
LAND_SPEED_M_S = 0.5
BLIND_SINK_M_S = 0.4
CLIMB_TO_START_M = 0.08       # a setpoint this far above the standing vehicle starts the take-off
BATTERY_WH = 75.0
HOVER_POWER_W = 170.0
IDLE_POWER_W = 12.0
BATTERY_FAILSAFE = 0.05


class Mode(enum.Enum):
    """What the vehicle does; the names of the two flavours are in MODE_NAMES."""

    manual = 0      # a pilot's mode that this simulator does not fly; on the ground only
    hold = 1        # stays where it is
    takeoff = 2     # climbs, then holds
    offboard = 3    # follows the companion's setpoints
    land = 4        # descends where it is (blindly without a position), then disarms


MODE_NAMES = {
    "px4": {Mode.manual: "MANUAL", Mode.hold: "AUTO.LOITER", Mode.takeoff: "AUTO.TAKEOFF", Mode.offboard: "OFFBOARD", Mode.land: "AUTO.LAND"},
    "ardupilot": {Mode.manual: "STABILIZE", Mode.hold: "LOITER", Mode.takeoff: "AUTO", Mode.offboard: "GUIDED", Mode.land: "LAND"},
}


class Landed(enum.IntEnum):
    """Values of MAV_LANDED_STATE."""

    on_ground = 1
    in_air = 2
    taking_off = 3
    landing = 4


class Severity(enum.IntEnum):
    """Values of MAV_SEVERITY that are used."""

    critical = 2
    warning = 4
    info = 6


class Autopilot:
    """One flight controller. Not thread-safe; deterministic in what it is given.

    Args:
        airframe: constants of the vehicle it controls.
        flavour: 'px4' or 'ardupilot'.

    Attributes: armed, mode, landed; estimator; battery, 0 to 1; messages, a list of (Severity, text) that the caller
    empties; rotors, the present demand (4,).
    """

    def __init__(self, airframe: Airframe, flavour: str = "px4"):
        if flavour not in MODE_NAMES:
            raise ValueError(f"autopilot flavour '{flavour}' is not one of {', '.join(MODE_NAMES)}")
        self.flavour = flavour
        self.estimator = Estimator()
        self.controller = Controller(airframe, GUIDED_TIMEOUT_S if flavour == "ardupilot" else CARRY_S)
        self.arm_settle_s = ARM_SETTLE_S[flavour]
        self.armed = False
        self.mode = Mode.hold if flavour == "px4" else Mode.manual
        self.landed = Landed.on_ground
        self.origin_given = False
        self.battery = 1.0
        self.messages: list[tuple[Severity, str]] = []
        self.rotors = [0.0, 0.0, 0.0, 0.0]
        self._setpoint: Setpoint | None = None
        self._target: Setpoint | None = None
        self._stream_since_us: int | None = None
        self._armed_us = self._lift_off_us = self._landed_us = 0
        self._supported_s = self._pressed_s = 0.0
        self._press = 1.0
        self._lost_said = False
        self._timed_out = False
        self._offboard_lost_us: int | None = None

    # ------------------------------------------------------------ what comes in

    def odometry(self, *measurement) -> bool:
        """See Estimator.odometry."""
        return self.estimator.odometry(*measurement)

    def setpoint(self, x, y, z, vx, vy, vz, yaw_rad) -> bool:
        """A position setpoint with velocity feed-forward (0 for none), frame Map. False: refused, not finite."""
        if not math.isfinite(x + y + z + vx + vy + vz + yaw_rad):
            return False
        now = self.estimator.t_us
        new = Setpoint(now, x, y, z, vx, vy, vz, yaw_rad)
        old = self._setpoint
        if old is None or (now - old.t_us) * 1e-6 > STREAM_GAP_S:
            self._stream_since_us = now
        new.follow(old)
        self._setpoint = new
        self._timed_out = False
        return True

    def stop_here(self) -> None:
        """ArduPilot, at a setpoint in a frame that it does not know: it stops on the spot."""
        if self.mode is Mode.offboard:
            self._setpoint = self._here()

    def set_mode(self, mode: Mode) -> str | None:
        """Ask for a mode. None: accepted; else why not."""
        why = self._mode_refusal(mode)
        if why:
            self._say(Severity.warning, f"Mode {self.name(mode)} denied: {why}")
            return why
        if mode is not self.mode:
            self._enter(mode)
        return None

    def arm(self) -> str | None:
        """Ask to arm. None: armed; else why not."""
        if self.armed:
            return None
        why = self._arm_refusal()
        if why:
            self._say(Severity.critical, f"Arming denied: {why}")
            return why
        self.armed = True
        self._armed_us = self.estimator.t_us
        self.landed = Landed.on_ground
        self.controller.idle()
        self._target = self._here()
        self._say(Severity.info, "Armed")
        return None

    def disarm(self, force: bool = False) -> str | None:
        """Ask to disarm. None: disarmed; else why not (in flight only with force)."""
        if self.armed and self.landed is not Landed.on_ground and not force:
            self._say(Severity.warning, "Disarming denied: not landed")
            return "not landed"
        self._stop("Disarmed" if self.armed else None)
        return None

    def takeoff(self, height_m: float) -> str | None:
        """Climb to height_m above here and hold. None: accepted; else why not."""
        if not self.armed or self.landed is not Landed.on_ground:
            return "not armed on the ground"
        self._target = self._here()
        self._target.z += height_m
        if self.flavour == "px4":
            self._enter(Mode.takeoff)
        elif self.mode is Mode.offboard:
            self._setpoint = self._target
            self._setpoint.t_us = self.estimator.t_us
        else:
            return "not in GUIDED"
        return None

    # ------------------------------------------------------------ what it is

    def name(self, mode: Mode | None = None) -> str:
        """The flavour's name of a mode, of the present one by default."""
        return MODE_NAMES[self.flavour][mode or self.mode]

    @property
    def position_known(self) -> bool:
        """The horizontal position is aided, or was a short time ago."""
        return self.estimator.odometry_age_s() < ODOMETRY_LOSS_S[self.flavour]

    @property
    def setpoint_age_s(self) -> float:
        return math.inf if self._setpoint is None else (self.estimator.t_us - self._setpoint.t_us) * 1e-6

    # ------------------------------------------------------------ one inertial sample

    def imu(self, t_us: int, dt_s: float, ax, ay, az, gx, gy, gz) -> list[float]:
        """Advance to t_us with one inertial sample, mean over dt_s, frame Body. Returns the rotor demands (4,)."""
        e = self.estimator
        at_rest = self.landed is Landed.on_ground
        e.predict(t_us, dt_s, ax, ay, az, gx, gy, gz, at_rest)
        power = IDLE_POWER_W
        if self.armed:
            self._failsafes()
            self._fly(dt_s)
            power += HOVER_POWER_W * max(0.0, self.controller.lift) ** 1.5
        self.battery = max(0.0, self.battery - power * dt_s / 3600.0 / BATTERY_WH)
        return self.rotors

    def _fly(self, dt_s: float) -> None:
        target, blind = self._wanted(dt_s)
        e, c = self.estimator, self.controller
        now = e.t_us
        if self.landed is Landed.on_ground:
            climbs = self.mode in (Mode.offboard, Mode.takeoff, Mode.hold) and not blind and (
                target.z - e.z > CLIMB_TO_START_M or target.vz > 0.1)
            if climbs and (now - self._armed_us) * 1e-6 > 0.5:
                self.landed = Landed.taking_off
                self._lift_off_us = now
                c.relax()
                self._supported_s, self._press = 0.0, 2.0
                self._say(Severity.info, "Takeoff detected")
            else:
                c.idle()
                self.rotors = c.rotors
                reference = self._landed_us if self._landed_us > self._armed_us else self._armed_us
                wait = DISARM_LANDED_S if self._landed_us > self._armed_us else DISARM_IDLE_S
                if (now - reference) * 1e-6 > wait:
                    self._stop("Disarmed by landing" if wait == DISARM_LANDED_S else "Disarmed: no take-off")
                return
        since = (now - self._lift_off_us) * 1e-6
        lift_max = 2.0
        if since < SPOOL_UP_S:
            lift_max = 1.4 * since / SPOOL_UP_S
        elif self.landed is Landed.taking_off and since > 2.0:
            self.landed = Landed.in_air
        if self.mode is Mode.land and self.landed is Landed.in_air:
            self.landed = Landed.landing
        elif self.mode is not Mode.land and self.landed is Landed.landing:
            self.landed = Landed.in_air
        if since > 2.0:
            lift_max = min(lift_max, self._touch_down(dt_s))
            if self.landed is Landed.on_ground:
                c.idle()
                self.rotors = c.rotors
                return
        self.rotors = c.step(e, target, dt_s, blind, lift_max)

    def _touch_down(self, dt_s: float) -> float:
        """The land detector. Returns the greatest lift: it is let down while a wanted descent does not happen.

        Landed: little lift is asked for, and yet the accelerometer feels the whole weight, for 0.7 s.
        """
        c, e = self.controller, self.estimator
        down = c.climb_wanted_m_s
        held_up = down < -0.06 and e.vz > 0.35 * down
        self._pressed_s = self._pressed_s + dt_s if held_up else 0.0
        if self._pressed_s > 0.4:
            self._press = max(0.1, min(self._press, 1.05) - 0.9 * dt_s)
        elif not held_up and c.climb_wanted_m_s > -0.03:
            self._press = 2.0
        elif e.vz < 0.6 * down:
            self._press = min(2.0, self._press + 2.0 * dt_s)
        supported = c.lift < 0.6 and e.force_z > 0.85 * GRAVITY_M_S2
        self._supported_s = self._supported_s + dt_s if supported else 0.0
        if self._supported_s > 0.7:
            self.landed = Landed.on_ground
            self._landed_us = e.t_us
            self._say(Severity.info, "Landing detected")
        return self._press

    def _wanted(self, dt_s: float) -> tuple[Setpoint, bool]:
        """The setpoint to fly now, and whether the position is unknown."""
        blind = not self.position_known
        if self.mode is Mode.offboard and self._setpoint is not None and not self._timed_out and not blind:
            return self._setpoint, False
        if self._target is None:
            self._target = self._here()
        target = self._target
        target.t_us = self.estimator.t_us
        if self.mode is Mode.land:
            target.vz = -BLIND_SINK_M_S if blind else -LAND_SPEED_M_S
            if self.origin_given and self.flavour == "px4":    # it heads for 0 N 0 E: its position counts as global and is none
                target.vx = max(-RUN_OFF_M_S, target.vx - RUN_OFF_M_S * dt_s)
                target.x += target.vx * dt_s
            target.z = max(target.z + target.vz * dt_s, self.estimator.z - 0.6)
        return target, blind

    def _here(self) -> Setpoint:
        e = self.estimator
        return Setpoint(e.t_us, e.x, e.y, e.z, 0.0, 0.0, 0.0, e.yaw_rad)

    # ------------------------------------------------------------ checks and failsafes

    def _stream_refusal(self) -> str | None:
        now = self.estimator.t_us
        if self._setpoint is None or self.setpoint_age_s > STREAM_GAP_S:
            return "no setpoints"
        if (now - self._stream_since_us) * 1e-6 < STREAM_WANTED_S:
            return "setpoints must flow first"
        return None

    def _mode_refusal(self, mode: Mode) -> str | None:
        if mode is Mode.manual:
            return "in flight there is no pilot" if self.landed is not Landed.on_ground else None
        if mode is Mode.takeoff:
            return "use the take-off command"
        if mode in (Mode.offboard, Mode.hold) and not self.position_known and (mode is Mode.offboard or self.armed):
            return "no position estimate"
        if mode is Mode.offboard and self.flavour == "px4":
            return self._stream_refusal()
        return None

    def _arm_refusal(self) -> str | None:
        e = self.estimator
        if e.odometry_age_s() > ODOMETRY_ARM_S:
            return "no external position (ODOMETRY is missing or its quality is negative)"
        if e.steady_s() < ODOMETRY_STEADY_S:
            return "position estimate not yet steady"
        if e.t_us * 1e-6 < self.arm_settle_s:
            return "PreArm: Accels inconsistent"
        if 1.0 - 2.0 * (e.qx * e.qx + e.qy * e.qy) < 0.94:
            return "not level"
        if self.battery < 0.15:
            return "battery low"
        if self.mode is Mode.manual:
            return f"mode {self.name()} needs a pilot's sticks"
        if self.mode is Mode.offboard and self.flavour == "px4" and self._stream_refusal():
            return self._stream_refusal()
        return None

    def _failsafes(self) -> None:
        flying = self.landed is not Landed.on_ground
        age = self.estimator.odometry_age_s()
        if age > ODOMETRY_LOSS_S[self.flavour]:
            if not self._lost_said:
                self._lost_said = True
                cause = "EKF variance" if self.flavour == "ardupilot" else "position lost"
                self._say(Severity.critical, f"Failsafe: {cause}, no ODOMETRY for {age:.1f} s")
                if self.mode is not Mode.land:
                    self._enter(Mode.land)
        elif age < 0.5:
            self._lost_said = False
        if self.mode is Mode.offboard and self._setpoint is not None and not self._timed_out:
            if self.flavour == "px4" and self.setpoint_age_s > OFFBOARD_LOSS_S:
                self._say(Severity.critical, "Failsafe: offboard control lost")
                self._enter(Mode.hold)
                self._offboard_lost_us = self._setpoint.t_us
            elif self.flavour == "ardupilot" and self.setpoint_age_s > GUIDED_TIMEOUT_S and flying:
                v = self._setpoint
                if v.vx or v.vy or v.vz:  # position-only targets never time out there
                    self._timed_out = True
                    self._target = self._here()
                    self._say(Severity.warning, "Guided: target timed out, stopping")
        if self._offboard_lost_us is not None and self.mode is Mode.hold and (
                (self.estimator.t_us - self._offboard_lost_us) * 1e-6 > OFFBOARD_LAND_S):
            self._enter(Mode.land)
        if flying and self.battery < BATTERY_FAILSAFE and self.mode is not Mode.land:
            self._say(Severity.critical, "Failsafe: battery, landing")
            self._enter(Mode.land)

    def _enter(self, mode: Mode) -> None:
        if mode is not Mode.takeoff:
            self._target = self._here()
        self.mode = mode
        self._timed_out = False
        self._offboard_lost_us = None
        self._say(Severity.info, f"Mode {self.name()}")

    def _stop(self, text: str | None) -> None:
        self.armed = False
        self.controller.stop()
        self.rotors = self.controller.rotors
        self.landed = Landed.on_ground
        if self.mode in (Mode.land, Mode.takeoff):
            self.mode = Mode.hold if self.flavour == "px4" else Mode.land
        if text:
            self._say(Severity.info, text)

    def _say(self, severity: Severity, text: str) -> None:
        self.messages.append((severity, text))
