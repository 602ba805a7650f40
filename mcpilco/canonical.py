"""Which models and policies the fast rollouts know: those with a canonical form."""

from __future__ import annotations

from mcpilco.dynamics import GPDynamics
from mcpilco.kernels.base import NoCanonicalFormError
from mcpilco.physics_dynamics import PhysicsDraw, PhysicsDynamics
from mcpilco.policies import SumOfGaussians
from mcpilco.typing import Dynamics, Policy, UncertainDynamics


def supports_physics(dynamics: Dynamics | UncertainDynamics, policy: Policy) -> bool:
    """Whether `mcpilco.fused` can roll these out: physics too, and features of it."""
    model = dynamics.model if isinstance(dynamics, PhysicsDynamics | PhysicsDraw) else dynamics
    return _canonical(model, policy)


def supports(dynamics: Dynamics | UncertainDynamics, policy: Policy) -> bool:
    """Whether `mcpilco.batched`, and so `mcpilco.fused`, can roll these out.

    They know a GP whose kernel is a sum of canonical terms, and a sum of Gaussians that sees the
    state as the GP does; `mcpilco.rollout` knows all.
    """
    if not isinstance(dynamics, GPDynamics) or dynamics.features or dynamics.C.any():
        return False
    return _canonical(dynamics, policy)


def _canonical(dynamics: object, policy: Policy) -> bool:
    if not (type(dynamics) is GPDynamics and type(policy) is SumOfGaussians):
        return False
    seen, acted = dynamics.augmentation, policy.augmentation
    if (seen.state_dim, seen.angles) != (acted.state_dim, acted.angles):
        return False
    try:
        dynamics.posterior.kernel.terms()
    except NoCanonicalFormError:
        return False
    return True
