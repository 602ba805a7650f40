"""Errors of free runs on held-out windows, with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.data import Windows
from mcpilco.gap.disturbance import Disturbance, Evidence
from mcpilco.gap.fit import Fit, fit_initial_states, on_windows, truncated
from mcpilco.gap.plant_model import PlantModel, Theta
from mcpilco.gap.sensitivities import lean, residual, run
from mcpilco.gap.thresholds import COMPARISON
from mcpilco.sweep import jackknife


@dataclass(frozen=True)
class ComparedModels:
    """The plants that are compared."""

    nominal: PlantModel
    """the plant as the user has it"""
    refit: Fit
    """the plant with its uncertain parameters refitted"""
    corrected: Fit
    """the plant with the effects that were found"""
    steps: tuple[Fit, ...] = ()
    """the plant with the first of these effects, with the first two, ...; without all of them"""

    def plants(self) -> dict[str, tuple[PlantModel, Float[np.ndarray, " p"]]]:
        """Model and parameters of each plant, by name."""
        return {
            "nominal": (self.nominal, np.zeros(self.nominal.nuisances)),
            "refit": (self.refit.model, self.refit.theta),
            "corrected": (self.corrected.model, self.corrected.theta),
        }

    @property
    def baseline(self) -> str:
        """The plant from which a gap is measured: the refit where parameters were freed."""
        return "refit" if any(map(np.isinf, self.nominal.priors.values())) else "nominal"

    @property
    def shown(self) -> tuple[str, ...]:
        """Which plants to look at beside one another; one alone where nothing was corrected."""
        if self.corrected.model.effects or self.corrected.model.learned:
            return (self.baseline, "corrected")
        return ("nominal",) if self.baseline == "nominal" else ("nominal", "refit")


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval."""

    value: float
    low: float
    """lower end of the 95 % interval"""
    high: float
    """upper end"""


@dataclass(frozen=True)
class ErrorStep:
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
    """(baseline - corrected) / (baseline - noise floor)"""
    baseline: str
    """from which plant that counts: nominal, or refit where parameters were freed"""
    hidden: bool
    """whether noise hides the gap: the error that shrinks is not surely above the noise floor"""
    channels: dict[str, dict[str, float]]
    """the same by state, in its unit [m, rad]"""
    everywhere: dict[str, float]
    """the same over all held-out windows, with events and motions that diverge [-]"""
    over_time: dict[str, Float[np.ndarray, " T"]]
    """the errors over the time since the start, by model [noise std]; NaN where none is known"""
    bands: dict[str, Float[np.ndarray, "2 T"]]
    """ends of their 95 % intervals"""
    steps: tuple[ErrorStep, ...]
    """how the error at the end shrinks, from the nominal plant to the corrected one"""
    windows: Windows
    """the held-out windows; they number the held-out recordings"""
    runs: dict[str, Float[np.ndarray, "W X T"]]
    """free runs of the nominal, refitted and corrected plant over them, in each state's unit"""

    def runs_away_s(self, name: str) -> Float[np.ndarray, " W"]:
        """When a plant's free run through each window is no longer finite, inf where it stays so.

        After the start of the window [s].
        """
        lost = ~np.isfinite(self.runs[name]).all(axis=1)
        return np.where(lost.any(axis=1), self.windows.dt * lost.argmax(axis=1), np.inf)


def compare(
    models: ComparedModels, windows: Windows, everything: Windows | None = None
) -> Comparison:
    """Errors of the nominal, refitted and corrected plant on held-out windows.

    Windows whose motion diverges before their end are left out: there no model, not even the true
    one, can be distinguished from another.

    Args:
        models: the plants.
        windows: without events and what was read wrongly.
        everything: with them; None: there are none.
    """
    everything = windows if everything is None else everything
    best = models.corrected
    windows = predictable(best, windows)
    plants = models.plants()
    runs = {name: free_run(model, theta, windows) for name, (model, theta) in plants.items()}
    errors = {name: scaled_errors(windows, y) for name, y in runs.items()}
    errors["noise_floor"] = noise_floor(best.model, best.theta, windows)
    by_window = {name: squares_at_end(e) for name, e in errors.items()}
    rms = {name: _rms(parts) for name, parts in by_window.items()}
    without = 1.0 - np.eye(len(windows))
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
        name: _factors(_over_time(e, without), windows) * growth[name] for name, e in errors.items()
    }
    base = models.baseline
    start, floor = (_mean_rms(by_window[name], without) for name in (base, "noise_floor"))
    return Comparison(
        horizon_s=round((windows.y.shape[2] - 1) * windows.dt, 6),
        **rms,
        closed=closed_interval(by_window, base, windows),
        baseline=base,
        hidden=bool(rms[base] - rms["noise_floor"] <= _half_width(start - floor, windows)),
        channels=channels,
        everywhere={
            name: _rms(squares_at_end(scaled_errors(everything, free_run(*plant, everything))))
            for name, plant in plants.items()
        },
        over_time=growth,
        bands=bands,
        steps=_steps(models, windows, by_window),
        windows=windows,
        runs=runs,
    )


def predictable(fit: Fit, windows: Windows) -> Windows:
    """The windows whose motion can be predicted to their end, if there are enough."""
    kept = truncated(fit.model, windows, fit.theta)
    whole = np.any(kept.measured[:, 0::2, -1], axis=1)
    return windows[np.flatnonzero(whole)] if whole.sum() >= COMPARISON.fewest else windows


def free_run(model: PlantModel, theta: Theta, windows: Windows) -> Float[np.ndarray, "W X T"]:
    """Simulated measurements, from initial states fitted to the first part of each window."""
    y = windows.y.copy()
    y[:, :, windows.beginning :] = np.nan
    x0 = fit_initial_states(model, replace(windows, y=y), theta)
    return run(model, windows, theta[None], x0[None])[0]


def scaled_errors(
    windows: Windows, simulated: Float[np.ndarray, "W X T"]
) -> Float[np.ndarray, "W X T"]:
    """(measured - simulated) / noise std; NaN where nothing was measured."""
    r = residual(windows, simulated).reshape(windows.y.shape)
    return np.where(windows.measured, r, np.nan)


def noise_floor(model: PlantModel, theta: Theta, windows: Windows) -> Float[np.ndarray, "W X T"]:
    """Errors of a model on its own motions with noise: no model has smaller ones."""
    rng = np.random.default_rng(0)
    x0 = fit_initial_states(model, windows, theta)
    truth = run(model, windows, theta[None], x0[None])[0]
    noise = rng.standard_normal(truth.shape) * windows.std[:, None]
    own = replace(windows, y=np.where(windows.measured, truth + noise, np.nan))
    return scaled_errors(own, free_run(model, theta, own))


def expected_squares(fit: Fit, windows: Windows, evidence: Evidence) -> Float[np.ndarray, "W J"]:
    """Mean squared error of each position at the end of each window that a model itself expects.

    With J the response to the initial state, which the readings of the first part determine by
    their pseudo-inverse P, and G that to random forces, what noise e and forces z lead to is

        (I - J P) (e + G z).

    Near an unstable rest that is a large part of the motion, which then says little of a model.
    The evidence holds the sizes of noise and random forces.
    """
    fit = on_windows(fit, windows)
    J = lean(fit.model, windows, fit.theta, fit.x0).Jx
    disturbance = Disturbance.of(fit, windows)
    noise = np.repeat(evidence.noise, windows.y.shape[2])
    begins = np.arange(windows.y.shape[2]) < windows.beginning
    early = (windows.measured & begins).reshape(len(windows), -1) / noise
    left = np.eye(len(noise)) - J @ (np.linalg.pinv(early[:, :, None] * J) * early[:, None])
    forced = left @ (disturbance.columns * evidence.std[disturbance.joint])
    squares = np.square(left * noise).sum(axis=2) + np.square(forced).sum(axis=2)
    seen = np.where(windows.measured, squares.reshape(windows.y.shape), np.nan)
    return squares_at_end(np.sqrt(seen))


def squares_at_end(e: Float[np.ndarray, "W X T"]) -> Float[np.ndarray, "W J"]:
    """Mean squared error of each position at the end of each window."""
    T = e.shape[2]
    squares = np.square(e[:, 0::2, T - max(1, round(COMPARISON.end * T)) :])
    known = np.isfinite(squares)
    return _ratio(np.where(known, squares, 0.0).sum(axis=2), known.sum(axis=2))


def _steps(
    models: ComparedModels, windows: Windows, by_window: Mapping[str, Float[np.ndarray, "W J"]]
) -> tuple[ErrorStep, ...]:
    """The errors of the nominal plant, the refitted one, and those with more and more effects."""
    parts = {"nominal": by_window["nominal"], "parameters refitted": by_window["refit"]}
    before: tuple = models.refit.model.effects
    forced: set[str] = set()
    for fit in (*models.steps, models.corrected):
        joints = {force.joint for force in fit.model.learned}
        added = [str(instance) for instance in fit.model.effects if instance not in before]
        added += [f"learned force ({joint})" for joint in sorted(joints - forced)]
        before, forced = fit.model.effects, forced | joints
        last = fit is models.corrected
        squares = by_window["corrected"] if last else _squares(fit, windows)
        if added:
            parts[" + ".join(added)] = squares
    return tuple(ErrorStep(name, rms_interval(part, windows)) for name, part in parts.items())


def _squares(fit: Fit, windows: Windows) -> Float[np.ndarray, "W J"]:
    """Mean squared error of a free run at the end of each window."""
    return squares_at_end(scaled_errors(windows, free_run(fit.model, fit.theta, windows)))


def error_reduction(before: Fit, after: Fit, windows: Windows, evidence: Evidence) -> Interval:
    """By which part the error at the end of windows is smaller, with an interval; below 0: larger.

    Of each window, which neither fit has seen, in parts of the error that can be expected there
    with random forces and noise of such sizes; see `expected_squares`.
    """
    windows = predictable(after, windows)
    usual = expected_squares(after, windows, evidence)
    old, new = (_squares(fit, windows) / usual for fit in (before, after))
    squares = {"before": old, "corrected": new, "noise_floor": np.zeros_like(usual)}
    return closed_interval(squares, "before", windows)


def misfit_over_expected(fit: Fit, windows: Windows, evidence: Evidence) -> float:
    """The misfit of windows, in parts of what noise and random forces of such sizes make of it [-].

    Initial states are fitted to all of a window: it does not decide by how far it diverges.
    """
    windows = truncated(fit.model, windows, fit.theta)
    white = Disturbance.of(on_windows(fit, windows), windows).whitened(evidence)
    by_window = on_windows(fit, white).by_window
    return float(np.sqrt(by_window.sum() / windows.samples.sum()))


def _half_width(left: Float[np.ndarray, "W ..."], windows: Windows) -> Float[np.ndarray, "*b"]:
    """Half of a 95 % interval; infinity for a single window.

    Windows share data where they overlap, by a part r, and their squared errors correlate by r^2.
    `left` holds a number without each of them.
    """
    apart = np.abs(windows.start_s[:, None] - windows.start_s) / (windows.y.shape[2] * windows.dt)
    same = windows.recording[:, None] == windows.recording
    return jackknife(left, np.where(same, np.maximum(1.0 - apart, 0.0), 0.0) ** 2)


def _factors(left: Float[np.ndarray, "W ..."], windows: Windows) -> Float[np.ndarray, "2 ..."]:
    """By which to multiply positive numbers for the ends of their intervals; args as there."""
    with np.errstate(divide="ignore", over="ignore"):
        half = _half_width(np.log(left), windows)
        return np.exp(np.stack([-half, half]))


def rms_interval(squares: Float[np.ndarray, "W J"], windows: Windows) -> Interval:
    """Mean over the joints of the root of the mean over windows, with its interval."""
    left = _mean_rms(squares, 1.0 - np.eye(len(windows)))
    value = _rms(squares)
    return Interval(value, *(float(end) for end in value * _factors(left, windows)))


def _rms(squares: Float[np.ndarray, "W J"]) -> float:
    return float(_mean_rms(squares, np.ones((1, len(squares))))[0])


def _mean_rms(
    squares: Float[np.ndarray, "W J"], weights: Float[np.ndarray, "R W"]
) -> Float[np.ndarray, " R"]:
    """Mean over the joints of the root of the mean over windows, by their weights."""
    known = np.isfinite(squares)
    return np.sqrt(_ratio(weights @ np.where(known, squares, 0.0), weights @ known)).mean(axis=1)


def _over_time(
    e: Float[np.ndarray, "W X T"], weights: Float[np.ndarray, "R W"]
) -> Float[np.ndarray, "R T"]:
    """Root-mean-square error of position at each time; NaN where nothing was measured."""
    by_time = np.square(e[:, 0::2])
    seen = np.isfinite(by_time).sum(axis=1)
    total = np.nansum(by_time, axis=1)
    return np.sqrt(_ratio(weights @ total, weights @ seen))


def _ratio(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """A mean; NaN of nothing."""
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def closed_interval(
    by_window: Mapping[str, Float[np.ndarray, "W J"]], baseline: str, windows: Windows
) -> Interval:
    """The part of the gap that is closed: 1 less the part that is left, a ratio where positive.

    From squared errors by model, of which the `baseline` is that from which the gap is measured.
    """

    def rest(weights: Float[np.ndarray, "R W"]) -> Float[np.ndarray, " R"]:
        start, end, floor = (
            _mean_rms(by_window[name], weights) for name in (baseline, "corrected", "noise_floor")
        )
        gap = start - floor
        return np.where(gap > 0.0, (end - floor) / np.where(gap > 0.0, gap, 1.0), 1.0)

    (value,), left = rest(np.ones((1, len(windows)))), rest(1.0 - np.eye(len(windows)))
    if value > 0.0 and (left > 0.0).all():
        low, high = value * _factors(left, windows)
    else:
        low, high = value + _half_width(left, windows) * np.array([-1.0, 1.0])
    return Interval(*(float(1.0 - part) for part in (value, high, low)))
