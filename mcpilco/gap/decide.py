"""The decisions: what a model leaves over, which effects are sure, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats

from mcpilco.gap.comparison import Interval, error_reduction, misfit_over_expected
from mcpilco.gap.data import Windows
from mcpilco.gap.disturbance import Disturbance, Evidence
from mcpilco.gap.fit import Fit, fit_model, nearer, on_windows, weighed_anew
from mcpilco.gap.learned_force import best_force
from mcpilco.gap.plant_model import PerWindow, PlantModel, Theta
from mcpilco.gap.posterior import CONFIDENCE, Posterior, lasting
from mcpilco.gap.screen import bounded
from mcpilco.gap.search import SearchResult, Tried, shrunk, without
from mcpilco.gap.sensitivities import residual, run
from mcpilco.gap.thresholds import DATA, SEARCH, VERDICT
from mcpilco.plant import EffectInstance, Member, Plant
from mcpilco.plant.effects import Symbol


@dataclass(frozen=True)
class Weighed:
    """The best model and the nominal one on all windows, each with random forces of its own."""

    best: Fit
    null: Fit
    windows: Windows
    """in which what the random forces of the best model may do weighs little"""
    evidence: Evidence
    """for the best model"""
    nominal: Evidence
    """for the model of no effect"""
    whole: Weighed | None = None
    """the same with effects that are too slight to be told, or not worth it"""

    @cached_property
    def disturbance(self) -> Disturbance:
        """The responses to random forces along the motions of the best model."""
        return Disturbance.of(self.best, self.windows)

    def posterior(self, fit: Fit, left: Evidence) -> Posterior:
        """Of a fit to the windows; of what it leaves over a part may be alike in all of them."""
        lasts = lasting(self.disturbance, self.best, self.windows, VERDICT.lasting * left.std)
        return Posterior(fit, self.windows, lasts)

    def share(self, instance: EffectInstance) -> float:
        """The part of the nominal plant's gap that opens again where it alone is taken out [-]."""
        fewer = _taken_out(self.best, instance, self.null)
        nominal = self.null.model, self.null.model.nominal(self.null.theta)
        ends = (replace(self.best, model=m, theta=t) for m, t in (fewer, nominal))
        opened, gap = (_missed(f, self.windows) - _missed(self.best, self.windows) for f in ends)
        return float(np.clip(opened / max(gap, 1e-12), 0.0, 1.0))

    def closed(self, clear: Windows) -> Interval:
        """The part of the error on held-out windows without events that the effects take away.

        From the refitted plant; where that alone left what its priors allow, from the nominal one.
        """
        null, nominal = self.null, self.null.model.nominal(self.null.theta)
        astray = shifted_parameters(null) and not shifted_parameters(self.best)
        before = replace(null, theta=nominal) if astray else null
        return error_reduction(before, self.best, clear, self.evidence)


def weighed(result: SearchResult, best: Fit, null: Fit, windows: Windows) -> Weighed:
    """The fits on all windows, without effects that are not worth it on these.

    A search looks at some windows, and may follow what is in these alone.
    """
    tried = Tried(null, (), Disturbance.of(best, windows), windows)
    tried.windows = tried.disturbance.whitened(tried.disturbance.evidence(best))
    for fit in (best, null):  # a closer fit by these weights may be less likely
        tried.keep(weighed_anew(fit, tried.windows))
    best, null = (
        tried.keep(fit_model(fit.model, tried.windows, fit.theta, fit.x0, iterations=15))
        for fit in (best, null)
    )
    told = whole = Weighed(best, null, tried.windows, tried.judged(best), tried.judged(null))
    while True:
        effects, seen = best.model.effects, tried.windows
        lasts = lasting(tried.disturbance, best, seen, VERDICT.lasting * told.evidence.std)
        vain = {*slight_effects(best, null, seen), *uncertain_effects(Posterior(best, seen, lasts))}
        fewer = {each: tried.keep(without(best, [each], seen, result.null)) for each in effects}
        enough = [f for one, f in fewer.items() if one in vain or not tried.prefers(best, f)]
        if not enough:  # about motions near what was measured all is closest to linear
            best, null = nearer(told.best, windows), nearer(null, windows)
            return replace(told, best=best, null=null)
        best = min(enough, key=tried.bic)
        told = replace(whole, best=best, evidence=tried.judged(best), whole=whole)


def _taken_out(best: Fit, instance: EffectInstance, null: Fit) -> tuple[PlantModel, Theta]:
    """The best model and its theta with one effect left out, or with the nominal parameter."""
    model, theta = shrunk(best, [instance], null)
    if (told := null.model.frees(instance)) is not None:
        theta = np.where(np.arange(len(theta)) == told, 0.0, theta)
    return model, theta


def slight_effects(best: Fit, null: Fit, windows: Windows) -> list[EffectInstance]:
    """The effects that change motions less than the error does that parameters are told to have.

    Of bodies all that; of others 1 %, for an integrator of first order acts like effects of that
    size. Both changes are simulated: behind impacts a linear form makes far more of an error.
    """
    if not best.model.effects:
        return []
    lin, priors = best.linearised(windows), np.array([*null.model.priors.values()])

    def moved(model: PlantModel, theta: Theta) -> PerWindow:
        y = run(model, windows, theta[None], best.x0[None])[0]
        return np.square(lin.cleaned((residual(windows, y) - lin.r)[..., None])).sum(axis=(1, 2))

    def by_errors(most: float) -> tuple[PerWindow, float]:
        told = np.where(np.isfinite(priors), np.minimum(priors, most), 0.0)
        errors = np.diag(told)[told > 0.0] @ np.eye(len(told), len(best.theta))
        each = [np.zeros(len(windows)), *(moved(best.model, best.theta + e) for e in errors)]
        weight = bounded(np.max(each, axis=0))
        return weight, VERDICT.slight**2 * float((np.array(each) @ weight).max())

    limits = by_errors(DATA.uncertainty), by_errors(np.inf)
    changes = {each: moved(*_taken_out(best, each, null)) for each in best.model.effects}
    bounds = {each: limits[each.effect.place == "body"] for each in changes}
    return [each for each, (weight, least) in bounds.items() if weight @ changes[each] < least]


def uncertain_effects(posterior: Posterior) -> list[EffectInstance]:
    """The effects of which the intervals of all sizes hold that of none, or that of them together.

    What is left of the forces, were it alike in all windows, would do as much.
    """
    return [
        instance
        for instance, parameters in estimates(posterior).items()
        if all(p.low <= s.neutral <= p.high for s, p in _sizes(instance, parameters))
        or _together(instance, posterior) < CONFIDENCE
    ]


def leaves_something(judged: Weighed) -> bool:
    """Whether more is left over than any machine has, or less that state and command predict.

    A force that acts in few places is small on the whole, and yet tells windows from others. What
    is too slight to be told is nothing that is left.
    """
    judged = judged.whole or judged
    evidence, windows = judged.evidence, judged.windows.plain
    if evidence.deficient or not (evidence.std > SEARCH.least_force).any():
        return evidence.deficient
    return best_force(nearer(judged.best, windows), windows) is not None


def mispredicts(judged: Weighed, clear: Windows) -> bool:
    """Whether effects that fit their recordings miss held-out windows without events far more.

    Those that are too slight to be told help.
    """
    judged = judged.whole or judged
    if not judged.best.model.effects or judged.closed(clear).value >= VERDICT.closed:
        return False
    some = clear, judged.windows.plain
    unseen, seen = (misfit_over_expected(judged.best, each, judged.evidence) for each in some)
    return unseen > VERDICT.far * max(1.0, seen)


def closes_most(judged: Weighed, clear: Windows) -> bool:
    """Whether effects surely take away most of the error on held-out windows without events."""
    return judged.closed(clear).low >= VERDICT.closed


def _missed(fit: Fit, windows: Windows) -> float:
    """Root mean square of the misfit, in noise std, random forces or not."""
    by_window = weighed_anew(fit, windows.plain).by_window
    return math.sqrt(float(by_window.sum() / windows.samples.sum()))


@dataclass(frozen=True)
class LeftForce:
    """A random force in a joint that a model needs beside its equations."""

    joint: str
    std: float
    """of its mean over 0.06 s, in its unit"""
    unit: str
    usual: float
    """part of the joint's usual force [-]"""
    nominal: float
    """std of the one that the nominal plant needs, in its unit"""


def left_forces(judged: Weighed) -> tuple[LeftForce, ...]:
    """The random forces of the best model, one a joint."""
    layout = judged.best.model.plant.layout
    left, before = judged.evidence.sure.tolist(), judged.nominal.sure.tolist()
    units = [judged.best.model.scales[joint].force for joint in layout.joints]
    return tuple(
        LeftForce(joint, usual * std, layout.unit_of(joint)[1], std, usual * nominal)
        for joint, std, nominal, usual in zip(layout.joints, left, before, units, strict=True)
    )


@dataclass(frozen=True)
class ShiftedParameter:
    """A parameter that a fit takes far from its nominal value, where its prior did not mean it."""

    name: str
    nominal: float
    """in its unit"""
    value: float
    """that the corrected plant has, in its unit"""
    unit: str
    stds: float
    """how many prior standard deviations lie between [-]"""


def shifted_parameters(fit: Fit) -> tuple[ShiftedParameter, ...]:
    """The parameters that lie farther from their nominal values than a prior allows."""
    known = {each.name: each for each in fit.model.plant.parameters}
    told = [
        (known[name], change, abs(change) / std)
        for (name, std), change in zip(fit.model.priors.items(), fit.theta.tolist(), strict=False)
    ]
    return tuple(
        ShiftedParameter(p.name, p.value, p.value * (1.0 + change), p.unit, stds)
        for p, change, stds in told
        if stds > VERDICT.shifted
    )


def on_bounds(fit: Fit) -> tuple[str, ...]:
    """The symbols of effects that lie on a bound, as sentences."""
    model, said = fit.model, []
    low, high = model.bounds
    for instance, span in zip(model.added, model.spans(), strict=True):
        units = instance.effect.units(model.plant.layout, instance.target)
        values = dict(model.effect_values(fit.theta[None]))[instance][0]
        for n, symbol in enumerate(instance.effect.symbols):
            at = fit.theta[span][n]
            ends = {"lower": low[span][n], "upper": high[span][n]}
            said += [
                f"{symbol.name} of {instance} lies on its {end} bound, {values[n]:.3g} {units[n]}."
                for end, bound in ends.items()
                if abs(at - bound) < 1e-6
            ]
    return tuple(said)


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
    """that it is missing: it belongs to the sets that the evidence favours, and it is not 0 [-]"""
    share: float
    """part of the closed gap that opens again where it alone is taken out [-]"""
    family: tuple[str, ...]
    """effects, itself first, that these recordings cannot distinguish from it"""


@dataclass(frozen=True)
class Closest:
    """Effects that come closest to what is missing, and explain too little of it to be named."""

    effects: tuple[NamedEffect, ...]
    reduction: Interval
    """the part of the error on held-out recordings that they take away [-]"""
    plant: Plant
    """the nominal one with them"""


@dataclass(frozen=True)
class Rival:
    """A model that has another effect in the place of one."""

    instance: EffectInstance
    """the other effect"""
    fit: Fit
    behind: float
    """its BIC less that of the best model, or of the one with both beside the same effects"""


def rivals(result: SearchResult, instance: EffectInstance) -> list[Rival]:
    """The models of a search as likely as its best one, but with another effect for one of it.

    Or with one in the place of several, or the other way round; or beside effects that are likely.
    """
    ours, least, listed = {*result.best.model.effects}, result.ranked[0][1], []
    known = {frozenset(fitted.model.effects): b for fitted, b in result.ranked}
    for fitted, b in result.ranked:
        theirs = {*fitted.model.effects}
        gone, new = ours - theirs, theirs - ours
        for other in new if gone == {instance} and len(new) > 1 else ():
            beside = known.get(frozenset(theirs - {other} | gone), math.inf)
            if beside < least - SEARCH.bic_gain and b - beside < VERDICT.tied:
                listed.append(Rival(other, fitted, b - beside))
        one = len(gone) == len(new) == 1 or all(x.holds(y) or y.holds(x) for x in gone for y in new)
        if instance in gone and one and b - least < VERDICT.tied:
            listed += [Rival(other, fitted, b - least) for other in new]
    return listed


def named_effects(result: SearchResult, judged: Weighed) -> tuple[NamedEffect, ...]:
    """The effects of the best model with their intervals, probabilities, shares and families."""
    posterior, named = judged.posterior(judged.best, judged.evidence), []
    for instance, parameters in estimates(posterior).items():
        tied = [rival.instance.effect.name for rival in rivals(result, instance)]
        present = min(_present(instance, parameters), _together(instance, posterior))
        sure = _probability(result, instance) * present
        name, target, share = instance.effect.name, instance.target, judged.share(instance)
        alike = tuple(dict.fromkeys([name, *tied]))
        named.append(NamedEffect(name, target, parameters, sure, share, alike))
    return tuple(named)


def estimates(posterior: Posterior) -> dict[EffectInstance, dict[str, EstimatedParameter]]:
    """The parameters of a fit's effects by symbol, with their intervals."""
    fit, model = posterior.fit, posterior.fit.model
    ends = fit.theta, *posterior.intervals()
    rows = zip(*(model.effect_values(x[None]) for x in ends), strict=True)
    found = {}
    for (instance, values), (_, lows), (_, highs) in rows:
        units = instance.effect.units(model.plant.layout, instance.target)
        found[instance] = {
            symbol.name: EstimatedParameter(float(value), float(least), float(most), unit)
            for symbol, value, least, most, unit in zip(
                instance.effect.symbols, values[0], lows[0], highs[0], units, strict=True
            )
            if symbol.reported
        }
    return found


def _probability(result: SearchResult, instance: EffectInstance) -> float:
    """That an effect is missing, or one of which it is a special case, by all that was fitted.

    Its family says which of these it could be as well. Models of more effects than the best one
    do not count, for these were not worth it, but where they have another in its place: each such
    effect counts once, as it is likeliest, and at most as much as this one.
    """
    least, most = result.ranked[0][1], len(result.best.model.effects)
    fits = [(fit, bic) for fit, bic in result.ranked if len(fit.model.effects) <= most]
    weight = np.exp(-0.5 * np.clip([bic - least for _, bic in fits], 0.0, 700.0))
    own = [
        any(each == instance or each.holds(instance) for each in fit.model.effects)
        for fit, _ in fits
    ]
    beside: dict[EffectInstance, float] = {}
    for rival in rivals(result, instance):
        other = rival.instance
        if len(rival.fit.model.effects) > most and not other.holds(instance):
            beside[other] = max(0.0, min(rival.behind, beside.get(other, math.inf)))
    others = sum(math.exp(-0.5 * behind) for behind in beside.values())
    return float(weight @ own / weight.sum() / (1.0 + others))


def _sizes(
    instance: EffectInstance, parameters: dict[str, EstimatedParameter]
) -> list[tuple[Symbol, EstimatedParameter]]:
    """The parameters of an effect that make it none where they have their neutral values."""
    sized = zip(instance.effect.symbols, instance.effect.amplitudes, strict=True)
    return [(s, parameters[s.name]) for s, size in sized if size and s.reported]


def _present(instance: EffectInstance, parameters: dict[str, EstimatedParameter]) -> float:
    """The confidence at which the interval of one of an effect's sizes excludes that of none."""
    sure = [0.0]
    for symbol, estimate in _sizes(instance, parameters):
        side = estimate.high if symbol.neutral > estimate.value else estimate.low
        std = abs(side - estimate.value) / stats.norm.ppf(0.975)
        far = abs(estimate.value - symbol.neutral)
        sure.append(float(1.0 - 2.0 * stats.norm.sf(far / std)) if std > 0.0 else 1.0)
    return max(sure)


def _together(instance: EffectInstance, posterior: Posterior) -> float:
    """The confidence at which an effect's sizes are not all none, where it has several.

    The interval of one of two excludes 0 by chance about twice as often as that of a single one.
    """
    if np.sum(instance.effect.amplitudes) < 2:
        return 1.0
    model = posterior.fit.model
    span = model.spans()[model.added.index(instance)]
    sizes = span.start + np.flatnonzero(instance.effect.amplitudes)
    return posterior.confidence(sizes.tolist())


def spread_of(result: SearchResult, judged: Weighed, final: Fit) -> tuple[Member, ...]:
    """The joint posterior of parameters and effects: of the final model, and of models as likely.

    The final model is the one that the plant gets, with a learned force where there is one.
    """
    chosen, null = judged.best, judged.null
    if final.model.effects != chosen.model.effects:
        return (judged.posterior(null, judged.nominal).member(1.0, final.theta),)
    ours = judged.posterior(chosen, judged.evidence)
    alike = [rival for instance in chosen.model.effects for rival in rivals(result, instance)]
    tied = {id(rival.fit): rival for rival in alike}.values()
    weights = [math.exp(-0.5 * max(rival.behind, 0.0)) for rival in tied]
    others = [replace(ours, fit=on_windows(rival.fit, judged.windows)) for rival in tied]
    each, total = zip(others, weights, strict=True), 1.0 + sum(weights)
    theirs = [other.member(weight / total, other.fit.theta) for other, weight in each]
    return (ours.member(1.0 / total, final.theta), *theirs)
