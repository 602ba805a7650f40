"""The current that each motor of an arm takes when nothing touches the arm.

    i_j = phi_j(x)' w_j                         PP, parametric prior, thesis eq. (4.7)
    i_j = phi_j(x)' w_j + f_j(x)                SP, semi-parametric, thesis eq. (3.7)
    i_j = phi_j(x)' w_j + a_j(x) f_j(x_aug)     FC, compensates friction, thesis eq. (4.10)

The w are normal, the f Gaussian processes with RBF kernels; joints are independent.
`Predictor` is the posterior of one joint in the form in which one sample costs least: f needs the
training samples only where its gate a is open, the linear part the posterior of w alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.linalg import qr

from mcpilco.gp import GP, Posterior
from mcpilco.identification.collision.features import (
    GATES,
    CurrentFeatures,
    about_unidentified,
    check_free,
    quiet,
    unidentified,
)
from mcpilco.identification.report import Report, jitter_of
from mcpilco.identification.rigid_body import RigidBody
from mcpilco.kernels import RBF, ActiveDims, Kernel, Linear, Rescaled
from mcpilco.recordings import WINDOW, ArmSamples

Features = Float[np.ndarray, "N p"]
"""phi of a joint"""
Seen = Float[np.ndarray, "N D"]
"""what f sees"""
Number = Float[np.ndarray, " N"]
"""one a sample"""
PerJoint = Float[np.ndarray, "N J"]
"""one a sample and joint"""

_SHUT = 1e-6
"""a gate that is closed but for this little is closed [-]"""


@dataclass(frozen=True, eq=False)
class Predictor:
    """Mean and variance of a joint's current [A]."""

    w: Float[np.ndarray, " p"]
    """posterior mean of the weights"""
    D: Float[np.ndarray, " p"]
    """their prior variances"""
    centre: Float[np.ndarray, " D"]
    """about which the training samples lie: distances far from 0 lose digits"""
    lengthscale: Float[np.ndarray, " D"]
    Z: Float[np.ndarray, "M D"]
    """training samples at which the gate is open, about the centre, in lengthscales"""
    prior: float
    """variance of f [A^2]"""
    beta: Float[np.ndarray, " M"]
    """f(z) = k(z, Z) beta"""
    R: Float[np.ndarray, "r p_plus_M"]
    """what the data say lessens the variance by |R [phi; a k(Z, z)]|^2"""
    noise_std: float
    """of the current's measurement [A]"""

    @classmethod
    def of(
        cls,
        posterior: Posterior,
        linear: Linear,
        rbf: RBF | None,
        phi: Features,
        z: Seen,
        a: Number,
    ) -> Predictor:
        """The predictor of a posterior with one output and the kernel phi' w + a f.

        Both kernels are as fitted, `rbf` None where there is no f; phi, z and a are of the N
        samples.
        """
        # K = Phi D Phi' + A Kf A + s^2 I = L L',  alpha = K^-1 y
        # var = phi' D phi + a^2 prior - |L^-1 (Phi D phi + a A k)|^2,  L^-1 [Phi D, A] = Q R
        L_inv, alpha = posterior.L_inv[0].numpy(), posterior.alpha[0].numpy()
        D = linear.weights[0].detach().numpy()
        seen = np.flatnonzero(a > _SHUT) if rbf is not None else np.empty(0, dtype=int)
        scale = np.ones(z.shape[1]) if rbf is None else rbf.lengthscale[0].detach().numpy()
        centre = z[seen].mean(axis=0) if len(seen) else np.zeros(z.shape[1])
        return cls(
            w=D * (alpha @ phi),
            D=D,
            centre=centre,
            lengthscale=scale,
            Z=(z[seen] - centre) / scale,
            prior=0.0 if rbf is None else float(rbf.variance[0]),
            beta=a[seen] * alpha[seen],
            R=qr(np.hstack([(L_inv @ phi) * D, L_inv[:, seen] * a[seen]]), mode="r")[0][
                : len(D) + len(seen)
            ],
            noise_std=float(posterior.noise_std[0]),
        )

    def mean(self, phi: Features, z: Seen, a: Number) -> Number:
        """The current expected [A]."""
        found = phi @ self.w
        if len(rows := self._open(a)):
            found[rows] += a[rows] * (self._k(z[rows]) @ self.beta)
        return found

    def variance(self, phi: Features, z: Seen, a: Number) -> Number:
        """Its variance, without the noise of the measurement [A^2]; arguments as of `mean`."""
        p = len(self.D)
        found = phi**2 @ self.D - np.square(phi @ self.R[:, :p].T).sum(axis=1)
        if len(rows := self._open(a)):
            gate = a[rows]
            less = np.hstack([phi[rows], gate[:, None] * self._k(z[rows])]) @ self.R.T
            found[rows] = phi[rows] ** 2 @ self.D + gate**2 * self.prior - (less**2).sum(axis=1)
        return np.maximum(found, 0.0)

    def _open(self, a: Number) -> Int[np.ndarray, " n"]:
        """Rows at which the gate is open."""
        return np.flatnonzero(a) if len(self.beta) else np.empty(0, dtype=int)

    def _k(self, z: Float[np.ndarray, "n D"]) -> Float[np.ndarray, "n M"]:
        """The covariance of f with itself at the training samples [A^2]."""
        z = (z - self.centre) / self.lengthscale
        square = (z * z).sum(axis=1)[:, None] + (self.Z * self.Z).sum(axis=1) - 2.0 * z @ self.Z.T
        return self.prior * np.exp(-0.5 * np.maximum(square, 0.0))


Kind = Literal["PP", "SP", "FC"]
_BLOCK = 2000
"""samples at once: their features are held in memory"""
_FLOOR = 2e-3
"""of the noise [A]"""


@dataclass(frozen=True)
class CurrentConfig:
    """How currents are modelled."""

    kind: Kind = "FC"
    """prior: parametric, semi-parametric or with friction compensated"""
    quiet_speed: float = 1e-2
    """sigma_v: a joint that is slower is quasi-static [rad/s or m/s]"""
    gate: Literal["hard", "smooth"] = "hard"
    """hard for detection, smooth where gradients shall flow through the velocity"""
    window: int = WINDOW
    """samples over which a derivative is taken"""
    points: int = 1500
    """samples that the posterior is conditioned on"""
    fit_points: int = 400
    """of these, that hyperparameters are fitted to"""
    iterations: int = 100
    """of that fit at most, for each joint"""


@dataclass(frozen=True, eq=False)
class CurrentModel:
    """The model of an arm's currents, learned from samples without any contact."""

    config: CurrentConfig
    features: CurrentFeatures
    dt: float
    """sampling time of what it learned from [s]"""
    gps: tuple[GP, ...]
    """of the joints: priors, with the hyperparameters found"""
    train: ArmSamples
    """what the posterior is conditioned on"""
    predictors: tuple[Predictor, ...]
    """of the joints: that posterior"""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""
        return self.features.body.chain.joints

    def mean(self, samples: ArmSamples) -> PerJoint:
        """The currents expected [A]."""
        return self._each("mean", samples)

    def std(self, samples: ArmSamples) -> PerJoint:
        """Standard deviation of the currents that are measured, about their mean [A]."""
        noise = np.array([predictor.noise_std for predictor in self.predictors])
        return np.sqrt(self._each("variance", samples) + noise**2)

    def quiet(self, samples: ArmSamples) -> np.ndarray:
        """Which joints are quasi-static at which samples, (N, J)."""
        return np.abs(samples.dq) < self.config.quiet_speed

    def _each(self, what: str, samples: ArmSamples) -> PerJoint:
        found = np.empty_like(samples.i)
        for first in range(0, len(samples), _BLOCK):
            rows = slice(first, first + _BLOCK)
            phi, z, a = inputs_of(samples[rows], self.features, self.config)
            for j, predictor in enumerate(self.predictors):
                found[rows, j] = getattr(predictor, what)(phi[j], z, a[:, j])
        return found


def inputs_of(
    samples: ArmSamples, features: CurrentFeatures, config: CurrentConfig
) -> tuple[list[Features], Seen, PerJoint]:
    """phi of each joint, what the f see of the samples, and the gates of the joints."""
    phi = features(samples.q, samples.dq, samples.ddq)
    match config.kind:
        case "PP":
            return phi, np.empty((len(samples), 0)), np.zeros_like(samples.dq)
        case "SP":
            return phi, samples.standard, np.ones_like(samples.dq)
        case "FC":
            return phi, samples.augmented, quiet(samples.dq, config.quiet_speed, config.gate)


def fit_currents(
    samples: ArmSamples, body: RigidBody, dt: float, config: CurrentConfig | None = None
) -> tuple[CurrentModel, Report]:
    """The model of the currents of an arm, and how its fit went.

    The arm moves and rests without any contact; the robot has the terms `CURRENT_TERMS`, and its
    masses need not be right.

    Raises:
        InputError: the samples cannot teach it; the sentence says what to record.
        NotPositiveDefiniteError: a covariance matrix has no Cholesky factor.

    Reference: thesis sections 4.4.1 and 4.5.
    Differs: the hyperparameters are fitted to a part of the samples that the posterior has.
    """
    config = config or CurrentConfig()
    check_free(samples, body.chain.joints, config.quiet_speed, rests=config.kind == "FC")
    features = CurrentFeatures(body, config.quiet_speed, config.gate)
    train = samples.thinned(config.points)
    some = train.thinned(config.fit_points)
    gps = tuple(current_prior(features, config))
    inputs = inputs_of(some, features, config)
    for j, gp in enumerate(gps):
        y = torch.from_numpy(some.i[:, j : j + 1])
        gp.fit(current_regressors(some, inputs, j), y, max_iterations=config.iterations)
    model, jitter = condition_currents(gps, train, features, dt, config)
    untold = unidentified(train, features)
    warnings = about_unidentified(untold)
    return model, Report.of_gps(gps, jitter=jitter, unidentified=untold, warnings=warnings)


def condition_currents(
    gps: tuple[GP, ...],
    train: ArmSamples,
    features: CurrentFeatures,
    dt: float,
    config: CurrentConfig,
) -> tuple[CurrentModel, tuple[float, ...]]:
    """The model with this prior given these samples, and the jitter of each joint's covariance.

    Raises:
        NotPositiveDefiniteError: a covariance matrix has no Cholesky factor.
    """
    inputs = inputs_of(train, features, config)
    phi, z, a = inputs
    predictors: list[Predictor] = []
    jitter: list[float] = []
    for j, gp in enumerate(gps):
        X = current_regressors(train, inputs, j)
        posterior = gp.condition(X, torch.from_numpy(train.i[:, j : j + 1]))
        jitter += jitter_of(posterior)
        predictors.append(Predictor.of(posterior, *parts(posterior.kernel), phi[j], z, a[:, j]))
    return CurrentModel(config, features, dt, gps, train, tuple(predictors)), tuple(jitter)


# One Gaussian process a joint, of the regressors [phi, what f sees, velocity of the joint] -------


def current_prior(features: CurrentFeatures, config: CurrentConfig) -> list[GP]:
    """The Gaussian process of each joint, before any data."""
    J = features.joints
    seen = {"PP": 0, "SP": 3 * J, "FC": 6 * J}[config.kind]
    return [
        GP(_kernel(len(kept) + 1, seen, config), noise_floor=_FLOOR, names=(joint,))
        for kept, joint in zip(features.kept, features.body.chain.joints, strict=True)
    ]


def current_regressors(
    samples: ArmSamples, inputs: tuple, joint: int
) -> Float[torch.Tensor, "N D"]:
    """Regressors of a joint's Gaussian process at the samples; `inputs` are of `inputs_of`."""
    phi, z, _ = inputs
    return torch.from_numpy(np.column_stack([phi[joint], z, samples.dq[:, joint]]))


def _kernel(p: int, seen: int, config: CurrentConfig) -> Kernel:
    width = p + seen + 1
    linear = ActiveDims(Linear(p, (1,), bias=False), range(p), width)
    if config.kind == "PP":
        return linear
    rbf = ActiveDims(RBF(seen, (1,)), range(p, p + seen), width)
    if config.kind == "SP":
        return linear + rbf
    return linear + Rescaled(rbf, GATES[config.gate](width - 1, config.quiet_speed))


def parts(kernel: Kernel) -> tuple[Linear, RBF | None]:
    """The linear kernel and the RBF kernel that a joint's kernel is made of."""
    found = {type(part): part for part in kernel.modules() if isinstance(part, Linear | RBF)}
    return found[Linear], found.get(RBF)  # type: ignore[return-value]
