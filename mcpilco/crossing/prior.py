"""The parts of a corrected simulation that MC-PILCO may take over as prior knowledge."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from mcpilco.plant import Correction, past_inputs


def as_mean(correction: Correction) -> Correction:
    """The part of a correction that equations can say as a model's mean; the rest is learned."""
    written = tuple(addition for addition in correction.effects if addition.effect.in_equations())
    return replace(correction, effects=written, learned=())


def remembered_inputs(correction: Correction, dt: float) -> int:
    """The number of past inputs that an actuator still answers to."""
    delay: dict[str, float] = defaultdict(float)
    lag: dict[str, float] = defaultdict(float)
    for addition in correction.effects:
        late = {"actuator_delay": delay, "actuator_lag": lag}.get(addition.name)
        if late is not None:
            late[addition.target] += addition.values[0]
    targets = {*delay, *lag}
    return max((past_inputs(delay[target], lag[target], dt) for target in targets), default=0)
