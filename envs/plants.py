"""The equations of the envs as plants, whose missing effects can be found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from envs.double_pendulum_dynamics import (
    AcrobotDynamics,
    DoublePendulumDynamics,
    PendubotDynamics,
)
from mcpilco.bodies import HINGE, SLIDE, Body, Chain
from mcpilco.plant import CATALOGUE, Base, EffectInstance, Layout, Parameter, Plant, known_plants

ALONG, ABOUT = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
"""axes: to the right; such that a hanging pole's tip moves to the right as its angle grows"""
MIDDLE, UNIFORM = 0.5, 1.0 / 12.0
"""center of mass of a uniform rod, relative to its length l, and inertia about it, to m l^2"""
VISCOUS, GAIN = CATALOGUE["viscous_friction"], CATALOGUE["actuator_gain"]


def cart_pole() -> Plant:
    """The cart-pole of `envs.cartpole_dynamics`."""

    def build(p: Mapping[str, float]) -> Chain:
        cart = Body(name="cart", joint="cart", kind=SLIDE, axis=ALONG, mass=p["cart_mass"])
        pole = rod("pole", 0, p["pole_mass"], p["pole_length"])
        return Chain((cart, pole), (0.0, 0.0, -p["gravity"]))

    layout = Layout(
        joints=("cart", "pole"),
        slides=(True, False),
        bodies=("cart", "pole"),
        states=("cart_position", "cart_velocity", "pole_angle", "pole_velocity"),
        inputs=("force",),
        drives=(0,),
    )
    return Plant(
        name="mcpilco/CartPoleSwingUp-v0",
        layout=layout,
        parameters=(
            Parameter("cart_mass", 0.5, "kg", low=1e-6),
            Parameter("pole_mass", 0.5, "kg", low=1e-6),
            Parameter("pole_length", 0.5, "m", low=1e-6),
            Parameter("cart_friction", 0.1, "N s/m"),
            Parameter("force_gain", 1.0, "-"),
            Parameter("gravity", 9.82, "m/s^2", uncertain=False),
        ),
        build=build,
        base=(
            Base(EffectInstance(VISCOUS, "cart"), ("cart_friction",)),
            Base(EffectInstance(GAIN, "actuator"), ("force_gain",)),
        ),
        angles=(2,),
        masses={"cart": "cart_mass", "pole": "pole_mass"},
    )


def pendulum() -> Plant:
    """The pendulum of `envs.pendulum_dynamics`: m l^2 q'' = tau - b q' - m g l sin q."""

    def build(p: Mapping[str, float]) -> Chain:
        body = Body(
            name="pendulum",
            joint="pendulum",
            kind=HINGE,
            axis=ABOUT,
            mass=p["mass"],
            center=(0.0, 0.0, -p["length"]),
        )
        return Chain((body,), (0.0, 0.0, -p["gravity"]))

    layout = Layout(
        joints=("pendulum",),
        slides=(False,),
        bodies=("pendulum",),
        states=("angle", "velocity"),
        inputs=("torque",),
        drives=(0,),
    )
    return Plant(
        name="mcpilco/Pendulum-v0",
        layout=layout,
        parameters=(
            Parameter("mass", 0.6, "kg", low=1e-6),
            Parameter("length", 0.5, "m", low=1e-6),
            Parameter("friction", 0.05, "N m s/rad"),
            Parameter("torque_gain", 1.0, "-"),
            Parameter("gravity", 9.82, "m/s^2", uncertain=False),
        ),
        build=build,
        base=(
            Base(EffectInstance(VISCOUS, "pendulum"), ("friction",)),
            Base(EffectInstance(GAIN, "actuator"), ("torque_gain",)),
        ),
        angles=(0,),
        masses={"pendulum": "mass"},
    )


def double_pendulum() -> Plant:
    """Two rods, a motor in each hinge; the second angle is relative to the first rod.

    They are uniform, unless their centers of mass and inertias are set: `upper_center` is relative
    to the rod's length l, `upper_inertia`, about the center, to its m l^2.
    """
    gains = {"shoulder_torque": "shoulder_gain", "elbow_torque": "elbow_gain"}
    return _two_rods("mcpilco/DoublePendulum-v0", ("shoulder_torque", "elbow_torque"), gains)


def pendubot() -> Plant:
    """The double pendulum of `envs.double_pendulum_dynamics` with a motor in its shoulder."""
    return _with_one_motor("mcpilco/Pendubot-v0", PendubotDynamics())


def acrobot() -> Plant:
    """The double pendulum of `envs.double_pendulum_dynamics` with a motor in its elbow."""
    return _with_one_motor("mcpilco/Acrobot-v0", AcrobotDynamics())


def _with_one_motor(name: str, dynamics: DoublePendulumDynamics) -> Plant:
    plant = _two_rods(name, (dynamics.input_name,), {"actuator": "torque_gain"})
    return plant.where(**asdict(dynamics))


def _two_rods(name: str, inputs: tuple[str, ...], gains: Mapping[str, str]) -> Plant:
    """Two rods behind their actuators, each with the parameter that is its gain."""
    motors = {"shoulder_torque": 0, "elbow_torque": 1}

    def build(p: Mapping[str, float]) -> Chain:
        def link(name: str, parent: int, joint: str, below: float = 0.0) -> Body:
            mass, length, center, inertia = (
                p[f"{name}_{what}"] for what in ("mass", "length", "center", "inertia")
            )
            return rod(name, parent, mass, length, (0.0, 0.0, -below), joint, center, inertia)

        upper, lower = link("upper", -1, "shoulder"), link("lower", 0, "elbow", p["upper_length"])
        return Chain((upper, lower), (0.0, 0.0, -p["gravity"]))

    layout = Layout(
        joints=("shoulder", "elbow"),
        slides=(False, False),
        bodies=("upper", "lower"),
        states=("shoulder_angle", "shoulder_velocity", "elbow_angle", "elbow_velocity"),
        inputs=inputs,
        drives=tuple(motors[torque] for torque in inputs),
    )
    return Plant(
        name=name,
        layout=layout,
        parameters=(
            Parameter("upper_mass", 0.6, "kg", low=1e-6),
            Parameter("upper_length", 0.3, "m", low=1e-6),
            Parameter("lower_mass", 0.4, "kg", low=1e-6),
            Parameter("lower_length", 0.3, "m", low=1e-6),
            Parameter("shoulder_friction", 0.01, "N m s/rad"),
            Parameter("elbow_friction", 0.01, "N m s/rad"),
            *(Parameter(gain, 1.0, "-") for gain in gains.values()),
            Parameter("gravity", 9.82, "m/s^2", uncertain=False),
            Parameter("upper_center", MIDDLE, "-", uncertain=False, low=1e-6),
            Parameter("upper_inertia", UNIFORM, "-", uncertain=False, low=1e-6),
            Parameter("lower_center", MIDDLE, "-", uncertain=False, low=1e-6),
            Parameter("lower_inertia", UNIFORM, "-", uncertain=False, low=1e-6),
        ),
        build=build,
        base=(
            Base(EffectInstance(VISCOUS, "shoulder"), ("shoulder_friction",)),
            Base(EffectInstance(VISCOUS, "elbow"), ("elbow_friction",)),
            *(Base(EffectInstance(GAIN, actuator), (gain,)) for actuator, gain in gains.items()),
        ),
        angles=(0, 2),
        masses={"upper": "upper_mass", "lower": "lower_mass"},
    )


def rod(
    name: str,
    parent: int,
    mass: float,
    length: float,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    joint: str | None = None,
    center: float = MIDDLE,
    inertia: float = UNIFORM,
) -> Body:
    """A rod that hangs from its hinge; center and inertia are relative to l and m l^2."""
    across = inertia * mass * length**2
    return Body(
        name=name,
        joint=joint or name,
        kind=HINGE,
        axis=ABOUT,
        mass=mass,
        parent=parent,
        origin=origin,
        center=(0.0, 0.0, -center * length),
        inertia=((across, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, 0.0)),
    )


PLANTS = {
    "mcpilco/CartPoleSwingUp-v0": cart_pole,
    "mcpilco/Pendulum-v0": pendulum,
    "mcpilco/DoublePendulum-v0": double_pendulum,
    "mcpilco/Pendubot-v0": pendubot,
    "mcpilco/Acrobot-v0": acrobot,
}
"""by the id of their env"""

for _name, _make in PLANTS.items():
    known_plants.register(_name, _make)
