"""Functions drawn from a GP posterior: the same wherever, and as often as, they are asked.

    (f | y)(x) = f(x) + k(x, X) (K + s^2 I)^-1 (y - f(X) - eps),    f ~ GP(0, k),  eps ~ N(0, s^2 I)

turns a draw from the prior into one from the posterior (Matheron's rule). To draw takes O(N^2) for
each particle, once; each value of the function O(N), where the posterior's variance takes O(N^2).

Reference: Wilson et al. 2020, "Efficiently sampling functions from Gaussian process posteriors",
and 2021, "Pathwise conditioning of Gaussian processes".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics.dynamics import GPDynamics
from mcpilco.gp import Posterior
from mcpilco.kernels import Monomials, Term
from mcpilco.typing import InputError

_MOST_SETS = 8
"""Particles share random frequencies in this many groups, or fewer that divide them evenly: an
average over all particles errs the less, and drawing takes the longer, the more there are."""


class PathSampler:
    """Draws functions from a posterior, whose kernel is a sum of canonical terms.

    What depends on the samples alone is computed once, here.
    """

    @torch.no_grad()
    def __init__(self, posterior: Posterior, features: int = 256) -> None:
        """A sampler.

        The posterior is of E outputs, given N samples. Each term that has an exponential factor has
        so many random Fourier `features`, half of them cosines, half sines: the error of the prior
        covariance falls with their root, the prior variance is exact. Terms without that factor are
        exact with any number.

        Raises:
            InputError: `features` is odd, or less than 2.
            NoCanonicalFormError: the kernel is not a sum of canonical terms.
        """
        if features < 2 or features % 2:
            raise InputError(
                f"features must be an even number of at least 2, cosines and sines, got {features}."
            )
        self.posterior = posterior
        terms = posterior.kernel.terms()
        polynomials = [term for term in terms if not bool(term.w.any())]
        self._parts: list[_Polynomial | _Bell] = [
            _Bell(term, posterior.X, features // 2) for term in terms if bool(term.w.any())
        ]
        if polynomials:
            self._parts.append(_Polynomial(polynomials, posterior.X))

    @torch.no_grad()
    def draw(self, particles: int, generator: torch.Generator) -> Paths:
        """A function for each particle and output.

        They are independent, but for the random frequencies, of which neighbours share a set.
        """
        posterior = self.posterior
        prior = [part.draw(particles, generator) for part in self._parts]
        eps = posterior.noise_std[:, None, None] * _normal(
            generator, len(posterior.noise_std), particles, len(posterior.X)
        )
        # v = (K + s^2 I)^-1 (y - f(X) - eps) = alpha - L^-T L^-1 (f(X) + eps)
        noisy = sum((path.at_samples() for path in prior), start=eps)
        v = posterior.alpha[:, None] - (noisy @ posterior.L_inv.mT) @ posterior.L_inv
        return Paths(tuple(path.given(v) for path in prior))


@dataclass(frozen=True, eq=False)
class Paths:
    """P functions of each of E outputs, differentiable in where they are asked."""

    summands: tuple[_PolynomialPath | _WavesAndBells, ...]
    """their values add up"""

    def __call__(self, regressors: Float[Tensor, "*b P D"]) -> Float[Tensor, "*b P E"]:
        """The value of each particle's functions at its own regressors, in each output's unit."""
        X = regressors[..., None, :, :]
        return reduce(add, (path(X) for path in self.summands)).mT


class PathwisePosterior:
    """A GP model of the next state, as a distribution over functions of the state and input."""

    noise_dim = 0
    """nothing is left to chance in a step of a draw"""

    def __init__(self, dynamics: GPDynamics, features: int = 256) -> None:
        """The functions that a model leaves possible.

        The law and the bounds of the `dynamics` hold for every draw; for `features` see
        `PathSampler`.

        Raises:
            InputError: `features` is odd, or less than 2, or the kernel has no canonical form.
        """
        self.dynamics = dynamics
        self.sampler = PathSampler(dynamics.posterior, features)

    def draw(self, particles: int, generator: torch.Generator) -> PathwiseDynamics:
        """Dynamics in which each particle has functions of its own."""
        return PathwiseDynamics(self.dynamics, self.sampler.draw(particles, generator))


@dataclass(frozen=True, eq=False)
class PathwiseDynamics:
    """The next state by functions drawn beforehand: a particle that returns meets what it met.

    Differs: the thesis draws the change of each step anew, independent of the steps before.
    """

    model: GPDynamics
    """whose regressors, law of the next state and bounds these are"""
    paths: Paths
    """the changes, as functions of the regressors; they take the place of its posterior"""

    noise_dim = 0
    """nothing is left to chance in a step"""

    def step(
        self,
        states: Float[Tensor, "P X"],
        inputs: Float[Tensor, "P U"],
        noise: Float[Tensor, "P 0"],
    ) -> Float[Tensor, "P X"]:
        """The next state of each particle."""
        regressors = self.model.regressors(states, inputs)
        return self.model.advance(states, inputs, self.paths(regressors))


# Parts of a kernel, and functions drawn from the prior of each ------------------------------------


class _Polynomial:
    """The sum of all terms without an exponential factor: finitely many features, and exact."""

    def __init__(self, terms: Sequence[Term], X: Float[Tensor, "N D"]) -> None:
        self.monomials = Monomials.of(terms)
        self.Phi = self.monomials(X[None]).expand(-1, len(X), -1)  # E N F

    def draw(self, particles: int, generator: torch.Generator) -> _PolynomialPath:
        outputs, _, features = self.Phi.shape
        return _PolynomialPath(self, _normal(generator, outputs, particles, features))


@dataclass(frozen=True, eq=False)
class _PolynomialPath:
    """f(x) = sum_f weights_f phi_f(x)."""

    part: _Polynomial
    weights: Float[Tensor, "E P F"]

    def at_samples(self) -> Float[Tensor, "E P N"]:
        return self.weights @ self.part.Phi.mT

    def given(self, v: Float[Tensor, "E P N"]) -> _PolynomialPath:
        # f(x) + k(x, X) v = phi(x)^T (weights + Phi^T v): the samples are needed no more
        return _PolynomialPath(self.part, self.weights + v @ self.part.Phi)

    def __call__(self, X: Float[Tensor, "*b 1 P D"]) -> Float[Tensor, "*b E P"]:
        return (self.part.monomials(X) * self.weights).sum(-1)


class _Bell:
    """exp(-1/2 |x - x'|^2_w) p(x, x'), with a polynomial p.

    In coordinates z = sqrt(w) (x - centre) the exponential factor is exp(-1/2 |z - z'|^2), whose
    random frequencies are standard normal.
    """

    def __init__(self, term: Term, X: Float[Tensor, "N D"], pairs: int) -> None:
        self.monomials = Monomials.of([term])
        self.root_w = term.w.sqrt()[:, None, :]
        self.centre = X.mean(0)
        self.pairs = pairs
        self.Z = self.whiten(X[None])  # E N D
        self.half_square = 0.5 * self.Z.square().sum(-1)[:, None, :]  # E 1 N
        self.Phi = self.monomials(X[None])  # E N F, or E 1 1 of a constant

    def whiten(self, X: Float[Tensor, "*b 1 M D"]) -> Float[Tensor, "*b E M D"]:
        """The coordinates z."""
        return (X - self.centre) * self.root_w

    def draw(self, particles: int, generator: torch.Generator) -> _Waves:
        outputs, _, width = self.Z.shape
        features = self.monomials.roots.shape[1]
        sets = max(s for s in range(1, _MOST_SETS + 1) if particles % s == 0)
        omega = _normal(generator, outputs, sets, self.pairs, width)
        a, b = _normal(generator, 2, outputs, particles, features, self.pairs) / self.pairs**0.5
        return _Waves(self, omega, a, b)


@dataclass(frozen=True, eq=False)
class _Waves:
    """f(x) = sum_f phi_f(x) sum_j (a_fj cos omega_j.z + b_fj sin omega_j.z), of the prior.

    Reference: Rahimi & Recht 2007, "Random features for large-scale kernel machines".
    """

    part: _Bell
    omega: Float[Tensor, "E S J D"]
    a: Float[Tensor, "E P F J"]
    b: Float[Tensor, "E P F J"]

    def at_samples(self) -> Float[Tensor, "E P N"]:
        phase = self.part.Z[:, None] @ self.omega.mT  # E S N J
        Phi = self.part.Phi.expand(-1, phase.shape[2], -1)
        a, b = (x.unflatten(1, (phase.shape[1], -1)) for x in (self.a, self.b))
        cosines = torch.einsum("esnj,esgfj,enf->esgn", phase.cos(), a, Phi)
        sines = torch.einsum("esnj,esgfj,enf->esgn", phase.sin(), b, Phi)
        return (cosines + sines).flatten(1, 2)

    def given(self, v: Float[Tensor, "E P N"]) -> _WavesAndBells:
        # a cos + b sin = amplitude cos(. + shift), which takes half the work
        amplitude, shift = torch.hypot(self.a, self.b), torch.atan2(-self.b, self.a)
        return _WavesAndBells(self.part, self.omega, amplitude, shift, v)


@dataclass(frozen=True, eq=False)
class _WavesAndBells:
    """Waves, which are the prior's, and bells around the samples: f(x) + k(x, X) v."""

    part: _Bell
    omega: Float[Tensor, "E S J D"]
    amplitude: Float[Tensor, "E P F J"]
    shift: Float[Tensor, "E P F J"]
    v: Float[Tensor, "E P N"]

    def __call__(self, X: Float[Tensor, "*b 1 P D"]) -> Float[Tensor, "*b E P"]:
        part = self.part
        z, phi = part.whiten(X), part.monomials(X)
        by_set = z.unflatten(-2, (self.omega.shape[1], -1))
        phase = (by_set @ self.omega.mT).flatten(-3, -2)[..., None, :]
        waves = (self.amplitude * torch.cos(phase + self.shift)).sum(-1)
        # -1/2 |z - z'|^2 = z.z' - 1/2 |z|^2 - 1/2 |z'|^2
        half_square = 0.5 * z.square().sum(-1, keepdim=True)
        bells = torch.exp(z @ part.Z.mT - half_square - part.half_square)
        return (waves * phi).sum(-1) + (bells * (phi @ part.Phi.mT) * self.v).sum(-1)


def _normal(generator: torch.Generator, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=generator, dtype=torch.float64)
