"""The search for missing effects: from model to model by single changes, the best evidence first.

A change adds an effect, drops one, or puts another in the place of one: a special case or a general
one of it, or whatever fits. A search that only adds may hold on to an effect that looks like the
true one. Alone a delay can explain more than the lag that is there, as long as friction is missing.

Reference: Miller, Subset Selection in Regression (2002), section 3.5: sequential replacement.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np
from jaxtyping import Float

from mcpilco.gap.data import Windows, split
from mcpilco.gap.disturbance import Disturbance, Evidence
from mcpilco.gap.fit import (
    Fit,
    Robust,
    fit_initial_states,
    fit_model,
    fit_nominal,
    given_way,
    improved_initial_states,
    misfits,
    nearer,
    on_windows,
    recovered,
    refit,
    weighed_anew,
)
from mcpilco.gap.plant_model import ComputeBudget, InitialStates, PlantModel, Theta
from mcpilco.gap.screen import Score, screen
from mcpilco.gap.sensitivities import Linearised
from mcpilco.gap.thresholds import BUDGET, DATA, FIT, SEARCH, VERDICT
from mcpilco.plant import EffectInstance

Effects = frozenset[EffectInstance]
Candidates = Sequence[EffectInstance]
Start = tuple[PlantModel, Windows, Theta, InitialStates]
"""from which a fit begins"""


@dataclass(frozen=True)
class SearchResult:
    """The models that a search has fitted, and the best of them."""

    best: Fit
    """that the evidence justifies"""
    null: Fit
    """of no effect"""
    ranked: tuple[tuple[Fit, float], ...]
    """all fits with their BIC, the best first"""
    scores: tuple[Score, ...]
    """of the effects that the best does not have"""
    windows: Windows
    """on which it searched"""
    evidence: Evidence
    """for the best"""

    @property
    def fits(self) -> list[Fit]:
        """All of them, the best first."""
        return [fit for fit, _ in self.ranked]


@dataclass
class Tried:
    """The models that were fitted, by their effects, each judged with random forces of its own."""

    null: Fit
    """of no effect"""
    candidates: Candidates
    disturbance: Disturbance
    windows: Windows
    """in which what the random forces of the best model may do weighs little"""
    fits: dict[Effects, Fit] = field(default_factory=dict)
    evidence: dict[Effects, Evidence] = field(default_factory=dict)
    """for the fits, as far as they were judged"""
    near: dict[tuple[Effects, bytes], Fit] = field(default_factory=dict)
    """fits that stay near what was measured, by effects and theta, where a simulation is dear"""
    grown: set[tuple[Effects, bool, *tuple[EffectInstance, ...]]] = field(default_factory=set)
    """those whose neighbours were fitted, whether effects were exchanged too, and which of them"""
    screened: dict[Effects, tuple[Fit, list[Score]]] = field(default_factory=dict)
    """the scores of all candidates that a fit lacks, by its effects"""

    @classmethod
    def begun(cls, null: Fit, windows: Windows, candidates: Candidates) -> Tried:
        """The model of no effect alone, fitted anew with its random forces."""
        disturbance = Disturbance.of(null, windows)
        white = disturbance.whitened(disturbance.evidence(null))
        null = fit_model(null.model, white, null.theta, null.x0, iterations=8)
        tried = cls(null, candidates, disturbance, white)
        tried.keep(null)
        return tried.following(())

    def following(self, hints: Sequence[Fit]) -> Tried:
        """With fits to other windows, on these; the best one's random forces weigh them."""
        for fit in (hint.allowed(self.null.model.budget) for hint in hints):
            known = self.keep(on_windows(fit, self.windows))
            self.keep(fit_model(fit.model, self.windows, fit.theta, known.x0))
        self.weigh_by(self.best())
        return self

    def weigh_by(self, best: Fit) -> None:
        """Let its random forces weigh what is fitted from now on; forget the worst models."""
        self.grown.discard((frozenset(best.model.effects), False))  # others may promise more now
        self.screened.clear()
        followed = [self.null, best, *self.ranked[: SEARCH.followed]]
        self.disturbance = Disturbance.of(best, self.windows)
        if best.model.plant.costly:
            self.evidence.clear()
        self.windows = self.disturbance.whitened(self.judged(best))
        self.fits = {frozenset(f.model.effects): weighed_anew(f, self.windows) for f in followed}
        self.null = weighed_anew(self.null, self.windows)

    def keep(self, fit: Fit) -> Fit:
        """The better of a fit and the one of these effects that there was."""
        key, evidence = frozenset(fit.model.effects), self._evidence(fit)
        if (there := self.fits.get(key)) and self.bic(there) <= self._criterion(fit, evidence):
            return there
        self.fits[key], self.evidence[key] = fit, evidence
        return fit

    def judged(self, fit: Fit) -> Evidence:
        """The evidence for one of the fits."""
        key = frozenset(fit.model.effects)
        self.evidence[key] = self.evidence.get(key) or self._evidence(fit)
        return self.evidence[key]

    def _evidence(self, fit: Fit) -> Evidence:
        """With the response to random forces along its own motions or, where dear, the best's."""
        if fit.model.plant.costly:
            key = frozenset(fit.model.effects), fit.theta.tobytes()
            self.near[key] = self.near.get(key) or nearer(fit, self.windows)
            return self.disturbance.evidence(self.near[key], near=True)
        near = nearer(fit.allowed(ComputeBudget()), self.windows)
        return Disturbance.of(near, self.windows, near=True).evidence(near, near=True)

    def bic(self, fit: Fit) -> float:
        """Bayesian information criterion of one of the fits; infinite where it is not plausible.

        Reference: Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978).
        """
        return self._criterion(fit, self.judged(fit))

    def _criterion(self, fit: Fit, evidence: Evidence) -> float:
        if not fit.model.plausible(fit.theta):
            return math.inf
        prior = fit.model.penalty(fit.theta)
        return evidence.deviance + prior + _numbers(fit) * math.log(evidence.samples)

    def prefers(self, larger: Fit, smaller: Fit) -> bool:
        """Whether a model with more effects is worth them: far likelier, and it explains enough.

        Or it is likelier by the prior alone: the smaller one takes masses far from what is known.
        """
        gain = self.bic(smaller) - self.bic(larger)
        cost = (_numbers(larger) - _numbers(smaller)) * math.log(self.judged(larger).samples)
        relief = smaller.model.penalty(smaller.theta) - larger.model.penalty(larger.theta)
        if min(gain, relief - cost) >= SEARCH.prior_gain:
            return True
        return gain >= SEARCH.bic_gain and self._explains(larger, smaller)

    def _explains(self, larger: Fit, smaller: Fit) -> bool:
        """Whether further effects explain as much as they leave over, in some joint or reading.

        What is left of a machine's forces has a form of its own, which an effect that explains less
        than that would but imitate. Where no more is left than noise, the evidence decides alone.
        """
        before, after = (_left_over(self.judged(fit)) for fit in (smaller, larger))
        halved = (before > 0.0) & (before >= 2.0 * after)
        left = _left_over(self.judged(larger), VERDICT.noise**2 - 1.0)
        return bool(halved.any()) or not left.any()

    @property
    def ranked(self) -> list[Fit]:
        """All fits by their BIC; of those that differ by rounding alone, usual effects first."""
        usual = list(self.null.model.plant.catalogue)

        def order(fit: Fit) -> tuple[float, list[int]]:
            bic = self.bic(fit)
            whole = round(bic / SEARCH.same_bic) if math.isfinite(bic) else math.inf
            return whole, sorted(usual.index(each.effect.name) for each in fit.model.effects)

        return sorted(self.fits.values(), key=order)

    def best(self) -> Fit:
        """The likeliest model of those that are worth their effects: of more and more effects."""
        ranked, chosen = self.ranked, [self.null]
        for size in range(1, 1 + SEARCH.most_effects):
            own = [fit for fit in ranked if len(fit.model.effects) == size]
            chosen += [fit for fit in own if self._worth(fit, chosen)][:1]
        return chosen[-1]

    def _worth(self, fit: Fit, fewer: Sequence[Fit]) -> bool:
        """Whether a model is preferred to some of fewer effects, and to itself with a plainer one.

        That is with none, or a special case, in the place of one of its effects.
        """
        ours = frozenset(fit.model.effects)
        keys = [key for e in ours for key in (ours - {e}, *self.special(ours, e))]
        plainer = [self.fits[key] for key in keys if key in self.fits]
        return all(self.prefers(fit, other) for other in (*fewer, *plainer))

    def special(self, ours: Effects, instance: EffectInstance) -> list[Effects]:
        """The sets of effects with a special case of one of them in its place."""
        rest = ours - {instance}
        return [rest | {c} for c in self.candidates if instance.holds(c) and c not in rest]

    def neighbours(self, fit: Fit, share: ComputeBudget, part: float = 0.0) -> list[Score]:
        """Fits the promising models that differ by one change; the scores of further effects.

        In the place of an effect is tried what promises a `part` of what that explains [-], if any.
        """
        ours, costly, scores = frozenset(fit.model.effects), fit.model.plant.costly, []
        if (ours, False) not in self.grown:
            scores = self.add(fit, self.candidates, SEARCH.shortlist, share, SEARCH.promising)
        self.grown |= {(ours, False), (ours, part > 0.0)}
        before = self.best()
        rests: dict[EffectInstance, Fit] = {}
        for instance in fit.model.effects if part and not share.used_up else ():
            near = (ours - {instance}, False) in self.grown if costly else fit is before
            there = self.fits.get(ours - {instance}) if near else None
            rests[instance] = there or self.keep(without(fit, [instance], self.windows, self.null))
        order = sorted(rests.items(), key=lambda pair: pair[1].chi2)
        for related, (instance, rest) in product((True, False), order):  # first what explains least
            known = costly and (ours - {instance}, False) in self.grown  # its best were fitted
            done = self.best() is not before or (known and not related)
            if share.used_up or done or (ours, related, instance) in self.grown:
                continue
            self.grown.add((ours, related, instance))
            some = [c for c in self.candidates if c != instance]
            if related:
                some = [c for c in some if c.holds(instance) or instance.holds(c)]
            least = (SEARCH.part_of_exchanged if related else part) * (rest.chi2 - fit.chi2)
            most = len(some) if related else SEARCH.exchanges
            self.add(rest, some, most, share, max(SEARCH.promising, least))
        return scores

    def scores(self, fit: Fit, new: Candidates) -> list[Score]:
        """Those of effects that a fit lacks."""
        ours, windows = frozenset(fit.model.effects), self.windows
        known, scores = self.screened.get(ours, (None, []))
        pulses = self.disturbance if fit.model.plant.costly else None
        if known is fit and pulses is None:
            return [score for score in scores if score.instance in new]
        scores = screen(fit, fit.linearised(windows), windows, new, pulses=pulses)
        if len(new) == len(_further(fit, self.candidates)):
            self.screened[ours] = fit, scores
        return scores

    def add(
        self, fit: Fit, candidates: Candidates, most: int, share: ComputeBudget, least: float
    ) -> list[Score]:
        """Fits the most promising models of one effect more; where there are random forces, twice.

        Beside these and without: they do what an effect would, of which then any size will do.
        """
        scores = self.add_beside(fit, candidates, most, share, least)
        if scores and not fit.model.plant.costly and np.any(self.judged(fit).gain >= VERDICT.sure):
            alone = on_windows(fit, bare := self.bare(fit))
            found = screen(alone, alone.linearised(bare), bare, _further(fit, candidates))
            for fitted in _larger(alone, bare, found, most, share, least):
                self.keep(weighed_anew(fitted, self.windows))
        return scores

    def add_beside(
        self, fit: Fit, candidates: Candidates, most: int, share: ComputeBudget, least: float
    ) -> list[Score]:
        """Fits `most` models at most of one effect more, of those that may gain the least."""
        new = _further(fit, candidates)
        if not new or len(fit.model.effects) == SEARCH.most_effects:
            return []
        scores = self.scores(fit, new)
        for fitted in _larger(fit, self.windows, scores, most, share, least):
            self.keep(fitted)
        return scores

    def bare(self, fit: Fit) -> Windows:
        """The windows with the noise of a fit, but without its random forces."""
        return self.disturbance.whitened(replace(self.judged(fit), std=0.0 * self.judged(fit).std))


def _further(fit: Fit, candidates: Candidates) -> list[EffectInstance]:
    """Those of candidates that a model does not have in some form."""
    return [c for c in candidates if not any(c == o or c.repeats(o) for o in fit.model.effects)]


def _numbers(fit: Fit) -> int:
    """Of a fit's numbers those that its effects bring."""
    return len(fit.theta) - fit.model.nuisances + len(fit.model.freed)


def _strained(fit: Fit) -> bool:
    """Whether it takes masses, or other nominal parameters, far from their priors."""
    return fit.model.penalty(fit.theta) > SEARCH.strained


def _left_over(
    evidence: Evidence, least_noise: float = SEARCH.least_noise
) -> Float[np.ndarray, " J_plus_X"]:
    """Variances of the random forces, and of noise beyond the reported one; none where small."""
    forces, noise = evidence.std**2, evidence.noise**2 - 1.0
    forces = np.where(evidence.std > SEARCH.least_force, forces, 0.0)
    return np.append(forces, np.where(noise > least_noise, noise, 0.0))


def search(
    model: PlantModel, windows: Windows, candidates: Candidates, hints: Sequence[Fit] = ()
) -> SearchResult:
    """Changes models as long as the evidence grows, the best ones first.

    Where the best model misses much, its motions answer to an effect in another way than measured
    ones. Then parts of the windows are searched too, and what fits them is tried on the windows. It
    begins without effects, and goes on from `hints`, fits to other windows of the machine.
    """
    share = model.budget.share(BUDGET.search)
    tried, scores = _search(model, windows, candidates, share, hints)
    compared = windows.y.shape[2] // SEARCH.parts - math.ceil(DATA.latency_s / windows.dt)
    longer = compared >= SEARCH.least_compared
    if longer and tried.judged(tried.best()).deficient and not share.used_up:
        short, _ = _search(model, split(windows, SEARCH.parts), candidates, share)
        scores = _improve(tried.following(short.ranked[: SEARCH.hints]), share) or scores
    if share.used_up:
        scores = _reconsider(tried, model.budget.share(BUDGET.search)) or scores
    (finish if model.plant.costly else confuse)(tried)
    best = tried.best()
    ranked = [(fit, tried.bic(fit)) for fit in tried.ranked if math.isfinite(tried.bic(fit))]
    told = tuple(sorted(ranked, key=lambda pair: pair[0] is not best)), tuple(scores)
    return SearchResult(best, tried.null, *told, tried.windows, tried.judged(best))


def simplify(tried: Tried) -> None:
    """Fits the best model in plainer forms, from where its own values are.

    Without what is needless, with special cases, with one effect for several that make it, and with
    effects of masses where it takes these from their priors.
    """
    best = tried.best()
    if not best.model.plant.costly:
        relieve(tried, best)
        _gather(tried, best)
        for instance in best.model.effects:
            tried.keep(without(best, [instance], tried.windows, tried.null))
    values = {e: list(v[0]) for e, v in best.model.effect_values(best.theta[None])}
    for plain in tried.candidates:
        for own in [own for own in values if own.holds(plain)]:
            _exchange(tried, best, [own], {plain: own.values_as(plain, values[own])})
        parts = [part for part in values if plain.repeats(part) or plain.holds(part)]
        made = plain.effect.made_of({part.effect.name: values[part] for part in parts})
        if made is not None:
            _exchange(tried, best, parts, {plain: made})
    if tried.best() is not best:
        simplify(tried)


def relieve(tried: Tried, fit: Fit, but: EffectInstance | None = None) -> None:
    """Fits a model with effects of masses, but one, where it takes these far from priors."""
    if _strained(fit):
        meant = [c for c in _of_masses(tried.candidates, tried.null) if c != but]
        share = fit.model.budget.share(1.0)
        tried.add_beside(fit, meant, SEARCH.relieving, share, SEARCH.strained)


def _gather(tried: Tried, fit: Fit) -> None:
    """Fits a model with one effect of masses in the place of several, which may imitate it.

    It begins with the nominal masses: without the several a fit bends these to do the same.
    """
    several = _of_masses(fit.model.effects, tried.null)
    model, theta = shrunk(fit, several, tried.null)
    ours, share = frozenset(model.effects), model.budget.share(1.0)
    if len(several) > 1 and (ours, True, several[0]) not in tried.grown:
        tried.grown.add((ours, True, several[0]))
        rest = on_windows(replace(fit, model=model, theta=model.nominal(theta)), tried.windows)
        meant = _of_masses(tried.candidates, tried.null)
        tried.add(rest, meant, SEARCH.shortlist, share, SEARCH.promising)


def _of_masses(effects: Iterable[EffectInstance], null: Fit) -> list[EffectInstance]:
    """Those that change bodies, or parameters that a prior holds."""
    return [e for e in effects if e.effect.place == "body" or null.model.frees(e) is not None]


def _exchange(
    tried: Tried, fit: Fit, gone: Candidates, new: dict[EffectInstance, list[float]]
) -> None:
    """Fits a model with others in the place of some effects, from these values of them."""
    model, theta = shrunk(fit, gone, tried.null)
    for instance, values in new.items():
        if any(instance == other or instance.repeats(other) for other in model.effects):
            return
        model, theta = model.grown(theta, instance, values)
    if len(model.effects) > SEARCH.most_effects:
        return
    other = tried.keep(fit_model(model, tried.windows, theta, fit.x0, iterations=8))
    if tried.bic(other) > tried.bic(fit) and not model.plant.costly:  # its starts were the fit's
        x0 = fit_initial_states(other.model, tried.windows, other.theta)
        tried.keep(fit_model(other.model, tried.windows, other.theta, x0, iterations=8))


def finish(tried: Tried) -> None:
    """Fits to the end what explains half as much as the best model, with as many effects.

    Where a simulation is dear fits end soon: a lag is preferred to a delay that has some way to go.
    The best one's effects are tried in other sizes.
    """
    null, best = tried.bic(tried.null), tried.best()
    enough = SEARCH.as_much * (null - tried.bic(best))
    rivals = [fit for fit in tried.ranked if len(fit.model.effects) == len(best.model.effects)]
    for fit in rivals[: SEARCH.refined]:
        if null - tried.bic(fit) >= enough:
            tried.keep(refit(fit, tried.windows))
    for instance in tried.best().model.effects:
        tried.keep(resized(tried.best(), instance, tried.windows, SEARCH.resized, anew=True))


def confuse(tried: Tried) -> None:
    """Fits the best model with what does the same to its motions in the place of an effect.

    A pendulum's gain may as well be its mass, a motor under a voltage a friction and a lag.
    """
    best = tried.best()
    scores = tried.scores(best, _further(best, tried.candidates))
    share = best.model.budget.for_stage()
    best = best.allowed(share)
    for instance, (values, *_) in best.model.effect_values(best.theta[None]):
        for pair in combinations([c for c in tried.candidates if instance.holds(c)], 2):
            if instance.effect.made_of({p.effect.name: list(p.effect.neutral) for p in pair}):
                parts = {part: instance.values_as(part, values) for part in pair}
                _exchange(tried, best, [instance], parts)
    same = [score.instance for score in scores if score.sensitivity < VERDICT.unseen]
    for instance in best.model.effects:
        model, theta = shrunk(best, [instance], tried.null)
        rest = replace(best, model=model, theta=theta)  # the others stay as they are
        own = max(score.gain for score in tried.scores(rest, [instance]))
        tried.add_beside(rest, same, len(same), share, SEARCH.part_of_exchanged * own)
        relieve(tried, tried.keep(without(best, [instance], tried.windows, tried.null)), instance)
    if {*tried.best().model.effects} != {*best.model.effects}:
        confuse(tried)


def _reconsider(tried: Tried, share: ComputeBudget) -> list[Score]:
    """Exchanges effects of the best model for what does as much, where a search ended too soon.

    What came first may be an image of the right effect; the scores of further effects.
    """
    best = tried.best()
    for fit in (tried.ranked[0], best):  # the likeliest may have a needless effect
        tried.grown.add((frozenset(fit.model.effects), False))  # nothing is added any more
        tried.neighbours(fit, share, SEARCH.as_much)
        if tried.best() is not best:
            return _improve(tried, share)
    return []


def _search(
    model: PlantModel,
    windows: Windows,
    candidates: Candidates,
    share: ComputeBudget,
    hints: Sequence[Fit] = (),
) -> tuple[Tried, list[Score]]:
    """The models that were tried on some windows, and the scores of further effects."""
    null, windows = fit_nominal(model, windows)
    tried = Tried.begun(null, windows, candidates)
    return tried, _improve(tried.following(hints) if hints else tried, share)


def _improve(tried: Tried, share: ComputeBudget) -> list[Score]:
    """Tries the neighbours of the best models until none is better; scores of further effects."""
    weighed, idle = tried.best(), 0  # whose random forces weigh all
    scores: list[Score] = []
    simplify(tried)
    while idle <= SEARCH.patience and not share.used_up:
        known = tried.bic(best := tried.best())
        scores = tried.neighbours(best, share) or scores
        if best.model.plant.costly and not idle and tried.best() is best:
            relieve(tried, best)
        if tried.best() is best:  # there is nothing to add
            for fit in _next(tried, best):
                part = SEARCH.part_of_exchanged if tried.bic(fit) <= tried.bic(best) else 0.0
                told = tried.neighbours(fit, share, part)
                scores = told if fit is best and told else scores
        best = tried.best()
        if best is not weighed or known - tried.bic(best) > SEARCH.bic_gain:
            tried.weigh_by(best)
            tried.keep(fit_model(best.model, tried.windows, best.theta, best.x0))
            weighed, idle = tried.best(), 0
            simplify(tried)
        else:
            idle += 1
    return scores


def _next(tried: Tried, best: Fit) -> list[Fit]:
    """The best model and the next ones by their evidence, whose neighbours are not known yet.

    What still misses an effect may bend nominal parameters to imitate it, which costs it its rank
    alone; of three effects none may explain what the others leave over. So models go on that are
    far likelier than the best one; its special cases, which may miss but one further effect; and if
    it takes masses far from their priors, the likeliest one that does not. Where a simulation is
    dear and the best one leaves nothing over, nothing but these goes on.
    """
    most, known = tried.judged(best).deviance - SEARCH.bic_gain, tried.bic(best)
    closed = best.model.plant.costly and not _left_over(tried.judged(best)).any()
    ours = frozenset(best.model.effects)
    open_ = [
        fit
        for fit in tried.ranked
        if (frozenset(fit.model.effects), tried.bic(fit) <= known) not in tried.grown
        and (tried.judged(fit).deviance < most or tried.bic(fit) <= known)
        and not (ours < frozenset(fit.model.effects) and known - tried.bic(fit) < SEARCH.bic_gain)
    ]
    rest = [fit for fit in open_ if fit is not best and not closed]
    closest = sorted(rest, key=lambda fit: tried.judged(fit).deviance)[:1]
    keys = [key for each in best.model.effects for key in tried.special(ours, each)]
    special = [tried.fits[k] for k in keys if k in tried.fits and (k, False) not in tried.grown]
    eased = [fit for fit in tried.ranked if not _strained(fit)][:1] if _strained(best) else []
    eased = [fit for fit in eased if (frozenset(fit.model.effects), False) not in tried.grown]
    chosen = [*(fit for fit in open_ if fit is best), *special, *rest[: SEARCH.beam]]
    return list({id(fit): fit for fit in (*chosen, *closest, *eased)}.values())


def _larger(
    fit: Fit,
    windows: Windows,
    scores: Sequence[Score],
    most: int,
    share: ComputeBudget,
    least: float,
) -> Iterator[Fit]:
    """The closest fits of models of one effect more, of those that may gain the least."""
    lin, dear = fit.linearised(windows), fit.model.plant.costly
    least = max(least, SEARCH.part_of_exchanged * (scores[0].gain if dear and scores else 0.0))
    begun: dict[Effects, Fit] = {}
    some = np.arange(0, len(windows), SEARCH.thinned)
    few, view = windows[some], fit.at(some)
    for score in scores:
        key = frozenset({*fit.model.effects, score.instance})
        if score.gain < least or (key not in begun and len(begun) == most):
            continue
        if share.used_up:
            break
        if (grown := grow(view, score, few, lin[some])) is None:
            continue
        begun[key] = min(begun.get(key, grown), grown, key=lambda each: each.chi2)
        taken = (view.by_window.sum() - grown.chi2) * len(windows) / len(few)
        if fit.model.plant.timestep_s and taken >= score.gain:  # far less cannot compare
            least = max(least, SEARCH.as_much * score.gain)
    closest = sorted(begun.values(), key=lambda grown: grown.chi2)
    if dear and closest:  # those that explain half of what the first does
        enough = 0.5 * (view.by_window.sum() + closest[0].chi2)
        closest = [grown for grown in closest if grown.chi2 <= enough]
    near = lin if dear and not fit.model.learned else None
    for grown in closest[: SEARCH.refined]:
        x0 = fit.x0.copy()
        x0[some] = grown.x0
        if dear:  # the model without the effect has led them astray
            x0 = improved_initial_states(grown.model, windows, grown.theta, x0, FIT.few)
        yield fit_model(grown.model, windows, grown.theta, x0, 8, near=near)


def grow(fit: Fit, score: Score, windows: Windows, lin: Linearised) -> Fit | None:
    """The closest fit of a model with one effect more, from the sizes at which it misses least.

    `lin` is how the fit's model changes on the windows. Where dear, None if no size misses less.
    """
    starts = _begun(fit, score, windows, lin)[: SEARCH.starts]
    near = None if fit.model.learned else lin
    fits = [fit_model(*start, iterations=4, hasty=True, near=near) for start in starts]
    best = min(fits, key=lambda each: each.chi2, default=None)
    if best is None or not best.model.plant.costly:
        return best
    return resized(best, score.instance, windows, anew=not best.model.plant.timestep_s)


def _begun(fit: Fit, score: Score, windows: Windows, lin: Linearised) -> list[Start]:
    """The models with an effect in sizes at which it may begin, the best first; see `grow`."""
    effect, model = score.instance.effect, fit.model.having(score.instance)
    sized = effect.amplitudes & np.isfinite(effect.neutral)
    thetas: dict[bytes, Theta] = {}
    for part in SEARCH.begun:
        with np.errstate(invalid="ignore"):  # of a limit that is nowhere
            scaled = effect.neutral + part * (score.start - effect.neutral)
        values = np.where(sized, scaled, score.start)
        theta = fit.model.grown(fit.theta, score.instance, values)[1]
        thetas[theta.tobytes()] = theta
    dear, begun = model.plant.costly, []
    for theta in thetas.values():
        at = model, windows, theta
        # where dear initial states give way first, and what does not help then never does
        x0, missed = given_way(*at, fit.x0, lin.Jx) if dear else (fit.x0, misfits(*at, fit.x0))
        begun.append(((*at, x0), missed))
    order = np.argsort([np.log(np.maximum(m / windows.samples, 1.0)).sum() for _, m in begun])
    least = np.log(fit.by_window).sum() if dear else np.inf
    return [begun[n][0] for n in order if np.log(begun[n][1]).sum() < least]


def resized(
    fit: Fit,
    instance: EffectInstance,
    windows: Windows,
    factors: Sequence[float] = SEARCH.resized[:1],
    anew: bool = False,
) -> Fit:
    """The fit with an effect some times as large, as long as that misses less.

    Initial states are fitted to each size, and also `anew`. Behind an impact, or where a model is
    far off, some windows answer to the least change of an effect beyond all proportion, and hold
    its size where it is, though at another all of them together are missed less.
    """
    robust = Robust.of(fit.by_window, windows.samples)
    for factor in factors:
        while True:
            theta = fit.model.scaled(fit.theta, instance, factor)
            x0 = improved_initial_states(fit.model, windows, theta, fit.x0, FIT.few)
            starts = x0, misfits(fit.model, windows, theta, x0)
            if anew:
                every = np.ones(len(windows), dtype=bool)
                starts = recovered(fit.model, windows, theta, *starts, every)
            other = Fit(fit.model, theta, *starts)
            falls = robust.cost(other.by_window) < robust.cost(fit.by_window)
            if not falls or (theta == fit.theta).all():
                break
            fit = other
    return fit


def without(fit: Fit, gone: Iterable[EffectInstance], windows: Windows, null: Fit) -> Fit:
    """The fit of a model without some of its effects."""
    model, theta = shrunk(fit, gone, null)
    return fit_model(model, windows, theta, fit.x0, iterations=12, hasty=True)


def shrunk(fit: Fit, gone: Iterable[EffectInstance], null: Fit) -> tuple[PlantModel, Theta]:
    """The model without some of its effects, and theta; a parameter gets the prior of no effect."""
    model, theta = fit.model, fit.theta
    for instance in gone:
        parameter = model.plant.parameter_of(instance)
        model, theta = model.shrunk(theta, instance, null.model.priors.get(parameter or "", np.inf))
    return model, theta


def nested_fits(result: SearchResult, best: Fit) -> tuple[Fit, ...]:
    """Fits of a search: the best of one of a fit's effects, the best of two with this one, ..."""
    ours, steps, chosen = {*best.model.effects}, list[Fit](), set[EffectInstance]()
    for size in range(1, len(ours)):
        own = [fit for fit in result.fits if len(fit.model.effects) == size]  # the best first
        steps += [fit for fit in own if chosen <= {*fit.model.effects} <= ours][:1]
        chosen = {*(steps[-1].model.effects if steps else ())}
    return tuple(steps)
