"""Where and when recordings disagree with a model: channels, joints, and events.

An event is a span that no model explains: a push by hand, a contact, a sample read wrongly. Within
a third of a second a force f that a model misses bends a motion by f t^2 / 2 M, which no initial
state can imitate. So the mean missed force in each joint and short window shows a push that a
longer window hides: near an unstable rest the longer one diverges. What happens whenever
a machine comes by a place is no event.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from scipy import stats
from scipy.ndimage import binary_propagation

from mcpilco.gap.data import Event, GapProblem, Windows, event_of
from mcpilco.gap.fit import Fit, on_windows, refit, refit_truncated, residuals, truncated
from mcpilco.gap.horizon import NORMAL
from mcpilco.gap.learned_force import candidates, force_places, log_misfit
from mcpilco.gap.plant_model import PerWindow
from mcpilco.gap.residual_force import force_response, unpredicted_by_forces
from mcpilco.gap.sensitivities import motion
from mcpilco.gap.thresholds import BUDGET, DATA, EVENT, FORCE
from mcpilco.recordings import Recording
from mcpilco.typing import InputError


@dataclass(frozen=True)
class Disagreement:
    """A share of the misfit, or of a force that was learned to explain it."""

    channel: str
    """state whose measurement is missed; of a force, the position of its joint"""
    share: float
    """of the squared misfit beyond the noise, or of the squared force [-]"""
    condition: str
    """when it is largest, in words"""
    joint: str = ""
    """in which a force is missing; empty where a measurement is missed"""


def located_misfit(fit: Fit, windows: Windows) -> tuple[Disagreement, ...]:
    """The shares of each measured state in a fit's misfit, largest first."""
    r = residuals(fit, windows)
    beyond = np.maximum((r**2).sum(axis=(0, 2)) - windows.measured.sum(axis=(0, 2)), 0.0)
    total = beyond.sum()
    if total == 0.0:
        return ()
    names = fit.model.plant.layout.states
    shares = [
        Disagreement(name, float(part / total), _condition(fit, windows, r[:, x]))
        for x, (name, part) in enumerate(zip(names, beyond, strict=True))
        if part > 0.0
    ]
    return tuple(sorted(shares, key=lambda share: -share.share))


def located_force(fit: Fit, windows: Windows) -> tuple[Disagreement, ...]:
    """The joints and regions in which a fit's learned force acts, the largest first."""
    layout = fit.model.plant.layout
    disagreements = []
    for place in force_places(fit, windows):
        force, joint = place.force, place.force.joint
        regions = [
            f"{axis.of} {low:.2g} to {high:.2g} {_unit(fit, axis.of, joint)}"
            + " of each turn" * axis.closed
            for axis, (low, high) in zip(force.axes, place.within, strict=True)
        ]
        size = f"{place.largest:.2g} {layout.unit_of(joint)[1]}"
        condition = f"a force of up to {size} at {' and '.join(regions)}"
        channel = layout.states[2 * layout.joints.index(joint)]
        disagreements.append(Disagreement(channel, place.share, condition, joint))
    return tuple(disagreements)


def _unit(fit: Fit, name: str, joint: str) -> str:
    """Of a state, or of the force of an input's actuator."""
    layout = fit.model.plant.layout
    if name in layout.states:
        return layout.units[layout.states.index(name)]
    return layout.unit_of(layout.actuator(layout.inputs.index(name)))[1]


def _condition(fit: Fit, windows: Windows, r: Float[np.ndarray, "W T"]) -> str:
    """When residuals are large: at fast or slow motion, at large or small commands."""
    layout = fit.model.plant.layout
    missed = np.sqrt((r**2).mean(axis=1))
    traits: dict[str, np.ndarray] = {}
    for j, joint in enumerate(layout.joints):
        q = windows.y[:, 2 * j]
        traits[f"|{layout.states[2 * j]}|"] = mean_of_known(np.abs(q))
        traits[f"the speed of {joint}"] = mean_of_known(np.abs(np.gradient(q, axis=1)))
    for u, name in enumerate(layout.inputs):
        used = windows.driven[:, :, u]
        traits[f"|{name}|"] = np.abs(used).mean(axis=1)
        traits[f"the change of {name}"] = np.abs(np.diff(used, axis=1)).mean(axis=1)
    with warnings.catch_warnings(action="ignore"):  # of what is the same in all windows
        found = {name: stats.spearmanr(missed, np.nan_to_num(t)) for name, t in traits.items()}
    ranks = {name: np.nan_to_num(each.statistic) for name, each in found.items()}
    name = max(ranks, key=lambda n: abs(ranks[n]))
    if abs(ranks[name]) < 0.3:
        return "at all speeds and amplitudes"
    return f"where {name} is {'large' if ranks[name] > 0.0 else 'small'}"


def mean_of_known(y: Float[np.ndarray, "W T"]) -> PerWindow:
    """Of what is known in each window; NaN where nothing is."""
    known = np.isfinite(y)
    total = np.where(known, y, 0.0).sum(axis=1)
    return np.where(known.any(axis=1), total / np.maximum(known.sum(axis=1), 1), np.nan)


def without_spikes(fit: Fit, windows: Windows) -> Windows:
    """The windows without single samples that stand out from the residuals around them.

    A sample that was read wrongly has no neighbours that share its error; what a model misses has,
    and in fast motion these differ from one another. Where neighbours are on one side alone, what
    is missed changes from them by its slope.
    """
    r = np.where(windows.measured, residuals(fit, windows), np.nan)
    around = _neighbours(r, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of neighbours without a measurement
        off = r - np.nanmedian(around, axis=3)
        usual = np.nanmedian(np.abs(off), axis=2, keepdims=True) / NORMAL
        slope = np.nanmedian(np.abs(np.diff(r, axis=2)), axis=2, keepdims=True)
        one_sided = np.isnan(around).any(axis=3)
        usual = EVENT.spike * np.maximum(np.where(one_sided, np.fmax(usual, slope), usual), 1.0)
        strange = _neighbours(_apart_from_all(r, around) > usual, False)
        strange &= strange.sum(axis=3, keepdims=True) == 1  # another spike; more are a motion
        # and so is what goes on to the next sample, if not on the other side
        strange[..., 1:3] &= (_neighbours(off, np.nan) * off[..., None] < 0.0)[..., 1:3]
        around = np.where(strange, np.nan, around)
        apart = np.abs(r - np.nanmedian(around, axis=3))
        differing = np.nanmax(around, axis=3) - np.nanmin(around, axis=3)
    spikes = apart > np.fmax(usual, EVENT.beyond * differing)
    return replace(windows, y=np.where(spikes, np.nan, windows.y))


def _apart_from_all(
    r: Float[np.ndarray, "W X T"], around: Float[np.ndarray, "W X T 4"]
) -> Float[np.ndarray, "W X T"]:
    """Distance to the nearest neighbour; of four, to the second nearest, for one may be a spike."""
    away = np.sort(np.abs(r[..., None] - around), axis=3)  # NaN last
    four = np.isfinite(away[..., 3])
    return np.where(four, away[..., 1], away[..., 0])


def _neighbours(r: np.ndarray, beyond: float) -> np.ndarray:
    """The two samples before each, and the two behind it; [W, X, T, 4] of [W, X, T]."""
    padded = np.pad(r, ((0, 0), (0, 0), (2, 2)), constant_values=beyond)
    return np.delete(sliding_window_view(padded, 5, axis=2), 2, axis=3)


def windows_with_events(fit: Fit, windows: Windows) -> Bool[np.ndarray, " W"]:
    """Windows that hold an event, unless they are many.

    They are missed far more than most, and no force that depends on state and command, as the other
    windows tell it, explains that: neither if those that are missed count less, nor if all count
    alike, for then an effect that acts in few places would show.
    """
    far = np.zeros(len(windows), dtype=bool)
    if not (fit.by_window > EVENT.far * windows.samples).any():
        return far
    response = force_response(fit, windows)
    alike = unpredicted_by_forces(response, np.ones(len(windows)))
    before = response.by_window / response.samples
    if not ((alike > EVENT.far) & (alike > EVENT.strange * before)).any():
        return far
    for _ in range(EVENT.passes):
        rest = np.minimum(alike, unpredicted_by_forces(response, response.weights * ~far))
        now = rest > EVENT.far * max(1.0, float(np.median(rest[~far])))
        now &= rest > EVENT.strange * before
        if now.mean() > EVENT.rare:
            return np.zeros_like(far)
        if (now == far).all():
            break
        far = now
    return far


def still_missed(
    best: Fit, windows: Windows, masked: Windows, train: Sequence[int] = ()
) -> tuple[Windows, Windows]:
    """Of windows that seemed to hold an event, those that still do, and those that a model fits.

    The widest swings may seem to hold one, for no other tells the force at their ends. So the model
    is fitted to them too, as far as windows count that are missed by more than the others. `best`
    is fitted to the other `windows`; `train` numbers recordings for its fit.
    """
    if not len(masked):
        return masked, masked
    own = masked[masked.of(train)]
    if len(own):
        more = windows.joined(truncated(best.model, own, best.theta))
        best = on_windows(refit(best, more), windows)
    usual = float(np.median(best.by_window / windows.samples))
    kept = truncated(best.model, masked, best.theta)
    misfit = on_windows(best, kept).by_window / kept.samples
    fine = misfit < EVENT.ordinary * max(1.0, usual)
    return masked[~fine], masked[fine]


def spans_of(windows: Windows, recordings: Sequence[Recording]) -> tuple[Event, ...]:
    """The spans of windows; those that touch are one."""
    length = windows.y.shape[2] * windows.dt
    spans: list[Event] = []
    for n, start in zip(windows.recording, windows.start_s, strict=True):
        name, end = recordings[n].name, float(start + length)
        if spans and spans[-1].recording == name and start - spans[-1].end_s < 1.5 * windows.dt:
            start = spans.pop().start_s
        spans.append(Event(name, float(start), end))
    return tuple(spans)


def bursts(fit: Fit, short: Windows, recordings: Sequence[Recording]) -> tuple[Event, ...]:
    """Spans in which a far larger force is missed than usual, and more than a part of what acts.

    None where they would be much of the recordings: then the model is wrong. Short windows are
    `GapProblem.short_s` long, half overlapping, and of all recordings in their order.
    """
    part, short = _without_spikes(on_windows(fit, short), short)
    far = _far(part, short)
    return () if far.mean() > EVENT.often else spans_of(short[far], recordings)


def _without_spikes(fit: Fit, windows: Windows) -> tuple[Fit, Windows]:
    """Windows without what is read wrongly, and a fit on them: only theirs move their starts."""
    clean = without_spikes(fit, windows)
    touched = (clean.measured != windows.measured).any(axis=(1, 2))
    x0, by_window = fit.x0.copy(), fit.by_window.copy()
    if touched.any():
        anew = on_windows(fit, clean[touched])
        x0[touched], by_window[touched] = anew.x0, anew.by_window
    return replace(fit, x0=x0, by_window=by_window), clean


def unforeseen(
    spans: Sequence[Event], fit: Fit, short: Windows, recordings: Sequence[Recording]
) -> tuple[Event, ...]:
    """Those of some spans whose forces no state and command predict, as all other windows tell.

    What a contact or a magnet does recurs where the machine comes by again; a push does not. It is
    sought as a force that is alike everywhere, and as a narrow one in a joint over few coordinates.
    Fit, windows and recordings as of `bursts`.
    """
    apart = short[::2]
    touched = event_of(spans, apart, [recording.name for recording in recordings])
    others = np.flatnonzero(touched < 0)
    some = others[np.linspace(0, len(others) - 1, min(EVENT.others, len(others))).astype(int)]
    chosen = np.union1d(some, np.flatnonzero(touched >= 0))
    windows, touched = apart[chosen], touched[chosen]
    part = on_windows(fit, windows)
    folds = np.where(touched < 0, np.arange(len(windows)), touched) % FORCE.folds
    response = force_response(part, windows)
    smooth = [unpredicted_by_forces(response, response.weights, folds, n) for n in (1, 2)]
    before, samples = part.by_window / windows.samples, windows.samples
    usual = EVENT.ordinary * float(np.median(before[touched < 0]))

    @cache
    def narrow() -> PerWindow:
        """Misfits that the narrow force leaves which predicts most; many are tried."""
        forces = candidates(part, windows, folds)
        return max(forces, key=lambda force: force.predicted).unpredicted

    def strange(number: int) -> bool:
        own = touched == number
        if before[own].sum() <= usual * own.sum():  # it shows over longer times alone
            return True
        if min(rest[own].sum() for rest in smooth) < EVENT.strange * before[own].sum():
            return False
        logs = [log_misfit(rest[own], samples[own]) for rest in (narrow(), before)]
        return logs[0] >= EVENT.strange * logs[1]

    return tuple(span for number, span in enumerate(spans) if strange(number))


def _far(fit: Fit, short: Windows) -> Bool[np.ndarray, " W"]:
    """Windows in which a far larger force is missed than usual, and their weaker neighbours."""
    response = force_response(fit, short, FORCE.short_s)
    G, r = response.G, response.r
    covariance = np.linalg.inv(np.einsum("wni,wnj->wij", G, G) + np.eye(G.shape[2]))
    force = np.abs(np.einsum("wij,wnj,wn->wi", covariance, G, r))
    std = np.sqrt(np.einsum("wii->wi", covariance))
    size = force / np.maximum(np.median(force, axis=0), 1e-12)
    least = np.maximum(EVENT.sure * std, EVENT.of_acting * _acting(fit, short)[:, response.joint])
    strong = ((size > EVENT.strong) & (force > least)).any(axis=1)
    weak, far = (size > EVENT.weak).any(axis=1), strong.copy()
    for run in runs(short):  # and weak ones that are joined to them by weak ones
        far[run] = binary_propagation(strong[run], mask=weak[run])
    return far


def _acting(fit: Fit, windows: Windows) -> Float[np.ndarray, "W J"]:
    """The root mean square force on each joint, by its acceleration [usual forces]."""
    plant, J = fit.model.plant, len(fit.model.plant.layout.joints)
    at = motion(windows)
    q, v = (np.ascontiguousarray(at[:, :, part : 2 * J : 2]) for part in (0, 1))
    M = plant.mass_matrix(q.reshape(-1, J)).reshape(*q.shape, J)
    force = np.einsum("wtij,wtj->wti", M, np.gradient(v, windows.dt, axis=1))
    usual = [fit.model.scales[joint].force for joint in plant.layout.joints]
    return np.sqrt(np.square(force).mean(axis=1)) / usual


def runs(short: Windows) -> list[slice]:
    """Windows that follow one another without a break."""
    longest = (short.y.shape[2] + 0.5) * short.dt  # from one start to the next, side by side
    broken = (np.diff(short.recording) != 0) | (np.diff(short.start_s) > longest)
    return [slice(a, b) for a, b in pairwise([0, *(np.flatnonzero(broken) + 1), len(short)])]


def without_bursts(problem: GapProblem, best: Fit) -> tuple[GapProblem, tuple[Event, ...]]:
    """The problem without bursts of force that neither model nor state explains, and these.

    `best` is the best model, which bursts that were not seen may have bent.
    """
    short, quiet, share = _short(problem), problem, problem.budget.share(BUDGET.bursts)
    spans: tuple[Event, ...] = ()
    for _ in range(EVENT.burst_passes):
        before, spans = spans, bursts(best, short, problem.recordings)
        quiet = _with_gaps(problem, spans)
        if spans == before or share.used_up:
            break
        best, _ = refit_truncated(best, quiet.windows(quiet.train))
    spans = unforeseen(spans, best, short, problem.recordings) if quiet is not problem else ()
    quiet = _with_gaps(problem, spans)
    return quiet, spans if quiet is not problem else ()


def foreseen(spans: Sequence[Event], problem: GapProblem, best: Fit) -> bool:
    """Whether some spans are no events, for a force of state and command predicts them."""
    short = _short(problem)
    return bool(spans) and len(unforeseen(spans, best, short, problem.recordings)) < len(spans)


def _short(problem: GapProblem) -> Windows:
    """Windows that overlap by half, in which a push shows."""
    return problem.windows(seconds=problem.short_s, every=0.5 * problem.short_s)


def _with_gaps(problem: GapProblem, spans: Sequence[Event]) -> GapProblem:
    """The problem without these spans; as it is where too little would be left."""
    quiet = problem.without(spans) if spans else problem
    with suppress(InputError):  # there are none
        fitted, unseen = (quiet.windows(numbers) for numbers in (quiet.train, quiet.held_out))
        return quiet if len(fitted) >= DATA.fewest_windows and len(unseen) else problem
    return problem


def recurring(spans: Sequence[Event], problem: GapProblem) -> Disagreement | None:
    """Where a joint is when nearly all events happen, and seldom without one; None: anywhere.

    Of each interval of positions the visits are counted, and those with an event of their own.
    Events from outside would hit them by chance: a binomial test, corrected for all intervals. The
    problem has no gaps at the events.

    Reference: Dunn, Multiple comparisons among means, JASA 56 (1961), for the correction.
    """
    short = problem.windows(seconds=problem.short_s)
    touched = event_of(spans, short, [recording.name for recording in problem.recordings])
    if not spans or not (touched >= 0).any():
        return None
    broken = np.zeros(len(short), dtype=bool)
    broken[[run.start for run in runs(short)]] = True
    layout, places = problem.plant.layout, []
    for j, joint in enumerate(layout.joints):
        q = mean_of_known(short.y[:, 2 * j])
        if 2 * j in problem.plant.angles:
            q = np.mod(q + np.pi, 2.0 * np.pi) - np.pi
        chance, low, high = _rarest(q, touched, broken)
        channel = layout.states[2 * j]
        condition = f"events whenever {channel} is {low:.2g} to {high:.2g} {layout.units[2 * j]}"
        inside = (q >= low) & (q <= high)
        share = float(inside[touched >= 0].mean())
        places.append((chance, Disagreement(channel, share, condition, joint)))
    chance, place = min(places, key=lambda pair: pair[0])
    return place if chance * len(places) < EVENT.recurring else None


def _rarest(
    q: PerWindow, touched: Int[np.ndarray, " W"], broken: np.ndarray
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
            own = inside & event
            hit = min(len(np.unique(visit[own])), len(np.unique(touched[own])))
            chance = float(stats.binom.sf(hit - 1, begins.sum(), usual))
            best = min(best, (chance, float(low), float(high)))
    pairs = len(ends) * (len(ends) + 1) / 2
    return min(1.0, best[0] * pairs), best[1], best[2]
