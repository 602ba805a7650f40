"""Whether the effects that were found are what recordings lack, or something else is."""

from __future__ import annotations

import numpy as np

from mcpilco.gap.fit import Fit
from mcpilco.gap.residual_force import explain, respond
from mcpilco.gap.show import beyond_noise, shrunk
from mcpilco.gap.validate import fits_roughly
from mcpilco.gap.where import structure
from mcpilco.gap.windows import Windows

STRUCTURED = 50.0
"""whiteness of residuals beyond which something may still be missing"""
PREDICTED = 0.3
"""part of what is left that forces of state and command explain, beyond which it is an effect"""
LEFT, LEFT_USUALLY = 0.3, 0.5
"""part of the gap that may be left over in any case; likewise of that in a usual window"""
MOST = 0.1
"""part of the gap that effects may leave over and still stay where a force is learned too"""
LARGE, UNEVEN = 3.0, 3.0
"""misfit of a sample over the noise, and its unevenness, that no noise has"""
ALONE = 2.5
"""times the usual misfit that no noise has in a single window"""
CLOSED, FAR = 0.5, 2.0
"""part of the held-out error that effects must take away, where it is so many times that of the
recordings that were fitted, each in parts of its noise"""


def something_else(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether what the best model leaves over is neither noise nor of little account.

    Noise of sensors may be correlated as well, but then it is alike in all windows, and no force
    predicts it.
    """
    if _missed_alone(best, null, windows):
        return True
    left, gap = structure(best, windows), structure(null, windows)
    if left.whiteness < STRUCTURED:
        return False
    if left.excess > LEFT * gap.excess and (left.excess > LARGE or left.unevenness > UNEVEN):
        return True
    if left.usual > max(LARGE, LEFT_USUALLY * gap.usual):  # few windows may make most of the gap
        return True
    return explain(respond(best, windows)).share > PREDICTED


def _missed_alone(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether single windows are missed as no noise would have it, and effects do not mend them.

    Such is a place by which a machine came once. An event has been taken out before. Where no model
    fits to the noise, each window is missed in its own way.
    """
    if fits_roughly(best, windows):
        return False
    left, gap = (found.by_window / windows.samples for found in (best, null))
    far = left > ALONE * max(1.0, float(np.median(left)))
    return bool((far & (left - 1.0 > CLOSED * (gap - 1.0))).any())


def mispredicts(best: Fit, null: Fit, windows: Windows, clear: Windows) -> bool:
    """Whether effects that fit their recordings leave much of the error on those held out.

    Args:
        best: the effects' fit.
        null: the fit of none.
        windows: those of the fits.
        clear: held-out windows without events.
    """
    if not best.model.named:
        return False
    closed = shrunk(null, best, clear)
    if fits_roughly(best, windows):  # then it is not the noise that hides what effects are worth
        return closed.low < CLOSED
    if closed.value >= CLOSED:
        return False
    return beyond_noise(best, clear) > FAR * max(1.0, beyond_noise(best, windows))


def explains_most(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether the effects of a model that does not fit are to stay beside what is learned."""
    left, gap = structure(best, windows), structure(null, windows)
    return bool(best.model.named) and left.excess < MOST * gap.excess


def settled(best: Fit, null: Fit, windows: Windows) -> bool:
    """Whether effects explain most of what a machine lacks that no model fits to the noise.

    Of what they leave over there, forces foresee parts in any case.
    """
    return fits_roughly(best, windows) and explains_most(best, null, windows)


def worth(found: Fit, others: tuple[Fit, ...], clear: Windows) -> bool:
    """Whether a model's error on held-out windows without events is surely less than others'."""
    return all(shrunk(known, found, clear).low > 0.0 for known in others)
