"""Exchanging effects: a search that only adds may hold on to one that looks like the true one.

Alone a delay can explain more than the lag that is there, and dry friction more than one that is
stronger at rest, as long as others are missing. Once these are found, the model still does not fit,
and no further effect mends it: one must go and another come in its place.

Reference: Miller, Subset Selection in Regression (2002), section 3.5: sequential replacement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from mcpilco.gap.effort import Share
from mcpilco.gap.fit import Fit, linearise
from mcpilco.gap.screen import screen
from mcpilco.gap.search import (
    ENOUGH,
    HOPELESS,
    Found,
    Yardstick,
    grow,
    without,
    without_superfluous,
)
from mcpilco.gap.where import structure
from mcpilco.gap.windows import Windows
from mcpilco.plant import EffectInstance

UNFIT = 50.0
"""whiteness of what a model leaves over beyond which an exchange may help"""
SHARE = 0.15
"""of the steps left to an investigation, for exchanges"""
TRIED, ROUNDS = 3, 4
"""effects that are tried in the place of one; exchanges, at most"""

Seen = dict[frozenset[EffectInstance], Fit]
"""fits by their effects"""


def exchanged(found: Found, candidates: Sequence[EffectInstance]) -> Found:
    """The search, its best model's effects exchanged for others as long as these explain more.

    Args:
        found: a search.
        candidates: effects that may be missing.
    """
    windows, best = found.windows, found.best
    share = best.model.effort.share(SHARE)
    seen: Seen = {frozenset(known.model.named): known for known, _ in found.ranked}
    for _ in range(ROUNDS):
        if share.used_up or not best.model.named or best.chi2 > HOPELESS * found.null.chi2:
            break
        if structure(best, windows).whiteness < UNFIT:
            break
        others = dict(_others(best, windows, candidates, seen, found.null.model.priors, share))
        seen |= others
        yardstick = Yardstick.of(min([best, *others.values()], key=_misfit), windows)
        better = min([best, *others.values()], key=yardstick.bic)
        if yardstick.bic(best) - yardstick.bic(better) < ENOUGH:
            break
        best = better
    if best is found.best:
        return found
    yardstick = Yardstick.of(best, windows)
    priors = found.null.model.priors
    return found.with_best(
        without_superfluous(best, windows, seen, priors, yardstick, found.null), seen.values()
    )


def _misfit(found: Fit) -> float:
    return found.chi2


def _others(
    best: Fit,
    windows: Windows,
    candidates: Sequence[EffectInstance],
    seen: Seen,
    priors: Mapping[str, float],
    share: Share,
) -> Iterator[tuple[frozenset[EffectInstance], Fit]]:
    """Models with another effect in the place of one, that were not seen yet."""
    for active in share.lasting(best.model.named):
        rest = {*best.model.named} - {active}
        new = [c for c in candidates if frozenset({*rest, c}) not in seen]
        yield from instead(best, active, new, windows, priors)


def instead(
    best: Fit,
    active: EffectInstance,
    candidates: Sequence[EffectInstance],
    windows: Windows,
    priors: Mapping[str, float],
) -> Iterator[tuple[frozenset[EffectInstance], Fit]]:
    """Models with one of some candidates in the place of an effect, the most promising ones."""
    if not candidates:
        return
    yield from further(without(best, active, windows, priors), windows, candidates)


def further(
    known: Fit, windows: Windows, candidates: Sequence[EffectInstance]
) -> Iterator[tuple[frozenset[EffectInstance], Fit]]:
    """Models with one of some candidates more, the most promising ones."""
    lin = linearise(known.model, windows, known.theta, known.starts)
    for score in screen(known, lin, windows, candidates, per_effect=1)[:TRIED]:
        yield frozenset({*known.model.named, score.active}), grow(known, score, windows)
