"""Searching what is missing: which sets of effects explain the recordings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit, fit, linearise, misfits, remembered, settle
from mcpilco.gap.model import Model
from mcpilco.gap.screen import Score, screen
from mcpilco.gap.where import correlation_time, residuals
from mcpilco.gap.windows import Windows
from mcpilco.plant import EffectInstance

ENOUGH = 15.0
"""least gain in BIC for which an effect is added"""
SAME = 0.01
"""difference in BIC below which models do the same"""
PROMISING = 25.0
"""least score for which an effect is tried"""
FRACTION = 3e-5
"""least part of the nominal misfit that a further effect must explain"""
PART = 0.05
"""least part of what is left over beyond the noise that a further effect must explain"""
SHORTLIST, BEAM = (8, 5, 4), (3, 4, 4)
"""effects that are tried on a model that has none, one, two; models that are carried on then"""
BEGUN = 1.0, 0.25, 0.0625
"""of the size that a linear response tells, from the best of which an effect is fitted"""
MOST, ROUNDS = 3, 5
"""effects; rounds of a search, of which some only drop what became superfluous: both at most"""
HOPELESS = 0.5
"""part of the nominal misfit that two effects leave over, beyond which no third is sought"""
SHARE = 0.4
"""of the steps left to an investigation, for a search"""
CAP = 9.0
"""how many times the median misfit a window may weigh in a comparison"""


@dataclass(frozen=True)
class Found:
    """What a search has seen."""

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
        return [known for known, _ in self.ranked]

    def choosing(self, best: Fit) -> Found:
        """This search, with another of its fits as the best."""
        rest = tuple(pair for pair in self.ranked if pair[0] is not best)
        own = next(pair for pair in self.ranked if pair[0] is best)
        return replace(self, best=best, ranked=(own, *rest))

    def with_best(self, best: Fit, seen: Iterable[Fit]) -> Found:
        """This search with its best fit, and all that were seen, judged by what that leaves."""
        yardstick = Yardstick.of(best, self.windows)
        judged = [(found, yardstick.bic(found)) for found in seen if found is not best]
        finite = [pair for pair in judged if math.isfinite(pair[1])]
        rest = sorted(finite, key=lambda pair: pair[1])
        return replace(self, best=best, ranked=((best, yardstick.bic(best)), *rest))


def search(model: Model, windows: Windows, candidates: Sequence[EffectInstance]) -> Found:
    """Adds effects as long as they explain more: a beam search over sets of effects.

    Each level scores all candidates on each of the best models, fits the most promising ones, and
    goes on with the best of these. An effect that the others make superfluous is dropped again. A
    search whose share of the steps is used up ends with what it has seen.

    Args:
        model: without effects.
        windows: of the recordings.
        candidates: effects that may be missing.
    """
    share = model.effort.share(SHARE)
    theta = np.zeros(model.nuisances)
    windows = remembered(model, windows, theta)
    starts = settle(model, windows, theta)
    null = fit(model, windows, theta, starts)
    best, beam = null, [null]
    seen: dict[frozenset[EffectInstance], Fit] = {frozenset(): null}
    scores: list[Score] = []
    for _ in range(ROUNDS):
        if not beam or (level := len(beam[0].model.named)) == MOST:
            break
        grown: list[Fit] = []
        for number, known in enumerate(share.lasting(beam)):
            lin = linearise(known.model, windows, known.theta, known.starts)
            new = [c for c in candidates if c not in known.model.named]
            listed = screen(known, lin, windows, new)
            if number == 0:
                scores = listed
            tried: dict[frozenset[EffectInstance], Fit] = {}
            for score in listed:
                key = frozenset({*known.model.named, score.active})
                fine = key in seen and seen[key].chi2 <= known.chi2
                if score.gain < PROMISING or (fine and key not in tried):
                    continue
                if key not in tried and len(tried) == SHORTLIST[level]:
                    continue
                if share.used_up:
                    break
                fitted = grow(known, score, windows)
                if key not in tried or fitted.chi2 < tried[key].chi2:
                    tried[key] = fitted
            better = {k: f for k, f in tried.items() if k not in seen or f.chi2 < seen[k].chi2}
            seen |= better
            grown += better.values()
        if not grown:
            break
        yardstick = Yardstick.of(min(grown, key=lambda found: found.chi2), windows)
        grown = _in_order(grown, yardstick)
        worth = [f for f in grown if yardstick.prefers(f, best, null)]
        closest = min(found.chi2 for found in grown)
        if not worth:
            if closest >= HOPELESS * best.chi2:
                break
            beam = _followed(grown, BEAM[level])  # its parameters bend for what else is missing
            continue
        leaner = without_superfluous(worth[0], windows, seen, model.priors, yardstick, null)
        done = {*leaner.model.named} == {*best.model.named} and best.chi2 - leaner.chi2 < ENOUGH
        best = leaner
        if done or (level and closest > HOPELESS * null.chi2):
            break
        beam = [best, *_followed([f for f in grown if f is not worth[0]], BEAM[level] - 1)]
    return Found(best, null, (), tuple(scores), windows).with_best(best, seen.values())


def _in_order(grown: Sequence[Fit], yardstick: Yardstick) -> list[Fit]:
    """Models by their BIC; of those that do the same, the first has the usual effect.

    A delay of the only actuator and one of the only sensor differ by rounding. Which of them is
    named should not depend on that.
    """
    judged = sorted(((yardstick.bic(found), found) for found in grown), key=lambda pair: pair[0])
    least, usual = judged[0][0], list(grown[0].model.plant.catalogue)
    same = [found for bic, found in judged if bic - least < SAME]
    same.sort(key=lambda f: [usual.index(active.effect.name) for active in f.model.named])
    return [*same, *(found for _, found in judged[len(same) :])]


def _followed(grown: Sequence[Fit], count: int) -> list[Fit]:
    """Models to carry on beside the best: those of the smallest BIC, and the one that fits best.

    What still misses an effect may bend the nominal parameters far beyond their priors to imitate
    it. That costs it its rank, but it is one effect away from what is there. Of models that do the
    same one is enough. Those that have as many effects as may be end here.
    """
    grown = [found for found in grown if len(found.model.named) < MOST]
    apart = [g for k, g in enumerate(grown) if all(abs(g.chi2 - o.chi2) >= SAME for o in grown[:k])]
    followed = apart[:count]
    closest = min(grown, key=lambda found: found.chi2, default=None)
    if closest is not None and all(closest is not found for found in followed):
        followed.append(closest)
    return followed


def grow(known: Fit, score: Score, windows: Windows) -> Fit:
    """The fit of a model with one effect more, from where the score would begin."""
    starts = [known.model.grown(known.theta, score.active, x) for x in _smaller(score)]
    misfit = [_log_misfit(model, windows, theta, known) for model, theta in starts]
    model, theta = starts[int(np.argmin(misfit))]
    return fit(model, windows, theta, known.starts, iterations=12, hasty=True)


def _smaller(score: Score) -> Iterator[Float[np.ndarray, " symbols"]]:
    """The values from which a score would begin, and such of a smaller effect.

    A linear response overrates what moves a motion far.
    """
    neutral = score.active.effect.neutral
    amplitudes = score.active.effect.amplitudes & np.isfinite(neutral)
    for part in BEGUN:
        with np.errstate(invalid="ignore"):  # of a limit that is nowhere
            begun = neutral + part * (score.start - neutral)
        yield np.where(amplitudes, begun, score.start)


def _log_misfit(
    model: Model, windows: Windows, theta: Float[np.ndarray, " p"], known: Fit
) -> float:
    """Sum of the log misfits of windows, their starts as they are in a fit."""
    by_window = misfits(model, windows, theta, known.starts)
    return float(np.log(np.maximum(by_window / windows.samples, 1.0)).sum())


def without(
    known: Fit, active: EffectInstance, windows: Windows, priors: Mapping[str, float]
) -> Fit:
    """The fit of a model without one of its effects; `priors` are those of parameters."""
    parameter = known.model.plant.parameter_of(active)
    model, theta = known.model.shrunk(known.theta, active, priors.get(parameter or "", np.inf))
    return fit(model, windows, theta, known.starts, iterations=12, hasty=True)


def without_superfluous(
    best: Fit,
    windows: Windows,
    seen: dict[frozenset[EffectInstance], Fit],
    priors: Mapping[str, float],
    yardstick: Yardstick,
    null: Fit,
) -> Fit:
    """The fit without those of its effects that explain nothing, now that the others are there."""
    for active in best.model.named if len(best.model.named) > 1 else ():
        smaller = without(best, active, windows, priors)
        key = frozenset(smaller.model.named)
        if key not in seen or smaller.chi2 < seen[key].chi2:
            seen[key] = smaller
        if not yardstick.prefers(best, seen[key], null):
            return seen[key]
    return best


@dataclass(frozen=True)
class Yardstick:
    """By what misfits are judged: as noise where they are noise, else by the best model's misfit.

    A model of a real machine never fits to the noise of the sensors, and what it leaves over is
    correlated in time. Misfits are then measured in units of what the best model leaves over, and
    count as many samples as are independent of one another.
    """

    windows: Windows
    cap: float
    """squared misfit of a sample beyond which a window counts no further"""
    inflation: float
    """misfit of an independent sample, at least 1"""
    samples: float
    """how many of these there are"""

    @classmethod
    def of(cls, best: Fit, windows: Windows) -> Yardstick:
        """The yardstick of a model that fits well."""
        samples = windows.samples
        by_sample = best.by_window / samples
        cap = CAP * max(1.0, float(np.median(by_sample)))
        misfit = float(np.minimum(best.by_window, cap * samples).sum() / samples.sum())
        repeated = windows.overlap * correlation_time(residuals(best, windows))
        return cls(windows, cap, max(1.0, misfit) * repeated, samples.sum() / repeated)

    def bic(self, found: Fit) -> float:
        """Bayesian information criterion; no window weighs more than some times the median.

        It is infinite where an effect is larger than what could be meant.

        Reference: Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978).
        """
        if not found.model.plausible(found.theta):
            return math.inf
        prior = float((found.model.precision * found.theta**2).sum())
        parameters = len(found.theta) - found.model.nuisances + len(found.model.freed)
        return self.misfit(found) / self.inflation + prior + parameters * math.log(self.samples)

    def misfit(self, found: Fit) -> float:
        """Squared residuals; no window weighs more than some times the median."""
        return float(np.minimum(found.by_window, self.cap * self.windows.samples).sum())

    def prefers(self, larger: Fit, smaller: Fit, null: Fit) -> bool:
        """Whether a model with more effects is worth them; `null` has none.

        An effect must explain a part of the whole gap, so that none is named for what two
        integrators do differently, and a part of what the smaller model leaves over, so that none
        is named for what is far too small beside noise that nobody told of. One that comes down to
        an uncertain parameter need not: its prior says what is small.
        """
        if len(larger.model.freed) > len(smaller.model.freed):
            return self.bic(smaller) - self.bic(larger) >= ENOUGH
        noise = float(self.windows.measured.sum())
        small = max(FRACTION * (null.chi2 - noise), PART * (self.misfit(smaller) - noise))
        return self.bic(smaller) - self.bic(larger) >= max(ENOUGH, small / self.inflation)
