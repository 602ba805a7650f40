"""What a correction is worth: errors of free runs on recordings that no fit has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit, remembered, residual, run, settle
from mcpilco.gap.model import Model
from mcpilco.gap.search import Found
from mcpilco.gap.windows import Windows

KNOWN_S = 0.3
"""of each window from which its start is estimated [s]"""
FEWEST = 5
"""windows that must be left"""
RESAMPLES, BLOCK = 500, 8
"""of the bootstrap over blocks of neighbouring windows, which overlap"""
NOISES = 8
"""draws of it by which it is told what a window's usual error is"""
END = 0.1
"""last part of a window, whose error counts as that at its end"""


@dataclass(frozen=True)
class Models:
    """What is compared."""

    nominal: Model
    """as it was given"""
    refit: Fit
    """the plant with its uncertain parameters refitted"""
    corrected: Fit
    """the plant with the effects that were found"""
    steps: tuple[Fit, ...] = ()
    """the plant with the first of these effects, with the first two, ...; without all of them"""

    def named(self) -> dict[str, tuple[Model, Float[np.ndarray, " p"]]]:
        """Each plant that is told of, with its parameters, by name."""
        return {
            "nominal": (self.nominal, np.zeros(self.nominal.nuisances)),
            "refit": (self.refit.model, self.refit.theta),
            "corrected": (self.corrected.model, self.corrected.theta),
        }

    @property
    def baseline(self) -> str:
        """What a gap is measured from: the refit where parameters were freed, else the nominal."""
        freed = any(np.isinf(std) for std in self.nominal.priors.values())
        return "refit" if freed else "nominal"

    @property
    def shown(self) -> tuple[str, ...]:
        """Which plants to look at beside one another; one alone where nothing was corrected."""
        if self.corrected.model.named or self.corrected.model.learned:
            return (self.baseline, "corrected")
        return ("nominal",) if self.baseline == "nominal" else ("nominal", "refit")


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval."""

    value: float
    low: float
    """of the 95 % interval"""
    high: float
    """of the 95 % interval"""


@dataclass(frozen=True)
class Step:
    """The error at the end of held-out windows with one thing more mended."""

    added: str
    """what: the parameters, or an effect at its target"""
    error: Interval
    """mean over the joints, each in its noise std [-]"""


@dataclass(frozen=True)
class Comparison:
    """Root-mean-square errors of position at the end of held-out windows."""

    horizon_s: float
    """time after the start of a window [s]"""
    nominal: float
    """mean over the joints, each in its noise std [-]"""
    refit: float
    """of the plant with its uncertain parameters refitted"""
    corrected: float
    """of the plant with the effects that were found"""
    noise_floor: float
    """of a model without error: noise, and what it does to the estimated start"""
    closed: Interval
    """(nominal - corrected) / (nominal - noise floor); with refit where parameters were freed"""
    hidden: bool
    """whether noise hides the gap: the error that shrinks is not surely above the noise floor"""
    channels: dict[str, dict[str, float]]
    """the same by state, in its unit"""
    over_time: dict[str, Float[np.ndarray, " T"]]
    """the errors over the time since the start, by model [noise std]; NaN where none is known"""
    bands: dict[str, Float[np.ndarray, "2 T"]]
    """ends of their 95 % intervals"""
    steps: tuple[Step, ...]
    """how the error at the end shrinks, from the nominal plant to the corrected one"""
    windows: Windows
    """the held-out windows; they number the held-out recordings"""
    runs: dict[str, Float[np.ndarray, "W X T"]]
    """free runs of the nominal, refitted and corrected plant over them, in each state's unit"""


def compare(models: Models, windows: Windows) -> Comparison:
    """Errors of the nominal, refitted and corrected plant on held-out windows.

    Windows whose motion forgets its start before their end are left out: there no model, not even
    the true one, can be told from another.
    """
    T = windows.y.shape[2]
    best = models.corrected
    windows = lasting(best, windows)
    plants = models.named()
    runs = {name: free_run(model, theta, windows) for name, (model, theta) in plants.items()}
    errors = {name: error(windows, y) for name, y in runs.items()}
    (errors["noise_floor"],) = noise_floor(best.model, best.theta, windows)
    by_window = {name: at_end(e) for name, e in errors.items()}
    rms = {name: _rms(parts) for name, parts in by_window.items()}
    draws = _draws(len(windows))
    drawn = {name: _mean_rms(parts, draws) for name, parts in by_window.items()}
    states = models.nominal.plant.layout.states
    channels = {
        states[2 * j]: {
            name: float(np.sqrt(np.nanmean(parts[:, j])) * windows.std[2 * j])
            for name, parts in by_window.items()
        }
        for j in range(len(states) // 2)
    }
    growth = {name: _over_time(e, np.ones((1, len(e))))[0] for name, e in errors.items()}
    bands = {
        name: np.percentile(_over_time(e, draws), [2.5, 97.5], axis=0) for name, e in errors.items()
    }
    return Comparison(
        horizon_s=round((T - 1) * windows.dt, 6),
        **rms,
        closed=_closed(rms, drawn, models.baseline),
        hidden=bool(np.percentile(drawn[models.baseline] - drawn["noise_floor"], 2.5) <= 0.0),
        channels=channels,
        over_time=growth,
        bands=bands,
        steps=_steps(models, windows, by_window, draws),
        windows=windows,
        runs=runs,
    )


def lasting(found: Fit, windows: Windows) -> Windows:
    """The windows whose motion remembers its start to their end, if there are some."""
    kept = remembered(found.model, windows, found.theta)
    whole = np.any(kept.measured[:, 0::2, -1], axis=1)
    return windows[np.flatnonzero(whole)] if whole.sum() >= FEWEST else windows


def free_run(
    model: Model, theta: Float[np.ndarray, " p"], windows: Windows
) -> Float[np.ndarray, "W X T"]:
    """Simulated measurements, from starts fitted to the first part of each window."""
    y = windows.y.copy()
    y[:, :, round(KNOWN_S / windows.dt) :] = np.nan
    starts = settle(model, replace(windows, y=y), theta)
    return run(model, windows, theta[None], starts[None])[0]


def error(windows: Windows, simulated: Float[np.ndarray, "W X T"]) -> Float[np.ndarray, "W X T"]:
    """(measured - simulated) / noise std; NaN where nothing was measured."""
    r = residual(windows, simulated).reshape(windows.y.shape)
    return np.where(windows.measured, r, np.nan)


def noise_floor(
    model: Model, theta: Float[np.ndarray, " p"], windows: Windows, noises: int = 1
) -> Float[np.ndarray, "R W X T"]:
    """Errors of a model on its own motions with noise: what no model can do better.

    Args:
        model: that moves.
        theta: its parameters.
        windows: whose commands it gets.
        noises: how often its motions are measured anew.
    """
    rng = np.random.default_rng(0)
    starts = settle(model, windows, theta)
    truth = run(model, windows, theta[None], starts[None])[0]
    errors = []
    for _ in range(noises):
        noise = rng.standard_normal(truth.shape) * windows.std[:, None]
        own = replace(windows, y=np.where(windows.measured, truth + noise, np.nan))
        errors.append(error(own, free_run(model, theta, own)))
    return np.stack(errors)


def at_end(e: Float[np.ndarray, "W X T"]) -> Float[np.ndarray, "W J"]:
    """Mean squared error of each position at the end of each window."""
    T = e.shape[2]
    squares = np.square(e[:, 0::2, T - max(1, round(END * T)) :])
    known = np.isfinite(squares)
    return _ratio(np.where(known, squares, 0.0).sum(axis=2), known.sum(axis=2))


def path(found: Found, best: Fit) -> tuple[Fit, ...]:
    """The best fit of one of a fit's effects, the best of two with this one, ...; without itself.

    They are fits of the search, on its windows.
    """
    ours, steps = set(best.model.named), []
    chosen: set = set()
    for size in range(1, len(ours)):
        for known, _ in found.ranked:  # the best first
            theirs = set(known.model.named)
            if len(theirs) == size and chosen <= theirs <= ours:
                steps.append(known)
                chosen = theirs
                break
    return tuple(steps)


def _steps(
    models: Models,
    windows: Windows,
    by_window: Mapping[str, Float[np.ndarray, "W J"]],
    draws: Float[np.ndarray, "R W"],
) -> tuple[Step, ...]:
    """The errors of the nominal plant, the refitted one, and those with more and more effects."""
    parts = {"nominal": by_window["nominal"], "parameters refitted": by_window["refit"]}
    before: tuple = models.refit.model.named
    pushed: set[str] = set()
    for known in (*models.steps, models.corrected):
        added = [str(active) for active in known.model.named if active not in before]
        added += [f"learned force ({joint})" for joint in sorted(_pushed(known) - pushed)]
        pushed |= _pushed(known)
        before = known.model.named
        if known is models.corrected:
            squares = by_window["corrected"]
        else:
            squares = at_end(error(windows, free_run(known.model, known.theta, windows)))
        if added:
            parts[" + ".join(added)] = squares
    return tuple(Step(name, _with_interval(squares, draws)) for name, squares in parts.items())


def _pushed(known: Fit) -> set[str]:
    """The joints in which a fit has learned forces."""
    return {force.joint for force in known.model.learned}


def shrunk(before: Fit, after: Fit, windows: Windows) -> Interval:
    """By which part the error at the end of windows is smaller, with an interval; below 0: larger.

    Args:
        before: a fit.
        after: another.
        windows: that neither has seen.
    """
    windows = lasting(after, windows)
    ends = [at_end(error(windows, free_run(f.model, f.theta, windows))) for f in (before, after)]

    def part(drawn: np.ndarray) -> np.ndarray:
        old, new = (_mean_rms(squares, drawn) for squares in ends)
        return 1.0 - new / old

    low, high = np.percentile(part(_draws(len(windows))), [2.5, 97.5])
    return Interval(float(part(np.ones((1, len(windows))))[0]), float(low), float(high))


def beyond_noise(found: Fit, windows: Windows) -> float:
    """The error at the end of windows, in parts of that of a model without error [-].

    Of each window in parts of its own: where a motion hardly remembers its start, the noise alone
    leads it far away.
    """
    windows = lasting(found, windows)
    simulated = free_run(found.model, found.theta, windows)
    floors = noise_floor(found.model, found.theta, windows, NOISES)
    usual = np.mean([at_end(floor) for floor in floors], axis=0)
    return _rms(at_end(error(windows, simulated)) / usual)


def _with_interval(squares: Float[np.ndarray, "W J"], draws: Float[np.ndarray, "R W"]) -> Interval:
    low, high = np.percentile(_mean_rms(squares, draws), [2.5, 97.5])
    return Interval(_rms(squares), float(low), float(high))


def _rms(squares: Float[np.ndarray, "W J"]) -> float:
    return float(_mean_rms(squares, np.ones((1, len(squares))))[0])


def _mean_rms(
    squares: Float[np.ndarray, "W J"], draws: Float[np.ndarray, "R W"]
) -> Float[np.ndarray, " R"]:
    """Mean over the joints of the root of the mean over windows, each as often as it was drawn."""
    return np.sqrt(_weighted_mean(squares, draws)).mean(axis=1)


def _over_time(
    e: Float[np.ndarray, "W X T"], draws: Float[np.ndarray, "R W"]
) -> Float[np.ndarray, "R T"]:
    """Root-mean-square error of position at each time; NaN where nothing was measured."""
    by_time = np.square(e[:, 0::2])
    seen = np.isfinite(by_time).sum(axis=1)
    total = np.nansum(by_time, axis=1)
    return np.sqrt(_ratio(draws @ total, draws @ seen))


def _weighted_mean(
    values: Float[np.ndarray, "W J"], draws: Float[np.ndarray, "R W"]
) -> Float[np.ndarray, "R J"]:
    known = np.isfinite(values)
    return _ratio(draws @ np.where(known, values, 0.0), draws @ known)


def _ratio(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """A mean; NaN of nothing."""
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _draws(W: int) -> Float[np.ndarray, "R W"]:
    """How often each window is in each resample of the block bootstrap."""
    rng = np.random.default_rng(0)
    blocks = -(-W // BLOCK)
    times = np.stack(
        [np.bincount(rng.integers(blocks, size=blocks), minlength=blocks) for _ in range(RESAMPLES)]
    )
    return np.repeat(times, BLOCK, axis=1)[:, :W].astype(float)


def _closed(
    rms: Mapping[str, float], drawn: Mapping[str, Float[np.ndarray, " R"]], baseline: str
) -> Interval:
    """The part of the gap that is closed, with its interval.

    Args:
        rms: errors, by model.
        drawn: the same in resamples of the block bootstrap.
        baseline: from which model the gap is measured.
    """

    def share(rms: Mapping[str, Any]) -> Float[np.ndarray, "*R"]:
        gap = rms[baseline] - rms["noise_floor"]
        closed = rms[baseline] - rms["corrected"]
        return np.where(gap > 0.0, closed / np.where(gap > 0.0, gap, 1.0), 0.0)

    low, high = np.percentile(share(drawn), [2.5, 97.5])
    return Interval(float(share(rms)), float(low), float(high))
