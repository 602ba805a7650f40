"""Which of the models that fit alike predicts recordings that it has not seen.

Where a model fits to the noise, its evidence decides. Real machines are never fitted so well: what
is left over is no noise, and an effect can follow it in the recordings at hand and mislead in the
next. There each recording is predicted from the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from mcpilco.gap.fit import Fit, fit, misfits, settle
from mcpilco.gap.windows import Windows

ROUGH = 4.0
"""misfit of a sample beyond which a model does not fit to the noise"""
NEAR, OF_EACH_SIZE = 3.0, 10
"""times the misfit of the first model; models that are compared"""
WORTH = 0.1
"""least mean fall of the log misfit of a recording that was not seen, for an effect more"""


def most_predictive(ranked: Sequence[Fit], windows: Windows) -> Fit:
    """The model that predicts each recording best from the others, with as few effects as will do.

    Args:
        ranked: fits of models, the best first.
        windows: of several recordings; of one there is nothing to predict, and the first is it.
    """
    best = ranked[0]
    recordings = np.unique(windows.recording)
    if np.median(best.by_window / windows.samples) < ROUGH or len(recordings) < 2:
        return best
    sizes = sorted({len(found.model.named) for found in ranked}, reverse=True)
    near = [found for found in ranked if found.chi2 < NEAR * best.chi2]
    compared = [  # the largest first: they cost little, which ends the others early
        found
        for size in sizes
        for found in [f for f in near if len(f.model.named) == size][:OF_EACH_SIZE]
    ]
    chosen, least = best, np.inf
    for found in compared:
        price = _price(found, windows, recordings, least)
        if price < least:
            chosen, least = found, price
    return chosen


def _price(found: Fit, windows: Windows, recordings: Int[np.ndarray, " R"], least: float) -> float:
    """Mean log misfit of recordings that were not seen, and what effects must be worth.

    A model that costs more than `least` is not followed to its end: no recording costs less than 0.
    """
    price = WORTH * len(found.model.named)
    for recording in recordings:
        if price >= least:
            break
        price += _unseen(found, windows, recording) / len(recordings)
    return price


def _unseen(found: Fit, windows: Windows, recording: int) -> float:
    """Mean log misfit of a sample in the windows of a recording, the model fitted to the others."""
    told, others = (
        np.flatnonzero(windows.recording == recording),
        np.flatnonzero(windows.recording != recording),
    )
    refitted = fit(
        found.model, windows[others], found.theta, found.starts[others], iterations=4, hasty=True
    )
    some = windows[told]
    starts = settle(found.model, some, refitted.theta, found.starts[told])
    misfit = misfits(found.model, some, refitted.theta, starts)
    return float(np.mean(np.log(np.maximum(misfit / some.samples, 1.0))))
