"""Output-error fits: free runs over windows against the measurement, their start states free.

The start state of a window moves only this window's residual. It is eliminated: what is left of the
other parameters' columns is what no start state could have done.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from mcpilco.gap.model import Model
from mcpilco.gap.windows import Windows
from mcpilco.simulation import simulate

LOST = 1e3
"""residual of a sample that a simulation that ran away did not reach, in noise std"""
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

    @cached_property
    def basis(self) -> Float[np.ndarray, "W n X"]:
        """Orthonormal columns that span those of Jx."""
        size = np.linalg.norm(self.Jx, axis=1, keepdims=True)
        return np.linalg.qr(self.Jx / np.where(size > 0.0, size, 1.0))[0]

    def cleaned(self, columns: Float[np.ndarray, "W n k"]) -> Float[np.ndarray, "W n k"]:
        """What no start state could have done."""
        return columns - self.basis @ (self.basis.transpose(0, 2, 1) @ columns)


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

    @property
    def effects(self) -> list[Float[np.ndarray, " symbols"]]:
        """Values of the model's effects."""
        return [values[0] for values in self.model.decode(self.theta[None])[1]]


def run(
    model: Model, windows: Windows, theta: Float[np.ndarray, "S p"], starts: Float[np.ndarray, "S W X"]
) -> Float[np.ndarray, "S W X T"]:
    """Simulated measurements of S parameter vectors, each on all windows."""
    S, W = starts.shape[:2]
    system, window = np.repeat(np.arange(S), W), np.tile(np.arange(W), S)
    y = simulate(
        model.tables(theta),
        system,
        np.ascontiguousarray(starts.reshape(S * W, -1)),
        window,
        windows.commands,
        windows.lead,
        windows.dt,
    )
    return y.reshape(S, W, *y.shape[1:])


def residual(windows: Windows, y: Float[np.ndarray, "... W X T"]) -> Float[np.ndarray, "... W n"]:
    """(measured - simulated) / noise std; 0 where nothing was measured."""
    r = (windows.y - y) / windows.std[:, None]
    r = np.where(np.isfinite(y), r, LOST)
    r = np.where(windows.measured, r, 0.0)
    return r.reshape(*r.shape[:-2], -1)


def linearise(
    model: Model, windows: Windows, theta: Float[np.ndarray, " p"], starts: Float[np.ndarray, "W X"]
) -> Linear:
    """The model's residuals at theta and the start states, and their finite differences."""
    X, p = starts.shape[1], len(theta)
    nudges = np.diag(np.tile(START_STEPS, X // 2))
    steps = model.steps(theta)
    thetas = np.concatenate([np.tile(theta, (1 + X, 1)), theta + np.diag(steps)])
    moved = np.concatenate(
        [starts[None], starts + nudges[:, None, :], np.tile(starts, (p, 1, 1))]
    )
    r = residual(windows, run(model, windows, thetas, moved))
    base = r[0]
    with np.errstate(invalid="ignore"):
        Jx = (base - r[1 : 1 + X]) / np.diag(nudges)[:, None, None]
        Jp = (base - r[1 + X :]) / steps[:, None, None]
    lost = np.abs(base) >= LOST
    Jx[:, lost], Jp[:, lost] = 0.0, 0.0
    return Linear(base, Jx.transpose(1, 2, 0), Jp.transpose(1, 2, 0))


def cost(
    model: Model, theta: np.ndarray, r: Float[np.ndarray, "W n"], temper: float
) -> tuple[float, np.ndarray]:
    """chi^2 with the tempered prior's share, and that of each window without."""
    by_window = np.einsum("wn,wn->w", r, r)
    return float(by_window.sum() + temper * (model.precision * theta**2).sum()), by_window


def settle(model: Model, windows: Windows, theta: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Start states fitted window by window, theta as it is: each with a damping of its own."""
    W, X = starts.shape
    damping = np.full(W, 1e-3)
    for _ in range(12):
        lin = linearise_starts(model, windows, theta, starts)
        now = np.einsum("wn,wn->w", lin.r, lin.r)
        step = _start_step(lin, lin.r, damping)
        r = residual(windows, run(model, windows, theta[None], (starts + step)[None]))[0]
        then = np.einsum("wn,wn->w", r, r)
        better = then < now
        starts = np.where(better[:, None], starts + step, starts)
        damping = np.where(better, np.maximum(0.1 * damping, 1e-9), 10.0 * damping)
        if np.all((now - then < 1e-3 * now) | (now - then < 0.1)) and better.any():
            break
    return starts


def linearise_starts(model, windows, theta, starts) -> Linear:
    """`linearise` over the start states only."""
    X = starts.shape[1]
    nudges = np.diag(np.tile(START_STEPS, X // 2))
    moved = np.concatenate([starts[None], starts + nudges[:, None, :]])
    r = residual(windows, run(model, windows, np.tile(theta, (1 + X, 1)), moved))
    Jx = (r[0] - r[1:]) / np.diag(nudges)[:, None, None]
    Jx[:, np.abs(r[0]) >= LOST] = 0.0
    return Linear(r[0], Jx.transpose(1, 2, 0), np.zeros((*r[0].shape, 0)))


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
    first: Linear | None = None,
) -> Fit:
    """Theta and the start states that fit best, by Levenberg and Marquardt's method.

    Args:
        model: what is fitted.
        windows: to what.
        theta: where the search begins.
        starts: likewise.
        iterations: at most.
        first: the model there, if it is known.
    """
    low, high = model.bounds
    damping, lin = 1e-4, first
    for _ in range(iterations):
        if lin is None:
            lin = linearise(model, windows, theta, starts)
        temper = misfit(windows, lin.r)
        now, by_window = cost(model, theta, lin.r, temper)
        for _ in range(6):
            step = _step(model, lin, theta, damping, temper)
            there = np.clip(theta + step, low, high)
            left = lin.r - np.einsum("wnp,p->wn", lin.Jp, there - theta)
            moved = starts + _start_step(lin, left, damping)
            r = residual(windows, run(model, windows, there[None], moved[None]))[0]
            then, after = cost(model, there, r, temper)
            if then < now:
                break
            damping = max(10.0 * damping, 1e-4)
        if not then < now:
            break
        theta, starts, by_window, lin = there, moved, after, None
        damping = damping * 0.03
        if now - then < max(0.02, 1e-4 * now):
            break
    prior = float((model.precision * theta**2).sum())
    return Fit(model, theta, starts, float(by_window.sum()) + prior, by_window)


def misfit(windows: Windows, r: Float[np.ndarray, "W n"]) -> float:
    """chi^2 of a sample, at least 1: by how much a misfit exceeds the noise.

    While a model misses an effect, its residuals are no noise, and the nominal parameters must not
    be bent for their sake: the prior holds against them as if the noise were that much larger.
    """
    return max(1.0, float(np.einsum("wn,wn->", r, r)) / max(int(windows.measured.sum()), 1))


def _step(
    model: Model, lin: Linear, theta: np.ndarray, damping: float, temper: float
) -> np.ndarray:
    """The damped Gauss-Newton step of theta, the start states eliminated, within its bounds."""
    P = lin.cleaned(lin.Jp)
    H = np.einsum("wni,wnj->ij", P, P) + np.diag(temper * model.precision)
    g = np.einsum("wni,wn->i", P, lin.r) - temper * model.precision * theta
    low, high = model.bounds
    free = ~((theta <= low) & (g < 0.0)) & ~((theta >= high) & (g > 0.0)) & (np.diag(H) > 0.0)
    step = np.zeros_like(theta)
    if free.any():
        Hf = H[np.ix_(free, free)]
        size = np.sqrt(np.diag(Hf))
        Hf = Hf / size[:, None] / size
        step[free] = np.linalg.solve(Hf + damping * np.eye(len(Hf)), g[free] / size) / size
    return step
