"""Output-error fits: free runs over windows against the measurement, their initial states free.

The initial state of a window moves only this window's residual. It is eliminated: what is left of
the other parameters' columns is what no initial state could have done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.plant_model import ComputeBudget, InitialStates, PerWindow, PlantModel, Theta
from mcpilco.gap.sensitivities import Linearised, lean, linearise, residuals_at, start_nudges
from mcpilco.gap.thresholds import BUDGET, DATA, FIT, SEARCH

LEAST_DAMPING = 1e-10
"""of a step, relative: a window that is cut off early may not determine its initial state"""


@dataclass(frozen=True)
class Fit:
    """A model fitted to windows."""

    model: PlantModel
    theta: Theta
    x0: InitialStates
    by_window: PerWindow
    """the squared residuals of each, over squared noise"""
    _known: list[Any] = field(default_factory=list, init=False, repr=False, compare=False)
    """windows, weights and kind of the last linear form, and this itself; see `linearised`"""

    @property
    def chi2(self) -> float:
        """Those of all windows, and the prior's."""
        return float(self.by_window.sum()) + self.model.penalty(self.theta)

    def linearised(
        self, windows: Windows, how: Callable[..., Linearised] = linearise
    ) -> Linearised:
        """The model where it was fitted; on the same windows, weighed alike, it is known."""
        key = windows.y, windows.whitening, how
        if not self._known or any(a is not b for a, b in zip(self._known, key, strict=False)):
            self._known[:] = *key, how(self.model, windows, self.theta, self.x0)
        return self._known[-1]

    def allowed(self, budget: ComputeBudget) -> Fit:
        """This fit, with other steps for what follows it."""
        return replace(self, model=replace(self.model, budget=budget))

    def at(self, chosen: Int[np.ndarray, " V"]) -> Fit:
        """This fit, of some of the windows only."""
        return replace(self, x0=self.x0[chosen], by_window=self.by_window[chosen])


@dataclass(frozen=True)
class Robust:
    """How windows count: in full up to some times the median misfit, and slowly more beyond.

    A window far beyond lacks its initial state, or holds an event; the others must not follow it.

    Reference: Huber & Ronchetti, Robust Statistics (2009), chapter 7, with windows for samples.
    """

    samples: Int[np.ndarray, " W"]
    """measured values of each window"""
    limit: float
    """squared misfit of a sample up to which a window counts in full"""

    @classmethod
    def of(cls, by_window: PerWindow, samples: Int[np.ndarray, " W"]) -> Robust:
        """The limit that suits the misfits of some windows."""
        return cls(samples, FIT.tolerated * max(1.0, float(np.median(by_window / samples))))

    def cost(self, by_window: PerWindow) -> float:
        """Sum over windows, logarithmic beyond the limit."""
        ratio = np.maximum(by_window / self.samples / self.limit, 1e-30)
        return float(self.limit * self.samples @ np.where(ratio < 1.0, ratio, 1.0 + np.log(ratio)))

    def weights(self, by_window: PerWindow) -> PerWindow:
        """Slope of the cost over each window's misfit."""
        return np.minimum(1.0, self.limit / np.maximum(by_window / self.samples, 1e-12))

    def far(self, by_window: PerWindow) -> Bool[np.ndarray, " W"]:
        """Windows beyond the limit."""
        return by_window / self.samples > self.limit


def fit_model(
    model: PlantModel,
    windows: Windows,
    theta: Theta,
    x0: InitialStates,
    iterations: int = 20,
    hasty: bool = False,
    near: Linearised | None = None,
) -> Fit:
    """Theta and the initial states that fit best, by Levenberg and Marquardt's method.

    Args:
        model: what is fitted.
        windows: to what.
        theta: where the search begins.
        x0: initial states from which it begins.
        iterations: at most.
        hasty: end as well where the cost falls but slowly.
        near: how a model changes that lacks its last effect, with which the search begins.

    Without learned forces a linear form is kept as long as it foretells what a step does.
    """
    damping, share = 1e-4, model.budget.share(BUDGET.fit)
    lin, given_up, dear = near, np.zeros(len(windows), dtype=bool), model.plant.costly
    for _ in range(iterations):
        low, high = model.reach(theta)
        held = lin if dear and not near and not model.learned else None  # what a prior holds stays
        kept, lin = near, linearise(model, windows, theta, x0, near or held, anew=bool(held))
        by_window = np.einsum("wn,wn->w", lin.r, lin.r)
        robust = Robust.of(by_window, windows.samples)
        weight = robust.weights(by_window)
        temper = misfit(windows, by_window, weight)
        now = _cost(model, theta, by_window, robust, temper)
        for _ in range(2 if kept else 6):
            step = _gauss_newton_step(model, lin, theta, damping, weight, temper)
            there = model.softened(np.clip(theta + step, low, high))
            residual_there = lin.r - np.einsum("wnp,p->wn", lin.Jp, there - theta)
            if dear:
                moved, after = given_way(model, windows, there, x0, lin.Jx, damping)
            else:
                moved = x0 + initial_state_step(lin.Jx, residual_there, damping)
                after = misfits(model, windows, there, moved)
            then = _cost(model, there, after, robust, temper)
            if abs(then - now) < FIT.converged * now:
                break
            worse = np.flatnonzero(after > by_window)
            if not then < now and len(worse) and not dear:  # right, perhaps, and too far for x0
                moved[worse] = improved_initial_states(
                    model, windows[worse], there, moved[worse], FIT.few
                )
                after[worse] = misfits(model, windows[worse], there, moved[worse])
                then = _cost(model, there, after, robust, temper)
            if then < now:
                break
            damping = max(10.0 * damping, 1e-4)
        expected = _squares(residual_there - np.einsum("wnx,wx->wn", lin.Jx, moved - x0))
        hoped = now - _cost(model, there, expected, robust, temper)
        near = lin if not model.learned and now - then > FIT.foretold * hoped else None
        if not then < now:
            if kept:
                continue
            break
        theta, x0, by_window = there, moved, after
        lost = Robust.of(after, windows.samples).far(after) & ~given_up
        if lost.any() and not lost.all():  # the step was too far for their initial states
            x0, by_window = recovered(model, windows, theta, x0, by_window, lost)
            if dear:  # behind an impact no start may fit
                given_up |= lost & (by_window == after)
        damping = max(0.03 * damping, LEAST_DAMPING)
        wrong = dear and temper > SEARCH.least_noise  # whose optimum tells little
        crawling = (hasty or wrong) and now - then < FIT.crawl * now
        crawling |= dear and now - then < FIT.settled * temper
        if crawling or share.used_up or (not kept and now - then < FIT.converged * now):
            break
        if now - then < FIT.converged * now:
            near = None
    return Fit(model, theta, x0, by_window)


def _gauss_newton_step(
    model: PlantModel,
    lin: Linearised,
    theta: Theta,
    damping: float,
    weight: np.ndarray,
    temper: float,
) -> np.ndarray:
    """The damped Gauss-Newton step of theta, the initial states eliminated, within its bounds."""
    H, g = lin.normal_equations(theta, weight, temper * model.precision)
    low, high = model.bounds
    free = ~((theta <= low) & (g < 0.0)) & ~((theta >= high) & (g > 0.0)) & (np.diag(H) > 0.0)
    step = np.zeros_like(theta)
    if free.any():
        Hf = H[np.ix_(free, free)]
        size = np.sqrt(np.diag(Hf))
        Hf = Hf / size[:, None] / size
        step[free] = np.linalg.solve(Hf + damping * np.eye(len(Hf)), g[free] / size) / size
    return step


def _cost(
    model: PlantModel, theta: Theta, by_window: np.ndarray, robust: Robust, temper: float
) -> float:
    return robust.cost(by_window) + temper * model.penalty(theta)


def misfit(windows: Windows, by_window: PerWindow, weight: PerWindow) -> float:
    """chi^2 of a sample, at least 1: by how much a misfit exceeds the noise.

    While a model misses an effect, its residuals are no noise, and the nominal parameters must not
    be bent for their sake: the prior holds against them as if the noise were that much larger.
    """
    samples = windows.samples
    return max(1.0, float(weight @ by_window) / max(float(weight @ samples), 1.0))


def misfits(model: PlantModel, windows: Windows, theta: Theta, x0: InitialStates) -> PerWindow:
    """Squared residual of each window."""
    return _squares(residuals_at(model, windows, theta, x0))


def _squares(r: Float[np.ndarray, "W n"]) -> PerWindow:
    return np.einsum("wn,wn->w", r, r)


def recovered(
    model: PlantModel,
    windows: Windows,
    theta: Theta,
    x0: InitialStates,
    by_window: np.ndarray,
    lost: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Initial states and misfits, those of lost windows fitted anew where that helps."""
    some = windows[lost]
    anew = fit_initial_states(model, some, theta)
    misfit_anew = misfits(model, some, theta, anew)
    better = misfit_anew < by_window[lost]
    x0, by_window = x0.copy(), by_window.copy()
    numbers = np.flatnonzero(lost)[better]
    x0[numbers], by_window[numbers] = anew[better], misfit_anew[better]
    return x0, by_window


def fit_initial_states(
    model: PlantModel, windows: Windows, theta: Theta, x0: InitialStates | None = None
) -> InitialStates:
    """Initial states fitted window by window, first to its beginning and then to all of it.

    The fit begins at `x0`, by default where the model's sensors would measure what was measured.
    """
    x0 = model.invert_sensors(theta, windows.guess) if x0 is None else x0
    y = windows.y.copy()
    y[:, :, y.shape[2] // 3 :] = np.nan
    if np.isfinite(y).any():
        x0 = improved_initial_states(model, replace(windows.plain, y=y), theta, x0)
    return improved_initial_states(model, windows, theta, x0)


def improved_initial_states(
    model: PlantModel, windows: Windows, theta: Theta, x0: InitialStates, iterations: int = 10
) -> InitialStates:
    """The initial states; where a simulation is dear, steps tell how its answer to them changes.

    Reference: Broyden, A class of methods for solving nonlinear simultaneous equations,
        Mathematics of Computation 19 (1965).
    """
    if windows.whitening is None:
        measured = np.flatnonzero(windows.measured.any(axis=(0, 1)))
        windows = windows.part(0, int(measured[-1]) + 1 if len(measured) else 1)
    x0, damping = x0.copy(), np.full(len(x0), 1e-3)
    moving, kept = np.arange(len(x0)), np.zeros(len(x0), dtype=bool)
    lin = lean(model, windows, theta, x0)
    r, Jx, unit = lin.r.copy(), lin.Jx.copy(), np.square(start_nudges(x0.shape[1]))
    for _ in range(iterations):
        some, here, J = windows[moving], r[moving], Jx[moving]
        step = initial_state_step(J, here, damping[moving])
        moved = x0[moving] + step
        there = residuals_at(model, some, theta, moved)
        now, then = _squares(here), _squares(there)
        left = here - np.einsum("wnx,wx->wn", J, step)
        better, small, was_kept = then < now, now - then < 1e-2 * now, kept[moving]
        x0[moving[better]], r[moving[better]] = moved[better], there[better]
        foretold = now - then > FIT.foretold * (now - _squares(left))
        if model.plant.costly:
            along = step / unit / np.maximum((np.square(step) / unit).sum(axis=1), 1e-12)[:, None]
            secant = np.einsum("wn,wx->wnx", left - there, along)
            Jx[moving[better]] += secant[better]
            kept[moving] = better & ~small & foretold
        anew = np.where(better, ~kept[moving], was_kept)
        damping[moving] *= np.where(better, 0.1, 10.0)
        damping = np.maximum(damping, 1e-9)
        settled = small & (better & foretold | ~was_kept & (better | (damping[moving] > 1e3)))
        anew, moving = moving[anew & ~settled], moving[~settled]
        if not len(moving):
            break
        if len(anew):
            lin = lean(model, windows[anew], theta, x0[anew])
            r[anew], Jx[anew] = lin.r, lin.Jx
    return x0


def initial_state_step(
    Jx: Float[np.ndarray, "W n X"], goal: Float[np.ndarray, "W n"], damping=1e-3
) -> InitialStates:
    """Least-squares change of the initial states that explains `goal`, damped."""
    N = np.einsum("wni,wnj->wij", Jx, Jx)
    size = np.sqrt(np.maximum(np.einsum("wii->wi", N), 1e-12))
    N = N / size[:, :, None] / size[:, None, :]
    N = N + np.broadcast_to(np.asarray(damping)[..., None, None] * np.eye(N.shape[-1]), N.shape)
    g = np.einsum("wni,wn->wi", Jx, goal) / size
    return np.linalg.solve(N, g[..., None])[..., 0] / size


def given_way(
    model: PlantModel,
    windows: Windows,
    theta: Theta,
    x0: InitialStates,
    Jx: Float[np.ndarray, "W n X"],
    damping: float = 1e-3,
) -> tuple[InitialStates, PerWindow]:
    """Initial states that give way to theta in windows that are missed less so, and misfits.

    Behind a contact motions do not answer linearly: they may begin as measured there, too.
    """
    r = residuals_at(model, windows, theta, x0)
    starts = [x0, x0 + initial_state_step(Jx, r, damping)]
    if model.plant.timestep_s:
        starts.append(model.invert_sensors(theta, windows.guess))
    missed = [_squares(r), *(misfits(model, windows, theta, each) for each in starts[1:])]
    least = np.argmin(missed, axis=0)
    return np.array(starts)[least, np.arange(len(x0))], np.min(missed, axis=0)


def truncated(model: PlantModel, windows: Windows, theta: Theta) -> Windows:
    """The windows, cut off where their motion has diverged.

    Beyond, an error of the initial state has grown so much that no fit can follow it.
    """
    x0 = model.invert_sensors(theta, windows.guess)
    lin = linearise(model, windows.plain, theta, x0, over_theta=False)
    W, X, T = windows.y.shape
    sensitivity = lin.Jx.reshape(W, X, T, X) * (windows.std[:, None, None] / windows.std)
    growth = np.sqrt(np.einsum("wxtk,wxtk->wt", sensitivity, sensitivity) / X)
    first = growth[:, : max(3, round(0.1 / windows.dt))].mean(axis=1)
    diverged = np.maximum.accumulate(growth > FIT.divergence * first[:, None], axis=1)
    diverged |= first[:, None] == 0.0
    return replace(windows.plain, y=np.where(diverged[:, None], np.nan, windows.y))


def fit_nominal(model: PlantModel, windows: Windows) -> tuple[Fit, Windows]:
    """The fit from the nominal parameters, and the windows to where their motion diverges.

    Where a simulation is dear the parameters stay for now: all fits that follow move them.
    """
    theta = np.zeros(model.nuisances)
    windows = truncated(model, windows, theta)
    x0 = fit_initial_states(model, windows, theta)
    if model.plant.costly:
        return Fit(model, theta, x0, misfits(model, windows, theta, x0)), windows
    return fit_model(model, windows, theta, x0), windows


def refit_nominal(null: Fit, windows: Windows) -> Fit:
    """The nominal fit to windows of which samples were taken; where dear, the parameters stay."""
    if null.model.plant.costly:
        return weighed_anew(null, windows)
    return fit_model(null.model, windows, null.theta, null.x0, iterations=5)


def refit_truncated(fit: Fit, windows: Windows) -> tuple[Fit, Windows]:
    """The fit of a search on all windows, those that it has not seen included."""
    kept = truncated(fit.model, windows, fit.theta)
    return refit(fit, kept), kept


def refit(fit: Fit, windows: Windows) -> Fit:
    """The fit of a model on the windows as they are."""
    x0 = fit_initial_states(fit.model, windows, fit.theta)
    return fit_model(fit.model, windows, fit.theta, x0, iterations=15)


def on_windows(fit: Fit, windows: Windows) -> Fit:
    """A fit as it is on other windows, whose initial states alone are fitted."""
    x0 = fit_initial_states(fit.model, windows, fit.theta)
    return Fit(fit.model, fit.theta, x0, misfits(fit.model, windows, fit.theta, x0))


def nearer(fit: Fit, windows: Windows) -> Fit:
    """A fit whose motions begin where they stay near what was measured.

    Where random forces weigh them, a fit may let them go far away.
    """
    x0 = improved_initial_states(fit.model, windows.plain, fit.theta, fit.x0)
    return weighed_anew(replace(fit, x0=x0), windows.plain)


def residuals(fit: Fit, windows: Windows) -> Float[np.ndarray, "W X T"]:
    """(measured - simulated) / noise std of a fit; 0 where nothing was measured."""
    r = residuals_at(fit.model, windows.plain, fit.theta, fit.x0)
    return r.reshape(windows.y.shape)


def weighed_anew(fit: Fit, windows: Windows) -> Fit:
    """A fit with its misfit by other weights of its windows."""
    return replace(fit, by_window=misfits(fit.model, windows, fit.theta, fit.x0))


def likeliest(problems: Sequence[GapProblem], fit: Fit | None = None) -> GapProblem:
    """The first problem, or that of another origin of the recordings which fits surely better.

    A millisecond shows. What a model lacks hides it, so that of `fit` is asked, or the nominal one.
    """
    if len(problems) == 1:
        return problems[0]
    first, *others = [_log_misfits(replace(p, std=problems[0].std), fit) for p in problems]
    fewer = [first - other for other in others]
    gains = [f.mean() - DATA.told_errors * f.std() / np.sqrt(len(f)) for f in fewer]
    return problems[1 + int(np.argmax(gains))] if max(gains) > 0.0 else problems[0]


def _log_misfits(problem: GapProblem, fit: Fit | None) -> PerWindow:
    """Log misfit of each window of a model that is fitted to them."""
    windows = problem.windows()[:: DATA.told_every]
    model = replace(fit.model, plant=problem.plant) if fit else problem.model(windows)
    theta = fit.theta if fit else np.zeros(model.nuisances)
    windows = truncated(model, windows, theta)
    x0 = fit_initial_states(model, windows, theta)
    by_window = fit_model(model, windows, theta, x0, iterations=DATA.told_iterations).by_window
    return np.log(np.maximum(by_window / np.maximum(windows.samples, 1), 1e-3))
