"""The whole workflow: from a plant and recordings to what is missing, and a corrected plant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mcpilco.gap.effort import LEARNING, Effort
from mcpilco.gap.events import Event, events, outlying, outside, without_spikes
from mcpilco.gap.exchange import exchanged
from mcpilco.gap.experiments import experiments
from mcpilco.gap.fit import Fit, fit, misfits, remembered, settle
from mcpilco.gap.given import FEWEST, UNCERTAINTY, Given
from mcpilco.gap.learn import SHORT_S, learn, learned_of, moved
from mcpilco.gap.model import Model
from mcpilco.gap.name import Named, certain
from mcpilco.gap.plain import plainer
from mcpilco.gap.quiet import foreseen, quiet
from mcpilco.gap.recurrence import recurring
from mcpilco.gap.refit import finish, refit
from mcpilco.gap.search import Found, search
from mcpilco.gap.show import Comparison, Models, compare, path
from mcpilco.gap.timing import likelier, timings
from mcpilco.gap.validate import most_predictive
from mcpilco.gap.verdict import explains_most, mispredicts, settled, something_else, worth
from mcpilco.gap.where import Disagreement, locate, located
from mcpilco.gap.windows import SECONDS, Windows
from mcpilco.plant import Own, Plant, own_effects
from mcpilco.recordings import Recording

ORDINARY = 3.0
"""times the usual misfit up to which a window holds no event"""
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
    held_out: Sequence[str] = (),
    effects: Own | Iterable[Own] = (),
) -> Gap:
    """Finds where a plant and recordings disagree, names the missing effects and adds them.

    Args:
        plant: nominal.
        recordings: of one sampling time, in the plant's states and inputs.
        uncertainty: prior std of the uncertain parameters relative to their values, one for all or
            by name.
        free: parameters of which nothing is known beforehand, by name.
        noise: std of the measurement noise of some states [their unit]; the others' is estimated.
        held_out: names of recordings that no fit may see; by default the last ones of three or
            more.
        effects: a user's own effects beside those of the catalogue, or Python files with them.

    Raises:
        InputError: the recordings do not fit the plant or one another.
    """
    plant = plant.knowing(own_effects(effects))
    sent = [
        Given.of(plant, timed, uncertainty, free, noise or {}, held_out)
        for timed in timings(recordings)
    ]
    sent = [replace(one, effort=sent[0].effort) for one in sent]  # one search, whatever it is of
    given = likelier(sent)
    everything = _windows(given)
    if len(everything) < FEWEST:
        return _too_poor(given, everything)

    found, best, windows, masked = _searched(given, everything)
    if (known := likelier(sent, best)) is not given:
        given = known
        found, best, windows, masked = _searched(given, _windows(given))
    recordings = given.recordings
    left, pushes = quiet(given, _closest(found, windows))
    place = recurring(pushes, given)
    if place is not None:  # what happens there each time is no push
        pushes = ()
    elif pushes:
        everything = _legible(best, _windows(left))
        found, best, *_ = _found(left, everything, everything[:0])
        given, pushes = quiet(given, best)
        everything = _legible(best, _windows(given))
        best, windows, masked = _finished(given, best, everything, everything[:0])
    null = refit(found.null, windows)
    found, best, named = certain(found, best, null, windows)
    missed = events(masked, recordings)
    spans, final = (*pushes, *missed), best
    clear = _clear(given, spans, best)
    unknown = place is not None or something_else(best, null, windows)
    unknown = unknown or (not settled(best, null, windows) and foreseen(missed, given, best))
    unknown = unknown or mispredicts(best, null, windows, clear)
    where = (*([place] if place else []), *locate(best if unknown else null, windows))
    if unknown and (learned := _learned(given, best, null, windows, masked)) is not None:
        named = named if learned.fit.model.named else ()
        spans, final = (*pushes, *learned.spans), learned.fit
        where = (*located(final, windows), *where)
    elif unknown and not worth(best, (null,), clear):
        named, final = (), null
    if final is not best:
        clear = _clear(given, spans, final)
    models = Models(found.null.model, null, final, path(found, best) if named else ())
    train, held_out = given.names
    return Gap(
        plant=plant,
        verdict="unknown" if unknown else "named" if named else "none",
        named=named,
        corrected=_corrected(final),
        where=where,
        comparison=compare(models, clear),
        events=spans,
        experiments=tuple(experiments(found, best, windows)),
        train=train,
        held_out=held_out,
        found=found,
        models=models,
        recordings=tuple(recordings),
    )


def _windows(given: Given) -> Windows:
    """Windows of all recordings, side by side, or where they are few overlapping by half."""
    windows = given.windows()
    return windows if len(windows) >= SEARCHED else given.windows(every=0.5 * SECONDS)


def _searched(given: Given, windows: Windows) -> tuple[Found, Fit, Windows, Windows]:
    """What `_found` tells of windows from which those that seem to hold an event were taken."""
    return _found(given, *_without_events(given.model(windows), windows))


def _found(
    given: Given, everything: Windows, masked: Windows
) -> tuple[Found, Fit, Windows, Windows]:
    """The search, its best model on all windows that it can explain, these, and those with events.

    Args:
        given: plant and recordings.
        everything: windows without events, of all recordings.
        masked: windows that seem to hold an event.
    """
    windows = everything[everything.of(given.train)]
    candidates = given.candidates(windows)
    found = exchanged(search(given.model(everything), _some(windows), candidates), candidates)
    found = plainer(found, candidates)
    found = found.choosing(most_predictive(found.fits, found.windows))
    return (found, *_finished(given, found.best, everything, masked))


def _finished(
    given: Given, best: Fit, everything: Windows, masked: Windows
) -> tuple[Fit, Windows, Windows]:
    """A model fitted to all windows that it can explain, these, and those with events.

    Args:
        given: plant and recordings.
        best: the model.
        everything: windows without events, of all recordings.
        masked: windows that seem to hold an event.
    """
    best, windows = finish(best, everything[everything.of(given.train)])
    legible = without_spikes(best, windows)
    if not np.array_equal(legible.measured, windows.measured):
        best, windows = refit(best, legible), legible
    far = outlying(best, windows)  # of what the best model leaves over
    masked, explained = _explained(best, windows, masked)
    if far.any() or len(explained):
        kept = windows[~far].joined(explained[explained.of(given.train)])
        masked = masked.joined(windows[far])
        best, windows = finish(best, kept)
    return best, windows, masked


def _closest(found: Found, windows: Windows) -> Fit:
    """The model that leaves over least, on all windows: what it misses is no effect of the list."""
    closest = min(found.fits, key=lambda known: known.chi2)
    return finish(closest, windows)[0]


def _clear(given: Given, spans: Sequence[Event], known: Fit) -> Windows:
    """Held-out windows without events, and without samples that a model shows to be misread."""
    windows = given.windows(given.held_out, every=EVERY_S)
    return _legible(known, outside(spans, windows, given.names[1]))


def _legible(known: Fit, windows: Windows) -> Windows:
    """The windows without samples that a model shows to be misread."""
    return without_spikes(moved(known, windows), windows)


@dataclass(frozen=True)
class _Learned:
    """A force that was learned in place of what no effect explains."""

    fit: Fit
    spans: tuple[Event, ...]
    """events that it does not explain either"""


def _learned(
    given: Given, best: Fit, null: Fit, windows: Windows, masked: Windows
) -> _Learned | None:
    """What is left over as a force; None where it does not shrink the held-out error."""
    base = best if explains_most(best, null, windows) else null
    base = replace(base, model=replace(base.model, effort=Effort.at(windows.dt, LEARNING)))
    every = windows.joined(masked[masked.of(given.train)])
    short = given.windows(given.train, seconds=SHORT_S)
    found = learn(base, _usable(base, every), _usable(base, short))
    spans = events(_explained(moved(found, windows), windows, masked)[0], given.recordings)
    clear = _clear(given, spans, found)
    return _Learned(found, spans) if worth(found, (null, best), clear) else None


def _without_events(model: Model, windows: Windows) -> tuple[Windows, Windows]:
    """The windows to search, and those that hold an event: it must not be explained by effects."""
    theta = np.zeros(model.nuisances)
    kept = remembered(model, windows, theta)
    null = fit(model, kept, theta, settle(model, kept, theta))
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
    kept = remembered(best.model, masked, best.theta)
    starts = settle(best.model, kept, best.theta)
    misfit = misfits(best.model, kept, best.theta, starts) / kept.samples
    fine = misfit < ORDINARY * max(1.0, usual)
    return masked[~fine], masked[fine]


def _some(windows: Windows) -> Windows:
    """Windows for the search, from all recordings alike."""
    if len(windows) <= SEARCHED:
        return windows
    return windows[np.linspace(0, len(windows) - 1, SEARCHED).round().astype(int)]


def _usable(base: Fit, windows: Windows) -> Windows:
    """Windows without what is read wrongly, as far as they remember their starts."""
    return _legible(base, remembered(base.model, windows, base.theta))


def _corrected(best: Fit) -> Plant:
    """The plant with the effects, parameters and learned forces of a fit."""
    parameters, _ = best.model.decode(best.theta[None])
    names = [parameter.name for parameter in best.model.plant.parameters]
    changed = {name: float(parameters[0, names.index(name)]) for name in best.model.priors}
    freed = len(best.model.freed)
    pairs = [(active, values[0]) for active, values in best.model.told(best.theta[None])[freed:]]
    return best.model.plant.where(**changed).having(pairs).with_learned(learned_of(best))


def _too_poor(given: Given, windows: Windows) -> Gap:
    experiment = (
        f"Record longer: at least {FEWEST} windows of one second are needed, "
        f"there are {len(windows)}. `mcpilco record --policy excitation` moves a plant so that "
        "effects show."
    )
    plant, names = given.plant, given.names
    return Gap(plant, "too_poor", (), plant, (), None, (), (experiment,), *names)
