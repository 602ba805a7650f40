"""What MC-PILCO may take over from a corrected simulation."""

from __future__ import annotations

import math
from dataclasses import replace

from mcpilco.plant import Correction

LAG_TOLD = 3.0
"""time constants of a lag after which an input no longer matters"""
UNWRITTEN = ("backlash", "sensor_delay")
"""effects that the equations of a model do not hold"""


def as_mean(correction: Correction) -> Correction:
    """What of a correction can be written as the mean of a model; the rest is to be learned."""
    written = tuple(effect for effect in correction.effects if effect.name not in UNWRITTEN)
    return replace(correction, effects=written, learned=())


def remembered_inputs(correction: Correction, dt: float) -> int:
    """How many past inputs an actuator still answers to.

    Args:
        correction: of a plant.
        dt: time step of the policy [s].
    """
    late = [
        effect.parameters.get("d", 0.0) + LAG_TOLD * effect.parameters.get("T", 0.0)
        for effect in correction.effects
        if effect.name in ("actuator_delay", "actuator_lag")
    ]
    return math.ceil(sum(late) / dt)
