"""Output-error fits: free runs over windows against the measurement, their start states free.

The start state of a window moves only this window's residual. It is eliminated: what is left of the
other parameters' columns is what no start state could have done.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from mcpilco.gap.model import Model
from mcpilco.gap.pushes import learned_columns
from mcpilco.gap.windows import Windows
from mcpilco.plant import simulate

LOST = 1e3
"""residual of a sample that a simulation that ran away did not reach, in noise std"""
CONVERGED = 1e-4
"""relative change of the cost below which a fit ends"""
FAR, CRAWL = 10.0, 0.02
"""misfit of a sample beyond which a model is far from fitting; change of the cost that is little"""
A_FIT = 0.2
"""part of the steps left to an investigation beyond which a fit makes no further iteration"""
TOLERATED = 9.0
"""how many times the median misfit a window may have and still count in full"""
LEAST_DAMPING = 1e-10
"""of a step, relative: a window that is cut off early may not tell all of its start state"""
START_STEPS = 1e-3, 1e-2
"""of finite differences over the start state: positions [m or rad], velocities [m/s or rad/s]"""


@dataclass(frozen=True)
class Linear:
    """A model at theta and start states: its residuals and how they change.

    Rows of unmeasured samples are 0.
    """

    r: Float[np.ndarray, "W n"]
    """(measured - simulated) / noise std"""
    Jx: Float[np.ndarray, "W n X"]
    """change of the simulation with the start state, over the noise std"""
    Jp: Float[np.ndarray, "W n p"]
    """with theta"""

    def __getitem__(self, chosen: Int[np.ndarray, " V"]) -> Linear:
        """Some of the windows."""
        return Linear(self.r[chosen], self.Jx[chosen], self.Jp[chosen])

    @cached_property
    def basis(self) -> Float[np.ndarray, "W n X"]:
        """Orthonormal columns that span those of Jx."""
        size = np.linalg.norm(self.Jx, axis=1, keepdims=True)
        return np.linalg.qr(self.Jx / np.where(size > 0.0, size, 1.0))[0]

    def cleaned(self, columns: Float[np.ndarray, "W n k"]) -> Float[np.ndarray, "W n k"]:
        """What no start state could have done."""
        return columns - self.basis @ (self.basis.transpose(0, 2, 1) @ columns)

    def normal_equations(
        self,
        theta: Float[np.ndarray, " p"],
        weight: Float[np.ndarray, " W"],
        precision: Float[np.ndarray, " p"],
    ) -> tuple[Float[np.ndarray, "W n p"], Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
        """P, H and g: cleaned columns of theta, and H step = g of the best step with a prior."""
        P = self.cleaned(self.Jp)
        WP = weight[:, None, None] * P
        H = np.einsum("wni,wnj->ij", WP, P) + np.diag(precision)
        return P, H, np.einsum("wni,wn->i", WP, self.r) - precision * theta


@dataclass(frozen=True)
class Fit:
    """A model fitted to windows."""

    model: Model
    theta: Float[np.ndarray, " p"]
    starts: Float[np.ndarray, "W X"]
    chi2: float
    """squared residuals over squared noise, and the prior's"""
    by_window: Float[np.ndarray, " W"]
    """the squared residuals of each"""

    def at(self, chosen: Int[np.ndarray, " V"]) -> Fit:
        """This fit, of some of the windows only."""
        by_window = self.by_window[chosen]
        return replace(self, starts=self.starts[chosen], by_window=by_window)


def run(
    model: Model,
    windows: Windows,
    theta: Float[np.ndarray, "S p"],
    starts: Float[np.ndarray, "S W X"],
) -> Float[np.ndarray, "S W X T"]:
    """Simulated measurements of S parameter vectors, each on all windows."""
    S, W = starts.shape[:2]
    system, window = np.repeat(np.arange(S), W), np.tile(np.arange(W), S)
    y = simulate(
        model.tables(theta),
        system,
        np.ascontiguousarray(starts.reshape(S * W, -1)),
        window,
        np.ascontiguousarray(windows.commands),  # compiled for these alone
        windows.lead,
        windows.dt,
        model.effort.taken,
    )
    return y.reshape(S, W, *y.shape[1:])


def residual(windows: Windows, y: Float[np.ndarray, "... W X T"]) -> Float[np.ndarray, "... W n"]:
    """(measured - simulated) / noise std; 0 where nothing was measured."""
    r = (windows.y - y) / windows.std[:, None]
    r = np.where(np.isfinite(y), r, LOST)
    r = np.where(windows.measured, r, 0.0)
    return r.reshape(*r.shape[:-2], -1)


def linearise(
    model: Model,
    windows: Windows,
    theta: Float[np.ndarray, " p"],
    starts: Float[np.ndarray, "W X"],
    over_theta: bool = True,
) -> Linear:
    """The model's residuals at theta and the start states, and their central differences.

    Differences to one side only are not enough: where masses and gains grow together nothing
    moves, and their columns must cancel. The coordinates of learned forces are many, and their
    columns are made of answers to pushes.
    """
    X, p = starts.shape[1], len(theta) - model.coordinates if over_theta else 0
    nudges = np.tile(START_STEPS, X // 2)
    steps = model.steps(theta)[:p]
    thetas = np.tile(theta, (1 + 2 * X + 2 * p, 1))
    moved = np.tile(starts, (1 + 2 * X + 2 * p, 1, 1))
    for sign, first in ((1.0, 1), (-1.0, 1 + X)):
        moved[first : first + X] += sign * np.diag(nudges)[:, None]
    for sign, first in ((1.0, 1 + 2 * X), (-1.0, 1 + 2 * X + p)):
        thetas[first : first + p] += sign * np.eye(p, len(theta)) * steps[:, None]
    low, high = model.bounds
    thetas = np.clip(thetas, low, high)
    y = run(model, windows, thetas, moved)
    r = residual(windows, y)
    ups, downs = thetas[1 + 2 * X : 1 + 2 * X + p], thetas[1 + 2 * X + p :]
    spans = np.diag(ups - downs).copy() if p else np.zeros(0)
    spans[spans == 0.0] = np.inf  # so large that no step changes them: they are not felt
    Jx = (r[1 + X : 1 + 2 * X] - r[1 : 1 + X]) / (2.0 * nudges)[:, None, None]
    Jp = (r[1 + 2 * X + p :] - r[1 + 2 * X : 1 + 2 * X + p]) / spans[:, None, None]
    lost = (np.abs(r) >= LOST).any(axis=0)
    Jx[:, lost], Jp[:, lost] = 0.0, 0.0
    columns = Jp.transpose(1, 2, 0)
    if over_theta and model.learned:
        learned = learned_columns(model, windows, theta, starts, y[0])
        learned[lost] = 0.0
        columns = np.concatenate([columns, learned], axis=2)
    return Linear(r[0], Jx.transpose(1, 2, 0), columns)


def _leaning(
    model: Model, windows: Windows, theta: Float[np.ndarray, " p"], starts: Float[np.ndarray, "W X"]
) -> Linear:
    """The model's residuals, and one-sided differences over the start states alone.

    They are enough for steps of the start states, each of which is judged by what it brings.
    """
    X = starts.shape[1]
    nudges = np.tile(START_STEPS, X // 2)
    moved = np.tile(starts, (1 + X, 1, 1))
    moved[1:] += np.diag(nudges)[:, None]
    r = residual(windows, run(model, windows, np.tile(theta, (1 + X, 1)), moved))
    Jx = (r[0] - r[1:]) / nudges[:, None, None]
    Jx[:, (np.abs(r) >= LOST).any(axis=0)] = 0.0
    return Linear(r[0], Jx.transpose(1, 2, 0), np.zeros((*r[0].shape, 0)))


@dataclass(frozen=True)
class Robust:
    """How windows count: in full up to some times the median misfit, and slowly more beyond.

    A window far beyond has not found its start yet, or holds an event; the others must not follow
    it.

    Reference: Huber & Ronchetti, Robust Statistics (2009), chapter 7, with windows for samples.
    """

    samples: Int[np.ndarray, " W"]
    """measured values of each window"""
    limit: float
    """squared misfit of a sample up to which a window counts in full"""

    @classmethod
    def of(cls, by_window: Float[np.ndarray, " W"], samples: Int[np.ndarray, " W"]) -> Robust:
        """The limit that suits the misfits of some windows."""
        return cls(samples, TOLERATED * max(1.0, float(np.median(by_window / samples))))

    def cost(self, by_window: Float[np.ndarray, " W"]) -> float:
        """Sum over windows, logarithmic beyond the limit."""
        ratio = np.maximum(by_window / self.samples / self.limit, 1e-30)
        return float(self.limit * self.samples @ np.where(ratio < 1.0, ratio, 1.0 + np.log(ratio)))

    def weights(self, by_window: Float[np.ndarray, " W"]) -> Float[np.ndarray, " W"]:
        """Slope of the cost over each window's misfit."""
        return np.minimum(1.0, self.limit / np.maximum(by_window / self.samples, 1e-12))

    def far(self, by_window: Float[np.ndarray, " W"]) -> Bool[np.ndarray, " W"]:
        """Windows beyond the limit."""
        return by_window / self.samples > self.limit


def settle(
    model: Model,
    windows: Windows,
    theta: Float[np.ndarray, " p"],
    starts: Float[np.ndarray, "W X"] | None = None,
) -> Float[np.ndarray, "W X"]:
    """Start states fitted window by window, first to its beginning and then to all of it.

    They begin where the sensors of the model would have measured what was measured, if not told.
    """
    T = windows.y.shape[2]
    starts = model.unread(theta, windows.guess) if starts is None else starts
    for part in (T // 3, T):
        y = windows.y.copy()
        y[:, :, part:] = np.nan
        starts = _settle(model, replace(windows, y=y), theta, starts)
    return starts


def _settle(
    model: Model, windows: Windows, theta: np.ndarray, starts: np.ndarray, iterations: int = 10
) -> np.ndarray:
    measured = np.flatnonzero(windows.measured.any(axis=(0, 1)))
    windows = windows.beginning(int(measured[-1]) + 1 if len(measured) else 1)
    starts, damping = starts.copy(), np.full(len(starts), 1e-3)
    left = np.arange(len(starts))
    for _ in range(iterations):
        some = windows[left]
        lin = _leaning(model, some, theta, starts[left])
        now = np.einsum("wn,wn->w", lin.r, lin.r)
        moved = starts[left] + _start_step(lin, lin.r, damping[left])
        then = misfits(model, some, theta, moved)
        better = then < now
        starts[left[better]] = moved[better]
        damping[left] *= np.where(better, 0.1, 10.0)
        damping = np.maximum(damping, 1e-9)
        settled = (now - then < 1e-2 * now) & (better | (damping[left] > 1e3))
        left = left[~settled]
        if not len(left):
            break
    return starts


def _start_step(lin: Linear, goal: Float[np.ndarray, "W n"], damping) -> Float[np.ndarray, "W X"]:
    """Least-squares change of the start states that explains `goal`, damped."""
    N = np.einsum("wni,wnj->wij", lin.Jx, lin.Jx)
    diagonal = np.einsum("wii->wi", N)
    size = np.sqrt(np.maximum(diagonal, 1e-12))
    N = N / size[:, :, None] / size[:, None, :]
    N = N + np.broadcast_to(np.asarray(damping)[..., None, None] * np.eye(N.shape[-1]), N.shape)
    g = np.einsum("wni,wn->wi", lin.Jx, goal) / size
    return np.linalg.solve(N, g[..., None])[..., 0] / size


def fit(
    model: Model,
    windows: Windows,
    theta: Float[np.ndarray, " p"],
    starts: Float[np.ndarray, "W X"],
    iterations: int = 20,
    hasty: bool = False,
) -> Fit:
    """Theta and the start states that fit best, by Levenberg and Marquardt's method.

    Args:
        model: what is fitted.
        windows: to what.
        theta: where the search begins.
        starts: likewise.
        iterations: at most.
        hasty: end as well where a model that is far from fitting crawls.
    """
    damping, share = 1e-4, model.effort.share(A_FIT)
    for _ in range(iterations):
        low, high = model.reach(theta)
        lin = linearise(model, windows, theta, starts)
        by_window = np.einsum("wn,wn->w", lin.r, lin.r)
        robust = Robust.of(by_window, windows.samples)
        weight = robust.weights(by_window)
        temper = misfit(windows, by_window, weight)
        now = _cost(model, theta, by_window, robust, temper)
        for _ in range(6):
            step = _step(model, lin, theta, damping, weight, temper)
            there = model.softened(np.clip(theta + step, low, high))
            left = lin.r - np.einsum("wnp,p->wn", lin.Jp, there - theta)
            moved = starts + _start_step(lin, left, damping)
            after = misfits(model, windows, there, moved)
            then = _cost(model, there, after, robust, temper)
            if abs(then - now) < CONVERGED * now:
                break
            worse = np.flatnonzero(after > by_window)
            if not then < now and len(worse):  # the step may be right, and too far for their starts
                moved[worse] = _settle(model, windows[worse], there, moved[worse], 4)
                after[worse] = misfits(model, windows[worse], there, moved[worse])
                then = _cost(model, there, after, robust, temper)
            if then < now:
                break
            damping = max(10.0 * damping, 1e-4)
        if not then < now:
            break
        theta, starts, by_window = there, moved, after
        lost = Robust.of(after, windows.samples).far(after)
        if lost.any() and not lost.all():  # the step was too far for their starts
            starts, by_window = _recovered(model, windows, theta, starts, by_window, lost)
        damping = max(0.03 * damping, LEAST_DAMPING)
        crawling = hasty and temper > FAR and now - then < CRAWL * now
        if crawling or now - then < CONVERGED * now or share.used_up:
            break
    prior = float((model.precision * theta**2).sum())
    return Fit(model, theta, starts, float(by_window.sum()) + prior, by_window)


def misfits(
    model: Model, windows: Windows, theta: Float[np.ndarray, " p"], starts: Float[np.ndarray, "W X"]
) -> Float[np.ndarray, " W"]:
    """Squared residual of each window."""
    r = residual(windows, run(model, windows, theta[None], starts[None]))[0]
    return np.einsum("wn,wn->w", r, r)


def _recovered(
    model: Model,
    windows: Windows,
    theta: np.ndarray,
    starts: np.ndarray,
    by_window: np.ndarray,
    lost: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Start states and misfits, those of lost windows fitted anew where that helps."""
    some = windows[lost]
    anew = settle(model, some, theta)
    found = misfits(model, some, theta, anew)
    better = found < by_window[lost]
    starts, by_window = starts.copy(), by_window.copy()
    numbers = np.flatnonzero(lost)[better]
    starts[numbers], by_window[numbers] = anew[better], found[better]
    return starts, by_window


def _cost(
    model: Model, theta: np.ndarray, by_window: np.ndarray, robust: Robust, temper: float
) -> float:
    return robust.cost(by_window) + temper * float((model.precision * theta**2).sum())


def misfit(
    windows: Windows, by_window: Float[np.ndarray, " W"], weight: Float[np.ndarray, " W"]
) -> float:
    """chi^2 of a sample, at least 1: by how much a misfit exceeds the noise.

    While a model misses an effect, its residuals are no noise, and the nominal parameters must not
    be bent for their sake: the prior holds against them as if the noise were that much larger.
    """
    samples = windows.samples
    return max(1.0, float(weight @ by_window) / max(float(weight @ samples), 1.0))


def _step(
    model: Model, lin: Linear, theta: np.ndarray, damping: float, weight: np.ndarray, temper: float
) -> np.ndarray:
    """The damped Gauss-Newton step of theta, the start states eliminated, within its bounds."""
    _, H, g = lin.normal_equations(theta, weight, temper * model.precision)
    low, high = model.bounds
    free = ~((theta <= low) & (g < 0.0)) & ~((theta >= high) & (g > 0.0)) & (np.diag(H) > 0.0)
    step = np.zeros_like(theta)
    if free.any():
        Hf = H[np.ix_(free, free)]
        size = np.sqrt(np.diag(Hf))
        Hf = Hf / size[:, None] / size
        step[free] = np.linalg.solve(Hf + damping * np.eye(len(Hf)), g[free] / size) / size
    return step


MEMORY = 20.0
"""growth of a start state's error beyond which a window is cut off"""


def remembered(model: Model, windows: Windows, theta: Float[np.ndarray, " p"]) -> Windows:
    """The windows, cut off where a motion has forgotten its start.

    Beyond, an error of the start, or of anything else, has grown so much that no fit can follow it.
    """
    starts = model.unread(theta, windows.guess)
    lin = linearise(model, windows, theta, starts, over_theta=False)
    W, X, T = windows.y.shape
    felt = lin.Jx.reshape(W, X, T, X) * (windows.std[:, None, None] / windows.std)
    growth = np.sqrt(np.einsum("wxtk,wxtk->wt", felt, felt) / X)
    first = growth[:, : max(3, round(0.1 / windows.dt))].mean(axis=1)
    forgotten = np.maximum.accumulate(growth > MEMORY * first[:, None], axis=1)
    forgotten |= first[:, None] == 0.0
    return replace(windows, y=np.where(forgotten[:, None], np.nan, windows.y))
