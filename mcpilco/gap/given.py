"""What an investigation is given: a plant, recordings, and what is known of both."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.effort import Effort
from mcpilco.gap.events import Event
from mcpilco.gap.model import Model, scales
from mcpilco.gap.windows import Windows, cut
from mcpilco.plant import EffectInstance, Plant
from mcpilco.recordings import Recording, noise_std
from mcpilco.typing import InputError

UNCERTAINTY = 0.01
"""prior std of masses, lengths, base friction and gains, relative to the nominal values"""
FINEST = 1e-4
"""least noise std of a state, as a part of the std of its values"""
FEWEST = 6
"""windows without which nothing is named"""
HELD_OUT, FEWEST_SPLIT = 0.42, 3
"""most of the samples that are held out; fewer recordings are not divided"""


@dataclass(frozen=True)
class Given:
    """A plant and recordings that fit one another."""

    plant: Plant
    """nominal"""
    recordings: tuple[Recording, ...]
    std: Float[np.ndarray, " X"]
    """of the noise of each state, in its unit"""
    priors: Mapping[str, float]
    """relative prior std of each uncertain parameter; inf frees it"""
    train: tuple[int, ...]
    """numbers of the recordings to fit"""
    held_out: tuple[int, ...]
    """numbers of those to compare models on; the same where there are too few"""
    effort: Effort = field(default_factory=Effort)
    """what it may cost, however often data are left out"""

    @classmethod
    def of(
        cls,
        plant: Plant,
        recordings: Sequence[Recording],
        uncertainty: float | Mapping[str, float],
        free: Sequence[str],
        noise: Mapping[str, float],
        held_out: Sequence[str] = (),
    ) -> Given:
        """What `investigate` is called with, checked and completed.

        Raises:
            InputError: the recordings do not fit the plant or one another.
        """
        _check(plant, recordings)
        std, priors = _noise(plant, recordings, noise), _priors(plant, uncertainty, free)
        train, unseen = _split(recordings, held_out)
        effort = Effort.at(recordings[0].dt)
        return cls(plant, tuple(recordings), std, priors, tuple(train), tuple(unseen), effort)

    @property
    def names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Of the recordings to fit, and of those to compare on."""
        return self._names(self.train), self._names(self.held_out)

    def _names(self, numbers: Sequence[int]) -> tuple[str, ...]:
        return tuple(self.recordings[n].name for n in numbers)

    def windows(self, numbers: Sequence[int] | None = None, **how: float) -> Windows:
        """Windows of some recordings, or of all.

        Args:
            numbers: of the recordings; None: all.
            how: as `cut` takes it.
        """
        chosen = self.recordings if numbers is None else [self.recordings[n] for n in numbers]
        return cut(chosen, self.std, **how)

    def without(self, spans: Sequence[Event]) -> Given:
        """The same with a gap in the recordings at each event."""
        by_name = {
            recording.name: tuple(
                (s.start_s, s.end_s) for s in spans if s.recording == recording.name
            )
            for recording in self.recordings
        }
        left = (replace(r, gaps=(*r.gaps, *by_name[r.name])) for r in self.recordings)
        return replace(self, recordings=tuple(left))

    def model(self, windows: Windows) -> Model:
        """The nominal plant, its uncertain parameters with their priors."""
        nominal = Model(self.plant, (), dict(self.priors), scales(self.plant, windows))
        return replace(nominal, effort=self.effort)

    def candidates(self, windows: Windows) -> list[EffectInstance]:
        """Effects that these recordings could show."""
        measured = np.any(windows.measured, axis=(0, 2))
        unseen = {name for x, name in enumerate(self.plant.layout.states) if not measured[x]}
        return [active for active in self.plant.candidates() if active.target not in unseen]


def _check(plant: Plant, recordings: Sequence[Recording]) -> None:
    if not recordings:
        raise InputError("investigate needs at least one recording, got none.")
    for recording in recordings:
        theirs = recording.state_names, recording.input_names
        ours = plant.layout.states, plant.layout.inputs
        if theirs != ours:
            raise InputError(
                f"the recording {recording.name!r} must have the states and inputs of "
                f"{plant.name}, {', '.join(ours[0] + ours[1])}, got "
                f"{', '.join(theirs[0] + theirs[1])}; read it with the plant's names."
            )


def _noise(
    plant: Plant, recordings: Sequence[Recording], known: Mapping[str, float]
) -> Float[np.ndarray, " X"]:
    """Noise std of each state: what is known, else the median over the recordings.

    It is at least that of rounding to the steps in which the values came, and the part `FINEST` of
    their spread: what a simulation without noise wrote is still no more exact than another one.
    """
    found = np.stack([noise_std(recording) for recording in recordings])
    measured = np.stack([recording.measured for recording in recordings])
    std = np.ones(found.shape[1])
    for x, name in enumerate(plant.layout.states):
        if name in known:
            std[x] = known[name]
        elif measured[:, x].any():
            steps = max(recording.resolution[x] for recording in recordings) / math.sqrt(12.0)
            spread = float(np.nanstd(np.concatenate([r.states[:, x] for r in recordings])))
            spread = min(spread, 1.0) if x in plant.angles else spread  # however often it turned
            std[x] = max(float(np.median(found[measured[:, x], x])), steps, FINEST * spread, 1e-9)
    return std


def _split(recordings: Sequence[Recording], held_out: Sequence[str]) -> tuple[list[int], list[int]]:
    """Numbers of the recordings to fit, and of those held out: by name, or the last ones."""
    numbers = list(range(len(recordings)))
    names = [recording.name for recording in recordings]
    if held_out:
        if not set(held_out) < set(names):
            raise InputError(
                f"held_out must be some of the recordings {', '.join(names)}, and leave one to "
                f"fit, got {', '.join(held_out)}."
            )
        unseen = [n for n in numbers if names[n] in held_out]
        return [n for n in numbers if n not in unseen], unseen
    if len(numbers) < FEWEST_SPLIT:
        return numbers, numbers
    lengths = np.array([len(recording) for recording in recordings])
    after = np.cumsum(lengths[::-1])[::-1] / lengths.sum()  # from each recording to the end
    first = min(int(np.argmax(after <= HELD_OUT)), numbers[-1]) if after[-1] <= HELD_OUT else -1
    return numbers[:first], numbers[first:]


def _priors(
    plant: Plant, uncertainty: float | Mapping[str, float], free: Sequence[str]
) -> dict[str, float]:
    """Relative prior std of each uncertain parameter; inf frees it."""
    names = [parameter.name for parameter in plant.parameters]
    by_name = uncertainty if isinstance(uncertainty, Mapping) else {}
    unknown = sorted({*by_name, *free} - {*names, "all"})
    if unknown:
        raise InputError(
            f"{plant.name} has no parameter {', '.join(unknown)}; it has {', '.join(names)}."
        )
    usual = UNCERTAINTY if isinstance(uncertainty, Mapping) else uncertainty
    priors = {
        parameter.name: float(by_name.get(parameter.name, usual))
        for parameter in plant.parameters
        if (parameter.uncertain or parameter.name in by_name) and parameter.value != 0.0
    }
    freed = [n for n in priors if "all" in free or n in free]
    freed += [name for name in free if name != "all" and name not in priors]
    priors |= dict.fromkeys(freed, np.inf)
    return {name: std for name, std in priors.items() if std > 0.0}
