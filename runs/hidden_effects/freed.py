"""A plant as a MuJoCo model, and everything in it that an identification of parameters can free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mcpilco.bodies import SLIDE, Chain
from mcpilco.mjcf import CorrectedModel
from mcpilco.plant import CATALOGUE, Addition, EffectInstance, Plant, Scale
from mcpilco.typing import InputError

TIMESTEP = 0.005
"""of the simulation [s]"""
ADVANCE = 2
"""timesteps by which the commands come early: the least delay and the least lag take them back"""
LEAST_LAG, MOST_DELAY = TIMESTEP, 0.15
"""of an actuator [s]"""
SMALLEST = 1e-9
"""moment of inertia that MuJoCo wants of a body that has none [kg m^2]"""
START = 0.02
"""where a parameter starts that would be on its bound, in its scale"""

JOINT = {
    "viscous_friction": lambda s: s.force / s.velocity,
    "coulomb_friction": lambda s: s.force,
    "quadratic_drag": lambda s: s.force / s.velocity**2,
    "spring": lambda s: s.force / s.position,
    "hardening_spring": lambda s: s.force / s.position**3,
    "constant_force": lambda s: s.force,
    "armature": lambda s: s.inertia,
}
BODY = {
    "body_mass": lambda s: s.mass,
    "center_of_mass": lambda s: s.length,
    "body_inertia": lambda s: s.inertia,
}
ACTUATOR = {
    "actuator_gain": lambda s: 1.0,
    "actuator_saturation": lambda s: -s.command,
    "actuator_delay": lambda s: 0.1,
    "actuator_lag": lambda s: 0.1,
}
SENSOR = {
    "sensor_offset": lambda s: s.signal,
    "sensor_scale": lambda s: 1.0,
    "sensor_delay": lambda s: 0.1,
}
"""the scale of each parameter: of one that is 1 the effect is as large as what it acts on"""
LOWEST = {"body_mass": -0.5, "center_of_mass": -0.5, "actuator_gain": -0.5, "sensor_scale": -0.5}
"""least value of a parameter that may be negative, in its scale; -1 where nothing is said"""
HIGHEST = {"actuator_saturation": 0.8, "sensor_delay": 0.6, "actuator_delay": 1.4}
"""largest value of a parameter, in its scale; 1 where nothing is said"""


@dataclass(frozen=True)
class Freed:
    """A parameter: 0 where its effect is absent."""

    effect: str
    target: str
    symbol: str
    neutral: float
    """value at which the effect changes nothing, in its unit"""
    scale: float
    """in its unit"""
    low: float
    high: float
    """bounds, in its scale"""

    @property
    def term(self) -> tuple[str, str]:
        """Effect and target."""
        return self.effect, self.target

    @property
    def name(self) -> str:
        return f"{self.effect} {self.target}"

    @property
    def start(self) -> float:
        """Off the bound, where a derivative could be 0 and the fit stall."""
        return START if self.low == 0.0 else 0.0

    def value(self, number: float) -> float:
        """The parameter in its unit."""
        number = min(max(number, self.low), self.high)  # which an optimizer misses by a rounding
        return self.neutral + self.scale * number


def everything(plant: Plant, scales: Mapping[str, Scale]) -> list[Freed]:
    """The parameters that can be freed: the effects that MJCF or a sensor's transform can say."""
    layout = plant.layout
    chosen = [
        *((name, joint) for joint in layout.joints for name in JOINT),
        *((name, body) for body in layout.bodies for name in BODY),
        *((name, actuator) for actuator in layout.actuators for name in ACTUATOR),
        *((name, state) for state in layout.states[0::2] for name in SENSOR),
    ]
    found = [
        _free(plant, name, target, scales[target])
        for name, target in chosen
        if target in CATALOGUE[name].targets(layout)
    ]
    model = nominal_model(plant)
    return [f for f in found if f.scale != 0.0 and _can_be_said(f, plant, model)]


def _free(plant: Plant, name: str, target: str, scale: Scale) -> Freed:
    symbol = CATALOGUE[name].symbols[0]
    size = (JOINT | BODY | ACTUATOR | SENSOR)[name](scale)
    neutral, low = symbol.neutral, LOWEST.get(name, -1.0)
    if name == "actuator_saturation":
        neutral, low = scale.command, 0.0
    elif name == "body_inertia":
        body = plant.chain.bodies[plant.layout.joint_of(target)]
        about = float(np.array(body.axis) @ np.array(body.inertia) @ np.array(body.axis))
        low = -0.5 * about / size
    elif symbol.low == 0.0 and neutral == 0.0:
        low = 0.0
    return Freed(name, target, symbol.name, neutral, size, low, HIGHEST.get(name, 1.0))


def _can_be_said(freed: Freed, plant: Plant, nominal: mujoco.MjSpec) -> bool:
    if freed.effect in SENSOR:
        return True
    try:
        spec_with(nominal, plant, [(freed, min(0.1, freed.high))]).compile()
    except (InputError, ValueError):
        return False
    return True


def nominal_model(plant: Plant) -> mujoco.MjSpec:
    """The plant's bodies, joints, motors and nominal effects."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.gravity = np.array(plant.chain.gravity)
    _add_bodies(spec, plant.chain)
    layout = plant.layout
    for name, drive in zip(layout.inputs, layout.drives, strict=True):
        motor = spec.add_actuator(name=name, target=layout.joints[drive])
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    model = CorrectedModel(spec, layout)
    known = {parameter.name: parameter.value for parameter in plant.parameters}
    own = [
        (base.active, [known[v] if isinstance(v, str) else v for v in base.values])
        for base in plant.base
        if base.active.effect.name in CATALOGUE
    ]
    for active, values in (*own, *plant.added):
        _require_said(model.add(_addition(active, values)))
    model.finish()
    return spec


def _add_bodies(spec: mujoco.MjSpec, chain: Chain) -> None:
    made: list[mujoco.MjsBody] = []
    for body in chain.bodies:
        parent = spec.worldbody if body.parent < 0 else made[body.parent]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ravel(body.rotation))
        new = parent.add_body(name=body.name, pos=body.origin, quat=quaternion)
        slides = body.kind == SLIDE
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        new.add_joint(name=body.joint, type=kind, axis=body.axis, armature=body.armature)
        moments, R = np.linalg.eigh(np.array(body.inertia))
        if np.linalg.det(R) < 0.0:
            R[:, 0] *= -1.0
        frame = np.empty(4)
        mujoco.mju_mat2Quat(frame, R.ravel())
        # a thin rod's are on the edge of what is physical, and a point has none
        moments[0] = max(moments[0], 1e-6 * moments[2])
        new.explicitinertial = True
        new.mass, new.ipos, new.iquat = body.mass, body.center, frame
        new.inertia = np.maximum(moments, SMALLEST)
        made.append(new)


def spec_with(
    nominal: mujoco.MjSpec, plant: Plant, freed: Sequence[tuple[Freed, float]]
) -> mujoco.MjSpec:
    """The nominal model with parameters in their scales; those of sensors are not in it.

    Raises:
        InputError: MJCF cannot say one of them.
    """
    spec = nominal.copy()
    model = CorrectedModel(spec, plant.layout)
    late: dict[str, dict[str, float]] = {"actuator_delay": {}, "actuator_lag": {}}
    for parameter, number in freed:
        value = parameter.value(number)
        if parameter.effect in late:
            late[parameter.effect][parameter.target] = value
        elif parameter.effect not in SENSOR and value != parameter.neutral:
            addition = Addition(parameter.effect, parameter.target, {parameter.symbol: value})
            _require_said(model.add(addition))
    model.finish()
    for motor, name in zip(spec.actuators, plant.layout.actuators, strict=True):
        _make_late(
            motor, late["actuator_delay"].get(name, 0.0), late["actuator_lag"].get(name, 0.0)
        )
    for x, name in enumerate(plant.layout.states):
        sensor = spec.add_sensor(name=name, objname=plant.layout.joints[x // 2])
        sensor.type = (
            mujoco.mjtSensor.mjSENS_JOINTVEL if x % 2 else mujoco.mjtSensor.mjSENS_JOINTPOS
        )
        sensor.objtype = mujoco.mjtObj.mjOBJ_JOINT
    return spec


def _make_late(motor: mujoco.MjsActuator, delay: float, lag: float) -> None:
    """Gives a motor a delay and a lag, the least where they are 0: its state keeps its size."""
    motor.delay = TIMESTEP + delay
    motor.nsample, motor.interp = round(MOST_DELAY / TIMESTEP) + 3, 1
    motor.dyntype = mujoco.mjtDyn.mjDYN_FILTER
    motor.dynprm[0] = LEAST_LAG + lag


def _addition(active: EffectInstance, values: Sequence[float]) -> Addition:
    symbols = [symbol.name for symbol in active.effect.symbols]
    return Addition(active.effect.name, active.target, dict(zip(symbols, values, strict=True)))


def _require_said(fault: str | None) -> None:
    if fault:
        raise InputError(fault)
