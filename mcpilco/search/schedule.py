"""The phases of a policy search, and the monitor that ends them."""

from __future__ import annotations

import math

from mcpilco.config import Phase, SearchConfig


class DriftMonitor:
    """Says when the cost no longer drifts.

    s = EMA(dJ) / sqrt(EMA variance), smoothed once more. The cost has settled when abs(s) stayed
    below a bound for the last `window` steps; the first `window` steps of all, while the averages
    fill, do not count.

    Reference: the authors' later setting (Amadio et al., IEEE T-RO 2022).
    """

    def __init__(self, decay: float = 0.99, window: int = 200) -> None:
        self.decay = decay
        self.window = window
        self.mean = 0.0
        self.variance = 0.0
        self.drift = 0.0
        self.last: float | None = None
        self.calm = -window

    def reset(self) -> None:
        """Begin a new phase; the averages are kept."""
        self.calm = 0

    def update(self, cost: float, bound: float) -> bool:
        """Whether the cost has settled, given its newest value; NaN is passed over."""
        if not math.isfinite(cost):
            return False
        if self.last is not None:
            change = cost - self.last
            surprise = change - self.mean
            self.mean += (1 - self.decay) * surprise
            self.variance = self.decay * (self.variance + (1 - self.decay) * surprise**2)
            standardised = self.mean / math.sqrt(self.variance) if self.variance > 0 else 0.0
            self.drift = self.decay * self.drift + (1 - self.decay) * standardised
        self.last = cost
        self.calm = 0 if self.calm >= 0 and abs(self.drift) >= bound else self.calm + 1
        return self.calm >= self.window


class Schedule:
    """Which phase a step belongs to, by shares of the steps or by a monitor of the cost."""

    def __init__(self, config: SearchConfig, steps: int, entered: int = 0) -> None:
        """A schedule.

        So many `steps` in all, of which those `entered` are taken as done.
        """
        self.phases = config.phases
        self.widest = config.widening
        self.steps = steps
        self.monitor = DriftMonitor() if config.monitored else None
        self.index = 0
        if not config.monitored:
            while self._passed(entered):
                self.index += 1

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return self.phases[self.index]

    def widening(self, step: int) -> float:
        """How many times as wide the cost is at a step, falling to 1 over the first half."""
        return max(1.0, self.widest + (1.0 - self.widest) * 2 * step / self.steps)

    def advance(self, step: int, cost: float) -> bool:
        """Take note of a finished step; False when the search is over."""
        if self.monitor is not None:
            if self.monitor.update(cost, self.phase.drift):
                if self._last:
                    return False
                self.monitor.reset()
                self.index += 1
        elif self._passed(step):
            self.index += 1
        return step < self.steps

    @property
    def _last(self) -> bool:
        return self.index == len(self.phases) - 1

    def _passed(self, step: int) -> bool:
        """Whether a step is beyond the present phase, and another one follows."""
        return not self._last and step >= self.phase.until * self.steps
