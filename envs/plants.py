"""The plants that envs simulate, and the one place where plants and their envs are registered."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import gymnasium

from mcpilco.bodies import HINGE, SLIDE, Body, Chain
from mcpilco.plant import (
    CATALOGUE,
    Base,
    ChainPlant,
    EffectInstance,
    Layout,
    Parameter,
    Plant,
    register_plant,
)
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from envs.swing_up_env import SwingUpEnv
    from mcpilco.mjcf import Physics

ALONG, ABOUT = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
"""axes: to the right; such that a hanging pole's tip moves to the right as its angle grows"""
MIDDLE, UNIFORM = 0.5, 1.0 / 12.0
"""center of mass of a uniform rod, relative to its length l, and inertia about it, to m l^2"""
VISCOUS, GAIN = CATALOGUE["viscous_friction"], CATALOGUE["actuator_gain"]


def cart_pole() -> ChainPlant:
    """A cart on a rail, a uniform pole hinged to it, and a horizontal force on the cart.

    Reference: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010),
        appendix C.2, the cart-pole of the PILCO package.
    """

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
    return ChainPlant(
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


def pendulum() -> ChainPlant:
    """A mass on a rod without weight, and a motor in its hinge."""

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
    return ChainPlant(
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


def double_pendulum() -> ChainPlant:
    """Two rods, a motor in each hinge; the second angle is relative to the first rod.

    They are uniform, unless their centers of mass and inertias are set: `upper_center` is relative
    to the rod's length l, `upper_inertia`, about the center, to its m l^2.
    """
    gains = {"shoulder_torque": "shoulder_gain", "elbow_torque": "elbow_gain"}
    return _two_rods("mcpilco/DoublePendulum-v0", ("shoulder_torque", "elbow_torque"), gains)


def pendubot() -> ChainPlant:
    """A double pendulum with a motor in its shoulder; the elbow is free.

    Reference: Spong and Block, The Pendubot, CDC 1995.
    """
    return _with_one_motor("mcpilco/Pendubot-v0", "shoulder_torque")


def acrobot() -> ChainPlant:
    """A double pendulum with a motor in its elbow; the shoulder is free."""
    return _with_one_motor("mcpilco/Acrobot-v0", "elbow_torque")


def _with_one_motor(name: str, torque: str) -> ChainPlant:
    """The DFKI's double pendulum, design C.1, with the numbers of its authors, rounded.

    The elbow's motor sits at the end of the upper link.

    Reference: models 1.0 and 1.1 of github dfki-ric-underactuated-lab/double_pendulum.
    """
    return _two_rods(name, (torque,), {"actuator": "torque_gain"}).where(
        upper_mass=0.523,
        upper_length=0.2,
        lower_mass=0.626,
        lower_length=0.3,
        shoulder_friction=0.001,
        elbow_friction=0.001,
        gravity=9.81,
        upper_center=1.0,
        upper_inertia=0.523,
        lower_center=0.852,
        lower_inertia=0.177,
    )


def _two_rods(name: str, inputs: tuple[str, ...], gains: Mapping[str, str]) -> ChainPlant:
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
    return ChainPlant(
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


MODELS = (".xml", ".urdf")
"""ends of names of files that MuJoCo loads"""
PLANTS: dict[str, Callable[[], Plant]] = {}
"""nominal plants by name: the ids of their envs, where they have one"""


def register(
    name: str,
    plant: Callable[[], Plant],
    env: str | type[SwingUpEnv] | None = None,
    *,
    steps: int | None = None,
) -> None:
    """Makes a plant known to `gap` and to priors, and its env to Gymnasium, by one name.

    Args:
        name: of the plant, as `Plant.name` has it; with an env, its id: "my/Robot-v0".
        plant: returns the nominal plant.
        env: what simulates it in episodes, as a class or its "module:Class"; None: nothing does.
        steps: after which an episode is truncated; None: never.

    Raises:
        InputError: the plant has another name.
    """
    if plant().name != name:
        raise InputError(
            f"The plant must be named {name!r}, as it is registered, got {plant().name!r}."
        )
    PLANTS[name] = plant
    register_plant(name, plant)
    if env is not None:
        register_env(name, env, steps=steps)


def plant_named(
    option: str,
    name: str,
    *,
    simulated: bool = False,
    physics: Physics = "auto",
    keyframe: str = "",
) -> Plant:
    """The plant that a user names: registered, or of a model file; of `module:Id` that of the id.

    `option` is where the user named it, for the error; where it must be `simulated`, an env does
    so, which none does with a file. The others are those of `mcpilco.mjcf.read_plant`.

    Raises:
        InputError: there is no such plant, as its module was not imported, or no env simulates it.
    """
    if name.endswith(MODELS) and not simulated:
        from mcpilco.mjcf import read_plant

        return read_plant(name, physics, keyframe)
    last = name.rpartition(":")[2]
    fitting = [known for known in PLANTS if not simulated or known in gymnasium.registry]
    if last not in fitting:
        more = "" if simulated else "an MJCF or URDF file, "
        raise InputError(
            f"{option} must be one of {', '.join(fitting)}, {more}or module:Id of a module that "
            f"registers its own with envs.register, got {name!r}."
        )
    return PLANTS[last]()


def register_env(
    name: str, env: str | type[SwingUpEnv], *, steps: int | None = None, **keywords: Any
) -> None:
    """Makes an env known to Gymnasium, also as a vector env, with some keywords set."""
    gymnasium.register(
        id=name,
        entry_point=env,  # type: ignore[arg-type]  # a class makes envs too
        vector_entry_point=partial(_make_batch, env),
        max_episode_steps=steps,
        kwargs=keywords,
    )


def _make_batch(*arguments: Any, **keywords: Any) -> Any:
    from envs.swing_up_env import make_batch

    return make_batch(*arguments, **keywords)


register("mcpilco/CartPoleSwingUp-v0", cart_pole, "envs.cartpole:CartPoleSwingUpEnv", steps=30)
register("mcpilco/Pendulum-v0", pendulum, "envs.pendulum:PendulumEnv", steps=40)
register("mcpilco/DoublePendulum-v0", double_pendulum)
register("mcpilco/Pendubot-v0", pendubot, "envs.double_pendulum:PendubotEnv", steps=50)
register("mcpilco/Acrobot-v0", acrobot, "envs.double_pendulum:AcrobotEnv", steps=50)
BOARD = {
    "upper_mass": 0.52346023,
    "lower_mass": 0.62556772,
    "upper_inertia": 0.52290459,
    "lower_center": 0.85231018,
    "lower_inertia": 0.17709948,
    **dict.fromkeys(("shoulder_friction", "elbow_friction"), 0.0),
}
"""parameters in the simulations of the RealAIGym boards: design C.1, model 1.0, no friction"""
for _robot in ("Pendubot", "Acrobot"):
    _board = {"dt": 0.02, "start_std": 1e-3, "noise_std": 0.0, **BOARD}
    _env = f"envs.double_pendulum:{_robot}Env"
    register_env(f"mcpilco/Board{_robot}-v0", _env, steps=500, **_board)
register_env(
    "mcpilco/CartPoleSwingUpPositions-v0",
    "envs.cartpole:CartPoleSwingUpEnv",
    steps=30,
    measured="positions",
)
# named only, so that MuJoCo is loaded where it is used
register_env("mcpilco/Model-v0", "envs.model:ModelEnv")
register_env(
    "mcpilco/MujocoCartPoleSwingUp-v0", "envs.mujoco_cartpole:MujocoCartPoleSwingUpEnv", steps=30
)
