"""The random force in each joint beside a plant's equations, and the evidence for a model with it.

No model of a machine is exact. Beside the equations a white force of unknown size acts in each
joint,

    M(q) dv = (forces(q, v, u, theta)) dt + sigma dw,        y_k = h(x_k) + e_k,

and what it may do to a motion weighs little in a fit. With G the response to forces that are held
for short intervals, residuals of a window have the covariance

    S = kappa^2 (I + G D G^T),      D = diag(sigma_j^2),

the initial state's part eliminated. The sizes are those of the largest likelihood. A significant
one says in which joint something is missing, and how much. To first order this is the likelihood
of an extended Kalman filter's innovations over the window.

Reference: Kristensen, Madsen & Jørgensen, Parameter estimation in stochastic grey-box models,
    Automatica 40 (2004); Harville, Maximum likelihood approaches to variance component
    estimation, JASA 72 (1977), for the eliminated initial states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize

from mcpilco.gap.data import Whitening, Windows
from mcpilco.gap.fit import Fit
from mcpilco.gap.sensitivities import impulse_responses, lean
from mcpilco.gap.thresholds import DISTURBANCE, FORCE, VERDICT


@dataclass(frozen=True)
class Evidence:
    """How likely a model with random forces of its own makes some recordings."""

    deviance: float
    """-2 log likelihood, without a constant, with the random forces that fit best"""
    std: Float[np.ndarray, " J"]
    """of the random force in each joint, held for `FORCE.hold_s` [usual forces]"""
    noise: float
    """std of the measurement noise over the reported one [-]"""
    samples: int
    """measured values beyond those that fix the initial states"""

    @property
    def deficient(self) -> bool:
        """Whether the model needs random forces, or noise, beyond what any machine has."""
        return bool((self.std > VERDICT.force).any() or self.noise > VERDICT.noise)


@dataclass(frozen=True)
class Disturbance:
    """The response of the measurements of some windows to random forces."""

    windows: Windows
    columns: Float[np.ndarray, "W n m"]
    """response to a usual force in a joint over an interval [noise std]"""
    joint: Int[np.ndarray, " m"]
    """of each column"""

    @classmethod
    def of(cls, fit: Fit, windows: Windows) -> Disturbance:
        """The responses along the motions of a fit."""
        layout, model = fit.model.plant.layout, fit.model
        hold = max(1, round(FORCE.hold_s / windows.dt))
        each = [
            model.scales[joint].force
            * impulse_responses(model, windows, fit.theta, fit.x0, j, hold)
            for j, joint in enumerate(layout.joints)
        ]
        joint = np.repeat(np.arange(len(each)), each[0].shape[2])
        return cls(replace(windows, whitening=None), np.concatenate(each, axis=2), joint)

    def evidence(self, fit: Fit) -> Evidence:
        """The evidence for a fit, its initial states and random forces eliminated."""
        windows = self.windows
        lin = lean(fit.model, windows, fit.theta, fit.x0)
        G = lin.cleaned(np.where(lin.lost[:, :, None], 0.0, self.columns))
        r = lin.cleaned(lin.r[:, :, None])[:, :, 0]
        seen = windows.measured.sum(axis=(1, 2))
        samples = int(np.maximum(seen - fit.x0.shape[1], 0).sum())
        return _Likelihood.of(r, G, self.joint, samples).largest()

    def whitened(self, evidence: Evidence) -> Windows:
        """The windows, what the random forces of a model may do weighing little in them.

        Noise that is smaller than was reported counts as it is; a model that misses much seems to
        have more of it, which is no reason to trust its data less.
        """
        std = np.minimum(evidence.std, DISTURBANCE.most) / max(evidence.noise, 1e-12)
        measured = self.windows.measured.reshape(len(self.windows), -1, 1)
        U, d, _ = np.linalg.svd(
            np.where(measured, self.columns * std[self.joint], 0.0), full_matrices=False
        )
        noise = min(max(evidence.noise, DISTURBANCE.least_noise), 1.0)
        white = Whitening(U, 1.0 - 1.0 / np.sqrt(1.0 + d**2), 1.0 / noise)
        return replace(self.windows, whitening=white)


@dataclass(frozen=True)
class _Likelihood:
    """That of the random forces' sizes, of residuals that no initial state could have made."""

    r: Float[np.ndarray, "W n"]
    G: Float[np.ndarray, "W n m"]
    joint: Int[np.ndarray, " m"]
    samples: int
    A: Float[np.ndarray, "W m m"]
    b: Float[np.ndarray, "W m"]

    @classmethod
    def of(cls, r: np.ndarray, G: np.ndarray, joint: np.ndarray, samples: int) -> _Likelihood:
        """That of `samples` residuals."""
        A = np.matmul(G.transpose(0, 2, 1), G)
        return cls(r, G, joint, samples, A, np.einsum("wni,wn->wi", G, r))

    def largest(self) -> Evidence:
        """The evidence with the sizes that fit best."""
        J = int(self.joint.max()) + 1
        found = minimize(
            lambda x: self(x)[:2],
            np.full(J, -2.0),
            jac=True,
            method="L-BFGS-B",
            bounds=[DISTURBANCE.ratios] * J,
        )
        deviance, _, noise = self(found.x)
        return Evidence(deviance, noise * np.exp(0.5 * found.x), noise, self.samples)

    def __call__(
        self, log_ratio: Float[np.ndarray, " J"]
    ) -> tuple[float, Float[np.ndarray, " J"], float]:
        """Deviance, its slope, and the noise, at logs of variances over that of the noise."""
        s, one = np.exp(0.5 * log_ratio)[self.joint], np.eye(len(self.joint))
        M = one + s[:, None] * self.A * s
        inverse = np.linalg.inv(M)
        z = np.einsum("wij,wj->wi", inverse, s * self.b)  # the forces, each in its std
        left = self.r - np.einsum("wni,wi->wn", self.G, s * z)
        quad = float(np.square(left).sum() + np.square(z).sum()) + 1e-300
        logs = 2.0 * np.log(np.einsum("wii->wi", np.linalg.cholesky(M))).sum()
        slope = (1.0 - np.einsum("wii->wi", inverse)).sum(axis=0)
        slope -= np.square(z).sum(axis=0) * self.samples / quad
        deviance = self.samples * (np.log(quad / self.samples) + 1.0) + logs
        noise = float(np.sqrt(quad / self.samples))
        return float(deviance), np.bincount(self.joint, slope, len(log_ratio)), noise
