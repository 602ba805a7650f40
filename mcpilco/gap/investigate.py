"""The whole workflow: from a plant and recordings to what is missing, and a corrected plant."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.gap.events import Event, events, outlying, outside, without_spikes
from mcpilco.gap.experiments import experiments
from mcpilco.gap.fit import Fit, fit, misfits, remembered, settle
from mcpilco.gap.learn import SHORT_S, learn, learned_of, moved
from mcpilco.gap.model import Model, scales
from mcpilco.gap.name import Found, Named, search, weigh
from mcpilco.gap.residual_force import explain, respond
from mcpilco.gap.show import Comparison, Models, compare, path, shrunk
from mcpilco.gap.validate import most_predictive
from mcpilco.gap.where import Disagreement, locate, located, structure
from mcpilco.gap.windows import SECONDS, Windows, cut
from mcpilco.plant import Active, Plant
from mcpilco.recordings import Recording, noise_std
from mcpilco.typing import InputError

ORDINARY = 3.0
"""times the usual misfit up to which a window holds no event"""
UNCERTAINTY = 0.01
"""prior std of masses, lengths, base friction and gains, relative to the nominal values"""
HELD_OUT, FEWEST_SPLIT = 0.42, 3
"""most of the samples that are held out; fewer recordings are not divided"""
STRUCTURED = 50.0
"""whiteness of residuals beyond which something may still be missing"""
PREDICTED = 0.3
"""part of what is left that forces of state and command explain, beyond which it is an effect"""
LEFT = 0.3
"""part of the gap that may be left over in any case"""
MOST = 0.1
"""part of the gap that effects may leave over and still stay where a force is learned too"""
LARGE, UNEVEN = 3.0, 3.0
"""misfit of a sample over the noise, and its unevenness, that no noise has"""
FEWEST = 6
"""windows without which nothing is named"""
EVERY_S = 0.3
"""between the starts of two held-out windows [s]"""
SEARCHED = 28
"""windows that a search looks at; the rest joins for the last fit"""


@dataclass(frozen=True)
class Gap:
    """What was found."""

    plant: Plant
    """nominal"""
    verdict: str
    """named, none, unknown or too_poor"""
    named: tuple[Named, ...]
    """effects that are missing"""
    corrected: Plant
    """the plant with them, its uncertain parameters as the data have them"""
    where: tuple[Disagreement, ...]
    """where the nominal plant disagrees with the recordings"""
    comparison: Comparison | None
    """errors on held-out recordings; None where the data are too poor"""
    events: tuple[Event, ...]
    """spans that no model explains: a push, a contact"""
    experiments: tuple[str, ...]
    """recordings that would settle what these cannot"""
    train: tuple[str, ...]
    """names of the recordings that were fitted"""
    held_out: tuple[str, ...]
    """names of the recordings on which the models are compared"""
    found: Found | None = None
    """the search"""
    models: Models | None = None
    """the models that were compared, to look at them further"""
    recordings: tuple[Recording, ...] = ()
    """all of them"""

    @property
    def mended(self) -> bool:
        """Whether the corrected plant has effects or learned forces that the nominal one lacks."""
        return bool(self.corrected.added[len(self.plant.added) :] or self.corrected.learned)


def investigate(
    plant: Plant,
    recordings: Sequence[Recording],
    *,
    uncertainty: float | Mapping[str, float] = UNCERTAINTY,
    free: Sequence[str] = (),
    noise: Mapping[str, float] | None = None,
) -> Gap:
    """Finds where a plant and recordings disagree, names the missing effects and adds them.

    Args:
        plant: nominal.
        recordings: of one sampling time, in the plant's states and inputs.
        uncertainty: prior std of the uncertain parameters relative to their values, one for all or
            by name.
        free: parameters of which nothing is known beforehand, by name.
        noise: std of the measurement noise of some states [their unit]; the others' is estimated.

    Raises:
        InputError: the recordings do not fit the plant or one another.
    """
    _check(plant, recordings)
    std = _noise(plant, recordings, noise or {})
    train, held_out = _split(recordings)
    everything = cut(recordings, std)
    if len(everything) < SEARCHED:
        everything = cut(recordings, std, every=0.5 * SECONDS)
    model = Model(plant, (), _priors(plant, uncertainty, free), scales(plant, everything))
    names = [tuple(recordings[n].name for n in part) for part in (train, held_out)]
    if len(everything) < FEWEST:
        return _too_poor(plant, everything, names)

    everything, masked = _without_events(model, everything)
    windows = everything[everything.of(train)]
    found = search(model, _some(windows), _candidates(plant, windows))
    found = found.choosing(most_predictive([f for f, _ in found.ranked], found.windows))
    best, windows = _finish(found.best, windows)
    far = outlying(best, windows)  # of what the best model leaves over
    masked, explained = _explained(best, windows, masked)
    masked = masked.joined(windows[far])
    if far.any() or len(explained):
        best, windows = _finish(best, windows[~far].joined(explained[explained.of(train)]))
    unseen = cut([recordings[n] for n in held_out], std, every=EVERY_S)
    null = _refit(found.null, windows)
    named = weigh(found, best, windows)
    verdict = "unknown" if _something_else(best, null, windows) else "named" if named else "none"
    where = locate(best if verdict == "unknown" else null, windows)
    spans, final = events(masked, recordings), best
    if verdict == "unknown":
        base = best if _explains_most(best, null, windows) else null
        every = windows.joined(masked[masked.of(train)])
        short = cut([recordings[n] for n in train], std, seconds=SHORT_S)
        learned = learn(base, _usable(base, every), _usable(base, short))
        others = events(_explained(moved(learned, windows), windows, masked)[0], recordings)
        clear = outside(others, unseen, names[1])
        if all(shrunk(known, learned, clear).low > 0.0 for known in (null, best)):
            spans, final = others, learned
            named = named if base is best else ()
            where = (*located(learned, windows), *where)
    models = Models(model, null, final, path(found, best) if named else ())
    return Gap(
        plant=plant,
        verdict=verdict,
        named=named,
        corrected=_corrected(final),
        where=where,
        comparison=compare(models, outside(spans, unseen, names[1])),
        events=spans,
        experiments=tuple(experiments(found, best, windows)),
        train=names[0],
        held_out=names[1],
        found=found,
        models=models,
        recordings=tuple(recordings),
    )


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

    It is at least that of rounding to the steps in which the values came.
    """
    found = np.stack([noise_std(recording) for recording in recordings])
    measured = np.stack([recording.measured for recording in recordings])
    std = np.ones(found.shape[1])
    for x, name in enumerate(plant.layout.states):
        if name in known:
            std[x] = known[name]
        elif measured[:, x].any():
            steps = max(recording.resolution[x] for recording in recordings) / math.sqrt(12.0)
            std[x] = max(float(np.median(found[measured[:, x], x])), steps, 1e-9)
    return std


def _split(recordings: Sequence[Recording]) -> tuple[list[int], list[int]]:
    """Numbers of the recordings to fit, and of the last ones, which are held out."""
    numbers = list(range(len(recordings)))
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


def _without_events(model: Model, windows: Windows) -> tuple[Windows, Windows]:
    """The windows to search, and those that hold an event: it must not be explained by effects."""
    theta = np.zeros(model.nuisances)
    kept = remembered(model, windows, theta, windows.guess)
    null = fit(model, kept, theta, settle(model, kept, theta, kept.guess))
    clean = without_spikes(null, windows)
    if not np.array_equal(clean.measured, windows.measured):
        kept = without_spikes(null, kept)
        null = fit(model, kept, null.theta, null.starts, iterations=5)
    far = outlying(null, kept)
    return clean[~far], clean[far]


def _explained(best: Fit, windows: Windows, masked: Windows) -> tuple[Windows, Windows]:
    """Of windows that seemed to hold an event, those that still do, and those that a model fits.

    Args:
        best: the model, fitted to the other windows.
        windows: these.
        masked: what seemed to be events.
    """
    if not len(masked):
        return masked, masked
    usual = float(np.median(best.by_window / windows.samples))
    kept = remembered(best.model, masked, best.theta, masked.guess)
    starts = settle(best.model, kept, best.theta, kept.guess)
    misfit = misfits(best.model, kept, best.theta, starts) / kept.samples
    fine = misfit < ORDINARY * max(1.0, usual)
    return masked[~fine], masked[fine]


def _candidates(plant: Plant, windows: Windows) -> list[Active]:
    """Effects that these recordings could show."""
    measured = np.any(windows.measured, axis=(0, 2))
    unseen = {name for x, name in enumerate(plant.layout.states) if not measured[x]}
    return [active for active in plant.candidates() if active.target not in unseen]


def _some(windows: Windows) -> Windows:
    """Windows for the search, from all recordings alike."""
    if len(windows) <= SEARCHED:
        return windows
    return windows[np.linspace(0, len(windows) - 1, SEARCHED).round().astype(int)]


def _finish(found: Fit, windows: Windows) -> tuple[Fit, Windows]:
    """The fit of a search on all windows, those that it has not seen included."""
    kept = remembered(found.model, windows, found.theta, windows.guess)
    return _refit(found, kept), kept


def _refit(found: Fit, windows: Windows) -> Fit:
    """The fit of a model on the windows as they are."""
    starts = settle(found.model, windows, found.theta, windows.guess)
    return fit(found.model, windows, found.theta, starts, iterations=15)


def _something_else(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether what the best model leaves over is neither noise nor of little account.

    Noise of sensors may be correlated as well, but then it is alike in all windows, and no force
    predicts it.
    """
    left, gap = structure(best, windows), structure(null, windows)
    if left.whiteness < STRUCTURED:
        return False
    if left.excess > LEFT * gap.excess and (left.excess > LARGE or left.unevenness > UNEVEN):
        return True
    return explain(respond(best, windows)).share > PREDICTED


def _explains_most(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether the effects of a model that does not fit are to stay beside what is learned."""
    left, gap = structure(best, windows), structure(null, windows)
    return bool(best.model.named) and left.excess < MOST * gap.excess


def _usable(base: Fit, windows: Windows) -> Windows:
    """Windows without what is read wrongly, as far as they remember their starts."""
    kept = remembered(base.model, windows, base.theta, windows.guess)
    return without_spikes(moved(base, kept), kept)


def _corrected(best: Fit) -> Plant:
    """The plant with the effects, parameters and learned forces of a fit."""
    parameters, _ = best.model.decode(best.theta[None])
    names = [parameter.name for parameter in best.model.plant.parameters]
    changed = {name: float(parameters[0, names.index(name)]) for name in best.model.priors}
    freed = len(best.model.freed)
    pairs = [(active, values[0]) for active, values in best.model.told(best.theta[None])[freed:]]
    return best.model.plant.where(**changed).having(pairs).with_learned(learned_of(best))


def _too_poor(plant: Plant, windows: Windows, names: Sequence[tuple[str, ...]]) -> Gap:
    experiment = (
        f"Record longer: at least {FEWEST} windows of one second are needed, "
        f"there are {len(windows)}. `mcpilco record --policy excitation` moves a plant so that "
        "effects show."
    )
    return Gap(plant, "too_poor", (), plant, (), None, (), (experiment,), names[0], names[1])
