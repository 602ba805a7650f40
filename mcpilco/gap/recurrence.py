"""Places where events recur: what happens whenever a machine comes by again is no accident."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from mcpilco.gap.bursts import runs, touched_by
from mcpilco.gap.events import Event
from mcpilco.gap.given import Given
from mcpilco.gap.learn import SHORT_S
from mcpilco.gap.where import Disagreement, mean_of_known

LEVEL = 0.01
"""probability, all places that are looked at together, below which events are no accidents"""


def recurring(spans: Sequence[Event], given: Given) -> Disagreement | None:
    """Where a joint is when nearly all events happen, and seldom without one; None: anywhere.

    Of each interval of positions the visits are counted, and those with an event. Events that come
    from outside would hit them by chance: a binomial test, corrected for the number of intervals.

    Args:
        spans: events.
        given: plant and recordings, without gaps at these.

    Reference: Dunn, Multiple comparisons among means, JASA 56 (1961), for the correction.
    """
    short = given.windows(seconds=SHORT_S)
    touched = touched_by(spans, short, given.recordings)
    if not spans or not (touched >= 0).any():
        return None
    broken = np.zeros(len(short), dtype=bool)
    broken[[run.start for run in runs(short)]] = True
    layout, found = given.plant.layout, []
    for j, joint in enumerate(layout.joints):
        q = mean_of_known(short.y[:, 2 * j])
        if 2 * j in given.plant.angles:
            q = np.mod(q + np.pi, 2.0 * np.pi) - np.pi
        chance, low, high = _rarest(q, touched, broken)
        channel = layout.states[2 * j]
        condition = f"events whenever {channel} is {low:.2g} to {high:.2g} {layout.units[2 * j]}"
        inside = (q >= low) & (q <= high)
        share = float(inside[touched >= 0].mean())
        found.append((chance, Disagreement(channel, share, condition, joint)))
    chance, place = min(found, key=lambda pair: pair[0])
    return place if chance * len(found) < LEVEL else None


def _rarest(
    q: Float[np.ndarray, " W"], touched: Int[np.ndarray, " W"], broken: np.ndarray
) -> tuple[float, float, float]:
    """The chance, for all intervals together, of the one that is hardest to explain, and its ends.

    Args:
        q: position in each window.
        touched: number of the event in each window; -1 where there is none.
        broken: whether a window does not follow on the one before it.
    """
    event = touched >= 0
    usual = min(1.0, (event.sum() + touched.max() + 1) / len(q))  # a visit may begin in one
    ends = np.unique(q[event & np.isfinite(q)])
    best = (1.0, np.nan, np.nan)
    for k, low in enumerate(ends):
        for high in ends[k:]:
            inside = (q >= low) & (q <= high)
            begins = inside & (broken | ~np.concatenate([[False], inside[:-1]]))
            visit = np.cumsum(begins)
            hit = len(np.unique(visit[inside & event]))
            chance = float(stats.binom.sf(hit - 1, begins.sum(), usual))
            best = min(best, (chance, float(low), float(high)))
    pairs = len(ends) * (len(ends) + 1) / 2
    return min(1.0, best[0] * pairs), best[1], best[2]
