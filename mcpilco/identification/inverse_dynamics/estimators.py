"""The six estimators of the thesis's chapter 3 by name: to fit, to save, to load.

Four are Gaussian processes (`gaussian`); least squares and the network are below.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from mcpilco.bodies import Chain
from mcpilco.config import from_dict
from mcpilco.files import read_groups, write_groups
from mcpilco.identification.inverse_dynamics.gaussian import (
    TUNED_ON,
    PhysicalFeatures,
    Prior,
    fit_gaussian,
    geometric,
    nonparametric,
    parametric,
    restored,
    semiparametric,
)
from mcpilco.identification.inverse_dynamics.model import Fitted, InverseDynamics
from mcpilco.identification.report import Report
from mcpilco.identification.rigid_body import base_parameters
from mcpilco.kernels import Kind
from mcpilco.recordings import ARRAYS, JointData, check_joint_data
from mcpilco.typing import InputError, RunFolderError


class LinearInverseDynamics(InverseDynamics):
    """tau = Phi(q, q', q'') w with one w for all joints: eq. (3.2)."""

    def __init__(
        self, fitted: Fitted, features: PhysicalFeatures, w: Float[np.ndarray, " D"]
    ) -> None:
        super().__init__(fitted)
        self.features, self.w = features, w

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        return self.features(motion) @ torch.as_tensor(self.w)

    def to_groups(self) -> dict[str, dict[str, np.ndarray]]:
        return {"parameters": {"w": self.w}}


def fit_least_squares(
    data: JointData, features: PhysicalFeatures, **built: Any
) -> LinearInverseDynamics:
    """The least w of all that explain the torques of all joints best.

    `report.unidentified` names the parameters whose columns depend on others in these data.

    Reference: thesis section 3.4.1; Sousa, Cortesão, Physical feasibility of robot base inertial
    parameter identification, International Journal of Robotics Research 33 (6), 2014.
    """
    Phi = features(data.motion).numpy()
    rows = Phi.reshape(-1, Phi.shape[-1])
    w = np.linalg.lstsq(rows, data.tau.ravel(), rcond=1e-9)[0]
    dependent = base_parameters(Phi).dependent
    names = tuple(features.names[column] for column in dependent)
    report = Report(converged=True, iterations=0, unidentified=names)
    return LinearInverseDynamics(Fitted.to("fe", data, report, **built), features, w)


UNITS = 400
"""of each hidden layer; the thesis takes 600 for six joints"""
EPOCHS = 80
BATCH = 200
RATE = 3e-3
"""of Adam at first; it falls to 0 along a cosine"""


class NetworkInverseDynamics(InverseDynamics):
    """Torques of standardised motions, through two layers of sigmoids.

    Reference: thesis section 3.4.1.
    """

    def __init__(self, fitted: Fitted, layers: nn.Sequential, scales: dict[str, Tensor]) -> None:
        super().__init__(fitted)
        self.layers, self.scales = layers, scales
        layers.requires_grad_(False)

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        s = self.scales
        return s["tau_mean"] + s["tau_std"] * self.layers((motion - s["x_mean"]) / s["x_std"])

    def to_groups(self) -> dict[str, dict[str, np.ndarray]]:
        weights = {name: value.numpy() for name, value in self.layers.state_dict().items()}
        scales = {name: value.numpy() for name, value in self.scales.items()}
        return {"layers": weights, "scales": scales}


def network(joints: int, units: int) -> nn.Sequential:
    """The layers, in double precision."""
    sizes = (3 * joints, units, units)
    hidden = [layer for a, b in pairwise(sizes) for layer in (nn.Linear(a, b), nn.Sigmoid())]
    return nn.Sequential(*hidden, nn.Linear(units, joints)).double()


def fit_network(
    data: JointData, units: int = UNITS, epochs: int = EPOCHS, seed: int = 0, **built: Any
) -> NetworkInverseDynamics:
    """A network of the least squared error on standardised torques, by Adam.

    Differs: the thesis leaves batches, rates and epochs to its source code; `BATCH`, `RATE` and
    `EPOCHS` are ours.
    """
    tau = torch.as_tensor(data.tau, dtype=torch.float64)
    X = data.motion
    scales = {
        "x_mean": X.mean(0),
        "x_std": X.std(0).clamp_min(1e-12),
        "tau_mean": tau.mean(0),
        "tau_std": tau.std(0),
    }
    inputs = ((X - scales["x_mean"]) / scales["x_std"]).float()
    targets = ((tau - scales["tau_mean"]) / scales["tau_std"]).float()
    generator = torch.Generator().manual_seed(seed)
    layers = network(len(data.joints), units).float()
    for layer in layers:
        if isinstance(layer, nn.Linear):  # Glorot's weights
            nn.init.xavier_normal_(layer.weight, generator=generator)
            nn.init.zeros_(layer.bias)
    adam = torch.optim.Adam(layers.parameters(), lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, epochs)
    for _ in range(epochs):
        for rows in torch.randperm(len(X), generator=generator).split(BATCH):
            adam.zero_grad()
            (layers(inputs[rows]) - targets[rows]).square().mean().backward()
            adam.step()
        schedule.step()
    report = Report(converged=True, iterations=epochs * -(-len(X) // BATCH))
    fitted = Fitted.to("nn", data, report, units=units, **built)
    return NetworkInverseDynamics(fitted, layers.double(), scales)


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


def fit_inverse_dynamics(
    data: JointData,
    kernel: Estimator = "gip",
    *,
    chain: Chain | None = None,
    friction: bool = True,
    tuned_on: int = TUNED_ON,
    seed: int = 0,
) -> InverseDynamics:
    """A model of the inverse dynamics, learned from data.

    The kernel is a key of `ESTIMATORS`; its cost grows as N^3 with N samples: some thousands take
    seconds. `chain` is the robot's geometry, for `fe`, `pp` and `sp`; its masses do not matter.
    Without `friction` joints have none; `rbf` and `nn` see the velocities anyway. Hyperparameters
    are fitted to `tuned_on` samples, which the seed chooses, as it does a network's weights.

    Raises:
        InputError: the data cannot determine a model, see `check_joint_data`, or the chain is
            missing or another's.
        NotPositiveDefiniteError: a covariance matrix has no Cholesky factor.
    """
    if kernel not in ESTIMATORS:
        raise InputError(f"kernel must be one of {', '.join(ESTIMATORS)}, got {kernel!r}.")
    check_joint_data(data)
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
        return geometric(kinds, friction)
    if kernel == "rbf":
        return nonparametric(len(kinds))
    assert chain is not None
    return parametric(chain, friction) if kernel == "pp" else semiparametric(chain, friction)


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


def save_inverse_dynamics(path: str | Path, model: InverseDynamics) -> Path:
    """Write a model as one `.npz` of plain arrays.

    Raises:
        RunFolderError: the file cannot be written.
    """
    return write_groups(Path(path), asdict(model.fitted), model.to_groups())


def load_inverse_dynamics(path: str | Path) -> InverseDynamics:
    """The model that `save_inverse_dynamics` wrote; nothing in the file is executed.

    Raises:
        RunFolderError: the file is missing, damaged, or no such model.
    """
    about, groups = read_groups(Path(path))
    try:
        return _build(from_dict(Fitted, about), groups)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise RunFolderError(
            f"{path} holds no model of inverse dynamics ({error}); fit it again."
        ) from error


def _build(fitted: Fitted, groups: dict[str, dict[str, np.ndarray]]) -> InverseDynamics:
    kernel, joints, built = fitted.kernel, fitted.joints, fitted.built
    friction = bool(built["friction"])
    chain = from_dict(Chain, built["chain"]) if "chain" in built else None
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
