"""Events: spans of a recording that no model explains, such as a push by hand or a contact."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool
from numpy.lib.stride_tricks import sliding_window_view

from mcpilco.gap.fit import Fit
from mcpilco.gap.residual_force import explain, respond
from mcpilco.gap.where import residuals
from mcpilco.gap.windows import Windows
from mcpilco.recordings import Recording

FAR, RARE = 12.0, 0.35
"""times the median misfit; part of the windows that may be events"""
SPIKE = 8.0
"""noise std by which a sample that was read wrongly stands out"""
STRANGE = 0.5
"""least part of the misfit of an event that cannot be predicted"""
PASSES = 4
"""at most: events found in one no longer blur the next"""


@dataclass(frozen=True)
class Event:
    """A span of a recording that was left out."""

    recording: str
    """its name"""
    start_s: float
    """from its beginning [s]"""
    end_s: float
    """from its beginning [s]"""


def without_spikes(found: Fit, windows: Windows) -> Windows:
    """The windows without single samples that stand out from what is left over around them.

    A sample that was read wrongly has no neighbours that share its error; what a model misses has.
    """
    r = np.where(windows.measured, residuals(found, windows), np.nan)
    padded = np.pad(r, ((0, 0), (0, 0), (2, 2)), mode="reflect")
    around = np.delete(sliding_window_view(padded, 5, axis=2), 2, axis=3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of neighbours without a measurement
        apart = np.abs(r - np.nanmedian(around, axis=3))
        usual = np.nanmedian(apart, axis=2, keepdims=True) / 0.67  # of a normal distribution
    spikes = apart > SPIKE * np.maximum(usual, 1.0)
    return replace(windows, y=np.where(spikes, np.nan, windows.y))


def outlying(found: Fit, windows: Windows) -> Bool[np.ndarray, " W"]:
    """Windows that hold an event, unless they are many.

    They are missed far more than most, and no force that depends on state and command, as the other
    windows tell it, explains that: neither if those that are missed count less, nor if all count
    alike, for then an effect that is felt in few places has told of itself.
    """
    response = respond(found, windows)
    far = np.zeros(len(windows), dtype=bool)
    alike = explain(response, np.ones(len(windows))).left
    before = response.by_window / response.samples
    for _ in range(PASSES):
        left = np.minimum(alike, explain(response, response.weights * ~far).left)
        now = left > FAR * max(1.0, float(np.median(left[~far])))
        now &= left > STRANGE * before
        if now.mean() > RARE:
            return np.zeros_like(far)
        if (now == far).all():
            break
        far = now
    return far


def events(windows: Windows, recordings: Sequence[Recording]) -> tuple[Event, ...]:
    """The spans of windows; those that touch are one."""
    length = windows.y.shape[2] * windows.dt
    spans: list[Event] = []
    for n, start in zip(windows.recording, windows.start_s, strict=True):
        name, end = recordings[n].name, float(start + length)
        if spans and spans[-1].recording == name and start - spans[-1].end_s < 1.5 * windows.dt:
            spans[-1] = Event(name, spans[-1].start_s, end)
        else:
            spans.append(Event(name, float(start), end))
    return tuple(spans)


def outside(spans: Sequence[Event], windows: Windows, names: Sequence[str]) -> Windows:
    """The windows that no event touches; all of them where none would be left.

    Args:
        spans: the events.
        windows: of some recordings.
        names: of these recordings.
    """
    ends = windows.start_s + windows.y.shape[2] * windows.dt
    clear = np.ones(len(windows), dtype=bool)
    for span in spans:
        own = np.array([names[n] == span.recording for n in windows.recording])
        clear &= ~(own & (windows.start_s < span.end_s) & (ends > span.start_s))
    return windows[clear] if clear.any() else windows
