"""Random chains of rigid bodies, as MJCF and of our own parts."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mcpilco.bodies import HINGE, SLIDE, Body, Chain


def random_mjcf(rng: np.random.Generator, joints: int) -> str:
    """A tree of bodies in turned frames, some with two joints and some with none."""
    bodies: list[list[str]] = []
    children: dict[int, list[int]] = {}
    while sum(len(body) for body in bodies) < joints:
        number = len(bodies)
        parent = int(rng.integers(-1, number)) if number else -1
        children.setdefault(parent, []).append(number)
        left = joints - sum(len(body) for body in bodies)
        count = min(int(rng.choice([0, 1, 1, 1, 2])) if number else 1, left)
        bodies.append([_joint(rng, f"b{number}_{k}") for k in range(count)])

    def write(number: int) -> str:
        inner = "".join(bodies[number]) + _inertial(rng)
        inner += "".join(write(child) for child in children.get(number, []))
        frame = f'pos="{_row(rng.normal(0, 0.3, 3))}" quat="{_row(rng.normal(size=4))}"'
        return f'<body name="b{number}" {frame}>{inner}</body>\n'

    trees = "".join(write(root) for root in children[-1])
    return (
        f'<mujoco><compiler autolimits="true"/><option gravity="{_row(rng.normal(0, 6, 3))}"/>'
        f'<worldbody>{trees}</worldbody><actuator><motor joint="b0_0"/></actuator></mujoco>'
    )


def random_planar_chain(rng: np.random.Generator, joints: int) -> Chain:
    """Hinges across the plane of x and z, slides in it; branches; frames turned in the plane."""

    def body(number: int) -> Body:
        slides = rng.random() < 0.4
        angle = rng.uniform(-np.pi, np.pi)
        along = (np.cos(angle), 0.0, np.sin(angle))
        turned = Rotation.from_rotvec([0.0, rng.uniform(-2.0, 2.0), 0.0]).as_matrix()
        turned[1], turned[:, 1] = (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)
        return Body(
            name=f"body{number}",
            joint=f"joint{number}",
            kind=SLIDE if slides else HINGE,
            axis=along if slides else (0.0, rng.choice([-1.0, 1.0]), 0.0),
            mass=rng.uniform(0.2, 2.0),
            parent=int(rng.integers(-1, number)) if number else -1,
            origin=tuple(rng.normal(0, 0.4, 3)),
            rotation=tuple(map(tuple, turned)),
            center=tuple(rng.normal(0, 0.3, 3)),
            inertia=tuple(map(tuple, _inertia(rng))),
            armature=rng.uniform(0.0, 0.1),
        )

    gravity = tuple(rng.normal(0, 6, 3))
    return Chain(tuple(body(number) for number in range(joints)), gravity)


def _joint(rng: np.random.Generator, name: str) -> str:
    kind = rng.choice(["hinge", "hinge", "slide"])
    where = f'pos="{_row(rng.normal(0, 0.2, 3))}" axis="{_row(rng.normal(size=3))}"'
    return f'<joint name="{name}" type="{kind}" {where} armature="{rng.choice([0, 0.05])}"/>'


def _inertial(rng: np.random.Generator) -> str:
    i = _inertia(rng)
    six = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    where = f'pos="{_row(rng.normal(0, 0.2, 3))}" mass="{rng.uniform(0.2, 2.0)}"'
    return f'<inertial {where} fullinertia="{_row(six)}"/>'


def _inertia(rng: np.random.Generator) -> np.ndarray:
    """Of ten points of mass, so that it is one that a body can have [kg m^2]."""
    points = rng.normal(0, 0.1, (10, 3))
    spread = points.T @ points
    return 0.1 * (np.trace(spread) * np.eye(3) - spread)


def _row(numbers: np.ndarray | list[float]) -> str:
    return " ".join(map(repr, map(float, numbers)))
