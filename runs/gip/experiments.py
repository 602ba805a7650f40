"""The experiments of chapter 3, a trial a seed: what is fitted to what, and how it is judged."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from envs.arms.motions import random_motion
from envs.arms.robots import scara, ur10
from mcpilco.bodies import Body, Chain, generalised_forces
from mcpilco.bodies import accelerations as true_accelerations
from mcpilco.dynamics import friction
from mcpilco.identification.inverse_dynamics import (
    NOISE_FLOORS,
    FeedForward,
    InverseDynamics,
    accelerations,
    fit_gaussian,
    fit_inverse_dynamics,
    geometric,
    inertia,
)
from mcpilco.recordings import JointData, held_out, joint_data, read_joint_recordings

NOISE = 0.01
"""standard deviation of the torques' noise [N m or N]"""
ALL = ("fe", "pp", "sp", "gip", "rbf", "nn")
"""estimators, those that know most first"""
EFFICIENT = ("pp", "gip", "rbf", "nn")
"""those of figure 3.3"""
TRACKED = ("pp", "gip", "rbf")
"""those that feed forward"""
GAINS = np.array([100.0, 40.0, 400.0, 1.0]), np.array([40.0, 12.0, 60.0, 0.2])
"""of the feedback: [N m/rad or N/m] and [N m s/rad or N s/m]"""
STEP_S, PLAN_S = 0.001, 5.0
LENGTH = 0.05
"""largest error of a length of a robot [m]"""
ANGLE = np.deg2rad(5.0)
"""largest error of an angle of a robot [rad]"""


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    samples: int = 2000
    """of the training data, and of the test"""
    curve: tuple[int, ...] = (250, 500, 1000, 2000, 4000)
    """amounts of training data in figure 3.3"""
    estimators: tuple[str, ...] = ALL
    """in figures 3.2 and 3.4"""
    tuned_on: int = 400
    """samples that hyperparameters are fitted to"""


QUICK = Sizes(samples=250, curve=(160, 250), estimators=("fe", "pp", "gip", "rbf"), tuned_on=120)


def measured(
    chain: Chain, rng: np.random.Generator, samples: int, noise: float = NOISE, dt: float = 0.05
) -> JointData:
    """A motion of its own at steps of dt [s], and its torques."""
    motion = random_motion(chain, rng, samples, dt)
    tau = generalised_forces(chain, *motion) + noise * rng.normal(size=motion[0].shape)
    return JointData(*motion, tau, chain.joints, tuple(body.kind for body in chain.bodies))


def perturbed(chain: Chain, rng: np.random.Generator) -> Chain:
    """The chain with uniform errors in the four Denavit-Hartenberg parameters of each joint.

    Masses, centers of mass and inertias stay, each in the frame of its body.

    Reference: thesis section 3.4.1.
    """

    def of(body: Body) -> Body:
        x, z = rng.uniform(-LENGTH, LENGTH, 2)
        turn = Rotation.from_euler("xz", rng.uniform(-ANGLE, ANGLE, 2)).as_matrix()
        origin = np.add(body.origin, (x, 0.0, z))
        rotation = np.array(body.rotation) @ turn
        rows = tuple(tuple(row) for row in rotation.tolist())
        return replace(body, origin=tuple(origin.tolist()), rotation=rows)

    return replace(chain, bodies=tuple(map(of, chain.bodies)))


def accuracy(seed: int, sizes: Sizes) -> dict[str, Any]:
    """Figure 3.2: a perturbed SCARA; the geometry that is told is the nominal one."""
    rng = np.random.default_rng([seed, 0])
    nominal = scara()
    robot = perturbed(nominal, rng)
    train, test = measured(robot, rng, sizes.samples), measured(robot, rng, sizes.samples)
    models, found = _fitted(sizes.estimators, train, test, nominal, seed, sizes.tuned_on)
    clean = measured(robot, rng, 200, noise=0.0)
    found["forward"] = {name: forward(models[name], clean) for name in models if name != "nn"}
    tracked = {name: models[name] for name in TRACKED if name in models}
    found["tracking"] = tracking(robot, tracked, rng)
    return found


def six_joints(seed: int, sizes: Sizes) -> dict[str, Any]:
    """Figure 3.4, but simulated: an arm like a UR10, perturbed as the SCARAs are."""
    rng = np.random.default_rng([seed, 1])
    nominal = ur10()
    robot = perturbed(nominal, rng)
    train, test = measured(robot, rng, sizes.samples), measured(robot, rng, sizes.samples)
    return _fitted(sizes.estimators, train, test, nominal, seed, sizes.tuned_on)[1]


def efficiency(seed: int, sizes: Sizes) -> dict[str, Any]:
    """Figure 3.3: the nominal SCARA; each amount is the beginning of one motion."""
    rng = np.random.default_rng([seed, 2])
    robot = scara()
    train, test = measured(robot, rng, sizes.curve[-1]), measured(robot, rng, sizes.samples)
    gmse: dict[str, list[float]] = {name: [] for name in EFFICIENT}
    for count in sizes.curve:
        for name in EFFICIENT:
            some = train[:count]
            model = fit_inverse_dynamics(
                some, name, chain=robot, friction=False, tuned_on=sizes.tuned_on, seed=seed
            )
            gmse[name].append(float((model.nmse(test) * test.tau.var(0)).sum()))
    return {"seed": seed, "samples": list(sizes.curve), "gmse": gmse}


def six_joint_efficiency(seed: int, sizes: Sizes) -> dict[str, Any]:
    """How much data six joints take: the arms of figure 3.4, the beginning of one long motion."""
    rng = np.random.default_rng([seed, 1])
    nominal = ur10()
    robot = perturbed(nominal, rng)
    train, test = measured(robot, rng, sizes.curve[-1]), measured(robot, rng, sizes.samples)
    nmse: dict[str, list[list[float]]] = {name: [] for name in ("pp", "gip")}
    for count in sizes.curve:
        models = _fitted(tuple(nmse), train[:count], test, nominal, seed, sizes.tuned_on)[0]
        for name, model in models.items():
            nmse[name].append(model.nmse(test).tolist())
    return {"seed": seed, "samples": list(sizes.curve), "joints": list(train.joints), "nmse": nmse}


UNEXPLAINED, STEP = 0.15, 0.01
"""a force that depends on time alone, in parts of the torque's std [-]; its sampling time [s]"""


def unexplained(seed: int, sizes: Sizes) -> dict[str, Any]:
    """A SCARA one of whose forces no motion explains: hyperparameters by evidence, or left out."""
    rng = np.random.default_rng([seed, 3])
    robot = scara()
    train, test = (measured(robot, rng, sizes.samples, dt=STEP) for _ in range(2))
    smooth = gaussian_filter1d(rng.normal(size=train.tau.shape), 8, axis=0)
    force = UNEXPLAINED * train.tau.std(0) * smooth / smooth.std(0)
    train = replace(train, tau=train.tau + force)
    prior, nmse = geometric(train.kinds, False), {}
    for name, tried in {"evidence": NOISE_FLOORS[-1:], "left out": NOISE_FLOORS}.items():
        model = fit_gaussian("gip", prior, train, sizes.tuned_on, floors=tried, seed=seed)
        nmse[name] = model.nmse(test).tolist()
    return {"seed": seed, "samples": len(train), "joints": list(train.joints), "nmse": nmse}


def recorded(learn: Path, other: Path, counts: Sequence[int]) -> dict[str, Any]:
    """A real arm like the UR10: the last fifth of a recording, and another recording.

    `friction` is least squares on 1, q' and tanh(q' / v_r), a joint at a time.
    """
    chain = ur10()
    kinds = tuple(body.kind for body in chain.bodies)
    whole, test = (
        joint_data(recording, chain.joints, kinds)
        for recording in read_joint_recordings([learn, other], chain.joints)
    )
    train, rest = held_out(whole, 0.2)
    tests = {"last fifth": rest, "other recording": test}
    nmse: dict[str, dict[str, list[list[float]]]] = {name: {} for name in tests}
    for count in counts:
        some = train.thinned(count)
        for name in ("pp", "sp", "gip", "rbf"):
            model = fit_inverse_dynamics(some, name, chain=chain)
            for where, data in tests.items():
                nmse[where].setdefault(name, []).append(model.nmse(data).tolist())
        for where, data in tests.items():
            nmse[where].setdefault("friction", []).append(_by_friction(some, data))
    return {"samples": list(counts), "joints": list(chain.joints), "nmse": nmse}


def _by_friction(train: JointData, test: JointData) -> list[float]:
    def regressors(data: JointData, j: int) -> np.ndarray:
        one = friction(torch.as_tensor(data.dq[:, j : j + 1]))[:, 0].numpy()
        return np.column_stack([np.ones(len(data)), one])

    errors = []
    for j in range(len(train.joints)):
        w = np.linalg.lstsq(regressors(train, j), train.tau[:, j], rcond=None)[0]
        errors.append(np.mean((regressors(test, j) @ w - test.tau[:, j]) ** 2))
    return (np.array(errors) / test.tau.var(0)).tolist()


EXPERIMENTS = {
    "scara": accuracy,
    "ur10": six_joints,
    "efficiency": efficiency,
    "ur10-efficiency": six_joint_efficiency,
    "unexplained": unexplained,
}


def _fitted(
    estimators: Sequence[str],
    train: JointData,
    test: JointData,
    chain: Chain,
    seed: int,
    tuned_on: int,
) -> tuple[dict[str, InverseDynamics], dict[str, Any]]:
    models, nmse, cpu = {}, {}, {}
    for name in estimators:
        begun = time.process_time()
        model = fit_inverse_dynamics(
            train, name, chain=chain, friction=False, tuned_on=tuned_on, seed=seed
        )
        cpu[name] = time.process_time() - begun
        models[name], nmse[name] = model, model.nmse(test).tolist()
    return models, {
        "seed": seed,
        "samples": len(train),
        "joints": list(train.joints),
        "torque_std": test.tau.std(0).tolist(),
        "nmse": nmse,
        "cpu_s": cpu,
    }


@torch.no_grad()
def forward(model: InverseDynamics, clean: JointData) -> dict[str, Any]:
    """Accelerations through the model, from the true torques."""
    q, dq, tau = (torch.as_tensor(a) for a in (clean.q, clean.dq, clean.tau))
    positive = inertia(model, q).positive.numpy()
    ddq = accelerations(model, q, dq, tau, indefinite="nan").numpy()
    errors = ((ddq - clean.ddq)[positive] ** 2).mean(0) if positive.any() else clean.q[0] * np.nan
    nmse = errors / clean.ddq.var(0)
    return {
        "positive": float(positive.mean()),
        "nmse": [None if np.isnan(value) else float(value) for value in nmse],
    }


def tracking(
    robot: Chain, models: Mapping[str, InverseDynamics], rng: np.random.Generator
) -> dict[str, list[float]]:
    """RMS errors of the joints [rad or m] on a new motion: feedback alone, and with each model."""
    names = ("pd", *models)
    plan = random_motion(robot, rng, round(PLAN_S / STEP_S), STEP_S)
    controllers = [FeedForward(models.get(name), *GAINS) for name in names]
    torques = np.stack([controller.plan(*plan) for controller in controllers], 1)  # T C J
    q, dq = (np.repeat(array[:1], len(names), 0) for array in plan[:2])
    errors = []
    for q_d, dq_d, planned in zip(plan[0], plan[1], torques, strict=True):
        errors.append(q_d - q)
        tau = controllers[0].torque(planned, q_d - q, dq_d - dq)
        dq = dq + STEP_S * true_accelerations(robot, q, dq, tau)
        q = q + STEP_S * dq
    rms = np.sqrt(np.mean(np.square(errors), 0))
    return {name: row.tolist() for name, row in zip(names, rms, strict=True)}
