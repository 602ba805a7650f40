"""Which rollout a configuration's `engine` stands for, on this machine and for this model."""

from __future__ import annotations

import functools
import logging
from types import ModuleType
from typing import Literal

from mcpilco.config import Config
from mcpilco.search.particles import RolloutFunction, rollout
from mcpilco.sensing import Observer
from mcpilco.typing import Dynamics, Policy, UncertainDynamics

logger = logging.getLogger(__name__)
Loop = Literal["forward", "backward"]
"""that is compiled: over the steps of a rollout, and back over them"""


def rollout_of(
    config: Config,
    dynamics: Dynamics | UncertainDynamics,
    policy: Policy,
    observer: Observer | None = None,
) -> RolloutFunction:
    """The fastest rollout there is for this model and policy; all compute the same.

    Where the compiled loops cannot be had, or do not know the model, the policy or the observer,
    the plain rollout takes over with a warning, once for each reason.

    The engine `eager` asks for the plain rollout always, which computes in float64.
    """
    if config.engine == "eager":
        return rollout
    fused = _compiled_loops()
    if fused is None:
        return rollout
    if unknown := fused.unknown(dynamics, policy, observer):
        _warn_once(
            f"The compiled loops do not know {unknown}: particles are rolled out in plain torch, "
            "in float64, several times slower. Choose one that they know, or set the engine to "
            '"eager" if that is meant.'
        )
        return rollout
    return functools.partial(fused.rollout, single=config.precision == "float32")


def compiled_before() -> bool:
    """Whether compiled loops of today's code lie on disk, or there can be none."""
    fused = _compiled_loops()
    return fused is None or fused.is_on_disk()


def compile_only(loop: Loop) -> None:
    """Let this process compile one of the two loops; the other does nothing in it."""
    if (fused := _compiled_loops()) is not None:
        fused.skip("backward" if loop == "forward" else "forward")


@functools.cache
def _warn_once(sentence: str) -> None:
    logger.warning(sentence)


@functools.cache
def _compiled_loops() -> ModuleType | None:
    """The compiled loops; None, after a warning, where the processor lacks what they need."""
    try:
        from mcpilco.search import fused
    except ImportError as error:
        logger.warning(
            "The compiled loops cannot be had (%s); plain torch computes the same in float64, "
            "several times slower.",
            error,
        )
        return None
    return fused
