"""PILCO's policy, and its prediction: one Gaussian over the state, step by step, in closed form.

The policy is the mean of a Gaussian process through a few points, squashed by sines. The prediction
is one differentiable operation of torch, of loops that numba compiles.

The entries of the joint Gaussian of a step, in order: the state, sines and cosines of its angles,
the policy's argument, the input, the changes of the state.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numba import njit
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from baselines.moments.compiled import bases as compiled_bases
from baselines.moments.compiled import waves as compiled_waves
from baselines.moments.compiled.bases import Functions, trace
from baselines.moments.compiled.waves import OUTERMOST, Waves
from baselines.moments.image import Bases, Gaussian
from mcpilco.compiling import digest
from mcpilco.dynamics import AngleAugmentation
from mcpilco.policies import Bounds, Dropout, Squash

POINT_STD = 0.01
"""noise of the points that the mean goes through, in parts of the prior's standard deviation [-]"""


class SineSquash(Squash):
    """u = centre + half_range (9 sin a + sin 3a) / 8: any number becomes an input within bounds.

    Reference: DFR (see `baselines.moments.image`). Differs: PILCO's bounds are symmetric.
    """

    def __init__(self, low: Bounds, high: Bounds) -> None:
        super().__init__(low, high, scale=1.0)

    def forward(self, a: Float[Tensor, "*b U"]) -> Float[Tensor, "*b U"]:
        return self.centre + self.half_range * (9.0 * a.sin() + (3.0 * a).sin()) / 8.0


class GPMean(nn.Module):
    """The mean of a Gaussian process on the augmented state z, squashed into the input's bounds.

        a(z) = k(z, C) (k(C, C) + s^2 I)^-1 t,    k(z, z') = exp(-1/2 |(z - z') / l|^2)

    Centres C, targets t and lengthscales l are trained: of 10 centres for the cart-pole 65 numbers.

    Reference: DFR on nonlinear controllers, a deterministic Gaussian process.
    """

    def __init__(
        self, augmentation: AngleAugmentation, low: Bounds, high: Bounds, centres: int
    ) -> None:
        """A policy that always answers the middle of its bounds; `randomise` gives it a start.

        Inputs go from `low` to `high`, in the env's unit; `centres` is B, the number of points.

        Raises:
            InputError: the bounds are not finite or not ordered.
        """
        super().__init__()
        self.augmentation = augmentation
        self.squash = SineSquash(low, high)
        inputs, width = len(low), augmentation.width
        self.centres = nn.Parameter(torch.zeros(centres, width, dtype=torch.float64))
        self.targets = nn.Parameter(torch.zeros(centres, inputs, dtype=torch.float64))
        self.log_lengthscale = nn.Parameter(torch.zeros(inputs, width, dtype=torch.float64))

    @torch.no_grad()
    def randomise(
        self,
        states: Float[Tensor, "B X"],
        lengthscale: Float[Tensor, " Z"],
        target_std: float,
        generator: torch.Generator,
    ) -> None:
        """Draw a new start in place."""
        self.centres.copy_(self.augmentation(states))
        normal = torch.randn(self.targets.shape, generator=generator, dtype=torch.float64)
        self.targets.copy_(target_std * normal)
        self.log_lengthscale.copy_(lengthscale.log().expand_as(self.log_lengthscale))

    def bases(self) -> Bases:
        """a as a sum of Gaussians around the centres, differentiable in the parameters."""
        lengthscale = self.log_lengthscale.exp()
        scaled = self.centres / lengthscale[:, None, :]
        K = torch.exp(-0.5 * (scaled[:, :, None, :] - scaled[:, None, :, :]).square().sum(-1))
        noise = POINT_STD**2 * torch.eye(len(self.centres), dtype=K.dtype)
        weights = torch.linalg.solve(K + noise, self.targets.mT)
        return Bases(self.centres, lengthscale, K.new_ones(len(K)), weights)

    def forward(
        self, states: Float[Tensor, "*b X"], dropout: Dropout | None = None, step: int = 0
    ) -> Float[Tensor, "*b U"]:
        """The inputs for a set of states, in the env's unit; there is no dropout."""
        bases = self.bases()
        z = self.augmentation(states)[..., None, None, :]
        distance = (z - bases.centres) / bases.lengthscale[:, None, :]
        k = torch.exp(-0.5 * distance.square().sum(-1))
        return self.squash((k * bases.weights).sum(-1))


_join_waves, _waves_back = compiled_waves.join, compiled_waves.join_back
_join_bases, _bases_back = compiled_bases.join, compiled_bases.join_back


class Steps(NamedTuple):
    """The stages of a step."""

    trig: Waves
    """sines and cosines of the angles"""
    squash: Waves
    """the input, of the policy's argument"""
    z: np.ndarray
    """(Z,) entries that the policy sees"""
    zu: np.ndarray
    """(Z + U,) entries that the model sees"""
    policy: Functions
    model: Functions
    A: np.ndarray
    """(X, J) from the joint to the next state"""


@dataclass(frozen=True)
class GaussianDynamics:
    """The step of a Gaussian state under a policy, by the posterior of the changes."""

    bases: Bases
    """of the E predicted changes, on regressors [z, u]"""
    augmentation: AngleAugmentation
    """from the state to z"""
    A: Float[Tensor, "X X"]
    """from the state to the next one"""
    B: Float[Tensor, "X E"]
    """from the predicted changes to the next state"""


def predicted(
    dynamics: GaussianDynamics, policy: GPMean, start: Gaussian, horizon: int
) -> tuple[Gaussian, Gaussian]:
    """The states at times 0 to T and the inputs between; gradients flow to the policy.

    The uncertainty of the functions is predicted, not the noise of measurements.

    Raises:
        torch.linalg.LinAlgError: a predicted covariance is none, for its numbers overflow.

    Reference: DFR on trajectory prediction.
    Differs: the law from changes to states is the model's, x' = A x + B delta.
    """
    bases = policy.bases()
    squash = policy.squash.centre.numpy(), policy.squash.half_range.numpy()
    arguments = dynamics, squash, start, horizon, bases
    mean, cov, mean_u, cov_u = _Prediction.apply(
        *arguments, bases.centres, bases.widths, bases.weights
    )
    return Gaussian(mean, cov), Gaussian(mean_u, cov_u)


class _Prediction(torch.autograd.Function):
    """(centres, widths, weights) of the policy -> means and covariances of states and inputs."""

    @staticmethod
    def forward(ctx, dynamics, squash, start, horizon, bases, *learned):
        steps = _steps(dynamics, squash, bases)
        width, joint = steps.A.shape
        mean, cov = np.zeros((horizon + 1, joint)), np.zeros((horizon + 1, joint, joint))
        mean[0, :width], cov[0, :width, :width] = start.mean.numpy(), start.cov.numpy()
        traces = trace(steps.policy, horizon), trace(steps.model, horizon)
        done = _forward(steps, mean, cov, *traces)
        if done < horizon:
            raise torch.linalg.LinAlgError(f"The covariance predicted for step {done} is none.")
        ctx.arrays = steps, mean, cov, *traces
        ctx.u = u = slice(int(steps.zu[len(steps.z)]), int(steps.zu[-1]) + 1)  # the inputs
        states = mean[:, :width], cov[:, :width, :width]
        inputs = mean[:-1, u], cov[:-1, u, u]
        return tuple(torch.from_numpy(part.copy()) for part in (*states, *inputs))

    @staticmethod
    @once_differentiable
    def backward(ctx, *gradients):
        steps, mean, cov, *traces = ctx.arrays
        width = len(steps.A)
        to_mean, to_cov = np.zeros_like(mean), np.zeros_like(cov)
        to_states, to_cov_states, to_inputs, to_cov_inputs = (g.numpy() for g in gradients)
        to_mean[:, :width], to_cov[:, :width, :width] = to_states, to_cov_states
        to_mean[:-1, ctx.u], to_cov[:-1, ctx.u, ctx.u] = to_inputs, to_cov_inputs
        policy = steps.policy
        learned = tuple(np.zeros_like(a) for a in (policy.centres, policy.widths, policy.weights))
        _backward(steps, mean, cov, *traces, to_mean, to_cov, learned)
        return *[None] * 5, *map(torch.from_numpy, learned)


def _steps(
    dynamics: GaussianDynamics, squash: tuple[np.ndarray, np.ndarray], bases: Bases
) -> Steps:
    middle, half = squash
    angles, plain = dynamics.augmentation.angles, dynamics.augmentation.plain
    X, U, K = len(dynamics.A), len(middle), 2 * len(angles)
    first_a, first_u = X + K, X + K + U
    a = np.arange(first_a, first_u)
    trig = Waves(
        source=np.repeat(np.array(angles, dtype=np.int64), 2),
        frequency=np.ones(K),
        shift=np.tile([0.0, np.pi / 2], len(angles)),
        W=np.eye(K),
        offset=np.zeros(K),
    )
    eye = np.diag(half) / 8.0
    waves = Waves(
        source=np.concatenate([a, a]),
        frequency=np.repeat([1.0, 3.0], U),
        shift=np.zeros(2 * U),
        W=np.concatenate([9.0 * eye, eye], 1),
        offset=middle.copy(),
    )
    sines = range(X, X + K, 2)
    z = np.array([*plain, *(i + 1 for i in sines), *sines], dtype=np.int64)
    A = np.zeros((X, first_u + U + dynamics.bases.outputs))
    A[:, :X], A[:, first_u + U :] = dynamics.A.numpy(), dynamics.B.numpy()
    return Steps(
        trig=trig,
        squash=waves,
        z=z,
        zu=np.concatenate([z, np.arange(first_u, first_u + U)]),
        policy=_functions(bases),
        model=_functions(dynamics.bases),
        A=A,
    )


def _functions(bases: Bases) -> Functions:
    N = bases.centres.shape[0]
    inverse = torch.zeros(0, N, N, dtype=torch.float64) if bases.inverse is None else bases.inverse
    parts = bases.centres, bases.widths, bases.variance, bases.weights, inverse
    return Functions(*map(_array, parts), torch.stack(bases.pairs).numpy())


def _array(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy())


def _loops(sources: str):
    """The loops over the steps, forwards and backwards."""

    @njit(**OUTERMOST)
    def forward(steps, mean, cov, by_policy, by_model):
        """Fill means and covariances of all steps; returns how many could be taken."""
        sources  # noqa: B018  closed over, so that a change in any of them compiles this anew
        X, J = steps.A.shape
        U, E = len(steps.squash.W), len(steps.model.variance)
        for t in range(len(mean) - 1):
            m, s = mean[t], cov[t]
            _join_waves(steps.trig, X, m, s)
            if not _join_bases(steps.policy, steps.z, J - E - 2 * U, m, s, by_policy, t):
                return t
            _join_waves(steps.squash, J - E - U, m, s)
            if not _join_bases(steps.model, steps.zu, J - E, m, s, by_model, t):
                return t
            mean[t + 1, :X] = np.dot(steps.A, m)
            following = np.dot(steps.A, np.dot(s, steps.A.T))
            cov[t + 1, :X, :X] = 0.5 * (following + following.T)
        return len(mean) - 1

    @njit(**OUTERMOST)
    def backward(steps, mean, cov, by_policy, by_model, to_mean, to_cov, learned):
        """Carry the gradients of all steps back to the policy's, which are added to."""
        sources  # noqa: B018
        X, J = steps.A.shape
        U, E = len(steps.squash.W), len(steps.model.variance)
        nothing = np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0))
        for t in range(len(mean) - 2, -1, -1):
            m, s, to_m, to_s = mean[t], cov[t], to_mean[t], to_cov[t]
            ahead = to_cov[t + 1, :X, :X].copy()
            to_m += np.dot(steps.A.T, to_mean[t + 1, :X])
            to_s += np.dot(steps.A.T, np.dot(0.5 * (ahead + ahead.T), steps.A))
            gradients = to_m, to_s
            _bases_back(steps.model, steps.zu, J - E, m, s, *gradients, by_model, t, nothing)
            _waves_back(steps.squash, J - E - U, m, s, *gradients)
            _bases_back(
                steps.policy, steps.z, J - E - 2 * U, m, s, *gradients, by_policy, t, learned
            )
            _waves_back(steps.trig, X, m, s, *gradients)

    return forward, backward


_FOLDERS = Path(compiled_bases.__file__).parent, Path(__file__).parent
_forward, _backward = _loops(digest(*_FOLDERS))
