"""Special cases: the plainest effects that explain the recordings.

A search comes first upon what bends most readily to what it sees. Friction that is alike in both
directions is Coulomb's all the same, and one that is not may be Coulomb's beside an offset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mcpilco.gap.exchange import SHARE, further, instead
from mcpilco.gap.fit import Fit
from mcpilco.gap.search import MOST, Found, Yardstick
from mcpilco.gap.validate import fits_roughly, promising
from mcpilco.gap.windows import Windows
from mcpilco.plant import EffectInstance


def plainer(found: Found, candidates: Sequence[EffectInstance]) -> Found:
    """The search, its best model's effects replaced by special cases that explain as much.

    The model of special cases alone is among what was seen, even where it explains less. Where no
    model fits to the noise, so are those of all that are promising, and this one with one effect
    more.

    Args:
        found: a search.
        candidates: effects that may be missing.
    """
    windows, null = found.windows, found.null
    seen = {frozenset(known.model.named): known for known, _ in found.ranked}
    cases = _Cases(windows, candidates, null.model.priors, seen)
    best = plainest = found.best
    for active in found.best.model.named:
        simple = cases.special(best, active)
        plainest = simple if plainest is best else cases.special(plainest, active)
        if not Yardstick.of(best, windows).prefers(best, simple, null):
            best = simple
    if fits_roughly(best, windows):
        for known in null.model.effort.share(SHARE).lasting(promising(found.fits)):
            cases.plainest(known)
        if plainest is not best:
            cases.grow(plainest)
    return found.with_best(seen[frozenset(best.model.named)], seen.values())


@dataclass(frozen=True)
class _Cases:
    """Models of special cases, and those of all fits that were seen."""

    windows: Windows
    candidates: Sequence[EffectInstance]
    priors: Mapping[str, float]
    seen: dict[frozenset[EffectInstance], Fit] = field(default_factory=dict)

    def special(self, known: Fit, active: EffectInstance) -> Fit:
        """The model with the special case of an effect in its place; itself where there is none."""
        rest = {*known.model.named} - {active}
        case = next((c for c in self.candidates if active.holds(c) and c not in rest), None)
        if case is None:
            return known
        for key, simple in instead(known, active, [case], self.windows, self.priors):
            self.seen[key] = min([simple, self.seen.get(key, simple)], key=lambda fit: fit.chi2)
        return self.seen.get(frozenset({*rest, case}), known)

    def plainest(self, known: Fit) -> Fit:
        """The model with all its special cases."""
        for active in known.model.named:
            known = self.special(known, active)
        return known

    def grow(self, known: Fit) -> None:
        """Models with one effect more, the most promising ones that hold none of those there."""
        named = known.model.named
        if len(named) < MOST:
            new = [c for c in self.candidates if c not in named and not any(map(c.holds, named))]
            self.seen.update(further(known, self.windows, new))
