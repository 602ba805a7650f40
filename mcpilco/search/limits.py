"""Limits of states: chance constraints on a policy, kept by the search itself.

A policy keeps the limits where a share of its particles, 99 % of them, stay within all of them at
every step. That a particle is outside has no gradient; how far it is beyond a margin before the
limit has one. So the policy descends along the cost with that proxy added, weighed by a multiplier
for each step, and the multipliers ascend along the share of the particles that are outside.

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
FIRST_WEIGHT, LEAST_WEIGHT = 3.0, 1.0
"""of a step's proxy beside its cost, at first and at least [-]"""
RATE = 20.0
"""by how much a weight grows in a step in which all particles are outside [-]"""
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


class Multipliers:
    """The weights of the limits at each step, of one start of the search."""

    def __init__(self, limits: Limits, steps: int) -> None:
        self._limits = limits
        self._weights = torch.full((steps,), FIRST_WEIGHT, dtype=torch.float64)

    def penalty(self, states: Float[Tensor, "T P X"]) -> Tensor:
        """The part of the limits in the cost [-]; their weights ascend."""
        beyond = self._limits.beyond(states)
        proxy = torch.relu(1.0 + beyond / MARGIN).square().mean(1)
        penalty = self._weights @ proxy
        outside = (beyond.detach() > 0).double().mean(1)
        ascent = RATE * (outside - (1.0 - self._limits.share))
        self._weights = (self._weights + ascent).clamp_min(LEAST_WEIGHT)
        return penalty
