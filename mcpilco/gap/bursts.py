"""Forces that come and go, such as a push by hand: neither state nor command tells of them.

In a third of a second a force f that a model misses bends a motion by f t^2 / 2 M, which no start
state can imitate and no growth of errors can hide. So one number for each joint and short window,
the force that is missed there on average, shows a push that a long window hides: near an unstable
rest the longer one forgets everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Int

from mcpilco.gap.events import STRANGE, Event, events, without_spikes
from mcpilco.gap.fit import Fit
from mcpilco.gap.learn import SHORT_S, candidates, log_misfit, moved
from mcpilco.gap.residual_force import FOLDS, explain, respond
from mcpilco.gap.windows import Windows
from mcpilco.recordings import Recording

STRONG, WEAK = 5.0, 3.0
"""times the usual missed force, in the middle of a burst and at its ends"""
SURE = 8.0
"""standard deviations that the force in the middle of a burst is away from 0"""
OFTEN = 0.2
"""part of the windows beyond which what comes and goes is no accident"""
OTHERS = 60
"""windows without a burst, at most, that may tell what a state and a command do"""


def bursts(found: Fit, short: Windows, recordings: Sequence[Recording]) -> tuple[Event, ...]:
    """Spans in which a far larger force is missed than usual.

    None where they would be much of the recordings: then the model is wrong.

    Args:
        found: a fit.
        short: windows of `SHORT_S` seconds that overlap by half, of all recordings in their order.
        recordings: these.
    """
    part, short = _without_spikes(moved(found, short), short)
    far = _far(part, short)
    return () if far.mean() > OFTEN else events(short[far], recordings)


def _without_spikes(part: Fit, windows: Windows) -> tuple[Fit, Windows]:
    """Windows without what is read wrongly, and a fit on them: only theirs move their starts."""
    clean = without_spikes(part, windows)
    touched = (clean.measured != windows.measured).any(axis=(1, 2))
    starts, by_window = part.starts.copy(), part.by_window.copy()
    if touched.any():
        anew = moved(part, clean[touched])
        starts[touched], by_window[touched] = anew.starts, anew.by_window
    return replace(part, starts=starts, chi2=float(by_window.sum()), by_window=by_window), clean


def unforeseen(
    spans: Sequence[Event], found: Fit, short: Windows, recordings: Sequence[Recording]
) -> tuple[Event, ...]:
    """Those of some spans whose forces no state and command predict, as all other windows tell.

    What a contact or a magnet does recurs where the machine comes by again; a push does not. It is
    sought as a force that is alike everywhere, and as one in a joint over few coordinates, which
    may be narrow.

    Args:
        spans: the events.
        found: a fit.
        short: windows of `SHORT_S` seconds that overlap by half, of all recordings in their order.
        recordings: these.
    """
    apart = short[::2]
    touched = touched_by(spans, apart, recordings)
    others = np.flatnonzero(touched < 0)
    some = others[np.linspace(0, len(others) - 1, min(OTHERS, len(others))).astype(int)]
    chosen = np.union1d(some, np.flatnonzero(touched >= 0))
    windows, touched = apart[chosen], touched[chosen]
    part = moved(found, windows)
    folds = np.where(touched < 0, np.arange(len(windows)), touched) % FOLDS
    response = respond(part, windows)
    smooth = [explain(response, response.weights, folds, n).left for n in (1, 2)]
    narrow = max(candidates(part, windows, folds), key=lambda force: force.predicted).left
    before, samples = part.by_window / windows.samples, windows.samples

    def strange(number: int) -> bool:
        own = touched == number
        missed = min(left[own].sum() for left in smooth) >= STRANGE * before[own].sum()
        if not (missed and own.any()):
            return bool(missed)
        logs = [log_misfit(left[own], samples[own]) for left in (narrow, before)]
        return logs[0] >= STRANGE * logs[1]

    return tuple(span for number, span in enumerate(spans) if strange(number))


def _far(part: Fit, short: Windows) -> Bool[np.ndarray, " W"]:
    """Windows in which a far larger force is missed than usual, and their weaker neighbours."""
    response = respond(part, short, SHORT_S)
    G, r = response.G, response.r
    precision = np.einsum("wni,wnj->wij", G, G) + np.eye(G.shape[2])
    covariance = np.linalg.inv(precision)
    force = np.abs(np.einsum("wij,wnj,wn->wi", covariance, G, r))
    std = np.sqrt(np.einsum("wii->wi", covariance))
    size = force / np.maximum(np.median(force, axis=0), 1e-12)
    strong = ((size > STRONG) & (force > SURE * std)).any(axis=1)
    return _grown(strong, (size > WEAK).any(axis=1), runs(short))


def runs(short: Windows) -> list[slice]:
    """Windows that follow one another without a break."""
    longest = (short.y.shape[2] + 0.5) * short.dt  # from one start to the next, side by side
    broken = (np.diff(short.recording) != 0) | (np.diff(short.start_s) > longest)
    ends = [0, *(np.flatnonzero(broken) + 1), len(short)]
    return [slice(a, b) for a, b in pairwise(ends)]


def _grown(
    strong: Bool[np.ndarray, " W"], weak: Bool[np.ndarray, " W"], runs: Sequence[slice]
) -> Bool[np.ndarray, " W"]:
    """Strong windows, and the weak ones that are joined to them by weak ones."""
    far = strong.copy()
    for run in runs:
        for order in (range(run.start + 1, run.stop), range(run.stop - 2, run.start - 1, -1)):
            for w in order:
                before = w - 1 if order.step > 0 else w + 1
                far[w] |= weak[w] & far[before]
    return far


def touched_by(
    spans: Sequence[Event], windows: Windows, recordings: Sequence[Recording]
) -> Int[np.ndarray, " W"]:
    """Which span touches each window; -1 where none does."""
    ends = windows.start_s + windows.y.shape[2] * windows.dt
    names = np.array([recordings[n].name for n in windows.recording])
    touched = np.full(len(windows), -1)
    for number, span in enumerate(spans):
        inside = (windows.start_s < span.end_s) & (ends > span.start_s)
        touched[(names == span.recording) & inside] = number
    return touched
