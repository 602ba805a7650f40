"""The search for missing effects: a beam search, then exchanges, then special cases.

A search that only adds may hold on to an effect that looks like the true one. Alone a delay can
explain more than the lag that is there, as long as friction is missing; once that is found the
model still does not fit, and one effect must go for another. The search also comes first upon what
bends most readily: friction that is alike in both directions is Coulomb's all the same.

Reference: Miller, Subset Selection in Regression (2002), section 3.5: sequential replacement.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from mcpilco.gap.data import Windows
from mcpilco.gap.fit import (
    Fit,
    correlation_time,
    fit_model,
    fit_nominal,
    misfits,
    residuals,
    structure,
)
from mcpilco.gap.plant_model import BudgetShare, PlantModel
from mcpilco.gap.screen import Score, screen
from mcpilco.gap.sensitivities import linearise
from mcpilco.gap.thresholds import BUDGET, CHOICE, SEARCH
from mcpilco.plant import EffectInstance

Effects = frozenset[EffectInstance]


@dataclass(frozen=True)
class SearchResult:
    """The models that a search has fitted, and the best of them."""

    best: Fit
    """of the smallest BIC that its gains justify"""
    null: Fit
    """of no effect"""
    ranked: tuple[tuple[Fit, float], ...]
    """all fits with their BIC, the best first"""
    scores: tuple[Score, ...]
    """of the effects that the best does not have"""
    windows: Windows
    """on which it searched"""

    @property
    def fits(self) -> list[Fit]:
        """All of them, the best first."""
        return [fit for fit, _ in self.ranked]

    def choosing(self, best: Fit) -> SearchResult:
        """This search, with another of its fits as the best."""
        rest = tuple(pair for pair in self.ranked if pair[0] is not best)
        own = next(pair for pair in self.ranked if pair[0] is best)
        return replace(self, best=best, ranked=(own, *rest))

    def with_best(self, best: Fit, seen: Iterable[Fit]) -> SearchResult:
        """This search with its best fit, and all that were seen, judged by its residual."""
        criterion = Criterion.of(best, self.windows)
        judged = [(fit, criterion.bic(fit)) for fit in seen if fit is not best]
        finite = [pair for pair in judged if math.isfinite(pair[1])]
        rest = sorted(finite, key=lambda pair: pair[1])
        return replace(self, best=best, ranked=((best, criterion.bic(best)), *rest))


def search(
    model: PlantModel, windows: Windows, candidates: Sequence[EffectInstance]
) -> SearchResult:
    """Adds effects as long as they explain more: a beam search over sets of effects.

    Each level scores all candidates on each of the best models, fits the most promising ones, and
    goes on with the best of these. An effect that the others make superfluous is dropped again. A
    search whose share of the steps is used up ends with what it has seen.

    Args:
        model: without effects.
        windows: of the recordings.
        candidates: effects that may be missing.
    """
    share = model.budget.share(BUDGET.search)
    null, windows = fit_nominal(model, windows)
    tried = Tried(windows, candidates, null, {frozenset(): null})
    best, beam = null, [null]
    scores: list[Score] = []
    for _ in range(SEARCH.rounds):
        if not beam or (level := len(beam[0].model.effects)) == SEARCH.most_effects:
            break
        grown: list[Fit] = []
        for number, fit in enumerate(share.while_left(beam)):
            promised = tried.scores(fit)
            if number == 0:
                scores = promised
            grown += tried.grow_promising(fit, promised, SEARCH.shortlist[level], share)
        if not grown:
            break
        closest = min(grown, key=_chi2)
        criterion = Criterion.of(closest, windows)
        grown = _in_order(grown, criterion)
        worth = [fit for fit in grown if criterion.prefers(fit, best, null)]
        if not worth:
            if closest.chi2 >= SEARCH.hopeless * best.chi2:
                break
            beam = _followed(grown, SEARCH.beam[level])  # they bend for what else is missing
            continue
        before, best = best, without_superfluous(worth[0], tried, criterion)
        same = {*best.model.effects} == {*before.model.effects}
        stalled = same and before.chi2 - best.chi2 < SEARCH.bic_gain
        if stalled or (level and closest.chi2 > SEARCH.hopeless * null.chi2):
            break
        beam = [best, *_followed([f for f in grown if f is not worth[0]], SEARCH.beam[level] - 1)]
    return SearchResult(best, null, (), tuple(scores), windows).with_best(best, tried.fits.values())


@dataclass(frozen=True)
class Tried:
    """The models that were fitted, by their effects, and how further ones are made."""

    windows: Windows
    candidates: Sequence[EffectInstance]
    null: Fit
    """of no effect"""
    fits: dict[Effects, Fit]

    @classmethod
    def by(cls, result: SearchResult, candidates: Sequence[EffectInstance]) -> Tried:
        """Those of a search."""
        fits = {frozenset(fit.model.effects): fit for fit in result.fits}
        return cls(result.windows, candidates, result.null, fits)

    def scores(self, fit: Fit) -> list[Score]:
        """Those of the effects that a model lacks."""
        lin = linearise(fit.model, self.windows, fit.theta, fit.x0)
        new = [c for c in self.candidates if c not in fit.model.effects]
        return screen(fit, lin, self.windows, new)

    def grow_promising(
        self, fit: Fit, scores: Sequence[Score], most: int, share: BudgetShare
    ) -> list[Fit]:
        """The most promising models of one effect more, where they fit better than what was tried.

        A model that was tried, and that fits no worse than the smaller one, is not fitted again.
        """
        new: dict[Effects, Fit] = {}
        for score in scores:
            key = frozenset({*fit.model.effects, score.instance})
            tried = key in self.fits and self.fits[key].chi2 <= fit.chi2
            if score.gain < SEARCH.promising or (key not in new and (len(new) == most or tried)):
                continue
            if share.used_up:
                break
            grown = grow(fit, score, self.windows)
            if key not in new or grown.chi2 < new[key].chi2:
                new[key] = grown
        better = {k: f for k, f in new.items() if k not in self.fits or f.chi2 < self.fits[k].chi2}
        self.fits.update(better)
        return list(better.values())

    def instead(
        self, fit: Fit, instance: EffectInstance, candidates: Sequence[EffectInstance]
    ) -> dict[Effects, Fit]:
        """The most promising models with one of some candidates in the place of an effect."""
        if not candidates:
            return {}
        return self.further(without(fit, instance, self.windows, self.null), candidates)

    def further(self, fit: Fit, candidates: Sequence[EffectInstance]) -> dict[Effects, Fit]:
        """The most promising models with one of some candidates more."""
        lin = linearise(fit.model, self.windows, fit.theta, fit.x0)
        scores = screen(fit, lin, self.windows, candidates, per_effect=1)
        grown = [grow(fit, score, self.windows) for score in scores[: SEARCH.exchange_tried]]
        return {frozenset(each.model.effects): each for each in grown}


_chi2 = attrgetter("chi2")


def _in_order(grown: Sequence[Fit], criterion: Criterion) -> list[Fit]:
    """Models by their BIC; of those that do the same, the first has the usual effect.

    A delay of the only actuator and one of the only sensor differ by rounding. Which of them is
    named should not depend on that.
    """
    judged = sorted(((criterion.bic(fit), fit) for fit in grown), key=lambda pair: pair[0])
    least, usual = judged[0][0], list(grown[0].model.plant.catalogue)
    same = [fit for bic, fit in judged if bic - least < SEARCH.same_bic]
    same.sort(key=lambda f: [usual.index(each.effect.name) for each in f.model.effects])
    return [*same, *(fit for _, fit in judged[len(same) :])]


def _followed(grown: Sequence[Fit], count: int) -> list[Fit]:
    """Models to carry on beside the best: those of the smallest BIC, and the one that fits best.

    What still misses an effect may bend the nominal parameters far beyond their priors to imitate
    it. That costs it its rank, but it is one effect away from what is there. Of models that do the
    same one is enough. Those that have as many effects as may be end here.
    """
    grown = [fit for fit in grown if len(fit.model.effects) < SEARCH.most_effects]
    apart: list[Fit] = []
    for k, fit in enumerate(grown):
        if all(abs(fit.chi2 - other.chi2) >= SEARCH.same_bic for other in grown[:k]):
            apart.append(fit)
    followed = apart[:count]
    closest = min(grown, key=_chi2, default=None)
    if closest is not None and all(closest is not fit for fit in followed):
        followed.append(closest)
    return followed


def grow(fit: Fit, score: Score, windows: Windows) -> Fit:
    """The fit of a model with one effect more, from the size at which it misses least.

    A linear response overrates what moves a motion far, so smaller sizes are tried as well.
    """
    effect = score.instance.effect
    sized = effect.amplitudes & np.isfinite(effect.neutral)
    begun = []
    for part in SEARCH.begun:
        with np.errstate(invalid="ignore"):  # of a limit that is nowhere
            smaller = effect.neutral + part * (score.start - effect.neutral)
        values = np.where(sized, smaller, score.start)
        begun.append(fit.model.grown(fit.theta, score.instance, values))
    by_window = [misfits(model, windows, theta, fit.x0) for model, theta in begun]
    missed = [np.log(np.maximum(each / windows.samples, 1.0)).sum() for each in by_window]
    model, theta = begun[int(np.argmin(missed))]
    return fit_model(model, windows, theta, fit.x0, iterations=12, hasty=True)


def without(fit: Fit, instance: EffectInstance, windows: Windows, null: Fit) -> Fit:
    """The fit of a model without one of its effects; a parameter gets the prior of no effect."""
    parameter = fit.model.plant.parameter_of(instance)
    prior = null.model.priors.get(parameter or "", np.inf)
    model, theta = fit.model.shrunk(fit.theta, instance, prior)
    return fit_model(model, windows, theta, fit.x0, iterations=12, hasty=True)


def without_superfluous(best: Fit, tried: Tried, criterion: Criterion) -> Fit:
    """The fit without those of its effects that explain nothing, now that the others are there."""
    for instance in best.model.effects if len(best.model.effects) > 1 else ():
        smaller = without(best, instance, tried.windows, tried.null)
        key = frozenset(smaller.model.effects)
        if key not in tried.fits or smaller.chi2 < tried.fits[key].chi2:
            tried.fits[key] = smaller
        if not criterion.prefers(best, tried.fits[key], tried.null):
            return tried.fits[key]
    return best


@dataclass(frozen=True)
class Criterion:
    """The evidence for a model, on the scale of the noise or, where larger, of the best misfit.

    A model of a real machine never fits to the noise of the sensors, and its residual is correlated
    in time. Misfits are then measured in units of the best model's, and count as many samples as
    are independent of one another.
    """

    windows: Windows
    cap: float
    """squared misfit of a sample beyond which a window counts no further"""
    inflation: float
    """misfit of an independent sample, at least 1"""
    samples: float
    """how many of these there are"""

    @classmethod
    def of(cls, best: Fit, windows: Windows) -> Criterion:
        """The criterion on the scale of a model that fits well."""
        samples = windows.samples
        by_sample = best.by_window / samples
        cap = SEARCH.cap * max(1.0, float(np.median(by_sample)))
        misfit = float(np.minimum(best.by_window, cap * samples).sum() / samples.sum())
        repeated = windows.overlap * correlation_time(residuals(best, windows))
        return cls(windows, cap, max(1.0, misfit) * repeated, samples.sum() / repeated)

    def bic(self, fit: Fit) -> float:
        """Bayesian information criterion; no window weighs more than some times the median.

        It is infinite where an effect is larger than what could be meant.

        Reference: Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978).
        """
        if not fit.model.plausible(fit.theta):
            return math.inf
        prior = float((fit.model.precision * fit.theta**2).sum())
        parameters = len(fit.theta) - fit.model.nuisances + len(fit.model.freed)
        return self.misfit(fit) / self.inflation + prior + parameters * math.log(self.samples)

    def misfit(self, fit: Fit) -> float:
        """Squared residuals; no window weighs more than some times the median."""
        return float(np.minimum(fit.by_window, self.cap * self.windows.samples).sum())

    def prefers(self, larger: Fit, smaller: Fit, null: Fit) -> bool:
        """Whether a model with more effects is worth them; `null` has none.

        An effect must explain a part of the whole gap, so that none is named for what two
        integrators do differently, and a part of the smaller model's misfit, so that none is named
        for what is far too small beside a noise larger than reported. One that comes down to an
        uncertain parameter need not: its prior says what is small.
        """
        if len(larger.model.freed) > len(smaller.model.freed):
            return self.bic(smaller) - self.bic(larger) >= SEARCH.bic_gain
        noise = float(self.windows.measured.sum())
        small = max(
            SEARCH.part_of_gap * (null.chi2 - noise),
            SEARCH.part_of_rest * (self.misfit(smaller) - noise),
        )
        return self.bic(smaller) - self.bic(larger) >= max(SEARCH.bic_gain, small / self.inflation)


def exchanged(result: SearchResult, candidates: Sequence[EffectInstance]) -> SearchResult:
    """The search, its best model's effects exchanged for others as long as these explain more.

    Args:
        result: of a search.
        candidates: effects that may be missing.
    """
    windows, best, null = result.windows, result.best, result.null
    share = best.model.budget.share(BUDGET.exchange)
    tried = Tried.by(result, candidates)
    for _ in range(SEARCH.exchange_rounds):
        hopeless = best.chi2 > SEARCH.hopeless * null.chi2
        if share.used_up or not best.model.effects or hopeless:
            break
        if structure(best, windows).whiteness < SEARCH.unfit:
            break
        others: dict[Effects, Fit] = {}
        for instance in share.while_left(best.model.effects):
            rest = {*best.model.effects} - {instance}
            new = [c for c in candidates if frozenset({*rest, c}) not in tried.fits]
            others |= tried.instead(best, instance, new)
        tried.fits.update(others)
        compared = [best, *others.values()]
        criterion = Criterion.of(min(compared, key=_chi2), windows)
        better = min(compared, key=criterion.bic)
        if criterion.bic(best) - criterion.bic(better) < SEARCH.bic_gain:
            break
        best = better
    if best is result.best:
        return result
    best = without_superfluous(best, tried, Criterion.of(best, windows))
    return result.with_best(best, tried.fits.values())


def plainer(result: SearchResult, candidates: Sequence[EffectInstance]) -> SearchResult:
    """The search, its best model's effects replaced by special cases that explain as much.

    The model of special cases alone is among those tried, even where it explains less. Where no
    model fits to the noise, so are those of all that are promising, and this one with one effect
    more.

    Args:
        result: of a search.
        candidates: effects that may be missing.
    """
    windows, null = result.windows, result.null
    tried = Tried.by(result, candidates)
    best = plainest = result.best
    for instance in result.best.model.effects:
        simple = _special_case(best, instance, tried)
        plainest = simple if plainest is best else _special_case(plainest, instance, tried)
        if not Criterion.of(best, windows).prefers(best, simple, null):
            best = simple
    if fits_roughly(best, windows):
        for fit in null.model.budget.share(BUDGET.exchange).while_left(promising(result.fits)):
            simple = fit
            for instance in fit.model.effects:
                simple = _special_case(simple, instance, tried)
        ours = plainest.model.effects
        if plainest is not best and len(ours) < SEARCH.most_effects:
            new = [c for c in candidates if c not in ours and not any(map(c.holds, ours))]
            tried.fits.update(tried.further(plainest, new))
    return result.with_best(tried.fits[frozenset(best.model.effects)], tried.fits.values())


def _special_case(fit: Fit, instance: EffectInstance, tried: Tried) -> Fit:
    """The model with the special case of an effect in its place; itself where there is none."""
    rest = {*fit.model.effects} - {instance}
    case = next((c for c in tried.candidates if instance.holds(c) and c not in rest), None)
    if case is None:
        return fit
    for key, simple in tried.instead(fit, instance, [case]).items():
        tried.fits[key] = min([simple, tried.fits.get(key, simple)], key=_chi2)
    return tried.fits.get(frozenset({*rest, case}), fit)


def fits_roughly(fit: Fit, windows: Windows) -> bool:
    """Whether a model misses more than noise in most windows."""
    return bool(np.median(fit.by_window / windows.samples) >= CHOICE.rough)


def promising(ranked: Sequence[Fit]) -> list[Fit]:
    """Models that fit nearly as well as the first.

    These are the first ones of each number of effects, and such of special cases of theirs.
    """
    near = [fit for fit in ranked if fit.chi2 < CHOICE.near * ranked[0].chi2]
    sizes = [len(fit.model.effects) for fit in near]
    places = range(len(near))
    first = [near[k] for k in places if sizes[:k].count(sizes[k]) < CHOICE.of_each_size]
    return [fit for fit in near if any(_narrows(fit, other) for other in first)]


def _narrows(fit: Fit, other: Fit) -> bool:
    """Whether a model has the effects of another, or special cases of them."""
    ours, theirs = {*fit.model.effects}, {*other.model.effects}
    special = all(any(t.holds(o) for t in theirs - ours) for o in ours - theirs)
    return len(ours) == len(theirs) and special


def nested_fits(result: SearchResult, best: Fit) -> tuple[Fit, ...]:
    """The best fit of one of a fit's effects, the best of two with this one, ...; without itself.

    They are fits of the search, on its windows.
    """
    ours, steps = set(best.model.effects), []
    chosen: set[EffectInstance] = set()
    for size in range(1, len(ours)):
        for fit in result.fits:  # the best first
            theirs = set(fit.model.effects)
            if len(theirs) == size and chosen <= theirs <= ours:
                steps.append(fit)
                chosen = theirs
                break
    return tuple(steps)
