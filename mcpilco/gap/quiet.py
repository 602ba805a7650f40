"""Recordings without what came from outside while they were made."""

from __future__ import annotations

from collections.abc import Sequence

from mcpilco.gap.bursts import bursts, unforeseen
from mcpilco.gap.events import Event
from mcpilco.gap.fit import Fit
from mcpilco.gap.given import FEWEST, Given
from mcpilco.gap.learn import SHORT_S
from mcpilco.gap.refit import finish
from mcpilco.gap.windows import Windows
from mcpilco.typing import InputError

PASSES, SHARE = 6, 0.5
"""to find bursts, for those that were found no longer blur the next; part of the steps left to an
investigation: both at most"""


def quiet(given: Given, best: Fit) -> tuple[Given, tuple[Event, ...]]:
    """What is given without bursts of force that neither a model nor a state explains, and these.

    Args:
        given: plant and recordings.
        best: the best model, which bursts that were not seen may have bent.
    """
    short = _short(given)
    left = given
    spans: tuple[Event, ...] = ()
    share = given.effort.share(SHARE)
    for _ in range(PASSES):
        before, spans = spans, bursts(best, short, given.recordings)
        if spans == before or share.used_up:
            break
        left = _with_gaps(given, spans)
        best, _ = finish(best, left.windows(left.train))
    spans = unforeseen(spans, best, short, given.recordings) if left is not given else ()
    left = _with_gaps(given, spans)
    return left, spans if left is not given else ()


def foreseen(spans: Sequence[Event], given: Given, best: Fit) -> bool:
    """Whether some events are none, for a force of state and command predicts them."""
    if not spans:
        return False
    return len(unforeseen(spans, best, _short(given), given.recordings)) < len(spans)


def _short(given: Given) -> Windows:
    """Windows that overlap by half, in which a push shows."""
    return given.windows(seconds=SHORT_S, every=0.5 * SHORT_S)


def _with_gaps(given: Given, spans: Sequence[Event]) -> Given:
    """What is given without these spans; as it is where too little would be left."""
    left = given.without(spans) if spans else given
    enough = _count(left, left.train) >= FEWEST and _count(left, left.held_out)
    return left if enough else given


def _count(given: Given, numbers: Sequence[int]) -> int:
    """How many windows there are of some recordings."""
    try:
        return len(given.windows(numbers))
    except InputError:
        return 0
