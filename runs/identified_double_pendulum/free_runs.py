"""Parameters by output errors: those whose free runs meet the measured angles.

Where a motion repeats itself, gravity and inertia move together and the regression of the torques
cannot part them. Free runs over windows of a second, each from a start of its own, feel what the
regression's accelerations blur.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from envs.plants import double_pendulum
from mcpilco.bodies import inertial_parameters
from mcpilco.gap import DATA, GapProblem, fit_initial_states, fit_model, truncated
from mcpilco.identification import RigidBody
from mcpilco.plant import CATALOGUE, EffectInstance, Plant
from mcpilco.recordings import Recording

FREE = "upper_mass", "upper_inertia", "lower_mass", "lower_inertia"
"""with these the plant has every inertia and weight that such a chain can have"""
VISCOUS, COULOMB = CATALOGUE["viscous_friction"], CATALOGUE["coulomb_friction"]
LENGTHS = 0.2, 0.3
"""of the links [m]"""


def fit_free_runs(robot: RigidBody, recording: Recording) -> Float[np.ndarray, " D"]:
    """Parameters of the bodies and of the friction in the joints; no motor has an inertia.

    Args:
        robot: the authors' model, where the search begins; its terms are viscous friction, dry
            friction and armature.
        recording: with a sampling time of 10 or 20 ms.
    """
    plant = frictionless(robot)
    problem = GapProblem.of(plant, [recording], 0.0, FREE, {})
    windows = problem.windows(every=0.5 * DATA.window_s)
    model, theta = problem.model(windows), np.zeros(len(FREE))
    for joint, block in zip(
        robot.chain.joints, robot.nominal.reshape(-1, robot.width), strict=True
    ):
        viscous, coulomb, _ = block[-3:]
        model, theta = model.grown(theta, EffectInstance(VISCOUS, joint), (viscous,))
        model, theta = model.grown(theta, EffectInstance(COULOMB, joint), (coulomb, 0.01))
    windows = truncated(model, windows, theta)
    found = fit_model(model, windows, theta, fit_initial_states(model, windows, theta))
    parameters, friction = model.decode(found.theta[None])
    names = [parameter.name for parameter in plant.parameters]
    bodies = plant.build(dict(zip(names, parameters[0], strict=True))).bodies
    blocks = [
        np.concatenate([inertial_parameters(body), [viscous[0, 0], coulomb[0, 0], 0.0]])
        for body, viscous, coulomb in zip(bodies, friction[0::2], friction[1::2], strict=True)
    ]
    return np.concatenate(blocks)


def frictionless(robot: RigidBody) -> Plant:
    """The equations of a double pendulum with a model's bodies."""
    values = {"shoulder_friction": 0.0, "elbow_friction": 0.0, "gravity": -robot.chain.gravity[2]}
    for body, length in zip(robot.chain.bodies, LENGTHS, strict=True):
        values |= {
            f"{body.name}_mass": body.mass,
            f"{body.name}_length": length,
            f"{body.name}_center": -body.center[2] / length,
            f"{body.name}_inertia": body.inertia[1][1] / (body.mass * length**2),
        }
    return double_pendulum().where(**values)
