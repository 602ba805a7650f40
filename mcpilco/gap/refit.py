"""A fit of some windows, on others."""

from __future__ import annotations

from mcpilco.gap.fit import Fit, fit, remembered, settle
from mcpilco.gap.windows import Windows


def finish(found: Fit, windows: Windows) -> tuple[Fit, Windows]:
    """The fit of a search on all windows, those that it has not seen included."""
    kept = remembered(found.model, windows, found.theta)
    return refit(found, kept), kept


def refit(found: Fit, windows: Windows) -> Fit:
    """The fit of a model on the windows as they are."""
    starts = settle(found.model, windows, found.theta)
    return fit(found.model, windows, found.theta, starts, iterations=15)
