"""The random force in each joint beside a plant's equations, and the evidence for a model with it.

No model of a machine is exact. Beside the equations a white force of unknown size acts in each
joint,

    M(q) dv = (forces(q, v, u, theta)) dt + sigma dw,        y_k = h(x_k) + e_k,

and what it may do to a motion weighs little in a fit. With G the response to forces that are held
for short intervals, residuals of a window have the covariance

    S = K + G D G^T,      D = diag(sigma_j^2),      K = diag(kappa_x^2),

the initial state's part eliminated. The sizes are those of the largest likelihood. A significant
sigma says in which joint something is missing, and how much; a kappa that is larger than reported,
in which reading. To first order, about motions that stay near what was measured, this is the
likelihood of an extended Kalman filter's innovations over the window.

Reference: Kristensen, Madsen & Jørgensen, Parameter estimation in stochastic grey-box models,
    Automatica 40 (2004); Harville, Maximum likelihood approaches to variance component
    estimation, JASA 72 (1977), for the eliminated initial states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize

from mcpilco.gap.data import Windows
from mcpilco.gap.fit import Fit, nearer
from mcpilco.gap.sensitivities import impulse_responses, lean
from mcpilco.gap.thresholds import DISTURBANCE, FORCE, VERDICT
from mcpilco.recordings import NoiseFilter, Whitening, following


@dataclass(frozen=True)
class Evidence:
    """How likely a model with random forces of its own makes some recordings."""

    deviance: float
    """-2 log likelihood, without a constant, with the random forces that fit best"""
    std: Float[np.ndarray, " J"]
    """of the random force in each joint, held for `FORCE.hold_s` [usual forces]"""
    noise: Float[np.ndarray, " X"]
    """std of each state's measurement noise over the reported one [-]"""
    samples: int
    """measured values beyond those that fix the initial states"""
    correlation: Float[np.ndarray, " X"]
    """of each state's measurement noise from one sample to the next [-]"""
    gain: Float[np.ndarray, " J"] | float = np.inf
    """of deviance by each random force that is not tiny, over more noise; of others it is 0"""

    @property
    def sure(self) -> Float[np.ndarray, " J"]:
        """The random forces without those of which noise does as much [usual forces]."""
        return np.where((self.std > VERDICT.force) & (self.gain < VERDICT.sure), 0.0, self.std)

    @property
    def deficient(self) -> bool:
        """Whether the model needs random forces, or noise, beyond what any machine has."""
        return bool((self.sure > VERDICT.force).any() or (self.noise > VERDICT.noise).any())

    @property
    def foreign(self) -> bool:
        """Whether the random force of a joint is larger than all that usually acts in it."""
        return bool((self.sure > VERDICT.whole).any())


@dataclass(frozen=True)
class Disturbance:
    """The response of the measurements of some windows to random forces."""

    windows: Windows
    columns: Float[np.ndarray, "W n m"]
    """response to a usual force in a joint over an interval [noise std]"""
    joint: Int[np.ndarray, " m"]
    """of each column"""

    @classmethod
    def of(
        cls, fit: Fit, windows: Windows, hold_s: float = FORCE.hold_s, near: bool = False
    ) -> Disturbance:
        """Responses to forces held for `hold_s` [s] along a fit's motions, `near` or made so."""
        fit = fit if near else nearer(fit, windows)
        layout, model = fit.model.plant.layout, fit.model
        hold, joints = max(1, round(hold_s / windows.dt)), range(len(layout.joints))
        responses = impulse_responses(model, windows, fit.theta, fit.x0, joints, hold, unstuck=True)
        usual = [model.scales[joint].force for joint in layout.joints]
        each = [force * change for force, change in zip(usual, responses, strict=True)]
        joint = np.repeat(np.arange(len(each)), each[0].shape[2])
        return cls(windows.plain, np.concatenate(each, axis=2), joint)

    def response(
        self, joint: int, forces: Float[np.ndarray, "k W m"], windows: Windows
    ) -> Float[np.ndarray, "W n k"]:
        """The response to some forces in a joint, each a train of pulses, weighed as `windows`.

        They are given midway between samples [usual forces].
        """
        first = np.arange(0, forces.shape[2], max(1, round(FORCE.hold_s / windows.dt)))
        train = np.add.reduceat(forces, first, axis=2) / np.diff(np.append(first, forces.shape[2]))
        change = np.einsum("wni,kwi->kwn", self.columns[:, :, self.joint == joint], train)
        change = change if windows.whitening is None else windows.whitening(change)
        return change.transpose(1, 2, 0)

    def evidence(self, fit: Fit, near: bool = False) -> Evidence:
        """The evidence for a fit, its initial states and random forces eliminated."""
        windows, fit = self.windows, fit if near else nearer(fit, self.windows)
        lin = fit.linearised(windows, lean)
        G = np.where(lin.lost[:, :, None], 0.0, self.columns)
        seen = windows.measured.reshape(lin.r.shape)
        G, r = (np.where(seen[:, :, None], part, 0.0) for part in (G, lin.r[:, :, None]))
        return _Likelihood(r, G, lin.basis, windows.measured, self.joint).largest()

    def whitened(self, evidence: Evidence) -> Windows:
        """The windows, what the random forces of a model may do weighing little in them.

        Noise that is smaller than was reported counts as it is. A model that misses much seems to
        have more of it in every reading, which is no reason to trust its data less.
        """
        noise, measured = np.maximum(evidence.noise, DISTURBANCE.least_noise), self.windows.measured
        common = max(float(noise.min()), 1.0)
        F = NoiseFilter.of(measured, noise / common, evidence.correlation)
        std = np.minimum(evidence.std, DISTURBANCE.most) / common
        G = np.where(measured.reshape(*F.a.shape, 1), self.columns * std[self.joint], 0.0)
        U, d, _ = np.linalg.svd(F.columns(G), full_matrices=False)
        return replace(self.windows, whitening=Whitening(F, U, 1.0 - 1.0 / np.sqrt(1.0 + d**2)))


@dataclass(frozen=True)
class _Likelihood:
    """That of the sizes of random forces and noise, with residuals in reported noise std."""

    r: Float[np.ndarray, "W n 1"]
    G: Float[np.ndarray, "W n m"]
    basis: Float[np.ndarray, "W n X"]
    """orthonormal, of what initial states can make"""
    seen: Bool[np.ndarray, "W X T"]
    """where there is a measurement"""
    joint: Int[np.ndarray, " m"]

    def largest(self) -> Evidence:
        """The evidence with the sizes that fit best, those of the noise in a few turns.

        Reference: MacKay, Bayesian interpolation, Neural Computation 4 (1992), eq. (4.8), for a
            noise's size by the squares over the degrees of freedom that they have.
        """
        X = self.seen.shape[1]
        noise, correlation = np.ones(X), np.zeros(X)
        given = _GivenNoise.of(self, noise, correlation)
        ratios = given.largest(np.full(int(self.joint.max()) + 1, DISTURBANCE.usual))
        for _ in range(DISTURBANCE.turns):
            squares, freedom, lagged, pairs = given.by_state(ratios)
            known = freedom > DISTURBANCE.least_freedom
            variance = np.where(known, squares / np.where(known, freedom, 1.0), 1.0)
            turned = np.maximum(np.sqrt(variance), DISTURBANCE.least_noise)
            slope = np.where(known, lagged / np.maximum(variance * pairs, 1e-12), 0.0)
            step = (1.0 - correlation**2) * slope
            correlated = np.clip(correlation + step, 0.0, DISTURBANCE.most_correlated)
            near = max(np.abs(np.log(turned / noise)).max(), np.abs(correlated - correlation).max())
            noise, correlation = turned, correlated
            given = _GivenNoise.of(self, noise, correlation)
            ratios = given.largest(ratios)
            if near < DISTURBANCE.same_noise:
                break
        deviance, _, _, common = given(ratios)
        std, gain = common * np.exp(0.5 * ratios), np.zeros(len(ratios))
        for joint in np.flatnonzero(std > DISTURBANCE.least):
            without = np.where(np.arange(len(ratios)) == joint, DISTURBANCE.ratios[0], ratios)
            gain[joint] = given(without)[0] - deviance
        return Evidence(deviance, std, common * noise, given.samples, correlation, gain)


@dataclass(frozen=True)
class _GivenNoise:
    """The likelihood of the random forces' sizes, up to a common factor of the noise."""

    r: Float[np.ndarray, "W n"]
    """without what initial states can make, like G; both in noise std"""
    G: Float[np.ndarray, "W n m"]
    Q: Float[np.ndarray, "W n X"]
    """orthonormal, of what initial states can make"""
    noise: Float[np.ndarray, " n"]
    """std of each reading [reported ones]"""
    seen: Bool[np.ndarray, "W X T"]
    joint: Int[np.ndarray, " m"]
    A: Float[np.ndarray, "W m m"]
    b: Float[np.ndarray, "W m"]
    squares: float
    """sum of those of r"""
    constant: float
    """of the deviance"""
    samples: int
    """readings beyond those that fix the initial states"""

    @classmethod
    def of(
        cls,
        whole: _Likelihood,
        noise: Float[np.ndarray, " X"],
        correlation: Float[np.ndarray, " X"],
    ) -> _GivenNoise:
        """That with some sizes of the noise, and correlations from one sample to the next."""
        seen = whole.seen
        F = NoiseFilter.of(seen, noise, correlation)
        Q, R = np.linalg.qr(F.columns(whole.basis))
        r, G = (A - Q @ (Q.transpose(0, 2, 1) @ A) for A in map(F.columns, (whole.r, whole.G)))
        samples = np.maximum(seen.sum(axis=(1, 2)) - len(noise), 0).sum()
        sizes = 2.0 * np.log(np.maximum(np.abs(np.einsum("wxx->wx", R)), 1e-300)).sum()
        constant = float(sizes) - 2.0 * float(np.log(F.a)[seen.reshape(F.a.shape)].sum())
        A, rows = np.matmul(G.transpose(0, 2, 1), G), np.repeat(noise, seen.shape[2])
        b = np.einsum("wni,wn->wi", G, r[:, :, 0])
        r, squares = r[:, :, 0], float(np.square(r).sum())
        return cls(r, G, Q, rows, seen, whole.joint, A, b, squares, constant, int(samples))

    def largest(self, start: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        """Logs of the variances that fit best, over that of the noise.

        They are sought over asinh(std / unit): where their responses would drown in the noise the
        deviance is a parabola of the std, and far above it almost one of its logarithm.
        """
        squares = np.einsum("wii->i", self.A) / len(self.A)
        count = np.maximum(np.bincount(self.joint), 1)
        unit = 1.0 / np.sqrt(np.maximum(np.bincount(self.joint, squares) / count, 1e-24))

        def ratios(x: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
            return np.clip(2.0 * np.log(np.abs(unit * np.sinh(x)) + 1e-300), *DISTURBANCE.ratios)

        @lru_cache(maxsize=2)
        def at(x: bytes) -> tuple[float, np.ndarray, np.ndarray]:
            here = np.frombuffer(x)
            deviance, slope, bend, _ = self(ratios(here))
            here = np.where(np.abs(here) < 1e-4, 1e-4, here)
            turned = 2.0 / np.tanh(here)
            bend = turned[:, None] * bend * turned
            return deviance, slope * turned, bend - np.diag(2.0 * slope / np.sinh(here) ** 2)

        found = minimize(
            lambda x: at(x.tobytes())[:2],
            np.maximum(np.arcsinh(np.exp(0.5 * start) / unit), DISTURBANCE.begun),
            jac=True,
            hess=lambda x: at(x.tobytes())[2],
            method="trust-exact",
            options={"gtol": DISTURBANCE.converged, "max_trust_radius": DISTURBANCE.farthest},
        )
        return ratios(found.x)

    def _forces(
        self, log_ratio: Float[np.ndarray, " J"]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Their std, the posterior precision and covariance in these, and its mean."""
        s, one = np.exp(0.5 * log_ratio)[self.joint], np.eye(len(self.joint))
        M = one + s[:, None] * self.A * s
        inverse = np.linalg.inv(M)
        return s, M, inverse, np.einsum("wij,wj->wi", inverse, s * self.b)

    def __call__(
        self, log_ratio: Float[np.ndarray, " J"]
    ) -> tuple[float, Float[np.ndarray, " J"], Float[np.ndarray, "J J"], float]:
        """Deviance, its slope and curvature at logs of variances; the noise's common factor."""
        s, M, inverse, z = self._forces(log_ratio)
        quad = self.squares - float((s * self.b * z).sum())  # squares that are left, and those of z
        least = (DISTURBANCE.least_noise / self.noise.min()) ** 2
        variance = max(quad / self.samples, least)
        logs = 2.0 * np.log(np.einsum("wii->wi", np.linalg.cholesky(M))).sum()
        deviance = self.samples * np.log(variance) + quad / variance + logs + self.constant
        by_joint = np.eye(len(log_ratio))[self.joint]  # sums over the forces of each
        certain = np.einsum("wii->i", inverse)
        taken = np.square(z).sum(axis=0) / variance
        slope = (len(z) - certain - taken) @ by_joint
        both = np.square(inverse) + 2.0 / variance * z[:, :, None] * inverse * z[:, None]
        bend = np.diag((certain + taken) @ by_joint) - by_joint.T @ both.sum(axis=0) @ by_joint
        if variance > least:
            bend -= np.outer(taken @ by_joint, taken @ by_joint) / self.samples
        return float(deviance), slope, bend, variance**0.5

    def by_state(self, log_ratio: Float[np.ndarray, " J"]) -> Float[np.ndarray, "4 X"]:
        """Squares that each state's readings leave, and their freedom; products with those before.

        Squares and products [reported variances]; last, how many of these there are. What forces
        and initial states take away from them is added.
        """
        s, _, inverse, z = self._forces(log_ratio)
        left = self.noise * (self.r - (self.G @ (s * z)[:, :, None])[:, :, 0])
        behind = following(self.seen)
        taking = np.concatenate([self.Q, self.G @ (s[:, None] * inverse)], axis=2)
        giving = np.concatenate([self.Q, self.G * s], axis=2)

        def taken(lag: int) -> Float[np.ndarray, "W n"]:
            rows = np.einsum("wni,wni->wn", taking[:, lag:], giving[:, : giving.shape[1] - lag])
            return np.pad(rows, ((0, 0), (lag, 0)))

        def total(part: np.ndarray, where: np.ndarray) -> Float[np.ndarray, " X"]:
            return np.where(where, part.reshape(self.seen.shape), 0.0).sum(axis=(0, 2))

        squares, freedom = total(left**2, self.seen), total(1.0 - taken(0), self.seen)
        variance = squares / np.maximum(freedom, 1e-12)
        lagged = total(left * np.roll(left, 1, axis=1), behind) + variance * total(taken(1), behind)
        return np.stack([squares, freedom, lagged, behind.sum(axis=(0, 2))])
