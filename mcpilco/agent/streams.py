"""The random numbers of a training, each a function of its seed, the trial and what they are for.

No generator's state goes from one trial to the next, so that a training which begins again at any
trial, from a file, draws what it would have drawn.

Reference: numpy's SeedSequence; streams of different spawn keys are independent.
"""

from __future__ import annotations

import numpy as np
import torch

_INPUTS, _RESET, _SEARCH = range(3)


class Streams:
    """Independent sources of random numbers for each trial; trial 0 is the exploration."""

    def __init__(self, seed: int) -> None:
        """Streams of one seed, which is not negative."""
        self.seed = seed

    def inputs(self, trial: int) -> np.random.Generator:
        """Source of the random inputs of an exploration."""
        return np.random.default_rng(self._sequence(trial, _INPUTS))

    def reset(self, trial: int, episode: int = 0) -> int:
        """The seed with which the env begins an episode of the trial, below 2^32."""
        later = (episode,) if episode else ()
        return int(self._sequence(trial, _RESET, *later).generate_state(1)[0])

    def search(self, trial: int) -> torch.Generator:
        """Source of the starts, particles and masks of a trial's policy search."""
        state = self._sequence(trial, _SEARCH).generate_state(1)
        return torch.Generator().manual_seed(int(state[0]))

    def _sequence(self, trial: int, *use: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=(trial, *use))
