"""Which of the models that fit alike predicts recordings that it has not seen.

Where a model fits to the noise, its evidence decides. Real machines are never fitted so well: what
is left over is no noise, and an effect can follow it in the recordings at hand and mislead in the
next. There each recording is predicted from the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from mcpilco.gap.fit import Fit, fit, misfits, settle
from mcpilco.gap.windows import Windows

ROUGH = 4.0
"""misfit of a sample beyond which a model does not fit to the noise"""
NEAR, OF_EACH_SIZE = 3.0, 10
"""times the misfit of the first model; models that are compared"""
WORTH = 0.1
"""least mean fall of the log misfit of a recording that was not seen, for an effect more"""


def most_predictive(ranked: Sequence[Fit], windows: Windows) -> Fit:
    """The model of the fewest effects that predicts recordings from the others as well as any.

    As well is within one standard error of the difference, which the windows tell.

    Args:
        ranked: fits of models, the best first.
        windows: of several recordings; of one there is nothing to predict, and the first is it.

    Reference: Breiman, Friedman, Olshen & Stone, Classification and Regression Trees (1984),
        section 3.4.3: the rule of one standard error.
    """
    best = ranked[0]
    recordings = np.unique(windows.recording)
    if np.median(best.by_window / windows.samples) < ROUGH or len(recordings) < 2:
        return best
    sizes = {len(found.model.named) for found in ranked}
    near = [found for found in ranked if found.chi2 < NEAR * best.chi2]
    compared = [
        found
        for size in sorted(sizes)
        for found in [f for f in near if len(f.model.named) == size][:OF_EACH_SIZE]
    ]
    missed = np.stack([_unseen(found, windows, recordings) for found in compared])
    effects = np.array([len(found.model.named) for found in compared])
    return compared[fewest(missed, effects, windows.overlap)]


def fewest(missed: Float[np.ndarray, "M W"], effects: Int[np.ndarray, " M"], overlap: float) -> int:
    """Number of the model with the fewest effects that is as good as the best one.

    Args:
        missed: log misfit of each window that was not seen, by model.
        effects: how many each model has.
        overlap: how many windows a sample is in.
    """
    score = missed.mean(axis=1) + WORTH * effects
    apart = missed - missed[np.argmin(score)]
    independent = max(missed.shape[1] / overlap, 2.0)
    error = apart.std(axis=1) / np.sqrt(independent - 1.0)
    good = np.flatnonzero(apart.mean(axis=1) <= error)
    return int(min(good, key=lambda m: (effects[m], score[m])))


def _unseen(
    found: Fit, windows: Windows, recordings: Int[np.ndarray, " R"]
) -> Float[np.ndarray, " W"]:
    """Log misfit of a sample in each window, the model fitted to the other recordings."""
    missed = np.empty(len(windows))
    for recording in recordings:
        told, others = (
            np.flatnonzero(windows.recording == recording),
            np.flatnonzero(windows.recording != recording),
        )
        refitted = fit(
            found.model,
            windows[others],
            found.theta,
            found.starts[others],
            iterations=4,
            hasty=True,
        )
        some = windows[told]
        starts = settle(found.model, some, refitted.theta, found.starts[told])
        misfit = misfits(found.model, some, refitted.theta, starts)
        missed[told] = np.log(np.maximum(misfit / some.samples, 1.0))
    return missed
