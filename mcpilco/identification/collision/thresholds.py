"""From residuals to alarms: how far a current may be from what is expected, and for how long."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.identification.collision.model import CurrentModel
from mcpilco.recordings import ArmSamples
from mcpilco.typing import InputError

Rule = Literal["current", "deviations"]
_TAIL = 10
"""samples above a quantile that make it more than the luck of one"""


@dataclass(frozen=True)
class ThresholdConfig:
    """How thresholds are set, from samples without contact that no model was fitted to."""

    quantile: float = 0.998
    """share of the samples of a joint that shall be below its threshold [-]; 1 is their maximum"""
    debounce: int = 3
    """an alarm is so many samples above the threshold, one after another, in one joint"""
    rule: Rule = "current"
    """a number of ampere, or of the standard deviations that the posterior tells at a sample"""
    by_phase: bool = False
    """a threshold for joints that move and one for joints that rest, in place of one for both"""


@dataclass(frozen=True)
class Thresholds:
    """sigma_CD of each joint, thesis section 4.2."""

    config: ThresholdConfig
    moving: Float[np.ndarray, " J"]
    """where the joint moves [A, or standard deviations]"""
    resting: Float[np.ndarray, " J"]
    """where it is quasi-static, in the same unit"""

    def __call__(self, model: CurrentModel, samples: ArmSamples) -> Float[np.ndarray, "N J"]:
        """What the residuals of these samples must not exceed [A]."""
        limits = np.where(model.quiet(samples), self.resting, self.moving)
        return limits * model.std(samples) if self.config.rule == "deviations" else limits


def thresholds(
    model: CurrentModel, samples: ArmSamples, config: ThresholdConfig | None = None
) -> Thresholds:
    """The thresholds below which a share of these samples is.

    Args:
        model: of the currents.
        samples: without any contact; those that the model was fitted to give thresholds that are
            too low.
        config: how they are set.

    Raises:
        InputError: the numbers make no sense, or there are too few samples for the quantile.

    Reference: thesis section 4.2 leaves the rule open; section 4.6.2 takes the maximum.
    Differs: a quantile, for the maximum is set by the few samples in which a joint breaks loose.
    """
    config = config or ThresholdConfig()
    _check(config, len(samples))
    size = np.abs(samples.i - model.mean(samples))
    if config.rule == "deviations":
        size = size / model.std(samples)
    still = model.quiet(samples)
    if not config.by_phase:
        both = np.quantile(size, config.quantile, axis=0, method="higher")
        return Thresholds(config, both, both)
    names = model.joints
    moving, resting = (
        np.array([_quantile(size[at[:, j], j], config, names[j], word) for j in range(len(names))])
        for at, word in ((~still, "moves"), (still, "rests"))
    )
    return Thresholds(config, moving, resting)


def _check(config: ThresholdConfig, count: int) -> None:
    if not 0.5 <= config.quantile <= 1.0:
        raise InputError(f"quantile must be within 0.5..1, got {config.quantile:g}; try 0.998.")
    if config.debounce < 1:
        raise InputError(f"debounce must be at least 1 sample, got {config.debounce}.")
    _require_tail(config, count, "")


def _require_tail(config: ThresholdConfig, count: int, when: str) -> None:
    needed = _TAIL / max(1.0 - config.quantile, 1e-12) if config.quantile < 1.0 else 100
    if count < needed:
        raise InputError(
            f"a quantile of {config.quantile:g} needs at least {needed:.0f} samples without "
            f"contact{when}, got {count}; record for longer, or lower the quantile."
        )


def _quantile(size: np.ndarray, config: ThresholdConfig, joint: str, word: str) -> float:
    _require_tail(config, len(size), f" in which {joint} {word}")
    return float(np.quantile(size, config.quantile, method="higher"))


def debounced(over: Bool[np.ndarray, "N J"], count: int) -> Bool[np.ndarray, "N J"]:
    """Where `over` has been true for this and the `count` - 1 samples before."""
    found = over.copy()
    for back in range(1, count):
        found[back:] &= over[:-back]
        found[:back] = False
    return found
