"""Naming what is missing: the effects of the best set, how large they are, and how sure that is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from mcpilco.gap.fit import Fit, linearise
from mcpilco.gap.search import Found, Yardstick, without
from mcpilco.gap.windows import Windows
from mcpilco.plant import EffectInstance


@dataclass(frozen=True)
class Estimate:
    """A parameter of a named effect."""

    value: float
    """best one"""
    low: float
    """lower end of the 95 % interval"""
    high: float
    """upper end"""
    unit: str
    """of all three"""


@dataclass(frozen=True)
class Named:
    """An effect that is missing in the plant."""

    name: str
    """of the effect"""
    target: str
    """where it acts"""
    parameters: dict[str, Estimate]
    """by symbol"""
    probability: float
    """that it belongs to the set of missing effects [-]"""
    family: tuple[str, ...]
    """effects, itself first, that these recordings cannot tell from it"""


TIED = 20.0
"""difference in BIC below which sets of effects cannot be told apart"""


@dataclass(frozen=True)
class Rival:
    """A model that has another effect in the place of one."""

    active: EffectInstance
    """the other effect"""
    fit: Fit
    behind: float
    """its BIC less that of the best model"""

    def holds(self, active: EffectInstance) -> bool:
        """Whether an effect is a special case of the other, which then cannot be worse."""
        return self.active.holds(active)


def rivals(found: Found, active: EffectInstance) -> list[Rival]:
    """The models of a search that differ from its best one by another effect for one of its own."""
    ours = set(found.best.model.named)
    listed = []
    for fitted, b in found.ranked:
        theirs = set(fitted.model.named)
        if active not in theirs and len(theirs) == len(ours) and len(theirs - ours) == 1:
            listed.append(Rival(next(iter(theirs - ours)), fitted, b - found.ranked[0][1]))
    return listed


def certain(
    found: Found, best: Fit, null: Fit, windows: Windows
) -> tuple[Found, Fit, tuple[Named, ...]]:
    """The search, its best model and what that names, without effects that may well be none.

    A search looks at some windows, and may follow what is in these alone. On all of them the
    interval of such an effect holds the size of none, and without it they are explained as well.
    Where few windows tell of a machine that no model fits, an interval alone may be too wide.

    Args:
        found: the search.
        best: its best model, fitted to all windows.
        null: the model of no effect, likewise.
        windows: these.
    """
    named = weigh(found, best, windows)
    priors, kept = found.null.model.priors, best
    for active, estimated in zip(best.model.named, named, strict=True):
        if not _holds_none(active, estimated):
            continue
        fewer = without(kept, active, windows, priors)
        if Yardstick.of(kept, windows).prefers(kept, fewer, null):
            continue
        searched = without(found.best, active, found.windows, priors)
        found, kept = found.with_best(searched, [*found.fits, searched]), fewer
    return found, kept, named if kept is best else weigh(found, kept, windows)


def _holds_none(active: EffectInstance, named: Named) -> bool:
    """Whether the intervals of an effect hold the values at which it changes nothing."""
    effect = active.effect
    sizes = [s for s, size in zip(effect.symbols, effect.amplitudes, strict=True) if size]
    ends = [(named.parameters[symbol.name], symbol.neutral) for symbol in sizes]
    return all(estimate.low <= neutral <= estimate.high for estimate, neutral in ends)


def weigh(found: Found, best: Fit, windows: Windows) -> tuple[Named, ...]:
    """The effects of the best model with their intervals, probabilities and families.

    Args:
        found: the search.
        best: its best model, fitted to all windows.
        windows: these.
    """
    layout = best.model.plant.layout
    low, high = (best.model.told(end[None]) for end in intervals(best, windows))
    named = []
    for (active, values), (_, lows), (_, highs) in zip(
        best.model.told(best.theta[None]), low, high, strict=True
    ):
        units = active.effect.units(layout, active.target)
        estimates = {
            symbol.name: Estimate(float(value), float(least), float(most), unit)
            for symbol, value, least, most, unit in zip(
                active.effect.symbols, values[0], lows[0], highs[0], units, strict=True
            )
            if symbol.reported
        }
        instead = rivals(found, active)
        others = [rival.behind for rival in instead if not rival.holds(active)]
        against = sum(math.exp(-0.5 * min(max(behind, 0.0), 700.0)) for behind in others)
        family = [active.effect.name]
        family += [rival.active.effect.name for rival in instead if rival.behind < TIED]
        named.append(
            Named(
                active.effect.name,
                active.target,
                estimates,
                1.0 / (1.0 + against),
                tuple(dict.fromkeys(family)),
            )
        )
    return tuple(named)


def intervals(best: Fit, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the 95 % intervals of theta; windows, not samples, count as independent.

    Reference: White, Maximum likelihood estimation of misspecified models, Econometrica 50 (1982),
        with windows as clusters.
    """
    model = best.model
    lin = linearise(model, windows, best.theta, best.starts)
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
