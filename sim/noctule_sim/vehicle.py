"""The quadrotor: its constants, rotors with lag, thrust and drag, and the MuJoCo model of it standing in a world.

Frame Body: x forward, y left, z up, origin at the centre of mass and of the hull. Model: docs/maths/vehicle.md.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field

import mujoco
import numpy as np

from .world import World

GRAVITY_M_S2 = 9.81
PHYSICS_STEP_S = 0.002
FLOOR_FRICTION = 0.8
SETTLING_STEPS = 500  # before the flight begins


@dataclass(frozen=True)
class Airframe:
    """Constants of the vehicle. The hull and the landing gear come from the parameter table."""

    hull_radius_m: float = 0.30
    hull_height_m: float = 0.20
    rest_height_m: float = 0.12          # Body origin over the floor when it stands on its legs
    mass_kg: float = 1.50
    inertia_kg_m2: tuple[float, float, float] = (0.019, 0.019, 0.034)
    rotor_offset_m: float = 0.14         # of each rotor along x and along y
    rotor_height_m: float = 0.03
    rotor_thrust_max_n: float = 7.5
    rotor_speed_max_rad_s: float = 1100.0
    rotor_torque_per_thrust_m: float = 0.016
    motor_lag_s: float = 0.030
    rotor_drag_n_s2_m_rad: float = 9.0e-5   # force along the disc per rotor speed and air speed
    body_drag_n_s2_m2: float = 0.030        # force per square of the air speed

    # Rotor order: front left, front right, rear right, rear left; torque sign about Body z of each.
    rotor_x: tuple[int, ...] = field(default=(1, 1, -1, -1))
    rotor_y: tuple[int, ...] = field(default=(1, -1, -1, 1))
    rotor_torque: tuple[int, ...] = field(default=(1, -1, 1, -1))

    @property
    def hover_share(self) -> float:
        """Hover thrust as a share of the greatest thrust."""
        return self.mass_kg * GRAVITY_M_S2 / (4.0 * self.rotor_thrust_max_n)


class Vehicle:
    """The vehicle in its world. Truth: nothing of it reaches the autopilot except through the sensors.

    Args:
        world: the building.
        airframe: constants.
        step_s: of the physics.
    """

    def __init__(self, world: World, airframe: Airframe, step_s: float = PHYSICS_STEP_S):
        self.airframe = airframe
        self.step_s = step_s
        self.model = mujoco.MjModel.from_xml_string(model_xml(world, airframe, step_s), model_files(world))
        self.data = mujoco.MjData(self.model)
        s = world.start
        self.data.qpos[:] = (s.x_m, s.y_m, s.z_m + airframe.rest_height_m, math.cos(s.yaw_rad / 2), 0.0, 0.0, math.sin(s.yaw_rad / 2))
        # At rest on the floor, not just over it: a vehicle that still falls has no weight, and an autopilot that looks then takes any
        # direction for down.
        mujoco.mj_step(self.model, self.data, SETTLING_STEPS)
        self.data.qvel[:] = 0.0
        self.data.time = 0.0
        mujoco.mj_forward(self.model, self.data)
        self.rotor_speed_rad_s = [0.0, 0.0, 0.0, 0.0]
        self._hull = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_GEOM, "hull")
        self._slab = [int(g) for g in range(self.model.ngeom)
                      if (mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_GEOM, g) or "").startswith("slab")]
        self._slab_set = frozenset(self._slab)
        self._lag = {}
        # Views that MuJoCo updates in place.
        self._qpos, self._qvel, self._ctrl = self.data.qpos, self.data.qvel, self.data.ctrl
        self.position_m = self._qpos[0:3].tolist()
        self.attitude = self._qpos[3:7].tolist()
        self.velocity_m_s = self._qvel[0:3].tolist()

    def advance(self, steps: int, demand) -> tuple:
        """Physics over `steps` steps with constant rotor demands; what an ideal IMU in the Body origin averages over them.

        Args:
            steps: number of physics steps.
            demand: (4,) thrust demand of each rotor as a share of its greatest thrust, 0 to 1.

        Returns:
            ax, ay, az, wx, wy, wz: mean specific force [m/s^2] and mean angular rate [rad/s], frame Body.

        Source: docs/maths/vehicle.md, equations (1) to (6).
        """
        a = self.airframe
        keep = self._lag.get(steps)
        if keep is None:
            keep = self._lag[steps] = math.exp(-steps * self.step_s / a.motor_lag_s)
        speed = self.rotor_speed_rad_s
        top = a.rotor_speed_max_rad_s
        k = a.rotor_thrust_max_n / (top * top)
        total = 0.0
        thrust = []
        for i in range(4):
            u = demand[i]
            wanted = top * math.sqrt(u) if u > 0.0 else 0.0
            before = speed[i]
            after = wanted + (before - wanted) * keep
            speed[i] = after
            mean = 0.5 * (before + after)
            total += mean
            thrust.append(k * mean * mean)
        vx, vy, vz = self.velocity_m_s
        w, x, y, z = self.attitude
        r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        r10, r11, r12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        r20, r21, r22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        bx, by, bz = r00 * vx + r10 * vy + r20 * vz, r01 * vx + r11 * vy + r21 * vz, r02 * vx + r12 * vy + r22 * vz
        parasitic = a.body_drag_n_s2_m2 * math.sqrt(vx * vx + vy * vy + vz * vz)
        along = a.rotor_drag_n_s2_m_rad * total + parasitic
        self._ctrl[:] = (*thrust, -along * bx, -along * by, -parasitic * bz)
        mujoco.mj_step(self.model, self.data, steps)
        self.position_m = self._qpos[0:3].tolist()
        q = self._qpos[3:7].tolist()
        v = self._qvel[0:3].tolist()
        span = steps * self.step_s
        # Mean rate: the rotation from the old attitude to the new one, equation (5).
        w1, x1, y1, z1 = q
        dw = w * w1 + x * x1 + y * y1 + z * z1
        dx = w * x1 - x * w1 - y * z1 + z * y1
        dy = w * y1 + x * z1 - y * w1 - z * x1
        dz = w * z1 - x * y1 + y * x1 - z * w1
        if dw < 0.0:
            dw, dx, dy, dz = -dw, -dx, -dy, -dz
        sine = math.sqrt(dx * dx + dy * dy + dz * dz)
        scale = (2.0 * math.atan2(sine, dw) / sine if sine > 1e-12 else 2.0) / span
        # Mean specific force: change of velocity less gravity, in the attitude half way, equation (6).
        ax, ay, az = (v[0] - vx) / span, (v[1] - vy) / span, (v[2] - vz) / span + GRAVITY_M_S2
        fx, fy, fz = r00 * ax + r10 * ay + r20 * az, r01 * ax + r11 * ay + r21 * az, r02 * ax + r12 * ay + r22 * az
        hx, hy, hz = 0.5 * scale * span * dx, 0.5 * scale * span * dy, 0.5 * scale * span * dz
        fx, fy, fz = fx - (hy * fz - hz * fy), fy - (hz * fx - hx * fz), fz - (hx * fy - hy * fx)
        self.attitude, self.velocity_m_s = q, v
        return fx, fy, fz, scale * dx, scale * dy, scale * dz

    def touching(self) -> set[int]:
        """Geoms of the world that the vehicle touches now, other than legs on a slab. Empty: none."""
        data = self.data
        if data.ncon == 0:
            return set()
        found = set()
        for g1, g2 in data.contact.geom.tolist():
            ours, other = (g1, g2) if self.model.geom_bodyid[g1] != 0 else (g2, g1)
            if ours == self._hull or other not in self._slab_set:
                found.add(other)
        return found

    def euler_rad(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of Body in World, Z-Y-X."""
        return quaternion_to_euler(*self.attitude)


def quaternion_to_euler(w, x, y, z) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad], Z-Y-X, of a unit quaternion.

    >>> quaternion_to_euler(1.0, 0.0, 0.0, 0.0)
    (0.0, 0.0, 0.0)
    """
    s = 2.0 * (w * y - z * x)
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, s))),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


# ---------------------------------------------------------------- MuJoCo model


def _numbers(values) -> str:
    return " ".join(f"{v:.9g}" for v in values)


def model_xml(world: World, airframe: Airframe, step_s: float = PHYSICS_STEP_S) -> str:
    """MJCF text: the world's primitives as fixed geoms, the vehicle as one free body with four rotors and a camera.

    Geoms of the world are in group 0, those of the vehicle in group 3 (its own camera does not show them).
    """
    assets, geoms, lights = [], [], []
    marks = {
        "none": 'builtin="flat"',
        "checker": 'builtin="checker"',
        "gradient": 'builtin="gradient"',
        "speckle": 'builtin="flat" mark="random" random="0.06"',
    }
    for m in world.materials.values():
        r, g, b, alpha = m.rgba
        if m.texture == "none":
            assets.append(f'<material name="{_quoted(m.name)}" rgba="{_numbers(m.rgba)}" specular="0.1" shininess="0.2"/>')
            continue
        if m.texture == "picture":
            assets.append(f'<texture name="{_quoted(m.name)}" type="cube" file="{_picture_file(m)}"/>')
            assets.append(f'<material name="{_quoted(m.name)}" texture="{_quoted(m.name)}" rgba="1 1 1 {alpha:.9g}" specular="0.1" shininess="0.2"/>')
            continue
        darker = _numbers((0.62 * r, 0.62 * g, 0.62 * b))
        assets.append(f'<texture name="{_quoted(m.name)}" type="cube" {marks[m.texture]} rgb1="{_numbers((r, g, b))}" rgb2="{darker}" '
                      f'markrgb="{darker}" width="128" height="128"/>')
        assets.append(f'<material name="{_quoted(m.name)}" texture="{_quoted(m.name)}" rgba="1 1 1 {alpha:.9g}" specular="0.1" shininess="0.2"/>')
    for i, p in enumerate(world.primitives()):
        size = p.half_extent_m if p.kind == "box" else (p.half_extent_m[0], p.half_extent_m[2])
        half = p.yaw_rad / 2
        geoms.append(f'<geom name="{p.tag}{i}" type="{p.kind}" size="{_numbers(size)}" pos="{_numbers(p.centre_m)}" '
                     f'quat="{_numbers((math.cos(half), 0, 0, math.sin(half)))}" material="{_quoted(p.material)}" '
                     f'contype="1" conaffinity="2" friction="{FLOOR_FRICTION} 0.005 0.0001"/>')
    for x, y, z in world.lights:
        lights.append(f'<light pos="{_numbers((x, y, z))}" dir="0 0 -1" cutoff="90" exponent="1" castshadow="false" diffuse="0.35 0.35 0.35" specular="0.1 0.1 0.1"/>')
    a = airframe
    legs = "".join(
        f'<geom type="sphere" size="0.012" pos="{_numbers((0.14 * sx, 0.14 * sy, 0.012 - a.rest_height_m))}" group="3" contype="2" conaffinity="1"/>'
        for sx, sy in ((1, 1), (1, -1), (-1, -1), (-1, 1))
    )
    rotors = "".join(
        f'<site name="rotor{i}" pos="{_numbers((a.rotor_offset_m * a.rotor_x[i], a.rotor_offset_m * a.rotor_y[i], a.rotor_height_m))}"/>'
        for i in range(4)
    )
    motors = "".join(f'<general site="rotor{i}" gear="0 0 1 0 0 {a.rotor_torque[i] * a.rotor_torque_per_thrust_m:.9g}"/>' for i in range(4))
    drag = "".join(f'<general site="centre" gear="{axis} 0 0 0"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    return f"""<mujoco model="noctule">
<option timestep="{step_s}" gravity="0 0 {-GRAVITY_M_S2}" integrator="Euler"/>
<size memory="8M"/>
<visual>
  <global offwidth="320" offheight="240"/><quality offsamples="0" shadowsize="0"/><map znear="0.01" zfar="60"/>
  <headlight ambient="0.45 0.45 0.45" diffuse="0.25 0.25 0.25" specular="0 0 0"/>
</visual>
<asset>{''.join(assets)}</asset>
<worldbody>{''.join(lights)}{''.join(geoms)}
<body name="vehicle"><freejoint/>
  <inertial pos="0 0 0" mass="{a.mass_kg}" diaginertia="{_numbers(a.inertia_kg_m2)}"/>
  <geom name="hull" type="cylinder" size="{_numbers((a.hull_radius_m, a.hull_height_m / 2))}" group="3" contype="2" conaffinity="1"/>
  {legs}{rotors}<site name="centre" pos="0 0 0"/>
  <camera name="front" pos="0.12 0 0.03" xyaxes="0 -1 0 0 0 1" fovy="54"/>
</body></worldbody>
<actuator>{motors}{drag}</actuator>
</mujoco>"""


def _picture_file(material) -> str:
    """Name of a picture's file inside the model: characters that need no quoting."""
    return f"{zlib.crc32(material.name.encode()):08x}.png"


def model_files(world: World) -> dict[str, bytes]:
    """The files that model_xml names: pictures of materials."""
    from .pictures import png

    return {_picture_file(m): png(m.name, m.rgba[:3]) for m in world.materials.values() if m.texture == "picture"}


def _quoted(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
