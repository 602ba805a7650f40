"""The six estimators of the thesis's chapter 3 by name: to fit, to save, to load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch

from mcpilco.bodies import Body, Chain
from mcpilco.files import read_groups, write_groups
from mcpilco.identification.inverse_dynamics.gaussian import TUNED_ON, fit_gaussian, restored
from mcpilco.identification.inverse_dynamics.least_squares import (
    LinearInverseDynamics,
    fit_least_squares,
)
from mcpilco.identification.inverse_dynamics.model import Fitted, InverseDynamics
from mcpilco.identification.inverse_dynamics.network import (
    NetworkInverseDynamics,
    fit_network,
    network,
)
from mcpilco.identification.inverse_dynamics.physics import PhysicalFeatures
from mcpilco.identification.inverse_dynamics.priors import (
    Geometric,
    Nonparametric,
    Parametric,
    Prior,
    Semiparametric,
)
from mcpilco.kernels import Kind
from mcpilco.recordings import ARRAYS, JointData, check
from mcpilco.typing import InputError, RunFolderError

Estimator = Literal["gip", "rbf", "pp", "sp", "fe", "nn"]

ESTIMATORS: Mapping[str, str] = {
    "fe": "Fisherian estimator: least squares on the regressor of a known geometry",
    "pp": "parametric prior: linear kernel on that regressor, a joint at a time",
    "sp": "semi-parametric prior: the same plus an RBF",
    "gip": "geometrically inspired polynomials: the kinds of the joints alone are known",
    "rbf": "RBF of positions, velocities and accelerations: nothing is known",
    "nn": "network of two layers of sigmoids: nothing is known",
}
"""what each estimator knows of the robot"""
GEOMETRIES = ("fe", "pp", "sp")
"""estimators that need a chain"""


def fit(
    data: JointData,
    kernel: Estimator = "gip",
    *,
    chain: Chain | None = None,
    friction: bool = True,
    tuned_on: int = TUNED_ON,
    seed: int = 0,
) -> InverseDynamics:
    """A model of the inverse dynamics, learned from data.

    Args:
        data: N samples; the cost of kernels grows as N^3, some thousands take seconds.
        kernel: a key of `ESTIMATORS`.
        chain: the robot's geometry, for `fe`, `pp` and `sp`; its masses do not matter.
        friction: whether joints have friction; `rbf` and `nn` see the velocities anyway.
        tuned_on: how many samples hyperparameters are fitted to.
        seed: of their choice, and of a network's weights.

    Raises:
        InputError: the data cannot tell a model, see `check`, or the chain is missing or another's.
        NotPositiveDefiniteError: a covariance matrix has no Cholesky factor.
    """
    if kernel not in ESTIMATORS:
        raise InputError(f"kernel must be one of {', '.join(ESTIMATORS)}, got {kernel!r}.")
    check(data)
    built: dict[str, Any] = {"friction": friction}
    if kernel in GEOMETRIES:
        chain = _require_chain(kernel, chain, data)
        built["chain"] = asdict(chain)
    if kernel == "nn":
        return fit_network(data, seed=seed, **built)
    if kernel == "fe":
        assert chain is not None
        return fit_least_squares(data, PhysicalFeatures(chain, friction), **built)
    prior = _prior(kernel, data.kinds, chain, friction)
    return fit_gaussian(kernel, prior, data, tuned_on=tuned_on, seed=seed, **built)


def _prior(kernel: str, kinds: tuple[Kind, ...], chain: Chain | None, friction: bool) -> Prior:
    if kernel == "gip":
        return Geometric(kinds, friction)
    if kernel == "rbf":
        return Nonparametric(len(kinds))
    assert chain is not None
    return Parametric(chain, friction) if kernel == "pp" else Semiparametric(chain, friction)


def _require_chain(kernel: str, chain: Chain | None, data: JointData) -> Chain:
    if chain is None:
        raise InputError(
            f"the estimator {kernel!r} needs the robot's geometry; give a chain or --model "
            "FILE.xml, or take gip, which needs the kinds of the joints alone."
        )
    kinds = tuple(body.kind for body in chain.bodies)
    if kinds != data.kinds:
        raise InputError(
            f"the data have joints of the kinds {', '.join(data.kinds)}, the chain "
            f"{', '.join(kinds)}; give the chain of this robot, joints in one order."
        )
    return chain


def save(path: str | Path, model: InverseDynamics) -> Path:
    """Write a model as one `.npz` of plain arrays.

    Raises:
        RunFolderError: the file cannot be written.
    """
    return write_groups(Path(path), model.fitted.to_json(), model.to_groups())


def load(path: str | Path) -> InverseDynamics:
    """The model that `save` wrote; nothing in the file is executed.

    Raises:
        RunFolderError: the file is missing, damaged, or no such model.
    """
    about, groups = read_groups(Path(path))
    try:
        return _build(Fitted.of_json(about), groups)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise RunFolderError(
            f"{path} holds no model of inverse dynamics ({error}); fit it again."
        ) from error


def _build(fitted: Fitted, groups: dict[str, dict[str, np.ndarray]]) -> InverseDynamics:
    kernel, joints, built = fitted.kernel, fitted.joints, fitted.built
    friction = bool(built["friction"])
    chain = _chain(built["chain"]) if "chain" in built else None
    if kernel == "nn":
        layers = network(len(joints), int(built["units"]))
        layers.load_state_dict(_tensors(groups["layers"]))
        return NetworkInverseDynamics(fitted, layers, _tensors(groups["scales"]))
    if kernel == "fe":
        assert chain is not None
        features = PhysicalFeatures(chain, friction)
        return LinearInverseDynamics(fitted, features, groups["parameters"]["w"])
    kinds = cast(tuple[Kind, ...], tuple(built["kinds"]))
    q, dq, ddq, tau = (groups["data"][name] for name in ARRAYS)
    data = JointData(q, dq, ddq, tau, joints, kinds)
    return restored(fitted, _prior(kernel, kinds, chain, friction), data, groups)


def _tensors(arrays: Mapping[str, np.ndarray]) -> dict[str, torch.Tensor]:
    return {name: torch.as_tensor(value) for name, value in arrays.items()}


def _chain(saved: dict[str, Any]) -> Chain:
    def frozen(value: Any) -> Any:
        return tuple(map(frozen, value)) if isinstance(value, list) else value

    bodies = tuple(
        Body(**{name: frozen(value) for name, value in body.items()}) for body in saved["bodies"]
    )
    return Chain(bodies, frozen(saved["gravity"]))
