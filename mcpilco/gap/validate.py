"""Which of the models that fit alike predicts recordings that it has not seen.

Where a model fits to the noise, its evidence decides. Real machines are never fitted so well: what
is left over is no noise, and an effect can follow it in the recordings at hand and mislead in the
next. There each recording is predicted from the others; of one alone, each third from the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from mcpilco.gap.fit import Fit, fit, misfits, settle
from mcpilco.gap.windows import Windows

ROUGH = 4.0
"""misfit of a sample beyond which a model does not fit to the noise"""
SHARE = 0.4
"""of the steps left to an investigation, to compare models in"""
NEAR, OF_EACH_SIZE = 3.0, 5
"""times the misfit of the first model; models that are compared"""
PARTS = 3
"""that are predicted from the others, at most"""
WORTH = 0.1
"""least mean fall of the log misfit of a recording that was not seen, for an effect more"""


def most_predictive(ranked: Sequence[Fit], windows: Windows) -> Fit:
    """The model of the fewest numbers that predicts recordings from the others as well as any.

    As well is within one standard error of the difference, which the windows tell.

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
    share = best.model.effort.share(SHARE)
    told = [_unseen(found, windows, parts) for found in share.lasting(compared)]
    compared, missed = compared[: len(told)], np.stack(told)
    effects = np.array([len(found.model.named) for found in compared])
    symbols = np.array([_symbols(found) for found in compared])
    return compared[fewest(missed, effects, symbols, windows.overlap)]


def promising(ranked: Sequence[Fit]) -> list[Fit]:
    """Models that fit nearly as well as the first.

    These are the first ones of each number of effects, and such of special cases of theirs.
    """
    near = [found for found in ranked if found.chi2 < NEAR * ranked[0].chi2]
    sizes = [len(found.model.named) for found in near]
    places = range(len(near))
    first = [near[k] for k in places if sizes[:k].count(sizes[k]) < OF_EACH_SIZE]
    return [found for found in near if any(_narrows(found, known) for known in first)]


def _narrows(found: Fit, known: Fit) -> bool:
    """Whether a model has the effects of another, or special cases of them."""
    ours, theirs = {*found.model.named}, {*known.model.named}
    special = all(any(t.holds(o) for t in theirs - ours) for o in ours - theirs)
    return len(ours) == len(theirs) and special


def fits_roughly(best: Fit, windows: Windows) -> bool:
    """Whether a model leaves over more than noise in most windows."""
    return bool(np.median(best.by_window / windows.samples) >= ROUGH)


def _symbols(found: Fit) -> int:
    """How many numbers a report tells of a model's effects."""
    return sum(symbol.reported for active in found.model.named for symbol in active.effect.symbols)


def _parts(windows: Windows) -> Int[np.ndarray, " W"]:
    """Number of the part that each window is in: some recordings, or a third of the only one."""
    own = np.unique(windows.recording, return_inverse=True)[1]
    if own.max() > 0:
        return own % PARTS
    return np.arange(len(windows)) * PARTS // len(windows)


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
    score = missed.mean(axis=1) + WORTH * effects
    apart = missed - missed[np.argmin(score)]
    independent = max(missed.shape[1] / overlap, 2.0)
    error = apart.std(axis=1) / np.sqrt(independent - 1.0)
    good = np.flatnonzero(apart.mean(axis=1) <= error)
    return int(min(good, key=lambda m: (symbols[m], score[m])))


def _unseen(found: Fit, windows: Windows, parts: Int[np.ndarray, " W"]) -> Float[np.ndarray, " W"]:
    """Log misfit of a sample in each window, the model fitted to the other parts."""
    missed = np.empty(len(windows))
    for part in np.unique(parts):
        told, others = np.flatnonzero(parts == part), np.flatnonzero(parts != part)
        others = others[~_beside(windows, others, told)]
        refitted = fit(
            found.model,
            windows[others],
            found.theta,
            found.starts[others],
            iterations=3,
            hasty=True,
        )
        some = windows[told]
        starts = settle(found.model, some, refitted.theta, found.starts[told])
        misfit = misfits(found.model, some, refitted.theta, starts)
        missed[told] = np.log(np.maximum(misfit / some.samples, 1.0))
    return missed


def _beside(
    windows: Windows, some: Int[np.ndarray, " V"], others: Int[np.ndarray, " U"]
) -> Bool[np.ndarray, " V"]:
    """Which of some windows share samples with others."""
    length = windows.y.shape[2] * windows.dt
    apart = windows.start_s[some][:, None] - windows.start_s[others]
    same = windows.recording[some][:, None] == windows.recording[others]
    return (same & (np.abs(apart) < length)).any(axis=1)
