"""Which models and policies the fast rollouts know: those with a canonical form."""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul
from typing import Any

from mcpilco.dynamics import GPDynamics, PhysicsDraw, PhysicsDynamics
from mcpilco.kernels import NoCanonicalFormError
from mcpilco.plant import Program, Real, cos, features_of, sin
from mcpilco.policies import SumOfGaussians
from mcpilco.typing import Dynamics, Policy, UncertainDynamics


def supports_physics(dynamics: Dynamics | UncertainDynamics, policy: Policy) -> bool:
    """Whether `mcpilco.search.fused` can roll these out: physics too, and features of it."""
    model = dynamics.model if isinstance(dynamics, PhysicsDynamics | PhysicsDraw) else dynamics
    return _canonical(model, policy)


def supports(dynamics: Dynamics | UncertainDynamics, policy: Policy) -> bool:
    """Whether `mcpilco.search.batched`, and so `mcpilco.search.fused`, can roll these out.

    They know a GP whose kernel is a sum of canonical terms of [z, u], and a sum of Gaussians that
    sees the state as the GP does; `mcpilco.search.particles` knows all.
    """
    if not isinstance(dynamics, GPDynamics) or dynamics.C.any():
        return False
    return _canonical(dynamics, policy) and canonical_features(dynamics) is None


def canonical_features(dynamics: GPDynamics) -> Program | None:
    """What a model's canonical terms see behind [z, u]: its features, and combinations of all.

    None where they see nothing more.
    """
    W = dynamics.posterior.kernel.canonical().W
    if not W.shape[1]:
        return dynamics.features
    seen = dynamics.augmentation

    def rows(given: Sequence[Real]) -> list[Any]:
        angles = [given[i] for i in seen.angles]
        z = [*(given[i] for i in seen.plain), *map(cos, angles), *map(sin, angles)]
        further = [] if dynamics.features is None else dynamics.features.on_tape(given)
        x = [*z, *given[seen.state_dim :], *further]
        return further + [sum(map(mul, column, x)) for column in W.T.tolist()]

    return features_of(seen.state_dim + dynamics.C.shape[1], [rows])[0]


def _canonical(dynamics: object, policy: Policy) -> bool:
    if not (type(dynamics) is GPDynamics and type(policy) is SumOfGaussians):
        return False
    seen, acted = dynamics.augmentation, policy.augmentation
    if (seen.state_dim, seen.angles) != (acted.state_dim, acted.angles):
        return False
    try:
        dynamics.posterior.kernel.canonical()
    except NoCanonicalFormError:
        return False
    return True
