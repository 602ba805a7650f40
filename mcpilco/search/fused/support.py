"""Which models, policies and observers the compiled loops know: those with a canonical form."""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul
from typing import Any

from mcpilco.dynamics import GPDynamics, PhysicsDraw, PhysicsDynamics
from mcpilco.kernels import NoCanonicalFormError
from mcpilco.plant import Program, Real, cos, features_of, sin
from mcpilco.policies import SumOfGaussians
from mcpilco.search.fused.sensing import parts
from mcpilco.sensing import Observer
from mcpilco.typing import Dynamics, Policy, UncertainDynamics


def unknown(
    dynamics: Dynamics | UncertainDynamics, policy: Policy, observer: Observer | None = None
) -> str | None:
    """What of these the compiled loops cannot roll out, in words; None where they know all.

    They know a GP whose kernel is a sum of canonical terms, with physics as its mean or without,
    a sum of Gaussians that sees the state as the GP does, and linear estimators and delay models.
    """
    model = dynamics.model if isinstance(dynamics, PhysicsDynamics | PhysicsDraw) else dynamics
    if type(model) is not GPDynamics:
        return f"the model {type(model).__name__} (they know GPDynamics, sampled step by step)"
    if type(policy) is not SumOfGaussians:
        return f"the policy {type(policy).__name__} (they know SumOfGaussians)"
    seen, acted = model.augmentation, policy.augmentation
    if (seen.state_dim, seen.angles) != (acted.state_dim, acted.angles):
        return "a policy that sees other states or angles than the model"
    if observer is not None and parts(observer) is None:
        name = type(observer.estimator).__name__
        return f"the estimator {name} (they know LinearEstimator, DelayModel and a Chain of both)"
    try:
        model.posterior.kernel.canonical()
    except NoCanonicalFormError as error:
        return f"the kernel ({' '.join(str(error).split())})"
    return None


def canonical_features(dynamics: GPDynamics) -> Program | None:
    """The further regressors that a model's canonical terms see behind [z, u].

    These are its features, and linear combinations of all; None where there are none.
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
