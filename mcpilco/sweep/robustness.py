"""Over which directions a policy holds: its success where one number of the plant is another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mcpilco.plant import Plant, correction_of, moved, opened
from mcpilco.sweep.job import Act, FreshEpisodes

FACTORS = (0.5, 0.7, 0.85, 1.0, 1.15, 1.3, 1.5)
"""times its own value that a number takes [-]"""


@dataclass(frozen=True)
class Direction:
    """A policy's success over one number of the plant, the others as they are."""

    name: str
    """of a parameter, or `effect.target.symbol`"""
    value: float
    """its own, in its unit"""
    unit: str
    success: tuple[float, ...]
    """share of fresh episodes, for each of `FACTORS` [-]"""


def directions(
    plant: Plant,
    env: str,
    env_kwargs: Mapping[str, Any],
    begin: Callable[[], Act],
    horizon: int,
    seed: int,
    episodes: int = 20,
) -> list[Direction]:
    """The success of a policy over each number of a plant that may differ; none if it is not told.

    Args:
        plant: that the env simulates, effects included.
        env: id of an env with the keyword `effects`.
        env_kwargs: its keywords.
        begin: what makes the policy act.
        horizon: steps of an episode.
        seed: of starts and noises; those of all plants are alike.
        episodes: fresh ones for each plant.

    Raises:
        EnvError: the env cannot be made.
    """

    def success(values: Mapping[str, float]) -> float | None:
        there = {**env_kwargs, "effects": correction_of(moved(plant, values))}
        with FreshEpisodes(env, there, episodes, horizon) as fresh:
            told = fresh.outcomes(begin, seed, 0).get("is_success")
        return None if told is None else float(told.mean())

    own = success({})
    if own is None:
        return []
    certain = {p.name for p in plant.parameters if not p.uncertain}
    numbers = [p for p in opened(plant).parameters if p.value != 0.0 and p.name not in certain]
    return [
        Direction(
            p.name,
            p.value,
            p.unit,
            tuple(own if f == 1.0 else success({p.name: f * p.value}) or 0.0 for f in FACTORS),
        )
        for p in numbers
    ]
