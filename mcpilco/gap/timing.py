"""When commands went out where time stamps jitter: with the samples, or by a clock of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit, fit, remembered, settle
from mcpilco.gap.given import Given
from mcpilco.recordings import Recording

EVERY = 2
"""one of so many windows is looked at"""
ROUGHLY = 5
"""iterations of a fit"""
SURE = 2.0
"""standard errors by which commands fit better with the samples, for them to have gone out so"""


def timings(recordings: Sequence[Recording]) -> list[tuple[Recording, ...]]:
    """The recordings, and where there is doubt, the same with commands that a clock sent out."""
    told = tuple(recordings)
    if all(recording.by_clock is None for recording in told):
        return [told]
    clocked = (r if r.by_clock is None else replace(r, inputs=r.by_clock) for r in told)
    return [told, tuple(clocked)]


def likelier(given: Sequence[Given], known: Fit | None = None) -> Given:
    """Of what `timings` offers, that which a model fits better; the clock where it is hard to tell.

    A step of a command that acts a millisecond late bends the second after it by more than the
    noise. What else a model lacks hides that, so the best one is asked again.

    Args:
        given: the same with one timing of the commands, or with two.
        known: a model; by default the nominal plant.
    """
    if len(given) == 1:
        return given[0]
    stamped, clocked = (_log_misfits(replace(g, std=given[0].std), known) for g in given)
    apart = stamped - clocked
    surely = apart.mean() < -SURE * apart.std() / np.sqrt(len(apart))
    return given[0] if surely else given[1]


def _log_misfits(given: Given, known: Fit | None) -> Float[np.ndarray, " W"]:
    """Log misfit of each window of a model that is fitted to them."""
    windows = given.windows()[::EVERY]
    model = known.model if known else given.model(windows)
    theta = known.theta if known else np.zeros(model.nuisances)
    kept = remembered(model, windows, theta)
    found = fit(model, kept, theta, settle(model, kept, theta), iterations=ROUGHLY)
    return np.log(np.maximum(found.by_window / np.maximum(kept.samples, 1), 1e-3))
