"""Which rollout a configuration's `engine` stands for, on this machine."""

from __future__ import annotations

import functools
import logging
from types import ModuleType

from mcpilco.config import Config
from mcpilco.search import batched
from mcpilco.search.particles import RolloutFunction, rollout
from mcpilco.sensing import Foresight, LinearObserver
from mcpilco.typing import Dynamics, Observer, Policy, UncertainDynamics

logger = logging.getLogger(__name__)

KNOWN = (LinearObserver, Foresight)
"""observers that the compiled loops know"""


def rollout_of(
    config: Config,
    dynamics: Dynamics | UncertainDynamics,
    policy: Policy,
    observer: Observer | None = None,
) -> RolloutFunction:
    """The fastest rollout there is for this model and policy; all compute the same.

    Args:
        config: its engine `eager` asks for the plain rollout always, which knows one precision.
        dynamics: the model.
        policy: the policy.
        observer: what it acts behind, where it does not see the states.
    """
    fast = None if config.engine == "eager" else _fastest()
    if observer is not None and (fast is batched or type(observer) not in KNOWN):
        fast = None
    if fast is None or not fast.supports(dynamics, policy):
        if config.precision == "float32":
            logger.warning("This model and policy are rolled out in plain torch, in float64.")
        return rollout
    return functools.partial(fast.rollout, single=config.precision == "float32")


def warn_without_numba(error: ImportError) -> None:
    """Says what the compiled loops lack, and what happens instead."""
    logger.warning(
        "The compiled loops need numba (%s); torch computes the same, some times slower. "
        "Run `pip install numba`.",
        error,
    )


@functools.cache
def _fastest() -> ModuleType:
    """The compiled loops; where numba is missing, the same algorithm in torch."""
    try:
        from mcpilco.search import fused
    except ImportError as error:
        warn_without_numba(error)
        return batched
    return fused
