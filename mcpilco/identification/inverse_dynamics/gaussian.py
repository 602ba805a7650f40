"""Inverse dynamics as Gaussian processes, one a joint, with four priors to choose from."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.bodies import INERTIAL, Chain, torch_regressor
from mcpilco.dynamics import JointPolynomials, friction
from mcpilco.gp import GP, Posterior, evenly_spaced
from mcpilco.identification.inverse_dynamics.model import Fitted, InverseDynamics
from mcpilco.identification.report import Report, jitter_of
from mcpilco.identification.rigid_body import RigidBody
from mcpilco.kernels import GIP, RBF, ActiveDims, Kernel, Kind, Linear
from mcpilco.recordings import ARRAYS, JointData


class PhysicalFeatures:
    """Row j of Phi of tau = Phi(q, q', q'') w, for each joint j: eq. (3.2).

    The columns are those of `mcpilco.identification.rigid_body`: a block for each joint, of the
    inertial parameters of its body, and then of the joint's armature and friction.

    Masses and inertias of the chain do not matter.
    """

    def __init__(self, chain: Chain, friction: bool) -> None:
        self.chain, self.friction = chain, friction
        terms = ("armature", "viscous", "coulomb") if friction else ("armature",)
        count = len(chain.bodies) * (len(INERTIAL) + len(terms))
        self.names = RigidBody(chain, terms, np.zeros(count)).names
        """of the columns"""

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        """Phi, differentiable by the motion."""
        _, dq, ddq = motion.split(len(self.chain.bodies), -1)
        own = [ddq[..., None], friction(dq)] if self.friction else [ddq[..., None]]
        terms = torch.cat(own, -1)  # *b J T
        spread = torch.diag_embed(terms.mT).movedim(-3, -1)  # *b J J T
        return torch.cat([torch_regressor(self.chain, motion), spread], -1).flatten(-2)


@dataclass(frozen=True)
class Prior:
    """Zero-mean Gaussian processes, one a joint, all with one kernel of features of their own."""

    features: Callable[[Float[Tensor, "*b Q"]], Float[Tensor, "*b J D"]]
    """regressors of the process of each joint, differentiable by the motion"""
    kernel: Callable[[], Kernel]
    """makes a kernel of D features, for one output"""


def nonparametric(joints: int) -> Prior:
    """k(x, x') = RBF of positions, velocities and accelerations: nothing is known of the robot.

    Reference: thesis section 3.2.2.
    """

    def features(motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        return motion[..., None, :].expand(*motion.shape[:-1], joints, -1)

    return Prior(features, lambda: RBF(3 * joints, (1,)))


def parametric(chain: Chain, friction: bool) -> Prior:
    """k_i(x, x') = phi_i(x)^T Sigma phi_i(x'), Sigma diagonal: the geometry is known.

    Reference: thesis eq. (3.6), with mean 0.
    """
    features = PhysicalFeatures(chain, friction)
    return Prior(features, lambda: Linear(len(features.names), (1,), bias=False))


def semiparametric(chain: Chain, friction: bool) -> Prior:
    """The parametric kernel plus an RBF of the motion, for what the geometry gets wrong.

    Reference: thesis eq. (3.7).
    """
    known, rest = parametric(chain, friction), nonparametric(len(chain.bodies))
    return Prior(
        lambda motion: torch.cat([known.features(motion), rest.features(motion)], -1),
        lambda: side_by_side(known.kernel(), rest.kernel()),
    )


def geometric(kinds: Sequence[Kind], with_friction: bool) -> Prior:
    """The GIP kernel: the kinds of the joints are known, and nothing else.

    Friction is no polynomial: joints that have it get a linear kernel besides.

    Reference: thesis eq. (3.11).
    """
    polynomials, J = JointPolynomials(kinds), len(kinds)

    def features(motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J D"]:
        z = polynomials(motion)[..., None, :].expand(*motion.shape[:-1], J, -1)
        return torch.cat([z, friction(motion[..., J : 2 * J])], -1) if with_friction else z

    def kernel() -> Kernel:
        gip = GIP(kinds, (1,))
        return side_by_side(gip, Linear(2, (1,), bias=False)) if with_friction else gip

    return Prior(features, kernel)


def side_by_side(first: Kernel, second: Kernel) -> Kernel:
    """The sum of a kernel of the first regressors and one of those behind them."""
    width = first.width + second.width
    return ActiveDims(first, range(first.width), width) + ActiveDims(
        second, range(first.width, width), width
    )


logger = logging.getLogger(__name__)

TUNED_ON = 400
"""samples that hyperparameters are fitted to"""
NOISE_FLOORS = (0.3, 0.1, 0.03, 0.01, 1e-4)
"""least standard deviations of the noise that are tried, in parts of the torque's [-]"""
JUDGED_ON, STRETCHES = 1000, 10
"""evenly spaced samples on which they are compared, and in how many stretches"""


class GaussianInverseDynamics(InverseDynamics):
    """Each joint's torque as a Gaussian process of its own, of features that a prior names.

    Reference: thesis section 3.2.2.
    """

    def __init__(
        self, fitted: Fitted, prior: Prior, data: JointData, posteriors: list[Posterior]
    ) -> None:
        super().__init__(fitted)
        self.prior, self.data, self.posteriors = prior, data, posteriors

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        return self._each(motion, Posterior.mean)

    def std(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        return self._each(motion, lambda known, Zq: known.mean_and_variance(Zq)[1]).sqrt()

    def _each(
        self, motion: Float[Tensor, "*b Q"], what: Callable[[Posterior, Tensor], Tensor]
    ) -> Float[Tensor, "*b J"]:
        """The latent torque of each joint, by its posterior: thesis eq. (3.4)."""
        Z = self.prior.features(motion.reshape(-1, motion.shape[-1]))
        each = [what(known, Z[:, j]) for j, known in enumerate(self.posteriors)]
        return torch.cat(each, -1).reshape(*motion.shape[:-1], -1)

    def to_groups(self) -> dict[str, dict[str, np.ndarray]]:
        groups = {"data": {name: getattr(self.data, name) for name in ARRAYS}}
        for joint, known in zip(self.joints, self.posteriors, strict=True):
            state = {name: value.numpy() for name, value in known.kernel.state_dict().items()}
            groups[f"joint_{joint}"] = state | {"noise_std": known.noise_std[0].numpy()}
        return groups


def fit_gaussian(
    kernel: str,
    prior: Prior,
    data: JointData,
    tuned_on: int = TUNED_ON,
    max_iterations: int = 200,
    floors: Sequence[float] = NOISE_FLOORS,
    seed: int = 0,
    **built: Any,
) -> GaussianInverseDynamics:
    """A Gaussian process a joint, whose hyperparameters predict stretches of the data left out.

    All data make the posterior, whose cost grows as N^3; `tuned_on` of them, drawn at random, the
    hyperparameters: those of highest evidence with the noise above one of `floors`, in parts of
    the torque's standard deviation. The stretches are of time where the samples are in its order.
    `built` is what a file must say to build the prior anew.
    """
    Z = prior.features(data.motion).detach()
    tau = torch.as_tensor(data.tau, dtype=torch.float64)
    some = np.random.default_rng(seed).permutation(len(data))[:tuned_on]
    gps = []
    for j, joint in enumerate(data.joints):
        y = tau[:, j : j + 1]
        processes = [
            GP(prior.kernel(), noise_floor=share * float(y.std()), names=(joint,))
            for share in floors
        ]
        for gp in processes:
            gp.fit(Z[some, j], y[some], max_iterations=max_iterations)
        gps.append(_best(processes, Z[:, j], y))
        logger.info("%s: joint %s, %s", kernel, joint, gps[-1].report)
    posteriors = [gp.condition(Z[:, j].clone(), tau[:, j : j + 1]) for j, gp in enumerate(gps)]
    report = _report(data, gps, posteriors)
    fitted = Fitted.to(kernel, data, report, kinds=list(data.kinds), **built)
    return GaussianInverseDynamics(fitted, prior, data, posteriors)


def _best(gps: Sequence[GP], Z: Float[Tensor, "N D"], y: Float[Tensor, "N 1"]) -> GP:
    """The process with the least left-out error.

    The evidence takes noise to be white. Where a joint sticks, or torques are filtered, what no
    function of the prior explains is smooth in time, and the highest evidence interpolates it with
    polynomials that are wild elsewhere: only stretches left out tell.
    """
    even = evenly_spaced(len(Z), JUDGED_ON)
    return min(gps, key=lambda gp: left_out_error(gp.condition(Z[even], y[even])))


def left_out_error(posterior: Posterior) -> float:
    """Mean square of the errors of the first output, each stretch predicted from the others.

    e_B = ([K + s^2 I]^-1)_BB^-1 alpha_B for a stretch B.

    Reference: R&W eq. (5.12), of stretches in place of single samples.
    """
    L_inv, alpha = posterior.L_inv[0], posterior.alpha[0]
    stretches = torch.arange(len(alpha)).tensor_split(STRETCHES)
    errors = [
        torch.linalg.solve(L_inv[:, B].mT @ L_inv[:, B], alpha[B]) for B in stretches if len(B)
    ]
    return float(torch.cat(errors).square().mean())


def _report(data: JointData, gps: list[GP], posteriors: list[Posterior]) -> Report:
    fits = [gp.report for gp in gps if gp.report is not None]
    warnings = [
        f"the hyperparameters of joint {joint!r} may be better: their search broke off after "
        f"{fit.iterations} steps; compare with another seed."
        for joint, fit in zip(data.joints, fits, strict=True)
        if not fit.converged
    ]
    for joint, gp, tau in zip(data.joints, gps, data.tau.T, strict=True):
        share = float(gp.noise_std.detach()) ** 2 / tau.var()
        if share > 0.5:
            warnings.append(
                f"{100 * share:.0f} % of the torque of joint {joint!r} is taken for noise; record "
                "faster or larger motions of it, or with a load."
            )
    jitter = tuple(jitter for known in posteriors for jitter in jitter_of(known))
    return Report.of_gps(gps, jitter=jitter, warnings=tuple(warnings))


def restored(
    fitted: Fitted, prior: Prior, data: JointData, groups: dict[str, dict[str, np.ndarray]]
) -> GaussianInverseDynamics:
    """The model that `to_groups` wrote: its posterior is factorised again."""
    Z, tau = prior.features(data.motion).detach(), torch.as_tensor(data.tau)
    posteriors = []
    for j, joint in enumerate(data.joints):
        state = {name: torch.as_tensor(value) for name, value in groups[f"joint_{joint}"].items()}
        noise = float(state.pop("noise_std"))
        gp = GP(prior.kernel(), noise_std=noise, noise_floor=0.0, names=(joint,))
        gp.kernel.load_state_dict(state)
        posteriors.append(gp.condition(Z[:, j].clone(), tau[:, j : j + 1]))
    return GaussianInverseDynamics(fitted, prior, data, posteriors)
