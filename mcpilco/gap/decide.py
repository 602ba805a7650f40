"""The decisions: which model is chosen, what it names and how surely, and the verdict.

Where a model fits to the noise, its evidence decides. Real machines are never fitted so well: the
residual is no noise, and an effect can follow it in the recordings at hand and mislead in the next.
There each recording is predicted from the others; of one alone, each third from the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from mcpilco.gap.comparison import Interval, error_over_noise, error_reduction
from mcpilco.gap.data import Windows
from mcpilco.gap.fit import Fit, fit_initial_states, fit_model, misfits, structure
from mcpilco.gap.plant_model import PerWindow
from mcpilco.gap.residual_force import explained_by_forces, force_response
from mcpilco.gap.search import Criterion, SearchResult, fits_roughly, promising, without
from mcpilco.gap.sensitivities import linearise
from mcpilco.gap.thresholds import BUDGET, CHOICE, VERDICT
from mcpilco.plant import EffectInstance


def misses_something(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether the best model's residual is neither noise nor of little account.

    Noise of sensors may be correlated as well, but then it is alike in all windows, and no force
    predicts it.
    """
    if _missed_alone(best, null, windows):
        return True
    rest, gap = structure(best, windows), structure(null, windows)
    if rest.whiteness < VERDICT.structured:
        return False
    unlike_noise = rest.excess > VERDICT.large or rest.unevenness > VERDICT.uneven
    if unlike_noise and rest.excess > VERDICT.rest * gap.excess:
        return True
    # Few windows may make most of the gap: the usual one must be explained as well.
    if rest.usual > max(VERDICT.large, VERDICT.rest_usually * gap.usual):
        return True
    return explained_by_forces(force_response(best, windows)).share > VERDICT.predicted


def _missed_alone(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether single windows are missed far beyond the noise, and effects do not mend them.

    A machine may have come by a place but once; events have been taken out before. Where no model
    fits to the noise, each window is missed in its own way.
    """
    if fits_roughly(best, windows):
        return False
    rest, gap = (fit.by_window / windows.samples for fit in (best, null))
    far = rest > VERDICT.alone * max(1.0, float(np.median(rest)))
    return bool((far & (rest - 1.0 > VERDICT.closed * (gap - 1.0))).any())


def mispredicts(best: Fit, null: Fit, windows: Windows, clear: Windows) -> bool:
    """Whether effects that fit their recordings take too little of the held-out error away.

    Args:
        best: the effects' fit.
        null: the fit of none.
        windows: those of the fits.
        clear: held-out windows without events.
    """
    if not best.model.effects:
        return False
    closed = error_reduction(null, best, clear)
    if fits_roughly(best, windows):  # then it is not the noise that hides what effects are worth
        return closed.low < VERDICT.closed
    if closed.value >= VERDICT.closed:
        return False
    return error_over_noise(best, clear) > VERDICT.far * max(1.0, error_over_noise(best, windows))


def explains_most(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether the effects of a model that does not fit are to stay beside what is learned."""
    rest, gap = structure(best, windows), structure(null, windows)
    return bool(best.model.effects) and rest.excess < VERDICT.rest_beside_force * gap.excess


def explains_rough_fit(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether effects explain most of the gap on a machine that no model fits to the noise.

    Forces of state and command predict a part of the residual there in any case.
    """
    return fits_roughly(best, windows) and explains_most(best, null, windows)


def surely_better(fit: Fit, others: tuple[Fit, ...], clear: Windows) -> bool:
    """Whether a model's error on held-out windows without events is surely less than others'."""
    return all(error_reduction(other, fit, clear).low > 0.0 for other in others)


def most_predictive(ranked: Sequence[Fit], windows: Windows) -> Fit:
    """The model of the fewest parameters that predicts held-out recordings as the best one does.

    That is within one standard error of the difference, by the windows.

    Args:
        ranked: fits of models, the best first.
        windows: of one recording or several.

    Reference: Breiman, Friedman, Olshen & Stone, Classification and Regression Trees (1984),
        section 3.4.3: the rule of one standard error.
    """
    best = ranked[0]
    if not fits_roughly(best, windows):
        return best
    compared = promising(ranked)
    parts = _parts(windows)
    share = best.model.budget.share(BUDGET.validation)
    missed = [_unseen(fit, windows, parts) for fit in share.while_left(compared)]
    compared = compared[: len(missed)]
    effects = np.array([len(fit.model.effects) for fit in compared])
    symbols = np.array([_symbols(fit) for fit in compared])
    return compared[fewest(np.stack(missed), effects, symbols, windows.overlap)]


def _symbols(fit: Fit) -> int:
    """How many numbers a report tells of a model's effects."""
    return sum(
        symbol.reported for instance in fit.model.effects for symbol in instance.effect.symbols
    )


def _parts(windows: Windows) -> Int[np.ndarray, " W"]:
    """Number of the part that each window is in: some recordings, or a third of the only one."""
    own = np.unique(windows.recording, return_inverse=True)[1]
    if own.max() > 0:
        return own % CHOICE.parts
    return np.arange(len(windows)) * CHOICE.parts // len(windows)


def fewest(
    missed: Float[np.ndarray, "M W"],
    effects: Int[np.ndarray, " M"],
    symbols: Int[np.ndarray, " M"],
    overlap: float,
) -> int:
    """Number of the model with the fewest numbers that is as good as the best one.

    Dry friction comes before one that is another in each direction, also where it needs an offset
    beside it. Of as many numbers the model is taken that predicts best.

    Args:
        missed: log misfit of each window that was not seen, by model.
        effects: how many each model has.
        symbols: how many numbers these have.
        overlap: how many windows a sample is in.
    """
    score = missed.mean(axis=1) + CHOICE.worth * effects
    apart = missed - missed[np.argmin(score)]
    independent = max(missed.shape[1] / overlap, 2.0)
    error = apart.std(axis=1) / np.sqrt(independent - 1.0)
    good = np.flatnonzero(apart.mean(axis=1) <= error)
    return int(min(good, key=lambda m: (symbols[m], score[m])))


def _unseen(fit: Fit, windows: Windows, parts: Int[np.ndarray, " W"]) -> PerWindow:
    """Log misfit of a sample in each window, the model fitted to the other parts."""
    missed = np.empty(len(windows))
    for part in np.unique(parts):
        own, others = np.flatnonzero(parts == part), np.flatnonzero(parts != part)
        others = others[~_beside(windows, others, own)]
        refitted = fit_model(
            fit.model, windows[others], fit.theta, fit.x0[others], iterations=3, hasty=True
        )
        some = windows[own]
        x0 = fit_initial_states(fit.model, some, refitted.theta, fit.x0[own])
        misfit = misfits(fit.model, some, refitted.theta, x0)
        missed[own] = np.log(np.maximum(misfit / some.samples, 1.0))
    return missed


def _beside(
    windows: Windows, some: Int[np.ndarray, " V"], others: Int[np.ndarray, " U"]
) -> Bool[np.ndarray, " V"]:
    """Which of some windows share samples with others."""
    length = windows.y.shape[2] * windows.dt
    apart = windows.start_s[some][:, None] - windows.start_s[others]
    same = windows.recording[some][:, None] == windows.recording[others]
    return (same & (np.abs(apart) < length)).any(axis=1)


@dataclass(frozen=True)
class EstimatedParameter(Interval):
    """A parameter of a named effect."""

    unit: str
    """of value and interval"""


@dataclass(frozen=True)
class NamedEffect:
    """An effect that is missing in the plant."""

    name: str
    """of the effect"""
    target: str
    """where it acts"""
    parameters: dict[str, EstimatedParameter]
    """by symbol"""
    probability: float
    """that it belongs to the set of missing effects [-]"""
    family: tuple[str, ...]
    """effects, itself first, that these recordings cannot distinguish from it"""


@dataclass(frozen=True)
class Rival:
    """A model that has another effect in the place of one."""

    instance: EffectInstance
    """the other effect"""
    fit: Fit
    behind: float
    """its BIC less that of the best model"""

    def holds(self, instance: EffectInstance) -> bool:
        """Whether an effect is a special case of the other, which then cannot be worse."""
        return self.instance.holds(instance)


def rivals(result: SearchResult, instance: EffectInstance) -> list[Rival]:
    """The models of a search that differ from its best one by another effect for one of its own."""
    ours = set(result.best.model.effects)
    listed = []
    for fitted, b in result.ranked:
        theirs = set(fitted.model.effects)
        if instance not in theirs and len(theirs) == len(ours) and len(theirs - ours) == 1:
            listed.append(Rival(next(iter(theirs - ours)), fitted, b - result.ranked[0][1]))
    return listed


def certain(
    result: SearchResult, best: Fit, null: Fit, windows: Windows
) -> tuple[SearchResult, Fit, tuple[NamedEffect, ...]]:
    """The search, its best model and what that names, without effects that may well be none.

    A search looks at some windows, and may follow what is in these alone. On all of them the
    interval of such an effect holds the size of none, and without it they are explained as well.
    Where few windows tell of a machine that no model fits, an interval alone may be too wide.

    Args:
        result: the search.
        best: its best model, fitted to all windows.
        null: the model of no effect, likewise.
        windows: these.
    """
    named = named_effects(result, best, windows)
    kept = best
    for instance, estimated in zip(best.model.effects, named, strict=True):
        if not _holds_none(instance, estimated):
            continue
        fewer = without(kept, instance, windows, null)
        if Criterion.of(kept, windows).prefers(kept, fewer, null):
            continue
        searched = without(result.best, instance, result.windows, result.null)
        result, kept = result.with_best(searched, [*result.fits, searched]), fewer
    return result, kept, named if kept is best else named_effects(result, kept, windows)


def _holds_none(instance: EffectInstance, named: NamedEffect) -> bool:
    """Whether the intervals of an effect hold the values at which it changes nothing."""
    effect = instance.effect
    sizes = [s for s, size in zip(effect.symbols, effect.amplitudes, strict=True) if size]
    ends = [(named.parameters[symbol.name], symbol.neutral) for symbol in sizes]
    return all(estimate.low <= neutral <= estimate.high for estimate, neutral in ends)


def named_effects(result: SearchResult, best: Fit, windows: Windows) -> tuple[NamedEffect, ...]:
    """The effects of the best model with their intervals, probabilities and families.

    Args:
        result: the search.
        best: its best model, fitted to all windows.
        windows: these.
    """
    layout = best.model.plant.layout
    low, high = (best.model.effect_values(end[None]) for end in intervals(best, windows))
    named = []
    for (instance, values), (_, lows), (_, highs) in zip(
        best.model.effect_values(best.theta[None]), low, high, strict=True
    ):
        units = instance.effect.units(layout, instance.target)
        estimates = {
            symbol.name: EstimatedParameter(float(value), float(least), float(most), unit)
            for symbol, value, least, most, unit in zip(
                instance.effect.symbols, values[0], lows[0], highs[0], units, strict=True
            )
            if symbol.reported
        }
        instead = rivals(result, instance)
        others = [rival.behind for rival in instead if not rival.holds(instance)]
        against = sum(math.exp(-0.5 * min(max(behind, 0.0), 700.0)) for behind in others)
        family = [instance.effect.name]
        family += [rival.instance.effect.name for rival in instead if rival.behind < CHOICE.tied]
        probability, family = 1.0 / (1.0 + against), list(dict.fromkeys(family))
        name, target = instance.effect.name, instance.target
        named.append(NamedEffect(name, target, estimates, probability, tuple(family)))
    return tuple(named)


def intervals(best: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the 95 % intervals of theta; windows, not samples, count as independent.

    Reference: White, Maximum likelihood estimation of misspecified models, Econometrica 50 (1982),
        with windows as clusters.
    """
    model = best.model
    lin = linearise(model, windows, best.theta, best.x0)
    P = lin.cleaned(lin.Jp)
    H = np.einsum("wni,wnj->ij", P, P) + np.diag(model.precision)
    g = np.einsum("wni,wn->wi", P, lin.r)
    dead = np.diag(H) <= 0.0
    H[dead, dead] = 1.0
    inverse = np.linalg.pinv(H)
    independent = len(windows) / windows.overlap
    spread = windows.overlap * g.T @ g * independent / max(independent - 1.0, 1.0)
    spread += np.diag(model.precision)
    std = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))
    factor = float(stats.t.ppf(0.975, max(independent - 1.0, 1.0)))
    low, high = model.bounds
    ends = np.stack([best.theta - factor * std, best.theta + factor * std])
    ends = np.clip(ends, low, high)
    return ends[0], ends[1]
