"""The cost of a batch of seeds: in one call where it takes leading axes, else seed by seed."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.search import Problem
from mcpilco.typing import Cost

logger = logging.getLogger(__name__)


class CostBatch:
    """Costs of particles of S seeds that learn the same task.

    A cost that follows its protocol takes any leading axes. A user's may not: so the first call
    compares one call for all seeds with one call a seed, and where they differ it stays with these.
    """

    def __init__(self) -> None:
        self._together: bool | None = None

    def __call__(
        self,
        problems: Sequence[Problem],
        states: Float[Tensor, "S T_plus_1 P X"],
        inputs: Float[Tensor, "S T P U"],
        widening: float = 1.0,
    ) -> Float[Tensor, "S T P"]:
        """The cost of each particle at the end of each step [-].

        Args:
            problems: of the seeds.
            states: the start, and the state after each step.
            inputs: before each step.
            widening: how many times as wide the costs are taken.
        """
        after = states[:, 1:]
        if self._together is None:
            self._together = _takes_seeds([problem.cost for problem in problems], after, inputs)
        if self._together:
            return problems[0].widened(widening).cost(after, inputs)
        costs = [problem.widened(widening).cost for problem in problems]
        return _one_by_one(costs, after, inputs)


def _one_by_one(costs: Sequence[Cost], states: Tensor, inputs: Tensor) -> Tensor:
    each = zip(costs, states, inputs, strict=True)
    return torch.stack([cost(state, before) for cost, state, before in each])


@torch.no_grad()
def _takes_seeds(costs: Sequence[Cost], states: Tensor, inputs: Tensor) -> bool:
    """Whether the first cost, called with all seeds at once, answers what each seed's answers."""
    expected = _one_by_one(costs, states, inputs)
    try:
        found = costs[0](states, inputs)
        if found.shape == expected.shape and torch.allclose(found, expected, equal_nan=True):
            return True
        reason = f"it answers with shape {tuple(found.shape)}, or with other values"
    except Exception as error:  # whatever a user's cost may raise
        reason = f"{type(error).__name__}: {error}"
    logger.warning(
        "The cost does not take a batch of seeds (%s); it is called seed by seed.", reason
    )
    return False
