"""The workflow: from a plant and recordings to what is missing, and a corrected plant."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mcpilco.gap.comparison import ComparedModels, compare, error_reduction
from mcpilco.gap.data import Event, GapProblem, Windows, apart, event_of, require_recordings_of
from mcpilco.gap.decide import (
    Closest,
    Weighed,
    closes_most,
    leaves_something,
    left_forces,
    mispredicts,
    named_effects,
    on_bounds,
    shifted_parameters,
    spread_of,
    weighed,
)
from mcpilco.gap.disagreement import (
    Disagreement,
    foreseen,
    located_force,
    located_misfit,
    recurring,
    spans_of,
    still_missed,
    windows_with_events,
    without_bursts,
    without_spikes,
)
from mcpilco.gap.fit import (
    Fit,
    fit_nominal,
    likeliest,
    on_windows,
    refit,
    refit_nominal,
    refit_truncated,
    truncated,
)
from mcpilco.gap.horizon import followed
from mcpilco.gap.learned_force import corrected, with_learned_force
from mcpilco.gap.plant_model import ComputeBudget
from mcpilco.gap.report import Gap, experiments, far_from_noise
from mcpilco.gap.search import SearchResult, nested_fits, search
from mcpilco.gap.thresholds import BUDGET, DATA, SEARCH, VERDICT
from mcpilco.plant import Own, Plant, own_effects
from mcpilco.recordings import (
    Recording,
    at_rest,
    distinct,
    misreadings,
    possible_origins,
    require_plausible,
    unchanging,
    without_unpowered,
)

_LOG = logging.getLogger(__name__)


def investigate(
    plant: Plant,
    recordings: Sequence[Recording],
    *,
    uncertainty: float | Mapping[str, float] = DATA.uncertainty,
    free: Sequence[str] = (),
    noise: Mapping[str, float] | None = None,
    held_out: Sequence[str] = (),
    effects: Own | Iterable[Own] = (),
    accepted: Sequence[str] | None = None,
) -> Gap:
    """Finds where a plant and recordings disagree, names the missing effects and adds them.

    Args:
        plant: nominal.
        recordings: of one sampling time, in the plant's states and inputs.
        uncertainty: prior std of uncertain parameters over their values, one for all or by name.
        free: parameters of which nothing is known beforehand, by name.
        noise: std of the measurement noise of some states [their unit]; the others' is estimated.
        held_out: names of recordings that no fit may see; by default the last of three or more.
        effects: a user's own effects beside those of the catalogue, or Python files with them.
        accepted: suspicions of the recordings that are accepted, which lead the verdict; empty: all
            that there are; None: the recordings must not look wrong, see `misreadings`.

    Raises:
        InputError: the recordings do not fit the plant or one another, or look wrong.
    """
    recordings, remarks = distinct([recording.thinned(DATA.compared_s) for recording in recordings])
    plant = plant.knowing(own_effects(effects))
    require_recordings_of(plant, recordings)
    recordings, off = without_unpowered(plant, recordings)
    remarks, told = remarks + off, noise or {}
    problems = [
        followed(GapProblem.of(moved, timed, uncertainty, free, told, held_out), told)
        for moved, timed in possible_origins(plant, recordings)
    ]
    problems = [replace(each, budget=problems[0].budget) for each in problems]  # both share one
    if at_rest(recordings, problems[0].std):
        return _too_poor(problems[0], AT_REST, remarks)
    doubts = tuple(accepted or misreadings(plant.finely(problems[0].finer), recordings))
    if accepted is None:
        require_plausible(doubts)
    doubts += unchanging(recordings)
    _tell("fit of the nominal plant")
    problem = likeliest(problems)
    everything = problem.enough_windows()
    if len(everything) * problem.window_s < DATA.fewest_windows * DATA.window_s:
        why = f"{LONGER} {len(everything) * problem.window_s / DATA.window_s:.0f}. {MOVE}"
        return _too_poor(problem, why, remarks, doubts)

    explained = _explain_but_events(problem, everything)
    if (likelier := likeliest(problems, explained.best)) is not problem:
        found, problem = explained.result.fits[: SEARCH.hints], likelier
        hints = [replace(f, model=replace(f.model, plant=problem.plant)) for f in found]
        explained = _explain_but_events(problem, problem.enough_windows(), hints)
    recordings = list(problem.recordings)
    if problem.plant is not plant:
        remarks = (*remarks, IN_STEPS.format(2e3 * recordings[0].earlier_s))
    _tell("search for pushes and contacts", explained.best)
    problem, explained, pushes, place = _leave_out_pushes(problem, explained)
    windows, masked = explained.windows, explained.masked
    _tell("verdict", explained.best)
    result, budget = explained.result, problem.budget.for_stage()
    null = refit(result.null.allowed(budget), windows)
    judged = weighed(result, explained.best.allowed(budget), null, windows)
    best, null, named = judged.best, judged.null, named_effects(result, judged)

    missed = spans_of(masked, recordings)
    events = (*pushes, *missed)
    kept = problem.windows(problem.held_out, every=DATA.held_out_every_s)  # that no fit has seen
    decisive, reported = apart(kept) if problem.names[1] else (kept, kept)
    clear = _clear(decisive, problem, events, best)
    unknown = place is not None or leaves_something(judged) or mispredicts(judged, clear)
    unknown = unknown or foreseen(missed, problem, best)
    helps = bool(named) and not judged.evidence.foreign and closes_most(judged, clear)
    where = (*([place] if place else []), *located_misfit(best if unknown else null, windows))
    if unknown:
        _tell("learning of a force without a name", best)
    final = null if unknown and not helps else best
    learned = _learn_force(problem, final, judged, explained, decisive) if unknown else None
    if learned is not None:
        final, unexplained = learned
        events = (*pushes, *unexplained)
        where = (*located_force(final, windows), *where)
    clear, closest = _clear(reported, problem, events, final), None
    nearest = judged if named else judged.whole  # of which none may be sure enough to be told
    if unknown and nearest and not helps:
        part = nearest.closed(clear)
        if named or part.value >= VERDICT.closed:
            closest = Closest(named_effects(result, nearest), part, corrected(nearest.best))
        named = ()

    verdict = ("partly" if named else "unknown") if unknown else "named" if named else "none"
    if verdict == "none" and unchanging(recordings):
        return _too_poor(problem, MOVE, remarks, doubts)
    _tell("comparison of the models", final)
    on_the_way = nested_fits(result, best) if named else ()
    models = ComparedModels(result.null.model, null, final, on_the_way)
    compared = compare(models, clear, reported)
    if verdict == "none" and compared.corrected > VERDICT.nothing * compared.noise_floor:
        verdict = "unknown"  # what tells so was left out as events, or is in no fitted window
    return Gap(
        plant=plant,
        verdict=verdict,
        named=named,
        corrected=corrected(final),
        where=where,
        comparison=compared,
        events=events,
        experiments=tuple(experiments(result, best, windows)),
        closest=closest,
        train=problem.names[0],
        held_out=problem.names[1],
        apart=reported is not decisive,
        search=result,
        models=models,
        recordings=tuple(recordings),
        suspicions=(*doubts, *far_from_noise(compared, unknown and not judged.evidence.foreign)),
        remarks=remarks,
        left=left_forces(judged),
        shifted=shifted_parameters(final),
        on_bounds=on_bounds(final),
        spread=spread_of(result, judged, final),
    )


MOVE = "Record with `mcpilco record --policy excitation`, which moves a plant so that effects show."
LONGER = f"Record longer: {DATA.fewest_windows} windows of one second are needed, there are"
IN_STEPS = "It moves as in timesteps of {:g} ms, or is read half of that late; this is allowed for."
AT_REST = f"Nothing moves: no position changes by more than its noise. {MOVE}"


def _tell(stage: str, best: Fit | None = None) -> None:
    """Log that a stage begins, and as `found` the effects that are known by then."""
    effects = [] if best is None else [str(effect) for effect in best.model.effects]
    _LOG.info(stage, extra={"found": effects})


def _too_poor(
    problem: GapProblem, why: str, remarks: tuple[str, ...], doubts: tuple[str, ...] = ()
) -> Gap:
    return Gap(
        plant=problem.plant,
        verdict="too_poor",
        corrected=problem.plant,
        experiments=(why,),
        train=problem.names[0],
        held_out=problem.names[1],
        suspicions=doubts,
        remarks=remarks,
    )


def _clear(windows: Windows, problem: GapProblem, events: Sequence[Event], fit: Fit) -> Windows:
    """Held-out windows without events, and without samples that a model shows to be misread."""
    names = [problem.recordings[n].name for n in problem.held_out]
    clear = event_of(events, windows, names) < 0
    return _without_spikes(fit, windows[clear] if clear.any() else windows)


def _without_spikes(fit: Fit, windows: Windows) -> Windows:
    """The windows without samples that a model shows to be misread."""
    return without_spikes(on_windows(fit, windows), windows)


@dataclass(frozen=True)
class _Explanation:
    """A search, and its best model on all windows that it can explain."""

    result: SearchResult
    best: Fit
    windows: Windows
    """to which the best model is fitted"""
    masked: Windows
    """those that hold an event"""


def _explain_but_events(
    problem: GapProblem, windows: Windows, hints: Sequence[Fit] = ()
) -> _Explanation:
    """The search on windows from which those are taken that seem to hold an event."""
    null, kept = fit_nominal(problem.model(windows), windows)
    clean = without_spikes(null, windows)
    if not np.array_equal(clean.measured, windows.measured):
        kept = without_spikes(null, kept)
        null = refit_nominal(null, kept)
    far = windows_with_events(null, kept)
    return _explain(problem, clean[~far], clean[far], hints)


def _explain(
    problem: GapProblem, everything: Windows, masked: Windows, hints: Sequence[Fit] = ()
) -> _Explanation:
    """The search for effects, and its best model on all windows that it can explain.

    `everything` are windows of all recordings, `masked` those of them that seem to hold an event.
    """
    windows = everything[everything.of(problem.train)]
    some = windows.evenly(problem.searched)
    problem = replace(problem, budget=problem.budget.for_stage())
    _tell("search for effects")
    result = search(problem.model(everything), some, problem.candidates(windows), hints)
    return _Explanation(result, *_fit_all_windows(problem, result.best, everything, masked))


def _fit_all_windows(
    problem: GapProblem, best: Fit, everything: Windows, masked: Windows
) -> tuple[Fit, Windows, Windows]:
    """A model fitted to all windows that it can explain, these, and those with events.

    Arguments as of `_explain`.
    """
    best = best.allowed(best.model.budget.for_stage())
    best, windows = refit_truncated(best, everything[everything.of(problem.train)])
    legible = without_spikes(best, windows)
    if not np.array_equal(legible.measured, windows.measured):
        best, windows = refit(best, legible), legible
    far = windows_with_events(best, windows)
    masked, explained = still_missed(best, windows, masked, problem.train)
    if far.any() or len(explained):
        kept = windows[~far].joined(explained[explained.of(problem.train)])
        masked = masked.joined(windows[far])
        best, windows = refit_truncated(best, kept)
    return best, windows, masked


def _leave_out_pushes(
    problem: GapProblem, explained: _Explanation
) -> tuple[GapProblem, _Explanation, tuple[Event, ...], Disagreement | None]:
    """The problem without pushes, a search that did not see them, these, and where they recur.

    Pushes are sought by the closest model of the search: what it misses is no effect of the list.
    Where they recur whenever a joint comes by a place they are none, and nothing is left out.
    """
    closest, _ = min(explained.result.ranked, key=lambda pair: pair[1])
    quiet, pushes = without_bursts(problem, refit_truncated(closest, explained.windows)[0])
    place = recurring(pushes, problem)
    if place is not None or not pushes:
        return problem, explained, (), place
    best, known = explained.best, explained.result.fits[: SEARCH.hints]
    everything = _without_spikes(best, quiet.enough_windows())
    kept = truncated(best.model, everything, best.theta)
    far = windows_with_events(on_windows(best, kept), kept)
    anew = _explain(quiet, everything[~far], everything[far], known)
    problem, pushes = without_bursts(problem, anew.best)
    everything = _without_spikes(anew.best, problem.enough_windows())
    fitted = _fit_all_windows(problem, anew.best, everything, everything[:0])
    return problem, _Explanation(anew.result, *fitted), pushes, None


def _learn_force(
    problem: GapProblem, base: Fit, judged: Weighed, explained: _Explanation, decisive: Windows
) -> tuple[Fit, tuple[Event, ...]] | None:
    """A fit with the residual as a force, and the events that this does not explain either.

    None where it does not surely shrink the error of the held-out windows that decide.
    """
    windows, masked = explained.windows.plain, explained.masked
    budget = ComputeBudget.at(windows.held_s, problem.plant.costly, BUDGET.stage_steps)
    base = base.allowed(budget)

    def usable(some: Windows) -> Windows:
        return _without_spikes(base, truncated(base.model, some, base.theta))

    every = windows.joined(masked[masked.of(problem.train)])
    short = problem.windows(problem.train, seconds=problem.short_s)
    fit = with_learned_force(base, usable(every), usable(short))
    missed, _ = still_missed(on_windows(fit, windows), windows, masked)
    events = spans_of(missed, problem.recordings)
    clear = _clear(decisive, problem, events, fit)
    others = judged.null, base
    less = [error_reduction(other, fit, clear, judged.evidence).low > 0.0 for other in others]
    return (fit, events) if all(less) else None
