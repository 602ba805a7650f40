"""Which rollout a configuration's `engine` stands for, on this machine."""

from __future__ import annotations

import functools
import logging
from types import ModuleType
from typing import Literal

from mcpilco import batched
from mcpilco.rollout import RolloutFunction, rollout
from mcpilco.typing import Dynamics, Policy, UncertainDynamics

logger = logging.getLogger(__name__)


def rollout_of(
    engine: Literal["fused", "eager"], dynamics: Dynamics | UncertainDynamics, policy: Policy
) -> RolloutFunction:
    """The fastest rollout there is for this model and policy; all compute the same.

    Args:
        engine: `eager` asks for the plain one always.
        dynamics: the model.
        policy: the policy.
    """
    if engine == "eager":
        return rollout
    fast = _fastest()
    return fast.rollout if fast.supports(dynamics, policy) else rollout


@functools.cache
def _fastest() -> ModuleType:
    """The compiled loops; where numba is missing, the same algorithm in torch."""
    try:
        from mcpilco import fused
    except ImportError as error:
        logger.warning(
            "The compiled loops need numba (%s); torch computes the same, some times slower. "
            "Run `pip install numba`.",
            error,
        )
        return batched
    return fused
