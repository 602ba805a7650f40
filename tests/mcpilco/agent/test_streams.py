"""Laws of a training's random numbers: repeatable, and independent of one another."""

from __future__ import annotations

import numpy as np
import torch

from mcpilco.agent.episode import Streams


def draws(seed: int, trial: int) -> list[float]:
    """The first number of each stream."""
    streams = Streams(seed)
    return [
        streams.inputs(trial).random(),
        np.random.default_rng(streams.reset(trial)).random(),
        float(torch.rand(1, generator=streams.search(trial))),
    ]


def test_equal_seeds_and_trials_draw_the_same_in_any_order() -> None:
    forwards = [draws(5, trial) for trial in range(4)]
    backwards = [draws(5, trial) for trial in reversed(range(4))]
    assert forwards == backwards[::-1]


def test_each_use_trial_and_seed_draws_its_own() -> None:
    """The inputs of an exploration and the env's first start had one stream once."""
    numbers = [x for seed in range(5) for trial in range(5) for x in draws(seed, trial)]
    assert len(set(numbers)) == len(numbers)


def test_a_reset_is_seeded_below_what_fresh_episodes_use() -> None:
    assert all(0 <= Streams(seed).reset(trial) < 2**32 for seed in (0, 2**40) for trial in (0, 9))
