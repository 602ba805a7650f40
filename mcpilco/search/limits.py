"""Limits of states: chance constraints on a policy, kept by the search where no brake holds them.

A policy keeps the limits where a share of its particles, 99 % of them, stay within all of them at
every step. That a particle is outside has no gradient; how far it is beyond a margin before the
limit has one. Two things are made of that proxy. A particle loses what it had yet to gain: a policy
that comes to its goal outside gains nothing by it, and none is worse for having tried, as with a
penalty alone, under which the search ends at rest. And a policy that gains nothing anywhere is held
inside by a weight for each step. Weights ascend, late in the search, along the share of the
particles that are outside.

What a brake holds, see `mcpilco.policies.brake`, is no constraint of the search.

Reference: A. Cotter, H. Jiang, K. Sridharan, Two-player games for efficient non-convex constrained
optimization, Algorithmic Learning Theory 2019 (the proxy-Lagrangian).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import Limit
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

MARGIN = 0.2
"""how long before a limit its proxy begins, in parts of the way from the start [-]"""
LOSS, LOSES = 2.0, (0.2, 0.6)
"""at a limit what a particle has yet to gain falls by exp(-LOSS) a step; from nothing to that
between these shares of the search, for a goal is found more easily than kept [-]"""
LEAST_WEIGHT, RATE, ASCENDS = 0.05, 5.0, 0.6
"""of a step's proxy beside its cost; by how much it grows where all particles are outside; from
which share of the search on [-]"""
EXPLORED = 0.5
"""exploration ends an episode behind this share of the way from the start to a limit [-]"""


@dataclass(frozen=True)
class Limits:
    """Bounds of some states, of which most particles must stay within all at every step."""

    components: tuple[int, ...]
    """which state each bound is of"""
    signs: Float[Tensor, " L"]
    """+1 of an upper bound, -1 of a lower one"""
    starts: Float[Tensor, " L"]
    """mean of that state at reset, in its unit"""
    rooms: Float[Tensor, " L"]
    """the way from there to the bound, in its unit"""
    share: float
    """of the particles that must keep them [-]"""

    @classmethod
    def of(cls, limits: tuple[Limit, ...], share: float, task: TaskSpec) -> Self | None:
        """The bounds that limits by name set to a task's states; None where there are none.

        Raises:
            InputError: the task has no such state, or starts outside.
        """
        bounds = []
        for limit in limits:
            if limit.state not in task.state_names:
                raise InputError(
                    f"A limit must be of one of the states {', '.join(task.state_names)}, got "
                    f"{limit.state!r}."
                )
            i = task.state_names.index(limit.state)
            for sign, bound in ((-1.0, limit.low), (1.0, limit.high)):
                room = None if bound is None else sign * (bound - task.start_mean[i])
                if room is not None and room <= 3 * task.start_std[i]:
                    raise InputError(
                        f"The limit {bound:g} of {limit.state} must lie beyond its start, "
                        f"{task.start_mean[i]:g} ± {task.start_std[i]:g} {task.state_units[i]}, by "
                        "three standard deviations; widen it, or let episodes start elsewhere."
                    )
                if room is not None:
                    bounds.append((i, sign, task.start_mean[i], room))
        if not bounds:
            return None
        components, *numbers = zip(*bounds, strict=True)
        signs, starts, rooms = torch.tensor(numbers, dtype=torch.float64)
        return cls(tuple(components), signs, starts, rooms, share)

    def beyond(self, states: Float[Tensor, "*b X"]) -> Float[Tensor, "*b"]:
        """How far beyond the nearest limit: 0 at it, -1 at the start [-]."""
        way = (states[..., self.components] - self.starts) * self.signs
        return (way / self.rooms).amax(-1) - 1.0

    def kept(self, states: Float[Tensor, "T P X"]) -> float:
        """The share of the particles that stay within all limits at all steps [-]."""
        return float((self.beyond(states) <= 0).all(0).double().mean())


class Lagrangian:
    """The cost of one start of the search, with its limits: their weights at each step."""

    def __init__(self, limits: Limits, reference_cost: float, steps: int) -> None:
        """Weights as they begin, where a step costs so much without a policy."""
        self._limits, self._reference = limits, reference_cost
        self._weights = torch.full((steps,), LEAST_WEIGHT, dtype=torch.float64)

    def of(
        self, states: Float[Tensor, "T P X"], costs: Float[Tensor, "T P"], progress: float
    ) -> Tensor:
        """The objective that the search descends along [-]; the weights ascend.

        Of the states behind each step, their costs, and the share of the search that is done.
        """
        beyond = self._limits.beyond(states)
        near = torch.relu(1.0 + beyond / MARGIN)
        proxy = torch.where(near < 2.0, near.square(), 4.0 * (near - 1.0))
        begin, end = LOSES
        loss = LOSS * min(max((progress - begin) / (end - begin), 0.0), 1.0)
        kept = torch.exp(-loss * proxy.cumsum(0))
        gained = kept * (self._reference - costs)
        lagrangian = (self._reference - gained).mean(1).sum() + self._weights @ proxy.mean(1)
        if progress >= ASCENDS:
            outside = (beyond.detach() > 0).double().mean(1)
            ascent = RATE * (outside - (1.0 - self._limits.share))
            self._weights = (self._weights + ascent).clamp_min(LEAST_WEIGHT)
        return lagrangian
