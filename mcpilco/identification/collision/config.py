"""The options of thresholds, which load nothing else: the command line shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ThresholdConfig:
    """How far a current may be from what is expected, and for how long."""

    quantile: float = 0.998
    """share of a joint's free samples below its threshold [-]; 1 is their maximum"""
    debounce: int = 3
    """an alarm is so many samples above the threshold, one after another"""
    rule: Literal["current", "deviations"] = "current"
    """thresholds in ampere, or in standard deviations that the posterior tells at each sample"""
    by_phase: bool = False
    """a threshold for joints that move, and another for joints that rest"""
