"""Naming what is missing: which sets of effects explain the recordings, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit, fit, linearise, remembered, settle
from mcpilco.gap.model import Model
from mcpilco.gap.screen import Score, screen
from mcpilco.gap.windows import Windows
from mcpilco.plant import Active

ENOUGH = 30.0
"""least gain in BIC for which an effect is added"""
PROMISING = 25.0
"""least score for which an effect is tried"""
FRACTION = 5e-4
"""least part of the nominal misfit that a further effect must explain"""
SHORTLIST = 8, 5
"""effects that are tried: on the nominal model, and on one that has effects already"""
BEAM = 3
"""models that are carried on"""
MOST = 3
"""effects at most"""
CAP = 9.0
"""how many times the median misfit a window may weigh in a comparison"""


@dataclass(frozen=True)
class Found:
    """What a search has seen."""

    best: Fit
    """of the smallest BIC that its gains justify"""
    null: Fit
    """of no effect"""
    others: tuple[Fit, ...]
    """all other fits, best first"""
    scores: tuple[Score, ...]
    """of the effects that the best does not have"""


def search(model: Model, windows: Windows, candidates: Sequence[Active]) -> Found:
    """Adds effects as long as they explain more: a beam search over sets of effects.

    Each level scores all candidates on each of the best models, fits the most promising ones, and
    goes on with the best of these. An effect that the others make superfluous is dropped again.

    Args:
        model: without effects.
        windows: of the recordings.
        candidates: effects that may be missing.
    """
    theta = np.zeros(model.nuisances)
    windows = remembered(model, windows, theta, windows.guess)
    starts = settle(model, windows, theta, windows.guess)
    null = fit(model, windows, theta, starts)
    best, beam, seen = null, [null], {frozenset(): null}
    scores: list[Score] = []
    for level in range(MOST):
        grown: list[Fit] = []
        for number, known in enumerate(beam):
            lin = linearise(known.model, windows, known.theta, known.starts)
            new = [c for c in candidates if c not in known.model.actives]
            listed = screen(known, lin, windows, new)
            if number == 0:
                scores = listed
            limit = SHORTLIST[min(level, 1)]
            for score in listed[:limit]:
                key = frozenset({*known.model.actives, score.active})
                if score.gain > PROMISING and key not in seen:
                    seen[key] = _grow(known, score, windows)
                    grown.append(seen[key])
        if not grown:
            break
        grown = sorted(grown, key=lambda found: bic(found, windows, best))
        needed = max(ENOUGH, FRACTION * (null.chi2 - null.by_window.size))
        gain = bic(best, windows, best) - bic(grown[0], windows, best)
        if gain < needed:
            break
        best = _without_superfluous(grown[0], windows, seen)
        beam = [best, *(f for f in grown[1:BEAM])]
    others = sorted(
        (f for f in seen.values() if f is not best), key=lambda found: bic(found, windows, best)
    )
    return Found(best, null, tuple(others), tuple(scores))


def _grow(known: Fit, score: Score, windows: Windows) -> Fit:
    """The fit of a model with one effect more, from where the score would begin."""
    model = known.model.having(score.active)
    added = model.encode([*known.effects, score.start])
    theta = np.concatenate([known.theta, added[len(known.theta) :]])
    return fit(model, windows, theta, known.starts, iterations=12)


def _without_superfluous(best: Fit, windows: Windows, seen: dict) -> Fit:
    """The fit without those of its effects that explain nothing, now that the others are there."""
    for number in range(len(best.model.actives) - 1):
        model = best.model.without(number)
        key = frozenset(model.actives)
        span = best.model.spans()[number]
        theta = np.delete(best.theta, np.arange(span.start, span.stop))
        smaller = fit(model, windows, theta, best.starts, iterations=12)
        if key not in seen or smaller.chi2 < seen[key].chi2:
            seen[key] = smaller
        if bic(seen[key], windows, best) - bic(best, windows, best) < ENOUGH:
            return seen[key]
    return best


def bic(found: Fit, windows: Windows, reference: Fit) -> float:
    """Bayesian information criterion; no window weighs more than some times the median.

    Reference: Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978).
    """
    samples = windows.measured.sum(axis=(1, 2))
    typical = float(np.median(reference.by_window / np.maximum(samples, 1)))
    misfit = np.minimum(found.by_window, CAP * max(1.0, typical) * samples).sum()
    prior = float((found.model.precision * found.theta**2).sum())
    parameters = len(found.theta) - found.model.nuisances
    return float(misfit) + prior + parameters * math.log(samples.sum())


def whiteness(found: Fit, residuals: Float[np.ndarray, "W X T"], lags: int = 8) -> float:
    """Mean over lags of N rho^2, pooled over windows and channels: about 1 for white residuals."""
    r = residuals - 0.0
    size = np.einsum("wxt,wxt->", r, r)
    count = np.count_nonzero(r)
    total = 0.0
    for lag in range(1, lags + 1):
        rho = np.einsum("wxt,wxt->", r[:, :, lag:], r[:, :, :-lag]) / size
        total += count * rho**2
    return total / lags
