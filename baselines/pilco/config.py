"""The numbers of PILCO; the defaults are those of its authors' package for the cart-pole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mcpilco.config import Checked, Preset


@dataclass(frozen=True)
class PilcoConfig(Checked):
    """Everything the agent is told."""

    signal_to_noise: float = 1000.0
    """a GP whose signal is more times its noise, in standard deviations, is penalised [-]"""
    longest: float = 100.0
    """a lengthscale more times the standard deviation of its input is penalised [-]"""
    centres: int = 10
    """points that the policy's mean goes through"""
    lengthscale: float = 1.0
    """the policy's starting lengthscale of states that are no angle, in their units"""
    angle_lengthscale: float = 0.7
    """of cosines and sines [-]"""
    target_std: float = 0.1
    """the points' values start around zero with this spread [-]"""
    line_searches: int = 150
    """most steps of the optimiser in a trial"""
    evaluations: int = 500
    """most evaluations of the expected cost and its gradient in a trial"""
    cost: Literal["task", "tip"] = "task"
    """task: the task's own; tip: that of PILCO's cart-pole, of the distance of the pole's tip"""
    tip_length: float = 0.5
    """of the pole, for the cost `tip` [m]"""
    tip_width: float = 0.25
    """distance at which the cost `tip` is 1 - exp(-1/2) [m]"""
    horizon: int | None = None
    """steps of one episode; None takes the env's time limit"""
    exploration: int | None = None
    """steps of random inputs before the first trial; None: one horizon"""
    engine: Literal["compiled", "eager"] = "compiled"
    """how the prediction is computed: compiled loops, or plain torch with the same result; where
    numba is missing, torch takes the place of the loops"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(centres=1, line_searches=1, evaluations=2)
        self._positive("lengthscale", "angle_lengthscale", "target_std", "tip_length", "tip_width")
        for name in ("signal_to_noise", "longest"):
            self._above(name, 1.0)
        for name in ("horizon", "exploration"):
            if getattr(self, name) is not None:
                self._at_least(**{name: 1})


PRESETS: dict[str, Preset] = {
    "default": Preset("PILCO's numbers, with the cost of the task", PilcoConfig()),
    "tip": Preset("PILCO's numbers and its own cost of the cart-pole", PilcoConfig(cost="tip")),
}
